"""Build and solve the contact problem of one step on its own, without doing the step.

Starts, exact solutions and errors of solutions are computed from this problem. A state has n circles and m contacts.

Tests: tests/solvers/test_solvers.py
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state import html
from deep_contact.state.arrays import Contacts
from deep_contact.state.equality import by_value
from deep_contact.state.materials import largest
from deep_contact.state.scales import ContactScales
from deep_contact.state.state import State
from deep_contact.stepping.broad_phase import make_cells
from deep_contact.stepping.contacts import Exclusions, Walls, detect_contacts, make_contacts
from deep_contact.stepping.convergence import ConvergenceRecord, convergence_record
from deep_contact.stepping.impacts import rebound
from deep_contact.stepping.inputs import friction_with_rolling, leaves_tangents_out, reach_of, step_input
from deep_contact.stepping.interface import entry_of, make_workspace, relax
from deep_contact.stepping.motion import integrate_velocities
from deep_contact.stepping.pairs import barred_pairs
from deep_contact.stepping.rows import (
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    V_S,
    V_Y,
    Rows,
    apply_impulses,
    contact_rows,
    more_rows,
    move_walls,
    with_wall_bodies,
)
from deep_contact.stepping.segment_grid import segments_in_grid


@njit(cache=True, error_model="numpy")
def solve_velocities(rows, friction, settings, solver_bodies, theta):
    """Solve the rows of a step, in place on their impulses and on the solver bodies. Returns the number of sweeps.

    rows: `Rows`. friction: as in `StepInput`, or None for rows without tangents. settings: those of the solver.
    solver_bodies: velocities before the impulses of the rows, (N, 4). theta: buffer for the θ of each sweep, N·s; its
    length is the largest number of sweeps.
    """
    apply_impulses(rows, solver_bodies, friction)
    sweeps, _ = relax(settings, rows, friction, solver_bodies, theta, make_workspace(settings, rows, solver_bodies))
    return sweeps


@njit(cache=True, error_model="numpy", nogil=True)
def build_rows(step, contacts, solver_bodies, actuation):
    """Return the rows of a step, and write the velocities after Δt of gravity and external forces into `solver_bodies`.

    The impacts of the step have to be applied before. step: `StepInput`. contacts: `Contacts`. solver_bodies: (N, 4),
    columns `V_X` to `INVERSE_MASS` of `rows`. actuation: `Actuation` of the step, or None.
    """
    integrate_velocities(step.bodies, step.gravity, step.dt, solver_bodies, actuation)
    buffer, radius = more_rows(contacts.body_a.shape[0], step.friction), step.bodies.radius
    rows = contact_rows(contacts, radius, step.segments, solver_bodies, buffer, step.friction, 1.0)
    if actuation is not None:
        move_walls(contacts, step.segments, solver_bodies, rows, radius.shape[0], actuation)
    return rows


@by_value
class ContactSolution(NamedTuple):
    """Solution of a contact problem by a solver.

    | field              | meaning                                       | shape  | unit  |
    |--------------------|-----------------------------------------------|--------|-------|
    | normal_impulses    | λ_n of each contact                           | (m,)   | N·s   |
    | tangent_impulses   | λ_t of each contact                           | (m,)   | N·s   |
    | velocities         | velocity of each circle after the solve       | (n, 2) | m/s   |
    | angular_velocities | spin of each circle after the solve           | (n,)   | rad/s |
    | record             | `ConvergenceRecord` of the sweeps             |        |       |
    """

    normal_impulses: np.ndarray
    tangent_impulses: np.ndarray
    velocities: np.ndarray
    angular_velocities: np.ndarray
    record: ConvergenceRecord

    def __repr__(self) -> str:
        return f"ContactSolution({html.counted(self.normal_impulses.size, 'contact')}, {self.record})"


@by_value
class StepProblem(NamedTuple):
    """The contact problem of the next step of a state, after the impacts of that step.

    It is built once, and serves both to find a start and to do the step.
    """

    rows: Rows  # with the impulses from which the state starts
    solver_bodies: np.ndarray  # (n + 4 + k, 4), with k contacts of moving segments: after forces, before impulses
    friction: object  # as in `StepInput`; None if there are no tangent rows (`started`)
    impacts: np.ndarray  # (m, 2): impulses of the impacts on the second bodies of the contacts, N·s; (0, 2) if e = 0


def after_impacts(state: State) -> tuple[State, np.ndarray]:
    """Return (state, impulses): the state after the impacts of its next step, and the impulses of these impacts.

    Only velocities and spins change. The impulses are those of `StepProblem.impacts`. If e = 0 there are no impacts,
    and the state itself is returned.
    """
    if largest(state.world.restitution) == 0.0:
        return state, np.zeros((0, 2))
    bodies = state.bodies._replace(velocity=state.bodies.velocity.copy(), spin=state.bodies.spin.copy())
    state, impacts = state.replace(bodies=bodies), np.zeros((state.contacts.count, 2))
    step = step_input(state, None)
    rebound(step, state.contacts, impacts, step.actuation)
    return state, impacts


def step_problem(state: State, scales: ContactScales | None = None, solver=None) -> StepProblem:
    """Return the contact problem of the next step of a state, with tangent rows.

    scales: `ContactScales` to use; by default those of the state. solver: options of a solver, with which the problem
    has the rows of rolling resistance; None leaves these out.
    """
    state, impacts = after_impacts(state)
    solver_bodies, step = np.empty((state.bodies.count + 4, 4)), step_input(state, None, scales)
    if step.actuation is not None:
        solver_bodies = with_wall_bodies(solver_bodies, state.contacts, state.bodies.count, step.actuation)
    step = step._replace(friction=friction_with_rolling(state, solver))
    rows = build_rows(step, state.contacts, solver_bodies, step.actuation)
    return StepProblem(rows, solver_bodies, step.friction, impacts)


def started(problem: StepProblem, contacts: Contacts, friction) -> StepProblem:
    """Return the problem with the starting impulses of these contacts.

    problem: problem with tangent rows. friction: that of the problem, or None for a result without tangent rows.
    """
    data, impulse = problem.rows.data, np.zeros((contacts.count, problem.rows.impulse.shape[1]))
    impulse[:, NORMAL], impulse[:, TANGENT] = contacts.normal_start, contacts.tangent_start
    if friction is None:
        data, impulse = data[:, : NORMAL_MASS + 1].copy(), impulse[:, :TANGENT].copy()
    return problem._replace(rows=Rows(problem.rows.body, data, impulse), friction=friction)


def contacts_of(state: State) -> Contacts:
    """Return the contacts at the positions of a state, with impulses of 0.

    The arrays of the state have the byte order of this machine (`state.native`).
    """
    bodies, world, scales = state.bodies, state.world, state.scales
    segments = segments_in_grid(world, reach_of(state, scales)) if world.segments else None
    walls, n = Walls(world.box, scales.wall_skin), bodies.count
    mass, touches = bodies.mass if bodies.is_fixed.any() else None, None if world.is_uniform else barred_pairs(state)
    exclusions, cells, buffer = Exclusions(mass, touches), make_cells(n), make_contacts(4 * n + 64)
    found = detect_contacts(bodies.position, bodies.radius, walls, segments, exclusions, cells, buffer)
    # The first five arrays are copied, since they lie in a larger buffer. The four arrays of impulses are set to zero.
    return Contacts(*map(np.copy, found[:5]), *map(np.zeros_like, found[5:]))


def solve(
    state: State, solver, normal_start: np.ndarray, tangent_start: np.ndarray, problem: StepProblem | None = None
) -> ContactSolution:
    """Solve the contact problem of a state from starting impulses, without changing the state.

    If e > 0, impacts come first. The velocities of the solution include their effect, but its impulses do not include
    those of the impacts. solver: options of the solver. normal_start, tangent_start: starting λ_n and λ_t, (m,) each,
    N·s. problem: `step_problem(state)` if it has been built already; it is not changed, and without its rows the solve
    has no rolling resistance.
    """
    solver = solver.for_state(state)
    settings, n = entry_of(solver).settings(solver), state.bodies.count
    state = state.replace(contacts=state.contacts._replace(normal_start=normal_start, tangent_start=tangent_start))
    problem = problem or step_problem(state, solver=solver)
    friction = None if leaves_tangents_out(state, solver) else problem.friction
    rows, solver_bodies, *_ = started(problem, state.contacts, friction)
    # Copies, because the solver scales the effective masses in place.
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
