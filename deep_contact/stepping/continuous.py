"""Continuous collision: circles that move far in one step push on the bodies that they meet, in the order of time.

Contacts are found between circles that touch at the end of a step. A circle that moves by more than its radius can pass
through another circle, or leave the box, between the ends of two steps. The paths of fast circles are therefore
followed through the step. A path consists of straight pieces, each with its own rate, in metres a step; the first rate
is Δt v. A *touch* is an overlap of half a slop, or the distance at the start of the step if that is smaller. With n the
unit normal from a to b, and a = (u_a − u_b) · n the rate at which a pair comes nearer,

    u_a ← u_a − s n / m_a,  u_b ← u_b + s n / m_b,  s = a / (1 / m_a + 1 / m_b):

both circles go on with their common rate along n, and each keeps its own rate along the tangent, as in a plastic
impact. If the tangents would take them apart before the end of the step, around each other or around the end of a
segment, both go on with their common rate in all directions (`slip_apart`). Velocities stay as they were solved: the
next step finds the contact, and solves it. The centre of mass moves as it would have without the touch, and only
relative motions count, so that the result is the same in every inertial frame.

A wall, a segment and a fixed circle have an infinite mass. A circle that has met one of them is *held* by it: a push
towards that body only lets the circle slide along it. If no direction is left in which to slide, the circle has an
infinite mass, and holds the circle that pushes. A held circle is *firm* if the body that holds it rests. Of two circles
that are held against each other, the less firm one yields nevertheless. A moving segment or fixed circle that runs into
a firm circle passes over it.

Slow approaches are left to the contacts (`PAIRS`, `HELD`). Simultaneous touches are handled together, and share the
masses of their circles among them, so that no order is preferred. (Box2D 2.3 stops circles at walls and bullets,
`b2World::SolveTOI`, which loses the rest of their step.)
"""

from __future__ import annotations

import math
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import WALL_NORMALS
from deep_contact.stepping.broad_phase import make_cells, smallest_of, sort_level, sum_of
from deep_contact.stepping.contacts import wall_gap
from deep_contact.stepping.segment_grid import BESIDE, ON, START, is_free, near_box, segment_gap
from deep_contact.stepping.segments import carried, crossing, hides, moves, time_to_touch

FAST = 0.5
"""A circle is fast if it moves farther in a step than this share of its radius, relative to a wall."""

PAIRS = 0.5
"""A pair of circles touches only where it approaches by more than this share of the smaller radius in a step."""

HELD = 0.01
"""The share in place of `PAIRS` if one of the two circles is held, and for walls and segments."""

FREE, CARRIED, FIRM = range(3)
"""Values of `Paths.held`: not held; held by a moving body; held by a body at rest."""

BLOCKED = 0.999
"""Cosine of the angle between a push and the direction to the holding body, from which on the circle does not yield."""

TOGETHER = 1e-9
"""Largest difference of the times of simultaneous touches, in steps."""

MOST_TOUCHES = 200
"""Largest number of touches of a circle in a step. Later approaches are left to the contacts of the next step."""


class Paths(NamedTuple):
    """The last pieces of the paths of n circles, and the box and segments of the step. Times are in steps.

    | field    | meaning                                                  | shape  | unit |
    |----------|----------------------------------------------------------|--------|------|
    | start    | centre at the start of the step                          | (n, 2) | m    |
    | place    | centre at the start of the piece                         | (n, 2) | m    |
    | since    | time at the start of the piece                           | (n,)   | –    |
    | rate     | displacement in a whole step                             | (n, 2) | m    |
    | inverse  | inverse mass                                             | (n,)   | 1/kg |
    | held     | `FREE`, `CARRIED` or `FIRM`                              | (n,)   | –    |
    | block    | unit vector to the body that holds the circle            | (n, 2) | –    |
    | touches  | number of changes of the path                            | (n,)   | –    |
    | radius   | radius                                                   | (n,)   | m    |

    box, segments, scales: of the step; the segments are at their positions at its end.
    """

    start: np.ndarray
    place: np.ndarray
    since: np.ndarray
    rate: np.ndarray
    inverse: np.ndarray
    held: np.ndarray
    block: np.ndarray
    touches: np.ndarray
    radius: np.ndarray
    box: tuple
    segments: tuple
    scales: tuple


