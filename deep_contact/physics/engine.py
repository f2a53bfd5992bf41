"""The engine: what a step does.

`advance` is the algorithm; the conduct is that of Box2D 2.3 for circles, without continuous collision, and with
sleeping only where it is asked for (`sleeping`). `deep_contact.simulation` is its validated face.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.constants import MAX_ROTATION, MAX_TRANSLATION
from deep_contact.physics.collision import (
    find_contacts,
    make_cells,
    make_contacts,
    next_contacts,
    own_contacts,
)
from deep_contact.physics.contact_solver import (
    apply_impulses,
    contact_rows,
    correct_positions,
    integrate_velocities,
    make_rows,
    store_impulses,
)
from deep_contact.physics.convergence import ConvergenceRecord, convergence_record
from deep_contact.physics.methods import PRECISIONS, BatchedPGS, SoftSteps
from deep_contact.physics.relaxation import WITHOUT_TANGENTS, make_scratch, relax, settings_of
from deep_contact.state import LIMITS, Bodies, Contacts, State

_POSITION, _VELOCITY, _SPIN, _MASS, _RADIUS = (
    LIMITS[f"bodies.{name}"][:2] for name in ("position", "velocity", "spin", "mass", "radius")
)
_SEPARATION, _IMPULSE = LIMITS["contacts.separation"][:2], LIMITS["contacts.normal_start"][:2]


@njit(cache=True, error_model="numpy")
def advance(bodies, contacts, world, dt, settings, position_sweeps, warm, steps, moving, theta, log):
    """Do `steps` steps: the bodies move in place. Returns the last solved contacts and those found after them.

    bodies: `Bodies`. contacts: `Contacts` at their positions, with the impulses to start from.
    world: (box, gravity, friction, restitution); friction None, instead of 0, leaves the tangent rows out.
    dt: s. settings: of `relaxation`; their type is the method.
    warm: start the steps after the first from the impulses carried over; otherwise from zero.
    moving: room for the velocities in the sweeps, (n + 4, 4), in their precision.
    theta: room for the θ of the sweeps of one step, which is also how many there may be.
    log: (steps, 4), filled with the number of contacts, of sweeps, the last θ, and the relaxations of each step.
    """
    box, gravity, friction, restitution = world
    n = bodies.mass.shape[0]
    cells = make_cells(n)
    room, spare = make_contacts(4 * n + 64), make_contacts(4 * n + 64)
    rows_room = make_rows(4 * n + 64, moving.dtype, friction)
    scratch = make_scratch(settings, rows_room, moving)
    solved = contacts
    for k in range(steps):
        integrate_velocities(bodies, gravity, dt, moving)
        rows, rows_room = contact_rows(bodies, contacts, moving, restitution, rows_room, friction)
        apply_impulses(rows, moving, friction)
        sweeps, relaxations = relax(settings, rows, friction, moving, theta, scratch)
        store_impulses(rows, contacts)
        integrate_positions(bodies, moving, dt)
        correct_positions(bodies, contacts, box, position_sweeps)

        solved = contacts
        contacts, spare = next_contacts(bodies, box, cells, solved, warm, spare)
        room, spare = spare, room

        log[k, 0] = solved.body_a.shape[0]
        log[k, 1] = sweeps
        log[k, 2] = theta[sweeps - 1] if sweeps > 0 else np.inf
        log[k, 3] = relaxations
    return own_contacts(solved), own_contacts(contacts)


@njit(cache=True, error_model="numpy")
def integrate_positions(bodies, moving, dt):
    """Give the bodies, in place, the solved velocities, and move them by those for Δt (symplectic Euler).

    A displacement is cut to `MAX_TRANSLATION`, a rotation to `MAX_ROTATION`, and the velocity with it, as in Box2D.
    """
    for i in range(bodies.mass.shape[0]):
        v_x, v_y = moving[i, 0], moving[i, 1]
        spin = moving[i, 2] / bodies.radius[i]
        distance = dt * math.sqrt(v_x * v_x + v_y * v_y)
        if distance > MAX_TRANSLATION:
            v_x *= MAX_TRANSLATION / distance
            v_y *= MAX_TRANSLATION / distance
        if abs(dt * spin) > MAX_ROTATION:
            spin *= MAX_ROTATION / abs(dt * spin)
        bodies.velocity[i, 0] = v_x
        bodies.velocity[i, 1] = v_y
        bodies.spin[i] = spin
        bodies.position[i, 0] += dt * v_x
        bodies.position[i, 1] += dt * v_y
        bodies.angle[i] += dt * spin


@njit(cache=True, error_model="numpy")
def solve_velocities(bodies, contacts, world, dt, settings, moving, theta):
    """The velocity part of a step alone; fills moving and theta. Returns (impulses, number of sweeps): of `Rows`."""
    _, gravity, friction, restitution = world
    integrate_velocities(bodies, gravity, dt, moving)
    room = make_rows(contacts.body_a.shape[0], moving.dtype, friction)
    rows, _ = contact_rows(bodies, contacts, moving, restitution, room, friction)
    apply_impulses(rows, moving, friction)
    sweeps, _ = relax(settings, rows, friction, moving, theta, make_scratch(settings, rows, moving))
    return rows.impulse, sweeps


@njit(cache=True)
def is_sound(bodies, contacts):
    """Whether arrays of the right kind also hold what `check_state` and `check_limits` ask for: without the message."""
    n = bodies.mass.shape[0]
    for values, limits in ((bodies.position, _POSITION), (bodies.velocity, _VELOCITY)):
        if values.shape[0] != n or values.shape[1] != 2 or not _within(values, limits):
            return False
    for values, limits in ((bodies.spin, _SPIN), (bodies.mass, _MASS), (bodies.radius, _RADIUS)):
        if values.shape[0] != n or not _within(values, limits):
            return False
    if bodies.angle.shape[0] != n or not np.isfinite(bodies.angle).all():
        return False
    m = contacts.body_a.shape[0]
    for values in (contacts.position, contacts.normal):
        if values.shape[0] != m or values.shape[1] != 2 or not np.isfinite(values).all():
            return False
    if contacts.separation.shape[0] != m or not _within(contacts.separation, _SEPARATION):
        return False
    for values in (
        contacts.normal_impulse,
        contacts.tangent_impulse,
        contacts.normal_start,
        contacts.tangent_start,
    ):
        if values.shape[0] != m or not _within(values, _IMPULSE):
            return False
    if contacts.body_b.shape[0] != m:
        return False
    last = np.int64(-1)
    for i in range(m):
        a, b = contacts.body_a[i], contacts.body_b[i]
        n_x, n_y = contacts.normal[i, 0], contacts.normal[i, 1]
        pair = a * (n + 4) + b
        if a < 0 or b <= a or b >= n + 4 or a >= n or pair <= last or abs(n_x * n_x + n_y * n_y - 1) > 1e-4:
            return False
        if contacts.normal_impulse[i] < 0:
            return False
        last = pair
    return True


@njit(cache=True)
def _within(values, limits):
    """Whether all values lie within the limits; NaN does not."""
    low, high = limits
    inside = True
    for value in values.flat:
        inside &= low <= value <= high
    return inside


class ContactSolution(NamedTuple):
    """What a solve of the contact problem found.

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


