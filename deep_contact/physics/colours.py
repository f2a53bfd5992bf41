"""Sweeps in batches: contacts that share no circle, eight at a time.

A sweep of `contact_solver` waits: the next contact needs the velocities that this one writes. Here the contacts are
put into batches in which no circle occurs twice; within one nothing waits, and eight contacts are one vector
operation (`lanes`). Walls never move, so they may be shared. There are two ways to batch:

* "levels": every contact comes right after the last contact before it that shares a circle with it. So every circle
  sees its contacts in the order of the list: it is the sequential sweep, equal up to rounding.
* "colours": the list is cut into blocks of `BLOCK`, and each block is coloured greedily. The order changes, and
  convergence with it. Blocks that share no circle belong to one phase, and may be relaxed at the same time by several
  threads. What one writes no other reads, so the number of threads changes no bit.

A batch is stored as tiles of eight contacts, so that its rows are runs of memory; the last tile of a batch is filled
up with contacts of nothing with nothing. A tile needs five rows that are nobody else's beside those of the circles,
one set for each block: the four walls, and the idle one that those contacts of nothing join.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numba.extending import overload

from deep_contact.compiled.simd import (
    WIDTH,
    lane,
    least,
    load,
    load_rows,
    lowest_zero,
    most,
    root,
    spread,
    store,
    store_rows,
    where_less,
    widened,
)
from deep_contact.constants import BAUMGARTE, LINEAR_SLOP, MAX_CORRECTION, POSITION_TOLERANCE, WALL_SKIN
from deep_contact.physics.collision import SMALLEST_DISTANCE
from deep_contact.physics.contact_solver import CONTRACT
from deep_contact.physics.convergence import is_over
from deep_contact.state import RIGHT, TOP

BLOCK = 1024
"""Contacts coloured together. Measured: smaller blocks fill fewer tiles, larger ones fall out of the nearest cache."""

COLOURS = 64
"""Colours, and phases, that a bit mask holds. What finds none left is a batch, or a phase, of its own."""

IDLE = 4
"""Of the five rows that a block has beside the circles': 0 to 3 are the walls, this one is nothing."""


class BatchSettings(NamedTuple):
    """Of `methods.BatchedPGS` on one thread. tolerance: as in `PGSSettings`. colours: that order; else levels."""

    tolerance: float
    colours: bool


class ThreadSettings(NamedTuple):
    """Of the same with the blocks of a phase on several threads."""

    tolerance: float
    colours: bool


class Plan(NamedTuple):
    """Which contact goes where. Room for M contacts of n circles in B blocks.

    | field | meaning                                                                           | shape  |
    |-------|-----------------------------------------------------------------------------------|--------|
    | mark  | of a circle: its colours in the block at hand as bits, or its level; its phases   | (n, 2) |
    | batch | of a contact: its batch, counted from 0 in each block                             | (M,)   |
    | place | of a contact: 8 · tile + lane                                                     | (M,)   |
    | fill  | of a batch: contacts in it, then the next free place                              | (M,)   |
    | used  | of a tile: lanes in use                                                           | (M,)   |
    | first | of a block: its first tile; one more at the end                                   | (B+1,) |
    | phase | of a block: its phase                                                             | (B,)   |
    | order | blocks by phase                                                                   | (B,)   |
    | start | of a phase: where it starts in `order`; one more at the end                       | (B+2,) |
    | worst | of a block: the θ of a sweep, or the deepest separation                           | (B,)   |
    | count | contacts, blocks, tiles and phases in use, circles                                | (5,)   |
    """

    mark: np.ndarray
    batch: np.ndarray
    place: np.ndarray
    fill: np.ndarray
    used: np.ndarray
    first: np.ndarray
    phase: np.ndarray
    order: np.ndarray
    start: np.ndarray
    worst: np.ndarray
    count: np.ndarray


class Tiles(NamedTuple):
    """Eight contacts each, in the order in which they are relaxed; and the circles, with five rows for each block.

    | field   | meaning                                                               | shape     |
    |---------|-----------------------------------------------------------------------|-----------|
    | body    | a, b as rows of `moving` and `centre`                                 | (T, 2, 8) |
    | data    | as in `Rows`                                                          | (T, 7, 8) |
    | impulse | λ_n, λ_t, N·s                                                         | (T, 2, 8) |
    | moving  | as in the engine, with the rows of the blocks                         | (n+5B, 4) |
    | centre  | x, y, radius, 1 / m; of a wall, a corner of the box that lies on it   | (n+5B, 4) |
    """

    body: np.ndarray
    data: np.ndarray
    impulse: np.ndarray
    moving: np.ndarray
    centre: np.ndarray


