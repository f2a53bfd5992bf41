"""Sub-stepped soft contacts: what `advance` of the engine does, in small steps of two sweeps each (Box2D v3).

A step finds its contacts once and is divided. Normals stay as they were found; the separation follows the bodies.
A contact that penetrates beyond the slop pushes as a damped spring in the first sweep of each small step: an implicit
spring is a row with less effective mass and some of its impulse taken back (E. Catto, Soft Constraints, GDC 2011), so
`contact_solver.sweep` does it all, from targets and masses written anew for each sweep.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.constants import LINEAR_SLOP, MAX_ROTATION, MAX_TRANSLATION
from deep_contact.physics.collision import make_cells, make_contacts, next_contacts, own_contacts
from deep_contact.physics.contact_solver import apply_impulses, contact_rows, integrate_velocities, make_rows, sweep


class SoftSettings(NamedTuple):
    """Options of `methods.SoftSteps`, as the compiled functions take them."""

    substeps: int
    hertz: float
    damping_ratio: float
    push_speed: float


def soft_settings(solver) -> SoftSettings:
    """The settings from the options."""
    return SoftSettings(
        int(solver.substeps), float(solver.hertz), float(solver.damping_ratio), float(solver.push_speed)
    )


@njit(cache=True, error_model="numpy")
def advance_softly(bodies, contacts, world, dt, settings, position_sweeps, warm, steps, moving, theta, log):
    """`engine.advance` for `SoftSteps`: same arguments, same results; there are no position sweeps.

    Impulses of the contacts are those of a small step times their number, so that a start fits any division of Δt.
    """
    box, gravity, friction, restitution = world
    n, substeps = bodies.mass.shape[0], settings.substeps
    h = dt / substeps
    cells = make_cells(n)
    room, spare = make_contacts(4 * n + 64), make_contacts(4 * n + 64)
    rows_room = make_rows(4 * n + 64, moving.dtype)
    origin = np.empty_like(bodies.position)
    solved = contacts
    for k in range(steps):
        integrate_velocities(bodies, gravity, 0.0, moving)
        rows, rows_room = contact_rows(bodies, contacts, moving, restitution, rows_room)
        mass, bounce = rows.data[:, 2].copy(), rows.data[:, 6].copy()
        pressed, gap = np.zeros_like(mass), np.empty(mass.shape[0])
        origin[:] = bodies.position
        divide_impulses(rows, substeps)
        for j in range(substeps):
            add_gravity(n, gravity, h, moving)
            apply_impulses(rows, moving)
            find_gaps(contacts, bodies.position, origin, gap)
            soften(rows, gap, mass, settings, h, n)
            theta[2 * j] = sweep(rows, friction, moving)
            move(bodies, moving, h, substeps)
            find_gaps(contacts, bodies.position, origin, gap)
            harden(rows, gap, mass, h)
            theta[2 * j + 1] = sweep(rows, friction, moving)
            np.maximum(pressed, rows.impulse[:, 0], pressed)
        if restitution > 0.0:
            bounce_back(rows, bounce, pressed, moving)
        store_velocities(bodies, moving, dt)
        store_whole_impulses(rows, contacts, substeps)

        solved = contacts
        contacts, spare = next_contacts(bodies, box, cells, solved, warm, spare)
        room, spare = spare, room

        log[k, 0] = solved.body_a.shape[0]
        log[k, 1] = 2 * substeps
        log[k, 2] = theta[2 * substeps - 1]
        log[k, 3] = 2 * substeps * solved.body_a.shape[0]
    return own_contacts(solved), own_contacts(contacts)


@njit(cache=True)
def add_gravity(n, gravity, h, moving):
    """v ← v + h g for the n circles, in place."""
    for i in range(n):
        moving[i, 0] += h * gravity[0]
        moving[i, 1] += h * gravity[1]


@njit(cache=True)
def find_gaps(contacts, position, origin, gap):
    """Separation of each contact now, beyond the slop, m: what it was, and how far its bodies have moved since.

    origin: positions where the contacts were found, (n, 2). Fills gap, (m,).
    """
    n = position.shape[0]
    body_a, body_b, normal, separation = contacts.body_a, contacts.body_b, contacts.normal, contacts.separation
    for i in range(gap.shape[0]):
        a, b = body_a[i], body_b[i]
        x, y = origin[a, 0] - position[a, 0], origin[a, 1] - position[a, 1]
        if b < n:
            x += position[b, 0] - origin[b, 0]
            y += position[b, 1] - origin[b, 1]
        gap[i] = separation[i] + LINEAR_SLOP + x * normal[i, 0] + y * normal[i, 1]


@njit(cache=True, error_model="numpy")
def soften(rows, gap, mass, settings, h, n):
    """Targets and masses for the sweep that pushes: springs where contacts penetrate, in place.

    The impulse −k s (v_n + bias) − c λ of Box2D v3 (s, c: `softness`) is a plain row's of mass k s and target
    −bias − c λ / (k s), with the λ that the row has when its turn comes, and it has but one turn.
    """
    data, impulse = rows.data, rows.impulse
    hertz = min(settings.hertz, 0.25 / h)
    circles, walls = softness(hertz, settings.damping_ratio, h), softness(2.0 * hertz, settings.damping_ratio, h)
    for i in range(mass.shape[0]):
        if gap[i] > 0.0:
            data[i, 2], data[i, 6] = mass[i], -gap[i] / h
        else:
            rate, share, taken_back = circles if rows.body[i, 1] < n else walls
            data[i, 2] = mass[i] * share
            data[i, 6] = min(-rate * gap[i], settings.push_speed) - taken_back * impulse[i, 0] / data[i, 2]


@njit(cache=True)
def softness(hertz, damping_ratio, h):
    """(1/s of the gap that is closed, share of the effective mass, share of λ taken back) of an implicit spring."""
    omega = 2.0 * math.pi * hertz
    a_1 = 2.0 * damping_ratio + h * omega
    a_2 = h * omega * a_1
    return omega / a_1, a_2 / (1.0 + a_2), 1.0 / (1.0 + a_2)


@njit(cache=True, error_model="numpy")
def harden(rows, gap, mass, h):
    """Targets and masses for the sweep that relaxes: rigid contacts, which leave a gap its time to close, in place."""
    data = rows.data
    for i in range(mass.shape[0]):
        data[i, 2], data[i, 6] = mass[i], -max(gap[i], 0.0) / h


@njit(cache=True, error_model="numpy")
def move(bodies, moving, h, substeps):
    """Move the bodies by the velocities in the sweeps for h, in place; in a whole step no further than the engine's."""
    cut_velocities(bodies, moving, h * substeps)
    position, angle, radius = bodies.position, bodies.angle, bodies.radius
    for i in range(radius.shape[0]):
        position[i, 0] += h * moving[i, 0]
        position[i, 1] += h * moving[i, 1]
        angle[i] += h * moving[i, 2] / radius[i]


