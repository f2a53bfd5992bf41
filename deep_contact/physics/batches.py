"""Batches of contacts that share no circle, in tiles of eight: the data structure of `solvers.batched`.

A sweep of `contact_solver` waits: the next contact needs the velocities that this one writes. In a batch no circle
occurs twice, so eight contacts are one vector operation (`compiled.simd`). Walls never move, so contacts of a batch may
share them.

The list of contacts is cut into blocks of `BLOCK`, and each block is coloured greedily: a batch is a colour of a block.
Blocks that share no circle form a phase, which several threads relax at the same time. None reads what another writes,
so the number of threads changes no bit.

A batch is stored as tiles of eight contacts; the last one is padded with contacts between the idle body and itself. A
block has five bodies of its own beside the circles: the four walls, and the idle one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.compiled.simd import WIDTH, lowest_zero
from deep_contact.physics.contact_solver import (
    ARM_A,
    ARM_B,
    BODY_A,
    BODY_B,
    INVERSE_MASS,
    N_X,
    N_Y,
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    TANGENT_MASS,
    V_S,
    apply_impulse,
    arms_of,
    effective_masses,
)
from deep_contact.physics.position_correction import IDLE
from deep_contact.physics.segments import surface_velocity

BLOCK = 1024
"""Contacts coloured together: smaller blocks fill fewer tiles, larger ones leave the nearest cache."""

COLOURS = 64
"""Colours, and phases, in a bit mask. A contact without a free colour is a batch of its own; so are phases."""

CONTACTS, BLOCKS, TILES, PHASES, CIRCLES = range(5)
"""Elements of `Plan.count`."""

BATCHES, PHASE_BITS = range(2)
"""Columns of `Plan.mark`."""


class Plan(NamedTuple):
    """Where each contact goes: buffers for M contacts of n circles in B blocks."""

    mark: np.ndarray  # (n, 2): of a circle: its colours in the current block, and its phases, as bits
    batch: np.ndarray  # (M,): of a contact: its batch, counted from 0 in each block
    place: np.ndarray  # (M,): of a contact: 8 · tile + lane
    fill: np.ndarray  # (M,): of a batch: contacts in it, then the next free place
    used: np.ndarray  # (M,): of a tile: lanes in use
    first: np.ndarray  # (B+1,): of a block: its first tile; one more at the end
    phase: np.ndarray  # (B,): of a block: its phase
    order: np.ndarray  # (B,): blocks by phase
    start: np.ndarray  # (B+2,): of a phase: where it starts in `order`; one more at the end
    worst: np.ndarray  # (B, 2): of a block: the θ of a sweep, or the deepest separation, by turns
    count: np.ndarray  # (5,): contacts, blocks, tiles and phases in use, circles


class Tiles(NamedTuple):
    """Eight contacts each, in the order in which they are relaxed; and the circles, with five rows for each block."""

    body: np.ndarray  # (T, 2, 8): a, b as rows of `solver_bodies` and `centre`
    data: np.ndarray  # (T, 6, 8): as in `Rows`
    impulse: np.ndarray  # (T, 2, 8): λ_n, λ_t, N·s
    solver_bodies: np.ndarray  # (n+5B, 4): as in the engine, with the bodies of the blocks
    centre: np.ndarray  # (n+5B, 4): see `position_correction.fill_ground`


@njit(cache=True)
def make_plan(n, capacity):
    """Buffers for the plan of so many contacts of n circles."""
    blocks = capacity // BLOCK + 1
    whole = np.int64
    return Plan(
        np.zeros((n, 2), np.uint64), np.empty(capacity, whole), np.empty(capacity, np.uint32),
        np.empty(capacity, whole), np.empty(capacity, whole), np.empty(blocks + 1, whole), np.empty(blocks, whole),
        np.empty(blocks, whole), np.empty(blocks + 2, whole), np.empty((blocks, 2)), np.zeros(5, whole),
    )  # fmt: skip


@njit(cache=True)
def make_tiles(n, blocks, tiles):
    """Buffers for so many tiles and blocks of contacts of n circles."""
    rows = n + 5 * blocks
    return Tiles(
        np.empty((tiles, 2, WIDTH), np.uint32), np.empty((tiles, 6, WIDTH)), np.empty((tiles, 2, WIDTH)),
        np.empty((rows, 4)), np.empty((rows, 4)),
    )  # fmt: skip


@njit(cache=True)
def plan_batches(body_a, body_b, n, plan):
    """Put all contacts, (m,) each, into batches: greedily, the first colour that neither circle has in its block.

    Welsh and Powell 1967, in the order of the list. Returns the plan, a larger one if needed.
    """
    m = body_a.shape[0]
    if m > plan.batch.shape[0]:
        plan = make_plan(n, m + m // 2)
    blocks, tiles, alone = (m + BLOCK - 1) // BLOCK, 0, 0
    plan.mark[:] = 0
    for k in range(blocks):
        begin, end = k * BLOCK, min(k * BLOCK + BLOCK, m)
        batches = choose_batches(body_a, body_b, n, begin, end, plan)
        phase = find_phase(body_a, body_b, n, begin, end, plan)
        if phase == COLOURS:
            phase, alone = COLOURS + alone, alone + 1
        plan.phase[k], plan.first[k] = phase, tiles
        tiles = place_contacts(begin, end, batches, tiles, plan)
    plan.first[blocks] = tiles
    plan.count[CONTACTS], plan.count[BLOCKS], plan.count[TILES], plan.count[CIRCLES] = m, blocks, tiles, n
    plan.count[PHASES] = sort_phases(blocks, plan)
    return plan


@njit(cache=True)
def is_plan_of(plan, n, contacts, planned):
    """Whether the plan, made for other contacts of n circles, holds for these: the same pairs in the same order."""
    m = contacts.body_a.shape[0]
    if plan.count[CIRCLES] != n or plan.count[CONTACTS] != m:
        return False
    for i in range(m):
        if contacts.body_a[i] != planned.body_a[i] or contacts.body_b[i] != planned.body_b[i]:
            return False
    return True


@njit(cache=True)
def choose_batches(body_a, body_b, n, begin, end, plan):
    """Batches of the contacts of one block; counts them in `fill`. Returns how many batches there are.

    Here and below, numbers without a sign index arrays: Numba looks whether others are negative, for each element.
    """
    mark, batches, alone = plan.mark, 0, 0
    nothing, one = np.uint64(0), np.uint64(1)
    for i in range(begin, end):
        a, b = np.uint32(body_a[i]), np.uint32(body_b[i])
        of_a, of_b = mark[a, BATCHES], mark[b, BATCHES] if b < n else nothing
        batch, mine = lowest_zero(of_a | of_b), nothing
        if batch == COLOURS:
            batch, alone = COLOURS + alone, alone + 1
        else:
            mine = one << np.uint64(batch)
        mark[a, BATCHES] = of_a | mine
        if b < n:
            mark[b, BATCHES] = of_b | mine
        while batch >= batches:
            plan.fill[begin + batches] = 0
            batches += 1
        plan.batch[i] = batch
        plan.fill[begin + batch] += 1
    return batches


@njit(cache=True)
def find_phase(body_a, body_b, n, begin, end, plan):
    """The first phase in which no other block has a circle of this one, or `COLOURS`. Wipes its marks of colours."""
    mark = plan.mark
    taken = np.uint64(0)
    for i in range(begin, end):
        a, b = np.uint32(body_a[i]), np.uint32(body_b[i])
        taken |= mark[a, PHASE_BITS]
        mark[a, BATCHES] = 0
        if b < n:
            taken |= mark[b, PHASE_BITS]
            mark[b, BATCHES] = 0
    phase = lowest_zero(taken)
    if phase < COLOURS:
        mine = np.uint64(1) << np.uint64(phase)
        for i in range(begin, end):
            a, b = np.uint32(body_a[i]), np.uint32(body_b[i])
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
def with_room(plan, tiles):
    """The tiles, larger ones if the plan needs them; walls and idle bodies at rest."""
    n, blocks, last = plan.count[CIRCLES], plan.count[BLOCKS], plan.count[TILES]
    if last > tiles.body.shape[0] or n + 5 * blocks > tiles.solver_bodies.shape[0]:
        tiles = make_tiles(n, blocks + blocks // 2 + 1, last + last // 2)
    tiles.solver_bodies[n : n + 5 * blocks] = 0.0
    return tiles


@njit(cache=True)
def contacts_of_block(plan, k):
    """(First contact of a block, the one after its last)."""
    return k * BLOCK, min(k * BLOCK + BLOCK, plan.count[CONTACTS])


@njit(cache=True, error_model="numpy")
def write_block(step, contacts, plan, tiles, k, rows, is_built):
    """Write the rows of a block's contacts to their places, and give its circles the impulses that they start from.

    step: `StepInput`. The solver bodies have their velocities after gravity. rows: `Rows`, if built.
    """
    body, data, impulse, v, n = tiles.body, tiles.data, tiles.impulse, tiles.solver_bodies, plan.count[CIRCLES]
    ground, (begin, end), segments = n + 5 * k, contacts_of_block(plan, k), step.segments
    share = 1.0 / step.parts
    if segments.line.shape[0] > 0:
        v[ground + 3, V_S] = 1.0  # see `contact_solver.move_surfaces`
    for i in range(begin, end):
        t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
        a, b, s = np.uint32(contacts.body_a[i]), np.uint32(contacts.body_b[i]), contacts.body_b[i] - n - 4
        row_b = np.uint32(b if b < n else ground + min(b - n, 3))
        body[t, BODY_A, j], body[t, BODY_B, j] = a, row_b
        if is_built:
            for column in range(ARM_B + 1):
                data[t, column, j] = rows.data[i, column]
        else:
            normal = (contacts.normal[i, 0], contacts.normal[i, 1])
            arms = arms_of(step.bodies.radius, a, b, contacts.separation[i])
            data[t, N_X, j], data[t, N_Y, j] = normal
            masses = effective_masses(v[a, INVERSE_MASS], v[row_b, INVERSE_MASS], arms)
            data[t, NORMAL_MASS, j], data[t, TANGENT_MASS, j] = masses
            data[t, ARM_A, j], data[t, ARM_B, j] = arms
            if s >= 0:
                data[t, ARM_B, j] = surface_velocity(segments.line[s], normal[0], normal[1])
        impulse[t, NORMAL, j] = share * contacts.normal_start[i]
        impulse[t, TANGENT, j] = share * contacts.tangent_start[i]
        apply_impulse(
            v, a, row_b, (data[t, N_X, j], data[t, N_Y, j]), (data[t, ARM_A, j], data[t, ARM_B, j]),
            (impulse[t, NORMAL, j], impulse[t, TANGENT, j]),
        )  # fmt: skip
    pad_block(plan, tiles, k)


@njit(cache=True)
def pad_block(plan, tiles, k):
    """Fill the unused lanes of a block with contacts of its idle body."""
    idle = plan.count[CIRCLES] + 5 * k + IDLE
    for t in range(plan.first[k], plan.first[k + 1]):
        for j in range(plan.used[t], WIDTH):
            tiles.body[t, BODY_A, j] = tiles.body[t, BODY_B, j] = idle
            for row in range(6):
                tiles.data[t, row, j] = 0.0
            tiles.impulse[t, NORMAL, j] = tiles.impulse[t, TANGENT, j] = 0.0


@njit(cache=True)
def fill_tiles(rows, solver_bodies, plan, tiles):
    """Copy rows to their places, and the solver bodies. Returns the tiles, larger ones if needed."""
    n, tiles = plan.count[CIRCLES], with_room(plan, tiles)
    for k in range(plan.count[BLOCKS]):
        ground, (begin, end) = n + 5 * k, contacts_of_block(plan, k)
        for i in range(begin, end):
            t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
            a, b = rows.body[i, BODY_A], rows.body[i, BODY_B]
            tiles.body[t, BODY_A, j] = a
            tiles.body[t, BODY_B, j] = b if b < n else ground + (b - n)
            tiles.data[t, :, j] = rows.data[i]
            tiles.impulse[t, :, j] = rows.impulse[i]
        pad_block(plan, tiles, k)
        tiles.solver_bodies[ground : ground + IDLE] = solver_bodies[n:]
    tiles.solver_bodies[:n] = solver_bodies[:n]
    return tiles


@njit(cache=True)
def store_block(plan, tiles, contacts, k, parts):
    """Write the solved impulses of a block, of one of so many parts of a step, into the contacts, in place."""
    begin, end = contacts_of_block(plan, k)
    for i in range(begin, end):
        t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
        contacts.normal_impulse[i] = parts * tiles.impulse[t, NORMAL, j]
        contacts.tangent_impulse[i] = parts * tiles.impulse[t, TANGENT, j]


@njit(cache=True)
def empty_tiles(plan, tiles, rows, solver_bodies):
    """Copy impulses and velocities back, in place."""
    for i in range(plan.count[CONTACTS]):
        t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
        rows.impulse[i, NORMAL], rows.impulse[i, TANGENT] = tiles.impulse[t, NORMAL, j], tiles.impulse[t, TANGENT, j]
    n = plan.count[CIRCLES]
    solver_bodies[:n] = tiles.solver_bodies[:n]
