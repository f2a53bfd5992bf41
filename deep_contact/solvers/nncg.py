"""Nonsmooth nonlinear conjugate gradient on projected Gauss-Seidel."""

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

    Each sweep's change is taken for a descent direction, and the directions are combined as by Fletcher and Reeves. The
    options are those of every solver (`SolverOptions`).

    Weakness: θ does not fall with every sweep, so with fewer than ten sweeps PGS is the safer
    choice. The combination assumes that the sets of sticking, slipping and open contacts do not change; while they
    change it restarts often and is PGS at a higher cost. With friction convergence is not proven.
    """


NNCGSettings = namedtuple("NNCGSettings", ["tolerance"])


class Directions(NamedTuple):
    """Workspace of `relax_nncg` and `relax_nesterov`: values of the last sweep and directions, over rows and bodies."""

    last_impulse: np.ndarray
    along: np.ndarray
    last_velocity: np.ndarray
    velocity_along: np.ndarray


@njit(cache=True)
def make_directions(rows, solver_bodies):
    """Workspace for as many rows and solver bodies."""
    size, width = rows.impulse.size, solver_bodies.size
    return Directions(np.empty(size), np.empty(size), np.empty(width), np.empty(width))


@njit(cache=True)
def relax_nncg(settings, rows, friction, solver_bodies, theta, workspace):
    """Nonsmooth nonlinear conjugate gradient: what a sweep changes is taken for the descent direction −∇f.

    After each sweep, λ ← λ + β p and p ← β p − ∇f with β = ‖∇f‖² / ‖∇f of the sweep before‖² (Fletcher-Reeves), and
    p ← 0 where β > 1. Velocities are linear in λ, so the direction of the velocities is carried along instead of being
    summed up over contacts. The last sweep is not extrapolated: the impulses returned are those that a sweep left in
    the cone.
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
        # Where nothing changed there is no direction; 0 / 0 would make everything NaN.
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
    """Σ (one − other)²."""
    total = 0.0
    for i in range(one.shape[0]):
        change = one[i] - other[i]
        total += change * change
    return total


@njit(cache=True, fastmath=CONTRACT)
def extrapolate(x, last, along, beta):
    """x ← x + β p, p ← β p + (x − last), last ← x; the p of the right-hand sides is the old one. In place."""
    for i in range(x.shape[0]):
        momentum = beta * along[i]
        along[i] = momentum + x[i] - last[i]
        x[i] += momentum
        last[i] = x[i]


@njit(cache=True)
def reset(x, last, along):
    """Restart the momentum, in place: p, which is `along`, becomes 0, and last becomes x."""
    along[:] = 0.0
    last[:] = x


register(
    NNCG, lambda solver: NNCGSettings(tolerance_argument(solver)), (Loop(NNCGSettings, relax_nncg, make_directions),)
)
