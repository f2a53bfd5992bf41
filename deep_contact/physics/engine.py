"""The engine: `advance` is the algorithm of a run. At e = 0 it is that of Box2D 2.3 for circles.

Continuous collision is our own. `solvers.batched` has the same stages in batches of contacts;
`deep_contact.simulation` is the validated interface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.compiled.direct import Direct
from deep_contact.physics import sleeping
from deep_contact.physics.collision import (
    Walls,
    carry_impulses,
    find_contacts,
    hold,
    make_cells,
    make_contacts,
    mass_if_fixed,
)
from deep_contact.physics.contact_solver import (
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    V_S,
    V_Y,
    Rows,
    apply_impulses,
    contact_rows,
    integrate_positions,
    integrate_velocities,
    more_rows,
    move_walls,
    room_for_walls,
    store_impulses,
)
from deep_contact.physics.convergence import ConvergenceRecord, all_finite, convergence_record
from deep_contact.physics.impacts import logged_rebound, rebound
from deep_contact.physics.passing import without_passed
from deep_contact.physics.position_correction import correct_positions
from deep_contact.physics.segments import moved_segments, positions_before, segments_in_grid
from deep_contact.physics.solvers.registry import SolverOptions, entry_of, make_workspace, relax
from deep_contact.physics.step import (
    DONE,
    FINITE,
    PASSED,
    WORK,
    Drive,
    Motion,
    StepInput,
    StepLog,
    StepMemory,
    StepOptions,
    StepSetup,
    impulses_of,
    is_asked,
    log_impulses,
    log_part,
    log_work,
    make_memory,
    make_setup,
    part_of,
    with_rare,
    work_on,
)
from deep_contact.physics.substeps import fly_on, part_by_motion
from deep_contact.state import State, native, notebook
from deep_contact.state.arrays import Contacts
from deep_contact.state.equality import by_value
from deep_contact.state.scales import ContactScales, mean


@njit(cache=True, error_model="numpy", nogil=True)
def advance(setup, contacts, motion, sleep, log, drive):
    """Do as many steps as the log has rows, or fewer if its bound on the work ends the call. Bodies move in place.

    A step has as many substeps as the solver asks for. Motion may divide these further (`substeps`). Code for
    segments, restitution, division by motion, sleep and continuous collision is compiled only if the scene needs it. If
    a circle becomes fast and the code for continuous collision is missing, the call ends before that substep. The next
    call has the code, and goes on from there.
    The conditions on motion and on actuation stand in this function, because a function that returned its argument
    unchanged would count references to some fifty arrays.
    Returns the contacts at the end, in memory that the next call overwrites, and `StepLog.received`.
    setup: `StepSetup`. motion: `Motion` of its step; None without optional features (`step.with_rare`). drive: `Drive`
    of its step, or None. sleep: `SleepMemory`, or None if no circle may sleep. log: `StepLog`, filled in place.
    """
    step, memory = setup.step, setup.memory
    if drive is not None:
        step = part_of(step, moved_segments(step.segments, drive, 0.0))
    part, turn, received = step, 0, log.received
    for j in range(log.progress[DONE], step.parts * log.contacts.shape[0]):
        if sleeping.all_asleep(sleep, drive):
            log_part(log, j // step.parts, 0, 0, memory.theta, 0)
            if is_asked(log):
                impulse, n = impulses_of(contacts, 1.0 / step.parts), step.bodies.mass.shape[0]
                received = log_impulses(log, received, contacts, impulse, n)
            log.progress[DONE] = j + 1
            continue
        if motion is not None:
            part = part_by_motion(step, part, memory.cells, drive)
            fly_on(step, part, contacts, step.dt - part.dt, drive, log.shifts)
        for _ in range(part.parts // step.parts):
            turn = 1 - turn
            is_whole, contacts, received, segments = do_part(
                part, motion, contacts, sleep, setup, log, received, j // step.parts, turn, drive
            )
            if not is_whole:
                return contacts, received
            if drive is not None:
                part, step = part_of(part, segments), part_of(step, segments)
        if motion is not None:
            fly_on(step, part, contacts, part.dt - step.dt, drive, log.shifts)
        log.progress[DONE] = j + 1
        if log.progress[WORK] <= 0 and (j + 1) % step.parts == 0:
            break
    log.progress[FINITE] = all_finite(step.bodies.position)
    return contacts, received


@njit(inline="always")
def do_part(part, motion, contacts, sleep, setup, log, received, k, turn, drive):
    """Do a substep of the k-th step: velocities, positions, and the contacts of the next substep, in buffer `turn`.

    Returns whether the substep was done, and the contacts, `StepLog.received` and the segments after it. If a circle is
    fast and the code for continuous collision is missing, the substep is not done: the function returns False, and the
    other values as they were. It is inlined, because a call would count references to all arrays that it passes.
    """
    bodies, box, segments, scales, friction = part.bodies, part.box, part.segments, part.scales, part.friction
    options, memory, n, impacts = setup.options, setup.memory, part.bodies.mass.shape[0], log.loads[:0]
    solver_bodies, theta, rows, cells = memory.solver_bodies, memory.theta, memory.rows, memory.cells
    active = sleeping.awake_contacts(contacts, sleep)
    # Velocities: rebounds, forces, rows, and the impulses that solve them.
    if not memory.is_built:
        impacts = logged_rebound(part, motion, active, log, drive)
        solver_bodies = room_for_walls(solver_bodies, active, n, drive)
        integrate_velocities(bodies, part.gravity, part.dt, solver_bodies, drive)
        sleeping.hold_sleeping(solver_bodies, sleep)
        rows = contact_rows(active, bodies.radius, segments, solver_bodies, rows, friction, 1.0 / part.parts)
        if drive is not None:
            move_walls(active, segments, solver_bodies, rows, n, drive)
    apply_impulses(rows, solver_bodies, friction)
    sweeps, relaxations = relax(options.settings, rows, friction, solver_bodies, theta, memory.workspace)
    store_impulses(rows, active, part.parts)
    sleeping.store_awake_impulses(active, contacts, sleep)
    # Positions: of segments and of circles, and position correction.
    if drive is not None:
        log_work(part, active, solver_bodies, log)
        segments = moved_segments(segments, drive, part.dt)
    before = positions_before(bodies, segments)
    if not integrate_positions(bodies, solver_bodies, part, segments, drive, log.shifts):
        return False, contacts, received, segments
    correct_positions(bodies, active, box, segments, scales, options.position_sweeps, memory.correction)
    # The contacts of the next substep, and the circles that sleep in it.
    walls, mass, buffer = Walls(box, scales.wall_skin), mass_if_fixed(bodies, drive), memory.contacts[turn]
    passed = hold(bodies, before, walls, segments, contacts, drive, part.dt)
    following = find_contacts(bodies.position, bodies.radius, mass, walls, segments, cells, buffer)
    if drive is not None:
        following = without_passed(following, bodies, segments, drive, log.progress)
        if passed >= 0:
            log.progress[PASSED] = passed + 1
    carry_impulses(contacts, following, options.carry)
    sleeping.wake_and_put_to_sleep(part, following, sleep, drive)
    # The log.
    log_part(log, k, active.body_a.shape[0], sweeps, theta, relaxations)
    if is_asked(log):
        received = log_impulses(log, received, contacts, impulses_of(contacts, 1.0 / part.parts), n)
        received = log_impulses(log, received, active, impacts, n)
    return True, following, received, segments


class Steps:
    """Steps of one solver: each call does some steps, in memory that the object keeps for the next call.

    solver: options with numbers in place of what follows the scene (`SolverOptions.for_state`). n: number of circles.
    sleep: whether islands may sleep, where the solver can (`registry.Entry`); all start awake.
    carry: see `StepOptions`.
    """

    def __init__(self, solver, n: int, *, sleep: bool = False, carry: bool = True):
        entry = entry_of(solver)
        self._advance = entry.advance(solver) if entry.advance else advance
        self._is_plain = not (sleep or entry.advance)  # whether optional features are left out; once False, it stays
        self._options = StepOptions(entry.settings(solver), solver.position_sweeps, carry)
        self._solver, self._memory, self._direct = solver, {}, {}
        self._asked = self._rare = None  # the last input of steps, and its `with_rare`
        self._setups: dict = {}  # buffer -> the last input of steps, and its setup
        self._found: tuple = (None, -1, False)  # body_a of the last contacts, their buffer, and the key of its memory
        self.sleep = sleeping.make_sleep_memory(n, 4 * n + 64) if sleep else None

    def wake(self) -> None:
        """Wake all islands."""
        if self.sleep is not None:
            self.sleep.still[:] = 0.0

    def memory(self, step: StepInput, contacts: int = 0) -> StepMemory:
        """The memory of these steps, which differs for rows with and without tangents. contacts: their number."""
        return self._memories(step, contacts)[-1]

    def _memories(self, step: StepInput, contacts: int) -> list[StepMemory]:
        """Four memories: memory i < 3 does not overwrite contacts in buffer i; the last is for contacts in no buffer.

        They share everything but the two buffers that each of them fills (`_BUFFERS`).
        """
        key = step.friction is None
        if key not in self._memory:
            n, m = step.bodies.count, contacts
            capacity, friction = max(4 * n, m + m // 2) + 64, step.friction
            memory = make_memory(n, capacity, self._solver.sweeps, friction)
            workspace = make_workspace(self._options.settings, memory.rows, memory.solver_bodies)
            memory = memory._replace(workspace=workspace)
            buffers = *memory.contacts, make_contacts(capacity)
            self._memory[key] = [memory._replace(contacts=(buffers[i], buffers[j])) for i, j in _BUFFERS]
        return self._memory[key]

    def _buffer_of(self, contacts: Contacts, key: bool) -> int:
        """Index of the buffer in which the contacts lie, in the memories of this key; -1 if they lie in none."""
        found, buffer, kept = self._found
        return buffer if contacts.body_a is found and key == kept else -1

    def _keep(self, following: Contacts, parts: int, buffer: int, key: bool) -> Contacts:
        """Record the buffer of the contacts after `parts` substeps, which fill two buffers in turn, and return them."""
        if self.sleep is not None:  # substeps in which all circles sleep fill no buffer
            following, buffer = Contacts(*map(np.copy, following)), -1
        elif parts > 0:
            buffer = _BUFFERS[buffer][parts % 2]
        self._found = following.body_a, buffer, key
        return following

    def __call__(
        self, step: StepInput, contacts: Contacts, log: StepLog, problem: StepProblem | None = None
    ) -> tuple[Contacts, np.ndarray]:
        """Do as many steps as the log has rows, and fill the log. Bodies move in place.

        problem: contact problem of the only step, if it is built already; the step overwrites it. If circles may sleep
        or the step is divided, it is ignored, and rows are built anew.
        Returns the contacts at the end, in memory that the next call does not overwrite, and `StepLog.received`.
        """
        key, before, built = step.friction is None, 0, None
        buffer = self._buffer_of(contacts, key)
        if problem is not None and self.sleep is None and step.parts == self._solver.motion_parts == 1:
            rows, solver_bodies, _, impacts = started(problem, contacts, step.friction)
            built = {"rows": rows, "solver_bodies": solver_bodies, "is_built": True}
            if step.drive is not None:
                log.work[0] += work_on(step, contacts, impacts)
            if is_asked(log):
                received = log_impulses(log, log.received, contacts, impacts, step.bodies.count)
                log = log._replace(received=received)
        while True:
            self._is_plain = self._is_plain and step.motion is None
            step = step if self._is_plain else self._with_rare(step)
            kind = self._is_plain, key, step.drive is None  # what the types of all arguments depend on
            if kind not in self._direct:
                self._direct[kind] = Direct(self._advance)
            setup = self._setup_of(step, buffer, contacts.count, built)
            following, received = self._direct[kind](setup, contacts, step.motion, self.sleep, log, step.drive)
            parts = int(log.parts[0] if len(log.parts) == 1 else log.parts.sum())
            following, before = self._keep(following, parts - before, buffer, key), parts
            if not self._is_plain or log.progress[WORK] <= 0 or log.progress[DONE] == step.parts * len(log.contacts):
                return following, received
            # A circle is fast, so the next call has the code for it. The rows that were built are overwritten by now.
            self._is_plain, contacts, log, built = False, following, log._replace(received=received), None
            buffer = self._buffer_of(following, key)

    def _setup_of(self, step: StepInput, buffer: int, contacts: int, built: dict | None) -> StepSetup:
        """The setup of steps whose contacts lie in this buffer. It is kept until the input of the steps changes.

        contacts: their number. built: fields of the memory that are filled already for a single step, or None.
        """
        before, setup = self._setups.get(buffer, (None, None))
        if built is not None or before is not step:
            memory = self._memories(step, contacts)[buffer]
            setup = make_setup(step, self._options, memory._replace(**built) if built else memory)
            if built is None:
                self._setups[buffer] = step, setup
        return setup

    def _with_rare(self, step: StepInput) -> StepInput:
        if step is not self._asked:
            self._asked, self._rare = step, with_rare(step)
        return self._rare


_BUFFERS = (1, 2), (0, 2), (0, 1), (0, 1)
"""The two of three buffers that steps fill, if their contacts lie in buffer 0, in buffer 1, in buffer 2, in none."""


@njit(cache=True, error_model="numpy")
def solve_velocities(rows, friction, settings, solver_bodies, theta):
    """Solve the rows of a step, in place on their impulses and on the solver bodies. Returns the number of sweeps."""
    apply_impulses(rows, solver_bodies, friction)
    sweeps, _ = relax(settings, rows, friction, solver_bodies, theta, make_workspace(settings, rows, solver_bodies))
    return sweeps


@njit(cache=True, error_model="numpy", nogil=True)
def build_rows(step, contacts, solver_bodies, drive):
    """Fill the solver bodies of a step, after its impacts, and return its rows.

    step: `StepInput`. drive: `Drive` of the step, or None.
    """
    integrate_velocities(step.bodies, step.gravity, step.dt, solver_bodies, drive)
    buffer, radius = more_rows(contacts.body_a.shape[0], step.friction), step.bodies.radius
    rows = contact_rows(contacts, radius, step.segments, solver_bodies, buffer, step.friction, 1.0)
    if drive is not None:
        move_walls(contacts, step.segments, solver_bodies, rows, radius.shape[0], drive)
    return rows


@by_value
class ContactSolution(NamedTuple):
    """Solution of a contact problem, as a solver left it.

    | field              | meaning                                | shape  | unit  |
    |--------------------|----------------------------------------|--------|-------|
    | normal_impulses    | λ_n                                    | (m,)   | N·s   |
    | tangent_impulses   | λ_t                                    | (m,)   | N·s   |
    | velocities         | of the circles, after the solve        | (n, 2) | m/s   |
    | angular_velocities | of the circles, after the solve        | (n,)   | rad/s |
    | record             | `ConvergenceRecord` of the sweeps      |        |       |
    """

    normal_impulses: np.ndarray
    tangent_impulses: np.ndarray
    velocities: np.ndarray
    angular_velocities: np.ndarray
    record: ConvergenceRecord

    def __repr__(self) -> str:
        return f"ContactSolution({notebook.counted(self.normal_impulses.size, 'contact')}, {self.record})"


class StepProblem(NamedTuple):
    """The contact problem of a state's next step, after its impacts, built once for the start and for the step."""

    rows: Rows  # with the impulses that the state starts from
    solver_bodies: np.ndarray  # (n + 4 + contacts with moving segments, 4): after gravity, before impulses
    friction: float | None  # μ, or None where there are no tangent rows (`started`)
    impacts: np.ndarray  # (m, 2): impulses on the second bodies of the contacts in the impacts, N·s; (0, 2) if e = 0


