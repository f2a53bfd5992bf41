"""The trade of speed for accuracy on a scene of your own: `measure_trade`, and the `Trade` that it returns.

Settings run an ensemble of the scene beside a reference, 20 sweeps of PGS in steps 16 times as small as a preset's
largest. Errors are those of the study (`run_errors.ERRORS`) and of quantities of the user, with intervals over seeds.
A setting is a mapping that JSON can hold: a method, or another engine, with its options, sweeps and Δt.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import pickle
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from deep_contact import parallel, peers, presets
from deep_contact.constants import TIME_STEP
from deep_contact.io.files import write_json
from deep_contact.io.provenance import provenance
from deep_contact.physics.engine import contacts_of
from deep_contact.physics.ready import ready
from deep_contact.physics.solvers import NNCG, PGS, PSOR, BatchedPGS, solver_from
from deep_contact.physics.solvers.batched import threads_of
from deep_contact.physics.solvers.registry import entry_of
from deep_contact.presets import PRESETS, Decision
from deep_contact.reporting import plotting, results
from deep_contact.reporting.figures import progress_bar
from deep_contact.run_errors import ERRORS, REST, Observation, errors, intervals, observation, observe, with_reach
from deep_contact.simulation import simulate
from deep_contact.state import State, notebook
from deep_contact.state.checks import check_types
from deep_contact.stiffness import stiffness
from deep_contact.validation import expect, integer, number, one_of

FRAMES = 120
"""Observations of a run."""

FEWEST_SEEDS, CHECKED_SEEDS = 3, 3
"""Seeds below which a budget drops settings first, and seeds with which the reference is checked at the least."""

SHIFT = 1e-3
"""Largest shift of a coordinate of a copy of a state, in slops."""

APART = 0.01
"""Root mean square distance, in radii, from which copies count as no longer together."""

TIMED = 2
"""Seeds whose runs are timed, each in one go."""

LONG_ENOUGH = 0.02
"""Runs are timed once if they take so long, s."""

POSITION_SWEEPS = 10
"""Of Box2D 2.3, at most."""

SHOWN = ("energy", "height", "penetration", "penetration_max")
"""Of the study's errors, those in the printed table, beside the user's quantities."""

ABSOLUTE = ("penetration", "penetration_95", "penetration_max")
"""Errors that compare with zero, not with the reference."""


# ---- settings ----


def setting_of(solver, dt: float, start: str = "builtin") -> dict:
    """The setting of a solver's options: those that differ from the defaults."""
    changed = {f.name: value for f in fields(solver) if (value := getattr(solver, f.name)) != f.default}
    changed = {name: value for name, value in changed.items() if (name, value) != ("tolerance", None)}
    if solver.tolerance is not None:
        changed["tolerance"] = solver.tolerance
    begin = {} if start == "builtin" else {"start": start}
    return {"method": type(solver).__name__, **changed, "sweeps": solver.sweeps, "dt": dt, **begin}


def solver_of(setting: Mapping):
    """The options of a setting's method; without a tolerance unless it has one."""
    options = {name: value for name, value in setting.items() if name not in ("method", "dt", "start")}
    return solver_from(setting["method"], {"tolerance": None} | options)


def name_of(setting: Mapping, step: float = TIME_STEP) -> str:
    """Such as "PGS, 10 sweeps, Δt / 2", or of an engine "Box2D v3, 4 iterations, Δt / 2"; `step` is Δt, s."""
    budget = "iteration" if "engine" in setting else "sweep"
    words = [
        setting.get("engine") or setting["method"],
        f"{setting['sweeps']} {budget}{'s' * (setting['sweeps'] != 1)}",
    ]
    words += [f"{key}={setting[key]}" for key in setting if key not in ("engine", "method", "sweeps", "dt")]
    ratio = step / setting["dt"]
    words.append("Δt" if ratio == 1 else f"Δt / {ratio:g}" if ratio > 1 else f"{1 / ratio:g} Δt")
    return ", ".join(words)


def world_of(start: State, setting: Mapping, **threads):
    """The scene in the engine that a setting names, with the setting's knobs."""
    knobs = {name: value for name, value in setting.items() if name in ("slop", "bias", "hertz")}
    return peers.ENGINES[setting["engine"]](start.replace(dt=setting["dt"], contacts=None), **knobs, **threads)


