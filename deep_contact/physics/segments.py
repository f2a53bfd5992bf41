"""Static segments: lines beside the box, felt from both sides and at their ends (`World.segments`).

A segment is (x_0, y_0, x_1, y_1), m, and the speed of its surface, m/s; the segments of a world are an array (S, 5).
Where a circle is nearest to an end, the contact is that with a point. Ends that two segments share are no points of
their own: of those that meet there, the one that the centre lies beside keeps the contact, or else the first (as ghost
vertices do in chains of Box2D 2.3; without them, a circle that rolls over a joint stumbles).

No centre ever crosses a segment: fast circles stop at it (`continuous`), and what sweeps or position correction would
still push through is held on its side (`hold_beside`). No grid is made of them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deep_contact.state import World

NO_SEGMENTS = np.zeros((0, 5))
"""Of a world that has none."""

BESIDE, START, END = range(3)
"""What of a segment is nearest to a point: its inside, or one of its ends."""

_ROUNDING = 1e-9
"""A path that crosses the line this far beyond an end, in lengths of the segment, crosses the segment: at a joint it
must not slip between two. And how far from 1 the cosine of a normal across the segment may be."""


def segments_of(world: World) -> np.ndarray:
    """The segments of a world with the speeds of their surfaces, (S, 5), m and m/s."""
    if not world.segments:
        return NO_SEGMENTS
    return np.column_stack([world.segments, world.surface_speeds or np.zeros(len(world.segments))])


@njit(cache=True, error_model="numpy")
def surface_velocity(segment, n_x, n_y):
    """Velocity of a segment's surface along the tangent (n_y, -n_x) of a contact with it, m/s."""
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    return segment[4] * (e_x * n_y - e_y * n_x) / math.sqrt(e_x * e_x + e_y * e_y)


def surface_velocities(contacts, segments, n):
    """`surface_velocity` of every contact of n circles, (m,), m/s; 0 where there is no segment."""
    pairs = zip(contacts.body_b - n - 4, contacts.normal)
    return np.array([surface_velocity(segments[s], *normal) if s >= 0 else 0.0 for s, normal in pairs])


@njit(cache=True, error_model="numpy")
def nearest_part(segment, x, y):
    """BESIDE, START or END: what of the segment is nearest to a point."""
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    along = e_x * (x - segment[0]) + e_y * (y - segment[1])
    if along < 0.0:
        return START
    return END if along > e_x * e_x + e_y * e_y else BESIDE


@njit(cache=True, error_model="numpy")
def segment_gap(segment, x, y, h_x=0.0, h_y=0.0):
    """(distance, n_x, n_y) of a point from a segment, m, and the unit normal from the point to it.

    h_x, h_y: a normal that was found before. It tells the side from which the distance is measured, so that beyond the
    segment it is negative; without it that is the side of the point. Across the segment, it keeps a point that has
    passed an end since beside it, as in Box2D: at a joint nothing changes within a step.
    """
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    length = math.sqrt(e_x * e_x + e_y * e_y)
    e_x, e_y = e_x / length, e_y / length
    part, side = nearest_part(segment, x, y), h_x * e_y - h_y * e_x
    if part == BESIDE or abs(side) > 1.0 - _ROUNDING:
        gap = e_x * (y - segment[1]) - e_y * (x - segment[0])
        if side < 0.0 or (side == 0.0 and gap < 0.0):
            return -gap, -e_y, e_x
        return gap, e_y, -e_x
    first = 0 if part == START else 2
    d_x, d_y = segment[first] - x, segment[first + 1] - y
    distance = math.sqrt(d_x * d_x + d_y * d_y)
    if distance == 0.0:
        return 0.0, e_y, -e_x
    return distance, d_x / distance, d_y / distance


@njit(cache=True)
def touches(segments, s, x, y, reach):
    """Whether a circle has a contact with segment s: no farther than `reach`, m, and not left to one that it joins."""
    segment = segments[s]
    if x < min(segment[0], segment[2]) - reach or x > max(segment[0], segment[2]) + reach:
        return False
    if y < min(segment[1], segment[3]) - reach or y > max(segment[1], segment[3]) + reach:
        return False
    if not segment_gap(segment, x, y)[0] <= reach:
        return False
    part = nearest_part(segment, x, y)
    if part == BESIDE:
        return True
    for k in range(segments.shape[0]):
        shared = shared_end(segments, s, part, k)
        # Another part of that one is at least as near, since this end lies on it.
        if shared != BESIDE and (k < s or nearest_part(segments[k], x, y) != shared):
            return False
    return True


