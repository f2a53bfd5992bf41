"""The last run of `simulate`, stored so that a call that continues from its final state can reuse it."""

from __future__ import annotations

import threading
import weakref
from typing import TYPE_CHECKING

import numpy as np

from deep_contact.starts.classical import Builtin
from deep_contact.state.state import State, StateWithContacts

if TYPE_CHECKING:
    from deep_contact.run.simulator import Simulator

KEPT = 20_000
"""Largest number of circles of a run that is stored for the next call of `simulate`."""


class _LastRun(threading.local):
    """The last run of `simulate` in this thread. A call that continues from the final state of this run reuses it.

    In a loop of calls, validation, the choice of a preset and the allocation of memory are then done only once. The run
    is deleted together with its final state.
    """

    kept: tuple | None = None

    def keep(self, run: Simulator, how: tuple) -> StateWithContacts:
        """Return the final state of a run, and store the run for a call that continues from this state.

        how: `RunOptions.how` of the run. A run is not stored if it has a push, another start than Builtin, a
        measurement in place of a preset, or more than `KEPT` circles.
        """
        plain = isinstance(run._start, Builtin) and run._options.push is None and isinstance(how[1], (str, type(None)))
        if not plain or run._scene.bodies.count > KEPT:
            return run._state(np.asarray)
        state = run._state(np.ndarray.copy)
        self.kept = weakref.ref(state, self._drop), how, run
        return state

    def _drop(self, reference: weakref.ref) -> None:
        if self.kept and self.kept[0] is reference:
            self.kept = None

    def take(self, state: State, how: tuple) -> Simulator | None:
        """Return the stored run if it has led to this state with the same options `how`. Otherwise return None.

        The result is also None if the arrays of the state have been written to since.
        """
        kept, self.kept = self.kept, None
        if kept is None or kept[0]() is not state or kept[1] != how:
            return None
        run = kept[2]
        mine, theirs = (*run._scene.bodies, *run._now.contacts), (*state.bodies, *state.contacts)
        if not all(map(_same_bits, mine, theirs)):
            return None
        run._steps.wake()
        run._origin = run._now
        return run


_last_run = _LastRun()


def _same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two arrays of one shape are equal. For small arrays, comparing bytes takes a tenth of the time."""
    return one.tobytes() == other.tobytes() if one.size < 4096 else np.array_equal(one, other)
