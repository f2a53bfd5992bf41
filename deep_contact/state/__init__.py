"""The state of a simulation: `World` (what never moves), `Bodies`, `Contacts`, and the `State` that holds them.

Conventions, said once, here:

* SI units; an impulse λ is in N·s. Physics is float64.
* The n circles are bodies 0 … n-1. The box is one static body; its walls are numbered n + 0 (bottom),
  n + 1 (right), n + 2 (top) and n + 3 (left), so that two contacts of one circle in a corner differ. The static
  segments of `World.segments` follow, from n + 4 on.
* A contact joins `body_a` < `body_b`. Its unit normal points from a to b, its tangent is (n_y, -n_x); relative
  velocity is b minus a; a negative separation is penetration. The contact point lies in the middle of the overlap.
  The impulse on b is λ_n n + λ_t t, on a the opposite.
* Contacts are sorted by (body_a, body_b), each pair at most once. The solver sweeps in that order, so the order is
  part of the result.
"""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from deep_contact import constants
from deep_contact.state import notebook
from deep_contact.state.scales import ContactScales, contact_scales
from deep_contact.validation import expect, flag, integer, number

S = TypeVar("S", bound="State")

BOTTOM, RIGHT, TOP, LEFT = range(4)
WALLS = ("bottom", "right", "top", "left")
WALL_NORMALS = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
"""Contact normals of the four walls, from circle to wall."""

LIMITS = {
    "bodies.position": (-1e12, 1e12, "m"),
    "bodies.velocity": (-1e10, 1e10, "m/s"),
    "bodies.spin": (-1e10, 1e10, "rad/s"),
    "bodies.mass": (1e-30, 1e30, "kg"),
    "bodies.radius": (1e-6, 1e11, "m"),
    "contacts.separation": (-1e13, 1e13, "m"),
    "contacts.normal_impulse": (-1e60, 1e60, "N·s"),
    "contacts.tangent_impulse": (-1e60, 1e60, "N·s"),
    "contacts.normal_start": (-1e60, 1e60, "N·s"),
    "contacts.tangent_start": (-1e60, 1e60, "N·s"),
    "world.box": (-1e12, 1e12, "m"),
    "world.segments": (-1e12, 1e12, "m"),
    "world.surface_speeds": (-1e10, 1e10, "m/s"),
    "world.gravity": (-1e6, 1e6, "m/s²"),
    "world.friction": (0.0, 1e12, ""),
    "dt": (1e-9, 1.0, "s"),
    "scales.slop": (0.0, 1e11, "m"),
    "scales.wall_skin": (0.0, 1e11, "m"),
    "scales.max_correction": (0.0, 1e11, "m"),
}
"""Name -> smallest and largest value that the engine computes with, and their unit.

A state may hold any finite number, and files keep it; the engine refuses what is outside (`check_limits`). Within,
nothing overflows, whatever the combination: λ / m <= 1e90 m/s, whose square is a float. A step makes an accepted state
of one: a body leaves it with at most `scales.FASTEST` and π / (2 Δt), and the walls stop it. (Impulses alone may grow,
after a start of 1e50 N·s.) Circles whose radius is below 1e-13 of their distance from the origin sink in.
"""

LARGEST_START = 1e50
"""Largest impulse that a start may hand to the solver, N·s: below what contacts may carry, so that it can be solved."""


def _is_equal(self, other) -> bool:
    return all(map(np.array_equal, self, other)) if isinstance(other, type(self)) else NotImplemented


class Bodies(NamedTuple):
    """n circles (solid discs).

    | field    | meaning                         | shape  | unit  |
    |----------|---------------------------------|--------|-------|
    | position | centre                          | (n, 2) | m     |
    | velocity | of the centre                   | (n, 2) | m/s   |
    | angle    | orientation, counter-clockwise  | (n,)   | rad   |
    | spin     | angular velocity ω              | (n,)   | rad/s |
    | mass     |                                 | (n,)   | kg    |
    | radius   |                                 | (n,)   | m     |
    """

    position: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    spin: np.ndarray
    mass: np.ndarray
    radius: np.ndarray

    __eq__, __ne__, __hash__ = _is_equal, object.__ne__, None  # type: ignore[assignment]

    @property
    def count(self) -> int:
        """Number of circles. (`len` of a NamedTuple is its number of fields.)"""
        return self.mass.shape[0]

    @property
    def inertia(self) -> np.ndarray:
        """Moment of inertia of a solid disc, m r² / 2, shape (n,), kg·m²."""
        # m r² first: half of the smallest mass is 0, and 0 times an infinite r² would be no number.
        return 0.5 * (self.mass * self.radius**2)

    def _repr_html_(self) -> str:
        return notebook.arrays_shown(notebook.counted(self.count, "circle"), self._asdict())