@njit(cache=True, error_model="numpy")
def any_fast(solver_bodies, radius, dt):
    """Whether a circle is fast with these velocities, relative to bodies at rest or to the other circles."""
    n, far = radius.shape[0], False
    least = 0.5 * PAIRS * smallest_of(radius) / dt
    for i in range(n):
        v_x, v_y = solver_bodies[i, 0], solver_bodies[i, 1]
        far |= v_x * v_x + v_y * v_y > least * least
    if not far:
        return False  # then no two circles approach by more than twice `least`
    for i in range(n):
        v_x, v_y = solver_bodies[i, 0], solver_bodies[i, 1]
        if v_x * v_x + v_y * v_y > (FAST * radius[i] / dt) ** 2:
            return True
    return any_apart(solver_bodies, radius, dt)


@njit(cache=True, error_model="numpy")
def any_apart(velocity, radius, dt):
    """Whether velocities, (n, 2 or more), differ so much from their middle that two circles can touch (`PAIRS`)."""
    x, y = middle_of(velocity, radius.shape[0])
    apart = False
    for i in range(radius.shape[0]):
        apart |= (velocity[i, 0] - x) ** 2 + (velocity[i, 1] - y) ** 2 > (0.5 * PAIRS * radius[i] / dt) ** 2
    return apart


@njit(cache=True, fastmath={"nnan", "nsz"})
def middle_of(values, n):
    """The middle of the bounding box of the first n points, (n, 2 or more)."""
    x_min = x_max = values[0, 0]
    y_min = y_max = values[0, 1]
    for i in range(n):
        x, y = values[i, 0], values[i, 1]
        x_min, x_max, y_min, y_max = min(x_min, x), max(x_max, x), min(y_min, y), max(y_max, y)
    return 0.5 * (x_min + x_max), 0.5 * (y_min + y_max)


@njit(cache=True, error_model="numpy")
def collide_fast(step, start, segments, actuation, shifts):
    """Let fast circles push on what they meet within a step, in place on positions, and on velocities if e > 0.

    step: `StepInput`, whose bodies have moved by Δt v. start: centres before this motion, (n, 2), m. segments: after
    their motion. actuation: `Actuation` of the step, or None. shifts: of `StepLog`.
    """
    bodies, n = step.bodies, step.bodies.mass.shape[0]
    rate = moved(bodies.position, start, -1.0)
    if not math.isfinite(sum_of(start) + sum_of(rate)):
        return  # the run raises an error
    paths = Paths(
        start, start.copy(), np.zeros(n), rate, 1.0 / bodies.mass, np.zeros(n, np.int64), np.zeros((n, 2)),
        np.zeros(n, np.int64), bodies.radius, step.box, segments, step.scales,
    )  # fmt: skip
    searches = np.zeros((n, 2), np.bool_)  # whether a circle searches walls and segments, and circles
    choose_fast(paths, searches, actuation, step.dt)
    if not searches.any():
        return
    swept = sort_swept(paths)
    queue = [(np.inf, -1, -1, -1, -1)]
    for i in range(n):
        if searches[i, 0] or searches[i, 1]:
            find_touch(i, 0.0, searches, paths, swept, queue, actuation, step.dt)
    first, second, changed = np.empty(8 * n, np.int64), np.empty(8 * n, np.int64), np.empty(n, np.int64)
    while queue[0][0] <= 1.0:
        time, count = queue[0][0], 0
        while queue[0][0] <= time + TOGETHER and count < 8 * n:
            _, i, k, touches_i, touches_k = heappop(queue)
            if paths.touches[i] != touches_i:
                continue  # circle i has been searched anew since
            if k < n and paths.touches[k] != touches_k:
                find_touch(i, time, searches, paths, swept, queue, actuation, step.dt)
                continue
            first[count], second[count] = i, k
            count += 1
        count = share_momentum(first[:count], second[:count], time, step, paths, changed, actuation, shifts)
        for i in changed[:count]:
            searches[i] = True
            follow(i, paths, swept)
        for i in changed[:count]:
            find_touch(i, time, searches, paths, swept, queue, actuation, step.dt)
    for i in range(n):
        if paths.touches[i] > 0:
            for axis in range(2):
                bodies.position[i, axis] = paths.place[i, axis] + (1.0 - paths.since[i]) * rate[i, axis]


