"""Substeps by motion: how many are chosen, that the choice changes nothing else, and what depth it prevents."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.stepping.broad_phase import make_cells
from deep_contact.stepping.inputs import step_input
from deep_contact.stepping.metrics import kinetic_energy
from deep_contact.stepping.prepare import ready
from deep_contact.stepping.segment_grid import segments_of
from deep_contact.stepping.substeps import shift_flights, substeps_by_motion
from deep_contact.studies.hard_scenes import mechanical_energy

OPTIONS = {"sweeps": 5, "tolerance": None, "most_substeps": 16, "approach": 0.02, "slop": 0.5}
MOTION = dc.PGS(**OPTIONS)


def fastest_approach(state):
    """Of all pairs, walls and segments: the fastest that closes its gap within Δt, m/s."""
    x, v, r, dt = state.bodies.position, state.bodies.velocity, state.bodies.radius, state.dt
    a, b = np.triu_indices(state.bodies.count, 1)
    distance = np.linalg.norm(x[b] - x[a], axis=1)
    speed = -((v[b] - v[a]) * (x[b] - x[a])).sum(axis=1) / distance
    found = [0.0, *np.where(distance - r[a] - r[b] < speed * dt, speed, 0.0)]
    falling, reach, box = v + dt * np.array(state.world.gravity), r + state.scales.wall_skin, state.world.box
    for wall, axis, sign in ((0, 0, -1), (1, 1, -1), (2, 0, 1), (3, 1, 1)):
        gap, speed = sign * (box[wall] - x[:, axis]), sign * falling[:, axis]
        found += [*np.where(gap - reach < speed * dt, speed, 0.0)]
    for segment in segments_of(state.world):
        start, end = segment[:2], segment[2:4]
        along = np.clip((x - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
        way = start + along[:, None] * (end - start) - x
        gap = np.linalg.norm(way, axis=1)
        speed = (falling * way).sum(axis=1) / gap
        found += [*np.where(gap - reach < speed * dt, speed, 0.0)]
    return max(found)


@pytest.mark.parametrize("speed", [0.0, 1.0, 10.0, 40.0, 400.0])
@pytest.mark.parametrize("segments", [(), ((5.0, 3.0, 25.0, 6.0),)])
def test_the_number_of_parts_is_that_of_the_fastest_approach_of_all(speed, segments):
    rng, cells = np.random.default_rng(int(speed)), make_cells(60)
    for _ in range(10):  # with what the search remembers of the states before
        state = dc.circles_in_box(60, size=25, radius=(0.5, 1.2), seed=int(rng.integers(1000)))
        velocity = rng.normal(0, speed, (60, 2)) * rng.random((60, 1)) ** 2
        world = replace(state.world, segments=segments)
        state = state.replace(bodies=state.bodies._replace(velocity=velocity), world=world)
        wanted = fastest_approach(state) * state.dt / (0.02 * state.bodies.radius.mean())
        given = step_input(ready(state), MOTION)
        expected = 1 if wanted <= 1 else min(16, 2 ** math.ceil(math.log2(wanted)))
        assert substeps_by_motion(given, cells, None) == expected


@pytest.mark.parametrize("height", [2.0, 5.0, 20.0])
def test_what_hits_goes_no_deeper_than_the_approach(height):
    # One circle onto the floor, at up to 20 m/s: in one step of 10 ms it would be up to 0.2 radii deep.
    scene = dc.single_body(height=height, box=(0.0, 0.0, 30.0, 40.0))
    run = dc.simulate(scene, steps=300, record=1, solver=replace(MOTION, position_sweeps=0))
    deepest = max(-state.contacts.separation.min(initial=0.0) for state in run.trajectory)
    assert 0 < deepest <= 0.02
    assert run.substeps.max() == 2 ** math.ceil(math.log2(math.sqrt(2 * 9.81 * height) * 0.01 / 0.02))
    assert (run.substeps != 1).sum() <= 2  # the step in which it hits


def test_a_run_by_motion_is_the_run_of_the_steps_it_chose():
    scene = state = dc.circles_in_box(40, size=16, seed=4)
    run = dc.simulate(scene, steps=150, solver=MOTION)
    assert set(run.substeps) >= {1, 2, 4, 8}
    for count in run.substeps:
        state = dc.simulate(state, steps=1, solver=replace(MOTION, substeps=int(count), most_substeps=None)).state
    np.testing.assert_array_equal(state.bodies.position, run.state.bodies.position)
    assert (run.sweeps <= 5 * run.substeps).all()
    # With two at least, each half is divided by itself.
    halves = dc.simulate(scene.replace(dt=0.005), steps=300, solver=replace(MOTION, most_substeps=8))
    whole = dc.simulate(scene, steps=150, solver=replace(MOTION, substeps=2))
    np.testing.assert_array_equal(whole.substeps, halves.substeps.reshape(-1, 2).sum(axis=1))
    np.testing.assert_array_equal(whole.state.bodies.position, halves.state.bodies.position)


def test_batches_divide_by_motion():
    scene = dc.lattice_in_box(200, seed=4)
    batches = dc.BatchedPGS(**OPTIONS | {"sweeps": 8})
    assert dc.simulate(scene, steps=120, solver=batches).substeps.max() > 1


def test_a_pile_at_rest_takes_the_fewest_and_its_changes_give_no_energy():
    settled = dc.simulate(dc.circles_in_box(60, seed=1), steps=900, solver=dc.PGS(sweeps=50, tolerance=None)).state
    assert (dc.simulate(settled, steps=50, solver=MOTION).substeps == 1).all()
    state, energies = settled, []
    for k in range(60):
        solver = dc.PGS(sweeps=50, tolerance=None, substeps=[1, 4, 2, 8][k % 4])
        state = dc.simulate(state, steps=1, solver=solver).state
        energies.append(kinetic_energy(state.bodies))
    weight = settled.bodies.mass.sum() * 9.81
    assert max(energies) < 1e-7 * weight  # 0.1 µm of height


@pytest.mark.parametrize("solver", [dc.PGS, dc.BatchedPGS])
def test_bounces_by_motion_keep_their_energy_and_their_bits(solver):
    # Divided on the way down and not on the way up: without the leapfrog's shift a bounce changes the energy by g Δt v.
    scene = dc.circles_in_box(12, friction=0.0, restitution=1.0, seed=3)
    motion = solver(**OPTIONS)
    run = dc.simulate(scene, steps=600, solver=motion)
    assert run.substeps.max() > 4
    energy = [mechanical_energy(scene, bodies) for bodies in (scene.bodies, run.state.bodies)]
    assert energy[1] == pytest.approx(energy[0], rel=0.01)
    watched = dc.simulate(scene, steps=600, solver=motion, on_step=lambda state, record: None)
    np.testing.assert_array_equal(watched.state.bodies.velocity, run.state.bodies.velocity)


def test_a_change_of_the_step_shifts_only_what_no_contact_pushes():
    # v(t − Δt / 2) of the leapfrog: half of g times the change, but for two circles in contact and one on the floor.
    centres = [[2.0, 5.0], [4.0, 5.0], [8.0, 1.0], [6.0, 8.0]]
    state = ready(circles_at(centres, velocity=np.ones((4, 2)), box=(0, 0, 10, 10)))
    assert state.contacts.count == 2
    state.contacts.normal_impulse[:] = 1.0
    shifts = np.zeros((4, 2))
    shift_flights(state.bodies, state.contacts, (2.0, -10.0), 0.01, None, shifts)
    np.testing.assert_allclose(state.bodies.velocity, [[1, 1], [1, 1], [1, 1], [1.01, 0.95]], rtol=1e-15)
    np.testing.assert_allclose(shifts / state.bodies.mass[:, None], state.bodies.velocity - 1.0, atol=1e-15)
    # A contact without an impulse has pushed nobody: what has just come, or leaves, is shifted.
    state.contacts.normal_impulse[:] = 0.0
    shift_flights(state.bodies, state.contacts, (2.0, -10.0), -0.01, None, np.zeros((0, 2)))
    np.testing.assert_allclose(state.bodies.velocity[2:], [[0.99, 1.05], [1.0, 1.0]], rtol=1e-15)


@pytest.mark.parametrize("gravity", [(0.0, -700.0), (700.0, 0.0), (-700.0, 0.0), (0.0, 700.0)])
@pytest.mark.parametrize("what", ["wall", "segment"])
def test_the_speed_that_gravity_gives_in_a_step_counts(what, gravity):
    """7 m/s for 0.01 s are 4.7 reaches of 0.03 · 0.5 m, so there are 8 parts. The other way nothing is near."""
    way = np.sign(gravity)
    left = np.array([-way[1], way[0]])
    place, line = 4.45 * way, ()
    if what == "segment":
        place, line = 0.0 * way, [(tuple(0.55 * way - 2.0 * left), tuple(0.55 * way + 2.0 * left))]
    scene = circles_at([place], radius=0.5, gravity=gravity, box=(-5.0, -5.0, 5.0, 5.0), segments=line)
    solver = dc.PGS(sweeps=20, tolerance=None, most_substeps=16)
    assert dc.simulate(scene, steps=1, solver=solver).substeps.tolist() == [8]
    away = scene.replace(world=replace(scene.world, gravity=tuple(-np.array(gravity))))
    assert dc.simulate(away, steps=1, solver=solver).substeps.tolist() == [1]