def world_arguments(state: State) -> tuple:
    """The state's world as the compiled functions take it."""
    world = state.world
    return world.box, world.gravity, world.friction, world.restitution


def required_arguments(state: State, settings: NamedTuple, tangent_start: np.ndarray) -> tuple:
    """`world_arguments` with friction None where no tangent rows are required: μ = 0, and none to start from.

    settings: of the method, which has to know rows without tangents.
    """
    box, gravity, friction, restitution = world_arguments(state)
    required = friction > 0 or not isinstance(settings, WITHOUT_TANGENTS) or tangent_start.any()
    return box, gravity, friction if required else None, restitution


def advance_of(solver, sleep: bool = False):
    """The compiled function that does the steps of a method, and what it takes as (settings, position sweeps).

    With sleeping it takes one argument more, `rest`. Raises ValueError for a method that cannot sleep.
    """
    if not isinstance(sleep, (bool, np.bool_)):
        raise ValueError(f"sleep: expected True or False, got {sleep!r}")
    if sleep and isinstance(solver, (SoftSteps, BatchedPGS)):
        raise ValueError(f"sleep: expected False with {type(solver).__name__}, got True")
    if isinstance(solver, SoftSteps):
        from deep_contact.physics.soft_steps import advance_softly, soft_settings

        return advance_softly, (soft_settings(solver), 0)
    if sleep:
        from deep_contact.physics.sleeping import advance_sleeping

        return advance_sleeping, (settings_of(solver), solver.position_sweeps)
    if isinstance(solver, BatchedPGS):
        from deep_contact.physics.batched_steps import advance_in_batches, advance_side_by_side

        step = advance_in_batches if solver.threads == 1 else advance_side_by_side(solver.threads)
        return step, (settings_of(solver), solver.position_sweeps)
    return advance, (settings_of(solver), solver.position_sweeps)


def moving_room(n_bodies: int, solver) -> np.ndarray:
    """Room for the velocities in the sweeps, (n + 4, 4), in the solver's precision."""
    return np.empty((n_bodies + 4, 4), PRECISIONS[solver.precision])


def contacts_of(state: State) -> Contacts:
    """The contacts at the state's positions, with zero impulses, found afresh."""
    bodies = state.bodies
    room = make_contacts(4 * bodies.count + 64)
    contacts, _ = find_contacts(bodies.position, bodies.radius, state.world.box, make_cells(bodies.count), room)
    return own_contacts(contacts)


def solve(state: State, solver, normal_start: np.ndarray, tangent_start: np.ndarray) -> ContactSolution:
    """Solve the contact problem of a state from the given impulses, (m,), N·s each. The state stays as it is.

    `SoftSteps` has no problem of its own to solve: its solution is what its step does to copies of the bodies.
    """
    contacts = state.contacts._replace(normal_start=normal_start, tangent_start=tangent_start)
    bodies, n = state.bodies, state.bodies.count
    theta = np.empty(solver.sweeps)
    moving = moving_room(n, solver)
    if isinstance(solver, SoftSteps):
        room = Contacts(*(field.copy() for field in contacts))
        bodies = Bodies(*(field.copy() for field in bodies))
        step, method = advance_of(solver)
        log = np.empty((1, 4))
        solved, _ = step(bodies, room, world_arguments(state), state.dt, *method, True, 1, moving, theta, log)
        impulse, sweeps = np.column_stack([solved.normal_impulse, solved.tangent_impulse]), int(log[0, 1])
        velocity, spin = bodies.velocity, bodies.spin
    else:
        settings = settings_of(solver)
        world = required_arguments(state, settings, tangent_start)
        impulse, sweeps = solve_velocities(bodies, contacts, world, state.dt, settings, moving, theta)
        velocity, spin = moving[:n, :2].astype(np.float64), moving[:n, 2] / bodies.radius
    return ContactSolution(
        normal_impulses=impulse[:, 0].astype(np.float64),
        tangent_impulses=impulse[:, 1].astype(np.float64) if impulse.shape[1] > 1 else np.zeros(contacts.count),
        velocities=velocity,
        angular_velocities=spin,
        record=convergence_record(theta[:sweeps], solver, contacts.count),
    )
