"""Functions that make scenes: states at time 0. Random scenes take a seed or a `numpy.random.Generator`.

Equal seeds give scenes that are equal to the last bit. Gaps and skins are multiples of the mean radius: if all lengths
are multiplied by s, the scene is the same, s times as large.
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
"""Largest number of random positions that are tried for one circle. If none of them is free, the box counts as full."""


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
    """Make the thesis's scene (section 3.4.1): circles at rest, normally distributed around the middle of a box.

    No circles overlap.

    size: side of the box, or (width, height), m. radius: smallest and largest radius, m; radii are uniformly
    distributed between the two. sigma_coef: factor of the standard deviation of the centres along each axis, which is
    sigma_coef · √(r size / 2), m; r is the middle of the two radii, 1 m in the thesis. density: mass per area, kg/m².
    world: friction, restitution and gravity of the `World`. Raises ValueError if the circles do not fit; the message
    says how many did.
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
    """Make circles at rest on a jittered square lattice that begins at the floor.

    Use it for scenes with too many or too densely packed circles for the random places of `circles_in_box`. The box is
    as wide and as high as the lattice, and no circles overlap.

    columns: number of circles in a row; by default the lattice is as wide as it is high. radius: smallest and largest
    radius, m. gap: gap between two neighbours of the largest radius, as a share of their diameter. Along each axis,
    every circle is moved at random by up to half of this gap. world: friction, restitution and gravity of the `World`.
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
    """Make a column of circles at rest, exactly above one another in the middle of a box. Neighbours just touch.

    radius: radius of all circles, m. width: width of the box, m; with 2.02 radii the circles exactly fit between the
    walls. density: mass per area, kg/m². world: friction, restitution and gravity of the `World`.
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
    """Make circles at rest above a funnel. They fall through the hole in its middle onto the floor.

    The circles lie on a jittered lattice. opening: width of the hole, in largest radii; below about 8, arches of
    circles may block the hole. steepness: angle between each side of the funnel and the floor, degrees. radius,
    options: arguments of `lattice_in_box`.
    """
    _, high = _checked_radius(radius)
    number("opening", opening, above=0)
    angle = math.radians(number("steepness", steepness, low=5, high=85))
    heap = lattice_in_box(n_bodies, radius=radius, **options)
    _, _, width, height = heap.world.box
    width = max(width, (opening + 4.0) * high)
    hole = 0.5 * opening * high
    # The hole is as high above the floor as the lattice is high, so that all circles fit below it.
    foot, drop = height, math.tan(angle) * (0.5 * width - hole)
    ends = [(0.0, foot + drop), (0.5 * width - hole, foot), (0.5 * width + hole, foot), (width, foot + drop)]
    shift = (0.5 * (width - heap.world.box[2]), foot + drop + high)
    world = replace(heap.world, box=(0, 0, width, shift[1] + height), segments=[(ends[0], ends[1]), (ends[2], ends[3])])
    bodies = heap.bodies._replace(position=heap.bodies.position + shift)
    return State(name=f"hopper_{n_bodies}", world=world, bodies=bodies)


