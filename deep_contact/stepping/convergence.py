"""Convergence of a solve: θ after each sweep, and why the sweeps ended.

Tests: tests/stepping/test_rows.py
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.equality import by_value
from deep_contact.state.validation import expect


@by_value
class ConvergenceRecord(NamedTuple):
    """Convergence of one solve.

    | field  | meaning                                                                              |
    |--------|--------------------------------------------------------------------------------------|
    | theta  | θ_k = max over rows of abs(λ_k − λ_{k−1}) after each sweep, (sweeps,), N·s (Alg 1)   |
    | sweeps | number of sweeps that were done                                                      |
    | status | "converged": the last θ is within the tolerance; "max_sweeps": it is not, or there   |
    |        | was no tolerance; "diverged": it is not finite, and sweeping ended there;            |
    |        | "no_contacts": there was nothing to solve                                            |
    | shifts | momentum that gravity and external forces add to the circles in a step beyond        |
    |        | Δt (m g + f), (n, 2), N·s; only for `on_step` and if e > 0, otherwise None           |

    θ is a stopping criterion and no error: if convergence is slow, θ is small far from the solution. For errors see
    `stepping.metrics`.
    """

    theta: np.ndarray
    sweeps: int
    status: str
    shifts: np.ndarray | None = None

    def __repr__(self) -> str:
        last = f", last θ {self.theta[-1]:.2g} N·s" if self.theta.size else ""
        return f"ConvergenceRecord({self.sweeps:,} sweeps, {self.status.replace('_', ' ')}{last})"


def convergence_record(theta: np.ndarray, solver, n_contacts: int, shifts=None) -> ConvergenceRecord:
    """Return the record of a solve. theta: θ of each sweep, N·s. solver: its options. n_contacts: number of contacts.

    shifts: as in `ConvergenceRecord`.
    """
    if n_contacts == 0:
        status = "no_contacts"
    elif solver.tolerance is not None and theta.size and theta[-1] <= solver.tolerance:
        status = "converged"
    elif theta.size and not np.isfinite(theta[-1]):
        status = "diverged"
    else:
        status = "max_sweeps"
    return ConvergenceRecord(theta.copy(), int(theta.size), status, shifts)


def mean_theta(thetas: Iterable[np.ndarray], sweeps: int) -> np.ndarray:
    """Return the average convergence rate of a simulation, Eq 2.30: the mean over its steps of θ after each sweep.

    thetas: for each step, θ after each of its sweeps, N·s. A step that stopped before `sweeps` sweeps counts with its
    last θ in the remaining sweeps. In the thesis's own code such a step does not count in the remaining sweeps, whose
    means are therefore over the slow steps only. Returns (sweeps,), N·s. Raises ValueError if there is no step, or a
    step without sweeps.
    """
    rows = [theta[:sweeps] for theta in thetas]
    expect(rows, "thetas: expected at least one step, got none")
    empty = [k for k, row in enumerate(rows) if len(row) == 0]
    expect(not empty, f"thetas{empty[:1]}: expected at least one sweep, got none")
    return np.mean([np.pad(row, (0, sweeps - len(row)), mode="edge") for row in rows], axis=0)


@njit(cache=True)
def is_over(theta, tolerance):
    """Return whether sweeping ends: θ, N·s, is at most the tolerance, or not finite."""
    return theta <= tolerance or not math.isfinite(theta)


@njit(cache=True, fastmath={"reassoc"})
def all_finite(solver_bodies):
    """Return whether all numbers of an array are finite. The fast-math flag lets the sum vectorise."""
    total, numbers = 0.0, solver_bodies.reshape(-1)
    for i in range(numbers.shape[0]):
        total += 0.0 * numbers[i]  # 0 times an infinite number is NaN
    return total == 0.0


@njit(cache=True)
def mark_divergence(solver_bodies, theta, sweeps):
    """Set the last θ to NaN if a velocity is not finite, which the impulses alone do not always show.

    theta: θ of each sweep. sweeps: number of sweeps that were done.
    """
    if sweeps > 0 and not all_finite(solver_bodies):
        theta[sweeps - 1] = np.nan
