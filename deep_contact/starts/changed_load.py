"""New starting impulses for a state without impulses, or with the impulses of another load or another Δt.

A pile whose gravity is switched off still has the impulses that carried its weight. A few sweeps do not remove them,
and the rest becomes velocity. A state therefore stores a digest of the load for which its impulses were solved
(`State.load`). If the load has changed, the impulses are solved anew, with many sweeps, and the next step starts from
them. In a run whose load never changes, all bits of the result stay the same.
"""

from __future__ import annotations

import math
import zlib

import numpy as np

from deep_contact.solvers import NesterovPGS
from deep_contact.starts.impulses_at_rest import at_rest
from deep_contact.starts.support import supported
from deep_contact.state.checks import check_types
from deep_contact.state.materials import largest
from deep_contact.state.scales import mean, theta_tolerance
from deep_contact.state.state import State, StateWithContacts, changed
from deep_contact.state.validation import number
from deep_contact.state.world import World
from deep_contact.stepping.inputs import actuation_of
from deep_contact.stepping.metrics import energy_norm
from deep_contact.stepping.problem import StepProblem, solve, started, step_problem
from deep_contact.stepping.rows import best_share, frictions, projected
from deep_contact.stepping.substeps import shift_flights

SWEEPS = 500, 2000
"""Smallest and largest number of sweeps of an accurate solve. Between these limits there are as many sweeps as circles.
After fewer sweeps the circles of a pile would sink into each other."""

CLOSE = 10.0
"""Tolerance of an accurate solve after a change of the load, as a multiple of the default tolerance of solvers."""

KICK = 0.001
"""Largest increase of the top speed, in √(g r), up to which the carried impulses are used in spite of a changed load.
"""

RELAXED = 2000
"""Largest number of iterations of the convex relaxation (`impulses_at_rest`), which is used if circles hardly move."""

ENDS = 1e-4
"""Rms speed at which the iterations of the relaxation end, as a multiple of g Δt, the speed that gravity adds in a
step."""

RESTS = 0.02
"""Largest rms speed after the relaxation at which a pile counts as being at rest, as a multiple of g Δt."""


def load_of(state: State) -> tuple[int, int]:
    """Return (digest of the load of a state, digest of its velocities and spins).

    The load consists of the world, Δt, the pushes, and the positions, masses and radii of the circles.
    """
    position, velocity, _, spin, mass, radius, _ = map(np.ascontiguousarray, state.bodies)
    load, motion = zlib.crc32(np.float64(state.dt), _of_world(state.world)), zlib.crc32(velocity, zlib.crc32(spin))
    material = () if state.world.materials is None else (state.bodies.material,)
    for values in (position, mass, radius, *material, *(state.push or ())):
        load = zlib.crc32(values, load)
    return load, motion


def _of_world(world: World) -> int:
    if (kept := vars(world).get("_digest")) is None:
        numbers = *world.box, *world.gravity, *np.ravel(world.friction), *np.ravel(world.restitution)
        numbers += *np.ravel(world.segments), *np.ravel(world.touches), *world.wall_materials, *world.segment_materials
        numbers += (*np.ravel(world.rolling_friction),)
        dragging = world.surface_speeds if largest(world.friction) > 0 else ()
        kept = zlib.crc32(np.array([*numbers, *dragging, *(world.scales or ())], np.float64))
        vars(world)["_digest"] = kept  # cached in the world, which never changes
    return kept


def has_new_load(state: State) -> bool:
    """Return whether the impulses of a state are known to belong to another load than its present load."""
    return state.load is not None and load_of(state)[0] != state.load[0]


def with_new_load(state: StateWithContacts, solver) -> StateWithContacts:
    """Return a state that carries the impulses of another load, with starting impulses that fit its own load.

    The carried impulses stay if the solver, starting from them, leaves no more energy than from impulses of 0, and
    raises the top speed by at most `KICK`. Otherwise the impulses are solved anew. This solve starts from the carried
    impulses times the factor that leaves the least energy (`best_share`). If the solver leaves more energy from the new
    impulses than from impulses of 0, the state starts from 0.

    solver: options of the next steps, with numbers in place of values that follow the scene
    (`SolverOptions.for_state`).
    """
    contacts = state.contacts
    if not contacts.have_past:
        return state
    problem, zero = step_problem(state), (np.zeros(contacts.count), np.zeros(contacts.count))
    carried = projected(contacts.normal_start, contacts.tangent_start, frictions(problem.rows, problem.friction))
    energy, (energy_carried, fastest) = (_left(state, *start, solver, problem) for start in (zero, carried))
    most = np.hypot(*state.bodies.velocity.T).max()
    most += KICK * math.sqrt(math.hypot(*state.world.gravity) * mean(state.bodies.radius))
    if energy_carried <= energy[0] and fastest <= most:
        return state
    contacts = contacts._replace(normal_start=carried[0], tangent_start=carried[1])
    share = best_share(started(problem, contacts, problem.friction).rows, problem.solver_bodies)
    tolerance = CLOSE * theta_tolerance(state.bodies.mass, state.bodies.radius, state.world.gravity, state.dt)
    impulses = _good(state, share * carried[0], share * carried[1], problem, tolerance)
    return _starting(state, *(impulses if _left(state, *impulses, solver, problem)[0] <= energy[0] else zero))


