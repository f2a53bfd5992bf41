"""Write a solver of your own.

For solver researchers: a solver is a loop over the rows of the contacts, its options, and a registration. The solver
`Twice` of this program sweeps twice where PGS sweeps once. Once it is registered, states, files and studies take
`Twice` as they take the solvers of the package.
"""

from dataclasses import dataclass
from typing import NamedTuple

from numba import njit

import deep_contact as dc
from deep_contact.solvers import Loop, register, sweep
from deep_contact.stepping.interface import SolverOptions


@dataclass(frozen=True, kw_only=True)
class Twice(SolverOptions):
    """Weakness: every second sweep is not counted."""

    sweeps: int = 20
    tolerance: float | None = None


class Settings(NamedTuple):
    """What the loop reads: nothing."""


@njit
def relax(settings, rows, friction, solver_bodies, theta, workspace):
    """Sweep in place on the rows and the solver bodies; fill θ. Returns the sweeps."""
    for k in range(theta.shape[0]):
        sweep(rows, friction, solver_bodies)
        theta[k] = sweep(rows, friction, solver_bodies)
    return theta.shape[0]


register(Twice, lambda solver: Settings(), (Loop(Settings, relax),))
state = dc.simulate(dc.circles_in_box(40, size=20, seed=1), steps=150).state
for solver in (Twice(), dc.PGS(sweeps=20), dc.PGS(sweeps=40)):
    print(solver, dc.solve_contacts(state, solver=solver).record.theta[-1])
