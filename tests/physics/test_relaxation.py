"""The convex relaxation of the contact problem: its optimality, and piles that rest."""

import numpy as np
import pytest
from scipy.optimize import nnls

import deep_contact as dc
from deep_contact.physics.engine import step_problem
from deep_contact.physics.relaxation import at_rest
from deep_contact.studies.no_past import without_past
from deep_contact.studies.piles import packed_pile, rms_speed


@pytest.fixture(scope="module")
def settling():
    return without_past(packed_pile(40, seed=3, steps=40))


def solved(problem):
    """(λ_n, λ_t, velocities along the normals, and along the tangents) of the relaxation."""
    nothing = np.zeros(len(problem.rows.body))
    normal, tangent, _ = at_rest(problem, nothing, nothing, iterations=30_000, speed=0.0)
    (n_x, n_y, _, _, arm_a, arm_b), v = problem.rows.data.T, problem.solver_bodies.copy()
    a, b = problem.rows.body.T
    p_x, p_y = normal * n_x + tangent * n_y, normal * n_y - tangent * n_x
    for body, arm, sign in ((a, arm_a, -1.0), (b, arm_b, 1.0)):
        change = np.column_stack([sign * p_x, sign * p_y, 2.0 * arm * tangent])
        np.add.at(v, (body[:, None], range(3)), v[body, 3:] * change)
    d_x, d_y = v[b, 0] - v[a, 0], v[b, 1] - v[a, 1]
    return normal, tangent, d_x * n_x + d_y * n_y, d_x * n_y - d_y * n_x + arm_a * v[a, 2] + arm_b * v[b, 2]


def test_impulses_and_velocities_lie_in_dual_cones_and_are_complementary(settling):
    """KKT: |λ_t| ≤ μ λ_n, v_n ≥ μ |v_t|, λ_n v_n + λ_t v_t = 0 at each contact."""
    problem = step_problem(settling)
    normal, tangent, v_n, v_t = solved(problem)
    assert np.abs(v_t).max() > 0.01  # some slide
    assert np.all(np.abs(tangent) <= problem.friction * normal + 1e-12)
    assert np.all(v_n - problem.friction * np.abs(v_t) > -1e-6)
    np.testing.assert_allclose(normal * v_n + tangent * v_t, 0.0, atol=1e-6 * normal.max())


def test_without_friction_it_is_the_non_negative_least_squares_problem(settling):
    problem = step_problem(settling)._replace(friction=0.0)
    normal, tangent, *_ = solved(problem)
    v, n = problem.solver_bodies, settling.bodies.count
    columns = np.zeros((n + 4, 2, len(normal)))
    for i, (a, b) in enumerate(problem.rows.body):
        columns[a, :, i], columns[b, :, i] = -problem.rows.data[i, :2], problem.rows.data[i, :2]
    system = (np.sqrt(v[:n, 3])[:, None, None] * columns[:n]).reshape(2 * n, -1)
    free = (v[:n, :2] / np.sqrt(v[:n, 3:])).ravel()
    assert not tangent.any()
    assert np.linalg.norm(system @ normal + free) == pytest.approx(nnls(system, -free)[1], rel=1e-9)


def test_a_pile_at_rest_stays_at_rest_without_its_impulses():
    past = packed_pile(150, seed=5, steps=1500).replace(solver=None)
    run, kept = (
        dc.simulate(one, steps=50, record=1, accuracy="fast") for one in (without_past(past).replace(step=0), past)
    )
    assert max(map(rms_speed, run.trajectory)) < max(map(rms_speed, kept.trajectory)) + 0.01
    assert np.abs(run.state.bodies.position - past.bodies.position).max() < 0.005
