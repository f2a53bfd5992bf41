"""Projected Gauss-Seidel in batches of contacts that share no circle, eight at a time (`physics.batches`)."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass

import numpy as np

from deep_contact.compiled import njit
from deep_contact.compiled.simd import WIDTH, lane, least, load, load_rows, most, spread, store, store_rows
from deep_contact.compiled.structures import Structure, StructureType, define
from deep_contact.constants import POSITION_TOLERANCE
from deep_contact.physics import batches
from deep_contact.physics.batches import BLOCKS, CONTACTS
from deep_contact.physics.collision import more_contacts, next_contacts, write_geometry
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
    integrate_positions,
    integrate_velocities,
)
from deep_contact.physics.convergence import all_finite, is_over, mark_divergence
from deep_contact.physics.impacts import logged_rebound
from deep_contact.physics.position_correction import (
    correct_tiles,
    fill_centres,
    take_centres,
)
from deep_contact.physics.segments import moved_segments, positions_before
from deep_contact.physics.solvers.pgs import PGS
from deep_contact.physics.solvers.registry import Loop, register, tolerance_argument
from deep_contact.physics.step import (
    DONE,
    FINITE,
    WORK,
    impulses_of,
    is_asked,
    log_impulses,
    log_part,
    log_work,
    part_of,
)
from deep_contact.physics.substeps import fly_on, part_by_motion


@dataclass(frozen=True, kw_only=True)
class BatchedPGS(PGS):
    """Projected Gauss-Seidel in batches of contacts that share no circle, eight at a time: for large scenes.

    The options are those of `PGS`. Position correction goes in the same batches.

    Weakness: the order of the contacts is not that of the list, so it may need more sweeps than PGS. Finding the
    batches costs a part of each step in which contacts have changed, so few sweeps do not repay it.
    """


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
def relax_tiles(settings, plan, tiles, friction, theta):
    """Projected Gauss-Seidel in batches, in place on the tiles; fills θ. Returns the sweeps."""
    for k in range(theta.shape[0]):
        largest = 0.0
        for block in plan.order[: plan.count[BLOCKS]]:
            largest = max(largest, sweep_tiles(tiles, plan.first[block], plan.first[block + 1], friction))
        theta[k] = largest
        if is_over(largest, settings.tolerance):
            return k + 1
    return theta.shape[0]


@njit(cache=True)
def relax_in_batches(settings, rows, friction, solver_bodies, theta, workspace):
    """The same for the rows of one solve. workspace: a `Room`."""
    n, pairs = solver_bodies.shape[0] - 4, rows.body.astype(np.int64)
    plan = batches.plan_batches(pairs[:, 0].copy(), pairs[:, 1].copy(), n, workspace.plan)
    tiles = batches.fill_tiles(rows, solver_bodies, plan, workspace.tiles)
    sweeps = relax_tiles(settings, plan, tiles, friction, theta)
    batches.empty_tiles(plan, tiles, rows, solver_bodies)
    return sweeps


@njit(cache=True, error_model="numpy")
def correct_positions_in_batches(plan, tiles, bodies, scales, sweeps):
    """`position_correction.correct_positions` over the tiles of the plan."""
    body, data, centre, first = tiles.body, tiles.data, tiles.centre, plan.first
    fill_centres(bodies, centre)
    for _ in range(sweeps):
        deepest = 0.0
        for k in plan.order[: plan.count[BLOCKS]]:
            deepest = min(deepest, correct_tiles(body, data, ARM_B + 1, centre, first[k], first[k + 1], scales))
        if deepest >= -POSITION_TOLERANCE * scales.slop:
            break
    take_centres(centre, bodies)


class _RoomType(StructureType):
    """Numba's type of a `Room`."""


class Room(Structure):
    """What the steps of a run hand on, whose fields they replace where they are too small.

    plan: `BatchPlan` of the contacts `planned`. tiles: `Tiles`.
    """


define(Room, _RoomType, ("plan", "tiles", "planned"))


@njit(cache=True)
def make_room(rows, solver_bodies):
    """A `Room` for as many contacts as there are rows."""
    n = solver_bodies.shape[0] - 4
    return Room(batches.make_plan(n, rows.body.shape[0]), batches.make_tiles(n + 5, 1), more_contacts(0))


