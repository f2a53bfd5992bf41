"""Contacts: touching pairs, their geometry (narrow phase), and the impulses that they had a step before.

What a function fills is handed to it, so that a run allocates its memory once. Conventions: `deep_contact.state`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import BOTTOM, RIGHT, TOP, WALL_NORMALS, Contacts
from deep_contact.state.constants import NEARLY
from deep_contact.stepping.broad_phase import TOUCHING, circles_around, refresh_list, sort_into_cells, sum_of
from deep_contact.stepping.segment_grid import segment_gap
from deep_contact.stepping.segments import insert_pairs

SMALLEST_DISTANCE = 5e-13
"""Distance of two centres, over the sum of the radii, below which the normal is undefined: `parting` chooses one."""

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
"""Golden angle, rad."""


class Walls(NamedTuple):
    """Geometry of the walls of the box."""

    box: tuple  # (x_min, y_min, x_max, y_max), m
    skin: float  # skin of walls and segments, m


def make_contacts(m):
    """A buffer of m contacts, uninitialised: memory that is never written costs nothing."""
    return Contacts(
        np.empty(m, np.int64), np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2)), np.empty(m),
        np.empty(m), np.empty(m), np.empty(m), np.empty(m),
    )  # fmt: skip


more_contacts = njit(cache=True)(make_contacts)
"""`make_contacts` for compiled callers; Python callers use the plain function, which needs no compilation."""


@njit(cache=True)
def some_contacts(buffer, i, j):
    """Contacts i to j − 1 of a buffer, as views."""
    return Contacts(
        buffer.body_a[i:j], buffer.body_b[i:j], buffer.position[i:j], buffer.normal[i:j], buffer.separation[i:j],
        buffer.normal_impulse[i:j], buffer.tangent_impulse[i:j], buffer.normal_start[i:j], buffer.tangent_start[i:j],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def write_pairs(position, radius, walls, cells, body_a, body_b):
    """Test of the narrow phase: write all touching pairs, sorted by (body_a, body_b), into `body_a` and `body_b`.

    position: (n, 2), m. radius: (n,), m. walls: `Walls`. body_b is a circle, or n + wall. cells: `Cells`, after
    `refresh_list` at these positions; a list saves work and changes no pair. Returns the number of pairs, or -1 if they
    do not fit.
    """
    n, m = position.shape[0], np.int64(0)
    if cells.memory[0]["pairs"] >= 0:
        return write_near_pairs(position, radius, walls, cells, body_a, body_b)
    # A position that is not finite has no cell, and would be written outside of the arrays. The run raises an error.
    if n == 0 or not math.isfinite(sum_of(position)):
        return 0
    levels = sort_into_cells(position, radius, 0.0, cells)
    for a in range(n):
        first = m
        m = circles_around(a, position, radius[a], levels, cells, body_b, m)
        if m < 0 or m + 4 > body_b.shape[0]:
            return -1
        m = write_walls(position[a, 0], position[a, 1], radius[a] + walls.skin, walls.box, n, body_b, m)
        body_a[first:m] = a
    return m


@njit(cache=True, error_model="numpy")
def write_near_pairs(position, radius, walls, cells, body_a, body_b):
    """`write_pairs` from the list of near pairs.

    Every pair is written, and overwritten by the next pair if it does not touch, which avoids a branch that cannot be
    predicted. On unsigned indices see `batches.choose_batches`.
    """
    n = position.shape[0]
    first, near, m = cells.first, cells.near, np.int64(0)
    for a in range(n):
        i, last = np.uint32(first[a]), np.uint32(first[a + 1])
        if m + (last - i) + 4 > body_a.shape[0]:
            return -1
        x, y, r = position[a, 0], position[a, 1], radius[a]
        for k in range(i, last):
            b = np.uint32(near[np.uint32(k)])
            dx = position[b, 0] - x
            dy = position[b, 1] - y
            reach = radius[b] + r
            body_a[np.uint32(m)], body_b[np.uint32(m)] = a, b
            m += dx * dx + dy * dy <= TOUCHING * reach * reach
        before = m
        m = write_walls(x, y, r + walls.skin, walls.box, n, body_b, m)
        for k in range(before, m):
            body_a[k] = a
    return m


@njit(cache=True)
def write_walls(x, y, reach, box, n, body_b, m):
    """Write the walls within `reach`, m, of the centre (x, y) from place m on. Returns the place after the last."""
    reach *= NEARLY
    for wall, gap in enumerate((y - box[1], box[2] - x, box[3] - y, x - box[0])):
        if gap <= reach:
            body_b[m] = n + wall
            m += 1
    return m


@njit(cache=True, error_model="numpy")
def detect_contacts(position, radius, mass, walls, segments, cells, buffer):
    """All contacts at these positions, sorted by (body_a, body_b); their impulses and starts are not initialised.

    position: (n, 2), m. radius: (n,), m. mass: (n,), kg; None where no circle is fixed. walls: `Walls`. segments:
    `Segments`. cells, buffer: work arrays. Returns views of the buffer, or of a larger one.
    """
    refresh_list(position, radius, cells, 0.0)
    contacts = find_pairs(position, radius, mass, walls, segments, cells, buffer)
    write_geometry(position, radius, walls, segments, contacts, 0)
    return contacts


@njit(inline="always")
def find_pairs(position, radius, mass, walls, segments, cells, buffer):
    """`find_contacts` after `refresh_list` at these positions, without the geometry of the contacts."""
    while True:
        m = write_pairs(position, radius, walls, cells, buffer.body_a, buffer.body_b)
        if segments is not None:
            if m >= 0 and segments.line.shape[0] > 0:
                m = insert_pairs(position, radius, walls, segments, buffer.body_a, buffer.body_b, m)
        if m >= 0:
            break
        # Only a heap of overlapping circles has so many pairs.
        buffer = more_contacts(2 * buffer.body_a.shape[0] + 64)
    return some_contacts(buffer, 0, without_fixed(buffer.body_a, buffer.body_b, mass, m))


@njit(cache=True)
def without_fixed(body_a, body_b, mass, m):
    """Drop the pairs without a free circle from the first m pairs, in place. Returns the number of the other pairs.

    mass: None where no circle is fixed.
    """
    if mass is None:
        return m
    n, kept = mass.shape[0], 0
    for i in range(m):
        if mass[body_a[i]] < math.inf or (body_b[i] < n and mass[body_b[i]] < math.inf):
            body_a[kept], body_b[kept] = body_a[i], body_b[i]
            kept += 1
    return kept


@njit(cache=True, error_model="numpy")
def write_geometry(position, radius, walls, segments, contacts, least):
    """Narrow phase: normal, separation and point (the middle of the overlap) of contacts, in place.

    least: contacts with a smaller body_b are left out: 0 writes all contacts, n those with walls and segments.
    """
    n = position.shape[0]
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        if b < least:
            continue
        x, y = position[a, 0], position[a, 1]
        if b < n:
            n_x, n_y = position[b, 0] - x, position[b, 1] - y
            distance = math.sqrt(n_x * n_x + n_y * n_y)
            separation = distance - radius[a] - radius[b]
            if distance < SMALLEST_DISTANCE * (radius[a] + radius[b]):
                n_x, n_y = parting(a, b)
            else:
                n_x, n_y = n_x / distance, n_y / distance
        else:
            w = min(b - n, 3)
            separation, n_x, n_y = wall_gap(x, y, walls.box, w), WALL_NORMALS[w, 0], WALL_NORMALS[w, 1]
            if segments is not None:
                if b >= n + 4:
                    separation, n_x, n_y = segment_gap(segments.line[b - n - 4], x, y)
            separation = separation - radius[a] - walls.skin
        arm = radius[a] + 0.5 * separation
        contacts.normal[i, 0] = n_x
        contacts.normal[i, 1] = n_y
        contacts.separation[i] = separation
        contacts.position[i, 0] = x + arm * n_x
        contacts.position[i, 1] = y + arm * n_y


@njit(cache=True, error_model="numpy")
def parting(a, b):
    """Unit normal from circle a to circle b if their centres coincide: as if circle i lay at √i on the golden spiral.

    A heap of circles in one place then separates as a disc, and no two circles in one direction (H. Vogel 1979, A
    better way to construct the sunflower head, Mathematical Biosciences 44). Circles 0 and 1 separate along +x, as in
    Box2D.
    """
    x_a, y_a = math.sqrt(a) * math.cos((a - 1) * GOLDEN_ANGLE), math.sqrt(a) * math.sin((a - 1) * GOLDEN_ANGLE)
    x_b, y_b = math.sqrt(b) * math.cos((b - 1) * GOLDEN_ANGLE), math.sqrt(b) * math.sin((b - 1) * GOLDEN_ANGLE)
    distance = math.hypot(x_b - x_a, y_b - y_a)
    return (x_b - x_a) / distance, (y_b - y_a) / distance


@njit(cache=True)
def wall_gap(x, y, box, wall):
    """Distance from a point to a wall, m."""
    if wall == BOTTOM:
        return y - box[1]
    if wall == RIGHT:
        return box[2] - x
    if wall == TOP:
        return box[3] - y
    return x - box[0]


@njit(cache=True)
def carry_impulses(old, contacts, warm):
    """Built-in warm starting: give every contact, in place, the impulses its pair of bodies had a step before.

    old: the contacts of the step before with their solved impulses. contacts: those of the next step, whose starts and
    impulses are written: 0 for new pairs, and starts of 0 for all pairs without `warm`. Both lists are sorted, so one
    pass over them finds all matches.
    """
    j, last = 0, old.body_a.shape[0]
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        # Most contacts have the same predecessor in both lists, so this branch is predicted well.
        if j >= last or old.body_a[j] != a or old.body_b[j] != b:
            while j < last and (old.body_a[j] < a or (old.body_a[j] == a and old.body_b[j] < b)):
                j += 1
        p_n = p_t = 0.0
        if j < last and old.body_a[j] == a and old.body_b[j] == b:
            p_n, p_t = old.normal_impulse[j], old.tangent_impulse[j]
            j += 1
        contacts.normal_impulse[i], contacts.tangent_impulse[i] = p_n, p_t
        contacts.normal_start[i], contacts.tangent_start[i] = (p_n, p_t) if warm else (0.0, 0.0)


@njit(cache=True)
def mass_if_fixed(bodies, actuation):
    """The masses if circles may be fixed, that is, in a scene with actuation; otherwise None."""
    if actuation is None:
        return None
    return bodies.mass
