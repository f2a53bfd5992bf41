"""The loss through the solver against the engine's own sweeps, and its gradient against finite differences."""

import numpy as np
import pytest

from deep_contact.cnn.evaluation import velocity_errors
from deep_contact.cnn.through_solver import errors_after, loss_and_gradient, solved_problem
from deep_contact.stepping.rows import projected

SWEEPS, WEIGHTS = (0, 3, 10), (0.5, 1.0, 2.0)


def builtin(state):
    return np.column_stack([state.contacts.normal_start, state.contacts.tangent_start])


@pytest.mark.parametrize("index", [2, 6, 12])
def test_errors_are_those_of_the_engines_sweeps(falling_states, index):
    state = falling_states[index]
    # Builtin's friction may lie a little outside of the cone: its normal impulse was swept after it.
    start = np.column_stack(projected(*builtin(state).T, state.world.friction))
    expected = velocity_errors(state, (start[:, 0], start[:, 1]), sweeps=(0, 3, 30))
    np.testing.assert_allclose(errors_after(solved_problem(state), start, (0, 3, 30)), expected, rtol=1e-9)


@pytest.mark.parametrize("index", [2, 6, 12])
def test_gradient_equals_finite_differences(falling_states, index):
    problem = solved_problem(falling_states[index])
    rng = np.random.default_rng(index)
    # Away from the solution, where the error has a kink, and from λ = 0, where the projection has one.
    start = problem.solution * rng.uniform(0.6, 1.4, problem.solution.shape)
    start[:, 0] += 0.05
    gradient = loss_and_gradient(problem, start, SWEEPS, WEIGHTS)[1]
    numeric = central_differences(lambda x: loss_and_gradient(problem, x, SWEEPS, WEIGHTS)[0], start)
    np.testing.assert_allclose(gradient, numeric, atol=1e-5 * np.abs(gradient).max())


def central_differences(loss, start, step=1e-7):
    numeric = np.zeros_like(start)
    for i, j in np.ndindex(start.shape):
        change = np.zeros_like(start)
        change[i, j] = step
        numeric[i, j] = (loss(start + change) - loss(start - change)) / (2 * step)
    return numeric


def test_a_contact_cut_at_zero_can_learn_to_push(falling_states):
    problem = solved_problem(falling_states[6])
    start = builtin(falling_states[6])
    strongest = int(problem.solution[:, 0].argmax())
    start[strongest] = [-0.1, 0.0]
    _, gradient, _ = loss_and_gradient(problem, start, (0,), (1.0,))
    assert gradient[strongest, 0] < 0
