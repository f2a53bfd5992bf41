"""Collision detection: contacts between circles, and of circles with walls (broad phase, narrow phase, matching).

Callers pass the arrays that a function fills, so that a run allocates its memory once. Conventions:
`deep_contact.state`.
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
"""Distance of two centres, over the sum of the radii, below which the normal is undefined: `parting` chooses one."""

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
"""Golden angle, rad."""

LEAST_NEAR = 0.1
"""Smallest gap limit of the list of near pairs, in smallest radii: pairs with a smaller gap are near."""

MOST_NEAR = 1.0
"""Largest gap limit, in smallest radii: in a packing, few second neighbours are nearer than this."""

NEAR_BY_MOTION = 5.0
"""Gap limit over the square root of the relative displacement of circles in a step, both in smallest radii. A list with
a larger limit lasts for more steps, and takes longer to make and to read."""

LASTING = 3
"""Least number of steps that a list has to last to pay: to make a list takes longer than a search, and to read it takes
a quarter of a search."""

TRY_AGAIN = 20
"""Number of searches without a list after a list that did not fit its array, which happens only to heaps of overlapping
circles."""

CROWDED = 8
"""Mean number of circles in the cell of a circle, from which on circles are sorted into size levels. Cells are as wide
as the largest circle, so that small circles crowd in them."""

LEVELS = 16
"""Largest number of size levels. The last level holds all remaining circles."""

STEP = 8.0
"""Ratio of the largest to the smallest radius of a size level."""

GRID = np.dtype(
    [
        ("x", float),  # of the grid's corner, m
        ("y", float),
        ("per_metre", float),  # cells per metre
        ("widest", float),  # largest radius, m
        ("columns", np.int64),
        ("rows", np.int64),
        ("first_cell", np.int64),
    ]
)
"""Grid of a size level: the place and the number of its cells, and its largest radius."""

LIST_MEMORY = np.dtype(
    [
        ("searches", np.int64),  # since the last sorting; -1 before the first
        ("pairs", np.int64),  # in the list; -1 where there is none
        ("wait", np.int64),  # searches until a list is tried again, after one that did not fit
        ("gap", float),  # limit below which a pair is near, m
    ]
)
"""Age and size of the list of near pairs."""


class Walls(NamedTuple):
    """Geometry of the walls of the box."""

    box: tuple  # (x_min, y_min, x_max, y_max), m
    skin: float  # skin of walls and segments, m


class Cells(NamedTuple):
    """Buffers of the broad phase over n circles, and its list of near pairs (Verlet's neighbour list).

    All touching pairs are in the list as long as no circle has moved by more than half the gap limit, relative to the
    common motion of all circles. No list is made if it would not last long enough.
    """

    start: np.ndarray  # (8n + 1000,): circles `order[start[c]:start[c + 1]]` are in cell c
    order: np.ndarray  # (n,): circles by level and cell, in a cell by index
    cell: np.ndarray  # (n,): cell of each circle: row * columns + column in the grid of its level
    circle: np.ndarray  # (n, 3): x, y, radius in the order of `order`
    anchor: np.ndarray  # (n, 2): positions at the last sorting
    first: np.ndarray  # (n + 1,): circles `near[first[a]:first[a + 1]]` are near a and come after it
    near: np.ndarray  # (8n + 40,): near circles, for each a by index
    memory: np.ndarray  # (1,): `LIST_MEMORY`
    level: np.ndarray  # (n,): size level of each circle; level 0 holds the largest
    grid: np.ndarray  # (16,): `GRID` of each level


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
def refresh_list(position, radius, cells, ahead):
    """Make the list of near pairs in `cells` anew if it is out of date and a new list pays. Returns whether it exists.

    ahead: gap, m, up to which the list has all pairs.
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
    """Record the positions of the circles and the gap limit, m, and that there is no list for them."""
    for i in range(position.shape[0]):
        cells.anchor[i, 0], cells.anchor[i, 1] = position[i, 0], position[i, 1]
    memory = cells.memory[0]
    memory["searches"], memory["pairs"], memory["gap"] = 0, -1, gap


@njit(cache=True)
def moves_within(position, anchor, x, y, distance):
    """Whether the displacement of every circle from its anchor differs from (x, y) by at most the distance, m.

    It is False if a position is not a number.
    """
    within, square = distance >= 0.0, distance * distance
    for i in range(position.shape[0]):
        dx, dy = position[i, 0] - anchor[i, 0] - x, position[i, 1] - anchor[i, 1] - y
        within &= dx * dx + dy * dy <= square
    return within


@njit(cache=True, fastmath={"nnan", "nsz"})
def common_motion(position, anchor):
    """(x, y, apart): the middle of the circles' displacements, and an upper bound of their differences, m."""
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
    """The least of some numbers. With these fast-math flags the loop vectorises."""
    smallest = values[0]
    for i in range(values.shape[0]):
        smallest = min(smallest, values[i])
    return smallest


@njit(cache=True, error_model="numpy")
def sort_into_cells(position, radius, gap, cells):
    """Broad phase: sort the circles into cells (`sort_level`). Fills `cells`. Returns the number of size levels.

    position: (n, 2), m. radius: (n,), m. gap: largest gap of the pairs to be found, m. All circles share one level,
    unless small circles crowd in the cells of the largest.
    """
    cells.level[:] = 0
    levels, last = 0, 1
    while levels < last:
        # Typed zeros: a literal 0 has a type of its own, for which `sort_level` would be compiled once more.
        levels, cell, circle = last, np.int64(0), np.int64(0)
        for number in range(levels):
            cell, circle = sort_level(number, position, radius, gap, cell, circle, cells)
        if levels == 1 and is_crowded(cells, radius.shape[0], cell):
            last = choose_levels(radius, cells.level)
    return levels


@njit(cache=True, error_model="numpy")
def sort_level(number, position, radius, gap, first_cell, first_circle, cells):
    """Counting sort of the circles of one level into square cells at least one diameter and a gap wide.

    Fills `grid` of the level, and `start` and `order` from the first cell and the first circle on. Returns the cell and
    the circle after the last. The grid covers the centres. Cells are wider if there would be more than about four of
    them per circle.
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
        grid["columns"] = 0  # no cells: those of an earlier search are not read
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
    """Whether the first cells are so full that size levels pay. n: number of circles. count: number of these cells."""
    in_cells_of_all = 0
    for c in range(count - 1):
        inside = cells.start[c + 1] - cells.start[c]
        in_cells_of_all += inside * inside
    return in_cells_of_all > CROWDED * n


@njit(cache=True, error_model="numpy")
def choose_levels(radius, level):
    """Fill the level of each circle by its size. Returns the number of levels, which is 1 if the radii are similar."""
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
    """Write circles with an index above a into `found`, from place m on, sorted: those near the centre of circle a.

    A circle is near if its centre is within `reach` plus its own radius, m. Returns the place after the last, or -1 if
    the circles may not fit.
    """
    x, y, first = position[a, 0], position[a, 1], np.int64(m)
    circle, order = cells.circle, cells.order
    for level in range(levels):
        grid = cells.grid[level]
        columns, per_metre = grid["columns"], grid["per_metre"]
        column, row = (x - grid["x"]) * per_metre, (y - grid["y"]) * per_metre
        span = TOUCHING * (reach + grid["widest"]) * per_metre + 1e-9  # the summand exceeds rounding
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
                # Written always and kept if it is near: cheaper than a branch that cannot be predicted.
                found[m] = order[k]
                m += (d_x * d_x + d_y * d_y <= TOUCHING * within * within) & (order[k] > a)
    if m >= 0:
        _sort_run(found, first, m)
    return m


@njit(cache=True, error_model="numpy")
def find_near(position, radius, gap, cells):
    """Fill the list with the pairs whose gap is at most `gap`, m. If the pairs do not fit, there is no list."""
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
    """Clamp centres that have left the box in this step to half a radius inside of it, in place: walls win.

    A centre leaves the box only if it is pressed harder than the sweeps and position correction can withstand. solved:
    contacts of the step. A centre that was outside of a wall before has a contact with it, which brings it back.
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
    """Clamp centres to the inside of the box and to their side of segments, in place (`hold_inside`, `hold_beside`).

    before: positions at the start of the substep, (n, 2), m; read only if there are segments (`positions_before`).
    solved: contacts at those positions. drive: `Drive` of the substep, or None. dt: Δt of the substep, s.
    Returns a circle over which a moving segment passes, or −1.
    """
    passed = np.int64(-1)
    if any_outside(bodies.position, walls.box):
        hold_inside(bodies, walls, solved)
    if segments is not None:
        if segments.line.shape[0] > 0 and may_cross(bodies, before, solved):
            hold_beside(bodies, before, segments, drive)
    if drive is not None:
        # Resting bodies come last, so that they win over moving ones. `hold_beside` puts a centre between two points of
        # the box, and so into the box.
        changed, passed = hold_beside_moving(bodies, before, segments, solved, drive, dt)
        if any_outside(bodies.position, walls.box):
            hold_inside(bodies, walls, solved)
            changed = True
        if changed:
            hold_beside(bodies, before, segments, drive)
    return passed


@njit(cache=True)
def mass_if_fixed(bodies, drive):
    """The masses if circles may be fixed, that is, in a scene with actuation; otherwise None."""
    if drive is None:
        return None
    return bodies.mass
