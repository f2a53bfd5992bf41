"""Projected successive over-relaxation.

Tests: tests/solvers/test_solvers.py
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from deep_contact.compiled import njit
from deep_contact.state import validation
from deep_contact.stepping.convergence import is_over
from deep_contact.stepping.interface import Loop, SolverOptions, register, tolerance_argument
from deep_contact.stepping.rows import NORMAL_MASS, TANGENT_MASS, scale_rolling, sweep


@dataclass(frozen=True, kw_only=True)
class PSOR(SolverOptions):
    """Projected successive over-relaxation: PGS with every change of an impulse multiplied by ω.

    omega: ω, between 0 and 2. friction_omega: ω of friction and rolling rows; None means `omega`. The other options are
    those of every solver (`SolverOptions`).

    Without friction the method converges for 0 < ω < 2 (Cottle, Pang and Stone, The Linear Complementarity Problem,
    1992, section 5.3). Other values are refused.

    Weakness: with friction convergence is not proven. The bounds ±μ λ_n move while λ_n overshoots. From ω of about 1.5
    on, single contacts alternate between sticking and slipping, so that θ stalls above a tight tolerance. A smaller
    `friction_omega` shifts this limit to a larger ω. After 10 to 50 sweeps a step, ω = 1.75 with 1.45 for the friction
    rows, or 1.8 with 1.4, leaves 0.88 to 1.04 times the error of the best single ω.
    """

    omega: float = 1.3
    friction_omega: float | None = None

    def __post_init__(self):
        super().__post_init__()
        validation.number("omega", self.omega, above=0, below=2)
        if self.friction_omega is not None:
            validation.number("friction_omega", self.friction_omega, above=0, below=2)


class PSORSettings(NamedTuple):
    """Settings of `PSOR` for compiled code."""

    tolerance: float
    omega: float
    friction_omega: float


@njit(cache=True)
def relax_psor(settings, rows, friction, solver_bodies, theta, workspace):
    """Do sweeps in which every change of an impulse is ω times the change that would solve its row.

    For this the effective masses are multiplied by ω, in place. θ is divided by the smaller ω, so that it is at least
    the largest change of a sweep without over-relaxation. Arguments and result are those of `Loop.relax`
    (`stepping.interface`).
    """
    for i in range(rows.data.shape[0]):
        rows.data[i, NORMAL_MASS] *= settings.omega
        if friction is not None:
            rows.data[i, TANGENT_MASS] *= settings.friction_omega
            scale_rolling(friction, rows, i, settings.friction_omega)
    least = min(settings.omega, settings.friction_omega)
    for k in range(theta.shape[0]):
        theta[k] = sweep(rows, friction, solver_bodies) / least
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


def _settings(solver: PSOR) -> PSORSettings:
    friction_omega = solver.omega if solver.friction_omega is None else solver.friction_omega
    return PSORSettings(tolerance_argument(solver), float(solver.omega), float(friction_omega))


register(PSOR, _settings, (Loop(PSORSettings, relax_psor),), rolls=True)
