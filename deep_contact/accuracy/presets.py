"""Presets of accuracy, and the cheapest setting for each: `simulate(accuracy=…)` and `recommend`.

A preset is a table of tolerances on the errors of a run (`errors.ERRORS`). A setting is a method with a number of
sweeps and a time step. The package has a study of settings, with their measured errors and times on kinds of scenes
(`studies.runs`). `scripts/run_tradeoff.py --install` writes the study. A preset chooses the cheapest setting whose
errors are within its tolerances on scenes like the user's.

The time step of a setting is meant for circles of r = 1 m under g = 9.81 m/s². For other circles it is scaled by √(r /
g). If the user's time step is longer, it is divided into substeps. Most settings divide it further if a circle is about
to hit something (`stepping.substeps`), and have a slop of their own.

If a few sweeps cannot solve a scene, it gets another solver (`stiffness`).
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np

from deep_contact.accuracy.scene_numbers import SceneNumbers, scene_numbers
from deep_contact.accuracy.stiffness import Stiffness, stiffness
from deep_contact.solvers import describe, solver_from
from deep_contact.state import html
from deep_contact.state.constants import FRICTION, GRAVITY, TIME_STEP
from deep_contact.state.state import State
from deep_contact.state.validation import number, one_of, suggesting
from deep_contact.stepping.interface import entry_of

TABLE = Path(__file__).with_name("runs.json")
"""File of the study that is shipped with the package."""

Accuracy = Literal["preview", "fast", "balanced", "accurate", "reference"]
"""The names of `PRESETS`, from the loosest to the tightest."""


class MeasuredAccuracy(Protocol):
    """A measurement on the user's own scene, such as a `trade.Trade`. It chooses the solver in place of the study."""

    def decide(self, scene: State) -> Decision: ...


PRESETS: dict[str, dict[str, float]] = {
    "preview": {"energy": 25, "height": 5, "creep": 4, "penetration": 1, "penetration_95": 2.5, "penetration_max": 40,
                "restlessness": 12, "contacts": 0.7, "forces": 30, "impact": 35},
    "fast": {"energy": 12, "height": 3, "creep": 2, "penetration": 0.6, "penetration_95": 1, "penetration_max": 12,
             "restlessness": 8, "contacts": 0.6, "forces": 30, "impact": 30},
    "balanced": {"energy": 8, "height": 2, "creep": 2, "penetration": 0.35, "penetration_95": 0.6,
                 "penetration_max": 8, "restlessness": 6, "contacts": 0.5, "forces": 30, "impact": 30},
    "accurate": {"energy": 6, "height": 2, "creep": 2, "penetration": 0.2, "penetration_95": 0.5,
                 "penetration_max": 5, "restlessness": 5, "contacts": 0.35, "forces": 20, "impact": 25},
    "reference": {"energy": 4, "height": 2, "creep": 1.5, "penetration": 0.12, "penetration_95": 0.4,
                  "penetration_max": 3, "restlessness": 5, "contacts": 0.2, "forces": 10, "impact": 20},
}  # fmt: skip
"""Name of a preset -> tolerance of each error, in %; "contacts" is in contacts per circle.

At a step of 10 ms, the deepest penetration of an impact does not depend on the number of sweeps. The tolerance of
"preview" allows such a step. In piles without friction the slop closes gaps, which changes the distribution of forces.
The tolerances of forces from "preview" to "accurate" allow this change.
"""

MARGIN = 0.85
"""Share of the tolerances within which the errors of a setting should be in the study. The study has few seeds of a few
scenes, so that its errors are uncertain."""

MARGIN_COST = 2.0
"""Largest factor by which `MARGIN` may raise the cost of a preset. Without this limit the preset "reference" took a
setting of 3.3 times the cost for 10,000 circles, while the errors of the cheaper setting were up to 0.87 of the
tolerances."""

KNOWN = 1.0
"""Largest error, %, that a setting may have in motions with known answers (`run_tradeoff.py`). Presets use no setting
with a larger error."""

_NEARLY = 1.05
"""Largest ratio of the user's step to a setting's step at which the user's step is not divided. It exceeds 1 because
the mean of random radii around 1 m is not exactly 1 m."""

