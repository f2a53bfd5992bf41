"""`SolvedMemory`: copies of the arrays of watched steps, in memory that is used again."""

from __future__ import annotations

import sys

import numpy as np

from deep_contact.compiled.direct import Direct
from deep_contact.state.arrays import Contacts
from deep_contact.stepping.log import write_rows, write_step

MOST_BLOCKS = 3
"""Largest number of blocks that stay for later steps: those of the last two steps, and one for the next step."""


class SolvedMemory:
    """Blocks of memory for the arrays of watched steps. A block is used again once nothing refers to its arrays.

    Without these blocks, the operating system would take back the memory of large arrays after each step, and hand it
    out again page by page. For 3,000 circles this takes longer than copying the arrays.

    Every array that NumPy makes of a block, also by slices of slices, refers to the block itself. So the number of
    references to the block tells whether anything still uses an array in it.
    """

    def __init__(self):
        self._blocks: list[np.ndarray] = []
        self._rows = np.empty((0, 8))
        self._write, self._write_rows = Direct(write_step), Direct(write_rows)

    def rows(self, contacts: Contacts) -> np.ndarray:
        """Return `StepLog.pair_impulses` for a step that starts with these contacts. The next call returns this memory.

        A step adds rows, in memory of its own, only for contacts that begin during the step.
        """
        m = contacts.count
        if len(self._rows) < m:
            self._rows = np.empty((m + m // 8 + 16, 8))
        self._write_rows(contacts, self._rows)
        return self._rows[:m]

    def copy(
        self, moved: tuple[np.ndarray, ...], contacts: Contacts, pair_impulses: np.ndarray
    ) -> tuple[tuple[np.ndarray, ...], Contacts]:
        """Return read-only copies of (positions, velocities, angles, spins) and of the contacts of a whole step.

        moved: these four arrays of n circles. contacts: m contacts at the start of the step. pair_impulses:
        `StepLog.pair_impulses`; if it has no rows, the impulses are those of `contacts`.
        """
        n, k = len(moved[2]), len(pair_impulses) or contacts.count
        block = self._block(6 * n + 11 * k)
        numbers, pairs = block[: 6 * n + 9 * k], block[6 * n + 9 * k : 6 * n + 11 * k].view(np.int64)
        self._write(moved, contacts, pair_impulses, pairs, numbers)
        numbers.flags.writeable = pairs.flags.writeable = False
        place, normal = numbers[6 * n : 6 * n + 4 * k].reshape(2, k, 2)
        return moving_arrays(numbers[: 6 * n]), Contacts(
            *pairs.reshape(2, k), place, normal, *numbers[6 * n + 4 * k :].reshape(5, k)
        )

    def _block(self, size: int) -> np.ndarray:
        """Return an array of at least `size` numbers to which nothing else refers."""
        blocks = self._blocks
        for i in range(len(blocks)):
            if _references(blocks, i) == UNUSED and len(blocks[i]) >= size:
                return blocks[i]
        block = np.empty(size + size // 16)
        self._blocks = [*blocks[1 - MOST_BLOCKS :], block]
        return block


def moving_arrays(block: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return positions and velocities, (n, 2) each, angles and spins, (n,) each, as views of one array, (6 n,).

    To copy the one array takes a fraction of the time of copying the four.
    """
    n = len(block) // 6
    return *block[: 4 * n].reshape(2, n, 2), *block[4 * n :].reshape(2, n)


def _references(blocks: list[np.ndarray], i: int) -> int:
    return sys.getrefcount(blocks[i])


UNUSED = _references([np.empty(1)], 0)
"""Number of references to a block to which only the list of blocks refers."""
