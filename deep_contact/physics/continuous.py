"""Continuous collision: what moves far in one step stops at the first thing in its way.

A contact is found where circles touch at the end of a step. One that moves by more than its radius can pass through
another, or leave the box, between two ends. So what moves further than `FAST` radii in a step moves along a straight
line until it touches, both circles stay there for the rest of the step, and the next step finds their contact. Touching
is half a slop of overlap; a pair that is deeper already may halve its distance but never pass. Stops are made in the
order of time, so that a circle also meets those that have stopped before it.

Circles slower than that are left alone. (Box2D 2.3 does this for walls and bullets, `b2World::SolveTOI`, and solves the
velocities there and then.)

What moves from outside, a segment or a fixed circle, is stopped by nothing. What it meets within the step goes on with
it from there (`step.Drive`).
"""

from __future__ import annotations

import math
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.physics.collision import make_cells, sort_level, wall_gap
from deep_contact.physics.segments import (
    BESIDE,
    ON,
    START,
    carried,
    hides,
    is_free,
    moves,
    near_box,
    segment_gap,
    time_to_touch,
)
from deep_contact.state.arrays import WALL_NORMALS

FAST = 0.5
"""A circle is fast if it moves further than so many of its radii in a step."""

CLOSER = 0.5
"""Share of the distance of a deep pair, or from a wall, that one step leaves at least."""

NOTHING = -1
"""Partner of a circle that meets nothing."""


MOST_LOOKS = 1000
"""Times that the first touch is looked for, for each circle, in a step."""


@njit(cache=True, error_model="numpy")
def stop_fast(step, start, segments, drive):
    """Take back, in place, what circles have moved beyond the first touch of a fast one, and the energy of its fall.

    step: `StepInput`, whose bodies have moved for Δt. start: (n, 2), where they were, m. segments: after their moves.
    """
    bodies, dt, n = step.bodies, step.dt, step.bodies.mass.shape[0]
    move = moved(bodies.position, start, -1.0)
    if not math.isfinite(start.sum() + move.sum()):
        return  # the caller of the run says so
    fast = np.empty(n, np.bool_)
    for i in range(n):
        fast[i] = move[i, 0] * move[i, 0] + move[i, 1] * move[i, 1] > (FAST * bodies.radius[i]) ** 2
    stop, when, along = np.ones(n), np.full(n, np.inf), np.zeros((n, 2))
    path = (start, move, stop, bodies.radius, step.box, segments, step.scales)
    if drive is not None:
        meet_moving_walls(fast, path, drive, dt)
        if not fast.any():
            return
    swept = _sort_swept(start, move, bodies.radius)
    if drive is not None:
        meet_fixed(fast, path, swept, bodies.mass)
    queue = [(np.inf, NOTHING)]  # of (time, circle); one whose time has changed since is passed over
    for i in range(n):
        if fast[i]:
            when[i], _ = _first_touch(i, 0.0, path, swept, drive, dt)
            heappush(queue, (when[i], i))
    looks = 0
    while queue[0][0] <= 1.0:
        expected, i = heappop(queue)
        if when[i] != expected:
            continue
        looks += 1
        # Others may have stopped since this was found: it is looked for again, and later if it is not the same.
        time, other = _first_touch(i, when[i], path, swept, drive, dt)
        # Where rounding finds it later without end, it is now.
        if time > when[i] + 1e-12 and (time > 1.0 or looks < MOST_LOOKS * n):
            when[i] = time
            heappush(queue, (time, i))
            continue
        if drive is not None:
            go_along(i, other, path, bodies.mass, drive, dt, along)
        for k in (i, other):
            if 0 <= k < n and stop[k] == 1.0 and bodies.mass[k] < np.inf:
                stop[k], when[k] = time, np.inf
                _tell_neighbours(k, time, path, swept, fast, when, queue)
    for i in range(n):
        if stop[i] < 1.0:
            for axis in range(2):
                bodies.position[i, axis] = start[i, axis] + stop[i] * move[i, axis] + (1.0 - stop[i]) * along[i, axis]
            take_back_fall(bodies.velocity[i], (1.0 - stop[i]) * dt, step.gravity)


