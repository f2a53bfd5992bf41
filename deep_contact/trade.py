"""The trade of speed for accuracy on a scene of your own: `measure_trade`, and the `Trade` that it returns.

Every setting runs the scene with several seeds. A reference runs it too, with 20 sweeps of PGS and substeps of at most
a sixteenth of the longest substep of a preset; scenes that `stiffness` finds too stiff for that get a better reference
(`reference_of`). Errors are the differences of both ensembles (`run_errors`), with intervals over seeds.
A setting is a mapping that JSON can hold: a method of ours, or another engine, with its options, sweeps and Δt.
The studies of runs (`studies.runs`) run, time and judge their settings by the same functions.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import pickle
import time
import typing
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from timeit import timeit
from typing import TYPE_CHECKING

import numpy as np

from deep_contact import parallel, peers, presets
from deep_contact.constants import TIME_STEP
from deep_contact.io.files import read_bytes, write_json
from deep_contact.io.provenance import provenance
from deep_contact.parallel import progress_bar
from deep_contact.physics.engine import contacts_of
from deep_contact.physics.ready import ready
from deep_contact.physics.solvers import NNCG, PGS, PSOR, BatchedPGS, solver_from
from deep_contact.physics.solvers.registry import entry_of
from deep_contact.presets import PRESETS, Decision
from deep_contact.reporting import plotting, results
from deep_contact.run_errors import (
    ERRORS,
    REST,
    Observation,
    errors,
    intervals,
    observation,
    observe,
    with_next,
    with_reach,
)
from deep_contact.scene_numbers import SceneNumbers, scene_numbers
from deep_contact.simulation import simulate
from deep_contact.state import State, notebook
from deep_contact.state.equality import by_value
from deep_contact.state.scales import mean
from deep_contact.stiffness import Stiffness, stiffness
from deep_contact.validation import brief, expect, integer, number, one_of, several, suggesting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRAMES = 120
"""Least observations of a run; a shorter one has as many as it has steps."""

SHIFT = 1e-3
"""Largest shift of a coordinate of a copy of a state, in slops."""

APART = 0.01
"""Root mean square distance, in mean radii, from which on two copies are no longer together."""

TIMED = 2
"""Number of seeds whose runs are timed, each in one call."""

LONG_ENOUGH = 0.02
"""Least time of all timings of a run together, s: a shorter run is timed several times."""

WARM = 5
"""Steps of a run before its time counts: the first ones load code, fill an engine's memory and find all contacts."""

POSITION_SWEEPS = 10
"""Largest number of position iterations of Box2D 2.3."""

SHOWN = ("energy", "height", "penetration", "penetration_max")
"""Errors of the study that the printed table shows, beside the user's quantities."""

LARGEST_FILE = 2**30
"""Largest file of a saved trade, bytes."""

ABSOLUTE = ("penetration", "penetration_95", "penetration_max")
"""Errors that compare with zero, not with the reference."""

REFERENCE = "reference"
"""Name of the reference's runs among those that are observed."""

HALF = "half step"
"""Name of the runs with half the reference's step."""


# ---- settings ----


def setting_of(solver, dt: float, start: str = "builtin") -> dict:
    """The setting of a solver's options: those that differ from the defaults, and a tolerance if there is one."""
    plain = {f.name: None if f.name == "tolerance" else f.default for f in fields(solver)}
    changed = {name: value for name, default in plain.items() if (value := getattr(solver, name)) != default}
    begin = {} if start == "builtin" else {"start": start}
    return {"method": type(solver).__name__, **changed, "sweeps": solver.sweeps, "dt": dt, **begin}


def solver_of(setting: Mapping):
    """The solver options of a setting, with a tolerance of None unless the setting has one."""
    options = {name: value for name, value in setting.items() if name not in ("method", "dt", "start")}
    return solver_from(setting["method"], {"tolerance": None} | options)


def name_of(setting: Mapping, step: float = TIME_STEP) -> str:
    """Name of a setting, such as "PGS, 10 sweeps, Δt / 2" or "Box2D v3, 4 iterations, Δt / 2". step: Δt, s."""
    budget, ratio = "iteration" if "engine" in setting else "sweep", step / setting["dt"]
    words = [group_of(setting), f"{setting['sweeps']} {budget}{'s' * (setting['sweeps'] != 1)}"]
    words += [f"{key}={setting[key]}" for key in setting if key not in ("engine", "method", "sweeps", "dt")]
    return ", ".join([*words, "Δt" if ratio == 1 else f"Δt / {ratio:g}" if ratio > 1 else f"{1 / ratio:g} Δt"])


