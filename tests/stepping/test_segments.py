"""Static segments: closed forms, the box as segments, joints, ends, and that nothing passes through."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at
from hypothesis import example, given, settings
from hypothesis import strategies as st

import deep_contact as dc
from deep_contact.solvers import METHODS
from deep_contact.stepping.problem import contacts_of
from deep_contact.stepping.segment_grid import BEHIND, END, START, circles_beside, in_grid, near_box, segments_in_grid
from deep_contact.stepping.segments import clamp_beside, hides, time_to_touch, touches

BOX = (0.0, 0.0, 60.0, 40.0)
EVERYWHERE = (-1e10, -1e10, 1e10, 1e10)
ALL = (None, 5)
"""All pairs touch (`segments.touches`)."""
SOLVERS = {name: METHODS[name]() for name in METHODS} | {"islands": dc.PGS(islands=True)}


def scene(position, *segments, **options):
    return circles_at(position, **({"box": BOX, "segments": segments, "friction": 0.3} | options))


def frames(state, steps, **options):
    """What `on_step` sees: solved states, the bodies before the step."""
    found = []
    dc.simulate(state, steps=steps, on_step=lambda solved, _: found.append(solved), **options)
    return found


def distances(line, points):
    """Of points, (k, 2), from segments, (S, 4 or 5): (k, S), m."""
    start, along = line[:, :2], line[:, 2:4] - line[:, :2]
    share = np.clip(((points[:, None] - start) * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(start + share[..., None] * along - points[:, None], axis=2)


GRIDS = {
    "terrain": (lambda rng: np.cumsum(rng.uniform(-1.0, 1.5, (301, 2)), axis=0), 1.01),
    "long ones": (lambda rng: rng.uniform(-1000.0, 1000.0, (41, 2)), 0.3),
    "hundreds in a cell": (lambda rng: rng.uniform(0.0, 1.0, (501, 2)), 20.0),
    "far apart": (lambda rng: np.array([[0.0, 0.0], [1e-3, 0.0], [1e9, 5.0], [1e9, 7.0]]), 1e-3),
    "one level": (lambda rng: np.column_stack([rng.uniform(0.0, 50.0, 101), np.full(101, 3.0)]), 0.5),
}


@pytest.mark.parametrize("kind", GRIDS)
def test_the_grid_lists_every_segment_within_reach_of_a_place_or_a_way(kind):
    # Against the distance from all of them. Points lie on ends, near segments, anywhere and far outside.
    rng, (make, reach) = np.random.default_rng(0), GRIDS[kind]
    ends = make(rng)
    segments = in_grid(np.column_stack([ends[:-1], ends[1:], np.zeros(len(ends) - 1)]), reach, 8 * len(ends) + 4000)
    line, buffer = segments.line, np.empty_like(segments.every)
    beside = line[rng.integers(len(line), size=200), :2] + rng.uniform(-1.5 * reach, 1.5 * reach, (200, 2))
    low, high = ends.min(axis=0), ends.max(axis=0)
    anywhere = rng.uniform(low - reach, high + reach, (200, 2))
    points = np.concatenate([ends[:100], beside, anywhere, [high + 1e6, [np.nan] * 2]])
    circles = np.empty(len(points), np.int64)
    beside = set(circles[: circles_beside(segments, points, points, circles)])
    for i, ((x, y), near) in enumerate(zip(points, distances(line, points) <= reach)):
        cell = near_box(segments, x, x, y, y, buffer)
        assert set(np.flatnonzero(near)) <= set(cell)
        assert i in beside or not near.any()
        found = {s for s in cell if touches(segments, EVERYWHERE, 0, s, x, y, reach, ALL)}
        assert found == {s for s in segments.every if touches(segments, EVERYWHERE, 0, s, x, y, reach, ALL)}
    for (x, y), (to_x, to_y) in zip(points[:-2:7], points[1:-1:7]):
        way = np.array([x, y]) + np.linspace(0.0, 1.0, 50)[:, None] * (to_x - x, to_y - y)
        near = (distances(line, way) <= reach).any(axis=0)
        box = min(x, to_x), max(x, to_x), min(y, to_y), max(y, to_y)
        assert set(np.flatnonzero(near)) <= set(near_box(segments, *box, buffer))


def test_a_grid_of_many_segments_is_small_and_is_made_once():
    ends = np.cumsum(np.random.default_rng(1).uniform(-0.5, 1.0, (100_001, 2)), axis=0)
    segments = in_grid(np.column_stack([ends[:-1], ends[1:], np.zeros(100_000)]), 0.5, 804_000)
    assert len(segments.start) < 1e6
    assert len(segments.near) < 4e6
    world = dc.World(segments=[((0.0, 1.0), (5.0, 1.0))])
    kept = segments_in_grid(world, 1.0)
    assert segments_in_grid(world, 0.9) is kept
    assert segments_in_grid(world, 1.1).reach == 1.1
    assert dc.World(segments=[((0.0, 1.0), (5.0, 1.0))]) == world


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize(("friction", "slides"), [(0.5, False), (0.1, True)])
def test_a_disc_on_a_slope_rolls_or_slides_as_in_closed_form(friction, slides, mirrored):
    # Rolling: a = g sin θ l² / (l² + r² / 2), 2/3 g sin θ for the arm l = r. It sticks while μ >= tan θ / 3.
    theta, g, top = math.radians(25), 9.81, np.array([2.0, 35.0])
    down, up = np.array([math.cos(theta), -math.sin(theta)]), np.array([math.sin(theta), math.cos(theta)])
    slope = (top, top + 50 * down)[:: -1 if mirrored else 1]  # neither side is the front
    state = scene([top + 5.0 * down + 1.005 * up], slope, friction=friction)
    run = frames(state, 100, solver=dc.PGS(sweeps=400, tolerance=0.0))
    arm = 1 + 0.5 * run[-1].contacts.separation[0]
    velocity = np.array([state.bodies.velocity[0] @ down for state in run[-40:]])
    rolling, sliding = g * math.sin(theta) / (1 + 0.5 / arm**2), g * (math.sin(theta) - friction * math.cos(theta))
    expected = sliding if slides else rolling
    np.testing.assert_allclose(np.diff(velocity) / 0.01, expected, rtol=1e-6)
    spin = np.array([state.bodies.spin[0] for state in run[-40:]])
    turning = 2 * friction * g * math.cos(theta) * arm if slides else expected / arm
    np.testing.assert_allclose(np.diff(spin) / 0.01, -turning, rtol=1e-6)
    normal = math.pi * g * 0.01 * math.cos(theta)
    np.testing.assert_allclose(run[-1].contacts.normal_impulse, normal, rtol=1e-6)


def test_a_disc_in_a_v_presses_on_both_sides_as_in_closed_form():
    # N₁ sin α = N₂ sin β and N₁ cos α + N₂ cos β = m g, without friction.
    alpha, beta, foot = math.radians(30), math.radians(50), np.array([20.0, 5.0])
    sides = foot + 10 * np.array([[-math.cos(alpha), math.sin(alpha)], [math.cos(beta), math.sin(beta)]])
    # Centre at 1.005 m from both lines.
    normals = np.array([[math.sin(alpha), math.cos(alpha)], [-math.sin(beta), math.cos(beta)]])
    centre = foot + np.linalg.solve(normals, [1.005, 1.005])
    state = scene([centre], (sides[0], foot), (foot, sides[1]), friction=0.0)
    after = frames(state, 50, solver=dc.PGS(sweeps=2000, tolerance=0.0))[-1]
    weight = math.pi * 9.81 * 0.01
    expected = weight / math.sin(alpha + beta) * np.array([math.sin(beta), math.sin(alpha)])
    np.testing.assert_array_equal(after.contacts.body_b, [5, 6])
    np.testing.assert_allclose(after.contacts.normal_impulse, expected, rtol=1e-6)
    np.testing.assert_allclose(after.bodies.position[0], centre, atol=1e-6)


@pytest.mark.parametrize("name", ["PGS", "BatchedPGS"])
def test_a_disc_bounces_off_an_end_as_off_a_point(name):
    # Elastic, without friction: v − 2 (v · n) n, n from the centre to the end; the speed stays.
    segment, matter = ((20.0, 10.0), (5.0, 10.0)), {"gravity": (0, 0), "friction": 0.0, "restitution": 1.0}
    state = scene([[20.5, 14.0]], segment, velocity=[0.0, -10.0], **matter)
    run = frames(state, 60, solver=SOLVERS[name])
    hit = next(state for state in run if state.contacts.count)
    to_end = np.array([20.0, 10.0]) - hit.bodies.position[0]
    normal = to_end / np.linalg.norm(to_end)
    np.testing.assert_allclose(hit.contacts.normal, [normal], rtol=1e-12)
    np.testing.assert_allclose(hit.contacts.separation, np.linalg.norm(to_end) - 1 - hit.scales.wall_skin, atol=1e-12)
    v = np.array([0.0, -10.0])
    np.testing.assert_allclose(run[-1].bodies.velocity[0], v - 2 * (v @ normal) * normal, rtol=1e-5)
    assert 0.3 < normal @ [-1.0, 0.0] < 0.6


@pytest.mark.parametrize("name", sorted(SOLVERS.keys() - {"BatchedPGS"}))  # which corrects positions in its own order
def test_a_box_of_four_segments_is_the_box_to_the_last_bit(name):
    inner = dc.lattice_in_box(60, radius=(0.6, 1.0), gap=0.2, seed=2, restitution=0.4)
    x_min, y_min, x_max, y_max = inner.world.box
    corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]
    segments = list(zip(corners, corners[1:] + corners[:1]))
    outer = replace(inner.world, box=(x_min - 9, y_min - 5, x_max + 7, y_max + 8), segments=segments)
    runs = [
        dc.simulate(inner.replace(world=world), steps=150, solver=SOLVERS[name], sleep=name == "PGS", record=10)
        for world in (inner.world, outer)
    ]
    walls, segments = runs
    assert (walls.state.contacts.body_b >= 60).sum() > 5
    np.testing.assert_array_equal(walls.state.bodies.velocity, segments.state.bodies.velocity)
    np.testing.assert_array_equal(walls.trajectory.positions, segments.trajectory.positions)
    np.testing.assert_array_equal(walls.trajectory.impulses, segments.trajectory.impulses)
    np.testing.assert_array_equal(walls.theta, segments.theta)
    wall = walls.state.contacts.body_b
    np.testing.assert_array_equal(np.where(wall >= 60, wall + 4, wall), segments.state.contacts.body_b)


@pytest.mark.parametrize("speed", [3.0, 20.0, 150.0])
def test_a_joint_is_not_felt(speed):
    # Over five segments in a row as over one; 150 m/s is beyond half a radius a step.
    x = [2.0, 9.3, 17.1, 24.0, 39.7, 58.0]
    row = [((a, 10.0), (b, 10.0)) for a, b in zip(x, x[1:])]
    row[1] = row[1][::-1]
    state = scene([[4.0, 11.004]], (row[0][0], row[-1][1]), friction=0.2, velocity=[speed, 0.0], spin=-speed)
    steps = int(50 / speed / 0.01)
    many = state.replace(world=replace(state.world, segments=row))
    solver = dc.PGS(sweeps=200, tolerance=0.0)
    one, many = (dc.simulate(state, steps=steps, solver=solver, record=1).trajectory for state in (state, many))
    np.testing.assert_allclose(many.positions, one.positions, rtol=0, atol=1e-9)
    np.testing.assert_allclose(many.velocities, one.velocities, rtol=0, atol=1e-9)
    assert one.positions[-1, 0, 0] > 45


def test_touching_segments_equal_brute_force():
    # Free segments: all within reach are found, sorted, with the distance.
    rng = np.random.default_rng(5)
    position, radius = rng.uniform(5, 35, (80, 2)), rng.uniform(0.3, 3.0, 80)
    segments = rng.uniform(5, 35, (25, 4))
    state = scene(position, *segments, radius=radius)
    contacts = contacts_of(state)
    gap = distances(segments, position) - radius[:, None] - state.scales.wall_skin
    found = contacts.body_b >= 84
    expected = np.argwhere(gap <= 0)
    assert len(expected) > 100
    np.testing.assert_array_equal(np.column_stack(contacts[:2])[found] - [0, 84], expected)
    np.testing.assert_allclose(contacts.separation[found], gap[tuple(expected.T)], atol=1e-12)
    order = list(zip(contacts.body_a, contacts.body_b))
    assert order == sorted(order)


@pytest.mark.parametrize("point", [(-1.0, 0.0), (3.0, 0.0), (1.0, -1.0), (1.0, 1.0)])
def test_a_segment_touches_as_far_as_the_reach_goes(point):
    for segment in ([0.0, 0.0, 2.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0, 0.0]):
        alone = in_grid(np.array([segment]), 1.0, 100)
        assert touches(alone, EVERYWHERE, 0, 0, *point, 1.0, ALL)
        assert not touches(alone, EVERYWHERE, 0, 0, *point, np.nextafter(1.0, 0.0), ALL)


def test_an_end_is_touched_by_what_comes_within_and_not_by_what_is_there():
    # By hand: 4 m a step from 3 m before the end, up to 1 m before it.
    segment = np.array([0.0, 0.0, 2.0, 0.0, 0.0])
    assert time_to_touch(segment, -3.0, 0.0, 4.0, 0.0, 1.0) == (0.5, START)
    assert time_to_touch(segment, 5.0, 0.0, -4.0, 0.0, 1.0) == (0.5, END)
    assert time_to_touch(segment, -0.5, 0.5, 0.0, -1.0, 1.0)[0] == math.inf


@pytest.mark.parametrize(
    ("segments", "point", "kept"),
    [
        ([((0, 0), (10, 10)), ((10, 10), (20, 0))], (10.0, 10.8), {0}),  # beyond the tip of both: the first
        ([((0, 0), (10, 10)), ((10, 10), (20, 0))], (10.4, 10.0), {1}),  # beside the second alone
        ([((0, 10), (10, 0)), ((20, 10), (10, 0))], (10.0, 0.7), {0, 1}),  # in a valley: both
        ([((0, 0), (10, 0)), ((10, 5), (10, 0)), ((10, 0), (20, 0))], (9.5, 0.5), {0, 1}),  # in a corner of three
        ([((0, 0), (10, 0)), ((10 + 1e-9, 0), (20, 0))], (10.1, 0.9), {1}),  # ends that differ by rounding
        ([((0, 0), (10, 0)), ((10.01, 0), (20, 0))], (10.1, 0.9), {1}),  # a gap of a hundredth of the radius
        ([((0, 0), (10, 0)), ((10.1, 0), (20, 0))], (10.12, 0.9), {0, 1}),  # a gap of a tenth
        ([((0, 0), (10, 0)), ((10, 0.001), (20, 0.001))], (9.9, 0.9), {0, 1}),  # a step of a thousandth
        ([((0, 0), (10, 0)), ((9, 0), (20, 0))], (8.8, 0.9), {0}),  # the second begins on the first
        ([((0, 0), (10, 0)), ((9, 0), (20, 0))], (9.5, 0.9), {0, 1}),  # beside both
        ([((0, 0), (20, 0)), ((10, 0), (10, -5))], (9.9, 0.9), {0}),  # hangs from it, unseen from above
        ([((0, 0), (20, 0)), ((10, -0.01), (20, -0.01))], (9.9, 0.9), {0}),  # lies just behind it
        ([((0, 0), (10, 0)), ((0, 0), (10, 0))], (10.2, 0.9), {0}),  # twice the same
        ([((2, 2), (10, 10)), ((10, 10), (10.2, 9.8)), ((10.2, 9.8), (18, 2))], (10.5, 10.4), {1}),
    ],
)
def test_an_end_that_segments_share_is_felt_once(segments, point, kept):
    moved = [tuple(np.add(end, 10.0) for end in segment) for segment in segments]
    contacts = contacts_of(scene([np.add(point, 10.0)], *moved))
    assert {b - 5 for b in contacts.body_b} == kept


@pytest.mark.parametrize(("point", "kept"), [((9.8, 0.9), []), ((10.2, 0.9), [0]), ((24.5, 0.9), [])])
def test_an_end_on_a_wall_is_not_felt(point, kept):
    # A belt laid flush on the floor, and the foot of a post: a circle on the floor does not stumble over their ends.
    contacts = contacts_of(scene([point], ((10.0, 0.0), (20.0, 0.0)), ((24.0, -1.0), (24.0, 1e-5))))
    assert contacts.body_b.tolist() == [1, *(5 + s for s in kept)]


def floor(kind, width, angle, origin):
    """Segments along a straight floor as people write them: their ends differ by rounding, or they overlap."""
    along = np.array([np.cos(angle), np.sin(angle)])

    def at(t):
        return tuple(origin + t * along)

    steps = np.arange(0.0, 60.0, width)
    if kind == "long below short":
        return [(at(0.0), at(60.0)), *((at(t), at(t + width)) for t in steps)]
    if kind == "overlapping":
        return [(at(t), at(t + 1.1 * width)) for t in steps]
    return [(at(t + 1e-9), at(t + width)) if kind == "gaps" else (at(t), at(t + width)) for t in steps]


@pytest.mark.parametrize("kind", ["rounded", "gaps", "overlapping", "long below short"])
@pytest.mark.parametrize(("width", "angle", "origin"), [(0.1, 0.0, 0.0), (0.7, 0.3, 1e3), (0.05, -2.2, 0.0)])
def test_a_disc_rolls_over_joints_that_are_not_equal_to_the_bit(kind, width, angle, origin):
    # It keeps v and its height: over `a + 0.1` of np.arange a disc lost 16 % of its speed on 40 m, over laps 59 %.
    along, up = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    start, box = origin + 3.0 * along + 1.006 * up, (origin - 99.0, origin - 99.0, origin + 99.0, origin + 99.0)
    lines, moving = floor(kind, width, angle, origin), {"velocity": 3.0 * along, "spin": -3.0 / 0.998}
    state = scene([start], *lines, box=box, gravity=tuple(-9.81 * up), **moving)
    run = dc.simulate(state, steps=1000, solver=dc.PGS(), record=1).trajectory
    np.testing.assert_allclose(run.velocities[:, 0] @ along, 3.0, rtol=1e-6)
    np.testing.assert_allclose((run.positions[:, 0] - start) @ up, 0.0, atol=1e-6)


def side_changes(before, after, segments):
    """Number of centres whose straight way crosses a segment, by the signs of four areas."""

    def area(p, q, r):
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    count = 0
    for segment in segments:
        a, b = np.reshape(segment, (2, 2))
        across = area(a, b, before) * area(a, b, after) < 0
        between = area(before, after, a) * area(before, after, b) < 0
        count += int((across & between).sum())
    return count


@pytest.mark.filterwarnings("ignore:.*nearly coincide")  # some seeds place two circles so
@example(seed=104, speed=0.0, name="PGS", dt=1e-3)
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    speed=st.floats(0.0, 1e4),
    name=st.sampled_from(["PGS", "BatchedPGS"]),
    dt=st.sampled_from([1e-3, 0.01, 0.05]),
)
def test_nothing_passes_through_a_segment(seed, speed, name, dt):
    rng = np.random.default_rng(seed)
    joint = rng.uniform(10, 30, 2)
    star = [(joint, rng.uniform(5, 35, 2)) for _ in range(3)]
    loose = [tuple(rng.uniform(3, 37, (2, 2))) for _ in range(4)]
    radius = rng.choice([0.05, 0.3, 1.0], 30)
    state = scene(
        rng.uniform(3, 37, (30, 2)), *star, *loose, radius=radius, velocity=speed * rng.uniform(-1, 1, (30, 2)),
        restitution=float(rng.choice([0.0, 0.5, 1.0])), dt=dt,
    )  # fmt: skip
    positions = dc.simulate(state, steps=40, solver=METHODS[name](), record=1).trajectory.positions
    for before, after in zip(positions, positions[1:]):
        assert side_changes(before, after, state.world.segments) == 0


def test_what_has_crossed_a_segment_is_put_half_way_to_it():
    # From (4, 7) to (6, 3) it crosses y = 5 at (5, 5).
    state = scene([[6.0, 3.0], [30.0, 3.0]], ((0, 5), (10, 5)))
    clamp_beside(state.bodies, np.array([[4.0, 7.0], [30.0, 7.0]]), segments_in_grid(state.world, 1.0), None, None)
    np.testing.assert_allclose(state.bodies.position, [[4.5, 6.0], [30.0, 3.0]], rtol=1e-15)


def test_a_crowd_pressed_against_a_segment_stays_on_its_side():
    # 40 weights of 1,000 kg on a line of circles of 1 kg, one sweep a step: far more than it can withstand.
    x = np.arange(10.0, 30.0, 2.0)
    light = np.column_stack([x, np.full(10, 11.01)])
    heavy = np.column_stack([np.tile(x, 4), np.repeat([13.1, 15.2, 17.3, 19.4], 10)])
    state = scene(
        np.vstack([light, heavy]), ((0, 10), (60, 10)), ((9, 10), (9, 40)), ((29, 40), (29, 10)),
        mass=[1.0] * 10 + [1000.0] * 40,
    )  # fmt: skip
    after = dc.simulate(state, steps=300, solver=dc.PGS(sweeps=1)).state
    assert (after.bodies.position[:, 1] > 10).all()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, 2.5])
def test_an_end_just_behind_a_segment_is_hidden_from_the_side_of_the_circle(angle, side, turned):
    """Seen from there: as far behind as `BEHIND` says, and in front only as far as `ON` says."""
    along, reach = np.array([np.cos(angle), np.sin(angle)]), 1.01
    out = side * np.array([-along[1], along[0]])
    line = np.concatenate([-5.0 * along, 5.0 * along, [0.0]])
    if turned:
        line[:4] = line[[2, 3, 0, 1]]
    for depth, is_hidden in ((0.5 * BEHIND, True), (-0.5 * BEHIND, False), (1.1 * BEHIND, False), (0.0, True)):
        end = 0.4 * along - depth * reach * out
        assert hides(line, *end, *(0.3 * along + reach * out), reach) == is_hidden


def test_more_contacts_with_segments_than_the_buffer_holds():
    """Two hundred segments cross in a point; the buffer is made larger until all contacts fit."""
    angles = np.pi * np.arange(200) / 200
    along = np.column_stack([np.cos(angles), np.sin(angles)])
    crossing = [(tuple(15.0 - 5.0 * one), tuple(15.0 + 5.0 * one)) for one in along]
    state = dc.find_contacts(circles_at([[15.0, 15.0 + 0.3]], segments=crossing))
    assert state.contacts.body_b.tolist() == list(range(5, 205))
