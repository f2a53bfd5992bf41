"""Segments: lines beside the box, with contacts on both sides and at their ends (`World.segments`).

A segment is (x_0, y_0, x_1, y_1), m, and the speed of its surface, m/s; the segments of a world are an array (S, 5).
If an end is the nearest point of a segment, the contact of a circle is that with a point. An end that lies on another
segment or on a wall of the box, or just behind it, has no contact of its own: the other surface has it (`touches`).
Ghost vertices do this in chains of Box2D 2.3. Without this rule, a circle that rolls over a joint stumbles.

No centre ever crosses a segment at rest. Continuous collision stops fast circles at it (`continuous`), and a centre
that sweeps or position correction would push through it is clamped to its side (`hold_beside`). A moving segment passes
over a circle that resting bodies hold in its way (`passing`).

A grid of cells lists the segments within reach of a place (`in_grid`). It is made once a run, and again after each move
of a segment (`step.Drive`). The path of a circle relative to a moving segment begins at the point to which the segment
would have carried the circle's first position (`carried`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.constants import NEARLY
from deep_contact.state import World

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
def surface_velocity(segment, n_x, n_y):
    """Velocity of a segment's surface along the tangent (n_y, -n_x) of a contact with it, m/s."""
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    return segment[4] * (e_x * n_y - e_y * n_x) / math.sqrt(e_x * e_x + e_y * e_y)


@njit(cache=True)
def moves(wall, s):
    """Whether the s-th segment moves. wall: velocities of the ends, (S, 4), m/s."""
    return wall[s, 0] != 0.0 or wall[s, 1] != 0.0 or wall[s, 2] != 0.0 or wall[s, 3] != 0.0


@njit(cache=True)
def has_moving(drive):
    """Whether any segment moves. drive: `Drive` of the step, or None."""
    if drive is None:
        return False
    return drive.moving.shape[0] > 0


@njit(cache=True, error_model="numpy")
def wall_velocity(line, wall, s, x, y):
    """(v_x, v_y) of the s-th segment at its point nearest to (x, y), m/s. wall: velocities of the ends, (S, 4), m/s."""
    e_x, e_y = line[s, 2] - line[s, 0], line[s, 3] - line[s, 1]
    t = (e_x * (x - line[s, 0]) + e_y * (y - line[s, 1])) / (e_x * e_x + e_y * e_y)
    t = min(1.0, max(0.0, t))
    return wall[s, 0] + t * (wall[s, 2] - wall[s, 0]), wall[s, 1] + t * (wall[s, 3] - wall[s, 1])


@njit(cache=True, error_model="numpy")
def carried(line, wall, s, dt, x, y):
    """The place to which the s-th segment, which has moved for Δt, would have carried the point (x, y) along, m."""
    x_0, y_0 = line[s, 0] - dt * wall[s, 0], line[s, 1] - dt * wall[s, 1]
    f_x, f_y = line[s, 2] - dt * wall[s, 2] - x_0, line[s, 3] - dt * wall[s, 3] - y_0
    e_x, e_y = line[s, 2] - line[s, 0], line[s, 3] - line[s, 1]
    square = f_x * f_x + f_y * f_y
    along = (f_x * (x - x_0) + f_y * (y - y_0)) / square
    across = (f_x * (y - y_0) - f_y * (x - x_0)) / math.sqrt(square * (e_x * e_x + e_y * e_y))
    return line[s, 0] + along * e_x - across * e_y, line[s, 1] + along * e_y + across * e_x


@njit(cache=True, error_model="numpy")
def moved_segments(segments, drive, dt):
    """The segments after Δt, in a new grid. Their lines move in place. drive: `step.Drive`."""
    if drive.moving.shape[0] == 0:
        return segments
    line = segments.line
    for s in drive.moving:
        for c in range(4):
            line[s, c] += dt * drive.wall[s, c]
    return in_grid_again(line, segments.reach, 8 * line.shape[0] + 100)


def ground_velocities(contacts, world, n):
    """(Along normals, along tangents): velocities of segments and their surfaces at contacts, (m,) each, m/s.

    n: number of circles. The velocities are 0 at contacts with circles and walls.
    """
    velocities, line, wall = np.zeros((2, len(contacts.body_a))), segments_of(world), np.array(world.segment_velocities)
    if world.surface_speeds or world.segment_velocities:
        for i in np.flatnonzero(contacts.body_b >= n + 4):
            s, (n_x, n_y) = contacts.body_b[i] - n - 4, contacts.normal[i]
            velocities[1, i] = surface_velocity(line[s], n_x, n_y)
            if world.segment_velocities:
                v_x, v_y = wall_velocity(line, wall, s, *contacts.position[i])
                velocities[:, i] += v_x * n_x + v_y * n_y, v_x * n_y - v_y * n_x
    return velocities


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


