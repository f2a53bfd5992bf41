"""Collision detection: which circles touch which, and which walls (broad phase, narrow phase, matching).

What a function fills is handed to it, so that a run allocates its memory once. Conventions: `deep_contact.state`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.constants import NEARLY
from deep_contact.physics.segments import hold_beside, hold_beside_moving, insert_pairs, may_cross, segment_gap
from deep_contact.state.arrays import BOTTOM, RIGHT, TOP, WALL_NORMALS, Contacts

SMALLEST_DISTANCE = 5e-13
"""Centres closer than this, in sums of their radii, have no direction between them: `parting` gives one."""

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
"""rad"""

LEAST_NEAR = 0.1
"""Smallest gap below which pairs are kept as near, in smallest radii."""

MOST_NEAR = 1.0
"""Largest such gap: a packing has few second neighbours there."""

NEAR_BY_MOTION = 5.0
"""Gap by the root of what circles move apart in a step, both in smallest radii. A wider one lasts for more steps, and
takes longer to make and to read."""

LASTING = 3
"""Steps from which on a list pays: to make one takes longer than a search, and to read it a quarter of that."""

TRY_AGAIN = 20
"""Searches after a list that did not fit: only a heap of overlapping circles has so many near pairs."""

CROWDED = 8
"""Circles in the cell of a circle, on average, from which on circles are sorted into levels by their size: where one is
large, cells are as wide as it is, and the others crowd in them."""

LEVELS = 16
"""Most levels of size. The last holds all circles that are left."""

STEP = 8.0
"""Largest radius of a level over the smallest that it holds."""

GRID = np.dtype(
    [
        ("x", float),  # of the corner, m
        ("y", float),
        ("per_metre", float),  # cells
        ("widest", float),  # largest radius, m
        ("columns", np.int64),
        ("rows", np.int64),
        ("first_cell", np.int64),
    ]
)
"""Where the cells of one level of size lie, and how large its circles are."""

LIST_MEMORY = np.dtype(
    [
        ("searches", np.int64),  # since the last sorting; -1 before the first
        ("pairs", np.int64),  # in the list; -1 where there is none
        ("wait", np.int64),  # searches until a list is tried again, after one that did not fit
        ("gap", float),  # below which a pair is near, m
    ]
)
"""What is known of the list of near pairs."""


class Walls(NamedTuple):
    """The walls of the box, as circles meet them."""

    box: tuple  # (x_min, y_min, x_max, y_max), m
    skin: float  # of walls and segments, m


class Cells(NamedTuple):
    """Buffers of the broad phase over n circles, and the pairs that it found near each other (Verlet's neighbour list).

    As long as no circle has moved by more than half of what near means, apart from the motion common to all, pairs that
    touch are among those. A list is not made where it would not last.
    """

    start: np.ndarray  # (8n + 1000,): circles `order[start[c]:start[c + 1]]` are in cell c
    order: np.ndarray  # (n,): circles by level and cell, in a cell by index
    cell: np.ndarray  # (n,): of each circle: row * columns + column in the grid of its level
    circle: np.ndarray  # (n, 3): x, y, radius in the order of `order`
    anchor: np.ndarray  # (n, 2): positions at the last sorting
    first: np.ndarray  # (n + 1,): circles `near[first[a]:first[a + 1]]` are near a and come after it
    near: np.ndarray  # (8n + 40,): circles, for each a by index
    memory: np.ndarray  # (1,): `LIST_MEMORY`
    level: np.ndarray  # (n,): of size of each circle: 0 holds the largest
    grid: np.ndarray  # (16,): of a level: `GRID`


def make_cells(n):
    """Buffers of the broad phase over n circles."""
    memory = np.zeros(1, LIST_MEMORY)
    memory[0]["searches"] = memory[0]["pairs"] = memory[0]["wait"] = -1
    return Cells(
        np.empty(8 * n + 1000, np.int64), np.empty(n, np.int64), np.empty(n, np.int64), np.empty((n, 3)),
        np.empty((n, 2)), np.empty(n + 1, np.int64), np.empty(8 * n + 40, np.int32), memory,
        np.empty(n, np.int64), np.zeros(LEVELS, GRID),
    )  # fmt: skip


def make_contacts(m):
    """A buffer of m contacts. Nothing is written into it: memory that is not touched costs nothing."""
    return Contacts(
        np.empty(m, np.int64), np.empty(m, np.int64), np.empty((m, 2)), np.empty((m, 2)), np.empty(m),
        np.empty(m), np.empty(m), np.empty(m), np.empty(m),
    )  # fmt: skip


more_contacts = njit(cache=True)(make_contacts)
"""`make_contacts` for compiled callers; Python needs no compiler for it."""


@njit(cache=True)
def some_contacts(buffer, i, j):
    """The contacts from the i-th to before the j-th, as views."""
    return Contacts(
        buffer.body_a[i:j], buffer.body_b[i:j], buffer.position[i:j], buffer.normal[i:j], buffer.separation[i:j],
        buffer.normal_impulse[i:j], buffer.tangent_impulse[i:j], buffer.normal_start[i:j], buffer.tangent_start[i:j],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def refresh_list(position, radius, cells, ahead):
    """Find the pairs that `cells` remembers anew where they are stale and that pays; whether it has a list then.

    ahead: m; the list has the pairs that are no farther apart than this, and more.
    """
    n, memory, x, y, apart = position.shape[0], cells.memory[0], 0.0, 0.0, math.inf
    half = 0.49 * (memory["gap"] - ahead)
    if n == 0:
        return False
    if memory["searches"] >= 0:
        memory["searches"] += ahead == 0.0
        if memory["pairs"] >= 0 and moves_within(position, cells.anchor, x, y, half):
            return True
        x, y, apart = common_motion(position, cells.anchor)
        if memory["pairs"] >= 0 and moves_within(position, cells.anchor, x, y, half):
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
    """Note where the circles are, and that there is no list of pairs closer than the gap, m."""
    for i in range(position.shape[0]):
        cells.anchor[i, 0], cells.anchor[i, 1] = position[i, 0], position[i, 1]
    memory = cells.memory[0]
    memory["searches"], memory["pairs"], memory["gap"] = 0, -1, gap


@njit(cache=True)
def moves_within(position, anchor, x, y, distance):
    """Whether every circle is within this distance of (x, y) from where it was, m. One without a position is not."""
    within, square = distance >= 0.0, distance * distance
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


@njit(cache=True)
def sum_of(rows):
    """The sum of an array, (n, 2): not finite where an element is not. Numba's own `sum` is four functions more."""
    total = 0.0
    for i in range(rows.shape[0]):
        total += rows[i, 0]
        total += rows[i, 1]
    return total


@njit(cache=True, fastmath={"nnan", "nsz"})
def smallest_of(values):
    """The least of some numbers. With these flags several are compared at a time."""
    smallest = values[0]
    for i in range(values.shape[0]):
        smallest = min(smallest, values[i])
    return smallest


@njit(cache=True, error_model="numpy")
def sort_into_cells(position, radius, gap, cells):
    """Broad phase: sort the circles into cells (`sort_level`). Fills `cells`. Returns the number of levels of size.

    position: (n, 2), m. radius: (n,), m. gap: m. There is one level for all circles, unless they crowd in the cells of
    the largest.
    """
    cells.level[:] = 0
    levels, last = 0, 1
    while levels < last:
        # Zeros with a type: a literal one would be a type of its own, and compiled as well.
        levels, cell, circle = last, np.int64(0), np.int64(0)
        for number in range(levels):
            cell, circle = sort_level(number, position, radius, gap, cell, circle, cells)
        if levels == 1 and is_crowded(cells, radius.shape[0], cell):
            last = choose_levels(radius, cells.level)
    return levels


@njit(cache=True, error_model="numpy")
def sort_level(number, position, radius, gap, first_cell, first_circle, cells):
    """Counting sort of the circles of one level into square cells at least one diameter and a gap wide.

    Fills `grid`, and `start` and `order` from a cell and a circle on; returns the ones after the last. The grid covers
    the centres. Cells are wider where there would be more than about four of them per circle.
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
        grid["columns"] = 0  # no cells: those of an earlier search are not looked into
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
    # Filled from the back, which leaves begin[c] where cell c begins.
    for i in range(n - 1, -1, -1):
        if level[i] == number:
            begin[cells.cell[i]] -= 1
            k = begin[cells.cell[i]]
            cells.order[k] = i
            cells.circle[k, 0], cells.circle[k, 1], cells.circle[k, 2] = position[i, 0], position[i, 1], radius[i]
    return first_cell + count + 1, first_circle + inside


@njit(cache=True)
def is_crowded(cells, n, count):
    """Whether so many of the first cells are so full that levels of size pay."""
    in_cells_of_all = 0
    for c in range(count - 1):
        inside = cells.start[c + 1] - cells.start[c]
        in_cells_of_all += inside * inside
    return in_cells_of_all > CROWDED * n


@njit(cache=True, error_model="numpy")
def choose_levels(radius, level):
    """Fill the level of each circle by its size. Returns the number of levels; 1 where sizes are alike."""
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


@njit(inline="always")
def circles_around(a, position, reach, levels, cells, found, m):
    """Write the circles after a, by index, within reach and their own radius, m, of its centre into `found` from m on.

    Returns m after them, or -1 if they may not fit.
    """
    x, y, first = position[a, 0], position[a, 1], np.int64(m)
    circle, order = cells.circle, cells.order
    for level in range(levels):
        grid = cells.grid[level]
        columns, per_metre = grid["columns"], grid["per_metre"]
        column, row = (x - grid["x"]) * per_metre, (y - grid["y"]) * per_metre
        span = TOUCHING * (reach + grid["widest"]) * per_metre + 1e-9  # more than rounding
        left, right = int(max(column - span, 0.0)), int(min(column + span, columns - 1.0))
        if left > right:
            continue
        for neighbour in range(int(max(row - span, 0.0)), int(min(row + span, grid["rows"] - 1.0)) + 1):
            # The cells of a row lie side by side, so these are one run of circles.
            corner = grid["first_cell"] + neighbour * columns
            start, stop = cells.start[corner + left], cells.start[corner + right + 1]
            if m >= 0 and m + (stop - start) > found.shape[0]:
                m = -1
            if m < 0:
                continue
            for k in range(start, stop):
                d_x, d_y, within = circle[k, 0] - x, circle[k, 1] - y, circle[k, 2] + reach
                # Written always and kept if it is near: cheaper than a branch nobody can predict.
                found[m] = order[k]
                m += (d_x * d_x + d_y * d_y <= TOUCHING * within * within) & (order[k] > a)
    if m >= 0:
        _sort_run(found, first, m)
    return m


@njit(cache=True, error_model="numpy")
def find_near(position, radius, gap, cells):
    """Fill the list of pairs no farther apart than the gap, m. Without a list if the pairs do not fit."""
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
def write_pairs(position, radius, walls, cells, body_a, body_b):
    """Narrow phase's test: all touching pairs, sorted by (body_a, body_b), into `body_a` and `body_b`.

    position: (n, 2), m. radius: (n,), m. walls: `Walls`. body_b is a circle, or n + wall. cells: `Cells`, that
    `refresh_list` has seen at these positions; if they have a list, it saves work and changes no pair. Returns the
    number of pairs, or -1 if they do not fit.
    """
    n, m = position.shape[0], np.int64(0)
    if cells.memory[0]["pairs"] >= 0:
        return write_near_pairs(position, radius, walls, cells, body_a, body_b)
    # What is not a number has no cell: it would be written outside of the arrays. The caller of the run says so.
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
    """`write_pairs` from the list of those that were near.

    Every pair is written, and the next one over it if it does not touch: no branch that cannot be predicted. For
    indices without a sign see `batches.choose_batches`.
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
    """Write the walls that a centre is within reach of, m, from m on. Returns what m is then."""
    reach *= NEARLY
    for wall, gap in enumerate((y - box[1], box[2] - x, box[3] - y, x - box[0])):
        if gap <= reach:
            body_b[m] = n + wall
            m += 1
    return m


@njit(cache=True, error_model="numpy")
def _sort_run(values, start, stop):
    """Sort values[start:stop], in place, by insertion; first with larger strides where there are many (Shell 1959)."""
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
def find_contacts(position, radius, mass, walls, segments, cells, buffer):
    """All contacts at the given positions, sorted by (body_a, body_b); impulses and starts are left as they lie.

    position: (n, 2), m. radius: (n,), m. mass: (n,), kg; None where no circle is fixed. walls: `Walls`. segments:
    `Segments`. cells, buffer: memory to use. Returns views of the buffer, or of a larger one.
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
    """Drop the pairs of bodies that do not yield from the first m, in place. Returns the number of those that stay.

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

    least: the least body b of those to write: 0 for all of them, n for walls and segments.
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

    old: the contacts of the step before with their solved impulses. contacts: those of the next step; starts and
    impulses are written, 0 where the pair is new, and starts of 0 without `warm`. Both are sorted, so one walk along
    both finds all matches.
    """
    j, last = 0, old.body_a.shape[0]
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
def hold_inside(bodies, walls, solved):
    """Put centres that have left the box in this step, in place, half a radius inside: the wall wins over the others.

    Only what is pressed harder than the sweeps or position correction can withstand comes so far. solved: the step's
    contacts; a centre that was outside of a wall before has a contact there, and comes back by that.
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
def hold(bodies, before, walls, segments, solved, drive, dt):
    """`hold_inside` and `hold_beside`, where they are needed. Returns a circle that a moving segment passes, or −1.

    before: where the bodies were, (n, 2), m; read only where there are segments (`positions_before`). solved: the
    contacts there. drive: of a step of dt, s, in which segments moved.
    """
    passed = np.int64(-1)
    if any_outside(bodies.position, walls.box):
        hold_inside(bodies, walls, solved)
    if segments is not None:
        if segments.line.shape[0] > 0 and may_cross(bodies, before, solved):
            hold_beside(bodies, before, segments, drive)
    if drive is not None:
        # What rests comes last: it wins over what moves. Half of a way inside of the box ends inside of it.
        changed, passed = hold_beside_moving(bodies, before, segments, solved, drive, dt)
        if any_outside(bodies.position, walls.box):
            hold_inside(bodies, walls, solved)
            changed = True
        if changed:
            hold_beside(bodies, before, segments, drive)
    return passed


@njit(cache=True)
def mass_if_fixed(bodies, drive):
    """The masses where circles may be fixed: in a scene with a drive; None elsewhere."""
    if drive is None:
        return None
    return bodies.mass
