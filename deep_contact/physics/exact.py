"""Exact solutions of the contact problem with friction, where sweeps do not come to one: Lemke's pivots.

Why sweeps do not. A pile has more impulses than it needs (it is hyperstatic): λ may move along the null space of
A = J M⁻¹ Jᵀ at no change of the velocities. While a pile settles, sweeps let λ drift there, slowly and steadily, until
some row reaches its bound: a contact opens or starts to slip. With that row at its bound the remaining problem, which
with sliding friction is neither symmetric nor monotone, may have a mode that sweeps make grow instead of decay: the
residual jumps, and the drift starts anew elsewhere. After 100,000 sweeps no method is at an end (Figure 6.1).

What is done instead. A proximal step (Rockafellar 1976) adds ε diag(A) (λ − c) to the velocities, c being the last
impulses: it takes the null space away and has the solutions of the contact problem as its fixed points. Each step is
solved exactly by the parametric form of Lemke's algorithm (Lemke 1965; Cottle, Pang and Stone 1992, sections 4.4-4.5;
for contact with friction see Anitescu and Potra 1997). Every contact is open, sticks or slips one way. c, put on the
bounds of the states that it shows, solves a problem whose velocities are shifted by q; the shift is then withdrawn,
t q from t = 1 to 0. Between two changes of a state λ is linear in t, and each change (a pivot) tells which way t goes
on: with friction it may have to grow again for a while, where a descent would be stuck. ε falls while steps are easy.

What it costs. A factorisation of a sparse matrix of 2 m rows a step, and a solve with it and some dense vectors for
every pivot: it is for references, not for the steps of a run.

Where it fails. A proximal step has a solution and the path finds it where the problem is monotone, as it is without
friction. With friction there is no such guarantee: ε may be too small against a negative mode, and a path can turn
back for good. It is then given up and taken up elsewhere, with a larger ε, which has sufficed in piles of 1,000 so
far and is no proof. Where solutions are many, which is found depends on the path, so on the start and these constants.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy import sparse
from scipy.sparse.linalg import splu

from deep_contact.physics import metrics
from deep_contact.physics.contact_solver import projected
from deep_contact.physics.convergence import ConvergenceRecord
from deep_contact.physics.engine import ContactSolution, solve
from deep_contact.physics.lcp import ContactProblem, contact_problem
from deep_contact.physics.solvers import PGS, NesterovPGS
from deep_contact.state import LARGEST_START, State
from deep_contact.validation import integer, number

OPEN, STICK, SLIP_UP, SLIP_DOWN = range(4)
"""States of a contact: λ = 0; u = 0; u_n = 0 and λ_t = μ λ_n, where u_t <= 0; λ_t = −μ λ_n, where u_t >= 0."""

FIRST_EPSILON, LEAST_EPSILON, LARGEST_EPSILON = 1e-4, 1e-9, 0.1
"""ε to start with, and its bounds. A drift of λ costs a residual of ε times it: the least ε lets it reach its end."""

FIRST_SWEEPS = NesterovPGS(sweeps=3000, tolerance=None)
"""What is done to the impulses that a state holds, before the first step."""

EASY, FAIR = 10, 25
"""Pivots up to which a step lets the next one have a fifth, or a half, of its ε."""

MOST_PIVOTS, MOST_TURNS = 120, 30
"""A step is given up after so many pivots, or so many with t growing: a larger ε is cheaper than a long path."""

MOST_IDLE = 100
"""It ends after so many easy steps in a row without a smaller residual: rounding lets it no further."""


class ExactSolution(NamedTuple):
    """What `solve_exactly` found.

    | field          | meaning                                                               | unit |
    |----------------|-----------------------------------------------------------------------|------|
    | solution       | `ContactSolution`; its record has the status, and no sweeps           |      |
    | residual       | `metrics.residual` of the solution                                     | m/s  |
    | converged      | whether that is within the residual asked for                         |      |
    | factorizations | proximal steps, each of which factorises a matrix once                |      |
    | pivots         | changes of a contact's state, over all steps                          |      |
    """

    solution: ContactSolution
    residual: float
    converged: bool
    factorizations: int
    pivots: int


@np.errstate(all="ignore")  # Sweeps may grow beyond all numbers where friction is large; the residual refuses them.
def solve_exactly(
    state: State,
    normal_start: np.ndarray | None = None,
    tangent_start: np.ndarray | None = None,
    *,
    residual: float = 1e-8,
    most_pivots: int = 20_000,
) -> ExactSolution:
    """A solution of the state's contact problem to `metrics.residual` <= residual, m/s, where one is found.

    normal_start, tangent_start: impulses to start from, (m,) each, N·s; by default those that the state holds as its
    start, or what 3,000 sweeps of NesterovPGS make of them where that has the smaller residual. most_pivots: it ends
    after so many pivots and factorisations together; the solution of least residual so far is returned, in the friction
    cone, and `converged` says how it went.
    The same arguments give the same solution. See the module on the method, its costs and where it fails.
    Raises ValueError if the contacts have not been found, and on arguments that do not hold together.
    """
    problem = contact_problem(state)
    number("residual", residual, above=0)
    integer("most_pivots", most_pivots)
    solution = _admissible(state, _start(state, normal_start, tangent_start))
    best, least = solution, metrics.residual(state, solution)
    epsilon, factorizations, pivots, idle = FIRST_EPSILON, 0, 0, 0
    while least > residual and pivots + factorizations < most_pivots and idle < MOST_IDLE:
        limit = min(MOST_PIVOTS, most_pivots - pivots - factorizations)
        impulse = np.column_stack([solution.normal_impulses, solution.tangent_impulses]).ravel()
        found, done = _proximal_step(problem, state.world.friction, impulse, epsilon, limit)
        factorizations, pivots = factorizations + 1, pivots + done
        if found is None:
            # From where it stands the path leads nowhere: sweeps move on, and a larger ε makes the next one shorter.
            epsilon, sweeps = min(LARGEST_EPSILON, 4 * epsilon), 200
        else:
            impulse, sweeps = found, 1
            epsilon = max(LEAST_EPSILON, epsilon / (5 if done <= EASY else 2 if done <= FAIR else 1))
        swept = solve(
            state, PGS(sweeps=sweeps, tolerance=None), *projected(impulse[::2], impulse[1::2], state.world.friction)
        )
        solution = _admissible(state, swept)
        wrong = metrics.residual(state, solution)
        idle = 0 if done > EASY or wrong < least else idle + 1
        if wrong < least:
            best, least = solution, wrong
        elif not np.isfinite(wrong):
            solution = best
    converged = bool(least <= residual)
    status = "no_contacts" if state.contacts.count == 0 else "converged" if converged else "max_sweeps"
    best = best._replace(record=ConvergenceRecord(np.empty(0), 0, status))
    return ExactSolution(best, least, converged, factorizations, pivots)


def _start(state: State, normal, tangent) -> ContactSolution:
    """The solution that the given impulses are; without, the better of what the state holds and what sweeps find."""
    contacts = state.contacts
    if normal is None and tangent is None:
        held = contacts.normal_start, contacts.tangent_start
        plain, swept = (solve(state, solver, *held) for solver in (PGS(sweeps=0), FIRST_SWEEPS))
        return swept if metrics.residual(state, swept) < metrics.residual(state, plain) else plain
    start = []
    for name, value in (("normal_start", normal), ("tangent_start", tangent)):
        array = np.array(np.nan if value is None else value, dtype=np.float64)
        bad = array[~(np.abs(array) <= LARGEST_START)]
        if array.shape != (contacts.count,) or bad.size:
            got = "None" if value is None else f"shape {array.shape}" if not bad.size else f"{bad[0]}"
            raise ValueError(
                f"{name}: expected {contacts.count} numbers, one a contact, up to {LARGEST_START:g} N·s, got {got}"
            )
        start.append(array)
    return solve(state, PGS(sweeps=0), *projected(*start, state.world.friction))


def _admissible(state: State, solution: ContactSolution) -> ContactSolution:
    """The solution with its impulses in the cone, which those of a sweep leave by what λ_n fell in it."""
    return solve(
        state, PGS(sweeps=0), *projected(solution.normal_impulses, solution.tangent_impulses, state.world.friction)
    )


def _proximal_step(problem: ContactProblem, friction: float, impulse: np.ndarray, epsilon: float, limit: int):
    """Solve the contact problem with ε diag(A) (λ − c) added to its velocities. Returns (λ or None, pivots).

    c: `impulse`, in the cone, put on the bounds of the states it shows; (2 m,), as all vectors here. None: given up.
    """
    A, diagonal = problem.A, problem.A.diagonal()
    states = _states(impulse, A @ impulse + problem.b, diagonal, friction)
    x = _on_bounds(states, impulse, friction)
    before = A @ x + problem.b
    u = _complementary(states, before)
    q = u - before
    A = A + sparse.diags_array(epsilon * diagonal, format="csr")
    t, sign, last, previous, pivots, turns = 1.0, -1.0, -1, OPEN, 0, 0
    try:
        system = _System(A, -q, friction, states, most_changes=2 * limit)
        while True:
            # How λ and u change as t grows.
            dx = system.solve()
            du = A @ dx + q
            if pivots:
                # The contact has to go on into its new state, whichever way that makes t go.
                sign = 1.0 if _slack(states[last], previous, friction, dx, du, last) > 0 else -1.0
                turns += sign > 0
            length, contact, new = _first_change(states, friction, x, u, dx, du, sign)
            if sign < 0 and length >= t and np.isfinite(du).all():
                return x - t * dx, pivots
            if contact < 0 or pivots == limit or turns > MOST_TURNS:
                return None, pivots
            x, u, t, pivots = x + sign * length * dx, u + sign * length * du, t + sign * length, pivots + 1
            last, previous = contact, states[contact]
            states[contact] = new if previous != OPEN else SLIP_UP if u[2 * contact + 1] < 0 else SLIP_DOWN
            system.change(contact, states[contact])
    except np.linalg.LinAlgError:
        return None, pivots


def _states(impulse: np.ndarray, u: np.ndarray, diagonal: np.ndarray, friction: float) -> np.ndarray:
    """The states that impulses and velocities show: where the natural map (`metrics.residual`) projects, (m,)."""
    free = impulse - u / diagonal
    bound = friction * impulse[::2]
    states = np.where(free[1::2] > bound, SLIP_UP, np.where(free[1::2] < -bound, SLIP_DOWN, STICK))
    if friction == 0:
        states[:] = SLIP_UP  # which says λ_t = 0, and is never left for another way
    states[free[::2] <= 0] = OPEN
    return states


def _on_bounds(states: np.ndarray, impulse: np.ndarray, friction: float) -> np.ndarray:
    """The impulses, in the cone, made to satisfy what the states say of them, nearest in each row."""
    normal = np.where(states == OPEN, 0.0, impulse[::2])
    bound = friction * normal
    tangent = np.choose(states, [0.0, impulse[1::2], bound, -bound])
    return np.column_stack([normal, tangent]).ravel()


def _complementary(states: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The velocities that satisfy what the states say of them, nearest in each row."""
    normal = np.where(states == OPEN, np.maximum(u[::2], 0.0), 0.0)
    tangent = u[1::2]
    tangent = np.choose(states, [tangent, 0.0, np.minimum(tangent, 0.0), np.maximum(tangent, 0.0)])
    return np.column_stack([normal, tangent]).ravel()


