"""Exact solutions of the contact problem with friction, where sweeps do not come to one: Lemke's pivots.

Why sweeps do not. A pile has more impulses than it needs (it is hyperstatic): λ may move along the null space of
A = J M⁻¹ Jᵀ at no change of the velocities. While a pile settles, sweeps let λ drift there, slowly and steadily, until
some row reaches its bound: a contact opens or starts to slip. With that row at its bound the remaining problem, which
with sliding friction is neither symmetric nor monotone, may have a mode that sweeps make grow instead of decay: the
residual jumps, and the drift starts anew elsewhere. So θ stands on plateaus between jumps for 100,000s of sweeps.

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

from deep_contact.physics import errors
from deep_contact.physics.convergence import ConvergenceRecord
from deep_contact.physics.engine import ContactSolution, solve
from deep_contact.physics.lcp import ContactProblem, contact_problem
from deep_contact.physics.methods import PGS, NesterovPGS
from deep_contact.state import State

OPEN, STICK, SLIP_UP, SLIP_DOWN = range(4)
"""States of a contact: λ = 0; u = 0; u_n = 0 and λ_t = μ λ_n, where u_t <= 0; λ_t = −μ λ_n, where u_t >= 0."""

FIRST_EPSILON, LEAST_EPSILON, LARGEST_EPSILON = 1e-4, 1e-7, 0.1
"""ε to start with, and its bounds, in diagonals of A."""

MOST_PIVOTS, MOST_TURNS = 120, 30
"""A step is given up after so many pivots, or so many with t growing: a larger ε is cheaper than a long path."""

NUDGE = 1e-9
"""Velocity, m/s, by which contacts part or slip where a path starts, so that they do not all change at once."""


class ExactSolution(NamedTuple):
    """What `solve_exactly` found.

    | field          | meaning                                                               | unit |
    |----------------|-----------------------------------------------------------------------|------|
    | solution       | `ContactSolution`; its record has the status, and no sweeps           |      |
    | residual       | `errors.residual` of the solution                                     | m/s  |
    | converged      | whether that is within the residual asked for                         |      |
    | factorizations | proximal steps, each of which factorises a matrix once                |      |
    | pivots         | changes of a contact's state, over all steps                          |      |
    """

    solution: ContactSolution
    residual: float
    converged: bool
    factorizations: int
    pivots: int


def solve_exactly(
    state: State,
    normal_start: np.ndarray | None = None,
    tangent_start: np.ndarray | None = None,
    *,
    residual: float = 1e-8,
    most_pivots: int = 20_000,
) -> ExactSolution:
    """A solution of the state's contact problem to `errors.residual` <= residual, m/s, where one is found.

    normal_start, tangent_start: impulses to start from, (m,) each, N·s; by default what 3,000 sweeps of NesterovPGS
    make of those that the state holds as its start. most_pivots: it ends after so many pivots and factorisations
    together; the solution of least residual so far is returned, in the friction cone, and `converged` says how it went.
    The same arguments give the same solution. See the module on the method, its costs and where it fails.
    Raises ValueError if the contacts have not been found, and on arguments that do not hold together.
    """
    problem = contact_problem(state)
    if isinstance(residual, bool) or not np.isscalar(residual) or not (np.isfinite(residual) and residual > 0):
        raise ValueError(f"residual: expected a finite number > 0, got {residual!r}")
    if isinstance(most_pivots, bool) or not isinstance(most_pivots, (int, np.integer)) or most_pivots < 0:
        raise ValueError(f"most_pivots: expected an integer >= 0, got {most_pivots!r}")
    solution = _admissible(state, _start(state, normal_start, tangent_start))
    best, least = solution, errors.residual(state, solution)
    epsilon, factorizations, pivots = FIRST_EPSILON, 0, 0
    while least > residual and pivots + factorizations < most_pivots:
        limit = min(MOST_PIVOTS, most_pivots - pivots - factorizations)
        impulse = np.column_stack([solution.normal_impulses, solution.tangent_impulses]).ravel()
        found, done = _proximal_step(problem, state.world.friction, impulse, epsilon, limit)
        factorizations, pivots = factorizations + 1, pivots + done
        if found is None:
            # From where it stands the path leads nowhere: sweeps move on, and a larger ε makes the next one shorter.
            epsilon, sweeps = min(LARGEST_EPSILON, 4 * epsilon), 200
        else:
            impulse, sweeps = found, 1
            epsilon = max(LEAST_EPSILON, epsilon / (5 if done <= 10 else 2 if done <= 25 else 1))
        swept = solve(state, PGS(sweeps=sweeps, tolerance=None), *_in_cone(state, impulse[::2], impulse[1::2]))
        solution = _admissible(state, swept)
        wrong = errors.residual(state, solution)
        if wrong < least:
            best, least = solution, wrong
    converged = bool(least <= residual)
    status = "no_contacts" if state.contacts.count == 0 else "converged" if converged else "max_sweeps"
    best = best._replace(record=ConvergenceRecord(np.empty(0), 0, status))
    return ExactSolution(best, least, converged, factorizations, pivots)


def _start(state: State, normal, tangent) -> ContactSolution:
    """The solution that the given impulses are, or that NesterovPGS finds if there are none."""
    contacts = state.contacts
    if normal is None and tangent is None:
        return solve(state, NesterovPGS(sweeps=3000, tolerance=None), contacts.normal_start, contacts.tangent_start)
    start = []
    for name, value in (("normal_start", normal), ("tangent_start", tangent)):
        array = np.array(np.nan if value is None else value, dtype=np.float64)
        if array.shape != (contacts.count,) or not np.isfinite(array).all():
            got = "None" if value is None else f"shape {array.shape}: {value}"
            raise ValueError(f"{name}: expected {contacts.count} finite numbers, one a contact, got {got}")
        start.append(array)
    return solve(state, PGS(sweeps=0), *_in_cone(state, *start))


def _in_cone(state: State, normal: np.ndarray, tangent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The impulses with λ_n cut to 0 and above, then λ_t to ±μ λ_n."""
    normal = np.maximum(normal, 0.0)
    return normal, np.clip(tangent, -state.world.friction * normal, state.world.friction * normal)


