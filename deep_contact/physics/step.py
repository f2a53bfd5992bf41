"""What a step reads and where it works: the arguments of `engine.advance` and of the steps that stand in for it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.compiled.structures import Structure, StructureType, define
from deep_contact.physics.collision import Cells, make_cells, make_contacts
from deep_contact.physics.contact_solver import Rows, make_rows
from deep_contact.physics.position_correction import CorrectionRoom, make_correction_room
from deep_contact.physics.segments import NO_SEGMENTS, Segments, moves, wall_velocity
from deep_contact.state.arrays import Bodies, Contacts
from deep_contact.state.scales import ContactScales


class Motion(NamedTuple):
    """How substeps are divided further by motion (`substeps`)."""

    most: int  # parts of a substep, a power of two; 1: never
    reach: float  # m


class Drive(NamedTuple):
    """What is moved and pushed from outside, in scenes that have moving segments, fixed circles or pushes."""

    wall: np.ndarray  # (S, 4): velocities of the ends of the segments, m/s
    moving: np.ndarray  # (k,): the segments that move
    force: np.ndarray  # (n, 2): on the circles beside gravity, N
    torque: np.ndarray  # (n,): likewise, N·m


class StepInput(NamedTuple):
    """What the steps read. None is a type of its own: what nothing in the scene requires is not compiled.

    segments, restitution and motion are None where all of them are idle: see `with_rare`. With a drive none is.
    Contacts carry the impulses of a whole step, whatever it is divided into; a solve starts from 1 / parts of them.
    """

    bodies: Bodies  # they move in place
    box: tuple  # of the `World`, as gravity, friction and restitution
    segments: Segments | None
    gravity: tuple
    friction: float | None  # None, in place of 0, leaves the tangent rows out
    restitution: float | None
    dt: float  # of a part, s: what is solved at once
    parts: int  # of a step: substeps, times those into which motion divides each
    scales: ContactScales  # of the state that the steps begin with
    motion: Motion | None = None
    drive: Drive | None = None  # its segments are the step's own: their lines move in place


def with_rare(step: StepInput) -> StepInput:
    """The input of steps that know all that is rare: segments, restitution, motion and fast circles."""
    return step._replace(
        segments=NO_SEGMENTS if step.segments is None else step.segments,
        restitution=0.0 if step.restitution is None else step.restitution,
        motion=Motion(1, 0.0) if step.motion is None else step.motion,
    )


class StepOptions(NamedTuple):
    """How the steps solve."""

    settings: NamedTuple  # of the solver (`solvers.registry`); their type picks the loop
    position_sweeps: int  # most sweeps of position correction
    carry: bool  # start the steps after the first from the impulses of the step before; otherwise from zero


class StepMemory(NamedTuple):
    """Where the steps work. What it holds from one call to the next changes no bit of what they compute."""

    solver_bodies: np.ndarray  # (n + 4, 4); each step fills them (`contact_solver.integrate_velocities`)
    theta: np.ndarray  # buffer for the θ of one step's sweeps; its length is the largest number of sweeps
    rows: Rows
    correction: CorrectionRoom
    cells: Cells
    contacts: tuple[Contacts, Contacts]  # two buffers, which the steps fill by turns
    workspace: object = None  # what the solver remembers (`registry.make_workspace`)
    is_built: bool = False  # whether solver bodies and rows are those of the one step to come (`engine.StepProblem`)


class _StepSetupType(StructureType):
    """Numba's type of a `StepSetup`."""


class StepSetup(Structure):
    """A `StepInput`, `StepOptions` and a `StepMemory`: the arguments that are the same in many calls."""


define(StepSetup, _StepSetupType, ("step", "options", "memory"))


@njit(cache=True)
def make_setup(step, options, memory):
    """A `StepSetup` of these."""
    return StepSetup(step, options, memory)


def make_memory(n: int, capacity: int, sweeps: int, friction) -> StepMemory:
    """Memory of steps of n circles, with room for so many contacts; where there are more, single steps take their own.

    sweeps: the most of a step. friction: None for rows without tangents.
    """
    return StepMemory(
        np.empty((n + 4, 4)), np.empty(sweeps), make_rows(capacity, friction),
        make_correction_room(n, capacity), make_cells(n), (make_contacts(capacity), make_contacts(capacity)),
    )  # fmt: skip


DONE, WORK, LAST_SWEEPS, WATCHED, FINITE, PASSED = range(6)
"""Elements of `StepLog.progress`: substeps done; the work, in relaxations, after which a call ends; sweeps of the last
part; whether the call is one step whose impulses are logged in `StepLog.received`; whether all positions are finite;
1 + the circle over which a moving segment has passed last, or 0."""

PAIR, X, Y, N_X, N_Y, SEPARATION, P_X, P_Y = range(8)
"""Columns of `StepLog.received`: the two bodies as one number (`pair_of`); the place, m, normal and separation, m, with
which the contact came; the impulse on its second body, N·s."""

