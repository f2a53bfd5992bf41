"""`Trade`: cost and errors of settings on a user's scene. `measure_trade` returns it."""

from __future__ import annotations

import json
import math
import typing
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deep_contact.accuracy import presets
from deep_contact.accuracy.presets import PRESETS, Decision
from deep_contact.accuracy.stiffness import stiffness
from deep_contact.io import json_data
from deep_contact.io.files import check_ending, path_of, read_bytes, write_json
from deep_contact.measure import peers
from deep_contact.measure.errors import ERRORS, REST, observation, with_reach
from deep_contact.measure.settings import name_of, solver_of
from deep_contact.plot import plotting
from deep_contact.state import html
from deep_contact.state.equality import by_value
from deep_contact.state.state import State
from deep_contact.state.validation import brief, expect, integer, number, one_of, several

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = ("energy", "height", "penetration", "penetration_max")
"""Errors of the study that the printed table shows, besides the user's quantities."""

LARGEST_FILE = 2**30
"""Largest size of a file of a saved trade, bytes."""

REFERENCE = "reference"
"""Name of the reference's runs in `Trade.observed`."""


@by_value
@dataclass(kw_only=True, repr=False, eq=False)
class Trade:
    """Cost and errors of settings on a scene. `print` and notebooks show a table.

    scene: name of the scene. n_bodies: number of its circles. dt: its Δt, s. steps: number of steps of a run. settings:
    name -> setting (`measure.settings`).
    rows: for each setting {"name", "setting", "group": solver or engine, "seeds": number of seeds, "us": time of a step
    of Δt, µs, or None, "errors": name -> (value, low, high) or None}; the errors of `ERRORS` are in their units, those
    of quantities are relative.
    noise: name of an error -> its size by the choice of seeds alone. converged: name of an error -> its change if the
    reference's step is halved. notes: sentences on the result. by_preset: name of a preset -> name of the setting that
    the preset chooses. reference: the setting with small steps, against which errors are measured; it is not the preset
    of that name. half: the reference's setting with half its step.
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
    digests: list  # digest of the scene of each seed
    looks: dict = field(default_factory=dict)  # quantity -> digest of its value for the first scene
    seeds: int = 0
    observed: dict = field(default_factory=dict)  # (name of a run, index of a seed) -> (time, s, or None, Observation)
    rows: list = field(default_factory=list)
    noise: dict = field(default_factory=dict)
    converged: dict = field(default_factory=dict)
    notes: list = field(default_factory=list)
    cpu: str = ""

    def choose(self, accuracy: str | None = None, **tolerances: float):
        """Return the solver of the cheapest setting whose errors are within the tolerances.

        accuracy: the preset that has the tolerances, by default "fast". tolerances: name of an error = its tolerance,
        in place of a preset. Tolerances of quantities are relative: discharge=0.02 means 2 %.

        The cheapest setting is taken from the first of these groups that is not empty:

        1. settings with the upper end of every error's interval within its tolerance;
        2. settings with every error within 85 % of its tolerance;
        3. settings with every error within its tolerance.

        If all groups are empty, the setting with the smallest ratio of an error to its tolerance is returned, with a
        warning. Another warning is given if more seeds are needed for a tolerance. Raises ValueError on a name that is
        no error of this scene, on a preset together with tolerances, and if no setting was measured.
        """
        return solver_of(self.chosen(accuracy, **tolerances)["setting"])

    def chosen(self, accuracy: str | None = None, **tolerances: float) -> dict:
        """Return the row of the setting whose solver `choose` returns."""
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
            """Return the largest ratio of an error to its tolerance.

            at: 0 for the error itself, 2 for the upper end of its interval.
            """
            errors = {name: (row["errors"][name] or (math.inf,) * 3)[at] for name in limits}
            return presets.excess(errors, limits)

        # The order of `choose`: the upper ends of the intervals are within the tolerances, then the errors with a
        # margin, then the errors themselves.
        for at, most in ((2, 1.0), (0, presets.MARGIN), (0, 1.0)):
            if kept := [row for row in mine if excess(row, at) <= most]:
                return min(kept, key=lambda row: row["us"])
        warnings.warn("trade: no setting keeps it; the nearest is taken", presets.PresetWarning, stacklevel=3)
        return min(mine, key=lambda row: (excess(row, 0), row["us"]))

    def enough(self, name: str, difference: float) -> int:
        """Return the number of seeds with which chance contributes at most half of `difference` to an error.

        name: name of the error. difference: difference between errors of settings, in the unit of the error.
        """
        return math.ceil(self.seeds * (2.0 * self.noise.get(name, 0.0) / difference) ** 2)

    def values(self, quantity: str) -> dict[str, np.ndarray]:
        """Return the values of a user's quantity for each setting: name -> (runs, T, …).

        The reference's name is "reference". A row is a run, in the order of the seeds; a run that ended with an error
        has no row.
        """
        one_of("quantity", quantity, self.quantities)
        seen: dict = {name: [] for name in (*self.settings, REFERENCE)}
        for (name, _), (_, run) in sorted(self.observed.items(), key=lambda run: run[0]):
            seen.get(name, []).append(run.quantities[quantity])
        return {name: np.array(runs) for name, runs in seen.items() if runs and not isinstance(runs[0], str)}

    def decide(self, scene: State) -> Decision:
        """Return the `Decision` of `simulate(accuracy=trade)`, which is `choose()`.

        Raises ValueError on a scene whose Δt is not that of the trade.
        """
        expect(scene.dt == self.dt, f"accuracy: expected a scene of Δt = {self.dt:g} s, as measured, got {scene.dt:g}")
        row, count = self.chosen(), scene.bodies.count
        other = count > 2 * self.n_bodies or 2 * count < self.n_bodies
        text = f"accuracy: the trade was measured on {self.n_bodies:,} circles, the scene has {count:,}"
        start = row["setting"].get("start", "builtin")
        return Decision(solver_of(row["setting"]), start, row["us"], stiffness(scene), (text,) if other else ())

    def table(self) -> list[list[str]]:
        """Return a header, and a line for each setting, the cheapest first.

        A line has the time of a step, ms, the errors, %, the tightest preset whose tolerances they keep, and the
        setting's name.
        """
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
        return f"{what}, {html.counted(self.seeds, 'seed')}, against {name_of(self.reference, self.dt)}; errors in %"

    def __str__(self) -> str:
        lines = self.table()
        widths = [max(len(line[j]) for line in lines) for j in range(len(lines[0]))]
        rows = ["  ".join([*map(str.rjust, line[:-1], widths), line[-1]]) for line in lines]
        return "\n  ".join([self._title(), *rows, *self.notes])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        header, *rows = self.table()
        return html.shown(self._title(), [*rows, *((note,) for note in self.notes)], header=header)

    def plot(self, *names: str) -> Figure:
        """Return a figure of errors against the time of a step: settings, their front, other engines and tolerances.

        A setting is on the front if its error is smaller than those of all cheaper settings. names: names of errors, a
        panel each; by default the energy, the deepest penetration and the user's quantities.
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
        """Write the trade with its observations to a JSON file. Returns the path of the file.

        Raises ValueError unless the path ends in .json, and OSError if the file cannot be written.
        """
        check_ending(path, (".json",), "trade.plot() makes a figure")
        stored = {f.name: getattr(self, f.name) for f in fields(self)}
        runs = [[*of, seconds, seen._asdict()] for of, (seconds, seen) in self.observed.items()]
        return write_json(path, json_data.plain(stored | {"observed": runs}))


