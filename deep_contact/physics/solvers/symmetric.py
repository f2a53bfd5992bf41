"""Symmetric projected Gauss-Seidel: sweeps forwards and backwards by turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from numba import njit

from deep_contact.physics.contact_solver import Rows, sweep
from deep_contact.physics.convergence import is_over
from deep_contact.physics.solvers.pgs import PGS
from deep_contact.physics.solvers.registry import Loop, register, tolerance_argument


@dataclass(frozen=True, kw_only=True)
class SymmetricPGS(PGS):
    """Projected Gauss-Seidel with sweeps forwards and backwards by turns (Aitken's double sweep). Options of `PGS`.

    Each direction counts as one sweep. The result depends less on the order of the contacts, so a pile numbered from
    bottom to top is solved as fast as one numbered from top to bottom. Weakness: it needs more sweeps than PGS, since
    the rows relaxed last in one sweep come first in the next, when nothing is left to change.
    """


class SymmetricSettings(NamedTuple):
    """Settings of `SymmetricPGS`."""

    tolerance: float


@njit(cache=True)
def relax_symmetric(settings, rows, friction, solver_bodies, theta, workspace):
    """Symmetric projected Gauss-Seidel: sweeps forwards and backwards by turns, each counted as one."""
    reverse = Rows(rows.body[::-1], rows.data[::-1], rows.impulse[::-1])
    for k in range(theta.shape[0]):
        if k % 2 == 0:
            theta[k] = sweep(rows, friction, solver_bodies)
        else:
            theta[k] = sweep(reverse, friction, solver_bodies)
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


register(
    SymmetricPGS,
    lambda solver: SymmetricSettings(tolerance_argument(solver)),
    (Loop(SymmetricSettings, relax_symmetric),),
)
