"""Accelerated projected gradient descent with backtracking and restarts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.physics.contact_solver import (
    ARM_A,
    ARM_B,
    BODY_A,
    BODY_B,
    CONTRACT,
    INVERSE_MASS,
    N_X,
    N_Y,
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    TANGENT_MASS,
    TARGET,
    V_S,
    V_X,
    V_Y,
)
from deep_contact.physics.convergence import is_over
from deep_contact.physics.solvers.pgs import PGS
from deep_contact.physics.solvers.registry import Loop, register, tolerance_argument


@dataclass(frozen=True, kw_only=True)
class APGD(PGS):
    """Accelerated projected gradient descent (Nesterov; Mazhar, Heyn, Negrut and Tasora, ACM Transactions on Graphics
    34, 2015), with backtracking and restarts. Options of `PGS`; a "sweep" is one evaluation of the gradient.

    It relaxes all rows from the same velocities, so it is the one method here whose result does not depend on the
    order of the contacts. The paper minimises a convex problem, in which a sliding contact is pushed apart at
    μ times its slip; here the bounds of friction follow the normal impulse, so that it solves the problem that the
    other methods solve, at the price of the proof: with friction the function that it minimises changes with λ_n.
    Strength: tight tolerances without friction. Weakness: few sweeps. A gradient step, shortened to what the circle
    with most contacts allows, does less than a sweep of PGS.
    """


class APGDSettings(NamedTuple):
    """Settings of `APGD`."""

    tolerance: float


class Points(NamedTuple):
    """Workspace of `relax_apgd`: extrapolated impulses y, the last ones, the velocities of both, a velocity change."""

    y: np.ndarray
    before: np.ndarray
    velocity_y: np.ndarray
    velocity_before: np.ndarray
    change: np.ndarray


@njit(cache=True)
def make_points(rows, solver_bodies):
    """Workspace for as many rows and solver bodies."""
    return Points(
        np.empty_like(rows.impulse),
        np.empty_like(rows.impulse),
        np.empty_like(solver_bodies),
        np.empty_like(solver_bodies),
        np.empty_like(solver_bodies),
    )


@njit(cache=True)
def relax_apgd(settings, rows, friction, solver_bodies, theta, workspace):
    """Accelerated projected gradient descent (Nesterov) with backtracking and restarts, in impulses scaled by mass.

    Each evaluation: from the extrapolated point y, λ ← Π(y − g / L) with the row's velocity g times its effective
    mass as the gradient, so that L is near the largest eigenvalue of a matrix with ones on its diagonal. L is doubled
    until it bounds the step, ‖Δv‖²_M ≤ L ‖Δλ‖², and is let down by a tenth after it. If g·(λ − λ of before) > 0, the
    extrapolation goes uphill and starts anew. θ is L times the largest change: a full Jacobi step's.
    """
    impulse = rows.impulse
    if impulse.shape[0] > workspace.y.shape[0]:
        workspace = make_points(rows, solver_bodies)
    y, before = workspace.y[: impulse.shape[0]], workspace.before[: impulse.shape[0]]
    velocity_y, velocity_before, change = workspace.velocity_y, workspace.velocity_before, workspace.change
    for i in range(impulse.shape[0]):
        for c in range(impulse.shape[1]):
            y[i, c] = before[i, c] = impulse[i, c]
    velocity_y[:] = solver_bodies
    velocity_before[:] = solver_bodies
    lipschitz, momentum = 2.0, 1.0
    k = 0
    while k < theta.shape[0]:
        largest, size, slope = project_step(rows, friction, velocity_y, y, before, lipschitz, change)
        theta[k] = largest * lipschitz
        k += 1
        is_too_long = kinetic(change, solver_bodies) > lipschitz * size * (1.0 + 1e-9)
        if is_too_long and k < theta.shape[0] and theta[k - 1] > 0.0:
            lipschitz *= 2.0
            continue
        add(velocity_y, change, solver_bodies)
        if is_over(theta[k - 1], settings.tolerance):
            return k
        if slope > 0.0:
            momentum, share = 1.0, 0.0
        else:
            after = 0.5 * momentum * (math.sqrt(momentum * momentum + 4.0) - momentum)
            share = momentum * (1.0 - momentum) / (momentum * momentum + after)
            momentum = after
        extrapolate(impulse, before, y, share)
        extrapolate(solver_bodies, velocity_before, velocity_y, share)
        lipschitz *= 0.9
    return theta.shape[0]


@njit(cache=True, fastmath=CONTRACT)
def project_step(rows, friction, solver_bodies, y, before, lipschitz, change):
    """λ = Π(y − D g / L) into the rows, and M⁻¹ Jᵀ (λ − y) into `change`; g are the row velocities, D the masses.

    Π puts λ_n above 0, and then λ_t within ±μ λ_n. Returns (largest |λ − y|, Σ (λ − y)² / D, Σ g (λ − before)).
    """
    v, real = solver_bodies, solver_bodies.dtype.type
    two, mu, zero, step = real(2.0), real(friction), real(0.0), real(1.0 / lipschitz)
    largest = zero
    size = slope = 0.0
    change[:] = zero
    data, impulse = rows.data, rows.impulse
    for i in range(data.shape[0]):
        a, b = rows.body[i, BODY_A], rows.body[i, BODY_B]
        n_x, n_y, k_n, k_t = data[i, N_X], data[i, N_Y], data[i, NORMAL_MASS], data[i, TANGENT_MASS]
        arm_a, arm_b, target = data[i, ARM_A], data[i, ARM_B], data[i, TARGET]
        d_x, d_y = v[b, V_X] - v[a, V_X], v[b, V_Y] - v[a, V_Y]
        g_n = d_x * n_x + d_y * n_y - target
        g_t = d_x * n_y - d_y * n_x + arm_b * v[b, V_S] + arm_a * v[a, V_S]
        new_n = max(y[i, NORMAL] - step * k_n * g_n, zero)
        new_t = max(-mu * new_n, min(y[i, TANGENT] - step * k_t * g_t, mu * new_n))
        p_n, p_t = new_n - y[i, NORMAL], new_t - y[i, TANGENT]
        largest = max(largest, max(abs(p_n), abs(p_t)))
        size += np.float64(p_n) * p_n / k_n + np.float64(p_t) * p_t / k_t
        slope += np.float64(g_n) * (new_n - before[i, NORMAL]) + np.float64(g_t) * (new_t - before[i, TANGENT])
        impulse[i, NORMAL], impulse[i, TANGENT] = new_n, new_t
        p_x, p_y = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x
        w_a, w_b = v[a, INVERSE_MASS], v[b, INVERSE_MASS]
        change[a, V_X] -= w_a * p_x
        change[a, V_Y] -= w_a * p_y
        change[a, V_S] += two * w_a * arm_a * p_t
        change[b, V_X] += w_b * p_x
        change[b, V_Y] += w_b * p_y
        change[b, V_S] += two * w_b * arm_b * p_t
    return np.float64(largest), size, slope


@njit(cache=True)
def kinetic(change, solver_bodies):
    """‖Δv‖²_M = Σ m (Δv_x² + Δv_y² + Δs² / 2) over the circles, kg·m²/s²: twice the kinetic energy of `change`."""
    total = 0.0
    for i in range(change.shape[0] - 4):
        x, y, s = np.float64(change[i, V_X]), np.float64(change[i, V_Y]), np.float64(change[i, V_S])
        total += (x * x + y * y + 0.5 * s * s) / solver_bodies[i, INVERSE_MASS]
    return total


@njit(cache=True)
def add(velocity, change, solver_bodies):
    """solver_bodies ← velocity + change, in place; the column of 1 / m stays."""
    for i in range(solver_bodies.shape[0]):
        for c in range(3):
            solver_bodies[i, c] = velocity[i, c] + change[i, c]


@njit(cache=True)
def extrapolate(x, before, y, share):
    """y ← x + share (x − before), before ← x, in place."""
    share = x.dtype.type(share)
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            y[i, c] = x[i, c] + share * (x[i, c] - before[i, c])
            before[i, c] = x[i, c]


register(
    APGD,
    lambda solver: APGDSettings(tolerance_argument(solver)),
    (Loop(APGDSettings, relax_apgd, make_points, frictionless=False),),
)