def group_of(setting: Mapping) -> str:
    """The method of a setting, or its engine."""
    return setting.get("engine") or setting["method"]


def reference_of(numbers: SceneNumbers, stiff: Stiffness | None, finer: int = 1) -> dict:
    """The setting that counts as a scene's limit of small steps, or one with `finer` times as many steps."""
    parts = presets.parts_for(numbers, TIME_STEP / 16)
    if stiff is None:
        return setting_of(PGS(sweeps=20, tolerance=None, substeps=finer * parts), numbers.dt)
    solver = stiff.solver(finer * parts)
    if solver.tolerance is None:  # with few sweeps in a substep: more substeps
        solver = replace(solver, sweeps=20, substeps=4 * solver.substeps)
    return setting_of(solver, numbers.dt)


def settings_of_presets(numbers: SceneNumbers, stiff: Stiffness | None) -> dict:
    """Preset -> its setting for a scene."""
    chosen = {name: presets.decided(numbers, stiff, name) for name in PRESETS}
    return {name: setting_of(one.solver, numbers.dt, one.start) for name, one in chosen.items()}


def ladder(numbers: SceneNumbers) -> list:
    """A short ladder of settings around those of the presets."""
    k = presets.parts_for(numbers, TIME_STEP)
    solvers = [
        PGS(sweeps=4, tolerance=None, substeps=2 * k),
        PGS(sweeps=1, tolerance=None, substeps=k),
        PGS(sweeps=10, tolerance=None, substeps=k),
        BatchedPGS(sweeps=10, tolerance=None, substeps=4 * k, most_substeps=32 * k, slop=0.25),
        PSOR(sweeps=3, tolerance=None, substeps=2 * k, most_substeps=16 * k, slop=0.25),
        PGS(sweeps=4, tolerance=None, substeps=k, most_substeps=8 * k, slop=0.5),
        PGS(sweeps=2, tolerance=None, substeps=4 * k),
        NNCG(sweeps=20, tolerance=None, substeps=2 * k),
    ]
    return [setting_of(solver, numbers.dt) for solver in solvers]


def rivals(scene: State) -> tuple[list, list[str]]:
    """(Settings of the engines that can run the scene, sentences on why the others cannot)."""
    settings, why = [], []
    for engine in peers.ENGINES:
        budgets = ((1, 4), (1, 10), (2, 4), (2, 10), (4, 2), (4, 4))
        mine = [{"engine": engine, "sweeps": count, "dt": scene.dt / k} for k, count in budgets]
        try:
            Run(scene, mine[0])
            settings += mine
        except (ImportError, ValueError) as error:
            why.append(f"{engine} is left out: {error}")
    return settings, why


# ---- runs, and what is made of them ----


class Run:
    """A run of a scene with a setting, of our engine or of another."""

    def __init__(self, start: State, setting: Mapping):
        self._state, self._setting, self._world = start.replace(dt=setting["dt"]), setting, None
        if "engine" in setting:
            options = {name: value for name, value in setting.items() if name in ("slop", "bias", "hertz")}
            self._world = peers.ENGINES[setting["engine"]](self._state.replace(contacts=None), **options)

    def advance(self, steps: int) -> None:
        """Do `steps` steps of the setting's Δt."""
        state, setting = self._state, self._setting
        if self._world is None:
            begin = setting.get("start", "builtin")
            self._state = simulate(state, steps=steps, solver=solver_of(setting), warm_start=begin).state
        else:
            most = setting.get("position_sweeps", POSITION_SWEEPS)
            self._world.run(steps, setting["dt"], setting["sweeps"], most)
            self._state = state.replace(time=state.time + steps * setting["dt"])

    def state(self) -> State:
        """The present state, with contacts."""
        if self._world is None:
            return self._state
        state = self._state.replace(bodies=self._world.bodies())
        return state.replace(contacts=contacts_of(state))


def states_of(start: State, setting: Mapping, frames: int, interval: float) -> Iterator[State]:
    """`frames` states of a run, one every `interval`, s. Raises ValueError if the setting's Δt does not divide it."""
    run, each = Run(start, setting), round(interval / setting["dt"])
    text = f"dt: expected a step that divides {interval:g} s, got {setting['dt']}"
    expect(math.isclose(each * setting["dt"], interval, rel_tol=1e-5), text)
    for _ in range(frames):
        run.advance(each)
        yield run.state()