def run_world(world, setting: Mapping, steps: int) -> None:
    """So many steps of the setting's Δt."""
    world.run(steps, setting["dt"], setting["sweeps"], setting.get("position_sweeps", POSITION_SWEEPS))


def states_of(start: State, setting: Mapping, frames: int, interval: float) -> Iterator[State]:
    """The states of a run with a setting, of our engine or of another, every `interval`, s."""
    each = round(interval / setting["dt"])
    if "engine" in setting:
        world = world_of(start, setting)
        for k in range(frames):
            run_world(world, setting, each)
            state = start.replace(bodies=world.bodies(), time=(k + 1) * interval)
            yield state.replace(contacts=contacts_of(state))
        return
    state, solver, begin = start.replace(dt=setting["dt"]), solver_of(setting), setting.get("start", "builtin")
    for _ in range(frames):
        state = simulate(state, steps=each, solver=solver, warm_start=begin).state
        yield state


def reference_of(scene: State, finer: int = 1) -> dict:
    """The setting that is taken for the limit of small steps of a scene, or one of steps `finer` times as small."""
    parts = finer * presets.parts_for(scene, TIME_STEP / 16)
    stiff = stiffness(scene, parts)
    solver = PGS(sweeps=20, tolerance=None, substeps=parts) if stiff is None else stiff.solver
    if stiff is not None and solver.tolerance is None:  # substeps of a few sweeps: so many more of them
        solver = replace(solver, sweeps=20, substeps=max(parts, 4 * finer * solver.substeps))
    return setting_of(solver, scene.dt)


def ladder(scene: State) -> tuple[dict, list]:
    """(Preset -> its setting, a short ladder of settings around them)."""
    chosen = {name: presets.decide(scene, name) for name in PRESETS}
    by_preset = {name: setting_of(one.solver, scene.dt, one.start) for name, one in chosen.items()}
    k = presets.parts_for(scene, TIME_STEP)
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
    return by_preset, [setting_of(solver, scene.dt) for solver in solvers]


def rivals(scene: State) -> tuple[list, list[str]]:
    """(Settings of the engines that have the scene, why the others do not)."""
    found, why = [], []
    for engine in peers.ENGINES:
        mine = [
            {"engine": engine, "sweeps": count, "dt": scene.dt / k}
            for k, counts in ((1, (4, 10)), (2, (4, 10)), (4, (2, 4)))
            for count in counts
        ]
        try:
            world_of(scene, mine[0])
            found += mine
        except (ImportError, ValueError) as error:
            why.append(f"{engine} is left out: {error}")
    return found, why


# ---- one run ----


def observed(
    start: State, setting: Mapping, frames: int, interval: float, quantities: Mapping[str, Callable] | None = None
) -> tuple[Observation, dict]:
    """The `Observation` of a run, and of each quantity its values, (T, …), or a sentence on why there are none."""
    own: dict = {name: [] for name in quantities or ()}

    def watched():
        for state in states_of(start, setting, frames, interval):
            for name, seen in own.items():
                if isinstance(seen, list):
                    value = _value(name, quantities[name], state, seen)
                    own[name] = value if isinstance(value, str) else [*seen, value]
            yield state

    seen = observe(watched())
    return seen, {name: values if isinstance(values, str) else np.array(values) for name, values in own.items()}


def _value(name: str, quantity: Callable, state: State, before: list) -> np.ndarray | str:
    """A quantity of a state, or what is wrong with it."""
    where = f"quantities[{name!r}] at t = {state.time:.3g} s: expected"
    try:
        value = np.asarray(quantity(state), float)
    except Exception as error:
        return f"{where} a number or an array, got {type(error).__name__}: {error}"
    if not np.isfinite(value).all():
        return f"{where} finite numbers, got {value.tolist()}"
    if before and before[0].shape != value.shape:
        return f"{where} the shape that it had before, {before[0].shape}, got {value.shape}"
    return value


def timed(start: State, setting: Mapping, seconds: float) -> float:
    """Time of a run of so many seconds in one go, s.

    Of one thread its own time counts, which other programs disturb least.
    """
    steps, clock, state = round(seconds / setting["dt"]), time.thread_time, start.replace(dt=setting["dt"])
    solver = None if "engine" in setting else solver_of(setting)
    if solver and threads_of(solver, state.bodies.count) > 1:
        clock = time.perf_counter

    def once():
        world = None if solver else world_of(start, setting)
        begun = clock()
        if solver:
            simulate(state, steps=steps, solver=solver, warm_start=setting.get("start", "builtin"))
        else:
            run_world(world, setting, steps)
        return clock() - begun

    took: list[float] = []
    while len(took) < 5 and sum(took) < LONG_ENOUGH:  # the least of several short ones
        took.append(once())
    return min(took)


