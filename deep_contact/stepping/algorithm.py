"""The engine: `advance` is the algorithm of a run. At e = 0 it is that of Box2D 2.3 for circles.

Continuous collision is our own. `solvers.batched` has the same stages in batches of contacts;
`deep_contact.run` is the validated interface.
"""

from __future__ import annotations

from deep_contact.compiled import njit
from deep_contact.stepping import sleeping
from deep_contact.stepping.contacts import Exclusions, carry_impulses, detect_contacts, mass_if_fixed
from deep_contact.stepping.context import begin_steps, follow, results_of, set_segments, walls_of
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
    log_pairs,
    log_rest,
    log_substep,
    log_work,
)
from deep_contact.stepping.motion import integrate_positions, integrate_velocities
from deep_contact.stepping.passing import without_passed
from deep_contact.stepping.position_correction import correct_positions
from deep_contact.stepping.rows import (
    apply_impulses,
    contact_rows,
    move_walls,
    store_impulses,
    with_wall_bodies,
    work_of_rolling,
)
from deep_contact.stepping.segment_grid import moved_segments
from deep_contact.stepping.segments import positions_before
from deep_contact.stepping.stay_inside import clamp_inside
from deep_contact.stepping.substeps import divide_by_motion, fly_on


@njit(cache=True, error_model="numpy", nogil=True)
def advance(context, contacts, motion, sleep, log, actuation):
    """Do a step for each row of the log, or fewer if the log's bound on the work ends the call. Bodies move in place.

    A step has as many substeps as the solver asks for. Motion may divide these further (`substeps`). Code for
    segments, restitution, division by motion, sleep and continuous collision is compiled only if the scene needs it. If
    a circle becomes fast and the code for continuous collision is missing, the call ends before that substep. The next
    call has the code, and begins with that substep.
    Returns the result of `context.results_of`: the number of contacts at the end, or −1, and `StepLog.pair_impulses`.

    context: `StepContext`. motion: `StepInput.motion` of the context's step; None if the code for optional features is
    left out (`context.with_optional`). sleep: `SleepMemory`, or None if no circle may sleep. log: `StepLog`, filled in
    place. actuation: `Actuation` of the step, or None. Numba leaves out the code behind a None only if the None is an
    argument.
    """
    step = context.step
    begin_steps(context, contacts, log, actuation)
    for j in range(log.progress[DONE], step.substeps * log.contacts.shape[0]):
        context.row = j // step.substeps
        if sleeping.all_asleep(sleep, actuation):
            log_rest(context, log)
        else:
            if motion is not None:
                divide_by_motion(context, log, actuation)
            for _ in range(context.substep.substeps // step.substeps):
                if not do_substep(context, sleep, log, actuation):
                    return results_of(context)
            if motion is not None:
                fly_on(context, context.substep.dt - step.dt, log, actuation)
        log.progress[DONE] = j + 1
        if log.progress[WORK] <= 0 and (j + 1) % step.substeps == 0:
            break
    log.progress[FINITE] = all_finite(step.bodies.position)
    return results_of(context)


@njit(inline="always")
def do_substep(context, sleep, log, actuation):
    """Do a substep: velocities, positions, and the contacts of the next substep, all in place. See `advance`.

    Returns whether the substep was done. If a circle is fast and the code for continuous collision is missing, bodies
    and contacts stay as they were.
    """
    substep, contacts, options, memory = context.substep, context.contacts, context.options, context.memory
    bodies, box, segments = substep.bodies, substep.box, substep.segments
    scales, friction = substep.scales, substep.friction
    n, impacts = bodies.mass.shape[0], log.loads[:0]
    solver_bodies, theta, rows = memory.solver_bodies, memory.theta, memory.rows
    active = sleeping.awake_contacts(contacts, sleep)
    # Velocities: rebounds, forces, rows, and the impulses that solve them.
    if not memory.is_built:
        impacts = logged_rebound(context, context.step.motion, active, log, actuation)
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
        log_work(substep, active, solver_bodies, work_of_rolling(friction, rows, bodies), log)
        segments = moved_segments(segments, actuation, substep.dt)
    before = positions_before(bodies, segments)
    if not integrate_positions(bodies, solver_bodies, substep, segments, actuation, log.shifts):
        return False
    correct_positions(bodies, active, box, segments, scales, options.position_sweeps, memory.correction)
    # The contacts of the next substep, and the circles that sleep in it.
    context.buffer = 1 - context.buffer
    walls, touches, buffer = walls_of(substep), substep.touches, memory.contacts[context.buffer]
    passed = clamp_inside(bodies, before, walls, segments, contacts, touches, actuation, substep.dt)
    exclusions = Exclusions(mass_if_fixed(bodies, actuation), touches)
    following = detect_contacts(bodies.position, bodies.radius, walls, segments, exclusions, memory.cells, buffer)
    if actuation is not None:
        following = without_passed(following, bodies, segments, actuation, log.progress)
        if passed >= 0:
            log.progress[PASSED] = passed + 1
        set_segments(context, segments)
    carry_impulses(contacts, following, options.carry)
    sleeping.wake_and_put_to_sleep(substep, following, sleep, actuation)
    follow(context, following, buffer)
    # The log.
    log_substep(log, context.row, active.body_a.shape[0], sweeps, theta, relaxations)
    if is_asked(log):
        log_pairs(context, log, contacts, impulses_of(contacts, 1.0 / substep.substeps))
        log_pairs(context, log, active, impacts)
    return True
