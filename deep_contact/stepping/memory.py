"""`Steps`: the compiled code and the memory that steps of a run pass from one call to the next.

Tests: tests/run/test_simulator.py
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deep_contact.compiled.direct import Direct
from deep_contact.state.arrays import Contacts
from deep_contact.stepping import sleeping
from deep_contact.stepping.algorithm import advance
from deep_contact.stepping.contacts import make_contacts
from deep_contact.stepping.context import (
    StepContext,
    StepInput,
    StepMemory,
    StepOptions,
    contacts_of_context,
    make_context,
    make_memory,
    with_optional,
)
from deep_contact.stepping.interface import entry_of, make_workspace
from deep_contact.stepping.log import DONE, WORK, StepLog, is_asked, log_impulses, work_on
from deep_contact.stepping.pairs import Rough
from deep_contact.stepping.problem import StepProblem, started


class Steps:
    """Steps of one solver. Each call does some steps, and leaves its memory in the object for the next call.

    solver: options with numbers in place of values that follow the scene (`SolverOptions.for_state`). n: number of
    circles. sleep: whether islands may sleep; all start awake. The solver has to support sleep
    (`interface.Entry.can_sleep`). carry: see `StepOptions`.
    """

    def __init__(self, solver, n: int, *, sleep: bool = False, carry: bool = True):
        entry = entry_of(solver)
        self._advance = entry.advance(solver) if entry.advance else advance
        self._is_plain = not (sleep or entry.advance)  # whether optional features are left out; once False, it stays so
        self._options = StepOptions(entry.settings(solver), solver.position_sweeps, carry)
        self._solver, self._memory, self._direct = solver, {}, {}
        self._plain_input = self._full_input = None  # the last input of steps, and its `with_optional`
        # Buffer -> the last input of steps, and its context. (Buffer, `_is_plain`) -> the argument `step` of the last
        # call that began in this buffer, the input that was made of it, the context and the compiled function.
        self._contexts: dict = {}
        self._buffers, self._views = {}, {}  # key -> three buffers; (buffer, key) -> the last contacts found in it
        self._found: tuple = (None, -1, False)  # body_a of the last contacts, their buffer, and the key of its memory
        self.sleep = sleeping.make_sleep_memory(n, 4 * n + 64) if sleep else None

    def wake(self) -> None:
        """Wake all islands."""
        if self.sleep is not None:
            self.sleep.still[:] = 0.0

    def takes(self, solver) -> bool:
        """Take other options of the solver for the following steps, if nothing but the tolerance differs.

        Returns whether the options are taken.
        """
        if solver == self._solver:
            return True
        if replace(solver, tolerance=self._solver.tolerance) != self._solver:
            return False
        self._solver, self._contexts = solver, {}
        self._options = self._options._replace(settings=entry_of(solver).settings(solver))
        return True

    def memory(self, step: StepInput, contacts: Contacts | None = None) -> StepMemory:
        """Return the memory of steps with this input. It differs for rows with and without tangents.

        contacts: `Contacts` from which the steps start; None stands for no contacts.
        """
        return self.memories(step, contacts)[-1]

    def memories(self, step: StepInput, contacts: Contacts | None) -> list[StepMemory]:
        """Return four memories, one for each place of the contacts before the steps. The first call allocates them.

        Memory i < 3 does not overwrite contacts in buffer i. The last memory is for contacts in no buffer. The memories
        share everything but the two buffers that each of them fills (`_BUFFERS`).
        """
        key = step.friction is None
        if key not in self._memory:
            n, m, friction = step.bodies.count, 0 if contacts is None else contacts.count, step.friction
            capacity = max(4 * n, m + m // 2) + 64
            memory = make_memory(n, capacity, self._solver.sweeps, friction)
            workspace = make_workspace(self._options.settings, memory.rows, memory.solver_bodies)
            memory = memory._replace(workspace=workspace)
            buffers = self._buffers[key] = *memory.contacts, make_contacts(capacity)
            self._memory[key] = [memory._replace(contacts=(buffers[i], buffers[j])) for i, j in _BUFFERS]
        return self._memory[key]

    def _buffer_of(self, contacts: Contacts, key: bool) -> int:
        """Return the index of the buffer in which the contacts lie, in the memories of this key; -1 if in none."""
        found, buffer, kept = self._found
        return buffer if contacts.body_a is found and key == kept else -1

    def _keep(
        self, context: StepContext, contacts: Contacts, m: int, substeps: int, buffer: int, key: bool
    ) -> Contacts:
        """Return the contacts after substeps, which fill two buffers in turn, and record their buffer.

        context: the context of the steps. contacts: those before the substeps, in this buffer. m: number of contacts
        after the substeps, or −1 (`context.results_of`).
        """
        if self.sleep is not None:  # substeps in which all circles sleep fill no buffer
            following, buffer = Contacts(*map(np.copy, contacts_of_context(context))), -1
        elif substeps == 0:
            following = contacts
        elif m < 0:
            following, buffer = contacts_of_context(context), _BUFFERS[buffer][substeps % 2]
        else:
            buffer = _BUFFERS[buffer][substeps % 2]
            following = self._views.get((buffer, key))
            if following is None or len(following.body_a) != m:
                following = Contacts(*[array[:m] for array in self._buffers[key][buffer]])
                self._views[buffer, key] = following
        self._found = following.body_a, buffer, key
        return following

    def __call__(
        self, step: StepInput, contacts: Contacts, log: StepLog, problem: StepProblem | None = None
    ) -> tuple[Contacts, np.ndarray]:
        """Do as many steps as the log has rows, and fill the log. Bodies move in place.

        problem: contact problem of the only step, if it is built already; the step overwrites it. It is ignored, and
        rows are built anew, if circles may sleep, if the step is divided, or if the scene has rolling resistance.
        Returns the contacts at the end, in memory that the next call does not overwrite, and `StepLog.pair_impulses`.
        """
        key, before, built = step.friction is None, 0, None
        buffer = self._buffer_of(contacts, key)
        if (
            problem is not None
            and self.sleep is None
            and step.substeps == self._solver.motion_parts == 1
            and not isinstance(step.friction, Rough)
        ):
            rows, solver_bodies, _, impacts = started(problem, contacts, step.friction)
            built = {"rows": rows, "solver_bodies": solver_bodies, "is_built": True}
            if step.actuation is not None:
                log.work[0] += work_on(step, contacts, impacts)
            if is_asked(log):
                pair_impulses = log_impulses(log, log.pair_impulses, contacts, impacts, step.bodies.count)
                log = log._replace(pair_impulses=pair_impulses)
        while True:
            # Most calls repeat the last call that began in this buffer, and use its context again.
            asked, found = step, self._contexts.get((buffer, self._is_plain))
            if built is None and found is not None and found[0] is step:
                _, step, context, advance_steps = found
            else:
                self._is_plain = self._is_plain and step.motion is None
                step = step if self._is_plain else self._with_optional(step)
                kind = self._is_plain, key, step.actuation is None  # determines the types of all arguments
                if kind not in self._direct:
                    self._direct[kind] = Direct(make_context), Direct(self._advance)
                make, advance_steps = self._direct[kind]
                context = self._context_of(step, buffer, contacts, log, built, make)
                if built is None:
                    self._contexts[buffer, self._is_plain] = asked, step, context, advance_steps
            m, pair_impulses = advance_steps(context, contacts, step.motion, self.sleep, log, step.actuation)
            substeps = log.substeps.item() if len(log.substeps) == 1 else int(log.substeps.sum())
            following, before = self._keep(context, contacts, m, substeps - before, buffer, key), substeps
            if not self._is_plain:
                return following, pair_impulses
            if log.progress[WORK] <= 0 or log.progress[DONE] == step.substeps * len(log.contacts):
                return following, pair_impulses
            # A circle is fast, so the next call has the code for it. The rows that were built are overwritten by now.
            self._is_plain, contacts, log, built = False, following, log._replace(pair_impulses=pair_impulses), None
            buffer = self._buffer_of(following, key)

    def _context_of(
        self, step: StepInput, buffer: int, contacts: Contacts, log: StepLog, built, make: Direct
    ) -> StepContext:
        """Return the context of steps from contacts in this buffer. It stays the same until the input changes.

        built: fields of the memory that are filled already for a single step, or None. make: `make_context`.
        """
        before, context = self._contexts.get(buffer, (None, None))
        if built is not None or before is not step:
            memory = self.memories(step, contacts)[buffer]
            memory = memory._replace(**built) if built else memory
            context = make(step, self._options, memory, contacts, log)
            if built is None:
                self._contexts[buffer] = step, context
        return context

    def _with_optional(self, step: StepInput) -> StepInput:
        if step is not self._plain_input:
            self._plain_input, self._full_input = step, with_optional(step)
        return self._full_input


_BUFFERS = (1, 2), (0, 2), (0, 1), (0, 1)
"""The two of three buffers that steps fill, if their contacts lie in buffer 0, in buffer 1, in buffer 2, in none."""
