"""Every method against the same contact problems: nnls, the natural map, sweeps done by hand, and whole runs."""

import numpy as np
import pytest
from conftest import carried, stacked

import deep_contact as dc
from deep_contact.analysis.lcp import contact_problem
from deep_contact.solvers import METHODS, describe, nesterov
from deep_contact.stepping import metrics
from deep_contact.stepping.problem import solve, step_problem

PAST_NEED = {"sweeps": 100_000, "tolerance": 1e-11}
EXACT = [method(**PAST_NEED) for method in METHODS.values()]


@pytest.mark.parametrize("solver", EXACT, ids=describe)
def test_frictionless_velocities_equal_nnls(solver, frictionless_states, nnls_velocities):
    for state, velocity in zip(frictionless_states, nnls_velocities):
        solution = dc.solve_contacts(state, solver=solver)
        # Of circles that touch all around each other, colours take more than 100,000 sweeps.
        close = 1e-8 if solution.record.status == "converged" else 1e-4
        np.testing.assert_allclose(solution.velocities, velocity[:, :2], atol=close)
        np.testing.assert_allclose(solution.angular_velocities, velocity[:, 2], atol=close)


@pytest.mark.parametrize("solver", EXACT, ids=describe)
def test_solution_is_complementary_and_in_the_cone(solver, falling_states):
    # Eq 2.27 and 2.29 row by row; θ of 1e-11 N·s over masses of 1 kg and more leaves far less than 1e-8 m/s.
    done = 0
    for state in falling_states[::3]:
        solution = dc.solve_contacts(state, solver=solver)
        if solution.record.status == "converged":  # with friction nothing promises that it does
            done += 1
            largest = state.world.friction * solution.normal_impulses
            assert (solution.normal_impulses >= 0).all()
            assert (np.abs(solution.tangent_impulses) <= largest + 1e-8).all()
            assert metrics.residual(state, solution) < 1e-8
    assert done >= 0.8 * len(falling_states[::3])


def problem_of(state):
    """A, b, μ and the impulses to start from, rows as `contact_problem` numbers them."""
    problem = contact_problem(state)
    return problem.A.toarray(), problem.b, state.world.friction, carried(state)


def swept(A, b, mu, impulse, *, omega=1.0, friction_omega=None):
    """λ after one sweep by hand: every change of a row times ω, cut to what is admissible; tangent row first."""
    factors = omega, omega if friction_omega is None else friction_omega
    impulse = impulse.copy()
    for row in range(0, b.size, 2):
        for i in (row + 1, row):
            free = impulse[i] - factors[i - row] * (A[i] @ impulse + b[i]) / A[i, i]
            bound = mu * max(impulse[row], 0.0)  # momentum may have carried λ_n below 0
            impulse[i] = max(free, 0.0) if i == row else max(-bound, min(free, bound))
    return impulse


def assert_impulses(solution, impulse):
    # Equal but for rounding, which tens of sweeps do not amplify beyond 1e-11.
    np.testing.assert_allclose(solution.normal_impulses, impulse[::2], atol=1e-11 * impulse.max())
    np.testing.assert_allclose(solution.tangent_impulses, impulse[1::2], atol=1e-11 * impulse.max())


OMEGAS = [(dc.PGS, {}), (dc.PSOR, {"omega": 1.4}), (dc.PSOR, {"omega": 1.8, "friction_omega": 1.3})]


@pytest.mark.parametrize(("method", "omega"), OMEGAS)
def test_sweeps_are_those_of_algorithm_1_over_relaxed(falling_states, method, omega):
    for state in falling_states[1::4]:
        A, b, mu, impulse = problem_of(state)
        for _ in range(5):
            before, impulse = impulse, swept(A, b, mu, impulse, **omega)
        solution = dc.solve_contacts(state, solver=method(sweeps=5, tolerance=None, **omega))
        assert_impulses(solution, impulse)
        # By the smaller ω, so that θ is no less than what a plain sweep would have changed.
        theta = np.abs(impulse - before).max() / min(omega.values(), default=1.0)
        assert solution.record.theta[-1] == pytest.approx(theta, rel=1e-9)


