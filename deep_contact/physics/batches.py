"""Batches of contacts that share no circle, in tiles of eight: the data structure of `solvers.batched`.

A sweep of `contact_solver` waits: the next contact needs the velocities that this one writes. In a batch no circle
occurs twice, so nothing waits, and eight contacts are one vector operation (`compiled.simd`). Walls never move, so
contacts of a batch may share them. There are two orders of batches:

* "levels": a contact goes into the first batch after those of the contacts before it that share a circle with it. Each
  circle sees its contacts in the order of the list: the sequential sweep, equal up to rounding.
* "colours": the list is cut into blocks of `BLOCK`, and each block is coloured greedily. The order of the sweep
  changes, and convergence with it. Blocks that share no circle form a phase, which several threads relax at the same
  time. None reads what another writes, so the number of threads changes no bit.

A batch is stored as tiles of eight contacts, so that the rows of a tile are runs of memory. The last tile of a batch
is padded with contacts between the idle body and itself. A block has five bodies of its own beside the circles: the
four walls, and the idle one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.compiled.simd import WIDTH, lowest_zero
from deep_contact.physics.contact_solver import BODY_A, BODY_B, NORMAL, TANGENT, TARGET
from deep_contact.physics.position_correction import IDLE

BLOCK = 1024
"""Contacts coloured together. Measured: smaller blocks fill fewer tiles; larger ones leave the nearest cache."""

COLOURS = 64
"""Colours, and phases, in a bit mask. A contact without a free colour is a batch of its own; so are phases."""

CONTACTS, BLOCKS, TILES, PHASES, CIRCLES = range(5)
"""Elements of `Plan.count`."""

BATCHES, PHASE_BITS = range(2)
"""Columns of `Plan.mark`."""


class Plan(NamedTuple):
    """Where each contact goes: buffers for M contacts of n circles in B blocks.

    | field | meaning                                                                           | shape  |
    |-------|-----------------------------------------------------------------------------------|--------|
    | mark  | of a circle: its colours in the current block as bits, or its level; its phases   | (n, 2) |
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
    | body    | a, b as rows of `solver_bodies` and `centre`                          | (T, 2, 8) |
    | data    | as in `Rows`                                                          | (T, 7, 8) |
    | impulse | λ_n, λ_t, N·s                                                         | (T, 2, 8) |
    | solver_bodies | as in the engine, with the bodies of the blocks                 | (n+5B, 4) |
    | centre  | see `position_correction.fill_ground`                                 | (n+5B, 4) |
    """

    body: np.ndarray
    data: np.ndarray
    impulse: np.ndarray
    solver_bodies: np.ndarray
    centre: np.ndarray


@njit(cache=True)
def make_plan(n, capacity):
    """Buffers for the plan of so many contacts of n circles."""
    blocks = capacity // BLOCK + 1
    whole = np.int64
    return Plan(
        np.zeros((n, 2), np.uint64), np.empty(capacity, whole), np.empty(capacity, whole), np.empty(capacity, whole),
        np.empty(capacity, whole), np.empty(blocks + 1, whole), np.empty(blocks, whole), np.empty(blocks, whole),
        np.empty(blocks + 2, whole), np.empty(blocks), np.zeros(5, whole),
    )  # fmt: skip


@njit(cache=True)
def make_tiles(n, blocks, tiles, dtype):
    """Buffers for so many tiles and blocks of contacts of n circles."""
    rows = n + 5 * blocks
    return Tiles(
        np.empty((tiles, 2, WIDTH), np.uint32), np.empty((tiles, 7, WIDTH), dtype), np.empty((tiles, 2, WIDTH), dtype),
        np.empty((rows, 4), dtype), np.empty((rows, 4)),
    )  # fmt: skip


@njit(cache=True)
def plan_batches(body, n, colours, plan):
    """Put all contacts into batches, by colours or by levels. Returns the plan, a larger one if needed.

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
    plan.count[CONTACTS], plan.count[BLOCKS], plan.count[TILES], plan.count[CIRCLES] = m, blocks, tiles, n
    plan.count[PHASES] = sort_phases(blocks, plan)
    return plan


