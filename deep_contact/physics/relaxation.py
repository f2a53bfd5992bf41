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
from deep_contact.physics.colours import BatchSettings, relax_in_batches
from deep_contact.physics.contact_solver import CONTRACT, Rows, sweep
from deep_contact.physics.convergence import is_over, tell_divergence
from deep_contact.physics.islands import make_islands_room, sort_by_island

_SUMS = {"contract", "reassoc"}
"""For sums over all rows: several at once, in an order that the compiler picks and keeps."""


class PGSSettings(NamedTuple):
    """Of `PGS`. tolerance: θ at which to stop, N·s; a negative one is never met."""

    tolerance: float


class IslandsSettings(NamedTuple):
    """Of `PGS` with islands, likewise."""

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


class NesterovSettings(NamedTuple):
    """Of `NesterovPGS`, likewise."""

    tolerance: float


class APGDSettings(NamedTuple):
    """Of `APGD`, likewise."""

    tolerance: float


_SETTINGS = {
    methods.PGS: PGSSettings,
    methods.SymmetricPGS: SymmetricSettings,
    methods.NNCG: NNCGSettings,
    methods.NesterovPGS: NesterovSettings,
    methods.APGD: APGDSettings,
}


def settings_of(solver) -> NamedTuple:
    """The settings of a method from its options."""
    tolerance = methods.tolerance_argument(solver)
    if isinstance(solver, methods.PSOR):
        return PSORSettings(tolerance, float(solver.omega), bool(solver.adaptive))
    if isinstance(solver, methods.BatchedPGS):
        return BatchSettings(tolerance, solver.order == "colours")
    if solver.islands:
        return IslandsSettings(tolerance)
    return _SETTINGS[type(solver)](tolerance)


WITHOUT_TANGENTS = (PGSSettings, IslandsSettings, PSORSettings, SymmetricSettings, NNCGSettings, NesterovSettings)
"""Settings of the methods that can do without tangent rows: those that relax by `contact_solver.sweep` alone."""


def make_scratch(settings, rows, moving):
    """What the method wants beside rows and velocities of that size, to be made once a run; None where nothing.

    For compiled callers only.
    """
    raise NotImplementedError("make_scratch: expected to be called from a compiled function")


@overload(make_scratch)
def _make_scratch(settings, rows, moving):
    make = _SCRATCH.get(settings.instance_class)
    if make is None:
        return lambda settings, rows, moving: None
    return lambda settings, rows, moving: make(rows, moving)


def relax(settings, rows, friction, moving, theta, scratch):
    """Relax all contacts, in place, by the method of the settings. Returns the number of sweeps, and of relaxations.

    rows: `Rows`. friction: μ, or None for rows without tangents. moving: (n + 4, 4). theta: room for the θ of each
    sweep, which is also how many there may be. scratch: of `make_scratch`. Relaxations are counted by contacts: all of
    them in each sweep, or, with islands, those of the islands that are still swept. For compiled callers only.
    """
    raise NotImplementedError("relax: expected to be called from a compiled function")


@overload(relax)
def _relax(settings, rows, friction, moving, theta, scratch):
    relax_by = _RELAX[settings.instance_class]
    if settings.instance_class is IslandsSettings:

        def relax_contacts(settings, rows, friction, moving, theta, scratch):
            sweeps, relaxations = relax_by(settings, rows, friction, moving, theta, scratch)
            tell_divergence(moving, theta, sweeps)
            return sweeps, relaxations

    elif settings.instance_class in _SCRATCH:

        def relax_contacts(settings, rows, friction, moving, theta, scratch):
            sweeps = relax_by(settings, rows, friction, moving, theta, scratch)
            tell_divergence(moving, theta, sweeps)
            return sweeps, sweeps * rows.body.shape[0]

    else:

        def relax_contacts(settings, rows, friction, moving, theta, scratch):
            sweeps = relax_by(settings, rows, friction, moving, theta)
            tell_divergence(moving, theta, sweeps)
            return sweeps, sweeps * rows.body.shape[0]

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
def relax_islands(settings, rows, friction, moving, theta, scratch):
    """Projected Gauss-Seidel, one island after the other, each to its own end. Returns (sweeps, relaxations).

    Sweeps are those of the island that needs most. θ of a sweep is the largest over the islands that did it, so the
    last one tells, as ever, whether all are within the tolerance.
    """
    if rows.body.shape[0] > scratch.order.shape[0]:
        scratch = make_islands_room(rows, moving)
    islands, by_island = sort_by_island(rows, scratch)
    most = relaxations = 0
    for i in range(islands):
        first, end = scratch.start[i], scratch.start[i + 1]
        part = Rows(by_island.body[first:end], by_island.data[first:end], by_island.impulse[first:end])
        for k in range(theta.shape[0]):
            largest = sweep(part, friction, moving)
            relaxations += end - first
            theta[k] = max(theta[k], largest) if k < most else largest
            most = max(most, k + 1)
            if is_over(largest, settings.tolerance):
                break
    for i in range(rows.body.shape[0]):
        for c in range(rows.impulse.shape[1]):
            rows.impulse[scratch.order[i], c] = by_island.impulse[i, c]
    return most, relaxations