@pytest.mark.parametrize("sweeps", [2, 3, 6, 20])
def test_nncg_is_fletcher_and_reeves_on_sweeps(falling_states, sweeps):
    # Silcowitz et al. 2010, Algorithm 3: λ ← λ + β p, p ← β p − ∇f with −∇f the sweep's change; p ← 0 where β > 1.
    A, b, mu, impulse = problem_of(falling_states[5])
    along, last = np.zeros_like(impulse), np.inf
    for k in range(sweeps):
        after = swept(A, b, mu, impulse)
        change, size = after - impulse, ((after - impulse) ** 2).sum()
        impulse = after
        if k < sweeps - 1:
            beta, last = size / last, size
            impulse = after + (beta <= 1) * beta * along
            along = beta * along + change if beta <= 1 else np.zeros_like(along)
    assert_impulses(dc.solve_contacts(falling_states[5], solver=dc.NNCG(sweeps=sweeps, tolerance=None)), impulse)


@pytest.mark.parametrize("solver", EXACT, ids=describe)
def test_velocities_stay_those_of_the_impulses(solver, falling_states):
    # v = v⁻ + M⁻¹ Jᵀ λ after hundreds of extrapolations: rounding adds up to far less than 1e-9 m/s.
    state = falling_states[4]
    solution = dc.solve_contacts(state, solver=type(solver)(sweeps=300, tolerance=None))
    velocity = contact_problem(state).velocities(stacked(solution)).reshape(-1, 3)
    np.testing.assert_allclose(solution.velocities, velocity[:, :2], atol=1e-9)
    np.testing.assert_allclose(solution.angular_velocities, velocity[:, 2], atol=1e-9)


@pytest.mark.parametrize("sweeps", [2, 4, 5])
def test_momentum_is_nesterovs(falling_states, sweeps):
    # β = (t − 1) / t⁺ from t = 1, restarted by the gradient; within the first window only sudden growth binds it.
    A, b, mu, start = problem_of(falling_states[5])
    last, t, most, size, shares = start, 1.0, nesterov.FIRST_MOMENTUM, np.inf, []
    for _ in range(sweeps):
        impulse = swept(A, b, mu, start)
        size, before = ((impulse - start) ** 2).sum(), size
        most = 2 * most - 1 if size > 1.2 * before else most
        after = (1 + np.sqrt(1 + 4 * t * t)) / 2
        uphill = (impulse - start) @ (impulse - last) < 0
        share, t = (0.0, 1.0) if uphill else (min((t - 1) / after, most), after)
        shares.append(share)
        start, last = impulse + share * (impulse - last), impulse
    assert sweeps < 4 or max(shares[:-1]) > 0.2
    assert_impulses(dc.solve_contacts(falling_states[5], solver=dc.NesterovPGS(sweeps=sweeps, tolerance=None)), impulse)


def test_what_is_not_finite_any_more_is_called_diverged(falling_states):
    # Past the face of the package, which refuses such a start.
    state = falling_states[5]
    huge = np.full(state.contacts.count, 1e308)
    for method in (dc.PGS, dc.NNCG, dc.NesterovPGS):
        assert solve(state, method(), huge, huge).record.status == "diverged"


@pytest.mark.parametrize("method", METHODS.values())
def test_a_problem_that_is_solved_twice_stays_as_it_is(method, falling_states):
    """`problem.solve` takes a problem that is at hand; over-relaxation scales effective masses in place."""
    state = falling_states[-1]
    problem, zero = step_problem(state), np.zeros(state.contacts.count)
    first, again = (solve(state, method(sweeps=5), zero, zero, problem) for _ in range(2))
    np.testing.assert_array_equal(first.velocities, again.velocities)
