"""Lemke's algorithm for a proximal step of `exact`: the path of the impulses while the shift t q falls to 0.

As long as no contact changes its state, the derivative dλ of λ by t satisfies one linear equation for each row i. If
the row's velocity stays 0, the equation is row i of (A + ε diag(A)) dλ = −q. If λ stays on a bound, the equation is
that of the bound. When a contact changes its state, one or two equations are replaced. Each replacement changes the
solution by a multiple of a column of the inverse (Sherman and Morrison 1950). SuperLU therefore factorises the matrix
only once a step, and again after `REFRESH` replaced equations.

Tests: tests/analysis/test_exact.py
"""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from deep_contact.analysis.lcp import ContactProblem
from deep_contact.compiled import njit

OPEN, STICK, SLIP_UP, SLIP_DOWN = range(4)
"""States of a contact with velocity u. OPEN: λ = 0. STICK: u = 0. SLIP_UP: u_n = 0, λ_t = μ λ_n and u_t <= 0.
SLIP_DOWN: u_n = 0, λ_t = −μ λ_n and u_t >= 0."""

AT_START, AT_END, NOWHERE = -1, -2, -3
"""Values that `_next_pivot` takes or returns in place of a contact. AT_START: no contact has changed its state yet.
AT_END: t = 0 is reached before another contact changes. NOWHERE: the path does not lead to t = 0."""

MOST_TURNS = 30
"""Largest number of pivots of a step after which t grows. With more, the step is abandoned, because a step with a
larger ε is cheaper than a long path."""

REFRESH = 48
"""Number of replaced equations after which the matrix is factorised anew. With more, the sum over the replacements
costs more than a factorisation."""


def follow(problem: ContactProblem, epsilon: float, states, x, u, q, limit: int) -> tuple[bool, int, int]:
    """Reduce the shift t q of the velocities from t = 1 to t = 0.

    states, (m,), impulses x = λ, (m, 2), N·s, and velocities u, (m, 2), m/s, are those at t = 1, and change in place.
    q: (m, 2), m/s. The path is abandoned after `limit` pivots and factorisations. Returns (whether t = 0 is reached,
    number of pivots, number of factorisations).
    """
    equations = Equations(problem, epsilon, states, q)
    t, contact, previous, pivots, turns = 1.0, AT_START, OPEN, 0, 0
    while True:
        rates = equations.rates()
        t, contact, previous, grows = _next_pivot(states, problem.friction, (x, u), rates, t, contact, previous)
        turns += grows
        if contact < 0 or pivots + equations.factorizations > limit or turns > MOST_TURNS:
            return contact == AT_END, pivots, equations.factorizations
        equations.change(contact, previous)
        pivots += 1