def load_trade(path) -> Trade:
    """Return the `Trade` in a file of `Trade.save`. Raises ValueError if it is another kind of file."""
    path = path_of(path)
    try:
        stored = json.loads(read_bytes(path, LARGEST_FILE), parse_constant=_refused, parse_float=_finite)
        runs = stored["observed"]
        stored["observed"] = {(name, i): (seconds, observation(seen)) for name, i, seconds, seen in runs}
        trade = Trade(**stored)
        for name, kind in typing.get_type_hints(Trade).items():
            value = getattr(trade, name)
            expect(isinstance(value, (kind, int) if kind is float else kind), f"{name}: {brief(value)}")
        _check_trade(trade)
        str(trade)  # raises an error if a row is wrong
        return trade
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path.name}: expected a file of Trade.save, got {brief(error)}") from None


def _refused(text: str) -> float:
    raise ValueError(f"expected finite numbers, got {text}")


def _finite(text: str) -> float:
    return number("a number", float(text))


def _check_trade(trade: Trade) -> None:
    """Raise ValueError on numbers and settings that no measurement gives. Errors in rows become tuples."""
    number("dt", trade.dt, above=0)
    for name, least in (("n_bodies", 1), ("steps", REST), ("seeds", 0)):
        integer(name, getattr(trade, name), least=least)
    settings = (trade.reference, trade.half, *trade.settings.values(), *(row["setting"] for row in trade.rows))
    for setting in settings:
        number("dt", setting["dt"], above=0)
        integer("sweeps", setting["sweeps"], least=1)
        expect("engine" in setting or solver_of(setting), f"settings: {brief(setting)}")
    for _, seen in trade.observed.values():
        is_at_each_time = seen.force is None or seen.force.shape == seen.kinetic.shape
        expect(is_at_each_time, "force: expected one at each time, got those of an earlier version")
    for row in trade.rows:
        expect(row["us"] is None or number("us", row["us"], above=0), "us")
        row["errors"] = {name: error and several(name, error, 3) for name, error in row["errors"].items()}


def draw_plane(ax, rows: Sequence[Mapping], error: str, *, names: bool = True) -> None:
    """Draw errors with intervals against the cost of settings. Settings of this package are blue, other engines grey.

    A black line is the front of the blue settings. Dotted lines are the tolerances of presets. rows: rows of a `Trade`.
    error: name of the error. names: whether the presets' names stand at the right ends of the dotted lines.
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


def _percent(name: str) -> float:
    """Return the factor from the unit of an error to %.

    It is 100 for errors of quantities, which are relative, and otherwise 1.
    """
    return 1.0 if name in ERRORS else 100.0


def _text(name: str, error: float) -> str:
    """Return an error as text, such as "1.2 %". The text of the error "contacts" is a number of contacts per circle."""
    return f"{error * _percent(name):.2g}{'' if name == 'contacts' else ' %'}"