def leaves_tangents_out(state: State, solver) -> bool:
    """Whether a step has no tangent rows: μ = 0, no contact starts from a tangent impulse, and the loop allows it."""
    return state.world.friction == 0 and entry_of(solver).advance is None and not state.contacts.tangent_start.any()


UNDIVIDED = SolverOptions()
"""The options of a step that is solved once."""


def step_input(state: State, solver, scales: ContactScales | None = None) -> StepInput:
    """The `StepInput` of the next steps of a state; it shares the state's arrays.

    solver: None for rows with tangents, an undivided step and the state's own scales.
    """
    world, options = state.world, UNDIVIDED if solver is None else solver
    friction = None if solver is not None and leaves_tangents_out(state, solver) else world.friction
    scales, most = scales_of(state, options) if scales is None else scales, options.motion_parts
    parts = options.substeps
    step = StepInput(state.bodies, world.box, None, world.gravity, friction, None, state.dt / parts, parts, scales)
    drive = drive_of(state)
    if most == 1 and not world.segments and world.restitution == 0.0 and drive is None:
        return step
    motion = Motion(most, options.approach * mean(state.bodies.radius)) if most > 1 else Motion(1, 0.0)
    segments = segments_in_grid(world, reach_of(state, scales))
    if world.segment_velocities:
        segments = segments._replace(line=segments.line.copy())
    return step._replace(segments=segments, restitution=world.restitution, motion=motion, drive=drive)


