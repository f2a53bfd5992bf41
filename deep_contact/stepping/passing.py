"""Moving segments pass over circles that bodies at rest hold in their way.

A circle between a segment that moves towards it and walls, segments or fixed circles at rest cannot keep clear of both.
A solver would let the impulses grow without end, and press the circle through one of them. The bodies at rest win: as
long as no velocity of the circle keeps it clear of both, the moving segment has no contact with it, and passes over it.
The run warns once.

With d the direction in which the segment pushes, and n_r the normals from the circle to the bodies at rest, such a
velocity exists unless d = Σ λ_r n_r with λ_r ≥ 0 (Farkas's lemma): d is one of the normals, or lies between two of
them. Friction is left out. Chains of circles are left out as well: if bodies at rest hold the last circle of a chain,
its circles are pressed into each other.
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.contacts import some_contacts
from deep_contact.stepping.log import PASSED
from deep_contact.stepping.segments import has_moving, moves, wall_velocity

PARALLEL = 1e-3
"""Largest angle, rad, between d and a normal that count as one direction."""


@njit(cache=True, error_model="numpy")
def without_passed(contacts, bodies, segments, actuation, progress):
    """The contacts without those of moving segments with circles that bodies at rest hold in their way, in place.

    contacts: at the bodies' positions, with geometry. segments: at the same time. progress: of `StepLog`; it records a
    circle that has lost such a contact. actuation: `Actuation` of the step, or None.
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
    left, right = np.full(n, np.inf), np.full(n, np.inf)  # least angles of normals on both sides of d, rad
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
    """Whether segment s moves towards the circle of the i-th contact."""
    if not moves(actuation.wall, s):
        return False
    v_x, v_y = wall_velocity(segments.line, actuation.wall, s, contacts.position[i, 0], contacts.position[i, 1])
    return v_x * contacts.normal[i, 0] + v_y * contacts.normal[i, 1] < 0.0


@njit(inline="always")
def rests(b, bodies, actuation):
    """Whether body b is a wall, or a segment or fixed circle at rest."""
    n = bodies.mass.shape[0]
    if b >= n:
        return b < n + 4 or not moves(actuation.wall, b - n - 4)
    return bodies.mass[b] == math.inf and bodies.velocity[b, 0] == 0.0 and bodies.velocity[b, 1] == 0.0


@njit(inline="always")
def note_normal(way, n_x, n_y, i, left, right):
    """Update the least angles between the push on circle i and normals on its two sides, in place, by one normal.

    way: direction of the push. n_x, n_y: normal from circle i to a body at rest.
    """
    angle = math.atan2(way[0] * n_y - way[1] * n_x, way[0] * n_x + way[1] * n_y)
    if angle >= -PARALLEL:
        left[i] = min(left[i], max(angle, 0.0))
    if angle <= PARALLEL:
        right[i] = min(right[i], max(-angle, 0.0))
