"""Projected Gauss-Seidel in batches of contacts that share no circle, eight at a time (`physics.batches`)."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numba import config, njit, types
from numba.experimental import structref

from deep_contact import validation
from deep_contact.compiled.simd import WIDTH, lane, least, load, load_rows, most, spread, store, store_rows
from deep_contact.compiled.team import Team, share_of, team_size, together, wait
from deep_contact.constants import POSITION_TOLERANCE
from deep_contact.physics import batches, collision
from deep_contact.physics.batches import BLOCKS, CIRCLES, PHASES
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
    correct_positions,
    correct_tiles,
    fill_centres,
    fill_ground,
    take_centres,
)
from deep_contact.physics.segments import positions_before
from deep_contact.physics.solvers.pgs import MOST_SWEEPS, PGS
from deep_contact.physics.solvers.registry import Loop, register, tolerance_argument
from deep_contact.physics.step import log_step
from deep_contact.physics.substeps import part_of, parts_of, rescale, shift_flights
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
def share_of_phase(plan, p, team):
    """The places in `Plan.order`, first and after the last, of the blocks of a phase that this thread does.

    Neighbours in the list, so that threads share the circles of a few blocks: to get one that another core has changed
    costs more than to relax a contact. Where phases are not shared, rank 0 does all.
    """
    first, last = share_of(plan.start[p + 1] - plan.start[p], team)
    if not phases_are_shared(plan):
        first, last = 0, plan.start[p + 1] - plan.start[p] if team.rank == 0 else 0
    return plan.start[p] + first, plan.start[p] + last


@njit(cache=True)
def phases_are_shared(plan):
    """Whether phases have more than one block. Those of circles that are numbered at random have nothing to share."""
    return 3 * plan.count[PHASES] <= 2 * plan.count[BLOCKS]


@njit(cache=True)
def end_phase(plan, p, team):
    """The barrier after a phase, where the next one needs it."""
    if phases_are_shared(plan) or p == plan.count[PHASES] - 1:
        wait(team)


@njit(cache=True)
def sweep_blocks(plan, tiles, friction, turn, team):
    """One sweep over all tiles, in place, by a team. Returns θ. turn: 0 and 1 alternate."""
    for p in range(plan.count[PHASES]):
        first, last = share_of_phase(plan, p, team)
        for q in range(first, last):
            k = plan.order[q]
            plan.worst[k, turn] = sweep_tiles(tiles, plan.first[k], plan.first[k + 1], friction)
        end_phase(plan, p, team)
    theta = 0.0
    for k in range(plan.count[BLOCKS]):
        theta = max(theta, plan.worst[k, turn])
    return theta


@njit(cache=True)
def correct_blocks(plan, tiles, scales, turn, team):
    """One sweep of position correction, likewise. Returns the deepest separation, m."""
    for p in range(plan.count[PHASES]):
        first, last = share_of_phase(plan, p, team)
        for q in range(first, last):
            k = plan.order[q]
            begin, end = plan.first[k], plan.first[k + 1]
            plan.worst[k, turn] = correct_tiles(tiles.body, tiles.data, ARM_B + 1, tiles.centre, begin, end, scales)
        end_phase(plan, p, team)
    deepest = 0.0
    for k in range(plan.count[BLOCKS]):
        deepest = min(deepest, plan.worst[k, turn])
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
    tiles = batches.fill_tiles(rows, solver_bodies, plan, batches.make_tiles(n, 1, 1))
    sweeps = relax_tiles(settings, plan, tiles, friction, theta, Team(0, 1, np.zeros(24, np.int64)))
    batches.empty_tiles(plan, tiles, rows, solver_bodies)
    return sweeps


@njit(cache=True, error_model="numpy")
def correct_positions_in_batches(plan, tiles, mine, box, scales, sweeps, team):
    """`position_correction.correct_positions` over the tiles of the plan. mine: `Bodies` of this thread, moved."""
    n, (first, last) = plan.count[CIRCLES], share_of(plan.count[CIRCLES], team)
    fill_centres(mine, tiles.centre[first:last])
    for k in range(team.rank, plan.count[BLOCKS], team.size):
        fill_ground(box, scales, tiles.centre[n + 5 * k : n + 5 * k + 5])
    wait(team)
    for k in range(sweeps):
        if correct_blocks(plan, tiles, scales, k % 2, team) >= -POSITION_TOLERANCE * scales.slop:
            break
    take_centres(tiles.centre[first:last], mine)


PAIRS_FOUND, PARTS = range(2)
"""Columns of `Shared.counts`."""

_FIELDS = ("plan", "tiles", "solved", "contacts", "memory", "flags", "counts")
"""What a team shares of a run, in a `Shared`. Rank 0 alone replaces it, between barriers, where it is too small.

