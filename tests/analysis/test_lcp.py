"""Measures of contact problems in matrix form, by hand and against their sum."""

import numpy as np
import pytest
from conftest import circles_at, stacked

import deep_contact as dc
from deep_contact.analysis import approach, contact_problem, dissipation_gap, signorini_gap
from deep_contact.analysis.exact import solve_exactly
from deep_contact.stepping.prepare import ready

WEIGHT = 9.81 * 0.01
"""g Δt of the scenes here, m/s: the impulse that carries a kilogram."""


def measures(problem, impulse):
    return [measure(problem, np.array(impulse)) for measure in (approach, signorini_gap, dissipation_gap)]


def test_a_circle_that_nothing_holds_approaches_and_has_no_gap():
    problem = contact_problem(ready(dc.single_body()))
    assert measures(problem, [0.0, 0.0]) == pytest.approx([WEIGHT, 0.0, 0.0])


@pytest.mark.parametrize("share", [0.5, 1.0, 3.0])
def test_a_circle_that_is_pushed_too_little_or_too_much(share):
    state = ready(dc.single_body())
    mass = state.bodies.mass[0]
    expected = [max(0.0, 1.0 - share) * WEIGHT, share * abs(share - 1.0) * mass * WEIGHT**2, 0.0]
    assert measures(contact_problem(state), [share * mass * WEIGHT, 0.0]) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("speed", [-5.0, 5.0])
@pytest.mark.parametrize(("friction", "missing"), [(0.0, 1.0), (1.0, 0.0), (-1.0, 2.0)])
def test_friction_that_is_missing_or_points_the_wrong_way(speed, friction, missing):
    """A circle slides; its friction is none, all against the slip, or all with the slip. u_t is after friction."""
    scene = circles_at([[10.0, 1.01]], velocity=[[speed, 0.0]], friction=0.3, mass=2.0)
    problem, normal = contact_problem(ready(scene)), 2.0 * WEIGHT
    slip = (problem.A @ [normal, 0.0] + problem.b)[1]
    tangent = -np.sign(slip) * friction * 0.3 * normal
    slip += problem.A[1, 1] * tangent
    assert measures(problem, [normal, tangent]) == pytest.approx(
        [0.0, 0.0, missing * 0.3 * normal * abs(slip)], abs=1e-14
    )


def test_an_exact_solution_has_no_gap_and_both_gaps_are_de_saxces(falling_states):
    for state in falling_states[4::6]:
        problem = contact_problem(state)
        exact = measures(problem, stacked(solve_exactly(state, residual=1e-10).solution))
        impulse = stacked(dc.solve_contacts(state, solver=dc.PGS(sweeps=5, tolerance=None), start=None))
        swept, velocity = measures(problem, impulse), problem.A @ impulse + problem.b
        energy = problem.b @ np.abs(impulse)
        np.testing.assert_allclose(exact, 0.0, atol=1e-6 * max(1.0, abs(energy)))
        assert min(swept) > 1e3 * max(exact)
        # |λ_n u_n| + (μ λ_n |u_t| + λ_t u_t), of which the second is no negative number in the friction cone.
        normal, tangent = (
            impulse[::2],
            np.clip(impulse[1::2], -problem.friction * impulse[::2], problem.friction * impulse[::2]),
        )
        inside = np.column_stack([normal, tangent]).ravel()
        velocity = problem.A @ inside + problem.b
        corrected = velocity[::2] + problem.friction * np.abs(velocity[1::2])
        of_bipotential = normal * corrected + tangent * velocity[1::2]
        below = np.minimum(normal * velocity[::2], 0.0).sum()
        total = signorini_gap(problem, inside) + dissipation_gap(problem, inside)
        assert total + 2.0 * below == pytest.approx(of_bipotential.sum(), rel=1e-9)
