"""Divide a step by motion, beyond the substeps that a solver asks for.

A step has as many equal substeps as the solver asks for, each of duration Δt. Motion divides such a substep if a circle
is about to hit something in it. Let v be the fastest approach that closes a gap within Δt. The substep is then divided
into the least power of two k for which v Δt / k ≤ reach (`Motion.reach`, m). A circle that hits something therefore
penetrates by no more than the reach before a contact stops it. The ratio v Δt / reach is a Courant number of motion.

The division depends only on positions, velocities and Δt. A run that is continued from a file is therefore the same bit
for bit. To divide by a power of two changes impulses without rounding. Weakness: the fastest pair decides for the whole
scene, and accelerations by contacts within the step are not foreseen.
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import WALL_NORMALS
from deep_contact.stepping.broad_phase import circles_around, refresh_list, sort_into_cells, sum_of
from deep_contact.stepping.contacts import wall_gap
from deep_contact.stepping.context import substep_of
from deep_contact.stepping.pairs import largest_of
from deep_contact.stepping.segment_grid import cells_of_box, is_beyond, segment_gap
from deep_contact.stepping.segments import wall_velocity


@njit(cache=True, error_model="numpy")
def divide_by_motion(context, log, actuation):
    """Divide the solver's next substep by motion, in place on `StepContext.substep`.

    Velocities of circles in flight are corrected for the change of Δt (`fly_on`). log: `StepLog`. actuation:
    `Actuation` of the step, or None.
    """
    step = context.step
    if actuation is not None:
        step = substep_of(step, context.substep.segments)
    substeps = substeps_by_motion(step, context.memory.cells, actuation)
    if substeps * step.substeps != context.substep.substeps:
        context.substep = substep_of(step, step.segments, substeps)
    fly_on(context, step.dt - context.substep.dt, log, actuation)


@njit(cache=True, error_model="numpy")
def fly_on(context, change, log, actuation):
    """Shift the velocities of circles in flight (`shift_flights`), in place, because Δt changes.

    Nothing changes if e = 0, or if motion does not divide the solver's substep. change: the old Δt minus the new Δt, s.
    log: `StepLog`. actuation: `Actuation` of the step, or None.
    """
    step = context.step
    if context.substep.substeps > step.substeps and largest_of(step.restitution) > 0.0:
        shift_flights(step.bodies, context.contacts, step.gravity, change, actuation, log.shifts)


@njit(cache=True, error_model="numpy")
def substeps_by_motion(step, cells, actuation):
    """Return the number of parts into which motion divides the solver's next substep: a power of two.

    step: `StepInput`. cells: `Cells`, overwritten. actuation: `Actuation` of the step, or None.
    """
    motion = step.motion
    if motion.most == 1 or step.bodies.mass.shape[0] == 0:
        return 1
    dt, slow = step.dt, motion.reach / step.dt
    pairs, walls = fastest_possible(step.bodies.velocity, step.gravity, dt)
    fastest = slow
    if walls + fastest_wall(actuation) > slow:
        fastest = fastest_onto_walls(step, fastest, actuation)
    if pairs > slow and fastest * dt <= 0.5 * motion.most * motion.reach:  # otherwise the limit is reached
        fastest = fastest_pair(step, cells, pairs * dt, fastest)
    substeps = 1
    while substeps < motion.most and fastest * dt > substeps * motion.reach:
        substeps *= 2
    return substeps


@njit(cache=True, fastmath={"nnan", "nsz"})
def fastest_possible(velocity, gravity, dt):
    """Return (pairs, walls), m/s: upper bounds on speeds of approach within Δt.

    pairs: bound for two circles. walls: bound for a circle and a body at rest. velocity: (n, 2), m/s. gravity: (g_x,
    g_y), m/s². dt: Δt, s.
    """
    x_min = x_max = velocity[0, 0]
    y_min = y_max = velocity[0, 1]
    for i in range(velocity.shape[0]):
        x, y = velocity[i, 0], velocity[i, 1]
        x_min, x_max, y_min, y_max = min(x_min, x), max(x_max, x), min(y_min, y), max(y_max, y)
    x, y = max(-x_min, x_max) + dt * abs(gravity[0]), max(-y_min, y_max) + dt * abs(gravity[1])
    return math.hypot(x_max - x_min, y_max - y_min), math.hypot(x, y)


@njit(cache=True)
def fastest_wall(actuation):
    """Return the speed of the fastest end of a moving segment, m/s; 0 if no segment moves."""
    speed = 0.0
    if actuation is not None:
        for s in actuation.moving:
            for end in (0, 2):
                speed = max(speed, math.hypot(actuation.wall[s, end], actuation.wall[s, end + 1]))
    return speed


@njit(cache=True, error_model="numpy", _nrt=False)
def fastest_onto_walls(step, fastest, actuation):
    """Return the fastest approach of a circle to a wall or segment that closes the gap between them within Δt, m/s.

    The result is at least `fastest`, m/s. step: `StepInput`. actuation: `Actuation` of the step, or None.
    """
    bodies, box, segments, dt, skin = step.bodies, step.box, step.segments, step.dt, step.scales.wall_skin
    start, grid, speed = segments.start, segments.grid, fastest_wall(actuation)
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
        # A gap can close within Δt only if the segment lies within reach of a place to which the circle can come.
        far = dt * (math.sqrt(v_x * v_x + v_y * v_y) + speed)
        left, right, bottom, top = cells_of_box(grid, x - far, x + far, y - far, y + far)
        for row in range(bottom, top + 1):
            for k in range(start[row * grid[3] + left], start[row * grid[3] + right + 1]):
                s = segments.near[k]
                if is_beyond(segments.line[s], x, y, reach + far):
                    continue
                gap, n_x, n_y = segment_gap(segments.line[s], x, y)
                approach = v_x * n_x + v_y * n_y
                if actuation is not None:
                    w_x, w_y = wall_velocity(segments.line, actuation.wall, s, x, y)
                    approach -= w_x * n_x + w_y * n_y
                if approach > fastest and gap - reach < approach * dt:
                    fastest = approach
    return fastest


@njit(cache=True, error_model="numpy")
def fastest_pair(step, cells, gap, fastest):
    """Return the fastest approach of two circles that closes the gap between them within Δt, m/s.

    The result is at least `fastest`, m/s. gap: largest gap of two circles that can meet within Δt, m. Pairs are taken
    from the list of near pairs, if the list has all pairs up to this gap or if it pays to make such a list. Otherwise
    the pairs are searched in cells. step: `StepInput`. cells: `Cells`.
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
    """Do `fastest_pair` for circle a and the circles near[first:last]."""
    position, velocity, radius, dt = step.bodies.position, step.bodies.velocity, step.bodies.radius, step.dt
    x, y, v_x, v_y, r = position[a, 0], position[a, 1], velocity[a, 0], velocity[a, 1], radius[a]
    for k in range(first, last):
        b = near[k]
        d_x, d_y = position[b, 0] - x, position[b, 1] - y
        # Speed of approach times distance, so that only few pairs need a square root.
        closing = (v_x - velocity[b, 0]) * d_x + (v_y - velocity[b, 1]) * d_y
        square = d_x * d_x + d_y * d_y
        if closing > 0.0 and closing * closing > fastest * fastest * square:
            distance = math.sqrt(square)
            if distance - r - radius[b] < closing / distance * dt:
                fastest = closing / distance
    return fastest


@njit(cache=True)
def shift_flights(bodies, contacts, gravity, change, actuation, shifts):
    """Shift the velocities of circles in flight, in place, so that their flight goes on although Δt changes.

    Symplectic Euler is a leapfrog: velocities are those of half a step before the positions. At a bounce, motion
    divides the step on the way down and not on the way up. Without the shift, each bounce would change the energy. A
    circle on which a contact pushes is not shifted, because it has to keep v = 0. A contact without an impulse does not
    count, because it has just begun or is ending. gravity: (g_x, g_y), m/s². change: decrease of Δt, s. The change of
    momentum of each circle is added to shifts, (n, 2), N·s, if the log stores it.
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
            if actuation is not None:
                shift += 0.5 * change * actuation.force[i, axis] / bodies.mass[i]
            bodies.velocity[i, axis] += shift
            if shifts.shape[0] > 0:
                shifts[i, axis] += bodies.mass[i] * shift