class Equations:
    """The linear equations for dλ, the derivative of the impulses by t, and their solution.

    states: states of the contacts, (m,). The path changes them one at a time. The equation of a bound is multiplied by
    the row's element of A's diagonal, so that all equations have coefficients of the same order. If the equations are
    singular, dλ is NaN.
    """

    def __init__(self, problem: ContactProblem, epsilon: float, states: np.ndarray, q: np.ndarray):
        self.scale = problem.A.diagonal()
        self.A = sparse.csr_array(problem.A + epsilon * sparse.diags_array(self.scale))
        self.friction, self.states, self.q = problem.friction, states, q.ravel()
        self.factorizations = 0
        self.factorise()

    def factorise(self) -> None:
        """Factorise the equations for the current states, and solve them."""
        self.factorizations += 1
        self.replaced: list[tuple] = []  # for each replacement: column of the inverse, old and new equation
        still = np.column_stack([self.states != OPEN, self.states == STICK]).ravel()
        slips = 2 * np.flatnonzero(self.states >= SLIP_UP) + 1
        ratio = np.where(self.states[slips // 2] == SLIP_UP, -1.0, 1.0) * self.friction[slips // 2]
        bounds = sparse.coo_array((ratio * self.scale[slips], (slips, slips - 1)), shape=self.A.shape)
        bounds = bounds + sparse.diags_array(np.where(still, 0.0, self.scale))
        rows = sparse.csr_array(sparse.diags_array(still.astype(np.float64)) @ self.A + bounds)
        try:
            # Transposed, so that SuperLU chooses its pivots within one equation, whose coefficients have one unit.
            self.factors = splu(
                rows.T, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
            )
            self.dx = self.factors.solve(np.where(still, -self.q, 0.0), trans="T")
        except RuntimeError:  # the equations are singular
            self.dx = np.full(self.q.size, np.nan)

    def row(self, i: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Return equation i for the current states: its column indices, its coefficients, its right-hand side."""
        contact, is_tangent = divmod(i, 2)
        state = self.states[contact]
        if state == STICK or (state != OPEN and not is_tangent):
            own = slice(self.A.indptr[i], self.A.indptr[i + 1])
            return self.A.indices[own], self.A.data[own], -self.q[i]
        if state == OPEN:
            return np.array([i]), self.scale[[i]], 0.0
        side = -1.0 if state == SLIP_UP else 1.0
        return np.array([i - 1, i]), self.scale[i] * np.array([side * self.friction[contact], 1.0]), 0.0

    def change(self, contact: int, previous: int) -> None:
        """Update the solution after a contact has changed its state.

        previous: the contact's state before the change.
        """
        if len(self.replaced) >= REFRESH:
            return self.factorise()
        new = self.states[contact]
        for i in (2 * contact, 2 * contact + 1):
            self.states[contact] = previous
            before = self.row(i)
            self.states[contact] = new
            after = self.row(i)
            if np.array_equal(before[1], after[1]):
                continue
            column = np.zeros(self.q.size)
            column[i] = 1.0
            column = self.factors.solve(column, trans="T")
            for other, (where, old, _), (columns, entries, _) in self.replaced:
                column -= (entries @ column[columns] - old @ column[where]) * other
            columns, entries, right = after
            pivot = entries @ column[columns]
            column /= pivot if pivot != 0.0 and math.isfinite(pivot) else math.nan
            self.dx += (right - entries @ self.dx[columns]) * column
            self.replaced.append((column, before, after))

    def rates(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of λ and of u by t, (m, 2) each."""
        return self.dx.reshape(-1, 2), (self.A @ self.dx + self.q).reshape(-1, 2)


@njit(cache=True)
def slack(state, to, friction, x_n, x_t, u_n, u_t):
    """Return a number that stays >= 0 as long as a contact does not change from `state` to `to`.

    x_n, x_t: impulses of the contact, N·s. u_n, u_t: its velocities, m/s. The number is linear in these four. If their
    derivatives by t are passed in their place, the function returns the derivative of the number.
    """
    if state == OPEN:
        return u_n
    if state == STICK:
        return friction * x_n - x_t if to == SLIP_UP else friction * x_n + x_t
    if to == OPEN:
        return x_n
    return -u_t if state == SLIP_UP else u_t


@njit(cache=True)
def first_change(states, friction, x, u, dx, du, sign):
    """Find the first contact that changes its state when (x, u) moves along sign · (dx, du), (m, 2) each.

    Returns (length of the move, in t; index of the contact, or −1 if none changes; its new state). The contact that
    changed last still lies on the bound between its old and its new state. It does not change back, because with this
    sign it moves away from that bound. For a contact that closes, SLIP_UP is returned; its u_t then decides the
    direction of slip.
    """
    least, contact, new = math.inf, -1, OPEN
    for i in range(states.shape[0]):
        state, mu = states[i], friction[i]
        # An open contact can only start to slip. A slipping contact can only open or stick.
        first = OPEN if state >= SLIP_UP else SLIP_UP
        for to in (first, SLIP_DOWN if state == STICK else STICK if state != OPEN and mu > 0.0 else first):
            rate = sign * slack(state, to, mu, dx[i, 0], dx[i, 1], du[i, 0], du[i, 1])
            if rate < 0.0:
                length = max(slack(state, to, mu, x[i, 0], x[i, 1], u[i, 0], u[i, 1]), 0.0) / -rate
                if length < least:
                    least, contact, new = length, i, to
    return least, contact, new


@njit(cache=True, error_model="numpy")
def _next_pivot(states, friction, point, rates, t, contact, previous):
    """Follow the path, in place, from the last change of a contact's state to the next one.

    point: (λ, u). rates: their derivatives by t. contact: the contact that changed last, or `AT_START`. previous: its
    state before that change. Returns (t, the contact that changes next, its state before that, whether t grew).
    `AT_END` or `NOWHERE` is returned in place of a contact if none changes.
    """
    (x, u), (dx, du) = point, rates
    total, sign = 0.0, -1.0
    for i in range(states.shape[0]):
        total += 0.0 * (dx[i, 0] + dx[i, 1] + du[i, 0] + du[i, 1])
    if total != 0.0:  # a rate is not finite
        return t, NOWHERE, previous, False
    if contact >= 0:
        # The contact has to move on into its new state. This decides whether t grows or falls.
        x_n, x_t, u_n, u_t = dx[contact, 0], dx[contact, 1], du[contact, 0], du[contact, 1]
        sign = 1.0 if slack(states[contact], previous, friction[contact], x_n, x_t, u_n, u_t) > 0.0 else -1.0
    length, contact, new = first_change(states, friction, x, u, dx, du, sign)
    if sign < 0.0 and length >= t:
        x -= t * dx
        return 0.0, AT_END, previous, False
    if contact < 0:
        return t, NOWHERE, previous, sign > 0.0
    step = sign * length
    x += step * dx
    u += step * du
    previous = states[contact]
    states[contact] = new if previous != OPEN else SLIP_UP if u[contact, 1] < 0.0 else SLIP_DOWN
    return t + step, contact, previous, sign > 0.0