@njit(cache=True)
def relax_psor(settings, rows, friction, moving, theta):
    """Projected successive over-relaxation: every change of an impulse is ω times what would solve its row.

    That is a sweep with ω times the effective masses. θ is divided by ω, so that it measures what a plain sweep would
    change at most. Adaptive: see `better_omega`.
    """
    omega = settings.omega
    scale_masses(rows, omega, friction)
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, moving) / omega
        if is_over(theta[k], settings.tolerance):
            return k + 1
        if settings.adaptive and (k + 1) % OMEGA_WINDOW == 0:
            better = better_omega(theta, k, omega)
            scale_masses(rows, better / omega, friction)
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
def scale_masses(rows, factor, friction):
    """Multiply the effective masses of all rows, in place."""
    for i in range(rows.data.shape[0]):
        rows.data[i, 2] *= factor
        if friction is not None:
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


class Directions(NamedTuple):
    """Room for `relax_nncg` and `relax_nesterov`: of the sweep before, and directions, over all rows and bodies."""

    last_impulse: np.ndarray
    along: np.ndarray
    last_velocity: np.ndarray
    velocity_along: np.ndarray


@njit(cache=True)
def make_directions(rows, moving):
    """Room for directions over so many rows."""
    size, width, dtype = rows.impulse.size, moving.size, moving.dtype
    return Directions(np.empty(size, dtype), np.empty(size, dtype), np.empty(width, dtype), np.empty(width, dtype))


@njit(cache=True)
def relax_nncg(settings, rows, friction, moving, theta, scratch):
    """Nonsmooth nonlinear conjugate gradient: what a sweep changes is taken for the descent direction −∇f.

    After each sweep, λ ← λ + β p and p ← β p − ∇f with β = ‖∇f‖² / ‖∇f of the sweep before‖² (Fletcher-Reeves), and
    p ← 0 where β > 1. Velocities are linear in λ, so theirs is carried along instead of being summed up over contacts.
    The last sweep is not extrapolated: the impulses returned are those that a sweep left in the cone.
    """
    # Flat, so that what goes over all of them is a loop over neighbours in memory.
    impulse, velocity = rows.impulse.reshape(rows.impulse.size), moving.reshape(moving.size)
    if impulse.size > scratch.last_impulse.size:
        scratch = make_directions(rows, moving)
    last_impulse, along = scratch.last_impulse[: impulse.size], scratch.along[: impulse.size]
    last_velocity, velocity_along = scratch.last_velocity, scratch.velocity_along
    forget(impulse, last_impulse, along)
    forget(velocity, last_velocity, velocity_along)
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


FIRST_LEAD, LARGEST_LEAD = 0.9, 0.99
"""Largest share of the last change that `relax_nesterov` goes on by: at first, and ever."""

LEAD_WINDOW = 5
"""Sweeps over which it is seen whether that share is too large."""

SUDDEN_GROWTH = 1.2
"""And where a sweep changes more than the last one did by this factor (of sums of squares), it is at once."""