def drive_of(state: State) -> Drive | None:
    """Kinematics and external force of a state's next step; None without moving segments, fixed circles and pushes."""
    (force, torque), world, n = state.push or (None, None), state.world, state.bodies.count
    if force is None and not world.segment_velocities and not state.bodies.is_fixed.any():
        return None
    if force is None:
        force, torque = np.zeros((n, 2)), np.zeros(n)
    wall = np.array(world.segment_velocities or np.zeros((len(world.segments), 4))).reshape(-1, 4)
    return Drive(wall, np.flatnonzero(wall.any(axis=1)), force, torque)


def reach_of(state: State, scales: ContactScales) -> float:
    """Largest distance from a segment at which the centre of a circle has a contact with it, m."""
    return float(state.bodies.radius.max(initial=0.0)) + scales.wall_skin


def scales_of(state: State, solver) -> ContactScales:
    """The scales of a state with the solver's slop."""
    slop, scales = solver.slop, state.scales
    return scales if slop == 1.0 else scales._replace(slop=slop * scales.slop)


def after_impacts(state: State) -> tuple[State, np.ndarray]:
    """(State, impulses): the state with the velocities after the impacts of its next step, and the impacts' impulses.

    The impulses are `StepProblem.impacts`. If e = 0 there are no impacts, and the state itself is returned.
    """
    if state.world.restitution == 0.0:
        return state, np.zeros((0, 2))
    bodies = state.bodies._replace(velocity=state.bodies.velocity.copy(), spin=state.bodies.spin.copy())
    state, impacts = state.replace(bodies=bodies), np.zeros((state.contacts.count, 2))
    step = step_input(state, None)
    rebound(step, state.contacts, impacts, step.drive)
    return state, impacts