MOST_SUBSTEPS = 1024
"""Largest number of substeps into which a preset divides a step."""

FASTEST = 10.0
"""Largest speed of circles, in √(g r), for which the time steps of the study are meant. Faster circles get shorter
steps."""

DENSITIES = {"densities": (2, 10, 100), "heavy on light": (10, 100), "light on heavy": (10,)}
"""Kind of the study's scenes with two densities -> ratios of the densities. In "densities" dense and light circles are
mixed, in the other kinds they lie in layers."""

LAYERED = 0.25
"""Least difference between the mean heights of dense and light circles at which they count as layers, as a share of the
height of all circles."""

SPREAD = 2.5
"""Least ratio of two heights of a dam that breaks: the height of its circles, and the height that they would have if
they lay across the whole width of the box."""

CHECKED = {"friction": 1.0, "restitution": 0.9, "count": 30_000}
"""Number of a scene -> largest value up to which the tolerances were checked, by the study or on the scenes outside of
it (`run_tradeoff_verify.py`). The count is three times the largest of these scenes. Larger ratios of radii or densities
than these scenes have make a scene stiff."""

RADII_OF_FLOWS = 1.3
"""Largest ratio of radii up to which the tolerances were checked in scenes with segments and in dams that break."""

FEW = 30
"""Scenes of fewer circles have no warning, since tests compare bounces of a few circles with their exact answers."""

DENSE = 0.5
"""The circles of a dam cover at least this share of the rectangle around them."""

MEASURING = 600 * 500
"""Time that `measure_trade` takes for 600 steps and six seeds, as a multiple of the time of one step of a preset. The
runs of the reference, and its runs with half the step, are included."""


class PresetWarning(UserWarning):
    """Warning that a preset may not keep its tolerances in a scene. Its text names the quantity, and what to do."""


@dataclass(frozen=True, kw_only=True)
class Recommendation:
    """A solver and a start for the runs of a scene, with their cost and errors. `print` shows all of it.

    accuracy: name of the preset. solver: options of the solver (`solvers`), with the number of substeps. warm_start:
    name of the start. us: wall time of a step of `dt` on the processor `cpu`, μs, the mean over a run. dt: Δt of the
    scene, s. n_bodies: number of circles in the scene. errors: name of an error -> its largest value in the study, over
    the kinds of scenes like this scene and the two sizes around `n_bodies`. tolerances: name of an error -> tolerance
    of the preset. reached: whether all errors are within the tolerances; if not, no setting is within them, and this
    setting comes nearest. outside: sentences on properties of the scene that the study did not measure; empty if there
    are none. cheaper, better: text on the setting of the next looser and of the next tighter preset, with its cost;
    empty if there is no such preset.
    """

    accuracy: str
    solver: object
    warm_start: str
    us: float
    dt: float
    n_bodies: int
    cpu: str
    errors: dict
    tolerances: dict
    reached: bool
    outside: tuple[str, ...] = ()
    cheaper: str = ""
    better: str = ""

    def _rows(self) -> Iterator[tuple[str, str]]:
        """Yield (name, text) of each line that `print` shows. The first line is the title."""
        yield self.accuracy, f"{describe(self.solver)} from {self.warm_start}"
        yield "cost", f"{self.us:,.0f} μs a step of {self.dt:g} s, {self.n_bodies:,} circles; {self.cpu}"
        if not self.reached:
            yield "nearest", "no setting of the study keeps all tolerances; this one comes nearest"
        known = ((name, most) for name, most in self.tolerances.items() if name in self.errors)
        percent = {name: "" if name == "contacts" else " %" for name in self.errors}
        errors = ", ".join(f"{name} {self.errors[name]:.2g}{percent[name]} ({most:g})" for name, most in known)
        yield "errors of a run (tolerances)", errors
        yield from (("outside of the study", sentence) for sentence in self.outside)
        if self.outside or not self.reached:
            yield "what to do", _way_out(self.us)
        yield from ((name, text) for name, text in (("cheaper", self.cheaper), ("better", self.better)) if text)

    def __str__(self) -> str:
        return "\n  ".join(f"{name}: {text}" for name, text in self._rows())

    def _repr_html_(self) -> str:
        (name, setting), *rows = self._rows()
        return html.shown(f"{name}: {setting}", rows)


