"""Broad phase: finds circles that are near one another, by a grid of cells and by a list of near pairs.

The list is valid for several steps. It contains all pairs of circles whose gap is at most the *gap limit*.

Tests: tests/stepping/test_contacts.py
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.constants import NEARLY

LEAST_NEAR = 0.1
"""Smallest value of the gap limit, in units of the smallest radius."""

MOST_NEAR = 1.0
"""Largest value of the gap limit, in units of the smallest radius. In a packing, few second neighbours have a smaller
gap."""

NEAR_BY_MOTION = 5.0
"""Factor c of the gap limit g = c √d, where d is the relative displacement of circles in a step. g and d are in units
of the smallest radius. With a larger gap limit a list lasts for more steps, but takes longer to make and to read."""

LASTING = 3
"""A list is made only if it will be valid for at least this number of steps. To make a list takes longer than a search
by cells; to read it takes a quarter of a search."""

TRY_AGAIN = 20
"""If a list is too long for its array, no list is made in this number of searches. A list is too long only in heaps of
overlapping circles."""

CROWDED = 8
"""Circles are sorted into size levels if the cell of a circle contains, on average, more circles than this. Without
levels the cells are as wide as the largest circle, and one cell can contain many small circles."""

LEVELS = 16
"""Largest number of size levels. The last level contains all smaller circles."""

STEP = 8.0
"""Largest ratio of two radii in one size level."""

GRID = np.dtype(
    [
        ("x", float),  # corner of the grid, m
        ("y", float),
        ("per_metre", float),  # number of cells per metre
        ("widest", float),  # largest radius, m
        ("columns", np.int64),
        ("rows", np.int64),
        ("first_cell", np.int64),
    ]
)
"""Grid of a size level: its place, the number of its cells, and the largest radius of the level."""

LIST_MEMORY = np.dtype(
    [
        ("searches", np.int64),  # number of searches since `anchor` was set; -1 before
        ("pairs", np.int64),  # number of pairs in the list; -1 without a list
        ("wait", np.int64),  # number of searches before another list is made
        ("gap", float),  # gap limit, m: pairs with at most this gap are near
    ]
)
"""Age and size of the list of near pairs."""


class Cells(NamedTuple):
    """Buffers of the broad phase over n circles, and its list of near pairs (Verlet's neighbour list).

    The list contains all touching pairs as long as no circle has moved by more than half the gap limit since the list
    was made. Displacements are measured relative to the common motion of all circles. A list is made only if it will be
    valid for some steps (`LASTING`).
    """

    start: np.ndarray  # (8n + 1000,): cell c contains the circles `order[start[c]:start[c + 1]]`
    order: np.ndarray  # (n,): circles, sorted by level, then by cell, then by index
    cell: np.ndarray  # (n,): cell of each circle: row * columns + column in the grid of its level
    circle: np.ndarray  # (n, 3): x, y and radius of the circles, in the order of `order`
    anchor: np.ndarray  # (n, 2): positions that `remember` stored last, m
    first: np.ndarray  # (n + 1,): `near[first[a]:first[a + 1]]` are the circles b > a near circle a
    near: np.ndarray  # (8n + 40,): near circles, for each circle a sorted by index
    memory: np.ndarray  # (1,): `LIST_MEMORY`
    level: np.ndarray  # (n,): size level of each circle; level 0 has the largest circles
    grid: np.ndarray  # (16,): `GRID` of each level


def make_cells(n):
    """Return `Cells` for n circles, without a list of near pairs."""
    memory = np.zeros(1, LIST_MEMORY)
    memory[0]["searches"] = memory[0]["pairs"] = memory[0]["wait"] = -1
    return Cells(
        np.empty(8 * n + 1000, np.int64), np.empty(n, np.int64), np.empty(n, np.int64), np.empty((n, 3)),
        np.empty((n, 2)), np.empty(n + 1, np.int64), np.empty(8 * n + 40, np.int32), memory,
        np.empty(n, np.int64), np.zeros(LEVELS, GRID),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def refresh_list(position, radius, cells, ahead):
    """Make a new list of near pairs if the list in `cells` is out of date and a new list saves time.

    Returns whether a valid list exists. position: (n, 2), m. radius: (n,), m. ahead: gap, m; a valid list contains all
    pairs with at most this gap.
    """
    n, memory, x, y, apart = position.shape[0], cells.memory[0], 0.0, 0.0, math.inf
    half = 0.49 * (memory["gap"] - ahead)
    if n == 0:
        return False
    if memory["searches"] >= 0:
        memory["searches"] += ahead == 0.0
        if memory["pairs"] >= 0 and stays_within(position, cells.anchor, x, y, half):
            return True
        x, y, apart = common_motion(position, cells.anchor)
        if memory["pairs"] >= 0 and stays_within(position, cells.anchor, x, y, half):
            return True
    if not math.isfinite(sum_of(position)):
        memory["pairs"] = -1
        return False
    smallest = smallest_of(radius)
    gap, apart = MOST_NEAR * smallest, apart / max(memory["searches"], 1)
    if memory["wait"] > 0:
        memory["wait"] -= 1
    elif LASTING * apart + ahead <= gap:
        gap = min(gap, ahead + smallest * max(LEAST_NEAR, NEAR_BY_MOTION * math.sqrt(apart / smallest)))
        find_near(position, radius, gap, cells)
        if memory["pairs"] >= 0:
            return True
        memory["wait"] = TRY_AGAIN
    remember(position, gap, cells)
    return False


@njit(cache=True)
def remember(position, gap, cells):
    """Store the positions of the circles and the gap limit, m, in `cells`, and that there is no list of near pairs."""
    for i in range(position.shape[0]):
        cells.anchor[i, 0], cells.anchor[i, 1] = position[i, 0], position[i, 1]
    memory = cells.memory[0]
    memory["searches"], memory["pairs"], memory["gap"] = 0, -1, gap


@njit(cache=True)
def stays_within(position, anchor, x, y, distance):
    """Return whether the displacement of every circle from its anchor differs from (x, y), m, by at most `distance`, m.

    The result is False if a position is not a number.
    """
    within, square = distance >= 0.0, distance * distance
    for i in range(position.shape[0]):
        dx, dy = position[i, 0] - anchor[i, 0] - x, position[i, 1] - anchor[i, 1] - y
        within &= dx * dx + dy * dy <= square
    return within


@njit(cache=True, fastmath={"nnan", "nsz"})
def common_motion(position, anchor):
    """Return (x, y, apart), m: the middle of all displacements, and an upper bound of the difference of any two.

    position, anchor: centres after and before the displacements, (n, 2), m.
    """
    x_min = x_max = position[0, 0] - anchor[0, 0]
    y_min = y_max = position[0, 1] - anchor[0, 1]
    for i in range(position.shape[0]):
        dx, dy = position[i, 0] - anchor[i, 0], position[i, 1] - anchor[i, 1]
        x_min, x_max, y_min, y_max = min(x_min, dx), max(x_max, dx), min(y_min, dy), max(y_max, dy)
    return 0.5 * (x_min + x_max), 0.5 * (y_min + y_max), math.hypot(x_max - x_min, y_max - y_min)


@njit(cache=True)
def sum_of(rows):
    """Return the sum of all elements of an array, (n, 2). It is not finite if an element is not finite.

    Numba's own `sum` would compile four functions more.
    """
    total = 0.0
    for i in range(rows.shape[0]):
        total += rows[i, 0]
        total += rows[i, 1]
    return total


@njit(cache=True, fastmath={"nnan", "nsz"})
def smallest_of(values):
    """Return the smallest of these numbers, (k,). The fast-math flags let the loop vectorise."""
    smallest = values[0]
    for i in range(values.shape[0]):
        smallest = min(smallest, values[i])
    return smallest


@njit(cache=True, error_model="numpy")
def sort_into_cells(position, radius, gap, cells):
    """Sort the circles into cells (`sort_level`), and fill `cells`. Returns the number of size levels.

    position: (n, 2), m. radius: (n,), m. gap: largest gap of the pairs to be found, m. All circles share one level,
    unless small circles crowd in the cells of the largest.
    """
    cells.level[:] = 0
    levels, last = 0, 1
    while levels < last:
        # Typed zeros: a literal 0 has a type of its own, and `sort_level` would be compiled once more for it.
        levels, cell, circle = last, np.int64(0), np.int64(0)
        for number in range(levels):
            cell, circle = sort_level(number, position, radius, gap, cell, circle, cells)
        if levels == 1 and is_crowded(cells, radius.shape[0], cell):
            last = choose_levels(radius, cells.level)
    return levels


@njit(cache=True, error_model="numpy")
def sort_level(number, position, radius, gap, first_cell, first_circle, cells):
    """Sort the circles of one size level into square cells (counting sort).

    The grid covers the centres of the level's circles. A cell is at least as wide as the largest diameter of the level
    plus `gap`, m. Cells are wider if there would be more than about four of them per circle.
    number: the size level. first_cell, first_circle: places in `cells.start` and `cells.order` at which this level
    begins. Returns the places after the last cell and the last circle.
    """
    n, level, grid = position.shape[0], cells.level, cells.grid[number]
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
        grid["columns"] = 0  # without cells, so that those of an earlier search are not read
        return first_cell, first_circle
    high, wide = y_max - y_min, x_max - x_min
    width = max(2.0 * widest + gap, math.sqrt(wide * high / (4.0 * inside + 16.0)))
    per_metre = (1.0 - 1e-12) / max(width, max(wide, high) / (inside + 4.0))
    columns, rows = int(wide * per_metre) + 1, int(high * per_metre) + 1
    grid["x"], grid["y"], grid["per_metre"], grid["widest"] = x_min, y_min, per_metre, widest
    grid["columns"], grid["rows"], grid["first_cell"] = columns, rows, first_cell
    count = columns * rows
    begin = cells.start[first_cell : first_cell + count + 1]
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
    # Filled from the back. Afterwards begin[c] is the place at which cell c begins.
    for i in range(n - 1, -1, -1):
        if level[i] == number:
            begin[cells.cell[i]] -= 1
            k = begin[cells.cell[i]]
            cells.order[k] = i
            cells.circle[k, 0], cells.circle[k, 1], cells.circle[k, 2] = position[i, 0], position[i, 1], radius[i]
    return first_cell + count + 1, first_circle + inside


@njit(cache=True)
def is_crowded(cells, n, count):
    """Return whether the first `count` cells contain so many circles that size levels save time.

    n: number of circles.
    """
    in_cells_of_all = 0
    for c in range(count - 1):
        inside = cells.start[c + 1] - cells.start[c]
        in_cells_of_all += inside * inside
    return in_cells_of_all > CROWDED * n


@njit(cache=True, error_model="numpy")
def choose_levels(radius, level):
    """Write the size level of each circle into `level`, (n,). Returns the number of levels, 1 if the radii are similar.

    radius: (n,), m.
    """
    largest, smallest = radius[0], radius[0]
    for i in range(radius.shape[0]):
        largest, smallest = max(largest, radius[i]), min(smallest, radius[i])
    levels = 1
    if STEP * smallest < largest:
        for i in range(radius.shape[0]):
            level[i], least = 0, largest / STEP
            while radius[i] < least and level[i] < LEVELS - 1:
                level[i] += 1
                least /= STEP
            levels = max(levels, level[i] + 1)
    return levels


TOUCHING = NEARLY**2
"""Two circles touch if their squared distance is at most this factor times the squared sum of their radii."""


@njit(inline="always")
def circles_around(a, position, reach, levels, cells, found, m):
    """Write the circles b > a that are near circle a into `found`, sorted, from place m on.

    Circle b is near if its centre is at most `reach` plus its own radius, m, from the centre of a. levels: number of
    size levels. Returns the place after the last circle, or -1 if the circles may not fit.
    """
    x, y, first = position[a, 0], position[a, 1], np.int64(m)
    circle, order = cells.circle, cells.order
    for level in range(levels):
        grid = cells.grid[level]
        columns, per_metre = grid["columns"], grid["per_metre"]
        column, row = (x - grid["x"]) * per_metre, (y - grid["y"]) * per_metre
        span = TOUCHING * (reach + grid["widest"]) * per_metre + 1e-9  # 1e-9 exceeds the rounding error
        left, right = int(max(column - span, 0.0)), int(min(column + span, columns - 1.0))
        if left > right:
            continue
        for neighbour in range(int(max(row - span, 0.0)), int(min(row + span, grid["rows"] - 1.0)) + 1):
            # The cells of a row lie side by side in memory, so that their circles are one run of `order`.
            corner = grid["first_cell"] + neighbour * columns
            start, stop = cells.start[corner + left], cells.start[corner + right + 1]
            if m >= 0 and m + (stop - start) > found.shape[0]:
                m = -1
            if m < 0:
                continue
            for k in range(start, stop):
                d_x, d_y, within = circle[k, 0] - x, circle[k, 1] - y, circle[k, 2] + reach
                # Every circle is written, and overwritten by the next one if it is not near. A branch that cannot be
                # predicted would cost more.
                found[m] = order[k]
                m += (d_x * d_x + d_y * d_y <= TOUCHING * within * within) & (order[k] > a)
    if m >= 0:
        _sort_run(found, first, m)
    return m


@njit(cache=True, error_model="numpy")
def find_near(position, radius, gap, cells):
    """Fill the list of near pairs with the pairs whose gap is at most `gap`, m.

    If they do not fit into the array, there is no list.
    """
    n, m = position.shape[0], np.int64(0)
    levels = sort_into_cells(position, radius, gap, cells)
    remember(position, gap, cells)
    for a in range(n):
        cells.first[a] = m
        m = circles_around(a, position, radius[a] + gap, levels, cells, cells.near, m)
        if m < 0:
            return
    cells.first[n] = cells.memory[0]["pairs"] = m


@njit(cache=True, error_model="numpy")
def _sort_run(values, start, stop):
    """Sort values[start:stop], in place, by insertion.

    Many values are first sorted with larger strides (Shell 1959).
    """
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
