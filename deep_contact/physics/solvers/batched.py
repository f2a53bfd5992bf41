"""Projected Gauss-Seidel in batches of contacts that share no circle, eight at a time (`physics.batches`)."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from numba import config, njit, types
from numba.experimental import structref

from deep_contact import validation
from deep_contact.compiled.simd import WIDTH, lane, least, load, load_rows, most, spread, store, store_rows
from deep_contact.compiled.team import Team, share_of, team_size, together, wait
from deep_contact.constants import POSITION_TOLERANCE
from deep_contact.physics import batches, collision
from deep_contact.physics.batches import BLOCK_PHASES, BLOCKS, CONTACTS
from deep_contact.physics.contact_solver import (
    ARM_A,
    ARM_B,
    CONTRACT,
    N_X,
    N_Y,
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    TANGENT_MASS,
    integrate_velocities,
    move,
    stop_fast_circles,
)
from deep_contact.physics.convergence import all_finite, is_over
from deep_contact.physics.impacts import rebound
from deep_contact.physics.position_correction import (
    correct_tiles,
    fill_centres,
    take_centres,
)
from deep_contact.physics.segments import positions_before
from deep_contact.physics.solvers.pgs import MOST_SWEEPS, PGS
from deep_contact.physics.solvers.registry import Loop, register, tolerance_argument
from deep_contact.physics.step import DONE, WORK, impulses_of, is_asked, log_impulses, log_part
from deep_contact.physics.substeps import depart, part_of, parts_of, rejoin
from deep_contact.state import Bodies


@dataclass(frozen=True, kw_only=True)
class BatchedPGS(PGS):
    """Projected Gauss-Seidel in batches of contacts that share no circle, eight at a time: for large scenes.

    threads: at most so many; they change no bit of the result. By default those that pay: one for every
    `CIRCLES_A_THREAD` circles, no more than there are cores. The other options are those of `PGS`. Position correction
    goes in the same batches.

    Weakness: the order of the contacts is not that of the list, so it may need more sweeps than PGS. Finding the
    batches costs a part of each step in which contacts have changed, so few sweeps do not repay it.
    """

    threads: int | None = None

    def __post_init__(self):
        super().__post_init__()
        if self.threads is not None:
            validation.integer("threads", self.threads, least=1, most=MOST_SWEEPS)


CIRCLES_A_THREAD = 1500
"""Circles for which a thread of its own pays: two threads break even at 3,000, and gain from there on."""


BatchSettings = namedtuple("BatchSettings", ["tolerance"])


@njit(cache=True, fastmath=CONTRACT)
def sweep_tiles(tiles, first, last, friction):
    """`contact_solver.sweep` over the tiles from `first` to before `last`, in place. Returns θ, N·s."""
    body, data, impulse, solver_bodies = tiles.body, tiles.data, tiles.impulse, tiles.solver_bodies
    mu, none = spread(friction), spread(0.0)
    theta = none
    for t in range(first, last):
        a_x, a_y, a_s, w_a = load_rows(solver_bodies, body, 2 * t)
        b_x, b_y, b_s, w_b = load_rows(solver_bodies, body, 2 * t + 1)
        row = 6 * t
        n_x, n_y = load(data, row + N_X), load(data, row + N_Y)
        k_n, k_t = load(data, row + NORMAL_MASS), load(data, row + TANGENT_MASS)
        arm_a, arm_b = load(data, row + ARM_A), load(data, row + ARM_B)
        old_n, old_t = load(impulse, 2 * t + NORMAL), load(impulse, 2 * t + TANGENT)

        d_x, d_y = b_x - a_x, b_y - a_y
        free_n = k_n * (none - d_x * n_x - d_y * n_y)
        free_t = k_t * (d_y * n_x - d_x * n_y - arm_a * a_s - arm_b * b_s)
        largest = mu * old_n
        p_t = most(least(free_t, largest - old_t), none - largest - old_t)
        p_n = most(free_n, none - old_n)
        store(impulse, 2 * t + NORMAL, old_n + p_n)
        store(impulse, 2 * t + TANGENT, old_t + p_t)
        theta = most(theta, most(most(p_n, none - p_n), most(p_t, none - p_t)))

        p_x, p_y, turn = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x, p_t + p_t
        store_rows(solver_bodies, body, 2 * t, (a_x - w_a * p_x, a_y - w_a * p_y, a_s + w_a * arm_a * turn, w_a))
        store_rows(solver_bodies, body, 2 * t + 1, (b_x + w_b * p_x, b_y + w_b * p_y, b_s + w_b * arm_b * turn, w_b))
    largest = lane(theta, 0)
    for j in range(1, WIDTH):
        largest = max(largest, lane(theta, j))
    return largest


@njit(cache=True)
def share_of_phase(start, count, p, team):
    """The places in `BatchPlan.order`, first and after the last, of the blocks of a phase that this thread does.

    Neighbours in the list, so that threads share the circles of a few blocks: to get one that another core has changed
    costs more than to relax a contact. Where phases are not shared, rank 0 does all. start, count: of the `BatchPlan`,
    of which a call would count the references to all its arrays, for each sweep.
    """
    first, last = share_of(start[p + 1] - start[p], team)
    if not phases_are_shared(count):
        first, last = 0, start[p + 1] - start[p] if team.rank == 0 else 0
    return start[p] + first, start[p] + last


@njit(cache=True)
def phases_are_shared(count):
    """Whether phases have more than one block. Those of circles that are numbered at random have nothing to share."""
    return 3 * count[BLOCK_PHASES] <= 2 * count[BLOCKS]


@njit(cache=True)
def end_phase(count, p, team):
    """The barrier after a phase, where the next one needs it."""
    if phases_are_shared(count) or p == count[BLOCK_PHASES] - 1:
        wait(team)


@njit(cache=True)
def sweep_blocks(plan, tiles, friction, turn, team):
    """One sweep over all tiles, in place, by a team. Returns θ. turn: 0 and 1 alternate."""
    start, order, begin, worst, count = plan.start, plan.order, plan.first, plan.worst, plan.count
    for p in range(count[BLOCK_PHASES]):
        first, last = share_of_phase(start, count, p, team)
        for q in range(first, last):
            k = order[q]
            worst[k, turn] = sweep_tiles(tiles, begin[k], begin[k + 1], friction)
        end_phase(count, p, team)
    theta = 0.0
    for k in range(count[BLOCKS]):
        theta = max(theta, worst[k, turn])
    return theta


@njit(cache=True)
def correct_blocks(plan, tiles, scales, turn, team):
    """One sweep of position correction, likewise. Returns the deepest separation, m."""
    start, order, begin, worst, count = plan.start, plan.order, plan.first, plan.worst, plan.count
    body, data, centre = tiles.body, tiles.data, tiles.centre
    for p in range(count[BLOCK_PHASES]):
        first, last = share_of_phase(start, count, p, team)
        for q in range(first, last):
            k = order[q]
            worst[k, turn] = correct_tiles(body, data, ARM_B + 1, centre, begin[k], begin[k + 1], scales)
        end_phase(count, p, team)
    deepest = 0.0
    for k in range(count[BLOCKS]):
        deepest = min(deepest, worst[k, turn])
    return deepest


@njit(cache=True)
def relax_tiles(settings, plan, tiles, friction, theta, team):
    """Projected Gauss-Seidel in batches, in place on the tiles; fills θ. Returns the sweeps."""
    for k in range(theta.shape[0]):
        theta[k] = sweep_blocks(plan, tiles, friction, k % 2, team)
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


@njit(cache=True)
def relax_in_batches(settings, rows, friction, solver_bodies, theta, workspace):
    """The same for the rows of one solve, with a plan and tiles of its own."""
    m, n = rows.body.shape[0], solver_bodies.shape[0] - 4
    pairs = rows.body.astype(np.int64)
    plan = batches.plan_batches(pairs[:, 0].copy(), pairs[:, 1].copy(), n, batches.make_plan(n, m))
    tiles = batches.fill_tiles(rows, solver_bodies, plan, batches.make_tiles(n + 5, 1))
    sweeps = relax_tiles(settings, plan, tiles, friction, theta, Team(0, 1, np.zeros(24, np.int64)))
    batches.empty_tiles(plan, tiles, rows, solver_bodies)
    return sweeps


@njit(cache=True, error_model="numpy")
def correct_positions_in_batches(plan, tiles, mine, scales, sweeps):
    """`position_correction.correct_positions` over the tiles of the plan, by a team. mine: `Share` of a thread."""
    team, centre = mine.team, tiles.centre[mine.first : mine.last]
    fill_centres(mine.bodies, centre)
    wait(team)
    for k in range(sweeps):
        if correct_blocks(plan, tiles, scales, k % 2, team) >= -POSITION_TOLERANCE * scales.slop:
            break
    take_centres(centre, mine.bodies)


FAST, FINITE, LISTED = range(3)
"""Columns of `Shared.flags`."""

PAIRS_FOUND, PARTS = range(2)
"""Columns of `Shared.counts`."""

_FIELDS = ("plan", "tiles", "solved", "contacts", "memory", "flags", "counts", "received")
"""What a team shares of a run, in a `Shared`. Rank 0 alone replaces it, between barriers, where it is too small.

