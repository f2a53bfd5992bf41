"""Training through the solver: the velocity error after some sweeps of Projected Gauss-Seidel, and its exact gradient.

A start serves the velocities after the few sweeps that a user pays for. λ itself is not unique, and errors that one
sweep removes do not matter. So the loss is the error after those sweeps, of the engine's own solver in its own order.
Its gradient with respect to the start is the adjoint of the sweeps: one pass back over the contacts per sweep, with the
clamps of the forward pass (almost everywhere the derivative).

The error of the velocities needs the solution. The loss may instead be the change by one more sweep ("residual"), which
needs no labels. `impulse_loss` is the plain regression on λ, for comparison.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.cnn.far_field import row_velocity
from deep_contact.physics.contact_solver import (
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
    projected,
)
from deep_contact.physics.engine import step_problem
from deep_contact.state import State
from deep_contact.validation import one_of

_NOTHING = 1e-12
"""‖v* − v⁻‖, √J, below which there is nothing to solve and the error is 0."""


class SolvedProblem(NamedTuple):
    """A contact problem with its solution."""

    rows: Rows  # with the impulses of Builtin's start
    free: np.ndarray  # velocities after Δt of gravity, packed for the solver, (n + 4, 4)
    solution: np.ndarray  # λ*, (m, 2), N·s
    friction: float


def solved_problem(state: State) -> SolvedProblem:
    """The contact problem of a solved state. Raises ValueError on a state that is not solved."""
    if state.contacts is None or not state.solved:
        raise ValueError("state.solved: expected a state that holds its solution, got False")
    rows, free, friction = step_problem(state)
    solution = np.column_stack([state.contacts.normal_impulse, state.contacts.tangent_impulse])
    return SolvedProblem(rows, free, solution, friction)


def errors_after(problem: SolvedProblem, start: np.ndarray, sweeps: Sequence[int]) -> np.ndarray:
    """‖v − v*‖ / ‖v* − v⁻‖ in the norm of kinetic energy after so many sweeps from a start (m, 2), projected first.

    It is `evaluation.velocity_errors` on packed arrays, with one run for all numbers of sweeps, which increase.
    Returns (len(sweeps),); 0 where there is nothing to solve.
    """
    return loss_and_gradient(problem, start, sweeps, np.zeros(len(sweeps)))[2]


def loss_and_gradient(
    problem: SolvedProblem, start: np.ndarray, sweeps: Sequence[int], weights: Sequence[float], measure="velocity"
) -> tuple[float, np.ndarray, np.ndarray]:
    """(loss, gradient (m, 2) with respect to the start, errors): loss = Σ weight · error after so many sweeps.

    measure: "velocity", the error of `errors_after`; or "residual", ‖Δλ‖ of one more sweep over ‖Δλ‖ of the first
    sweep from λ = 0, in the norm Σ Δλ² / k with the effective masses k, which needs no solution.

    The start is projected on λ_n ≥ 0 and the cone before the first sweep. Where the projection cuts a negative normal
    impulse off, the gradient is kept if it asks for more impulse; otherwise such a contact could never learn to push.
    """
    one_of("measure", measure, ("velocity", "residual"))
    sweeps, weights, start = np.asarray(sweeps), np.asarray(weights, float), np.array(start, float)
    in_cone = np.column_stack(projected(*start.T.copy(), problem.friction))
    errors, gradient = _errors_and_gradient(problem, in_cone, sweeps, weights, measure == "residual")
    _before_projection(start, problem.friction, gradient)
    return float(weights @ errors), gradient, errors


def impulse_loss(problem: SolvedProblem, start: np.ndarray) -> tuple[float, np.ndarray]:
    """(loss, gradient (m, 2)): ‖λ − λ*‖ / ‖λ*‖ in the norm Σ λ² / k with the effective masses k; 0 where λ* = 0."""
    weight = 1.0 / problem.rows.data[:, NORMAL_MASS : TANGENT_MASS + 1]
    size = math.sqrt(np.sum(weight * problem.solution**2))
    if size == 0.0:
        return 0.0, np.zeros(problem.solution.shape)
    off = start - problem.solution
    error = math.sqrt(np.sum(weight * off**2))
    return error / size, weight * off / (size * max(error, 1e-12 * size))


@njit(cache=True)
def _errors_and_gradient(problem, start, sweeps, weights, residual):
    """(errors (c,), gradient (m, 2) of Σ weight · error by a start in the cone). residual: of one more sweep."""
    rows, free, solution, friction = problem
    n = free.shape[0] - 4
    impulses, velocities, clamped = _sweeps(rows, free, friction, start, sweeps[-1] + 1 if residual else sweeps[-1])
    by_velocities, by_impulses = np.zeros((len(impulses), n + 4, 3)), np.zeros_like(impulses)
    errors, goal = np.zeros(sweeps.size), free
    if residual:
        metric = 1.0 / rows.data[:, NORMAL_MASS : TANGENT_MASS + 1]
        size = _norm(metric, _sweeps(rows, free, friction, np.zeros_like(start), 1)[0][1])
    else:
        # s = ω r has half the inertia of the mass.
        metric = np.array([1.0, 1.0, 0.5]) / free[:n, 3:]
        goal = _velocities(rows, free, solution)
        size = _norm(metric, (goal - free)[:n, :3])
    if size < _NOTHING:
        return errors, by_impulses[0]
    for c, k in enumerate(sweeps):
        off = impulses[k + 1] - impulses[k] if residual else (velocities[k] - goal)[:n, :3]
        errors[c] = _norm(metric, off) / size
        slope = weights[c] / (size * size * max(errors[c], 1e-9)) * metric * off
        if residual:
            by_impulses[k + 1] += slope
            by_impulses[k] -= slope
        else:
            by_velocities[k, :n] = slope
    return errors, _adjoint_sweeps(rows, free, friction, clamped, by_velocities, by_impulses)


@njit(cache=True)
def _norm(metric, off):
    """√(Σ metric · off²)."""
    return math.sqrt(np.sum(metric * off * off))


@njit(cache=True)
def _before_projection(start, friction, gradient):
    """The adjoint of the projection, in place: the derivative by the projected start becomes that by the start."""
    for i in range(start.shape[0]):
        largest = friction * max(start[i, 0], 0.0)
        if abs(start[i, 1]) > largest:
            gradient[i, 0] += math.copysign(friction, start[i, 1]) * gradient[i, 1]
            gradient[i, 1] = 0.0
        if start[i, 0] < 0.0 and gradient[i, 0] > 0.0:
            gradient[i, 0] = 0.0


@njit(cache=True)
def _velocities(rows, free, impulse):
    """v⁻ + M⁻¹ Jᵀ λ, packed like `free`."""
    velocity = free.copy()
    apply_impulses(Rows(rows.body, rows.data, impulse), velocity, 0.0)
    return velocity


@njit(cache=True)
def _sweeps(rows, free, friction, start, count):
    """Sweeps from a start in the cone: impulses (count + 1, m, 2) and velocities (count + 1, n + 4, 4) after each
    number of them, and clamped (count, m, 2)."""
    m = rows.body.shape[0]
    impulses, velocities = np.empty((count + 1, m, 2)), np.empty((count + 1, free.shape[0], 4))
    clamped = np.empty((count, m, 2), np.int8)
    impulses[0], velocities[0] = start, _velocities(rows, free, start)
    for k in range(count):
        impulses[k + 1], velocities[k + 1] = impulses[k], velocities[k]
        forward_sweep(rows, friction, velocities[k + 1], impulses[k + 1], clamped[k])
    return impulses, velocities, clamped


@njit(cache=True)
def _adjoint_sweeps(rows, free, friction, clamped, by_velocities, by_impulses):
    """The adjoint of `_sweeps`: derivative by the start, (m, 2), of a loss of what `_sweeps` returns.

    by_velocities: (count + 1, n + 4, 3). by_impulses: (count + 1, m, 2).
    """
    by_velocity, by_impulse = by_velocities[-1], by_impulses[-1]
    for k in range(len(clamped) - 1, -1, -1):
        adjoint_sweep(rows, friction, free, clamped[k], by_velocity, by_impulse)
        by_velocity += by_velocities[k]
        by_impulse += by_impulses[k]
    for i in range(clamped.shape[1]):
        by_normal, by_tangent = _by_change(rows, free, by_velocity, i)
        by_impulse[i, 0] += by_normal
        by_impulse[i, 1] += by_tangent
    return by_impulse


@njit(cache=True)
def forward_sweep(rows, friction, velocity, impulse, clamped):
    """The engine's sweep over `impulse` and `velocity`, in place; writes to `clamped`, (m, 2), int8, which rows it cut.

    clamped: 1 where λ_n was cut at 0; ±1 where λ_t was cut at ±μ λ_n; 0 where a row was free. The adjoint needs them,
    and the engine's own sweep does not keep them.
    """
    for i in range(rows.body.shape[0]):
        row, (v_n, v_t) = rows.data[i], row_velocity(rows, velocity, i)
        old_n, old_t = impulse[i, 0], impulse[i, 1]
        largest = friction * old_n
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
    """The adjoint of `forward_sweep`: derivatives after the sweep become those before it, in place.

    velocity: any packed velocities, for their inverse masses. by_velocity: (n + 4, 3). by_impulse: (m, 2).
    """
    for i in range(rows.body.shape[0] - 1, -1, -1):
        a, b, row = rows.body[i, BODY_A], rows.body[i, BODY_B], rows.data[i]
        d_n, d_t = _by_change(rows, velocity, by_velocity, i)
        # Derivatives by the changes p_n and p_t of this contact's impulses.
        d_n += by_impulse[i, 0]
        d_t += by_impulse[i, 1]
        if clamped[i, 1] != 0:
            by_impulse[i, 1] -= d_t
            by_impulse[i, 0] += clamped[i, 1] * friction * d_t
        if clamped[i, 0] != 0:
            by_impulse[i, 0] -= d_n
        # Derivatives by the velocities v_n and v_t, which do not matter to a row that was cut.
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
    """Derivative by a normal and by a tangent impulse of contact i through the velocities that they change."""
    a, b, row = rows.body[i, BODY_A], rows.body[i, BODY_B], rows.data[i]
    n_x, n_y, w_a, w_b = row[N_X], row[N_Y], velocity[a, INVERSE_MASS], velocity[b, INVERSE_MASS]
    g_x = w_b * by_velocity[b, 0] - w_a * by_velocity[a, 0]
    g_y = w_b * by_velocity[b, 1] - w_a * by_velocity[a, 1]
    turn = 2.0 * (w_a * row[ARM_A] * by_velocity[a, 2] + w_b * row[ARM_B] * by_velocity[b, 2])
    return g_x * n_x + g_y * n_y, g_x * n_y - g_y * n_x + turn
