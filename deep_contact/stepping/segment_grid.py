"""A grid of cells that lists the segments near each cell, and the distance of a point from a segment.

The grid is made once a run. If segments move (`context.Actuation`), it is made again after each of their moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.world import World

BESIDE, START, END = range(3)
"""The part of a segment that is nearest to a point: its interior, its first end or its second end."""

_ROUNDING = 1e-9
"""Tolerance for rounding. A path that crosses the line of a segment beyond an end, by at most this share of the
segment's length, counts as crossing the segment, so that no path slips through a joint. A normal counts as
perpendicular to a segment if the cosine of their angle to the perpendicular differs from 1 by at most this number."""

ON = 1e-4
"""An end of a segment is hidden by another surface if it stands out of this surface by at most this distance, in units
of the circle's reach (radius plus skin). It is a fiftieth of the slop."""

BEHIND = 0.02
"""An end of a segment is also hidden by another surface if it lies behind this surface, or in a gap beyond the
surface's own end, by at most this distance, in units of the circle's reach. A circle sinks into such a gap by a
hundredth of the slop."""


class Segments(NamedTuple):
    """The segments of a world, and a grid that lists, for each of its cells, the segments within reach."""

    line: np.ndarray  # (S, 5): two ends x, y, x, y, m, and the speed of the surface, m/s
    start: np.ndarray  # (rows · columns + 1,): cell c lists the segments `near[start[c]:start[c + 1]]`
    near: np.ndarray  # lists of the cells, one after the other: indices of segments
    every: np.ndarray  # (S,): indices of all segments
    first: np.ndarray  # (2 S + 1,): end e = 2 s + (0 or 1) of segment s lists `hiding[first[e]:first[e + 1]]`
    hiding: np.ndarray  # lists of the ends, one after the other: indices of segments that may hide an end
    grid: tuple  # (x, y, cells a metre, columns, rows); x, y: corner of the grid, m
    reach: float  # largest distance of a listed segment from its cell, m


NO_SEGMENTS = Segments(
    np.zeros((0, 5)), np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(1, np.int64),
    np.zeros(0, np.int64), (0.0, 0.0, 1.0, 0, 0), 0.0,
)  # fmt: skip
"""`Segments` of a world without segments."""


def segments_of(world: World) -> np.ndarray:
    """Return the segments of a world with the speeds of their surfaces, (S, 5), m and m/s."""
    if not world.segments:
        return NO_SEGMENTS.line
    return np.column_stack([world.segments, world.surface_speeds or np.zeros(len(world.segments))])


def segments_in_grid(world: World, reach: float) -> Segments:
    """Return the `Segments` of a world for this reach, m, or a larger one. The world caches them in a hidden field."""
    kept = vars(world).get("_in_grid")
    if kept is None or kept.reach < reach:
        line = segments_of(world)
        kept = vars(world)["_in_grid"] = in_grid(line, reach, 8 * len(line) + 4000) if len(line) else NO_SEGMENTS
    return kept


def in_grid(line, reach, most):
    """Return `Segments` of lines, (S, 5). reach: largest distance of a listed segment from a cell, m.

    most: largest number of cells, approximately. A cell is not smaller than the reach.
    """
    beyond, every, none = 1.001 * reach, np.arange(line.shape[0]), np.zeros(0, np.int64)
    x, y = min(line[:, 0].min(), line[:, 2].min()) - beyond, min(line[:, 1].min(), line[:, 3].min()) - beyond
    wide = max(line[:, 0].max(), line[:, 2].max()) - (x + beyond) + 2.0 * beyond
    high = max(line[:, 1].max(), line[:, 3].max()) - (y + beyond) + 2.0 * beyond
    cell = max(reach, math.sqrt(wide * high / most), max(wide, high) / most)
    columns, rows = int(wide / cell) + 1, int(high / cell) + 1
    grid, start = (float(x), float(y), 1.0 / cell, columns, rows), np.zeros(rows * columns + 1, np.int64)
    list_cells(line, beyond, grid, start, none)
    start = np.cumsum(start)
    near = np.empty(start[-1], np.int64)
    list_cells(line, beyond, grid, start[:-1].copy(), near)
    first = np.zeros(2 * line.shape[0] + 1, np.int64)
    list_hiding(Segments(line, start, near, every, first, none, grid, reach), first, none)
    first = np.cumsum(first)
    hiding = np.empty(first[-1], np.int64)
    list_hiding(Segments(line, start, near, every, first, none, grid, reach), first[:-1].copy(), hiding)
    return Segments(line, start, near, every, first, hiding, grid, reach)