@suggesting
def terrain(n_bodies: int = 300, *, bumps: int = 24, seed: int | np.random.Generator = 0, **options) -> State:
    """Make circles at rest above rough ground: a line of segments from wall to wall, with slopes and valleys.

    The circles lie on a jittered lattice. bumps: number of segments. The heights of their ends are random, between 0
    and the width of a segment. options: arguments of `lattice_in_box`.
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
    """Make circles in a drum that rotates counter-clockwise.

    The drum is a regular polygon of segments. They stay in place, and their surfaces move.

    froude: Froude number ω² R / g, with the angular velocity ω and the radius R of the drum. At 1e-3 avalanches follow
    one another; from 1e-2 to 1e-1 the surface of the heap flows; above 1 circles stick to the drum. filling: share of
    the drum's area that the circles take in the densest packing, at most 0.45. The drum is larger, and the share
    smaller, if the lattice from which the circles fall does not fit otherwise, as with mixed radii. sides: number of
    sides of the polygon. options: arguments of `lattice_in_box`. Raises ValueError if froude > 0 without gravity.
    """
    number("froude", froude, low=0)
    number("filling", filling, low=0.01, high=0.45)
    sides = integer("sides", sides, least=8)
    heap = lattice_in_box(n_bodies, **options)
    gravity = math.hypot(*heap.world.gravity)
    expect(froude == 0 or gravity > 0, f"froude: expected 0 without gravity, which it is measured by, got {froude}")
    half = 0.5 * math.hypot(*heap.world.box[2:])  # half the diagonal of the lattice, whose corners lie in the drum
    area = 2.0 * math.sqrt(3.0) * float((heap.bodies.radius**2).sum())
    outer = max(math.sqrt(area / (math.pi * filling)), half / math.cos(math.pi / sides))
    # The box is larger than the drum. A circle in the drum that also touched a wall of the box would be slowed down.
    middle = outer + float(heap.bodies.radius.max())
    corner = 2.0 * math.pi * np.arange(sides + 1) / sides
    line = middle + outer * np.stack([np.cos(corner), np.sin(corner)], axis=1)
    line[-1] = line[0]  # bit for bit, since two segments share this point
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
    """Make columns of circles side by side. They collapse into the free space on either side, 18 radii wide.

    This is the scene of the benchmark "barrel" of Box2D v3. options: arguments of `lattice_in_box`.
    """
    columns = integer("columns", columns, least=1)
    heap = lattice_in_box(integer("rows", rows, least=1) * columns, columns=columns, seed=seed, **options)
    _, _, width, height = heap.world.box
    room = 18.0 * float(heap.bodies.radius.max())
    world = replace(heap.world, box=(-room, 0, width + room, height))
    return heap.replace(name=f"barrel_{rows}_{columns}", world=world)


@suggesting
def two_bodies(*, speed: float = 2.0, radius: tuple[float, float] = (1.0, 1.0), density: float = 1.0, **world) -> State:
    """Make two circles that touch and move towards each other without gravity, each at half of `speed`.

    speed: closing speed, m/s. radius: radii of the left and of the right circle, m. world: friction and restitution of
    the `World`.
    """
    first, second = (float(r) for r in radius)
    centres = 15.0 + np.array([[0.0, 0.0], [first + second, 0.0]])
    bodies = make_bodies(centres, radius=[first, second], velocity=[[speed / 2, 0], [-speed / 2, 0]], density=density)
    return State(name="two_bodies", world=World(gravity=(0, 0), **world), bodies=bodies)


@suggesting
def single_body(*, height: float = 0.0, radius: float = 1.0, density: float = 1.0, **world) -> State:
    """Make one circle above the middle of the floor of the thesis's box.

    height: distance between the circle and the skin of the floor, m. world: fields of the `World`.
    """
    bodies = make_bodies([[15.0, WALL_SKIN * radius + radius + height]], radius=radius, density=density)
    return State(name="single_body", world=World(**world), bodies=bodies)


@suggesting
def drifting_circles(
    n_bodies: int = 100, *, speed: float = 2.0, seed: int | np.random.Generator = 0, **options
) -> State:
    """Make the thesis's scene without gravity. Every circle starts with a random velocity.

    speed: standard deviation of each velocity component, which is normally distributed, m/s. options: arguments of
    `circles_in_box`.
    """
    rng = _generator(seed)
    number("speed", speed, low=0)
    scene = circles_in_box(n_bodies, **({"gravity": (0.0, 0.0)} | options), seed=rng)
    velocity = rng.normal(0.0, speed, (n_bodies, 2))
    return scene.replace(name=f"drifting_{n_bodies}", bodies=scene.bodies._replace(velocity=velocity))


def _generator(seed) -> np.random.Generator:
    # Checked here: NumPy also accepts sequences, and ends the process on a matrix.
    if isinstance(seed, np.random.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise ValueError(f"seed: expected an integer >= 0 or a numpy.random.Generator, got {seed!r}")
    return np.random.default_rng(seed)


def _positive(name: str, values, shapes, expected: str) -> np.ndarray:
    """Return the values as float64. Raises ValueError unless they are finite, > 0, and of one of these shapes."""
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
    """Return the side of a box, m, in which `circles_in_box` finds places for circles of these radii, (n,), m.

    In this box the circles cover at most a quarter of the area, and the sum of their squared radii is at most six times
    the variance of the centres along an axis. At 6.3 times the variance, random places for all circles are not always
    found.
    """
    length = mean(radii)
    squares = float(((radii / length) ** 2).sum())
    return length * math.ceil(max(2.0 * math.sqrt(math.pi * squares), squares / (3.0 * sigma_coef**2)))
