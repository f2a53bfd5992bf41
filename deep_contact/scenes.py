"""Scenes: states at time 0. Random scenes take a seed or a `numpy.random.Generator`; the same seed gives the same bits.

Circles are placed by multiples of their mean radius, so that all lengths times s give the same scene, s times as large.
"""

from __future__ import annotations

import math
from dataclasses import replace
from numbers import Integral

import numpy as np

from deep_contact.state.constants import WALL_SKIN
from deep_contact.state.fields import make_bodies
from deep_contact.state.scales import mean
from deep_contact.state.state import State
from deep_contact.state.validation import brief, expect, integer, number, real_numbers, suggesting
from deep_contact.state.world import World

_TRIES = 20_000
"""Draws in a row for one circle before the scene is taken to be full."""


@suggesting
def circles_in_box(
    n_bodies: int = 100,
    *,
    size: float | tuple[float, float] = 30.0,
    radius: tuple[float, float] = (1.0, 1.0),
    sigma_coef: float = 1.2,
    density: float = 1.0,
    seed: int | np.random.Generator = 0,
    **world,
) -> State:
    """The thesis's scene (section 3.4.1): circles at rest, drawn normally around the middle of a box, none overlapping.

    size: side of the box, or (width, height), m. radius: smallest and largest, uniform between, m.
    sigma_coef: the standard deviation of the centres is sigma_coef · √(r size / 2) along each axis, m; r is the middle
    of the radii, the thesis's 1 m.
    density: kg/m². world: friction, restitution and gravity of the `World`.
    Raises ValueError if the circles do not fit, saying how many did.
    """
    rng = _generator(seed)
    n = integer("n_bodies", n_bodies, least=1)
    extent = np.broadcast_to(_positive("size", size, [(), (2,)], "finite numbers > 0"), 2)
    low, high = _checked_radius(radius)
    number("sigma_coef", sigma_coef, above=0)
    radii = np.full(n, low) if low == high else rng.uniform(low, high, n)
    skin = WALL_SKIN * mean(radii)
    sigma = sigma_coef * np.sqrt(0.5 * (low + high) * extent / 2)
    centres = np.empty((n, 2))
    for i in range(n):
        margin = radii[i] + skin
        for _ in range(_TRIES):
            centre = rng.normal(extent / 2, sigma)
            if (centre < margin).any() or (centre > extent - margin).any():
                continue
            offset = centres[:i] - centre
            if (np.einsum("ij,ij->i", offset, offset) > (radii[:i] + radii[i]) ** 2).all():
                centres[i] = centre
                break
        else:
            raise ValueError(
                f"n_bodies: expected circles that fit, got {n_bodies}; {i} fitted in a box of "
                f"{extent[0]:g} x {extent[1]:g} m with sigma_coef {sigma_coef:g}; size="
                f"{_roomy_size(radii, sigma_coef):g} has room for all, and dc.lattice_in_box places any number"
            )
    bodies = make_bodies(centres, radius=radii, density=density)
    return State(name=f"circles_{n}", world=World(box=(0, 0, *extent), **world), bodies=bodies)