def timed(start: State, setting: Mapping, seconds: float) -> float:
    """Thread time of a run of `seconds` seconds of the scene in one call, s: the least of several for a short run.

    Other programs disturb thread time least. The Python wrapper of another engine counts, since its users pay for it;
    the destruction of its world does not.
    """
    took: list[float] = []
    while len(took) < 5 and sum(took) < LONG_ENOUGH:
        run = Run(start, setting)
        run.advance(WARM)
        steps = partial(run.advance, round(seconds / setting["dt"]))
        took.append(timeit(steps, timer=time.thread_time, number=1))
    return min(took)


def row_of(setting: Mapping, step: float, ensemble: Sequence[Observation], reference: Sequence[Observation]) -> dict:
    """A row of results: the setting, and its errors with intervals, against the reference's runs of the same scenes.

    step: Δt of the scene, s.
    """
    row = {"name": name_of(setting, step), "setting": dict(setting), "group": group_of(setting)}
    return row | {"seeds": len(ensemble), "errors": intervals(ensemble, reference)}


def noise_of(half: Sequence, reference: Sequence, *, swaps: int = 20) -> dict[str, float]:
    """Sizes of the `errors` by chance, from runs of the same scenes by the reference and by half its step.

    If half the step changes nothing but chance, the two runs of a scene may be swapped. The errors between ensembles
    with swapped pairs are then those that seeds alone make.
    """
    if len(half) < 2:
        return {}
    seen, rng = [], np.random.default_rng(0)
    for _ in range(swaps):
        pairs = [pair[::-1] if swap else pair for pair, swap in zip(zip(half, reference), rng.random(len(half)) < 0.5)]
        seen.append(errors(*zip(*pairs)))
    known = [name for name in seen[0] if name not in ABSOLUTE and all(one[name] is not None for one in seen)]
    return {name: float(np.mean([one[name] for one in seen])) for name in known}


# ---- what comes back ----


