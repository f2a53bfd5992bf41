"""Kinematics and external forces: moving segments, fixed circles, pushes. All fast tests share one compiled kind."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at
from scipy.optimize import brentq

import deep_contact as dc
from deep_contact.run.simulator import Simulator
from deep_contact.stepping.metrics import row_velocities

PGS = dc.PGS(sweeps=60, tolerance=None)
FREE = {"gravity": (0.0, 0.0), "friction": 0.3, "box": (-50.0, -50.0, 50.0, 50.0)}


def plate(velocity, *, at=(0.0, 0.0), along=(0.0, 1.0), half=10.0):
    """A segment around a point, along a unit vector, both of whose ends have this velocity: options of `World`."""
    at, along = np.array(at), np.array(along)
    return {"segments": [(at - half * along, at + half * along)], "segment_velocities": [(velocity, velocity)]}


@pytest.mark.parametrize("dt", [0.001, 0.01, 0.03])
@pytest.mark.parametrize("angle", [0.0, 0.6, 2.2])
@pytest.mark.parametrize(("restitution", "times"), [(0.0, 1.0), (0.5, 1.5), (1.0, 2.0)])
def test_a_piston_gives_its_velocity_times_one_and_e(restitution, times, angle, dt):
    # Newton's law against what has infinite mass: v = (1 + e) V.
    normal = np.array([math.cos(angle), math.sin(angle)])
    piston = plate(2.0 * normal, along=(-normal[1], normal[0]))
    scene = circles_at([0.6 * normal], radius=0.5, dt=dt, restitution=restitution, **piston, **FREE)
    state = dc.simulate(scene, steps=round(0.3 / dt), solver=PGS).state
    np.testing.assert_allclose(state.bodies.velocity[0], 2.0 * times * normal, atol=1e-6)
    np.testing.assert_allclose(np.reshape(state.world.segments, (2, 2)).mean(axis=0), 2.0 * 0.3 * normal, atol=1e-9)


def test_momentum_that_a_piston_gives_a_pile_is_what_it_receives():
    places = [(0.55 + x, y) for x in range(4) for y in (-1.0, 0.02, 1.1)]
    scene = circles_at(places, radius=0.5, restitution=0.2, **plate((3.0, 0.5)), **FREE)
    run = dc.simulate(scene, steps=40, solver=PGS, record=40, forces=True)
    momentum = run.state.bodies.mass @ run.state.bodies.velocity
    received = run.loads[-1].sum(axis=0)
    assert momentum[0] > 10.0
    np.testing.assert_allclose(momentum, -received, atol=1e-9)
    np.testing.assert_allclose(run.on_circles[-1].sum(axis=0), momentum, atol=1e-9)


def next_hit(height, speed, start, plate_at, g):
    """When a ball at `height` with `speed` at a time meets the plate next: a root of the closed form of its flight."""
    gap = lambda t: height + speed * (t - start) - 0.5 * g * (t - start) ** 2 - plate_at(t)  # noqa: E731
    low = start + 1e-6
    while gap(low + 1e-4) > 0.0:
        low += 1e-4
    return brentq(gap, low, low + 1e-4, xtol=1e-14)


def bounced(height, speed, *, top, restitution, bounces, dt):
    """By the engine and by events: (hits, s, and the apexes after them, m) of a ball on a plate at `height`(t), m.

    The ball falls from `top`, m, at time 0.
    """
    r, g = 0.1, 9.81
    world = {"gravity": (0.0, -g), "restitution": restitution, "friction": 0.3, "box": (-5.0, -5.0, 5.0, 5.0)}
    scales = dc.BOX2D._replace(wall_skin=0.0, restitution_threshold=0.0, slop=1e-6)
    bar = plate((0.0, 0.0), at=(0.0, height(0.0)), along=(1.0, 0.0), half=2.0)
    run = Simulator(circles_at([[0.0, r + top]], radius=r, dt=dt, scales=scales, **bar, **world), solver=PGS)
    hits, apexes, last, k = [], [], 0.0, 0
    while len(apexes) < bounces:
        velocity = (0.0, (height((k + 1) * dt) - height(k * dt)) / dt)
        run.set(segment_velocities=[(velocity, velocity)])
        run.step()
        if last < 0.0 < run.velocities[0, 1]:
            hits.append(run.time)
        if last > 0.0 >= run.velocities[0, 1]:
            apexes.append(run.positions[0, 1] - r)
        last, k = run.velocities[0, 1], k + 1
    expected, y, v, t = [], top, 0.0, 0.0
    for _ in range(bounces):
        hit = next_hit(y, v, t, height, g)
        wall = speed(hit)
        y, v, t = height(hit), wall - restitution * (v - g * (hit - t) - wall), hit
        expected.append((hit, y + v * v / (2.0 * g)))
    return np.array([hits, apexes]), np.transpose(expected)


def test_a_ball_on_a_plate_that_oscillates_bounces_as_by_events():
    # The engine finds a hit up to Δt late: 2e-4 s at 2.4 m/s and less.
    size, omega = 0.02, 2.0 * math.pi
    height, speed = (lambda t: size * math.sin(omega * t)), (lambda t: size * omega * math.cos(omega * t))
    found, expected = bounced(height, speed, top=0.3, restitution=0.4, bounces=3, dt=2e-4)
    np.testing.assert_allclose(found[1], expected[1], atol=3e-4)


@pytest.mark.slow
def test_a_ball_settles_on_the_orbit_of_one_bounce_a_period_as_by_events():
    # It leaves with U = g T / 2 where the plate has W = U (1 − e) / (1 + e). With (A ω² / g) = 1, e = 0.6 it is stable:
    # a deviation shrinks to about e a bounce. The engine's is at most 2 Δt a bounce: Δt for a hit found late, and Δt
    # for its steps of flight, so 2 Δt / (1 − e) = 5 Δt in all. The apex U² / 2 g changes by U (A ω² + e g) / g of it.
    dt, e, g, omega = 1e-3, 0.6, 9.81, 10.0 * math.pi
    size, leaves = g / omega**2, g * 0.1
    phase = math.acos(leaves * (1.0 - e) / (1.0 + e) / (size * omega))
    height = lambda t: size * math.sin(omega * (t - 0.1) + phase)  # noqa: E731
    speed = lambda t: size * omega * math.cos(omega * (t - 0.1) + phase)  # noqa: E731
    top = height(0.1) + leaves**2 / (2.0 * g) + 0.003  # m, off the orbit
    (hits, apexes), (when, expected) = bounced(height, speed, top=top, restitution=e, bounces=50, dt=dt)
    np.testing.assert_allclose(np.diff(when)[-9:], 0.2, atol=1e-6)
    np.testing.assert_allclose(hits, when, atol=5.0 * dt)
    np.testing.assert_allclose(apexes, expected, atol=5.0 * dt * leaves * (1.0 + e))


def test_velocities_set_between_steps_are_those_of_a_world_that_has_them():
    bar = plate((0.0, 1.0), at=(0.0, 0.0), along=(1.0, 0.0), half=2.0)
    state = circles_at([[0.0, 0.15], [0.21, 0.2]], radius=0.1, box=(-5.0, -5.0, 5.0, 5.0), restitution=0.6, **bar)
    run = Simulator(state, solver=PGS)
    for k in range(40):
        velocity = (0.0, 0.0) if k == 20 else (0.1 * (k % 3), math.cos(0.7 * k))
        run.set(segment_velocities=[(velocity, velocity)])
        run.step()
        world = replace(state.world, segment_velocities=[(velocity, velocity)])
        state = dc.simulate(state.replace(world=world), steps=1, solver=PGS).state
        assert run.state == state
    assert np.abs(state.bodies.velocity[:, 0]).max() > 0.01  # only the bar pushes across


def test_a_wall_that_becomes_fast_gets_the_substeps_of_its_preset():
    bar = plate((0.0, 0.1), at=(0.0, 0.0), along=(1.0, 0.0), half=2.0)
    scene = circles_at([[0.0, 0.15]], radius=0.1, box=(-5.0, -5.0, 5.0, 50.0), **bar)
    run = Simulator(scene, accuracy="fast")
    run.step(5)
    before = run.state.solver
    run.set(segment_velocities=[((0.0, 40.0),) * 2])
    assert run.state.solver.substeps > before.substeps
    kept = run._inputs
    run.set(segment_velocities=[((0.0, 20.0),) * 2])  # slower: in place
    assert run._inputs is kept


def test_no_velocities_are_set_where_there_are_no_segments():
    scene = circles_at([[5.0, 1.0], [5.0, 3.2]], mass=[np.inf, 1.0])
    run = Simulator(scene, solver=PGS)
    run.set(segment_velocities=[])
    run.step()
    assert run.state == dc.simulate(scene, steps=1, solver=PGS).state


def test_fixed_circles_stay_and_carry_and_have_no_contacts_among_themselves():
    pegs = circles_at([[4.0, 1.0], [5.9, 1.0], [4.95, 2.75]], fixed=[True, True, False], friction=0.5)
    assert pegs.bodies.is_fixed.tolist() == [True, True, False]
    run = dc.simulate(pegs, steps=200, solver=PGS, record=100, push=np.full((3, 2), [0.0, -1.0]))
    assert run.state.contacts.body_b.tolist() == [2, 2]
    np.testing.assert_array_equal(run.state.bodies.position[:2], pegs.bodies.position[:2])
    assert np.abs(run.state.bodies.velocity).max() < 1e-6
    load = math.pi * 9.81 + 1.0
    np.testing.assert_allclose(run.force_on("circle", 2)[-1], [0.0, load], atol=1e-3)
    np.testing.assert_allclose(run.force_on("circle", [0, 1])[-1], [0.0, -load], atol=1e-3)


def test_rollers_turn_a_ball_until_it_rolls():
    # Without slip s = ω r of the ball is the opposite of the rollers'.
    scene = circles_at(
        [[4.0, 1.5], [5.4, 1.5], [4.7, 2.4]], radius=[0.6, 0.6, 0.5], spin=[3.0, 3.0, 0.0], friction=0.8,
        fixed=[True, True, False], velocity=0.0,
    )  # fmt: skip
    state = dc.simulate(scene, steps=400, solver=PGS).state
    assert state.bodies.spin[:2].tolist() == [3.0, 3.0]
    assert state.bodies.angle[0] == pytest.approx(12.0)
    assert state.bodies.spin[2] == pytest.approx(-3.0 * 0.6 / 0.5, rel=0.01)


def test_a_paddle_carries_what_lies_on_it():
    # A fixed circle that moves is a wall that moves: e = 0 leaves its velocity.
    scene = circles_at(
        [[0.0, 0.0], [1.05, 0.0]], radius=0.5, fixed=[True, False], velocity=[[2.0, 0.0], [0, 0]], **FREE
    )
    state = dc.simulate(scene, steps=50, solver=PGS).state
    np.testing.assert_allclose(state.bodies.velocity, [[2.0, 0.0], [2.0, 0.0]], atol=1e-9)
    assert state.bodies.position[0, 0] == pytest.approx(1.0)


@pytest.mark.parametrize("as_function", [False, True])
def test_a_push_of_m_g_is_gravity(as_function):
    scales = dc.column(4).scales
    fall = dc.column(4, friction=0.4).replace(solver=dc.PGS(sweeps=20, tolerance=None))
    fall = fall.replace(world=replace(fall.world, scales=scales))
    fall = fall.with_bodies(add=dc.make_bodies([[2.0, 20.0]], fixed=True))  # compiles what the others have
    push = fall.bodies.free_mass[:, None] * np.array(fall.world.gravity)
    pushed = fall.replace(world=replace(fall.world, gravity=(0.0, 0.0)))
    one = dc.simulate(fall, steps=60).state
    other = dc.simulate(pushed, steps=60, push=(lambda state: push) if as_function else push).state
    np.testing.assert_allclose(other.bodies.position, one.bodies.position, atol=1e-10)
    np.testing.assert_allclose(other.contacts.normal_impulse, one.contacts.normal_impulse, atol=1e-9)


def test_a_torque_turns_a_disc():
    # ω = τ t / I.
    scene = circles_at([[0.0, 0.0]], radius=0.5, **FREE)
    state = dc.simulate(scene, steps=50, solver=PGS, push=(np.zeros((1, 2)), np.array([2.0]))).state
    assert state.bodies.spin[0] == pytest.approx(2.0 * 0.5 / scene.bodies.inertia[0], rel=1e-12)


def test_work_is_the_change_of_energy_and_what_contacts_dissipate():
    # At e = 0 a contact takes −P · (u + u⁺) / 2 of the energy, u its relative velocity before and after the step.
    rng = np.random.default_rng(3)
    paddle = {"segments": [((-3.0, -2.0), (-3.0, 2.0))], "segment_velocities": [((2.0, 0.3), (1.0, -0.5))]}
    grid = np.stack(np.meshgrid(np.arange(-2.0, 3.0), np.arange(-2.0, 3.0)), -1).reshape(-1, 2)
    scene = circles_at(
        grid, radius=rng.uniform(0.35, 0.5, 25), velocity=rng.uniform(-1, 1, (25, 2)), spin=rng.uniform(-2, 2, 25),
        fixed=np.arange(25) == 12, **paddle, **FREE,
    )  # fmt: skip
    push, steps = (rng.uniform(-3, 3, (25, 2)), rng.uniform(-1, 1, 25)), []
    options = {"solver": PGS, "push": push}
    run = dc.simulate(scene, steps=60, record=1, on_step=lambda state, record: steps.append(state), **options)
    taken = []
    for before, after in zip(steps, [*steps[1:], run.state]):
        c, mean = before.contacts, before.bodies._replace(
            velocity=0.5 * (before.bodies.velocity + after.bodies.velocity),
            spin=0.5 * (before.bodies.spin + after.bodies.spin),
        )  # fmt: skip
        u = np.column_stack(row_velocities(before, mean.velocity, mean.spin))
        taken.append(-(c.normal_impulse @ u[:, 0] + c.tangent_impulse @ u[:, 1]))
    turned = np.abs(np.diff(run.trajectory.work)).sum()
    assert turned > 10.0
    np.testing.assert_allclose(run.trajectory.dissipated, taken, atol=1e-9 * turned)


def test_a_chute_of_glued_grains_gives_no_energy():
    x = np.arange(0.0, 12.0, 0.35)
    glued = dc.make_bodies(np.column_stack([x, 7.0 - 0.45 * x]), radius=0.2, fixed=True)
    x, layer = map(np.ravel, np.meshgrid(np.arange(0.5, 4.0, 0.5), np.arange(3)))
    grains = dc.make_bodies(np.column_stack([x, 8.2 - 0.45 * x + 0.5 * layer]), radius=0.2)
    scene = circles_at([[28.5, 1.01]], box=(-1.0, 0.0, 30.0, 15.0), friction=0.5).with_bodies(add=glued)
    run = dc.simulate(scene.with_bodies(add=grains), steps=300, solver=PGS, record=20)
    assert run.trajectory.dissipated.sum() > 10.0
    assert run.trajectory.dissipated.min() > -1e-9  # J; rounding in free fall
    assert np.abs(run.state.bodies.velocity).max() < math.sqrt(2.0 * 9.81 * 8.5)


def test_what_a_fast_wall_sweeps_stays_in_front_of_it():
    # 50 m/s are a diameter in a step: unseen, the wall would be behind the circle at the next.
    scene = circles_at([[0.9, 0.0], [2.2, 0.3]], radius=0.25, **plate((50.0, 0.0), at=(0.2, 0.0)), **FREE)
    run = dc.simulate(scene, steps=60, solver=PGS, record=1)
    for state in run.trajectory:
        assert (state.bodies.position[:, 0] > state.world.segments[0][0]).all()
    np.testing.assert_allclose(run.state.bodies.velocity[:, 0], 50.0, atol=1e-6)


def test_a_wall_that_moves_out_of_the_box_leaves_its_circles_there():
    # Between the wall and that of the box there is no room left: what it pushed went on with it, without end.
    scene = circles_at([[2.0, 1.01], [4.0, 1.01]], friction=0.5, **plate((2.0, 0.0), at=(0.5, 2.0), half=3.0))
    scene = scene.replace(world=replace(scene.world, box=(0.0, 0.0, 10.0, 10.0)))
    with pytest.warns(UserWarning, match="a moving segment passes over circle"):
        run = dc.simulate(scene, steps=900, solver=PGS, record=20)
    assert run.state.world.segments[0][0] > 15.0
    for state in run.trajectory:
        assert ((state.bodies.position >= 0.0) & (state.bodies.position <= 10.0)).all()
    assert np.abs(run.state.bodies.velocity).max() < 5.0


def driven_scene(seed):
    """A box with circles of masses up to 1e4, a wall and a paddle up to 50 m/s, a roller and a peg; and a push."""
    rng = np.random.default_rng(seed)
    n, speed = 24, rng.choice([0.5, 5.0, 50.0])
    grid = np.stack(np.meshgrid(np.arange(-5.0, 6.0, 2.0), np.arange(-3.0, 4.0, 2.0)), -1).reshape(-1, 2)
    walls = [((-8.0, -8.0), (-8.0, 8.0)), ((7.5, -6.0), (7.5, 6.0)), ((-6.0, -9.0), (6.0, -9.5))]
    velocities = [[(speed, 0.0)] * 2, rng.uniform(-0.1, 0.1, (2, 2)) * speed, [(0.0, 0.0)] * 2]
    scene = circles_at(
        grid, radius=rng.uniform(0.3, 0.7, n), velocity=rng.uniform(-3, 3, (n, 2)), spin=rng.uniform(-5, 5, n),
        mass=10.0 ** rng.uniform(0, 4, n), fixed=rng.random(n) < 0.1, gravity=(0.0, -9.81), friction=0.4,
        restitution=rng.choice([0.0, 0.5]), box=(-20.0, -10.0, 20.0, 10.0), segments=walls,
        segment_velocities=velocities,
    )  # fmt: skip
    return scene, (rng.uniform(-20, 20, (n, 2)), rng.uniform(-5, 5, n)), 6.0 / speed


def sides(state):
    """On which side of the first wall, and within its length, the circles are, (n,): −1, 1, or 0 beyond its ends."""
    (x, low, _, high), y = state.world.segments[0], state.bodies.position[:, 1]
    return np.sign(state.bodies.position[:, 0] - x) * ((low < y) & (y < high))


def check_driven(seed, folder, **how):
    """Nothing through a wall, no NaN, parts = whole = file, to the bit."""
    scene, push, time = driven_scene(seed)
    steps = int(np.clip(time / scene.dt, 8, 60))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        whole = dc.simulate(scene, steps=steps, push=push, record=1, **how)
    if any("passes over circle" in str(one.message) for one in said):  # as a moving segment may, with this warning
        return
    for before, after in zip(whole.trajectory, list(whole.trajectory)[1:]):
        one, other = sides(before), sides(after)
        assert not ((one * other < 0) & ~scene.bodies.is_fixed).any()
        assert np.isfinite(after.bodies.velocity).all()
    half = dc.simulate(scene, steps=steps // 2, push=push, **how).state
    dc.write_state(folder / "half.xml", half)
    whole.trajectory.save(folder / "whole.h5")
    for state in (half, dc.read_state(folder / "half.xml"), dc.load_trajectory(folder / "whole.h5")[steps // 2]):
        again = dc.simulate(state, steps=steps - steps // 2, push=push, solver=half.solver).state
        assert again == whole.state


@pytest.mark.parametrize("seed", range(12))
def test_random_scenes_with_walls_fixed_circles_and_pushes(seed, tmp_path):
    check_driven(seed, tmp_path, solver=PGS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 300))
def test_many_random_scenes(seed, tmp_path):
    how = [{"solver": PGS}, {"accuracy": "fast"}, {"solver": dc.BatchedPGS(sweeps=20)}, {"solver": dc.NNCG(sweeps=20)}]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_driven(seed, tmp_path, **how[seed % 4])


@pytest.mark.slow
def test_a_wall_that_moves_wakes_who_sleeps():
    scene = circles_at([[3.0, 0.98]], radius=1.0, friction=0.5, **plate((1.0, 0.0), at=(-2.0, 2.0), half=1.5))
    scene = scene.replace(world=replace(scene.world, box=(-10.0, 0.0, 10.0, 10.0)))
    run = Simulator(scene, solver=dc.PGS(sweeps=20), sleep=True)
    run.step(200)
    assert run._steps.sleep.still[0] == math.inf
    run.step(400)
    assert run.velocities[0, 0] == pytest.approx(1.0, abs=0.05)


def test_segments_that_are_put_elsewhere_jump_with_a_warning_once():
    bar, above = [((0.0, 5.0), (9.0, 5.0))], [((0.0, 5.1), (9.0, 5.1))]
    scene = circles_at([[4.0, 7.0]], segments=bar)
    run = Simulator(scene, solver=PGS)
    with pytest.warns(UserWarning, match="segments: a segment that is put elsewhere jumps"):
        run.set(segments=above)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run.set(segments=bar)
        run.set(segments=above, segment_velocities=[((0, 1), (0, 1))])
    with pytest.warns(UserWarning, match="segments: a segment that is put elsewhere jumps"):
        run.state.replace(step=1).replace(world=replace(scene.world, segments=bar))


@pytest.mark.parametrize(
    ("push", "message"),
    [(np.zeros((3, 2)), "push: expected forces"), ((np.zeros((2, 2)), 1.0), "push: expected"), ("up", "push: expected"),
     (np.full((2, 2), np.nan), "push: expected"), (lambda state: None, "push: expected")],
)  # fmt: skip
def test_what_is_no_push_is_refused(push, message):
    with pytest.raises(ValueError, match=message):
        dc.simulate(circles_at([[0.0, 5.0], [3.0, 5.0]]), steps=1, solver=PGS, push=push)


def test_velocities_of_other_segments_and_flags_of_other_circles_are_refused():
    with pytest.raises(ValueError, match="segment_velocities: expected those of both ends of 1 segments"):
        dc.World(segments=[((0, 0), (1, 0))], segment_velocities=[((1, 0), (1, 0))] * 2)
    with pytest.raises(ValueError, match="fixed: expected True or False for all circles, or for each of the 2"):
        dc.make_bodies([[0.0, 1.0], [3.0, 1.0]], fixed=[True])


def test_a_push_that_ends_leaves_no_impulses_behind():
    # The impulses of a load that is gone are solved anew: the pile stays (`starts.changed_load`).
    run = Simulator(dc.column(5, friction=0.4), solver=PGS, push=np.full((5, 2), [0.0, -500.0]))
    run.step(150)
    run.set(push=np.zeros((5, 2)))
    run.step()
    assert np.abs(run.velocities).max() < 0.02


def test_who_comes_and_goes_is_told_by_index():
    run = Simulator(circles_at([[1.0, 5.0], [4.0, 5.0], [7.0, 5.0]]), solver=PGS, push=np.full((3, 2), [0.0, 9.0]))
    assert run.add(dc.make_bodies([[10.0, 5.0]])).tolist() == [3]
    assert run.remove([1]).tolist() == [0, -1, 1, 2]
    run.step(10)
    assert run.velocities[:2, 1] == pytest.approx([0.1 * (9.0 / math.pi - 9.81)] * 2)
    assert run.velocities[2, 1] == pytest.approx(-0.981)


def test_a_film_of_states_with_other_numbers_of_circles(tmp_path):
    states = [circles_at([[5.0, 5.0]] * 1), circles_at([[5.0, 5.0], [9.0, 5.0]])]
    with pytest.raises(ValueError, match=r"the 1 circles of the first state, as a trajectory has them \(dc.film"):
        dc.Trajectory.from_states([dc.find_contacts(state) for state in states])
    assert dc.film(states, tmp_path / "two.gif", size=64).stat().st_size > 100


def test_a_single_solve_knows_that_a_wall_moves():
    """Without restitution the ball at rest gets the velocity of the wall that meets it."""
    wall = {"segments": [((2, 0), (2, 4))], "segment_velocities": [((2, 0), (2, 0))]}
    state = dc.find_contacts(circles_at([[3.0, 2.0]], box=(0, 0, 10, 4), gravity=(0, 0), **wall))
    np.testing.assert_allclose(dc.solve_contacts(state, solver=dc.PGS()).velocities, [[2.0, 0.0]], atol=1e-12)
    later = dc.step(state, solver=dc.PGS(), warm_start="support")  # a start from Python: its rows are built ahead
    np.testing.assert_allclose(later.bodies.velocity, [[2.0, 0.0]], atol=1e-12)