class Contacts(NamedTuple):
    """m contacts, sorted by (body_a, body_b).

    | field           | meaning                                          | shape  | unit |
    |-----------------|--------------------------------------------------|--------|------|
    | body_a          | index of the first circle                        | (m,)   | –    |
    | body_b          | second circle, n + wall, or n + 4 + segment      | (m,)   | –    |
    | position        | contact point, in the middle of the overlap      | (m, 2) | m    |
    | normal          | unit normal from a to b                          | (m, 2) | –    |
    | separation      | gap along the normal, negative is penetration    | (m,)   | m    |
    | normal_impulse  | λ_n, solved (or, unsolved, as the start)         | (m,)   | N·s  |
    | tangent_impulse | λ_t, likewise                                    | (m,)   | N·s  |
    | normal_start    | λ_n that the solver starts from                  | (m,)   | N·s  |
    | tangent_start   | λ_t that the solver starts from                  | (m,)   | N·s  |
    """

    body_a: np.ndarray
    body_b: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    separation: np.ndarray
    normal_impulse: np.ndarray
    tangent_impulse: np.ndarray
    normal_start: np.ndarray
    tangent_start: np.ndarray

    __eq__, __ne__, __hash__ = _is_equal, object.__ne__, None  # type: ignore[assignment]

    @property
    def count(self) -> int:
        """Number of contacts."""
        return self.body_a.shape[0]

    def _repr_html_(self) -> str:
        return notebook.arrays_shown(notebook.counted(self.count, "contact"), self._asdict())


@dataclass(frozen=True, kw_only=True)
class World:
    """What never moves: the box, and the constants that hold for every contact.

    box: (x_min, y_min, x_max, y_max), m. gravity: (g_x, g_y), m/s². friction: Coulomb's μ. restitution: Newton's e,
    felt above (1 − e²) times the scales' threshold; the impulses of contacts are without those of rebounds
    (`physics.impacts`). scales: `ContactScales` that hold whatever the scene; by default None, they follow it
    (`State.scales`), and a circle more or less changes them by what it changes the mean radius.

    segments: any number of ((x, y), (x, y)), m: static lines beside the box, felt from both sides and at their ends,
    with the skin of the walls (edge shapes of Box2D). Those that share an end, to the last bit, are one line there: a
    circle rolls over the joint as over a chain of Box2D. Kept as (x_0, y_0, x_1, y_1) each.

    surface_speeds: of the segments, m/s each, towards their second ends: a belt, or the wall of a drum that turns. The
    segment stays where it is, and friction drags what touches it. () where all surfaces rest.
    """

    box: tuple[float, float, float, float] = (0.0, 0.0, 30.0, 30.0)
    gravity: tuple[float, float] = constants.GRAVITY
    friction: float = constants.FRICTION
    restitution: float = constants.RESTITUTION
    scales: ContactScales | None = None
    segments: Sequence = ()
    surface_speeds: Sequence = ()

    def __post_init__(self):
        box, gravity, segments = _numbers(self.box), _numbers(self.gravity), _checked_segments(self.segments)
        fits = len(box) == 4 and np.isfinite(box).all() and box[0] < box[2] and box[1] < box[3]
        expect(fits, f"box: expected finite (x_min, y_min, x_max, y_max) of positive extent, got {self.box}")
        fits = len(gravity) == 2 and np.isfinite(gravity).all()
        expect(fits, f"gravity: expected two finite numbers, such as (0, -9.81), got {self.gravity}")
        # Past the dataclass, which is frozen.
        vars(self).update(
            box=box, gravity=gravity, segments=segments, scales=_checked_scales(self.scales),
            surface_speeds=_checked_speeds(self.surface_speeds, len(segments)),
            friction=number("friction", self.friction, low=0),
            restitution=number("restitution", self.restitution, low=0, high=1),
        )  # fmt: skip

    @cached_property
    def is_within_limits(self) -> bool:
        """Whether the engine computes with all of it (`LIMITS`)."""
        parts = {"world": self} | ({"scales": self.scales} if self.scales else {})
        named = ((parts.get(name.partition(".")[0]), name) for name in LIMITS)
        return not any(_beyond(part, name)[0].any() for part, name in named if part is not None)


