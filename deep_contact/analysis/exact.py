"""Exact solutions of the contact problem with friction, where sweeps do not converge: by Lemke's pivots.

A pile is hyperstatic: λ may move along the null space of A = J M⁻¹ Jᵀ without a change of the velocities. Sweeps let λ
drift there until a contact opens or starts to slip. With friction the remaining problem is neither symmetric nor
monotone, and may have a mode that grows under sweeps.

A proximal step (Rockafellar 1976) adds ε diag(A) (λ − c) to the velocities, where c are the last impulses. It removes
the null space, and its fixed points are the solutions of the contact problem. Each step is solved by the parametric
form of Lemke's algorithm (Lemke 1965; Cottle, Pang and Stone 1992, sections 4.4-4.5; with friction Anitescu and Potra
1997). Every contact has a state: it is open, sticks, or slips in one direction. The impulses c, put on the bounds of
the states that they show, solve a problem whose velocities are shifted by q. The shift t q is then withdrawn, from
t = 1 to t = 0. Between two changes of a state λ is linear in t. Each change, a pivot, decides the direction in which t
goes on: with friction t may have to grow again for a while. ε decreases as long as steps are easy.

A pivot is a solve with SuperLU's factors (`proximal_path`), which costs too much for the steps of a run.

Without friction the problem is monotone, and every path leads to a solution. With friction ε may be too small against a
negative mode, so that a path turns back for good. That step is abandoned, and done again with a larger ε. The method is
for scenes of up to some 1,000 circles. If there are many solutions, the start and these constants choose one.
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
from deep_contact.state.state import State
from deep_contact.state.validation import expect, floats, integer, number
from deep_contact.stepping import metrics
from deep_contact.stepping.convergence import ConvergenceRecord
from deep_contact.stepping.problem import ContactSolution, solve, step_problem
from deep_contact.stepping.rows import projected

FIRST_EPSILON = 1e-4
"""ε of the first step."""

LEAST_EPSILON = 1e-6
"""Smallest ε. If other contacts hold the contact of a pivot, the pivot divides by a number of order ε, which costs as
many of the 16 digits as 1 / ε has."""

LARGEST_EPSILON = 0.1
"""Largest ε: a drift of λ leaves a residual of ε times that drift."""

FIRST_SWEEPS = NesterovPGS(sweeps=300, tolerance=None)
"""Sweeps before the first step, from the impulses that a state holds or that follow from its positions. More sweeps
take longer than the pivots that they save."""

EASY = 5
"""Largest number of pivots of an easy step, which divides ε by 5 for the next step."""

FAIR = 12
"""Largest number of pivots of a fair step, which halves ε for the next step."""

MOST_PIVOTS = 120
"""Largest number of pivots of a step, which is then abandoned: a larger ε is cheaper than a long path."""

MOST_IDLE = 30
"""Number of easy steps in a row without a smaller residual that lead to a restart: to sweeps, and to the first ε."""

MOST_RESTARTS = 5
"""Largest number of restarts. After them the solve ends, since rounding allows no better solution."""

SWEEPS_ELSEWHERE = 200
"""Sweeps of PGS in a restart, and from impulses from which not even the largest ε leads on."""

LONGEST_DRIFT = 1e4
"""Largest number of steps without a pivot that one step along their line may replace."""


@by_value
class ExactSolution(NamedTuple):
    """Result of `solve_exactly`.

    | field          | meaning                                                                      | unit |
    |----------------|------------------------------------------------------------------------------|------|
    | solution       | `ContactSolution`; its record has the status, and no sweeps. Without bodies  |      |
    |                | its velocities are empty                                                     |      |
    | residual       | `metrics.residual` of the solution, or `lcp.natural_residual` of a problem   | m/s  |
    | converged      | whether the residual is at most the argument `residual`                      |      |
    | factorizations | number of factorised matrices: at least one in each proximal step            |      |
    | pivots         | number of changes of a contact's state, over all steps                       |      |
    """

    solution: ContactSolution
    residual: float
    converged: bool
    factorizations: int
    pivots: int


@np.errstate(all="ignore")  # Impulses of sweeps may overflow where friction is large; their residual rejects them.
def solve_exactly(
    state: State | ContactProblem,
    normal_start: np.ndarray | None = None,
    tangent_start: np.ndarray | None = None,
    *,
    residual: float = 1e-8,
    most_pivots: int = 5_000,
) -> ExactSolution:
    """Solve a state's contact problem to `metrics.residual` <= residual, m/s, if such a solution is found.

    state: a `State` with contacts, or a `ContactProblem` with friction, whose residual is the equal
    `lcp.natural_residual`. normal_start, tangent_start: impulses to start from, (m,) each, N·s. By default the solve
    starts from the impulses that the state holds as its start (of `support` if it has no past), or from these after 300
    sweeps of NesterovPGS, whichever have the smaller residual. residual: largest residual that counts as converged,
    m/s. most_pivots: largest number of pivots and factorisations together.

    The solution with the least residual so far is returned, in the friction cone; `converged` says whether it is within
    `residual`. Equal arguments give equal solutions. See the module on the method, its costs and where it fails.
    Raises ValueError naming field and value if the state has no contacts, on a state or problem that is not valid or
    beyond `state.arrays.LIMITS`, and on arguments that do not fit each other.
    """
    number("residual", residual, above=0)
    integer("most_pivots", most_pivots)
    if isinstance(state, ContactProblem):
        problem = check_problem(state)
    elif isinstance(state, State):
        if state.contacts is None:
            raise ValueError("state.contacts: expected the contacts to have been found, got None (see dc.step)")
        state = check_limits(check_state(state))
        problem = check_problem(contact_problem(state))
    else:
        raise ValueError(f"state: expected a State or a ContactProblem, got {state!r}")
    if normal_start is not None or tangent_start is not None:
        impulse = _start_of(problem, normal_start, tangent_start)
    else:
        impulse = _start_of_state(state) if isinstance(state, State) else _start_of_problem(problem)
    impulse, factorizations, pivots = _solved(problem, impulse, residual, most_pivots)
    if isinstance(state, State):
        solution = solve(state, PGS(sweeps=0), *projected(impulse[::2], impulse[1::2], state.world.friction))
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
    """Do proximal steps from impulses in the cone, (2 m,).

    Returns the best impulses, (2 m,), the number of factorisations and the number of pivots.
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
            # The path from these impulses leads nowhere. A larger ε makes the next path shorter. Sweeps help as well,
            # but undo what earlier steps have reached, so they come last.
            sweeps = SWEEPS_ELSEWHERE if epsilon == LARGEST_EPSILON else 0
            epsilon = min(LARGEST_EPSILON, max(LEAST_EPSILON, 4 * epsilon))
        else:
            impulse, sweeps = reached, 1
            epsilon = max(LEAST_EPSILON, epsilon / (5 if done <= EASY else 2 if done <= FAIR else 1))
        impulse = _swept(blocks, impulse, sweeps)
        wrong, last = natural_residual(problem, impulse.ravel()), wrong
        if done == 0 and reached is not None and 0.9 * last < wrong < 1.1 * last:
            # Only λ changes, along a line: λ follows this line until a contact reaches a bound.
            impulse = _drifted(blocks, start, reached)
            wrong = natural_residual(problem, impulse.ravel())
        idle = 0 if done > EASY or wrong < least else idle + 1
        if wrong < least:
            best, least = impulse, wrong
        elif not np.isfinite(wrong):
            impulse = best
        if reached is not None:
            # Near the solution a sweep raises the residual more than it lowers it.
            exact = _swept(blocks, reached, 0)
            at_end = natural_residual(problem, exact.ravel())
            if at_end < least:
                best, least = exact, at_end
        if idle == MOST_IDLE:
            impulse, epsilon, idle, restarts = _swept(blocks, impulse, SWEEPS_ELSEWHERE), FIRST_EPSILON, 0, restarts + 1
    return best.ravel(), factorizations, pivots


