"""Segments whose surface moves: belts and drums. Closed forms, an oracle, matrices, files."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at, stacked
from symmetry import SYMMETRIES, transform_state

import deep_contact as dc
from deep_contact.accuracy.presets import longest_step
from deep_contact.accuracy.scene_numbers import scene_numbers
from deep_contact.analysis.lcp import contact_problem, natural_residual
from deep_contact.solvers import METHODS
from deep_contact.stepping import metrics

BOX = (0.0, 0.0, 60.0, 40.0)
LEVEL = ((5.0, 10.0), (55.0, 10.0))
SOLVERS = {name: METHODS[name]() for name in METHODS} | {"islands": dc.PGS(islands=True)}
G = 9.81


def on_belt(speed, segment=LEVEL, position=(30.0, 11.01), friction=0.3):
    return circles_at([position], box=BOX, friction=friction, segments=[segment], surface_speeds=[speed])


@pytest.fixture(scope="module")
def turning():
    """A drum after a turn or so: a heap that flows."""
    return dc.simulate(dc.drum(80, froude=0.1, seed=4, radius=(0.7, 1.0)), steps=500, solver=dc.PGS(sweeps=30)).state


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("speed", [3.0, -3.0])
@pytest.mark.parametrize("name", SOLVERS)
def test_a_belt_drags_a_disc_as_in_closed_form(name, speed, reverse):
    # It slides at μ g until its rim has the belt's speed, which is when its centre has a third of it: I = m r² / 2.
    scene = on_belt(-speed, LEVEL[::-1]) if reverse else on_belt(speed)
    for steps in (15, 60):  # while it slides, and after that
        end = dc.simulate(scene, steps=steps, solver=SOLVERS[name]).state.bodies
        expected = math.copysign(min(0.3 * G * 0.01 * steps, abs(speed) / 3), speed)
        # Arms end in the middle of the overlap.
        np.testing.assert_allclose(end.velocity[0], (expected, 0.0), atol=1e-3 * abs(speed))
        np.testing.assert_allclose(end.spin, 2 * expected, atol=2e-3 * abs(speed))


def test_an_end_drags_by_what_of_its_motion_is_tangential():
    # A disc on the end of a belt at 45°: held up by it, and driven by cos 45° of the speed along the contact's tangent.
    state = dc.simulate(on_belt(2.0, ((10.0, 10.0), (20.0, 20.0)), (20.0, 21.01)), steps=3).state
    normal, tangent = metrics.row_velocities(state, np.zeros((1, 2)), np.zeros(1))
    np.testing.assert_allclose((normal[0], abs(tangent[0])), (0.0, math.sqrt(2.0)), atol=0.01)
    assert state.bodies.velocity[0, 0] > 0.0


def test_a_belt_drags_as_in_pymunk():
    pytest.importorskip("pymunk", reason="needs the package pymunk")
    for speed in (4.0, -1.0):
        scene = on_belt(speed, position=(30.0, 11.0))
        peer = dc.peers.Pymunk(scene)
        for _ in range(40):
            peer.step(0.01, 30)
        ours, theirs = dc.simulate(scene, steps=40).state.bodies, peer.bodies()
        np.testing.assert_allclose(ours.velocity, theirs.velocity, atol=0.02)
        np.testing.assert_allclose(ours.spin, theirs.spin, atol=0.04)


def test_box2d_refuses_a_belt():
    pytest.importorskip("Box2D", reason="needs the package Box2D")
    with pytest.raises(ValueError, match="surface_speeds: expected"):
        dc.peers.Box2D23(on_belt(1.0))


@pytest.mark.parametrize("name", SOLVERS)
def test_matrices_and_solvers_agree_in_a_drum(turning, name):
    solution = dc.solve_contacts(turning, solver=replace(SOLVERS[name], sweeps=3000, tolerance=None))
    error = natural_residual(contact_problem(turning), stacked(solution))
    assert error < 1e-6
    np.testing.assert_allclose(metrics.residual(turning, solution), error, atol=1e-9)
    still = contact_problem(turning.replace(world=replace(turning.world, surface_speeds=())))
    assert natural_residual(still, stacked(solution)) > 0.1
    assert name != "PGS" or metrics.residual(turning, dc.solve_exactly(turning).solution) < 1e-8


def test_surfaces_at_rest_and_without_friction_change_no_bit(turning):
    world = replace(turning.world, surface_speeds=[0.0] * 60)
    assert world == replace(turning.world, surface_speeds=()) != turning.world
    smooth = [
        dc.simulate(turning.replace(world=replace(world, friction=0.0, surface_speeds=speeds)), steps=20).state
        for speeds in ((), turning.world.surface_speeds)
    ]
    assert smooth[0].bodies == smooth[1].bodies


@pytest.mark.parametrize("k", SYMMETRIES)
def test_a_drum_turned_and_mirrored_with_its_circles_goes_on_the_same(turning, k):
    here, there = (dc.simulate(state, steps=5).state for state in (turning, transform_state(turning, k)))
    np.testing.assert_allclose(transform_state(here, k).bodies.velocity, there.bodies.velocity, atol=1e-6)


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_nothing_sleeps_on_a_belt(speed):
    # A wall at the end of the belt holds the disc in its place, where it turns without friction worth the name.
    scene = on_belt(speed, ((0.0, 10.0), (60.0, 10.0)), (58.99, 11.01), friction=0.001)
    end = dc.simulate(scene, steps=400, sleep=True).state
    still = dc.simulate(end, steps=50, sleep=True).state.bodies.spin != end.bodies.spin
    assert still.any() == (speed != 0.0)


# ---- the scene ----


def test_a_drum_carries_its_heap_up_on_the_side_that_rises():
    ends = {}
    for froude in (0.0, 0.05):
        scene = dc.drum(120, froude=froude, seed=1)
        middle = 0.5 * scene.world.box[2]
        assert np.hypot(*(scene.bodies.position - middle).T).max() + 1 < (middle - 1) * math.cos(math.pi / 60)
        run = dc.simulate(scene, steps=900, record=10)
        heap = run.trajectory.positions[-20:].mean(axis=(0, 1)) - middle
        ends[froude] = math.degrees(math.atan2(heap[0], -heap[1]))
        inside = np.hypot(*(run.state.bodies.position - middle).T)
        assert (inside < middle - 1).all()
        assert not ((run.state.contacts.body_b >= 120) & (run.state.contacts.body_b < 124)).any()
    assert abs(ends[0.0]) < 5
    assert 12 < ends[0.05] < 60


@pytest.mark.parametrize("sides", [8, 60, 120])
def test_the_box_does_not_brake_a_drum(sides):
    scene = dc.drum(1, sides=sides, filling=0.02, seed=1)
    x_0, _, x_1, _ = scene.world.box
    lowest = np.reshape(scene.world.segments, (-1, 2))[:, 1].min()
    touching = scene.bodies._replace(position=np.array([[0.5 * (x_0 + x_1), lowest + 1.005]]))
    state = dc.simulate(scene.replace(bodies=touching), steps=2).state
    assert state.contacts.count
    assert (state.contacts.body_b >= 5).all()


def test_presets_know_that_a_surface_is_fast():
    calm, fast = dc.drum(60, froude=0.05), dc.drum(60, froude=400.0)
    assert dc.recommend(calm).outside == () != dc.recommend(fast).outside
    assert dc.recommend(fast).solver.substeps > dc.recommend(calm).solver.substeps
    assert "the world has 60, 60 have a surface that moves" in dc.plan(fast)["segments"].why
    smooth = [dc.drum(60, froude=froude, friction=0.0) for froude in (0.05, 400.0)]
    assert longest_step(scene_numbers(smooth[0]), 0.01) == longest_step(scene_numbers(smooth[1]), 0.01)


def test_a_barrel_leaves_its_columns_room_to_fall_apart():
    scene = dc.barrel(20, columns=4, seed=1)
    assert scene.bodies.count == 80
    assert scene.bodies.position[:, 0].min() - scene.world.box[0] > 17
    end = dc.simulate(scene, steps=600).state.bodies
    assert end.position[:, 1].max() < 0.7 * scene.bodies.position[:, 1].max()