@njit(cache=True, error_model="numpy")
def choose_fast(paths, searches, actuation, dt):
    """Mark in `searches`, (n, 2), in place, the fast circles: they search walls and segments, and other circles.

    A circle is fast relative to walls and to moving segments near it, or relative to the mean motion of all circles.
    """
    rate, radius, n = paths.rate, paths.radius, paths.radius.shape[0]
    mean_x = mean_y = 0.0
    for i in range(n):
        mean_x, mean_y = mean_x + rate[i, 0] / n, mean_y + rate[i, 1] / n
        if paths.inverse[i] > 0.0:
            searches[i, 0] = rate[i, 0] ** 2 + rate[i, 1] ** 2 > (FAST * radius[i]) ** 2
        else:
            paths.held[i] = CARRIED if rate[i, 0] != 0.0 or rate[i, 1] != 0.0 else FIRM
    if any_apart(rate, radius, 1.0):
        for i in range(n):
            apart = (rate[i, 0] - mean_x) ** 2 + (rate[i, 1] - mean_y) ** 2
            searches[i, 1] = apart > (0.5 * PAIRS * radius[i]) ** 2
    if actuation is not None:
        choose_near_moving(paths, searches, actuation, dt)


@njit(cache=True, error_model="numpy")
def choose_near_moving(paths, searches, actuation, dt):
    """Mark circles with a long path relative to a moving segment near it, in place: they search walls and segments."""
    start, rate, radius, line = paths.start, paths.rate, paths.radius, paths.segments.line
    for s in actuation.moving:
        for i in range(radius.shape[0]):
            to_x, to_y = start[i, 0] + rate[i, 0], start[i, 1] + rate[i, 1]
            x, y = carried(line, actuation.wall, s, dt, start[i, 0], start[i, 1])
            reach = radius[i] + paths.scales.wall_skin
            if (
                max(x, to_x) + reach >= min(line[s, 0], line[s, 2])
                and min(x, to_x) - reach <= max(line[s, 0], line[s, 2])
                and max(y, to_y) + reach >= min(line[s, 1], line[s, 3])
                and min(y, to_y) - reach <= max(line[s, 1], line[s, 3])
                and paths.inverse[i] > 0.0
            ):
                searches[i, 0] |= (to_x - x) ** 2 + (to_y - y) ** 2 > (FAST * radius[i]) ** 2


@njit(cache=True)
def moved(points, by, share):
    """points + share · by, (n, 2) each. The loop compiles in less time than NumPy's expression."""
    result = np.empty_like(points)
    for i in range(points.shape[0]):
        for axis in range(2):
            result[i, axis] = points[i, axis] + share * by[i, axis]
    return result


@njit(inline="always")
def place_at(paths, i, time):
    """Centre (x, y) of circle i at a time of the last piece of its path, m."""
    flown = time - paths.since[i]
    return paths.place[i, 0] + flown * paths.rate[i, 0], paths.place[i, 1] + flown * paths.rate[i, 1]


class Swept(NamedTuple):
    """Broad phase of paths: boxes around their last pieces, sorted into cells by the middles of their first pieces."""

    start: np.ndarray  # of `Cells`
    order: np.ndarray  # of `Cells`
    rank: np.ndarray  # (n,): place of each circle in `order`
    middle: np.ndarray  # (n, 2): middle of the first piece of each path, m
    box: np.ndarray  # (n, 4): x_min, x_max, y_min, y_max of each box, m, in the order of `order`
    farthest: np.ndarray  # (2,): largest distances of the sides of a box from the middle of its path, m
    grid: np.ndarray  # of `Cells`
    found: np.ndarray  # (n,): buffer for circles
    times: np.ndarray  # (n,): buffer for times of touches


_make_cells = njit(cache=True)(make_cells)


@njit(cache=True, error_model="numpy")
def sort_swept(paths):
    """The `Swept` of paths at the start of a step."""
    n = paths.radius.shape[0]
    cells, rank = _make_cells(n), np.empty(n, np.int64)
    middle = moved(paths.start, paths.rate, 0.5)
    cells.level[:] = 0
    sort_level(np.int64(0), middle, paths.radius, 0.0, np.int64(0), np.int64(0), cells)
    for k in range(n):
        rank[cells.order[k]] = k
    found, times, box = np.empty(n, np.int64), np.empty(n), np.empty((n, 4))
    swept = Swept(cells.start, cells.order, rank, middle, box, np.zeros(2), cells.grid, found, times)
    for i in range(n):
        follow(i, paths, swept)
    return swept


