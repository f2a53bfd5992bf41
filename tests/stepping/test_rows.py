"""Contacts solved by sweeps and by pivots against closed forms and invariants."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at, momentum, solved_states, stacked
from hypothesis import given, settings
from hypothesis import strategies as st

import deep_contact as dc
from deep_contact.analysis.exact import solve_exactly
from deep_contact.analysis.lcp import contact_problem
from deep_contact.stepping.convergence import mean_theta
from deep_contact.stepping.metrics import kinetic_energy
from deep_contact.stepping.prepare import ready

EXACT = dc.PGS(sweeps=20_000, tolerance=1e-13)


def by_sweeps(state):
    return dc.solve_contacts(state, solver=EXACT, start=None)


def by_pivots(state):
    zero = np.zeros(state.contacts.count)
    return solve_exactly(state, zero, zero, residual=1e-12).solution


both_ways = pytest.mark.parametrize("solved", [by_sweeps, by_pivots])


@both_ways
@pytest.mark.parametrize("n", [1, 10])
def test_column_carries_k_weights_at_level_k(n, solved):
    state = dc.simulate(dc.column(n), steps=5, solver=EXACT).state
    solution = solved(state)
    # Contacts by (a, b): 0-1, 0-floor, 1-2, ... so level k (k circles above) is contact (n - k - 1, n - k).
    below = {a: p for a, b, p in zip(state.contacts.body_a, state.contacts.body_b, solution.normal_impulses) if b < n}
    floor = solution.normal_impulses[state.contacts.body_b == n]
    weight = np.pi * 9.81 * 0.01
    np.testing.assert_allclose(floor, n * weight, rtol=1e-9)
    np.testing.assert_allclose([below[n - 1 - k] for k in range(1, n)], weight * np.arange(1, n), rtol=1e-9)
    np.testing.assert_allclose(solution.velocities, 0, atol=1e-11)


@both_ways
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_head_on_pair_ends_as_newton_says(restitution, solved):
    # One contact of two masses: m_a m_b / (m_a + m_b) times (1 + e) times the closing speed.
    state = ready(dc.two_bodies(speed=4.0, radius=(1.0, 0.5), restitution=restitution))
    m_a, m_b = state.bodies.mass
    impulse = (1 + restitution) * 4.0 / (1 / m_a + 1 / m_b)
    solution = solved(state)
    np.testing.assert_allclose(solution.normal_impulses, impulse if restitution == 0 else 0.0, rtol=1e-11)
    np.testing.assert_allclose(solution.velocities, [[2 - impulse / m_a, 0], [-2 + impulse / m_b, 0]], atol=1e-11)
    np.testing.assert_allclose(solution.angular_velocities, 0, atol=1e-14)


def test_slow_approach_does_not_bounce():
    # Slow is what gravity makes slow ((1 − e²) times 1 m/s for circles of 1 m), so nothing is without it.
    scene = dc.two_bodies(speed=0.7, restitution=0.5)
    np.testing.assert_allclose(dc.solve_contacts(scene, solver=EXACT).velocities[:, 0], [-0.175, 0.175], atol=1e-12)
    # Gravity presses no contact across it.
    across = dc.solve_contacts(scene.replace(world=replace(scene.world, gravity=(0.0, -9.81))), solver=EXACT)
    np.testing.assert_allclose(across.velocities[:, 0], [-0.175, 0.175], atol=1e-12)
    for world in (replace(scene.world, scales=dc.BOX2D), replace(scene.world, gravity=(-9.81, 0.0))):
        solution = dc.solve_contacts(scene.replace(world=world), solver=EXACT)
        np.testing.assert_allclose(np.diff(solution.velocities[:, 0]), 0, atol=1e-12)


@both_ways
@pytest.mark.parametrize(("speed", "friction_speed"), [(5.0, 0.3 * 9.81 * 0.01), (0.01, 0.01 / 3)])
def test_circle_on_the_floor_slips_or_sticks(speed, friction_speed, solved):
    # By hand: it is braked by μ g Δt, or by a third of its speed, which makes a disc roll.
    scene = dc.single_body(friction=0.3)
    solution = solved(ready(scene.replace(bodies=scene.bodies._replace(velocity=np.array([[speed, 0.0]])))))
    np.testing.assert_allclose(solution.velocities[0], [speed - friction_speed, 0.0], atol=1e-11)
    np.testing.assert_allclose(solution.angular_velocities[0], -2 * friction_speed, atol=1e-11)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), friction=st.sampled_from([0, 0.3, 1]), restitution=st.sampled_from([0, 0.5, 1]))
def test_collisions_keep_momentum_and_make_no_energy(seed, friction, restitution):
    law = {"friction": friction, "restitution": restitution}
    scene = dc.drifting_circles(25, size=14.0, radius=(0.4, 1.2), speed=3.0, seed=seed, **law)
    solver = dc.PGS(sweeps=5000, tolerance=1e-12)
    for state in solved_states(scene, steps=25, solver=solver):
        if (state.contacts.body_b >= state.bodies.count).any():
            continue  # walls take momentum up
        solution = dc.solve_contacts(state, solver=solver)
        after = state.bodies._replace(velocity=solution.velocities, spin=solution.angular_velocities)
        before = state.bodies
        np.testing.assert_allclose(momentum(after), momentum(before), atol=1e-10)
        angular = [
            b.inertia @ b.spin + b.mass @ (b.position[:, 0] * b.velocity[:, 1] - b.position[:, 1] * b.velocity[:, 0])
            for b in (before, after)
        ]
        np.testing.assert_allclose(angular[1], angular[0], atol=1e-9)
        assert kinetic_energy(after) <= kinetic_energy(before) * (1 + 1e-10)


def test_record_stops_for_a_reason(falling_states):
    state = falling_states[-1]
    assert dc.solve_contacts(state, solver=dc.PGS(sweeps=3, tolerance=None)).record.status == "max_sweeps"
    record = dc.solve_contacts(state, solver=dc.PGS(sweeps=5000, tolerance=1e-4)).record
    assert record.status == "converged"
    assert record.theta[-1] <= 1e-4 < record.theta[:-1].min()
    assert record.sweeps == record.theta.size
    assert dc.solve_contacts(dc.single_body(height=1.0)).record.status == "no_contacts"


def test_zero_sweeps_apply_the_start_only(falling_states):
    state = falling_states[3]
    solution = dc.solve_contacts(state, solver=dc.PGS(sweeps=0), start="copy")
    np.testing.assert_array_equal(solution.normal_impulses, state.contacts.normal_impulse)
    velocities = contact_problem(state).velocities(stacked(solution))
    np.testing.assert_allclose(solution.velocities, velocities.reshape(-1, 3)[:, :2], atol=1e-11)


def test_mean_theta_repeats_a_finished_step():
    # Eq 2.30 over two steps, the first of which stopped after one sweep at θ = 1 (not left out: survivor bias).
    np.testing.assert_array_equal(mean_theta([np.array([1.0]), np.array([5.0, 3.0, 1.0])], 3), [3.0, 2.0, 1.0])
    with pytest.raises(ValueError, match=r"thetas\[1\]: expected"):
        mean_theta([np.ones(1), np.empty(0)], 3)


def test_compiled_rows_have_the_friction_and_the_rolling_resistance_of_their_pair():
    """Two discs of unlike materials on a floor: one slides, v = v₀ − μ g t; one rolls, v = v₀ − ρ g t / (1.5 r).

    The other laws are tested in test_pairs.py and test_rolling.py, without the compiler.
    """
    friction, rho = [[0.5, 0.5, 0.2], [0.5, 0.5, 0.8], [0.2, 0.8, 0.5]], np.zeros((3, 3))
    rho[1, 2] = rho[2, 1] = 0.08
    state = circles_at(
        [[20.0, 1.0075], [120.0, 1.0075]], velocity=[[9.0, 0.0], [2.0, 0.0]], spin=[0.0, -2.0 / 0.99875],
        material=[0, 1], friction=friction, rolling_friction=rho, wall_materials=(2, 0, 0, 0),
        box=(0.0, 0.0, 400.0, 20.0),
    )  # fmt: skip
    end = dc.simulate(state, steps=100, solver=dc.PGS(sweeps=25, tolerance=None)).state.bodies.velocity[:, 0]
    np.testing.assert_allclose(end, [9.0 - 0.2 * 9.81, 2.0 - 0.08 * 9.81 / 1.5], rtol=0.01)
