"""Training through the solver: the velocity error after some sweeps of Projected Gauss-Seidel, and its exact gradient.

What a start is for is the velocities after the few sweeps that a user pays for. λ itself is not unique, and an error
that one sweep removes does not matter. So the loss is the error after those sweeps, of the engine's own solver in its
own order, and its gradient with respect to the start is the adjoint of the sweeps: one pass back over the contacts a
sweep, with the clamps as the pass forward left them (almost everywhere the derivative). No automatic differentiation
could unroll 170 contacts × 30 sweeps in a time worth having; this takes two or three times that of the sweeps.

Instead of the error of the velocities, which wants the solution, the loss may be what one more sweep would change
("residual"), which needs no labels. `impulse_loss` is the plain regression on λ, for comparison.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.physics.contact_solver import Rows, apply_impulses, contact_rows, integrate_velocities, make_rows
from deep_contact.physics.engine import world_arguments
from deep_contact.state import State

_NOTHING = 1e-12
"""‖v* − v⁻‖, in √J, below which there was nothing to solve and no error is counted."""


class SolvedProblem(NamedTuple):
    """A contact problem with its solution, as the loss needs it.

    rows: `Rows`; their impulses are Builtin's start. free: velocities after Δt of gravity, packed, (n + 4, 4).
    solution: λ*, (m, 2), N·s. friction: μ.
    """

    rows: Rows
    free: np.ndarray
    solution: np.ndarray
    friction: float


def solved_problem(state: State) -> SolvedProblem:
    """The contact problem of a solved state. Raises ValueError on a state that is not solved."""
    if state.contacts is None or not state.solved:
        raise ValueError("state.solved: expected a state that holds its solution, got False")
    _, gravity, friction, restitution = world_arguments(state)
    free = np.empty((state.bodies.count + 4, 4))
    integrate_velocities(state.bodies, gravity, state.dt, free)
    room = make_rows(state.contacts.count, free.dtype)
    rows, _ = contact_rows(state.bodies, state.contacts, free, restitution, room)
    solution = np.column_stack([state.contacts.normal_impulse, state.contacts.tangent_impulse])
    return SolvedProblem(rows, free, solution, friction)


MEASURES = ("velocity", "residual")
"""What a loss measures after each number of sweeps."""


def errors_after(problem: SolvedProblem, start: np.ndarray, sweeps: Sequence[int]) -> np.ndarray:
    """‖v − v*‖ / ‖v* − v⁻‖ in the norm of kinetic energy after so many sweeps from a start (m, 2), projected first.

    sweeps: increasing. Returns (len(sweeps),); 0 where there was nothing to solve.
    """
    errors = np.empty(len(sweeps))
    sweeps = np.asarray(sweeps, dtype=np.int64)
    start = np.asarray(start, dtype=np.float64)
    _loss(*problem, start, sweeps, np.zeros(sweeps.size), False, errors, np.empty((0, 2)))
    return errors


def loss_and_gradient(
    problem: SolvedProblem, start: np.ndarray, sweeps: Sequence[int], weights: Sequence[float], measure="velocity"
) -> tuple[float, np.ndarray, np.ndarray]:
    """(loss, gradient (m, 2) with respect to the start, errors): loss = Σ weight · error after so many sweeps.

    measure: "velocity", the error of `errors_after`; or "residual", ‖Δλ‖ of one more sweep over ‖Δλ‖ of the first
    sweep from λ = 0, in the norm Σ Δλ² / k with the effective masses k, for which no solution is asked.

    The start is projected on λ_n ≥ 0 and the cone before the first sweep. Where the projection cuts a normal impulse
    below zero off, the gradient is kept if it asks for more impulse: else such a contact could never learn to push.
    """
    if measure not in MEASURES:
        raise ValueError(f"measure: expected one of {', '.join(MEASURES)}, got {measure!r}")
    sweeps, weights = np.asarray(sweeps, dtype=np.int64), np.asarray(weights, dtype=np.float64)
    errors, gradient = np.empty(sweeps.size), np.zeros(problem.solution.shape)
    start = np.asarray(start, dtype=np.float64)
    _loss(*problem, start, sweeps, weights, measure == "residual", errors, gradient)
    return float(weights @ errors), gradient, errors


def impulse_loss(problem: SolvedProblem, start: np.ndarray) -> tuple[float, np.ndarray]:
    """(loss, gradient (m, 2)): ‖λ − λ*‖ / ‖λ*‖ in the norm Σ λ² / k with the effective masses k; 0 where λ* = 0."""
    weight = 1.0 / problem.rows.data[:, 2:4]
    size = math.sqrt(np.sum(weight * problem.solution**2))
    if size == 0.0:
        return 0.0, np.zeros(problem.solution.shape)
    off = start - problem.solution
    error = math.sqrt(np.sum(weight * off**2))
    return error / size, weight * off / (size * max(error, 1e-12 * size))


@njit(cache=True)
def _velocities(rows, free, impulse, out):
    """v⁻ + M⁻¹ Jᵀ λ into `out`, packed like `free`."""
    out[:] = free
    apply_impulses(Rows(rows.body, rows.data, impulse), out)


@njit(cache=True)
def _distance(one, other, n):
    """√(2 × kinetic energy) of the difference of two packed velocities; s = ω r has half the mass's inertia."""
    total = 0.0
    for i in range(n):
        d_x, d_y, d_s = one[i, 0] - other[i, 0], one[i, 1] - other[i, 1], one[i, 2] - other[i, 2]
        total += (d_x * d_x + d_y * d_y + 0.5 * d_s * d_s) / one[i, 3]
    return math.sqrt(total)


