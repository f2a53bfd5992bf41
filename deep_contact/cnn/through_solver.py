"""Training through the solver: the velocity error after some sweeps of Projected Gauss-Seidel, and its exact gradient.

What a start is for is the velocities after the few sweeps that a user pays for. λ itself is not unique, and an error
that one sweep removes does not matter. So the loss is the error after those sweeps, of the engine's own solver in its
own order, and its gradient with respect to the start is the adjoint of the sweeps: one pass back over the contacts a
sweep, with the clamps as the pass forward left them (almost everywhere the derivative). No automatic differentiation
could unroll 170 contacts × 30 sweeps in a time worth having; this takes two or three times that of the sweeps.
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


def errors_after(problem: SolvedProblem, start: np.ndarray, sweeps: Sequence[int]) -> np.ndarray:
    """‖v − v*‖ / ‖v* − v⁻‖ in the norm of kinetic energy after so many sweeps from a start (m, 2), projected first.

    sweeps: increasing. Returns (len(sweeps),); 0 where there was nothing to solve.
    """
    errors = np.empty(len(sweeps))
    sweeps = np.asarray(sweeps, dtype=np.int64)
    _loss(*problem, np.asarray(start, dtype=np.float64), sweeps, np.zeros(sweeps.size), errors, np.empty((0, 2)))
    return errors


def loss_and_gradient(
    problem: SolvedProblem, start: np.ndarray, sweeps: Sequence[int], weights: Sequence[float]
) -> tuple[float, np.ndarray, np.ndarray]:
    """(loss, gradient (m, 2) with respect to the start, errors): loss = Σ weight · error after so many sweeps.

    The start is projected on λ_n ≥ 0 and the cone before the first sweep. Where the projection cuts a normal impulse
    below zero off, the gradient is kept if it asks for more impulse: else such a contact could never learn to push.
    """
    sweeps, weights = np.asarray(sweeps, dtype=np.int64), np.asarray(weights, dtype=np.float64)
    errors, gradient = np.empty(sweeps.size), np.zeros(problem.solution.shape)
    _loss(*problem, np.asarray(start, dtype=np.float64), sweeps, weights, errors, gradient)
    return float(weights @ errors), gradient, errors


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
def _loss(rows, free, solution, friction, start, sweeps, weights, errors, gradient):
    """Fill `errors`, and `gradient` unless it has no rows."""
    m, n = rows.body.shape[0], free.shape[0] - 4
    goal, moving = np.empty_like(free), np.empty_like(free)
    _velocities(rows, free, solution, goal)
    size = _distance(goal, free, n)
    if size < _NOTHING:
        errors[:] = 0.0
        return
    impulse = np.empty((m, 2))
    for i in range(m):
        impulse[i, 0] = max(start[i, 0], 0.0)
        largest = friction * impulse[i, 0]
        impulse[i, 1] = max(-largest, min(start[i, 1], largest))
    _velocities(rows, free, impulse, moving)
    back = gradient.shape[0] > 0
    clamped = np.empty((max(sweeps[-1], 1), m, 2), np.int8)
    by_velocity = np.zeros((n + 4, 3))
    kept = np.empty((sweeps.size, n, 3))
    done = 0
    for c in range(sweeps.size):
        while done < sweeps[c]:
            sweep_and_note(rows, friction, moving, impulse, clamped[done])
            done += 1
        errors[c] = _distance(moving, goal, n) / size
        if back:
            factor = weights[c] / (size * size * max(errors[c], 1e-9))
            for i in range(n):
                for j in range(3):
                    inertia = (0.5 if j == 2 else 1.0) / moving[i, 3]
                    kept[c, i, j] = factor * inertia * (moving[i, j] - goal[i, j])
    if not back:
        return
    by_impulse = np.zeros((m, 2))
    c = sweeps.size - 1
    for k in range(done, -1, -1):
        while c >= 0 and sweeps[c] == k:
            by_velocity[:n] += kept[c]
            c -= 1
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
