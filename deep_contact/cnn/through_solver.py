"""Training through the solver: the velocity error after some sweeps of Projected Gauss-Seidel, and its gradient.

The network predicts a start, the impulses λ before the first sweep. A good start leaves small velocity errors after a
few sweeps. The error of λ itself is no measure, because λ is not unique, and because some of its errors vanish in one
sweep. So the loss is the velocity error after a few sweeps of the engine's own solver, in the engine's own order of the
contacts.

The gradient of the loss with respect to the start is computed by the adjoint of the sweeps. The adjoint passes over the
contacts in reverse order, once for each sweep. Each contact has two rows, a normal and a tangential one. The adjoint
treats a row as clamped in a sweep if the forward sweep clamped it. This gives the derivative almost everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.checks import check_solution
from deep_contact.state.state import State
from deep_contact.stepping.problem import step_problem
from deep_contact.stepping.rows import (
    ARM_A,
    ARM_B,
    BODY_A,
    BODY_B,
    INVERSE_MASS,
    N_X,
    N_Y,
    NORMAL_MASS,
    TANGENT_MASS,
    Rows,
    apply_impulse,
    apply_impulses,
    frictions,
    projected,
    relative_velocity,
)

_NOTHING = 1e-12
"""Limit of ‖v* − v⁻‖ in √J. Below it, the errors are set to 0.

‖v* − v⁻‖ is the mass-weighted norm of the change from v⁻, the velocities without impulses, to v*, the solved ones.
"""


class SolvedProblem(NamedTuple):
    """A contact problem with its solution."""

    rows: Rows  # rows of the contacts, with the impulses of the step before
    free: np.ndarray  # velocities after Δt of gravity without impulses, packed for the solver, (n + 4, 4)
    solution: np.ndarray  # solved impulses λ*, (m, 2), N·s
    friction: np.ndarray  # Coulomb's μ of each contact, (m,)


def solved_problem(state: State) -> SolvedProblem:
    """Return the contact problem of a solved state. Raises ValueError on a state that is not solved."""
    check_solution(state)
    rows, free, friction, _ = step_problem(state)
    friction = np.full(state.contacts.count, frictions(rows, friction))
    solution = np.column_stack([state.contacts.normal_impulse, state.contacts.tangent_impulse])
    return SolvedProblem(rows, free, solution, friction)


def errors_after(problem: SolvedProblem, start: np.ndarray, sweeps: Sequence[int]) -> np.ndarray:
    """Return the relative velocity errors after some sweeps, (len(sweeps),), as `evaluation.velocity_errors` does.

    If almost no impulses are needed (‖v* − v⁻‖ is below `_NOTHING`), all errors are 0. start: impulses before the first
    sweep, (m, 2), N·s. They are projected on the friction cone first. sweeps: numbers of sweeps, ascending.
    """
    return loss_and_gradient(problem, start, sweeps, np.zeros(len(sweeps)))[2]


def loss_and_gradient(
    problem: SolvedProblem, start: np.ndarray, sweeps: Sequence[int], weights: Sequence[float]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the loss Σ_c weights[c] · errors[c], its gradient with respect to the start, (m, 2), and the errors.

    errors[c] is the relative velocity error after sweeps[c] sweeps. The start is projected on λ_n ≥ 0 and the friction
    cone before the first sweep.

    The gradient is exact with two exceptions. If λ_n of a contact in the start is negative, the exact derivative with
    respect to this λ_n is 0. From 0, the network could never learn that the contact pushes. So the derivative with
    respect to λ_n is computed at λ_n = 0 as if the limit λ_n ≥ 0 did not exist; the friction cone still counts. This
    derivative is returned if a larger λ_n would reduce the loss by it, and otherwise 0. Secondly, if λ_n of a contact
    is 0 or negative and its λ_t is exactly 0, the derivative with respect to λ_t is returned as if the friction cone
    did not exist. The exact one is 0, because the cone allows only λ_t = 0.

    start: impulses (λ_n, λ_t), (m, 2), N·s. sweeps: numbers of sweeps, ascending. weights: (len(sweeps),). The gradient
    is in 1 / (N·s), since the errors have no unit.
    """
    sweeps, weights, start = np.asarray(sweeps), np.asarray(weights, float), np.array(start, float)
    in_cone = np.column_stack(projected(*start.T.copy(), problem.friction))
    errors, gradient = _errors_and_gradient(problem, in_cone, sweeps, weights)
    # Apply the adjoint of the projection on the friction cone.
    normal, tangent = start.T
    cut = np.abs(tangent) > problem.friction * np.maximum(normal, 0.0)
    gradient[cut, 0] += np.copysign(problem.friction[cut], tangent[cut]) * gradient[cut, 1]
    gradient[cut, 1] = 0.0
    gradient[(normal < 0.0) & (gradient[:, 0] > 0.0), 0] = 0.0
    return float(weights @ errors), gradient, errors


