"""Sleeping: islands at rest are left as they are, by the rule of Box2D 2.3, until something touches them.

A circle is still while its speed and spin are below `LINEAR_TOLERANCE` and `ANGULAR_TOLERANCE`. An island falls asleep
once all of its circles have been still for `TIME_TO_SLEEP` and none of its contacts is left to be corrected: their
velocities become 0, and their impulses are kept to wake up with. It wakes as a whole when a circle that is awake
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
    apply_impulses,
    contact_rows,
    correct_positions,
    integrate_velocities,
    make_rows,
    store_impulses,
)
from deep_contact.physics.engine import integrate_positions
from deep_contact.physics.islands import root_of, unite
from deep_contact.physics.relaxation import make_scratch, relax

TIME_TO_SLEEP = 0.5
"""s (`b2_timeToSleep`)"""

LINEAR_TOLERANCE = 0.01
"""m/s (`b2_linearSleepTolerance`)"""

ANGULAR_TOLERANCE = math.radians(2.0)
"""rad/s (`b2_angularSleepTolerance`)"""


@njit(cache=True, error_model="numpy")
def advance_sleeping(bodies, contacts, world, dt, settings, position_sweeps, warm, steps, moving, theta, log, rest):
    """`engine.advance` with sleeping: same arguments and results, and `rest`; logs the contacts that are awake.

    rest: for how long each circle has been still, (n,), s; infinite while it is asleep. Goes on in place.
    """
    box, gravity, friction, restitution = world
    n = bodies.mass.shape[0]
    cells = make_cells(n)
    room, spare, active_room = make_contacts(4 * n + 64), make_contacts(4 * n + 64), make_contacts(4 * n + 64)
    rows_room = make_rows(4 * n + 64, moving.dtype, friction)
    scratch = make_scratch(settings, rows_room, moving)
    parent, shortest = np.empty(n, np.int64), np.empty(n)
    solved = contacts
    awake = (rest < np.inf).sum()
    for k in range(steps):
        if awake == 0:
            solved = contacts
            log[k, 0], log[k, 1], log[k, 2], log[k, 3] = 0, 0, np.inf, 0
            continue
        active, active_room = awake_contacts(contacts, rest, active_room)
        integrate_velocities(bodies, gravity, dt, moving)
        hold_sleeping(rest, moving)
        rows, rows_room = contact_rows(bodies, active, moving, restitution, rows_room, friction)
        apply_impulses(rows, moving, friction)
        sweeps, relaxations = relax(settings, rows, friction, moving, theta, scratch)
        store_impulses(rows, active)
        store_awake_impulses(active, rest, contacts)
        integrate_positions(bodies, moving, dt)
        correct_positions(bodies, active, box, position_sweeps)

        solved = contacts
        contacts, spare = next_contacts(bodies, box, cells, solved, warm, spare)
        room, spare = spare, room
        awake = wake_and_put_to_sleep(bodies, contacts, dt, parent, shortest, rest)

        log[k, 0] = active.body_a.shape[0]
        log[k, 1] = sweeps
        log[k, 2] = theta[sweeps - 1] if sweeps > 0 else np.inf
        log[k, 3] = relaxations
    return own_contacts(solved), own_contacts(contacts)


@njit(cache=True)
def awake_contacts(contacts, rest, room):
    """The contacts of circles that are awake, as far as a step needs them. Returns (contacts, room): a room's views."""
    if contacts.body_a.shape[0] > room.body_a.shape[0]:
        room = make_contacts(contacts.body_a.shape[0])
    m = 0
    for i in range(contacts.body_a.shape[0]):
        # Islands sleep as a whole, so the first circle tells.
        if rest[contacts.body_a[i]] < np.inf:
            room.body_a[m], room.body_b[m] = contacts.body_a[i], contacts.body_b[i]
            room.normal[m, 0], room.normal[m, 1] = contacts.normal[i, 0], contacts.normal[i, 1]
            room.separation[m] = contacts.separation[i]
            room.normal_start[m], room.tangent_start[m] = contacts.normal_start[i], contacts.tangent_start[i]
            m += 1
    return first_contacts(room, m), room


@njit(cache=True)
def store_awake_impulses(active, rest, contacts):
    """Write the solved impulses of the contacts that are awake among all contacts, in place: `awake_contacts` back."""
    j = 0
    for i in range(contacts.body_a.shape[0]):
        if rest[contacts.body_a[i]] < np.inf:
            contacts.normal_impulse[i] = active.normal_impulse[j]
            contacts.tangent_impulse[i] = active.tangent_impulse[j]
            j += 1


@njit(cache=True)
def hold_sleeping(rest, moving):
    """Take back, in place, what gravity did to the circles that are asleep."""
    for i in range(rest.shape[0]):
        if rest[i] == np.inf:
            moving[i, 0] = moving[i, 1] = moving[i, 2] = 0.0


@njit(cache=True)
def wake_and_put_to_sleep(bodies, contacts, dt, parent, shortest, rest):
    """Let Δt pass, in place, for the stillness of circles and islands. Returns how many circles are awake.

    contacts: those at the bodies' positions. parent, shortest: room, (n,) each.
    """
    n = rest.shape[0]
    for i in range(n):
        if rest[i] < np.inf:
            speed = math.hypot(bodies.velocity[i, 0], bodies.velocity[i, 1])
            still = speed <= LINEAR_TOLERANCE and abs(bodies.spin[i]) <= ANGULAR_TOLERANCE
            rest[i] = rest[i] + dt if still else 0.0
    unite(contacts.body_a, contacts.body_b, parent)
    shortest[:] = np.inf
    for i in range(n):
        root = root_of(parent, i)
        shortest[root] = min(shortest[root], rest[i])
    for k in range(contacts.body_a.shape[0]):
        root = root_of(parent, contacts.body_a[k])
        if contacts.separation[k] < -POSITION_TOLERANCE and shortest[root] < np.inf:
            shortest[root] = 0.0
    awake = 0
    for i in range(n):
        still = shortest[root_of(parent, i)]
        if still == np.inf:
            continue
        if still >= TIME_TO_SLEEP:
            rest[i] = np.inf
            bodies.velocity[i, 0] = bodies.velocity[i, 1] = bodies.spin[i] = 0.0
        else:
            awake += 1
            if rest[i] == np.inf:
                rest[i] = 0.0
    return awake
