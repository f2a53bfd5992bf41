"""Input, memory and log of steps: the arguments of `algorithm.advance`, and of the functions that replace it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.compiled.structures import Structure, StructureType, define
from deep_contact.state.arrays import Bodies, Contacts
from deep_contact.state.scales import ContactScales
from deep_contact.stepping.broad_phase import Cells, make_cells
from deep_contact.stepping.contacts import Walls, make_contacts
from deep_contact.stepping.position_correction import CorrectionWorkspace, make_correction_workspace
from deep_contact.stepping.rows import Rows, make_rows
from deep_contact.stepping.segment_grid import NO_SEGMENTS, Segments, moved_segments


class Motion(NamedTuple):
    """Parameters of the division of substeps by motion (`substeps`)."""

    most: int  # largest number of parts of a solver's substep, a power of two; 1: no division
    reach: float  # largest displacement in a part of a circle that is about to hit something, m


class Actuation(NamedTuple):
    """Kinematics and external force in scenes with moving segments, fixed circles or pushes."""

    wall: np.ndarray  # (S, 4): velocities of the ends of the segments, m/s
    moving: np.ndarray  # (k,): indices of the moving segments
    force: np.ndarray  # (n, 2): external force on each circle beside gravity, N
    torque: np.ndarray  # (n,): external torque on each circle, N·m


class StepInput(NamedTuple):
    """Input of steps. The code for a field that is None is not compiled, since None is a type of its own.

    segments, restitution and motion are None if the scene needs none of the three (`with_optional`); with actuation
    none of them is None. Contacts carry the impulses of a whole step, into however many substeps it is divided; the
    solve of a substep starts from these impulses divided by the number of substeps.
    """

    bodies: Bodies  # moved in place
    box: tuple  # of the `World`, as gravity, friction and restitution
    segments: Segments | None
    gravity: tuple
    friction: float | None  # None, in place of 0, leaves the tangent rows out
    restitution: float | None
    dt: float  # Δt of a substep, s
    substeps: int  # number of substeps of a step: that of the solver, times the factor of motion
    scales: ContactScales  # of the state that the steps begin with
    motion: Motion | None = None
    actuation: Actuation | None = None  # lines of segments that it moves are copies for these steps, and move in place


def with_optional(step: StepInput) -> StepInput:
    """The input with all optional features: segments, restitution, division by motion and continuous collision."""
    return step._replace(
        segments=NO_SEGMENTS if step.segments is None else step.segments,
        restitution=0.0 if step.restitution is None else step.restitution,
        motion=Motion(1, 0.0) if step.motion is None else step.motion,
    )


class StepOptions(NamedTuple):
    """Options of the solver and of the start of each step."""

    settings: NamedTuple  # of the solver (`stepping.interface`); their type picks the loop
    position_sweeps: int  # largest number of sweeps of position correction
    carry: bool  # start the steps after the first from the impulses of the step before; otherwise from zero


class StepMemory(NamedTuple):
    """Work arrays of the steps. Their content before a call changes no bit of the result."""

    solver_bodies: np.ndarray  # (n + 4, 4); each step fills them (`motion.integrate_velocities`)
    theta: np.ndarray  # buffer for the θ of one step's sweeps; its length is the largest number of sweeps
    rows: Rows
    correction: CorrectionWorkspace
    cells: Cells
    contacts: tuple[Contacts, Contacts]  # two buffers, which the steps fill in turn
    workspace: object = None  # of the solver (`interface.make_workspace`)
    is_built: bool = False  # whether solver bodies and rows of the only step are filled already (`problem.StepProblem`)


class _StepContextType(StructureType):
    """Numba's type of a `StepContext`."""


class StepContext(Structure):
    """What the phases of a step read, and the fields that they replace in place.

    | field         | meaning                                                                         | changes |
    |---------------|---------------------------------------------------------------------------------|---------|
    | step          | `StepInput` of the solver's substep                                             | no      |
    | options       | `StepOptions`                                                                   | no      |
    | memory        | `StepMemory`                                                                    | no      |
    | substep       | `StepInput` of the next substep: divided by motion, with its segments in place  | yes     |
    | contacts      | `Contacts` at the positions of the circles                                      | yes     |
    | pair_impulses | see `StepLog.pair_impulses`                                                     | yes     |
    | row           | row of the log in which the step is logged                                      | yes     |
    | buffer        | index of the buffer of `StepMemory.contacts` that holds the contacts, 0 or 1    | yes     |
    """


_FIELDS = "step", "options", "memory", "substep", "contacts", "pair_impulses", "row", "buffer"
define(StepContext, _StepContextType, _FIELDS)


@njit(cache=True)
def make_context(step, options, memory, contacts, log):
    """The `StepContext` of steps that start from these contacts. log: `StepLog`."""
    return StepContext(step, options, memory, step, contacts, log.pair_impulses, 0, 0)


@njit(inline="always")
def begin_steps(context, contacts, log, actuation):
    """Prepare a context, in place, for steps that start from these contacts."""
    context.contacts, context.pair_impulses, context.buffer = contacts, log.pair_impulses, 0
    if actuation is not None:
        segments = moved_segments(context.step.segments, actuation, 0.0)
        context.substep = substep_of(context.step, segments)


def make_memory(n: int, capacity: int, sweeps: int, friction) -> StepMemory:
    """A `StepMemory` for n circles and `capacity` contacts. A step with more contacts allocates arrays of its own.

    sweeps: largest number of sweeps of a solve. friction: None for rows without tangents.
    """
    return StepMemory(
        np.empty((n + 4, 4)), np.empty(sweeps), make_rows(capacity, friction),
        make_correction_workspace(n, capacity), make_cells(n), (make_contacts(capacity), make_contacts(capacity)),
    )  # fmt: skip


@njit(inline="always")
def walls_of(step):
    """The `Walls` of a step: its box with the skin in which a contact begins."""
    return Walls(step.box, step.scales.wall_skin)


@njit(cache=True, error_model="numpy")
def substep_of(step, segments, substeps=1):
    """The input of one of several equal substeps of a step. step: `StepInput`. segments: at the substep's start."""
    return StepInput(
        step.bodies, step.box, segments, step.gravity, step.friction, step.restitution, step.dt / substeps,
        step.substeps * substeps, step.scales, step.motion, step.actuation,
    )  # fmt: skip


@njit(cache=True)
def place_segments(context, segments):
    """Replace the segments of the substep, in place."""
    context.substep = substep_of(context.substep, segments)
