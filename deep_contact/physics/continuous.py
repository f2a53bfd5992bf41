"""Continuous collision: what moves far in one step stops at the first thing in its way.

A contact is found where circles touch at the end of a step. One that moves by more than its radius can pass through
another, or leave the box, between two ends. So what moves further than `FAST` radii in a step moves along a straight
line until it touches, both circles stay there for the rest of the step, and the next step finds their contact. Touching
is half a slop of overlap; a pair that is deeper already may halve its distance but never pass. Stops are made in the
order of time, so that a circle also meets those that have stopped before it.

Circles slower than that are left alone, so a scene without fast ones keeps its bits, at the cost of one comparison a
circle. (Box2D 2.3 does this for walls and bullets, `b2World::SolveTOI`, and solves the velocities there and then.)
"""

from __future__ import annotations

import math
from heapq import heappop, heappush

import numpy as np
from numba import njit

from deep_contact.physics.collision import make_cells, sort_into_cells, wall_gap
from deep_contact.physics.segments import BESIDE, segment_gap, shared_end, time_to_touch
from deep_contact.state import WALL_NORMALS

FAST = 0.5
"""A circle is fast if it moves further than so many of its radii in a step."""

CLOSER = 0.5
"""Share of the distance of a deep pair, or from a wall, that one step leaves at least."""

NOTHING = -1
"""Partner of a circle that meets nothing."""


@njit(cache=True)
def any_is_fast(bodies, start):
    """Whether some circle has moved further than `FAST` radii from where it started, (n, 2), m."""
    for i in range(bodies.mass.shape[0]):
        x, y = bodies.position[i, 0] - start[i, 0], bodies.position[i, 1] - start[i, 1]
        if x * x + y * y > (FAST * bodies.radius[i]) ** 2:
            return True
    return False


@njit(cache=True, error_model="numpy")
def stop_fast(bodies, start, gravity, dt, box, segments, scales):
    """Take back, in place, what circles have moved beyond the first touch of a fast one, and the energy of its fall.

    bodies: after their move of Δt, s. start: (n, 2), where they were, m. gravity, box, segments, scales: of
    `StepInput`.
    """
    n = bodies.mass.shape[0]
    move = bodies.position - start
    if not math.isfinite(start.sum() + move.sum()):
        return  # the caller of the run says so
    longest = 0.0
    fast = np.empty(n, np.bool_)
    for i in range(n):
        length = math.sqrt(move[i, 0] * move[i, 0] + move[i, 1] * move[i, 1])
        longest = max(longest, length)
        fast[i] = length > FAST * bodies.radius[i]
    cells = make_cells(n)
    grid = sort_into_cells(start, bodies.radius, cells, 2.0 * longest)
    stop = np.ones(n)
    when = np.full(n, np.inf)
    path = (start, move, stop, bodies.radius, box, segments, scales)
    queue = [(np.inf, NOTHING)]  # of (time, circle); one whose time has changed since is passed over
    for i in range(n):
        if fast[i]:
            when[i], _ = _first_touch(i, 0.0, path, cells, grid)
            heappush(queue, (when[i], i))
    while queue[0][0] <= 1.0:
        expected, i = heappop(queue)
        if when[i] != expected:
            continue
        # Others may have stopped since this was found: it is looked for again, and later if it is not the same.
        time, other = _first_touch(i, when[i], path, cells, grid)
        if time > when[i] + 1e-12:
            when[i] = time
            heappush(queue, (time, i))
            continue
        for k in (i, other):
            if 0 <= k < n and stop[k] == 1.0:
                stop[k], when[k] = time, np.inf
                _tell_neighbours(k, time, path, cells, grid, fast, when, queue)
    for i in range(n):
        if stop[i] < 1.0:
            for axis in range(2):
                bodies.position[i, axis] = start[i, axis] + stop[i] * move[i, axis]
            take_back_fall(bodies.velocity[i], (1.0 - stop[i]) * dt, gravity)


@njit(cache=True, error_model="numpy")
def take_back_fall(velocity, time, gravity):
    """Slow a velocity, (2,), m/s, in place, by the energy of the way that it would have fallen in this time, s.

    What stops early has not lost that height: with all of its speed it would gain energy from nothing.
    """
    g = math.hypot(gravity[0], gravity[1])
    if g == 0.0:
        return
    d_x, d_y = gravity[0] / g, gravity[1] / g
    down = velocity[0] * d_x + velocity[1] * d_y
    if down > 0.0:
        change = math.sqrt(max(0.0, down * (down - 2.0 * g * time))) - down
        velocity[0] += change * d_x
        velocity[1] += change * d_y


@njit(cache=True, error_model="numpy")
def _first_touch(i, now, path, cells, grid):
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
    for s in range(segments.shape[0]):
        time = max(now, _touch_segment(i, s, path))
        if time < first:
            first, partner = time, n + 4 + s
    columns, rows = grid
    row = cells.cell[i] // columns
    column = cells.cell[i] - row * columns
    for neighbour_row in range(max(row - 1, 0), min(row + 2, rows)):
        begin = cells.start[neighbour_row * columns + max(column - 1, 0)]
        end = cells.start[neighbour_row * columns + min(column + 1, columns - 1) + 1]
        for k in cells.order[begin:end]:
            if k != i:
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
def _touch_segment(i, s, path):
    """Time of the first touch of a circle and a segment, in steps; inf without one."""
    start, move, _, radius, _, segments, scales = path
    x, y, reach = start[i, 0], start[i, 1], radius[i] + scales.wall_skin
    least = _least(segment_gap(segments[s], x, y)[0], reach, radius[i], scales)
    time, part = time_to_touch(segments[s], x, y, move[i, 0], move[i, 1], least)
    if part != BESIDE and time <= 1.0:
        # A joint is no nearer than the line: what slides along one segment does not stop at the next.
        for k in range(segments.shape[0]):
            if shared_end(segments, s, part, k) != BESIDE:
                least = min(least, _least(segment_gap(segments[k], x, y)[0], reach, radius[i], scales))
        time, _ = time_to_touch(segments[s], x, y, move[i, 0], move[i, 1], least)
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
    least = _least(math.sqrt(s_x * s_x + s_y * s_y), reach, min(radius[i], radius[k]), scales)
    beyond = p_x * p_x + p_y * p_y - least * least
    if beyond <= 0.0:
        return now
    under = approach * approach - (w_x * w_x + w_y * w_y) * beyond
    return np.inf if under < 0.0 else now + beyond / (math.sqrt(under) - approach)


@njit(cache=True, error_model="numpy")
def _tell_neighbours(k, now, path, cells, grid, fast, when, queue):
    """Let fast circles that still move know, in `when` and the queue, that this one has stopped."""
    columns, rows = grid
    row = cells.cell[k] // columns
    column = cells.cell[k] - row * columns
    stop = path[2]
    for neighbour_row in range(max(row - 1, 0), min(row + 2, rows)):
        begin = cells.start[neighbour_row * columns + max(column - 1, 0)]
        end = cells.start[neighbour_row * columns + min(column + 1, columns - 1) + 1]
        for i in cells.order[begin:end]:
            if i != k and fast[i] and stop[i] == 1.0:
                time = _touch(i, k, now, path)
                if time < when[i]:
                    when[i] = time
                    heappush(queue, (time, i))
