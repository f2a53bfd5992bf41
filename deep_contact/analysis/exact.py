"""Exact solutions of the contact problem with friction by Lemke's pivots, for problems in which sweeps do not converge.

A pile is hyperstatic: λ may move along the null space of A = J M⁻¹ Jᵀ without a change of the velocities. Sweeps of PGS
let λ drift along the null space until a contact opens or starts to slip. With friction the remaining problem is neither
symmetric nor monotone, and may have a mode that grows from sweep to sweep.

A proximal step (Rockafellar 1976) adds ε diag(A) (λ − c) to the velocities, where c are the impulses before the step.
This term removes the null space. If a step leaves the impulses unchanged, they solve the contact problem.

Each step is solved by the parametric form of Lemke's algorithm (Lemke 1965; Cottle, Pang and Stone 1992, sections
4.4-4.5; with friction Anitescu and Potra 1997). Every contact has a state: it is open, sticks, or slips in one of two
directions. The states at the start follow from c. The impulses c are moved to the bounds of these states. They then
solve a problem whose velocities are shifted by some q. The algorithm reduces this shift, t q, from t = 1 to t = 0.
While all contacts stay in their states, λ is linear in t. A change of a state is called a pivot. Each pivot decides
whether t falls or grows until the next one; without friction t always falls. As long as the steps need few pivots, ε is
reduced from step to step.

A pivot is a solve with SuperLU's factors (`proximal_path`), which costs too much for the steps of a run.

Without friction the problem is monotone, and every path leads to a solution. With friction, ε may be too small to
outweigh a mode that grows. A path may then turn back and never reach t = 0. Such a step is abandoned, and done again
with a larger ε. The method is for scenes of up to some 1,000 circles. If there are many solutions, the start and the
constants of this module choose one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.analysis.lcp import ContactProblem, check_problem, contact_problem, natural_residual
from deep_contact.analysis.matrix_solvers import Blocks, blocks_of, solve_problem, sweep_matrix, velocities
from deep_contact.analysis.proximal_path import OPEN, SLIP_DOWN, SLIP_UP, STICK, follow
from deep_contact.compiled import njit
from deep_contact.solvers import PGS, NesterovPGS
from deep_contact.starts.support import supported
from deep_contact.state.arrays import LARGEST_START
from deep_contact.state.checks import check_limits, check_state
from deep_contact.state.equality import by_value
from deep_contact.state.materials import at_contacts, largest
from deep_contact.state.state import State
from deep_contact.state.validation import brief, expect, floats, integer, number
from deep_contact.stepping import metrics
from deep_contact.stepping.convergence import ConvergenceRecord
from deep_contact.stepping.problem import ContactSolution, solve, step_problem
from deep_contact.stepping.rows import projected

FIRST_EPSILON = 1e-4
"""ε of the first proximal step. ε has no unit: it is a factor of diag(A)."""

LEAST_EPSILON = 1e-6
"""Smallest ε. If impulses of other contacts can replace the impulse of the pivot's contact, the pivot divides by a
number of order ε. This division loses log₁₀(1 / ε) of the 16 digits."""

LARGEST_EPSILON = 0.1
"""Largest ε. A step that changes λ by δ leaves a residual of ε diag(A) δ."""

FIRST_SWEEPS = NesterovPGS(sweeps=300, tolerance=None)
"""Solver whose sweeps improve the starting impulses before the first proximal step. More sweeps would take longer than
the pivots that they save."""

EASY = 5
"""Largest number of pivots of an easy step. After an easy step, ε is divided by 5."""

FAIR = 12
"""Largest number of pivots of a fair step. After a fair step that is not easy, ε is halved."""

MOST_PIVOTS = 120
"""Largest number of pivots and factorisations in a step. A step that needs more is abandoned. The next step has a
larger ε, and so a shorter path, which costs less."""

MOST_IDLE = 30
"""Number of easy steps in a row without a smaller residual, after which the solve restarts: it does sweeps, and sets ε
to `FIRST_EPSILON`."""

MOST_RESTARTS = 5
"""Largest number of restarts. After them the solve ends, because rounding is taken to allow no better solution."""

SWEEPS_ELSEWHERE = 200
"""Number of PGS sweeps in a restart, and after a step that was abandoned although ε was `LARGEST_EPSILON`."""

LONGEST_DRIFT = 1e4
"""If steps without a pivot move λ along a line, `_drifted` replaces at most this number of them by one step."""


@by_value
class ExactSolution(NamedTuple):
    """Result of `solve_exactly`.

    | field          | meaning                                                                      | unit |
    |----------------|------------------------------------------------------------------------------|------|
    | solution       | `ContactSolution`, whose record has the status, and no sweeps. Its           |      |
    |                | velocities are empty if the problem has no bodies                            |      |
    | residual       | `metrics.residual` of the solution, or `lcp.natural_residual` if a           | m/s  |
    |                | `ContactProblem` was solved                                                  |      |
    | converged      | whether the residual is at most the argument `residual`                      |      |
    | factorizations | number of matrix factorisations: at least one in each proximal step          |      |
    | pivots         | number of changes of a contact's state, over all proximal steps              |      |
    """

    solution: ContactSolution
    residual: float
    converged: bool
    factorizations: int
    pivots: int


# Impulses may overflow in sweeps with a large μ. They are then rejected because of their residual.
@np.errstate(all="ignore")
def solve_exactly(
    state: State | ContactProblem,
    normal_start: np.ndarray | None = None,
    tangent_start: np.ndarray | None = None,
    *,
    residual: float = 1e-8,
    most_pivots: int = 5_000,
) -> ExactSolution:
    """Solve a contact problem with friction until its residual is at most `residual`, if such a solution is found.

    state: a `State` with contacts, or a `ContactProblem` with friction. The residual is `metrics.residual` or, for a
    `ContactProblem`, the equal `lcp.natural_residual`. normal_start, tangent_start: impulses to start from, (m,) each,
    N·s. By default these are the state's starting impulses (those of `support` if the state has no past; 0 for a
    `ContactProblem`), or the impulses after 300 sweeps of NesterovPGS, whichever have the smaller residual.
    residual: largest residual that counts as converged, m/s. most_pivots: largest number of pivots and factorisations
    together.

    The result is the solution with the least residual so far, in the friction cone; `converged` tells whether its
    residual is at most `residual`. Equal arguments give equal solutions. The module `analysis.exact` describes the
    method, its costs and its limits. Raises ValueError, which names field and value, if the state has no contacts, if a
    state or problem is not valid or exceeds `state.arrays.LIMITS`, and if arguments do not fit each other.
    """
    number("residual", residual, above=0)
    integer("most_pivots", most_pivots)
    if isinstance(state, ContactProblem):
        problem = check_problem(state)
    elif isinstance(state, State):
        if state.contacts is None:
            raise ValueError("state.contacts: expected the contacts to have been found, got None (see dc.step)")
        state = check_limits(check_state(state))
        rolling = state.world.rolling_friction
        expected = "0 for exact solutions, which have no rolling resistance"
        expect(largest(rolling) == 0.0, f"rolling_friction: expected {expected}, got {brief(rolling)}")
        problem = check_problem(contact_problem(state))
    else:
        raise ValueError(f"state: expected a State or a ContactProblem, got {state!r}")
    if normal_start is not None or tangent_start is not None:
        impulse = _start_of(problem, normal_start, tangent_start)
    else:
        impulse = _start_of_state(state) if isinstance(state, State) else _start_of_problem(problem)
    impulse, factorizations, pivots = _solved(problem, impulse, residual, most_pivots)
    if isinstance(state, State):
        solution = solve(state, PGS(sweeps=0), *projected(impulse[::2], impulse[1::2], problem.friction))
        least = metrics.residual(state, solution)
    else:
        velocity = np.empty((0, 3)) if problem.jacobian is None else problem.velocities(impulse).reshape(-1, 3)
        parts = (impulse[::2], impulse[1::2], velocity[:, :2], velocity[:, 2])
        solution, least = ContactSolution(*map(np.copy, parts), record=None), natural_residual(problem, impulse)
    converged = bool(least <= residual)
    status = "no_contacts" if impulse.size == 0 else "converged" if converged else "max_sweeps"
    solution = solution._replace(record=ConvergenceRecord(np.empty(0), 0, status))
    return ExactSolution(solution, least, converged, factorizations, pivots)


def _solved(problem: ContactProblem, impulse: np.ndarray, residual: float, most_pivots: int):
    """Do proximal steps from impulses in the friction cone, (2 m,), N·s, until the residual, m/s, is small enough.

    Returns the impulses with the least residual, (2 m,), the number of factorisations and the number of pivots.
    """
    blocks = blocks_of(problem)
    impulse = impulse.reshape(-1, 2)
    best, least = impulse, natural_residual(problem, impulse.ravel())
    wrong = least
    epsilon, factorizations, pivots, idle, restarts = FIRST_EPSILON, 0, 0, 0, 0
    while least > residual and pivots + factorizations < most_pivots and restarts <= MOST_RESTARTS:
        limit = min(MOST_PIVOTS, most_pivots - pivots - factorizations)
        start = impulse
        reached, done, factorized = _step(problem, blocks, start, epsilon, limit)
        factorizations, pivots = factorizations + factorized, pivots + done
        if reached is None:
            # The step was abandoned. A larger ε makes the next path shorter. Sweeps help as well, but undo what earlier
            # steps have reached, so they are done only at the largest ε.
            sweeps = SWEEPS_ELSEWHERE if epsilon == LARGEST_EPSILON else 0
            epsilon = min(LARGEST_EPSILON, max(LEAST_EPSILON, 4 * epsilon))
        else:
            impulse, sweeps = reached, 1
            epsilon = max(LEAST_EPSILON, epsilon / (5 if done <= EASY else 2 if done <= FAIR else 1))
        impulse = _swept(blocks, impulse, sweeps)
        wrong, last = natural_residual(problem, impulse.ravel()), wrong
        if done == 0 and reached is not None and 0.9 * last < wrong < 1.1 * last:
            # The step had no pivot and left the residual as it was: λ moves along a line. Follow this line until a
            # contact reaches a bound.
            impulse = _drifted(blocks, start, reached)
            wrong = natural_residual(problem, impulse.ravel())
        idle = 0 if done > EASY or wrong < least else idle + 1
        if wrong < least:
            best, least = impulse, wrong
        elif not np.isfinite(wrong):
            impulse = best
        if reached is not None:
            # Near the solution a sweep raises the residual, so the impulses before the sweep are compared too.
            exact = _swept(blocks, reached, 0)
            at_end = natural_residual(problem, exact.ravel())
            if at_end < least:
                best, least = exact, at_end
        if idle == MOST_IDLE:
            impulse, epsilon, idle, restarts = _swept(blocks, impulse, SWEEPS_ELSEWHERE), FIRST_EPSILON, 0, restarts + 1
    return best.ravel(), factorizations, pivots


def _start_of_problem(problem: ContactProblem) -> np.ndarray:
    """Return starting impulses, (2 m,), N·s: zeros, or the impulses after `FIRST_SWEEPS`.

    Of the two, those with the smaller residual are returned.
    """
    starts = np.zeros(problem.b.size), solve_problem(problem, FIRST_SWEEPS)[0]
    return min(starts, key=lambda impulse: np.nan_to_num(natural_residual(problem, impulse), nan=np.inf))


def _start_of_state(state: State) -> np.ndarray:
    """Return starting impulses, (2 m,), N·s: those of the state, or the impulses after `FIRST_SWEEPS` from them.

    Of the two, those with the smaller residual are returned. If the state has no past, the impulses of `support` take
    the place of its own.
    """
    held = state.contacts.normal_start, state.contacts.tangent_start
    if not state.contacts.have_past:
        held = supported(state, step_problem(state))
    starts = [solve(state, solver, *held) for solver in (PGS(sweeps=0), FIRST_SWEEPS)]
    nearest = min(starts, key=lambda start: np.nan_to_num(metrics.residual(state, start), nan=np.inf))
    friction = at_contacts(state, state.world.friction)
    return np.column_stack(projected(nearest.normal_impulses, nearest.tangent_impulses, friction)).ravel()


def _start_of(problem: ContactProblem, normal, tangent) -> np.ndarray:
    """Return the user's starting impulses, validated and projected onto the friction cone, (2 m,), N·s.

    normal, tangent: λ_n and λ_t, (m,) each, N·s.
    """
    start = []
    for name, value in (("normal_start", normal), ("tangent_start", tangent)):
        start.append(floats(name, value, problem.friction.shape))
        largest = np.abs(start[-1]).max(initial=0.0)
        expect(largest <= LARGEST_START, f"{name}: expected numbers up to {LARGEST_START:g} N·s, got {largest:g}")
    return np.column_stack(projected(*start, problem.friction)).ravel()


@njit(cache=True)
def _swept(blocks: Blocks, impulse, sweeps):
    """Return the impulses, (m, 2), N·s, after `sweeps` sweeps of PGS, with λ_t clipped to ±μ λ_n.

    The clip is needed because a sweep relaxes λ_t before λ_n: if λ_n then falls, λ_t may lie outside of the cone.
    """
    impulse = impulse.copy()
    for _ in range(sweeps):
        sweep_matrix(blocks, impulse)
    for i in range(impulse.shape[0]):
        bound = blocks.mu[i] * impulse[i, 0]
        impulse[i, 1] = max(-bound, min(impulse[i, 1], bound))
    return impulse


@njit(cache=True)
def _drifted(blocks: Blocks, before, after):
    """Extend the line from `before` to `after`, (m, 2) each, N·s, until the first contact reaches a bound of its cone.

    Returns the impulses at that point, (m, 2), N·s, after one sweep.
    """
    length = LONGEST_DRIFT
    for i in range(after.shape[0]):
        mu, p_n, p_t = blocks.mu[i], after[i, 0], after[i, 1]
        d_n, d_t = p_n - before[i, 0], p_t - before[i, 1]
        for room, rate in ((p_n, d_n), (mu * p_n - p_t, mu * d_n - d_t), (mu * p_n + p_t, mu * d_n + d_t)):
            # A slipping contact moves along its bound. Only rounding takes it off the bound, which does not count.
            if rate < -1e-9 * (abs(d_n) + abs(d_t)) and room > 1e-12 * p_n:
                length = min(length, room / -rate)
    return _swept(blocks, after + length * (after - before), 1)


@njit(cache=True)
def _shown(blocks: Blocks, impulse):
    """Return the start of a proximal step from impulses c, (m, 2), N·s: (states, λ, u, q) at t = 1.

    states, (m,): each contact's state is the bound to which the natural map (`metrics.residual`) projects it. λ, (m,
    2), N·s: c, moved to the bounds of the states. u, (m, 2), m/s: the velocities of λ, changed so that they satisfy the
    conditions of the states. q, (m, 2), m/s: this change.
    """
    u, x, q = np.empty_like(impulse), impulse.copy(), np.empty_like(impulse)
    states = np.empty(impulse.shape[0], np.int64)
    velocities(blocks, impulse, u)
    for i in range(impulse.shape[0]):
        mu = blocks.mu[i]
        bound = mu * impulse[i, 0]
        free_t = impulse[i, 1] - u[i, 1] / blocks.diagonal[i, 3]
        # With μ = 0 a contact counts as slipping up, which means λ_t = 0, and never changes its direction of slip.
        state = SLIP_UP if free_t > bound or mu == 0.0 else SLIP_DOWN if free_t < -bound else STICK
        if impulse[i, 0] - u[i, 0] / blocks.diagonal[i, 0] <= 0.0:
            state = OPEN
            x[i, 0] = 0.0
            x[i, 1] = 0.0
        elif state != STICK:
            x[i, 1] = bound if state == SLIP_UP else -bound
        states[i] = state
    velocities(blocks, x, q)
    for i in range(impulse.shape[0]):
        before_n, before_t = q[i, 0], q[i, 1]
        u[i, 0] = max(before_n, 0.0) if states[i] == OPEN else 0.0
        u[i, 1] = before_t
        if states[i] == STICK:
            u[i, 1] = 0.0
        elif states[i] == SLIP_UP:
            u[i, 1] = min(before_t, 0.0)
        elif states[i] == SLIP_DOWN:
            u[i, 1] = max(before_t, 0.0)
        q[i, 0] = u[i, 0] - before_n
        q[i, 1] = u[i, 1] - before_t
    return states, x, u, q


def _step(problem: ContactProblem, blocks: Blocks, impulse: np.ndarray, epsilon: float, limit: int):
    """Do a proximal step: solve the problem with ε diag(A) (λ − c) added to its velocities.

    impulse: c, (m, 2), N·s, in the friction cone. limit: largest number of pivots and factorisations. Returns (λ, or
    None if the step is abandoned; number of pivots; number of factorisations).
    """
    states, x, u, q = _shown(blocks, impulse)
    reached, pivots, factorizations = follow(problem, epsilon, states, x, u, q, limit)
    return x if reached else None, pivots, factorizations
