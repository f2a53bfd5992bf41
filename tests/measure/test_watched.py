"""Runs that are watched in every step: extremes between two readings, by closed forms and by single steps."""

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.measure import peers
from deep_contact.measure.errors import REST, Reading, observe
from deep_contact.measure.setting_runs import world_of
from deep_contact.measure.settings import setting_of
from deep_contact.measure.watched import PeerWatched, readings_of
from deep_contact.state.constants import WALL_SKIN
from deep_contact.stepping.problem import contacts_of

G, INTERVAL = 9.81, 0.05


def pgs(**options):
    return dc.PGS(sweeps=10, tolerance=None, **options)


def ball(height):
    """A circle of r = 1 m at rest whose lowest point is so high above the skin of the floor."""
    return circles_at([[15.0, 1.0 + WALL_SKIN + height]])


def depth_of_hit(height, dt):
    """(number of the step, depth, m) of the first penetration, by symplectic Euler: h − g Δt² k (k + 1) / 2 < 0."""
    k = int(np.ceil(-0.5 + np.sqrt(0.25 + 2.0 * height / (G * dt**2))))
    return k, 0.5 * G * dt**2 * k * (k + 1) - height


@pytest.mark.parametrize(("substeps", "height"), [(1, 0.85), (4, 0.84)])
def test_a_ball_that_hits_between_two_readings_is_seen_with_the_depth_of_the_hit(substeps, height):
    k, depth = depth_of_hit(height, 0.01 / substeps)
    hit = k * 0.01 / substeps
    frame = int(hit // INTERVAL)
    assert 0.2 * INTERVAL < hit - frame * INTERVAL < 0.8 * INTERVAL  # well between two readings
    seen = list(readings_of(ball(height), setting_of(pgs(substeps=substeps), 0.01), 14, INTERVAL))
    deepest = [reading.deepest for reading in seen]
    assert deepest[frame] == pytest.approx(depth, rel=1e-9)
    assert deepest[:frame] == [0.0] * frame
    at_readings = [max(0.0, -reading.state.contacts.separation.min(initial=0.0)) for reading in seen]
    assert max(at_readings) < 0.8 * depth  # what readings alone would have
    assert all(one < depth for one in deepest[frame + 1 :])


def test_the_parts_into_which_motion_divides_a_step_are_seen():
    """A hit at 9 m/s, in four parts: the depth is that of the part in which the ball passes the floor."""
    height, fall = 4.04, pgs(most_substeps=16, approach=0.03)
    run = dc.simulate(ball(height), steps=100, solver=fall, record=1)
    step = int(np.argmax(run.substeps))  # the first divided step
    parts = int(run.substeps[step])
    assert parts == 4
    before = dc.simulate(ball(height), steps=step, solver=fall).state
    speed, left = -before.bodies.velocity[0, 1], before.bodies.position[0, 1] - 1.0 - WALL_SKIN
    dt = 0.01 / parts
    ways = np.cumsum(dt * (speed + G * dt * np.arange(1, parts + 1)))
    depth = ways[np.argmax(ways > left)] - left
    whole = list(readings_of(ball(height), setting_of(fall, 0.01), 20, INTERVAL))
    assert max(reading.deepest for reading in whole) == pytest.approx(depth, rel=1e-9)
    after_steps = max(-state.contacts.separation.min(initial=0.0) for state in run.trajectory)
    assert after_steps < 0.6 * depth  # what each whole step alone would have


@pytest.mark.parametrize(
    "solver", [pgs(), dc.BatchedPGS(sweeps=10, tolerance=None), dc.NNCG(sweeps=10, tolerance=None)]
)
@pytest.mark.parametrize("substeps", [1, 2])
def test_the_deepest_penetration_is_that_of_single_steps(solver, substeps):
    scene, solver = dc.circles_in_box(30, seed=4), solver.__class__(sweeps=10, tolerance=None, substeps=substeps)
    seen = list(readings_of(scene, setting_of(solver, 0.01), 50, INTERVAL))
    state, alone = scene.replace(dt=0.01 / substeps), solver.__class__(sweeps=10, tolerance=None)
    last, hidden = 0.0, 0
    for reading in seen:
        depths, contacts = [last], [0]
        for _ in range(5 * substeps):
            state = dc.simulate(state, steps=1, solver=alone).state
            depths.append(max(0.0, -state.contacts.separation.min(initial=0.0)))
            contacts.append(int(np.argmin(state.contacts.separation)) if state.contacts.count else 0)
        assert reading.deepest == pytest.approx(max(depths), rel=1e-9)
        np.testing.assert_array_equal(reading.state.bodies.position, state.bodies.position)
        # Deeper than at both readings, and not at the first contact of a step.
        hidden += max(depths) > max(last, depths[-1]) and contacts[int(np.argmax(depths))] > 0
        last = depths[-1]
    assert hidden > 2


@pytest.mark.parametrize("solver", [pgs(), dc.BatchedPGS(sweeps=10, tolerance=None, most_substeps=8)])
def test_a_run_that_is_watched_has_the_bits_of_one_that_is_not(solver):
    scene = dc.circles_in_box(30, seed=4)
    *_, last = readings_of(scene, setting_of(solver, 0.01), 20, INTERVAL)
    assert last.state.bodies == dc.simulate(scene, steps=100, solver=solver).state.bodies


@pytest.mark.parametrize("engine", list(peers.ENGINES))
def test_another_engine_is_read_after_each_of_its_steps(engine):
    pytest.importorskip(peers.ENGINES[engine].package)
    scene, setting = dc.circles_in_box(30, seed=4), {"engine": engine, "sweeps": 6, "dt": 0.005}
    seen, world = list(readings_of(scene, setting, 20, INTERVAL)), world_of(scene.replace(dt=0.005), setting)
    share = scene.bodies.mass / scene.bodies.mass.sum()
    depth = 0.0
    for reading in seen:
        centres = [share @ world.bodies().velocity]
        for k in range(10):
            world.step(0.005, 6, 10)
            bodies = world.bodies()
            depth = max(depth, -contacts_of(scene.replace(bodies=bodies)).separation.min(initial=0.0))
            centres += [share @ bodies.velocity] * (k % 2)  # every 10 ms
        assert reading.deepest == pytest.approx(depth, abs=1e-12)
        np.testing.assert_allclose(reading.velocity, centres, atol=1e-12)
        depth = max(0.0, -contacts_of(scene.replace(bodies=bodies)).separation.min(initial=0.0))
        np.testing.assert_array_equal(reading.state.bodies.position, world.bodies().position)
    assert seen[-1].deepest > 0
    assert seen[-1].state.time == pytest.approx(1.0)


@pytest.mark.parametrize("engine", list(peers.ENGINES))
def test_positions_and_velocities_of_an_engine_are_those_of_its_bodies(engine):
    pytest.importorskip(peers.ENGINES[engine].package)
    world = peers.ENGINES[engine](dc.circles_in_box(20, seed=1))
    for _ in range(3):
        world.run(40, 0.01, 6, 10)
        bodies = world.bodies()
        np.testing.assert_array_equal(world.positions(), bodies.position)
        np.testing.assert_array_equal(world.velocities(), bodies.velocity)


@pytest.mark.parametrize("split", [1, 4])
def test_the_force_of_a_hit_is_the_mean_over_an_interval_whatever_the_step(split):
    """A ball is stopped within one step. The force over that step alone would grow as the step shrinks."""
    height = 0.25
    solver = pgs()
    seen = list(readings_of(ball(height), setting_of(solver, 0.01 / split), 8, INTERVAL))
    assert {reading.velocity.shape for reading in seen} == {(6, 2)}
    speeds = np.concatenate([reading.velocity[1:, 1] for reading in seen])
    alone = dc.simulate(ball(height), steps=40 * split, dt=0.01 / split, solver=solver, record=split)
    expected = np.array([state.bodies.velocity[0, 1] for state in alone.trajectory])
    np.testing.assert_allclose(speeds, expected[1:], atol=1e-12)
    k, _ = depth_of_hit(height, 0.01 / split)
    fall = k // split  # steps of 10 ms before the one in which the ball is stopped
    # The hardest interval begins then, at a speed of G × 10 ms × fall, and ends at rest.
    force = observe(readings_of(ball(height), setting_of(solver, 0.01 / split), 30, INTERVAL)).force
    assert force.max() == pytest.approx(1.0 + fall / 5, rel=1e-6)
    assert force.argmax() == (fall + 4) // 5


def test_an_observation_has_the_extremes_of_its_readings():
    state = dc.simulate(dc.column(2), steps=2, solver=pgs()).state
    rise = np.zeros((3 * REST + 1, 2))
    rise[16:, 1], rise[17:, 1] = 0.5, 0.7  # m/s: steps 16 and 17 accelerate the pile upwards
    seen = [Reading(state.replace(time=0.03 * k), 0.25 * (k == 3), rise[3 * k : 3 * k + 4], 0.01) for k in range(REST)]
    found = observe(seen)
    # Three steps rise by 0.7 m/s if they end with step 17 or 18, of reading 5, and by 0.2 m/s if they end with step 19.
    gained = np.zeros(REST)
    gained[[5, 6]] = 0.7, 0.2
    np.testing.assert_allclose(found.force, 1.0 + gained / (G * 0.03))
    at_state = max(0.0, -state.contacts.separation.min())
    np.testing.assert_allclose(found.penetration[:, 2], np.where(np.arange(REST) == 3, 0.25, at_state))


def test_an_engine_that_loses_its_circles_is_refused(monkeypatch):
    pytest.importorskip("pymunk")
    run = PeerWatched(dc.circles_in_box(5, seed=1), {"engine": "pymunk", "sweeps": 4, "dt": 0.01})
    monkeypatch.setattr(run._world, "positions", lambda: np.full((5, 2), np.nan))
    with pytest.raises(ValueError, match="position: expected finite numbers from pymunk"):
        run.advance(1)


def test_a_step_that_does_not_divide_a_window_is_refused():
    with pytest.raises(ValueError, match=r"dt: expected a step that divides 0\.01 s, got 0\.004"):
        next(readings_of(dc.column(2), {"method": "PGS", "sweeps": 4, "dt": 0.004}, 2, INTERVAL))
    with pytest.raises(ValueError, match=r"scene\.dt: expected a step that divides 0\.05 s, got 0\.03"):
        next(readings_of(dc.column(2).replace(dt=0.03), {"method": "PGS", "sweeps": 4, "dt": 0.03}, 2, INTERVAL))