@njit(cache=True, error_model="numpy")
def meet_moving_walls(fast, path, drive, dt):
    """Let circles be fast as well, in place, whose way is long relative to a moving segment near it."""
    start, move, _, radius, _, segments, scales = path
    line = segments.line
    for s in drive.moving:
        for i in range(radius.shape[0]):
            to_x, to_y = start[i, 0] + move[i, 0], start[i, 1] + move[i, 1]
            x, y = carried(line, drive.wall, s, dt, start[i, 0], start[i, 1])
            reach = radius[i] + scales.wall_skin
            if (
                max(x, to_x) + reach >= min(line[s, 0], line[s, 2])
                and min(x, to_x) - reach <= max(line[s, 0], line[s, 2])
                and max(y, to_y) + reach >= min(line[s, 1], line[s, 3])
                and min(y, to_y) - reach <= max(line[s, 1], line[s, 3])
            ):
                fast[i] |= (to_x - x) ** 2 + (to_y - y) ** 2 > (FAST * radius[i]) ** 2


@njit(cache=True)
def meet_fixed(fast, path, swept, mass):
    """Let the circles that a fast fixed circle may meet be fast, in place. No fixed circle is fast then."""
    for k in range(mass.shape[0]):
        if mass[k] == np.inf and fast[k]:
            for i in _crossing(k, path, swept):
                fast[i] = True
    for k in range(mass.shape[0]):
        fast[k] &= mass[k] < np.inf


@njit(cache=True)
def go_along(i, other, path, mass, drive, dt, along):
    """If circle i meets a moving segment or a fixed circle, write how far that carries it in a whole step, m."""
    start, move, segments, n = path[0], path[1], path[5], mass.shape[0]
    if other >= n + 4 and moves(drive.wall, other - n - 4):
        x, y = carried(segments.line, drive.wall, other - n - 4, dt, start[i, 0], start[i, 1])
        along[i, 0], along[i, 1] = x - start[i, 0], y - start[i, 1]
    elif 0 <= other < n and mass[other] == np.inf:
        along[i, 0], along[i, 1] = move[other, 0], move[other, 1]


@njit(cache=True)
def moved(points, by, share):
    """points + share by, (n, 2) each. By a loop, which compiles in less time than NumPy's expression."""
    result = np.empty_like(points)
    for i in range(points.shape[0]):
        for axis in range(2):
            result[i, axis] = points[i, axis] + share * by[i, axis]
    return result


class Swept(NamedTuple):
    """The broad phase: boxes around the paths of circles in a step, sorted into cells by their middles."""

    start: np.ndarray  # of `Cells`
    order: np.ndarray  # of `Cells`
    cell: np.ndarray  # of `Cells`
    box: np.ndarray  # (n, 4): x_min, x_max, y_min, y_max of each circle, m, in the order of `order`
    columns: int
    rows: int
    aside: int  # columns that boxes which cross may be apart
    above: int  # rows that they may be apart
    found: np.ndarray  # (n,): a buffer


_make_cells = njit(cache=True)(make_cells)


@njit(cache=True, error_model="numpy")
def _sort_swept(start, move, radius):
    """`Swept` of circles that start at (n, 2) and move by (n, 2), m."""
    n = radius.shape[0]
    cells = _make_cells(n)
    middle = moved(start, move, 0.5)
    cells.level[:] = 0
    sort_level(np.int64(0), middle, radius, 0.0, np.int64(0), np.int64(0), cells)
    columns, rows = cells.grid[0]["columns"], cells.grid[0]["rows"]
    box, longest, largest = np.empty((n, 4)), np.zeros(2), 0.0
    low, high = np.full(2, np.inf), np.full(2, -np.inf)  # of the middles
    for k in range(n):
        i = cells.order[k]
        for axis in range(2):
            x, to_x = start[i, axis], start[i, axis] + move[i, axis]
            box[k, 2 * axis], box[k, 2 * axis + 1] = min(x, to_x) - radius[i], max(x, to_x) + radius[i]
            longest[axis] = max(longest[axis], box[k, 2 * axis + 1] - box[k, 2 * axis])
            low[axis], high[axis] = min(low[axis], middle[i, axis]), max(high[axis], middle[i, axis])
        largest = max(largest, radius[i])
    width = max(2.0 * largest, (high[0] - low[0]) / columns, (high[1] - low[1]) / rows)  # of a cell, at least
    aside, above = int(min(longest[0] / width, columns)) + 1, int(min(longest[1] / width, rows)) + 1
    return Swept(cells.start, cells.order, cells.cell, box, columns, rows, aside, above, np.empty(n, np.int64))


