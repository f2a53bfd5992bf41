"""Errors of solutions, against matrices, by hand, and where θ misleads."""

import numpy as np
import pytest
from conftest import circles_at, stacked

import deep_contact as dc
from deep_contact.analysis.exact import solve_exactly
from deep_contact.analysis.lcp import contact_problem, natural_residual
from deep_contact.stepping import metrics
from deep_contact.stepping.prepare import ready


def rows_of(state, solution):
    """(A λ + b), (m, 2), and the diagonal of A, (m, 2), from the matrices of the textbook."""
    problem = contact_problem(state)
    return (problem.A @ stacked(solution) + problem.b).reshape(-1, 2), problem.A.diagonal().reshape(-1, 2)


def test_rows_and_masses_equal_the_matrices(falling_states):
    for state in falling_states[::3]:
        solution = dc.solve_contacts(state, solver=dc.PGS(sweeps=20, tolerance=None))
        expected, diagonal = rows_of(state, solution)
        normal, tangent = metrics.row_velocities(state, solution.velocities, solution.angular_velocities)
        np.testing.assert_allclose(normal, expected[:, 0], atol=1e-11)
        np.testing.assert_allclose(tangent, expected[:, 1], atol=1e-11)
        np.testing.assert_allclose(np.column_stack(metrics.effective_masses(state)), 1 / diagonal, rtol=1e-12)


def test_residual_is_the_natural_map(falling_states):
    # |min(λ_n / k, u_n)| in normal rows (Cottle, Pang and Stone 1992); tangent rows by their definition.
    state = falling_states[5]
    solution = dc.solve_contacts(state, solver=dc.PGS(sweeps=20, tolerance=None))
    u, diagonal = rows_of(state, solution)
    normal = np.abs(np.minimum(solution.normal_impulses * diagonal[:, 0], u[:, 0]))
    bound = state.world.friction * solution.normal_impulses * diagonal[:, 1]
    scaled = solution.tangent_impulses * diagonal[:, 1]
    tangent = np.abs(scaled - np.clip(scaled - u[:, 1], -bound, bound))
    residual = metrics.residual(state, solution)
    np.testing.assert_allclose(residual, max(normal.max(), tangent.max()), rtol=1e-9)
    assert natural_residual(contact_problem(state), stacked(solution)) == pytest.approx(residual, rel=1e-9)


@pytest.mark.parametrize("speed", [-5.0, 5.0])
def test_residual_sees_friction_that_is_missing(speed):
    # Two circles on the floor carry their weight; one of them slides without friction: what is missing there is
    # μ λ_n over the row's mass m / 3 (a disc), and nothing else is wrong.
    velocity = [[speed, 0.0], [0.0, 0.0]]
    state = ready(circles_at([[10.0, 1.01], [20.0, 1.01]], velocity=velocity, friction=0.3))
    weight = state.bodies.mass * 9.81 * 0.01
    solution = dc.solve_contacts(state, solver=dc.PGS(sweeps=0), start=(weight, np.zeros(2)))
    np.testing.assert_allclose(metrics.residual(state, solution), 0.3 * 9.81 * 0.01 * 3, rtol=1e-12)


def test_a_circle_that_was_not_stopped():
    # One step of gravity, no impulse: it still approaches at g Δt, and that is all that is wrong, or all that is done.
    state = ready(dc.single_body())
    falling = dc.solve_contacts(state, solver=dc.PGS(sweeps=0), start=None)
    held = solve_exactly(state)
    np.testing.assert_allclose(metrics.residual(state, falling), 0.0981, rtol=1e-12)
    np.testing.assert_allclose(metrics.velocity_error(state, falling, held.solution), 1.0, rtol=1e-12)
    assert metrics.velocity_error(state, held.solution, held.solution) == 0.0


def test_penetration_is_measured_where_the_bodies_are():
    state = dc.single_body(height=-0.02)
    np.testing.assert_allclose(metrics.penetration(state), 0.02, rtol=1e-12)
    assert metrics.penetration(dc.single_body(height=1.0)) == 0.0