@njit(cache=True)
def choose_batches(body, n, colours, begin, end, plan):
    """Batches of the contacts of one block; counts them in `fill`. Returns how many batches there are."""
    mark, batches, alone = plan.mark, 0, 0
    nothing, one = np.uint64(0), np.uint64(1)
    for i in range(begin, end):
        a, b = body[i, BODY_A], body[i, BODY_B]
        of_a, of_b = mark[a, BATCHES], mark[b, BATCHES] if b < n else nothing
        if colours:
            batch = lowest_zero(of_a | of_b)
            if batch == COLOURS:
                batch, alone = COLOURS + alone, alone + 1
                mine = nothing
            else:
                mine = one << np.uint64(batch)
            mark[a, BATCHES] = of_a | mine
            if b < n:
                mark[b, BATCHES] = of_b | mine
        else:
            level = max(of_a, of_b)
            batch = np.int64(level)
            mark[a, BATCHES] = level + one
            if b < n:
                mark[b, BATCHES] = level + one
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
        a, b = body[i, BODY_A], body[i, BODY_B]
        taken |= mark[a, PHASE_BITS]
        mark[a, BATCHES] = 0
        if b < n:
            taken |= mark[b, PHASE_BITS]
            mark[b, BATCHES] = 0
    phase = lowest_zero(taken)
    if phase < COLOURS:
        mine = np.uint64(1) << np.uint64(phase)
        for i in range(begin, end):
            a, b = body[i, BODY_A], body[i, BODY_B]
            mark[a, PHASE_BITS] |= mine
            if b < n:
                mark[b, PHASE_BITS] |= mine
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
def fill_tiles(rows, solver_bodies, plan, tiles):
    """Copy rows to their places, and the solver bodies. Returns the tiles, larger ones if needed."""
    n, blocks, last = plan.count[CIRCLES], plan.count[BLOCKS], plan.count[TILES]
    if last > tiles.body.shape[0] or n + 5 * blocks > tiles.solver_bodies.shape[0]:
        tiles = make_tiles(n, blocks + blocks // 2 + 1, last + last // 2, solver_bodies.dtype)
    body, data, impulse = tiles.body, tiles.data, tiles.impulse
    m, size = plan.count[CONTACTS], BLOCK if blocks > 1 else max(plan.count[CONTACTS], 1)
    for k in range(blocks):
        ground = n + 5 * k
        for i in range(k * size, min(k * size + size, m)):
            t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
            a, b = rows.body[i, 0], rows.body[i, 1]
            body[t, BODY_A, j] = a
            body[t, BODY_B, j] = b if b < n else ground + (b - n)
            for c in range(TARGET + 1):
                data[t, c, j] = rows.data[i, c]
            impulse[t, NORMAL, j], impulse[t, TANGENT, j] = rows.impulse[i, NORMAL], rows.impulse[i, TANGENT]
        for t in range(plan.first[k], plan.first[k + 1]):
            for j in range(plan.used[t], WIDTH):
                body[t, :, j] = ground + IDLE
                data[t, :, j] = 0.0
                impulse[t, :, j] = 0.0
    tiles.solver_bodies[:n] = solver_bodies[:n]
    tiles.solver_bodies[n : n + 5 * blocks] = 0.0
    for k in range(blocks):
        tiles.solver_bodies[n + 5 * k : n + 5 * k + IDLE] = solver_bodies[n:]
    return tiles


@njit(cache=True)
def empty_tiles(plan, tiles, rows, solver_bodies):
    """Copy impulses and velocities back, in place."""
    for i in range(plan.count[CONTACTS]):
        t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
        rows.impulse[i, NORMAL], rows.impulse[i, TANGENT] = tiles.impulse[t, NORMAL, j], tiles.impulse[t, TANGENT, j]
    n = plan.count[CIRCLES]
    solver_bodies[:n] = tiles.solver_bodies[:n]
