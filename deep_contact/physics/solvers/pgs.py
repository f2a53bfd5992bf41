"""Projected Gauss-Seidel: one sweep after the other, over all contacts or island by island."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass, replace
from typing import NamedTuple

from deep_contact import validation
from deep_contact.compiled import njit
from deep_contact.physics.contact_solver import Rows, sweep
from deep_contact.physics.convergence import is_over
from deep_contact.physics.islands import make_islands_workspace, sort_by_island
from deep_contact.physics.solvers.registry import Loop, register, tolerance_argument
from deep_contact.state import State
from deep_contact.state.scales import FOLLOWS_SCENE, theta_tolerance

MOST_SWEEPS = 10_000_000
"""Largest value of each count among the options: the θ of each sweep is kept, which takes 8 bytes."""


@dataclass(frozen=True, kw_only=True)
class PGS:
    """Projected Gauss-Seidel, the thesis's Algorithm 1 with the friction row of Box2D beside every normal row.

    sweeps: largest number of velocity sweeps. tolerance: θ at which the sweeps end, N·s, where θ is the largest change
    of an impulse in a sweep. None does all sweeps; "scene" takes 6e-5 N·s times the ratio of the scene's m g Δt to the
    thesis's (`scales.theta_tolerance`). With substeps it is the tolerance of the longest substep.
    position_sweeps: largest number of sweeps of position correction. islands: whether each island is swept on its own.
    substeps: number of equal parts of every step of a run, each with sweeps and position sweeps of its own (Macklin et
    al., Small Steps in Physics Simulation, 2019). Contacts carry the impulses of the last substep times the number of
    substeps, so that a start fits any division of Δt. If this number is a power of two, a run that is read back goes on
    bit for bit.
    most_substeps: largest number of substeps of a step in which a circle is about to hit something, `substeps` times a
    power of two; by default `substeps`. approach: largest displacement of such a circle in a substep, in mean radii,
    which decides the number of substeps (`physics.substeps`).
    slop: penetration that position correction leaves alone, in units of the scene's slop (`scales`). With a small slop
    and one substep a pile may tremble; with a quarter, two substeps are enough.

    Weakness: it is slow, not unstable. Every sweep lowers the energy of the error, but information travels one contact
    a sweep, so the number of sweeps grows with the square of a pile's height and with the mass ratio. The sweeps of
    each island end separately, which saves nothing for one pile, or without a tolerance. Only PGS has islands.
    """

    sweeps: int = 3000
    tolerance: float | str | None = FOLLOWS_SCENE
    position_sweeps: int = 10
    islands: bool = False
    substeps: int = 1
    most_substeps: int | None = None
    approach: float = 0.03
    slop: float = 1.0

    def __post_init__(self):
        validation.integer("sweeps", self.sweeps, most=MOST_SWEEPS)
        validation.integer("position_sweeps", self.position_sweeps, most=MOST_SWEEPS)
        validation.integer("substeps", self.substeps, least=1, most=MOST_SWEEPS)
        if self.most_substeps is not None:
            most = validation.integer("most_substeps", self.most_substeps, least=self.substeps, most=MOST_SWEEPS)
            parts, rest = divmod(most, self.substeps)
            if rest or parts & (parts - 1):
                raise ValueError(f"most_substeps: expected {self.substeps} times a power of two, got {most}")
        validation.number("approach", self.approach, above=0)
        validation.number("slop", self.slop, low=0, high=100)
        if validation.flag("islands", self.islands) and type(self) is not PGS:
            raise ValueError(f"islands: expected False, since {type(self).__name__} sweeps them together, got True")
        if self.tolerance is not None and not (isinstance(self.tolerance, str) and self.tolerance == FOLLOWS_SCENE):
            validation.number("tolerance", self.tolerance, low=0)

    def for_state(self, state: State) -> PGS:
        """The options with the tolerance of a substep in N·s, if it follows the scene."""
        if self.tolerance != FOLLOWS_SCENE:
            return self
        bodies = state.bodies
        tolerance_of_state = theta_tolerance(bodies.mass, bodies.radius, state.world.gravity, state.dt)
        return replace(self, tolerance=tolerance_of_state / self.substeps)


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
