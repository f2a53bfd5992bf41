"""Order the next touches of all circles in a step by time.

A touch is the moment at which a moving circle first meets another body: a circle, a wall or a segment. Times are
counted from the beginning of the step, in units of the step. A tournament tree finds the first touch of all: its leaves
are the times of the first touches of the circles, every other node is the smaller time of its two children, and the
root is the least time.

When the path of a circle changes, its touches are searched anew, and replace the old ones. A touch in the queue can
therefore be out of date only because the path of its partner has changed.

Tests: tests/stepping/test_touch_queue.py
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit

MOST_TOGETHER = 8
"""Largest number of touches that the queue stores for a circle. A later search finds the others, at the same time."""


class TouchQueue(NamedTuple):
    """The next touches of n circles. A touch is the moment at which a circle first meets another body, its partner.

    The row of a circle contains at most `MOST_TOGETHER` touches, the earliest last, so that it is removed first. Times
    are counted from the beginning of the step, in units of the step. A touch can be out of date only because the path
    of its partner has changed since the search.
    """

    least: np.ndarray  # (2 m,), m >= n: least time below each node of the tree; the leaf of circle i is m + i
    count: np.ndarray  # (n,): number of touches of each circle
    partner: np.ndarray  # (n, 8): index of the other body of each touch
    touches: np.ndarray  # (n, 8): `Paths.touches` of the partner when the touch was found; 0 for walls and segments
    time: np.ndarray  # (n, 8): time of each touch, in units of the step


@njit(cache=True)
def make_queue(n):
    """Return a `TouchQueue` of n circles without touches."""
    m = 1
    while m < n:
        m *= 2
    body, time = np.empty((2, n, MOST_TOGETHER), np.int64), np.empty((n, MOST_TOGETHER))
    return TouchQueue(np.full(2 * m, np.inf), np.zeros(n, np.int64), body[0], body[1], time)


@njit(inline="always")
def next_time(queue):
    """Return the time of the first touch of all circles, or infinity if there is none."""
    return queue.least[1]


@njit(cache=True, _nrt=False)
def next_circle(queue):
    """Return the index of the circle that has the first touch of all. Of several such circles it is the least index."""
    least, j = queue.least, 1
    while 2 * j < least.shape[0]:
        j = 2 * j if least[2 * j] <= least[2 * j + 1] else 2 * j + 1
    return j - least.shape[0] // 2


@njit(inline="always")
def clear_touches(queue, i):
    """Remove the touches of circle i, in place. `queue_circle` has to be called afterwards."""
    queue.count[i] = 0


@njit(cache=True, _nrt=False)
def add_touch(queue, i, partner, touches, time):
    """Add a touch of circle i, in place. `queue_circle` has to be called afterwards.

    If the row of the circle is full, the latest touch is left out. partner: index of the other body. touches:
    `Paths.touches` of the partner now, or 0 if it is a wall or a segment. time: time of the touch, in units of the
    step.
    """
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
    """Overwrite the k-th touch of circle i by its j-th touch, in place."""
    queue.partner[i, k], queue.touches[i, k] = queue.partner[i, j], queue.touches[i, j]
    queue.time[i, k] = queue.time[i, j]


@njit(cache=True, _nrt=False)
def queue_circle(queue, i):
    """Write the time of the first touch of circle i into the tree, in place; infinity if the circle has no touch."""
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
    """Remove the first touch of circle i, in place. Returns its (partner, touches), fields of `TouchQueue`."""
    queue.count[i] -= 1
    queue_circle(queue, i)
    j = queue.count[i]
    return queue.partner[i, j], queue.touches[i, j]