@njit(cache=True, error_model="numpy")
def touches(segments, box, s, x, y, reach):
    """Whether a circle at (x, y) has a contact with segment s: within `reach`, m, and not with a hidden end.

    An end is hidden if a wall, or another segment that is at least as near, has the contact in its place. Of two ends
    that are equally near, the end of the first segment is not hidden. box: of the `World`.
    """
    line = segments.line
    segment = line[s]
    if x < min(segment[0], segment[2]) - reach or x > max(segment[0], segment[2]) + reach:
        return False
    if y < min(segment[1], segment[3]) - reach or y > max(segment[1], segment[3]) + reach:
        return False
    gap, part = segment_gap(segment, x, y)[0], nearest_part(segment, x, y)
    if not gap <= reach or part == BESIDE:
        return gap <= reach
    which = part - START  # 0: its first end, 1: its second
    end = 2 * s + which
    e_x, e_y = segment[2 * which], segment[2 * which + 1]
    if min(e_x - box[0], e_y - box[1], box[2] - e_x, box[3] - e_y) <= ON * reach:
        return False
    for k in segments.hiding[segments.first[end] : segments.first[end + 1]]:
        if hides(line[k], e_x, e_y, x, y, reach):
            other = segment_gap(line[k], x, y)[0]
            if other < gap or (other == gap and k < s) or nearest_part(line[k], x, y) == BESIDE:
                return False
    return True


@njit(cache=True, error_model="numpy")
def hides(segment, e_x, e_y, x, y, reach):
    """Whether an end (e_x, e_y) lies on a segment, or just behind it as seen from (x, y): see `ON` and `BEHIND`."""
    s_x, s_y = segment[2] - segment[0], segment[3] - segment[1]
    length = math.sqrt(s_x * s_x + s_y * s_y)
    d_x, d_y = e_x - segment[0], e_y - segment[1]
    before, along = (s_x * d_y - s_y * d_x) / length, (s_x * d_x + s_y * d_y) / length
    if s_x * (y - segment[1]) - s_y * (x - segment[0]) < 0.0:
        before = -before
    beyond = (BEHIND if nearest_part(segment, x, y) == BESIDE else ON) * reach
    return -BEHIND * reach <= before <= ON * reach and -beyond <= along <= length + beyond


@njit(cache=True)
def insert_pairs(position, radius, walls, segments, body_a, body_b, m):
    """Insert touching circles and segments into m sorted pairs, in place. Returns the new number, or -1 if full."""
    n, end = position.shape[0], m
    circles = np.empty(n, np.int64)
    for i in circles[: circles_beside(segments, position, position, circles)]:
        x, y = position[i, 0], position[i, 1]
        for s in near_box(segments, x, x, y, y, segments.every):
            if touches(segments, walls.box, s, x, y, NEARLY * (radius[i] + walls.skin)):
                if end == body_a.shape[0]:
                    return -1
                body_a[end], body_b[end] = i, n + 4 + s
                end += 1
    more_a, more_b = body_a[m:end].copy(), body_b[m:end].copy()
    i, j = m - 1, end - m - 1
    # Merged from the back. For each circle, segments come after all other bodies.
    while j >= 0:
        if i >= 0 and body_a[i] > more_a[j]:
            body_a[i + j + 1], body_b[i + j + 1] = body_a[i], body_b[i]
            i -= 1
        else:
            body_a[i + j + 1], body_b[i + j + 1] = more_a[j], more_b[j]
            j -= 1
    return end


@njit(cache=True, error_model="numpy")
def first_crossing(segments, x, y, to_x, to_y, buffer, drive):
    """Share of the straight way from (x, y) to (to_x, to_y) at the first crossing of a segment at rest, or infinity."""
    first = math.inf
    for s in near_box(segments, min(x, to_x), max(x, to_x), min(y, to_y), max(y, to_y), buffer):
        if drive is not None:
            if moves(drive.wall, s):
                continue
        first = min(first, crossing(segments.line[s], x, y, to_x, to_y))
    return first


@njit(cache=True, error_model="numpy")
def crossing(segment, x, y, to_x, to_y):
    """`first_crossing` for one segment, moving or at rest."""
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    before = e_x * (y - segment[1]) - e_y * (x - segment[0])
    after = e_x * (to_y - segment[1]) - e_y * (to_x - segment[0])
    if (before >= 0.0) != (after >= 0.0):
        share = before / (before - after)
        at_x, at_y = x + share * (to_x - x), y + share * (to_y - y)
        along = (e_x * (at_x - segment[0]) + e_y * (at_y - segment[1])) / (e_x * e_x + e_y * e_y)
        if -_ROUNDING <= along <= 1.0 + _ROUNDING:
            return share
    return math.inf


@njit(cache=True)
def positions_before(bodies, segments):
    """Positions at the start of a substep, for `hold_beside`: a copy, or without segments the positions themselves."""
    if segments is None:
        return bodies.position
    return bodies.position.copy() if segments.line.shape[0] > 0 else bodies.position


