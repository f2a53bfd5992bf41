"""Compute the times at which the path of a circle touches a wall, a segment or the path of another circle.

A touch is the moment at which a moving circle overlaps another body by `touching_overlap`. If the two overlapped more
at the start of the step, it is the moment at which their distance would become smaller than at the start. Times are
counted from the beginning of the step, in units of the step. A rate is a displacement in a whole step, m. A circle is
called held if it has met a wall, a segment or a fixed circle in the step (`Paths.held`).

Tests: tests/stepping/test_continuous.py
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import WALL_NORMALS
from deep_contact.stepping.contacts import wall_gap
from deep_contact.stepping.pairs import pass_through
from deep_contact.stepping.paths import FIRM, FREE, place_at
from deep_contact.stepping.segment_grid import BESIDE, ON, START, cells_of_box, segment_gap
from deep_contact.stepping.segments import carried, crossing, hides, is_moving, time_to_touch

FAST = 0.5
"""A circle is fast relative to a body if it moves farther in a step, relative to it, than this share of its radius."""

PAIRS = 0.5
"""Two circles, neither of them fixed, touch only if they approach each other, in a step, by more than this share of the
smaller radius.

At the end of the step, two circles that approach more slowly overlap by less than this share. The contacts of the next
step stop them. The limit saves searches: without it, circles in a row pass ever smaller pushes to and fro. The paths of
circles that touch and fly together need no limit: an approach that is only a rounding error changes a path by a
rounding error.
"""

FIXED = 0.01
"""Share that replaces `PAIRS` for touches with walls, segments and fixed circles."""

MOST_TOUCHES = 200
"""Largest number of touches of a circle in a step. Later approaches are left to the contacts of the next step."""


@njit(cache=True, error_model="numpy", _nrt=False)
def touch_walls(i, now, paths, actuation):
    """Return (time, partner) of the first touch of circle i with a wall or a segment from time `now` on, or (inf, −1).

    partner: index of the wall or segment, as in `Contacts.body_b`. paths: `Paths`. actuation: `Actuation` of the step,
    or None.
    """
    step, segments, n = paths.step, paths.segments, paths.since.shape[0]
    radius, scales = step.bodies.radius[i], step.scales
    rate_x, rate_y, (x, y) = paths.rate[i, 0], paths.rate[i, 1], place_at(paths, i, now)
    first, partner = np.inf, -1
    if paths.touches[i] > 0 or rate_x * rate_x + rate_y * rate_y > (FAST * radius) ** 2:
        for wall in range(4):
            rate = rate_x * WALL_NORMALS[wall, 0] + rate_y * WALL_NORMALS[wall, 1]
            before = wall_gap(paths.start[i, 0], paths.start[i, 1], paths.step.box, wall)
            # A circle that was outside of the box at the start of the step may come in.
            if rate > FIXED * radius and before > 0.0:
                least = min(before, radius + scales.wall_skin - touching_overlap(radius, scales))
                time = now + max(0.0, (wall_gap(x, y, paths.step.box, wall) - least) / rate)
                if time < first:
                    first, partner = time, n + wall
        to_x, to_y = place_at(paths, i, 1.0)
        way = min(x, to_x), max(x, to_x), min(y, to_y), max(y, to_y)
        left, right, bottom, top = cells_of_box(segments.grid, *way)
        for row in range(bottom, top + 1):
            begin = row * segments.grid[3]
            for j in range(segments.start[begin + left], segments.start[begin + right + 1]):
                s = segments.near[j]
                if actuation is not None:
                    if is_moving(actuation.wall, s):
                        continue
                time = touch_segment(i, s, now, paths, None)
                if time < first:
                    first, partner = time, n + 4 + s
    if actuation is not None:
        if paths.held[i] != FIRM:
            for s in actuation.moving:
                time = touch_segment(i, s, now, paths, actuation)
                if time < first:
                    first, partner = time, n + 4 + s
    return first, partner


@njit(inline="always")
def touching_overlap(radius, scales):
    """Return the overlap of a touch, m. It is large enough that the next step finds a contact.

    radius: radius of the circle, of two circles the smaller radius, m. scales: `ContactScales`.
    """
    return min(0.5 * scales.slop, 0.1 * radius)


@njit(cache=True, error_model="numpy")
def piece_beside(i, s, now, paths, actuation):
    """Return ((x, y), (m_x, m_y)): centre of circle i at time `now`, and its displacement in the rest of the step, m.

    Both are relative to segment s, in its place at the end of the step. actuation: `Actuation` of the step, or None for
    a segment at rest.
    """
    (x, y), (to_x, to_y) = place_at(paths, i, now), place_at(paths, i, 1.0)
    if actuation is not None:
        x, y = carried(paths.segments.line, actuation.wall, s, (1.0 - now) * paths.step.dt, x, y)
    return (x, y), (to_x - x, to_y - y)


@njit(cache=True, error_model="numpy")
def touch_segment(i, s, now, paths, actuation):
    """Return the time of the first touch of circle i with segment s from time `now` on, or infinity.

    The time is in units of the step. actuation: `Actuation` of the step, or None for a segment at rest.
    """
    behind, barred = paths.since.shape[0] + 4, paths.step.touches
    if pass_through(barred, i, behind + s):
        return np.inf
    line, box, radius, rest = paths.segments.line, paths.step.box, paths.step.bodies.radius[i], 1.0 - now
    reach, (start_x, start_y) = radius + paths.step.scales.wall_skin, (paths.start[i, 0], paths.start[i, 1])
    (x, y), (m_x, m_y) = piece_beside(i, s, now, paths, actuation)
    e_x, e_y = line[s, 2] - line[s, 0], line[s, 3] - line[s, 1]
    before = e_x * (y - line[s, 1]) - e_y * (x - line[s, 0])
    after = before + e_x * m_y - e_y * m_x
    if before * after > 0.0 and min(before * before, after * after) > reach * reach * (e_x * e_x + e_y * e_y):
        return np.inf  # the whole path is on one side of the line, and out of reach of it
    far = paths.touches[i] > 0 or m_x * m_x + m_y * m_y > (FAST * radius * rest) ** 2
    if not far or rest <= 0.0:
        return np.inf
    if actuation is not None:
        start_x, start_y = carried(line, actuation.wall, s, paths.step.dt, start_x, start_y)
    touching = reach - touching_overlap(radius, paths.step.scales)
    least = min(touching, segment_gap(line[s], start_x, start_y)[0], segment_gap(line[s], x, y)[0])
    share, part = time_to_touch(line[s], x, y, m_x, m_y, least)
    if part != BESIDE and share <= 1.0:
        # An end on a surface counts as no nearer than the surface. So a circle that slides along one segment does not
        # touch the end of the next segment.
        end, column = 2 * s + part - START, 2 * (part - START)
        e_x, e_y, hiding, first = line[s, column], line[s, column + 1], paths.segments.hiding, paths.segments.first
        for k in hiding[first[end] : first[end + 1]]:
            if hides(line[k], e_x, e_y, x, y, reach) and not pass_through(barred, i, behind + k):
                least = min(least, segment_gap(line[k], start_x, start_y)[0], segment_gap(line[k], x, y)[0])
        for wall in range(4):
            if wall_gap(e_x, e_y, box, wall) <= ON * reach:
                least = min(least, wall_gap(start_x, start_y, box, wall), wall_gap(x, y, box, wall))
        share, _ = time_to_touch(line[s], x, y, m_x, m_y, least)
    if share > 1.0:
        return np.inf
    _, n_x, n_y = segment_gap(line[s], x + share * m_x, y + share * m_y)
    return now + share * rest if m_x * n_x + m_y * n_y > FIXED * radius * rest else np.inf


@njit(inline="always")
def touch_circle(i, k, now, paths):
    """Return the time of the first touch of circles i and k from time `now` on, in units of the step, or infinity."""
    start, rate, held, radius = paths.start, paths.rate, paths.held, paths.step.bodies.radius
    (x_i, y_i), (x_k, y_k) = place_at(paths, i, now), place_at(paths, k, now)
    p_x, p_y, w_x, w_y = x_k - x_i, y_k - y_i, rate[k, 0] - rate[i, 0], rate[k, 1] - rate[i, 1]
    along = p_x * w_x + p_y * w_y
    if not along < 0.0:
        return np.inf
    reach, smaller = radius[i] + radius[k], min(radius[i], radius[k])
    missed, w = p_x * p_x + p_y * p_y - reach * reach, w_x * w_x + w_y * w_y
    if along * along < w * missed:
        return np.inf  # the paths miss each other even at the distance `reach`; this test needs no square root
    is_fixed_i, is_fixed_k = paths.inverse[i] == 0.0, paths.inverse[k] == 0.0
    if (is_fixed_i and held[k] > held[i]) or (is_fixed_k and held[i] > held[k]) or (is_fixed_i and is_fixed_k):
        return np.inf  # a fixed circle passes over a firmer circle, and over another fixed one
    if paths.touches[k] >= MOST_TOUCHES:
        return np.inf
    least, slowest = reach - touching_overlap(smaller, paths.step.scales), PAIRS * smaller
    s_x, s_y = start[k, 0] - start[i, 0], start[k, 1] - start[i, 1]
    square = min(least * least, s_x * s_x + s_y * s_y)
    if is_fixed_i or is_fixed_k:
        slowest = FIXED * smaller
    beyond = p_x * p_x + p_y * p_y - square
    if beyond <= 0.0:
        return now if along * along > slowest * slowest * (p_x * p_x + p_y * p_y) else np.inf
    under = along * along - w * beyond
    return now + beyond / (math.sqrt(under) - along) if under > slowest * slowest * square else np.inf


@njit(cache=True, error_model="numpy", _nrt=False)
def approach_of(i, k, time, paths, actuation):
    """Return (n_x, n_y, rate): unit normal from circle i to body k, and the rate at which i approaches k, m per step.

    k: index of the body, as in `Contacts.body_b`. time: in units of the step. actuation: `Actuation` of the step, or
    None.
    """
    n, rate = paths.since.shape[0], paths.rate
    if k < n:
        (x_i, y_i), (x_k, y_k) = place_at(paths, i, time), place_at(paths, k, time)
        distance = math.hypot(x_k - x_i, y_k - y_i)
        n_x, n_y = (x_k - x_i) / distance, (y_k - y_i) / distance
        return n_x, n_y, (rate[i, 0] - rate[k, 0]) * n_x + (rate[i, 1] - rate[k, 1]) * n_y
    if k < n + 4:
        n_x, n_y = WALL_NORMALS[k - n, 0], WALL_NORMALS[k - n, 1]
        return n_x, n_y, rate[i, 0] * n_x + rate[i, 1] * n_y
    s = k - n - 4
    (x, y), (m_x, m_y) = piece_beside(i, s, time, paths, None)
    if actuation is not None:
        if is_moving(actuation.wall, s):
            (x, y), (m_x, m_y) = piece_beside(i, s, time, paths, actuation)
    _, n_x, n_y = segment_gap(paths.segments.line[s], x, y)
    return n_x, n_y, (m_x * n_x + m_y * n_y) / (1.0 - time)


@njit(cache=True, error_model="numpy", _nrt=False)
def slip_apart(i, k, normal, time, paths, actuation):
    """Return (t_x, t_y, rate): unit tangent along which circle i slips on body k, and the rate of the slip, m per step.

    The rate is 0 if the slip leaves the two bodies close enough for a contact at the end of the step, if one of them is
    a held circle, and if k is a wall. normal: unit normal from i to k, (2,). time: in units of the step. actuation:
    `Actuation` of the step, or None.
    """
    n, rest, line, scales = paths.since.shape[0], 1.0 - time, paths.segments.line, paths.step.scales
    is_held = paths.inverse[i] > 0.0 and paths.held[i] != FREE
    if k < n:
        is_held |= paths.inverse[k] > 0.0 and paths.held[k] != FREE
    if n <= k < n + 4 or rest <= 0.0 or is_held:
        return 0.0, 0.0, 0.0
    (x, y), radius = place_at(paths, i, time), paths.step.bodies.radius
    s, reach, smaller = k - n - 4, radius[i] + scales.wall_skin, radius[i]
    if k < n:
        x_k, y_k = place_at(paths, k, time)
        x, y, reach, smaller = x - x_k, y - y_k, radius[i] + radius[k], min(radius[i], radius[k])
        m_x, m_y = rest * (paths.rate[i, 0] - paths.rate[k, 0]), rest * (paths.rate[i, 1] - paths.rate[k, 1])
    else:
        (x, y), (m_x, m_y) = piece_beside(i, s, time, paths, None)
        if actuation is not None:
            if is_moving(actuation.wall, s):
                (x, y), (m_x, m_y) = piece_beside(i, s, time, paths, actuation)
    across = m_x * normal[0] + m_y * normal[1]
    m_x, m_y = m_x - across * normal[0], m_y - across * normal[1]
    to_x, to_y, least = x + m_x, y + m_y, reach - 0.5 * touching_overlap(smaller, scales)
    if k < n:
        parts = math.hypot(to_x, to_y) > least
    else:
        parts = segment_gap(line[s], to_x, to_y)[0] > least
        if parts:  # not if a segment or wall on which segment s ends has a contact with the circle, or stops it
            hiding, first = paths.segments.hiding, paths.segments.first
            for other in hiding[first[2 * s] : first[2 * s + 2]]:
                parts &= segment_gap(line[other], to_x, to_y)[0] > least
                parts &= crossing(line[other], x, y, to_x, to_y) == np.inf
            for wall in range(4):
                parts &= wall_gap(to_x, to_y, paths.step.box, wall) > least
    slip = math.hypot(m_x, m_y)
    return (m_x / slip, m_y / slip, slip / rest) if parts and slip > 0.0 else (0.0, 0.0, 0.0)
