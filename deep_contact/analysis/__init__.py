"""Analysis of solved states: forces and their bounds, the contact problem as matrices, exact solutions, and errors.

Tests: tests/test_imports.py
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.lazy import attach

if TYPE_CHECKING:
    from deep_contact.analysis.exact import ExactSolution as ExactSolution
    from deep_contact.analysis.lcp import ContactProblem as ContactProblem
    from deep_contact.analysis.lcp import approach as approach
    from deep_contact.analysis.lcp import contact_problem as contact_problem
    from deep_contact.analysis.lcp import dissipation_gap as dissipation_gap
    from deep_contact.analysis.lcp import natural_residual as natural_residual
    from deep_contact.analysis.lcp import signorini_gap as signorini_gap
    from deep_contact.analysis.matrix_solvers import solve_problem as solve_problem
    from deep_contact.stepping.metrics import free_velocity as free_velocity
    from deep_contact.stepping.metrics import kinetic_energy as kinetic_energy
    from deep_contact.stepping.metrics import residual as residual
    from deep_contact.stepping.metrics import velocity_error as velocity_error

__getattr__, __dir__, __all__ = attach(__name__, __file__)
