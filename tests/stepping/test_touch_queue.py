"""The queue of touches against a sorted list of (time, circle, partner)."""

import heapq

import numpy as np
import pytest

from deep_contact.stepping.touch_queue import (
    MOST_TOGETHER,
    add_touch,
    clear_touches,
    make_queue,
    next_circle,
    next_time,
    pop_touch,
    queue_circle,
)


def replace(queue, i, touches):
    """Replace the touches of circle i by (time, partner, touches of the partner)."""
    clear_touches(queue, i)
    for time, partner, count in touches:
        add_touch(queue, i, partner, count, time)
    queue_circle(queue, i)


@pytest.mark.parametrize("n", [1, 2, 3, 16, 37])
def test_touches_leave_in_the_order_of_time_circle_and_partner(n):
    rng, queue, known = np.random.default_rng(n), make_queue(n), []
    for i in range(n):
        own = [(float(rng.integers(5)), int(rng.integers(40)), int(rng.integers(9))) for _ in range(rng.integers(6))]
        replace(queue, i, own)
        known += [(time, i, partner, count) for time, partner, count in own]
    heapq.heapify(known)
    while known:
        time, i, partner, count = heapq.heappop(known)
        assert (next_time(queue), next_circle(queue)) == (time, i)
        found = pop_touch(queue, i)
        assert found[0] == partner
        assert found[1] == count or (time, i, partner) in {k[:3] for k in known}  # equal touches in any order
    assert next_time(queue) == np.inf


def test_a_circle_that_is_searched_again_replaces_its_touches():
    queue = make_queue(3)
    replace(queue, 0, [(0.2, 7, 0), (0.2, 5, 0)])
    replace(queue, 1, [(0.3, 8, 0)])
    replace(queue, 0, [(0.4, 9, 1)])
    assert (next_time(queue), next_circle(queue)) == (0.3, 1)
    replace(queue, 1, [])
    assert (next_time(queue), next_circle(queue), pop_touch(queue, 0)) == (0.4, 0, (9, 1))


def test_of_too_many_touches_the_first_ones_stay():
    queue, times = make_queue(2), np.random.default_rng(0).permutation(3 * MOST_TOGETHER)
    replace(queue, 1, [(float(time), 100 + int(time), 0) for time in times])
    assert [pop_touch(queue, 1)[0] for _ in range(MOST_TOGETHER)] == [100 + k for k in range(MOST_TOGETHER)]
    assert next_time(queue) == np.inf