@by_value
@dataclass(kw_only=True, repr=False, eq=False)
class Trade:
    """Costs and errors of settings on a scene; `print` and notebooks show a table.

    rows: for each setting {"name", "setting", "group": method or engine, "seeds", "us": time of a step of Δt, µs, or
    None, "errors": name -> (value, low, high) or None}; the errors of `ERRORS` are in their units, those of quantities
    are shares.
    noise: name of an error -> its size by seeds alone. converged: name of an error -> its change by half the
    reference's step. notes: sentences on the result. by_preset: preset -> name of the study's setting for it.
    reference: the setting from which errors are measured, with small steps; not the preset of that name. half: the
    reference with half its step.
    """

    scene: str
    n_bodies: int
    dt: float
    steps: int
    settings: dict
    by_preset: dict
    reference: dict
    half: dict
    quantities: list
    digests: list  # of the scene of each seed
    looks: dict = field(default_factory=dict)  # quantity -> digest of its value for the first scene
    seeds: int = 0
    observed: dict = field(default_factory=dict)  # (name, number of the seed) -> (seconds or None, Observation)
    rows: list = field(default_factory=list)
    noise: dict = field(default_factory=dict)
    converged: dict = field(default_factory=dict)
    notes: list = field(default_factory=list)
    cpu: str = ""

    def choose(self, accuracy: str | None = None, **tolerances: float):
        """The solver of the cheapest setting that keeps a preset ("fast" by default), or tolerances of errors by name.

        Tolerances of quantities are shares: discharge=0.02. Settings that keep the tolerances at the upper ends of
        their errors' intervals come first, then settings whose errors are within 85 % of the tolerances, then settings
        whose errors are just within them. If no setting keeps the tolerances, the nearest is taken, with a warning. A
        second warning says if more seeds are needed. Raises ValueError on a name that is no error of this scene, on a
        preset beside tolerances, and if no setting was measured.
        """
        return solver_of(self.chosen(accuracy, **tolerances)["setting"])

    def chosen(self, accuracy: str | None = None, **tolerances: float) -> dict:
        """The row of the setting that `choose` takes."""
        mine = [row for row in self.rows if row["us"] and row["group"] not in peers.ENGINES]
        expect(mine, "trade: expected a setting that was measured, got none; see its notes")
        expect(not (accuracy and tolerances), "choose: expected a preset or tolerances, got both")
        known = {name for row in mine for name, error in row["errors"].items() if error}
        for name, most in tolerances.items():
            number(one_of("tolerances", name, sorted(known)), most, above=0)
            if (seeds := self.enough(name, most)) > self.seeds:
                text = f"{name}: seeds alone make an error of {self.noise[name]:.2g}, asked for was {most:g}"
                warnings.warn(f"{text}; {seeds} seeds would do", presets.PresetWarning, stacklevel=3)
        limits = tolerances or PRESETS[one_of("accuracy", accuracy or "fast", PRESETS)]
        limits = {name: most for name, most in limits.items() if name in known}

        def excess(row, at):
            """The largest error over its tolerance. at: 0 for the error itself, 2 for the upper end of its interval."""
            errors = {name: (row["errors"][name] or (math.inf,) * 3)[at] for name in limits}
            return presets.excess(errors, limits)

        # First settings that keep the tolerances at the upper ends of the intervals, then settings whose errors keep
        # them with a margin, then settings whose errors just keep them.
        for at, most in ((2, 1.0), (0, presets.MARGIN), (0, 1.0)):
            if kept := [row for row in mine if excess(row, at) <= most]:
                return min(kept, key=lambda row: row["us"])
        warnings.warn("trade: no setting keeps it; the nearest is taken", presets.PresetWarning, stacklevel=3)
        return min(mine, key=lambda row: (excess(row, 0), row["us"]))

    def enough(self, name: str, difference: float) -> int:
        """The number of seeds with which chance makes at most half of a difference between errors."""
        return math.ceil(self.seeds * (2.0 * self.noise.get(name, 0.0) / difference) ** 2)

    def values(self, quantity: str) -> dict[str, np.ndarray]:
        """Name of a setting -> values of a user's quantity, (runs, T, …). The reference's name is "reference".

        A row is a run, in the order of the seeds; a run that ended with an error has no row.
        """
        one_of("quantity", quantity, self.quantities)
        seen: dict = {name: [] for name in (*self.settings, REFERENCE)}
        for (name, _), (_, run) in sorted(self.observed.items(), key=lambda run: run[0]):
            seen.get(name, []).append(run.quantities[quantity])
        return {name: np.array(runs) for name, runs in seen.items() if runs and not isinstance(runs[0], str)}

    def decide(self, scene: State) -> Decision:
        """The `Decision` of `simulate(accuracy=trade)`: `choose()`. Raises ValueError on a scene of another Δt."""
        expect(scene.dt == self.dt, f"accuracy: expected a scene of Δt = {self.dt:g} s, as measured, got {scene.dt:g}")
        row, count = self.chosen(), scene.bodies.count
        other = count > 2 * self.n_bodies or 2 * count < self.n_bodies
        text = f"accuracy: the trade was measured on {self.n_bodies:,} circles, the scene has {count:,}"
        start = row["setting"].get("start", "builtin")
        return Decision(solver_of(row["setting"]), start, row["us"], stiffness(scene), (text,) if other else ())

    def table(self) -> list[list[str]]:
        """A header, and a line for each setting, the cheapest first: ms a step, errors in %, the preset that it keeps,
        its name."""
        names = [name for name in (*SHOWN, *self.quantities) if any(row["errors"].get(name) for row in self.rows)]
        lines = [["ms a step", *names, "keeps", "setting"]]
        for row in sorted(self.rows, key=lambda row: row["us"] or math.inf):
            by = ", ".join(preset for preset, name in self.by_preset.items() if name == row["name"])
            errors = {name: error and error[0] for name, error in row["errors"].items()}
            kept = [preset for preset, tolerances in PRESETS.items() if presets.excess(errors, tolerances) <= 1]
            cells = [f"{errors[name] * _percent(name):.3g}" if row["errors"].get(name) else "–" for name in names]
            cost = f"{1e-3 * row['us']:.3g}" if row["us"] else "–"
            lines.append([cost, *cells, kept[-1] if kept else "–", row["name"] + (f" ({by})" if by else "")])
        return lines

    def _title(self) -> str:
        what = f"{self.scene}: {self.n_bodies:,} circles, {self.steps:,} steps of {self.dt:g} s"
        return (
            f"{what}, {notebook.counted(self.seeds, 'seed')}, against {name_of(self.reference, self.dt)}; errors in %"
        )

    def __str__(self) -> str:
        lines = self.table()
        widths = [max(len(line[j]) for line in lines) for j in range(len(lines[0]))]
        rows = ["  ".join([*map(str.rjust, line[:-1], widths), line[-1]]) for line in lines]
        return "\n  ".join([self._title(), *rows, *self.notes])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        header, *rows = self.table()
        return notebook.shown(self._title(), [*rows, *((note,) for note in self.notes)], header=header)

    def plot(self, *names: str) -> Figure:
        """The figure of errors over the time of a step: settings, their front, other engines, tolerances.

        names: of the errors, a panel each; by default the energy, the deepest penetration and the user's quantities.
        Raises ValueError for an error that no setting has.
        """
        known = dict.fromkeys(name for row in self.rows for name, error in row["errors"].items() if error)
        wanted = names or [n for n in ("energy", "penetration_max", *self.quantities) if n in known]
        figure, axes = plotting.subplots(1, len(wanted), size=(4.2 * len(wanted) + 0.6, 3.9), squeeze=False)
        for ax, name in zip(axes[0], wanted):
            one_of("names", name, known)
            draw_plane(ax, [row for row in self.rows if row["us"] and row["errors"].get(name)], name)
            unit = "%" if name in ERRORS else "share"
            plotting.label_axes(ax, f"time of {self.dt:g} s", name, x_unit="µs", y_unit=unit)
        figure.suptitle(self._title(), fontsize=9)
        return figure

    def save(self, path) -> Path:
        """Write the trade with its observations to a JSON file. Returns its path."""
        stored = {f.name: getattr(self, f.name) for f in fields(self)}
        runs = [[*of, seconds, seen._asdict()] for of, (seconds, seen) in self.observed.items()]
        return write_json(path, results.plain(stored | {"observed": runs}))


