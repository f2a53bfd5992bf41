"""Continuous collision: circles that move far in one step push on the bodies that they meet, in the order of time.

Contacts are found between circles that touch at the end of a step. Between the ends of two steps, a circle that moves
by more than its radius can pass through another circle, or leave the box. Therefore the paths of fast circles are
followed through the step. A path consists of straight pieces. Each piece has its own rate: the displacement in a whole
step, m. The first rate is Δt v. Times are counted from the beginning of the step, in units of the step.

A touch is the moment at which two bodies overlap by half a slop, or by a tenth of the smaller radius if that is less.
If two bodies overlap more than that at the start of the step, the touch is the moment at which their distance would
become smaller than at the start. Let n be the unit normal from circle a to body b, u_a and u_b their rates, and c the
rate at which they approach, c = (u_a − u_b) · n. A touch changes the rates:

    u_a ← u_a − s n / m_a,  u_b ← u_b + s n / m_b,  s = c / (1 / m_a + 1 / m_b).

As in a plastic impact, both circles go on with their common rate along n, and each keeps its own rate along the
tangent. If the tangential motion would take them apart before the end of the step, around each other or around the end
of a segment, both go on with their common rate in all directions (`slip_apart`).

Velocities stay as they were solved: the next step finds the contact, and solves it. Only if e > 0 are they corrected,
for the energy (`keep_energy`). The centre of mass moves as it would have moved without the touch. Only relative motions
count, so that the result is the same in every inertial frame.

A wall, a segment and a fixed circle have an infinite mass. A circle that has met one of them is called held by it: a
push towards that body only lets the circle slide along it. If no direction is left in which the circle can slide, the
circle has an infinite mass, too, and holds the circle that pushes on it. A held circle is called firm if the body that
holds it is at rest. If two circles are held against each other so that neither can move, the circle that is less firm
moves nevertheless. A moving segment or fixed circle that runs into a firm circle passes over it.

Slow approaches are left to the contacts of the next step, which saves time (`PAIRS`, `FIXED`). Simultaneous touches are
handled together, and share the masses of their circles, so that the order of the circles does not matter. (Box2D 2.3
stops circles at walls and bullets, `b2World::SolveTOI`. The stopped circles lose the rest of their step.)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.broad_phase import smallest_of, sum_of
from deep_contact.stepping.pairs import largest_of, pass_through
from deep_contact.stepping.paths import (
    CARRIED,
    FIRM,
    FREE,
    bound_path,
    crossing_paths,
    make_paths,
    place_at,
    sort_swept,
)
from deep_contact.stepping.segments import carried, is_moving
from deep_contact.stepping.touch_queue import (
    add_touch,
    clear_touches,
    make_queue,
    next_circle,
    next_time,
    pop_touch,
    queue_circle,
)
from deep_contact.stepping.touches import FAST, MOST_TOUCHES, PAIRS, approach_of, slip_apart, touch_circle, touch_walls

BLOCKED = 0.999
"""Largest cosine of the angle between a push on a held circle and the direction to the body that holds it.

