"""Projected Gauss-Seidel: one sweep after the other, over all contacts or island by island."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from typing import NamedTuple

from deep_contact.compiled import njit
from deep_contact.state import validation
from deep_contact.stepping.convergence import is_over
from deep_contact.stepping.interface import Loop, SolverOptions, register, tolerance_argument
from deep_contact.stepping.islands import make_islands_workspace, sort_by_island
from deep_contact.stepping.rows import Rows, sweep


@dataclass(frozen=True, kw_only=True)
class PGS(SolverOptions):
    """Projected Gauss-Seidel, the thesis's Algorithm 1 with the friction row of Box2D beside every normal row.

    islands: sweep each island on its own. Islands are stopped separately, which saves nothing for one pile, or without
    a tolerance.
    sweeps, tolerance: see `SweepOptions`.
    position_sweeps, substeps, most_substeps, approach, slop: options of stepping, see `SolverOptions`.

    Weakness: it is slow, not unstable. Every sweep lowers the energy of the error, but information travels one contact
    a sweep, so the number of sweeps grows with the square of a pile's height and with the mass ratio.
    """

    islands: bool = False

    def __post_init__(self):
        super().__post_init__()
        validation.flag("islands", self.islands)


PGSSettings = namedtuple("PGSSettings", ["tolerance"])
IslandsSettings = namedtuple("IslandsSettings", ["tolerance"])


@njit(cache=True)
def relax_pgs(settings, rows, friction, solver_bodies, theta, workspace):
    """Projected Gauss-Seidel: one sweep after the other."""
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, solver_bodies)
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


@njit(cache=True)
def relax_islands(settings, rows, friction, solver_bodies, theta, workspace):
    """Projected Gauss-Seidel, one island after the other. Returns (sweeps, relaxations).

    The number of sweeps is that of the slowest island. θ of a sweep is the largest over the islands that did it, so
    the last θ tells whether all islands are within the tolerance.
    """
    if rows.body.shape[0] > workspace.order.shape[0]:
        workspace = make_islands_workspace(rows, solver_bodies)
    islands, by_island = sort_by_island(rows, workspace)
    most = relaxations = 0
    for i in range(islands):
        first, end = workspace.start[i], workspace.start[i + 1]
        part = Rows(by_island.body[first:end], by_island.data[first:end], by_island.impulse[first:end])
        for k in range(theta.shape[0]):
            largest = sweep(part, friction, solver_bodies)
            relaxations += end - first
            theta[k] = max(theta[k], largest) if k < most else largest
            most = max(most, k + 1)
            if is_over(largest, settings.tolerance):
                break
    for i in range(rows.body.shape[0]):
        for c in range(rows.impulse.shape[1]):
            rows.impulse[workspace.order[i], c] = by_island.impulse[i, c]
    return most, relaxations


def _settings(solver: PGS) -> NamedTuple:
    return (IslandsSettings if solver.islands else PGSSettings)(tolerance_argument(solver))


_ISLANDS = Loop(IslandsSettings, relax_islands, make_islands_workspace, counts_relaxations=True)
register(PGS, _settings, (Loop(PGSSettings, relax_pgs), _ISLANDS))