@suggesting
def recommend(scene: State, *, accuracy: Accuracy | None = None, budget_ms: float | None = None) -> Recommendation:
    """Return the cheapest setting within the tolerances of a preset, or the most accurate setting within a budget.

    accuracy: a name of `PRESETS`; by default "fast". budget_ms: largest wall time of a step of the scene's Δt, ms, on
    the processor of the study. Raises ValueError if both are set, and on a bad value.
    """
    if accuracy is not None and budget_ms is not None:
        raise ValueError("recommend: expected one of accuracy, budget_ms, got both")
    numbers = scene_numbers(scene)
    stiff = stiffness(scene, numbers)
    candidates = _candidates(*_case(numbers, stiff))
    if budget_ms is None:
        name = one_of("accuracy", accuracy or "fast", PRESETS)
        best = cheapest(candidates, PRESETS[name])
    else:
        limit = 1e3 * number("budget_ms", budget_ms, above=0)
        affordable = [one for one in candidates if one["us"] <= limit]
        if not affordable:
            least = min(one["us"] for one in candidates)
            raise ValueError(f"budget_ms: expected at least {least / 1e3:.3g}, the cheapest setting, got {budget_ms}")
        best = min(affordable, key=lambda one: (excess(one["errors"], PRESETS["reference"]), one["us"]))
        name = ["preview", *(preset for preset, most in PRESETS.items() if excess(best["errors"], most) <= 1)][-1]
    names, tolerances = ["", *PRESETS, ""], dict(PRESETS[name])
    at = names.index(name)
    cheaper, better = (_neighbour(other, best, candidates) for other in (names[at - 1], names[at + 1]))
    return Recommendation(
        accuracy=name, solver=best["solver"], warm_start=best["start"], us=best["us"], dt=numbers.dt,
        n_bodies=numbers.count, cpu=installed()["cpu"], errors=best["errors"], tolerances=tolerances,
        reached=excess(best["errors"], tolerances) <= 1, outside=tuple(outside(numbers, stiff)),
        cheaper=cheaper, better=better,
    )  # fmt: skip


def _neighbour(accuracy: str, best: dict, candidates: list[dict]) -> str:
    """Return a text on the setting of another preset, with the ratio of its cost to that of the recommended setting.

    accuracy: name of the other preset; if it is "", so is the text. best: the recommended setting. candidates: settings
    from `_candidates`.
    """
    if not accuracy:
        return ""
    other = cheapest(candidates, PRESETS[accuracy])
    if other["solver"] == best["solver"]:
        return f"{accuracy} is the same here"
    return f"{accuracy}, {describe(other['solver'])}, {other['us'] / best['us']:.2g} times the time"


class Decision(NamedTuple):
    """The choice of `simulate(accuracy=…)` for a scene.

    solver: solver options. start: name of the start. us: time of a step of the scene's Δt on the study's processor, μs;
    an upper bound if steps are solved to a tolerance. stiff: `Stiffness` of a scene that is too stiff for a few sweeps,
    or None. warnings: sentences for the user.
    """

    solver: object
    start: str
    us: float
    stiff: Stiffness | None
    warnings: tuple[str, ...]


def decide(scene: State, accuracy: str | MeasuredAccuracy | None, *, sleep: bool = False) -> Decision:
    """Return the `Decision` of a preset for a scene, by default of "fast". Raises ValueError on an unknown name.

    accuracy: name of the preset, or a measurement that decides in its place. sleep: whether to choose only among
    solvers that support sleeping. If the preset was named, the decision has a warning where no setting of the study
    keeps the preset's tolerances, and where the tolerances were not checked (`unchecked`).
    """
    if hasattr(accuracy, "decide"):
        return accuracy.decide(scene)
    numbers = scene_numbers(scene)
    return decided(numbers, stiffness(scene, numbers), accuracy, sleep=sleep)


