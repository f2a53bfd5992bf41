"""Impacts: what a rebound does by hand, and that no setting makes or loses energy in many of them."""

import math

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.physics.continuous import take_back_fall
from deep_contact.presets import PRESETS
from deep_contact.studies.extremes import mechanical_energy

pytestmark = pytest.mark.filterwarnings("ignore:.*solved to a tolerance")


def energies(state, steps, every=50, **options):
    """Mechanical energy along a run over that at its start, the floor as zero, (steps // every,)."""
    found = [mechanical_energy(state, state.bodies)]
    for _ in range(steps // every):
        state = dc.simulate(state, steps=every, **options).state
        found.append(mechanical_energy(state, state.bodies))
    return np.array(found[1:]) / found[0]


def with_masses(scene, ratio, seed=1):
    factor = ratio ** np.random.default_rng(seed).uniform(0, 1, scene.bodies.count)
    return scene.replace(bodies=scene.bodies._replace(mass=scene.bodies.mass * factor))


@pytest.mark.parametrize("accuracy", PRESETS)
def test_three_elastic_circles_keep_their_energy_with_every_preset(accuracy):
    scene = dc.circles_in_box(3, friction=0.0, restitution=1.0, seed=0)
    assert np.abs(energies(scene, 1000, every=100, accuracy=accuracy) - 1).max() < 0.02


@pytest.mark.parametrize("solver", [None, dc.PGS(), dc.PSOR(sweeps=2, omega=1.9, tolerance=None), dc.NNCG(sweeps=3)])
def test_unlike_masses_with_friction_gain_no_energy(solver):
    scene = with_masses(dc.circles_in_box(30, restitution=1.0, seed=2), 1e4)
    options = {"accuracy": "fast"} if solver is None else {"solver": solver}
    assert energies(scene, 300, **options).max() < 1.01


@pytest.mark.parametrize("ratio", [1.0, 1e4])
def test_elastic_frictionless_circles_keep_their_energy_whatever_the_masses(ratio):
    # Light ones come to 400 m/s: nothing cuts a speed, and what stops early keeps the energy of its height.
    scene = with_masses(dc.circles_in_box(30, friction=0.0, restitution=1.0, seed=3), ratio)
    assert np.abs(energies(scene, 1000, solver=dc.PGS(sweeps=2, tolerance=None)) - 1).max() < 0.02


def test_a_circle_that_slides_along_the_floor_rebounds_by_coulomb():
    # p_n = (1 + e) m v_n, p_t = μ p_n against the slip, v_n with half a step of gravity; then the step's gravity.
    scene = circles_at([[15.0, 1.01]], velocity=[[6.0, -4.0]], friction=0.1, restitution=0.5)
    solution = dc.solve_contacts(scene, solver=dc.PGS())
    v_n, half = 4.0 + 0.5 * 0.01 * 9.81, 0.5 * 0.01 * 9.81
    np.testing.assert_allclose(solution.velocities[0], [6.0 - 0.1 * 1.5 * v_n, 0.5 * v_n - half], rtol=1e-12)
    np.testing.assert_allclose(solution.angular_velocities, -2.0 * 0.1 * 1.5 * v_n, rtol=1e-12)


def test_a_surface_that_moves_drags_what_rebounds_from_it():
    belt = {"segments": (((25.0, 5.0), (5.0, 5.0)),), "surface_speeds": (2.0,)}
    scene = circles_at([[15.0, 6.0]], velocity=[[0.0, -4.0]], gravity=(0, 0), restitution=1.0, friction=9.0, **belt)
    state = dc.simulate(scene, steps=1, solver=dc.PGS()).state
    # A disc that sticks takes a third of the surface's speed, and turns with the rest.
    assert abs(state.bodies.velocity[0, 0]) == pytest.approx(2.0 / 3.0, rel=0.02)
    assert state.bodies.velocity[0, 1] == pytest.approx(4.0, rel=1e-9)


def test_what_rests_does_not_rebound():
    # At e = 1, too: a column stays, and a light circle between heavy ones. Solved tightly: the speed that a loose
    # tolerance leaves opens a contact, and what falls back at e = 1 bounces.
    for scene in (dc.column(4, restitution=1.0), with_masses(dc.column(4, restitution=1.0), 50.0)):
        state = dc.simulate(scene, steps=200, solver=dc.PGS(sweeps=500, tolerance=1e-10)).state
        assert np.abs(state.bodies.velocity).max() < 1e-3


@pytest.mark.parametrize("speed", [-80.0, 80.0])
def test_what_stops_early_keeps_the_energy_of_its_height(speed):
    velocity, time, g = np.array([3.0, speed]), 0.004, 9.81
    take_back_fall(velocity, time, (0.0, -g))
    assert velocity[0] == 3.0
    assert velocity[1] == pytest.approx(math.copysign(math.sqrt(speed**2 + 2 * g * time * speed), speed), rel=1e-14)
    turned = np.array([0.8 * 3.0 - 0.6 * speed, 0.6 * 3.0 + 0.8 * speed])
    take_back_fall(turned, time, (0.6 * g, -0.8 * g))
    np.testing.assert_allclose(turned, [0.8 * 3.0 - 0.6 * velocity[1], 0.6 * 3.0 + 0.8 * velocity[1]], rtol=1e-14)


def test_angular_momentum_changes_by_position_correction_alone():
    # Both circles get their impulses at one point. Correction moves centres along the normal, which changes Σ m x × v.
    # Two blocks of 16 circles run into each other, without gravity.
    block = np.stack(np.meshgrid(np.arange(4), np.arange(4)), -1).reshape(-1, 2) * 2.02
    position = np.concatenate([block + np.array([3.0, 11.0]), block + np.array([18.0, 11.5])])
    state = circles_at(position, velocity=np.repeat([[5.0, 0.0], [-5.0, 0.0]], 16, axis=0), gravity=(0, 0))

    def angular(bodies):
        x, v = bodies.position - 15.0, bodies.velocity
        return bodies.inertia @ bodies.spin + bodies.mass @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])

    solvers = [dc.PGS(sweeps=20, position_sweeps=sweeps) for sweeps in (0, 10)]
    ends = [angular(dc.simulate(state, steps=80, solver=solver).state.bodies) for solver in solvers]
    without, corrected = np.abs(np.array(ends) - angular(state.bodies)) / (state.bodies.mass.sum() * 5.0 * 10.0)
    assert without < 1e-13
    assert 1e-6 < corrected < 1e-2
