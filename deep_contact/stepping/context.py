"""Define the input, the memory and the context of steps: the arguments of `algorithm.advance`.

Solvers with a step of their own replace `algorithm.advance` by a function with the same arguments.

Tests: tests/behaviour/test_scene_requirements.py
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.compiled.structures import Structure, StructureType, define
from deep_contact.state.arrays import Bodies, Contacts
from deep_contact.state.scales import ContactScales
from deep_contact.stepping.broad_phase import Cells, make_cells
from deep_contact.stepping.contacts import Walls, make_contacts
from deep_contact.stepping.pairs import PairTable, Rough
from deep_contact.stepping.position_correction import CorrectionWorkspace, make_correction_workspace
from deep_contact.stepping.rows import Rows, make_rows
from deep_contact.stepping.segment_grid import NO_SEGMENTS, Segments, moved_segments


class Motion(NamedTuple):
    """Parameters of the division of a solver's substep into equal parts, if circles are about to collide."""

    most: int  # largest number of parts of a solver's substep, a power of two; 1: no division
    reach: float  # largest displacement, in one part, of a circle that is about to hit something, m


class Actuation(NamedTuple):
    """Velocities of segments, and external forces on circles.

    Only scenes with moving segments, fixed circles or external forces have an actuation.
    """

    wall: np.ndarray  # (S, 4): velocities (v_x, v_y, v_x, v_y) of the two ends of each of S segments, m/s
    moving: np.ndarray  # (k,): indices of the moving segments
    force: np.ndarray  # (n, 2): external force on each circle, without gravity, N
    torque: np.ndarray  # (n,): external torque on each circle, N·m


class StepInput(NamedTuple):
    """Input of steps.

    Numba compiles no code for a field that is None, because None has a type of its own. segments, restitution and
    motion are None if the scene needs none of the three; otherwise none of them is None (`with_optional`). If actuation
    is not None, they are not None either.

    Contacts store the impulses of a whole step, however many substeps it has. The solve of a substep starts from these
    impulses divided by the number of substeps.
    """

    bodies: Bodies  # the steps move them in place; without the array of materials
    box: tuple  # (x_min, y_min, x_max, y_max), m
    segments: Segments | None
    gravity: tuple  # (g_x, g_y), m/s²
    friction: float | PairTable | Rough | None  # μ, and ρ; None in place of 0 leaves the tangent rows out
    restitution: float | PairTable | None  # e
    dt: float  # Δt of a substep, s
    substeps: int  # number of substeps of a step: the solver's number times the number of parts by motion
    scales: ContactScales  # scales of the state from which the steps start
    motion: Motion | None = None
    actuation: Actuation | None = None  # if it moves segments, `segments.line` is a copy, which moves in place
    touches: PairTable | None = None  # whether pairs have contacts; None if all have


def with_optional(step: StepInput) -> StepInput:
    """Return the input in the form that makes Numba compile all optional features.

    These are segments, restitution, division by motion and continuous collision. A feature that the scene does not need
    gets a value without effect in place of None.
    """
    return step._replace(
        segments=NO_SEGMENTS if step.segments is None else step.segments,
        restitution=0.0 if step.restitution is None else step.restitution,
        motion=Motion(1, 0.0) if step.motion is None else step.motion,
    )


class StepOptions(NamedTuple):
    """Options of the solver, and of the start of each step."""

    settings: NamedTuple  # settings of the solver (`stepping.interface`); their type selects its loop of sweeps
    position_sweeps: int  # largest number of sweeps of position correction
    carry: bool  # whether steps after the first start from the impulses of the step before; otherwise they start from 0


class StepMemory(NamedTuple):
    """Work arrays of steps for n circles. Their content before a call changes no bit of the result."""

    solver_bodies: np.ndarray  # (n + 4, 4): velocities and inverse masses of circles and walls (`rows.V_X`)
    theta: np.ndarray  # (largest number of sweeps,): θ of each sweep of a solve, N·s
    rows: Rows
    correction: CorrectionWorkspace
    cells: Cells
    contacts: tuple[Contacts, Contacts]  # two buffers, which the substeps fill in turn
    workspace: object = None  # work arrays of the solver (`interface.make_workspace`)
    is_built: bool = False  # whether solver bodies and rows of a single step are filled already (`problem`)


