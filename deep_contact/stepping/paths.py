"""Describe the paths of circles through a step as straight pieces, and search for paths that cross.

Tests: tests/stepping/test_continuous.py
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.broad_phase import make_cells, sort_level

FREE, CARRIED, FIRM = range(3)
"""Values of `Paths.held`: how a circle is held, that is, kept from moving in one direction, by a body that it has met.

FREE: no body holds it. CARRIED: a moving body holds it. FIRM: a body at rest holds it. For a fixed circle the value
tells whether the circle itself moves or is at rest."""


class Paths(NamedTuple):
    """The paths of n circles in a step, each described by its last straight piece. Times are in units of the step.

    | field    | meaning                                                             | shape  | unit |
    |----------|---------------------------------------------------------------------|--------|------|
    | step     | `StepInput` of the step, whose bodies are at the end of the step    |        |      |
    | segments | `Segments` at the end of the step                                   |        |      |
    | start    | centre at the start of the step                                     | (n, 2) | m    |
    | place    | centre at the start of the last piece                               | (n, 2) | m    |
    | since    | time at the start of the last piece                                 | (n,)   | –    |
    | rate     | rate of the last piece: its displacement if it lasted a whole step  | (n, 2) | m    |
    | inverse  | inverse mass                                                        | (n,)   | 1/kg |
    | held     | `FREE`, `CARRIED` or `FIRM`                                         | (n,)   | –    |
    | block    | unit vector to the body that the circle has met last, if not `FREE` | (n, 2) | –    |
    | carrier  | rate of that body along `block`                                      | (n,)   | m    |
    | touches  | number of times that the path has changed                           | (n,)   | –    |
    | searches | whether to search touches with walls and segments; with circles     | (n, 2) | –    |
    """

    step: NamedTuple
    segments: NamedTuple
    start: np.ndarray
    place: np.ndarray
    since: np.ndarray
    rate: np.ndarray
    inverse: np.ndarray
    held: np.ndarray
    block: np.ndarray
    carrier: np.ndarray
    touches: np.ndarray
    searches: np.ndarray


@njit(cache=True)
def make_paths(step, segments, start):
    """Return the `Paths` of a step before any touch.

    step: `StepInput`. segments: `Segments` at the end of the step. start: centres at the start of the step, (n, 2), m.
    """
    bodies, n = step.bodies, step.bodies.mass.shape[0]
    rate = displaced(bodies.position, start, -1.0)
    return Paths(
        step, segments, start, start.copy(), np.zeros(n), rate, 1.0 / bodies.mass, np.zeros(n, np.int64),
        np.zeros((n, 2)), np.zeros(n), np.zeros(n, np.int64), np.zeros((n, 2), np.bool_),
    )  # fmt: skip


@njit(cache=True)
def displaced(points, by, share):
    """Return points + share · by. points, by: (n, 2). This loop takes less time to compile than NumPy's expression."""
    result = np.empty_like(points)
    for i in range(points.shape[0]):
        for axis in range(2):
            result[i, axis] = points[i, axis] + share * by[i, axis]
    return result


@njit(inline="always")
def place_at(paths, i, time):
    """Return the centre (x, y) of circle i, m, at a time within the last piece of its path, in units of the step."""
    flown = time - paths.since[i]
    return paths.place[i, 0] + flown * paths.rate[i, 0], paths.place[i, 1] + flown * paths.rate[i, 1]


class Swept(NamedTuple):
    """Search structure for the paths of n circles: a box around the last piece of each path, in a grid of cells.

    Each circle belongs to the cell that contains the middle of the first piece of its path.
    """

    start: np.ndarray  # `Cells.start` of the grid
    order: np.ndarray  # (n,): `Cells.order` of the grid: indices of the circles, sorted by cell
    rank: np.ndarray  # (n,): place of each circle in `order`
    middle: np.ndarray  # (n, 2): middle of the first piece of each path, m
    box: np.ndarray  # (n, 4): x_min, x_max, y_min, y_max of each box, m, in the sequence of `order`
    farthest: np.ndarray  # (2,): largest distance of a side of any box from its `middle`, along x and y, m
    grid: np.ndarray  # `Cells.grid` of the grid
    found: np.ndarray  # (n,): buffer for indices of circles
    times: np.ndarray  # (n,): buffer for times of touches, in units of the step


_make_cells = njit(cache=True)(make_cells)


@njit(cache=True, error_model="numpy")
def sort_swept(paths):
    """Return the `Swept` of paths at the start of a step."""
    n = paths.step.bodies.radius.shape[0]
    cells, rank = _make_cells(n), np.empty(n, np.int64)
    middle = displaced(paths.start, paths.rate, 0.5)
    cells.level[:] = 0
    sort_level(np.int64(0), middle, paths.step.bodies.radius, 0.0, np.int64(0), np.int64(0), cells)
    for k in range(n):
        rank[cells.order[k]] = k
    found, times, box = np.empty(n, np.int64), np.empty(n), np.empty((n, 4))
    swept = Swept(cells.start, cells.order, rank, middle, box, np.zeros(2), cells.grid, found, times)
    for i in range(n):
        bound_path(i, paths, swept)
    return swept


@njit(cache=True, _nrt=False)
def bound_path(i, paths, swept):
    """Put the box of circle i around the last piece of its path, in place. The piece may have changed."""
    radius, k, rest = paths.step.bodies.radius[i], swept.rank[i], 1.0 - paths.since[i]
    for axis in range(2):
        x, middle = paths.place[i, axis], swept.middle[i, axis]
        to_x = x + rest * paths.rate[i, axis]
        low, high = min(x, to_x) - radius, max(x, to_x) + radius
        swept.box[k, 2 * axis], swept.box[k, 2 * axis + 1] = low, high
        swept.farthest[axis] = max(swept.farthest[axis], high - middle, middle - low)


@njit(inline="always")
def crossing_paths(i, now, paths, swept):
    """Find the circles whose boxes overlap the box of the path of circle i from time `now` on.

    No other circle can touch circle i. Returns the number of circles found. Their indices are the first elements of
    `Swept.found`.
    """
    radius, (x, y) = paths.step.bodies.radius[i], place_at(paths, i, now)
    to_x, to_y = place_at(paths, i, 1.0)
    x_min, x_max = min(x, to_x) - radius, max(x, to_x) + radius
    y_min, y_max = min(y, to_y) - radius, max(y, to_y) + radius
    grid, box, found, count = swept.grid[0], swept.box, swept.found, 0
    columns, per_metre, (far_x, far_y) = grid["columns"], grid["per_metre"], swept.farthest
    # Rounding errors are smaller than a millionth of a cell.
    left = int(max((x_min - far_x - grid["x"]) * per_metre - 1e-6, 0.0))
    right = int(min((x_max + far_x - grid["x"]) * per_metre + 1e-6, columns - 1.0))
    low = int(max((y_min - far_y - grid["y"]) * per_metre - 1e-6, 0.0))
    high = int(min((y_max + far_y - grid["y"]) * per_metre + 1e-6, grid["rows"] - 1.0))
    for row in range(low, high + 1):
        for k in range(swept.start[row * columns + left], swept.start[row * columns + right + 1]):
            found[count] = swept.order[k]  # counted without a branch, which could not be predicted
            crosses = (box[k, 0] <= x_max) & (box[k, 1] >= x_min) & (box[k, 2] <= y_max) & (box[k, 3] >= y_min)
            count += crosses & (found[count] != i)
    return count
