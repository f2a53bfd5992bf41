"""Clamps centres to the inside of the box and to their side of each segment, after the sweeps of a substep.

Tests: tests/stepping/test_segments.py
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import WALL_NORMALS
from deep_contact.stepping.contacts import wall_gap
from deep_contact.stepping.segments import clamp_beside, clamp_beside_moving, may_cross


@njit(cache=True)
def any_outside(position, box):
    """Return whether a centre lies outside of the box. position: (n, 2), m."""
    x_min, y_min, x_max, y_max = box
    outside = False
    for i in range(position.shape[0]):
        x, y = position[i, 0], position[i, 1]
        # Without branches, so that the loop vectorises.
        outside |= (x < x_min) | (x > x_max) | (y < y_min) | (y > y_max)
    return outside


@njit(cache=True)
def clamp_to_box(bodies, walls, solved):
    """Move centres that have left the box in this substep back inside, in place, to half a radius from the wall.

    A centre leaves the box only if it is pressed harder than the sweeps and position correction can withstand. A centre
    that was outside of a wall at the start of the substep is not moved: its contact with the wall brings it back.
    solved: contacts at the start of the substep.
    """
    n = bodies.mass.shape[0]
    was_outside = np.zeros((n, 4), np.bool_)
    for k in range(solved.body_a.shape[0]):
        a, b = solved.body_a[k], solved.body_b[k]
        if n <= b < n + 4:
            was_outside[a, b - n] = solved.separation[k] < -(bodies.radius[a] + walls.skin)
    for i in range(n):
        for wall in range(4):
            gap = wall_gap(bodies.position[i, 0], bodies.position[i, 1], walls.box, wall)
            if gap < 0.0 and not was_outside[i, wall] and bodies.mass[i] < math.inf:
                back = gap - 0.5 * bodies.radius[i]
                bodies.position[i, 0] += back * WALL_NORMALS[wall, 0]
                bodies.position[i, 1] += back * WALL_NORMALS[wall, 1]


@njit(cache=True)
def clamp_inside(bodies, before, walls, segments, solved, touches, actuation, dt):
    """Clamp centres to the inside of the box and to their side of segments, in place (`clamp_to_box`, `clamp_beside`).

    before: positions at the start of the substep, (n, 2), m, from `positions_before`; read only if there are segments.
    segments: `Segments` at its end. solved: contacts at the positions before. touches: `StepInput.touches`. actuation:
    `Actuation` of the substep, or None. dt: Δt of the substep, s. Returns the index of a circle over which a moving
    segment passes, or −1.
    """
    passed = np.int64(-1)
    if any_outside(bodies.position, walls.box):
        clamp_to_box(bodies, walls, solved)
    if segments is not None:
        if segments.line.shape[0] > 0 and may_cross(bodies, before, solved):
            clamp_beside(bodies, before, segments, touches, actuation)
    if actuation is not None:
        # Bodies at rest are treated last, so that they have priority over moving ones. `clamp_beside` moves a centre to
        # a point between two points in the box, which lies in the box too.
        changed, passed = clamp_beside_moving(bodies, before, segments, solved, touches, actuation, dt)
        if any_outside(bodies.position, walls.box):
            clamp_to_box(bodies, walls, solved)
            changed = True
        if changed:
            clamp_beside(bodies, before, segments, touches, actuation)
    return passed
