"""Sleeping: islands at rest are left as they are, by the rule of Box2D 2.3, until something touches them.

A circle is still while its speed and spin are at most `sleep_speed` and `sleep_spin` of the `ContactScales`. An island
falls asleep once all of its circles have been still for `sleep_time` and none of its contacts is left to be corrected:
their velocities become 0, and their impulses are kept to wake up with. It wakes as a whole when a circle that is awake
touches it. Nothing else can wake it within a run, for what is asleep does not move and so neither finds nor loses a
contact by itself; new velocities, an impulse, another world come with a new run, which starts awake.

Contacts are still looked for among all circles, unless all are asleep, when a step is nothing at all.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deep_contact.constants import POSITION_TOLERANCE
from deep_contact.physics.collision import first_contacts, make_cells, make_contacts, next_contacts, own_contacts
from deep_contact.physics.contact_solver import (
    INVERSE_MASS,
    apply_impulses,
    contact_rows,
    integrate_positions,
    integrate_velocities,
    make_rows,
    move_surfaces,
    store_impulses,
)
from deep_contact.physics.impacts import rebound
from deep_contact.physics.islands import root_of, unite
from deep_contact.physics.position_correction import correct_positions, make_correction_room
from deep_contact.physics.segments import positions_before
from deep_contact.physics.solvers.registry import make_workspace, relax
from deep_contact.physics.step import log_step


@njit(cache=True, error_model="numpy", nogil=True)
def advance_sleeping(given, options, workspace, log):
    """`engine.advance` with sleeping: same arguments and results; logs the contacts that are awake.

    `workspace.still` goes on in place. Rows are built from the contacts that are awake.
    """
    bodies, contacts, friction, still = given.bodies, given.contacts, given.friction, workspace.still
    solver_bodies, theta, scales = workspace.solver_bodies, workspace.theta, given.scales
    segments = given.segments
    n = bodies.mass.shape[0]
    cells = make_cells(n)
    front_buffer, back_buffer, active_buffer = (
        make_contacts(4 * n + 64),
        make_contacts(4 * n + 64),
        make_contacts(4 * n + 64),
    )
    row_buffer = make_rows(4 * n + 64, solver_bodies.dtype, friction)
    solver_workspace = make_workspace(options.settings, row_buffer, solver_bodies)
    room = make_correction_room(n, 4 * n + 64)
    parent, shortest = np.empty(n, np.int64), np.empty(n)
    solved = contacts
    awake = (still < np.inf).sum()
    for k in range(log.contacts.shape[0]):
        if awake == 0:
            solved = contacts
            if log_step(log, k, 0, 0, theta, 0):
                break
            continue
        active, active_buffer = awake_contacts(contacts, still, active_buffer)
        if given.restitution > 0.0:
            rebound(given, active)
        integrate_velocities(bodies, given.gravity, given.dt, solver_bodies)
        hold_sleeping(still, solver_bodies)
        rows, row_buffer = contact_rows(bodies, active, solver_bodies, row_buffer, friction)
        if segments.shape[0] > 0:
            move_surfaces(active, segments, solver_bodies, rows)
        apply_impulses(rows, solver_bodies, friction)
        sweeps, relaxations = relax(options.settings, rows, friction, solver_bodies, theta, solver_workspace)
        store_impulses(rows, active)
        store_awake_impulses(active, still, contacts)
        before = positions_before(bodies, segments)
        integrate_positions(bodies, solver_bodies, given)
        room = correct_positions(bodies, active, given.box, segments, scales, options.position_sweeps, room)

        solved = contacts
        contacts, back_buffer = next_contacts(
            bodies, before, given.box, segments, scales.wall_skin, cells, solved, options.carry, back_buffer
        )
        front_buffer, back_buffer = back_buffer, front_buffer
        awake = wake_and_put_to_sleep(bodies, contacts, segments, given.dt, scales, parent, shortest, still)
        if log_step(log, k, active.body_a.shape[0], sweeps, theta, relaxations):
            break
    return solved, own_contacts(contacts)


@njit(cache=True)
def awake_contacts(contacts, still, buffer):
    """Contacts of awake circles, with the fields that a step reads. Returns (contacts, buffer): views of the buffer."""
    if contacts.body_a.shape[0] > buffer.body_a.shape[0]:
        buffer = make_contacts(contacts.body_a.shape[0])
    m = 0
    for i in range(contacts.body_a.shape[0]):
        # Islands sleep as a whole, so the first circle tells.
        if still[contacts.body_a[i]] < np.inf:
            buffer.body_a[m], buffer.body_b[m] = contacts.body_a[i], contacts.body_b[i]
            buffer.normal[m, 0], buffer.normal[m, 1] = contacts.normal[i, 0], contacts.normal[i, 1]
            buffer.separation[m] = contacts.separation[i]
            buffer.normal_start[m], buffer.tangent_start[m] = contacts.normal_start[i], contacts.tangent_start[i]
            m += 1
    return first_contacts(buffer, m), buffer


@njit(cache=True)
def store_awake_impulses(active, still, contacts):
    """Write the solved impulses of the contacts that are awake among all contacts, in place: `awake_contacts` back."""
    j = 0
    for i in range(contacts.body_a.shape[0]):
        if still[contacts.body_a[i]] < np.inf:
            contacts.normal_impulse[i] = active.normal_impulse[j]
            contacts.tangent_impulse[i] = active.tangent_impulse[j]
            j += 1


@njit(cache=True)
def hold_sleeping(still, solver_bodies):
    """Take back, in place, what gravity did to the circles that are asleep."""
    for i in range(still.shape[0]):
        if still[i] == np.inf:
            solver_bodies[i, :INVERSE_MASS] = 0.0


@njit(cache=True)
def wake_and_put_to_sleep(bodies, contacts, segments, dt, scales, parent, shortest, still):
    """Let Δt pass, in place, for the stillness of circles and islands. Returns how many circles are awake.

    contacts: those at the bodies' positions. segments: (S, 5); what touches a moving surface stays awake. scales:
    `ContactScales`. parent, shortest: buffers, (n,) each.
    """
    n = still.shape[0]
    for i in range(n):
        if still[i] < np.inf:
            speed = math.hypot(bodies.velocity[i, 0], bodies.velocity[i, 1])
            is_still = speed <= scales.sleep_speed and abs(bodies.spin[i]) <= scales.sleep_spin
            still[i] = still[i] + dt if is_still else 0.0
    unite(contacts.body_a, contacts.body_b, parent)
    shortest[:] = np.inf
    for i in range(n):
        root = root_of(parent, i)
        shortest[root] = min(shortest[root], still[i])
    for k in range(contacts.body_a.shape[0]):
        root = root_of(parent, contacts.body_a[k])
        s = contacts.body_b[k] - n - 4
        is_restless = contacts.separation[k] < -POSITION_TOLERANCE * scales.slop or (s >= 0 and segments[s, 4] != 0.0)
        if is_restless and shortest[root] < np.inf:
            shortest[root] = 0.0
    awake = 0
    for i in range(n):
        time = shortest[root_of(parent, i)]
        if time == np.inf:
            continue
        if time >= scales.sleep_time:
            still[i] = np.inf
            bodies.velocity[i, 0] = bodies.velocity[i, 1] = bodies.spin[i] = 0.0
        else:
            awake += 1
            if still[i] == np.inf:
                still[i] = 0.0
    return awake