@njit(cache=True)
def follow(i, paths, swept):
    """Put the box of circle i around the last piece of its path, in place."""
    radius, k, rest = paths.radius[i], swept.rank[i], 1.0 - paths.since[i]
    for axis in range(2):
        x, middle = paths.place[i, axis], swept.middle[i, axis]
        to_x = x + rest * paths.rate[i, axis]
        low, high = min(x, to_x) - radius, max(x, to_x) + radius
        swept.box[k, 2 * axis], swept.box[k, 2 * axis + 1] = low, high
        swept.farthest[axis] = max(swept.farthest[axis], high - middle, middle - low)


@njit(cache=True, error_model="numpy")
def crossing_paths(i, now, paths, swept):
    """Circles whose boxes cross the path of circle i from time `now` on: no other circle can touch it in this step."""
    radius, (x, y) = paths.radius[i], place_at(paths, i, now)
    to_x, to_y = place_at(paths, i, 1.0)
    x_min, x_max = min(x, to_x) - radius, max(x, to_x) + radius
    y_min, y_max = min(y, to_y) - radius, max(y, to_y) + radius
    grid, box, found, count = swept.grid[0], swept.box, swept.found, 0
    columns, per_metre, (far_x, far_y) = grid["columns"], grid["per_metre"], swept.farthest
    # Rounding is less than a cell's millionth.
    left = int(max((x_min - far_x - grid["x"]) * per_metre - 1e-6, 0.0))
    right = int(min((x_max + far_x - grid["x"]) * per_metre + 1e-6, columns - 1.0))
    low = int(max((y_min - far_y - grid["y"]) * per_metre - 1e-6, 0.0))
    high = int(min((y_max + far_y - grid["y"]) * per_metre + 1e-6, grid["rows"] - 1.0))
    for row in range(low, high + 1):
        for k in range(swept.start[row * columns + left], swept.start[row * columns + right + 1]):
            found[count] = swept.order[k]  # counted without a branch, which could not be predicted
            crosses = (box[k, 0] <= x_max) & (box[k, 1] >= x_min) & (box[k, 2] <= y_max) & (box[k, 3] >= y_min)
            count += crosses & (found[count] != i)
    return found[:count]


@njit(cache=True, error_model="numpy")
def find_touch(i, now, searches, paths, swept, queue, actuation, dt):
    """Queue the first touches of circle i from time `now` on, as (time, i, partner, touches of both so far)."""
    if paths.touches[i] >= MOST_TOUCHES:
        return
    first = np.inf
    if searches[i, 0] and paths.inverse[i] > 0.0:
        first, wall = touch_walls(i, now, paths, actuation, dt)
        if first <= 1.0:
            heappush(queue, (first, i, wall, paths.touches[i], 0))
    if searches[i, 1]:
        others, times = crossing_paths(i, now, paths, swept), swept.times
        for j in range(others.shape[0]):
            times[j] = touch_circle(i, others[j], now, paths)
            first = min(first, times[j])
        for j in range(others.shape[0]):
            if times[j] <= min(first + TOGETHER, 1.0):
                heappush(queue, (times[j], i, others[j], paths.touches[i], paths.touches[others[j]]))


@njit(cache=True, error_model="numpy")
def touch_walls(i, now, paths, actuation, dt):
    """(time, partner) of the first touch of circle i with a wall or a segment from time `now` on, or (inf, −1)."""
    radius, scales, segments, n = paths.radius[i], paths.scales, paths.segments, paths.radius.shape[0]
    rate_x, rate_y, (x, y) = paths.rate[i, 0], paths.rate[i, 1], place_at(paths, i, now)
    first, partner = np.inf, -1
    if paths.touches[i] > 0 or rate_x * rate_x + rate_y * rate_y > (FAST * radius) ** 2:
        for wall in range(4):
            rate = rate_x * WALL_NORMALS[wall, 0] + rate_y * WALL_NORMALS[wall, 1]
            before = wall_gap(paths.start[i, 0], paths.start[i, 1], paths.box, wall)
            # A circle that began outside of the wall may come in.
            if rate > HELD * radius and before > 0.0:
                least = min(before, radius + scales.wall_skin - touching_overlap(radius, scales))
                time = now + max(0.0, (wall_gap(x, y, paths.box, wall) - least) / rate)
                if time < first:
                    first, partner = time, n + wall
        to_x, to_y = place_at(paths, i, 1.0)
        way = min(x, to_x), max(x, to_x), min(y, to_y), max(y, to_y)
        if not is_free(segments.start, segments.grid, *way):
            for s in near_box(segments, *way, np.empty_like(segments.every)):
                if actuation is not None:
                    if moves(actuation.wall, s):
                        continue
                time = touch_segment(i, s, now, paths, None, dt)
                if time < first:
                    first, partner = time, n + 4 + s
    if actuation is not None:
        if paths.held[i] != FIRM:
            for s in actuation.moving:
                time = touch_segment(i, s, now, paths, actuation, dt)
                if time < first:
                    first, partner = time, n + 4 + s
    return first, partner