@njit(cache=True)
def make_plan(n, capacity):
    """Room for the plan of so many contacts of n circles."""
    blocks = capacity // BLOCK + 1
    whole = np.int64
    return Plan(
        np.zeros((n, 2), np.uint64), np.empty(capacity, whole), np.empty(capacity, whole), np.empty(capacity, whole),
        np.empty(capacity, whole), np.empty(blocks + 1, whole), np.empty(blocks, whole), np.empty(blocks, whole),
        np.empty(blocks + 2, whole), np.empty(blocks), np.zeros(5, whole),
    )  # fmt: skip


@njit(cache=True)
def make_tiles(n, blocks, tiles, dtype):
    """Room for so many tiles and blocks of contacts of n circles."""
    rows = n + 5 * blocks
    return Tiles(
        np.empty((tiles, 2, WIDTH), np.uint32), np.empty((tiles, 7, WIDTH), dtype), np.empty((tiles, 2, WIDTH), dtype),
        np.empty((rows, 4), dtype), np.empty((rows, 4)),
    )  # fmt: skip


@njit(cache=True)
def plan_batches(body, n, colours, plan):
    """Put all contacts into batches, by colours or by levels. Returns the plan, which is a larger one if it must be.

    body: (m, 2), as in `Rows`. Greedy: the first colour that neither circle has in this block (Welsh and Powell 1967,
    in the order of the list); for levels, the first batch after those that either circle is in.
    """
    m = body.shape[0]
    if m > plan.batch.shape[0]:
        plan = make_plan(n, m + m // 2)
    size = BLOCK if colours else max(m, 1)
    blocks, tiles, alone = (m + size - 1) // size, 0, 0
    plan.mark[:] = 0
    for k in range(blocks):
        begin, end = k * size, min(k * size + size, m)
        batches = choose_batches(body, n, colours, begin, end, plan)
        phase = np.int64(0)
        if colours:
            phase = find_phase(body, n, begin, end, plan)
            if phase == COLOURS:
                phase, alone = COLOURS + alone, alone + 1
        plan.phase[k], plan.first[k] = phase, tiles
        tiles = place_contacts(begin, end, batches, tiles, plan)
    plan.first[blocks] = tiles
    plan.count[0], plan.count[1], plan.count[2], plan.count[4] = m, blocks, tiles, n
    plan.count[3] = sort_phases(blocks, plan)
    return plan


@njit(cache=True)
def choose_batches(body, n, colours, begin, end, plan):
    """Batches of the contacts of one block; counts them in `fill`. Returns how many batches there are."""
    mark, batches, alone = plan.mark, 0, 0
    nothing, one = np.uint64(0), np.uint64(1)
    for i in range(begin, end):
        a, b = body[i, 0], body[i, 1]
        of_a, of_b = mark[a, 0], mark[b, 0] if b < n else nothing
        if colours:
            batch = lowest_zero(of_a | of_b)
            if batch == COLOURS:
                batch, alone = COLOURS + alone, alone + 1
                mine = nothing
            else:
                mine = one << np.uint64(batch)
            mark[a, 0] = of_a | mine
            if b < n:
                mark[b, 0] = of_b | mine
        else:
            level = max(of_a, of_b)
            batch = np.int64(level)
            mark[a, 0] = level + one
            if b < n:
                mark[b, 0] = level + one
        while batch >= batches:
            plan.fill[begin + batches] = 0
            batches += 1
        plan.batch[i] = batch
        plan.fill[begin + batch] += 1
    return batches


@njit(cache=True)
def find_phase(body, n, begin, end, plan):
    """The first phase in which no other block has a circle of this one, or `COLOURS`. Wipes its marks of colours."""
    mark = plan.mark
    taken = np.uint64(0)
    for i in range(begin, end):
        a, b = body[i, 0], body[i, 1]
        taken |= mark[a, 1]
        mark[a, 0] = 0
        if b < n:
            taken |= mark[b, 1]
            mark[b, 0] = 0
    phase = lowest_zero(taken)
    if phase < COLOURS:
        mine = np.uint64(1) << np.uint64(phase)
        for i in range(begin, end):
            a, b = body[i, 0], body[i, 1]
            mark[a, 1] |= mine
            if b < n:
                mark[b, 1] |= mine
    return phase


@njit(cache=True)
def place_contacts(begin, end, batches, tile, plan):
    """Places of the contacts of one block from a tile on, batch after batch. Returns the tile after them."""
    fill = plan.fill[begin : begin + batches]
    for c in range(batches):
        left, fill[c] = fill[c], tile * WIDTH
        while left > 0:
            plan.used[tile] = min(left, WIDTH)
            left -= WIDTH
            tile += 1
    for i in range(begin, end):
        c = plan.batch[i]
        plan.place[i] = fill[c]
        fill[c] += 1
    return tile


@njit(cache=True)
def sort_phases(blocks, plan):
    """Fill `order` and `start` by the phases of the blocks. Returns the number of phases."""
    phases = place = 0
    while place < blocks:
        plan.start[phases] = place
        # Phases without blocks are left out: those beyond the mask follow on whatever was found before them.
        lowest = np.int64(2**62)
        for k in range(blocks):
            if phases == 0 or plan.phase[k] > plan.phase[plan.order[place - 1]]:
                lowest = min(lowest, plan.phase[k])
        for k in range(blocks):
            if plan.phase[k] == lowest:
                plan.order[place] = k
                place += 1
        phases += 1
    plan.start[phases] = blocks
    return phases


@njit(cache=True)
def fill_tiles(rows, moving, plan, tiles):
    """Copy the rows to their places and the velocities beside them. Returns the tiles, larger ones if they must be."""
    n, blocks, last = plan.count[4], plan.count[1], plan.count[2]
    if last > tiles.body.shape[0] or n + 5 * blocks > tiles.moving.shape[0]:
        tiles = make_tiles(n, blocks + blocks // 2 + 1, last + last // 2, moving.dtype)
    body, data, impulse = tiles.body, tiles.data, tiles.impulse
    m, size = plan.count[0], BLOCK if blocks > 1 else max(plan.count[0], 1)
    for k in range(blocks):
        ground = n + 5 * k
        for i in range(k * size, min(k * size + size, m)):
            t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
            a, b = rows.body[i, 0], rows.body[i, 1]
            body[t, 0, j] = a
            body[t, 1, j] = b if b < n else ground + (b - n)
            for c in range(7):
                data[t, c, j] = rows.data[i, c]
            impulse[t, 0, j], impulse[t, 1, j] = rows.impulse[i, 0], rows.impulse[i, 1]
        for t in range(plan.first[k], plan.first[k + 1]):
            for j in range(plan.used[t], WIDTH):
                body[t, :, j] = ground + IDLE
                data[t, :, j] = 0.0
                impulse[t, :, j] = 0.0
    tiles.moving[:n] = moving[:n]
    tiles.moving[n : n + 5 * blocks] = 0.0
    return tiles


@njit(cache=True)
def empty_tiles(plan, tiles, rows, moving):
    """Copy impulses and velocities back, in place."""
    for i in range(plan.count[0]):
        t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
        rows.impulse[i, 0], rows.impulse[i, 1] = tiles.impulse[t, 0, j], tiles.impulse[t, 1, j]
    n = plan.count[4]
    moving[:n] = tiles.moving[:n]


@njit(cache=True, fastmath=CONTRACT)
def sweep_tiles(tiles, first, last, friction):
    """`contact_solver.sweep` over the tiles from `first` to before `last`, in place. Returns θ, N·s."""
    body, data, impulse, moving = tiles.body, tiles.data, tiles.impulse, tiles.moving
    mu, none = spread(moving.dtype.type(friction)), spread(moving.dtype.type(0.0))
    theta = none
    for t in range(first, last):
        a_x, a_y, a_s, w_a = load_rows(moving, body, 2 * t)
        b_x, b_y, b_s, w_b = load_rows(moving, body, 2 * t + 1)
        n_x, n_y, k_n, k_t = load(data, 7 * t), load(data, 7 * t + 1), load(data, 7 * t + 2), load(data, 7 * t + 3)
        arm_a, arm_b, target = load(data, 7 * t + 4), load(data, 7 * t + 5), load(data, 7 * t + 6)
        old_n, old_t = load(impulse, 2 * t), load(impulse, 2 * t + 1)

        d_x, d_y = b_x - a_x, b_y - a_y
        free_n = k_n * (target - d_x * n_x - d_y * n_y)
        free_t = k_t * (d_y * n_x - d_x * n_y - arm_a * a_s - arm_b * b_s)
        largest = mu * old_n
        p_t = most(least(free_t, largest - old_t), none - largest - old_t)
        p_n = most(free_n, none - old_n)
        store(impulse, 2 * t, old_n + p_n)
        store(impulse, 2 * t + 1, old_t + p_t)
        theta = most(theta, most(most(p_n, none - p_n), most(p_t, none - p_t)))

        p_x, p_y, turn = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x, p_t + p_t
        store_rows(moving, body, 2 * t, (a_x - w_a * p_x, a_y - w_a * p_y, a_s + w_a * arm_a * turn, w_a))
        store_rows(moving, body, 2 * t + 1, (b_x + w_b * p_x, b_y + w_b * p_y, b_s + w_b * arm_b * turn, w_b))
    largest = lane(theta, 0)
    for j in range(1, WIDTH):
        largest = max(largest, lane(theta, j))
    return np.float64(largest)


@njit(cache=True, fastmath=CONTRACT)
def correct_tiles(tiles, first, last):
    """A sweep of `contact_solver.correct_positions` over some tiles, in place. Returns the deepest separation, m."""
    body, data, centre = tiles.body, tiles.data, tiles.centre
    none, one, tiny = spread(0.0), spread(1.0), spread(SMALLEST_DISTANCE)
    slop, share, longest = spread(LINEAR_SLOP), spread(BAUMGARTE), spread(MAX_CORRECTION)
    deepest = none
    for t in range(first, last):
        a_x, a_y, r_a, w_a = load_rows(centre, body, 2 * t)
        b_x, b_y, r_b, w_b = load_rows(centre, body, 2 * t + 1)
        d_x, d_y, reach = b_x - a_x, b_y - a_y, r_a + r_b
        distance = root(d_x * d_x + d_y * d_y)
        # Where the centres coincide there is no direction: along +x, as in the narrow phase.
        n_x = where_less(distance, tiny, one, d_x / distance)
        n_y = where_less(distance, tiny, none, d_y / distance)
        # What has no inverse mass is a wall: its normal stands, and the distance behind it is negative.
        wall_x, wall_y = widened(load(data, 7 * t)), widened(load(data, 7 * t + 1))
        n_x, n_y = where_less(none, w_b, n_x, wall_x), where_less(none, w_b, n_y, wall_y)
        distance = where_less(none, w_b, distance, d_x * wall_x + d_y * wall_y)
        overlap = most(most(reach - slop, none) - distance, none)
        push = least(share * overlap, longest) / (w_a + w_b)
        store_rows(centre, body, 2 * t, (a_x - push * w_a * n_x, a_y - push * w_a * n_y, r_a, w_a))
        store_rows(centre, body, 2 * t + 1, (b_x + push * w_b * n_x, b_y + push * w_b * n_y, r_b, w_b))
        deepest = least(deepest, distance - reach)
    lowest = lane(deepest, 0)
    for j in range(1, WIDTH):
        lowest = min(lowest, lane(deepest, j))
    return lowest


def sweep_batches(settings, plan, tiles, friction):
    """One sweep over all tiles, in place. Returns θ. The settings decide about threads. For compiled callers only."""
    raise NotImplementedError("sweep_batches: expected to be called from a compiled function")


def correct_batches(settings, plan, tiles):
    """One sweep of position correction, likewise. Returns the deepest separation."""
    raise NotImplementedError("correct_batches: expected to be called from a compiled function")


@overload(sweep_batches)
def _sweep_batches(settings, plan, tiles, friction):
    return _sweep_side_by_side if settings.instance_class is ThreadSettings else _sweep_in_turn


@overload(correct_batches)
def _correct_batches(settings, plan, tiles):
    return _correct_side_by_side if settings.instance_class is ThreadSettings else _correct_in_turn


def _sweep_in_turn(settings, plan, tiles, friction):
    theta = 0.0
    for k in plan.order[: plan.count[1]]:
        theta = max(theta, sweep_tiles(tiles, plan.first[k], plan.first[k + 1], friction))
    return theta


def _correct_in_turn(settings, plan, tiles):
    deepest = 0.0
    for k in plan.order[: plan.count[1]]:
        deepest = min(deepest, correct_tiles(tiles, plan.first[k], plan.first[k + 1]))
    return deepest


def _sweep_side_by_side(settings, plan, tiles, friction):
    for p in range(plan.count[3]):
        sweep_phase(plan.order[plan.start[p] : plan.start[p + 1]], plan.first, plan.worst, tiles, friction)
    theta = 0.0
    for k in range(plan.count[1]):
        theta = max(theta, plan.worst[k])
    return theta


def _correct_side_by_side(settings, plan, tiles):
    for p in range(plan.count[3]):
        correct_phase(plan.order[plan.start[p] : plan.start[p + 1]], plan.first, plan.worst, tiles)
    deepest = 0.0
    for k in range(plan.count[1]):
        deepest = min(deepest, plan.worst[k])
    return deepest


@njit(cache=True, parallel=True)
def sweep_phase(blocks, first, theta, tiles, friction):
    """Sweep these blocks, which share no circle, at the same time; fills their θ."""
    for i in prange(blocks.shape[0]):
        theta[blocks[i]] = sweep_tiles(tiles, first[blocks[i]], first[blocks[i] + 1], friction)


@njit(cache=True, parallel=True)
def correct_phase(blocks, first, deepest, tiles):
    """Position correction over these blocks, likewise; fills their deepest separations."""
    for i in prange(blocks.shape[0]):
        deepest[blocks[i]] = correct_tiles(tiles, first[blocks[i]], first[blocks[i] + 1])


@njit(cache=True)
def sweep_all(settings, plan, tiles, friction):
    """`sweep_batches` as a function that can be called from outside."""
    return sweep_batches(settings, plan, tiles, friction)


@njit(cache=True)
def relax_tiles(settings, plan, tiles, rows, friction, moving, theta):
    """Projected Gauss-Seidel in batches, from and into the tiles, then the rows and velocities. Returns the sweeps."""
    sweeps = theta.shape[0]
    for k in range(theta.shape[0]):
        theta[k] = sweep_batches(settings, plan, tiles, friction)
        if is_over(theta[k], settings.tolerance):
            sweeps = k + 1
            break
    empty_tiles(plan, tiles, rows, moving)
    return sweeps


@njit(cache=True)
def relax_in_batches(settings, rows, friction, moving, theta):
    """The same, for `relaxation.relax`: with a plan made for this call alone."""
    m, n = rows.body.shape[0], moving.shape[0] - 4
    plan = plan_batches(rows.body, n, settings.colours, make_plan(n, m))
    tiles = fill_tiles(rows, moving, plan, make_tiles(n, plan.count[1], plan.count[2], moving.dtype))
    return relax_tiles(settings, plan, tiles, rows, friction, moving, theta)


@njit(cache=True, error_model="numpy")
def correct_positions_in_batches(settings, plan, tiles, bodies, box, sweeps):
    """`contact_solver.correct_positions` over the tiles of the plan: in place, with the same stop."""
    n = plan.count[4]
    centre = tiles.centre
    for i in range(n):
        centre[i, 0], centre[i, 1] = bodies.position[i, 0], bodies.position[i, 1]
        centre[i, 2], centre[i, 3] = bodies.radius[i], 1.0 / bodies.mass[i]
    for k in range(plan.count[1]):
        ground = centre[n + 5 * k : n + 5 * k + 5]
        for wall in range(4):
            ground[wall, 0] = box[2] if wall == RIGHT or wall == TOP else box[0]
            ground[wall, 1] = box[3] if wall == RIGHT or wall == TOP else box[1]
            ground[wall, 2], ground[wall, 3] = WALL_SKIN, 0.0
        ground[IDLE, :3], ground[IDLE, 3] = 0.0, 1.0
    for _ in range(sweeps):
        if correct_batches(settings, plan, tiles) >= -POSITION_TOLERANCE:
            break
    for i in range(n):
        bodies.position[i, 0], bodies.position[i, 1] = centre[i, 0], centre[i, 1]
