"""The data structure of `solvers.batched`: batches of contacts that share no circle, stored in tiles of eight contacts.

In a sweep of `stepping.rows`, each contact waits for the velocities that the contact before it writes. In a batch no
circle occurs twice, so that one vector operation can relax eight contacts (`compiled.simd`). Contacts of a batch may
share a wall, because no impulse changes the velocity of a wall.

The list of contacts is divided into blocks of `BLOCK` contacts, and the contacts of each block are coloured greedily.
The contacts of one colour in a block are a batch. Blocks are relaxed phase by phase, and the blocks of a phase share no
circle. This order is part of the result: if more than two blocks were relaxed in the order of the list, the bits would
differ.

A batch is stored as tiles of eight contacts. In each unused lane of its last tile, the idle body touches itself. The
idle body has no inverse mass, so that such a contact changes nothing. Each block has five bodies of its own besides the
circles: the four walls and the idle body.

Tests: tests/solvers/test_batched.py
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from deep_contact.compiled import njit
from deep_contact.compiled.simd import (
    WIDTH,
    any_less,
    least,
    load,
    load_rows,
    lowest_zero,
    most,
    root,
    spread,
    store,
    store_rows,
    times,
    where_less,
)
from deep_contact.stepping.contacts import SMALLEST_DISTANCE, parting
from deep_contact.stepping.pairs import is_rough, is_rough_type, is_table, is_table_type, value_of
from deep_contact.stepping.position_correction import IDLE, fill_ground
from deep_contact.stepping.rows import (
    ARM_A,
    ARM_B,
    BODY_A,
    BODY_B,
    CONTRACT,
    FRICTION,
    INVERSE_MASS,
    N_X,
    N_Y,
    NORMAL,
    NORMAL_MASS,
    ROLL,
    ROLLING,
    TANGENT,
    TANGENT_MASS,
    V_S,
    V_X,
    V_Y,
)
from deep_contact.stepping.segments import surface_velocity, wall_velocity

BLOCK = 1024
"""Number of contacts in a block. Smaller blocks leave more lanes of their tiles unused; larger blocks exceed the
fastest cache."""

COLOURS = 64
"""Largest number of colours in a block, and largest number of phases: the number of bits in a mask of `BatchPlan.mark`.
A contact for which no colour is free is a batch of its own. Blocks for which no phase is free come last, in the order
of the list."""

CONTACTS, BLOCKS, TILES, CIRCLES, ROWS = range(5)
"""Indices into `BatchPlan.count`."""

BOUND, ROLL_INERTIA, TURN_OF_A, TURN_OF_B, ROLLED = range(5)
"""Rows of `Tiles.rolling`: the columns `ROLLING` to `TURN_B` of `Rows.data`, and λ_r, N·m·s."""

BATCHES, PHASE_BITS = range(2)
"""Columns of `BatchPlan.mark`."""


class BatchPlan(NamedTuple):
    """The batch and the place of each contact, in buffers for M contacts of n circles in B blocks."""

    mark: np.ndarray  # (n, 2): bit masks: colours of each circle in the current block, phases of each circle
    batch: np.ndarray  # (M,): batch of each contact, counted from 0 in each block
    place: np.ndarray  # (M,): place of each contact: 8 · tile + lane
    fill: np.ndarray  # (M,): for each batch, first the number of its contacts, later its next free place
    used: np.ndarray  # (M,): number of lanes in use in each tile
    first: np.ndarray  # (B + 1,): first tile of each block; the last element is the number of tiles
    own: np.ndarray  # (B + 1,): first body row for each block's contacts with segments; last, the number of rows
    phase: np.ndarray  # (B,): phase of each block
    order: np.ndarray  # (B,): indices of the blocks, sorted by phase
    count: np.ndarray  # (5,): numbers of contacts, blocks and tiles in use, of circles, and of body rows


class Tiles(NamedTuple):
    """T tiles of eight contacts, block by block, and R rows of bodies.

    The bodies are the n circles, then four walls and an idle body for each block, then one body for each contact with a
    segment.
    """

    body: np.ndarray  # (T, 2, 8): bodies a and b, as row indices of `solver_bodies` and `centre`
    data: np.ndarray  # (T, 6, 8): normal, effective masses and arms, as in `Rows.data`
    impulse: np.ndarray  # (T, 2, 8): λ_n, λ_t, N·s
    friction: np.ndarray  # (T, 8): μ, if it depends on the pair; otherwise (0, 8)
    rolling: np.ndarray  # (T, 5, 8): `BOUND` to `ROLLED`, with rolling resistance; otherwise (0, 5, 8)
    solver_bodies: np.ndarray  # (R, 4): velocities and inverse masses, as in `stepping.rows`
    centre: np.ndarray  # (R, 4): x, y, radius, mass of these bodies (`position_correction.fill_ground`)


def tile_friction(friction, column, t):
    """Return μ of tile t as a vector of eight lanes. friction: as in `StepInput`. column: `Tiles.friction`."""
    return load(column, t) if is_table(friction) else spread(value_of(friction, 0, 0))


def roll_tile(friction, rolling, t, spins, inverse_masses, old_n, theta):
    """Relax the rolling rows of tile t, if there are any (`rows.roll`), in place on `rolling`.

    friction: as in `StepInput`. rolling: `Tiles.rolling`. spins: s of the first and the second bodies, m/s. old_n: λ_n,
    N·s. theta: largest changes so far, N·s. Returns (spins, theta). All are vectors of eight lanes.
    """
    return roll_lanes(rolling, t, spins, inverse_masses, old_n, theta) if is_rough(friction) else (spins, theta)


def write_tile_friction(friction, tiles, t, j, bodies, radius) -> None:
    """Write the friction of lane j of tile t, in place: μ if it is a table, and the rows of rolling resistance, if any.

    λ_r becomes 0. friction: as in `StepInput`. bodies: indices (a, b) as in `Contacts`. radius: (n,), m.
    """
    if is_table(friction):
        tiles.friction[t, j] = value_of(friction, *bodies)
    if is_rough(friction):
        write_tile_rolling(friction.rolling, tiles, t, j, bodies, radius)


@njit(cache=True, error_model="numpy")
def write_tile_rolling(rolling, tiles, t, j, bodies, radius):
    """Write the rows of `Tiles.rolling` of one contact, in place. The arguments are those of `write_tile_friction`."""
    (a, b), n, w_b, turn_b = bodies, radius.shape[0], 0.0, 0.0
    w_a, turn_a = tiles.solver_bodies[a, INVERSE_MASS], 1.0 / radius[a]
    if b < n:
        w_b, turn_b = tiles.solver_bodies[b, INVERSE_MASS], 1.0 / radius[b]
    inertia = 0.5 / (w_a * turn_a * turn_a + w_b * turn_b * turn_b)
    for row, value in enumerate((value_of(rolling, a, b), inertia, turn_a, turn_b, 0.0)):
        tiles.rolling[t, row, j] = value


@njit(cache=True, fastmath=CONTRACT)
def roll_lanes(rolling, t, spins, inverse_masses, old_n, theta):
    """Do `roll_tile` for tiles with rolling resistance."""
    row, none, (a_s, b_s), (w_a, w_b) = 5 * t, spread(0.0), spins, inverse_masses
    turn_a, turn_b, old = load(rolling, row + TURN_OF_A), load(rolling, row + TURN_OF_B), load(rolling, row + ROLLED)
    bound = load(rolling, row + BOUND) * most(old_n, none)
    free = load(rolling, row + ROLL_INERTIA) * (turn_a * a_s - turn_b * b_s)
    p = most(least(free, bound - old), none - bound - old)
    store(rolling, row + ROLLED, old + p)
    change = most(p, none - p) * most(turn_a, turn_b)
    return (a_s - w_a * turn_a * (p + p), b_s + w_b * turn_b * (p + p)), most(theta, change)


def work_of_rolling(friction, plan, tiles, bodies) -> float:
    """Return the work of fixed circles on free circles by rolling resistance, J, as `rows.work_of_rolling` does."""
    return work_of_tiles(plan, tiles, bodies.mass, bodies.spin) if is_rough(friction) else 0.0


@njit(cache=True)
def work_of_tiles(plan, tiles, mass, spin):
    """Do `work_of_rolling` for tiles with rolling resistance. mass, spin: of the circles, (n,), kg and rad/s."""
    work, n = 0.0, mass.shape[0]
    for t in range(plan.count[TILES]):
        for j in range(WIDTH):
            a, b = tiles.body[t, BODY_A, j], tiles.body[t, BODY_B, j]
            if a < n and mass[a] == np.inf:
                work += tiles.rolling[t, ROLLED, j] * spin[a]
            if b < n and mass[b] == np.inf:
                work -= tiles.rolling[t, ROLLED, j] * spin[b]
    return work


@overload(tile_friction)
def _overload_tile_friction(friction, column, t):
    if is_table_type(friction):
        return lambda friction, column, t: load(column, t)
    if is_rough_type(friction):
        return lambda friction, column, t: spread(friction.friction)
    return lambda friction, column, t: spread(friction)


@overload(roll_tile)
def _overload_roll_tile(friction, rolling, t, spins, inverse_masses, old_n, theta):
    if is_rough_type(friction):
        return lambda friction, rolling, t, spins, inverse_masses, old_n, theta: roll_lanes(
            rolling, t, spins, inverse_masses, old_n, theta
        )
    return lambda friction, rolling, t, spins, inverse_masses, old_n, theta: (spins, theta)


@overload(write_tile_friction)
def _overload_write_tile_friction(friction, tiles, t, j, bodies, radius):
    def nothing(friction, tiles, t, j, bodies, radius):
        pass

    def of_table(friction, tiles, t, j, bodies, radius):
        tiles.friction[t, j] = value_of(friction, bodies[0], bodies[1])

    def of_rolling(friction, tiles, t, j, bodies, radius):
        write_tile_rolling(friction.rolling, tiles, t, j, bodies, radius)

    def of_both(friction, tiles, t, j, bodies, radius):
        tiles.friction[t, j] = value_of(friction, bodies[0], bodies[1])
        write_tile_rolling(friction.rolling, tiles, t, j, bodies, radius)

    choices = {(False, False): nothing, (True, False): of_table, (False, True): of_rolling, (True, True): of_both}
    return choices[is_table_type(friction), is_rough_type(friction)]


@overload(work_of_rolling)
def _overload_work_of_rolling(friction, plan, tiles, bodies):
    if is_rough_type(friction):
        return lambda friction, plan, tiles, bodies: work_of_tiles(plan, tiles, bodies.mass, bodies.spin)
    return lambda friction, plan, tiles, bodies: 0.0


@njit(cache=True)
def make_plan(n, capacity):
    """Return a plan with buffers for `capacity` contacts of n circles.

    Its counts are −1, so that it fits no contacts yet.
    """
    blocks = capacity // BLOCK + 1
    whole = np.int64
    return BatchPlan(
        np.zeros((n, 2), np.uint64), np.empty(capacity, whole), np.empty(capacity, np.uint32),
        np.empty(capacity, whole), np.empty(capacity, whole), np.empty(blocks + 1, whole),
        np.empty(blocks + 1, whole), np.empty(blocks, whole), np.empty(blocks, whole), np.full(5, -1, whole),
    )  # fmt: skip


@njit(cache=True)
def make_tiles(rows, tiles, friction):
    """Return uninitialised `Tiles` with `rows` rows of bodies and `tiles` tiles of contacts.

    friction: as in `StepInput`.
    """
    return Tiles(
        np.empty((tiles, 2, WIDTH), np.uint32), np.empty((tiles, 6, WIDTH)), np.empty((tiles, 2, WIDTH)),
        np.empty((tiles * is_table(friction), WIDTH)), np.empty((tiles * is_rough(friction), 5, WIDTH)),
        np.empty((rows, 4)), np.empty((rows, 4)),
    )  # fmt: skip


@njit(cache=True)
def plan_batches(body_a, body_b, n, plan):
    """Sort m contacts into batches: each contact gets the first colour that neither of its two circles has yet.

    This is the greedy colouring of Welsh and Powell (1967), in the order of the list.

    body_a, body_b: bodies of the contacts, (m,). n: number of circles. plan: `BatchPlan`, filled in place. Returns the
    plan, or a larger plan if needed.
    """
    m = body_a.shape[0]
    if m > plan.batch.shape[0]:
        plan = make_plan(n, m + m // 2)
    blocks, tiles = (m + BLOCK - 1) // BLOCK, 0
    rows = n + 5 * blocks
    plan.mark[:] = 0
    for k in range(blocks):
        begin, end = k * BLOCK, min(k * BLOCK + BLOCK, m)
        batches, taken, segments = choose_batches(body_a, body_b, n, begin, end, plan)
        phase = take_phase(body_a, body_b, n, begin, end, taken, plan)
        plan.phase[k], plan.first[k], plan.own[k] = phase, tiles, rows
        tiles, rows = place_contacts(begin, end, batches, tiles, plan), rows + segments
    plan.first[blocks], plan.own[blocks] = tiles, rows
    plan.count[CONTACTS], plan.count[BLOCKS], plan.count[TILES], plan.count[CIRCLES] = m, blocks, tiles, n
    plan.count[ROWS] = rows
    sort_phases(blocks, plan)
    return plan


@njit(cache=True)
def is_plan_of(plan, n, contacts, planned):
    """Return whether a plan that was made for the contacts `planned` also fits `contacts`.

    It fits if both have the same pairs in the same order, and if n is the number of circles of the plan.
    """
    m = contacts.body_a.shape[0]
    if plan.count[CIRCLES] != n or plan.count[CONTACTS] != m:
        return False
    for i in range(m):
        if contacts.body_a[i] != planned.body_a[i] or contacts.body_b[i] != planned.body_b[i]:
            return False
    return True


@njit(cache=True)
def choose_batches(body_a, body_b, n, begin, end, plan):
    """Choose a batch for each contact of one block, and count the contacts of each batch in `plan.fill`, in place.

    begin, end: first contact of the block, and the contact after its last. Returns the number of batches, the phases of
    the block's circles as a bit mask, and the number of contacts with segments. Here and below, array indices are
    unsigned integers, since Numba tests every signed index for a negative value.
    """
    mark, batches, alone, segments = plan.mark, 0, 0, 0
    nothing, one = np.uint64(0), np.uint64(1)
    taken = of_a = nothing
    held = np.uint32(body_a[begin])  # contacts are sorted by body a, so that the marks of body a stay in registers
    for i in range(begin, end):
        a, b = np.uint32(body_a[i]), np.uint32(body_b[i])
        if a != held:
            taken, mark[held, BATCHES] = taken | mark[held, PHASE_BITS], of_a
            held, of_a = a, mark[a, BATCHES]
        of_b, mine = mark[b, BATCHES] if b < n else nothing, nothing
        batch = lowest_zero(of_a | of_b)
        if batch == COLOURS:
            batch, alone = COLOURS + alone, alone + 1
        else:
            mine = one << np.uint64(batch)
        of_a |= mine
        if b < n:
            mark[b, BATCHES] = of_b | mine
            taken |= mark[b, PHASE_BITS]
        else:
            segments += b >= n + 4
        while batch >= batches:
            plan.fill[begin + batches] = 0
            batches += 1
        plan.batch[i] = batch
        plan.fill[begin + batch] += 1
    return batches, taken | mark[held, PHASE_BITS], segments


@njit(cache=True)
def take_phase(body_a, body_b, n, begin, end, taken, plan):
    """Assign the first free phase to a block, and mark the block's circles with it, in place. Returns the phase.

    A phase is free if no other block in it has a circle of this block. If no phase is free, the result is `COLOURS`.
    The colours of the block's circles are cleared. taken: phases of the block's circles, as a bit mask.
    """
    mark, phase, mine = plan.mark, lowest_zero(taken), np.uint64(0)
    if phase < COLOURS:
        mine = np.uint64(1) << np.uint64(phase)
    for i in range(begin, end):
        a, b = np.uint32(body_a[i]), np.uint32(body_b[i])
        mark[a, BATCHES] = 0
        mark[a, PHASE_BITS] |= mine
        if b < n:
            mark[b, BATCHES] = 0
            mark[b, PHASE_BITS] |= mine
    return phase


@njit(cache=True)
def place_contacts(begin, end, batches, tile, plan):
    """Assign a place to each contact of one block, batch by batch, in place on the plan.

    batches: number of batches. tile: first tile of the block. Returns the tile after the last tile of the block.
    """
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
    """Fill `plan.order` with the blocks sorted by phase. The blocks of a phase stay in the order of the list."""
    place = 0
    for phase in range(COLOURS + 1):
        for k in range(blocks):
            if plan.phase[k] == phase:
                plan.order[place] = k
                place += 1


@njit(cache=True)
def with_room(plan, tiles, friction):
    """Return the tiles, or larger tiles if the plan needs them. friction: as in `StepInput`.

    Velocities and inverse masses of walls and idle bodies are set to 0.
    """
    n, rows, last = plan.count[CIRCLES], plan.count[ROWS], plan.count[TILES]
    if last > tiles.body.shape[0] or rows > tiles.solver_bodies.shape[0]:
        tiles = make_tiles(n + (rows - n) * 3 // 2 + 5, last + last // 2, friction)
    tiles.solver_bodies[n : n + 5 * plan.count[BLOCKS]] = 0.0
    return tiles


@njit(cache=True)
def contacts_of_block(plan, k):
    """Return (first contact of block k, contact after its last)."""
    return k * BLOCK, min(k * BLOCK + BLOCK, plan.count[CONTACTS])


@njit(cache=True, error_model="numpy")
def place_block(step, contacts, plan, tiles, k, actuation):
    """Write the bodies and the starting impulses of the contacts of block k to their places in the tiles.

    For contacts with walls and segments, also write the row data that `fill_rows` cannot compute. step: `StepInput`.
    actuation: `Actuation`, or None.
    """
    body, data, impulse, n = tiles.body, tiles.data, tiles.impulse, plan.count[CIRCLES]
    body_a, body_b, place = contacts.body_a, contacts.body_b, plan.place
    normal, normal_start, tangent_start = contacts.normal, contacts.normal_start, contacts.tangent_start
    ground, (begin, end), last = n + 5 * k, contacts_of_block(plan, k), n + 3
    share, eight = 1.0 / step.substeps, np.uint64(WIDTH)
    fill_ground(step.box, step.scales, tiles.centre[ground : ground + 5])
    if plan.own[k + 1] > plan.own[k]:
        place_segments(step, contacts, plan, tiles, k, actuation)
    own = np.uint32(plan.own[k])
    for i in range(begin, end):
        t, j = np.uint64(place[i]) // eight, np.uint64(place[i]) % eight
        a, b = np.uint32(body_a[i]), np.uint32(body_b[i])
        if b >= n:
            data[t, N_X, j], data[t, N_Y, j] = normal[i, 0], normal[i, 1]
            if b > last:
                b, own = own, own + np.uint32(1)
            else:
                b, data[t, ARM_B, j] = np.uint32(ground + b - n), 0.0
        write_tile_friction(step.friction, tiles, t, j, (body_a[i], body_b[i]), step.bodies.radius)
        body[t, BODY_A, j], body[t, BODY_B, j] = a, b
        impulse[t, NORMAL, j], impulse[t, TANGENT, j] = share * normal_start[i], share * tangent_start[i]
    pad_block(plan, tiles, k)


@njit(cache=True)
def place_rows(rows, plan, tiles, k):
    """Copy the row data of the contacts of block k to their places in the tiles. `fill_rows` is then not needed.

    rows: `Rows` that are already built.
    """
    begin, end = contacts_of_block(plan, k)
    for i in range(begin, end):
        for column in range(ARM_B + 1):
            tiles.data[plan.place[i] // WIDTH, column, plan.place[i] % WIDTH] = rows.data[i, column]


@njit(cache=True)
def move_points(plan, tiles, dt):
    """Move the contact points on segments with the velocities of their segments over Δt, in place. dt: Δt, s."""
    v, centre = tiles.solver_bodies, tiles.centre
    for row in range(plan.own[0], plan.count[ROWS]):
        centre[row, 0] += dt * v[row, V_X]
        centre[row, 1] += dt * v[row, V_Y]


@njit(cache=True)
def place_segments(step, contacts, plan, tiles, k, actuation):
    """Write a wall-like body for each contact of block k with a segment, in place on the tiles (`fill_ground`).

    The body has the position of the contact point on the segment, and the velocity of the segment there.
    """
    n, row, (begin, end), skin = plan.count[CIRCLES], plan.own[k], contacts_of_block(plan, k), step.scales.wall_skin
    centre, solver_bodies, place = tiles.centre, tiles.solver_bodies, plan.place
    position, radius, line = step.bodies.position, step.bodies.radius, step.segments.line
    body_a, body_b, normal, separation = contacts.body_a, contacts.body_b, contacts.normal, contacts.separation
    for i in range(begin, end):
        s = body_b[i] - n - 4
        if s >= 0:
            a, n_x, n_y = body_a[i], normal[i, 0], normal[i, 1]
            distance = separation[i] + radius[a] + skin
            centre[row, 0], centre[row, 1] = position[a, 0] + distance * n_x, position[a, 1] + distance * n_y
            centre[row, 2], centre[row, 3] = skin, 0.0
            solver_bodies[row, :] = 0.0
            solver_bodies[row, V_S] = 1.0  # see `rows.move_surfaces`
            if actuation is not None:
                x, y = contacts.position[i, 0], contacts.position[i, 1]
                solver_bodies[row, V_X], solver_bodies[row, V_Y] = wall_velocity(line, actuation.wall, s, x, y)
            tiles.data[place[i] // WIDTH, ARM_B, place[i] % WIDTH] = surface_velocity(line[s], n_x, n_y)
            row += 1


@njit(cache=True)
def fill_rows(tiles, first, last):
    """Fill the rows of the tiles from `first` to before `last`, in place. Returns whether two centres coincide.

    The row data are those of `rows.contact_rows`. They follow from the centres (`fill_centres`) and from the data that
    `place_block` writes. Normals between coinciding centres are not filled; `part_coinciding` writes them.
    """
    body, data, centre, v = tiles.body, tiles.data, tiles.centre, tiles.solver_bodies
    none, one, half, tiny = spread(0.0), spread(1.0), spread(0.5), spread(SMALLEST_DISTANCE)
    nearest = one
    for t in range(first, last):
        row = 6 * t
        a_x, a_y, r_a, _ = load_rows(centre, body, 2 * t)
        b_x, b_y, r_b, m_b = load_rows(centre, body, 2 * t + 1)
        w_a, w_b = load_rows(v, body, 2 * t)[INVERSE_MASS], load_rows(v, body, 2 * t + 1)[INVERSE_MASS]
        d_x, d_y = b_x - a_x, b_y - a_y
        distance, coincide = root(times(d_x, d_x) + times(d_y, d_y)), times(tiny, r_a + r_b)
        both = w_a + w_b
        # In the test for coinciding centres, only lanes count whose body b has a mass and whose bodies can move. This
        # leaves out walls, and unused lanes, in which the idle body touches itself.
        nearest = least(nearest, where_less(none, times(both, m_b), distance - coincide, one))
        written_x, written_y = load(data, row + N_X), load(data, row + N_Y)
        n_x = where_less(distance, coincide, written_x, d_x / distance)
        n_y = where_less(distance, coincide, written_y, d_y / distance)
        distance = where_less(none, m_b, distance, times(d_x, written_x) + times(d_y, written_y))
        separation = times(half, distance - r_a - r_b)
        arm_a = one + separation / r_a
        arm_b = where_less(none, m_b, one + separation / r_b, load(data, row + ARM_B))
        turning = times(times(arm_a, arm_a), w_a) + times(times(arm_b, arm_b), w_b)
        store(data, row + N_X, where_less(none, m_b, n_x, written_x))
        store(data, row + N_Y, where_less(none, m_b, n_y, written_y))
        store(data, row + NORMAL_MASS, where_less(none, both, one / both, none))
        store(data, row + TANGENT_MASS, where_less(none, both, one / (both + (turning + turning)), none))
        store(data, row + ARM_A, arm_a)
        store(data, row + ARM_B, arm_b)
    return any_less(nearest, none)


@njit(cache=True)
def part_coinciding(tiles, first, last):
    """Write the normals of circles whose centres coincide (`contacts.parting`), in place.

    The tiles are those from `first` to before `last`.
    """
    centre = tiles.centre
    for t in range(first, last):
        for j in range(WIDTH):
            a, b = np.int64(tiles.body[t, BODY_A, j]), np.int64(tiles.body[t, BODY_B, j])
            distance = math.hypot(centre[b, 0] - centre[a, 0], centre[b, 1] - centre[a, 1])
            if a != b and centre[b, 3] > 0.0 and distance < SMALLEST_DISTANCE * (centre[a, 2] + centre[b, 2]):
                tiles.data[t, N_X, j], tiles.data[t, N_Y, j] = parting(a, b)


@njit(cache=True)
def start_tiles(tiles, first, last):
    """Apply the starting impulses of tiles to the velocities, in place (`rows.apply_impulses`).

    The tiles are those from `first` to before `last`.
    """
    body, data, impulse, v = tiles.body, tiles.data, tiles.impulse, tiles.solver_bodies
    for t in range(first, last):
        row = 6 * t
        a_x, a_y, a_s, w_a = load_rows(v, body, 2 * t)
        b_x, b_y, b_s, w_b = load_rows(v, body, 2 * t + 1)
        n_x, n_y = load(data, row + N_X), load(data, row + N_Y)
        arm_a, arm_b = load(data, row + ARM_A), load(data, row + ARM_B)
        p_n, p_t = load(impulse, 2 * t + NORMAL), load(impulse, 2 * t + TANGENT)
        p_x, p_y, turn = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x, p_t + p_t
        store_rows(v, body, 2 * t, (a_x - w_a * p_x, a_y - w_a * p_y, a_s + w_a * arm_a * turn, w_a))
        store_rows(v, body, 2 * t + 1, (b_x + w_b * p_x, b_y + w_b * p_y, b_s + w_b * arm_b * turn, w_b))


@njit(cache=True)
def pad_block(plan, tiles, k):
    """Fill the unused lanes of block k with contacts of its idle body with itself, in place."""
    idle = plan.count[CIRCLES] + 5 * k + IDLE
    for t in range(plan.first[k], plan.first[k + 1]):
        for j in range(plan.used[t], WIDTH):
            tiles.body[t, BODY_A, j] = tiles.body[t, BODY_B, j] = idle
            for row in range(6):
                tiles.data[t, row, j] = 0.0
            if tiles.friction.shape[0] > 0:
                tiles.friction[t, j] = 0.0
            if tiles.rolling.shape[0] > 0:
                for row in range(5):
                    tiles.rolling[t, row, j] = 0.0
            tiles.impulse[t, NORMAL, j] = tiles.impulse[t, TANGENT, j] = 0.0


@njit(cache=True)
def fill_tiles(rows, solver_bodies, plan, tiles, friction):
    """Copy the rows to their places in the tiles, and copy the solver bodies, in place.

    friction: as in `StepInput`. Returns the tiles, or larger tiles if needed.
    """
    n, tiles = plan.count[CIRCLES], with_room(plan, tiles, friction)
    for k in range(plan.count[BLOCKS]):
        ground, (begin, end) = n + 5 * k, contacts_of_block(plan, k)
        for i in range(begin, end):
            t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
            a, b = rows.body[i, BODY_A], rows.body[i, BODY_B]
            tiles.body[t, BODY_A, j] = a
            tiles.body[t, BODY_B, j] = b if b < n else ground + (b - n)
            for column in range(ARM_B + 1):
                tiles.data[t, column, j] = rows.data[i, column]
            if tiles.friction.shape[0] > 0:
                tiles.friction[t, j] = rows.data[i, FRICTION]
            if tiles.rolling.shape[0] > 0:
                for column in range(4):
                    tiles.rolling[t, column, j] = rows.data[i, ROLLING + column]
                tiles.rolling[t, ROLLED, j] = rows.impulse[i, ROLL]
            tiles.impulse[t, NORMAL, j], tiles.impulse[t, TANGENT, j] = (
                rows.impulse[i, NORMAL],
                rows.impulse[i, TANGENT],
            )
        pad_block(plan, tiles, k)
        tiles.solver_bodies[ground : ground + IDLE] = solver_bodies[n:]
    tiles.solver_bodies[:n] = solver_bodies[:n]
    return tiles


@njit(cache=True)
def store_block(plan, tiles, contacts, k, substeps):
    """Write the solved impulses of block k into the contacts, in place. Contacts have impulses of a whole step.

    substeps: number of substeps of a step, by which the impulses of a substep are multiplied.
    """
    begin, end = contacts_of_block(plan, k)
    for i in range(begin, end):
        t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
        contacts.normal_impulse[i] = substeps * tiles.impulse[t, NORMAL, j]
        contacts.tangent_impulse[i] = substeps * tiles.impulse[t, TANGENT, j]


@njit(cache=True)
def empty_tiles(plan, tiles, rows, solver_bodies):
    """Copy impulses and velocities from the tiles back into `rows` and `solver_bodies`, in place."""
    for i in range(plan.count[CONTACTS]):
        t, j = plan.place[i] // WIDTH, plan.place[i] % WIDTH
        rows.impulse[i, NORMAL], rows.impulse[i, TANGENT] = tiles.impulse[t, NORMAL, j], tiles.impulse[t, TANGENT, j]
    n = plan.count[CIRCLES]
    solver_bodies[:n] = tiles.solver_bodies[:n]
