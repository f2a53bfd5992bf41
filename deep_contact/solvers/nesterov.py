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
"""Upper bound of the momentum β at the first sweep."""

MAX_MOMENTUM = 0.99
"""Largest value of the upper bound of β."""

MOMENTUM_WINDOW = 5
"""Number of sweeps between two adaptations of the upper bound of β."""

SUDDEN_GROWTH = 1.2
"""Ratio of the squared change of the impulses in a sweep to that in the sweep before, above which the upper bound of β
is lowered at once."""


@dataclass(frozen=True, kw_only=True)
class NesterovPGS(SolverOptions):
    """Projected Gauss-Seidel with Nesterov's momentum (Soviet Mathematics Doklady 27, 1983) and an upper bound on it.

    The momentum restarts by the gradient scheme of O'Donoghue and Candès (Foundations of Computational Mathematics 15,
    2015). The options are those of every solver (`SolverOptions`).

    Weakness: the bound adapts to the last sweeps, so it reacts late when contacts open or slip, and the error may then
    grow for some sweeps. Fewer than ten sweeps gain little. With friction convergence is not proven, and θ does not
    fall with every sweep.
    """


NesterovSettings = namedtuple("NesterovSettings", ["tolerance"])


@njit(cache=True)
def relax_nesterov(settings, rows, friction, solver_bodies, theta, workspace):
    """Do sweeps with Nesterov's momentum: each sweep starts from λ + β (λ − λ of the sweep before).

    β = (t − 1) / t⁺ with t⁺ = (1 + √(1 + 4 t²)) / 2, from t = 1. t restarts at 1 if the change of λ by the sweep and
    the change of λ since the sweep before have a negative scalar product (gradient scheme of O'Donoghue and Candès
    2015).

    With friction this rule alone makes the impulses cycle around the solution. β therefore has an upper bound. 1 −
    bound doubles when the sum of the squared changes grows from one window of sweeps to the next, or suddenly in one
    sweep. After a window without growth, 1 − bound falls by a fifth.

    Velocities are extrapolated like the impulses, and the last sweep is not extrapolated, as in `relax_nncg`. Arguments
    and result are those of `Loop.relax` (`stepping.interface`).
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
"""Memory of `next_momentum` before the first sweep: t, the bound of β, and the squared changes of the impulses in the
last sweep, in the last window and in this window."""


@njit(cache=True)
def next_momentum(k, impulse, swept_from, last, memory):
    """Return (β, memory) after the k-th sweep, counted from 0.

    The sweep changed the impulses from `swept_from` to `impulse`. last: impulses after the sweep before. memory: as
    `FIRST_MEMORY`.
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
    """Set x to x + share (x − last), and `last` to the old x, in place."""
    for i in range(x.shape[0]):
        new = x[i]
        x[i] = new + share * (new - last[i])
        last[i] = new


register(
    NesterovPGS,
    lambda solver: NesterovSettings(tolerance_argument(solver)),
    (Loop(NesterovSettings, relax_nesterov, make_directions),),
)
