"""Nonsmooth nonlinear conjugate gradients on projected Gauss-Seidel.

Tests: tests/solvers/test_solvers.py
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.convergence import is_over
from deep_contact.stepping.interface import Loop, SolverOptions, register, tolerance_argument
from deep_contact.stepping.rows import CONTRACT, SUMS, sweep


@dataclass(frozen=True, kw_only=True)
class NNCG(SolverOptions):
    """Nonsmooth nonlinear conjugate gradient on PGS (Silcowitz, Niebe and Erleben, The Visual Computer 26, 2010).

    The change of the impulses in a sweep serves as descent direction. Directions are combined by the formula of
    Fletcher and Reeves. The options are those of every solver (`SolverOptions`).

    Weakness: θ does not fall with every sweep, so with fewer than ten sweeps PGS is the safer choice. The formula
    assumes that the sets of sticking, slipping and open contacts do not change. While these sets change, the method
    restarts often and is PGS at a higher cost. With friction convergence is not proven.
    """


NNCGSettings = namedtuple("NNCGSettings", ["tolerance"])


class Directions(NamedTuple):
    """Workspace of `relax_nncg` and `relax_nesterov`: flat arrays with the sizes of the impulses and the solver bodies.

    `last_impulse` and `last_velocity` have the impulses and velocities from which the last sweep started. `along` and
    `velocity_along` have the directions in which `relax_nncg` extrapolates them. (`relax_nesterov` uses the arrays in
    another way.)
    """

    last_impulse: np.ndarray
    along: np.ndarray
    last_velocity: np.ndarray
    velocity_along: np.ndarray


@njit(cache=True)
def make_directions(rows, solver_bodies):
    """Return uninitialised `Directions` for these rows and solver bodies."""
    size, width = rows.impulse.size, solver_bodies.size
    return Directions(np.empty(size), np.empty(size), np.empty(width), np.empty(width))


@njit(cache=True)
def relax_nncg(settings, rows, friction, solver_bodies, theta, workspace):
    """Do sweeps with nonlinear conjugate gradients. The change of λ in a sweep is the descent direction −∇f.

    p is the search direction, at first 0. After each sweep, β p is added to λ, and p becomes β p − ∇f. Here β is ‖∇f‖²
    divided by its value in the sweep before (Fletcher-Reeves). If β exceeds 1, the method restarts: λ is not
    extrapolated, and p becomes 0.

    The velocities are linear in λ. They are therefore extrapolated in the same way, with a direction of their own, and
    need no sum over the contacts. The result of the last sweep is not extrapolated, so that the returned impulses lie
    in the friction cone. Arguments and result are those of `Loop.relax` (`stepping.interface`).
    """
    # Flat views, so that the loops over all numbers vectorise.
    impulse, velocity = rows.impulse.reshape(rows.impulse.size), solver_bodies.reshape(solver_bodies.size)
    if impulse.size > workspace.last_impulse.size or velocity.size > workspace.last_velocity.size:
        workspace = make_directions(rows, solver_bodies)
    last_impulse, along = workspace.last_impulse[: impulse.size], workspace.along[: impulse.size]
    last_velocity, velocity_along = workspace.last_velocity[: velocity.size], workspace.velocity_along[: velocity.size]
    reset(impulse, last_impulse, along)
    reset(velocity, last_velocity, velocity_along)
    last_size = np.inf
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, solver_bodies)
        if is_over(theta[k], settings.tolerance) or k + 1 == theta.shape[0]:
            return k + 1
        size = squared_distance(impulse, last_impulse)
        # If the sweep before changed nothing, β is 0: the quotient 0 / 0 would make all impulses NaN.
        beta = size / last_size if last_size > 0.0 else 0.0
        last_size = size
        if beta > 1.0:
            reset(impulse, last_impulse, along)
            reset(velocity, last_velocity, velocity_along)
        else:
            extrapolate(impulse, last_impulse, along, beta)
            extrapolate(velocity, last_velocity, velocity_along, beta)
    return theta.shape[0]


@njit(cache=True, fastmath=SUMS)
def squared_distance(one, other):
    """Return Σ (one − other)² of two flat arrays."""
    total = 0.0
    for i in range(one.shape[0]):
        change = one[i] - other[i]
        total += change * change
    return total


@njit(cache=True, fastmath=CONTRACT)
def extrapolate(x, last, along, beta):
    """Extrapolate x along the direction p, which is `along`, and update p and `last`, in place.

    With the old values on the right-hand sides: x ← x + β p, p ← β p + (x − last). Then `last` becomes the new x.
    """
    for i in range(x.shape[0]):
        momentum = beta * along[i]
        along[i] = momentum + x[i] - last[i]
        x[i] += momentum
        last[i] = x[i]


@njit(cache=True)
def reset(x, last, along):
    """Restart from x, in place: the direction p, which is `along`, becomes 0, and `last` becomes x."""
    along[:] = 0.0
    last[:] = x


register(
    NNCG, lambda solver: NNCGSettings(tolerance_argument(solver)), (Loop(NNCGSettings, relax_nncg, make_directions),)
)