@njit(cache=True)
def shared_end(segments, s, end, k):
    """The end of segment k that is the given end of another segment s; BESIDE where they do not meet there."""
    first = 0 if end == START else 2
    x, y = segments[s, first], segments[s, first + 1]
    if k != s and segments[k, 0] == x and segments[k, 1] == y:
        return START
    return END if k != s and segments[k, 2] == x and segments[k, 3] == y else BESIDE


@njit(cache=True)
def insert_pairs(position, radius, segments, skin, body_a, body_b, m):
    """Insert the circles and segments that touch among m sorted pairs, in place. Returns their number, -1 if full."""
    n, found = position.shape[0], m
    for i in range(n):
        for s in range(segments.shape[0]):
            if touches(segments, s, position[i, 0], position[i, 1], radius[i] + skin):
                if found == body_a.shape[0]:
                    return -1
                body_a[found], body_b[found] = i, n + 4 + s
                found += 1
    more_a, more_b = body_a[m:found].copy(), body_b[m:found].copy()
    i, j = m - 1, found - m - 1
    # Merged from the back; of one circle, segments come after all other bodies.
    while j >= 0:
        if i >= 0 and body_a[i] > more_a[j]:
            body_a[i + j + 1], body_b[i + j + 1] = body_a[i], body_b[i]
            i -= 1
        else:
            body_a[i + j + 1], body_b[i + j + 1] = more_a[j], more_b[j]
            j -= 1
    return found


@njit(cache=True, error_model="numpy")
def first_crossing(segments, x, y, to_x, to_y):
    """Share of the straight way from (x, y) at which it first crosses a segment; infinite where it crosses none."""
    first = math.inf
    for s in range(segments.shape[0]):
        segment = segments[s]
        e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
        before = e_x * (y - segment[1]) - e_y * (x - segment[0])
        after = e_x * (to_y - segment[1]) - e_y * (to_x - segment[0])
        if (before >= 0.0) != (after >= 0.0):
            share = before / (before - after)
            at_x, at_y = x + share * (to_x - x), y + share * (to_y - y)
            along = (e_x * (at_x - segment[0]) + e_y * (at_y - segment[1])) / (e_x * e_x + e_y * e_y)
            if -_ROUNDING <= along <= 1.0 + _ROUNDING:
                first = min(first, share)
    return first


@njit(cache=True)
def positions_before(bodies, segments):
    """Positions at the start of a step for `hold_beside`; where there are no segments, nothing is copied."""
    if segments is None:
        return bodies.position
    return bodies.position.copy() if segments.shape[0] > 0 else bodies.position


@njit(cache=True)
def hold_beside(bodies, before, segments):
    """Take back half of the way, in place, of the centres that have crossed a segment, to where they did.

    before: positions at the start of the step, (n, 2), m. Only what is pressed harder than the sweeps or position
    correction can withstand comes so far.
    """
    position = bodies.position
    for i in range(bodies.mass.shape[0]):
        x, y = before[i, 0], before[i, 1]
        share = 0.5 * first_crossing(segments, x, y, position[i, 0], position[i, 1])
        if share <= 0.5:
            to_x, to_y = x + share * (position[i, 0] - x), y + share * (position[i, 1] - y)
            # On the line but for rounding, it stays.
            stays = first_crossing(segments, x, y, to_x, to_y) <= 1.0
            position[i, 0], position[i, 1] = (x, y) if stays else (to_x, to_y)


@njit(cache=True, error_model="numpy")
def time_to_touch(segment, x, y, m_x, m_y, least):
    """(time, part) when a point that moves by (m_x, m_y), m, in a step comes within `least` of a segment; or inf."""
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    length = math.sqrt(e_x * e_x + e_y * e_y)
    gap = (e_x * (y - segment[1]) - e_y * (x - segment[0])) / length
    speed = (e_y * m_x - e_x * m_y) / length
    if gap < 0.0:
        gap, speed = -gap, -speed
    first, part = math.inf, BESIDE
    if gap >= least and speed > 0.0:
        time = (gap - least) / speed
        if nearest_part(segment, x + time * m_x, y + time * m_y) == BESIDE:
            first = time
    for end in (START, END):
        column = 0 if end == START else 2
        d_x, d_y = x - segment[column], y - segment[column + 1]
        approach, beyond = d_x * m_x + d_y * m_y, d_x * d_x + d_y * d_y - least * least
        under = approach * approach - (m_x * m_x + m_y * m_y) * beyond
        if approach < 0.0 and beyond >= 0.0 and under >= 0.0:
            time = beyond / (math.sqrt(under) - approach)
            if time < first:
                first, part = time, end
    return first, part
