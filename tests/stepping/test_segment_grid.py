"""The geometry of segments against plain vector algebra, at random places and in all directions."""

import math
from fractions import Fraction

import numpy as np
import pytest
from conftest import circles_at

from deep_contact.stepping.contacts import make_contacts
from deep_contact.stepping.context import Actuation
from deep_contact.stepping.inputs import actuation_of
from deep_contact.stepping.problem import contacts_of
from deep_contact.stepping.segment_grid import (
    BESIDE,
    END,
    START,
    in_grid,
    is_beyond,
    nearest_part,
    segment_gap,
    segments_in_grid,
)
from deep_contact.stepping.segments import (
    carried,
    clamp_beside,
    clamp_beside_moving,
    crossing,
    first_crossing,
    ground_velocities,
    surface_velocity,
    time_to_touch,
    wall_velocity,
)

RNG = np.random.default_rng(7)
LINES = np.column_stack([RNG.uniform(-5.0, 9.0, (40, 4)), np.zeros(40)])
POINTS = RNG.uniform(-6.0, 10.0, (40, 2, 2))
RATES = RNG.uniform(-3.0, 3.0, (40, 4))


def ends_of(line):
    return line[:2], line[2:4]


def place_on(line, point):
    """(Share, signed distance to the left, m) of a point, along and across the straight line through a segment."""
    start, end = ends_of(line)
    along = (end - start) / np.linalg.norm(end - start)
    off = point - start
    return off @ along / np.linalg.norm(end - start), along[0] * off[1] - along[1] * off[0]


def met(line, point, to):
    """Share of the way from a point to another at which it crosses a segment, or infinity: of two linear equations."""
    start, end = ends_of(line)
    share, along = np.linalg.solve(np.column_stack([to - point, start - end]), start - point)
    return share if 0.0 <= share <= 1.0 and 0.0 <= along <= 1.0 else math.inf


def test_a_way_crosses_a_segment_where_two_lines_meet():
    expected = [met(line, *way) for line in LINES for way in POINTS]
    found = [crossing(line, *way[0], *way[1]) for line in LINES for way in POINTS]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert 100 < np.isfinite(expected).sum() < 1500


def test_the_first_crossing_is_that_of_the_nearest_segment_that_rests():
    grid, moving = in_grid(LINES, 0.5, 1000), RATES * (np.arange(40) % 3 == 0)[:, None]
    actuation = Actuation(moving, np.flatnonzero(moving.any(axis=1)), np.zeros((0, 2)), np.zeros(0))
    for point, to in POINTS:
        each = np.array([met(line, point, to) for line in LINES])
        for kind, stays in ((None, each >= 0.0), (actuation, ~moving.any(axis=1))):
            found = first_crossing(grid, 0, *point, *to, np.empty_like(grid.every), (None, 5), kind)
            np.testing.assert_allclose(found, each[stays].min(), rtol=1e-9)


def test_a_point_that_a_segment_carries_keeps_its_place_beside_it():
    for line, rate, (point, _) in zip(LINES, RATES, POINTS):
        dt = 0.3
        before = line.copy()
        before[:4] -= dt * rate
        found = np.array(carried(line[None], rate[None], 0, dt, *point))
        np.testing.assert_allclose(place_on(line, found), place_on(before, point), rtol=1e-9, atol=1e-9)


def test_a_segment_has_the_velocity_between_those_of_its_ends():
    for line, rate, (point, _) in zip(LINES, RATES, POINTS):
        share = min(1.0, max(0.0, place_on(line, point)[0]))
        expected = (1.0 - share) * rate[:2] + share * rate[2:]
        np.testing.assert_allclose(wall_velocity(line[None], rate[None], 0, *point), expected, rtol=1e-12, atol=1e-12)


def test_the_gap_is_the_distance_and_the_normal_points_to_the_nearest_place():
    for line, (point, _) in zip(LINES, POINTS):
        share, across = place_on(line, point)
        start, end = ends_of(line)
        nearest = start + min(1.0, max(0.0, share)) * (end - start)
        gap, *normal = segment_gap(line, *point)
        np.testing.assert_allclose(point + gap * np.array(normal), nearest, atol=1e-9)
        assert abs(math.hypot(*normal) - 1.0) < 1e-12
        assert nearest_part(line, *point) == (START if share < 0.0 else END if share > 1.0 else BESIDE)
        # From the side that a normal of before tells: beyond the line it is negative.
        left = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
        for side in (1.0, -1.0):
            seen, *same = segment_gap(line, *point, *(-side * left))
            assert abs(seen - side * across) < 1e-9
            np.testing.assert_allclose(same, -side * left, atol=1e-9)


