"""The solvers a user can choose, as frozen options. The sweeps themselves are in `contact_solver`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deep_contact import constants


@dataclass(frozen=True, kw_only=True)
class PGS:
    """Projected Gauss-Seidel, the thesis's Algorithm 1 with the friction row of Box2D beside every normal row.

    sweeps: at most so many velocity sweeps. tolerance: stop once θ (the largest change of an impulse in the last
    sweep, N·s) is no larger; None sweeps to the end. position_sweeps: at most so many sweeps of position correction.

    It fails slowly, not badly: every sweep lowers the kinetic energy that is left to lose, but information travels
    one contact a sweep, so tall piles and large mass ratios need sweeps by the square of their height.
    """

    sweeps: int = 3000
    tolerance: float | None = constants.THETA_TOLERANCE
    position_sweeps: int = 10

    def __post_init__(self):
        for name in ("sweeps", "position_sweeps"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
                raise ValueError(f"{name}: expected an integer >= 0, got {value!r}")
        if self.tolerance is not None and not (np.isfinite(self.tolerance) and self.tolerance >= 0):
            raise ValueError(f"tolerance: expected None or a finite number >= 0, got {self.tolerance!r}")


METHODS = {"PGS": PGS}
"""Name in a state file -> options class."""
