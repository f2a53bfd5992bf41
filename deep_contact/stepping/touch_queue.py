"""The next touches of each circle in a step, in the order of time.

A tournament tree has the least time of all circles at its root. A circle that is searched anew replaces its touches, so
that none of them is out of date by its own path.

Tests: tests/stepping/test_touch_queue.py
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit

MOST_TOGETHER = 8
"""Largest number of simultaneous touches that a circle queues. A later search finds the others at the same time."""


class TouchQueue(NamedTuple):
    """The next touches of n circles, at most `MOST_TOGETHER` of each, the latest first. Times are in steps."""

    least: np.ndarray  # (2 m,), m >= n: least time in each node of the tree; that of circle i is element m + i
    count: np.ndarray  # (n,): number of touches
    partner: np.ndarray  # (n, 8): the other body of each touch
    touches: np.ndarray  # (n, 8): `Paths.touches` of this body when the touch was found
    time: np.ndarray  # (n, 8): time of each touch


@njit(cache=True)
def make_queue(n):
    """A `TouchQueue` of n circles without touches."""
    m = 1
    while m < n:
        m *= 2
    body, time = np.empty((2, n, MOST_TOGETHER), np.int64), np.empty((n, MOST_TOGETHER))
    return TouchQueue(np.full(2 * m, np.inf), np.zeros(n, np.int64), body[0], body[1], time)


@njit(inline="always")
def next_time(queue):
    """Time of the first touch of all, or infinity."""
    return queue.least[1]


@njit(cache=True, _nrt=False)
def next_circle(queue):
    """The circle with the first touch of all; of several the one with the least index."""
    least, j = queue.least, 1
    while 2 * j < least.shape[0]:
        j = 2 * j if least[2 * j] <= least[2 * j + 1] else 2 * j + 1
    return j - least.shape[0] // 2


@njit(inline="always")
def clear_touches(queue, i):
    """Remove the touches of circle i, in place; `queue_circle` has to follow."""
    queue.count[i] = 0


@njit(cache=True, _nrt=False)
def add_touch(queue, i, partner, touches, time):
    """Add a touch of circle i, in place; `queue_circle` has to follow. Of too many touches the latest is left out."""
    j = queue.count[i]
    if j == MOST_TOGETHER:
        if (time, partner) >= (queue.time[i, 0], queue.partner[i, 0]):
            return
        for k in range(1, MOST_TOGETHER):
            copy_touch(queue, i, k, k - 1)
        j -= 1
    else:
        queue.count[i] += 1
    while j > 0 and (queue.time[i, j - 1], queue.partner[i, j - 1]) < (time, partner):
        copy_touch(queue, i, j - 1, j)
        j -= 1
    queue.partner[i, j], queue.touches[i, j], queue.time[i, j] = partner, touches, time


@njit(inline="always")
def copy_touch(queue, i, j, k):
    """Write the j-th touch of circle i over its k-th one, in place."""
    queue.partner[i, k], queue.touches[i, k] = queue.partner[i, j], queue.touches[i, j]
    queue.time[i, k] = queue.time[i, j]


@njit(cache=True, _nrt=False)
def queue_circle(queue, i):
    """Put the time of the first touch of circle i into the tree, in place."""
    least, count = queue.least, queue.count[i]
    j = least.shape[0] // 2 + i
    least[j] = queue.time[i, count - 1] if count > 0 else np.inf
    while j > 1:
        j //= 2
        time = min(least[2 * j], least[2 * j + 1])
        if time == least[j]:
            return
        least[j] = time


@njit(cache=True, _nrt=False)
def pop_touch(queue, i):
    """(partner, touches) of the first touch of circle i, which is removed in place."""
    queue.count[i] -= 1
    queue_circle(queue, i)
    j = queue.count[i]
    return queue.partner[i, j], queue.touches[i, j]
