"""Validation of the fields of a state: bodies, contacts, the world, pushes and indices.

Tests: tests/state/test_checks.py, tests/state/test_state.py
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from deep_contact.state.arrays import LIMITS, SIDES, Bodies, Contacts
from deep_contact.state.materials import (
    MOST_MATERIALS,
    checked_materials,
    checked_table,
    checked_touches,
    expect_in_tables,
    table_size,
)
from deep_contact.state.scales import ContactScales
from deep_contact.state.validation import (
    array_of,
    brief,
    expect,
    floats,
    number,
    one_of,
    real_numbers,
    refuse_where,
    several,
    suggesting,
    warn,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from deep_contact.state.state import State
    from deep_contact.state.world import World

UNIT = 1e-4
"""Largest difference between 1 and the length of a vector that counts as a unit vector."""


@suggesting
def make_bodies(
    position: ArrayLike,
    *,
    radius: ArrayLike = 1.0,
    velocity: ArrayLike = 0.0,
    angle: ArrayLike = 0.0,
    spin: ArrayLike = 0.0,
    density: ArrayLike = 1.0,
    mass: ArrayLike | None = None,
    fixed: ArrayLike = False,
    material: ArrayLike = 0,
) -> Bodies:
    """Make circles from their centres. Every other argument is one value for all circles, or one value for each circle.

    position: centres, (n, 2), m. radius: radii, m; by default 1 m. velocity: velocities of the centres, (2,) or (n, 2),
    m/s. angle: orientations, rad, counter-clockwise. spin: angular velocities, rad/s, counter-clockwise. density: mass
    per area, kg/m², used if `mass` is None. mass: masses, kg. fixed: whether no force or contact changes the motion of
    a circle; a fixed circle has an infinite mass (`Bodies`), whatever `mass` and `density` are. material: index in the
    tables of the world, an integer from 0 on (`World`). Raises ValueError naming the field, the body and the value.
    """
    places = real_numbers(position)
    if places is None or np.atleast_2d(places).shape[1:] != (2,):
        raise ValueError(f"position: expected numbers of shape (n, 2), x and y, got {brief(position)}")
    position = np.atleast_2d(places)
    n = position.shape[0]
    radius = _for_each("radius", radius, (n,))
    refuse_where(radius <= 0, "bodies.radius", radius, "a number > 0")  # before a mass is computed from it
    if mass is None:
        density = _for_each("density", density, (n,))
        refuse_where(~(density > 0), "density", density, "a number > 0")
        mass = density * np.pi * radius**2
    velocity = _for_each("velocity", velocity, (n, 2))
    angle, spin, mass = (_for_each(*one, (n,)) for one in (("angle", angle), ("spin", spin), ("mass", mass)))
    flags, kinds = array_of(fixed), array_of(material)
    of = f"for all circles, or for each of the {n}"
    if flags.dtype != bool or flags.shape not in ((), (n,)):  # not by `expect`, as in `_length`
        raise ValueError(f"fixed: expected True or False {of}, got {brief(fixed)}")
    if not np.issubdtype(kinds.dtype, np.integer) or kinds.shape not in ((), (n,)):
        raise ValueError(f"material: expected an integer from 0 on {of}, got {brief(material)}")
    mass = np.where(flags, np.inf, mass)
    return check_bodies(Bodies(position, velocity, angle, spin, mass, radius, np.broadcast_to(kinds, (n,))))


def _for_each(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    """Return one value for all circles, or a value for each circle, as an array of this shape.

    shape: (n,) or (n, 2). Raises ValueError for values that are not numbers, and for values of another shape.
    """
    with suppress(ValueError):
        if (numbers := real_numbers(value)) is not None:
            return np.broadcast_to(numbers, shape)
    expected = f"one {'value' if len(shape) == 1 else 'pair'} for all circles, or for each of the {shape[0]}"
    raise ValueError(f"{name}: expected {expected}, got {brief(value)}")


def checked_world(world: World) -> dict:
    """Return the validated fields of a world by name, in the form in which `World` stores them.

    Raises ValueError naming the field and the value.
    """
    segments = _checked_segments(world.segments)
    box = several("box", world.box, 4, expected="finite numbers, (x_min, y_min, x_max, y_max)")
    fits = box[0] < box[2] and box[1] < box[3]
    expect(fits, f"box: expected (x_min, y_min, x_max, y_max) of positive extent, got {world.box}")
    of_pairs = {
        "friction": checked_table("friction", world.friction),
        "restitution": checked_table("restitution", world.restitution, high=1),
        "rolling_friction": checked_table("rolling_friction", world.rolling_friction),
        "touches": checked_touches(world.touches),
    }
    materials = {
        "wall_materials": checked_materials("wall_materials", world.wall_materials, 4, of=", ".join(SIDES)),
        "segment_materials": _checked_segment_materials(world.segment_materials, len(segments)),
    }
    for name, values in materials.items():
        expect_in_tables(name, values, table_size(of_pairs))
    return {
        "box": box, "segments": segments, "scales": _checked_scales(world.scales),
        "gravity": several("gravity", world.gravity, 2, expected="finite numbers, such as (0, -9.81)"),
        "surface_speeds": _checked_speeds(world.surface_speeds, len(segments)),
        "segment_velocities": checked_velocities(world.segment_velocities, len(segments)),
        **of_pairs, **materials,
    }  # fmt: skip


def check_bodies(bodies: Bodies) -> Bodies:
    """Return the bodies with validated, contiguous float64 copies of all arrays.

    Raises ValueError naming the field, the body and the value.
    """
    if not isinstance(bodies, Bodies):  # not by `expect`: formatting its message would take longer than the checks
        raise ValueError(f"bodies: expected Bodies, as dc.make_bodies makes them, got {brief(bodies)}")
    if _are_plain(bodies):
        return Bodies(*map(np.copy, bodies))
    n = _length("bodies.mass", bodies.mass)
    # The radius is checked first: if a bad mass was computed from a bad radius, the message names the radius.
    names = sorted(Bodies._fields, key=lambda name: name != "radius")
    if bodies.material is None:
        bodies = bodies._replace(material=np.zeros(n, np.int64))
    fields = {name: _checked_array("bodies", name, getattr(bodies, name), n) for name in names}
    for name in ("mass", "radius"):
        refuse_where(fields[name] <= 0, f"bodies.{name}", fields[name], "a number > 0")
    material = fields["material"]
    expected = f"an integer from 0 to {MOST_MATERIALS - 1}"
    refuse_where((material < 0) | (material >= MOST_MATERIALS), "bodies.material", material, expected)
    return Bodies(**fields)


def _are_plain(bodies: Bodies) -> bool:
    """Return whether all arrays are contiguous, and have the right types, the right shapes and valid values.

    This one fast test accepts most bodies, which then need no further check.
    """
    n = getattr(bodies.mass, "size", -1)
    shapes = (n, 2), (n, 2), (n,), (n,), (n,), (n,), (n,)
    for array, shape, kind in zip(bodies, shapes, (*[np.float64] * 6, np.int64)):
        if type(array) is not np.ndarray or array.dtype != kind or array.shape != shape or not array.flags.carray:
            return False
    mass, radius, material = bodies.mass, bodies.radius, bodies.material
    finite = np.isfinite(np.concatenate([array.ravel() for array in (*bodies[:4], radius)])).all()
    is_known = ((material >= 0) & (material < MOST_MATERIALS)).all()
    return bool(finite and is_known and (radius > 0).all() and (mass > 0).all())


def check_contacts(contacts: Contacts, bodies: Bodies, segments: int = 0) -> Contacts:
    """Return the contacts sorted by (body_a, body_b), with validated, contiguous copies of all arrays.

    bodies: the circles to which the contacts refer. segments: number of segments of the world. Raises ValueError naming
    the field, the contact and the value.
    """
    m, n = _length("contacts.body_a", contacts.body_a), bodies.count
    fields = {name: _checked_array("contacts", name, value, m) for name, value in contacts._asdict().items()}
    a, b, end = fields["body_a"], fields["body_b"], n + 4 + segments
    for name, bad, expected in contact_faults(fields, n, segments):
        refuse_where(bad, f"contacts.{name}", fields[name], expected)
    order = np.lexsort((b, a))
    key = a[order] * end + b[order]
    for i in order[1:][key[1:] == key[:-1]]:
        raise ValueError(f"contacts: the pair (body_a {a[i]}, body_b {b[i]}) appears twice")
    return Contacts(**{name: np.ascontiguousarray(value[order]) for name, value in fields.items()})


def contact_faults(fields: Mapping, n: int, segments: int) -> Iterator[tuple[str, np.ndarray, str]]:
    """Yield, for each field of contacts with a rule, its name, flags of the contacts that break the rule, and the rule.

    The flags are (m,); the rule is in words. λ_n < 0, which would be tensile, breaks a rule. Starting impulses have no
    rule, since the solver only begins from them. fields: arrays of `Contacts` by name, (m, …) each. n: number of
    circles. segments: number of segments of the world.
    """
    a, b, end, fixed = fields["body_a"], fields["body_b"], n + 4 + segments, "walls, segments" if segments else "walls"
    yield "body_a", (a < 0) | (a >= n), f"a circle, 0 to {n - 1}"
    yield "body_b", (b <= a) | (b >= end), f"a body after body_a, up to {end - 1} ({fixed})"
    yield "normal", ~is_unit(fields["normal"]), "a unit vector"
    yield "normal_impulse", fields["normal_impulse"] < 0, "a number >= 0"


def check_kept_contacts(before: State, after: State) -> None:
    """Raise ValueError if the contacts of a state would refer to other bodies in a changed state.

    before: state with the contacts. after: state with the same contacts, but other circles or another world.
    """
    hint = "; contacts=None lets them be found, `State.with_bodies` keeps the impulses"
    n, contacts = before.bodies.count, before.contacts
    mass = after.bodies.mass if isinstance(after.bodies, Bodies) else before.bodies.mass
    circles = len(mass) if isinstance(mass, (list, tuple)) else np.size(mass)  # `np.size` fails on ragged lists
    if circles != n and contacts.count:
        raise ValueError(f"bodies: expected {n} circles, as the contacts have, got {circles}{hint}")
    old, new = (getattr(state.world, "segments", ()) for state in (before, after))
    for k in np.unique(contacts.body_b[contacts.body_b >= n + 4]) - (n + 4) if len(old) != len(new) else ():
        expected = f"segments[{k}]: expected {old[k]}, which has contacts"
        expect(tuple(new[k : k + 1]) == (old[k],), f"{expected}, got another{hint.partition(',')[0]}")


def warn_of_jumps(before: World, after: World) -> bool:
    """Warn if a segment has another position in `after` than in `before`, and does not move in `after`.

    Returns whether there is such a segment. Worlds with different numbers of segments are not compared.
    """
    count = len(after.segments) if len(before.segments) == len(after.segments) else 0  # unequal numbers: no comparison
    for k in range(count):
        is_still = not after.segment_velocities or not any(after.segment_velocities[k])
        if before.segments[k] != after.segments[k] and is_still:
            warn("segments: a segment that is put elsewhere jumps, and pushes nothing; segment_velocities move it")
            return True
    return False


def checked_push(push, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the external forces, (n, 2), N, and torques, (n,), N·m, of a push as float64 arrays.

    push: array of forces, or a tuple (forces, torques); without torques these are 0. count: number of circles, n.
    Raises ValueError naming what was expected and the value.
    """
    both = push if isinstance(push, tuple) and len(push) == 2 else (push, np.zeros(count))
    arrays = [real_numbers(values) for values in both]
    shapes = [getattr(values, "shape", None) for values in arrays]
    if shapes != [(count, 2), (count,)] or not all(np.isfinite(values).all() for values in arrays):
        expected = f"forces ({count}, 2), N, or a tuple of them and torques ({count},), N·m, of finite numbers"
        raise ValueError(f"push: expected {expected}, got {brief(push)}")
    return tuple(np.array(values, np.float64) for values in arrays)