def load_trade(path) -> Trade:
    """The `Trade` in a file of `Trade.save`. Raises ValueError if the file is no such file."""
    try:
        stored = json.loads(read_bytes(path, LARGEST_FILE), parse_constant=_refused, parse_float=_finite)
        runs = stored["observed"]
        stored["observed"] = {(name, i): (seconds, observation(seen)) for name, i, seconds, seen in runs}
        trade = Trade(**stored)
        for name, kind in typing.get_type_hints(Trade).items():
            value = getattr(trade, name)
            expect(isinstance(value, (kind, int) if kind is float else kind), f"{name}: {brief(value)}")
        _check_trade(trade)
        str(trade)  # reads all rows
        return trade
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(f"{Path(path).name}: expected a file of Trade.save, got {brief(error)}") from None


def _refused(text: str) -> float:
    raise ValueError(f"expected finite numbers, got {text}")


def _finite(text: str) -> float:
    return number("a number", float(text))


def _check_trade(trade: Trade) -> None:
    """Raise ValueError on numbers and settings that no measurement gives. Errors of rows become tuples."""
    number("dt", trade.dt, above=0)
    for name, least in (("n_bodies", 1), ("steps", REST), ("seeds", 0)):
        integer(name, getattr(trade, name), least=least)
    settings = (trade.reference, trade.half, *trade.settings.values(), *(row["setting"] for row in trade.rows))
    for setting in settings:
        number("dt", setting["dt"], above=0)
        integer("sweeps", setting["sweeps"], least=1)
        expect("engine" in setting or solver_of(setting), f"settings: {brief(setting)}")
    for row in trade.rows:
        expect(row["us"] is None or number("us", row["us"], above=0), "us")
        row["errors"] = {name: error and several(name, error, 3) for name, error in row["errors"].items()}


def draw_plane(ax, rows: Sequence[Mapping], error: str, *, names: bool = True) -> None:
    """Draw cost and error of settings with intervals: ours in blue with their front, other engines in grey.

    Dotted lines are the tolerances of presets. names: whether the presets' names stand at their right ends.
    """
    ours = []
    for row in rows:
        value, reach = with_reach(row["errors"][error])
        marker = plotting.ENGINE_MARKER.get(row["group"])
        look = {"color": plotting.GREY, "marker": marker} if marker else {"color": plotting.BLUE, "marker": "o"}
        ax.errorbar(row["us"], value, reach, linewidth=0.5, markersize=3, **look)
        ours += [] if marker else [(row["us"], value)]
    ours.sort()
    front = [(us, value) for k, (us, value) in enumerate(ours) if all(value < before for _, before in ours[:k])]
    ax.plot(*zip(*front), color=plotting.BLACK, drawstyle="steps-post", linewidth=1.2, zorder=3)
    ax.margins(y=0.1)
    plotting.log_axes(ax)
    for preset, tolerances in PRESETS.items() if error in ERRORS else ():
        ax.axhline(tolerances[error], color=plotting.BLACK, linewidth=0.7, linestyle=":")
        if names:
            ax.annotate(preset, (1.02, tolerances[error]), xycoords=("axes fraction", "data"), va="center",
                        fontsize=8, color=plotting.BLACK, annotation_clip=False)  # fmt: skip


