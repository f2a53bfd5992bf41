"""`Simulation`: the result of a run.

Tests: tests/analysis/test_contact_forces.py, tests/stepping/test_sleeping.py
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deep_contact.run.trajectory import Trajectory
from deep_contact.state import html
from deep_contact.state.equality import by_value
from deep_contact.state.fields import checked_part
from deep_contact.state.state import StateWithContacts
from deep_contact.stepping.interface import tolerance_argument


@by_value
class Simulation(NamedTuple):
    """A finished run.

    | field       | meaning                                                                                  |
    |-------------|------------------------------------------------------------------------------------------|
    | state       | the `State` after the last step; its contacts are detected, but not solved               |
    | contacts    | number of contacts solved in each step, (steps,); contacts that sleep do not count       |
    | sweeps      | number of velocity sweeps in each step, (steps,); with islands, of the slowest island    |
    | theta       | θ after the last sweep of each step, (steps,), N·s; infinite if no sweep was done        |
    | relaxations | contacts times sweeps in each step, (steps,); with islands, summed over the islands      |
    | substeps    | number of substeps of each step, (steps,)                                                |
    | recorded    | the recorded states as a `Trajectory`, which ends with `state`; None without record=…    |
    | loads       | sum of the impulses on walls and segments until each recorded state, (T, 4 + S, 2), N·s; |
    |             | None without forces=True                                                                 |
    | solved      | the solved states, as in `on_step`, of the last steps before recorded states, as a       |
    |             | `Trajectory`; None without forces=True                                                   |
    | on_circles  | sum of the contact impulses on circles until each recorded state, (T, n, 2), N·s; None   |
    |             | without moving segments, fixed circles and pushes                                        |
    | shifts      | momentum that gravity gives each circle until each recorded state, minus m g t,          |
    |             | (T, n, 2), N·s; None if e = 0, or if there are `on_circles`                              |

    If steps have substeps, contacts and θ are those of a step's last substep. Sweeps and relaxations are sums over its
    substeps.
    """

    state: StateWithContacts
    contacts: np.ndarray
    sweeps: np.ndarray
    theta: np.ndarray
    relaxations: np.ndarray
    substeps: np.ndarray
    recorded: Trajectory | None = None
    loads: np.ndarray | None = None
    solved: Trajectory | None = None
    on_circles: np.ndarray | None = None
    shifts: np.ndarray | None = None

    @property
    def trajectory(self) -> Trajectory:
        """The recorded states. Raises ValueError if none were recorded."""
        if self.recorded is None:
            raise ValueError("trajectory: expected a run of simulate(…, record=…), got one that recorded no states")
        return self.recorded

    def force_on(self, part: str, index: int | Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """Return the mean contact force on a part of the scene between successive recorded states, (T − 1, 2), N.

        Force k is the mean from times[k] to times[k + 1] of the trajectory, over all steps and substeps, rebounds
        included. The force on a circle is its change of momentum over time, minus gravity. In scenes with moving
        segments, fixed circles or pushes it is the sum of its contact impulses over time.

        part: "floor", "right", "ceiling", "left", "segment", "circle", or "wall", which stands for the four sides,
        numbered in this order. index: index of the segment, circle or wall, or several indices, whose forces are added;
        None if `part` is one of the four sides. Raises ValueError if no states were recorded, for walls and segments
        without forces=True, and on an unknown part or index.
        """
        recorded, world = self.trajectory, self.state.world
        is_circle, chosen = checked_part(part, index, self.state.bodies.count, len(world.segments))
        seconds = np.diff(recorded.times)[:, None]
        if is_circle and self.on_circles is not None:
            return np.diff(self.on_circles[:, chosen].sum(axis=1), axis=0) / seconds
        if is_circle:
            mass = self.state.bodies.mass[chosen]
            change = np.einsum("tik,i->tk", np.diff(recorded.velocities[:, chosen], axis=0), mass)
            if self.shifts is not None:
                change -= np.diff(self.shifts[:, chosen].sum(axis=1), axis=0)
            return change / seconds - mass.sum() * np.array(world.gravity)
        if self.loads is None:
            raise ValueError("forces: expected a run of simulate(…, record=…, forces=True), got one without")
        return np.diff(self.loads[:, chosen].sum(axis=1), axis=0) / seconds

    @property
    def status(self) -> np.ndarray:
        """Reason why the sweeps of each step ended, (steps,), as `ConvergenceRecord.status`."""
        tolerance = tolerance_argument(self.state.solver)
        cases = [self.contacts == 0, self.theta <= tolerance, (self.sweeps > 0) & ~np.isfinite(self.theta)]
        return np.select(cases, ["no_contacts", "converged", "diverged"], "max_sweeps")

    def __repr__(self) -> str:
        return f"Simulation({', '.join(self._summary().values())}, state={self.state!r})"

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: a summary of the run, and its last state."""
        return html.shown("Simulation", self._summary().items()) + self.state._repr_html_()

    def _summary(self) -> dict[str, str]:
        summary = {"steps": html.counted(self.sweeps.size, "step")}
        if self.sweeps.size:
            ends = self.status
            summary["sweeps"] = f"{self.sweeps.mean():.1f} sweeps a step"
            if self.substeps.max() > 1:
                summary["substeps"] = f"{self.substeps.mean():.1f} substeps a step"
            if tolerance_argument(self.state.solver) > 0:  # without a tolerance every step does all sweeps
                summary["solves"] = f"converged in {np.isin(ends, ('converged', 'no_contacts')).sum():,} steps"
            if (ends == "diverged").any():
                summary["diverged"] = f"{(ends == 'diverged').sum():,} diverged"
        return summary | ({} if self.recorded is None else {"record": html.counted(len(self.recorded), "state")})