@njit(cache=True)
def _crossing(i, path, swept):
    """The other circles whose boxes cross that of circle i: no others can touch it in this step."""
    start, move, radius = path[0], path[1], path[3]
    row = swept.cell[i] // swept.columns
    column = swept.cell[i] - row * swept.columns
    left, right = max(column - swept.aside, 0), min(column + swept.aside, swept.columns - 1)
    x, y = start[i, 0], start[i, 1]
    to_x, to_y = x + move[i, 0], y + move[i, 1]
    x_min, x_max = min(x, to_x) - radius[i], max(x, to_x) + radius[i]
    y_min, y_max = min(y, to_y) - radius[i], max(y, to_y) + radius[i]
    box, found, count = swept.box, swept.found, 0
    for other in range(max(row - swept.above, 0), min(row + swept.above + 1, swept.rows)):
        for k in range(swept.start[other * swept.columns + left], swept.start[other * swept.columns + right + 1]):
            found[count] = swept.order[k]  # counted without a branch, which could not be predicted
            crosses = (box[k, 0] <= x_max) & (box[k, 1] >= x_min) & (box[k, 2] <= y_max) & (box[k, 3] >= y_min)
            count += crosses & (found[count] != i)
    return found[:count]


@njit(cache=True, error_model="numpy")
def take_back_fall(velocity, time, gravity):
    """Change a velocity, (2,), m/s, in place, of a circle that has stopped this time, s, before the end of its step.

    It has the speed that gravity gives within a whole step, but has not fallen, or risen, all the way. The energy of
    the way that is missing is taken out of its speed, or put into it.
    """
    g = math.hypot(gravity[0], gravity[1])
    if g == 0.0:
        return
    d_x, d_y = gravity[0] / g, gravity[1] / g
    down = velocity[0] * d_x + velocity[1] * d_y
    change = math.copysign(math.sqrt(max(0.0, down * (down - 2.0 * g * time))), down) - down
    velocity[0] += change * d_x
    velocity[1] += change * d_y


@njit(cache=True, error_model="numpy")
def _first_touch(i, now, path, swept, drive, dt):
    """(time, partner) of the first touch of a circle from a time on; (inf, NOTHING) without one. Time is in steps."""
    start, move, _, radius, box, segments, scales = path
    n = radius.shape[0]
    first, partner = np.inf, NOTHING
    for wall in range(4):
        n_x, n_y = WALL_NORMALS[wall, 0], WALL_NORMALS[wall, 1]
        gap, speed = wall_gap(start[i, 0], start[i, 1], box, wall), move[i, 0] * n_x + move[i, 1] * n_y
        least = _least(gap, radius[i] + scales.wall_skin, radius[i], scales)
        # What began outside may come in.
        if gap > 0.0 and speed > 0.0:
            time = max(now, (gap - least) / speed)
            if time < first:
                first, partner = time, n + wall
    x, y = start[i, 0], start[i, 1]
    to_x, to_y = x + move[i, 0], y + move[i, 1]
    way = min(x, to_x), max(x, to_x), min(y, to_y), max(y, to_y)
    if not is_free(segments.start, segments.grid, *way):
        for s in near_box(segments, *way, np.empty_like(segments.every)):
            if drive is not None:
                if moves(drive.wall, s):
                    continue
            time = max(now, _touch_segment(i, s, x, y, path))
            if time < first:
                first, partner = time, n + 4 + s
    if drive is not None:
        for s in drive.moving:
            from_x, from_y = carried(segments.line, drive.wall, s, dt, x, y)
            time = max(now, _touch_segment(i, s, from_x, from_y, path))
            if time < first:
                first, partner = time, n + 4 + s
    for k in _crossing(i, path, swept):
        time = _touch(i, k, now, path)
        if time < first:
            first, partner = time, k
    return (first, partner) if first <= 1.0 else (np.inf, NOTHING)


