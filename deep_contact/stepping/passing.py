"""Removes contacts of moving segments with blocked circles, so that the segments pass over these circles.

A circle is blocked if a segment moves towards it, and walls, segments or fixed circles at rest lie in its way. A solver
would let the impulses grow without limit, and press the circle through one of the bodies. Here the bodies at rest have
priority: as long as every velocity of the circle would violate a contact, the moving segment has no contact with it,
and passes over it. The run warns once.

Let d be the direction in which the segment pushes, and n_r the normals from the circle to the bodies at rest. The
circle is blocked if d = Σ λ_r n_r with λ_r ≥ 0 (Farkas's lemma). In the plane this means that d is one of the normals,
or lies between two of them. Friction is neglected. Chains of circles are not detected: if bodies at rest block the last
circle of a chain, its circles are pressed into each other.

Tests: tests/behaviour/test_actuation.py, tests/stepping/test_continuous.py
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.contacts import some_contacts
from deep_contact.stepping.log import PASSED
from deep_contact.stepping.segments import has_moving, is_moving, wall_velocity

PARALLEL = 1e-3
"""Largest angle, rad, between d and a normal at which both count as one direction."""


@njit(cache=True, error_model="numpy")
def without_passed(contacts, bodies, segments, actuation, progress):
    """Remove the contacts of moving segments with blocked circles, in place. Returns the remaining contacts.

    contacts: at the bodies' positions, with geometry. segments: `Segments` at the same time. actuation: `Actuation` of
    the step, or None. progress: `StepLog.progress`, in which a circle that has lost such a contact is recorded.
    """
    if not has_moving(actuation):
        return contacts
    n, m = bodies.mass.shape[0], contacts.body_a.shape[0]
    way, pushed = np.zeros((n, 2)), False
    for i in range(m):
        a, s = contacts.body_a[i], contacts.body_b[i] - n - 4
        if s >= 0 and pushes(contacts, i, s, segments, actuation):
            way[a, 0], way[a, 1], pushed = -contacts.normal[i, 0], -contacts.normal[i, 1], True
    if not pushed:
        return contacts
    left, right = np.full(n, np.inf), np.full(n, np.inf)  # least angles of normals to the left and right of d, rad
    for i in range(m):
        a, b = contacts.body_a[i], contacts.body_b[i]
        if way[a, 0] != 0.0 or way[a, 1] != 0.0:
            if rests(b, bodies, actuation):
                note_normal(way[a], contacts.normal[i, 0], contacts.normal[i, 1], a, left, right)
        if b < n and (way[b, 0] != 0.0 or way[b, 1] != 0.0):
            if rests(a, bodies, actuation):
                note_normal(way[b], -contacts.normal[i, 0], -contacts.normal[i, 1], b, left, right)
    kept = 0
    for i in range(m):
        a, s = contacts.body_a[i], contacts.body_b[i] - n - 4
        if s >= 0 and left[a] + right[a] < math.pi and pushes(contacts, i, s, segments, actuation):
            progress[PASSED] = a + 1
            continue
        contacts.body_a[kept], contacts.body_b[kept] = a, contacts.body_b[i]
        for axis in range(2):
            contacts.normal[kept, axis] = contacts.normal[i, axis]
            contacts.position[kept, axis] = contacts.position[i, axis]
        contacts.separation[kept] = contacts.separation[i]
        kept += 1
    return some_contacts(contacts, 0, kept)


@njit(inline="always")
def pushes(contacts, i, s, segments, actuation):
    """Return whether segment s moves towards the circle of contact i."""
    if not is_moving(actuation.wall, s):
        return False
    v_x, v_y = wall_velocity(segments.line, actuation.wall, s, contacts.position[i, 0], contacts.position[i, 1])
    return v_x * contacts.normal[i, 0] + v_y * contacts.normal[i, 1] < 0.0


@njit(inline="always")
def rests(b, bodies, actuation):
    """Return whether body b is at rest: a wall, a segment that does not move, or a fixed circle with velocity 0."""
    n = bodies.mass.shape[0]
    if b >= n:
        return b < n + 4 or not is_moving(actuation.wall, b - n - 4)
    return bodies.mass[b] == math.inf and bodies.velocity[b, 0] == 0.0 and bodies.velocity[b, 1] == 0.0


@njit(inline="always")
def note_normal(way, n_x, n_y, i, left, right):
    """Update the least angles between the push on circle i and normals to the left and right of it, by one normal.

    way: direction of the push, (2,). n_x, n_y: normal from circle i to a body at rest. left, right: least angles of
    each circle, (n,), rad, changed in place.
    """
    angle = math.atan2(way[0] * n_y - way[1] * n_x, way[0] * n_x + way[1] * n_y)
    if angle >= -PARALLEL:
        left[i] = min(left[i], max(angle, 0.0))
    if angle <= PARALLEL:
        right[i] = min(right[i], max(-angle, 0.0))