def _admissible(state: State, solution: ContactSolution) -> ContactSolution:
    """The solution with its impulses in the cone, which those of a sweep leave by what λ_n fell in it."""
    return solve(state, PGS(sweeps=0), *_in_cone(state, solution.normal_impulses, solution.tangent_impulses))


def _proximal_step(problem: ContactProblem, friction: float, impulse: np.ndarray, epsilon: float, limit: int):
    """Solve the contact problem with ε diag(A) (λ − c) added to its velocities. Returns (λ or None, pivots).

    c: `impulse`, (2 m,), as are λ and all vectors here, put on the bounds of its states. None: given up.
    """
    A, diagonal = problem.A, problem.A.diagonal()
    states = _states(impulse, A @ impulse + problem.b, diagonal, friction)
    x = _on_bounds(states, impulse, friction)
    before = A @ x + problem.b
    u = _complementary(states, before)
    q = u - before
    A = A + sparse.diags_array(epsilon * diagonal, format="csr")
    rows = _Rows(A, -q, friction)
    try:
        system = _ChangingSystem(*rows.all(states), most_changes=2 * limit)
    except RuntimeError:  # exactly singular
        return None, 0
    t, sign, last, previous, pivots, turns = 1.0, -1.0, -1, OPEN, 0, 0
    while True:
        # How λ and u change as t grows.
        dx = system.solve()
        du = A @ dx + q
        if not np.isfinite(du).all():
            return None, pivots
        if pivots:
            # The contact has to go on into its new state, whichever way that makes t go.
            sign = 1.0 if _slack(states[last], previous, friction, dx, du, last) > 0 else -1.0
            turns += sign > 0
        length, contact, new = _first_change(states, friction, x, u, dx, du, sign, last, previous)
        if sign < 0 and length >= t:
            return x - t * dx, pivots
        if contact < 0 or pivots == limit or turns > MOST_TURNS:
            return None, pivots
        x, u, t, pivots = x + sign * length * dx, u + sign * length * du, t + sign * length, pivots + 1
        last, previous = contact, states[contact]
        if previous == OPEN:
            new = SLIP_UP if u[2 * contact + 1] < 0 else SLIP_DOWN
        states[contact] = new
        for row in (2 * contact, 2 * contact + 1):
            system.change(row, *rows.one(row, new))


def _states(impulse: np.ndarray, u: np.ndarray, diagonal: np.ndarray, friction: float) -> np.ndarray:
    """The states that impulses and velocities show: where the natural map (`errors.residual`) projects, (m,)."""
    free = impulse - u / diagonal
    bound = friction * impulse[::2]
    states = np.where(free[1::2] > bound, SLIP_UP, np.where(free[1::2] < -bound, SLIP_DOWN, STICK))
    if friction == 0:
        states[:] = SLIP_UP  # which says λ_t = 0, and is never left for another way
    states[(free[::2] <= 0) | (impulse[::2] <= 0)] = OPEN
    return states


def _on_bounds(states: np.ndarray, impulse: np.ndarray, friction: float) -> np.ndarray:
    """The impulses that satisfy what the states say of them, nearest in λ_t."""
    normal = np.where(states == OPEN, 0.0, impulse[::2])
    inside = (1 - 1e-9) * friction * normal  # A contact that sticks on the very edge would slip at once.
    tangent = np.select(
        [states == STICK, states == SLIP_UP, states == SLIP_DOWN],
        [np.clip(impulse[1::2], -inside, inside), friction * normal, -friction * normal],
        0.0,
    )
    return np.column_stack([normal, tangent]).ravel()


