"""Circles that move far in one step: each pushes the first body in its way, and none gets out of the box."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.solvers import METHODS
from deep_contact.stepping.continuous import any_apart, middle_of
from deep_contact.studies.hard_scenes import loaded_silo

SMOOTH = 1e-12
"""Friction that turns no circle measurably. Without friction, each solver has steps of a kind of its own to compile."""

NO_GRAVITY = dc.World(box=(0, 0, 60, 40), gravity=(0, 0))
EMPTY = dc.World(box=(-1e5, -1e5, 1e5, 1e5), gravity=(0, 0), friction=SMOOTH)
ELASTIC = replace(NO_GRAVITY, restitution=1.0, friction=0.0)
SOLVERS = {name: METHODS[name]() for name in METHODS}


def scene(position, velocity, *, radius=1.0, world=NO_GRAVITY, **options):
    return dc.State(
        name="fast", world=world, bodies=dc.make_bodies(position, velocity=velocity, radius=radius, **options)
    )


def inside(state):
    box, position = np.array(state.world.box), state.bodies.position
    return bool(((position > box[:2]) & (position < box[2:])).all())


LINE, END = ((8.51, 15.0), (8.51, 25.0)), ((8.51, 20.0), (15.0, 20.0))
# The circle is touched at a distance of 1.9975 m, after 0.6025 of 1.9 m; both go on with half of the rate.
PUSHED = 9.5 - 1.9975 + 0.5 * (1.9 - 0.6025)
OBSTACLES = [([[9.5, 20.0]], (), PUSHED, 95.0), ([], [LINE], 7.5025, 0.0), ([], [END], 7.5025, 0.0)]


@pytest.mark.parametrize(("circles", "segments", "place", "speed"), OBSTACLES)
@pytest.mark.parametrize("name", SOLVERS)
def test_a_fast_circle_pushes_where_it_touches_and_hits_in_the_next_step(name, circles, segments, place, speed):
    # By hand: 1.9 m a step from x = 5 touches the circle, the line or its end after 2.5 m, in the second step.
    velocity = [[190.0, 0.0]] + [[0.0, 0.0]] * len(circles)
    state = scene([[5.0, 20.0], *circles], velocity, world=replace(NO_GRAVITY, segments=segments, friction=0.3))
    first = dc.simulate(state, steps=1, solver=SOLVERS[name]).state
    np.testing.assert_allclose(first.bodies.position[0], [6.9, 20.0], rtol=1e-12)
    second = dc.simulate(first, steps=1, solver=SOLVERS[name]).state
    np.testing.assert_allclose(second.bodies.position[0], [place, 20.0], rtol=1e-12)
    np.testing.assert_allclose(second.bodies.velocity[0], [190.0, 0.0])
    assert second.contacts.count == 1
    third = dc.simulate(second, steps=1, solver=SOLVERS[name]).state
    np.testing.assert_allclose(third.bodies.velocity[:, 0], speed, atol=1e-6 * 190)


@pytest.mark.parametrize("frame", [0.0, 1000.0, -64.0])
def test_a_push_is_the_same_in_every_frame_and_keeps_the_centre_of_mass(frame):
    # Touch after 1.5025 of 1.9 m; then 1.9 / (1 + m) m a step for both.
    for mass in (1.0, 3.0):
        state = scene([[0.0, 0.0], [3.5, 0.0]], [[190.0 + frame, 0.0], [frame, 0.0]], mass=[1.0, mass], world=EMPTY)
        x = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position[:, 0]
        rest = (1.9 - 1.5025) / (1.0 + mass)
        np.testing.assert_allclose(x - 0.01 * frame, [1.5025 + rest, 3.5 + rest], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", [*SOLVERS, "divided"])
def test_circles_that_touch_and_fly_together_are_free(name):
    # At half a slop of overlap, exactly where a touch leaves a pair.
    solver = SOLVERS.get(name, dc.PGS(most_substeps=4))
    state = scene([[0.0, 0.0], [1.9975, 0.0]], [[60.0, 0.0], [60.0, 0.0]], world=EMPTY)
    after = dc.simulate(state, steps=100, solver=solver).state
    np.testing.assert_allclose(after.bodies.position - state.bodies.position, [[60.0, 0.0]] * 2, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", SOLVERS)
def test_a_clump_that_is_thrown_stays_together_in_every_frame(name, seed):
    # They wobble by less than a touch needs. The centre of mass goes straight on, and nobody stays behind.
    rng = np.random.default_rng(seed)
    side, speed = int(rng.integers(2, 6)), rng.uniform(40.0, 1000.0)
    position = 1.9975 * np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)
    wobble = rng.normal(0.0, 0.3 * (seed % 2), (side**2, 2))
    throw, found = speed * np.array([np.cos(seed), np.sin(seed)]), []
    for frame in (0.0, 1.0):
        state = scene(position, wobble + frame * throw, world=EMPTY)
        found.append(dc.simulate(state, steps=50, solver=SOLVERS[name]).state.bodies.position - 0.5 * frame * throw)
        np.testing.assert_allclose(found[-1].mean(axis=0), position.mean(axis=0) + 0.5 * wobble.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9 * 0.5 * speed)


@pytest.mark.parametrize("solver", [dc.PGS(), dc.BatchedPGS()], ids=["PGS", "BatchedPGS"])
@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize("speed", [100.0, 300.0, 1000.0])
@pytest.mark.parametrize("fixed", [False, True])
def test_no_oblique_hit_of_fast_circles_is_lost(fixed, speed, e, solver):
    """Forty pairs, at every impact parameter and time within the step: v_n⁺ = −e v_n and v_t⁺ = v_t, to the slop.

    If they slid along their tangents for the rest of the step, they would be apart at its end, without an impulse.
    """
    rng, dt = np.random.default_rng(5), 0.01
    b, phase, angle = rng.uniform(-0.8, 0.8, 40), rng.uniform(0.0, 3.0, 40), rng.uniform(0.0, 2.0 * np.pi, 40)
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    left = np.column_stack([-along[:, 1], along[:, 0]])
    deep, b = np.sqrt(1.0 - b**2)[:, None], b[:, None]
    middle = 4000.0 * np.column_stack([np.arange(40) // 8, np.arange(40) % 8])
    comes = middle - (2.0 * deep + (phase * speed * dt)[:, None]) * along + 2.0 * b * left
    state = circles_at(
        np.concatenate([comes, middle]), velocity=np.concatenate([speed * along, np.zeros((40, 2))]), radius=1.0,
        fixed=np.arange(80) >= 40 if fixed else False, gravity=(0.0, 0.0), friction=SMOOTH, restitution=e,
        box=(-1e5, -1e5, 1e5, 1e5), dt=dt,
    )  # fmt: skip
    after = dc.simulate(state, steps=8, solver=solver).state.bodies.velocity
    normal, tangent = deep * along - b * left, b * along + deep * left
    rebound = -e if fixed else 0.5 * (1.0 - e)
    np.testing.assert_allclose(after[:40], speed * (rebound * deep * normal + b * tangent), atol=0.1 * speed)


@pytest.mark.parametrize("e", [0.0, 0.5])
@pytest.mark.parametrize("place", ["end", "edge"])
@pytest.mark.parametrize("carried", [(0.0, 0.0), (300.0, -200.0)])
def test_no_oblique_hit_at_the_end_of_a_segment_is_lost(carried, place, e):
    """A circle that slides past the end has left the segment at the end of the step. Also a segment that moves."""
    carried = np.array(carried)
    # At the end the normal is that of the point. At the edge the circle hits 0.3 m before the end, and slides past it.
    normal = np.array([0.6, 0.8]) if place == "end" else np.array([0.0, 1.0])
    touch = 1.01 * normal if place == "end" else np.array([-0.3, 1.01])
    velocity = np.array([700.0, -700.0]) if place == "edge" else np.array([200.0, -900.0])
    moving = {"segments": [((-20.0, 0.0), (0.0, 0.0))], "segment_velocities": [(tuple(carried), tuple(carried))]}
    world = replace(EMPTY, restitution=e, **moving)
    for phase in (0.3, 1.6):
        state = scene([touch - phase * 0.01 * velocity], [velocity + carried], world=world)
        after = dc.simulate(state, steps=5, solver=dc.PGS()).state.bodies.velocity[0] - carried
        right = velocity - (1.0 + e) * (velocity @ normal) * normal
        np.testing.assert_allclose(after, right, atol=20.0)


def test_a_fast_circle_that_meets_a_wall_keeps_its_velocity_and_its_way_along_the_wall():
    # 1 m of 1.9 m to the skin of the wall. At e = 0 nothing changes the momentum but impulses and gravity.
    world = replace(NO_GRAVITY, gravity=(0.0, -10.0))
    state = dc.simulate(scene([[57.99, 20.0]], [[190.0, 0.0]], world=world), steps=1, solver=dc.PGS()).state
    np.testing.assert_allclose(state.bodies.velocity[0], [190.0, -0.1], rtol=1e-12)
    np.testing.assert_allclose(state.bodies.position[0], [60 - 1 - 0.01 + 0.0025, 20 - 0.001], rtol=1e-12)


@pytest.mark.parametrize("restitution", [0.5, 1.0])
@pytest.mark.parametrize("pushed", [False, True])
@pytest.mark.parametrize("turned", [0.0, 0.6])
def test_what_is_held_early_keeps_the_energy_of_its_height(restitution, pushed, turned):
    # From 9 m above the floor at 150 m/s: it misses most of a step's way. Leapfrog: ½ (v + g Δt / 2)² + g y is kept.
    # Turned: with a slope, on which only the speed along its normal changes.
    g, dt, line = 9.81, 0.01, ()
    if turned:
        line = [((60.0 - 40.0 * np.cos(turned), 20.0 - 40.0 * np.sin(turned)), (60.0, 20.0))]
    world = dc.World(
        box=(-500, 0, 500, 100),
        gravity=(0, 0 if pushed else -g),
        friction=SMOOTH,
        restitution=restitution,
        segments=line,
    )
    state = scene([[40.0, 15.3]], [[0.0, -150.0]], world=world)
    force = (state.bodies.mass[0] * np.array([[0.0, -g]]), [0.0]) if pushed else None
    run = dc.simulate(state, steps=60, record=1, solver=dc.PGS(), push=force)
    x, v = run.trajectory.positions[:, 0], run.trajectory.velocities[:, 0] - [0.0, 0.5 * g * dt]
    energy = 0.5 * (v**2).sum(axis=1) + g * x[:, 1]
    hit = int(np.argmax(np.abs(np.diff(run.trajectory.velocities[:, 0, 1])) > 1.0))
    np.testing.assert_allclose(energy[: hit + 1], energy[0], rtol=1e-9)
    if restitution == 1.0:
        np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


def test_a_circle_meets_what_has_stopped_before_it():
    # The second follows the first at the same speed, 2.5 m behind, and would never touch it; the first stops at the
    # wall after 0.5 m, so the second may go 1 m.
    state = scene([[58.49, 20.0], [55.99, 20.0]], [[190.0, 0.0], [190.0, 0.0]])
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state
    np.testing.assert_allclose(after.bodies.position[:, 0], [58.9925, 56.995], rtol=1e-12)


def test_touches_of_one_time_have_no_order():
    # One between two, and a symmetric wedge: mirrored to rounding, whatever the order of the circles.
    for order in ([0, 1, 2], [1, 0, 2], [2, 1, 0]):
        position = np.array([[29.0, 20.0], [31.0, 20.0], [30.0, 25.0]])[order]
        velocity = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, -400.0]])[order]
        x = dc.simulate(scene(position, velocity), steps=1, solver=dc.PGS()).state.bodies.position
        left, right, top = x[[order.index(k) for k in range(3)]]
        np.testing.assert_allclose([left[0] + right[0], left[1] - right[1], top[0]], [60.0, 0.0, 30.0], atol=1e-12)
        assert left[1] < 20.0
        assert top[1] > left[1]


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0], [1, 2, 0]])
@pytest.mark.parametrize("rest", ["segment", "circle"])
def test_what_moves_fast_carries_circles_up_to_what_rests(rest, order):
    # 10 m a step: the wall carries three, which stop one after the other before what rests at x = 8, and passes over.
    lines, velocities = [((0, -9), (0, 9)), ((8, -9), (8, 9))], [((1000, 0), (1000, 0)), ((0, 0), (0, 0))]
    place, fixed, stop = np.array([[2.0, 0.0], [4.1, 0.0], [6.2, 0.0]])[order], [False] * 3, 6.9925
    if rest == "circle":
        lines, velocities, stop = lines[:1], velocities[:1], 9.0 - 1.9975
        place, fixed = np.concatenate([place, [[9.0, 0.0]]]), [*fixed, True]
    world = replace(EMPTY, segments=lines, segment_velocities=velocities)
    for solver in (dc.PGS(), dc.BatchedPGS()):
        state = scene(place, np.zeros_like(place), world=world, fixed=fixed)
        with pytest.warns(UserWarning, match="a moving segment passes over circle"):
            after = dc.simulate(state, steps=5, solver=solver).state
        stops = stop - 1.9975 * (2 - np.array(order))
        np.testing.assert_allclose(after.bodies.position[:3, 0], stops, atol=0.02)


@pytest.mark.parametrize("rest", ["segment", "wall", "circle", "wedge"])
def test_a_moving_segment_passes_over_what_is_held_in_its_way(rest):
    # At 0.5 m/s, and so once: the circle never gets through what rests, and is not shot away.
    lines, velocities, box = [((0, -5), (0, 5))], [((0.5, 0), (0.5, 0))], (-50, -50, 50, 50)
    position, radius, fixed = [[1.5, 0.0]], [0.5], [False]
    if rest == "segment":
        lines, velocities = [*lines, ((3, -5), (3, 5))], [*velocities, ((0, 0), (0, 0))]
    elif rest == "wedge":
        lines += [((3.5, 0), (2.5, -1)), ((3.5, 0), (2.5, 1))]
        velocities = [*velocities, ((0, 0), (0, 0)), ((0, 0), (0, 0))]
    elif rest == "circle":
        position, radius, fixed = [[1.5, 0.0], [4.0, 0.0]], [0.5, 1.0], [False, True]
    else:
        box = (-50, -50, 3, 50)
    world = dc.World(box=box, gravity=(0, 0), friction=0.3, segments=lines, segment_velocities=velocities)
    state = dc.State(name="press", world=world, bodies=dc.make_bodies(position, radius=radius, fixed=fixed))
    with pytest.warns(UserWarning, match="passes over circle 0") as said:
        run = dc.simulate(state, steps=1204, record=1, solver=dc.PGS())
    assert len(said) == 1
    x, speed = run.trajectory.positions[:, 0, 0], np.abs(run.trajectory.velocities[:, 0]).max()
    assert x.max() <= (2.9 if rest == "wedge" else 2.5)
    assert speed <= 0.6
    assert run.state.world.segments[0][0] > 6.0


@pytest.mark.parametrize("angle", [0.5 * np.pi, np.pi, -0.5 * np.pi, 0.8])
def test_a_moving_segment_passes_over_what_is_held_whichever_way_it_goes(angle):
    """At 5 m/s. A second circle, which nothing holds, goes on in front of it."""
    along = np.array([np.cos(angle), np.sin(angle)])
    left = np.array([-along[1], along[0]])
    ends = [(at * along - 5.0 * left, at * along + reach * left) for at, reach in ((0.0, 5.0), (3.0, 1.0))]
    lines = [tuple(map(tuple, line)) for line in ends]
    world = dc.World(
        box=(-50, -50, 50, 50), gravity=(0, 0), friction=SMOOTH, segments=lines,
        segment_velocities=[(tuple(5.0 * along), tuple(5.0 * along)), ((0, 0), (0, 0))],
    )  # fmt: skip
    place = [1.5 * along - 2.0 * left, 1.5 * along + 3.0 * left]
    state = dc.State(name="press", world=world, bodies=dc.make_bodies(place, radius=0.5))
    with pytest.warns(UserWarning, match="passes over circle 0"):
        run = dc.simulate(state, steps=120, record=1, solver=dc.PGS())
    way = run.trajectory.positions @ along
    assert way[:, 0].max() <= 2.51
    assert way[-1, 1] > 6.0
    assert np.abs(run.trajectory.velocities).max() <= 5.1


def test_circles_that_fly_together_are_not_held():
    state = scene([[10.0, 20.0], [12.1, 20.0], [14.2, 20.0]], [[190.0, 0.0]] * 3)
    after = dc.simulate(state, steps=10, solver=dc.PGS()).state
    np.testing.assert_allclose(after.bodies.position - state.bodies.position, [[19.0, 0.0]] * 3, atol=1e-9)


def test_small_circles_do_not_slip_between_or_through():
    # A wall of unlike circles across the box; a thousandth as large, and fast, against it from the left.
    y = np.arange(1.0, 40.0, 2.0)
    wall = np.column_stack([np.full(20, 30.0), y])
    bullets = np.column_stack([np.full(20, 25.0), y])
    state = scene(
        np.vstack([wall, bullets]), [[0.0, 0.0]] * 20 + [[95.0, 0.0]] * 20, radius=[1.0] * 20 + [0.001] * 20,
        mass=[1e6] * 20 + [1.0] * 20,
    )  # fmt: skip
    after = dc.simulate(state, steps=30, solver=dc.PGS()).state
    assert (after.bodies.position[20:, 0] < 30.0).all()


@pytest.mark.parametrize("speed", [1.0, 24.0, 49.0])
def test_what_moves_less_than_half_a_radius_is_left_alone(speed):
    # To the last bit it moves by Δt v.
    state = scene([[30.0, 20.0], [40.0, 20.0]], [[speed, 0.0], [0.0, 0.0]])
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state
    np.testing.assert_array_equal(after.bodies.position, state.bodies.position + 0.01 * state.bodies.velocity)


@pytest.mark.parametrize("speed", [1.0, 24.0, 49.0])
def test_circles_that_approach_slowly_are_left_to_their_contact(speed):
    """They meet within the step, beside a fast circle: each moves by Δt v to the last bit, and they overlap."""
    state = scene([[30.0, 20.0], [32.0 + 0.003 * speed, 20.0], [5.0, 5.0]], [[speed, 0.0], [0.0, 0.0], [0.0, 300.0]])
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state
    np.testing.assert_array_equal(after.bodies.position, state.bodies.position + 0.01 * state.bodies.velocity)
    assert after.contacts.count == 1


@pytest.mark.parametrize("segments", [(), [((0.0, 10.0), (60.0, 10.0))]], ids=["wall", "segment"])
def test_a_fast_circle_that_sinks_slowly_onto_what_it_flies_along_is_left_to_its_contact(segments):
    """By 9 mm in a step, less than a hundredth of its radius: it moves by Δt v to the last bit."""
    state = scene(
        [[10.0, 1.012 + (10.0 if segments else 0.0)]], [[190.0, -0.9]], world=replace(NO_GRAVITY, segments=segments)
    )
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state
    np.testing.assert_array_equal(after.bodies.position, state.bodies.position + 0.01 * state.bodies.velocity)
    assert after.contacts.count == 1


@pytest.mark.parametrize("speed", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("seed", range(3))
def test_nothing_gets_out_of_a_closed_box(seed, speed):
    rng = np.random.default_rng(seed)
    state = dc.circles_in_box(40, radius=(0.5, 1.0), restitution=float(rng.choice([0.0, 0.5, 1.0])), seed=seed)
    velocity = speed * rng.normal(size=(40, 2))
    state = state.replace(bodies=state.bodies._replace(velocity=velocity))
    for _ in range(20):
        state = dc.simulate(state, steps=10, solver=dc.PGS(sweeps=20)).state
        assert inside(state)


def test_fast_circles_do_not_change_their_order_in_a_channel():
    # 15 circles at random speeds in a channel that is one circle wide: none passes another.
    rng = np.random.default_rng(8)
    x = np.cumsum(rng.uniform(2.0, 4.0, 15))
    world = replace(ELASTIC, box=(0, 0, x[-1] + 3, 2.02))
    velocity = np.column_stack([rng.normal(0, 1e3, 15), np.zeros(15)])
    state = scene(np.column_stack([x, np.full(15, 1.01)]), velocity, world=world)
    for _ in range(300):
        state = dc.step(state, solver=dc.PGS())
        assert (np.diff(state.bodies.position[:, 0]) > 0).all()
        assert inside(state)


@pytest.mark.parametrize("name", SOLVERS)
def test_what_is_pressed_too_hard_for_the_sweeps_stays_in_the_box(name):
    # A million times as heavy on top: five sweeps hold nothing, and the circles below sink into each other.
    state = loaded_silo(5, 1e6)
    solver = replace(SOLVERS[name], sweeps=5, tolerance=None)
    for _ in range(200):
        state = dc.simulate(state, steps=1, solver=solver).state
        assert inside(state)


@pytest.mark.filterwarnings("ignore:.*outside of the box")
def test_what_begins_outside_comes_in_by_its_contact():
    # Centres 0.1 and 3 m behind the wall: no step puts them inside at once, but they come.
    state = scene([[-0.1, 10.0], [-3.0, 20.0]], [[0.0, 0.0], [0.0, 0.0]])
    after = dc.simulate(state, steps=1, solver=dc.PGS(position_sweeps=1)).state
    np.testing.assert_allclose(after.bodies.position[:, 0], [0.1, -2.8], atol=1e-9)
    assert inside(dc.simulate(after, steps=40, solver=dc.PGS()).state)


def test_restitution_1_keeps_the_energy_of_ten_thousand_bounces_under_gravity():
    # Symplectic Euler keeps ½ m v² + m g y − ½ Δt m g v of a fall, and a bounce at a step's end turns the fall back.
    state = dc.single_body(height=0.3, restitution=1.0, friction=0.5)

    def energy(bodies):
        return 0.5 * bodies.velocity[0, 1] ** 2 + 9.81 * (bodies.position[0, 1] - 0.01 * bodies.velocity[0, 1])

    run = dc.simulate(state, steps=255_000, dt=0.02, solver=dc.PGS(sweeps=2))
    assert (run.contacts > 0).sum() > 10_000
    assert abs(energy(run.state.bodies) / energy(state.bodies) - 1) < 1e-9


def test_a_circle_that_leaves_a_wall_is_struck_back_to_it_and_rebounds():
    # They swap ±1 and ∓3 m/s, and the wall returns the 3: momentum and energy of each blow alone.
    state = scene([[1.0, 15.0], [3.0, 15.0]], [[1.0, 0.0], [-3.0, 0.0]], world=ELASTIC)
    solution = dc.solve_contacts(state, solver=dc.PGS(sweeps=200))
    np.testing.assert_allclose(solution.velocities[:, 0], [1.0, 3.0], atol=1e-12)


@pytest.mark.parametrize("gap", [0.0, 0.2])
def test_newtons_cradle_hands_its_speed_on(gap):
    # Blows follow one another, with gaps between the balls over steps, without gaps in one step.
    x = 5.0 + np.array([0.0, *(6.0 + (2.0 + gap) * np.arange(4))])
    state = scene(np.column_stack([x, np.full(5, 20.0)]), [[5.0, 0.0]] + [[0.0, 0.0]] * 4, world=ELASTIC)
    state = dc.simulate(state, steps=150, solver=dc.PGS(sweeps=1000, tolerance=None)).state
    np.testing.assert_allclose(state.bodies.velocity[:, 0], [0, 0, 0, 0, 5], atol=1e-9)


@pytest.mark.parametrize("speed", [120.0, 900.0])
@pytest.mark.parametrize("seed", range(3))
def test_every_pair_that_flies_at_each_other_meets_wherever_it_is(seed, speed):
    """Forty pairs, in all directions and at all distances; each is ordered along its line as before the step."""
    rng, dt = np.random.default_rng(seed), 0.01
    cells = rng.permutation(64)[:40]
    middle = 30.0 * np.column_stack([cells // 8, cells % 8]) + rng.uniform(-4.0, 4.0, (40, 2)) + 30.0
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, 40), rng.uniform(0.05, 1.0, (40, 2))
    along, share = np.column_stack([np.cos(angle), np.sin(angle)]), rng.uniform(0.0, 1.0, 40)
    gap = rng.uniform(0.1, 0.9, 40) * speed * dt
    apart = (radius.sum(axis=1) + gap)[:, None] * along
    velocity = np.concatenate([(share * speed)[:, None] * along, -((1.0 - share) * speed)[:, None] * along])
    state = circles_at(
        np.concatenate([middle - 0.5 * apart, middle + 0.5 * apart]), radius=radius.T.ravel(), velocity=velocity,
        gravity=(0.0, 0.0), friction=0.0, restitution=1.0, box=(0.0, 0.0, 300.0, 300.0), dt=dt,
    )  # fmt: skip
    after = dc.simulate(state, steps=2, solver=dc.PGS(), record=1).trajectory.positions[1:]
    for position in after:
        distance = np.einsum("ij,ij->i", position[40:] - position[:40], along)
        assert (distance > 0.9 * radius.sum(axis=1)).all()


@pytest.mark.parametrize("overlap", [0.3, 1.2])
@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_what_is_deep_in_another_and_fast_does_not_pass_it(overlap, angle):
    """Nor the wall in which it begins."""
    along = np.array([np.cos(angle), np.sin(angle)])
    centres = np.add([30.0, 20.0], np.outer([0.0, 2.0 - overlap], along))
    run = dc.simulate(scene(centres, np.outer([150.0, -100.0], along)), steps=6, solver=dc.PGS(), record=1).trajectory
    assert (np.einsum("tj,j->t", run.positions[:, 1] - run.positions[:, 0], along) > 0.0).all()
    beside = scene([[1.0 - 0.5 * overlap, 20.0]], [[-150.0, 0.0]])
    assert (dc.simulate(beside, steps=6, solver=dc.PGS(), record=1).trajectory.positions[..., 0] > 0.0).all()


def test_velocities_of_a_solution_are_of_discs_of_any_radius():
    """I ω = r P_t: of a disc of 0.25 m that is thrown along the floor."""
    state = dc.find_contacts(scene([[20.0, 0.25]], [[3.0, -1.0]], radius=0.25, world=replace(NO_GRAVITY, friction=0.5)))
    solution = dc.solve_contacts(state, solver=dc.PGS())
    p_n, p_t, (mass,), (inertia,) = *solution[:2], state.bodies.mass, state.bodies.inertia
    arm = 0.25 + 0.5 * state.contacts.separation[0]
    assert p_n[0] == pytest.approx(mass * 1.0, rel=1e-6)
    assert abs(p_t[0]) == pytest.approx(min(0.5 * p_n[0], 3.0 / (1.0 / mass + arm**2 / inertia)), rel=1e-6)
    assert solution.angular_velocities[0] == pytest.approx(-arm * abs(p_t[0]) / inertia, rel=1e-6)
    np.testing.assert_allclose(solution.velocities, [[3.0 - abs(p_t[0]) / mass, 0.0]], atol=1e-6)


@pytest.mark.parametrize("gravity", [(0.0, -9.81), (7.0, -3.0), (-9.81, 0.0), (2.0, 9.0)])
@pytest.mark.parametrize("velocity", [(70.0, 45.0), (-150.0, 80.0)])
def test_elastic_bounces_of_a_fast_circle_keep_their_energy_however_gravity_lies(gravity, velocity):
    """½ v² − g · x, with v half a step later: velocities of the leapfrog are those of half a step before."""
    world = replace(ELASTIC, gravity=gravity)
    run = dc.simulate(scene([[25.0, 17.0]], [velocity], world=world), steps=300, solver=dc.PGS(), record=1).trajectory
    late = run.velocities[:, 0] + 0.5 * 0.01 * np.array(gravity)
    energy = 0.5 * (late**2).sum(axis=1) - run.positions[:, 0] @ gravity
    np.testing.assert_allclose(energy, energy[0], rtol=2e-5)
    assert np.count_nonzero(np.abs(np.diff(run.velocities[:, 0], axis=0)).max(axis=1) > 1.0) > 5


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("way", [-1, 1])
def test_a_fast_circle_meets_what_is_many_cells_away_in_a_crowd_of_small_ones(axis, way):
    """10 m a step along a row that is empty but for one circle, 8 m away."""
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    row = grid[:, 1 - axis] == 7.0
    line = np.array([[10.0 - 5.0 * way, 7.0], [10.0 + 3.0 * way, 7.0]])[:, :: 1 - 2 * axis]
    speeds = np.zeros((len(grid[~row]) + 2, 2))
    speeds[-2, axis] = 1000.0 * way
    state = scene(np.concatenate([grid[~row], line]) + 5.0, speeds, radius=0.1)
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position[-2:, axis]
    assert (after[1] - after[0]) * way > 0.1
    assert (after[0] - line[0, axis] - 5.0) * way > 7.0


@pytest.mark.parametrize("signs", [(-1, -1), (-1, 1), (1, -1), (1, 1)])
@pytest.mark.parametrize("first", [0, 1])
def test_a_fast_circle_that_flies_into_a_corner_meets_the_nearer_wall_first(signs, first):
    """Of a box of 60 m × 40 m: after half of its way it touches one wall, after three quarters it would the other."""
    gaps = np.array([3.0, 3.0])
    gaps[first] = 2.0
    corner = np.where(np.array(signs) > 0, [60.0, 40.0], 0.0)
    state = scene([corner - np.array(signs) * (1.0 + gaps)], [np.array(signs) * 400.0])
    run = dc.simulate(state, steps=3, solver=dc.PGS(), record=1).trajectory
    sunk = 1.0 - np.abs(corner - run.positions[:, 0])
    assert sunk.max() < 0.02
    assert run.positions[1, 0, first] == pytest.approx(corner[first] - signs[first], abs=0.02)


@pytest.mark.parametrize("count", [3, 12])
def test_a_fast_fixed_circle_carries_all_that_it_meets(count):
    """A roller of 2 m flies 8 m in a step, and meets small circles one after the other: none is behind it then.

    The other 200 circles are at rest, so that the small ones are not fast relative to the mean motion.
    """
    met = np.column_stack([22.5 + 0.5 * np.arange(count), np.linspace(18.8, 21.2, count)])
    others = np.stack(np.meshgrid(np.arange(50.0, 55.0), np.arange(0.5, 40.0, 0.99)), axis=-1).reshape(-1, 2)
    place = np.vstack([[20.0, 20.0], met, others])
    n, velocity = len(place), np.zeros((len(place), 2))
    velocity[0] = 800.0, 0.0
    state = scene(place, velocity, radius=np.append(2.0, np.full(n - 1, 0.2)), fixed=np.arange(n) == 0)
    position = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position
    assert np.all(np.hypot(*(position[1:] - position[0]).T) > 2.1)
    assert not np.any((position[1:, 0] < 28.0) & (np.abs(position[1:, 1] - 20.0) < 2.1))


@pytest.mark.parametrize("rate", [0.6, 0.9, 1.4])
@pytest.mark.parametrize("what", ["wall", "segment"])
def test_a_circle_that_moves_by_little_more_than_half_its_radius_is_held_at_what_it_meets(what, rate):
    """A circle of 1 m, with `rate` metres a step, a fifth of a step before it touches."""
    line = [((55.0, 10.0), (55.0, 30.0))] if what == "segment" else ()
    end = (55.0 if line else 60.0) - 1.01 + 0.0025
    state = scene([[end - 0.2 * rate, 20.0]], [[100.0 * rate, 0.0]], world=replace(NO_GRAVITY, segments=line))
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state
    assert after.bodies.position[0, 0] == pytest.approx(end, rel=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, 2.1, -0.7])
@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("share", [0.03, 0.5, 0.97])
def test_a_fast_circle_touches_a_segment_anywhere_along_it(share, side, angle):
    """Also close to its ends. It keeps its way along the segment."""
    along = np.array([np.cos(angle), np.sin(angle)])
    out, middle = side * np.array([-along[1], along[0]]), np.array([30.0, 20.0])
    line = [(tuple(middle - 5.0 * along), tuple(middle + 5.0 * along))]
    inwards = np.sign(0.5 - share) or 1.0
    start = middle + (10.0 * share - 5.0) * along + 2.3 * out
    velocity = 30.0 * inwards * along - 190.0 * out
    state = scene([start], [velocity], world=replace(NO_GRAVITY, segments=line))
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position[0] - start
    np.testing.assert_allclose([after @ along, after @ out], [0.3 * inwards, 1.01 - 0.0025 - 2.3], atol=1e-12)


FAR = np.column_stack([np.linspace(-900.0, 900.0, 60), np.full(60, -900.0)])
"""Circles at rest. With them the mean motion is so small that what rests does not search: only what moves does."""


def test_what_a_fast_paddle_has_met_pushes_on_with_its_speed():
    """5 m a step: the paddle holds a disc after 1.0025 m, and this disc, which counts as infinite, holds the next."""
    place = np.concatenate([[[0.0, 0.0], [3.0, 0.0], [6.0, 0.0]], FAR])
    velocity = np.zeros_like(place)
    velocity[0, 0] = 500.0
    state = scene(place, velocity, world=EMPTY, fixed=np.arange(len(place)) == 0)
    x = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position[:3, 0]
    np.testing.assert_allclose(x, 5.0 + 1.9975 * np.arange(3), atol=1e-9)


def test_a_ball_that_a_fast_paddle_meets_keeps_its_energy_in_the_frame_of_the_paddle():
    """e = 1. Under gravity, ½ (v + g Δt / 2)² − g · x is kept, relative to a paddle of constant velocity."""
    gravity, paddle = np.array([3.0, -9.81]), np.array([0.0, 300.0])
    place, velocity = np.concatenate([[[0.0, 0.0], [0.0, 4.6]], FAR]), np.zeros((62, 2))
    velocity[0] = paddle
    world = replace(EMPTY, gravity=tuple(gravity), restitution=1.0)
    state = scene(place, velocity, world=world, fixed=np.arange(62) == 0)
    run = dc.simulate(state, steps=4, record=1, solver=dc.PGS())
    late = run.trajectory.velocities[:, 1] + 0.005 * gravity - paddle
    way = run.trajectory.positions[:, 1] - run.trajectory.times[:, None] * paddle
    energy = 0.5 * (late**2).sum(axis=1) - way @ gravity
    assert late[-1, 1] > 0.0 > late[0, 1]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


def test_the_middle_of_points_is_that_of_their_bounding_box():
    points = np.array([[0.0, 7.0], [2.0, -1.0], [1.0, 0.0], [9.0, 9.0]])
    assert middle_of(points, 3) == (1.0, 3.0)
    assert middle_of(points[::-1].copy(), 4) == (4.5, 4.0)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_circles_search_each_other_only_if_they_move_apart_from_the_middle_of_all(axis, way):
    """One of 1 m has to differ from it by a quarter of its radius in a step of 0.01 s: 25 m/s."""
    radius, velocity = np.array([1.0, 2.0]), np.array([[300.0, -40.0], [300.0, -40.0]])
    for difference, apart in ((0.0, False), (48.0, False), (52.0, True)):
        moved = velocity.copy()
        moved[0, axis] += way * difference
        assert any_apart(moved, radius, 0.01) == apart


@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi])
@pytest.mark.parametrize("share", [0.1, 0.9])
@pytest.mark.parametrize("ends", [1, -1])
def test_a_fast_wall_holds_what_it_only_just_reaches(ends, share, angle):
    """It moves 5 m a step. Without a touch it would end the step 1 m before the centre; a touch is at 1.0075 m.

    share: place along the wall. ends: which end of the segment is the first.
    """
    along = np.round([np.cos(angle), np.sin(angle)])
    left = np.array([-along[1], along[0]])
    line = np.array([-5.0 * left, 5.0 * left])[::ends]
    world = replace(EMPTY, segments=[tuple(map(tuple, line))], segment_velocities=[(tuple(500.0 * along),) * 2])
    state = scene([6.0 * along + (10.0 * share - 5.0) * left], [[0.0, 0.0]], world=world)
    moved = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position[0] - state.bodies.position[0]
    np.testing.assert_allclose([moved @ along, moved @ left], [0.0075, 0.0], atol=1e-9)


def crowd(seed, e, along):
    """Fast circles, three of them fixed, among walls of which two move, as (scene, …): x goes along a unit vector."""
    rng, turn = np.random.default_rng(seed), np.array([along, [-along[1], along[0]]])
    place = np.stack(np.meshgrid(np.arange(-3.0, 4.0), np.arange(-2.0, 3.0)), axis=-1).reshape(-1, 2)
    place, n = 2.5 * place + rng.uniform(-0.3, 0.3, place.shape), len(place)
    fixed, velocity = np.isin(np.arange(n), [8, 17, 26]), rng.normal(0.0, 300.0, (n, 2))
    velocity[[8, 17]] = 0.0
    lines = [((-9, -7), (-5, -9)), ((-5, -9), (-1, -8)), ((8, 9), (3, 7)), ((-11, -6), (-10, 6)), ((7, -9), (10, -9))]
    moves = [((0, 0), (0, 0)), ((0, 0), (0, 0)), ((0, 0), (0, 0)), ((400, 0), (300, 100)), ((0, 300), (-50, 300))]
    world = dc.World(
        box=(-12, -12, 12, 12), gravity=tuple(np.array([30.0, -90.0]) @ turn), friction=SMOOTH, restitution=e,
        segments=np.array(lines) @ turn, segment_velocities=np.array(moves) @ turn,
    )  # fmt: skip
    return scene(
        place @ turn, velocity @ turn, radius=rng.uniform(0.4, 0.9, n), mass=rng.uniform(0.5, 5.0, n), fixed=fixed,
        world=world,
    ), turn  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*passes over circle")
@pytest.mark.parametrize("along", [(0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
@pytest.mark.parametrize("e", [0.0, 0.8])
@pytest.mark.parametrize("seed", range(4))
def test_a_fast_crowd_moves_alike_whichever_way_it_is_turned(seed, e, along):
    """By quarters of a turn, with all that is in it. Two steps, of some metres each."""
    ways = []
    for direction in ((1.0, 0.0), along):
        state, turn = crowd(seed, e, direction)
        after = dc.simulate(state, steps=2, solver=dc.PGS()).state.bodies
        assert np.abs(after.position - state.bodies.position).max() > 2.0
        ways.append((after.position @ turn.T, after.velocity @ turn.T))
    np.testing.assert_allclose(ways[1][0], ways[0][0], atol=1e-7)
    np.testing.assert_allclose(ways[1][1], ways[0][1], atol=1e-5)


TURNS = [np.array([along, [-along[1], along[0]]]) for along in ([1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0])]
"""Rows are the unit vectors along which x and y go, turned by quarters."""


@pytest.mark.parametrize("turn", TURNS)
def test_a_circle_that_slides_off_a_segment_goes_on_to_the_wall_on_which_the_segment_ends(turn):
    """8 m along the segment and 2 m down in a step: it touches the segment at x = 18.87, and then the wall."""
    world = dc.World(box=(-20, -20, 20, 20), gravity=(0, 0), segments=[([[10.0, -10.0], [20.0, -10.0]] @ turn)])
    state = scene([[14.9, -8.0]] @ turn, [[800.0, -200.0]] @ turn, world=world)
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position @ turn.T
    np.testing.assert_allclose(after, [[20.0 - 1.0075, -10.0 + 1.0075]], atol=1e-9)


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("ends", [1, -1])
@pytest.mark.parametrize("ground", ["segment", "wall"])
def test_a_fast_circle_does_not_feel_the_end_of_a_segment_that_lies_on_what_it_slides_along(ground, ends, turn):
    """It lies 4 mm deep, where an end that stood alone would be touched, and goes 8 m in a step."""
    lines = [[[10.0, 0.0], [20.0, 0.0]][::ends]]
    if ground == "segment":
        lines.append([[0.0, 0.0], [10.0, 0.0]])
    corners = np.array([[-30.0, -30.0 if ground == "segment" else 0.0], [30.0, 30.0]]) @ turn
    world = replace(EMPTY, box=(*corners.min(axis=0), *corners.max(axis=0)), segments=np.array(lines) @ turn)
    state = scene([[5.0, 1.006]] @ turn, [[800.0, 0.0]] @ turn, world=world)
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position @ turn.T
    np.testing.assert_allclose(after, [[13.0, 1.006]], atol=1e-9)


@pytest.mark.parametrize("turn", TURNS)
def test_a_fast_circle_that_slides_into_a_wedge_stops_where_it_touches_both_sides(turn):
    """Of 60°. It touches the lower side after half of the step, and then goes 15 m along it."""
    lines = np.array([[[0.0, 0.0], [40.0, 0.0]], [[0.0, 0.0], [20.0, 20.0 * np.sqrt(3.0)]]]) @ turn
    state = scene([[20.0, 1.5]] @ turn, [[-3000.0, -100.0]] @ turn, world=replace(EMPTY, segments=lines))
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position @ turn.T
    np.testing.assert_allclose(after, [[1.0075 * np.sqrt(3.0), 1.0075]], atol=1e-9)


@pytest.mark.parametrize("angle", np.linspace(0.1, 6.2, 24))
@pytest.mark.parametrize("place", ["beside", "end"])
def test_a_circle_that_lies_on_a_segment_is_held_by_it_when_a_fast_circle_hits_it(place, angle):
    """4 mm deep, more than at a touch. The rounding of its distance does not decide whether the segment holds it."""
    along = np.array([np.cos(angle), np.sin(angle)])
    out = np.array([-along[1], along[0]])
    if place == "end":
        out, along = along, -out
    line = [-9.0 * out, 0.0 * out] if place == "end" else [-5.0 * along, 4.0 * along]
    state = scene([1.006 * out, 4.3 * out], [0.0 * out, -300.0 * out], world=replace(EMPTY, segments=[line]))
    after = dc.simulate(state, steps=1, solver=dc.PGS()).state.bodies.position
    np.testing.assert_allclose(after @ out, [1.006, 1.006 + 1.9975], atol=1e-9)