class _StepContextType(StructureType):
    """Numba's type of a `StepContext`."""


class StepContext(Structure):
    """What the phases of a step read, and what they replace in place. A substep is one of the equal parts of a step.

    | field         | meaning                                                                            | changes |
    |---------------|------------------------------------------------------------------------------------|---------|
    | step          | `StepInput` of a substep of the solver                                             | no      |
    | options       | `StepOptions`                                                                      | no      |
    | memory        | `StepMemory`                                                                       | no      |
    | substep       | `StepInput` of the next substep, after division by motion, with moved segments     | yes     |
    | contacts      | `Contacts` at the present positions of the circles                                 | yes     |
    | pair_impulses | array described in `StepLog.pair_impulses`                                         | yes     |
    | row           | index of the step in the arrays of the `StepLog`                                   | yes     |
    | buffer        | index of the array in `StepMemory.contacts` in which the contacts lie, 0 or 1      | yes     |
    | is_inside     | whether the contacts lie in that array; otherwise in a larger one or the caller's   | yes     |
    """


_FIELDS = "step", "options", "memory", "substep", "contacts", "pair_impulses", "row", "buffer", "is_inside"
define(StepContext, _StepContextType, _FIELDS)


@njit(cache=True)
def make_context(step, options, memory, contacts, log):
    """Return the `StepContext` of steps that start from these `Contacts`. log: `StepLog`."""
    return StepContext(step, options, memory, step, contacts, log.pair_impulses, 0, 0, False)


@njit(inline="always")
def begin_steps(context, contacts, log, actuation):
    """Prepare a context, in place, for steps that start from these contacts.

    log: `StepLog`. actuation: `Actuation` of the steps, or None.
    """
    context.contacts, context.pair_impulses, context.buffer = contacts, log.pair_impulses, 0
    context.is_inside = False
    if actuation is not None:
        segments = moved_segments(context.step.segments, actuation, 0.0)
        context.substep = substep_of(context.step, segments)


@njit(inline="always")
def follow(context, following, buffer):
    """Replace the contacts of a context, in place. buffer: `Contacts` that may contain the arrays of `following`."""
    context.contacts = following
    context.is_inside = following.body_a.ctypes.data == buffer.body_a.ctypes.data


@njit(inline="always")
def results_of(context):
    """Return the results of steps: (number of contacts, or −1 if `contacts_of_context` returns them; pair_impulses).

    To hand over the nine arrays of the contacts as objects of Python takes as long as a step of ten circles.
    """
    m = context.contacts.body_a.shape[0]
    return m if context.is_inside else -1, context.pair_impulses


@njit(cache=True)
def contacts_of_context(context):
    """Return the `Contacts` of a context."""
    return context.contacts


def make_memory(n: int, capacity: int, sweeps: int, friction) -> StepMemory:
    """Return a `StepMemory` for n circles and `capacity` contacts.

    A step with more contacts allocates arrays of its own. sweeps: largest number of sweeps of a solve. friction: as in
    `StepInput`; None for rows without tangents.
    """
    return StepMemory(
        np.empty((n + 4, 4)), np.empty(sweeps), make_rows(capacity, friction),
        make_correction_workspace(n, capacity), make_cells(n), (make_contacts(capacity), make_contacts(capacity)),
    )  # fmt: skip


@njit(inline="always")
def walls_of(step):
    """Return the `Walls` of a step: its box, and the skin at which circles touch walls. step: `StepInput`."""
    return Walls(step.box, step.scales.wall_skin)


@njit(cache=True, error_model="numpy")
def substep_of(step, segments, substeps=1):
    """Return the input of one of `substeps` equal substeps of a step.

    step: `StepInput` of the step. segments: `Segments` at the start of the substep.
    """
    return StepInput(
        step.bodies, step.box, segments, step.gravity, step.friction, step.restitution, step.dt / substeps,
        step.substeps * substeps, step.scales, step.motion, step.actuation, step.touches,
    )  # fmt: skip


@njit(cache=True)
def set_segments(context, segments):
    """Replace the segments of `StepContext.substep`, in place. segments: the new `Segments`."""
    context.substep = substep_of(context.substep, segments)
