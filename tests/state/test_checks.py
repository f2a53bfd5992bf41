"""The borders of what a state may hold: the last value that is accepted, and the first that is refused."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.state.arrays import LIMITS, Bodies, body_name
from deep_contact.state.checks import check_limits
from deep_contact.state.fields import check_contacts, checked_indices, checked_push, is_unit
from deep_contact.state.scales import ContactScales


def laden():
    """Two circles, one on a segment, with contacts and scales of their own."""
    world = {"segments": [((0.0, 5.0), (9.0, 5.0))], "surface_speeds": [1.0], "scales": dc.BOX2D}
    world["segment_velocities"] = [((0.0, 0.0), (0.0, 0.1))]
    return dc.find_contacts(circles_at([[2.0, 6.0], [6.0, 6.0], [3.9, 6.0]], **world))


def with_value(state, name, value):
    """The state with this value at the last place of a quantity of `LIMITS`, and the place as messages name it."""
    owner, _, field = name.partition(".")
    if not field:
        return state.replace(**{owner: value}), ""
    part = getattr(state, owner)
    if isinstance(part, ContactScales):
        scales = part._replace(**{field: value})
        return replace(state, world=replace(state.world, scales=scales)), ""
    array = np.array(getattr(part, field), float)
    place = "" if array.ndim == 0 else "[" + ", ".join(str(length - 1) for length in array.shape) + "]"
    array.flat[-1] = value
    if owner == "world":
        if field == "box":
            array[:] = (-abs(value), -abs(value), value, value) if value > 0 else (value, value, -value, -value)
            place = "[0]"
        kept = float(array) if array.ndim == 0 else array.tolist()
        return replace(state, world=replace(state.world, **{field: kept})), place
    return replace(state, **{owner: part._replace(**{field: array})}), place


@pytest.mark.parametrize("name", LIMITS)
def test_a_quantity_may_be_as_small_and_as_large_as_its_limits_and_no_more(name):
    """`ready` and `check_limits` ask alike. A message names the quantity, its place, the limits and the value."""
    low, high, unit = LIMITS[name]
    state = laden()
    for limit, beyond in ((low, -1.0), (high, 1.0)):
        if limit == 0.0 and name.startswith(("world.friction", "world.rolling", "scales")):
            continue  # below 0 no world is made
        if name == "contacts.normal_impulse" and limit < 0.0:
            continue
        taken, _ = with_value(state, name, limit)
        assert check_limits(taken) is taken
        refused, place = with_value(state, name, limit + beyond * 1e-9 * abs(limit))
        expected = f"{name}{place}: expected {low:g} to {high:g} {unit}".rstrip() + ", got"
        with pytest.raises(ValueError, match="^" + re.escape(expected)):
            check_limits(refused)
        with pytest.raises(ValueError, match=re.escape(f"{name}")):
            dc.simulate(refused, steps=1, solver=dc.PGS())


def test_fixed_circles_are_within_the_limits_of_mass():
    state = laden()
    mass = state.bodies.mass.copy()
    mass[1] = np.inf
    assert check_limits(state.replace(bodies=state.bodies._replace(mass=mass)))
    mass[1] = -np.inf
    with pytest.raises(ValueError, match=r"bodies\.mass\[1\]"):
        check_limits(state.replace(bodies=state.bodies._replace(mass=mass)))


@pytest.mark.parametrize("box", [(0, 0, 0, 5), (0, 0, 5, 0), (3, 0, 1, 9), (0, 9, 20, 1), (0, -1, 5, -1)])
def test_a_box_has_a_width_and_a_height(box):
    with pytest.raises(ValueError, match=r"box: expected \(x_min, y_min, x_max, y_max\) of positive extent"):
        dc.World(box=box)
    assert dc.World(box=(-3, -2, -1, -1)).box == (-3.0, -2.0, -1.0, -1.0)


def one_contact(**changes):
    """A contact of circle 0 and the floor, of two circles; changed."""
    plain = {"body_a": 0, "body_b": 2, "normal": [0.0, -1.0], "position": [0.0, 0.0]} | changes
    names = dc.Contacts._fields
    return dc.Contacts(*(np.array([plain.get(name, 0.0)], int if "body" in name else float) for name in names))


@pytest.mark.parametrize(
    ("changes", "segments", "message"),
    [
        ({}, 0, None),
        ({"body_a": 1}, 0, None),
        ({"body_a": 2, "body_b": 3}, 0, r"body_a\[0\]: expected a circle, 0 to 1, got 2"),
        ({"body_a": -1}, 0, r"body_a\[0\]: expected a circle, 0 to 1, got -1"),
        ({"body_b": 0}, 0, r"body_b\[0\]: expected a body after body_a, up to 5 \(walls\), got 0"),
        ({"body_b": 1}, 0, None),
        ({"body_b": 5}, 0, None),
        ({"body_b": 6}, 0, r"body_b\[0\]: expected a body after body_a, up to 5 \(walls\), got 6"),
        ({"body_b": 6}, 1, None),
        ({"body_b": 7}, 1, r"body_b\[0\]: expected a body after body_a, up to 6 \(walls, segments\), got 7"),
        ({"normal": [0.0, -1.00009]}, 0, None),
        ({"normal": [0.0, -1.00011]}, 0, r"normal\[0\]: expected a unit vector"),
        ({"normal": [0.0, -0.99991]}, 0, None),
        ({"normal": [0.0, -0.99989]}, 0, r"normal\[0\]: expected a unit vector"),
        ({"normal_impulse": -1e-12}, 0, r"normal_impulse\[0\]: expected a number >= 0"),
        ({"normal_start": -1.0, "tangent_impulse": -1.0, "separation": -1.0}, 0, None),
    ],
)
def test_a_contact_joins_a_circle_and_a_body_after_it_along_a_unit_normal(changes, segments, message):
    bodies = dc.make_bodies([[1.0, 1.0], [5.0, 1.0]])
    if message is None:
        assert check_contacts(one_contact(**changes), bodies, segments) == one_contact(**changes)
    else:
        with pytest.raises(ValueError, match=message):
            check_contacts(one_contact(**changes), bodies, segments)
    assert is_unit(np.array([[1e300, 1e300], [0.6, 0.8]])).tolist() == [False, True]


def test_bodies_have_the_names_of_their_places():
    assert [body_name(body, 3) for body in (0, 2, 3, 4, 5, 6, 7, 9)] == [
        0, 2, "floor", "right", "ceiling", "left", "segment 0", "segment 2",
    ]  # fmt: skip


@pytest.mark.parametrize("which", [[3], [-1], [0, 0], [0.0], [[0]], [True, False], "0", [None]])
def test_indices_are_different_numbers_below_the_count_or_flags(which):
    message = re.escape("which: expected different numbers, 0 to 2, or 3 flags, got")
    with pytest.raises(ValueError, match=message):
        checked_indices("which", which, 3)
    for taken, expected in (([2, 0], [2, 0]), ([True, False, True], [0, 2]), (1, [1]), ([], []), ([False] * 3, [])):
        assert checked_indices("which", taken, 3).tolist() == expected


@pytest.mark.parametrize(
    "push",
    [np.zeros(2), np.zeros((2, 3)), np.zeros((3, 2)), (np.zeros((2, 2)), np.zeros(3)), (np.zeros((2, 2)),) * 2,
     (np.zeros((2, 2)), np.zeros(2), 0), (np.zeros((2, 2)), np.array([0.0, np.nan])), np.full((2, 2), np.inf), None],
)  # fmt: skip
def test_a_push_is_forces_or_forces_and_torques(push):
    with pytest.raises(ValueError, match=r"push: expected forces \(2, 2\), N, or a tuple of them and torques \(2,\)"):
        checked_push(push, 2)
    force, torque = checked_push([[1, 2], [3, 4]], 2)
    assert (force.tolist(), torque.tolist(), force.dtype) == ([[1.0, 2.0], [3.0, 4.0]], [0.0, 0.0], np.float64)
    assert checked_push((force, [1, 2]), 2)[1].tolist() == [1.0, 2.0]
    assert checked_push(force, 2)[0] is not force


LINE, MOVED = [((0.0, 5.0), (9.0, 5.0))], [((0.0, 5.1), (9.0, 5.1))]
JUMPS = {
    "a segment elsewhere": ({}, {"segments": MOVED}, 1, True),
    "at the beginning": ({}, {"segments": MOVED}, 0, False),
    "the same segment": ({}, {"segments": LINE, "friction": 0.1}, 1, False),
    "with a velocity": ({}, {"segments": MOVED, "segment_velocities": [((0, 1), (0, 1))]}, 1, False),
    "another number of segments": ({}, {"segments": MOVED * 2}, 1, False),
    "with other bodies": ({"bodies": dc.make_bodies([[4.0, 9.0]])}, {"segments": MOVED}, 1, False),
    "another of two": ({}, {"segments": [*LINE, *LINE], "segment_velocities": [((0, 1), (0, 1)), ((0, 0), (0, 0))]},
                       1, False),
}  # fmt: skip


@pytest.mark.parametrize("name", JUMPS)
def test_a_warning_says_where_a_segment_jumps_in_the_course_of_a_run(name):
    fields, world, step, is_said = JUMPS[name]
    state = circles_at([[4.0, 7.0]], segments=LINE).replace(step=step)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        state.replace(world=replace(state.world, **world), **fields)
    assert [str(one.message)[:40] for one in said] == ["segments: a segment that is put elsewhere"[:40]] * is_said


def test_arrays_of_the_wrong_kind_are_named():
    bodies = dc.make_bodies([[1.0, 1.0], [5.0, 1.0]])
    bad = {
        "position": [np.zeros((2, 3)), np.zeros(2), np.full((2, 2), np.nan)],
        "mass": [np.zeros(2), np.array([1.0, -1.0]), np.array([1.0, -np.inf]), np.array([np.nan, 1.0])],
        "radius": [np.array([1.0, 0.0]), np.array([1.0, np.inf]), np.ones(3)],
        "spin": [np.array([1.0, np.inf]), np.ones((2, 1))],
    }
    for name, values in bad.items():
        for value in values:
            state = dc.State(name="bad", world=dc.World(), bodies=bodies._replace(**{name: value}))
            with pytest.raises(ValueError, match=rf"bodies\.{name}"):
                dc.step(state)
    assert Bodies(*bodies) == bodies
    assert bodies._replace(spin=np.ones(2)) != bodies
