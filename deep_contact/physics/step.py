"""What a step reads and where it works: the arguments of `engine.advance` and of the steps that stand in for it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.physics.collision import Cells, make_cells, make_contacts
from deep_contact.physics.contact_solver import Rows, make_rows
from deep_contact.physics.position_correction import CorrectionRoom, make_correction_room
from deep_contact.physics.segments import NO_SEGMENTS, Segments
from deep_contact.state import Bodies, Contacts
from deep_contact.state.scales import ContactScales


class Motion(NamedTuple):
    """How substeps are divided further by motion (`substeps`)."""

    most: int  # parts of a substep, a power of two; 1: never
    reach: float  # m


class StepInput(NamedTuple):
    """What the steps read. None is a type of its own: what nothing in the scene requires is not compiled.

    segments, restitution and motion are None where all of them are idle: see `with_rare`. Contacts carry the impulses
    of a whole step, whatever it is divided into; a solve starts from 1 / parts of them.
    """

    bodies: Bodies  # they move in place
    box: tuple  # of the `World`, as gravity, friction and restitution
    segments: Segments | None
    gravity: tuple
    friction: float | None  # None, in place of 0, leaves the tangent rows out
    restitution: float | None
    dt: float  # of a part, s
    parts: int  # of a step
    scales: ContactScales  # of the state that the steps begin with
    motion: Motion | None = None


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
    workspace: tuple | None = None  # what the solver remembers (`registry.make_workspace`)
    is_built: bool = False  # whether solver bodies and rows are those of the one step to come (`engine.StepProblem`)


def make_memory(n: int, capacity: int, sweeps: int, friction) -> StepMemory:
    """Memory of steps of n circles, with room for so many contacts; where there are more, single steps take their own.

    sweeps: the most of a step. friction: None for rows without tangents.
    """
    return StepMemory(
        np.empty((n + 4, 4)), np.empty(sweeps), make_rows(capacity, friction),
        make_correction_room(n, capacity), make_cells(n), (make_contacts(capacity), make_contacts(capacity)),
    )  # fmt: skip


DONE, WORK, LAST_SWEEPS = range(3)
"""Elements of `StepLog.progress`: substeps done; the work, in relaxations, after which a call ends; sweeps of the last
part."""


BESIDE_SWEEPS = 20
"""Work of a part beside its sweeps, in relaxations a contact."""


class StepLog(NamedTuple):
    """What the steps log, (steps,) each. Of a divided step: contacts and θ of the last part, sums of the others."""

    contacts: np.ndarray
    sweeps: np.ndarray
    theta: np.ndarray  # the last, N·s
    relaxations: np.ndarray
    parts: np.ndarray  # of a step
    progress: np.ndarray  # (3,): `DONE`, `WORK`, `LAST_SWEEPS`
    loads: np.ndarray  # (4 + S, 2): the sum of all that walls and segments received, N·s; (0, 2) where nobody asks


def make_log(steps: int, loads: int = 0) -> StepLog:
    """A log for so many steps, which one call may do all. loads: walls and segments, or 0."""
    columns = (np.zeros(steps, kind) for kind in (np.int64, np.int64, np.float64, np.int64, np.int64))
    return StepLog(*columns, np.array([0, np.iinfo(np.int64).max, 0]), np.zeros((loads, 2)))


def some_steps(log: StepLog, first: int, count: int, work: int) -> StepLog:
    """The rows of a log from `first` on, as views, for a call that ends after so much work."""
    return StepLog(*(column[first : first + count] for column in log[:5]), np.array([0, work, 0]), log.loads)


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


@njit(cache=True)
def add_loads(log, contacts, n, share):
    """Add what walls and segments received of this share of a step to the log, in place. n: circles."""
    for i in range(contacts.body_a.shape[0] if log.loads.shape[0] > 0 else 0):
        wall, p_n, p_t = contacts.body_b[i] - n, contacts.normal_impulse[i], contacts.tangent_impulse[i]
        if wall >= 0:
            log.loads[wall, 0] += share * (p_n * contacts.normal[i, 0] + p_t * contacts.normal[i, 1])
            log.loads[wall, 1] += share * (p_n * contacts.normal[i, 1] - p_t * contacts.normal[i, 0])