@njit(cache=True, error_model="numpy")
def cut_velocities(bodies, moving, dt):
    """Cut the velocities in the sweeps, in place, to `MAX_TRANSLATION` and `MAX_ROTATION` in Δt."""
    for i in range(bodies.mass.shape[0]):
        distance = dt * math.sqrt(moving[i, 0] * moving[i, 0] + moving[i, 1] * moving[i, 1])
        if distance > MAX_TRANSLATION:
            moving[i, 0] *= MAX_TRANSLATION / distance
            moving[i, 1] *= MAX_TRANSLATION / distance
        turn = abs(dt * moving[i, 2]) / bodies.radius[i]
        if turn > MAX_ROTATION:
            moving[i, 2] *= MAX_ROTATION / turn


@njit(cache=True)
def bounce_back(rows, bounce, pressed, moving):
    """Give the contacts that met fast, and pressed, the speed at which they part, in place: one pass at the end."""
    for i in range(bounce.shape[0]):
        if bounce[i] <= 0.0 or pressed[i] <= 0.0:
            continue
        a, b = rows.body[i, 0], rows.body[i, 1]
        n_x, n_y = rows.data[i, 0], rows.data[i, 1]
        v_n = (moving[b, 0] - moving[a, 0]) * n_x + (moving[b, 1] - moving[a, 1]) * n_y
        p_n = max(rows.data[i, 2] * (bounce[i] - v_n), -rows.impulse[i, 0])
        rows.impulse[i, 0] += p_n
        moving[a, 0] -= moving[a, 3] * p_n * n_x
        moving[a, 1] -= moving[a, 3] * p_n * n_y
        moving[b, 0] += moving[b, 3] * p_n * n_x
        moving[b, 1] += moving[b, 3] * p_n * n_y


@njit(cache=True, error_model="numpy")
def store_velocities(bodies, moving, dt):
    """Give the bodies, in place, the solved velocities, cut as `move` cuts them: what came after it may be faster."""
    cut_velocities(bodies, moving, dt)
    for i in range(bodies.mass.shape[0]):
        bodies.velocity[i, 0] = moving[i, 0]
        bodies.velocity[i, 1] = moving[i, 1]
        bodies.spin[i] = moving[i, 2] / bodies.radius[i]


@njit(cache=True)
def divide_impulses(rows, substeps):
    """Starting impulses of a small step from those of a whole one, in place."""
    share = rows.impulse.dtype.type(1.0 / substeps)
    for i in range(rows.impulse.shape[0]):
        rows.impulse[i, 0] *= share
        rows.impulse[i, 1] *= share


@njit(cache=True)
def store_whole_impulses(rows, contacts, substeps):
    """Write the last small step's impulses times the number of them into the contacts, in place."""
    for i in range(rows.body.shape[0]):
        contacts.normal_impulse[i] = rows.impulse[i, 0] * substeps
        contacts.tangent_impulse[i] = rows.impulse[i, 1] * substeps