@njit(cache=True)
def _errors_and_gradient(problem, start, sweeps, weights):
    """Return the errors, (c,), and the gradient of Σ_c weights[c] · errors[c] with respect to the start, (m, 2).

    start: impulses within the friction cone, (m, 2), N·s. sweeps, weights: as for `loss_and_gradient`.
    """
    rows, free, solution, friction = problem
    n, count = free.shape[0] - 4, sweeps[-1]
    # The kinetic energy of a disc is m (v_x² + v_y² + s² / 2) / 2 with s = ω r. So s has half of the weight.
    metric = np.array([1.0, 1.0, 0.5]) / free[:n, 3:]
    goal, errors, by_impulse = _velocities(rows, free, solution), np.zeros(sweeps.size), np.zeros_like(start)
    change = (goal - free)[:n, :3]
    size = math.sqrt(np.sum(metric * change * change))
    if size < _NOTHING:
        return errors, by_impulse
    impulse, velocity = start.copy(), _velocities(rows, free, start)
    clamped, by_velocities = np.empty((count, *start.shape), np.int8), np.zeros((sweeps.size, n + 4, 3))
    k = 0
    for c in range(sweeps.size):
        while k < sweeps[c]:
            forward_sweep(rows, friction, velocity, impulse, clamped[k])
            k += 1
        off = (velocity - goal)[:n, :3]
        errors[c] = math.sqrt(np.sum(metric * off * off)) / size
        by_velocities[c, :n] = weights[c] / (size * size * max(errors[c], 1e-9)) * metric * off
    by_velocity = np.zeros((n + 4, 3))
    for c in range(sweeps.size - 1, -1, -1):
        by_velocity += by_velocities[c]
        while k > (sweeps[c - 1] if c > 0 else 0):
            k -= 1
            adjoint_sweep(rows, friction, free, clamped[k], by_velocity, by_impulse)
    for i in range(start.shape[0]):
        by_normal, by_tangent = _by_change(rows, free, by_velocity, i)
        by_impulse[i, 0] += by_normal
        by_impulse[i, 1] += by_tangent
    return errors, by_impulse


@njit(cache=True)
def _velocities(rows, free, impulse):
    """Return the velocities v⁻ + M⁻¹ Jᵀ λ, with the mass matrix M and the Jacobian J of the rows.

    free: v⁻, as in `SolvedProblem`. The result is packed in the same way. impulse: λ, (m, 2), N·s.
    """
    velocity = free.copy()
    apply_impulses(Rows(rows.body, rows.data, impulse), velocity, 0.0)
    return velocity


