"""Position correction: penetrating bodies are pushed apart, and their velocities stay as they are.

The method is the nonlinear Gauss-Seidel of Box2D 2.3. Each contact in turn moves its two bodies apart, by a share of
its present penetration beyond the slop. The bodies move in proportion to their inverse masses. Circles do not rotate.

Circles are pushed along the line of their centres. If many circles lie in almost the same place, each push changes the
directions of the next pushes, and all circles would follow the first pair along one line. A pair whose line has rotated
by more than 60° since the narrow phase is therefore pushed along the normal of the narrow phase.

`correct_tiles` corrects a tile at a time: eight contacts of which no two share a circle. For this, contacts are sorted
into levels, and a tile has contacts of one level. The level of a contact comes after the levels of all earlier contacts
that share a circle with it. Every circle therefore meets its contacts in the order of the list. No product is fused
with a sum. The result is therefore equal, to the last bit, to that of `correct_in_turn`, which corrects one contact at
a time. `correct_positions` chooses the cheaper of the two functions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit, simd
from deep_contact.compiled.simd import (
    WIDTH,
    any_less,
    lane,
    least,
    load,
    load_rows,
    most,
    spread,
    store_rows,
    times,
    where_less,
)
from deep_contact.state.arrays import RIGHT, TOP, WALL_NORMALS
from deep_contact.state.constants import BAUMGARTE, POSITION_TOLERANCE
from deep_contact.stepping.contacts import SMALLEST_DISTANCE, wall_gap
from deep_contact.stepping.segment_grid import segment_gap

IDLE = 4
"""Index of the idle body among the five bodies behind the circles; 0 to 3 are the walls. The idle body fills unused
lanes of a tile of eight contacts."""

_IDLE_RADIUS = 1e-200
"""Radius of the idle body, m. With 0, a pair of idle bodies would not count as coinciding. With a larger radius, it
could penetrate by more than the slop."""

_HEAVY = 1e200
"""Mass of a fixed circle in tiles, kg. Its displacement is far below rounding, and is not written back."""

TURNED = 0.5
"""Cosine of the angle between the line of centres and the normal of the narrow phase, below which a pair is pushed
along this normal."""

_FEW = 3
"""Levels are used only for more sweeps than this: to sort contacts into levels costs about as much as three sweeps
contact by contact."""

_FILLED = 8
"""Tiles are used only if the levels have, on average, at least this number of contacts. With fewer, correction contact
by contact costs less. In a column each level has one contact."""

_PATIENCE = 50
"""If the levels have too few contacts, they are not tried in this number of corrections: a pile does not widen in a few
steps."""

CORRECTION_MEMORY = np.dtype([("sweeps", np.int64), ("wait", np.int64)])
"""Memory of earlier corrections. sweeps: number of sweeps of the last correction. wait: number of corrections until
levels are tried again."""


class CorrectionWorkspace(NamedTuple):
    """Buffers of `correct_positions` for n circles, M contacts and T tiles of eight contacts."""

    level: np.ndarray  # (n,): for each circle, the first level after those of its contacts that are already sorted
    batch: np.ndarray  # (M,): level of each contact
    fill: np.ndarray  # (M,): number of contacts in each level; later the next free place of the level in the tiles
    body: np.ndarray  # (T, 2, 8): bodies a and b of the contacts, as rows of `centre`
    normal: np.ndarray  # (T, 2, 8): normals of these contacts, from the narrow phase
    centre: np.ndarray  # (n + 5, 4): x, y, radius, mass of the circles and of the bodies of `fill_ground`
    memory: np.ndarray  # (1,): `CORRECTION_MEMORY`


def make_correction_workspace(n, capacity):
    """Return buffers for n circles and `capacity` contacts."""
    tiles = capacity // WIDTH + capacity // _FILLED + 1
    return CorrectionWorkspace(
        np.empty(n, np.int64), np.empty(capacity, np.int64), np.empty(capacity, np.int64),
        np.empty((tiles, 2, WIDTH), np.uint32), np.empty((tiles, 2, WIDTH)), np.empty((n + 5, 4)),
        np.zeros(1, CORRECTION_MEMORY),
    )  # fmt: skip


_larger_workspace = njit(cache=True)(make_correction_workspace)


@njit(cache=True, error_model="numpy")
def correct_positions(bodies, contacts, box, segments, scales, sweeps, workspace):
    """Push the circles apart, in place, until no penetration exceeds three slops, or `sweeps` sweeps are done.

    box: (x_min, y_min, x_max, y_max), m. scales: `ContactScales`. workspace: `CorrectionWorkspace`. The memory in it
    decides whether the contacts are corrected in tiles or in turn, and changes no bit of the result. Tiles support
    walls but no segments, so that scenes with segments are corrected contact by contact.
    """
    n, m, memory = bodies.mass.shape[0], contacts.body_a.shape[0], workspace.memory[0]
    if m > workspace.batch.shape[0]:
        workspace = _larger_workspace(n, m)
    tiles, done = 0, 0
    begin = 0 if memory["sweeps"] > _FEW else _FEW
    in_turn = segments is not None and segments.line.shape[0] > 0
    if in_turn:
        begin = sweeps
    elif memory["wait"] > 0 or sweeps - begin <= _FEW:
        memory["wait"], begin = max(memory["wait"] - 1, 0), sweeps
    while done < sweeps:
        if done == begin:
            tiles = fill_levels(contacts, n, workspace)
            if tiles > 0:
                fill_centres(bodies, workspace.centre)
                fill_ground(box, scales, workspace.centre[n:])
            else:
                memory["wait"] = _PATIENCE
        if tiles > 0:
            deepest = correct_tiles(workspace.body, workspace.normal, 2, workspace.centre, 0, tiles, scales)
        else:
            deepest = correct_in_turn(bodies, contacts, box, segments, scales)
        done += 1
        if deepest >= -POSITION_TOLERANCE * scales.slop:
            break
    if tiles > 0:
        take_centres(workspace.centre, bodies)
    memory["sweeps"] = done


@njit(cache=True, error_model="numpy", _nrt=False)
def correct_in_turn(bodies, contacts, box, segments, scales):
    """Do one sweep of position correction, contact by contact, in place. Returns the least separation, m, at most 0."""
    n = bodies.mass.shape[0]
    position, radius, mass = bodies.position, bodies.radius, bodies.mass
    slop, skin, longest = scales.slop, scales.wall_skin, scales.max_correction
    deepest = 0.0
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        x, y = position[a, 0], position[a, 1]
        if b < n:
            d_x, d_y = position[b, 0] - x, position[b, 1] - y
            reach = radius[a] + radius[b]
            wanted = max(reach - slop, 0.0)  # circles smaller than the slop are not pulled together
            if d_x * d_x + d_y * d_y >= wanted * wanted:
                continue  # Nothing to correct; found without a square root.
            distance = math.sqrt(d_x * d_x + d_y * d_y)
            separation = distance - reach
            m_a, m_b = mass[a], mass[b]
            if m_a == math.inf or m_b == math.inf:  # the free circle takes the whole displacement
                m_a, m_b = (1.0, 0.0) if m_a == math.inf else (0.0, 1.0)
            push = min(BAUMGARTE * (wanted - distance), longest) / (m_a + m_b)
            n_x, n_y = contacts.normal[i, 0], contacts.normal[i, 1]
            if distance >= SMALLEST_DISTANCE * reach and d_x * n_x + d_y * n_y > TURNED * distance:
                push /= distance
            else:
                d_x, d_y = n_x, n_y
            position[b, 0] += push * m_a * d_x
            position[b, 1] += push * m_a * d_y
            position[a, 0] = x - push * m_b * d_x
            position[a, 1] = y - push * m_b * d_y
        else:
            w = min(b - n, 3)
            separation, d_x, d_y = wall_gap(x, y, box, w), WALL_NORMALS[w, 0], WALL_NORMALS[w, 1]
            if segments is not None:
                if b >= n + 4:
                    normal = contacts.normal[i]
                    separation, d_x, d_y = segment_gap(segments.line[b - n - 4], x, y, normal[0], normal[1])
            separation = separation - radius[a] - skin
            push = max(0.0, min(-BAUMGARTE * (separation + slop), longest))
            position[a, 0] = x - push * d_x
            position[a, 1] = y - push * d_y
        deepest = min(deepest, separation)
    return deepest


@njit(cache=True)
def correct_tiles(body, normal, stride, centre, first, last, scales):
    """Do `correct_in_turn` over the tiles `first` to `last` − 1, in place: eight contacts at a time, with equal bits.

    body: (T, 2, 8), bodies of each contact as rows of `centre` (`fill_ground`). normal: (T, stride, 8), whose first two
    rows are the normals of the narrow phase. centre: x, y, radius and mass of each body, (n + 5, 4).
    """
    none, tiny, turned = spread(0.0), spread(SMALLEST_DISTANCE), spread(TURNED)
    slop, share, longest = spread(scales.slop), spread(BAUMGARTE), spread(scales.max_correction)
    deepest = none
    for t in range(first, last):
        a_x, a_y, r_a, m_a = load_rows(centre, body, 2 * t)
        b_x, b_y, r_b, m_b = load_rows(centre, body, 2 * t + 1)
        d_x, d_y, reach = b_x - a_x, b_y - a_y, r_a + r_b
        wanted = most(reach - slop, none)
        square, squared = times(d_x, d_x) + times(d_y, d_y), times(wanted, wanted)
        found_x, found_y = load(normal, stride * t), load(normal, stride * t + 1)
        # A mass of 0 marks a wall: its normal is constant, and only body a moves.
        along = times(d_x, found_x) + times(d_y, found_y)
        behind = along - r_a - r_b
        if not any_less(none, where_less(none, m_b, squared - square, none - slop - behind)):
            continue  # Nothing to correct; found without a square root.
        distance = simd.root(square)
        push = least(times(share, wanted - distance), longest) / (m_a + m_b)
        # Pairs with coinciding centres, and pairs whose line of centres has rotated, are pushed along the normal of the
        # narrow phase.
        beyond = where_less(distance, times(tiny, reach), none, along - times(turned, distance))
        push = where_less(none, beyond, push / distance, push)
        push = where_less(square, squared, push, none)
        n_x, n_y = where_less(none, beyond, d_x, found_x), where_less(none, beyond, d_y, found_y)
        depth = where_less(square, squared, distance - reach, none)
        from_wall = most(none, least(times(none - share, behind + slop), longest))
        n_x, n_y = where_less(none, m_b, n_x, found_x), where_less(none, m_b, n_y, found_y)
        push_a = where_less(none, m_b, times(push, m_b), from_wall)
        push_b = where_less(none, m_b, times(push, m_a), none)
        store_rows(centre, body, 2 * t, (a_x - times(push_a, n_x), a_y - times(push_a, n_y), r_a, m_a))
        store_rows(centre, body, 2 * t + 1, (b_x + times(push_b, n_x), b_y + times(push_b, n_y), r_b, m_b))
        deepest = least(deepest, where_less(none, m_b, depth, behind))
    lowest = lane(deepest, 0)
    for j in range(1, WIDTH):
        lowest = min(lowest, lane(deepest, j))
    return lowest


@njit(cache=True)
def fill_levels(contacts, n, workspace):
    """Sort the contacts into tiles, level by level. Returns the number of tiles, or 0 if tiles would be too empty.

    The level of a contact is the first one after the levels of all earlier contacts that share a circle with it. n:
    number of circles.
    """
    level, batch, fill = workspace.level, workspace.batch, workspace.fill
    m, levels = contacts.body_a.shape[0], 0
    level[:] = 0
    for i in range(m):
        a, b = contacts.body_a[i], contacts.body_b[i]
        own = level[a]
        if b < n:
            own = max(own, level[b])
            level[b] = own + 1
        level[a] = own + 1
        if own == levels:
            fill[own] = 0
            levels += 1
        batch[i] = own
        fill[own] += 1
    if m < _FILLED * levels or m == 0:
        return 0
    tiles = 0
    for k in range(levels):
        used, fill[k] = fill[k], tiles * WIDTH
        tiles += (used + WIDTH - 1) // WIDTH
        for place in range(fill[k] + used, tiles * WIDTH):
            workspace.body[place // WIDTH, :, place % WIDTH] = n + IDLE
            workspace.normal[place // WIDTH, :, place % WIDTH] = 0.0
    for i in range(m):
        place = fill[batch[i]]
        fill[batch[i]] += 1
        a, b = contacts.body_a[i], contacts.body_b[i]
        workspace.body[place // WIDTH, 0, place % WIDTH] = a
        workspace.body[place // WIDTH, 1, place % WIDTH] = b
        normal = contacts.normal[i] if b < n else WALL_NORMALS[b - n]
        workspace.normal[place // WIDTH, 0, place % WIDTH] = normal[0]
        workspace.normal[place // WIDTH, 1, place % WIDTH] = normal[1]
    return tiles


@njit(cache=True)
def fill_centres(bodies, centre):
    """Write x, y, radius and mass of the circles into the first rows of `centre`, in place."""
    for i in range(bodies.mass.shape[0]):
        centre[i, 0], centre[i, 1] = bodies.position[i, 0], bodies.position[i, 1]
        centre[i, 2], centre[i, 3] = bodies.radius[i], min(bodies.mass[i], _HEAVY)


@njit(cache=True)
def fill_ground(box, scales, ground):
    """Write the five bodies that are not circles, (5, 4), in place: the four walls and the idle body.

    The columns are x, y, radius and mass, as for circles. A wall is stored as a corner of the box that lies on it, with
    the skin as radius, and with a mass of 0, which marks it as a wall.
    """
    for wall in range(4):
        ground[wall, 0] = box[2] if wall == RIGHT or wall == TOP else box[0]
        ground[wall, 1] = box[3] if wall == RIGHT or wall == TOP else box[1]
        ground[wall, 2], ground[wall, 3] = scales.wall_skin, 0.0
    ground[IDLE, :2], ground[IDLE, 2], ground[IDLE, 3] = 0.0, _IDLE_RADIUS, 1.0


@njit(cache=True)
def take_centres(centre, bodies):
    """Write the corrected positions into the bodies that are not fixed, in place.

    centre: (n + 5, 4); only the columns x and y are read.
    """
    for i in range(bodies.mass.shape[0]):
        if bodies.mass[i] < math.inf:
            bodies.position[i, 0], bodies.position[i, 1] = centre[i, 0], centre[i, 1]