def decided(numbers: SceneNumbers, stiff: Stiffness | None, accuracy: str | None, *, sleep: bool = False) -> Decision:
    """Return the `Decision` of a preset from the numbers and the stiffness of a scene (`decide`)."""
    name = one_of("accuracy", accuracy or "fast", PRESETS)
    best = _chosen(name, sleep, *_case(numbers, stiff))
    sentences = _too_long(numbers, best["dt"])
    if stiff and stiff.carried is not None:
        price = f"up to {best['us'] / 1e3:.3g} ms a step of {numbers.dt:g} s"
        sentences.append(f"{stiff.why}: solved to a tolerance, which takes {price}")
    if accuracy is not None and excess(best["errors"], PRESETS[name]) > 1:
        sentences.append(
            f"no setting of the study keeps its tolerances for {numbers.count:,} circles; the nearest is taken "
            f"(print(dc.recommend(scene, accuracy={name!r})) says more); {_way_out(best['us'])}"
        )
    is_solved = stiff is not None and stiff.carried is not None  # to a tolerance, whatever the scene
    if accuracy is not None and not is_solved and (beyond := unchecked(numbers)):
        advice = f"the preset may miss its tolerances; {_way_out(best['us'])}, or name a solver"
        sentences.append(f"{'; '.join(beyond)}; {advice}")
    warnings = tuple(f"accuracy={name!r}: {one}" for one in sentences)
    return Decision(best["solver"], best["start"], best["us"], stiff, warnings)


def _way_out(us: float) -> str:
    """Return a sentence that recommends `measure_trade` where the study does not suffice.

    us: time of a step of a setting, μs, from which the sentence estimates the time of the measurement.
    """
    return f"dc.measure_trade(scene) measures it on this scene, in about {MEASURING * us / 1e6:,.0f} s for 600 steps"


@functools.lru_cache(256)
def _chosen(accuracy: str, sleep: bool, *case) -> dict:
    """Return the cheapest setting in the installed study that keeps the tolerances of the preset `accuracy`.

    If no setting keeps them, return the nearest (`cheapest`). sleep: whether the solver has to let circles sleep. case:
    the arguments of `_candidates`, which describe the scene.
    """
    candidates = [one for one in _candidates(*case) if not sleep or entry_of(one["solver"]).can_sleep]
    return cheapest(candidates, PRESETS[accuracy])


@functools.cache
def installed() -> dict:
    """Return the study in the package."""
    return json.loads(TABLE.read_text(encoding="utf-8"))


def longest_step(numbers: SceneNumbers, dt: float) -> float:
    """Return the time step of a scene, s, that corresponds to the step `dt` for circles of r = 1 m under 9.81 m/s².

    dt: time step of a setting, s.
    """
    speed = max(math.sqrt(numbers.gravity * numbers.radius), numbers.fastest / FASTEST)
    return math.inf if speed == 0 else dt * math.sqrt(-GRAVITY[1]) * numbers.radius / speed


def parts_for(numbers: SceneNumbers, dt: float) -> int:
    """Return the number of substeps into which a setting with the time step `dt`, s, divides a scene's Δt.

    It is the least power of two with which a substep exceeds `longest_step(numbers, dt)` by at most 5 %, or
    `MOST_SUBSTEPS` if that is less. A power of two scales impulses exactly.
    """
    ratio = numbers.dt / longest_step(numbers, dt)
    return 2 ** math.ceil(math.log2(min(ratio / _NEARLY, MOST_SUBSTEPS)) - 1e-9) if ratio > _NEARLY else 1


def keeping(candidates: list[dict], tolerances: Mapping[str, float], *, margin: bool = True) -> list[dict]:
    """Return the candidates whose "errors" are within the tolerances.

    margin: whether to return only candidates whose errors are within `MARGIN` times the tolerances, and whose cost "us"
    is at most `MARGIN_COST` times that of the cheapest candidate within the tolerances. If there is no such candidate,
    all candidates within the tolerances are returned.
    """
    kept = [one for one in candidates if excess(one["errors"], tolerances) <= 1.0]
    if not (margin and kept):
        return kept
    most = MARGIN_COST * min(one["us"] for one in kept)
    return [one for one in kept if one["us"] <= most and excess(one["errors"], tolerances) <= MARGIN] or kept


