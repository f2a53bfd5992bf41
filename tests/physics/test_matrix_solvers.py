"""Solvers on matrices against the engine's sweeps on the same states, closed forms, and Siconos's measure of error."""

import numpy as np
import pytest
from conftest import carried
from scipy import sparse

import deep_contact as dc
from deep_contact.physics.lcp import ContactProblem, contact_problem, siconos_error
from deep_contact.physics.matrix_solvers import CHECK_EVERY, blocks_of, is_met, solve_problem


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


@pytest.mark.parametrize(("b", "error"), [((-1.0, 0.0), 1.0), ((-1.0, -2.0), np.hypot(0.8, 0.4) / np.sqrt(5))])
def test_siconos_error_by_hand(b, error):
    # λ = 0 and u = b, μ = ½. (−1, 0): z = (1, 0) is in the cone, so the distance is 1, over max(0, 1, 1).
    # (−1, −2): z = (1 − 1, 2), whose projection on the edge (1, ½) is (0.8, 0.4).
    problem = ContactProblem(sparse.csr_array(np.eye(2)), np.array(b), friction=np.array([0.5]))
    assert siconos_error(problem, np.zeros(2)) == pytest.approx(error, rel=1e-14)


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


@pytest.mark.parametrize("solver", [dc.PGS, dc.NesterovPGS])
def test_sweeping_ends_at_the_error_asked_for(falling_states, solver):
    problem = contact_problem(falling_states[7])
    impulse, record = solve_problem(problem, solver(sweeps=20_000, tolerance=None), error=1e-6)
    assert record.status == "converged"
    assert record.sweeps % 10 == 0
    assert siconos_error(problem, impulse) <= 1e-6
    _, record = solve_problem(problem, solver(sweeps=10, tolerance=None), error=1e-12)
    assert (record.status, record.sweeps) == ("max_sweeps", 10)


@pytest.mark.parametrize("b", [(-1.0, 2.0), (-30.0, 0.0)])
@pytest.mark.parametrize("stiffness", [0.01, 10.0])
def test_the_error_that_sweeps_are_asked_for_is_siconos_error(stiffness, b):
    # Its scale is the largest of λ, u and b; each is that somewhere here.
    problem = ContactProblem(sparse.csr_array(stiffness * np.eye(2)), np.array(b), friction=np.array([0.5]))
    impulse = np.array([[4.0, 1.5]])
    error = siconos_error(problem, impulse.ravel())
    for factor, met in ((1 - 1e-9, False), (1 + 1e-9, True)):
        assert is_met(blocks_of(problem), impulse, factor * error, CHECK_EVERY - 1) == met