@njit(inline="always")
def touching_overlap(radius, scales):
    """Overlap of a touch, m, with which the next step finds a contact."""
    return min(0.5 * scales.slop, 0.1 * radius)


@njit(cache=True, error_model="numpy")
def piece_beside(i, s, now, paths, actuation, dt):
    """((x, y), (m_x, m_y)): start and rest of the path of circle i from time `now` on, relative to segment s, m.

    actuation: `Actuation` of the step; None for a segment at rest.
    """
    (x, y), (to_x, to_y) = place_at(paths, i, now), place_at(paths, i, 1.0)
    if actuation is not None:
        x, y = carried(paths.segments.line, actuation.wall, s, (1.0 - now) * dt, x, y)
    return (x, y), (to_x - x, to_y - y)


@njit(cache=True, error_model="numpy")
def touch_segment(i, s, now, paths, actuation, dt):
    """Time of the first touch of circle i with segment s from time `now` on, in steps, or infinity.

    actuation: `Actuation` of the step; None for a segment at rest.
    """
    line, radius, rest = paths.segments.line, paths.radius[i], 1.0 - now
    reach, (start_x, start_y) = radius + paths.scales.wall_skin, (paths.start[i, 0], paths.start[i, 1])
    (x, y), (m_x, m_y) = piece_beside(i, s, now, paths, actuation, dt)
    e_x, e_y = line[s, 2] - line[s, 0], line[s, 3] - line[s, 1]
    before = e_x * (y - line[s, 1]) - e_y * (x - line[s, 0])
    after = before + e_x * m_y - e_y * m_x
    if before * after > 0.0 and min(before * before, after * after) > reach * reach * (e_x * e_x + e_y * e_y):
        return np.inf  # the whole path is on one side of the line, and beyond reach of it
    far = paths.touches[i] > 0 or m_x * m_x + m_y * m_y > (FAST * radius * rest) ** 2
    if not far or rest <= 0.0:
        return np.inf
    if actuation is not None:
        start_x, start_y = carried(line, actuation.wall, s, dt, start_x, start_y)
    touching = reach - touching_overlap(radius, paths.scales)
    least = min(touching, segment_gap(line[s], start_x, start_y)[0], segment_gap(line[s], x, y)[0])
    share, part = time_to_touch(line[s], x, y, m_x, m_y, least)
    if part != BESIDE and share <= 1.0:
        # An end on a surface is no nearer than the surface: a circle that slides along one segment does not touch the
        # end of the next.
        end, column = 2 * s + part - START, 2 * (part - START)
        e_x, e_y, hiding, first = line[s, column], line[s, column + 1], paths.segments.hiding, paths.segments.first
        for k in hiding[first[end] : first[end + 1]]:
            if hides(line[k], e_x, e_y, x, y, reach):
                least = min(least, segment_gap(line[k], start_x, start_y)[0], segment_gap(line[k], x, y)[0])
        for wall in range(4):
            if wall_gap(e_x, e_y, paths.box, wall) <= ON * reach:
                least = min(least, wall_gap(start_x, start_y, paths.box, wall), wall_gap(x, y, paths.box, wall))
        share, _ = time_to_touch(line[s], x, y, m_x, m_y, least)
    if share > 1.0:
        return np.inf
    _, n_x, n_y = segment_gap(line[s], x + share * m_x, y + share * m_y)
    return now + share * rest if m_x * n_x + m_y * n_y > HELD * radius * rest else np.inf


