"""python scripts/figure_6_6_stability.py: extreme values of each quantity, in this package and in two other engines.

`QUANTITIES` lists the quantities, their values and the scenes. `measure` runs one scene in one engine, and judges the
outcome. A scene is

* **safe** if all circles stay in the box and in their order, if their final penetration is at most what position
  correction allows (three slops, or a tenth of the smallest radius if that is less), and if the energy never rises by
  more than a hundredth of its initial value;
* **degraded** if the penetration or the energy is larger, but the scene has not failed;
* **failed** if a number is not finite, a circle has left the box or passed through another, or the energy doubles;
* **refused** if the engine raises an error before the first step, or an adapter cannot build the scene;
* **absent** if the engine is not installed.
"""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from itertools import groupby, product
from timeit import timeit

import numpy as np

from deep_contact import figures, parallel
from deep_contact.accuracy.stiffness import stiffness
from deep_contact.figures import Claim, Figure
from deep_contact.measure.setting_runs import Run
from deep_contact.measure.settings import setting_of
from deep_contact.plot import plotting
from deep_contact.scenes import circles_in_box, lattice_in_box
from deep_contact.solvers import PGS
from deep_contact.state import constants
from deep_contact.state.arrays import Bodies
from deep_contact.state.constants import POSITION_TOLERANCE, WALL_SKIN
from deep_contact.state.fields import make_bodies
from deep_contact.state.scales import mean
from deep_contact.state.state import State
from deep_contact.state.validation import one_of
from deep_contact.state.world import World
from deep_contact.stepping import metrics
from deep_contact.stepping.prepare import ready
from deep_contact.studies.hard_scenes import (
    channel,
    loaded_silo,
    mechanical_energy,
    overlapping,
    pyramid,
    silo,
    with_bodies,
    with_lid,
)

SAFE, DEGRADED, FAILED, REFUSED, ABSENT = ("safe", "degraded", "failed", "refused", "absent")

ENGINES = ("ours", "Box2D 2.3", "pymunk")

ENERGY_TOLERANCE = 0.01
"""Largest rise of the mechanical energy in a safe scene, as a share of its initial value."""

SOLVER = PGS(sweeps=50, tolerance=None)
"""Solver of a trial, if the sweeps are not the quantity that varies. Other engines do as many iterations."""

ACCURATE = PGS(sweeps=100_000, tolerance=1e-9)
"""Most accurate solver of this figure. It nearly always reaches its tolerance."""


@dataclass(frozen=True)
class Trial:
    """A scene to run, and how.

    scene: the scene. steps: number of time steps. solver: solver of this package; other engines do the same number of
    sweeps. warm_start: start of every step. ordered: axis (0 or 1) along which the circles have to keep the order of
    their indices, or None. recognised: whether this package takes the solver of the presets instead of `solver`, if a
    few sweeps are not enough for the stiffness of the scene.
    """

    scene: State
    steps: int
    _: KW_ONLY
    solver: PGS = SOLVER
    warm_start: object = "builtin"
    ordered: int | None = None
    recognised: bool = True


# ---- the scenes, and the values of each quantity ----


def struck_silo(n: int, *, dt: float = constants.TIME_STEP, **options) -> State:
    """Return a silo of n circles, of which the highest falls onto the others at 5 m/s.

    It starts so high that it arrives in step 20 for every Δt. dt: time step, s. options: arguments of `column`.
    """
    scene = silo(n, **options).replace(dt=dt)
    position, velocity = scene.bodies.position.copy(), scene.bodies.velocity.copy()
    position[-1, 1] += min(5.0 * dt, scene.scales.max_translation) * 20
    velocity[-1, 1] = -5.0
    top = max(scene.world.box[3], position[-1, 1] + 2 * scene.bodies.radius[-1])
    return with_lid(with_bodies(scene, position=position, velocity=velocity), top)


def bed_under(ratio: float) -> State:
    """Return a row of eight circles of radius 1 m on the floor, which carry a circle of the radius `ratio`, m.

    All circles have the same mass.
    """
    radius = np.array([1.0] * 8 + [ratio])
    skin = WALL_SKIN * mean(radius)
    width = 2 * max(8, ratio) + 2 * skin
    row = np.column_stack([width / 2 + 2.0 * np.arange(8) - 7, np.full(8, skin + 1.0)])
    bodies = make_bodies([*row, (width / 2, skin + 2.0 + ratio)], radius=radius, mass=1.0)
    return State(name="bed_8", world=World(box=(0, 0, width, 2 * ratio + 6)), bodies=bodies)