@njit(cache=True)
def sweep_and_note(rows, friction, moving, impulse, clamped):
    """The engine's sweep over `impulse` and `moving`, in place, noting in `clamped`, (m, 2), int8, what it cut.

    clamped: 1 where λ_n was cut at 0; ±1 where λ_t was cut at ±μ λ_n; 0 where a row was free.
    """
    for i in range(rows.body.shape[0]):
        a, b = rows.body[i, 0], rows.body[i, 1]
        n_x, n_y, k_n, k_t = rows.data[i, 0], rows.data[i, 1], rows.data[i, 2], rows.data[i, 3]
        arm_a, arm_b, target = rows.data[i, 4], rows.data[i, 5], rows.data[i, 6]
        v_x, v_y = moving[b, 0] - moving[a, 0], moving[b, 1] - moving[a, 1]
        v_n = v_x * n_x + v_y * n_y - target
        v_t = v_x * n_y - v_y * n_x + arm_a * moving[a, 2] + arm_b * moving[b, 2]
        old_n, old_t = impulse[i, 0], impulse[i, 1]
        largest = friction * old_n
        new_n, new_t = old_n - k_n * v_n, old_t - k_t * v_t
        clamped[i, 0] = clamped[i, 1] = 0
        if new_n < 0.0:
            new_n, clamped[i, 0] = 0.0, 1
        if new_t > largest:
            new_t, clamped[i, 1] = largest, 1
        elif new_t < -largest:
            new_t, clamped[i, 1] = -largest, -1
        impulse[i, 0], impulse[i, 1] = new_n, new_t
        p_n, p_t = new_n - old_n, new_t - old_t
        p_x, p_y = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x
        w_a, w_b = moving[a, 3], moving[b, 3]
        moving[a, 0] -= w_a * p_x
        moving[a, 1] -= w_a * p_y
        moving[a, 2] += 2.0 * w_a * arm_a * p_t
        moving[b, 0] += w_b * p_x
        moving[b, 1] += w_b * p_y
        moving[b, 2] += 2.0 * w_b * arm_b * p_t


@njit(cache=True)
def _sweep_back(rows, friction, moving, clamped, by_velocity, by_impulse):
    """The adjoint of `sweep_and_note`: derivatives after the sweep become those before it, in place.

    moving: any packed velocities, for their inverse masses. by_velocity: (n + 4, 3). by_impulse: (m, 2).
    """
    for i in range(rows.body.shape[0] - 1, -1, -1):
        a, b = rows.body[i, 0], rows.body[i, 1]
        n_x, n_y, k_n, k_t = rows.data[i, 0], rows.data[i, 1], rows.data[i, 2], rows.data[i, 3]
        arm_a, arm_b = rows.data[i, 4], rows.data[i, 5]
        d_n, d_t = _by_change(rows, moving, by_velocity, i)
        # Of the loss by the changes p_n and p_t of this contact's impulses.
        d_n += by_impulse[i, 0]
        d_t += by_impulse[i, 1]
        if clamped[i, 1] == 0:
            g_x, g_y = -k_t * d_t * n_y, k_t * d_t * n_x
            by_velocity[b, 0] += g_x
            by_velocity[b, 1] += g_y
            by_velocity[a, 0] -= g_x
            by_velocity[a, 1] -= g_y
            by_velocity[a, 2] -= k_t * d_t * arm_a
            by_velocity[b, 2] -= k_t * d_t * arm_b
        else:
            by_impulse[i, 1] -= d_t
            by_impulse[i, 0] += clamped[i, 1] * friction * d_t
        if clamped[i, 0] == 0:
            g_x, g_y = -k_n * d_n * n_x, -k_n * d_n * n_y
            by_velocity[b, 0] += g_x
            by_velocity[b, 1] += g_y
            by_velocity[a, 0] -= g_x
            by_velocity[a, 1] -= g_y
        else:
            by_impulse[i, 0] -= d_n