@suggesting
def lattice_in_box(
    n_bodies: int = 1000,
    *,
    columns: int | None = None,
    radius: tuple[float, float] = (1.0, 1.0),
    gap: float = 0.1,
    density: float = 1.0,
    seed: int | np.random.Generator = 0,
    **world,
) -> State:
    """Circles at rest on a jittered square lattice from the floor up, for scenes too large or dense for chance.

    columns: circles in a row; by default as many as make the lattice square. radius: smallest and largest, m.
    gap: between the largest neighbours, as a share of their diameter; each circle is moved by up to half of it.
    The box is as wide as the lattice and as high, so that nothing overlaps at the start. world: friction, restitution
    and gravity of the `World`.
    """
    rng = _generator(seed)
    n = integer("n_bodies", n_bodies, least=1)
    columns = math.ceil(math.sqrt(n)) if columns is None else integer("columns", columns, least=1)
    low, high = _checked_radius(radius)
    number("gap", gap, above=0)
    radii = np.full(n, low) if low == high else rng.uniform(low, high, n)
    pitch = 2 * high * (1 + gap)
    cell = np.stack([np.arange(n) % columns, np.arange(n) // columns], axis=1)
    jitter = rng.uniform(-0.5, 0.5, (n, 2)) * (pitch - 2 * high)
    skin = WALL_SKIN * mean(radii)
    centres = skin + (cell + 0.5) * pitch + jitter
    box = (0, 0, 2 * skin + columns * pitch, 2 * skin + math.ceil(n / columns) * pitch)
    bodies = make_bodies(centres, radius=radii, density=density)
    return State(name=f"lattice_{n}", world=World(box=box, **world), bodies=bodies)


@suggesting
def column(n_bodies: int = 10, *, radius: float = 1.0, width: float = 30.0, density: float = 1.0, **world) -> State:
    """Circles exactly above one another in the middle of the box, just touching.

    radius: m. width: of the box, m; a silo that leaves no play has 2.02 radii. density: kg/m².
    world: friction, restitution and gravity of the `World`.
    """
    n = integer("n_bodies", n_bodies, least=1)
    _checked_radius((radius, radius))
    if not (np.isfinite(width) and width >= 2 * radius):
        raise ValueError(f"width: expected a finite number >= the diameter {2 * radius}, got {width}")
    centres = np.stack([np.full(n, width / 2), WALL_SKIN * radius + radius * (1 + 2 * np.arange(n))], axis=1)
    bodies = make_bodies(centres, radius=radius, density=density)
    return State(name=f"column_{n}", world=World(box=(0, 0, width, 2 * radius * (n + 1)), **world), bodies=bodies)


@suggesting
def hopper(
    n_bodies: int = 400,
    *,
    opening: float = 8.0,
    steepness: float = 60.0,
    radius: tuple[float, float] = (0.8, 1.0),
    **options,
) -> State:
    """Circles on a jittered lattice above a funnel with a hole in the middle, through which they fall onto the floor.

    opening: width of the hole in largest radii; below about 8 arches of circles may block it. steepness: angle of the
    two sides over the floor, degrees. radius, options: those of `lattice_in_box`.
    """
    _, high = _checked_radius(radius)
    number("opening", opening, above=0)
    angle = math.radians(number("steepness", steepness, low=5, high=85))
    heap = lattice_in_box(n_bodies, radius=radius, **options)
    _, _, width, height = heap.world.box
    width = max(width, (opening + 4.0) * high)
    hole = 0.5 * opening * high
    # There is space below for circles that fall through: the heap of all circles is lower than the lattice.
    foot, drop = height, math.tan(angle) * (0.5 * width - hole)
    ends = [(0.0, foot + drop), (0.5 * width - hole, foot), (0.5 * width + hole, foot), (width, foot + drop)]
    shift = (0.5 * (width - heap.world.box[2]), foot + drop + high)
    world = replace(heap.world, box=(0, 0, width, shift[1] + height), segments=[(ends[0], ends[1]), (ends[2], ends[3])])
    bodies = heap.bodies._replace(position=heap.bodies.position + shift)
    return State(name=f"hopper_{n_bodies}", world=world, bodies=bodies)


@suggesting
def terrain(n_bodies: int = 300, *, bumps: int = 24, seed: int | np.random.Generator = 0, **options) -> State:
    """Circles on a jittered lattice above a line of slopes and valleys from wall to wall.

    bumps: number of segments of the line. The heights of their joints are random, from 0 to the width of a segment.
    options: those of `lattice_in_box`.
    """
    rng = _generator(seed)
    heap = lattice_in_box(n_bodies, seed=rng, **options)
    _, _, width, height = heap.world.box
    x = np.linspace(0.0, width, integer("bumps", bumps, least=1) + 1)
    y = rng.uniform(0.0, x[1], x.size)
    line = np.column_stack([x, y + heap.bodies.radius.max()])
    lift = line[:, 1].max()
    bodies = heap.bodies._replace(position=heap.bodies.position + np.array([0.0, lift]))
    segments = np.stack([line[:-1], line[1:]], axis=1)
    world = replace(heap.world, box=(0, 0, width, height + lift), segments=segments)
    return State(name=f"terrain_{n_bodies}", world=world, bodies=bodies)


@suggesting
def drum(n_bodies: int = 300, *, froude: float = 0.05, filling: float = 0.4, sides: int = 60, **options) -> State:
    """Circles in a drum that turns counter-clockwise: a regular polygon of segments whose surface moves.

    froude: ω² R / g, with the drum's radius R: at 1e-3 avalanches follow one another, from 1e-2 to 1e-1 the surface
    flows, beyond 1 circles stick to the wall. filling: share of the drum's area that a dense packing of the circles
    takes, up to 0.45; less for mixed radii, since their lattice, which falls from the middle, takes more space. sides:
    number of sides of the polygon. options: those of `lattice_in_box`. Raises ValueError for a drum that turns without
    gravity.
    """
    number("froude", froude, low=0)
    number("filling", filling, low=0.01, high=0.45)
    sides = integer("sides", sides, least=8)
    heap = lattice_in_box(n_bodies, **options)
    gravity = math.hypot(*heap.world.gravity)
    expect(froude == 0 or gravity > 0, f"froude: expected 0 without gravity, which it is measured by, got {froude}")
    half = 0.5 * math.hypot(*heap.world.box[2:])  # so that the corners of the lattice lie within
    area = 2.0 * math.sqrt(3.0) * float((heap.bodies.radius**2).sum())
    outer = max(math.sqrt(area / (math.pi * filling)), half / math.cos(math.pi / sides))
    # The box stands clear of the drum: a circle that also touched a wall of the box would be slowed down.
    middle = outer + float(heap.bodies.radius.max())
    corner = 2.0 * math.pi * np.arange(sides + 1) / sides
    line = middle + outer * np.stack([np.cos(corner), np.sin(corner)], axis=1)
    line[-1] = line[0]  # to the last bit, since two segments share this end
    world = replace(
        heap.world,
        box=(0, 0, 2 * middle, 2 * middle),
        segments=np.stack([line[:-1], line[1:]], axis=1),
        surface_speeds=(math.sqrt(froude * gravity * outer),) * sides,
    )
    bodies = heap.bodies._replace(position=heap.bodies.position + middle - 0.5 * np.array(heap.world.box[2:]))
    return State(name=f"drum_{n_bodies}", world=world, bodies=bodies)


@suggesting
def barrel(rows: int = 150, *, columns: int = 26, seed: int | np.random.Generator = 0, **options) -> State:
    """Columns of circles side by side, with a free space of 18 radii on either side, into which they collapse.

    The scene is that of the benchmark "barrel" of Box2D v3. options: those of `lattice_in_box`.
    """
    columns = integer("columns", columns, least=1)
    heap = lattice_in_box(integer("rows", rows, least=1) * columns, columns=columns, seed=seed, **options)
    _, _, width, height = heap.world.box
    room = 18.0 * float(heap.bodies.radius.max())
    world = replace(heap.world, box=(-room, 0, width + room, height))
    return heap.replace(name=f"barrel_{rows}_{columns}", world=world)


@suggesting
def two_bodies(*, speed: float = 2.0, radius: tuple[float, float] = (1.0, 1.0), density: float = 1.0, **world) -> State:
    """Two circles that touch and run into each other without gravity, each at half the closing `speed`, m/s.

    radius: of the first (left) and of the second, m. world: friction and restitution of the `World`.
    """
    first, second = (float(r) for r in radius)
    centres = 15.0 + np.array([[0.0, 0.0], [first + second, 0.0]])
    bodies = make_bodies(centres, radius=[first, second], velocity=[[speed / 2, 0], [-speed / 2, 0]], density=density)
    return State(name="two_bodies", world=World(gravity=(0, 0), **world), bodies=bodies)


@suggesting
def single_body(*, height: float = 0.0, radius: float = 1.0, density: float = 1.0, **world) -> State:
    """One circle in the middle of the thesis's box, `height` m above the floor. `world`: fields of `World`."""
    bodies = make_bodies([[15.0, WALL_SKIN * radius + radius + height]], radius=radius, density=density)
    return State(name="single_body", world=World(**world), bodies=bodies)


@suggesting
def drifting_circles(
    n_bodies: int = 100, *, speed: float = 2.0, seed: int | np.random.Generator = 0, **options
) -> State:
    """The thesis's scene without gravity: every circle starts with a normally drawn velocity.

    speed: standard deviation of each velocity component, m/s. options: those of `circles_in_box`.
    """
    rng = _generator(seed)
    number("speed", speed, low=0)
    scene = circles_in_box(n_bodies, **({"gravity": (0.0, 0.0)} | options), seed=rng)
    velocity = rng.normal(0.0, speed, (n_bodies, 2))
    return scene.replace(name=f"drifting_{n_bodies}", bodies=scene.bodies._replace(velocity=velocity))


def _generator(seed) -> np.random.Generator:
    # NumPy also accepts sequences, and ends the process on a matrix.
    if isinstance(seed, np.random.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise ValueError(f"seed: expected an integer >= 0 or a numpy.random.Generator, got {seed!r}")
    return np.random.default_rng(seed)


def _positive(name: str, values, shapes, expected: str) -> np.ndarray:
    """The values as float64. Raises ValueError unless they are finite numbers > 0 of one of these shapes."""
    array = real_numbers(values)
    if array is None or array.shape not in shapes or not (np.isfinite(array) & (array > 0)).all():
        raise ValueError(f"{name}: expected {expected}, got {brief(values)}")
    return array


def _checked_radius(radius) -> tuple[float, float]:
    expected = "finite 0 < smallest <= largest, such as (1.0, 1.0)"
    low, high = _positive("radius", radius, [(2,)], expected).tolist()
    expect(low <= high, f"radius: expected {expected}, got {radius!r}")
    return low, high


def _roomy_size(radii: np.ndarray, sigma_coef: float) -> float:
    """Side of a box, m, in which `circles_in_box` finds places for circles of these radii.

    The circles cover at most a quarter of the box, and the sum of their squared radii is at most six times the variance
    of the centres: from 6.3 times on, random centres for all circles are not always found.
    """
    length = mean(radii)
    squares = float(((radii / length) ** 2).sum())
    return length * math.ceil(max(2.0 * math.sqrt(math.pi * squares), squares / (3.0 * sigma_coef**2)))
