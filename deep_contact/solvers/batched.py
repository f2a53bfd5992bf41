"""Projected Gauss-Seidel over batches of contacts that share no circle. Eight contacts are relaxed at a time.

`solvers.batches` has the data structure: a plan of the batches, and tiles of eight contacts.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass

import numpy as np
from numba.extending import overload

from deep_contact.compiled import njit
from deep_contact.compiled.direct import Direct
from deep_contact.compiled.simd import WIDTH, lane, least, load, load_rows, most, spread, store, store_rows
from deep_contact.compiled.structures import Structure, StructureType, define
from deep_contact.solvers import batches
from deep_contact.solvers.batches import BLOCKS, CONTACTS
from deep_contact.state.constants import POSITION_TOLERANCE
from deep_contact.stepping import broad_phase, stay_inside
from deep_contact.stepping.contacts import Exclusions, carry_impulses, find_pairs, mass_if_fixed, write_geometry
from deep_contact.stepping.context import begin_steps, follow, results_of, set_segments, walls_of
from deep_contact.stepping.convergence import all_finite, is_over
from deep_contact.stepping.impacts import logged_rebound
from deep_contact.stepping.interface import Loop, SolverOptions, register, tolerance_argument
from deep_contact.stepping.log import (
    DONE,
    FINITE,
    PASSED,
    WORK,
    impulses_of,
    is_asked,
    log_pairs,
    log_substep,
    log_work,
)
from deep_contact.stepping.motion import integrate_positions, integrate_velocities
from deep_contact.stepping.pairs import is_rough, is_rough_type, largest_of
from deep_contact.stepping.passing import without_passed
from deep_contact.stepping.position_correction import correct_tiles, fill_centres, take_centres
from deep_contact.stepping.rows import (
    ARM_A,
    ARM_B,
    CONTRACT,
    N_X,
    N_Y,
    NORMAL,
    NORMAL_MASS,
    ROLLING_STARTS,
    TANGENT,
    TANGENT_MASS,
)
from deep_contact.stepping.segment_grid import moved_segments
from deep_contact.stepping.segments import positions_before
from deep_contact.stepping.substeps import divide_by_motion, fly_on


@dataclass(frozen=True, kw_only=True)
class BatchedPGS(SolverOptions):
    """Projected Gauss-Seidel for large scenes, over batches of contacts that share no circle, eight contacts at a time.

    The options are those of every solver (`SolverOptions`). Position correction uses the same batches.

    Weakness: contacts are not swept in the order of the list, so the solver may need more sweeps than PGS. In each step
    in which the list of contacts has changed, the batches are chosen anew, which takes longer than a few sweeps save.
    """


BatchSettings = namedtuple("BatchSettings", ["tolerance"])


@njit(cache=True, fastmath=CONTRACT)
def sweep_tiles(tiles, first, last, friction):
    """Do a sweep of Projected Gauss-Seidel over the tiles from `first` to before `last`, in place. Returns θ, N·s.

    It is `rows.sweep` for eight contacts at a time. tiles: `Tiles`. friction: as in `StepInput`. θ is the largest
    change of an impulse.
    """
    body, data, impulse, solver_bodies = tiles.body, tiles.data, tiles.impulse, tiles.solver_bodies
    column, none = tiles.friction, spread(0.0)
    theta = none
    for t in range(first, last):
        a_x, a_y, a_s, w_a = load_rows(solver_bodies, body, 2 * t)
        b_x, b_y, b_s, w_b = load_rows(solver_bodies, body, 2 * t + 1)
        row = 6 * t
        n_x, n_y = load(data, row + N_X), load(data, row + N_Y)
        k_n, k_t = load(data, row + NORMAL_MASS), load(data, row + TANGENT_MASS)
        arm_a, arm_b = load(data, row + ARM_A), load(data, row + ARM_B)
        old_n, old_t = load(impulse, 2 * t + NORMAL), load(impulse, 2 * t + TANGENT)

        (a_s, b_s), theta = batches.roll_tile(friction, tiles.rolling, t, (a_s, b_s), (w_a, w_b), old_n, theta)
        d_x, d_y = b_x - a_x, b_y - a_y
        free_n = k_n * (none - d_x * n_x - d_y * n_y)
        free_t = k_t * (d_y * n_x - d_x * n_y - arm_a * a_s - arm_b * b_s)
        largest = batches.tile_friction(friction, column, t) * old_n
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


def start_rolling_tiles(friction, plan, tiles) -> None:
    """Do `rows.start_rolling` for all tiles of a plan, in place. friction: as in `StepInput`."""
    if is_rough(friction):
        roll_blocks(plan, tiles)


@overload(start_rolling_tiles)
def _overload_start_rolling_tiles(friction, plan, tiles):
    if is_rough_type(friction):
        return lambda friction, plan, tiles: roll_blocks(plan, tiles)
    return lambda friction, plan, tiles: None


@njit(cache=True)
def roll_blocks(plan, tiles):
    """Do `ROLLING_STARTS` sweeps over the rolling rows of all tiles of a plan, in place."""
    for _ in range(ROLLING_STARTS):
        for k in plan.order[: plan.count[BLOCKS]]:
            roll_tiles(tiles, plan.first[k], plan.first[k + 1])


@njit(cache=True, fastmath=CONTRACT)
def roll_tiles(tiles, first, last):
    """Relax the rolling rows of the tiles from `first` to before `last`, in place. tiles: `Tiles`."""
    body, solver_bodies = tiles.body, tiles.solver_bodies
    for t in range(first, last):
        a_x, a_y, a_s, w_a = load_rows(solver_bodies, body, 2 * t)
        b_x, b_y, b_s, w_b = load_rows(solver_bodies, body, 2 * t + 1)
        old_n = load(tiles.impulse, 2 * t + NORMAL)
        spins, _ = batches.roll_lanes(tiles.rolling, t, (a_s, b_s), (w_a, w_b), old_n, spread(0.0))
        store_rows(solver_bodies, body, 2 * t, (a_x, a_y, spins[0], w_a))
        store_rows(solver_bodies, body, 2 * t + 1, (b_x, b_y, spins[1], w_b))


@njit(cache=True)
def sweep_blocks(plan, tiles, friction):
    """Do one sweep over all tiles of a plan, in place. Returns θ, the largest change of an impulse, N·s."""
    theta = 0.0
    for k in plan.order[: plan.count[BLOCKS]]:
        theta = max(theta, sweep_tiles(tiles, plan.first[k], plan.first[k + 1], friction))
    return theta


@njit(cache=True)
def correct_blocks(plan, tiles, scales):
    """Do one sweep of position correction over all tiles of a plan, in place.

    Returns the smallest separation before the corrections, m, or 0 if no contact penetrates.
    """
    body, data, centre, first, deepest = tiles.body, tiles.data, tiles.centre, plan.first, 0.0
    for k in plan.order[: plan.count[BLOCKS]]:
        deepest = min(deepest, correct_tiles(body, data, ARM_B + 1, centre, first[k], first[k + 1], scales))
    return deepest


@njit(cache=True)
def relax_tiles(settings, plan, tiles, friction, theta):
    """Do sweeps over all tiles of a plan, in place, until θ is within the tolerance. Returns the number of sweeps.

    settings: `BatchSettings`. theta: buffer for θ of each sweep, N·s; its length is the largest number of sweeps.
    Rolling rows are relaxed alone first (`rows.start_rolling`).
    """
    start_rolling_tiles(friction, plan, tiles)
    for k in range(theta.shape[0]):
        theta[k] = sweep_blocks(plan, tiles, friction)
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


@njit(cache=True)
def relax_in_batches(settings, rows, friction, solver_bodies, theta, workspace):
    """Relax the rows of a single solve by `relax_tiles`, with a plan and tiles made for these rows.

    Arguments and result are those of `Loop.relax` (`stepping.interface`).
    """
    m, n = rows.body.shape[0], solver_bodies.shape[0] - 4
    pairs = rows.body.astype(np.int64)
    plan = batches.plan_batches(pairs[:, 0].copy(), pairs[:, 1].copy(), n, batches.make_plan(n, m))
    tiles = batches.fill_tiles(rows, solver_bodies, plan, batches.make_tiles(n + 5, 1, friction), friction)
    sweeps = relax_tiles(settings, plan, tiles, friction, theta)
    batches.empty_tiles(plan, tiles, rows, solver_bodies)
    return sweeps


@njit(cache=True, error_model="numpy")
def correct_positions_in_batches(plan, tiles, bodies, scales, sweeps):
    """Correct positions over the tiles of a plan, as `position_correction.correct_positions` does.

    Bodies move in place. sweeps: largest number of sweeps.
    """
    centre = tiles.centre[: bodies.mass.shape[0]]
    fill_centres(bodies, centre)
    for _ in range(sweeps):
        if correct_blocks(plan, tiles, scales) >= -POSITION_TOLERANCE * scales.slop:
            break
    take_centres(centre, bodies)


class _BatchWorkspaceType(StructureType):
    """Numba's type of a `BatchWorkspace`."""