@njit(cache=True)
def _by_change(rows, moving, by_velocity, i):
    """Derivative by a normal and by a tangent impulse of contact i through the velocities that they change."""
    a, b = rows.body[i, 0], rows.body[i, 1]
    n_x, n_y, arm_a, arm_b = rows.data[i, 0], rows.data[i, 1], rows.data[i, 4], rows.data[i, 5]
    w_a, w_b = moving[a, 3], moving[b, 3]
    g_x = w_b * by_velocity[b, 0] - w_a * by_velocity[a, 0]
    g_y = w_b * by_velocity[b, 1] - w_a * by_velocity[a, 1]
    turn = 2.0 * (w_a * arm_a * by_velocity[a, 2] + w_b * arm_b * by_velocity[b, 2])
    return g_x * n_x + g_y * n_y, g_x * n_y - g_y * n_x + turn


@njit(cache=True)
def _distance_of_impulses(rows, one, other):
    """√(Σ (λ − λ')² / k) over all rows, with the effective masses k: m/s · √kg."""
    total = 0.0
    for i in range(one.shape[0]):
        for j in range(2):
            total += (one[i, j] - other[i, j]) ** 2 / rows.data[i, 2 + j]
    return math.sqrt(total)


@njit(cache=True)
def _loss(rows, free, solution, friction, start, sweeps, weights, residual, errors, gradient):
    """Fill `errors`, and `gradient` unless it has no rows. residual: measure what one more sweep would change."""
    m, n = rows.body.shape[0], free.shape[0] - 4
    goal, moving = np.empty_like(free), np.empty_like(free)
    impulse, before = np.zeros((m, 2)), np.zeros((m, 2))
    clamped = np.empty((sweeps[-1] + 1, m, 2), np.int8)
    if residual:
        moving[:] = free
        sweep_and_note(rows, friction, moving, impulse, clamped[0])
        size = _distance_of_impulses(rows, impulse, before)
    else:
        _velocities(rows, free, solution, goal)
        size = _distance(goal, free, n)
    if size < _NOTHING:
        errors[:] = 0.0
        return
    for i in range(m):
        impulse[i, 0] = max(start[i, 0], 0.0)
        largest = friction * impulse[i, 0]
        impulse[i, 1] = max(-largest, min(start[i, 1], largest))
    _velocities(rows, free, impulse, moving)
    # Derivatives of each error by the velocities it is taken from, or by the impulses after the sweep beyond it.
    kept_velocity, kept_impulse = np.zeros((sweeps.size, n, 3)), np.zeros((sweeps.size, m, 2))
    last, c = sweeps[-1] + (1 if residual else 0), 0
    for k in range(last + 1):
        if not residual and sweeps[c] == k:
            errors[c] = _distance(moving, goal, n) / size
            factor = weights[c] / (size * size * max(errors[c], 1e-9))
            for i in range(n):
                for j in range(3):
                    inertia = (0.5 if j == 2 else 1.0) / moving[i, 3]
                    kept_velocity[c, i, j] = factor * inertia * (moving[i, j] - goal[i, j])
            c += 1
        if k < last:
            noted = residual and sweeps[c] == k
            if noted:
                before[:] = impulse
            sweep_and_note(rows, friction, moving, impulse, clamped[k])
            if noted:
                errors[c] = _distance_of_impulses(rows, impulse, before) / size
                factor = weights[c] / (size * size * max(errors[c], 1e-9))
                for i in range(m):
                    for j in range(2):
                        kept_impulse[c, i, j] = factor * (impulse[i, j] - before[i, j]) / rows.data[i, 2 + j]
                c += 1
    if gradient.shape[0] == 0:
        return
    by_velocity, by_impulse = np.zeros((n + 4, 3)), np.zeros((m, 2))
    for k in range(last, -1, -1):
        for c in range(sweeps.size):
            if residual and sweeps[c] + 1 == k:
                by_impulse += kept_impulse[c]
            elif residual and sweeps[c] == k:
                by_impulse -= kept_impulse[c]
            elif not residual and sweeps[c] == k:
                by_velocity[:n] += kept_velocity[c]
        if k > 0:
            _sweep_back(rows, friction, free, clamped[k - 1], by_velocity, by_impulse)
    for i in range(m):
        d_n, d_t = _by_change(rows, free, by_velocity, i)
        d_n += by_impulse[i, 0]
        d_t += by_impulse[i, 1]
        largest = friction * max(start[i, 0], 0.0)
        if start[i, 1] > largest:
            d_n, d_t = d_n + friction * d_t, 0.0
        elif start[i, 1] < -largest:
            d_n, d_t = d_n - friction * d_t, 0.0
        gradient[i, 0] = 0.0 if start[i, 0] < 0.0 and d_n > 0.0 else d_n
        gradient[i, 1] = d_t