MOST_BODIES = 2**26
"""Walls and segments included: a pair of so many is one number that float64 holds exactly."""

BESIDE_SWEEPS = 20
"""Work of a part beside its sweeps, in relaxations a contact."""


class StepLog(NamedTuple):
    """What the steps log, (steps,) each. Of a divided step: contacts and θ of the last part, sums of the others."""

    contacts: np.ndarray
    sweeps: np.ndarray
    theta: np.ndarray  # the last, N·s
    relaxations: np.ndarray
    parts: np.ndarray  # of a step
    progress: np.ndarray  # (6,): `DONE`, `WORK`, `LAST_SWEEPS`, `WATCHED`, `FINITE`, `PASSED`
    loads: np.ndarray  # (4 + S, 2): the sum of all that walls and segments received, N·s; (0, 2) where nobody asks
    received: np.ndarray  # (k, 8): what pairs received in a step that is watched, sorted by `PAIR`: rebounds and solves
    on_circles: np.ndarray  # (n, 2): the sum of what contacts gave to the circles, N·s; (0, 2) where nobody asks
    work: np.ndarray  # (1,): the sum of what moving segments, fixed circles and pushes did, J
    shifts: np.ndarray  # (n, 2): the sum of what gravity and pushes gave beside m g Δt, N·s; (0, 2) where nobody asks


def make_log(steps: int, loads: int = 0, circles: int = 0, shifts: int = 0) -> StepLog:
    """A log for so many steps, which one call may do all.

    loads: walls and segments, or 0. circles, shifts: of whose contacts and flights the sums are asked, or 0.
    """
    columns = (np.zeros(steps, kind) for kind in (np.int64, np.int64, np.float64, np.int64, np.int64))
    progress = np.array([0, 2**63 - 1, 0, 0, 1, 0])  # with no bound on the work
    sums = np.zeros((loads, 2)), np.zeros((0, 8)), np.zeros((circles, 2)), np.zeros(1), np.zeros((shifts, 2))
    return StepLog(*columns, progress, *sums)


def some_steps(log: StepLog, first: int, count: int, work: int, is_watched: bool) -> StepLog:
    """The rows of a log from `first` on, as views, for a call that ends after so much work."""
    progress = np.array([0, work, 0, is_watched, 1, 0])
    return StepLog(*(column[first : first + count] for column in log[:5]), progress, *log[6:])


@njit(cache=True)
def log_part(log, k, contacts, sweeps, theta, relaxations):
    """Add a part of the k-th step to the log, in place."""
    log.contacts[k] = contacts
    log.sweeps[k] += sweeps
    log.theta[k] = theta[sweeps - 1] if sweeps > 0 else np.inf
    log.relaxations[k] += relaxations
    log.parts[k] += 1
    log.progress[WORK] -= relaxations + BESIDE_SWEEPS * contacts
    log.progress[LAST_SWEEPS] = sweeps