def _task(task: tuple) -> tuple | str:
    """(Seconds or None, Observation, quantities) of a run; a sentence where it comes to no end."""
    start, setting, frames, interval, quantities, is_timed = task
    try:
        seconds = timed(start, setting, frames * interval) if is_timed else None
        return seconds, *observed(start, setting, frames, interval, quantities)
    except (FloatingPointError, ValueError) as error:
        return str(error)


def all_errors(found: Sequence[tuple], reference: Sequence[tuple]) -> dict[str, float | None]:
    """`errors` of ensembles of (Observation, quantities), and of each quantity two, as shares of the reference's size.

    Its name: mean curve, Σ |⟨q⟩ − ⟨q⟩*| / Σ |⟨q⟩*|. "… spread": distance of the distributions over seeds of the mean
    over a run (Wasserstein). Both are absolute where the reference is 0.
    """
    values = errors([seen for seen, _ in found], [seen for seen, _ in reference])
    for name in reference[0][1]:
        curves, true = ([own[name] for _, own in runs] for runs in (found, reference))
        values |= {name: None, f"{name} spread": None}
        if any(isinstance(one, str) for one in (*curves, *true)) or curves[0].shape != true[0].shape:
            continue
        size = float(np.abs(np.mean(true, axis=0)).sum()) or float(true[0].size)
        ends = [np.sort([one.mean() for one in runs]) for runs in (curves, true)]
        values[name] = float(np.abs(np.mean(curves, axis=0) - np.mean(true, axis=0)).sum()) / size
        values[f"{name} spread"] = float(np.abs(ends[0] - ends[1]).mean()) * true[0].size / size
    return values


def noise_of(half: Sequence, reference: Sequence, *, swaps: int = 20) -> dict[str, float]:
    """What `all_errors` are by chance: between runs of the same scenes by the reference and by half its step.

    Where halving changes nothing but chance, the two runs of a scene may be swapped, and the errors of ensembles with
    swapped pairs are those that seeds alone make.
    """
    if len(half) < 2:
        return {}
    seen, rng = [], np.random.default_rng(0)
    for _ in range(swaps):
        pairs = [pair[::-1] if swap else pair for pair, swap in zip(zip(half, reference), rng.random(len(half)) < 0.5)]
        seen.append(all_errors(*zip(*pairs)))
    known = [name for name in seen[0] if name not in ABSOLUTE and all(one[name] is not None for one in seen)]
    return {name: float(np.mean([one[name] for one in seen])) for name in known}


# ---- what comes back ----


