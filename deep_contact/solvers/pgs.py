"""Projected Gauss-Seidel, over all contacts together or island by island.

Tests: tests/solvers/test_solvers.py, tests/stepping/test_islands.py
"""

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

    islands: whether to sweep each island, a group of connected circles, on its own. The sweeps of each island then end
    at the tolerance. This saves nothing for a scene with one island, or without a tolerance.
    sweeps, tolerance: see `SweepOptions`.
    position_sweeps, substeps, most_substeps, approach, slop: options of stepping, see `SolverOptions`.

    Weakness: it is stable, but slow. Every sweep lowers the energy of the error, but information travels one contact a
    sweep, so the number of sweeps grows with the square of a pile's height and with the mass ratio.
    """

    islands: bool = False

    def __post_init__(self):
        super().__post_init__()
        validation.flag("islands", self.islands)


PGSSettings = namedtuple("PGSSettings", ["tolerance"])
IslandsSettings = namedtuple("IslandsSettings", ["tolerance"])


@njit(cache=True)
def relax_pgs(settings, rows, friction, solver_bodies, theta, workspace):
    """Do sweeps over all contacts, in place, until θ is within the tolerance. Returns the number of sweeps.

    Arguments are those of `Loop.relax` (`stepping.interface`).
    """
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, solver_bodies)
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


@njit(cache=True)
def relax_islands(settings, rows, friction, solver_bodies, theta, workspace):
    """Do sweeps over one island after the other, in place. Returns (sweeps, relaxations).

    `sweeps` is the number of sweeps of the island that needs most. `relaxations` is the number of relaxations of a
    contact in all sweeps of all islands. θ of sweep k is the largest over the islands that did k sweeps or more. An
    island that did fewer is within the tolerance, so that the last θ tells whether all are. Arguments are those of
    `Loop.relax` (`stepping.interface`).
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
register(PGS, _settings, (Loop(PGSSettings, relax_pgs), _ISLANDS), rolls=True)