@njit(cache=True)
def forward_sweep(rows, friction, velocity, impulse, clamped):
    """Do one sweep of the engine's solver over `impulse` and `velocity`, in place, and record which rows were clamped.

    The adjoint needs the record, which the engine's own sweep does not make.
    friction: Coulomb's μ of each contact, (m,). velocity: solver bodies, (n + 4, 4), with the velocities v⁻ + M⁻¹ Jᵀ λ.
    impulse: λ, (m, 2), N·s.
    clamped: the record, (m, 2), int8, is written. clamped[i, 0] is 1 if λ_n was clamped at 0. clamped[i, 1] is ±1 if
    λ_t was clamped at ±μ λ_n. Otherwise the entries are 0.
    """
    for i in range(rows.body.shape[0]):
        row, (v_n, v_t) = rows.data[i], relative_velocity(rows, velocity, i)
        old_n, old_t = impulse[i, 0], impulse[i, 1]
        largest = friction[i] * old_n
        new_n, new_t = old_n - row[NORMAL_MASS] * v_n, old_t - row[TANGENT_MASS] * v_t
        clamped[i, 0] = clamped[i, 1] = 0
        if new_n < 0.0:
            new_n, clamped[i, 0] = 0.0, 1
        if new_t > largest:
            new_t, clamped[i, 1] = largest, 1
        elif new_t < -largest:
            new_t, clamped[i, 1] = -largest, -1
        impulse[i, 0], impulse[i, 1] = new_n, new_t
        change, arms = (new_n - old_n, new_t - old_t), (row[ARM_A], row[ARM_B])
        apply_impulse(velocity, rows.body[i, BODY_A], rows.body[i, BODY_B], (row[N_X], row[N_Y]), arms, change)


@njit(cache=True)
def adjoint_sweep(rows, friction, velocity, clamped, by_velocity, by_impulse):
    """Apply the adjoint of `forward_sweep`: turn derivatives with respect to its results into ones for its inputs.

    The results are the velocities and the impulses after the sweep, and the inputs those before it.
    rows, friction: as for `forward_sweep`. velocity: solver bodies, of which only the inverse masses are read. clamped:
    the record of `forward_sweep`. by_velocity: derivatives of the loss with respect to the velocities, (n + 4, 3),
    changed in place. by_impulse: derivatives of the loss with respect to the impulses, (m, 2), changed in place.
    """
    for i in range(rows.body.shape[0] - 1, -1, -1):
        a, b, row = rows.body[i, BODY_A], rows.body[i, BODY_B], rows.data[i]
        d_n, d_t = _by_change(rows, velocity, by_velocity, i)
        # d_n and d_t become the derivatives with respect to the changes of this contact's impulses in the sweep.
        d_n += by_impulse[i, 0]
        d_t += by_impulse[i, 1]
        if clamped[i, 1] != 0:
            by_impulse[i, 1] -= d_t
            by_impulse[i, 0] += clamped[i, 1] * friction[i] * d_t
        if clamped[i, 0] != 0:
            by_impulse[i, 0] -= d_n
        # g_n and g_t are the derivatives with respect to v_n and v_t. The result of a clamped row does not depend on
        # them.
        g_n = -row[NORMAL_MASS] * d_n if clamped[i, 0] == 0 else 0.0
        g_t = -row[TANGENT_MASS] * d_t if clamped[i, 1] == 0 else 0.0
        g_x, g_y = g_n * row[N_X] + g_t * row[N_Y], g_n * row[N_Y] - g_t * row[N_X]
        by_velocity[a, 0] -= g_x
        by_velocity[a, 1] -= g_y
        by_velocity[a, 2] += g_t * row[ARM_A]
        by_velocity[b, 0] += g_x
        by_velocity[b, 1] += g_y
        by_velocity[b, 2] += g_t * row[ARM_B]


@njit(cache=True)
def _by_change(rows, velocity, by_velocity, i):
    """Return the derivatives of the loss with respect to the normal and the tangent impulse of contact i.

    Only the effect through the velocities that these impulses change is counted. by_velocity: derivatives of the loss
    with respect to the velocities, (n + 4, 3).
    """
    a, b, row = rows.body[i, BODY_A], rows.body[i, BODY_B], rows.data[i]
    n_x, n_y, w_a, w_b = row[N_X], row[N_Y], velocity[a, INVERSE_MASS], velocity[b, INVERSE_MASS]
    g_x = w_b * by_velocity[b, 0] - w_a * by_velocity[a, 0]
    g_y = w_b * by_velocity[b, 1] - w_a * by_velocity[a, 1]
    turn = 2.0 * (w_a * row[ARM_A] * by_velocity[a, 2] + w_b * row[ARM_B] * by_velocity[b, 2])
    return g_x * n_x + g_y * n_y, g_x * n_y - g_y * n_x + turn
