"""Segments: lines that act as walls, with contacts on both sides and at their ends (`World.segments`).

A segment is (x_0, y_0, x_1, y_1), m, and the speed of its surface, m/s. The segments of a world are an array (S, 5). If
an end is the point of a segment that is nearest to a circle, the contact is that with a point. An end that lies on
another segment or on a wall of the box, or just behind it, has no contact of its own: the other surface has it
(`touches`). Without this rule, a circle that rolls over a joint stumbles. Box2D 2.3 uses ghost vertices for this in its
chains.

No centre ever crosses a segment at rest. Continuous collision stops fast circles at it (`continuous`). A centre that
sweeps or position correction would push through it is clamped to its side (`clamp_beside`). A moving segment passes
over a circle that bodies at rest block (`passing`).

The path of a circle relative to a moving segment begins at the point to which the segment would have carried the
circle's first position (`carried`).
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.constants import NEARLY
from deep_contact.stepping.pairs import pass_through
from deep_contact.stepping.segment_grid import (
    _ROUNDING,
    BEHIND,
    BESIDE,
    END,
    ON,
    START,
    cells_of_box,
    circles_beside,
    is_beyond,
    near_box,
    nearest_part,
    segment_gap,
    segments_of,
)


@njit(cache=True, error_model="numpy")
def surface_velocity(segment, n_x, n_y):
    """Return the velocity of a segment's surface along the tangent (n_y, -n_x) of a contact with it, m/s."""
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    return segment[4] * (e_x * n_y - e_y * n_x) / math.sqrt(e_x * e_x + e_y * e_y)


@njit(cache=True)
def is_moving(wall, s):
    """Return whether segment s moves. wall: velocities of the ends of all segments, (S, 4), m/s."""
    return wall[s, 0] != 0.0 or wall[s, 1] != 0.0 or wall[s, 2] != 0.0 or wall[s, 3] != 0.0


@njit(cache=True)
def has_moving(actuation):
    """Return whether any segment moves. actuation: `Actuation` of the step, or None."""
    if actuation is None:
        return False
    return actuation.moving.shape[0] > 0


@njit(cache=True, error_model="numpy")
def wall_velocity(line, wall, s, x, y):
    """Return the velocity (v_x, v_y) of segment s at its point nearest to (x, y), m/s.

    line: the segments, (S, 5). wall: velocities of their ends, (S, 4), m/s.
    """
    e_x, e_y = line[s, 2] - line[s, 0], line[s, 3] - line[s, 1]
    t = (e_x * (x - line[s, 0]) + e_y * (y - line[s, 1])) / (e_x * e_x + e_y * e_y)
    t = min(1.0, max(0.0, t))
    return wall[s, 0] + t * (wall[s, 2] - wall[s, 0]), wall[s, 1] + t * (wall[s, 3] - wall[s, 1])


@njit(cache=True, error_model="numpy")
def carried(line, wall, s, dt, x, y):
    """Return the point to which segment s would have carried the point (x, y) in its motion over Δt, m.

    The carried point has the same distance from the segment, and the same place along it as a share of its length.
    line: the segments after Δt, (S, 5). wall: velocities of their ends, (S, 4), m/s. dt: Δt, s.
    """
    x_0, y_0 = line[s, 0] - dt * wall[s, 0], line[s, 1] - dt * wall[s, 1]
    f_x, f_y = line[s, 2] - dt * wall[s, 2] - x_0, line[s, 3] - dt * wall[s, 3] - y_0
    e_x, e_y = line[s, 2] - line[s, 0], line[s, 3] - line[s, 1]
    square = f_x * f_x + f_y * f_y
    along = (f_x * (x - x_0) + f_y * (y - y_0)) / square
    across = (f_x * (y - y_0) - f_y * (x - x_0)) / math.sqrt(square * (e_x * e_x + e_y * e_y))
    return line[s, 0] + along * e_x - across * e_y, line[s, 1] + along * e_y + across * e_x