def cornered(depth: float) -> State:
    """Return five touching circles on a diagonal, without gravity, of which the first penetrates a corner.

    depth: penetration of both walls, m.
    """
    centres = 1.01 - depth + np.sqrt(2) * np.arange(5)[:, None] * np.ones(2)
    return State(name="corner_5", world=World(gravity=(0, 0)), bodies=make_bodies(centres))


def shifted(scene: State, by: float) -> State:
    """Return the scene translated by the vector (by, by), m."""
    world = replace(scene.world, box=tuple(side + by for side in scene.world.box))
    return with_bodies(scene, position=scene.bodies.position + by).replace(world=world)


def small_pile(**options) -> State:
    """Return thirty circles that fall into a box with a width of 10 m. options: arguments of `circles_in_box`."""
    return circles_in_box(30, size=(10.0, 40.0), sigma_coef=1.2, seed=5, **options)


def misleading_start(kind: str, factor: float):
    """Return a start, as a function (state, solver) -> (λ_n, λ_t), that is far from the solution.

    W is Δt times the weight of all circles, N·s. kind: with "huge" all λ_n are factor · W. With "pulling" all λ_n are
    -factor · W. With "outside" all λ_n are W, and λ_t alternates between factor · W and -factor · W, far outside of the
    friction cone.
    """

    def start(state, solver):
        weight = state.dt * state.bodies.mass.sum() * np.hypot(*state.world.gravity)
        normal = np.full(state.contacts.count, weight)
        if kind == "outside":
            return normal, factor * weight * (-1.0) ** np.arange(normal.size)
        return (factor if kind == "huge" else -factor) * normal, 0.0 * normal

    return start


def _powers(first: int, last: int) -> tuple[float, ...]:
    return tuple(float(f"1e{p}") for p in range(first, last + 1))


def _stacked(scene: State, steps: int, **options) -> Trial:
    """Return the `Trial` of a scene whose circles have to stay above one another. options: fields of the `Trial`."""
    return Trial(scene, steps, ordered=1, **options)


def _misled(kind: str) -> Callable:
    # Every step has the same misleading start, so 40 steps are enough to show the effect.
    return lambda v, s: Trial(pyramid(5), min(s, 40), solver=ACCURATE, warm_start=misleading_start(kind, v))


_MASS_RATIOS = (*_powers(0, 8), 1e31)
_MASSES = (1e-40, 1e-30, 1e-20, 1e-12, 1e-6, 1.0, 1e6, 1e12, 1e20, 1e30, 1e40)
_RADII = (1e-8, 1e-6, 1e-4, 1e-3, 0.01, 0.05, 0.1, 1.0, 10.0, 100.0, 1e4, 1e6, 1e8, 1e10)
_STEPS = (*_powers(-10, -3), 0.01, 0.02, 0.05, 0.1, 0.3, 1.0, 2.0)
_SPEEDS = (1e-9, 1e-6, 1e-3, 1.0, 10.0, 100.0, 200.0, 400.0, 500.0, 1e3, 1e4, 1e6, 1e10, 1e11)
_TOLERANCES = (0.0, 1e-12, 1e-9, 1e-6, 6e-5, 1e-3, 0.01, 0.1, 1.0, 10.0)
_FAR = (1e3, 1e6, 1e9, 1e12, 1e15, 1e60)