@njit(cache=True, error_model="numpy", nogil=True)
def advance_in_batches(setup, contacts, motion, sleep, log, drive):
    """`engine.advance` for `BatchedPGS`. motion is never None, and sleep always is."""
    step, memory = setup.step, setup.memory
    if drive is not None:
        step = part_of(step, moved_segments(step.segments, drive, 0.0))
    part, turn, received = step, 0, log.received
    for j in range(log.progress[DONE], step.parts * log.contacts.shape[0]):
        if motion.most > 1:
            part = part_by_motion(step, part, memory.cells, drive)
            fly_on(step, part, contacts, step.dt - part.dt, drive)
        for _ in range(part.parts // step.parts):
            turn = 1 - turn
            contacts, received, segments = do_part_in_batches(part, contacts, setup, log, received, turn, drive)
            if drive is not None:
                part, step = part_of(part, segments), part_of(step, segments)
        if motion.most > 1:
            fly_on(step, part, contacts, part.dt - step.dt, drive)
        log.progress[DONE] = j + 1
        if log.progress[WORK] <= 0 and (j + 1) % step.parts == 0:
            break
    where = step.bodies.position, step.bodies.radius, step.box, step.segments, step.scales.wall_skin
    write_geometry(*where, contacts, 0)
    log.progress[FINITE] = all_finite(step.bodies.position)
    return contacts, received


@njit(inline="always")
def do_part_in_batches(part, contacts, setup, log, received, turn, drive):
    """`engine.do_part`: velocities, positions, and the contacts that the next part solves, in buffer `turn`.

    Returns these contacts, `StepLog.received` and the segments after it.
    """
    bodies, segments, options, memory = part.bodies, part.segments, setup.options, setup.memory
    room, scales = memory.workspace, part.scales
    n, theta, rows, is_built = bodies.mass.shape[0], memory.theta, memory.rows, memory.is_built
    plan_part(n, contacts, room)
    plan, tiles = room.plan, room.tiles
    # Velocities: rebounds, forces, tiles, and the impulses that solve them.
    velocities = tiles.solver_bodies[:n]
    if is_built:
        take_velocities(memory.solver_bodies, velocities)
    else:
        impacts = logged_rebound(part, part.motion, contacts, log, drive)
        received = log_impulses(log, received, contacts, impacts, n)
        integrate_velocities(bodies, part.gravity, part.dt, velocities, drive)
    fill_centres(bodies, tiles.centre)
    for block in plan.order[: plan.count[BLOCKS]]:  # one after the other, since each changes velocities
        first, last = plan.first[block], plan.first[block + 1]
        batches.place_block(part, contacts, plan, tiles, block, rows, is_built, drive)
        if not is_built and batches.fill_rows(tiles, first, last):
            batches.part_coinciding(tiles, first, last)
        batches.start_tiles(tiles, first, last)
    sweeps = relax_tiles(options.settings, plan, tiles, part.friction, theta)
    mark_divergence(velocities, theta, sweeps)
    for block in range(plan.count[BLOCKS]):
        batches.store_block(plan, tiles, contacts, block, part.parts)
    # Positions: of segments, of circles, and their correction.
    if drive is not None:
        log_work(part, contacts, velocities, log)
        batches.move_points(plan, tiles, part.dt)
        segments = moved_segments(segments, drive, part.dt)
    before = positions_before(bodies, segments)
    integrate_positions(bodies, velocities, part, segments, drive)
    correct_positions_in_batches(plan, tiles, bodies, scales, options.position_sweeps)
    step, count = log.progress[DONE] // setup.step.parts, plan.count[CONTACTS]
    log_part(log, step, count, sweeps, theta, sweeps * count)
    if is_asked(log):
        received = log_impulses(log, received, contacts, impulses_of(contacts, 1.0 / part.parts), n)
    # The contacts that the next part or step solves. Logs and impacts read all geometry; tiles, that of walls.
    least = 0 if part.restitution > 0.0 or is_asked(log) or drive is not None else n
    buffer, carry = memory.contacts[turn], options.carry
    following = next_contacts(part, segments, before, contacts, memory.cells, buffer, carry, drive, least)
    return following, received, segments


@njit(cache=True)
def take_velocities(solver_bodies, velocities):
    """Copy the velocities of solver bodies. By a loop, which compiles in less time than a slice."""
    for i in range(velocities.shape[0]):
        for c in range(velocities.shape[1]):
            velocities[i, c] = solver_bodies[i, c]


@njit(cache=True, error_model="numpy")
def plan_part(n, contacts, room):
    """A plan for these contacts of n circles, and room for their tiles, in place."""
    if not batches.is_plan_of(room.plan, n, contacts, room.planned):
        room.plan = batches.plan_batches(contacts.body_a, contacts.body_b, n, room.plan)
    room.tiles = batches.with_room(room.plan, room.tiles)
    room.planned = contacts


_LOOP = Loop(BatchSettings, relax_in_batches, make_room)
register(BatchedPGS, lambda solver: BatchSettings(tolerance_argument(solver)), (_LOOP,), advance=advance_in_batches)