in_grid_again = njit(cache=True, error_model="numpy")(in_grid)
"""`in_grid` for compiled callers."""


@njit(cache=True, error_model="numpy")
def list_cells(line, reach, grid, fill, near):
    """List the segments within reach of each cell c in `near`, or count them in `fill[c + 1]` if `near` is empty.

    reach: m. fill: changed in place. If segments are listed, `fill[c]` is the place in `near` at which the list of cell
    c begins.
    """
    x, y, per_metre, columns, rows = grid
    for s in range(line.shape[0]):
        x_0, y_0, x_1, y_1 = line[s, 0], line[s, 1], line[s, 2], line[s, 3]
        first = max(int((min(y_0, y_1) - reach - y) * per_metre), 0)
        for row in range(first, min(int((max(y_0, y_1) + reach - y) * per_metre), rows - 1) + 1):
            # t_0 to t_1 is the part of the segment within reach of the row.
            low, high = y + row / per_metre - reach, y + (row + 1) / per_metre + reach
            t_0, t_1 = 0.0, 1.0
            if y_0 != y_1:
                a, b = (low - y_0) / (y_1 - y_0), (high - y_0) / (y_1 - y_0)
                t_0, t_1 = max(0.0, min(a, b)), min(1.0, max(a, b))
            a, b = x_0 + t_0 * (x_1 - x_0), x_0 + t_1 * (x_1 - x_0)
            left = max(int((min(a, b) - reach - x) * per_metre), 0)
            for column in range(left, min(int((max(a, b) + reach - x) * per_metre), columns - 1) + 1):
                c = row * columns + column
                if near.shape[0] == 0:
                    fill[c + 1] += 1
                else:
                    near[fill[c]] = s
                    fill[c] += 1


@njit(cache=True, error_model="numpy")
def list_hiding(segments, fill, hiding):
    """List the segments that may hide each end e in `hiding`, or count them in `fill[e + 1]` if `hiding` is empty.

    fill: changed in place. If segments are listed, `fill[e]` is the place in `hiding` at which the list of end e
    begins.
    """
    line, every, within = segments.line, segments.every, 1.5 * BEHIND * segments.reach
    for end in range(2 * line.shape[0]):
        s, column = end // 2, 2 * (end % 2)
        x, y = line[s, column], line[s, column + 1]
        for k in near_box(segments, x, x, y, y, every):
            if k != s and segment_gap(line[k], x, y)[0] <= within:
                if hiding.shape[0] == 0:
                    fill[end + 1] += 1
                else:
                    hiding[fill[end]] = k
                    fill[end] += 1


@njit(cache=True, error_model="numpy", _nrt=False)
def circles_beside(segments, before, position, found):
    """Write all circles that may come within reach of a segment during their motion into `found`. Returns their number.

    before, position: centres before and after the motion, (n, 2), m. found: (n,), indices. Some of the circles that are
    written do not come within reach.
    """
    (corner_x, corner_y, per_metre, columns, rows), start, reach = segments.grid, segments.start, segments.reach
    count = 0
    for i in range(position.shape[0]):
        x, y = before[i, 0], before[i, 1]
        column, row = (x - corner_x) * per_metre, (y - corner_y) * per_metre
        is_near = False
        if 0.0 <= column < columns and 0.0 <= row < rows:
            c = int(row) * columns + int(column)
            is_near = start[c] != start[c + 1]
        found[count] = i
        count += is_near or not abs(position[i, 0] - x) + abs(position[i, 1] - y) <= reach
    return count


@njit(cache=True, error_model="numpy", _nrt=False)
def cells_of_box(grid, x_min, x_max, y_min, y_max):
    """Return (first column, last column, first row, last row) of the cells that a box overlaps.

    Returns (0, −1, 0, −1) if there are none. The box is in m.
    """
    corner_x, corner_y, per_metre, columns, rows = grid
    left, right = (x_min - corner_x) * per_metre, (x_max - corner_x) * per_metre
    low, high = (y_min - corner_y) * per_metre, (y_max - corner_y) * per_metre
    if not (right >= 0.0 and left < columns and high >= 0.0 and low < rows):
        return 0, -1, 0, -1
    return int(max(left, 0.0)), int(min(right, columns - 1.0)), int(max(low, 0.0)), int(min(high, rows - 1.0))


