"""New starting impulses for a state without impulses, or with the impulses of another load or another Δt.

A pile whose gravity is switched off still has the impulses that carried its weight. A few sweeps do not remove them,
and the rest becomes velocity. A state therefore stores the load for which its impulses were solved (`load`). After a
small change of this load the impulses stay. After a large change the solver tests the impulses. If the test shows that
they would become velocity, they are solved anew, with many sweeps. In a run whose load never changes, all bits of the
result stay the same.
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.solvers import NesterovPGS
from deep_contact.starts.impulses_at_rest import at_rest, energy_of_change
from deep_contact.starts.load import KICK, Anchor, anchor_of, kept_anchor, load_of, share_of_gravity
from deep_contact.starts.support import supported
from deep_contact.state.arrays import Contacts
from deep_contact.state.checks import check_types
from deep_contact.state.materials import largest
from deep_contact.state.scales import mean, theta_tolerance
from deep_contact.state.state import State, StateWithContacts, changed
from deep_contact.state.validation import number
from deep_contact.stepping.inputs import actuation_of
from deep_contact.stepping.metrics import energy_norm
from deep_contact.stepping.prepare import find_contacts
from deep_contact.stepping.problem import StepProblem, solve, step_problem
from deep_contact.stepping.rows import apply_impulses, best_share, frictions, projected
from deep_contact.stepping.substeps import shift_flights

SWEEPS = 500, 2000
"""Smallest and largest number of sweeps of an accurate solve. Between these limits there are as many sweeps as circles.
After fewer sweeps the circles of a pile would sink into each other."""

CLOSE = 10.0
"""Tolerance of an accurate solve after a change of the load, as a multiple of the default tolerance of solvers."""

RELAXED = 2000
"""Largest number of iterations of the convex relaxation (`impulses_at_rest`), which is used if circles hardly move."""

ENDS = 1e-4
"""Rms speed at which the iterations of the relaxation end, as a multiple of g Δt, the speed that gravity adds in a
step, for a state without impulses. After a change of the load they end at `RESTS`, since the steps that follow
relax the impulses further."""

RESTS = 0.02
"""Largest rms speed after the relaxation at which a pile counts as being at rest, as a multiple of g Δt."""


def fitted(state: StateWithContacts, solver, *, carries: bool = True) -> tuple[StateWithContacts, Anchor]:
    """Return (state, anchor): the state with starting impulses that fit its load, and the anchor of these impulses.

    After a small change of gravity, friction, restitution or the push the carried impulses stay (`load.kept_anchor`),
    times the factor that follows from gravity. After other changes of the load they are tested (`with_new_load`). The
    state is returned unchanged if its load is that of its impulses, or if the load of its impulses is unknown.

    solver: as in `with_new_load`. carries: whether steps start from the carried impulses at all.
    """
    load, share = state.load, 1.0
    if load is None:
        return state, anchor_of(state)
    now = load_of(state)
    if now.digest == load.digest:
        return state, load.anchor
    if now.constant != load.constant:
        state = find_contacts(state)
    else:
        share = share_of_gravity(load.world, load.anchor, state)
        if (anchor := kept_anchor(load.anchor, load.world, state)) is not None:
            contacts = scaled_impulses(state.contacts, share, is_solved=state.solved)
            return changed(state, contacts=contacts), anchor
    return with_new_load(state, solver, share=share) if carries else state, now.anchor


def with_new_load(state: StateWithContacts, solver, *, share: float = 1.0) -> StateWithContacts:
    """Return a state that carries the impulses of another load, with starting impulses that fit its own load.

    The carried impulses times `share` stay if the solver, starting from them, leaves no more energy than from impulses
    of 0, and kicks no circle (`_kicks`). Otherwise the impulses are solved anew, from the better of two starts
    (`_nearest_start`): by the convex relaxation if circles hardly move, and by NesterovPGS if they move. NesterovPGS
    also follows the relaxation if circles do not rest, and the solver leaves more energy from the impulses of the
    relaxation than from those of before, or throws a circle (`_throws`). If it leaves more energy from the new impulses
    than from impulses of 0, the state starts from 0.

    solver: options of the next steps, with numbers in place of values that follow the scene
    (`SolverOptions.for_state`). share: factor on the impulses that follows from the change of gravity
    (`load.share_of_gravity`).
    """
    contacts, zero = state.contacts, np.zeros((2, state.contacts.count))
    if contacts.count == 0:
        return state
    if share == 0.0 and not any(state.world.gravity):  # circles at rest without a load need no impulses
        return _starting(state, *zero)
    problem = step_problem(state)
    carried = projected(contacts.normal_start, contacts.tangent_start, frictions(problem.rows, problem.friction))
    scaled = share * carried[0], share * carried[1]
    (energy, free), (energy_scaled, velocity) = (_left(state, *start, solver, problem) for start in (zero, scaled))
    if energy_scaled <= energy and not _kicks(state, velocity, free):
        return _starting(state, *scaled)
    *impulses, rests = _relaxed(state, *_nearest_start(state, problem, carried), problem, is_changed=True)
    energy_new, velocity = _left(state, *impulses, solver, problem)
    if not rests and (not energy_new <= min(energy, energy_scaled) or _throws(state, velocity)):
        tolerance = CLOSE * theta_tolerance(state.bodies.mass, state.bodies.radius, state.world.gravity, state.dt)
        impulses = _solved(state, *impulses, problem, tolerance)
        energy_new, _ = _left(state, *impulses, solver, problem)
    return _starting(state, *(impulses if energy_new <= energy else zero))


def _nearest_start(state: StateWithContacts, problem: StepProblem, carried) -> tuple[np.ndarray, np.ndarray]:
    """Return the better of two starts (λ_n, λ_t) of a search for impulses, (m,) each, N·s: it leaves less energy.

    One start is the carried impulses times the factor that leaves the least energy (`best_share`). The other start is
    the impulses that carry loads down (`support.supported`). carried: (λ_n, λ_t). problem: `StepProblem` of the state.
    """
    energies, starts = [], [carried, supported(state, problem)]
    for i, (normal, tangent) in enumerate(starts):
        rows = problem.rows._replace(impulse=np.column_stack([normal, tangent]))
        share = best_share(rows, problem.solver_bodies)
        starts[i], v = (share * normal, share * tangent), problem.solver_bodies.copy()
        rows.impulse[:] *= share
        apply_impulses(rows, v, problem.friction)
        energies.append(energy_of_change(v, np.zeros_like(v)))
    return starts[int(np.argmin(energies))]


def _kicks(state: StateWithContacts, velocity: np.ndarray, free: np.ndarray) -> bool:
    """Return whether the velocities after a solve show that its starting impulses kick a circle.

    A kicked circle is faster, by more than `KICK`, than the fastest circle before the solve. Circles that fall or roll
    become faster without a kick, by at most the speed that gravity and the push give in a step. Such circles do not
    count: those without contacts, those that were at least half as fast as this speed, and those with one contact that
    become as fast from impulses of 0. A pile is also kicked if it sinks: if most circles with at least two contacts
    that were slow gain more than half of this speed.

    velocity, free: velocities after the solve and after a solve from impulses of 0, (n, 2), m/s.
    """
    before, after = (np.hypot(*values.T) for values in (state.bodies.velocity, velocity))
    (own, kick), n = _speeds_of_load(state), state.bodies.count
    contacts = np.bincount(np.concatenate(state.contacts[:2]), minlength=n)[:n]
    moves_on = (before >= 0.5 * own) | ((contacts == 1) & (after <= np.hypot(*free.T) + kick))
    is_free = (contacts == 0) | (moves_on & (after - before <= own))
    rests = (contacts >= 2) & (before < 0.5 * own)
    if 2 * np.count_nonzero(rests & (after - before > 0.5 * own)) > np.count_nonzero(rests):
        return True
    return bool(((after > before.max(initial=0.0) + kick) & ~is_free).any())


def _throws(state: StateWithContacts, velocity: np.ndarray) -> bool:
    """Return whether a solve has made a circle faster than gravity and the push make it.

    velocity: velocities after the solve, (n, 2), m/s.
    """
    own, kick = _speeds_of_load(state)
    return bool((np.hypot(*velocity.T) - np.hypot(*state.bodies.velocity.T) > own + kick).any())


def _speeds_of_load(state: State) -> tuple[np.ndarray | float, float]:
    """Return (speed that gravity and the push give a circle in a step, m/s; `KICK` in m/s).

    The first is an array, (n,), if there is a push.
    """
    bodies, gravity = state.bodies, math.hypot(*state.world.gravity)
    own, kick = state.dt * gravity, KICK * math.sqrt(gravity * mean(bodies.radius))
    if state.push is not None:
        own = own + state.dt * np.hypot(*state.push[0].T) / bodies.mass
    return own, kick


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

    normal, tangent: impulses to start from, (m,) each, N·s. problem: `StepProblem` of the state. tolerance: as in
    `_solved`.
    """
    *impulses, rests = _relaxed(state, normal, tangent, problem)
    return tuple(impulses) if rests else _solved(state, *impulses, problem, tolerance)