def checked_indices(name: str, which, count: int) -> np.ndarray:
    """Return distinct indices from 0 to `count` − 1.

    which: one index, several indices, or `count` flags. Raises ValueError if an index occurs twice or is out of range.
    """
    chosen = array_of(which)
    if chosen.dtype == bool and chosen.shape == (count,):
        chosen = np.flatnonzero(chosen)
    chosen = np.atleast_1d(chosen) if chosen.size else np.zeros(0, np.int64)
    fits = chosen.ndim == 1 and np.issubdtype(chosen.dtype, np.integer)
    fits = fits and ((chosen >= 0) & (chosen < count)).all() and len(np.unique(chosen)) == len(chosen)
    expected = f"different numbers, 0 to {count - 1}, or {count} flags" if count else "none, since there are none"
    expect(fits, f"{name}: expected {expected}, got {brief(which)}")
    return chosen


def checked_part(part: str, index, circles: int, segments: int) -> tuple[bool, np.ndarray]:
    """Return (whether a part of the scene consists of circles, indices of the bodies of this part).

    Circles have the indices of the circles. The four sides are 0 to 3, in the order of `SIDES`, and segment s is 4 + s,
    as the rows of `StepLog.loads`. part: one of `SIDES`, "wall", "segment" or "circle". index: one index, several
    indices or flags; None if `part` is one of `SIDES`. circles: number of circles. segments: number of segments. Raises
    ValueError on an unknown part or index.
    """
    if part in SIDES:
        expect(index is None, f"index: expected none of the {part}, got {brief(index)}")
        return False, np.array([SIDES.index(part)])
    count = {"wall": 4, "segment": segments, "circle": circles}
    chosen = checked_indices("index", index, count[one_of("part", part, (*SIDES, "segment", "circle", "wall"))])
    return part == "circle", chosen + (4 if part == "segment" else 0)