@njit(cache=True, error_model="numpy")
def touch_circle(i, k, now, paths):
    """Time of the first touch of circles i and k from time `now` on, in steps, or infinity."""
    start, rate, held = paths.start, paths.rate, paths.held
    (x_i, y_i), (x_k, y_k) = place_at(paths, i, now), place_at(paths, k, now)
    p_x, p_y, w_x, w_y = x_k - x_i, y_k - y_i, rate[k, 0] - rate[i, 0], rate[k, 1] - rate[i, 1]
    along = p_x * w_x + p_y * w_y
    if not along < 0.0:
        return np.inf
    reach, smaller = paths.radius[i] + paths.radius[k], min(paths.radius[i], paths.radius[k])
    missed, w = p_x * p_x + p_y * p_y - reach * reach, w_x * w_x + w_y * w_y
    if along * along < w * missed:
        return np.inf  # the test below, without a root, for the larger distance `reach`
    is_fixed_i, is_fixed_k = paths.inverse[i] == 0.0, paths.inverse[k] == 0.0
    if (is_fixed_i and held[k] > held[i]) or (is_fixed_k and held[i] > held[k]) or (is_fixed_i and is_fixed_k):
        return np.inf  # a fixed circle passes over a firmer circle, and over another fixed one
    if paths.touches[k] >= MOST_TOUCHES:
        return np.inf
    least, slowest = reach - touching_overlap(smaller, paths.scales), PAIRS * smaller
    s_x, s_y = start[k, 0] - start[i, 0], start[k, 1] - start[i, 1]
    square = min(least * least, s_x * s_x + s_y * s_y)
    if held[i] != FREE or held[k] != FREE:
        slowest = HELD * smaller
    beyond = p_x * p_x + p_y * p_y - square
    if beyond <= 0.0:
        return now if along * along > slowest * slowest * (p_x * p_x + p_y * p_y) else np.inf
    under = along * along - w * beyond
    return now + beyond / (math.sqrt(under) - along) if under > slowest * slowest * square else np.inf


@njit(cache=True, error_model="numpy")
def share_momentum(first, second, time, step, paths, changed, actuation, shifts):
    """Change the paths of circles at simultaneous touches, in place. Returns how many circles `changed` lists.

    first, second: a circle and its partner in each touch, (k,) each. A circle shares its mass among its touches.
    """
    touches, count, n = first.shape[0], 0, paths.radius.shape[0]
    normal, approach, yielding = np.empty((touches, 2)), np.empty(touches), np.empty((touches, 2, 3))
    shares, slip, given = np.zeros(n), np.empty((touches, 2)), np.empty((2, 2))
    for j in range(touches):
        i, k = first[j], second[j]
        normal[j, 0], normal[j, 1], approach[j] = approach_of(i, k, time, paths, actuation, step.dt)
        slip[j, 0], slip[j, 1] = slip_apart(i, k, normal[j], time, paths, actuation, step.dt)
        yield_along(i, k, normal[j], paths, yielding[j])
        for side, c in ((0, i), (1, k)):
            if yielding[j, side, 0] > 0.0:
                if shares[c] == 0.0:
                    changed[count] = c
                    count += 1
                shares[c] += 1.0
    for c in changed[:count]:
        paths.place[c, 0], paths.place[c, 1] = place_at(paths, c, time)
        paths.since[c] = time
        paths.touches[c] += 1
    for j in range(touches):
        i, k, (w_i, w_k) = first[j], second[j], (yielding[j, 0, 0], yielding[j, 1, 0])
        s = approach[j] / ((shares[i] * w_i if w_i > 0.0 else 0.0) + (shares[k] * w_k if w_k > 0.0 else 0.0))
        for side in range(2):
            for axis in range(2):
                given[side, axis] = s * yielding[j, side, 1 + axis] if yielding[j, side, 0] > 0.0 else 0.0
        give_slip(i, k, slip[j], yielding[j], shares, paths, given)
        for side, c in ((0, i), (1, k)):
            if yielding[j, side, 0] > 0.0:
                for axis in range(2):
                    paths.rate[c, axis] += paths.inverse[c] * given[side, axis]
        if w_k == 0.0:
            hold(i, normal[j], 1.0, hold_of(k, paths, actuation), paths)
        elif w_i == 0.0:
            hold(k, normal[j], -1.0, paths.held[i], paths)
        if step.restitution > 0.0:
            keep_energy(i, k, 1.0 - time, given, normal[j], approach[j], yielding[j], step, paths, actuation, shifts)
    return count