def with_a_past(state: StateWithContacts) -> StateWithContacts:
    """Return the state with starting impulses that follow from its positions alone.

    They are impulses at which the circles rest, if there are any, and otherwise accurately solved impulses. The state
    is returned unchanged if these impulses would leave more energy than impulses of 0.
    """
    if state.contacts.count == 0:
        return state
    problem = step_problem(state)
    normal, tangent = _good(state, *supported(state, problem), problem, None)
    rows = problem.rows._replace(impulse=np.column_stack([normal, tangent]))
    # If the best share of these impulses is below one half, the full impulses leave more energy than impulses of 0.
    if not np.isfinite(rows.impulse).all() or best_share(rows, problem.solver_bodies) < 0.5:
        return state
    return _starting(state, normal, tangent)


def _good(state: State, normal, tangent, problem: StepProblem, tolerance: float | None) -> tuple:
    """Return impulses (λ_n, λ_t), (m,) each, N·s, at which the state rests, or else accurately solved impulses.

    If the circles hardly move, the convex relaxation searches for impulses at rest. If it finds none, or if the circles
    move faster, NesterovPGS solves the contact problem. normal, tangent: impulses to start from, (m,) each, N·s.
    problem: `StepProblem` of the state. tolerance: θ at which the sweeps of NesterovPGS end, N·s, or None.
    """
    gained, speed = state.dt * math.hypot(*state.world.gravity), math.inf
    ends, rests = ENDS * gained, RESTS * gained
    if np.mean(state.bodies.velocity**2) < gained**2:
        normal, tangent, speed = at_rest(problem, normal, tangent, iterations=RELAXED, speed=ends)
    if speed > rests:
        solver = NesterovPGS(sweeps=int(np.clip(state.bodies.count, *SWEEPS)), tolerance=tolerance)
        solution = solve(state, solver, normal, tangent, problem)
        normal, tangent = solution.normal_impulses, solution.tangent_impulses
    return normal, tangent


def _left(state: State, normal, tangent, solver, problem: StepProblem) -> tuple[float, float]:
    """Return (energy norm, √J; top speed, m/s) of the velocities that a solve leaves.

    normal, tangent: impulses from which it starts, (m,) each, N·s. solver: its options. problem: `StepProblem` of the
    state.
    """
    solution = solve(state, solver, normal, tangent, problem)
    energy = energy_norm(state.bodies, solution.velocities, solution.angular_velocities)
    return energy, float(np.hypot(*solution.velocities.T).max())


def _starting(state: StateWithContacts, normal, tangent) -> StateWithContacts:
    """Return the state that starts from these impulses, (m,) each, N·s."""
    contacts = state.contacts._replace(normal_start=normal, tangent_start=tangent)
    if not state.solved:
        contacts = contacts._replace(normal_impulse=normal, tangent_impulse=tangent)
    return state.replace(contacts=contacts)


def with_time_step(state: State, dt: float) -> State:
    """Return the state with another Δt, s. The impulses carried from the last step are scaled by new Δt / old Δt.

    Without the scaling a change of Δt kicks a pile at rest, whose impulses are m g Δt (Box2D 2.3 scales by `dtRatio`).
    If e > 0, the velocities of circles in flight are corrected, so that the circles keep their energy
    (`substeps.shift_flights`).
    """
    contacts = check_types(state).contacts
    if dt == state.dt:
        return state
    if number("dt", dt, above=0) and contacts is not None:
        ratio, names = dt / state.dt, ["normal_start", "tangent_start"]
        if not state.solved:  # the impulses of an unsolved state are its starting impulses
            names += ["normal_impulse", "tangent_impulse"]
        contacts = contacts._replace(**{name: ratio * getattr(contacts, name) for name in names})
        state = with_shifted_flights(state, (state.dt - dt) / getattr(state.solver, "substeps", 1))
    return state.replace(dt=dt, contacts=contacts)


def with_shifted_flights(state: StateWithContacts, change: float) -> StateWithContacts:
    """Return the state with corrected velocities, for a run whose substeps become shorter by `change`, s.

    Only the velocities of circles in flight are corrected, and only if e > 0. These circles then keep their energy.
    """
    if change == 0.0 or largest(state.world.restitution) == 0.0 or state.step == 0:
        return state
    bodies = state.bodies._replace(velocity=state.bodies.velocity.copy())
    shift_flights(bodies, state.contacts, state.world.gravity, change, actuation_of(state), np.zeros((0, 2)))
    return changed(state, bodies=bodies)