plan: `Plan`. tiles: `Tiles`. solved, contacts: `Contacts` of the step before and of this one. memory: `StepMemory`.
flags: what a thread tells the others, (size, 8): whether a circle of its share is fast, whether all are finite, whether
there is a list of near pairs, whether the call ends. counts: pairs of its share that touch, parts of a step, (size, 8).
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
    plan, tiles = batches.make_plan(n, 4 * n + 64), batches.make_tiles(n, 1, 1)
    flags, counts = np.zeros((size, 8), np.bool_), np.zeros((size, 8), np.int64)
    return Shared(plan, tiles, contacts, contacts, memory, flags, counts)


@njit(cache=True)
def go_on(shared, contacts, memory):
    """Let the next steps start from these contacts in this memory, in place."""
    shared.contacts, shared.memory = contacts, memory


@njit(cache=True)
def results_in(shared):
    """What `engine.advance` returns."""
    return shared.solved, shared.contacts


@njit(cache=True)
def some_bodies(bodies, first, last):
    """The bodies from `first` to before `last`, as views."""
    return Bodies(
        bodies.position[first:last], bodies.velocity[first:last], bodies.angle[first:last], bodies.spin[first:last],
        bodies.mass[first:last], bodies.radius[first:last],
    )  # fmt: skip


@njit(cache=True, error_model="numpy", nogil=True)
def advance_by_team(given, options, log, shared, team):
    """`engine.advance` for `BatchedPGS`, by a team: the same stages, with barriers between them.

    Each thread does its share of circles, contacts and blocks; rank 0 makes the plan, the list of near pairs, and what
    scenes with segments or fast circles need. The contacts are left in `shared`, a `Shared`.
    """
    bodies, box, segments, scales, memory = given.bodies, given.box, given.segments, given.scales, shared.memory
    n, theta, flags = bodies.mass.shape[0], memory.theta, shared.flags
    first, last = share_of(n, team)
    mine = some_bodies(bodies, first, last)
    mine_a, mine_b = np.empty(4 * (last - first) + 64, np.int64), np.empty(4 * (last - first) + 64, np.int64)
    part, parts, k, j, turn = given, 1, 0, 0, 0  # the j-th of the parts of the k-th step
    if team.rank == 0:
        shared.counts[0, PARTS] = parts
    while k < log.contacts.shape[0]:
        if team.rank == 0:
            contacts = shared.contacts
            if j == 0:
                wanted = parts_of(given, memory.cells) if given.motion.most > 1 else 1
                if wanted != parts:
                    rescale(contacts, parts / wanted)
                    part, parts, shared.counts[0, PARTS] = part_of(given, wanted), wanted, wanted
                if parts > 1 and given.restitution > 0.0:
                    shift_flights(bodies, contacts, given.gravity, given.dt - part.dt)
            if not batches.is_plan_of(shared.plan, n, contacts, shared.solved):
                shared.plan = batches.plan_batches(contacts.body_a, contacts.body_b, n, shared.plan)
            shared.tiles = batches.with_room(shared.plan, shared.tiles)
            shared.solved = contacts
            if part.restitution > 0.0 and not memory.is_built:
                rebound(part, contacts)
        wait(team)
        if team.rank > 0 and shared.counts[0, PARTS] != parts:
            parts = shared.counts[0, PARTS]
            part = part_of(given, parts)
        plan, tiles, solved = shared.plan, shared.tiles, shared.solved
        my_velocities, before = tiles.solver_bodies[first:last], positions_before(bodies, segments)
        # Velocities.
        if memory.is_built:
            my_velocities[:] = memory.solver_bodies[first:last]
        else:
            integrate_velocities(mine, part.gravity, part.dt, my_velocities)
        wait(team)
        write_blocks(part, solved, plan, tiles, team, memory)
        sweeps = relax_tiles(options.settings, plan, tiles, given.friction, theta, team)
        flags[team.rank, 1] = all_finite(my_velocities)
        store_blocks(plan, tiles, solved, team)
        # Positions.
        flags[team.rank, 0] = move(mine, my_velocities, part)
        wait(team)
        if flags[:, 0].any():
            if team.rank == 0:
                stop_fast_circles(bodies, part)
            wait(team)
        if segments.shape[0] == 0:
            correct_positions_in_batches(plan, tiles, mine, box, scales, options.position_sweeps, team)
            wait(team)
        if team.rank == 0:
            if segments.shape[0] > 0:
                correct_positions(bodies, solved, box, segments, scales, options.position_sweeps, memory.correction)
            if sweeps > 0 and not flags[:, 1].all():
                theta[sweeps - 1] = np.nan
            m = solved.body_a.shape[0]
            flags[0, 3] = log_step(log, k, m, sweeps, theta, sweeps * m)
            # The contacts that the next step solves.
            collision.hold(bodies, before, box, segments, scales.wall_skin, solved)
            is_listed = collision.refresh_list(bodies.position, bodies.radius, memory.cells, 0.0)
            flags[0, 2] = is_listed and segments.shape[0] == 0
        wait(team)
        buffer, turn, j = memory.contacts[turn], 1 - turn, j + 1
        if flags[0, 2]:
            mine_a, mine_b = find_touching(given, shared, buffer, mine_a, mine_b, team)
            describe_touching(given, options, shared, mine_a, mine_b, team)
        elif team.rank == 0:
            where = bodies.position, bodies.radius, box, segments, scales.wall_skin
            shared.contacts = collision.contacts_at(*where, memory.cells, buffer)
            collision.carry_impulses(solved, shared.contacts, options.carry)
        wait(team)
        if j == parts:
            j, k = 0, k + 1
            if team.rank == 0 and parts > 1 and given.restitution > 0.0:
                shift_flights(bodies, shared.contacts, given.gravity, part.dt - given.dt)
            if flags[0, 3]:
                break
    if team.rank == 0 and parts > 1:
        rescale(shared.contacts, parts)