def _complementary(states: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The velocities that satisfy what the states say of them, as near as `NUDGE` allows."""
    normal, tangent = u[::2], u[1::2]
    normal = np.where(states == OPEN, np.maximum(normal, NUDGE), 0.0)
    tangent = np.select(
        [states == STICK, states == SLIP_UP, states == SLIP_DOWN],
        [0.0, np.minimum(tangent, -NUDGE), np.maximum(tangent, NUDGE)],
        tangent,
    )
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
def _first_change(states, friction, x, u, dx, du, sign, last, previous):
    """The first contact to leave its state along sign (dx, du). Returns (length, contact or −1, its new state).

    A contact that closes is said to slip up: which way it slips is told by u_t there. The contact that changed last
    does not go back where it came from: it stands on that bound, and would by rounding.
    """
    least, contact, new = np.inf, -1, OPEN
    for i in range(states.shape[0]):
        for to in range(4):
            if states[i] == OPEN:
                leads = to == SLIP_UP and i != last
            elif states[i] == STICK:
                leads = to >= SLIP_UP
            else:
                leads = to == OPEN or (to == STICK and friction > 0)
            if not leads or (i == last and to == previous):
                continue
            rate = sign * _slack(states[i], to, friction, dx, du, i)
            if rate < 0:
                length = max(_slack(states[i], to, friction, x, u, i), 0.0) / -rate
                if length < least:
                    least, contact, new = length, i, to
    return least, contact, new


class _Rows:
    """The equations that states are: B x = y, whose rows are those of A where u is 0, and bounds of λ elsewhere.

    Bounds are scaled by the diagonal of A, so that all rows are of one size whatever the masses.
    """

    def __init__(self, A, right: np.ndarray, friction: float):
        self.A, self.right, self.friction = A, right, friction
        self.scale = A.diagonal()

    def all(self, states: np.ndarray):
        """(B, sparse (CSR); y)."""
        still = np.column_stack([states != OPEN, states == STICK]).ravel()
        slips = 2 * np.flatnonzero(states >= SLIP_UP) + 1
        ratio = np.where(states[slips // 2] == SLIP_UP, -self.friction, self.friction)
        edges = sparse.coo_array((ratio * self.scale[slips], (slips, slips - 1)), shape=self.A.shape)
        bounds = sparse.diags_array(np.where(still, 0.0, self.scale), format="csr")
        B = sparse.diags_array(still.astype(np.float64)) @ self.A + bounds + edges.tocsr()
        return B, np.where(still, self.right, 0.0)

    def one(self, row: int, state: int):
        """(columns, entries, y) of a row, whose contact is in that state."""
        if state != OPEN and (row % 2 == 0 or state == STICK):
            inside = slice(self.A.indptr[row], self.A.indptr[row + 1])
            return self.A.indices[inside], self.A.data[inside], self.right[row]
        if row % 2 == 0 or state == OPEN:
            return np.array([row]), self.scale[[row]], 0.0
        ratio = -self.friction if state == SLIP_UP else self.friction
        return np.array([row - 1, row]), self.scale[row] * np.array([ratio, 1.0]), 0.0


class _ChangingSystem:
    """B x = y, of which rows are changed: B is factorised once, and solved by Woodbury's formula from then on.

    With C = B⁻¹ E the columns of the inverse for the changed rows and D what was added to these rows, the solution is
    x = z − C (I + D C)⁻¹ D z, z = B⁻¹ y. Raises RuntimeError where B is exactly singular.
    """

    def __init__(self, B, y: np.ndarray, *, most_changes: int):
        self.B, self.y = B, y
        # The rows of B as columns: pivots are chosen within one row, whose entries are of one kind.
        self.factors = splu(
            B.T, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
        )
        self.z = self._inverse(y)
        self.changed: list[int] = []
        self.columns = np.empty((most_changes, y.size))
        self.added = np.zeros((most_changes, y.size))
        self.product = np.empty((most_changes, most_changes))
        self.right = np.zeros(most_changes)

    def _inverse(self, y: np.ndarray) -> np.ndarray:
        return self.factors.solve(y, trans="T")

    def change(self, row: int, columns: np.ndarray, entries: np.ndarray, right: float) -> None:
        """Give the row new entries and a new right-hand side."""
        inside = slice(self.B.indptr[row], self.B.indptr[row + 1])
        k = self.changed.index(row) if row in self.changed else len(self.changed)
        self.added[k] = 0.0
        self.added[k, columns] = entries
        self.added[k, self.B.indices[inside]] -= self.B.data[inside]
        self.right[k] = right - self.y[row]
        if k == len(self.changed):
            if not self.added[k].any():
                return
            self.changed.append(row)
            unit = np.zeros(self.y.size)
            unit[row] = 1.0
            self.columns[k] = self._inverse(unit)
            self.product[:k, k] = self.added[:k] @ self.columns[k]
        self.product[k, : len(self.changed)] = self.columns[: len(self.changed)] @ self.added[k]

    def solve(self) -> np.ndarray:
        """x, (2 m,); not finite where the matrix is singular."""
        k = len(self.changed)
        z = self.z + self.right[:k] @ self.columns[:k]
        try:
            weights = np.linalg.solve(np.eye(k) + self.product[:k, :k], self.added[:k] @ z)
        except np.linalg.LinAlgError:
            return np.full_like(z, np.nan)
        return z - weights @ self.columns[:k]
