"""The convex relaxation of the contact problem: its optimality, and piles that rest."""

import numpy as np
import pytest
from conftest import circles_at
from scipy.optimize import nnls

import deep_contact as dc
from deep_contact.starts import changed_load, impulses_at_rest
from deep_contact.starts.changed_load import with_a_past
from deep_contact.starts.impulses_at_rest import at_rest, largest_eigenvalue
from deep_contact.stepping.problem import step_problem
from deep_contact.stepping.rows import apply_impulses, relative_velocity
from deep_contact.studies.piles import packed_pile, rms_speed_of_state, without_past


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


@pytest.mark.parametrize("width", [0.6, 0.3, 0.1])
def test_a_circle_in_a_gap_narrower_than_itself_gets_finite_impulses(width):
    """Its two normals are opposite, so that a power method from equal numbers sees nothing: 8e194 N·s, 200 m/s.

    Friction holds it: λ_t = m g Δt / 2 on each side, λ_n = λ_t / μ. The next call goes on.
    """
    state = circles_at([[width / 2, 5.0]], box=(0, 0, width, 30), friction=0.5)
    run = dc.simulate(state, steps=60, record=1)
    assert run.state.contacts.normal_impulse.max() < 1.1 * np.pi * 9.81 * 0.01
    assert np.abs(run.trajectory.velocities).max() < 0.3
    assert np.isfinite(dc.simulate(run.state, steps=60).state.bodies.velocity).all()


def block(rows, columns, width):
    """A block of circles in hexagonal order, in a box of some width: the same contacts over and over."""
    centres = [[0.5 + 1.99 * i + k % 2, 1.0 + 1.73 * k] for k in range(rows) for i in range(columns)]
    return circles_at(centres, box=(0, 0, width, 99), friction=0.5)


@pytest.mark.parametrize("scene", [block(1, 1, 1.0), block(8, 1, 3.0), block(5, 6, 14.0)])
def test_the_bound_of_the_steps_is_no_less_than_the_largest_eigenvalue(scene):
    # Of D^½ J M⁻¹ Jᵀ D^½ with D the effective masses along the normals, from the columns of its products.
    problem = step_problem(dc.find_contacts(scene))
    rows, v = problem.rows, problem.solver_bodies
    columns = []
    for impulse in np.eye(2 * len(rows.body)).reshape(-1, len(rows.body), 2):
        change = v * [0, 0, 0, 1]
        apply_impulses(rows._replace(impulse=impulse), change, problem.friction)
        columns.append([relative_velocity(rows, change, i) for i in range(len(rows.body))])
    scaled = np.repeat(rows.data[:, 2], 2)[:, None] * np.reshape(columns, (2 * len(rows.body), -1)).T
    assert largest_eigenvalue(rows, problem.friction, v.copy()) >= np.linalg.eigvals(scaled).real.max()


def test_steps_that_are_too_long_are_made_shorter(settling, monkeypatch):
    # From a sixth of the bound, as a start orthogonal to what is sought gives it, the same minimum is found.
    problem, speeds = step_problem(settling), []
    for share in (1.0, 1.0 / 6.0):
        rows, v = problem.rows._replace(impulse=np.zeros((len(problem.rows.body), 2))), problem.solver_bodies.copy()
        largest = share * largest_eigenvalue(rows, problem.friction, v.copy())
        monkeypatch.setattr(impulses_at_rest, "largest_eigenvalue", lambda *_, largest=largest: largest)
        speeds.append(impulses_at_rest.relax_cones.py_func(rows, problem.friction, v, 1000, 0.0, np.inf))
    np.testing.assert_allclose(speeds[1], speeds[0], rtol=1e-3)


def iterations_of(problem, needed, monkeypatch):
    """(number of iterations, rms speed): of the relaxation from impulses of 0, with a cap of 2,000."""
    calls, approach = [], impulses_at_rest.approach
    monkeypatch.setattr(impulses_at_rest, "approach", lambda *arguments: calls.append(0) or approach(*arguments))
    rows, v = problem.rows._replace(impulse=np.zeros((len(problem.rows.body), 2))), problem.solver_bodies.copy()
    rms = impulses_at_rest.relax_cones.py_func(rows, problem.friction, v, 2000, 1e-6, needed)
    monkeypatch.undo()
    return len(calls), rms


def test_iterations_end_where_nothing_can_rest(monkeypatch):
    """A disc between two others on a floor without friction pushes them apart: no impulses hold it."""
    state = circles_at([[5.0, 1.0], [7.5, 1.0], [6.25, 2.5612494995995996]], friction=0.0)
    problem = step_problem(dc.find_contacts(state))
    needed = 0.02 * 0.0981
    count, rms = iterations_of(problem, needed, monkeypatch)
    assert rms > needed
    assert count == 25 * (impulses_at_rest.PAST + 1)
    count, unhurried = iterations_of(problem, np.inf, monkeypatch)
    assert count == 2000
    assert unhurried == pytest.approx(rms, rel=0.01)


def test_iterations_go_on_where_circles_come_to_rest(monkeypatch):
    state = dc.find_contacts(without_past(packed_pile(40, seed=3, steps=1000)))
    problem = step_problem(state)
    assert iterations_of(problem, 0.02 * 0.0981, monkeypatch) == iterations_of(problem, np.inf, monkeypatch)


@pytest.mark.parametrize(("rms", "before", "left", "is_out"), [
    (1.0, 2.0, 100, False), (1.0, 2.0, 99, True), (1.0, 1.0, 10_000, True), (0.4, 0.4, 0, False), (0.6, 9.0, 0, True),
])  # fmt: skip
def test_the_rate_of_the_last_100_iterations_is_that_of_those_to_come(rms, before, left, is_out):
    """Half of the speed in 100 iterations, and half of it is needed."""
    assert impulses_at_rest._misses(rms, before, left, 0.5) == is_out


@pytest.mark.parametrize("factor", [np.nan, -3.0, 1e30])
def test_impulses_that_are_no_start_are_not_used(factor, monkeypatch):
    # Not finite, or with more energy than none: the run begins without.
    state = dc.find_contacts(without_past(packed_pile(20, seed=1, steps=1000)))
    assert with_a_past(state).contacts.have_past
    found = at_rest(step_problem(state), *np.zeros((2, state.contacts.count)), iterations=500, speed=0.0)[:2]
    with np.errstate(invalid="ignore"):
        wrong = factor * found[0], factor * found[1], 0.0
    monkeypatch.setattr(changed_load, "at_rest", lambda *_, **__: wrong)
    assert not with_a_past(state).contacts.have_past


def test_a_pile_at_rest_stays_at_rest_without_its_impulses():
    past = packed_pile(150, seed=5, steps=1500).replace(solver=None)
    run, kept = (
        dc.simulate(one, steps=50, record=1, accuracy="fast") for one in (without_past(past).replace(step=0), past)
    )
    assert max(map(rms_speed_of_state, run.trajectory)) < max(map(rms_speed_of_state, kept.trajectory)) + 0.01
    assert np.abs(run.state.bodies.position - past.bodies.position).max() < 0.005


def test_the_speed_that_is_left_is_that_of_the_circles_alone():
    """Two circles at 5 m/s and 0, and four walls, which belts may move."""
    v = np.array([[3.0, 4.0, 9.0, 1.0], [0.0, 0.0, 9.0, 1.0], *[[7.0, 7.0, 7.0, 0.0]] * 4])
    assert impulses_at_rest.rms_speed(v) == pytest.approx(5.0 / np.sqrt(2.0))
    assert impulses_at_rest.rms_speed(v[2:]) == 0.0