def step_problem(state: State, scales: ContactScales | None = None) -> StepProblem:
    """The contact problem of the next step, with tangent rows. scales: those of the state, if at hand."""
    state, impacts = after_impacts(state)
    solver_bodies, step = np.empty((state.bodies.count + 4, 4)), step_input(state, None, scales)
    if step.drive is not None:
        solver_bodies = room_for_walls(solver_bodies, state.contacts, state.bodies.count, step.drive)
    rows = build_rows(step, state.contacts, solver_bodies, step.drive)
    return StepProblem(rows, solver_bodies, step.friction, impacts)


def started(problem: StepProblem, contacts: Contacts, friction: float | None) -> StepProblem:
    """The problem with the starting impulses of these contacts; without tangent rows if friction is None.

    problem: with tangent rows.
    """
    data, impulse = problem.rows.data, np.empty((contacts.count, 2))
    impulse[:, NORMAL], impulse[:, TANGENT] = contacts.normal_start, contacts.tangent_start
    if friction is None:
        data, impulse = data[:, : NORMAL_MASS + 1].copy(), impulse[:, :TANGENT].copy()
    return problem._replace(rows=Rows(problem.rows.body, data, impulse), friction=friction)


def contacts_of(state: State) -> Contacts:
    """The contacts at the state's positions, with zero impulses."""
    bodies, world = native(state).bodies, state.world
    segments = segments_in_grid(world, reach_of(state, state.scales)) if world.segments else None
    mass = bodies.mass if bodies.is_fixed.any() else None
    walls, cells = Walls(world.box, state.scales.wall_skin), make_cells(bodies.count)
    buffer = make_contacts(4 * bodies.count + 64)
    found = find_contacts(bodies.position, bodies.radius, mass, walls, segments, cells, buffer)
    # Bodies and geometry are copied, since they lie in a larger buffer. The four arrays of impulses are set to zero.
    return Contacts(*map(np.copy, found[:5]), *map(np.zeros_like, found[5:]))


