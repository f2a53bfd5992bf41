"""Solvers on matrices against the engine's sweeps on the same states, and closed forms."""

import numpy as np
import pytest
from conftest import carried
from scipy import sparse

import deep_contact as dc
from deep_contact.analysis.lcp import ContactProblem, contact_problem
from deep_contact.analysis.matrix_solvers import solve_problem


@pytest.mark.parametrize("solver", [dc.PGS, dc.NesterovPGS])
def test_sweeps_of_matrices_are_those_of_the_engine(falling_states, solver):
    options = {"sweeps": 25, "tolerance": None}
    for state in falling_states[4::6]:
        expected = dc.solve_contacts(state, solver=solver(**options))
        impulse, record = solve_problem(contact_problem(state), solver(**options), carried(state))
        tolerance = 1e-10 * max(1.0, expected.normal_impulses.max())
        np.testing.assert_allclose(impulse[::2], expected.normal_impulses, atol=tolerance)
        cone = state.world.friction * expected.normal_impulses
        np.testing.assert_allclose(impulse[1::2], np.clip(expected.tangent_impulses, -cone, cone), atol=tolerance)
        np.testing.assert_allclose(record.theta, expected.record.theta, atol=tolerance)


def test_a_block_that_couples_normal_and_tangent():
    # Closed form of a sticking contact: λ = −A⁻¹ b, where the cone contains it.
    A = np.array([[2.0, 0.3], [0.3, 1.0]])
    b = np.array([-1.0, 0.1])
    expected = np.linalg.solve(A, -b)
    problem = ContactProblem(sparse.csr_array(A), b, friction=np.array([1.0]))
    for solver in (dc.PGS, dc.NesterovPGS):
        impulse, _ = solve_problem(problem, solver(sweeps=500, tolerance=1e-15))
        np.testing.assert_allclose(impulse, expected, atol=1e-12)


def test_mu_of_each_contact():
    # Two contacts that do not meet, both pushed sideways beyond their cones.
    b = np.array([-1.0, 3.0, -1.0, 3.0])
    problem = ContactProblem(sparse.csr_array(np.eye(4)), b, friction=np.array([0.2, 0.7]))
    impulse, _ = solve_problem(problem, dc.PGS(sweeps=5, tolerance=0.0))
    np.testing.assert_allclose(impulse, [1.0, -0.2, 1.0, -0.7], atol=1e-15)
