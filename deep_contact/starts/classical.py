"""Starts that need no image and no network; and the impulses that a solve starts from, checked."""

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
    """Impulses of 0 (the thesis's Non-Model)."""

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(state.contacts.count), np.zeros(state.contacts.count)


@dataclass(frozen=True)
class Builtin:
    """The solved impulses of each pair of bodies in the step before, 0 for a new pair (the thesis's Builtin-Model).

    The engine carries these impulses along, so they are the start that the state holds.
    """

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return state.contacts.normal_start.copy(), state.contacts.tangent_start.copy()


class FromProblem:
    """A start made from the rows of a step, which then uses the same rows: `from_problem(state, solver, problem)`."""

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        return self.from_problem(state, solver, step_problem(state))


@dataclass(frozen=True)
class Scaled(FromProblem):
    """Builtin's impulses times one number α between 0 and 1: the exact line search along them (`best_share`).

    In an impact the carried impulses are too large or wrong, and α is small; at rest α is 1. It costs one pass over the
    contacts. From states of well solved runs it saves sweeps in impacts. Weakness: there is one α for all contacts.
    Builtin adds up half-solved impulses over the steps of a run, and α shrinks these, so that piles sink.
    """

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        share = best_share(problem.rows, problem.solver_bodies)
        return share * problem.rows.impulse[:, NORMAL], share * problem.rows.impulse[:, TANGENT]


@dataclass(frozen=True)
class Support(FromProblem):
    """Impulses that carry each circle's load down, from positions alone (`starts.support`): for piles without a past.

    If contacts carry impulses of a step before, Builtin is better.
    """

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        return supported(state, problem)


def starting_impulses(
    start, state: State, solver, scales: ContactScales | None = None
) -> tuple[np.ndarray, np.ndarray, StepProblem | None]:
    """(λ_n, λ_t, problem) of a start, or of two arrays in its place. The impulses are validated copies, (m,) each, N·s.

    problem is the state's contact problem if a start with a method `from_problem(state, solver, problem)` needed it, so
    that the step can use it; otherwise None. scales: those of the state, if at hand.
    Raises ValueError on impulses that do not fit the contacts or are beyond `state.arrays.LARGEST_START`.
    """
    problem = None
    if start is None or isinstance(start, str) or callable(start) or is_network(start):
        start = warm_start_of(start)
        if isinstance(start, Builtin):
            return *start(state, solver), None  # the state's own, which have been checked
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
