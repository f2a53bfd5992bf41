"""The segments of a world in a grid of cells, and the distance of a point from a segment.

The grid is made once a run, and where a segment moves (`context.Actuation`), after each of its moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.world import World

BESIDE, START, END = range(3)
"""The part of a segment that is nearest to a point: its interior, or one of its ends."""

_ROUNDING = 1e-9
"""Tolerance for rounding. A path that crosses the line of a segment up to this far beyond an end, in lengths of the
segment, counts as crossing the segment, so that no path slips through a joint. A normal counts as perpendicular to a
segment if its cosine differs from 1 by at most this."""

ON = 1e-4
"""Largest distance by which the end of a segment stands out of another surface and is still hidden by it, in reaches of
the circle (radius plus skin). It is a fiftieth of the slop."""

BEHIND = 0.02
"""Largest distance by which a hidden end lies behind another surface, or in a gap beyond that surface's own end, in
reaches of the circle. In such a gap a circle sinks by a hundredth of the slop."""


class Segments(NamedTuple):
    """The segments of a world, and a grid that lists, for each of its cells, the segments within reach."""

    line: np.ndarray  # (S, 5): two ends, m, and the speed of the surface, m/s
    start: np.ndarray  # (rows · columns + 1,): `near[start[c]:start[c + 1]]` are within reach of cell c
    near: np.ndarray  # segments within reach, for each cell in their order
    every: np.ndarray  # (S,): indices of all segments
    first: np.ndarray  # (2 S + 1,): `hiding[first[e]:first[e + 1]]` may hide end e = 2 s + 0 or 1 of segment s
    hiding: np.ndarray  # segments that may hide an end, for each end in their order
    grid: tuple  # (x, y) of its corner, m, cells a metre, columns, rows
    reach: float  # reach of the grid, m


NO_SEGMENTS = Segments(
    np.zeros((0, 5)), np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(1, np.int64),
    np.zeros(0, np.int64), (0.0, 0.0, 1.0, 0, 0), 0.0,
)  # fmt: skip
"""`Segments` of a world without segments."""


def segments_of(world: World) -> np.ndarray:
    """The segments of a world with the speeds of their surfaces, (S, 5), m and m/s."""
    if not world.segments:
        return NO_SEGMENTS.line
    return np.column_stack([world.segments, world.surface_speeds or np.zeros(len(world.segments))])


def segments_in_grid(world: World, reach: float) -> Segments:
    """The segments of a world in a grid for a reach, m, or a larger one. The world caches it in a hidden field."""
    kept = vars(world).get("_in_grid")
    if kept is None or kept.reach < reach:
        line = segments_of(world)
        kept = vars(world)["_in_grid"] = in_grid(line, reach, 8 * len(line) + 4000) if len(line) else NO_SEGMENTS
    return kept


def in_grid(line, reach, most):
    """`Segments` of lines, (S, 5), in a grid of about `most` cells at most, none smaller than the reach, m."""
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

    fill: changed in place; for a list, the places in `near` where the lists of the cells begin.
    """
    x, y, per_metre, columns, rows = grid
    for s in range(line.shape[0]):
        x_0, y_0, x_1, y_1 = line[s, 0], line[s, 1], line[s, 2], line[s, 3]
        first = max(int((min(y_0, y_1) - reach - y) * per_metre), 0)
        for row in range(first, min(int((max(y_0, y_1) + reach - y) * per_metre), rows - 1) + 1):
            # The part of the segment within reach of the row.
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

    fill: changed in place; for a list, the places in `hiding` where the lists of the ends begin.
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


@njit(cache=True, error_model="numpy")
def circles_beside(segments, before, position, found):
    """Write the circles that may meet a segment on their way into `found`, (n,). Returns their number.

    before, position: centres before and after the motion, (n, 2), m. All circles that come within reach of a segment
    are among those found.
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


@njit(cache=True, error_model="numpy")
def cells_of_box(grid, x_min, x_max, y_min, y_max):
    """(First column, last column, first row, last row) of the cells that a box crosses; (0, −1, 0, −1) without any."""
    corner_x, corner_y, per_metre, columns, rows = grid
    left, right = (x_min - corner_x) * per_metre, (x_max - corner_x) * per_metre
    low, high = (y_min - corner_y) * per_metre, (y_max - corner_y) * per_metre
    if not (right >= 0.0 and left < columns and high >= 0.0 and low < rows):
        return 0, -1, 0, -1
    return int(max(left, 0.0)), int(min(right, columns - 1.0)), int(max(low, 0.0)), int(min(high, rows - 1.0))


@njit(cache=True, error_model="numpy")
def is_free(start, grid, x_min, x_max, y_min, y_max):
    """Whether no segment is within reach of a box. start, grid: of `Segments`."""
    first, last, bottom, top = cells_of_box(grid, x_min, x_max, y_min, y_max)
    for row in range(bottom, top + 1):
        if start[row * grid[3] + first] != start[row * grid[3] + last + 1]:
            return False
    return True


@njit(cache=True, error_model="numpy")
def near_box(segments, x_min, x_max, y_min, y_max, buffer):
    """A list with all segments within reach of a box, and with others; some occur twice. buffer: (S,), overwritten."""
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
    """The segments after Δt, in a new grid. Their lines move in place. actuation: `context.Actuation`."""
    if actuation.moving.shape[0] == 0:
        return segments
    line = segments.line
    for s in actuation.moving:
        for c in range(4):
            line[s, c] += dt * actuation.wall[s, c]
    return in_grid_again(line, segments.reach, 8 * line.shape[0] + 100)


@njit(cache=True, error_model="numpy")
def nearest_part(segment, x, y):
    """BESIDE, START or END: the part of the segment that is nearest to a point."""
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    along = e_x * (x - segment[0]) + e_y * (y - segment[1])
    if along < 0.0:
        return START
    return END if along > e_x * e_x + e_y * e_y else BESIDE


@njit(cache=True, error_model="numpy")
def segment_gap(segment, x, y, h_x=0.0, h_y=0.0):
    """(distance, n_x, n_y): distance of a point from a segment, m, and the unit normal from the point to the segment.

    h_x, h_y: normal from an earlier search. It sets the side from which the distance is measured, so that the distance
    is negative beyond the segment; without it, that side is the side of the point. If this normal is perpendicular to
    the segment, a point that has passed an end since then still counts as beside the segment, as in Box2D: nothing
    changes at a joint within a step.
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