@njit(cache=True)
def relax_nesterov(settings, rows, friction, moving, theta, scratch):
    """Projected Gauss-Seidel with Nesterov's momentum: each sweep starts from λ + β (λ − λ of the sweep before).

    β = (t − 1) / t⁺ with t⁺ = (1 + √(1 + 4 t²)) / 2, from t = 1 and again from there where the step goes uphill: where
    what the sweep changed points against where λ went (gradient scheme of O'Donoghue and Candès 2015). That alone
    circles around the solution for ever where there is friction, so β is bound: the least 1 − β doubles whenever the
    sum of squared changes has grown from one window to the next, or suddenly, and falls by a fifth with every other
    window.
    As in `relax_nncg`, velocities are led on with the impulses, and the last sweep is not.
    """
    impulse, velocity = rows.impulse.reshape(rows.impulse.size), moving.reshape(moving.size)
    if impulse.size > scratch.last_impulse.size:
        scratch = make_directions(rows, moving)
    last_impulse, begun, last_velocity = scratch.last_impulse[: impulse.size], scratch.along, scratch.last_velocity
    begun = begun[: impulse.size]
    last_impulse[:] = impulse
    begun[:] = impulse
    last_velocity[:] = velocity
    momentum, most = 1.0, FIRST_LEAD
    last_size, before, now = np.inf, np.inf, 0.0
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, moving)
        if is_over(theta[k], settings.tolerance) or k + 1 == theta.shape[0]:
            return k + 1
        size, downhill = step_and_slope(impulse, begun, last_impulse)
        now += size
        if size > SUDDEN_GROWTH * last_size:
            most = max(0.0, 2.0 * most - 1.0)
        if (k + 1) % LEAD_WINDOW == 0:
            most = max(0.0, 2.0 * most - 1.0) if now > before else min(LARGEST_LEAD, 0.2 + 0.8 * most)
            before, now = now, 0.0
        last_size = size
        share = 0.0
        if downhill < 0.0:
            momentum = 1.0
        else:
            after = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
            share = min((momentum - 1.0) / after, most)
            momentum = after
        lead_on(impulse, last_impulse, share)
        lead_on(velocity, last_velocity, share)
        begun[:] = impulse
    return theta.shape[0]


@njit(cache=True, fastmath=_SUMS)
def step_and_slope(x, begun, last):
    """Σ (x − begun)² and Σ (x − begun) (x − last), summed in float64."""
    size = slope = 0.0
    for i in range(x.shape[0]):
        change = np.float64(x[i] - begun[i])
        size += change * change
        slope += change * np.float64(x[i] - last[i])
    return size, slope


@njit(cache=True, fastmath=CONTRACT)
def lead_on(x, last, share):
    """x ← x + share (x − last), and last ← the x of the right-hand sides. In place."""
    share = x.dtype.type(share)
    for i in range(x.shape[0]):
        new = x[i]
        x[i] = new + share * (new - last[i])
        last[i] = new


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


class Points(NamedTuple):
    """Room for `relax_apgd`: the extrapolated impulses y, those of before, their velocities, and a change of those."""

    y: np.ndarray
    before: np.ndarray
    velocity_y: np.ndarray
    velocity_before: np.ndarray
    change: np.ndarray


@njit(cache=True)
def make_points(rows, moving):
    """Room for points over so many rows."""
    return Points(
        np.empty_like(rows.impulse),
        np.empty_like(rows.impulse),
        np.empty_like(moving),
        np.empty_like(moving),
        np.empty_like(moving),
    )


@njit(cache=True)
def relax_apgd(settings, rows, friction, moving, theta, scratch):
    """Accelerated projected gradient descent (Nesterov) with backtracking and restarts, in impulses scaled by mass.

    Each evaluation: from the extrapolated point y, λ ← Π(y − g / L) with the row's velocity g times its effective
    mass as the gradient, so that L is near the largest eigenvalue of a matrix with ones on its diagonal. L is doubled
    until it bounds the step, ‖Δv‖²_M ≤ L ‖Δλ‖², and is let down by a tenth after it. If g·(λ − λ of before) > 0, the
    extrapolation goes uphill and starts anew. θ is L times the largest change: a full Jacobi step's.
    """
    impulse = rows.impulse
    if impulse.shape[0] > scratch.y.shape[0]:
        scratch = make_points(rows, moving)
    y, before = scratch.y[: impulse.shape[0]], scratch.before[: impulse.shape[0]]
    velocity_y, velocity_before, change = scratch.velocity_y, scratch.velocity_before, scratch.change
    for i in range(impulse.shape[0]):
        for c in range(impulse.shape[1]):
            y[i, c] = before[i, c] = impulse[i, c]
    velocity_y[:] = moving
    velocity_before[:] = moving
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


_SCRATCH = {
    IslandsSettings: make_islands_room,
    NNCGSettings: make_directions,
    NesterovSettings: make_directions,
    APGDSettings: make_points,
}

_RELAX = {
    PGSSettings: relax_pgs,
    IslandsSettings: relax_islands,
    BatchSettings: relax_in_batches,
    PSORSettings: relax_psor,
    SymmetricSettings: relax_symmetric,
    NNCGSettings: relax_nncg,
    NesterovSettings: relax_nesterov,
    APGDSettings: relax_apgd,
}