# ---- the measurement ----


@suggesting
def measure_trade(
    scene: State | Callable[[int], State],
    *,
    steps: int = 600,
    minutes: float | None = None,
    seeds: int | Iterable[int] = 6,
    quantities: Mapping[str, Callable[[State], object]] | None = None,
    settings: Iterable | None = None,
    engines: bool = False,
    jobs: int | Executor = 1,
    before: Trade | None = None,
) -> Trade:
    """Measure the cost and the errors of settings on a scene.

    scene: a state, or a function of a seed that returns a state. If it is a state, each seed makes a copy with its
    coordinates shifted by up to 0.001 slops. steps: number of steps of the scene's Δt in each run, at least 20. From
    240 steps on, a run leaves out last steps that fill no interval between its observations. seeds: number of seeds,
    or the seeds themselves.
    minutes: time after which no further run begins; the result then has the runs so far. Compiling does not count.
    quantities: name -> a function of a state that returns a number or an array. It is called after each step, and from
    240 steps on at 120 to 179 equal intervals.
    settings: solvers to measure beside the presets, such as PGS(sweeps=4); by default a short ladder around the
    presets. engines: whether Box2D and pymunk run the scene as well, if they can. jobs: as in `parallel.finished`.
    before: an earlier result, whose runs are not done again.

    Runs are done seed by seed. Ctrl-C returns the result of the runs so far.
    Raises ValueError on bad arguments, and if a run of the reference ends with an error.
    """
    numbers, quantities = _checked(steps, minutes, seeds, quantities, jobs)
    states = copies(scene, numbers)
    trade = _begun(states, steps, settings, engines, quantities)
    trade.observed = {} if before is None else _known(trade, before)
    _run(trade, states, quantities, minutes, jobs)
    _judge(trade)
    if isinstance(scene, State) and len(states) > 1:
        trade.notes.append(_together(states[:2], trade))
    return trade