@njit(cache=True, error_model="numpy")
def slip_apart(i, k, normal, time, paths, actuation, dt):
    """Rate of circle i along the tangent of its touch with body k, relative to that body, (x, y), m a step.

    It is 0 if this motion would leave the two within reach of a contact until the end of the step.
    """
    n, rest, line = paths.radius.shape[0], 1.0 - time, paths.segments.line
    if n <= k < n + 4 or rest <= 0.0:
        return 0.0, 0.0
    (x, y), radius, smaller = place_at(paths, i, time), paths.radius[i], paths.radius[i]
    if k < n:
        x_k, y_k = place_at(paths, k, time)
        x, y, smaller = x - x_k, y - y_k, min(radius, paths.radius[k])
        reach, m_x, m_y = radius + paths.radius[k], rest * paths.rate[i, 0], rest * paths.rate[i, 1]
        m_x, m_y = m_x - rest * paths.rate[k, 0], m_y - rest * paths.rate[k, 1]
    else:
        s, reach = k - n - 4, radius + paths.scales.wall_skin
        (x, y), (m_x, m_y) = piece_beside(i, s, time, paths, None, dt)
        if actuation is not None:
            if moves(actuation.wall, s):
                (x, y), (m_x, m_y) = piece_beside(i, s, time, paths, actuation, dt)
    across = m_x * normal[0] + m_y * normal[1]
    m_x, m_y = m_x - across * normal[0], m_y - across * normal[1]
    least = reach - 0.5 * touching_overlap(smaller, paths.scales)
    if k < n:
        parts = math.hypot(x + m_x, y + m_y) > least
    else:
        parts = segment_gap(line[s], x + m_x, y + m_y)[0] > least
        if parts:  # unless a segment or a wall on which it ends has the contact, or stops the circle
            hiding, first = paths.segments.hiding, paths.segments.first
            for other in hiding[first[2 * s] : first[2 * s + 2]]:
                parts &= segment_gap(line[other], x + m_x, y + m_y)[0] > least
                parts &= crossing(line[other], x, y, x + m_x, y + m_y) == np.inf
            for wall in range(4):
                parts &= wall_gap(x + m_x, y + m_y, paths.box, wall) > least
    return (m_x / rest, m_y / rest) if parts else (0.0, 0.0)


@njit(cache=True, error_model="numpy")
def give_slip(i, k, slip, yielding, shares, paths, given):
    """Add to `given`, (2, 2), in place, what ends the slip of circle i along body k: kg m a step for each of the two.

    slip: of `slip_apart`. yielding, shares: of `share_momentum`. Circles that do not yield are left as they are.
    """
    rate = math.hypot(slip[0], slip[1])
    if rate == 0.0:
        return
    along, w = np.zeros((2, 3)), 0.0
    for side, c, sign in ((0, i, -1.0), (1, k, 1.0)):
        if yielding[side, 0] > 0.0:
            mobility(c, sign * slip[0] / rate, sign * slip[1] / rate, paths, along[side])
            if along[side, 0] > 0.0:
                w += shares[c] * along[side, 0]
    for side in range(2):
        if along[side, 0] > 0.0:
            for axis in range(2):
                given[side, axis] += rate / w * along[side, 1 + axis]


@njit(inline="always")
def hold(i, normal, sign, by, paths):
    """Mark circle i as held by a body in the direction of the normal times the sign, in place. by: how it is held."""
    paths.held[i] = max(paths.held[i], by)
    paths.block[i, 0], paths.block[i, 1] = sign * normal[0], sign * normal[1]


@njit(cache=True, error_model="numpy")
def yield_along(i, k, normal, paths, yielding):
    """Write the `mobility` of circle i along −normal, and of body k along +normal, into `yielding`, (2, 3).

    If neither can move, the circle with the lower `Paths.held` moves as if it were free. If both have the same value,
    both circles do.
    """
    n, inverse = paths.radius.shape[0], paths.inverse
    mobility(i, -normal[0], -normal[1], paths, yielding[0])
    yielding[1, 0] = 0.0
    if k < n:
        mobility(k, normal[0], normal[1], paths, yielding[1])
    if yielding[0, 0] == 0.0 and yielding[1, 0] == 0.0:
        if inverse[i] > 0.0 and (k >= n or paths.held[i] <= paths.held[k] or inverse[min(k, n - 1)] == 0.0):
            yielding[0, 0], yielding[0, 1], yielding[0, 2] = inverse[i], -normal[0], -normal[1]
        if k < n and inverse[min(k, n - 1)] > 0.0 and (paths.held[k] <= paths.held[i] or inverse[i] == 0.0):
            yielding[1, 0], yielding[1, 1], yielding[1, 2] = inverse[k], normal[0], normal[1]


