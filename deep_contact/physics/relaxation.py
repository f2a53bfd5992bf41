"""How each method repeats the sweep: `relax`, one function for every method, and the stages that they share.

A method is known here by its settings, a named tuple; their type picks the function when the caller is compiled, so
that a run with one method never compiles another, and inside of the loop over steps there is nothing to decide.
All work in place on the impulses of the rows and on the moving velocities, which stay v + M⁻¹ Jᵀ λ throughout; all
write the θ of every sweep and return their number; all stop once θ is within the tolerance (a negative one never is),
or where it is no longer a number. Options, weaknesses and sources: `deep_contact.physics.methods`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from deep_contact.physics import methods
from deep_contact.physics.contact_solver import CONTRACT, Rows, sweep

_SUMS = {"contract", "reassoc"}
"""For sums over all rows: several at once, in an order that the compiler picks and keeps."""


class PGSSettings(NamedTuple):
    """Of `PGS`. tolerance: θ at which to stop, N·s; a negative one is never met."""

    tolerance: float


class PSORSettings(NamedTuple):
    """Of `PSOR`, whose options they are."""

    tolerance: float
    omega: float
    adaptive: bool


class SymmetricSettings(NamedTuple):
    """Of `SymmetricPGS`, likewise."""

    tolerance: float


class NNCGSettings(NamedTuple):
    """Of `NNCG`, likewise."""

    tolerance: float


class APGDSettings(NamedTuple):
    """Of `APGD`, likewise."""

    tolerance: float


_SETTINGS = {
    methods.PGS: PGSSettings,
    methods.SymmetricPGS: SymmetricSettings,
    methods.NNCG: NNCGSettings,
    methods.APGD: APGDSettings,
}


def settings_of(solver) -> NamedTuple:
    """The settings of a method from its options."""
    tolerance = methods.tolerance_argument(solver)
    if isinstance(solver, methods.PSOR):
        return PSORSettings(tolerance, float(solver.omega), bool(solver.adaptive))
    return _SETTINGS[type(solver)](tolerance)


def relax(settings, rows, friction, moving, theta):
    """Relax all contacts, in place, by the method of the settings. Returns the number of sweeps.

    rows: `Rows`. moving: (n + 4, 4). theta: room for the θ of each sweep, which is also how many there may be.
    For compiled callers only.
    """
    raise NotImplementedError("relax: expected to be called from a compiled function")


@overload(relax)
def _relax(settings, rows, friction, moving, theta):
    relax_by = _RELAX[settings.instance_class]

    def relax_contacts(settings, rows, friction, moving, theta):
        sweeps = relax_by(settings, rows, friction, moving, theta)
        # A maximum does not show what is not a number, so θ is told: once, at the end.
        if sweeps > 0 and not all_finite(moving):
            theta[sweeps - 1] = np.nan
        return sweeps

    return relax_contacts


@njit(cache=True)
def relax_pgs(settings, rows, friction, moving, theta):
    """Projected Gauss-Seidel: one sweep after the other."""
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, moving)
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


@njit(cache=True)
def relax_psor(settings, rows, friction, moving, theta):
    """Projected successive over-relaxation: every change of an impulse is ω times what would solve its row.

    That is a sweep with ω times the effective masses. θ is divided by ω, so that it measures what a plain sweep would
    change at most. Adaptive: see `better_omega`.
    """
    omega = settings.omega
    scale_masses(rows, omega)
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, moving) / omega
        if is_over(theta[k], settings.tolerance):
            return k + 1
        if settings.adaptive and (k + 1) % OMEGA_WINDOW == 0:
            better = better_omega(theta, k, omega)
            scale_masses(rows, better / omega)
            omega = better
    return theta.shape[0]


OMEGA_WINDOW = 12
"""Sweeps over which the rate of convergence is taken before ω changes."""

LARGEST_OMEGA = 1.7
"""Adaptive ω goes no further: with friction, sweeps closer to 2 were measured to circle around the solution."""


@njit(cache=True)
def better_omega(theta, k, omega):
    """ω for the sweeps after the k-th, from the rate ρ at which θ fell over the last window (Hageman and Young 1981).

    Where sweeps converge as on a linear problem with consistent order, ρ + ω − 1 = √ρ ω μ with the spectral radius μ
    of the Jacobi iteration, and the best ω is 2 / (1 + √(1 − μ²)). Where θ grew, ω goes half of the way back to 1.
    """
    half = OMEGA_WINDOW // 2
    late = early = 0.0
    for i in range(half):
        late = max(late, theta[k - i])
        early = max(early, theta[k - half - i])
    if not late < early:
        return 1.0 + 0.5 * (omega - 1.0)
    rho = (late / early) ** (1.0 / half)
    if rho <= omega - 1.0:
        return omega
    mu = (rho + omega - 1.0) / (math.sqrt(rho) * omega)
    best = 2.0 / (1.0 + math.sqrt(max(0.0, 1.0 - mu * mu)))
    return min(max(omega, best), LARGEST_OMEGA)


@njit(cache=True)
def scale_masses(rows, factor):
    """Multiply the effective masses of all rows, in place."""
    for i in range(rows.data.shape[0]):
        rows.data[i, 2] *= factor
        rows.data[i, 3] *= factor


@njit(cache=True)
def relax_symmetric(settings, rows, friction, moving, theta):
    """Symmetric projected Gauss-Seidel: sweeps forwards and backwards by turns, each counted as one."""
    reverse = Rows(rows.body[::-1], rows.data[::-1], rows.impulse[::-1])
    for k in range(theta.shape[0]):
        if k % 2 == 0:
            theta[k] = sweep(rows, friction, moving)
        else:
            theta[k] = sweep(reverse, friction, moving)
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


@njit(cache=True)
def relax_nncg(settings, rows, friction, moving, theta):
    """Nonsmooth nonlinear conjugate gradient: what a sweep changes is taken for the descent direction −∇f.

    After each sweep, λ ← λ + β p and p ← β p − ∇f with β = ‖∇f‖² / ‖∇f of the sweep before‖² (Fletcher-Reeves), and
    p ← 0 where β > 1. Velocities are linear in λ, so theirs is carried along instead of being summed up over contacts.
    The last sweep is not extrapolated: the impulses returned are those that a sweep left in the cone.
    """
    # Flat, so that what goes over all of them is a loop over neighbours in memory.
    impulse, velocity = rows.impulse.reshape(rows.impulse.size), moving.reshape(moving.size)
    last_impulse, last_velocity = impulse.copy(), velocity.copy()
    along, velocity_along = np.zeros_like(impulse), np.zeros_like(velocity)
    last_size = np.inf
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, moving)
        if is_over(theta[k], settings.tolerance) or k + 1 == theta.shape[0]:
            return k + 1
        size = squared_distance(impulse, last_impulse)
        # Where nothing changed there is no direction either; 0 / 0 would make everything not a number.
        beta = size / last_size if last_size > 0.0 else 0.0
        last_size = size
        if beta > 1.0:
            forget(impulse, last_impulse, along)
            forget(velocity, last_velocity, velocity_along)
        else:
            extrapolate(impulse, last_impulse, along, beta)
            extrapolate(velocity, last_velocity, velocity_along, beta)
    return theta.shape[0]


@njit(cache=True, fastmath=_SUMS)
def squared_distance(one, other):
    """Σ (one − other)², summed in float64."""
    total = 0.0
    for i in range(one.shape[0]):
        change = np.float64(one[i] - other[i])
        total += change * change
    return total


@njit(cache=True, fastmath=CONTRACT)
def extrapolate(x, last, along, beta):
    """x ← x + β p, p ← β p + (x − last), last ← x; the p of the right-hand sides is the old one. In place."""
    share = x.dtype.type(beta)
    for i in range(x.shape[0]):
        momentum = share * along[i]
        along[i] = momentum + x[i] - last[i]
        x[i] += momentum
        last[i] = x[i]


@njit(cache=True)
def forget(x, last, along):
    """p ← 0, last ← x, in place."""
    along[:] = x.dtype.type(0.0)
    last[:] = x


@njit(cache=True)
def relax_apgd(settings, rows, friction, moving, theta):
    """Accelerated projected gradient descent (Nesterov) with backtracking and restarts, in impulses scaled by mass.

    Each evaluation: from the extrapolated point y, λ ← Π(y − g / L) with the row's velocity g times its effective
    mass as the gradient, so that L is near the largest eigenvalue of a matrix with ones on its diagonal. L is doubled
    until it bounds the step, ‖Δv‖²_M ≤ L ‖Δλ‖², and is let down by a tenth after it. If g·(λ − λ of before) > 0, the
    extrapolation goes uphill and starts anew. θ is L times the largest change: a full Jacobi step's.
    """
    impulse = rows.impulse
    y, before = impulse.copy(), impulse.copy()
    velocity_y, velocity_before, change = moving.copy(), moving.copy(), np.zeros_like(moving)
    lipschitz, momentum = 2.0, 1.0
    k = 0
    while k < theta.shape[0]:
        largest, size, slope = project_step(rows, friction, velocity_y, y, before, lipschitz, change)
        theta[k] = largest * lipschitz
        k += 1
        if kinetic(change, moving) > lipschitz * size * (1.0 + 1e-9) and k < theta.shape[0] and theta[k - 1] > 0.0:
            lipschitz *= 2.0
            continue
        add(velocity_y, change, moving)
        if is_over(theta[k - 1], settings.tolerance):
            return k
        if slope > 0.0:
            momentum, share = 1.0, 0.0
        else:
            after = 0.5 * momentum * (math.sqrt(momentum * momentum + 4.0) - momentum)
            share = momentum * (1.0 - momentum) / (momentum * momentum + after)
            momentum = after
        lead(impulse, before, y, share)
        lead(moving, velocity_before, velocity_y, share)
        lipschitz *= 0.9
    return theta.shape[0]


@njit(cache=True, fastmath=CONTRACT)
def project_step(rows, friction, moving, y, before, lipschitz, change):
    """λ = Π(y − D g / L) into the rows, and M⁻¹ Jᵀ (λ − y) into `change`; g are the row velocities, D the masses.

    Π puts λ_n above 0, and then λ_t within ±μ λ_n. Returns (largest |λ − y|, Σ (λ − y)² / D, Σ g (λ − before)).
    """
    real = moving.dtype.type
    two, mu, zero, step = real(2.0), real(friction), real(0.0), real(1.0 / lipschitz)
    largest = zero
    size = slope = 0.0
    change[:] = zero
    data, impulse = rows.data, rows.impulse
    for i in range(data.shape[0]):
        a, b = rows.body[i, 0], rows.body[i, 1]
        n_x, n_y, k_n, k_t = data[i, 0], data[i, 1], data[i, 2], data[i, 3]
        arm_a, arm_b, target = data[i, 4], data[i, 5], data[i, 6]
        d_x, d_y = moving[b, 0] - moving[a, 0], moving[b, 1] - moving[a, 1]
        g_n = d_x * n_x + d_y * n_y - target
        g_t = d_x * n_y - d_y * n_x + arm_b * moving[b, 2] + arm_a * moving[a, 2]
        new_n = max(y[i, 0] - step * k_n * g_n, zero)
        new_t = max(-mu * new_n, min(y[i, 1] - step * k_t * g_t, mu * new_n))
        p_n, p_t = new_n - y[i, 0], new_t - y[i, 1]
        largest = max(largest, max(abs(p_n), abs(p_t)))
        size += np.float64(p_n) * p_n / k_n + np.float64(p_t) * p_t / k_t
        slope += np.float64(g_n) * (new_n - before[i, 0]) + np.float64(g_t) * (new_t - before[i, 1])
        impulse[i, 0], impulse[i, 1] = new_n, new_t
        p_x, p_y = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x
        w_a, w_b = moving[a, 3], moving[b, 3]
        change[a, 0] -= w_a * p_x
        change[a, 1] -= w_a * p_y
        change[a, 2] += two * w_a * arm_a * p_t
        change[b, 0] += w_b * p_x
        change[b, 1] += w_b * p_y
        change[b, 2] += two * w_b * arm_b * p_t
    return np.float64(largest), size, slope


@njit(cache=True)
def kinetic(change, moving):
    """‖Δv‖²_M = Σ m (Δv_x² + Δv_y² + Δs² / 2) over the circles, kg·m²/s²: twice the kinetic energy of `change`."""
    total = 0.0
    for i in range(change.shape[0] - 4):
        x, y, s = np.float64(change[i, 0]), np.float64(change[i, 1]), np.float64(change[i, 2])
        total += (x * x + y * y + 0.5 * s * s) / moving[i, 3]
    return total


@njit(cache=True)
def add(velocity, change, moving):
    """moving ← velocity + change, in place; the column of 1 / m stays."""
    for i in range(moving.shape[0]):
        for c in range(3):
            moving[i, c] = velocity[i, c] + change[i, c]


@njit(cache=True)
def lead(x, before, y, share):
    """y ← x + share (x − before), before ← x, in place."""
    share = x.dtype.type(share)
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            y[i, c] = x[i, c] + share * (x[i, c] - before[i, c])
            before[i, c] = x[i, c]


@njit(cache=True)
def all_finite(moving):
    """Whether all velocities are finite."""
    total = 0.0
    for i in range(moving.shape[0]):
        for c in range(3):
            # 0 times an infinite number is none.
            total += 0.0 * moving[i, c]
    return total == 0.0


@njit(cache=True)
def is_over(theta, tolerance):
    """Whether sweeping ends: θ is within the tolerance, or not a number any more."""
    return theta <= tolerance or not math.isfinite(theta)


_RELAX = {
    PGSSettings: relax_pgs,
    PSORSettings: relax_psor,
    SymmetricSettings: relax_symmetric,
    NNCGSettings: relax_nncg,
    APGDSettings: relax_apgd,
}
