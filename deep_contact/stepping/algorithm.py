"""The engine: `advance` is the algorithm of a run. At e = 0 it is that of Box2D 2.3 for circles.

Continuous collision is our own. `solvers.batched` has the same stages in batches of contacts;
`deep_contact.run` is the validated interface.
"""

from __future__ import annotations

from deep_contact.compiled import njit
from deep_contact.stepping import sleeping
from deep_contact.stepping.contacts import Walls, carry_impulses, detect_contacts, mass_if_fixed
from deep_contact.stepping.context import substep_of
from deep_contact.stepping.convergence import all_finite
from deep_contact.stepping.impacts import logged_rebound
from deep_contact.stepping.interface import relax
from deep_contact.stepping.log import (
    DONE,
    FINITE,
    PASSED,
    WORK,
    impulses_of,
    is_asked,
    log_impulses,
    log_substep,
    log_work,
)
from deep_contact.stepping.motion import integrate_positions, integrate_velocities
from deep_contact.stepping.passing import without_passed
from deep_contact.stepping.position_correction import correct_positions
from deep_contact.stepping.rows import apply_impulses, contact_rows, move_walls, store_impulses, with_wall_bodies
from deep_contact.stepping.segment_grid import moved_segments
from deep_contact.stepping.segments import positions_before
from deep_contact.stepping.stay_inside import clamp_inside
from deep_contact.stepping.substeps import fly_on, substep_by_motion


@njit(cache=True, error_model="numpy", nogil=True)
def advance(setup, contacts, motion, sleep, log, actuation):
    """Do as many steps as the log has rows, or fewer if its bound on the work ends the call. Bodies move in place.

    A step has as many substeps as the solver asks for. Motion may divide these further (`substeps`). Code for
    segments, restitution, division by motion, sleep and continuous collision is compiled only if the scene needs it. If
    a circle becomes fast and the code for continuous collision is missing, the call ends before that substep. The next
    call has the code, and goes on from there.
    The conditions on motion and on actuation stand in this function, because a function that returned its argument
    unchanged would count references to some fifty arrays.
    Returns the contacts at the end, in memory that the next call overwrites, and `StepLog.pair_impulses`.
    setup: `StepSetup`. motion: `Motion` of its step; None without optional features (`context.with_optional`).
    actuation: `Actuation` of its step, or None. sleep: `SleepMemory`, or None if no circle may sleep. log: `StepLog`,
    filled in place.
    """
    step, memory = setup.step, setup.memory
    if actuation is not None:
        step = substep_of(step, moved_segments(step.segments, actuation, 0.0))
    substep, buffer_index, pair_impulses = step, 0, log.pair_impulses
    for j in range(log.progress[DONE], step.substeps * log.contacts.shape[0]):
        if sleeping.all_asleep(sleep, actuation):
            log_substep(log, j // step.substeps, 0, 0, memory.theta, 0)
            if is_asked(log):
                impulse, n = impulses_of(contacts, 1.0 / step.substeps), step.bodies.mass.shape[0]
                pair_impulses = log_impulses(log, pair_impulses, contacts, impulse, n)
            log.progress[DONE] = j + 1
            continue
        if motion is not None:
            substep = substep_by_motion(step, substep, memory.cells, actuation)
            fly_on(step, substep, contacts, step.dt - substep.dt, actuation, log.shifts)
        for _ in range(substep.substeps // step.substeps):
            buffer_index = 1 - buffer_index
            is_whole, contacts, pair_impulses, segments = do_substep(
                substep, motion, contacts, sleep, setup, log, pair_impulses, j // step.substeps, buffer_index, actuation
            )
            if not is_whole:
                return contacts, pair_impulses
            if actuation is not None:
                substep, step = substep_of(substep, segments), substep_of(step, segments)
        if motion is not None:
            fly_on(step, substep, contacts, substep.dt - step.dt, actuation, log.shifts)
        log.progress[DONE] = j + 1
        if log.progress[WORK] <= 0 and (j + 1) % step.substeps == 0:
            break
    log.progress[FINITE] = all_finite(step.bodies.position)
    return contacts, pair_impulses


@njit(inline="always")
def do_substep(substep, motion, contacts, sleep, setup, log, pair_impulses, k, buffer_index, actuation):
    """Do a substep of the k-th step: velocities, positions, and, in one of two buffers, the contacts of the next one.

    Returns whether the substep was done, and the contacts, `StepLog.pair_impulses` and the segments after it. If a
    circle is fast and the code for continuous collision is missing, the substep is not done: the function returns
    False, and the other values as they were. It is inlined, because a call would count references to all arrays that it
    passes.
    """
    bodies, box, segments = substep.bodies, substep.box, substep.segments
    scales, friction = substep.scales, substep.friction
    options, memory, n, impacts = setup.options, setup.memory, substep.bodies.mass.shape[0], log.loads[:0]
    solver_bodies, theta, rows, cells = memory.solver_bodies, memory.theta, memory.rows, memory.cells
    active = sleeping.awake_contacts(contacts, sleep)
    # Velocities: rebounds, forces, rows, and the impulses that solve them.
    if not memory.is_built:
        impacts = logged_rebound(substep, motion, active, log, actuation)
        solver_bodies = with_wall_bodies(solver_bodies, active, n, actuation)
        integrate_velocities(bodies, substep.gravity, substep.dt, solver_bodies, actuation)
        sleeping.stop_sleeping(solver_bodies, sleep)
        rows = contact_rows(active, bodies.radius, segments, solver_bodies, rows, friction, 1.0 / substep.substeps)
        if actuation is not None:
            move_walls(active, segments, solver_bodies, rows, n, actuation)
    apply_impulses(rows, solver_bodies, friction)
    sweeps, relaxations = relax(options.settings, rows, friction, solver_bodies, theta, memory.workspace)
    store_impulses(rows, active, substep.substeps)
    sleeping.store_awake_impulses(active, contacts, sleep)
    # Positions: of segments and of circles, and position correction.
    if actuation is not None:
        log_work(substep, active, solver_bodies, log)
        segments = moved_segments(segments, actuation, substep.dt)
    before = positions_before(bodies, segments)
    if not integrate_positions(bodies, solver_bodies, substep, segments, actuation, log.shifts):
        return False, contacts, pair_impulses, segments
    correct_positions(bodies, active, box, segments, scales, options.position_sweeps, memory.correction)
    # The contacts of the next substep, and the circles that sleep in it.
    walls, mass, buffer = Walls(box, scales.wall_skin), mass_if_fixed(bodies, actuation), memory.contacts[buffer_index]
    passed = clamp_inside(bodies, before, walls, segments, contacts, actuation, substep.dt)
    following = detect_contacts(bodies.position, bodies.radius, mass, walls, segments, cells, buffer)
    if actuation is not None:
        following = without_passed(following, bodies, segments, actuation, log.progress)
        if passed >= 0:
            log.progress[PASSED] = passed + 1
    carry_impulses(contacts, following, options.carry)
    sleeping.wake_and_put_to_sleep(substep, following, sleep, actuation)
    # The log.
    log_substep(log, k, active.body_a.shape[0], sweeps, theta, relaxations)
    if is_asked(log):
        pair_impulses = log_impulses(log, pair_impulses, contacts, impulses_of(contacts, 1.0 / substep.substeps), n)
        pair_impulses = log_impulses(log, pair_impulses, active, impacts, n)
    return True, following, pair_impulses, segments