def excess(errors: Mapping[str, float | None], tolerances: Mapping[str, float]) -> float:
    """Return the largest ratio of an error to its tolerance, over all errors that are known and have a tolerance."""
    known = ((errors.get(name), most) for name, most in tolerances.items())
    return max((value / most for value, most in known if value is not None), default=0.0)


def cheapest(candidates: list[dict], tolerances: Mapping[str, float]) -> dict:
    """Return the cheapest of the candidates that `keeping` returns for the tolerances: the one with the smallest "us".

    If there is none, return the candidate whose errors come nearest to the tolerances.
    """
    if kept := keeping(candidates, tolerances):
        return min(kept, key=lambda one: one["us"])
    return min(candidates, key=lambda one: (excess(one["errors"], tolerances), one["us"]))


def _case(numbers: SceneNumbers, stiff: Stiffness | None) -> tuple:
    """Return the arguments of `_candidates` for a scene."""
    substeps = {dt: parts_for(numbers, dt) for dt in _time_steps()}
    rolls = numbers.rolling > 0.0
    solver = stiff and stiff.solver(substeps[TIME_STEP], rolls=rolls)
    return numbers.count, tuple(kinds_of(numbers)), tuple(substeps.items()), solver, rolls


def _time_steps() -> list[float]:
    """Return the time steps of the study's settings and the time step of its scenes, s, sorted."""
    return sorted({setting["dt"] for setting in installed()["settings"]} | {TIME_STEP})


def _candidates(n: int, kinds: Sequence[str], substeps: Sequence, stiff, rolls: bool) -> list[dict]:
    """Return every setting of the study for n circles of these kinds: its solver, start, cost and errors.

    A candidate has "solver", "start", "us" (μs for a step of the scene's Δt), "errors" and "dt" (time step of the
    setting, s). Errors are the largest over the two sizes of the study around n, and over the kinds. Times are those of
    the slowest kind, interpolated between the sizes by a power law.

    substeps: pairs of a time step of the study, s, and the number of substeps into which it divides the scene's Δt.
    stiff: None, or the solver for a scene that a few sweeps cannot solve (`stiffness`), which is then the only
    candidate. Its cost is an upper bound: all its sweeps at the lowest cost of a sweep in the study. Its errors are
    those of the study's best setting. rolls: whether solvers without rolling resistance are left out.
    """
    candidates, parts = [], dict(substeps)
    kinds, low, high = _near(n, kinds)
    for setting in installed()["settings"]:
        if setting.get("known", 0.0) > KNOWN:
            continue
        measured = {size: kinds <= of_size.keys() for size, of_size in setting["errors"].items()}
        if not (measured.get(low) and measured.get(high)):
            continue  # Large piles, and kinds other than "plain", were run with fewer settings.
        alike = [setting["errors"][size][kind] for size in (low, high) for kind in kinds]
        names = dict.fromkeys(name for one in alike for name in one)
        errors = {name: max(one[name] for one in alike if name in one) for name in names}
        times = {int(size): max(setting["us"][size][kind] for kind in kinds) for size, kept in measured.items() if kept}
        k, options = parts[setting["dt"]], dict(setting["options"])
        us, start = k * _us_at(n, times) * setting["dt"] / TIME_STEP, options.pop("start", "builtin")
        solver = solver_from(options.pop("method"), options)
        if rolls and not entry_of(solver).rolls:
            continue
        solver = replace(solver, substeps=k, most_substeps=solver.most_substeps and k * solver.most_substeps)
        candidates.append({"solver": solver, "start": start, "us": us, "errors": errors, "dt": setting["dt"]})
    if stiff is None:
        return candidates
    best = min(candidates, key=lambda one: excess(one["errors"], PRESETS["reference"]))
    each = min(one["us"] / (one["solver"].sweeps * one["solver"].substeps) for one in candidates)
    us = each * stiff.sweeps * stiff.substeps
    return [best | {"solver": stiff, "start": "builtin", "us": us, "dt": TIME_STEP}]