def test_the_time_to_touch_is_that_at_which_the_distance_has_become_so_small():
    times = np.linspace(0.0, 1.0, 2001)
    touched = 0
    for line in LINES[:12]:
        for point, to in POINTS[:20]:
            start, end = ends_of(line)
            least = 0.4
            way = point + times[:, None] * (to - point)
            shares = np.clip((way - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
            far = np.linalg.norm(start + shares[:, None] * (end - start) - way, axis=1)
            if far[0] < least:
                continue
            time, part = time_to_touch(line, *point, *(to - point), least)
            within = np.flatnonzero(far <= least)
            if within.size:
                assert abs(time - times[within[0]]) <= times[1]
                if min(abs(shares[within[0]]), abs(1.0 - shares[within[0]])) > 0.01 or shares[within[0]] in (0.0, 1.0):
                    assert part == {0.0: START, 1.0: END}.get(shares[within[0]], BESIDE)
                touched += 1
            elif far.min() > least + 1e-2:
                assert not time <= 1.0
    assert touched > 30


def crossed_by(lines, box=(-50.0, -50.0, 50.0, 50.0), **world):
    """A state of circles at the ends of the ways in POINTS, and where they were."""
    segments = [tuple(map(tuple, np.reshape(line[:4], (2, 2)))) for line in lines]
    return circles_at(POINTS[:, 1].copy(), radius=0.5, box=box, segments=segments, **world), POINTS[:, 0].copy()


def test_centres_that_have_crossed_a_resting_segment_are_put_to_half_of_their_way_to_it():
    state, before = crossed_by(LINES[:3])
    share = np.array([min(met(line, *way) for line in LINES[:3]) for way in POINTS])
    assert 5 < np.isfinite(share).sum() < 35
    clamp_beside(state.bodies, before, segments_in_grid(state.world, 0.5), None, None)
    part = np.where(np.isfinite(share), 0.5 * np.where(np.isfinite(share), share, 0.0), 1.0)
    np.testing.assert_allclose(state.bodies.position, before + part[:, None] * (POINTS[:, 1] - before), atol=1e-9)


@pytest.mark.parametrize("radius", [100.0, 1e-3])
def test_centres_that_a_segment_presses_stay_before_it_and_what_is_fixed_or_fast_is_passed(radius):
    """As of a segment at rest, where the way began as far from it as it was from the segment then.

    Slow are ways of less than half of a radius, as the segment sees them; others are for `continuous`. What it did not
    touch before it passes as well.
    """
    dt, line, rate = 0.25, LINES[:1], RATES[:1]
    state, before = crossed_by(line, segment_velocities=[np.reshape(rate, (2, 2))], fixed=np.arange(40) % 4 == 0)
    state = state.replace(bodies=state.bodies._replace(radius=np.full(40, radius)))
    solved = make_contacts(20)  # with each second circle
    solved.body_a[:], solved.body_b[:] = np.arange(1, 40, 2), 44
    segments, expected, held, passed = segments_in_grid(state.world, 0.5), state.bodies.position.copy(), 0, []
    for i, (start, end) in enumerate(zip(before, expected.copy())):
        start = np.array(carried(line, rate, 0, dt, *start))
        if (share := met(line[0], start, end)) < math.inf and i % 4:
            if i % 2 and np.hypot(*(end - start)) < 0.5 * radius:
                expected[i] = start + 0.5 * share * (end - start)
                held += 1
            else:
                passed.append(i)
    changed, last = clamp_beside_moving(state.bodies, before, segments, solved, None, actuation_of(state), dt)
    np.testing.assert_allclose(state.bodies.position, expected, atol=1e-9)
    assert changed == (held > 0)
    assert last == passed[-1]
    assert (held > 2) == (radius > 1.0)


def test_a_point_is_called_beyond_a_limit_only_where_it_is_and_wherever_it_clearly_is():
    """Against the distance in exact rational arithmetic, near the limit and far from it, on scales of 1e-6 to 1e9."""
    rng, near = np.random.default_rng(0), 0
    for size in 10.0 ** rng.uniform(-6, 9, 300):
        line, point = size * rng.uniform(-1, 1, 4), size * rng.uniform(-2, 2, 2)
        (x_0, y_0, x_1, y_1), (x, y) = map(Fraction, line), map(Fraction, point)
        e_x, e_y = x_1 - x_0, y_1 - y_0
        share = min(1, max(0, (e_x * (x - x_0) + e_y * (y - y_0)) / (e_x**2 + e_y**2)))
        square = (x_0 + share * e_x - x) ** 2 + (y_0 + share * e_y - y) ** 2
        distance = math.sqrt(square)
        for limit in distance * (1.0 + np.array([-0.9, -1e-3, -1e-6, -1e-12, 0.0, 1e-15, 1e-12, 1e-6, 0.5])):
            beyond = is_beyond(np.array([*line, 0.0]), *point, limit)
            assert not (beyond and Fraction(limit) ** 2 >= square)
            assert beyond or limit > (1.0 - 1e-5) * distance
            near += beyond
    assert near == 900


def test_contacts_know_how_fast_the_ground_is():
    """Along the normal and along the tangent (n_y, −n_x): of a belt, of a wall that turns, and of a wall at rest."""
    world = {"segments": [((0.0, 0.0), (4.0, 3.0)), ((6.0, 0.0), (6.0, 4.0)), ((9.0, 0.0), (9.0, 4.0))],
             "surface_speeds": [5.0, 0.0, 0.0],
             "segment_velocities": [((0, 0), (0, 0)), ((1.0, 2.0), (3.0, -2.0)), ((0, 0), (0, 0))]}  # fmt: skip
    state = circles_at([[1.7, 1.9], [5.6, 1.0], [9.4, 3.0]], radius=0.5, box=(-9, -9, 19, 19), friction=0.5, **world)
    contacts = contacts_of(state)
    assert contacts.body_b.tolist() == [7, 8, 9]
    velocities = np.array([[4.0, 3.0], [1.5, 1.0], [0.0, 0.0]])  # the belt's; a quarter between the ends; none
    tangent = np.column_stack([contacts.normal[:, 1], -contacts.normal[:, 0]])
    expected = np.einsum("ij,ij->i", velocities, contacts.normal), np.einsum("ij,ij->i", velocities, tangent)
    np.testing.assert_allclose(ground_velocities(contacts, state.world, 3), expected, atol=1e-9)
    for i, line in enumerate(np.array(state.world.segments)):
        speed = surface_velocity(np.append(line, [5.0, 0.0, 0.0][i]), *contacts.normal[i])
        assert abs(speed - (expected[1][i] if i == 0 else 0.0)) < 1e-9
