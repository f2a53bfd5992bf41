"""Starts without images and networks, and the validation of starting impulses.

Tests: tests/starts/test_starts.py, tests/starts/test_support.py
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deep_contact.starts.names import is_network, warm_start_of
from deep_contact.starts.support import supported
from deep_contact.state.arrays import LARGEST_START
from deep_contact.state.scales import ContactScales
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.validation import brief, expect, real_numbers
from deep_contact.stepping.problem import StepProblem, step_problem
from deep_contact.stepping.rows import NORMAL, TANGENT, best_share


@dataclass(frozen=True)
class NoStart:
    """The start from impulses of 0 (the thesis's Non-Model)."""

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(state.contacts.count), np.zeros(state.contacts.count)


@dataclass(frozen=True)
class Builtin:
    """The start from the solved impulses of the step before, pair by pair (the thesis's Builtin-Model).

    A new pair of bodies starts from 0. The engine carries these impulses along, so the state already has them as its
    starting impulses.
    """

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return state.contacts.normal_start.copy(), state.contacts.tangent_start.copy()


class FromProblem:
    """Base class of starts that are computed from the contact problem of a step.

    Subclasses have a method `from_problem(state, solver, problem)`. The step then uses the same problem, which is built
    once.
    """

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        return self.from_problem(state, solver, step_problem(state))


@dataclass(frozen=True)
class Scaled(FromProblem):
    """The start from Builtin's impulses times one number α between 0 and 1, by an exact line search (`best_share`).

    In an impact the carried impulses are too large or wrong, and α is small. At rest α is 1. The search costs one pass
    over the contacts. If the steps of a run are solved well, this start saves sweeps in impacts.

    Weakness: there is one α for all contacts. With few sweeps a step, Builtin's impulses grow to their full size only
    over several steps. A factor α < 1 keeps them too small, so that piles sink.
    """

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        share = best_share(problem.rows, problem.solver_bodies)
        return share * problem.rows.impulse[:, NORMAL], share * problem.rows.impulse[:, TANGENT]


@dataclass(frozen=True)
class Support(FromProblem):
    """The start from impulses that carry each circle's load down, computed from positions alone (`starts.support`).

    It is meant for piles whose contacts have no impulses yet. If contacts carry impulses of a step before, Builtin is
    better.
    """

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        return supported(state, problem)


def starting_impulses(
    start, state: State, solver, scales: ContactScales | None = None
) -> tuple[np.ndarray, np.ndarray, StepProblem | None]:
    """Return (λ_n, λ_t, problem): validated starting impulses, (m,) each, N·s, and the contact problem or None.

    start: a start, or anything that names one (`names.Start`), or two arrays (normal, tangent), (m,) each, N·s. solver:
    options of the solver. scales: `State.scales`, if already computed.

    `problem` is the contact problem of the state if the start has a method `from_problem(state, solver, problem)`. The
    step can then use the same problem. Raises ValueError on impulses that do not fit the contacts or are beyond
    `state.arrays.LARGEST_START`.
    """
    problem = None
    if start is None or isinstance(start, str) or callable(start) or is_network(start):
        start = warm_start_of(start)
        if isinstance(start, Builtin):
            return *start(state, solver), None  # the impulses of a state are validated already
        if hasattr(start, "from_problem"):
            problem = step_problem(state, scales)
            start = start.from_problem(state, solver, problem)
        else:
            start = start(state, solver)
    try:
        normal, tangent = map(real_numbers, start)
    except (TypeError, ValueError):
        normal = tangent = None
    if normal is None or tangent is None:
        raise ValueError(f"start: expected two arrays of impulses (normal, tangent), got {brief(start)}")
    m = state.contacts.count
    for name, values in (("normal", normal), ("tangent", tangent)):
        expected = f"start: expected {name} impulses of"
        expect(values.shape == (m,), f"{expected} shape ({m},), one a contact, got {values.shape}")
        for bad in np.flatnonzero(~(np.abs(values) <= LARGEST_START))[:1]:
            raise ValueError(f"{expected} at most {LARGEST_START:g} N·s, got {values[bad]} at contact {bad}")
    return normal, tangent, problem
