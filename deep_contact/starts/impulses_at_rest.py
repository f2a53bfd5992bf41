"""Impulses at which a pile rests, from its positions alone: the convex relaxation of the contact problem.

Coulomb's law has several solutions for one state: the same circles may rest or slide. Sweeps find a solution that
slides. The relaxation minimises ½ ‖M^½ (v + M⁻¹ Jᵀ λ)‖² over the cones |λ_t| ≤ μ λ_n (Anitescu 2006). Its minima are
the solutions at rest, if there are any, since their energy is 0. If no solution rests, a minimum does not satisfy
Coulomb's law: circles that slide also separate.

The method is accelerated projected gradients (Nesterov 1983), with restarts by the gradient scheme (O'Donoghue and
Candès 2015). The step length follows from the largest eigenvalue of J M⁻¹ Jᵀ, of which only a lower bound is known. If
the Rayleigh quotient of a step is larger than this bound, the bound is raised, and later steps are shorter
(backtracking, Beck and Teboulle 2009).
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.rows import (
    CONTRACT,
    INVERSE_MASS,
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    V_S,
    V_X,
    V_Y,
    Rows,
    apply_impulses,
    friction_of,
    relative_velocity,
)

LOOKS = 25
"""Number of iterations between two tests whether the circles rest, and number of iterations of the power method."""

PAST = 4
"""Number of tests over which the rate of the iterations is measured, which is 100 iterations."""

SPARE = 1.1
"""Factor on every lower bound of the largest eigenvalue, so that the product is rarely too small."""

GOLDEN = 0.6180339887498949
"""Golden section (√5 − 1) / 2. Its products with square numbers have no pattern modulo 1."""


def at_rest(
    problem, normal, tangent, *, iterations: int, speed: float, needed: float = math.inf
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return (λ_n, λ_t, rms speed): the impulses of the relaxation, (m,) each, N·s, and the speed that they leave, m/s.

    problem: `StepProblem` with tangent rows. normal, tangent: impulses to start from, (m,) each, N·s. iterations:
    largest number of iterations. speed: rms speed of the circles at which the iterations end, m/s. needed: largest rms
    speed at which the result is of use, m/s: the iterations also end if, at the rate of the last 100 iterations, the
    speed would be above `needed` after all iterations.
    """
    rows, v = problem.rows, problem.solver_bodies.copy()
    rows = rows._replace(impulse=np.column_stack([normal, tangent]))
    apply_impulses(rows, v, problem.friction)
    rms = relax_cones(rows, problem.friction, v, iterations, speed, needed)
    return rows.impulse[:, NORMAL].copy(), rows.impulse[:, TANGENT].copy(), rms


@njit(cache=True, error_model="numpy", fastmath=CONTRACT)
def relax_cones(rows, friction, v, iterations, speed, needed):
    """Do the iterations of `at_rest`, in place on impulses and velocities. Returns the rms speed of the circles, m/s.

    v: solver bodies, (n + 4, 4). At the start their velocities include the effect of the impulses of the rows.
    """
    impulse, old = rows.impulse, rows.impulse.copy()
    ahead, before, t = v.copy(), v.copy(), 1.0
    trial, largest = impulse.copy(), largest_eigenvalue(rows, friction, ahead)
    ahead[:, :], rms, past = v, rms_speed(v), np.empty(PAST)
    for k in range(iterations):
        along, square = approach(rows, friction, ahead, 1.0 / largest, trial, old)
        before[:, :] = v
        # From here to the next iteration, `impulse` has the change of the impulses, and `old` the impulses.
        for i in range(impulse.shape[0]):
            for c in range(2):
                impulse[i, c], old[i, c] = trial[i, c] - old[i, c], trial[i, c]
        apply_impulses(rows, v, friction)
        following = 0.5 + math.sqrt(0.25 + t * t)
        share, t = (t - 1.0) / following, following
        energy = energy_of_change(v, ahead)
        if energy > largest * square > 0.0:
            # The trace is an upper bound of the eigenvalue, which holds even if the change is only rounding error.
            largest, along = min(SPARE * energy / square, 4.0 * impulse.shape[0]), math.inf
        if along > 0.0:
            share, t = 0.0, 1.0
        for i in range(impulse.shape[0]):
            for c in range(2):
                trial[i, c] = old[i, c] + share * impulse[i, c]
        for a in range(v.shape[0]):
            for c in range(3):
                ahead[a, c] = v[a, c] + share * (v[a, c] - before[a, c])
        if k % LOOKS == LOOKS - 1:
            rms, look = rms_speed(v), k // LOOKS
            if not rms > speed or (look >= PAST and _misses(rms, past[look % PAST], iterations - 1 - k, needed)):
                break
            past[look % PAST] = rms
    impulse[:, :] = old
    return rms