def _near(n: int, kinds: Sequence[str]) -> tuple[set[str], str, str]:
    """Return (kinds, smaller size, larger size): kinds of the study, and the two sizes of its scenes around n, as text.

    The result has those of `kinds` that the study has. If the study has none of them, the result has all kinds of the
    study. Both sizes are the nearest size if n lies outside of the sizes that the study has for these kinds.
    """
    sizes_of = installed()["kinds"]
    wanted = sizes_of.keys() & kinds or set(sizes_of)
    sizes = sorted(set.intersection(*(set(sizes_of[kind]) for kind in wanted)))
    low = max((size for size in sizes if size <= n), default=sizes[0])
    return wanted, str(low), str(min((size for size in sizes if size >= n), default=sizes[-1]))


def kinds_of(numbers: SceneNumbers) -> list[str]:
    """Return the kinds of scenes in the study (`studies.runs.KINDS`) that a scene resembles, or between which it lies.

    Scenes with segments, a dam or two densities need better settings than piles, and the study ran them with settings
    that it did not run on piles. A scene with one of these features therefore does not count as a pile.

    Segments at rest that leave no opening for a circle are a terrain. With an opening, the scene lies between a terrain
    and a hopper.
    """
    if numbers.gravity == 0.0:
        return ["gas"]
    smallest = numbers.radius / numbers.radius_ratio  # or larger
    ground = ["terrain", "hopper"] if numbers.opening > 2.0 * smallest else ["terrain"]
    walls = ["drum"] if numbers.is_dragged else ground if numbers.still else []
    walls += ["piston"] if numbers.moving else []
    kinds = [kind for kind in walls if kind in installed()["kinds"]]  # a small study may not have these kinds
    kinds += _of_densities(numbers)
    if not {"hopper", "piston"} & set(kinds) and _is_dam(numbers):  # these two kinds contain such flows
        kinds.append("dam break")
    is_pile = not kinds
    if numbers.friction < FRICTION:
        kinds.append("no friction")
    if 0 < numbers.most_restitution and numbers.restitution < 0.8:
        kinds.append("elastic 0.3")
    if numbers.most_restitution > 0.3:
        kinds.append("elastic 0.8")
    if is_pile and numbers.radius_ratio > 1.05:
        return [*kinds, "mixed radii"]
    return [*kinds, "plain"] if is_pile and numbers.most_friction > 0 and numbers.restitution < 0.3 else kinds


def _of_densities(numbers: SceneNumbers) -> list[str]:
    """Return which of the study's kinds with two densities (`DENSITIES`) a scene resembles, as a list of one name.

    It is the kind with the next larger ratio of densities, in layers or mixed. The list is empty if all circles have
    the same density.
    """
    if numbers.density_ratio <= 1.001:
        return []
    layers = "heavy on light" if numbers.layers > 0 else "light on heavy"
    names = (layers, "densities") if abs(numbers.layers) > LAYERED else ("densities",)
    kinds = (
        f"{name} 1 : {most}" for name in names for most in DENSITIES[name] if numbers.density_ratio <= 1.001 * most
    )
    return [next(kinds, f"{names[0]} 1 : {DENSITIES[names[0]][-1]}")]


def _is_dam(numbers: SceneNumbers) -> bool:
    """Return whether a scene is a dam that breaks: circles so high and so dense that they will flow apart.

    `SPREAD` and `DENSE` are the limits.
    """
    if numbers.count < 2:
        return False
    diameter = 2.0 * numbers.radius
    up, across = numbers.height + diameter, numbers.width + diameter
    lying = max(2.0 * math.sqrt(3.0) * numbers.squares / numbers.box_width, diameter)
    return up > SPREAD * lying and math.pi * numbers.squares > DENSE * up * across


def _us_at(n: int, times: Mapping[int, float]) -> float:
    """Return the time of a step with n circles, μs, by a power law through the two nearest measured sizes.

    times: number of circles -> time, μs.
    """
    sizes = sorted(times)
    if len(sizes) == 1:
        return times[sizes[0]] * n / sizes[0]
    at = min(max(1, int(np.searchsorted(sizes, n))), len(sizes) - 1)
    low, high = sizes[at - 1], sizes[at]
    power = math.log(times[high] / times[low]) / math.log(high / low)
    return times[low] * (max(n, sizes[0]) / low) ** power