@njit(cache=True)
def _least(distance, reach, radius, scales):
    """Distance at which circles stop, m: half a slop within reach, so that a contact is found; see `CLOSER`."""
    touching = reach - min(0.5 * scales.slop, 0.1 * radius)
    return touching if distance >= touching else CLOSER * distance


@njit(cache=True, error_model="numpy")
def _touch_segment(i, s, x, y, path):
    """Time of the first touch of a circle, which comes from (x, y), and a segment, in steps; inf without one."""
    start, move, _, radius, box, segments, scales = path
    line, reach = segments.line, radius[i] + scales.wall_skin
    m_x, m_y = start[i, 0] - x + move[i, 0], start[i, 1] - y + move[i, 1]
    e_x, e_y = line[s, 2] - line[s, 0], line[s, 3] - line[s, 1]
    before = e_x * (y - line[s, 1]) - e_y * (x - line[s, 0])
    after = before + e_x * m_y - e_y * m_x
    if before * after > 0.0 and min(before * before, after * after) > reach * reach * (e_x * e_x + e_y * e_y):
        return np.inf  # the whole path is on one side of the line, and beyond reach of it
    least = _least(segment_gap(line[s], x, y)[0], reach, radius[i], scales)
    time, part = time_to_touch(line[s], x, y, m_x, m_y, least)
    if part != BESIDE and time <= 1.0:
        # An end on a surface is no nearer than that: what slides along one segment does not stop at the next.
        end, column = 2 * s + part - START, 2 * (part - START)
        e_x, e_y = line[s, column], line[s, column + 1]
        for k in segments.hiding[segments.first[end] : segments.first[end + 1]]:
            if hides(line[k], e_x, e_y, x, y, reach):
                least = min(least, _least(segment_gap(line[k], x, y)[0], reach, radius[i], scales))
        for wall in range(4):
            if wall_gap(e_x, e_y, box, wall) <= ON * reach:
                least = min(least, _least(wall_gap(x, y, box, wall), reach, radius[i], scales))
        time, _ = time_to_touch(line[s], x, y, m_x, m_y, least)
    return time


@njit(cache=True, error_model="numpy")
def _touch(i, k, now, path):
    """Time of the first touch of two circles from a time on, in steps; inf without one."""
    start, move, stop, radius, _, _, scales = path
    s_x, s_y = start[k, 0] - start[i, 0], start[k, 1] - start[i, 1]
    i_t, k_t = min(now, stop[i]), min(now, stop[k])
    p_x, p_y = s_x + k_t * move[k, 0] - i_t * move[i, 0], s_y + k_t * move[k, 1] - i_t * move[i, 1]
    w_x = w_y = 0.0
    if stop[i] == 1.0:
        w_x, w_y = -move[i, 0], -move[i, 1]
    if stop[k] == 1.0:
        w_x, w_y = w_x + move[k, 0], w_y + move[k, 1]
    approach = p_x * w_x + p_y * w_y
    if not approach < 0.0:
        return np.inf
    reach = radius[i] + radius[k]
    missed = p_x * p_x + p_y * p_y - reach * reach
    if approach * approach < (w_x * w_x + w_y * w_y) * missed:
        return np.inf  # as below, without a root: they stop within reach
    least = _least(math.sqrt(s_x * s_x + s_y * s_y), reach, min(radius[i], radius[k]), scales)
    beyond = p_x * p_x + p_y * p_y - least * least
    if beyond <= 0.0:
        return now
    under = approach * approach - (w_x * w_x + w_y * w_y) * beyond
    return np.inf if under < 0.0 else now + beyond / (math.sqrt(under) - approach)


@njit(cache=True, error_model="numpy")
def _tell_neighbours(k, now, path, swept, fast, when, queue):
    """Let fast circles that still move know, in `when` and the queue, that this one has stopped."""
    stop = path[2]
    for i in _crossing(k, path, swept):
        if fast[i] and stop[i] == 1.0:
            time = _touch(i, k, now, path)
            if time < when[i]:
                when[i] = time
                heappush(queue, (time, i))