@dataclass(frozen=True, kw_only=True, repr=False)
class State:
    """A moment of a simulation: the bodies before a step, and the contacts found where they are.

    A scene is a state at time 0. `contacts` is None until they have been looked for. `solver` is what the run uses
    (options of `physics.solvers`, or None).
    If `solved`, the contacts hold the impulses which the step from here solved; if not, they hold the impulses
    carried over from the step before, which Builtin starts from. Either way, `dc.step(state)` does the step from
    `normal_start` and `tangent_start`, and a run that is written out and read back goes on bit for bit.

    States are equal if all numbers and settings are. The fields cannot be set; nothing in this package writes into the
    arrays of a state that it is given, or hands out arrays that a later step writes into.
    """

    name: str
    world: World
    bodies: Bodies
    contacts: Contacts | None = None
    time: float = 0.0
    step: int = 0
    dt: float = constants.TIME_STEP
    solver: object = None
    solved: bool = False

    @property
    def scales(self) -> ContactScales:
        """Lengths, speeds and times of the contact model in the steps of this state (`scales.contact_scales`)."""
        world = self.world
        bounces = world.restitution > 0.0
        return contact_scales(self.bodies.radius, world.gravity, self.dt, world.scales, bounces=bounces)

    def replace(self: S, **changes) -> S:
        """A copy with some fields changed."""
        return replace(self, **changes)

    def __repr__(self) -> str:
        return f"State({self.name!r}, {', '.join(self._summary().values())})"

    def _repr_html_(self) -> str:
        """What a notebook shows: numbers, and a picture of circles and impulses."""
        return notebook.shown(f"State {self.name!r}", self._summary().items(), self._picture())

    def _summary(self) -> dict[str, str]:
        contacts = "contacts unknown" if self.contacts is None else notebook.counted(self.contacts.count, "contact")
        summary = {"bodies": notebook.counted(self.bodies.count, "circle"), "contacts": contacts}
        summary |= {"time": f"t = {self.time:g} s", "step": f"step {self.step:,}"}
        return summary | ({"impulses": "solved"} if self.solved else {})

    def _picture(self) -> str:
        (position, *_, radius), contacts, world = self.bodies, self.contacts or no_contacts(), self.world
        ends, between = contacts.position.copy(), contacts.body_b < len(radius)
        ends[between] = position[contacts.body_b[between]]
        lines = np.stack([position[contacts.body_a], ends], axis=1)
        return notebook.picture_of(world.box, position, radius, lines, contacts.normal_impulse, world.segments)


if TYPE_CHECKING:

    class StateWithContacts(State):
        """What a run hands out. For type checkers alone: there, `contacts` is never None."""

        contacts: Contacts

else:
    StateWithContacts = State


def make_bodies(position, *, radius=1.0, velocity=0.0, angle=0.0, spin=0.0, density=1.0, mass=None) -> Bodies:
    """Circles from their centres; everything else is given per circle or once for all.

    position: (n, 2), m. radius: m. velocity: (2,) or (n, 2), m/s. density: kg/m², used where `mass` (kg) is None.
    Raises ValueError naming the field, the body and the value.
    """
    try:
        position = np.array(position, dtype=np.float64, ndmin=2)
    except (ValueError, TypeError):
        raise ValueError(f"position: expected numbers of shape (n, 2), x and y, got {position!r}") from None
    n = position.shape[0]
    radius = _for_each("radius", radius, (n,))
    if mass is None:
        mass = _for_each("density", density, (n,)) * np.pi * radius**2
    angle, spin, mass = (_for_each(*given, (n,)) for given in (("angle", angle), ("spin", spin), ("mass", mass)))
    return check_bodies(Bodies(position, _for_each("velocity", velocity, (n, 2)), angle, spin, mass, radius))


def _for_each(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    """A value for all circles, or one for each, as an array of this shape."""
    try:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), shape)
    except (ValueError, TypeError):
        expected = f"one {'value' if len(shape) == 1 else 'pair'} for all circles, or for each of the {shape[0]}"
        raise ValueError(f"{name}: expected {expected}, got {value!r}") from None