def solve(
    state: State, solver, normal_start: np.ndarray, tangent_start: np.ndarray, problem: StepProblem | None = None
) -> ContactSolution:
    """Solve the contact problem of a state from starting impulses, (m,) each, N·s. The state stays as it is.

    If e > 0 the impacts come first: the solution's velocities include their effect, but its impulses do not include
    theirs. problem: `step_problem(state)`, if at hand; it stays as it is.
    """
    solver = solver.for_state(state)
    settings, n = entry_of(solver).settings(solver), state.bodies.count
    state = state.replace(contacts=state.contacts._replace(normal_start=normal_start, tangent_start=tangent_start))
    friction = None if leaves_tangents_out(state, solver) else state.world.friction
    rows, solver_bodies, *_ = started(problem or step_problem(state), state.contacts, friction)
    # Relaxation scales effective masses in place.
    rows, solver_bodies, theta = rows._replace(data=rows.data.copy()), solver_bodies.copy(), np.empty(solver.sweeps)
    sweeps = solve_velocities(rows, friction, settings, solver_bodies, theta)
    impulse = rows.impulse
    return ContactSolution(
        normal_impulses=impulse[:, NORMAL].copy(),
        tangent_impulses=impulse[:, TANGENT].copy() if friction is not None else np.zeros(len(impulse)),
        velocities=solver_bodies[:n, : V_Y + 1].copy(),
        angular_velocities=solver_bodies[:n, V_S] / state.bodies.radius,
        record=convergence_record(theta[:sweeps], solver, len(impulse)),
    )