@njit(cache=True)
def _slack(state, to, friction, x, u, contact):
    """What must stay >= 0 for the contact not to go from its state to another. Linear, so its rate is that of x, u."""
    n, t = 2 * contact, 2 * contact + 1
    if state == OPEN:
        return u[n]
    if state == STICK:
        return friction * x[n] - x[t] if to == SLIP_UP else friction * x[n] + x[t]
    if to == OPEN:
        return x[n]
    return -u[t] if state == SLIP_UP else u[t]


@njit(cache=True)
def _first_change(states, friction, x, u, dx, du, sign):
    """The first contact to leave its state along sign (dx, du). Returns (length, contact or −1, its new state).

    A contact that closes is said to slip up: which way it slips is told by u_t there. The contact that changed last
    does not go straight back, though it stands on that bound: the sign is such that it leaves it.
    """
    least, contact, new = np.inf, -1, OPEN
    for i in range(states.shape[0]):
        for to in range(4):
            if states[i] == OPEN:
                leads = to == SLIP_UP
            elif states[i] == STICK:
                leads = to >= SLIP_UP
            else:
                leads = to == OPEN or (to == STICK and friction > 0)
            rate = sign * _slack(states[i], to, friction, dx, du, i) if leads else 0.0
            if rate < 0:
                length = max(_slack(states[i], to, friction, x, u, i), 0.0) / -rate
                if length < least:
                    least, contact, new = length, i, to
    return least, contact, new


