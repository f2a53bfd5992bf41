"""The division of a step: into the substeps that a solver asks for, and each of these by motion.

Motion divides where something is about to hit, and leaves whole where nothing moves. With v the fastest approach that
closes its gap within a substep's Δt, that takes the least power of two of parts with
v Δt / parts ≤ reach, so that nothing that hits has gone farther than the reach into the other before a contact stops
it: a Courant number of motion.

The choice depends on positions, velocities and Δt alone, so a run that is read back goes on bit for bit; a power of two
scales impulses exactly. Weakness: the fastest pair decides for the whole scene, and what contacts accelerate within the
step is not foreseen.
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.physics.collision import circles_around, refresh_list, sort_into_cells, sum_of, wall_gap
from deep_contact.physics.segments import is_free, near_box, segment_gap, wall_velocity
from deep_contact.physics.step import part_of
from deep_contact.state.arrays import WALL_NORMALS


@njit(inline="always")
def part_by_motion(step, part, cells, drive):
    """The part into which motion divides the next substep; `part` where it is as before."""
    parts = parts_of(step, cells, drive)
    return part if parts * step.parts == part.parts else part_of(step, step.segments, parts)


@njit(inline="always")
def fly_on(step, part, contacts, change, drive, shifts):
    """Let circles that fly go on with another Δt (`shift_flights`), where motion has divided a substep into parts.

    step: `StepInput` of the substep. part: of one of its parts. change: by which Δt becomes shorter, s. shifts: of
    `StepLog`.
    """
    if part.parts > step.parts and step.restitution > 0.0:
        shift_flights(step.bodies, contacts, step.gravity, change, drive, shifts)


@njit(cache=True, error_model="numpy")
def parts_of(step, cells, drive):
    """Into how many parts motion divides the next substep: a power of two. step: `StepInput`. cells: `Cells`, used.

    drive: of the step.
    """
    motion = step.motion
    if motion.most == 1 or step.bodies.mass.shape[0] == 0:
        return 1
    dt, slow = step.dt, motion.reach / step.dt
    pairs, walls = fastest_possible(step.bodies.velocity, step.gravity, dt)
    fastest = slow
    if walls + fastest_wall(drive) > slow:
        fastest = fastest_onto_walls(step, fastest, drive)
    if pairs > slow and fastest * dt <= 0.5 * motion.most * motion.reach:  # otherwise it is the most already
        fastest = fastest_pair(step, cells, pairs * dt, fastest)
    parts = 1
    while parts < motion.most and fastest * dt > parts * motion.reach:
        parts *= 2
    return parts


@njit(cache=True, fastmath={"nnan", "nsz"})
def fastest_possible(velocity, gravity, dt):
    """(Of two circles, of a circle to what stands still): speeds, m/s, that no approach exceeds within Δt.

    velocity: (n, 2), m/s.
    """
    x_min = x_max = velocity[0, 0]
    y_min = y_max = velocity[0, 1]
    for i in range(velocity.shape[0]):
        x, y = velocity[i, 0], velocity[i, 1]
        x_min, x_max, y_min, y_max = min(x_min, x), max(x_max, x), min(y_min, y), max(y_max, y)
    x, y = max(-x_min, x_max) + dt * abs(gravity[0]), max(-y_min, y_max) + dt * abs(gravity[1])
    return math.hypot(x_max - x_min, y_max - y_min), math.hypot(x, y)


@njit(cache=True)
def fastest_wall(drive):
    """The speed of the fastest end of a segment, m/s."""
    speed = 0.0
    if drive is not None:
        for s in drive.moving:
            for end in (0, 2):
                speed = max(speed, math.hypot(drive.wall[s, end], drive.wall[s, end + 1]))
    return speed


@njit(cache=True, error_model="numpy")
def fastest_onto_walls(step, fastest, drive):
    """The fastest approach that closes the gap of a circle to a wall or a segment within Δt, m/s, or `fastest`."""
    bodies, box, segments, dt, skin = step.bodies, step.box, step.segments, step.dt, step.scales.wall_skin
    buffer, start, grid, speed = np.empty_like(segments.every), segments.start, segments.grid, fastest_wall(drive)
    for i in range(bodies.mass.shape[0]):
        v_x, v_y = bodies.velocity[i, 0] + dt * step.gravity[0], bodies.velocity[i, 1] + dt * step.gravity[1]
        if speed == 0.0 and v_x * v_x + v_y * v_y <= fastest * fastest:
            continue
        if bodies.mass[i] == math.inf:
            continue
        x, y, reach = bodies.position[i, 0], bodies.position[i, 1], bodies.radius[i] + skin
        for wall in range(4):
            approach = v_x * WALL_NORMALS[wall, 0] + v_y * WALL_NORMALS[wall, 1]
            if approach > fastest and wall_gap(x, y, box, wall) - reach < approach * dt:
                fastest = approach
        # What it closes within Δt lies within reach of where it comes in that time, at most.
        far = dt * (math.sqrt(v_x * v_x + v_y * v_y) + speed)
        if is_free(start, grid, x - far, x + far, y - far, y + far):
            continue
        for s in near_box(segments, x - far, x + far, y - far, y + far, buffer):
            gap, n_x, n_y = segment_gap(segments.line[s], x, y)
            approach = v_x * n_x + v_y * n_y
            if drive is not None:
                w_x, w_y = wall_velocity(segments.line, drive.wall, s, x, y)
                approach -= w_x * n_x + w_y * n_y
            if approach > fastest and gap - reach < approach * dt:
                fastest = approach
    return fastest


@njit(cache=True, error_model="numpy")
def fastest_pair(step, cells, gap, fastest):
    """The fastest approach that closes the gap of two circles within Δt, m/s, or `fastest`.

    gap: m; circles that are farther apart do not meet within Δt. The pairs are read from the list of near pairs, where
    it reaches so far or is worth making.
    """
    position, radius = step.bodies.position, step.bodies.radius
    if refresh_list(position, radius, cells, gap):
        for a in range(position.shape[0]):
            fastest = fastest_of(step, a, cells.near, cells.first[a], cells.first[a + 1], fastest)
    elif math.isfinite(sum_of(position)):
        levels = sort_into_cells(position, radius, gap, cells)
        for a in range(position.shape[0]):
            m = circles_around(a, position, radius[a] + gap, levels, cells, cells.near, np.int64(0))
            fastest = fastest_of(step, a, cells.near, np.int64(0), m, fastest)
    return fastest


@njit(cache=True, error_model="numpy")
def fastest_of(step, a, near, first, last, fastest):
    """`fastest_pair` of circle a with those in near[first:last]."""
    position, velocity, radius, dt = step.bodies.position, step.bodies.velocity, step.bodies.radius, step.dt
    x, y, v_x, v_y, r = position[a, 0], position[a, 1], velocity[a, 0], velocity[a, 1], radius[a]
    for k in range(first, last):
        b = near[k]
        d_x, d_y = position[b, 0] - x, position[b, 1] - y
        # Approach times distance, so that few pairs need a root.
        closing = (v_x - velocity[b, 0]) * d_x + (v_y - velocity[b, 1]) * d_y
        square = d_x * d_x + d_y * d_y
        if closing > 0.0 and closing * closing > fastest * fastest * square:
            distance = math.sqrt(square)
            if distance - r - radius[b] < closing / distance * dt:
                fastest = closing / distance
    return fastest


@njit(cache=True)
def shift_flights(bodies, contacts, gravity, change, drive, shifts):
    """Let circles that nothing pushes fly on as before where Δt becomes shorter by `change`, s, in place.

    Symplectic Euler is a leapfrog: velocities are those of half a step before. Without the shift each bounce, which is
    divided on the way down and not on the way up, would change the energy. What a contact pushes has v = 0 to keep; a
    contact without an impulse is one that a circle has just come to, or leaves.
    The changes of momentum are added to shifts, (n, 2), N·s; (0, 2) where nobody asks.
    """
    n = bodies.mass.shape[0]
    held = np.zeros(n + 1, np.bool_)
    for i in range(contacts.body_a.shape[0]):
        if contacts.normal_impulse[i] > 0.0:
            held[contacts.body_a[i]] = held[min(contacts.body_b[i], n)] = True
    for i in range(n):
        if held[i] or bodies.mass[i] == math.inf:
            continue
        for axis in range(2):
            shift = 0.5 * change * gravity[axis]
            if drive is not None:
                shift += 0.5 * change * drive.force[i, axis] / bodies.mass[i]
            bodies.velocity[i, axis] += shift
            if shifts.shape[0] > 0:
                shifts[i, axis] += bodies.mass[i] * shift
