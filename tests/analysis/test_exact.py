"""Exact solutions by pivoting against analytic ones, non-negative least squares, dense matrices, and what sweeps do."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from conftest import circles_at, solved_states, stacked
from scipy import sparse

import deep_contact as dc
from deep_contact.analysis import exact, proximal_path
from deep_contact.analysis.exact import solve_exactly
from deep_contact.analysis.lcp import ContactProblem, check_problem, contact_problem, natural_residual
from deep_contact.analysis.matrix_solvers import blocks_of
from deep_contact.stepping import metrics
from deep_contact.stepping.prepare import ready
from deep_contact.studies import piles


def from_nothing(state, **options):
    """Without a start, so that the pivots have everything to do."""
    zero = np.zeros(state.contacts.count)
    return solve_exactly(state, zero, zero, **options)


def check_solution(state, found, residual=1e-8):
    """It solves Eq 2.27 and 2.29: by `metrics.residual`, in the cone, and a sweep of PGS leaves it as it is."""
    solution = found.solution
    assert found.converged
    assert solution.record.status == "converged"
    assert found.residual == metrics.residual(state, solution) <= residual
    normal, tangent = solution.normal_impulses, solution.tangent_impulses
    assert normal.min() >= 0
    assert (np.abs(tangent) <= state.world.friction * normal).all()
    swept = dc.solve_contacts(state, solver=dc.PGS(sweeps=1), start=(normal, tangent))
    # A row's change is its effective mass, at most the mass of a circle, times what is wrong there, plus what the
    # rows before it changed: a handful of neighbours.
    assert swept.record.theta[0] <= 10 * residual * state.bodies.mass.max()


def test_every_state_of_a_fall_is_solved(falling_states):
    found = [from_nothing(state) for state in falling_states]
    for state, one in zip(falling_states, found):
        check_solution(state, one)
    assert sum(one.pivots for one in found) > 1000


@pytest.mark.parametrize("friction", [0.0, 0.1, 1.0, 1000.0])
def test_circles_of_all_sizes_with_any_friction(friction):
    scene = dc.lattice_in_box(40, radius=(0.2, 1.0), density=3.0, friction=friction, seed=2)
    for state in solved_states(scene, steps=200, every=20):
        check_solution(state, from_nothing(state))


def touching(centres, **world):
    """A state of circles of radius 1 at these centres, which overlap by so much that rounding opens no contact."""
    return ready(circles_at(np.array(centres) * 0.9999, **world))


def test_silo_carries_k_weights_at_level_k():
    # Walls that touch on both sides: any thrust of one on the other is a solution, so A is singular.
    n = 30
    state = touching([(1.009, 1.01 + 2 * k) for k in range(n)], friction=0.0, box=(0, 0, 2.018, 100))
    solution = from_nothing(state, residual=1e-12).solution
    assert state.contacts.count == 3 * n
    resting = state.contacts.body_b <= n
    weight = np.pi * 9.81 * 0.01
    # By (a, b): 0-1, 0-floor, 1-2, … so that the floor comes second, with all n of them on it.
    expected = weight * np.array([n - 1, n, *range(n - 2, 0, -1)])
    np.testing.assert_allclose(solution.normal_impulses[resting], expected, rtol=1e-9)


def test_pyramid_stands_on_friction():
    # Three, two, one: 24 rows for 18 velocities, and without friction the lowest row would spread. (Taller ones may
    # hold or let go, either way within Coulomb's law.)
    centres = [(10 + 2 * i + k, 1.01 + np.sqrt(3) * k) for k in range(3) for i in range(3 - k)]
    still = {}
    for friction in (0.0, 1.0):
        state = touching(centres, friction=friction)
        assert state.contacts.count == 12
        found = from_nothing(state, residual=1e-10)
        check_solution(state, found, residual=1e-10)
        floor = found.solution.normal_impulses[state.contacts.body_b == len(centres)].sum()
        still[friction] = np.abs(found.solution.velocities).max()
    np.testing.assert_allclose(floor, state.bodies.mass.sum() * 9.81 * 0.01, rtol=1e-8)
    assert still[1.0] < 1e-9 < 1e-3 < still[0.0]


def test_a_settling_pile_that_sweeps_do_not_solve():
    state = piles.pile_states(piles.pile("settling", 300, 2), count=1)[0]
    swept = metrics.residual(state, dc.solve_contacts(state, solver=dc.PGS(sweeps=5000, tolerance=None)))
    found = solve_exactly(state)
    check_solution(state, found)
    assert found.residual < swept / 100
    assert found.factorizations > 0


def bare(problem):
    """The problem without its bodies."""
    return ContactProblem(problem.A, problem.b, friction=problem.friction)


@pytest.mark.parametrize("friction", [0.5, 0.0])
@pytest.mark.parametrize("k", [3, 7, 9])
def test_a_proximal_step_solves_its_problem(falling_states, k, friction, monkeypatch):
    # The natural map of the contact problem with ε diag(A) (λ − c) added to the velocities, in dense matrices. Factors
    # that are taken anew after 3 rows lead along the same path.
    state = falling_states[k]
    problem = check_problem(contact_problem(state.replace(world=replace(state.world, friction=friction))))
    step, epsilon, A = partial(exact._step, problem, blocks_of(problem)), 1e-2, problem.A.toarray()
    start, taken = np.zeros((state.contacts.count, 2)), []
    assert step(start, epsilon, 5)[:2] == (None, 5)
    for refresh in (proximal_path.REFRESH, 3):
        monkeypatch.setattr(proximal_path, "REFRESH", refresh)
        end, pivots, _ = step(start, epsilon, 1000)
        impulse = end.ravel()
        u = A @ impulse + problem.b + epsilon * np.diag(A) * impulse
        free = impulse - u / np.diag(A)
        normal, bound = np.maximum(free[::2], 0.0), friction * impulse[::2]
        np.testing.assert_allclose(impulse[::2], normal, atol=1e-10)
        np.testing.assert_allclose(impulse[1::2], np.clip(free[1::2], -bound, bound), atol=1e-10)
        taken.append(pivots)
    assert taken[0] == taken[1] > 5


@pytest.mark.parametrize("with_bodies", [True, False])
def test_a_problem_of_matrices_is_solved_as_its_state(falling_states, with_bodies):
    state = falling_states[9]
    problem, zero = contact_problem(state), np.zeros(state.contacts.count)
    problem = problem if with_bodies else bare(problem)
    found, expected = solve_exactly(problem, zero, zero, residual=1e-10), from_nothing(state, residual=1e-10)
    assert found.converged
    assert found.residual == pytest.approx(natural_residual(check_problem(problem), stacked(found.solution)), abs=1e-14)
    if with_bodies:
        np.testing.assert_allclose(found.solution.velocities, expected.solution.velocities, atol=1e-9)
    else:
        assert found.solution.velocities.shape == (0, 2)
    assert solve_exactly(problem).converged


def packings():
    """States whose matrices have dependent rows: columns, hexagonal packings, walls that touch on both sides."""
    for friction in (0.0, 0.5, 10.0):
        for gravity in ((0.0, -9.81), (0.0, 0.0), (3.0, -9.81)):
            world = {"friction": friction, "gravity": gravity}
            for n in (1, 12):
                yield touching([(1.009, 1.01 + 2 * k) for k in range(n)], box=(0, 0, 2.018, 100), **world)
            for rows in (2, 5):
                hexagonal = [(10 + 2 * i + k % 2, 1.01 + np.sqrt(3) * k) for k in range(rows) for i in range(5 - k % 2)]
                yield touching(hexagonal, **world)
                yield touching([(10 + 2 * i, 1.01 + 2 * k) for k in range(rows) for i in range(3)], **world)


def test_packings_whose_rows_depend_on_each_other_are_solved():
    for state in packings():
        check_solution(state, solve_exactly(state))


@pytest.mark.parametrize(("sweeps", "expected"), [(0, (1.0, 0.5)), (1, (0.1, 0.05))])
def test_what_is_swept_lies_in_the_cone(sweeps, expected):
    # By hand, A = I and μ = ½: a sweep holds λ_t at ½ λ_n = ½ of before it, then λ_n falls to 0.1.
    problem = ContactProblem(sparse.csr_array(np.eye(2)), np.array([-0.1, -1.0]), friction=np.array([0.5]))
    np.testing.assert_allclose(exact._swept(blocks_of(problem), np.array([[1.0, 2.0]]), sweeps), [expected], rtol=1e-12)


@pytest.mark.parametrize("tangent", [0.0, 0.5, -0.5])
def test_a_drift_ends_where_a_contact_reaches_its_bound(tangent):
    # Two contacts that share a load, so that their sum alone counts: one gives up what it does not need for λ_t, μ = ½.
    A = sparse.csr_array(np.kron(np.ones((2, 2)), np.eye(2)))
    blocks = blocks_of(ContactProblem(A, np.array([-4.0, 0.0, -4.0, 0.0]), friction=np.full(2, 0.5)))
    before, least = np.array([[2.0, tangent], [2.0, -tangent]]), 2 * abs(tangent)
    found = exact._drifted(blocks, before, before + np.array([[-0.1, 0.0], [0.1, 0.0]]))
    np.testing.assert_allclose(found, [[least, tangent], [4 - least, -tangent]], atol=1e-12)


def test_a_solution_is_left_as_it_is(falling_states):
    state = falling_states[-1]
    first = from_nothing(state).solution
    again = solve_exactly(state, first.normal_impulses, first.tangent_impulses)
    assert (again.factorizations, again.pivots) == (0, 0)
    np.testing.assert_array_equal(again.solution.normal_impulses, first.normal_impulses)
    np.testing.assert_array_equal(again.solution.tangent_impulses, first.tangent_impulses)


def test_too_few_pivots_give_the_best_so_far(falling_states):
    # Another limit cuts the same path elsewhere, or its last step short, so no smaller one can come to more.
    for state in falling_states[-3:]:
        none, residuals = dc.solve_contacts(state, solver=dc.PGS(sweeps=0), start=None), []
        for limit in (0, 1, 2, 4, 8, 16, 32, 64, 128, 256):
            found = from_nothing(state, residual=1e-14, most_pivots=limit)
            assert not found.converged
            assert found.solution.record.status == "max_sweeps"
            assert found.pivots + found.factorizations <= limit + 1
            assert found.residual == metrics.residual(state, found.solution)
            residuals.append(found.residual)
            p_n, p_t = found.solution.normal_impulses, found.solution.tangent_impulses
            assert (np.abs(p_t) <= state.world.friction * p_n).all()
        assert residuals == sorted(residuals, reverse=True)
        assert residuals[0] <= metrics.residual(state, none)


def test_a_singular_step_is_given_up():
    # Two rows that say the same, and nothing to hold them apart.
    problem = ContactProblem(sparse.csr_array(np.ones((2, 2))), -2 * np.ones(2), friction=np.array([2.0]))
    assert exact._step(problem, blocks_of(problem), np.ones((1, 2)), 0.0, 9)[:2] == (None, 0)


def test_sweeps_that_diverge_do_no_harm(falling_states, monkeypatch):
    # Those between the steps are made to, once.
    steps = iter([(np.full((falling_states[4].contacts.count, 2), np.nan), 1, 1)])
    step = exact._step
    monkeypatch.setattr(exact, "_step", lambda *arguments: next(steps, None) or step(*arguments))
    check_solution(falling_states[4], from_nothing(falling_states[4]))


def test_what_it_cannot_solve_does_not_raise():
    # Masses that differ by more than numbers have digits, and impulses to start from that swamp all others.
    masses = np.array([1e-30, 1e30, 1.0, 1e30, 1e-30])
    state = ready(circles_at([(9, 1 + 2 * k) for k in range(5)], mass=masses))
    huge = np.full(state.contacts.count, 1e50)
    for start in ((), (huge, -huge)):
        found = solve_exactly(state, *start, most_pivots=500)
        assert np.isfinite(found.solution.velocities).all()
        assert found.solution.normal_impulses.min() >= 0
        assert found.residual == metrics.residual(state, found.solution)


def test_it_ends_where_rounding_lets_it_no_further(falling_states):
    found = from_nothing(falling_states[4], residual=1e-300)
    assert 0 < found.residual < 1e-11
    assert found.factorizations < 1000


def test_nothing_to_solve():
    state = ready(dc.single_body(height=1.0))
    found = solve_exactly(state)
    assert found[1:] == (0.0, True, 0, 0)
    assert found.solution.record.status == "no_contacts"
    np.testing.assert_allclose(found.solution.velocities, [[0.0, -0.0981]], rtol=1e-12)


@pytest.mark.parametrize(("residual", "status"), [(0.11, "converged"), (0.09, "max_sweeps")])
def test_converged_is_what_leaves_no_more_than_the_residual(residual, status, monkeypatch):
    """A circle on the floor that nothing carries: g Δt = 0.098 m/s."""
    state = dc.find_contacts(circles_at([[5.0, 1.0]]))
    monkeypatch.setattr(exact, "_solved", lambda *_: (np.zeros(2), 3, 4))
    found = solve_exactly(state, residual=residual)
    assert found.residual == pytest.approx(0.0981)
    assert (found.converged, found.solution.record.status) == (status == "converged", status)
    assert (found.factorizations, found.pivots) == (3, 4)