class BatchWorkspace(Structure):
    """Workspace that each step of a run passes to the next step. A step replaces fields that do not fit its contacts.

    | field  | meaning                                 |
    |--------|-----------------------------------------|
    | plan   | `BatchPlan`                             |
    | tiles  | `Tiles`                                 |
    | solved | `Contacts` of which the plan was made   |
    """


define(BatchWorkspace, _BatchWorkspaceType, ("plan", "tiles", "solved"))


@njit(cache=True)
def make_batch_workspace(context, contacts):
    """Return a `BatchWorkspace` for steps that start from these contacts. context: `StepContext`."""
    n = context.step.bodies.mass.shape[0]
    friction = context.step.friction
    return BatchWorkspace(batches.make_plan(n, 4 * n + 64), batches.make_tiles(n + 5, 1, friction), contacts)


@njit(cache=True, error_model="numpy", nogil=True)
def advance_in_batches(context, contacts, workspace, log, actuation):
    """Do steps as `algorithm.advance` does, with the solver `BatchedPGS`. Bodies move in place.

    context: `StepContext`. contacts: `Contacts` at the start. workspace: `BatchWorkspace`, changed in place and passed
    to the next call. log: `StepLog`, filled in place. actuation: `Actuation` of the steps, or None. Returns the result
    of `context.results_of`.
    """
    step = context.step
    begin_steps(context, contacts, log, actuation)
    for j in range(log.progress[DONE], step.substeps * log.contacts.shape[0]):
        context.row = j // step.substeps
        if step.motion.most > 1:
            divide_by_motion(context, log, actuation)
        for _ in range(context.substep.substeps // step.substeps):
            do_substep_in_batches(context, workspace, log, actuation)
        if step.motion.most > 1:
            fly_on(context, context.substep.dt - step.dt, log, actuation)
        log.progress[DONE] = j + 1
        if log.progress[WORK] <= 0 and (j + 1) % step.substeps == 0:
            break
    segments = context.substep.segments
    write_geometry(step.bodies.position, step.bodies.radius, walls_of(step), segments, context.contacts, 0)
    log.progress[FINITE] = all_finite(step.bodies.position)
    return results_of(context)


@njit(inline="always")
def do_substep_in_batches(context, workspace, log, actuation):
    """Do a substep as `algorithm.do_substep` does, but over batches of contacts.

    It computes velocities, positions, and the contacts of the next substep, all in place. Arguments are those of
    `advance_in_batches`.
    """
    substep, options, memory, solved = context.substep, context.options, context.memory, context.contacts
    bodies, segments, scales, n = substep.bodies, substep.segments, substep.scales, substep.bodies.mass.shape[0]
    cells, is_built, theta = memory.cells, memory.is_built, memory.theta
    plan_batches_of(solved, n, workspace, substep.friction)
    plan, tiles = workspace.plan, workspace.tiles
    # Velocities: rebounds, external forces, rows in tiles, and the sweeps that solve the rows.
    velocities = tiles.solver_bodies[:n]
    if is_built:
        take_velocities(memory.solver_bodies, velocities)
    else:
        log_pairs(context, log, solved, logged_rebound(context, context.step.motion, solved, log, actuation))
        integrate_velocities(bodies, substep.gravity, substep.dt, velocities, actuation)
    fill_centres(bodies, tiles.centre[:n])
    start_blocks(substep, solved, plan, tiles, memory.rows, is_built, actuation)
    sweeps = relax_tiles(options.settings, plan, tiles, substep.friction, theta)
    if sweeps > 0 and not all_finite(velocities):
        theta[sweeps - 1] = np.nan
    for block in range(plan.count[BLOCKS]):
        batches.store_block(plan, tiles, solved, block, substep.substeps)
    # Positions: segments and circles move, and position correction follows.
    if actuation is not None:
        log_work(substep, solved, velocities, batches.work_of_rolling(substep.friction, plan, tiles, bodies), log)
        batches.move_points(plan, tiles, substep.dt)
        segments = moved_segments(segments, actuation, substep.dt)
    before = positions_before(bodies, segments)
    integrate_positions(bodies, velocities, substep, segments, actuation, log.shifts)
    correct_positions_in_batches(plan, tiles, bodies, scales, options.position_sweeps)
    log_substep(log, context.row, plan.count[CONTACTS], sweeps, theta, sweeps * plan.count[CONTACTS])
    if is_asked(log):
        log_pairs(context, log, solved, impulses_of(solved, 1.0 / substep.substeps))
    # Contacts of the next substep. Logs and impacts need the geometry of all contacts; tiles need that of contacts
    # with walls and segments only.
    context.buffer = 1 - context.buffer
    least = 0 if largest_of(substep.restitution) > 0.0 or is_asked(log) or actuation is not None else n
    position, radius, walls = bodies.position, bodies.radius, walls_of(substep)
    touches, buffer = substep.touches, memory.contacts[context.buffer]
    passed = stay_inside.clamp_inside(bodies, before, walls, segments, solved, touches, actuation, substep.dt)
    broad_phase.refresh_list(position, radius, cells, 0.0)
    exclusions = Exclusions(mass_if_fixed(bodies, actuation), touches)
    following = find_pairs(position, radius, walls, segments, exclusions, cells, buffer)
    write_geometry(position, radius, walls, segments, following, least)
    if actuation is not None:
        following = without_passed(following, bodies, segments, actuation, log.progress)
        if passed >= 0:
            log.progress[PASSED] = passed + 1
        set_segments(context, segments)
    carry_impulses(solved, following, options.carry)
    follow(context, following, buffer)


@njit(cache=True)
def take_velocities(solver_bodies, velocities):
    """Copy the velocities of the solver bodies into `velocities`, (n, 4), in place.

    This loop compiles faster than a slice.
    """
    for i in range(velocities.shape[0]):
        for c in range(velocities.shape[1]):
            velocities[i, c] = solver_bodies[i, c]


@njit(cache=True, error_model="numpy")
def plan_batches_of(contacts, n, workspace, friction):
    """Plan the batches of contacts of n circles, and allocate their tiles if needed, in place on the workspace.

    friction: as in `StepInput`.
    """
    if not batches.is_plan_of(workspace.plan, n, contacts, workspace.solved):
        workspace.plan = batches.plan_batches(contacts.body_a, contacts.body_b, n, workspace.plan)
    workspace.tiles = batches.with_room(workspace.plan, workspace.tiles, friction)
    workspace.solved = contacts


@njit(cache=True, error_model="numpy")
def start_blocks(step, contacts, plan, tiles, rows, is_built, actuation):
    """Fill the rows of all blocks and apply their starting impulses, block by block, in place on the tiles.

    step: `StepInput`. rows: `Rows` built before, which are copied if `is_built` is True. actuation: `Actuation`, or
    None.
    """
    for k in plan.order[: plan.count[BLOCKS]]:
        batches.place_block(step, contacts, plan, tiles, k, actuation)
        if is_built:
            batches.place_rows(rows, plan, tiles, k)
        begin, end = plan.first[k], plan.first[k + 1]
        if not is_built and batches.fill_rows(tiles, begin, end):
            batches.part_coinciding(tiles, begin, end)
        batches.start_tiles(tiles, begin, end)


class _Run:
    """A function in place of `algorithm.advance` for one run of `BatchedPGS`. It stores the workspace of the run."""

    def __init__(self, solver: BatchedPGS):
        self._workspace, self._plain, self._actuated = None, Direct(advance_in_batches), Direct(advance_in_batches)

    def __call__(self, context, contacts, motion, sleep, log, actuation):
        """Do steps. Arguments and result are those of `algorithm.advance`."""
        if self._workspace is None:
            self._workspace = make_batch_workspace(context, contacts)
        run = self._plain if actuation is None else self._actuated
        return run(context, contacts, self._workspace, log, actuation)


_LOOP = Loop(BatchSettings, relax_in_batches)
register(BatchedPGS, lambda solver: BatchSettings(tolerance_argument(solver)), (_LOOP,), advance=_Run, rolls=True)
