"""Steps whose sweeps go in batches: what `advance` of the engine does, over the tiles of `colours`."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
from numba import config, get_num_threads, njit, set_num_threads

from deep_contact.physics.collision import make_cells, make_contacts, next_contacts, own_contacts
from deep_contact.physics.colours import (
    ThreadSettings,
    correct_positions_in_batches,
    fill_tiles,
    make_plan,
    make_tiles,
    plan_batches,
    relax_tiles,
)
from deep_contact.physics.contact_solver import (
    apply_impulses,
    contact_rows,
    integrate_velocities,
    make_rows,
    store_impulses,
)
from deep_contact.physics.convergence import tell_divergence
from deep_contact.physics.engine import integrate_positions


@njit(cache=True, error_model="numpy")
def advance_in_batches(bodies, contacts, world, dt, settings, position_sweeps, warm, steps, moving, theta, log):
    """`engine.advance` for `BatchedPGS`: same arguments, same results; positions are corrected in batches as well."""
    box, gravity, friction, restitution = world
    n = bodies.mass.shape[0]
    cells = make_cells(n)
    room, spare = make_contacts(4 * n + 64), make_contacts(4 * n + 64)
    rows_room = make_rows(4 * n + 64, moving.dtype)
    plan, tiles = make_plan(n, 4 * n + 64), make_tiles(n, 1, 1, moving.dtype)
    solved = contacts
    for k in range(steps):
        integrate_velocities(bodies, gravity, dt, moving)
        rows, rows_room = contact_rows(bodies, contacts, moving, restitution, rows_room)
        apply_impulses(rows, moving)
        plan = plan_batches(rows.body, n, settings.colours, plan)
        tiles = fill_tiles(rows, moving, plan, tiles)
        sweeps = relax_tiles(settings, plan, tiles, rows, friction, moving, theta)
        tell_divergence(moving, theta, sweeps)
        store_impulses(rows, contacts)
        integrate_positions(bodies, moving, dt)
        correct_positions_in_batches(settings, plan, tiles, bodies, box, position_sweeps)

        solved = contacts
        contacts, spare = next_contacts(bodies, box, cells, solved, warm, spare)
        room, spare = spare, room

        log[k, 0] = solved.body_a.shape[0]
        log[k, 1] = sweeps
        log[k, 2] = theta[sweeps - 1] if sweeps > 0 else np.inf
        log[k, 3] = sweeps * solved.body_a.shape[0]
    return own_contacts(solved), own_contacts(contacts)


@contextmanager
def at_most_threads(count: int):
    """Let Numba's parallel functions use so many threads, or as many as there are cores, which it insists on."""
    before = get_num_threads()
    set_num_threads(min(count, config.NUMBA_NUM_THREADS))
    try:
        yield
    finally:
        set_num_threads(before)


def advance_side_by_side(threads: int):
    """`advance_in_batches` with the blocks of a phase on at most so many threads: the same bits."""

    def advance(bodies, contacts, world, dt, settings, *others):
        with at_most_threads(threads):
            return advance_in_batches(bodies, contacts, world, dt, ThreadSettings(*settings), *others)

    return advance
