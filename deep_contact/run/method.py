"""The options of a run, and the solver and the start that follow from them for a state.

Tests: tests/accuracy/test_presets.py, tests/run/test_many_scenes.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from deep_contact.accuracy.presets import Accuracy, Decision, MeasuredAccuracy, decide
from deep_contact.solvers import PGS
from deep_contact.starts.load import is_near
from deep_contact.starts.names import Start, WarmStart, warm_start_of
from deep_contact.state.state import State
from deep_contact.state.validation import flag
from deep_contact.stepping.interface import entry_of


class RunOptions(NamedTuple):
    """The options of a run. `simulate` describes them; `Simulator` and `simulate_many` have some of them."""

    steps: int = 600
    dt: float | None = None
    solver: object = None
    warm_start: Start = "builtin"
    accuracy: Accuracy | MeasuredAccuracy | None = None
    sleep: bool = False
    push: object = None
    record: int | None = None
    forces: bool = False
    until: Callable | None = None
    on_step: Callable | None = None
    is_anew: bool = False  # whether a `Simulator` without a solver argument chooses again when its scene changes

    @property
    def how(self) -> tuple:
        """The options that two calls must share so that the second can continue the run of the first (`last_run`)."""
        return self.solver, self.accuracy, self.warm_start, self.sleep


class Method(NamedTuple):
    """Solver and start of a run. `simulate` uses them, and `plan` prints them."""

    solver: object  # with numbers in place of values that follow the scene
    start: WarmStart
    start_name: str
    decision: Decision | None  # the choice of the preset; None if the caller or the state chose the solver


def method_of(state: State, solver=None, start="builtin", accuracy=None, *, sleep=False) -> Method:
    """Return the `Method` of a run from this state.

    The preset `accuracy` chooses solver and start. Without a preset the solver is `solver`, or else the state's solver,
    or else that of the preset "fast", and the start is `start`. sleep: whether circles may sleep. Raises ValueError if
    the arguments do not fit each other.
    """
    if accuracy is not None and solver is not None:
        raise ValueError(f"accuracy: expected no solver beside it, got {solver!r}")
    decision = None
    if accuracy is not None or (solver is None and state.solver is None):
        decision = decide(state, accuracy, sleep=sleep)
        keeps = _keeps_solver(state, accuracy) and (entry_of(state.solver).can_sleep or not sleep)
        solver, start = state.solver if keeps else decision.solver, start if accuracy is None else decision.start
    solver = checked_solver(solver, state)
    if flag("sleep", sleep) and not entry_of(solver).can_sleep:
        raise ValueError(f"sleep: expected False with {type(solver).__name__}, got True")
    named = str(start) if isinstance(start, (str, Path)) else getattr(start, "__name__", type(start).__name__)
    return Method(solver, warm_start_of(start), "none" if start is None else named, decision)


def _keeps_solver(state: State, accuracy) -> bool:
    """Return whether the state comes from a run under this preset, with nearly the same load.

    The solver of such a state stays. Without this rule the preset could choose another solver later in the run, when
    the fastest circle is slower, or when a dam has broken.
    """
    came = state.step > 0 and state.solver is not None and isinstance(accuracy, str) and accuracy == state.preset
    return came and (state.load is None or is_near(state))


def checked_solver(solver, state: State):
    """Return `solver`, or the state's solver, or PGS, with numbers in place of values that follow the scene.

    Raises ValueError on an unknown solver.
    """
    if solver is None:
        solver = PGS() if state.solver is None else state.solver
    entry_of(solver)
    return solver.for_state(state)