With a larger cosine the circle does not move."""

TOGETHER = 1e-9
"""Largest difference of the times of touches that count as simultaneous, in units of the step."""


NORMAL, SLIP = range(2)
"""Indices of the two directions of a touch: its normal, and the direction of the slip (`slip_apart`)."""


class Touches(NamedTuple):
    """Simultaneous touches, each of a circle i with a body k. Their number is at most 8 n for n circles."""

    first: np.ndarray  # (8 n,): index of circle i
    second: np.ndarray  # (8 n,): index of body k, as in `Contacts.body_b`
    direction: np.ndarray  # (2, 8 n, 2): unit vectors: `NORMAL` from i to k, and `SLIP`, in which i slips along k
    rate: np.ndarray  # (2, 8 n): rates of i relative to k in these two directions, m per step
    yielding: np.ndarray  # (2, 8 n, 2, 3): for each direction, `mobility` of i against it and of k along it
    shares: np.ndarray  # (n,): number of touches among which each circle shares its mass
    popped: np.ndarray  # (8 n,): indices of the circles whose touches were taken from the queue
    changed: np.ndarray  # (9 n,): indices of circles whose paths change; then of circles that need a new search


@njit(cache=True)
def make_touches(n):
    """Return `Touches` for n circles, uninitialised."""
    body, changed, shares = np.empty((3, 8 * n), np.int64), np.empty(9 * n, np.int64), np.empty(n)
    direction, rate, yielding = np.empty((2, 8 * n, 2)), np.empty((2, 8 * n)), np.empty((2, 8 * n, 2, 3))
    return Touches(body[0], body[1], direction, rate, yielding, shares, body[2], changed)


@njit(cache=True, error_model="numpy")
def any_fast(solver_bodies, radius, dt):
    """Return whether any circle is fast relative to bodies at rest (`FAST`), or to other circles (`any_apart`).

    solver_bodies: (N, 4), with the velocities of n circles in its first two columns, m/s. radius: (n,), m. dt: Δt, s.
    """
    n, far = radius.shape[0], False
    least = 0.5 * PAIRS * smallest_of(radius) / dt
    for i in range(n):
        v_x, v_y = solver_bodies[i, 0], solver_bodies[i, 1]
        far |= v_x * v_x + v_y * v_y > least * least
    if not far:
        return False  # no two circles approach each other faster than twice `least`
    for i in range(n):
        v_x, v_y = solver_bodies[i, 0], solver_bodies[i, 1]
        if v_x * v_x + v_y * v_y > (FAST * radius[i] / dt) ** 2:
            return True
    return any_apart(solver_bodies, radius, dt)


@njit(cache=True, error_model="numpy")
def any_apart(velocity, radius, dt):
    """Return whether two circles may approach each other fast enough for a touch (`PAIRS`).

    They may if any velocity differs enough from the middle of all velocities. velocity: (n, 2 or more), m/s. radius:
    (n,), m. dt: Δt, s.
    """
    x, y = middle_of(velocity, radius.shape[0])
    apart = False
    for i in range(radius.shape[0]):
        apart |= (velocity[i, 0] - x) ** 2 + (velocity[i, 1] - y) ** 2 > (0.5 * PAIRS * radius[i] / dt) ** 2
    return apart


@njit(cache=True, fastmath={"nnan", "nsz"})
def middle_of(values, n):
    """Return the middle (x, y) of the bounding box of the first n points.

    values: coordinates of points or components of velocities, (n or more, 2 or more). The result has their unit.
    """
    x_min = x_max = values[0, 0]
    y_min = y_max = values[0, 1]
    for i in range(n):
        x, y = values[i, 0], values[i, 1]
        x_min, x_max, y_min, y_max = min(x_min, x), max(x_max, x), min(y_min, y), max(y_max, y)
    return 0.5 * (x_min + x_max), 0.5 * (y_min + y_max)


@njit(cache=True, error_model="numpy")
def collide_fast(step, start, segments, actuation, shifts):
    """Let fast circles push on the bodies that they meet within a step, in place.

    Positions change, and at e > 0 velocities, too. step: `StepInput`, whose bodies have moved by Δt v. start: centres
    before this motion, (n, 2), m. segments: `Segments` after their motion. actuation: `Actuation` of the step, or None.
    shifts: `StepLog.shifts`.
    """
    paths, n = make_paths(step, segments, start), step.bodies.mass.shape[0]
    if not math.isfinite(sum_of(start) + sum_of(paths.rate)):
        return  # the run raises an error later
    choose_fast(paths, actuation)
    if not paths.searches.any():
        return
    follow_touches(paths, sort_swept(paths), make_queue(n), make_touches(n), actuation, shifts)
    for i in range(n):
        if paths.touches[i] > 0:
            step.bodies.position[i, 0], step.bodies.position[i, 1] = place_at(paths, i, 1.0)


@njit(cache=True, error_model="numpy", _nrt=False)
def follow_touches(paths, swept, queue, together, actuation, shifts):
    """Change the paths of circles at all touches of a step, in the order of time, in place.

    paths: `Paths`. swept: `Swept`. queue: `TouchQueue`. together: `Touches`. actuation: `Actuation` of the step, or
    None. shifts: `StepLog.shifts`. This function and those that it calls allocate no arrays. With `_nrt=False`, Numba
    therefore counts no references to arrays.
    """
    number, time, changed, shares = 0, 0.0, together.changed, together.shares
    for i in range(shares.shape[0]):
        shares[i] = 0.0
        if paths.searches[i, 0] or paths.searches[i, 1]:
            changed[number] = i
            number += 1
    while time <= 1.0:
        for i in changed[:number]:
            if shares[i] > 0.0:
                paths.searches[i, 0] = paths.searches[i, 1] = True
                bound_path(i, paths, swept)
        for i in changed[:number]:
            find_touch(i, time, paths, swept, queue, actuation)
        time = next_time(queue)
        count, popped = next_touches(paths, queue, together)
        number = share_momentum(count, time, together, paths, actuation, shifts)
        # A circle needs a new search, although its path stays the same, if its touch was dropped or did not change it.
        for i in together.popped[:popped]:
            if queue.count[i] == 0 and shares[i] == 0.0:
                changed[number] = i
                number += 1


@njit(inline="always")
def next_touches(paths, queue, together):
    """Move the earliest touches, which are simultaneous, from the queue into `Touches`, in place.

    A touch is dropped if the path of its partner has changed since the touch was found. Returns the number of touches
    that were moved, and the number of circles in `Touches.popped`.
    """
    n, count, popped, shares = paths.since.shape[0], 0, 0, together.shares
    last = min(next_time(queue) + TOGETHER, 1.0)
    while next_time(queue) <= last and popped < 8 * n:
        i = next_circle(queue)
        k, touches_k = pop_touch(queue, i)
        together.popped[popped], shares[i] = i, 0.0
        popped += 1
        if k >= n or paths.touches[k] == touches_k:
            together.first[count], together.second[count] = i, k
            count += 1
            if k < n:
                shares[k] = 0.0
    return count, popped


@njit(inline="always")
def find_touch(i, now, paths, swept, queue, actuation):
    """Replace the touches of circle i in the queue by its first touches from time `now` on, in place.

    Of several simultaneous touches, at most `touch_queue.MOST_TOGETHER` are queued. actuation: `Actuation` of the step,
    or None.
    """
    clear_touches(queue, i)
    first = np.inf
    if paths.touches[i] < MOST_TOUCHES:
        if paths.searches[i, 0] and paths.inverse[i] > 0.0:
            first, wall = touch_walls(i, now, paths, actuation)
            if first <= 1.0:
                add_touch(queue, i, wall, 0, first)
        if paths.searches[i, 1]:
            found, times = swept.found, swept.times
            count = crossing_paths(i, now, paths, swept)
            for j in range(count):
                times[j] = touch_circle(i, found[j], now, paths)
                if pass_through(paths.step.touches, i, found[j]):
                    times[j] = np.inf
                first = min(first, times[j])
            for j in range(count):
                if times[j] <= min(first + TOGETHER, 1.0):
                    add_touch(queue, i, found[j], paths.touches[found[j]], times[j])
    queue_circle(queue, i)


@njit(cache=True, error_model="numpy")
def choose_fast(paths, actuation):
    """Mark the fast circles in `Paths.searches`, in place, and mark fixed circles as moving or at rest in `Paths.held`.

    A circle searches walls and segments if it is fast relative to bodies at rest, or relative to a moving segment near
    it. It searches other circles if it is fast relative to the mean motion of all circles. actuation: `Actuation` of
    the step, or None.
    """
    rate, radius, searches = paths.rate, paths.step.bodies.radius, paths.searches
    n = radius.shape[0]
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
        choose_near_moving(paths, actuation)


@njit(cache=True, error_model="numpy")
def choose_near_moving(paths, actuation):
    """Mark circles that are fast relative to a moving segment near them, in place: they search walls and segments."""
    start, rate, radius, line = paths.start, paths.rate, paths.step.bodies.radius, paths.segments.line
    for s in actuation.moving:
        for i in range(radius.shape[0]):
            to_x, to_y = start[i, 0] + rate[i, 0], start[i, 1] + rate[i, 1]
            x, y = carried(line, actuation.wall, s, paths.step.dt, start[i, 0], start[i, 1])
            reach = radius[i] + paths.step.scales.wall_skin
            if (
                max(x, to_x) + reach >= min(line[s, 0], line[s, 2])
                and min(x, to_x) - reach <= max(line[s, 0], line[s, 2])
                and max(y, to_y) + reach >= min(line[s, 1], line[s, 3])
                and min(y, to_y) - reach <= max(line[s, 1], line[s, 3])
                and paths.inverse[i] > 0.0
            ):
                paths.searches[i, 0] |= (to_x - x) ** 2 + (to_y - y) ** 2 > (FAST * radius[i]) ** 2


@njit(inline="always")
def share_momentum(touches, time, together, paths, actuation, shifts):
    """Change the paths of the circles at simultaneous touches, in place. A circle shares its mass among its touches.

    touches: number of touches in `Touches`. time: their time, in units of the step. Returns the number of circles in
    `Touches.changed`.
    """
    first, second, shares, changed = together.first, together.second, together.shares, together.changed
    direction, rate, yielding, count = together.direction, together.rate, together.yielding, 0
    for j in range(touches):
        i, k, normal, slip = first[j], second[j], direction[NORMAL, j], direction[SLIP, j]
        normal[0], normal[1], rate[NORMAL, j] = approach_of(i, k, time, paths, actuation)
        slip[0], slip[1], rate[SLIP, j] = slip_apart(i, k, normal, time, paths, actuation)
        for way in range(2):
            yield_along(i, k, direction[way, j], paths, yielding[way, j])
        for side in range(2):
            c = k if side == 1 else i
            if yielding[NORMAL, j, side, 0] > 0.0:
                if shares[c] == 0.0:
                    changed[count] = c
                    count += 1
                shares[c] += 1.0
    for c in changed[:count]:
        paths.place[c, 0], paths.place[c, 1] = place_at(paths, c, time)
        paths.since[c] = time
        paths.touches[c] += 1
    for j in range(touches):
        i, k, normal = first[j], second[j], direction[NORMAL, j]
        for way in range(2):
            if rate[way, j] > 0.0:
                end_rate(way, j, time, together, paths, actuation, shifts)
        if yielding[NORMAL, j, 1, 0] == 0.0:
            hold(i, normal, 1.0, hold_of(k, paths, actuation), paths)
        elif yielding[NORMAL, j, 0, 0] == 0.0:
            hold(k, normal, -1.0, paths.held[i], paths)
    return count


@njit(cache=True, error_model="numpy", _nrt=False)
def end_rate(way, j, time, together, paths, actuation, shifts):
    """Give the two bodies of the j-th touch a common rate along one direction, in place.

    way: `NORMAL` or `SLIP`. time: time of the touch, in units of the step.
    """
    i, k, yielding, shares = together.first[j], together.second[j], together.yielding[way, j], together.shares
    w = 0.0
    for side in range(2):
        if yielding[side, 0] > 0.0:
            w += shares[k if side == 1 else i] * yielding[side, 0]
    s = together.rate[way, j] / w
    for side in range(2):
        c = k if side == 1 else i
        if yielding[side, 0] > 0.0:
            for axis in range(2):
                paths.rate[c, axis] += s * paths.inverse[c] * yielding[side, 1 + axis]
    if largest_of(paths.step.restitution) > 0.0:
        keep_energy(way, j, (1.0 - time) * s, together, paths, actuation, shifts)


@njit(inline="always")
def hold(i, normal, sign, by, paths):
    """Write into `paths` that a body holds circle i. The body lies in the direction sign · normal from the circle.

    by: how it holds the circle, `CARRIED`, `FIRM` or `FREE` (`hold_of`).
    """
    paths.held[i] = max(paths.held[i], by)
    paths.block[i, 0], paths.block[i, 1] = sign * normal[0], sign * normal[1]
    paths.carrier[i] = sign * (paths.rate[i, 0] * normal[0] + paths.rate[i, 1] * normal[1])


@njit(inline="always")
def yield_along(i, k, normal, paths, yielding):
    """Write the `mobility` of circle i along −normal and of body k along +normal into the rows of `yielding`, (2, 3).

    A wall or a segment has w = 0. If neither body can move, the circle with the lower value of `Paths.held` gets the
    mobility of a free circle. If both values are equal, both circles get it.
    """
    n, inverse = paths.since.shape[0], paths.inverse
    yielding[1, 0] = 0.0
    for side in range(2):
        c, sign = (k, 1.0) if side == 1 else (i, -1.0)
        if c < n:
            mobility(c, sign * normal[0], sign * normal[1], paths, yielding[side])
    if yielding[0, 0] == 0.0 and yielding[1, 0] == 0.0:
        if inverse[i] > 0.0 and (k >= n or paths.held[i] <= paths.held[k] or inverse[min(k, n - 1)] == 0.0):
            yielding[0, 0], yielding[0, 1], yielding[0, 2] = inverse[i], -normal[0], -normal[1]
        if k < n and inverse[min(k, n - 1)] > 0.0 and (paths.held[k] <= paths.held[i] or inverse[i] == 0.0):
            yielding[1, 0], yielding[1, 1], yielding[1, 2] = inverse[k], normal[0], normal[1]


@njit(inline="always")
def mobility(i, d_x, d_y, paths, result):
    """Write (w, x, y) into `result`: how circle i yields to a push along the unit vector d = (d_x, d_y).

    A push s, kg m, changes the rate of the circle by s (x, y) / m, m, and its rate along d by s w. A held circle slides
    along the body that holds it, unless it moves away from that body. If d points almost straight at the body
    (`BLOCKED`), w is 0.
    """
    w, x, y = paths.inverse[i], d_x, d_y
    along = d_x * paths.block[i, 0] + d_y * paths.block[i, 1]
    ahead = paths.rate[i, 0] * paths.block[i, 0] + paths.rate[i, 1] * paths.block[i, 1]
    leaves = ahead < paths.carrier[i] - TOGETHER * paths.step.bodies.radius[i]
    if along > 0.0 and paths.held[i] != FREE and not leaves:
        x, y = d_x - along * paths.block[i, 0], d_y - along * paths.block[i, 1]
        w = w * (1.0 - along * along) if along < BLOCKED else 0.0
    result[0], result[1], result[2] = w, x, y


@njit(inline="always")
def hold_of(k, paths, actuation):
    """Return how body k holds a circle: `FREE`, `CARRIED` or `FIRM`.

    A moving segment holds as `CARRIED`, and a wall or a segment at rest as `FIRM`. A circle k passes on the value that
    it has itself (`Paths.held`).
    """
    n = paths.since.shape[0]
    if k < n:
        return paths.held[k]
    if actuation is not None:
        if k >= n + 4 and is_moving(actuation.wall, k - n - 4):
            return CARRIED
    return FIRM


@njit(cache=True, error_model="numpy", _nrt=False)
def keep_energy(way, j, impulse, together, paths, actuation, shifts):
    """Correct a velocity after the j-th touch so that energy is conserved, in place.

    Of the circles that the touch can move, the heavier one gets another velocity along one direction. The velocities
    contain the effect of gravity and external forces in a whole step. A touch changes how far the circles
    move along these forces, and so their potential energy. Without the correction the total energy would change.
    Velocities are those of half a step before the positions.

    way: index of the direction, `NORMAL` or `SLIP`. impulse: s in the formula of the module, times the part of the step
    that is left, kg m. shifts: `StepLog.shifts`, (n, 2), N·s, to which the change of momentum is added if the log
    stores it.
    """
    i, k = together.first[j], together.second[j]
    direction, yielding = together.direction[way, j], together.yielding[way, j]
    step, bodies, dt = paths.step, paths.step.bodies, paths.step.dt
    n, gained, g = bodies.mass.shape[0], 0.0, 0.0
    is_second = yielding[1, 0] > 0.0 and (yielding[0, 0] == 0.0 or bodies.mass[min(k, n - 1)] > bodies.mass[i])
    heavier = k if is_second else i
    for side in range(2):
        c = k if side == 1 else i
        if yielding[side, 0] > 0.0:
            for axis in range(2):
                force = bodies.mass[c] * step.gravity[axis]
                if actuation is not None:
                    force += actuation.force[c, axis]
                gained += force / bodies.mass[c] * impulse * yielding[side, 1 + axis]
                if c == heavier:
                    g += force / bodies.mass[c] * direction[axis] * (1.0 - 2.0 * side)
    sign = -1.0 if is_second else 1.0
    v = together.rate[way, j] / dt + 0.5 * dt * g
    change = math.copysign(math.sqrt(max(0.0, v * v + 2.0 * gained / bodies.mass[heavier])), v) - v
    for axis in range(2):
        bodies.velocity[heavier, axis] += sign * change * direction[axis]
        if shifts.shape[0] > 0:
            shifts[heavier, axis] += bodies.mass[heavier] * sign * change * direction[axis]