def ground_velocities(contacts, world, n):
    """Return the velocities of segments and their surfaces at contacts, along the normals and along the tangents.

    The result is (2, m), m/s. It is 0 at contacts with circles and walls. n: number of circles.
    """
    velocities, line, wall = np.zeros((2, len(contacts.body_a))), segments_of(world), np.array(world.segment_velocities)
    if world.surface_speeds or world.segment_velocities:
        for i in np.flatnonzero(contacts.body_b >= n + 4):
            s, (n_x, n_y) = contacts.body_b[i] - n - 4, contacts.normal[i]
            velocities[1, i] = surface_velocity(line[s], n_x, n_y)
            if world.segment_velocities:
                v_x, v_y = wall_velocity(line, wall, s, *contacts.position[i])
                velocities[:, i] += v_x * n_x + v_y * n_y, v_x * n_y - v_y * n_x
    return velocities


@njit(cache=True, error_model="numpy", _nrt=False)
def touches(segments, box, i, s, x, y, reach, barred):
    """Return whether circle i with its centre at (x, y) has a contact with segment s.

    Whether the circle passes through this segment is not tested here. It has a contact if the segment is at most
    `reach`, m, from the centre, and its nearest point is not a hidden end. An end is hidden if a wall, or another
    segment that is at least as near, has the contact in its place. If two ends are equally near, the end of the segment
    with the smaller index is not hidden. A segment through which the circle passes hides no end. box: box of the
    `World`. barred: `StepInput.touches`, and the number n + 4 to which the index of a segment is added.
    """
    line = segments.line
    segment = line[s]
    if x < min(segment[0], segment[2]) - reach or x > max(segment[0], segment[2]) + reach:
        return False
    if y < min(segment[1], segment[3]) - reach or y > max(segment[1], segment[3]) + reach:
        return False
    gap, part = segment_gap(segment, x, y)[0], nearest_part(segment, x, y)
    if not gap <= reach or part == BESIDE:
        return gap <= reach
    which = part - START  # 0: first end of the segment, 1: second end
    end = 2 * s + which
    e_x, e_y = segment[2 * which], segment[2 * which + 1]
    if min(e_x - box[0], e_y - box[1], box[2] - e_x, box[3] - e_y) <= ON * reach:
        return False
    for k in segments.hiding[segments.first[end] : segments.first[end + 1]]:
        if hides(line[k], e_x, e_y, x, y, reach) and not pass_through(barred[0], i, barred[1] + k):
            other = segment_gap(line[k], x, y)[0]
            if other < gap or (other == gap and k < s) or nearest_part(line[k], x, y) == BESIDE:
                return False
    return True


@njit(cache=True, error_model="numpy", _nrt=False)
def hides(segment, e_x, e_y, x, y, reach):
    """Return whether an end (e_x, e_y) lies on a segment, or just behind it as seen from (x, y).

    The tolerances are `ON` and `BEHIND`. reach: radius of the circle plus skin, m.
    """
    s_x, s_y = segment[2] - segment[0], segment[3] - segment[1]
    length = math.sqrt(s_x * s_x + s_y * s_y)
    d_x, d_y = e_x - segment[0], e_y - segment[1]
    before, along = (s_x * d_y - s_y * d_x) / length, (s_x * d_x + s_y * d_y) / length
    if s_x * (y - segment[1]) - s_y * (x - segment[0]) < 0.0:
        before = -before
    beyond = (BEHIND if nearest_part(segment, x, y) == BESIDE else ON) * reach
    return -BEHIND * reach <= before <= ON * reach and -beyond <= along <= length + beyond


@njit(cache=True, error_model="numpy", _nrt=False)
def append_pairs(position, radius, walls, segments, barred, circles, body_a, body_b, end):
    """Do the search of `insert_pairs`: write the pairs behind the first `end` pairs, in place.

    barred: `StepInput.touches`. circles: (n,), overwritten. Returns the new number of pairs, or -1 if they do not fit.
    In rough ground a circle has dozens of segments in its cell. Numba therefore counts no references here (`_nrt`),
    which took most of the time.
    """
    n, grid, start, near, line = position.shape[0], segments.grid, segments.start, segments.near, segments.line
    for j in range(circles_beside(segments, position, position, circles)):
        i = circles[j]
        x, y, reach = position[i, 0], position[i, 1], NEARLY * (radius[i] + walls.skin)
        first, last, bottom, top = cells_of_box(grid, x, x, y, y)
        for row in range(bottom, top + 1):
            for k in range(start[row * grid[3] + first], start[row * grid[3] + last + 1]):
                # A call of `touches` copies all fields of `segments`, so that far segments are left out before it.
                if is_beyond(line[near[k]], x, y, reach):
                    continue
                if touches(segments, walls.box, i, near[k], x, y, reach, (barred, n + 4)):
                    if end == body_a.shape[0]:
                        return -1
                    body_a[end], body_b[end] = i, n + 4 + near[k]
                    end += 1
    return end


