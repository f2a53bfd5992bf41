"""The steps of a run: calls of the engine between which Python may start, watch, record and interrupt them."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Event

import numpy as np

from deep_contact.physics import engine
from deep_contact.physics.convergence import convergence_record
from deep_contact.physics.engine import Steps, step_input
from deep_contact.physics.load import load_of
from deep_contact.physics.step import DONE, LAST_SWEEPS, StepLog, make_log, of_whole_step, some_steps
from deep_contact.state import Bodies, Contacts, StateWithContacts, read_only
from deep_contact.warm_start import Builtin, NoStart, starting_impulses

MOST_WORK, SECONDS = 20_000_000, 0.2
"""Most work of a call of compiled code, in relaxations of a contact, and its time: between calls Ctrl-C is raised."""


def run(
    state: StateWithContacts, start, steps: int, sleep: bool = False, record: int | None = None,
    on_step: Callable | None = None, until: Callable | None = None, forces: bool = False, stopped: Event | None = None,
) -> tuple[StateWithContacts, StepLog, list[StateWithContacts], list[np.ndarray], list[StateWithContacts]]:  # fmt: skip
    """So many steps of a state with its solver: the state after them, their log, the recorded states, loads and steps.

    Arguments as of `simulation.simulate`, checked. Loads are `StepLog.loads` up to each recorded state; the steps are
    what `on_step` sees of those that led to one, with `forces`. stopped: ends the run with a KeyboardInterrupt once it
    is set.
    """
    calls = _Calls(state, start, sleep)
    # Builtin and NoStart need nothing from Python between two steps.
    one_by_one = on_step is not None or until is not None or not isinstance(start, (Builtin, NoStart))
    every, log, done = record or steps + 1, make_log(steps, 4 + len(state.world.segments) if forces else 0), 0
    frames, state = [] if record is None else [state], None  # a million circles have 200 MB of contacts
    loads, solved, is_over = [log.loads.copy()], [], False
    while done < steps and not is_over:
        if stopped is not None and stopped.is_set():
            raise KeyboardInterrupt
        left = min(steps - done, every - done % every)
        most = 1 if one_by_one else calls.affordable()
        if forces and left > 1:
            most = min(most, left - 1)  # so that the step that leads to a recorded state is a call of its own
        is_watched = on_step is not None or (forces and (left == 1 or until is not None))
        done += calls.advance(log, done, min(left, most), is_watched)
        if on_step is not None:
            on_step(*calls.seen)
        if until is not None:
            is_over, calls.is_own = bool(until(read_only(calls.known()))), False
        if record is not None and (done % every == 0 or done == steps or is_over):
            frames.append(calls.known())
            loads.append(log.loads.copy())
            solved += calls.seen[:1]
            calls.is_own = False
    return calls.known(), StepLog(*(column[:done] for column in log[:5]), *log[5:]), frames, loads, solved


class _Calls:
    """Calls of the engine that go on from `state`."""

    def __init__(self, state: StateWithContacts, start, sleep: bool):
        self.state, self._start, self._solver = state.replace(load=None), start, state.solver
        self.is_own = False  # whether nobody else sees the arrays that a step writes into
        self.seen: tuple = ()  # what `on_step` sees of the last step that was watched
        self._work = MOST_WORK // 8
        self._is_one_solve = state.replace(solved=True).holds_solution
        self._scales = engine.scales_of(state, state.solver)  # of radii that do not change in a run
        self._steps = Steps(state.solver, state.bodies.count, sleep=sleep, carry=not isinstance(start, NoStart))
        # Before the arrays of the result, so that its release leaves no gap on top of the heap, which is inputs back.
        self._steps.memory(step_input(state, state.solver, self._scales), state.contacts.count)

    def known(self) -> StateWithContacts:
        """The state for others, which says what its impulses were solved for."""
        return self.state.replace(load=load_of(self.state))

    def affordable(self) -> int:
        """So many steps may be done by a call."""
        return 1 + self._work // (10 * self.state.bodies.count + 50)

    def advance(self, log: StepLog, first: int, count: int, is_watched: bool) -> int:
        """Do up to so many steps, the rows of the log from `first` on. Returns how many have been done."""
        before = self.state if is_watched else None
        problem = self._prepare()
        inputs = step_input(self.state, self._solver, self._scales)
        rows = some_steps(log, first, count, self._work, is_watched and not self._is_one_solve)
        contacts, begun = self.state.contacts, time.perf_counter()
        contacts_after, received = self._steps(inputs, contacts, rows, problem)
        # How a run is divided changes no bit of it.
        self._work = min(MOST_WORK, 2 * self._work, 1 + int(self._work * SECONDS / (time.perf_counter() - begun)))
        state, count = self.state, int(rows.progress[DONE]) // inputs.parts
        step = state.step + count
        if not np.isfinite(state.bodies.position.sum()):
            _raise_diverged(state.bodies, step)
        # From the number of steps, not by adding up, so that time does not depend on how a run was divided.
        now = step * state.dt if state.time == state.step * state.dt else state.time + count * state.dt
        self.state = state.replace(contacts=contacts_after, time=now, step=step, solved=False)
        self.is_own = not is_watched
        if before is not None:
            theta = self._steps.memory(inputs).theta[: rows.progress[LAST_SWEEPS]]
            convergence = convergence_record(theta, self._solver, int(rows.contacts[0]))
            solved = contacts if self._is_one_solve else of_whole_step(contacts, received)
            self.seen = read_only(before.replace(contacts=solved, solved=True)), convergence
        return count

    def _prepare(self):
        """Let the state start from the impulses of the start, in arrays that a step may write into.

        Returns its contact problem, if the start has built it (`starting_impulses`).
        """
        state, problem = self.state, None
        if not isinstance(self._start, Builtin):
            *impulses, problem = starting_impulses(self._start, state, self._solver, self._scales)
            names = "normal_start", "tangent_start"
            state = state.replace(contacts=state.contacts._replace(**dict(zip(names, impulses))))
        if not self.is_own:
            solved = {name: getattr(state.contacts, name).copy() for name in Contacts._fields[5:7]}
            contacts = state.contacts._replace(**solved)
            state = state.replace(bodies=Bodies(*map(np.copy, state.bodies)), contacts=contacts)
        self.state = state
        return problem


def _raise_diverged(bodies: Bodies, step: int) -> None:
    circle = int(np.flatnonzero(~np.isfinite(bodies.position).all(axis=1))[0])
    raise FloatingPointError(
        f"up to step {step}: circle {circle} (mass {bodies.mass[circle]:g} kg, radius {bodies.radius[circle]:g} m) has "
        "come to a position that is not finite: the solver diverged; try PGS, a smaller dt"
    )