class _System:
    """The equations B x = y that states are: rows of A λ = y where u is 0, and bounds of λ elsewhere.

    B is factorised once; rows that change are dealt with by Woodbury's formula. With C = B⁻¹ E the columns of the
    inverse for the changed rows and D what was added to these rows, x = z − C (I + D C)⁻¹ D z, where z = B⁻¹ y.
    Bounds are scaled by the diagonal of A, so that all rows are of one size whatever the masses.
    """

    def __init__(self, A, right: np.ndarray, friction: float, states: np.ndarray, *, most_changes: int):
        self.A, self.right, self.friction, self.scale = A, right, friction, A.diagonal()
        still = np.column_stack([states != OPEN, states == STICK]).ravel()
        slips = 2 * np.flatnonzero(states >= SLIP_UP) + 1
        ratio = np.where(states[slips // 2] == SLIP_UP, -friction, friction)
        edges = sparse.coo_array((ratio * self.scale[slips], (slips, slips - 1)), shape=A.shape)
        bounds = sparse.diags_array(np.where(still, 0.0, self.scale), format="csr")
        self.B = sparse.diags_array(still.astype(np.float64)) @ A + bounds + edges.tocsr()
        self.y = np.where(still, right, 0.0)
        try:
            # The rows of B as columns: pivots are chosen within one row, whose entries are of one kind.
            self.factors = splu(
                self.B.T, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            raise np.linalg.LinAlgError(str(error)) from error
        self.z = self.factors.solve(self.y, trans="T")
        self.changed: list[int] = []
        self.columns = np.empty((most_changes, self.y.size))
        self.added = np.zeros((most_changes, self.y.size))
        self.added_columns = np.empty((most_changes, most_changes))
        self.right_added = np.zeros(most_changes)

    def change(self, contact: int, state: int) -> None:
        """Let the contact have another state."""
        for row in (2 * contact, 2 * contact + 1):
            self._change(row, *self._row(row, state))

    def _row(self, row: int, state: int):
        """(columns, entries, y) of a row whose contact is in that state."""
        if state != OPEN and (row % 2 == 0 or state == STICK):
            inside = slice(self.A.indptr[row], self.A.indptr[row + 1])
            return self.A.indices[inside], self.A.data[inside], self.right[row]
        if row % 2 == 0 or state == OPEN:
            return np.array([row]), self.scale[[row]], 0.0
        ratio = -self.friction if state == SLIP_UP else self.friction
        return np.array([row - 1, row]), self.scale[row] * np.array([ratio, 1.0]), 0.0

    def _change(self, row: int, columns: np.ndarray, entries: np.ndarray, right: float) -> None:
        count = len(self.changed)
        k = self.changed.index(row) if row in self.changed else count
        inside = slice(self.B.indptr[row], self.B.indptr[row + 1])
        self.added[k] = 0.0
        self.added[k, columns] = entries
        self.added[k, self.B.indices[inside]] -= self.B.data[inside]
        self.right_added[k] = right - self.y[row]
        if k == count:
            if not self.added[k].any() and self.right_added[k] == 0.0:
                return  # A normal row stays as it is where its contact begins or ends to slip.
            self.changed.append(row)
            unit = np.zeros(self.y.size)
            unit[row] = 1.0
            self.columns[k] = self.factors.solve(unit, trans="T")
            self.added_columns[:k, k] = self.added[:k] @ self.columns[k]
        self.added_columns[k, : len(self.changed)] = self.columns[: len(self.changed)] @ self.added[k]

    def solve(self) -> np.ndarray:
        """x, (2 m,). Raises LinAlgError where B is singular."""
        k = len(self.changed)
        z = self.z + self.right_added[:k] @ self.columns[:k]
        weights = np.linalg.solve(np.eye(k) + self.added_columns[:k, :k], self.added[:k] @ z)
        return z - weights @ self.columns[:k]