def outside(numbers: SceneNumbers, stiff: Stiffness | None) -> list[str]:
    """Return sentences on the properties of a scene that lie outside of the study, or an empty list."""
    sizes, count, speed = installed()["sizes"], numbers.count, numbers.fastest
    fastest = FASTEST * math.sqrt(numbers.gravity * numbers.radius)
    measured = {kind: installed()["kinds"].get(kind, [math.inf]) for kind in kinds_of(numbers)}
    missing = ", ".join(kind for kind, of in measured.items() if not min(of) / 3 <= count <= 3 * max(of))
    of_friction = numbers.most_friction > 0.5 or numbers.friction < numbers.most_friction
    of_restitution = numbers.most_restitution > 0.8 or numbers.restitution < numbers.most_restitution
    rubs = _range(numbers.friction, numbers.most_friction)
    bounces = _range(numbers.restitution, numbers.most_restitution)
    price = "the cost is that of all sweeps, of which a scene at rest needs few, and the errors are those of the"
    sentences = {
        f"{count:,} circles; it has {min(sizes):,} to {max(sizes):,}": not min(sizes) / 3 <= count <= 3 * max(sizes),
        f"{count:,} circles of the kind {missing}; it has none of about this size": missing,
        f"radii that differ {numbers.radius_ratio:.3g} times; it has up to 3": numbers.radius_ratio > 3.001,
        f"densities that differ {numbers.density_ratio:.3g} times; it has up to 100": numbers.density_ratio > 100.1,
        f"friction {rubs}; it has 0 and 0.5": of_friction,
        f"restitution {bounces}; it has 0, 0.3 and 0.8": of_restitution,
        f"rolling resistance of up to {numbers.rolling:g} m; it has none": numbers.rolling > 0.0,
        f"{stiff and stiff.why}: solved to a tolerance in substeps; {price} study's best setting": stiff,
        **dict.fromkeys(_too_long(numbers, max(_time_steps())), True),
        f"a speed of {speed:.3g} m/s; it has up to {fastest:.3g}": 0 < fastest < speed,
    }
    return [sentence for sentence, is_so in sentences.items() if is_so]


def _range(low: float, high: float) -> str:
    """Return the values of a property as text: one number, or the smallest and the largest."""
    return f"{low:g}" if low == high else f"from {low:g} to {high:g} between pairs"


def unchecked(numbers: SceneNumbers) -> list[str]:
    """Return sentences on the properties of a scene beyond those at which the tolerances were checked.

    The list is empty for scenes of fewer than `FEW` circles, which get the settings of 100 circles. Fast circles are no
    such property, because presets shorten their steps.
    """
    if numbers.count < FEW:
        return []
    flows = {"terrain", "hopper", "drum", "piston", "dam break"} & set(kinds_of(numbers))
    most = CHECKED | ({"radius_ratio": RADII_OF_FLOWS} if flows else {})
    words = {
        "friction": "friction {:g}", "restitution": "restitution {:g}", "count": "{:,} circles",
        "radius_ratio": "radii that differ {:.3g} times, in a scene of this kind",
    }  # fmt: skip
    largest = numbers._asdict() | {"friction": numbers.most_friction, "restitution": numbers.most_restitution}
    return [
        f"{words[name].format(value)}: the study and its check have up to {limit:,g}"
        for name, limit in most.items()
        if (value := largest[name]) > 1.001 * limit
    ]


def _too_long(numbers: SceneNumbers, dt: float) -> list[str]:
    """Return a list with a sentence if a scene's Δt would need more than `MOST_SUBSTEPS` substeps, or an empty list.

    dt: time step of the setting in the study, s.
    """
    needed = numbers.dt / longest_step(numbers, dt)
    if needed <= MOST_SUBSTEPS * _NEARLY:
        return []
    return [
        f"dt = {numbers.dt:g} s: circles of {numbers.radius:.3g} m at up to {numbers.fastest:.3g} m/s need "
        f"{needed:,.0f} substeps, and get {MOST_SUBSTEPS:,}; give a dt of at most "
        f"{numbers.dt * MOST_SUBSTEPS / needed:.2g} s"
    ]