def _numbers(value) -> tuple[float, ...]:
    """What was given as floats; none where it is no numbers."""
    try:
        return tuple(float(v) for v in np.ravel(value))
    except (ValueError, TypeError):
        return ()


def check_bodies(bodies: Bodies) -> Bodies:
    """Own, contiguous float64 copies of all fields, validated.

    Raises ValueError naming the field, the body and the value.
    """
    n = _length("bodies.mass", bodies.mass)
    # The radius first: where a mass was made from it, the radius is at fault.
    names = sorted(Bodies._fields, key=lambda name: name != "radius")
    fields = {name: _checked_array("bodies", name, getattr(bodies, name), n) for name in names}
    for name in ("mass", "radius"):
        _refuse_where(fields[name] <= 0, "bodies", name, fields[name], "a number > 0")
    return Bodies(**fields)


def check_contacts(contacts: Contacts, bodies: Bodies, segments: int = 0) -> Contacts:
    """Own, contiguous copies of all fields in sweep order (by body_a, body_b), validated against the bodies.

    segments: how many the world has. Raises ValueError naming the field, the contact and the value.
    """
    m, n = _length("contacts.body_a", contacts.body_a), bodies.count
    fields = {name: _checked_array("contacts", name, value, m) for name, value in contacts._asdict().items()}
    a, b, end, fixed = fields["body_a"], fields["body_b"], n + 4 + segments, "walls, segments" if segments else "walls"
    # A touching pair may carry no tensile impulse; starts are not judged here, they are hints.
    for name, bad, expected in (
        ("body_a", (a < 0) | (a >= n), f"a circle, 0 to {n - 1}"),
        ("body_b", (b <= a) | (b >= end), f"a body after body_a, up to {end - 1} ({fixed})"),
        ("normal", np.abs(np.hypot(*fields["normal"].T) - 1) > 1e-4, "a unit vector"),
        ("normal_impulse", fields["normal_impulse"] < 0, "a number >= 0"),
    ):
        _refuse_where(bad, "contacts", name, fields[name], expected)
    order = np.lexsort((b, a))
    key = a[order] * end + b[order]
    for i in order[1:][key[1:] == key[:-1]]:
        raise ValueError(f"contacts: the pair (body_a {a[i]}, body_b {b[i]}) appears twice")
    return Contacts(**{name: np.ascontiguousarray(value[order]) for name, value in fields.items()})


def check_state(state: State) -> State:
    """The state with all arrays validated and owned. Raises ValueError naming the field and the value."""
    check_types(state)
    bodies, contacts = check_bodies(state.bodies), state.contacts
    if contacts is not None:
        contacts = check_contacts(contacts, bodies, len(state.world.segments))
    return state.replace(bodies=bodies, contacts=contacts)


def check_types(state) -> State:
    """The state itself, if it, its parts and its settings are of their types. Raises ValueError naming the part."""
    if not isinstance(state, State):
        raise ValueError(f"state: expected a State, of dc.circles_in_box or dc.read_state for instance, got {state!r}")
    for name, kind in (("world", World), ("bodies", Bodies), ("contacts", Contacts)):
        value = getattr(state, name)
        if not (isinstance(value, kind) or (value is None and kind is Contacts)):
            raise ValueError(f"{name}: expected {kind.__name__}, got {type(value).__name__}")
    if not isinstance(state.name, str):
        raise ValueError(f"name: expected a text, got {state.name!r}")
    number("time", state.time)
    number("dt", state.dt, above=0)
    integer("step", state.step)
    flag("solved", state.solved)
    return state


def check_limits(state: State) -> State:
    """The state itself, if all it holds is within `LIMITS`. Raises ValueError naming the quantity, limits and value."""
    for name, (low, high, unit) in LIMITS.items():
        owner = name.rpartition(".")[0]
        part = getattr(state, owner) if owner else state
        bad, values = _beyond(part, name) if part is not None else ((), ())
        for at in np.argwhere(bad)[:1].tolist():
            expected = f"{low:g} to {high:g} {unit}".rstrip()
            raise ValueError(f"{name}{at or ''}: expected {expected}, got {values[tuple(at)]}")
    return state