def _start_of_problem(problem: ContactProblem) -> np.ndarray:
    """The start with the smaller residual, (2 m,): impulses of 0, or the impulses that sweeps find from them."""
    starts = np.zeros(problem.b.size), solve_problem(problem, FIRST_SWEEPS)[0]
    return min(starts, key=lambda impulse: np.nan_to_num(natural_residual(problem, impulse), nan=np.inf))


def _start_of_state(state: State) -> np.ndarray:
    """The start with the smaller residual, (2 m,): the impulses that the state holds, or these after sweeps.

    A state without a past starts from the impulses of `support`.
    """
    held = state.contacts.normal_start, state.contacts.tangent_start
    if not state.contacts.have_past:
        held = supported(state, step_problem(state))
    starts = [solve(state, solver, *held) for solver in (PGS(sweeps=0), FIRST_SWEEPS)]
    nearest = min(starts, key=lambda start: np.nan_to_num(metrics.residual(state, start), nan=np.inf))
    return np.column_stack(projected(nearest.normal_impulses, nearest.tangent_impulses, state.world.friction)).ravel()


def _start_of(problem: ContactProblem, normal, tangent) -> np.ndarray:
    """The impulses that the user passed, validated and projected onto the cone, (2 m,)."""
    start = []
    for name, value in (("normal_start", normal), ("tangent_start", tangent)):
        start.append(floats(name, value, problem.friction.shape))
        largest = np.abs(start[-1]).max(initial=0.0)
        expect(largest <= LARGEST_START, f"{name}: expected numbers up to {LARGEST_START:g} N·s, got {largest:g}")
    return np.column_stack(projected(*start, problem.friction)).ravel()


