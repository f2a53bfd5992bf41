"""Projected Gauss-Seidel in batches of contacts that share no circle, eight at a time (`physics.batches`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numba.extending import overload

from deep_contact import validation
from deep_contact.compiled.simd import (
    WIDTH,
    lane,
    least,
    load,
    load_rows,
    most,
    spread,
    store,
    store_rows,
)
from deep_contact.compiled.threads import at_most_threads
from deep_contact.constants import POSITION_TOLERANCE
from deep_contact.physics.batches import (
    BLOCKS,
    CIRCLES,
    PHASES,
    TILES,
    empty_tiles,
    fill_tiles,
    make_plan,
    make_tiles,
    plan_batches,
)
from deep_contact.physics.collision import make_cells, make_contacts, next_contacts, own_contacts
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
    TARGET,
    apply_impulses,
    contact_rows,
    integrate_positions,
    integrate_velocities,
    make_rows,
    move_surfaces,
    store_impulses,
)
from deep_contact.physics.convergence import is_over, mark_divergence
from deep_contact.physics.position_correction import (
    correct_positions,
    correct_tiles,
    fill_centres,
    fill_ground,
    make_correction_room,
    take_centres,
)
from deep_contact.physics.segments import positions_before
from deep_contact.physics.solvers.pgs import MOST_SWEEPS, PGS
from deep_contact.physics.solvers.registry import Loop, register, tolerance_argument
from deep_contact.physics.step import log_step

ORDERS = ("levels", "colours")
"""Orders of the batches: see `physics.batches`."""


@dataclass(frozen=True, kw_only=True)
class BatchedPGS(PGS):
    """Projected Gauss-Seidel in batches of contacts that share no circle, eight at a time: for large scenes.

    order: "levels" keeps the order of the contacts, so that it is PGS up to rounding; "colours" changes it (see
    `deep_contact.physics.batches`). threads: at most so many, for "colours" only; they change no bit of the result.
    The other options are those of `PGS`. Position correction goes in the same batches.

    A sweep costs a third of PGS's; finding the batches costs some nanoseconds a contact and step, so it pays from about
    five sweeps on. Weakness: in a chain of contacts, as in a column, a level is one contact and fills one lane of
    eight. Colours fill more lanes, but their order is not that of the list, so they may need more sweeps.
    """

    order: str = "levels"
    threads: int = 1

    def __post_init__(self):
        super().__post_init__()
        validation.one_of("order", self.order, ORDERS)
        validation.integer("threads", self.threads, least=1, most=MOST_SWEEPS)
        if self.threads > 1 and self.order != "colours":
            raise ValueError(f"threads: expected 1 with order={self.order!r}, got {self.threads}")


class BatchSettings(NamedTuple):
    """Settings of `BatchedPGS` on one thread. colours: order by colours; otherwise by levels."""

    tolerance: float
    colours: bool


class ThreadSettings(NamedTuple):
    """Settings of `BatchedPGS` with the blocks of a phase on several threads."""

    tolerance: float
    colours: bool


@njit(cache=True, fastmath=CONTRACT)
def sweep_tiles(tiles, first, last, friction):
    """`contact_solver.sweep` over the tiles from `first` to before `last`, in place. Returns θ, N·s."""
    body, data, impulse, solver_bodies = tiles.body, tiles.data, tiles.impulse, tiles.solver_bodies
    mu, none = spread(solver_bodies.dtype.type(friction)), spread(solver_bodies.dtype.type(0.0))
    theta = none
    for t in range(first, last):
        a_x, a_y, a_s, w_a = load_rows(solver_bodies, body, 2 * t)
        b_x, b_y, b_s, w_b = load_rows(solver_bodies, body, 2 * t + 1)
        row = 7 * t
        n_x, n_y, k_n, k_t = (
            load(data, row + N_X),
            load(data, row + N_Y),
            load(data, row + NORMAL_MASS),
            load(data, row + TANGENT_MASS),
        )
        arm_a, arm_b, target = load(data, row + ARM_A), load(data, row + ARM_B), load(data, row + TARGET)
        old_n, old_t = load(impulse, 2 * t + NORMAL), load(impulse, 2 * t + TANGENT)

        d_x, d_y = b_x - a_x, b_y - a_y
        free_n = k_n * (target - d_x * n_x - d_y * n_y)
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
    return np.float64(largest)


@njit(cache=True)
def correct_block(tiles, first, last, scales):
    """A sweep of position correction over some tiles, in place. Returns the deepest separation, m."""
    return correct_tiles(tiles.body, tiles.data, TARGET + 1, tiles.centre, first, last, scales)


def sweep_batches(settings, plan, tiles, friction):
    """One sweep over all tiles, in place, on threads if the settings say so. Returns θ."""
    return _sweeper(type(settings))(settings, plan, tiles, friction)


def correct_batches(settings, plan, tiles, scales):
    """One sweep of position correction, likewise. Returns the deepest separation, m."""
    return _corrector(type(settings))(settings, plan, tiles, scales)


@overload(sweep_batches)
def _overload_sweep_batches(settings, plan, tiles, friction):
    return _sweeper(settings.instance_class)


@overload(correct_batches)
def _overload_correct_batches(settings, plan, tiles, scales):
    return _corrector(settings.instance_class)


def _sweeper(settings_type):
    return _sweep_side_by_side if settings_type is ThreadSettings else _sweep_in_turn


def _corrector(settings_type):
    return _correct_side_by_side if settings_type is ThreadSettings else _correct_in_turn


def _sweep_in_turn(settings, plan, tiles, friction):
    theta = 0.0
    for k in plan.order[: plan.count[BLOCKS]]:
        theta = max(theta, sweep_tiles(tiles, plan.first[k], plan.first[k + 1], friction))
    return theta


def _correct_in_turn(settings, plan, tiles, scales):
    deepest = 0.0
    for k in plan.order[: plan.count[BLOCKS]]:
        deepest = min(deepest, correct_block(tiles, plan.first[k], plan.first[k + 1], scales))
    return deepest


def _sweep_side_by_side(settings, plan, tiles, friction):
    for p in range(plan.count[PHASES]):
        sweep_phase(plan.order[plan.start[p] : plan.start[p + 1]], plan.first, plan.worst, tiles, friction)
    theta = 0.0
    for k in range(plan.count[BLOCKS]):
        theta = max(theta, plan.worst[k])
    return theta


def _correct_side_by_side(settings, plan, tiles, scales):
    for p in range(plan.count[PHASES]):
        correct_phase(plan.order[plan.start[p] : plan.start[p + 1]], plan.first, plan.worst, tiles, scales)
    deepest = 0.0
    for k in range(plan.count[BLOCKS]):
        deepest = min(deepest, plan.worst[k])
    return deepest


@njit(cache=True, parallel=True)
def sweep_phase(blocks, first, theta, tiles, friction):
    """Sweep these blocks, which share no circle, at the same time; fills their θ."""
    for i in prange(blocks.shape[0]):
        theta[blocks[i]] = sweep_tiles(tiles, first[blocks[i]], first[blocks[i] + 1], friction)


@njit(cache=True, parallel=True)
def correct_phase(blocks, first, deepest, tiles, scales):
    """Position correction over these blocks, likewise; fills their deepest separations."""
    for i in prange(blocks.shape[0]):
        deepest[blocks[i]] = correct_block(tiles, first[blocks[i]], first[blocks[i] + 1], scales)


@njit(cache=True)
def relax_tiles(settings, plan, tiles, rows, friction, solver_bodies, theta):
    """Projected Gauss-Seidel in batches, from and into the tiles, then the rows and velocities. Returns the sweeps."""
    sweeps = theta.shape[0]
    for k in range(theta.shape[0]):
        theta[k] = sweep_batches(settings, plan, tiles, friction)
        if is_over(theta[k], settings.tolerance):
            sweeps = k + 1
            break
    empty_tiles(plan, tiles, rows, solver_bodies)
    return sweeps


@njit(cache=True)
def relax_in_batches(settings, rows, friction, solver_bodies, theta, workspace):
    """The same for one solve, with a plan and tiles of its own."""
    m, n = rows.body.shape[0], solver_bodies.shape[0] - 4
    plan = plan_batches(rows.body, n, settings.colours, make_plan(n, m))
    tiles = fill_tiles(
        rows, solver_bodies, plan, make_tiles(n, plan.count[BLOCKS], plan.count[TILES], solver_bodies.dtype)
    )
    return relax_tiles(settings, plan, tiles, rows, friction, solver_bodies, theta)


@njit(cache=True, error_model="numpy")
def correct_positions_in_batches(settings, plan, tiles, bodies, box, scales, sweeps):
    """`position_correction.correct_positions` over the tiles of the plan: in place, with the same stop."""
    n = plan.count[CIRCLES]
    fill_centres(bodies, tiles.centre)
    for k in range(plan.count[BLOCKS]):
        fill_ground(box, scales, tiles.centre[n + 5 * k : n + 5 * k + 5])
    for _ in range(sweeps):
        if correct_batches(settings, plan, tiles, scales) >= -POSITION_TOLERANCE * scales.slop:
            break
    take_centres(tiles.centre, bodies)


@njit(cache=True, error_model="numpy", nogil=True)
def advance_in_batches(given, options, workspace, log):
    """`engine.advance` for `BatchedPGS`: same arguments, same results; positions are corrected in batches as well."""
    bodies, contacts, friction, settings = given.bodies, given.contacts, given.friction, options.settings
    solver_bodies, theta = workspace.solver_bodies, workspace.theta
    scales, segments = given.scales, given.segments
    n = bodies.mass.shape[0]
    cells = make_cells(n)
    front_buffer, back_buffer = make_contacts(4 * n + 64), make_contacts(4 * n + 64)
    row_buffer = make_rows(4 * n + 64, solver_bodies.dtype)
    plan, tiles = make_plan(n, 4 * n + 64), make_tiles(n, 1, 1, solver_bodies.dtype)
    room = make_correction_room(n, 0)
    solved = contacts
    for k in range(log.contacts.shape[0]):
        integrate_velocities(bodies, given.gravity, given.dt, solver_bodies)
        rows, row_buffer = contact_rows(
            bodies, contacts, solver_bodies, given.restitution, scales.restitution_threshold, row_buffer
        )
        if segments.shape[0] > 0:
            move_surfaces(contacts, segments, solver_bodies, rows)
        apply_impulses(rows, solver_bodies)
        plan = plan_batches(rows.body, n, settings.colours, plan)
        tiles = fill_tiles(rows, solver_bodies, plan, tiles)
        sweeps = relax_tiles(settings, plan, tiles, rows, friction, solver_bodies, theta)
        mark_divergence(solver_bodies, theta, sweeps)
        store_impulses(rows, contacts)
        before = positions_before(bodies, segments)
        integrate_positions(bodies, solver_bodies, given)
        if segments.shape[0] > 0:
            room = correct_positions(bodies, contacts, given.box, segments, scales, options.position_sweeps, room)
        else:
            correct_positions_in_batches(settings, plan, tiles, bodies, given.box, scales, options.position_sweeps)

        solved = contacts
        contacts, back_buffer = next_contacts(
            bodies, before, given.box, segments, scales.wall_skin, cells, solved, options.carry, back_buffer
        )
        front_buffer, back_buffer = back_buffer, front_buffer
        log_step(log, k, solved.body_a.shape[0], sweeps, theta, sweeps * solved.body_a.shape[0])
    return own_contacts(solved), own_contacts(contacts)


def _advance(solver: BatchedPGS):
    if solver.threads == 1:
        return advance_in_batches

    def advance_in_parallel(given, options, workspace, log):
        """`advance_in_batches` with the blocks of a phase on at most so many threads: the same bits."""
        parallel = options._replace(settings=ThreadSettings(*options.settings))
        with at_most_threads(solver.threads):
            return advance_in_batches(given, parallel, workspace, log)

    return advance_in_parallel


def _settings(solver: BatchedPGS) -> BatchSettings:
    return BatchSettings(tolerance_argument(solver), solver.order == "colours")


register(
    BatchedPGS,
    _settings,
    (
        Loop(BatchSettings, relax_in_batches, frictionless=False),
        Loop(ThreadSettings, relax_in_batches, frictionless=False),
    ),
    advance=_advance,
)