plan: `BatchPlan`. tiles: `Tiles`. solved, contacts: `Contacts` of the step before and this one. memory: `StepMemory`.
flags: what a thread tells the others, (size, 8): whether a circle of its share is fast, whether all are finite, whether
there is a list of near pairs. counts: pairs of its share that touch, parts of a substep, (size, 8). received: of
`StepLog`.
"""

if config.DISABLE_JIT:

    def Shared(*values):
        return SimpleNamespace(**dict(zip(_FIELDS, values)))
else:

    @structref.register
    class _SharedType(types.StructRef):
        """Numba's type of a `Shared`."""

        def preprocess_fields(self, fields):
            return tuple((name, types.unliteral(kind)) for name, kind in fields)

    class Shared(structref.StructRefProxy):
        """The fields for compiled code."""

    structref.define_proxy(Shared, _SharedType, list(_FIELDS))


@njit(cache=True)
def make_shared(contacts, memory, size):
    """A `Shared` for a team of that size, that starts from these contacts."""
    n = memory.cells.cell.shape[0]
    plan, tiles = batches.make_plan(n, 4 * n + 64), batches.make_tiles(n + 5, 1)
    flags, counts = np.zeros((size, 8), np.bool_), np.zeros((size, 8), np.int64)
    return Shared(plan, tiles, contacts, contacts, memory, flags, counts, np.zeros((0, 8)))