def _beyond(part, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Which values of a quantity of a part of a state are beyond its limits, and the values."""
    (low, high, _), values = LIMITS[name], np.asarray(getattr(part, name.rpartition(".")[2]))
    return ~((values >= low) & (values <= high)), values


def native(state: State) -> State:
    """The state with all arrays in the byte order of this machine: Numba compiles for no other."""
    for name, part in (("bodies", state.bodies), ("contacts", state.contacts)):
        if part is not None and not all(array.dtype.isnative for array in part):
            arrays = (array.astype(array.dtype.newbyteorder("="), copy=False) for array in part)
            state = state.replace(**{name: type(part)(*arrays)})
    return state


def no_contacts() -> Contacts:
    """Contacts of a state that has none."""
    return Contacts(*(np.zeros(0, np.int64),) * 2, *(np.zeros((0, 2)),) * 2, *(np.zeros(0),) * 5)


def _is_list(value) -> bool:
    return isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, str)


def _checked_segments(segments) -> tuple[tuple[float, ...], ...]:
    if not _is_list(segments):
        raise ValueError(f"segments: expected a list of ((x, y), (x, y)), got {segments!r}")
    checked = tuple(map(_numbers, segments))
    for index, ends in enumerate(checked):
        fits = len(ends) == 4 and np.isfinite(ends).all()
        # The squared length is what the engine divides by.
        if not fits or (ends[2] - ends[0]) ** 2 + (ends[3] - ends[1]) ** 2 == 0.0:
            expected = "two different points, ((x, y), (x, y)), of finite numbers"
            raise ValueError(f"segments[{index}]: expected {expected}, got {segments[index]!r}")
    return checked


def _checked_speeds(speeds, count: int) -> tuple[float, ...]:
    are_numbers = _is_list(speeds) and all(isinstance(v, Real) for v in speeds)
    checked = _numbers(speeds) if are_numbers else ()
    if not are_numbers or len(checked) not in (0, count) or not np.isfinite(checked).all():
        raise ValueError(f"surface_speeds: expected {count} finite numbers, m/s, one a segment, got {speeds!r}")
    return checked if any(checked) else ()


def _checked_scales(scales) -> ContactScales | None:
    if scales is None:
        return None
    is_known = isinstance(scales, ContactScales)
    expect(is_known, f"scales: expected None or ContactScales, such as scales.BOX2D, got {scales!r}")
    # Floats, whatever was given: compiled code is compiled for those.
    limits = {"max_translation": {"above": 0}}
    named = scales._asdict().items()
    return ContactScales(*(number(f"scales.{name}", v, **limits.get(name, {"low": 0})) for name, v in named))


def _length(name: str, values) -> int:
    """Length of a row of numbers."""
    try:
        shape = np.shape(values)
    except ValueError:  # rows of unlike lengths
        shape = ()
    if len(shape) != 1:  # asked first, since NumPy takes milliseconds to print an array
        raise ValueError(f"{name}: expected an array of one dimension, got {reprlib.repr(values)}")
    return shape[0]


def _checked_array(owner: str, name: str, value, count: int) -> np.ndarray:
    """An own array: float64, or int64 of indices."""
    shape = (count, 2) if name in ("position", "velocity", "normal") else (count,)
    if name in ("body_a", "body_b"):
        index = np.asarray(value)
        fits = index.shape == shape and (np.issubdtype(index.dtype, np.integer) or index.size == 0)
        expect(fits, f"{owner}.{name}: expected integers of shape {shape}, got {index.dtype}, {index.shape}")
        return index.astype(np.int64)
    try:
        if np.iscomplexobj(value):
            raise TypeError("complex")  # which NumPy would cut
        array = np.array(value, dtype=np.float64, order="C")
    except (ValueError, TypeError, OverflowError):
        raise ValueError(f"{owner}.{name}: expected numbers of shape {shape}, got {reprlib.repr(value)}") from None
    expect(array.shape == shape, f"{owner}.{name}: expected shape {shape}, got {array.shape}")
    _refuse_where(~np.isfinite(array), owner, name, array, "a finite number")
    return array


def _refuse_where(bad: np.ndarray, owner: str, name: str, values: np.ndarray, expected: str) -> None:
    if bad.any():
        index = int(np.argwhere(bad)[0][0])
        raise ValueError(f"{owner}.{name}[{index}]: expected {expected}, got {values[index]}")