@njit(cache=True, error_model="numpy")
def _misses(rms, before, left, needed):
    """Return whether the speed is above `needed` after `left` more iterations at the rate of the last `PAST` tests.

    rms, before: rms speed now and `PAST` tests ago, m/s.
    """
    return rms > needed and rms * (rms / before) ** (left / (PAST * LOOKS)) > needed


@njit(cache=True, error_model="numpy", fastmath=CONTRACT)
def approach(rows, friction, v, step, trial, old):
    """Move the trial impulses against the gradient J v, and project them onto the cones, in place.

    Both rows of a contact are scaled by the effective mass of its normal row, so that the friction cone keeps its
    shape. step: factor of the gradient in the scaled impulses. old: impulses after the iteration before. Returns two
    numbers: the scalar product of the gradient and the change from `old` to `trial`, and the squared length of the move
    in the scaled impulses.
    """
    body, data, along, square = rows.body, rows.data, 0.0, 0.0
    for i in range(body.shape[0]):
        g_n, g_t = relative_velocity(rows, v, i)
        scaled, mu = step * data[i, NORMAL_MASS], friction_of(friction, data, i)
        p_n, p_t = nearest_in_cone(trial[i, NORMAL] - scaled * g_n, trial[i, TANGENT] - scaled * g_t, mu)
        d_n, d_t = p_n - trial[i, NORMAL], p_t - trial[i, TANGENT]
        square += (d_n * d_n + d_t * d_t) / data[i, NORMAL_MASS]
        trial[i, NORMAL], trial[i, TANGENT] = p_n, p_t
        along += g_n * (p_n - old[i, NORMAL]) + g_t * (p_t - old[i, TANGENT])
    return along, square


@njit(cache=True, error_model="numpy")
def nearest_in_cone(p_n, p_t, friction):
    """Return the point of the cone |λ_t| ≤ μ λ_n that is nearest to (p_n, p_t)."""
    size = abs(p_t)
    if size <= friction * p_n:
        return p_n, p_t
    p_n = max(0.0, (p_n + friction * size) / (1.0 + friction * friction))
    return p_n, math.copysign(friction * p_n, p_t)


@njit(cache=True, error_model="numpy")
def largest_eigenvalue(rows, friction, v):
    """Return the largest eigenvalue of J M⁻¹ Jᵀ, scaled by the effective masses, from the power method, times `SPARE`.

    The power method starts from numbers without a pattern, which no symmetry of a scene makes orthogonal to the
    eigenvector. v: solver bodies, (n + 4, 4), whose velocities are overwritten.
    """
    m, largest = rows.body.shape[0], 1.0
    x, impulse = np.empty((m, 2)), np.empty((m, 2))
    for i in range(m):
        for c in range(2):
            k = float(2 * i + c + 1)
            x[i, c] = (k * k * GOLDEN) % 1.0 - 0.5
    change = Rows(rows.body, rows.data, impulse)
    for _ in range(LOOKS):
        v[:, : V_S + 1] = 0.0
        for i in range(m):
            for c in range(2):
                impulse[i, c] = rows.data[i, NORMAL_MASS] * x[i, c]
        apply_impulses(change, v, friction)
        square = np.sum(x * impulse)
        for i in range(m):
            g_n, g_t = relative_velocity(rows, v, i)
            x[i, NORMAL], x[i, TANGENT] = g_n, g_t
        largest = math.sqrt(np.sum(x * x * rows.data[:, NORMAL_MASS : NORMAL_MASS + 1]) / square)
        x /= largest
    return SPARE * largest


@njit(cache=True, error_model="numpy", fastmath=CONTRACT)
def energy_of_change(v, before):
    """Return twice the kinetic energy of the difference between two velocities of the circles, J.

    v, before: solver bodies with the two velocities, (n + 4, 4).
    """
    total = 0.0
    for a in range(v.shape[0] - 4):
        x, y, s = v[a, V_X] - before[a, V_X], v[a, V_Y] - before[a, V_Y], v[a, V_S] - before[a, V_S]
        if v[a, INVERSE_MASS] > 0.0:
            total += (x * x + y * y + 0.5 * s * s) / v[a, INVERSE_MASS]
    return total


@njit(cache=True, fastmath=CONTRACT)
def rms_speed(v):
    """Return the root mean square speed of the circles that are not fixed, m/s. v: solver bodies, (n + 4, 4)."""
    total, n = 0.0, 0
    for a in range(v.shape[0] - 4):
        if v[a, INVERSE_MASS] > 0.0:
            total += v[a, V_X] * v[a, V_X] + v[a, V_Y] * v[a, V_Y]
            n += 1
    return math.sqrt(total / max(n, 1))
