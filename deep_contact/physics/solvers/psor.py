"""Projected successive over-relaxation, with a fixed or an adaptive factor ω."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from numba import njit

from deep_contact import validation
from deep_contact.physics.contact_solver import NORMAL_MASS, TANGENT_MASS, sweep
from deep_contact.physics.convergence import is_over
from deep_contact.physics.solvers.pgs import PGS
from deep_contact.physics.solvers.registry import Loop, register, tolerance_argument

OMEGA_WINDOW = 12
"""Sweeps over which the rate of convergence is taken before ω changes."""

LARGEST_OMEGA = 1.7
"""Adaptive ω goes no further: with friction, sweeps closer to 2 were measured to circle around the solution."""


@dataclass(frozen=True, kw_only=True)
class PSOR(PGS):
    """Projected successive over-relaxation: PGS with every change of an impulse multiplied by ω.

    omega: ω, between 0 and 2; with `adaptive`, the one to start with. friction_omega: ω of the friction rows; None:
    the same. adaptive: follow the measured rate of convergence (Hageman and Young, Applied Iterative Methods, 1981,
    chapter 9), not together with a friction_omega. The other options are those of `PGS`.

    Without friction it converges for 0 < ω < 2 (Cottle, Pang and Stone, The Linear Complementarity Problem, 1992,
    section 5.3); other values are refused. Weakness: with friction convergence is not proven. The bounds ±μ λ_n move
    as λ_n overshoots, and from ω of about 1.5 single contacts alternate between sticking and slipping, so θ stalls
    above a tight tolerance. A smaller friction_omega moves that to larger ω: 1.75 with 1.45, or 1.8 with 1.4, leaves
    0.88 to 1.04 of the error of the best single ω after 10 to 50 sweeps along runs (Figure 6.11). Adaptive ω is
    estimated from θ alone and lags where contacts keep opening and closing.
    """

    omega: float = 1.3
    adaptive: bool = False
    friction_omega: float | None = None

    def __post_init__(self):
        super().__post_init__()
        validation.number("omega", self.omega, above=0, below=2)
        validation.flag("adaptive", self.adaptive)
        if self.friction_omega is not None:
            validation.number("friction_omega", self.friction_omega, above=0, below=2)
            if self.adaptive:
                raise ValueError(f"friction_omega: expected None with adaptive=True, got {self.friction_omega}")


class PSORSettings(NamedTuple):
    """Settings of `PSOR`."""

    tolerance: float
    omega: float
    adaptive: bool
    friction_omega: float


@njit(cache=True)
def relax_psor(settings, rows, friction, solver_bodies, theta, workspace):
    """Projected successive over-relaxation: every change of an impulse is ω times what would solve its row.

    This is a sweep with ω times the effective masses. θ is divided by the smaller ω, so that it is at least the largest
    change of a plain sweep. Adaptive: see `better_omega`.
    """
    omega = settings.omega
    least = min(omega, settings.friction_omega)
    scale_masses(rows, omega, settings.friction_omega, friction)
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, solver_bodies) / least
        if is_over(theta[k], settings.tolerance):
            return k + 1
        if settings.adaptive and (k + 1) % OMEGA_WINDOW == 0:
            better = better_omega(theta, k, omega)
            scale_masses(rows, better / omega, better / omega, friction)
            omega = least = better
    return theta.shape[0]


@njit(cache=True)
def better_omega(theta, k, omega):
    """ω for the sweeps after the k-th, from the rate ρ at which θ fell over the last window (Hageman and Young 1981).

    Where sweeps converge as on a linear problem with consistent order, ρ + ω − 1 = √ρ ω μ with the spectral radius μ
    of the Jacobi iteration, and the best ω is 2 / (1 + √(1 − μ²)). Where θ grew, ω goes half of the way back to 1.
    """
    half = OMEGA_WINDOW // 2
    late = early = 0.0
    for i in range(half):
        late = max(late, theta[k - i])
        early = max(early, theta[k - half - i])
    if not late < early:
        return 1.0 + 0.5 * (omega - 1.0)
    rho = (late / early) ** (1.0 / half)
    if rho <= omega - 1.0:
        return omega
    mu = (rho + omega - 1.0) / (math.sqrt(rho) * omega)
    best = 2.0 / (1.0 + math.sqrt(max(0.0, 1.0 - mu * mu)))
    return min(max(omega, best), LARGEST_OMEGA)


@njit(cache=True)
def scale_masses(rows, normal_factor, tangent_factor, friction):
    """Multiply the effective masses of all rows, in place."""
    for i in range(rows.data.shape[0]):
        rows.data[i, NORMAL_MASS] *= normal_factor
        if friction is not None:
            rows.data[i, TANGENT_MASS] *= tangent_factor


def _settings(solver: PSOR) -> PSORSettings:
    friction_omega = solver.omega if solver.friction_omega is None else solver.friction_omega
    return PSORSettings(tolerance_argument(solver), float(solver.omega), bool(solver.adaptive), float(friction_omega))


register(PSOR, _settings, (Loop(PSORSettings, relax_psor),))
