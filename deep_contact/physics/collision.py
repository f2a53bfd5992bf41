"""Collision detection: which circles touch which, and which walls (broad phase, narrow phase, matching).

Everything here is compiled and works on plain arrays; what a function fills is handed to it, so that a run of many
steps allocates its memory once. Conventions: `deep_contact.state`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.physics.segments import hold_beside, insert_pairs, segment_gap
from deep_contact.state import BOTTOM, RIGHT, TOP, WALL_NORMALS, Contacts

SMALLEST_DISTANCE = 5e-13
"""Centres closer than this, in sums of their radii, have no direction between them: `parting` gives one."""


GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
"""rad"""

LEAST_NEAR, MOST_NEAR = 0.1, 1.0
"""Gap below which pairs are kept as near, in smallest radii. At the most, a packing has few second neighbours there,
and the list takes a tenth longer to read than at the least."""

NEAR_BY_MOTION = 5.0
"""Gap by the root of what circles move apart in a step, both in smallest radii. A wider one lasts for more steps, and
takes longer to make and to read: measured at 1,000 to 100,000 circles."""

LASTING = 3
"""Steps from which on a list pays. To make one takes 1.1 to 1.6 times a search, and to read it a quarter."""


TRY_AGAIN = 20
"""Searches after a list that did not fit: only a heap of overlapping circles has so many near pairs."""

CROWDED = 8
"""Circles in the cell of a circle, on average, from which on circles are sorted into levels by their size. Equal ones
have one or two; where one is large, cells are as wide as it is, and the others crowd in them."""

LEVELS, STEP = 16, 8.0
"""Levels of size: each holds circles down to an eighth of its largest radius, the last all that are left."""

X, Y, PER_METRE, COLUMNS, ROWS, FIRST_CELL = range(6)
"""Columns of `Cells.grid`."""

SEARCHES, PAIRS, WAIT = range(3)
"""Elements of `Cells.memory`."""


class Cells(NamedTuple):
    """Buffers of the broad phase over n circles, and the pairs that it found near each other (Verlet's neighbour list).

    As long as no circle has moved by more than half of what near means, apart from the motion common to all, pairs that
    touch are among those. A pile at rest, or one that falls as a whole, is sorted into cells once, then, and a list is
    not made where it would not last.

    | field  | meaning                                                                       | shape        |
    |--------|-------------------------------------------------------------------------------|--------------|
    | start  | circles `order[start[c]:start[c + 1]]` are in cell c = row * columns + column | (8n + 1000,) |
    | order  | circles by cell, in a cell by index                                           | (n,)         |
    | cell   | cell of each circle                                                           | (n,)         |
    | circle | x, y, radius in the order of `order`                                          | (n, 3)       |
    | anchor | positions at the last sorting                                                 | (n, 2)       |
    | first  | circles `near[first[a]:first[a + 1]]` are near a and come after it            | (n + 1,)     |
    | near   | circles, for each a by index                                                  | (8n + 40,)   |
    | memory | searches since the last sorting, -1 before the first; pairs in `near`, or -1; | (3,)         |
    |        | searches until a list is tried again, after one that did not fit              |              |
    | level  | of each circle, if they are sorted by size: 0 holds the largest                | (n,)         |
    | grid   | of a level: corner, m, cells per metre, columns, rows, first cell in `start`   | (16, 6)      |
    | pair   | near pairs as they were found, the lesser index first                          | (8n + 40, 2) |
    | gap    | below which a pair is near, m                                                  | (1,)         |
    """

    start: np.ndarray
    order: np.ndarray
    cell: np.ndarray
    circle: np.ndarray
    anchor: np.ndarray
    first: np.ndarray
    near: np.ndarray
    memory: np.ndarray
    level: np.ndarray
    grid: np.ndarray
    pair: np.ndarray
    gap: np.ndarray


@njit(cache=True)
def make_cells(n):
    """Buffers of the broad phase over n circles."""
    return Cells(
        np.empty(8 * n + 1000, np.int64), np.empty(n, np.int64), np.empty(n, np.int64), np.empty((n, 3)),
        np.empty((n, 2)), np.empty(n + 1, np.int64), np.empty(8 * n + 40, np.int32), np.full(3, -1),
        np.empty(n, np.int64), np.empty((LEVELS, 6)), np.empty((8 * n + 40, 2), np.int32), np.empty(1),
    )  # fmt: skip


@njit(cache=True)
def make_contacts(capacity):
    """A buffer of contacts. Nothing is written into it: memory that is not touched costs nothing."""
    m = capacity
    return Contacts(
        np.empty(m, np.int64), np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2)), np.empty(m),
        np.empty(m), np.empty(m), np.empty(m), np.empty(m),
    )  # fmt: skip


@njit(cache=True)
def first_contacts(buffer, m):
    """The first m contacts of a buffer, as views."""
    return some_contacts(buffer, 0, m)


@njit(cache=True)
def some_contacts(buffer, i, j):
    """The contacts from the i-th to before the j-th, as views."""
    return Contacts(
        buffer.body_a[i:j], buffer.body_b[i:j], buffer.position[i:j], buffer.normal[i:j], buffer.separation[i:j],
        buffer.normal_impulse[i:j], buffer.tangent_impulse[i:j], buffer.normal_start[i:j], buffer.tangent_start[i:j],
    )  # fmt: skip


@njit(cache=True)
def own_contacts(contacts):
    """The contacts in memory of their own, no larger than they are."""
    return Contacts(
        contacts.body_a.copy(), contacts.body_b.copy(), contacts.position.copy(), contacts.normal.copy(),
        contacts.separation.copy(), contacts.normal_impulse.copy(), contacts.tangent_impulse.copy(),
        contacts.normal_start.copy(), contacts.tangent_start.copy(),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def sort_into_cells(position, radius, cells, gap=0.0):
    """Broad phase: counting sort of the circles into square cells at least one diameter and a gap wide. Fills `cells`.

    position: (n, 2), m. radius: (n,), m. gap: m. Returns (columns, rows) of the grid, which covers the centres.
    Cells are wider where there would be more than four of them per circle.
    """
    n = position.shape[0]
    x_min = x_max = position[0, 0]
    y_min = y_max = position[0, 1]
    largest = radius[0]
    for i in range(n):
        x_min = min(x_min, position[i, 0])
        x_max = max(x_max, position[i, 0])
        y_min = min(y_min, position[i, 1])
        y_max = max(y_max, position[i, 1])
        largest = max(largest, radius[i])
    most = 4.0 * n + 16.0
    width = max(2.0 * largest + gap, math.sqrt((x_max - x_min) * (y_max - y_min) / most))
    width = max(width, max(x_max - x_min, y_max - y_min) / (n + 4.0))
    per_metre = 1.0 / width
    columns = int((x_max - x_min) * per_metre) + 1
    rows = int((y_max - y_min) * per_metre) + 1
    start, cell = cells.start, cells.cell
    start[: columns * rows + 1] = 0
    for i in range(n):
        column = int((position[i, 0] - x_min) * per_metre)
        row = int((position[i, 1] - y_min) * per_metre)
        cell[i] = row * columns + column
        start[cell[i] + 1] += 1
    for c in range(columns * rows):
        start[c + 1] += start[c]
    # Filled from the back, which leaves start[c + 1] where cell c begins; start is then read one further.
    for i in range(n - 1, -1, -1):
        start[cell[i] + 1] -= 1
        k = start[cell[i] + 1]
        cells.order[k] = i
        cells.circle[k, 0] = position[i, 0]
        cells.circle[k, 1] = position[i, 1]
        cells.circle[k, 2] = radius[i]
    for c in range(columns * rows):
        start[c] = start[c + 1]
    start[columns * rows] = n
    return columns, rows


@njit(cache=True, error_model="numpy")
def write_pairs(position, radius, box, skin, cells, body_a, body_b):
    """Narrow phase's test: all touching pairs, sorted by (body_a, body_b), into `body_a` and `body_b`.

    position: (n, 2), m. radius: (n,), m. box: (x_min, y_min, x_max, y_max), m. skin: of the walls, m. body_b is a
    circle, or n + wall. cells: `Cells`, about which `has_list` was asked at these positions; if they have a list, it
    saves work and changes no pair. Returns the number of pairs, or -1 if they do not fit.
    """
    n = position.shape[0]
    if cells.memory[PAIRS] >= 0:
        return write_near_pairs(position, radius, box, skin, cells, 0, n, body_a, body_b)
    # What is not a number has no cell: it would be written outside of the arrays. The caller of the run says so.
    if n == 0 or not math.isfinite(position.sum()):
        return 0
    return search_cells(position, radius, box, skin, cells, body_a, body_b)


@njit(cache=True, error_model="numpy")
def has_list(position, radius, cells):
    """Whether the pairs that touch are among those that `cells` remembers; they are found anew where that pays."""
    n, memory, half, x, y, apart = position.shape[0], cells.memory, 0.49 * cells.gap[0], 0.0, 0.0, math.inf
    if n == 0:
        return False
    if memory[SEARCHES] >= 0:
        memory[SEARCHES] += 1
        if memory[PAIRS] >= 0 and moves_within(position, cells.anchor, x, y, half):
            return True
        x, y, apart = common_motion(position, cells.anchor)
        if memory[PAIRS] >= 0 and moves_within(position, cells.anchor, x, y, half):
            return True
    if not math.isfinite(position.sum()):
        memory[PAIRS] = -1
        return False
    smallest = smallest_of(radius)
    gap, apart = MOST_NEAR * smallest, apart / max(memory[SEARCHES], 1)
    if memory[WAIT] > 0:
        memory[WAIT] -= 1
    elif LASTING * apart <= gap:
        gap = min(gap, smallest * max(LEAST_NEAR, NEAR_BY_MOTION * math.sqrt(apart / smallest)))
        find_near(position, radius, gap, cells)
        if memory[PAIRS] >= 0:
            return True
        memory[WAIT] = TRY_AGAIN
    memory[SEARCHES], memory[PAIRS] = 0, -1
    cells.anchor[:], cells.gap[0] = position, gap
    return False


@njit(cache=True, error_model="numpy")
def search_cells(position, radius, box, skin, cells, body_a, body_b):
    """`write_pairs` by the cells, without a list; where circles crowd in a few of them, by levels of size."""
    n = position.shape[0]
    columns, rows = sort_into_cells(position, radius, cells)
    if is_crowded(cells, n, columns * rows):
        if find_near_by_levels(position, radius, cells.gap[0], cells):
            return write_near_pairs(position, radius, box, skin, cells, 0, n, body_a, body_b)
        columns, rows = sort_into_cells(position, radius, cells)
    circle, order = cells.circle, cells.order
    m = 0
    for a in range(n):
        x, y, r = position[a, 0], position[a, 1], radius[a]
        row = cells.cell[a] // columns
        column = cells.cell[a] - row * columns
        first = m
        for neighbour_row in range(max(row - 1, 0), min(row + 2, rows)):
            # The cells of a row lie side by side, so three of them are one run of circles.
            start = cells.start[neighbour_row * columns + max(column - 1, 0)]
            stop = cells.start[neighbour_row * columns + min(column + 1, columns - 1) + 1]
            if m + (stop - start) + 4 > body_a.shape[0]:
                return -1
            for k in range(start, stop):
                dx = circle[k, 0] - x
                dy = circle[k, 1] - y
                reach = circle[k, 2] + r
                # Written always and kept if it touches: cheaper than a branch nobody can predict.
                body_b[m] = order[k]
                m += (dx * dx + dy * dy <= reach * reach) & (order[k] > a)
        _sort_run(body_b, first, m)
        m = write_walls(x, y, r + skin, box, n, body_b, m)
        body_a[first:m] = a
    return m


@njit(cache=True)
def moves_within(position, anchor, x, y, distance):
    """Whether every circle is within this distance of (x, y) from where it was, m. One without a position is not."""
    within, square = True, distance * distance
    for i in range(position.shape[0]):
        dx, dy = position[i, 0] - anchor[i, 0] - x, position[i, 1] - anchor[i, 1] - y
        within &= dx * dx + dy * dy <= square
    return within


@njit(cache=True, fastmath={"nnan", "nsz"})
def common_motion(position, anchor):
    """(x, y, apart): the middle of what circles have moved, and no less than what any two have moved apart, m."""
    x_min = x_max = position[0, 0] - anchor[0, 0]
    y_min = y_max = position[0, 1] - anchor[0, 1]
    for i in range(position.shape[0]):
        dx, dy = position[i, 0] - anchor[i, 0], position[i, 1] - anchor[i, 1]
        x_min, x_max, y_min, y_max = min(x_min, dx), max(x_max, dx), min(y_min, dy), max(y_max, dy)
    return 0.5 * (x_min + x_max), 0.5 * (y_min + y_max), math.hypot(x_max - x_min, y_max - y_min)


@njit(cache=True, fastmath={"nnan", "nsz"})
def smallest_of(values):
    """The least of some numbers. With these flags several are compared at a time."""
    smallest = values[0]
    for i in range(values.shape[0]):
        smallest = min(smallest, values[i])
    return smallest


@njit(cache=True, error_model="numpy")
def find_near(position, radius, gap, cells):
    """Fill the list of pairs no farther apart than the gap, m. Without a list if the pairs do not fit."""
    n = position.shape[0]
    columns, rows = sort_into_cells(position, radius, cells, gap)
    circle, order, near = cells.circle, cells.order, cells.near
    cells.anchor[:], cells.gap[0] = position, gap
    cells.memory[SEARCHES], cells.memory[PAIRS] = 0, -1
    if is_crowded(cells, n, columns * rows):
        if find_near_by_levels(position, radius, gap, cells):
            return
        columns, rows = sort_into_cells(position, radius, cells, gap)
    m = 0
    for a in range(n):
        x, y, r = position[a, 0], position[a, 1], radius[a] + gap
        row = cells.cell[a] // columns
        column = cells.cell[a] - row * columns
        first = m
        for neighbour_row in range(max(row - 1, 0), min(row + 2, rows)):
            start = cells.start[neighbour_row * columns + max(column - 1, 0)]
            stop = cells.start[neighbour_row * columns + min(column + 1, columns - 1) + 1]
            if m + (stop - start) > near.shape[0]:
                return
            for k in range(start, stop):
                dx = circle[k, 0] - x
                dy = circle[k, 1] - y
                reach = circle[k, 2] + r
                near[m] = order[k]
                m += (dx * dx + dy * dy <= reach * reach) & (order[k] > a)
        _sort_run(near, first, m)
        cells.first[a] = first
    cells.first[n] = m
    cells.memory[PAIRS] = m


@njit(cache=True)
def is_crowded(cells, n, count):
    """Whether so many cells are so full that levels of size pay."""
    in_cells_of_all = 0
    for c in range(count):
        inside = cells.start[c + 1] - cells.start[c]
        in_cells_of_all += inside * inside
    return in_cells_of_all > CROWDED * n


@njit(cache=True, error_model="numpy")
def find_near_by_levels(position, radius, gap, cells):
    """`find_near` where sizes differ: a grid for each level of size, as wide as its own largest circle.

    A circle looks for others of its level, and in all levels of larger ones. Returns whether the pairs fit; if not, or
    if one level holds all, nothing has been found, and the cells have to be sorted again.
    """
    n, near, pair, first = position.shape[0], cells.near, cells.pair, cells.first
    if not sort_into_levels(position, radius, gap, cells):
        return False
    m = 0
    first[:] = 0
    for i in range(n):
        x, y, r = position[i, 0], position[i, 1], radius[i] + gap
        for level in range(cells.level[i] + 1):
            columns, rows = int(cells.grid[level, COLUMNS]), int(cells.grid[level, ROWS])
            corner = int(cells.grid[level, FIRST_CELL])
            column = math.floor((x - cells.grid[level, X]) * cells.grid[level, PER_METRE])
            row = math.floor((y - cells.grid[level, Y]) * cells.grid[level, PER_METRE])
            left, right = int(max(column - 1, 0)), int(min(column + 1, columns - 1))
            if left > right:
                continue
            own = level == cells.level[i]
            for neighbour_row in range(int(max(row - 1, 0)), int(min(row + 2, rows))):
                start = cells.start[corner + neighbour_row * columns + left]
                stop = cells.start[corner + neighbour_row * columns + right + 1]
                if m + (stop - start) > near.shape[0]:
                    return False
                for k in range(start, stop):
                    j = cells.order[k]
                    d_x, d_y, reach = cells.circle[k, 0] - x, cells.circle[k, 1] - y, cells.circle[k, 2] + r
                    if d_x * d_x + d_y * d_y <= reach * reach and (j > i or not own):
                        pair[m, 0], pair[m, 1] = min(i, j), max(i, j)
                        first[pair[m, 0] + 1] += 1
                        m += 1
    for a in range(n):
        first[a + 1] += first[a]
    # Filled from where each run begins, which leaves first[a] where the next one begins; it is then moved back by one.
    for k in range(m):
        near[first[pair[k, 0]]] = pair[k, 1]
        first[pair[k, 0]] += 1
    for a in range(n, 0, -1):
        first[a] = first[a - 1]
    first[0] = 0
    for a in range(n):
        _sort_run(near, first[a], first[a + 1])
    cells.memory[PAIRS] = m
    return True


@njit(cache=True, error_model="numpy")
def sort_into_levels(position, radius, gap, cells):
    """Sort the circles into levels of size, and those of each level into cells of its grid. False: one holds all.

    As in `sort_into_cells`, a grid covers the centres of its circles and has at most about four cells per circle.
    """
    n, level, grid, start = position.shape[0], cells.level, cells.grid, cells.start
    largest, smallest = radius[0], radius[0]
    for i in range(n):
        largest, smallest = max(largest, radius[i]), min(smallest, radius[i])
    if STEP * smallest >= largest:
        return False
    for i in range(n):
        level[i], least = 0, largest / STEP
        while radius[i] < least and level[i] < LEVELS - 1:
            level[i] += 1
            least /= STEP
    first_cell = first_circle = 0
    for number in range(LEVELS):
        x_min = y_min = math.inf
        x_max = y_max = -math.inf
        inside, widest = 0, 0.0
        for i in range(n):
            if level[i] == number:
                inside += 1
                widest = max(widest, radius[i])
                x_min, x_max = min(x_min, position[i, 0]), max(x_max, position[i, 0])
                y_min, y_max = min(y_min, position[i, 1]), max(y_max, position[i, 1])
        if inside == 0:
            grid[number, :] = 0.0
            continue
        width, high, wide = 2.0 * widest + gap, y_max - y_min, x_max - x_min
        width = max(width, math.sqrt(wide * high / (4.0 * inside + 16.0)), max(wide, high) / (inside + 4.0))
        per_metre = (1.0 - 1e-12) / width
        columns, rows = int(wide * per_metre) + 1, int(high * per_metre) + 1
        grid[number, X], grid[number, Y], grid[number, PER_METRE] = x_min, y_min, per_metre
        grid[number, COLUMNS], grid[number, ROWS], grid[number, FIRST_CELL] = columns, rows, first_cell
        count = columns * rows
        begin = start[first_cell : first_cell + count + 1]
        begin[:] = 0
        for i in range(n):
            if level[i] == number:
                column, row = int((position[i, 0] - x_min) * per_metre), int((position[i, 1] - y_min) * per_metre)
                cells.cell[i] = row * columns + column
                begin[cells.cell[i]] += 1
        total = first_circle
        for c in range(count + 1):
            total += begin[c]
            begin[c] = total
        # Filled from the back, which leaves begin[c] where cell c begins.
        for i in range(n - 1, -1, -1):
            if level[i] == number:
                begin[cells.cell[i]] -= 1
                k = begin[cells.cell[i]]
                cells.order[k] = i
                cells.circle[k, 0], cells.circle[k, 1], cells.circle[k, 2] = position[i, 0], position[i, 1], radius[i]
        first_circle, first_cell = first_circle + inside, first_cell + count + 1
    return True


@njit(cache=True, error_model="numpy")
def write_near_pairs(position, radius, box, skin, cells, begin, end, body_a, body_b):
    """`write_pairs` from the list of those that were near, for body_a from `begin` to before `end`.

    Every pair is written, and the next one over it if it does not touch: no branch that cannot be predicted. For
    indices without a sign see `batches.choose_batches`.
    """
    n = position.shape[0]
    first, near = cells.first, cells.near
    m = 0
    for a in range(begin, end):
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
            m += dx * dx + dy * dy <= reach * reach
        before = m
        m = write_walls(x, y, r + skin, box, n, body_b, m)
        for k in range(before, m):
            body_a[k] = a
    return m


@njit(cache=True)
def write_walls(x, y, reach, box, n, body_b, m):
    """Write the walls no farther from a centre than `reach`, m, from m on. Returns what m is then."""
    for wall, gap in enumerate((y - box[1], box[2] - x, box[3] - y, x - box[0])):
        if gap <= reach:
            body_b[m] = n + wall
            m += 1
    return m


@njit(cache=True, error_model="numpy")
def _sort_run(values, start, stop):
    """Sort values[start:stop], in place: insertion sort, since a circle has few neighbours, after coarse ones with
    growing strides where it has many (Shell 1959)."""
    stride = 1
    while 9 * stride < stop - start:
        stride = 3 * stride + 1
    while stride > 0:
        for i in range(start + stride, stop):
            value = values[i]
            j = i
            while j >= start + stride and values[j - stride] > value:
                values[j] = values[j - stride]
                j -= stride
            values[j] = value
        stride //= 3


@njit(cache=True, error_model="numpy")
def find_contacts(position, radius, box, segments, skin, cells, buffer):
    """All contacts at the given positions, sorted by (body_a, body_b); impulses and starts are left as they lie.

    position: (n, 2), m. radius: (n,), m. box: (x_min, y_min, x_max, y_max), m, a tuple. segments: (S, 5), m and m/s.
    skin: of walls and segments, m. cells, buffer: memory to use. Returns views of the buffer, or of a larger one.
    """
    has_list(position, radius, cells)
    return contacts_at(position, radius, box, segments, skin, cells, buffer)


@njit(cache=True, error_model="numpy")
def contacts_at(position, radius, box, segments, skin, cells, buffer):
    """`find_contacts` after `has_list` has been asked at these positions."""
    while True:
        m = write_pairs(position, radius, box, skin, cells, buffer.body_a, buffer.body_b)
        if m >= 0 and segments.shape[0] > 0:
            m = insert_pairs(position, radius, segments, skin, buffer.body_a, buffer.body_b, m)
        if m >= 0:
            break
        # Only a heap of overlapping circles has so many pairs.
        buffer = make_contacts(2 * buffer.body_a.shape[0] + 64)
    contacts = first_contacts(buffer, m)
    write_geometry(position, radius, box, segments, skin, contacts)
    return contacts


@njit(cache=True, error_model="numpy")
def write_geometry(position, radius, box, segments, skin, contacts):
    """Narrow phase's geometry: normal, separation and point of every contact, in place.

    The point lies in the middle of the overlap. Coinciding centres have the normal of `parting`.
    """
    n = position.shape[0]
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        x, y = position[a, 0], position[a, 1]
        if b < n:
            n_x, n_y = position[b, 0] - x, position[b, 1] - y
            distance = math.sqrt(n_x * n_x + n_y * n_y)
            separation = distance - radius[a] - radius[b]
            if distance < SMALLEST_DISTANCE * (radius[a] + radius[b]):
                n_x, n_y = parting(a, b)
            else:
                n_x, n_y = n_x / distance, n_y / distance
        elif b < n + 4:
            separation = wall_gap(x, y, box, b - n) - radius[a] - skin
            n_x, n_y = WALL_NORMALS[b - n, 0], WALL_NORMALS[b - n, 1]
        else:
            separation, n_x, n_y = segment_gap(segments[b - n - 4], x, y)
            separation = separation - radius[a] - skin
        arm = radius[a] + 0.5 * separation
        contacts.normal[i, 0] = n_x
        contacts.normal[i, 1] = n_y
        contacts.separation[i] = separation
        contacts.position[i, 0] = x + arm * n_x
        contacts.position[i, 1] = y + arm * n_y


@njit(cache=True, error_model="numpy")
def parting(a, b):
    """Unit normal from circle a to circle b where their centres coincide: as if i lay at √i on the golden spiral.

    A heap in one place parts as a disc, then, and no two of its circles in one direction (H. Vogel 1979, A better way
    to construct the sunflower head, Mathematical Biosciences 44). Circles 0 and 1 part along +x, as in Box2D.
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

    old: the contacts of the step before with their solved impulses. contacts: those of the next step, or some of them
    in a row; starts and impulses are written, 0 where the pair is new, and starts of 0 without `warm`. Both are sorted,
    so one walk along both finds all matches.
    """
    last = old.body_a.shape[0]
    j = np.searchsorted(old.body_a, contacts.body_a[0]) if contacts.body_a.shape[0] > 0 else 0
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        # Most contacts follow in the new list on what they followed in the old: a branch that is predicted.
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
def any_outside(position, box):
    """Whether a centre lies outside of the box."""
    x_min, y_min, x_max, y_max = box
    outside = False
    for i in range(position.shape[0]):
        x, y = position[i, 0], position[i, 1]
        # Without branches, so that the loop vectorises.
        outside |= (x < x_min) | (x > x_max) | (y < y_min) | (y > y_max)
    return outside


@njit(cache=True)
def hold_inside(bodies, box, skin, solved):
    """Put centres that have left the box in this step, in place, half a radius inside: the wall wins over the others.

    Only what is pressed harder than the sweeps or position correction can withstand comes so far. solved: the step's
    contacts; a centre that was outside of a wall before has a contact there, and comes back by that.
    """
    n = bodies.mass.shape[0]
    was_outside = np.zeros((n, 4), np.bool_)
    for k in range(solved.body_a.shape[0]):
        a, b = solved.body_a[k], solved.body_b[k]
        if n <= b < n + 4:
            was_outside[a, b - n] = solved.separation[k] < -(bodies.radius[a] + skin)
    for i in range(n):
        for wall in range(4):
            gap = wall_gap(bodies.position[i, 0], bodies.position[i, 1], box, wall)
            if gap < 0.0 and not was_outside[i, wall]:
                back = gap - 0.5 * bodies.radius[i]
                bodies.position[i, 0] += back * WALL_NORMALS[wall, 0]
                bodies.position[i, 1] += back * WALL_NORMALS[wall, 1]


@njit(cache=True)
def hold(bodies, before, box, segments, skin, solved):
    """`hold_inside` and `hold_beside`, where they are needed."""
    if any_outside(bodies.position, box):
        hold_inside(bodies, box, skin, solved)
    if segments.shape[0] > 0:
        hold_beside(bodies, before, segments)


@njit(cache=True)
def next_contacts(bodies, before, box, segments, skin, cells, solved, warm, buffer):
    """Contacts of the step after the one that `solved` those given, found where the bodies are now.

    before: where they were, (n, 2), m; read only where there are segments (`positions_before`). warm: with the impulses
    that their pairs had solved; otherwise without. Returns the contacts: `find_contacts`.
    """
    hold(bodies, before, box, segments, skin, solved)
    contacts = find_contacts(bodies.position, bodies.radius, box, segments, skin, cells, buffer)
    carry_impulses(solved, contacts, warm)
    return contacts
