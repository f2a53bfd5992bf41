"""Contacts: touching pairs, their geometry (narrow phase), and impulses that are carried over from the step before.

Functions fill arrays that their caller passes, so that a run allocates its memory once. `deep_contact.state` states the
conventions for normals and indices.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import BOTTOM, RIGHT, TOP, WALL_NORMALS, Contacts
from deep_contact.state.constants import NEARLY
from deep_contact.stepping.broad_phase import TOUCHING, circles_around, refresh_list, sort_into_cells, sum_of
from deep_contact.stepping.pairs import PairTable, pass_through
from deep_contact.stepping.segment_grid import segment_gap
from deep_contact.stepping.segments import insert_pairs

SMALLEST_DISTANCE = 5e-13
"""Distance of two centres, divided by the sum of the radii, below which the normal is undefined. `parting` then chooses
one."""

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
"""Golden angle, rad."""


class Walls(NamedTuple):
    """Geometry of the walls of the box."""

    box: tuple  # (x_min, y_min, x_max, y_max), m
    skin: float  # skin, m: distance from their surface at which walls and segments make contact


class Exclusions(NamedTuple):
    """Rules that exclude touching pairs from the contacts."""

    mass: np.ndarray | None  # (n,), kg: a pair without a free circle has no contact; None if no circle is fixed
    touches: PairTable | None  # pairs that pass through each other have no contact (`StepInput.touches`)


def make_contacts(m):
    """Return `Contacts` for m contacts, uninitialised: memory that is never written costs nothing."""
    return Contacts(
        np.empty(m, np.int64), np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2)), np.empty(m),
        np.empty(m), np.empty(m), np.empty(m), np.empty(m),
    )  # fmt: skip


more_contacts = njit(cache=True)(make_contacts)
"""`make_contacts` for compiled callers; Python callers use the plain function, which needs no compilation."""


@njit(cache=True)
def some_contacts(buffer, i, j):
    """Return contacts i to j − 1 of a buffer, as views."""
    return Contacts(
        buffer.body_a[i:j], buffer.body_b[i:j], buffer.position[i:j], buffer.normal[i:j], buffer.separation[i:j],
        buffer.normal_impulse[i:j], buffer.tangent_impulse[i:j], buffer.normal_start[i:j], buffer.tangent_start[i:j],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def write_pairs(position, radius, walls, cells, body_a, body_b):
    """Write all touching pairs, circle and circle or circle and wall, into `body_a` and `body_b`.

    The pairs are sorted by (body_a, body_b). position: (n, 2), m. radius: (n,), m. walls: `Walls`. A wall has the index
    n + wall in body_b. cells: `Cells`, after `refresh_list` at these positions; a list saves work and changes no pair.
    Returns the number of pairs, or -1 if they do not fit.
    """
    n, m = position.shape[0], np.int64(0)
    if cells.memory[0]["pairs"] >= 0:
        return write_near_pairs(position, radius, walls, cells, body_a, body_b)
    # A position that is not finite has no cell, and sorting it would write outside of the arrays. The run raises an
    # error later.
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
    """Do `write_pairs` from the list of near pairs.

    Every near pair is written, and overwritten by the next pair if it does not touch. This avoids a branch that cannot
    be predicted. `batches.choose_batches` explains the unsigned indices.
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
    """Write the walls that a circle touches into `body_b`, from place m on. Returns the place after the last wall.

    x, y: centre of the circle, m. reach: its radius plus the skin, m. A wall is written as n + wall.
    """
    reach *= NEARLY
    for wall, gap in enumerate((y - box[1], box[2] - x, box[3] - y, x - box[0])):
        if gap <= reach:
            body_b[m] = n + wall
            m += 1
    return m


@njit(cache=True, error_model="numpy")
def detect_contacts(position, radius, walls, segments, exclusions, cells, buffer):
    """Find all contacts at these positions, sorted by (body_a, body_b), with their geometry.

    Their impulses and starting impulses are not initialised. position: (n, 2), m. radius: (n,), m. walls: `Walls`.
    segments: `Segments`, or None. exclusions: `Exclusions`. cells, buffer: work arrays. Returns views of the buffer, or
    of a larger one.
    """
    refresh_list(position, radius, cells, 0.0)
    contacts = find_pairs(position, radius, walls, segments, exclusions, cells, buffer)
    write_geometry(position, radius, walls, segments, contacts, 0)
    return contacts