@dataclass(kw_only=True, repr=False)
class Trade:
    """What settings cost on a scene, and what they get wrong; `print` shows a table, a notebook as well.

    rows: of each setting {"name", "setting", "group": method or engine, "seeds", "us": time of a step of Δt, "errors":
    name -> (value, low, high) or None}; the errors of `ERRORS` in their units, those of quantities as shares.
    noise: error -> what seeds alone make of it. converged: error -> what half the step changes. notes: sentences.
    by_preset: preset -> name of what the study takes for it. predicted_s, took_s: how long the measurement was said to
    take, and took.
    """

    scene: str
    n_bodies: int
    dt: float
    steps: int
    settings: dict
    by_preset: dict
    reference: dict
    quantities: list
    digests: list  # of the scene of each seed
    seeds: int = 0
    observed: dict = field(default_factory=dict)  # (name, number of the seed) -> (seconds, Observation, quantities)
    rows: list = field(default_factory=list)
    noise: dict = field(default_factory=dict)
    converged: dict = field(default_factory=dict)
    notes: list = field(default_factory=list)
    predicted_s: float = 0.0
    took_s: float = 0.0
    cpu: str = ""

    def choose(self, accuracy: str | None = None, **tolerances: float):
        """The solver of the cheapest setting that keeps a preset ("fast" by default), or tolerances of errors by name.

        Tolerances of quantities are shares: discharge=0.02. Taken is what keeps them at the upper ends of its
        intervals; where nothing does, what keeps them with a margin; else the nearest, with a warning. Raises
        ValueError on a name that this scene has no error of.
        """
        return solver_of(self.chosen(accuracy, **tolerances)["setting"])

    def chosen(self, accuracy: str | None = None, **tolerances: float) -> dict:
        """The row of `choose`."""
        mine = [row for row in self.rows if row["errors"] and row["us"] and row["group"] not in peers.ENGINES]
        expect(mine, "trade: expected a setting that was measured, got none; see its notes")
        known = {name for row in mine for name, error in row["errors"].items() if error}
        for name, most in tolerances.items():
            number(one_of("tolerances", name, sorted(known)), most, above=0)
        limits = tolerances or PRESETS[one_of("accuracy", accuracy or "fast", PRESETS)]
        limits = {name: most for name, most in limits.items() if name in known}

        def excess(row, at):
            return max(
                (row["errors"][n][at] / most if row["errors"][n] else math.inf for n, most in limits.items()), default=0
            )

        for name, most in tolerances.items():
            if (seeds := self.enough(name, most)) > self.seeds:
                text = f"{name}: seeds alone make an error of {self.noise[name]:.2g}, asked for was {most:g}"
                warnings.warn(f"{text}; {seeds} seeds would do", presets.PresetWarning, stacklevel=3)
        for at, share in ((2, 1.0), (0, presets.MARGIN), (0, 1.0)):
            if kept := [row for row in mine if excess(row, at) <= share]:
                return min(kept, key=lambda row: row["us"])
        warnings.warn("trade: no setting keeps it; the nearest is taken", presets.PresetWarning, stacklevel=3)
        return min(mine, key=lambda row: excess(row, 0))

    def enough(self, name: str, difference: float) -> int:
        """Seeds with which chance makes half of a difference at most."""
        return math.ceil(self.seeds * (2.0 * self.noise.get(name, 0.0) / difference) ** 2)

    def values(self, quantity: str) -> dict[str, np.ndarray]:
        """A quantity of the user, (seeds, T, …), by the name of the setting, the reference's as "reference"."""
        one_of("quantity", quantity, self.quantities)
        seen = {name: [own[quantity] for (of, _), (*_, own) in self.observed.items() if of == name] for name in
                (*self.settings, REFERENCE)}  # fmt: skip
        return {name: np.array(runs) for name, runs in seen.items() if runs and not isinstance(runs[0], str)}

    def decide(self, scene: State) -> Decision:
        """What `simulate(accuracy=trade)` takes: `choose()`. Raises ValueError on a scene of another Δt."""
        expect(scene.dt == self.dt, f"accuracy: expected a scene of Δt = {self.dt:g} s, as measured, got {scene.dt:g}")
        row, count = self.chosen(), scene.bodies.count
        other = count > 2 * self.n_bodies or 2 * count < self.n_bodies
        text = f"accuracy: the trade was measured on {self.n_bodies:,} circles, the scene has {count:,}"
        start = row["setting"].get("start", "builtin")
        return Decision(solver_of(row["setting"]), start, row["us"], None, (text,) if other else ())

    def table(self) -> list[list[str]]:
        """A header and a line a setting, the cheapest first; errors in %, with what presets they keep."""
        names = [
            name for name in (*SHOWN, *self.quantities) if any((row["errors"] or {}).get(name) for row in self.rows)
        ]
        lines = [["setting", "ms a step", *(f"{name}, %" for name in names), "keeps"]]
        for row in sorted(self.rows, key=lambda row: row["us"] or math.inf):
            by = [preset for preset, name in self.by_preset.items() if name == row["name"]]
            kept = [p for p in PRESETS if row["errors"] and presets.keeps(row["errors"], p)]
            cells = []
            for name in names:
                error = (row["errors"] or {}).get(name)
                cells.append(f"{error[0] * (100 if name in self.quantities else 1):.3g}" if error else "–")
            name = row["name"] + (f" ({', '.join(by)})" if by else "")
            lines.append([name, f"{1e-3 * row['us']:.3g}" if row["us"] else "–", *cells, kept[-1] if kept else "–"])
        return lines

    def _title(self) -> str:
        what = f"{self.scene}: {self.n_bodies:,} circles, {self.steps:,} steps of {self.dt:g} s"
        return f"{what}, {notebook.counted(self.seeds, 'seed')}, against {name_of(self.reference, self.dt)}"

    def __str__(self) -> str:
        lines = self.table()
        widths = [max(len(line[j]) for line in lines) for j in range(len(lines[0]))]
        rows = ["  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]) for line in lines]
        return "\n  ".join([self._title(), *rows, *self.notes])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        header, *rows = self.table()
        return notebook.shown(self._title(), [*rows, *((note,) for note in self.notes)], header=header)

    def plot(self, *names: str):
        """The figure of errors over time, a panel an error: settings, their front, other engines, tolerances.

        names: of errors; by default the energy and the deepest penetration, and the user's quantities.
        """
        known = [name for row in self.rows for name, error in (row["errors"] or {}).items() if error]
        wanted = names or [n for n in ("energy", "penetration_max", *self.quantities) if n in known]
        figure, axes = plotting.subplots(1, len(wanted), size=(4.2 * len(wanted) + 0.6, 3.9), squeeze=False)
        for ax, name in zip(axes[0], wanted):
            one_of("names", name, dict.fromkeys(known))
            draw_plane(ax, [row for row in self.rows if row["us"] and (row["errors"] or {}).get(name)], name)
            for preset, tolerances in PRESETS.items():
                if name in tolerances:
                    ax.axhline(tolerances[name], color=plotting.BLACK, linewidth=0.7, linestyle=":")
                    ax.annotate(
                        preset,
                        (0.99, tolerances[name]),
                        xycoords=("axes fraction", "data"),
                        fontsize=7,
                        ha="right",
                        va="bottom",
                    )
            plotting.label_axes(
                ax, f"time of {self.dt:g} s", name, x_unit="µs", y_unit="%" if name in ERRORS else "share"
            )
        figure.suptitle(self._title(), fontsize=9)
        return figure

    def save(self, path) -> Path:
        """Write all of it, observations too, as JSON."""
        stored = {f.name: getattr(self, f.name) for f in fields(self)}
        runs = [[*of, us, seen._asdict(), own] for of, (us, seen, own) in self.observed.items()]
        return write_json(path, results.plain(stored | {"observed": runs}, digits=6))


def load_trade(path) -> Trade:
    """A `Trade` that was saved. Raises ValueError where the file is none."""
    try:
        stored = json.loads(Path(path).read_text(encoding="utf-8"))
        stored["observed"] = {
            (name, i): (us, observation(seen), {q: v if isinstance(v, str) else np.array(v) for q, v in own.items()})
            for name, i, us, seen, own in stored["observed"]
        }
        return Trade(**stored)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{Path(path).name}: expected a file of Trade.save, got {error!r}") from None


def draw_plane(ax, rows: Sequence[Mapping], error: str) -> None:
    """Cost and error of settings with intervals, ours in blue with their front, other engines in grey."""
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


# ---- the measurement ----


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
    """Measure what each setting costs on a scene, and what it gets wrong.

    scene: a state, of which each seed makes a copy shifted by up to `SHIFT` slops; or a function of a seed that makes
    one. steps: of the scene's Δt. seeds: their number, or the seeds. minutes: a budget: fewer seeds, settings and runs
    of the check of the reference, and an end when it is over. What has to be compiled first does not count.
    quantities: name -> function of a state, a number or an array, looked at `FRAMES` times a run.
    settings: solvers beside the presets, in place of the short ladder around these. engines: Box2D and pymunk too,
    where they have the scene. jobs: as in `parallel.finished`. before: an earlier result, which this one goes on from.
    The time that it takes is told first, on standard error; Ctrl-C returns what is known. Raises ValueError on bad
    arguments, and where the reference comes to no end.
    """
    integer("steps", steps, least=REST)
    numbers = (
        list(range(integer("seeds", seeds, least=1)))
        if isinstance(seeds, int)
        else [integer("seeds", s) for s in seeds]
    )
    quantities = dict(quantities or {})
    for name, quantity in quantities.items():
        expect(callable(quantity), f"quantities[{name!r}]: expected a function of a state, got {quantity!r}")
        expect(name not in ERRORS, f"quantities: expected other names than those of the study's errors, got {name!r}")
    if minutes is not None:
        number("minutes", minutes, above=0)
    if not isinstance(jobs, Executor) and integer("jobs", jobs, least=1) > 1:
        try:
            pickle.dumps(quantities)
        except (AttributeError, pickle.PicklingError, TypeError) as error:
            raise ValueError(f"quantities: expected functions of a module for jobs={jobs}, got {error}") from None
    states = copies(scene, numbers)
    trade = _begun(states, steps, settings, engines, list(quantities))
    known = {} if before is None else _known(trade, before)
    begun, every = time.perf_counter(), max(1, steps // FRAMES)
    frames, interval = steps // every, every * trade.dt
    workers = jobs if isinstance(jobs, int) else getattr(jobs, "_max_workers", 1)
    costs = _costs(trade, states[0], frames, interval)
    names, count, checked = _planned(trade, costs, len(states), workers, None if minutes is None else 60.0 * minutes)
    if (left := trade.settings.keys() - names) or count < len(states):
        trade.notes.append(f"within {minutes:g} min: {count} of {len(states)} seeds, {len(left)} settings left out")
    parts = [(name, i) for i in range(count) for name in (REFERENCE, *names)] + [(HALF, i) for i in range(checked)]
    parts = [part for part in parts if part not in known]
    setting_by_name = trade.settings | {REFERENCE: trade.reference, HALF: reference_of(states[0], 2)}
    tasks = [
        (states[i], setting_by_name[name], frames, interval, quantities, i < TIMED and name in trade.settings)
        for name, i in parts
    ]
    trade.predicted_s = time.perf_counter() - begun + sum(_cost(part, costs, trade) for part in parts) / workers
    trade.predicted_s += costs["judging"] * (len(names) + 1) + (STARTING if workers > 1 else 0.0)
    what = f"{notebook.counted(len(names), 'setting')} and a reference, {notebook.counted(count, 'seed')}"
    print(f"measure_trade: {what}: about {trade.predicted_s:.0f} s", file=sys.stderr, flush=True)
    trade.observed = known
    bar = progress_bar(total=max(1, round(sum(_cost(part, costs, trade) for part in parts))), text="trade")
    bar.bar_format = "{desc}: {percentage:.0f}% {bar} {elapsed}<{remaining}"
    try:
        with bar, closing(parallel.finished(_task, tasks, jobs=jobs)) as done:
            for i, result in done:
                bar.update(_cost(parts[i], costs, trade))
                if isinstance(result, str):
                    expect(parts[i][0] != REFERENCE, f"scene: expected one that the reference can run, got {result}")
                    trade.notes.append(f"{parts[i][0]} comes to no end: {result}")
                else:
                    trade.observed[parts[i]] = result
                following = _cost(parts[min(i + workers, len(parts) - 1)], costs, trade) + costs["judging"] * len(names)
                if minutes is not None and time.perf_counter() - begun + following > 60.0 * minutes:
                    trade.notes += [f"the budget of {minutes:g} min ended first"] * (i + 1 < len(parts))
                    break
    except KeyboardInterrupt:
        if not any(name == REFERENCE for name, _ in trade.observed):
            raise
        trade.notes.append("interrupted: this is what was known then")
    _judge(trade)
    if isinstance(scene, State) and len(states) > 1:
        trade.notes.append(_together(states[:2], trade, frames, interval))
    trade.took_s = time.perf_counter() - begun
    return trade


REFERENCE, HALF = "reference", "half step"
"""Names of its runs, and of those of half its step, among the observed."""

JUDGING, STARTING = 0.15, 5.0
"""Time that the intervals of a setting take, and processes until they compute, s."""


def copies(scene: State | Callable[[int], State], seeds: Sequence[int]) -> list[State]:
    """The scene of each seed. Raises ValueError on what is none, and what does not hold together."""
    states = []
    for seed in seeds:
        if isinstance(scene, State):
            bodies = ready(scene).bodies
            shift = np.random.default_rng(seed).uniform(-SHIFT, SHIFT, bodies.position.shape) * scene.scales.slop
            state = scene.replace(bodies=bodies._replace(position=bodies.position + shift))
        else:
            expect(callable(scene), f"scene: expected a State or a function of a seed, got {scene!r}")
            try:
                state = scene(seed)
            except Exception as error:
                text = f"scene({seed}): expected a State, got {type(error).__name__}: {error}"
                raise ValueError(text) from error
        ready(check_types(state))
        expect(state.bodies.count, "scene: expected a circle at least, got none")
        states.append(state)
        alike = (state.bodies.count, state.dt) == (states[0].bodies.count, states[0].dt)
        expect(alike, f"scene({seed}): expected as many circles and the Δt of the first, got {state!r}")
    return states


def _begun(states: Sequence[State], steps: int, settings, engines: bool, quantities: list) -> Trade:
    """The trade before its first run; everything is compiled."""
    first = states[0]
    by_preset, more = ladder(first)
    if settings is not None:
        more = [setting_of(solver, first.dt) for solver in settings if entry_of(solver)]
    found, notes = rivals(first) if engines else ([], [])
    if outside := presets.outside(first, presets.installed()):
        notes.append("outside of the study of the presets: " + "; ".join(outside))
    for setting in (*by_preset.values(), *more):
        with contextlib.suppress(FloatingPointError):  # its runs will say it
            simulate(first, steps=1, solver=solver_of(setting), warm_start=setting.get("start", "builtin"))
    return Trade(
        scene=first.name, n_bodies=first.bodies.count, dt=first.dt, steps=steps, quantities=quantities, notes=notes,
        settings={name_of(one, first.dt): one for one in (*by_preset.values(), *more, *found)},
        by_preset={preset: name_of(one, first.dt) for preset, one in by_preset.items()},
        reference=reference_of(first), digests=list(map(_digest, states)), cpu=provenance()["cpu"],
    )  # fmt: skip


def _digest(state: State) -> str:
    """Sixteen hexadecimal digits of the bodies."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in state.bodies)).hexdigest()[:16]


def _known(trade: Trade, before: Trade) -> dict:
    """What an earlier result has observed of the same runs. Raises ValueError where it is of other ones."""
    for name in ("dt", "steps", "quantities", "reference"):
        mine, other = getattr(trade, name), getattr(before, name)
        expect(mine == other, f"before: expected {name} {mine!r}, got {other!r}")
    common = [i for i, (one, other) in enumerate(zip(trade.digests, before.digests)) if one == other]
    expect(common, "before: expected a trade of the same scene, got another")
    same = {name for name, one in trade.settings.items() if before.settings.get(name) == one} | {REFERENCE, HALF}
    return {(name, i): seen for (name, i), seen in before.observed.items() if name in same and i in common}


def _costs(trade: Trade, scene: State, frames: int, interval: float) -> dict[str, float]:
    """What a run with each setting will take, s: of one interval at four moments of a run that "fast" drives."""
    fast = solver_of(trade.settings[trade.by_preset["fast"]])
    steps = round(interval / scene.dt)
    moments = [scene]
    for _ in range(4):
        with contextlib.suppress(FloatingPointError):  # as the runs will say
            moments.append(simulate(moments[-1], steps=max(1, frames // 5) * steps, solver=fast).state)
    begun = time.perf_counter()
    judging, looking = JUDGING, 0.0
    with contextlib.suppress(ValueError):  # of neither gravity nor motion
        seen = observe((moments[1:] or moments) * REST)
        looking = (time.perf_counter() - begun) / (len(moments) * REST)
        ensemble, begun = [(seen, {})] * len(trade.digests), time.perf_counter()
        for _ in range(10):
            all_errors(ensemble, ensemble)
        judging = 40 * (time.perf_counter() - begun)  # of 400 resamplings
    moments = moments[1:] or moments

    def cost(setting):
        took = []
        for moment in moments:
            states = states_of(moment, setting, 3, interval)
            with contextlib.suppress(FloatingPointError):
                next(states)
                took.append(min(_next_seconds(states) for _ in range(2)))
        return frames * (sum(took) / len(moments) + looking)

    costs = {name: cost(setting) for name, setting in trade.settings.items()}
    return costs | {"judging": judging, REFERENCE: cost(trade.reference), HALF: cost(reference_of(scene, 2))}


def _next_seconds(states: Iterator) -> float:
    begun = time.perf_counter()
    next(states)
    return time.perf_counter() - begun


def _cost(part: tuple[str, int], costs: Mapping, trade: Trade) -> float:
    """Of a run, s; those of the first seeds are done twice."""
    name, i = part
    return costs[name] * (2 if i < TIMED and name in trade.settings else 1)


def _planned(trade: Trade, costs: Mapping, count: int, workers: int, seconds: float | None) -> tuple[list, int, int]:
    """(Settings, number of seeds, of those that check the reference) that a budget leaves."""
    names, checked = list(trade.settings), count
    presets_own = set(trade.by_preset.values())

    def total():
        runs = sum(_cost((name, i), costs, trade) for name in (REFERENCE, *names) for i in range(count))
        return (runs + checked * costs[HALF]) / workers + costs["judging"] * len(names)

    while seconds is not None and total() > 0.9 * seconds:
        others = [name for name in names if name not in presets_own]
        if checked > min(count, FEWEST_SEEDS):
            checked -= 1
        elif count > FEWEST_SEEDS:
            count, checked = count - 1, min(checked, count - 1)
        elif others:
            names.remove(max(others, key=costs.__getitem__))
        elif checked > 1:
            checked -= 1
        elif count > 1:
            count -= 1
        else:
            text = f"minutes: the least, a seed of the presets and the reference, takes about {total():.0f} s"
            warnings.warn(f"{text}, more than the {seconds:g} s that were given", presets.PresetWarning, stacklevel=3)
            break
    return names, count, checked


def _judge(trade: Trade) -> None:
    """Rows, noise and sentences from what was observed."""
    runs = {name: {i: seen[1:] for (of, i), seen in trade.observed.items() if of == name} for name in
            dict.fromkeys(name for name, _ in trade.observed)}  # fmt: skip
    true = runs.get(REFERENCE, {})
    trade.seeds = len(true)

    def paired(name):
        common = sorted(true.keys() & runs.get(name, {}).keys())
        return [runs[name][i] for i in common], [true[i] for i in common]

    for name, setting in trade.settings.items():
        ensemble, reference = paired(name)
        if ensemble:
            took = [us for (of, _), (us, *_) in trade.observed.items() if of == name and us is not None]
            row = {"name": name, "setting": setting, "seeds": len(ensemble)}
            row["group"] = setting.get("engine") or setting["method"]
            us = 1e6 * float(np.mean(took)) / trade.steps if took else None
            trade.rows.append(row | {"us": us, "errors": intervals(ensemble, reference, of=all_errors)})
    half, reference = paired(HALF)
    if half:
        chance = math.sqrt(len(half) / trade.seeds)
        trade.noise = {name: chance * value for name, value in noise_of(half, reference).items()}
        trade.converged = {name: value for name, value in all_errors(half, reference).items() if value is not None}
    trade.notes += _sentences(trade, [seen for seen, _ in true.values()], len(half))


def _sentences(trade: Trade, reference: Sequence[Observation], checked: int) -> Iterator[str]:
    """What to know of a trade: where seeds or the reference do not decide, and what the scene has not."""
    for name, noise in trade.noise.items():
        unit = "" if name not in ERRORS or name == "contacts" else " %"
        scale = 1.0 if name in ERRORS else 100.0
        unit = unit if name in ERRORS else " %"
        of = [row["errors"][name][0] for row in trade.rows if row["errors"][name]]
        differ = max(of, default=0.0) - min(of, default=0.0)
        if name in (*SHOWN, *trade.quantities) and noise > differ > 1e-3 * noise:
            seeds = trade.enough(name, differ)
            text = f"seeds alone make {scale * noise:.2g}{unit}, settings differ by {scale * differ:.2g}{unit}"
            yield f"{name} is undecided: {text}; {seeds} seeds would do"
        change, chance = trade.converged.get(name, 0.0), noise * math.sqrt(trade.seeds / max(1, checked))
        if change > max(2.0 * chance, 0.01 if name not in ERRORS else 1.0):
            text = f"half its step changes it by {scale * change:.2g}{unit}, seeds by {scale * chance:.2g}{unit}"
            yield f"the reference is not converged in {name}: {text}"
    faults = {own for runs in trade.observed.values() for own in runs[2].values() if isinstance(own, str)}
    yield from sorted(faults)[:3]
    if reference and not any(seen.contacts.any() or seen.penetration.any() for seen in reference):
        yield "nothing touches anything: the errors are those of free flight"


def _together(pair: Sequence[State], trade: Trade, frames: int, interval: float) -> str:
    """How long two copies of a state stay together."""
    setting = trade.settings[trade.by_preset["fast"]]
    for k, (one, other) in enumerate(zip(*(states_of(state, setting, frames, interval) for state in pair))):
        apart = np.sqrt(((one.bodies.position - other.bodies.position) ** 2).sum(axis=1).mean())
        if apart > APART * one.bodies.radius.mean():
            return f"copies of the state stay within {APART:.0%} of a radius of one another for {k * interval:.3g} s"
    return f"copies of the state stay together: the spread over seeds is that of shifts of {SHIFT:g} slops"