@njit(cache=True)
def go_on(shared, contacts, memory, received):
    """Let the next steps start from these contacts in this memory, in place. received: of `StepLog`."""
    shared.contacts, shared.memory, shared.received = contacts, memory, received


@njit(cache=True)
def contacts_in(shared):
    """The contacts that the next step starts from, and `StepLog.received`."""
    return shared.contacts, shared.received


class Share(NamedTuple):
    """What a thread of a team does of a scene: a row of circles, and buffers for their pairs."""

    team: Team
    first: int
    last: int  # before it the row ends
    bodies: Bodies  # views
    body_a: np.ndarray
    body_b: np.ndarray


@njit(cache=True)
def share_of_scene(bodies, team):
    """The `Share` of a thread."""
    first, last = share_of(bodies.mass.shape[0], team)
    mine = Bodies(
        bodies.position[first:last], bodies.velocity[first:last], bodies.angle[first:last], bodies.spin[first:last],
        bodies.mass[first:last], bodies.radius[first:last],
    )  # fmt: skip
    capacity = 4 * (last - first) + 64
    return Share(team, first, last, mine, np.empty(capacity, np.int64), np.empty(capacity, np.int64))


@njit(cache=True, error_model="numpy", nogil=True)
def advance_by_team(step, options, log, shared, team):
    """`engine.advance` for `BatchedPGS`, by a team. The contacts are left in `shared`, a `Shared`."""
    part, mine, turn, buffers = step, share_of_scene(step.bodies, team), 0, shared.memory.contacts
    for j in range(log.progress[DONE], step.parts * log.contacts.shape[0]):
        if step.motion.most > 1:
            if team.rank == 0:
                shared.counts[0, PARTS] = parts_of(step, shared.memory.cells)
            wait(team)
            part = part_of(step, shared.counts[0, PARTS])
            if team.rank == 0 and part.parts > step.parts:
                depart(step, part, shared.contacts)
        for _ in range(part.parts // step.parts):
            turn = 1 - turn
            mine = step_by_team(part, options, shared, mine, buffers[turn], log, j // step.parts)
        if team.rank == 0:
            if part.parts > step.parts:
                rejoin(step, part, shared.contacts)
            log.progress[DONE] = j + 1
        if log.progress[WORK] <= 0 and (j + 1) % step.parts == 0:
            break
    write_last_geometry(step, shared.contacts, team)


@njit(inline="always")
def step_by_team(step, options, shared, mine, buffer, log, k):
    """The stages of `engine.advance`, by a team with barriers between them. Returns the `Share` of this thread.

    Each thread does its share of circles, contacts and blocks; rank 0 makes the plan, the list of near pairs, and what
    scenes with segments or fast circles need.
    """
    bodies, segments, scales, team = step.bodies, step.segments, step.scales, mine.team
    flags, theta, is_built = shared.flags, shared.memory.theta, shared.memory.is_built
    if team.rank == 0:
        plan_step(step, shared, log)
    wait(team)
    plan, tiles, solved = shared.plan, shared.tiles, shared.solved
    velocities, before = tiles.solver_bodies[mine.first : mine.last], positions_before(bodies, segments)
    # Velocities.
    if is_built:
        take_velocities(shared.memory.solver_bodies, mine.first, velocities)
    else:
        integrate_velocities(mine.bodies, step.gravity, step.dt, velocities)
    fill_centres(mine.bodies, tiles.centre[mine.first : mine.last])
    wait(team)
    start_blocks(step, solved, plan, tiles, team, shared.memory.rows, is_built)
    sweeps = relax_tiles(options.settings, plan, tiles, step.friction, theta, team)
    flags[team.rank, FINITE] = all_finite(velocities)
    store_blocks(plan, tiles, solved, step.parts, team)
    # Positions.
    flags[team.rank, FAST] = move(mine.bodies, velocities, step.dt, scales.max_translation)
    wait(team)
    if flags[:, FAST].any():
        if team.rank == 0:
            stop_fast_circles(bodies, step)
        wait(team)
    correct_positions_in_batches(plan, tiles, mine, scales, options.position_sweeps)
    wait(team)
    if team.rank == 0:
        if sweeps > 0 and not flags[:, FINITE].all():
            theta[sweeps - 1] = np.nan
        log_part(log, k, plan.count[CONTACTS], sweeps, theta, sweeps * plan.count[CONTACTS])
        if is_asked(log):
            impulse = impulses_of(solved, 1.0 / step.parts)
            shared.received = log_impulses(log, shared.received, solved, impulse, bodies.mass.shape[0])
    return next_contacts(step, options, shared, mine, before, buffer, least_known(step, log))


@njit(cache=True)
def take_velocities(solver_bodies, first, velocities):
    """Copy the velocities of solver bodies from the first on. By a loop, which compiles in less time than a slice."""
    for i in range(velocities.shape[0]):
        for c in range(velocities.shape[1]):
            velocities[i, c] = solver_bodies[first + i, c]


@njit(cache=True, error_model="numpy")
def plan_step(step, shared, log):
    """What a team needs before it solves the contacts, in `shared`: a plan for them, room for their tiles, impacts."""
    n, contacts = step.bodies.mass.shape[0], shared.contacts
    if not batches.is_plan_of(shared.plan, n, contacts, shared.solved):
        shared.plan = batches.plan_batches(contacts.body_a, contacts.body_b, n, shared.plan)
    shared.tiles = batches.with_room(shared.plan, shared.tiles)
    shared.solved = contacts
    if not shared.memory.is_built:
        impacts = log.loads[:0]
        if is_asked(log):
            impacts = np.zeros((contacts.body_a.shape[0], 2))
        rebound(step, contacts, impacts)
        shared.received = log_impulses(log, shared.received, contacts, impacts, n)


@njit(inline="always")
def next_contacts(step, options, shared, mine, before, buffer, least):
    """`collision.next_contacts` by a team, into `shared`. Returns the `Share`, with room for its pairs.

    least: of `collision.write_geometry`.
    """
    bodies, box, segments, skin, team = step.bodies, step.box, step.segments, step.scales.wall_skin, mine.team
    cells, solved = shared.memory.cells, shared.solved
    if team.rank == 0:
        collision.hold(bodies, before, box, segments, skin, solved)
        is_listed = collision.refresh_list(bodies.position, bodies.radius, cells, 0.0)
        shared.flags[0, LISTED] = is_listed and segments.line.shape[0] == 0
    wait(team)
    if shared.flags[0, LISTED]:
        mine = find_touching(step, shared, buffer, mine)
        describe_touching(step, options, shared, mine, least)
    elif team.rank == 0:
        shared.contacts = collision.contacts_at(
            bodies.position, bodies.radius, box, segments, skin, cells, buffer, least
        )
        collision.carry_impulses(solved, shared.contacts, options.carry)
    wait(team)
    return mine


@njit(cache=True)
def least_known(step, log):
    """`collision.write_geometry`'s `least` within a call: logs and impacts read all, tiles those of walls."""
    return 0 if step.restitution > 0.0 or is_asked(log) else step.bodies.mass.shape[0]


@njit(inline="always")
def write_last_geometry(step, contacts, team):
    """The geometry of all contacts after the last step of a call."""
    first, last = share_of(contacts.body_a.shape[0], team)
    bodies, skin = step.bodies, step.scales.wall_skin
    mine = collision.some_contacts(contacts, first, last)
    collision.write_geometry(bodies.position, bodies.radius, step.box, step.segments, skin, mine, 0)


@njit(cache=True, error_model="numpy")
def find_touching(step, shared, buffer, mine):
    """The pairs of this thread's circles that touch, from the list of near ones. Returns the `Share` that has them.

    `Shared.contacts` has room for the pairs of all threads then, in the buffer.
    """
    position, radius, skin, cells = (
        step.bodies.position,
        step.bodies.radius,
        step.scales.wall_skin,
        shared.memory.cells,
    )
    pairs_found = -1
    while pairs_found < 0:
        where = position, radius, step.box, skin, cells, mine.first, mine.last, mine.body_a, mine.body_b
        pairs_found = collision.write_near_pairs(*where)
        if pairs_found < 0:
            capacity = 2 * mine.body_a.shape[0] + 64
            pairs = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
            mine = Share(mine.team, mine.first, mine.last, mine.bodies, pairs[0], pairs[1])
    shared.counts[mine.team.rank, PAIRS_FOUND] = pairs_found
    wait(mine.team)
    if mine.team.rank == 0:
        m = shared.counts[:, PAIRS_FOUND].sum()
        if m > buffer.body_a.shape[0]:
            buffer = collision.more_contacts(m)
        shared.contacts = collision.some_contacts(buffer, 0, m)
    wait(mine.team)
    return mine


@njit(cache=True, error_model="numpy")
def describe_touching(step, options, shared, mine, least):
    """Write this thread's pairs where they belong among the contacts, with their geometry and what they carry."""
    bodies, skin, rank = step.bodies, step.scales.wall_skin, mine.team.rank
    before, count = shared.counts[:rank, PAIRS_FOUND].sum(), shared.counts[rank, PAIRS_FOUND]
    contacts = collision.some_contacts(shared.contacts, before, before + count)
    for i in range(count):
        contacts.body_a[i], contacts.body_b[i] = mine.body_a[i], mine.body_b[i]
    collision.write_geometry(bodies.position, bodies.radius, step.box, step.segments, skin, contacts, least)
    collision.carry_impulses(shared.solved, contacts, options.carry)


@njit(cache=True, error_model="numpy")
def start_blocks(step, contacts, plan, tiles, team, rows, is_built):
    """The rows of all blocks and what they start from, phase by phase, since that changes velocities."""
    for p in range(plan.count[BLOCK_PHASES]):
        first, last = share_of_phase(plan.start, plan.count, p, team)
        for q in range(first, last):
            k = plan.order[q]
            batches.place_block(step, contacts, plan, tiles, k, rows, is_built)
            begin, end = plan.first[k], plan.first[k + 1]
            if not is_built and batches.fill_rows(tiles, begin, end):
                batches.part_coinciding(tiles, begin, end)
            batches.start_tiles(tiles, begin, end)
        end_phase(plan.count, p, team)


@njit(cache=True)
def store_blocks(plan, tiles, contacts, parts, team):
    """`batches.store_block` of all blocks."""
    first, last = share_of(plan.count[BLOCKS], team)
    for k in range(first, last):
        batches.store_block(plan, tiles, contacts, k, parts)


class _Run:
    """`engine.advance` for a run on at most so many threads, and no more than there are cores: the same bits."""

    def __init__(self, solver: BatchedPGS):
        self._solver, self._shared = solver, None

    def __call__(self, step, motion, contacts, sleep, options, memory, log):
        """As `engine.advance`."""
        if self._shared is None:
            self._size = threads_of(self._solver, step.bodies.count)
            self._shared = make_shared(contacts, memory, self._size)
        go_on(self._shared, contacts, memory, log.received)
        together(self._size, advance_by_team, step, options, log, self._shared)
        return contacts_in(self._shared)


def threads_of(solver, n_bodies: int) -> int:
    """On how many threads a solver runs a scene of so many circles here."""
    if not isinstance(solver, BatchedPGS):
        return 1
    return team_size(solver.threads, n_bodies, CIRCLES_A_THREAD)


_LOOP = Loop(BatchSettings, relax_in_batches)
register(BatchedPGS, lambda solver: BatchSettings(tolerance_argument(solver)), (_LOOP,), advance=_Run)