QUANTITIES: dict[str, tuple[str, tuple, Callable[[float, int], Trial]]] = {
    "mass ratio, heavy on light": ("", _MASS_RATIOS, lambda v, s: _stacked(loaded_silo(5, v), s)),
    "mass ratio, light on heavy": ("", _MASS_RATIOS, lambda v, s: _stacked(loaded_silo(5, v, at=0), s)),
    "mass": ("kg", _MASSES, lambda v, s: _stacked(with_bodies(silo(5), mass=np.full(5, v)), s)),
    "radius": ("m", _RADII, lambda v, s: _stacked(silo(3, radius=v), s)),
    "radius ratio": ("", (1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1e3, 1e4), lambda v, s: Trial(bed_under(v), s)),
    "column height": (
        "", (1, 2, 5, 10, 20, 50, 100, 200, 1000),
        lambda v, s: _stacked(silo(v), 10 * s, solver=PGS(sweeps=10, tolerance=None)),
    ),
    "pyramid rows": ("", (2, 5, 10, 20, 50, 100), lambda v, s: Trial(pyramid(v), s)),
    "pile": ("circles", (10, 100, 1000, 10_000), lambda v, s: Trial(lattice_in_box(v), 4 * s)),
    "time step": ("s", _STEPS, lambda v, s: _stacked(struck_silo(5, dt=v), s)),
    "speed": ("m/s", _SPEEDS, lambda v, s: Trial(channel(v), s, ordered=0)),
    "gravity": (
        "m/s²", (0.0, 1e-6, 1e-3, 1.0, 10.0, 100.0, *_powers(3, 7)),
        lambda v, s: _stacked(struck_silo(5, gravity=(0.0, -v)), s),
    ),
    "friction": (
        "", (0.0, 1e-9, 0.5, 1.0, 10.0, 1e3, 1e6, 1e9, 1e12), lambda v, s: Trial(small_pile(friction=v), 2 * s)
    ),
    # At e = 1 only friction dissipates energy, and the pile comes to rest within 1,300 steps.
    "restitution": ("", (0.0, 0.25, 0.5, 0.75, 1.0), lambda v, s: Trial(small_pile(restitution=v), 4 * s)),
    "overlap": ("of the diameter", (0.0, 1e-6, 0.01, 0.1, 0.5, 0.9, 1.0), lambda v, s: Trial(overlapping(v), s)),
    "coinciding circles": ("circles", (2, 5, 10, 20, 50, 100, 200), lambda v, s: Trial(overlapping(1.0, v), s)),
    "depth in a corner": ("m", (0.0, 0.005, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0), lambda v, s: Trial(cornered(v), s)),
    "coordinate": ("m", (1e-6, 1.0, *_powers(3, 8), 9e8, 1e10), lambda v, s: _stacked(shifted(silo(5), v), s)),
    "sweeps": (
        "", (0, 1, 2, 5, 10, 100, 1000, 100_000),
        lambda v, s: _stacked(
            struck_silo(10), min(s, max(60, 300_000 // (v + 1))), solver=PGS(sweeps=v, tolerance=None)
        ),
    ),
    "tolerance": ("N·s", _TOLERANCES, lambda v, s: _stacked(struck_silo(10), s, solver=PGS(sweeps=1000, tolerance=v))),
    "start, huge": ("weights", (0.0, 1.0, 10.0, *_FAR), _misled("huge")),
    "start, pulling": ("weights", (1.0, 10.0, *_FAR), _misled("pulling")),
    "start, outside the cone": ("weights", (0.5, 1.0, 10.0, *_FAR), _misled("outside")),
}  # fmt: skip
"""Quantity that varies in Figure 6.6 -> (its unit, its values, function (value, steps) -> `Trial`)."""

OURS_ALONE = ("tolerance", "start, huge", "start, pulling", "start, outside the cone")
"""Quantities that only this package has."""

OPTIONS = {"quantities": list(QUANTITIES), "few": False, "steps": 400}
QUICK = {"quantities": ["mass", "radius ratio", "speed", "overlap", "sweeps"], "few": True, "steps": 100}


# ---- outcomes ----


def measure(trial: Trial, engine: str = "ours") -> dict:
    """Run a trial in an engine of `ENGINES`, and judge the outcome.

    Returns a dict. A number in it is None if there was no run, or if the number is not finite:

    * "verdict": "safe", "degraded", "failed", "refused" or "absent";
    * "message": reason of a refusal or failure;
    * "finite": whether all numbers were finite;
    * "energy": largest rise of the mechanical energy above its initial value, over the energy scale;
    * "correction": work of position correction against gravity, over the energy scale, for this package only;
    * "settled": largest penetration in the last tenth of the steps, in slops;
    * "speed": largest speed at the end, m/s;
    * "us": processor time of a step, measured after the trial, μs.

    The energy scale is the initial energy, which is kinetic energy and potential energy above the lowest point of the
    box. If it is 0, the scale is the kinetic energy of all circles at 1 m/s.
    """
    # Reading the bodies of another engine takes longer than one of its steps.
    every = 1 if engine == "ours" else max(1, trial.scene.bodies.count // 250)
    watch, more = _Watch(trial, every), max(20, trial.steps // 10)
    try:
        run = _begin(trial, engine)
        for _ in range(trial.steps // every):
            run.advance(every)
            watch.see(run.state().bodies, ours=engine == "ours")
        with suppress(ValueError, ArithmeticError):
            watch.us = 1e6 * timeit(partial(run.advance, more), timer=time.thread_time, number=1) / more
    except (ImportError, FileNotFoundError) as error:
        return _without_run(ABSENT, error)
    except (ValueError, AssertionError, ArithmeticError) as error:
        # An error before the first step is a refusal. A later error means that numbers are beyond the limits of a
        # state.
        return watch.outcome(str(error)) if watch.depth else _without_run(REFUSED, error)
    return watch.outcome()


def _without_run(verdict: str, error: Exception) -> dict:
    nothing = dict.fromkeys(("energy", "correction", "settled", "speed", "us"))
    return {"verdict": verdict, "message": str(error).strip().splitlines()[-1], "finite": True, **nothing}


def _begin(trial: Trial, engine: str) -> Run:
    """Return the `Run` of a trial in an engine, before its first step."""
    scene, solver = trial.scene, trial.solver
    if engine == "pymunk" and solver.sweeps == 0:
        raise ValueError("iterations must be positive and non-zero")  # Chipmunk would end the process
    if engine != "ours":
        budget = {"sweeps": solver.sweeps, "position_sweeps": solver.position_sweeps}
        return Run(scene, {"engine": engine, "dt": scene.dt, **budget})
    stiff = stiffness(ready(scene)) if trial.recognised else None
    return Run(scene, setting_of(stiff.solver() if stiff else solver, scene.dt, trial.warm_start))


class _Watch:
    """The observations of a trial's bodies once every `every` steps, from which `outcome` makes the result."""

    def __init__(self, trial: Trial, every: int):
        self.every, self.trial, self.scene, self.before = every, trial, trial.scene, trial.scene.bodies
        self.depth: list[float] = []
        with np.errstate(over="ignore"):
            self.first = mechanical_energy(self.scene, self.scene.bodies)
            self.scale = self.first if self.first > 0 else 0.5 * self.scene.bodies.mass.sum()
        self.energy = self.rise = self.correction = self.speed = 0.0
        self.lost, self.us = "", None

    def see(self, bodies: Bodies, *, ours: bool) -> None:
        step, axis = self.every * (len(self.depth) + 1) - 1, self.trial.ordered
        # A rise of the energy counts only if it is still there at the next observation. Continuous collision detection
        # may shorten the path of a circle at a contact. Its velocity is then that of a whole step until the next step
        # solves the contact (`continuous`).
        rise = (mechanical_energy(self.scene, bodies) - self.first) / self.scale
        self.energy, self.rise = max(self.energy, min(self.rise, rise)), rise
        self.speed = float(np.hypot(*bodies.velocity.T).max())
        self.depth.append(metrics.penetration(self.scene.replace(bodies=bodies)))
        if ours:  # add the work of position correction against gravity in this step
            corrected = bodies.position - self.before.position - self.scene.dt * bodies.velocity
            lift = -(bodies.mass[:, None] * np.asarray(self.scene.world.gravity) * corrected).sum()
            self.correction += max(0.0, lift) / self.scale
        self.before = bodies
        # A circle that is outside of the box at the beginning may stay outside until the last step.
        due = _inside(self.scene, self.scene.bodies) if step < self.trial.steps - self.every else True
        left = np.flatnonzero(~_inside(self.scene, bodies) & due)
        if left.size:
            self.lost = self.lost or f"step {step}: circle {left[0]} has left the box"
        elif axis is not None and (np.diff(bodies.position[:, axis]) <= 0).any():
            self.lost = self.lost or f"step {step}: a circle has passed through another"

    def outcome(self, error: str | None = None) -> dict:
        """Return the result of `measure`. error: message of the error that ended the run, or None."""
        slop, settled = self.scene.scales.slop, max(self.depth[-max(1, len(self.depth) // 10) :], default=0.0)
        # The factor 1 + 1e-9 allows for rounding errors of the coordinates.
        allowed = min(POSITION_TOLERANCE * slop, 0.1 * float(self.scene.bodies.radius.min())) * (1 + 1e-9)
        rose = f"the energy rose by {self.energy:.3g} of its initial value" if self.energy > 1 else ""
        message = error or self.lost or rose
        verdict = FAILED if message else DEGRADED if settled > allowed or self.energy > ENERGY_TOLERANCE else SAFE
        numbers = {"energy": self.energy, "correction": self.correction, "settled": settled / slop, "speed": self.speed}
        finite = error is None and bool(np.isfinite(list(numbers.values())).all())
        numbers = {name: float(value) if np.isfinite(value) else None for name, value in numbers.items()}
        return {"verdict": verdict, "message": message, "finite": finite, **numbers, "us": self.us}


def _inside(scene: State, bodies: Bodies) -> np.ndarray:
    x_min, y_min, x_max, y_max = scene.world.box
    return ((bodies.position >= (x_min, y_min)) & (bodies.position <= (x_max, y_max))).all(axis=1)


def run_case(case: dict) -> dict:
    """Build and run the trial of a case. Returns its quantity, value and engine, with the result of `measure`.

    A scene that cannot be built counts as refused. case: dict with "quantity", "value", "engine" and "steps".
    """
    _, _, trial_of = QUANTITIES[case["quantity"]]
    about = {"quantity": case["quantity"], "value": float(case["value"]), "engine": case["engine"]}
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            trial = trial_of(case["value"], case["steps"])
    except ValueError as error:
        return about | _without_run(REFUSED, error)
    return about | measure(trial, case["engine"])


# ---- the figure ----


def compute(options, seed, jobs, progress):
    """Run the trials of all values of all quantities in every engine that has the quantity.

    If the option "few" is true, every other value is left out.
    """
    cases, units = [], {}
    for name in options["quantities"]:
        units[name], values, _ = QUANTITIES[one_of("quantities", name, QUANTITIES)]
        cells = product(values[:: 1 + options["few"]], ENGINES[:1] if name in OURS_ALONE else ENGINES)
        cases += [{"quantity": name, "value": v, "engine": engine, "steps": options["steps"]} for v, engine in cells]
    cells = parallel.parallel_map(run_case, cases, jobs=jobs, progress=progress, text="scenes")
    return {"units": units, "cells": cells}


ROUNDING = 1e-9
"""Largest rise of the energy that counts as a rounding error, as a share of its initial value."""

MILD_START = 1e12
"""Largest factor of `misleading_start` with which the rise of the energy by rounding stays below `ROUNDING`."""


def unearned(cell):
    """Return the rise of the energy minus the work of position correction, over the energy scale (`measure`).

    cell: result of `run_case`.
    """
    return cell["energy"] - (cell["correction"] or 0.0)


def claims(data):
    mine = [cell for cell in data["cells"] if cell["engine"] == "ours"]
    accepted = [cell for cell in mine if cell["verdict"] != REFUSED]
    not_finite = sum(not cell["finite"] for cell in accepted)
    text = "no accepted scene ends in a number that is not finite"
    yield Claim(text, None, not not_finite, {"scenes": len(accepted), "not finite": not_finite})
    refusals = [cell["message"] for cell in mine if cell["verdict"] == REFUSED]
    explained = all("expected" in message and "got" in message for message in refusals)
    text = "every refusal names the quantity, its limits and the value"
    yield Claim(text, None, explained, {"refused": len(refusals)})
    inelastic = [cell for cell in accepted if cell["quantity"] != "restitution" or cell["value"] == 0]
    mild = [c for c in inelastic if not c["quantity"].startswith("start") or c["value"] <= MILD_START]
    if mild:
        worst = max(mild, key=unearned)
        measured = {"scenes": len(mild), "largest rise": unearned(worst), "of": worst["quantity"]}
        text = f"with e = 0 the energy never rises by more than {ROUNDING:g} and the work of position correction"
        yield Claim(text, None, unearned(worst) <= ROUNDING, {**measured, "at": worst["value"]})
    if speeds := [cell["speed"] for cell in accepted if cell["quantity"] in ("overlap", "coinciding circles")]:
        text = "circles that overlap, up to the whole diameter, are parted without giving them any speed"
        yield Claim(text, None, max(speeds) == 0.0, {"largest speed (m/s)": max(speeds)})


def by_quantity(data):
    """Return the results ordered by value: quantity -> engine -> results of `run_case`.

    The list of an engine that does not have the quantity is empty.
    """
    grouped = {name: {engine: [] for engine in ENGINES} for name in data["units"]}
    for cell in sorted(data["cells"], key=lambda cell: cell["value"]):
        grouped[cell["quantity"]][cell["engine"]].append(cell)
    return grouped


def ranges(cells, verdict):
    """Return the values with some verdict as a text: "1 to 100; 1e+06". None if there is no such value.

    cells: results of `run_case` by ascending value.
    """
    runs = [list(group) for said, group in groupby(cells, key=lambda cell: cell["verdict"]) if said == verdict]
    ends = [[f"{cell['value']:g}" for cell in (run[0], run[-1])] for run in runs]
    return "; ".join(low if low == high else f"{low} to {high}" for low, high in ends) or None


def spread(cells, key):
    """Return [least, median, largest] of a number over the safe and degraded scenes, or None if there are none.

    key: name of the number in the results of `run_case`.
    """
    kept = [cell[key] for cell in cells if cell["verdict"] in (SAFE, DEGRADED) and cell[key] is not None]
    return [float(value) for value in np.percentile(kept, (0, 50, 100))] if kept else None


def table(data):
    verdicts = (SAFE, DEGRADED, FAILED, REFUSED)
    rows = [["quantity", "unit", *(f"ours: {v}" for v in verdicts), *(f"{engine}: safe" for engine in ENGINES[1:])]]
    for name, engines in by_quantity(data).items():
        mine, *others = engines.values()
        row = [ranges(mine, verdict) for verdict in verdicts] + [ranges(cells, SAFE) for cells in others]
        rows.append([name, data["units"][name], *row])
    return rows


COLOURS = {SAFE: plotting.GREEN, DEGRADED: plotting.YELLOW, FAILED: plotting.VERMILION, REFUSED: "#BBBBBB"}
LOOKS = {"ours": (plotting.BLUE, "o")} | {name: (plotting.GREY, plotting.ENGINE_MARKER[name]) for name in ENGINES[1:]}


def draw(data, options):
    """Draw three panels.

    The left panel has the verdict for each value, from the least to the largest, with this package above the others.
    The other panels have the final penetration and the time of a step, median and range over the safe and degraded
    values.
    """
    from matplotlib.patches import Patch

    grouped = by_quantity(data)
    size = (plotting.PAGE, 1.4 + 0.36 * len(grouped))
    figure, (left, middle, right) = plotting.subplots(1, 3, size=size, sharey=True, width_ratios=(1.3, 1, 1))
    for (row, engines), (stripe, engine) in product(enumerate(grouped.values()), enumerate(ENGINES)):
        cells, y, (colour, marker) = engines[engine], row + 0.25 * (stripe - 1), LOOKS[engine]
        for i, cell in enumerate(cells):
            if cell["verdict"] != ABSENT:
                left.barh(y, 1 / len(cells), 0.21, i / len(cells), color=COLOURS[cell["verdict"]])
        for ax, key in ((middle, "settled"), (right, "us")):
            if of := spread(cells, key):
                low, value, high = np.maximum(of, 0.01)
                ax.plot([low, high], [y, y], color=colour, linewidth=0.8)
                ax.plot(value, y, marker, color=colour, markersize=3.5)
    ends = ((of["ours"][0]["value"], of["ours"][-1]["value"]) for of in grouped.values())
    names = (f"{name}, {data['units'][name]}".rstrip(", ") for name in grouped)
    left.set_yticks(range(len(grouped)), [f"{name}\n{low:g} to {high:g}" for name, (low, high) in zip(names, ends)])
    left.set(ylim=(len(grouped) - 0.5, -0.5), xlim=(0, 1), title="Is it safe? (ours above)")
    left.set_xticks([0, 1], ["least", "largest"])
    left.set_xlabel("values tried, in order:\nbeside each name")
    middle.axvline(3, color=plotting.BLACK, linewidth=0.8, linestyle=":")
    for ax in (left, middle, right):
        ax.grid(False, axis="y")
        ax.tick_params(axis="y", length=0)
    middle.set(xscale="log", xlabel="slops (dotted: 3 are safe)", title="How deep at rest?")
    right.set(xscale="log", xlabel="time of a step (µs)", title="At which cost?")
    handles = [Patch(color=colour, label=verdict) for verdict, colour in COLOURS.items()]
    for name, (colour, marker) in LOOKS.items():
        handles += middle.plot([], [], color=colour, marker=marker, markersize=3.5, linewidth=0.8, label=name)
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


FIGURE = Figure("6.6", "Stability at the extremes: what is safe, degraded, failed and refused", compute, table, draw,
                claims, options=OPTIONS, quick=QUICK)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
