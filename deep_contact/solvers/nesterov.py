"""Projected Gauss-Seidel with Nesterov's momentum and restarts.

Tests: tests/solvers/test_solvers.py
"""

from __future__ import annotations

import math
from collections import namedtuple
from dataclasses import dataclass

import numpy as np

from deep_contact.compiled import njit
from deep_contact.solvers.nncg import make_directions
from deep_contact.stepping.convergence import is_over
from deep_contact.stepping.interface import Loop, SolverOptions, register, tolerance_argument
from deep_contact.stepping.rows import CONTRACT, SUMS, sweep

FIRST_MOMENTUM = 0.9
"""Upper bound of the momentum β after the first sweep (`relax_nesterov`)."""

MAX_MOMENTUM = 0.99
"""Largest value that the upper bound of β takes."""

MOMENTUM_WINDOW = 5
"""Number of sweeps between two regular adaptations of the upper bound of β."""

SUDDEN_GROWTH = 1.2
"""If the squared change of the impulses in a sweep exceeds that in the sweep before by more than this factor, the upper
bound of β is lowered at once."""


@dataclass(frozen=True, kw_only=True)
class NesterovPGS(SolverOptions):
    """Projected Gauss-Seidel with Nesterov's momentum (Soviet Mathematics Doklady 27, 1983) and an upper bound on it.

    The momentum restarts by the gradient scheme of O'Donoghue and Candès (Foundations of Computational Mathematics 15,
    2015). The options are those of every solver (`SolverOptions`).

    Weakness: the bound follows from the last sweeps. When contacts open or begin to slip, it therefore reacts late, and
    the error may grow for some sweeps. Fewer than ten sweeps gain little over `PGS`. With friction convergence is not
    proven, and θ does not fall with every sweep.
    """


NesterovSettings = namedtuple("NesterovSettings", ["tolerance"])


@njit(cache=True)
def relax_nesterov(settings, rows, friction, solver_bodies, theta, workspace):
    """Do sweeps with Nesterov's momentum: each sweep starts from an extrapolation of the results of the last two.

    Let a sweep start from impulses λ* and end at λ, and let λ⁻ be the result of the sweep before. The next sweep starts
    from λ + β (λ − λ⁻), with β = (t − 1) / t⁺ and t⁺ = (1 + √(1 + 4 t²)) / 2. The number t begins at 1 and becomes t⁺
    after each sweep. If the scalar product of λ − λ* and λ − λ⁻ is negative, the momentum restarts: β is 0 for the next
    sweep, and t becomes 1 (gradient scheme of O'Donoghue and Candès 2015).

    With friction this rule alone makes the impulses cycle around the solution. Therefore β is at most 1 − ε, where ε
    adapts to s = Σ (λ − λ*)², the squared change of the impulses in a sweep. If s grows by more than the factor
    `SUDDEN_GROWTH` from one sweep to the next, ε doubles. `MOMENTUM_WINDOW` sweeps form a window. After each window, ε
    doubles if the sum of s is larger than in the window before, and otherwise falls by a fifth.

    The solver bodies' velocities are extrapolated like the impulses. The result of the last sweep is not extrapolated,
    so that the returned impulses lie in the friction cone. Arguments and result are those of `Loop.relax`
    (`stepping.interface`).
    """
    impulse, velocity = rows.impulse.reshape(rows.impulse.size), solver_bodies.reshape(solver_bodies.size)
    if impulse.size > workspace.last_impulse.size or velocity.size > workspace.last_velocity.size:
        workspace = make_directions(rows, solver_bodies)
    last_impulse, swept_from = workspace.last_impulse[: impulse.size], workspace.along[: impulse.size]
    last_velocity = workspace.last_velocity[: velocity.size]
    last_impulse[:] = impulse
    swept_from[:] = impulse
    last_velocity[:] = velocity
    memory = FIRST_MEMORY
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, solver_bodies)
        if is_over(theta[k], settings.tolerance) or k + 1 == theta.shape[0]:
            return k + 1
        momentum, memory = next_momentum(k, impulse, swept_from, last_impulse, memory)
        extrapolate(impulse, last_impulse, momentum)
        extrapolate(velocity, last_velocity, momentum)
        swept_from[:] = impulse
    return theta.shape[0]


FIRST_MEMORY = (1.0, FIRST_MOMENTUM, np.inf, np.inf, 0.0)
"""The `memory` of `next_momentum` before the first sweep. It has five numbers: t, the upper bound of β, and squared
changes of the impulses: that of the last sweep, and the sums over the window before and over the present window."""


@njit(cache=True)
def next_momentum(k, impulse, swept_from, last, memory):
    """Return β for the extrapolation after sweep k, and the new memory. The first sweep has k = 0.

    swept_from, impulse: impulses before and after this sweep. last: impulses after the sweep before. memory: the result
    after that sweep, or `FIRST_MEMORY`.
    """
    t, bound, last_size, before, now = memory
    size, downhill = step_and_slope(impulse, swept_from, last)
    now += size
    if size > SUDDEN_GROWTH * last_size:
        bound = max(0.0, 2.0 * bound - 1.0)
    if (k + 1) % MOMENTUM_WINDOW == 0:
        bound = max(0.0, 2.0 * bound - 1.0) if now > before else min(MAX_MOMENTUM, 0.2 + 0.8 * bound)
        before, now = now, 0.0
    momentum = 0.0
    if downhill < 0.0:
        t = 1.0
    else:
        next_t = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * t * t))
        momentum = min((t - 1.0) / next_t, bound)
        t = next_t
    return momentum, (t, bound, size, before, now)


@njit(cache=True, fastmath=SUMS)
def step_and_slope(x, swept_from, last):
    """Return Σ (x − swept_from)² and Σ (x − swept_from) (x − last). All arguments are flat arrays."""
    size = slope = 0.0
    for i in range(x.shape[0]):
        change = x[i] - swept_from[i]
        size += change * change
        slope += change * (x[i] - last[i])
    return size, slope


@njit(cache=True, fastmath=CONTRACT)
def extrapolate(x, last, share):
    """Add share (x − last) to x, and set `last` to the old x, in place."""
    for i in range(x.shape[0]):
        new = x[i]
        x[i] = new + share * (new - last[i])
        last[i] = new


register(
    NesterovPGS,
    lambda solver: NesterovSettings(tolerance_argument(solver)),
    (Loop(NesterovSettings, relax_nesterov, make_directions),),
)