@njit(cache=True, error_model="numpy")
def near_box(segments, x_min, x_max, y_min, y_max, buffer):
    """Return the indices of all segments within reach of a box. The list also has other segments, and some occur twice.

    buffer: (S,), overwritten.
    """
    first, last, bottom, top = cells_of_box(segments.grid, x_min, x_max, y_min, y_max)
    columns, count = segments.grid[3], 0
    if first == last and bottom == top:
        c = bottom * columns + first
        return segments.near[segments.start[c] : segments.start[c + 1]]
    for row in range(bottom, top + 1):
        begin, end = segments.start[row * columns + first], segments.start[row * columns + last + 1]
        if count + end - begin > buffer.shape[0]:
            return segments.every
        for k in range(begin, end):
            buffer[count] = segments.near[k]
            count += 1
    return buffer[:count]


@njit(cache=True, error_model="numpy")
def moved_segments(segments, actuation, dt):
    """Move the segments by their velocities for Δt, s, in place. Returns them in a new grid.

    actuation: `context.Actuation`.
    """
    if actuation.moving.shape[0] == 0:
        return segments
    line = segments.line
    for s in actuation.moving:
        for c in range(4):
            line[s, c] += dt * actuation.wall[s, c]
    return in_grid_again(line, segments.reach, 8 * line.shape[0] + 100)


@njit(cache=True, error_model="numpy", _nrt=False)
def nearest_part(segment, x, y):
    """Return BESIDE, START or END: the part of the segment that is nearest to a point."""
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    along = e_x * (x - segment[0]) + e_y * (y - segment[1])
    if along < 0.0:
        return START
    return END if along > e_x * e_x + e_y * e_y else BESIDE


@njit(cache=True, error_model="numpy", _nrt=False)
def is_beyond(segment, x, y, limit):
    """Return whether a point is certainly farther than `limit`, m, from a segment.

    If the result is False, the distance may be larger or smaller. The function has no root and no quotient, so that it
    takes a fraction of the time of `segment_gap`. In a cell with many short segments, most are beyond a circle's reach.
    """
    e_x, e_y, d_x, d_y = segment[2] - segment[0], segment[3] - segment[1], x - segment[0], y - segment[1]
    along, square = e_x * d_x + e_y * d_y, e_x * e_x + e_y * e_y
    # The margin is larger than the rounding errors of this function and of `segment_gap`.
    limit = (1.0 + 1e-9) * limit + 1e-14 * (abs(d_x) + abs(d_y))
    if along < 0.0:
        return d_x * d_x + d_y * d_y > limit * limit
    if along > square:
        d_x, d_y = x - segment[2], y - segment[3]
        return d_x * d_x + d_y * d_y > limit * limit
    across = e_x * d_y - e_y * d_x
    return across * across > limit * limit * square


@njit(cache=True, error_model="numpy", _nrt=False)
def segment_gap(segment, x, y, h_x=0.0, h_y=0.0):
    """Return (distance, n_x, n_y): the distance of a point from a segment, m, and the unit normal towards the segment.

    h_x, h_y: normal from an earlier search, or 0. The earlier normal tells on which side of the segment the point was.
    If the point is on the other side now, the distance is negative. Without an earlier normal it is never negative. If
    the earlier normal is perpendicular to the segment, the distance is measured from the line of the segment, even if
    the point has passed an end since then. As in Box2D, a contact at a joint therefore does not change within a step.
    """
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    length = math.sqrt(e_x * e_x + e_y * e_y)
    e_x, e_y = e_x / length, e_y / length
    part, side = nearest_part(segment, x, y), h_x * e_y - h_y * e_x
    if part == BESIDE or abs(side) > 1.0 - _ROUNDING:
        gap = e_x * (y - segment[1]) - e_y * (x - segment[0])
        if side < 0.0 or (side == 0.0 and gap < 0.0):
            return -gap, -e_y, e_x
        return gap, e_y, -e_x
    first = 0 if part == START else 2
    d_x, d_y = segment[first] - x, segment[first + 1] - y
    distance = math.sqrt(d_x * d_x + d_y * d_y)
    if distance == 0.0:
        return 0.0, e_y, -e_x
    return distance, d_x / distance, d_y / distance
