"""Scenes at the extremes, in this engine and in others: the measurements of Figure 6.6.

`QUANTITIES` lists which quantity is pushed how far and in which scene; `measure` runs one such scene in one engine and
judges the outcome. A scene is

* **safe** where everything stays in the box and in its order, the circles end no deeper in each other than position
  correction leaves them (three slops, or a tenth of the smallest radius if that is less), and the energy never rises
  by more than a hundredth of its initial value;
* **degraded** where everything stays bounded, but one of the last two conditions does not hold;
* **failed** where a number is not finite, a circle has left the box or passed through another, or the energy doubles;
* **refused** where the engine raises an error before the first step, or an adapter cannot build the scene.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from timeit import timeit

import numpy as np

from deep_contact.accuracy.stiffness import stiffness
from deep_contact.measure.setting_runs import Run
from deep_contact.measure.settings import setting_of
from deep_contact.scenes import circles_in_box, column, lattice_in_box
from deep_contact.solvers import PGS
from deep_contact.state import constants
from deep_contact.state.arrays import Bodies
from deep_contact.state.constants import POSITION_TOLERANCE, WALL_SKIN
from deep_contact.state.fields import make_bodies
from deep_contact.state.scales import mean
from deep_contact.state.state import State
from deep_contact.state.world import World
from deep_contact.stepping import metrics
from deep_contact.stepping.prepare import ready

SAFE, DEGRADED, FAILED, REFUSED, ABSENT = ("safe", "degraded", "failed", "refused", "absent")
ENGINES = ("ours", "Box2D 2.3", "pymunk")

ENERGY_TOLERANCE = 0.01
"""Rise of the mechanical energy that a safe scene may show, as a share of its initial value."""

SOLVER = PGS(sweeps=50, tolerance=None)
"""Solver of a trial, or iterations of another engine, where sweeps are not the quantity that is pushed."""

ACCURATE = PGS(sweeps=100_000, tolerance=1e-9)
"""The most accurate setting here: it nearly always ends by its tolerance."""


@dataclass(frozen=True)
class Trial:
    """One scene to run.

    solver: its sweeps are those of every engine. recognised: whether ours takes the solver of the presets instead where
    a scene is too stiff for a few sweeps. ordered: axis along which the circles have to keep the order of their
    numbers, or None.
    """

    scene: State
    steps: int
    _: KW_ONLY
    solver: PGS = SOLVER
    warm_start: object = "builtin"
    ordered: int | None = None
    recognised: bool = True


# ---- outcomes ----


def measure(trial: Trial, engine: str = "ours") -> dict:
    """Run a trial in an engine of `ENGINES`.

    Returns {"verdict": `SAFE` or another, "message": why it was refused, or how it failed, "finite": whether all
    numbers were, "energy": largest rise of the mechanical energy over its initial value, as a share of the scale,
    "correction": work of position correction against gravity, as a share of the scale, ours only, "settled": deepest
    penetration of the last tenth of the steps, slops, "speed": largest speed at the end, m/s, "us": processor time of a
    step after the trial's, μs}. A number is None where there is no run, or where it is not finite.

    The scale of energy is the initial energy, kinetic and potential above the lowest place in the box; where
    that is 0, the kinetic energy of all circles at 1 m/s.
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
        # An error before the first step is a refusal; later, numbers have left the limits of a state.
        return watch.outcome(str(error)) if watch.depth else _without_run(REFUSED, error)
    return watch.outcome()


def _without_run(verdict: str, error: Exception) -> dict:
    nothing = dict.fromkeys(("energy", "correction", "settled", "speed", "us"))
    return {"verdict": verdict, "message": str(error).strip().splitlines()[-1], "finite": True, **nothing}


def _begin(trial: Trial, engine: str) -> Run:
    """The run of a trial in an engine."""
    scene, solver = trial.scene, trial.solver
    if engine == "pymunk" and solver.sweeps == 0:
        raise ValueError("iterations must be positive and non-zero")  # Chipmunk prints this and ends the process
    if engine != "ours":
        budget = {"sweeps": solver.sweeps, "position_sweeps": solver.position_sweeps}
        return Run(scene, {"engine": engine, "dt": scene.dt, **budget})
    stiff = stiffness(ready(scene)) if trial.recognised else None
    return Run(scene, setting_of(stiff.solver() if stiff else solver, scene.dt, trial.warm_start))


class _Watch:
    """The largest values of what is observed of the bodies, once in `every` steps."""

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
        # A rise counts only if the next step keeps it: a circle whose path ends early at a contact has the velocity of
        # a whole step until the next step solves that contact (`continuous`).
        rise = (mechanical_energy(self.scene, bodies) - self.first) / self.scale
        self.energy, self.rise = max(self.energy, min(self.rise, rise)), rise
        self.speed = float(np.hypot(*bodies.velocity.T).max())
        self.depth.append(metrics.penetration(self.scene.replace(bodies=bodies)))
        if ours:  # the work of position correction against gravity
            corrected = bodies.position - self.before.position - self.scene.dt * bodies.velocity
            lift = -(bodies.mass[:, None] * np.asarray(self.scene.world.gravity) * corrected).sum()
            self.correction += max(0.0, lift) / self.scale
        self.before = bodies
        # Circles that began outside have until the last step to come back.
        due = _inside(self.scene, self.scene.bodies) if step < self.trial.steps - self.every else True
        left = np.flatnonzero(~_inside(self.scene, bodies) & due)
        if left.size:
            self.lost = self.lost or f"step {step}: circle {left[0]} has left the box"
        elif axis is not None and (np.diff(bodies.position[:, axis]) <= 0).any():
            self.lost = self.lost or f"step {step}: a circle has passed through another"

    def outcome(self, error: str | None = None) -> dict:
        """The result of `measure`. error: message of the error that ended the run, or None."""
        slop, settled = self.scene.scales.slop, max(self.depth[-max(1, len(self.depth) // 10) :], default=0.0)
        # Rounding at the circles' coordinates is not penetration.
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


def mechanical_energy(scene: State, bodies: Bodies) -> float:
    """Kinetic energy, and potential energy above the lowest place in the box, J."""
    x_min, y_min, x_max, y_max = scene.world.box
    gravity = np.asarray(scene.world.gravity)
    lowest = np.where(gravity < 0, (x_min, y_min), (x_max, y_max))
    height = bodies.position - lowest
    return metrics.kinetic_energy(bodies) - float(np.einsum("i,ij,j->", bodies.mass, height, gravity))


# ---- the scenes ----


def silo(n: int, *, radius: float = 1.0, **options) -> State:
    """`column` in a silo one circle wide, its lid two circles above it."""
    scene = column(n, radius=radius, width=2.0 * radius * (1 + WALL_SKIN), **options)
    return with_lid(scene, 2.0 * radius * (WALL_SKIN + (n + 2)))


def with_lid(scene: State, top: float) -> State:
    """The scene in a box whose upper wall is at y = `top`, m."""
    return scene.replace(world=replace(scene.world, box=(*scene.world.box[:3], top)))


def with_bodies(scene: State, **fields) -> State:
    """The scene with some fields of its bodies changed, and without contacts, so that they are found again."""
    return scene.replace(bodies=scene.bodies._replace(**fields), contacts=None)


def loaded_silo(n: int, ratio: float, *, at: int = -1) -> State:
    """A silo of circles of radius 1 m, one of which (`at`) weighs `ratio` times as much as the others."""
    scene = silo(n)
    mass = scene.bodies.mass.copy()
    mass[at] *= ratio
    return with_bodies(scene, mass=mass)


def struck_silo(n: int, *, dt: float = constants.TIME_STEP, **options) -> State:
    """A silo whose top circle arrives at 5 m/s in step 20 with every Δt and gravity. options: those of `column`."""
    scene = silo(n, **options).replace(dt=dt)
    position, velocity = scene.bodies.position.copy(), scene.bodies.velocity.copy()
    position[-1, 1] += min(5.0 * dt, scene.scales.max_translation) * 20
    velocity[-1, 1] = -5.0
    top = max(scene.world.box[3], position[-1, 1] + 2 * scene.bodies.radius[-1])
    return with_lid(with_bodies(scene, position=position, velocity=velocity), top)


def pyramid(rows: int) -> State:
    """Circles in hexagonal order on a floor as wide as the lowest row, each row one shorter."""
    places = [(row, i) for row in range(rows) for i in range(rows - row)]
    centres = [(WALL_SKIN + (1 + row + 2 * i), WALL_SKIN + (1 + np.sqrt(3) * row)) for row, i in places]
    side = 2 * (rows + WALL_SKIN)
    return State(name=f"pyramid_{rows}", world=World(box=(0, 0, side, side)), bodies=make_bodies(centres))


def bed_under(ratio: float) -> State:
    """A circle `ratio` times as large as the eight in a row on the floor that carry it; all weigh the same."""
    radius = np.array([1.0] * 8 + [ratio])
    skin = WALL_SKIN * mean(radius)
    width = 2 * max(8, ratio) + 2 * skin
    row = np.column_stack([width / 2 + 2.0 * np.arange(8) - 7, np.full(8, skin + 1.0)])
    bodies = make_bodies([*row, (width / 2, skin + 2.0 + ratio)], radius=radius, mass=1.0)
    return State(name="bed_8", world=World(box=(0, 0, width, 2 * ratio + 6)), bodies=bodies)


def channel(speed: float) -> State:
    """Two circles that run into each other with closing `speed`, m/s, in a channel that they cannot leave."""
    bodies = make_bodies([[9.0, 1.01], [21.0, 1.01]], velocity=[[speed / 2, 0], [-speed / 2, 0]])
    return State(name="channel", world=World(box=(0, 0, 30, 2.02), gravity=(0, 0)), bodies=bodies)


def overlapping(share: float, n: int = 2) -> State:
    """n circles without gravity, each overlapping the next by this share of the diameter: 1 is coinciding centres."""
    centres = np.column_stack([15.0 + 2.0 * (1 - share) * np.arange(n), np.full(n, 15.0)])
    return State(name=f"overlap_{n}", world=World(gravity=(0, 0)), bodies=make_bodies(centres))


def cornered(depth: float) -> State:
    """Five circles on a diagonal, touching, without gravity; the first is `depth` m too deep in a corner, both ways."""
    centres = 1.01 - depth + np.sqrt(2) * np.arange(5)[:, None] * np.ones(2)
    return State(name="corner_5", world=World(gravity=(0, 0)), bodies=make_bodies(centres))


def shifted(scene: State, by: float) -> State:
    """The scene moved by (by, by), m."""
    world = replace(scene.world, box=tuple(side + by for side in scene.world.box))
    return with_bodies(scene, position=scene.bodies.position + by).replace(world=world)


def small_pile(**options) -> State:
    """Thirty circles that fall into a box ten wide."""
    return circles_in_box(30, size=(10.0, 40.0), sigma_coef=1.2, seed=5, **options)


def misleading_start(kind: str, factor: float):
    """A start far from the solution, in units of W = Δt times the weight of all circles.

    "huge": all normal impulses are factor · W. "pulling": all are -factor · W. "outside": normal impulses are W,
    friction is ± factor · W by turns, far outside the cone.
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
    """The trial of a scene whose circles stay above one another."""
    return Trial(scene, steps, ordered=1, **options)


def _misled(kind: str) -> Callable:
    # Every step starts as badly as the first, so 40 steps show the effect.
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
    # At e = 1 friction alone brings the pile to rest, within 1,300 steps.
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
"""Quantity that Figure 6.6 pushes -> its unit, its values, and the function (value, steps) -> `Trial`."""

OURS_ALONE = ("tolerance", "start, huge", "start, pulling", "start, outside the cone")
"""Quantities that other engines do not have."""


def run_case(case: dict) -> dict:
    """The first three fields of a case {"quantity", "value", "engine", "steps"}, and the result of `measure` for it.

    A scene that cannot be built counts as refused.
    """
    _, _, trial_of = QUANTITIES[case["quantity"]]
    about = {"quantity": case["quantity"], "value": float(case["value"]), "engine": case["engine"]}
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            trial = trial_of(case["value"], case["steps"])
    except ValueError as error:
        return about | _without_run(REFUSED, error)
    return about | measure(trial, case["engine"])
