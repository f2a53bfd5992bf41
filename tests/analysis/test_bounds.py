"""Bounds on impulses against cases by hand, and against linear programs written as Coulomb's law is."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest
from conftest import circles_at
from scipy.optimize import linprog

import deep_contact as dc
from deep_contact.analysis.lcp import contact_problem, natural_residual
from deep_contact.state.constants import WALL_SKIN
from deep_contact.studies.piles import packing


def row_of_circles(count, friction, width=None):
    """Circles side by side on the floor, the first at the left wall, the last at the right one, and m g Δt."""
    centres = [(1.0 + 2.0 * i, 1.0) for i in range(count)]
    state = dc.find_contacts(circles_at(centres, box=(0, 0, width or 2.0 * count, 9), friction=friction))
    return state, state.bodies.mass[0] * -state.world.gravity[1] * state.dt


def on(state, a, b):
    """The number of a contact."""
    return int(np.flatnonzero((state.contacts.body_a == a) & (state.contacts.body_b == b))[0])


def test_the_wall_of_a_corner_carries_nothing_unless_friction_is_1():
    # Friction f on the floor, which the wall has to balance, in force and in torque: f <= μ f. From μ = 1 on f <= ∞.
    for friction, least, largest, share in ((0.5, 1.0, 1.0, 1.0), (1.5, 1.0, np.inf, 0.0)):
        state, weight = row_of_circles(1, friction, width=5.0)
        bounds = dc.force_bounds(state)
        np.testing.assert_allclose(bounds.normal / weight, [[least, largest], [0, largest - 1]], atol=1e-9)
        assert bounds.determined == share


def test_two_circles_between_walls_lean_on_each_other():
    # μ = 1/2. The friction of the wall on the first is u upwards, that between them s: N = W - u - s on the floor,
    # whose friction is u - s, by the torque. N = 0 where u = s = W/2; 2 W / (1 - μ) where
    # u = -5/2 W and s = -W/2.
    state, weight = row_of_circles(2, 0.5)
    floor, left = on(state, 0, 2), on(state, 0, 5)
    bounds = dc.force_bounds(state, [floor, left])
    np.testing.assert_allclose(bounds.normal / weight, [[0, 4], [0, np.inf]], atol=1e-9)
    np.testing.assert_allclose(bounds.tangent[1] / weight, [-0.5, 2.5], atol=0.01)  # arms are 0.995 m at the walls


@pytest.mark.parametrize("speed", [3.0, -3.0])
def test_friction_of_what_slides_drags_the_floor_along(speed):
    """t = (-1, 0) on the floor: λ_t = -μ λ_n where the circle slides to the right."""
    state = dc.find_contacts(circles_at([[5.0, 1.0]], velocity=[[speed, 0.0]], friction=0.5))
    weight, bounds = state.bodies.mass[0] * 9.81 * state.dt, dc.force_bounds(state)
    np.testing.assert_allclose(bounds.normal / weight, [[1.0, 1.0]])
    np.testing.assert_allclose(bounds.tangent / weight, [[-0.5 * np.sign(speed)] * 2])
    assert bounds.determined == 1.0


def test_a_pyramid_of_three_stands_by_friction_within_bounds():
    # Friction f at the upper contacts is, by the torques, that on the floor. On the upper circle √3 N + f = W; between
    # the lower ones K = (1 + √3 / 2) f - N / 2 >= 0; and f <= μ N.
    mu, floor = 0.5, 1.0 + WALL_SKIN - 1e-9
    centres = [(9.0, floor), (11.0 - 1e-9, floor), (10.0, floor - 1e-9 + np.sqrt(3))]
    state = dc.find_contacts(circles_at(centres, friction=mu))
    weight, root = state.bodies.mass[0] * 9.81 * state.dt, np.sqrt(3)
    f = np.array([1 / (2 * root) / (1 + root / 2 + 1 / (2 * root)), mu / (root + mu)])
    bounds = dc.force_bounds(state)
    np.testing.assert_allclose(bounds.normal[on(state, 0, 2)] / weight, (1 - f[::-1]) / root, atol=1e-6)
    np.testing.assert_allclose(
        bounds.normal[on(state, 0, 1)] / weight, [0, (1 + root / 2) * f[1] - (1 - f[1]) / (2 * root)], atol=1e-6
    )
    np.testing.assert_allclose(bounds.normal[on(state, 0, 3)] / weight, 1.5, atol=1e-6)
    assert bounds.determined == 0.0  # nor that on the floor, whose friction is f


def test_the_keystone_of_an_arch_is_wedged_within_bounds():
    # On two slopes of 45 degrees: N + f = W / √2 and |f| <= μ N.
    at = 5.0 + np.sqrt(2) * (1 + WALL_SKIN) - 1e-9
    slopes = (((2.0, 8.0), (5.0, 5.0)), ((5.0, 5.0), (8.0, 8.0)))
    state = dc.find_contacts(circles_at([(5.0, at)], friction=0.5, segments=slopes))
    weight = state.bodies.mass[0] * 9.81 * state.dt
    normal = dc.force_bounds(state).normal / weight
    np.testing.assert_allclose(normal, [[1 / 1.5 / np.sqrt(2), 1 / 0.5 / np.sqrt(2)]] * 2, atol=1e-6)


@cache
def pile(friction):
    scene = packing(16, np.random.default_rng(3), smallest=0.5, friction=friction)
    return dc.simulate(scene, steps=300, solver=dc.PGS(sweeps=1000)).state


def test_without_friction_everything_is_determined():
    bounds = dc.force_bounds(pile(0.0))
    assert bounds.determined == 1.0
    exact = dc.solve_exactly(pile(0.0)).solution
    np.testing.assert_allclose(bounds.normal[:, 0], exact.normal_impulses, atol=1e-6 * exact.normal_impulses.mean())


def test_random_solutions_lie_within_and_each_bound_is_one_of_them():
    state = pile(0.5)
    exact, bounds, problem = dc.solve_exactly(state).solution, dc.force_bounds(state), contact_problem(state)
    own = np.column_stack([exact.normal_impulses, exact.tangent_impulses]).ravel()
    scale, m = own[::2].mean(), state.contacts.count
    # Without edges: |λ_t| <= μ λ_n as rows; all contacts of this pile rest.
    cone = np.vstack([np.kron(np.eye(m), [-0.5, 1.0]), np.kron(np.eye(m), [-0.5, -1.0])])
    G = problem.jacobian.T.toarray()
    tight = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}

    def vertex(cost):
        end = linprog(cost, cone, np.zeros(2 * m), G, G @ own / scale, (None, None), "highs", options=tight)
        return scale * end.x

    rng, ends = np.random.default_rng(0), np.stack([bounds.normal, bounds.tangent], axis=1).reshape(2 * m, 2) / scale
    for cost in rng.normal(size=(100, 2 * m)):
        cost[::2] = np.abs(cost[::2]) + np.abs(cost[1::2])  # bounded below: λ_n counts for more than friction
        found = vertex(cost) / scale
        assert np.clip(found, *ends.T) == pytest.approx(found, abs=1e-7)
    for row, (least, largest) in enumerate(ends):
        for sign, end in ((1, least), (-1, largest)):
            solution = vertex(sign * np.eye(2 * m)[row])
            assert solution[row] / scale == pytest.approx(end, rel=1e-7, abs=1e-7)
            assert natural_residual(problem, solution) < 1e-8
    assert np.ptp(bounds.normal, axis=1).max() > 0.5 * scale


def test_an_executor_finds_the_bounds_that_one_process_finds():
    state = dc.find_contacts(packing(12, np.random.default_rng(3)))
    alone = dc.force_bounds(state)
    with ThreadPoolExecutor(2) as executor:
        spread = dc.force_bounds(state, jobs=executor)
    np.testing.assert_allclose(np.stack(spread[:2]), np.stack(alone[:2]), rtol=1e-6, atol=1e-9)