@njit(inline="always")
def mobility(i, d_x, d_y, paths, result):
    """Write (w, x, y) of circle i, which is pushed along a unit vector d: its rate changes by 1/m (x, y), along d by w.

    A held circle slides along the body that holds it. If d points almost straight at that body, w is 0.
    """
    w, x, y = paths.inverse[i], d_x, d_y
    along = d_x * paths.block[i, 0] + d_y * paths.block[i, 1]
    if along > 0.0 and paths.held[i] != FREE:
        x, y = d_x - along * paths.block[i, 0], d_y - along * paths.block[i, 1]
        w = w * (1.0 - along * along) if along < BLOCKED else 0.0
    result[0], result[1], result[2] = w, x, y


@njit(inline="always")
def hold_of(k, paths, actuation):
    """Hold of body k on a circle: for a wall or segment `CARRIED` or `FIRM`, for a circle its own hold (`held`)."""
    n = paths.radius.shape[0]
    if k < n:
        return paths.held[k]
    if actuation is not None:
        if k >= n + 4 and moves(actuation.wall, k - n - 4):
            return CARRIED
    return FIRM


@njit(cache=True, error_model="numpy")
def approach_of(i, k, time, paths, actuation, dt):
    """(n_x, n_y, rate): unit normal from circle i to body k, and the rate at which i approaches k, m a step."""
    n, rate = paths.radius.shape[0], paths.rate
    if k < n:
        (x_i, y_i), (x_k, y_k) = place_at(paths, i, time), place_at(paths, k, time)
        distance = math.hypot(x_k - x_i, y_k - y_i)
        n_x, n_y = (x_k - x_i) / distance, (y_k - y_i) / distance
        return n_x, n_y, (rate[i, 0] - rate[k, 0]) * n_x + (rate[i, 1] - rate[k, 1]) * n_y
    if k < n + 4:
        n_x, n_y = WALL_NORMALS[k - n, 0], WALL_NORMALS[k - n, 1]
        return n_x, n_y, rate[i, 0] * n_x + rate[i, 1] * n_y
    s = k - n - 4
    (x, y), (m_x, m_y) = piece_beside(i, s, time, paths, None, dt)
    if actuation is not None:
        if moves(actuation.wall, s):
            (x, y), (m_x, m_y) = piece_beside(i, s, time, paths, actuation, dt)
    _, n_x, n_y = segment_gap(paths.segments.line[s], x, y)
    return n_x, n_y, (m_x * n_x + m_y * n_y) / (1.0 - time)


@njit(cache=True, error_model="numpy")
def keep_energy(i, k, rest, given, normal, approach, yielding, step, paths, actuation, shifts):
    """Correct the velocity of circle i, or of circle k if that is heavier, in place: a touch has to keep their energy.

    The circles have the velocities that gravity and pushes give in a whole step. A touch changes how far they move
    along gravity and pushes in it, and so their potential energy: without the correction, the total would change.
    Velocities are half a step behind positions. rest: of the step. given: impulses of the touch on the rates of the
    two, (2, 2), kg m a step. approach: rate of approach before the touch, m a step. The change of momentum is added to
    shifts, (n, 2), N·s, if these are logged.
    """
    bodies, dt, n, gained, g = step.bodies, step.dt, paths.radius.shape[0], 0.0, 0.0
    is_second = yielding[1, 0] > 0.0 and (yielding[0, 0] == 0.0 or bodies.mass[min(k, n - 1)] > bodies.mass[i])
    heavier = k if is_second else i
    for side, c in ((0, i), (1, k)):
        if yielding[side, 0] > 0.0:
            for axis in range(2):
                force = bodies.mass[c] * step.gravity[axis]
                if actuation is not None:
                    force += actuation.force[c, axis]
                gained += force / bodies.mass[c] * rest * given[side, axis]
                if c == heavier:
                    g += force / bodies.mass[c] * normal[axis] * (1.0 - 2.0 * side)
    sign = -1.0 if is_second else 1.0
    v = approach / dt + 0.5 * dt * g
    change = math.copysign(math.sqrt(max(0.0, v * v + 2.0 * gained / bodies.mass[heavier])), v) - v
    for axis in range(2):
        bodies.velocity[heavier, axis] += sign * change * normal[axis]
        if shifts.shape[0] > 0:
            shifts[heavier, axis] += bodies.mass[heavier] * sign * change * normal[axis]