@njit(cache=True)
def _swept(blocks: Blocks, impulse, sweeps):
    """The impulses after `sweeps` sweeps of PGS, (m, 2), with λ_t clipped to ±μ λ_n.

    The clip is needed: a sweep that lowers λ_n can leave λ_t outside of the cone.
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
    """Impulses further along the line from `before` to `after`, (m, 2), where the first contact leaves its cone."""
    length = LONGEST_DRIFT
    for i in range(after.shape[0]):
        mu, p_n, p_t = blocks.mu[i], after[i, 0], after[i, 1]
        d_n, d_t = p_n - before[i, 0], p_t - before[i, 1]
        for room, rate in ((p_n, d_n), (mu * p_n - p_t, mu * d_n - d_t), (mu * p_n + p_t, mu * d_n + d_t)):
            # A contact that slips stays on its bound, but for rounding.
            if rate < -1e-9 * (abs(d_n) + abs(d_t)) and room > 1e-12 * p_n:
                length = min(length, room / -rate)
    return _swept(blocks, after + length * (after - before), 1)


@njit(cache=True)
def _shown(blocks: Blocks, impulse):
    """The start of a step from impulses c: the states of the contacts, and λ, u and q at t = 1.

    The state of a contact is the bound to which the natural map (`metrics.residual`) projects it. λ is c, put on the
    bounds of the states. u are the velocities of λ, shifted by q so that they satisfy the conditions of the states.
    Returns (states (m,), λ, u, q, (m, 2) each).
    """
    u, x, q = np.empty_like(impulse), impulse.copy(), np.empty_like(impulse)
    states = np.empty(impulse.shape[0], np.int64)
    velocities(blocks, impulse, u)
    for i in range(impulse.shape[0]):
        mu = blocks.mu[i]
        bound = mu * impulse[i, 0]
        free_t = impulse[i, 1] - u[i, 1] / blocks.diagonal[i, 3]
        # A contact without friction counts as slipping up, which means λ_t = 0, and never changes its direction.
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
    """A proximal step: solve the problem with ε diag(A) (λ − c) added to its velocities, c being the impulses, (m, 2).

    c lies in the cone. Returns (λ, or None if the step is abandoned, number of pivots, number of factorisations).
    """
    states, x, u, q = _shown(blocks, impulse)
    reached, pivots, factorizations = follow(problem, epsilon, states, x, u, q, limit)
    return x if reached else None, pivots, factorizations