def _relaxed(
    state: State, normal, tangent, problem: StepProblem, *, is_changed: bool = False
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return (λ_n, λ_t, rests): impulses of the convex relaxation, and whether the circles rest at them.

    There is no relaxation, and the impulses are returned unchanged, if the rms speed of the circles exceeds the speed
    that gravity adds in a step. After a change of the load (`is_changed`), there is a relaxation also if the median
    speed is below this limit. If then a few circles are fast, the iterations do not end early, because the rms speed
    does not show whether most circles rest. The other arguments are those of `_good`.
    """
    velocity, gained, speed = state.bodies.velocity, state.dt * math.hypot(*state.world.gravity), math.inf
    is_slow, rests = np.mean(velocity**2) < gained**2, RESTS * gained
    if is_slow or (is_changed and np.median(np.hypot(*velocity.T)) < gained):
        needed, ends = rests if is_slow else math.inf, rests if is_changed else ENDS * gained
        normal, tangent, speed = at_rest(problem, normal, tangent, iterations=RELAXED, speed=ends, needed=needed)
    return normal, tangent, not speed > rests


def _solved(state: State, normal, tangent, problem: StepProblem, tolerance: float | None) -> tuple:
    """Return accurately solved impulses (λ_n, λ_t), (m,) each, N·s.

    tolerance: θ at which the sweeps of NesterovPGS end, N·s, or None. The other arguments are those of `_good`.
    """
    solver = NesterovPGS(sweeps=int(np.clip(state.bodies.count, *SWEEPS)), tolerance=tolerance)
    solution = solve(state, solver, normal, tangent, problem)
    return solution.normal_impulses, solution.tangent_impulses


def _left(state: State, normal, tangent, solver, problem: StepProblem) -> tuple[float, np.ndarray]:
    """Return (energy norm, √J; velocities, (n, 2), m/s) that a solve leaves.

    normal, tangent: impulses from which the solve starts, (m,) each, N·s. solver: options of the solver. problem:
    `StepProblem` of the state.
    """
    solution = solve(state, solver, normal, tangent, problem)
    return energy_norm(state.bodies, solution.velocities, solution.angular_velocities), solution.velocities


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
        contacts = scaled_impulses(contacts, dt / state.dt, is_solved=state.solved)
        state = with_shifted_flights(state, (state.dt - dt) / getattr(state.solver, "substeps", 1))
    return state.replace(dt=dt, contacts=contacts)


def scaled_impulses(contacts: Contacts, ratio: float, *, is_solved: bool) -> Contacts:
    """Return the contacts with their starting impulses times `ratio`.

    is_solved: `State.solved` of their state. The impulses of an unsolved state are its starting impulses, and are
    scaled with them.
    """
    names = ["normal_start", "tangent_start"] + ["normal_impulse", "tangent_impulse"] * (not is_solved)
    return contacts._replace(**{name: ratio * getattr(contacts, name) for name in names})


def with_shifted_flights(state: StateWithContacts, change: float) -> StateWithContacts:
    """Return the state with corrected velocities, for a run whose substeps become shorter by `change`, s.

    Only the velocities of circles in flight are corrected, and only if e > 0. These circles then keep their energy.
    """
    if change == 0.0 or largest(state.world.restitution) == 0.0 or state.step == 0:
        return state
    bodies = state.bodies._replace(velocity=state.bodies.velocity.copy())
    shift_flights(bodies, state.contacts, state.world.gravity, change, actuation_of(state), np.zeros((0, 2)))
    return changed(state, bodies=bodies)