@njit(cache=True, error_model="numpy")
def find_touching(given, shared, buffer, mine_a, mine_b, team):
    """The pairs of this thread's circles that touch, from the list of near ones, into `mine_a` and `mine_b`.

    Returns these, larger ones if needed. `Shared.contacts` has room for the pairs of all threads then, in the buffer.
    """
    bodies, (begin, end) = given.bodies, share_of(given.bodies.mass.shape[0], team)
    where = bodies.position, bodies.radius, given.box, given.scales.wall_skin, shared.memory.cells, begin, end
    found = collision.write_near_pairs(*where, mine_a, mine_b)
    while found < 0:
        mine_a, mine_b = np.empty(2 * mine_a.shape[0] + 64, np.int64), np.empty(2 * mine_b.shape[0] + 64, np.int64)
        found = collision.write_near_pairs(*where, mine_a, mine_b)
    shared.counts[team.rank, PAIRS_FOUND] = found
    wait(team)
    if team.rank == 0:
        m = shared.counts[:, PAIRS_FOUND].sum()
        if m > buffer.body_a.shape[0]:
            buffer = collision.more_contacts(m)
        shared.contacts = collision.some_contacts(buffer, 0, m)
    wait(team)
    return mine_a, mine_b


@njit(cache=True, error_model="numpy")
def describe_touching(given, options, shared, mine_a, mine_b, team):
    """Write this thread's pairs where they belong among the contacts, with their geometry and what they carry."""
    bodies, skin = given.bodies, given.scales.wall_skin
    before, count = shared.counts[: team.rank, PAIRS_FOUND].sum(), shared.counts[team.rank, PAIRS_FOUND]
    contacts = collision.some_contacts(shared.contacts, before, before + count)
    for i in range(count):
        contacts.body_a[i], contacts.body_b[i] = mine_a[i], mine_b[i]
    collision.write_geometry(bodies.position, bodies.radius, given.box, given.segments, skin, contacts)
    collision.carry_impulses(shared.solved, contacts, options.carry)


@njit(cache=True, error_model="numpy")
def write_blocks(given, contacts, plan, tiles, team, memory):
    """`batches.write_block` of all blocks, phase by phase, since it changes velocities."""
    for p in range(plan.count[PHASES]):
        first, last = share_of_phase(plan, p, team)
        for q in range(first, last):
            batches.write_block(given, contacts, plan, tiles, plan.order[q], memory)
        end_phase(plan, p, team)


@njit(cache=True)
def store_blocks(plan, tiles, contacts, team):
    """`batches.store_block` of all blocks."""
    first, last = share_of(plan.count[BLOCKS], team)
    for k in range(first, last):
        batches.store_block(plan, tiles, contacts, k)


class _Run:
    """`engine.advance` for a run on at most so many threads, and no more than there are cores: the same bits."""

    def __init__(self, solver: BatchedPGS):
        self._solver, self._shared = solver, None

    def __call__(self, given, rare, options, memory, log):
        """As `engine.advance`."""
        if self._shared is None:
            self._size = threads_of(self._solver, given.bodies.count)
            self._shared = make_shared(given.contacts, memory, self._size)
        go_on(self._shared, given.contacts, memory)
        together(self._size, advance_by_team, given, options, log, self._shared)
        return results_in(self._shared)


def threads_of(solver, n_bodies: int) -> int:
    """On how many threads a solver runs a scene of so many circles here."""
    if not isinstance(solver, BatchedPGS):
        return 1
    return team_size(solver.threads, n_bodies, CIRCLES_A_THREAD)


_LOOP = Loop(BatchSettings, relax_in_batches)
register(BatchedPGS, lambda solver: BatchSettings(tolerance_argument(solver)), (_LOOP,), advance=_Run)