def checked_fixed(bodies: Bodies, velocities, spins) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities, (k, 2), m/s, and spins, (k,), rad/s, of the k fixed circles.

    velocities: one pair for all fixed circles, or a pair for each; None takes their present velocities. spins: one
    number or k numbers; None takes their present spins. Raises ValueError naming what was expected and the value.
    """
    fixed, found = bodies.is_fixed, []
    k = int(fixed.sum())
    for name, value, present in (
        ("fixed_velocities", velocities, bodies.velocity), ("fixed_spins", spins, bodies.spin)
    ):  # fmt: skip
        kept = present[fixed]
        if value is not None:
            what, unit = ("pair", "m/s") if kept.ndim == 2 else ("number", "rad/s")
            expected = f"a finite {what}, {unit}, for all fixed circles, or one for each of the {k}"
            expected = expected if k else "None, since no circle is fixed"
            numbers = real_numbers(value)
            fits = k > 0 and numbers is not None and numbers.shape in (kept.shape[1:], kept.shape)
            expect(fits and np.isfinite(numbers).all(), f"{name}: expected {expected}, got {brief(value)}")
            kept = np.broadcast_to(numbers, kept.shape)
        found.append(kept)
    return tuple(found)


def is_unit(normal: np.ndarray) -> np.ndarray:
    """Return whether each vector of `normal`, (m, 2), has the length 1 to within `UNIT`, (m,), bool."""
    with np.errstate(over="ignore"):
        return np.abs(np.hypot(*normal.T) - 1) <= UNIT


def beyond_limits(**parts) -> Iterator[str]:
    """Yield a message for each quantity outside of `LIMITS`, with its name, its value and its limits.

    If the quantity is an array, the message has the index of the first such value. parts: fields of a state by name,
    such as `bodies` and `dt`. Quantities of fields that are missing or None are skipped.
    """
    for name, (low, high, unit) in LIMITS.items():
        owner, _, field = name.partition(".")
        if (part := parts.get(owner)) is not None:
            values = np.asarray(getattr(part, field) if field else part)
            if name == "bodies.mass":
                values = np.where(np.isposinf(values), high, values)  # fixed circles are within the limits
            for at in np.argwhere(~((values >= low) & (values <= high)))[:1].tolist():
                expected = f"{low:g} to {high:g} {unit}".rstrip()
                yield f"{name}{at or ''}: expected {expected}, got {values[tuple(at)]}"


def _checked_segments(segments) -> tuple[tuple[float, ...], ...]:
    def numbers(ends) -> tuple[float, ...]:
        array = real_numbers(ends)
        return () if array is None else tuple(array.ravel().tolist())

    if not isinstance(segments, (Sequence, np.ndarray)) or isinstance(segments, str):
        raise ValueError(f"segments: expected a list of ((x, y), (x, y)), got {brief(segments)}")
    checked = tuple(map(numbers, segments))
    for index, ends in enumerate(checked):
        fits = len(ends) == 4 and np.isfinite(ends).all()
        along = (ends[2] - ends[0], ends[3] - ends[1]) if fits else (0.0, 0.0)
        # The engine divides by the squared length. If that is infinite, `LIMITS` refuse the segment later.
        if along[0] * along[0] + along[1] * along[1] == 0.0:
            expected = "two different points, ((x, y), (x, y)), of finite numbers"
            raise ValueError(f"segments[{index}]: expected {expected}, got {brief(segments[index])}")
    return checked


def _checked_speeds(speeds, count: int) -> tuple[float, ...]:
    count = 0 if np.array_equal(speeds, []) else count
    checked = several("surface_speeds", speeds, count, expected="finite numbers, m/s, one a segment")
    return checked if any(checked) else ()


def _checked_segment_materials(materials, count: int) -> tuple[int, ...]:
    count = 0 if np.array_equal(materials, []) else count
    checked = checked_materials("segment_materials", materials, count, of="one a segment")
    return checked if any(checked) else ()


def checked_velocities(velocities, count: int) -> tuple[tuple[float, ...], ...]:
    numbers = real_numbers(velocities)
    fits = numbers is not None and (numbers.size == 0 or numbers.shape in ((count, 2, 2), (count, 4)))
    expected = f"those of both ends of {count} segments, ((v_x, v_y), (v_x, v_y)), m/s"
    expect(fits and np.isfinite(numbers).all(), f"segment_velocities: expected {expected}, got {brief(velocities)}")
    return tuple(map(tuple, numbers.reshape(-1, 4).tolist())) if numbers.any() else ()


def _checked_scales(scales) -> ContactScales | None:
    if scales is None:
        return None
    is_known = isinstance(scales, ContactScales)
    expect(is_known, f"scales: expected None or ContactScales, such as scales.BOX2D, got {brief(scales)}")
    limits = {"max_translation": {"above": 0}}
    named = scales._asdict().items()
    # Integers become floats, the type for which the engine is compiled.
    return ContactScales(*(number(f"scales.{name}", v, **limits.get(name, {"low": 0})) for name, v in named))


def _length(name: str, values) -> int:
    """Return the length of an array of one dimension. Raises ValueError for any other number of dimensions."""
    try:
        shape = np.shape(values)
    except ValueError:  # rows of unequal length
        shape = ()
    if len(shape) != 1:  # not by `expect`: NumPy takes milliseconds to print an array for its message
        raise ValueError(f"{name}: expected an array of one dimension, got {brief(values)}")
    return shape[0]


def _checked_array(owner: str, name: str, value, count: int) -> np.ndarray:
    """Return a validated copy of the array of a field: int64 for indices and materials, float64 for all other fields.

    owner: "bodies" or "contacts", for the message. name: name of the field. count: number of bodies or contacts.
    """
    shape = (count, 2) if name in ("position", "velocity", "normal") else (count,)
    if name in ("body_a", "body_b", "material"):
        index = array_of(value)
        fits = index.shape == shape and (np.issubdtype(index.dtype, np.integer) or index.size == 0)
        expect(fits, f"{owner}.{name}: expected integers of shape {shape}, got {index.dtype}, {index.shape}")
        return index.astype(np.int64)
    if name != "mass":
        return floats(f"{owner}.{name}", value, shape)
    numbers = real_numbers(value)
    if numbers is None or numbers.shape != shape:
        return floats(f"{owner}.{name}", value, shape)  # raises ValueError
    is_fixed = np.isposinf(numbers)  # a fixed circle has an infinite mass
    return np.where(is_fixed, np.inf, floats(f"{owner}.{name}", np.where(is_fixed, 1.0, numbers), shape))