def _intervals(trade: Trade) -> tuple[int, float]:
    """Number of intervals between the observations of a run, and their length, s."""
    every = max(1, trade.steps // FRAMES)
    return trade.steps // every, every * trade.dt


def _run(trade: Trade, states: Sequence[State], quantities: Mapping, minutes: float | None, jobs) -> None:
    """Do all runs, until the time is over or the user interrupts them; their results go into the trade, in place."""
    settings = {REFERENCE: trade.reference, **trade.settings, HALF: trade.half}
    # Seed by seed, so that a budget that ends leaves out seeds, not settings.
    runs = [(name, i) for i in range(len(states)) for name in settings if (name, i) not in trade.observed]
    where = *_intervals(trade), quantities
    tasks = [(states[i], settings[name], *where, _is_timed(trade, name, i)) for name, i in runs]
    end = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
    try:
        with closing(parallel.finished(_task, tasks, jobs=jobs)) as done:
            for count, (k, result) in enumerate(progress_bar(done, total=len(runs), text="trade"), 1):
                name, _ = runs[k]
                if isinstance(result, str):
                    expect(name != REFERENCE, f"scene: expected one that the reference can run, got {result}")
                    trade.notes.append(f"{name} comes to no end: {result}")
                else:
                    trade.observed[runs[k]] = result
                if count < len(runs) and time.monotonic() > end and _has_reference(trade):
                    trade.notes.append(f"after {minutes:g} min {count} of {len(runs)} runs were done")
                    break
    except KeyboardInterrupt:
        if not _has_reference(trade):
            raise
        trade.notes.append("interrupted: this is what was known then")


def _has_reference(trade: Trade) -> bool:
    """Whether a run of the reference is known, without which there are no errors."""
    return any(name == REFERENCE for name, _ in trade.observed)


def _checked(steps, minutes, seeds, quantities, jobs) -> tuple[list[int], dict[str, Callable]]:
    """The seeds and the quantities of `measure_trade`. Raises ValueError on bad arguments."""
    integer("steps", steps, least=REST)
    if minutes is not None:
        number("minutes", minutes, above=0)
    quantities = dict(quantities or {})
    for name, quantity in quantities.items():
        expect(callable(quantity), f"quantities[{name!r}]: expected a function of a state, got {quantity!r}")
        expect(name not in ERRORS, f"quantities: expected other names than those of the study's errors, got {name!r}")
    if not isinstance(jobs, Executor) and integer("jobs", jobs, least=1) > 1:
        try:
            pickle.dumps(quantities)
        except (AttributeError, pickle.PicklingError, TypeError) as error:
            raise ValueError(f"quantities: expected functions of a module for jobs={jobs}, got {error}") from None
    several = range(integer("seeds", seeds, least=1)) if isinstance(seeds, int) else seeds
    numbers = [integer("seeds", seed) for seed in several]
    expect(numbers and len(set(numbers)) == len(numbers), f"seeds: expected different numbers, got {brief(numbers)}")
    return numbers, quantities


def _is_timed(trade: Trade, name: str, i: int) -> bool:
    """Whether the run of this name and of the i-th seed is timed: runs of settings are, runs of the reference not."""
    return i < TIMED and name in trade.settings


def _task(task: tuple) -> tuple[float | None, Observation] | str:
    """(Seconds or None, Observation) of a run, or the message of the error with which it ends."""
    start, setting, frames, interval, quantities, is_timed = task
    try:
        seconds = timed(start, setting, frames * interval) if is_timed else None
        return seconds, observe(states_of(start, setting, frames, interval), quantities)
    except (FloatingPointError, ValueError) as error:
        return str(error)


def copies(scene: State | Callable[[int], State], seeds: Sequence[int]) -> list[State]:
    """The scene of each seed. Raises ValueError on a value that is no scene, and on a scene that is not valid."""
    if isinstance(scene, State):
        bodies, slop = ready(scene).bodies, scene.scales.slop
        expect(bodies.count, "scene: expected a circle at least, got none")
        shifts = (np.random.default_rng(seed).uniform(-SHIFT, SHIFT, bodies.position.shape) * slop for seed in seeds)
        return [scene.replace(bodies=bodies._replace(position=bodies.position + shift)) for shift in shifts]
    expect(callable(scene), f"scene: expected a State or a function of a seed, got {scene!r}")
    states: list[State] = []
    for seed in seeds:
        try:
            state = scene(seed)
        except Exception as error:
            raise ValueError(f"scene({seed}): expected a State, got {type(error).__name__}: {error}") from error
        expect(ready(state).bodies.count, "scene: expected a circle at least, got none")
        states.append(state)
        alike = (state.bodies.count, state.dt) == (states[0].bodies.count, states[0].dt)
        expect(alike, f"scene({seed}): expected as many circles and the Δt of the first, got {state!r}")
    return states


def _begun(states: Sequence[State], steps: int, settings, engines: bool, quantities: Mapping) -> Trade:
    """The trade before its first run. All code that the runs need is compiled."""
    first, numbers = states[0], scene_numbers(states[0])
    stiff = stiffness(first, numbers)
    by_preset, more = settings_of_presets(numbers, stiff), ladder(numbers)
    if settings is not None:
        more = [setting_of(solver, first.dt) for solver in settings if entry_of(solver)]
    found, notes = rivals(first) if engines else ([], [])
    if outside := presets.outside(numbers, stiff):
        notes.append("outside of the study of the presets: " + "; ".join(outside))
    for setting in (*by_preset.values(), *more):
        with contextlib.suppress(FloatingPointError):  # its runs will report it
            Run(first, setting).advance(1)
    named = {name_of(one, first.dt): one for one in (*by_preset.values(), *more, *found)}
    values = {name: with_next(name, quantity, ready(first), []) for name, quantity in quantities.items()}
    true, half = (reference_of(numbers, stiff, finer) for finer in (1, 2))
    return Trade(
        scene=first.name, n_bodies=first.bodies.count, dt=first.dt, steps=steps, notes=notes,
        quantities=list(quantities), settings=named, reference=true, half=half, cpu=provenance()["cpu"],
        by_preset={preset: name_of(one, first.dt) for preset, one in by_preset.items()},
        digests=list(map(_digest_of_state, states)),
        looks={name: _digest(value if isinstance(value, str) else value[0]) for name, value in values.items()},
    )  # fmt: skip


def _digest_of_state(state: State) -> str:
    """Digest of everything from which a run starts: the world, the bodies, the contacts with impulses, and the time."""
    moment = repr((state.world, state.time, state.step, state.dt, state.solved, state.contacts is None))
    return _digest(moment, *state.bodies, *(state.contacts or ()))


def _digest(*parts) -> str:
    """Sixteen hexadecimal digits of arrays and texts."""
    sha = hashlib.sha256()
    for part in parts:
        sha.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
    return sha.hexdigest()[:16]


def _known(trade: Trade, before: Trade) -> dict:
    """Observations of an earlier result that are of this trade's runs. Raises ValueError if it is of another trade."""
    expect(isinstance(before, Trade), f"before: expected a Trade, got {brief(before)}")
    for name in ("dt", "steps", "quantities", "looks", "reference", "cpu"):
        mine, other = getattr(trade, name), getattr(before, name)
        expect(mine == other, f"before: expected {name} {mine!r}, got {other!r}")
    common = [i for i, (one, other) in enumerate(zip(trade.digests, before.digests)) if one == other]
    expect(common, "before: expected a trade of the same scene, got another")
    same = {name for name, one in trade.settings.items() if before.settings.get(name) == one} | {REFERENCE, HALF}
    return {(name, i): seen for (name, i), seen in before.observed.items() if name in same and i in common}


def _judge(trade: Trade) -> None:
    """Fill rows, noise and notes of the trade from its observations, in place."""
    true = {i: seen for (name, i), (_, seen) in sorted(trade.observed.items()) if name == REFERENCE}
    trade.seeds, seconds_each = len(true), math.prod(_intervals(trade))

    def paired(name):
        return [(trade.observed[name, i][1], seen) for i, seen in true.items() if (name, i) in trade.observed]

    for name, setting in trade.settings.items():
        if pairs := paired(name):
            took = [seconds for (of, _), (seconds, _) in trade.observed.items() if of == name and seconds is not None]
            us = 1e6 * float(np.mean(took)) * trade.dt / seconds_each if took else None
            trade.rows.append(row_of(setting, trade.dt, *zip(*pairs)) | {"us": us})
    if pairs := paired(HALF):
        half, reference = zip(*pairs)
        chance = math.sqrt(len(half) / trade.seeds)
        trade.noise = {name: chance * value for name, value in noise_of(half, reference).items()}
        trade.converged = {name: value for name, value in errors(half, reference).items() if value is not None}
    trade.notes += _sentences(trade, list(true.values()), len(pairs))


def _percent(name: str) -> float:
    """Factor from the unit of an error to %: 100 for errors of quantities, which are shares, and otherwise 1."""
    return 1.0 if name in ERRORS else 100.0


def _text(name: str, error: float) -> str:
    """An error as text, such as "1.2 %"; the error of contacts is a number without %."""
    return f"{error * _percent(name):.2g}{'' if name == 'contacts' else ' %'}"


def _sentences(trade: Trade, reference: Sequence[Observation], checked: int) -> Iterator[str]:
    """Notes of a trade: errors that seeds or the reference leave undecided, failed quantities, and missing contacts."""
    for name, noise in trade.noise.items():
        of = [row["errors"][name][0] for row in trade.rows if row["errors"][name]]
        differ = max(of, default=0.0) - min(of, default=0.0)
        if name in (*SHOWN, *trade.quantities) and noise > differ > 1e-3 * noise:
            alone = f"seeds alone make {_text(name, noise)}, settings differ by {_text(name, differ)}"
            yield f"{name} is undecided: {alone}; {trade.enough(name, differ)} seeds would do"
        change, chance = trade.converged.get(name, 0.0), noise * math.sqrt(trade.seeds / max(1, checked))
        if change > max(2.0 * chance, 1.0 / _percent(name)):
            why = f"half its step changes it by {_text(name, change)}, seeds by {_text(name, chance)}"
            yield f"the reference is not converged in {name}: {why}"
    own = (value for _, seen in trade.observed.values() for value in seen.quantities.values())
    yield from sorted({value for value in own if isinstance(value, str)})[:3]
    if reference and not any(seen.contacts.any() or seen.penetration.any() for seen in reference):
        yield "nothing touches anything: the errors are those of free flight"


def _together(pair: Sequence[State], trade: Trade) -> str:
    """A sentence on how long two copies of a state stay together."""
    setting, (frames, interval) = trade.settings[trade.by_preset["fast"]], _intervals(trade)
    for k, (one, other) in enumerate(zip(*(states_of(state, setting, frames, interval) for state in pair))):
        apart = np.sqrt(((one.bodies.position - other.bodies.position) ** 2).sum(axis=1).mean())
        if apart > APART * mean(one.bodies.radius):
            return f"copies of the state stay within {APART:.0%} of a radius of one another for {k * interval:.3g} s"
    return f"copies of the state stay together: the spread over seeds is that of shifts of {SHIFT:g} slops"