@njit(cache=True)
def insert_pairs(position, radius, walls, segments, barred, body_a, body_b, m):
    """Insert the touching pairs of circles and segments into `body_a` and `body_b`, in place.

    Their first m pairs are sorted by (body_a, body_b), and stay so with the new ones. barred: `StepInput.touches`.
    Returns the new number of pairs, or -1 if they do not fit.
    """
    circles = np.empty(len(position), np.int64)
    end = append_pairs(position, radius, walls, segments, barred, circles, body_a, body_b, m)
    if end < 0:
        return -1
    more_a, more_b = body_a[m:end].copy(), body_b[m:end].copy()
    i, j = m - 1, end - m - 1
    # Merged from the back. Among the pairs of a circle, those with segments come last.
    while j >= 0:
        if i >= 0 and body_a[i] > more_a[j]:
            body_a[i + j + 1], body_b[i + j + 1] = body_a[i], body_b[i]
            i -= 1
        else:
            body_a[i + j + 1], body_b[i + j + 1] = more_a[j], more_b[j]
            j -= 1
    return end


@njit(cache=True, error_model="numpy")
def first_crossing(segments, i, x, y, to_x, to_y, buffer, barred, actuation):
    """Return the share of the straight path from (x, y) to (to_x, to_y) before it first crosses a segment at rest.

    Segments through which circle i passes do not count. Returns infinity if the path crosses none. buffer: (S,),
    overwritten. barred: see `touches`. actuation: `Actuation` of the step, or None.
    """
    first = math.inf
    for s in near_box(segments, min(x, to_x), max(x, to_x), min(y, to_y), max(y, to_y), buffer):
        if actuation is not None:
            if is_moving(actuation.wall, s):
                continue
        if not pass_through(barred[0], i, barred[1] + s):
            first = min(first, crossing(segments.line[s], x, y, to_x, to_y))
    return first


@njit(cache=True, error_model="numpy")
def crossing(segment, x, y, to_x, to_y):
    """Return the share of a path before it crosses one segment, moving or at rest (`first_crossing`).

    Returns infinity if the path does not cross the segment.
    """
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    before = e_x * (y - segment[1]) - e_y * (x - segment[0])
    after = e_x * (to_y - segment[1]) - e_y * (to_x - segment[0])
    if (before >= 0.0) != (after >= 0.0):
        share = before / (before - after)
        at_x, at_y = x + share * (to_x - x), y + share * (to_y - y)
        along = (e_x * (at_x - segment[0]) + e_y * (at_y - segment[1])) / (e_x * e_x + e_y * e_y)
        if -_ROUNDING <= along <= 1.0 + _ROUNDING:
            return share
    return math.inf


@njit(cache=True)
def positions_before(bodies, segments):
    """Return the positions at the start of a substep, (n, 2), m, which `clamp_beside` needs.

    They are a copy if there are segments, and otherwise the array of the bodies itself.
    """
    if segments is None:
        return bodies.position
    return bodies.position.copy() if segments.line.shape[0] > 0 else bodies.position


@njit(cache=True)
def may_cross(bodies, before, solved):
    """Return whether a centre may have crossed a segment in a substep.

    A centre that moved by less than half of its radius cannot have crossed a segment that was farther away than that. A
    segment that was nearer has a contact with the circle, whose separation shows it. before: positions at the start,
    (n, 2), m. solved: contacts at these positions.
    """
    position, radius, n = bodies.position, bodies.radius, bodies.radius.shape[0]
    body_a, body_b, separation = solved.body_a, solved.body_b, solved.separation
    crosses = False
    for i in range(n):
        m_x, m_y = position[i, 0] - before[i, 0], position[i, 1] - before[i, 1]
        crosses |= not m_x * m_x + m_y * m_y < 0.25 * radius[i] * radius[i]
    for k in range(body_a.shape[0]):
        if body_b[k] >= n + 4:
            crosses |= not separation[k] > -0.4 * radius[body_a[k]]
    return crosses