@njit(inline="always")
def find_pairs(position, radius, walls, segments, exclusions, cells, buffer):
    """Find the pairs of `detect_contacts`, without their geometry. `cells` are those after `refresh_list`."""
    touches = exclusions.touches
    while True:
        m = write_pairs(position, radius, walls, cells, buffer.body_a, buffer.body_b)
        if segments is not None:
            if m >= 0 and segments.line.shape[0] > 0:
                m = insert_pairs(position, radius, walls, segments, touches, buffer.body_a, buffer.body_b, m)
        if m >= 0:
            break
        # The buffer is too short. Only a heap of overlapping circles has so many pairs.
        buffer = more_contacts(2 * buffer.body_a.shape[0] + 64)
    m = without_fixed(buffer.body_a, buffer.body_b, exclusions.mass, m)
    return some_contacts(buffer, 0, without_barred(buffer.body_a, buffer.body_b, touches, radius.shape[0], m))


@njit(cache=True)
def without_fixed(body_a, body_b, mass, m):
    """Drop the pairs without a free circle from the first m pairs, in place. Returns the number of remaining pairs.

    mass: (n,), kg, or None if no circle is fixed.
    """
    if mass is None:
        return m
    n, kept = mass.shape[0], 0
    for i in range(m):
        if mass[body_a[i]] < math.inf or (body_b[i] < n and mass[body_b[i]] < math.inf):
            body_a[kept], body_b[kept] = body_a[i], body_b[i]
            kept += 1
    return kept


@njit(cache=True)
def without_barred(body_a, body_b, touches, n, m):
    """Drop the pairs that pass through each other from the first m pairs, in place. Returns the number of the others.

    touches: `StepInput.touches`; if it is None, all pairs stay. n: number of circles. Walls keep their pairs.
    """
    if touches is None:
        return m
    kept = 0
    for i in range(m):
        a, b = body_a[i], body_b[i]
        if n <= b < n + 4 or not pass_through(touches, a, b):
            body_a[kept], body_b[kept] = a, b
            kept += 1
    return kept


@njit(cache=True, error_model="numpy")
def write_geometry(position, radius, walls, segments, contacts, least):
    """Write the normal, separation and contact point of each contact, in place (narrow phase).

    The contact point is the middle of the overlap. least: contacts with body_b < least are left out. With 0 all
    contacts are written; with n, only contacts with walls and segments.
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
    """Return a unit normal from circle a to circle b for coinciding centres.

    It is the direction from point a to point b of a golden spiral, whose point i has the radius √i. A heap of circles
    in one place therefore spreads to a disc, and no two circles move in the same direction (H. Vogel 1979, A better way
    to construct the sunflower head, Mathematical Biosciences 44). Circles 0 and 1 separate along +x, as in Box2D.
    """
    x_a, y_a = math.sqrt(a) * math.cos((a - 1) * GOLDEN_ANGLE), math.sqrt(a) * math.sin((a - 1) * GOLDEN_ANGLE)
    x_b, y_b = math.sqrt(b) * math.cos((b - 1) * GOLDEN_ANGLE), math.sqrt(b) * math.sin((b - 1) * GOLDEN_ANGLE)
    distance = math.hypot(x_b - x_a, y_b - y_a)
    return (x_b - x_a) / distance, (y_b - y_a) / distance


@njit(cache=True)
def wall_gap(x, y, box, wall):
    """Return the distance of a point from a wall, m, negative outside of the box.

    wall: BOTTOM, RIGHT, TOP or LEFT.
    """
    if wall == BOTTOM:
        return y - box[1]
    if wall == RIGHT:
        return box[2] - x
    if wall == TOP:
        return box[3] - y
    return x - box[0]


@njit(cache=True)
def carry_impulses(old, contacts, warm):
    """Copy the impulses of each pair from the step before to the next step, in place: the built-in warm start.

    old: contacts of the step before, with their solved impulses. contacts: contacts of the next step, whose impulses
    and starting impulses are written. A new pair gets 0. If `warm` is false, all starting impulses are 0. Both lists
    are sorted, so that one pass over them finds all common pairs.
    """
    j, last = 0, old.body_a.shape[0]
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        # In most cases the next contact of both lists is the same pair, so that this branch is predicted well.
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
    """Return the masses of the circles, (n,), kg, if circles may be fixed, and otherwise None.

    Circles may be fixed only in a scene with actuation. actuation: `Actuation`, or None.
    """
    if actuation is None:
        return None
    return bodies.mass