@njit(cache=True, error_model="numpy")
def part_of(step, segments, parts=1):
    """The input of one of several equal parts of a step. step: `StepInput`. segments: those of the part."""
    return StepInput(
        step.bodies, step.box, segments, step.gravity, step.friction, step.restitution, step.dt / parts,
        step.parts * parts, step.scales, step.motion, step.drive,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def log_work(step, contacts, solver_bodies, log):
    """Log the work of a part that has a drive: that of its solved impulses, and that of pushes.

    A push works on the mean of the velocities before and after the part.
    """
    bodies, drive, of_pushes = step.bodies, step.drive, 0.0
    for i in range(bodies.mass.shape[0]):
        if bodies.mass[i] < np.inf:
            v_x, v_y = bodies.velocity[i, 0] + solver_bodies[i, 0], bodies.velocity[i, 1] + solver_bodies[i, 1]
            turn = bodies.spin[i] + solver_bodies[i, 2] / bodies.radius[i]
            of_pushes += drive.force[i, 0] * v_x + drive.force[i, 1] * v_y + drive.torque[i] * turn
    log.work[0] += work_on(step, contacts, impulses_of(contacts, 1.0 / step.parts)) + 0.5 * step.dt * of_pushes


@njit(cache=True, error_model="numpy")
def work_on(step, contacts, impulse):
    """The work of moving segments and fixed circles, by the impulses on second bodies, (m, 2), N·s, in J.

    Without that of surfaces that move (`World.surface_speeds`). contacts: at the positions of the circles.
    """
    bodies, drive, work = step.bodies, step.drive, 0.0
    n = bodies.mass.shape[0]
    for i in range(impulse.shape[0]):
        a, b, x, y = contacts.body_a[i], contacts.body_b[i], contacts.position[i, 0], contacts.position[i, 1]
        v_x, v_y, sign = 0.0, 0.0, -1.0
        if b >= n:
            if b >= n + 4 and moves(drive.wall, b - n - 4):
                v_x, v_y = wall_velocity(step.segments.line, drive.wall, b - n - 4, x, y)
        else:
            fixed = b
            if bodies.mass[a] == np.inf:
                fixed, sign = a, 1.0
            if bodies.mass[fixed] == np.inf:
                v_x = bodies.velocity[fixed, 0] - bodies.spin[fixed] * (y - bodies.position[fixed, 1])
                v_y = bodies.velocity[fixed, 1] + bodies.spin[fixed] * (x - bodies.position[fixed, 0])
        work += sign * (impulse[i, 0] * v_x + impulse[i, 1] * v_y)
    return work


@njit(cache=True)
def is_asked(log):
    """Whether a log takes impulses."""
    return log.loads.shape[0] > 0 or log.on_circles.shape[0] > 0 or log.progress[WATCHED] != 0


@njit(cache=True)
def impulses_of(contacts, share):
    """A share of the impulses of contacts on their second bodies, (m, 2), N·s."""
    impulse = np.empty((contacts.body_a.shape[0], 2))
    for i in range(impulse.shape[0]):
        p_n, p_t = share * contacts.normal_impulse[i], share * contacts.tangent_impulse[i]
        impulse[i, 0] = p_n * contacts.normal[i, 0] + p_t * contacts.normal[i, 1]
        impulse[i, 1] = p_n * contacts.normal[i, 1] - p_t * contacts.normal[i, 0]
    return impulse


@njit(cache=True)
def log_impulses(log, received, contacts, impulse, n):
    """Log impulses on the second bodies of contacts, (m, 2), N·s: the loads in place. Returns `StepLog.received`.

    n: circles.
    """
    m, j = impulse.shape[0], 0
    for i in range(m if log.loads.shape[0] > 0 else 0):
        wall = contacts.body_b[i] - n
        if wall >= 0:
            log.loads[wall, 0] += impulse[i, 0]
            log.loads[wall, 1] += impulse[i, 1]
    for i in range(m if log.on_circles.shape[0] > 0 else 0):
        a, b = contacts.body_a[i], contacts.body_b[i]
        for axis in range(2):
            log.on_circles[a, axis] -= impulse[i, axis]
            if b < n:
                log.on_circles[b, axis] += impulse[i, axis]
    if m == 0 or log.progress[WATCHED] == 0:
        return received
    received = with_pairs(received, contacts)
    for i in range(m):
        while received[j, PAIR] < pair_of(contacts, i):
            j += 1
        received[j, P_X] += impulse[i, 0]
        received[j, P_Y] += impulse[i, 1]
    return received


@njit(cache=True)
def with_pairs(received, contacts):
    """`StepLog.received` with the pairs of these contacts, sorted as they are; itself where it has them all."""
    k, m, new, j = received.shape[0], contacts.body_a.shape[0], 0, 0
    for i in range(m):
        while j < k and received[j, PAIR] < pair_of(contacts, i):
            j += 1
        new += j == k or received[j, PAIR] > pair_of(contacts, i)
    if new == 0:
        return received
    merged, i, j = np.zeros((k + new, 8)), 0, 0
    for row in range(k + new):
        if j < k and (i == m or received[j, PAIR] <= pair_of(contacts, i)):
            i += i < m and received[j, PAIR] == pair_of(contacts, i)
            for column in range(8):  # an assignment of rows brings 37 functions along, for the text of its error
                merged[row, column] = received[j, column]
            j += 1
        else:
            merged[row, PAIR], merged[row, SEPARATION] = pair_of(contacts, i), contacts.separation[i]
            merged[row, X], merged[row, Y] = contacts.position[i, 0], contacts.position[i, 1]
            merged[row, N_X], merged[row, N_Y] = contacts.normal[i, 0], contacts.normal[i, 1]
            i += 1
    return merged


@njit(inline="always")
def pair_of(contacts, i):
    """The two bodies of the i-th contact as one number, in the order of contacts."""
    return contacts.body_a[i] * MOST_BODIES + contacts.body_b[i]


def of_whole_step(contacts: Contacts, received: np.ndarray) -> Contacts:
    """The contacts of a step and those that came during it, with all that they gave in it.

    contacts: at its begin. received: of `StepLog`.
    """
    pair, x, y, n_x, n_y, separation, p_x, p_y = received.T
    starts = np.zeros((2, len(pair)))
    starts[:, np.searchsorted(pair, contacts.body_a * MOST_BODIES + contacts.body_b)] = contacts[7:]
    impulses = np.maximum(p_x * n_x + p_y * n_y, 0.0), p_x * n_y - p_y * n_x
    places = np.column_stack([x, y]), np.column_stack([n_x, n_y]), separation.copy()
    return Contacts(*np.divmod(pair.astype(np.int64), MOST_BODIES), *places, *impulses, *starts)
