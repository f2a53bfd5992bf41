"""`LiveForces`: sums of contact impulses on the walls, segments and circles of a `Simulator`.

Tests: tests/run/test_live_forces.py
"""

from __future__ import annotations

import numpy as np


class LiveForces:
    """Sums of contact impulses on each body, and the time of each sum, since the force on the body was last read.

    Each body has an interval of its own, so that the force on one wall can be read more often than the force on another
    wall.

    | field      | meaning                                                                  | shape      | unit |
    |------------|--------------------------------------------------------------------------|------------|------|
    | loads      | sums of the impulses on walls and segments (`StepLog.loads`)             | (4 + S, 2) | N·s  |
    | on_circles | sums of the impulses on circles (`StepLog.on_circles`)                   | (n, 2)     | N·s  |
    | block      | all sums and times of both, in one array, to copy and to restore          | (k,)       |      |

    Compiled code adds to `loads` and `on_circles` in place.
    """

    def __init__(self, circles: int, segments: int):
        a, b = 4 + segments, circles
        self.block = np.zeros(3 * (a + b))
        sums, seconds = self.block[: 2 * (a + b)].reshape(-1, 2), self.block[2 * (a + b) :]
        self.loads, self.on_circles, self._seconds = sums[:a], sums[a:], seconds
        self._last_read = np.zeros((a + b, 2))

    def __reduce__(self):
        return _restored, (len(self.on_circles), len(self.loads) - 4, self.block, self._last_read)

    def add_time(self, seconds: float) -> None:
        """Add the time in which the latest impulses were given, s."""
        self._seconds += seconds

    def read(self, are_circles: bool, chosen: np.ndarray) -> np.ndarray:
        """Return the sum of the mean forces on some bodies since each was last read, (2,), N. New intervals begin.

        If no time has passed since a body was last read, its force is that of the last reading, and 0 before the first.
        are_circles, chosen: result of `fields.checked_part`.
        """
        first = len(self.loads) if are_circles else 0
        sums, chosen = self._sums, chosen + first
        later = chosen[self._seconds[chosen] > 0.0]
        self._last_read[later] = sums[later] / self._seconds[later, None]
        sums[later] = 0.0
        self._seconds[later] = 0.0
        return self._last_read[chosen].sum(axis=0)

    def of_scene(self, circles: int, segments: int, stays: np.ndarray | None = None) -> LiveForces:
        """Return the sums for a changed scene. A new circle or segment begins with a sum of 0.

        circles, segments: numbers of circles and of segments in the changed scene. stays: old indices of the circles
        that are left, which become the first circles; None if all are left. The sum of a segment stays at its index.
        """
        new, walls = LiveForces(circles, segments), np.arange(min(len(self.loads), 4 + segments))
        stays = np.arange(len(self.on_circles)) if stays is None else stays
        old = np.concatenate([walls, len(self.loads) + stays])
        at = np.concatenate([walls, 4 + segments + np.arange(len(stays))])
        for mine, theirs in zip(self._arrays, new._arrays):
            theirs[at] = mine[old]
        return new

    @property
    def _sums(self) -> np.ndarray:
        """Sums of the impulses on walls, segments and circles, (4 + S + n, 2), N·s."""
        return self.block[: 2 * len(self._seconds)].reshape(-1, 2)

    @property
    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self._sums, self._seconds, self._last_read


def _restored(circles: int, segments: int, block: np.ndarray, last_read: np.ndarray) -> LiveForces:
    """Return `LiveForces` from a pickle. Its arrays share one block of memory, which a plain pickle would divide."""
    forces = LiveForces(circles, segments)
    forces.block[:], forces._last_read[:] = block, last_read
    return forces