@njit(cache=True)
def may_cross(bodies, before, solved):
    """Whether a centre may have crossed a segment on its way.

    A centre that moved less than half of its radius has not crossed one, unless it was nearer than that to a segment
    before, which the separation of a contact shows. before: positions at the start, (n, 2), m. solved: contacts there.
    """
    position, radius, n = bodies.position, bodies.radius, bodies.radius.shape[0]
    body_a, body_b, separation = solved.body_a, solved.body_b, solved.separation
    crosses = False
    for i in range(n):
        m_x, m_y = position[i, 0] - before[i, 0], position[i, 1] - before[i, 1]
        crosses |= not m_x * m_x + m_y * m_y < 0.25 * radius[i] * radius[i]
    for k in range(body_a.shape[0]):
        if body_b[k] >= n + 4:
            crosses |= not separation[k] > -0.4 * radius[body_a[k]]
    return crosses


@njit(cache=True)
def hold_beside(bodies, before, segments, drive):
    """Put centres that have crossed a resting segment back, in place, to half of their way to the crossing.

    before: positions at the start of the substep, (n, 2), m. A centre crosses a segment only if it is pressed harder
    than the sweeps and position correction can withstand.
    """
    position, buffer, circles = bodies.position, np.empty_like(segments.every), np.empty(len(before), np.int64)
    for i in circles[: circles_beside(segments, before, position, circles)]:
        x, y = before[i, 0], before[i, 1]
        share = 0.5 * first_crossing(segments, x, y, position[i, 0], position[i, 1], buffer, drive)
        if share <= 0.5:
            to_x, to_y = x + share * (position[i, 0] - x), y + share * (position[i, 1] - y)
            # A centre that lies on the line, but for rounding, stays where it was.
            stays = first_crossing(segments, x, y, to_x, to_y, buffer, drive) <= 1.0
            position[i, 0], position[i, 1] = (x, y) if stays else (to_x, to_y)


@njit(cache=True, error_model="numpy")
def hold_beside_moving(bodies, before, segments, solved, drive, dt):
    """`hold_beside` for the moving segments, in place. They have moved for Δt, s. solved: contacts at the start of Δt.

    A segment passes over a centre that it crosses if the circle had no contact with it, or was fast relative to it
    (`continuous`). Returns whether a centre has changed, and a circle over which a segment passes, or −1.
    """
    position, line, n = bodies.position, segments.line, bodies.mass.shape[0]
    changed, passed = False, np.int64(-1)
    for s in drive.moving:
        for i in range(n):
            x, y = carried(line, drive.wall, s, dt, before[i, 0], before[i, 1])
            share = 0.5 * crossing(line[s], x, y, position[i, 0], position[i, 1])
            if share > 0.5 or bodies.mass[i] == math.inf:
                continue
            m_x, m_y = position[i, 0] - x, position[i, 1] - y
            if not touched(solved, i, n + 4 + s) or m_x * m_x + m_y * m_y > 0.25 * bodies.radius[i] ** 2:
                passed = np.int64(i)
                continue
            to_x, to_y = x + share * m_x, y + share * m_y
            stays, changed = crossing(line[s], x, y, to_x, to_y) <= 1.0, True
            position[i, 0], position[i, 1] = (x, y) if stays else (to_x, to_y)
    return changed, passed


@njit(cache=True)
def touched(contacts, a, b):
    """Whether there is a contact between bodies a and b."""
    for k in range(contacts.body_a.shape[0]):
        if contacts.body_a[k] == a and contacts.body_b[k] == b:
            return True
    return False


@njit(cache=True, error_model="numpy")
def time_to_touch(segment, x, y, m_x, m_y, least):
    """(time, part): when a point that moves by (m_x, m_y), m, first comes within `least`, m, of a segment; or infinity.

    The time is a share of the motion. part: `BESIDE`, `START` or `END`.
    """
    e_x, e_y = segment[2] - segment[0], segment[3] - segment[1]
    length = math.sqrt(e_x * e_x + e_y * e_y)
    gap = (e_x * (y - segment[1]) - e_y * (x - segment[0])) / length
    speed = (e_y * m_x - e_x * m_y) / length
    if gap < 0.0:
        gap, speed = -gap, -speed
    first, part = math.inf, BESIDE
    if gap >= least and speed > 0.0:
        time = (gap - least) / speed
        if nearest_part(segment, x + time * m_x, y + time * m_y) == BESIDE:
            first = time
    for end in (START, END):
        column = 0 if end == START else 2
        d_x, d_y = x - segment[column], y - segment[column + 1]
        approach, beyond = d_x * m_x + d_y * m_y, d_x * d_x + d_y * d_y - least * least
        under = approach * approach - (m_x * m_x + m_y * m_y) * beyond
        if approach < 0.0 and beyond >= 0.0 and under >= 0.0:
            time = beyond / (math.sqrt(under) - approach)
            if time < first:
                first, part = time, end
    return first, part