@njit(cache=True)
def clamp_beside(bodies, before, segments, touches, actuation):
    """Move centres that have crossed a segment at rest back to their side, in place.

    The new place is half-way from the old position to the crossing. before: positions at the start of the substep, (n,
    2), m. A centre crosses a segment only if it is pressed harder than the sweeps and position correction can
    withstand. touches: `StepInput.touches`.
    """
    barred = touches, bodies.mass.shape[0] + 4
    position, buffer, circles = bodies.position, np.empty_like(segments.every), np.empty(len(before), np.int64)
    for i in circles[: circles_beside(segments, before, position, circles)]:
        x, y = before[i, 0], before[i, 1]
        share = 0.5 * first_crossing(segments, i, x, y, position[i, 0], position[i, 1], buffer, barred, actuation)
        if share <= 0.5:
            to_x, to_y = x + share * (position[i, 0] - x), y + share * (position[i, 1] - y)
            # If rounding puts the new place on the other side, the centre stays at its old position.
            stays = first_crossing(segments, i, x, y, to_x, to_y, buffer, barred, actuation) <= 1.0
            position[i, 0], position[i, 1] = (x, y) if stays else (to_x, to_y)


@njit(cache=True, error_model="numpy")
def clamp_beside_moving(bodies, before, segments, solved, touches, actuation, dt):
    """Do `clamp_beside` for the moving segments, in place, after they have moved for Δt.

    A segment passes over a centre that it crosses if the circle had no contact with it, or was fast relative to it
    (`continuous`). before: positions at the start of Δt, (n, 2), m. solved: contacts at these positions. touches:
    `StepInput.touches`. dt: Δt, s. Returns (whether a centre has changed, index of a circle over which a segment
    passes, or −1).
    """
    position, line, n = bodies.position, segments.line, bodies.mass.shape[0]
    changed, passed = False, np.int64(-1)
    for s in actuation.moving:
        for i in range(n):
            x, y = carried(line, actuation.wall, s, dt, before[i, 0], before[i, 1])
            share = 0.5 * crossing(line[s], x, y, position[i, 0], position[i, 1])
            if share > 0.5 or bodies.mass[i] == math.inf or pass_through(touches, i, n + 4 + s):
                continue
            m_x, m_y = position[i, 0] - x, position[i, 1] - y
            if not touched(solved, i, n + 4 + s) or m_x * m_x + m_y * m_y > 0.25 * bodies.radius[i] ** 2:
                passed = np.int64(i)
                continue
            to_x, to_y = x + share * m_x, y + share * m_y
            stays, changed = crossing(line[s], x, y, to_x, to_y) <= 1.0, True
            position[i, 0], position[i, 1] = (x, y) if stays else (to_x, to_y)
    return changed, passed


@njit(cache=True)
def touched(contacts, a, b):
    """Return whether there is a contact between bodies a and b."""
    for k in range(contacts.body_a.shape[0]):
        if contacts.body_a[k] == a and contacts.body_b[k] == b:
            return True
    return False


@njit(cache=True, error_model="numpy")
def time_to_touch(segment, x, y, m_x, m_y, least):
    """Return (time, part): the time at which a point first comes within `least`, m, of a segment, and the nearest part.

    The point moves by (m_x, m_y), m. The time is a share of this motion, or infinity if the point is nearer already. If
    the distance is `least` to rounding, and decreases, the time is 0. part: the part of the segment that is nearest at
    this time, `BESIDE`, `START` or `END`.
    """
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    length, nearer = math.sqrt(e_x * e_x + e_y * e_y), (1.0 - _ROUNDING) * least
    gap = (e_x * (y - segment[1]) - e_y * (x - segment[0])) / length
    speed = (e_y * m_x - e_x * m_y) / length
    if gap < 0.0:
        gap, speed = -gap, -speed
    first, part = math.inf, BESIDE
    if gap >= nearer and speed > 0.0:
        time = max(0.0, gap - least) / speed
        if nearest_part(segment, x + time * m_x, y + time * m_y) == BESIDE:
            first = time
    for end in (START, END):
        column = 0 if end == START else 2
        d_x, d_y = x - segment[column], y - segment[column + 1]
        approach, square = d_x * m_x + d_y * m_y, d_x * d_x + d_y * d_y
        beyond = max(0.0, square - least * least)
        under = approach * approach - (m_x * m_x + m_y * m_y) * beyond
        if approach < 0.0 and square >= nearer * nearer and under >= 0.0:
            time = beyond / (math.sqrt(under) - approach)
            if time < first:
                first, part = time, end
    return first, part
