"""The path of a proximal step of `exact`, by Lemke's algorithm, and how impulses change along it.

As long as no contact changes its state, the derivative dλ by t satisfies one equation for each row: (A + ε diag(A)) dλ
= −q if the velocity stays 0, and the equation of the bound if λ stays on a bound. A contact that changes its state
replaces one or two rows. The solution then changes by a multiple of the row's column of the inverse (Sherman and
Morrison 1950), so that SuperLU factorises once a step, and again after `REFRESH` replaced rows.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from deep_contact.analysis.lcp import ContactProblem
from deep_contact.compiled import njit

OPEN, STICK, SLIP_UP, SLIP_DOWN = range(4)
"""States of a contact: λ = 0; u = 0; u_n = 0 and λ_t = μ λ_n, where u_t <= 0; λ_t = −μ λ_n, where u_t >= 0."""

AT_START, AT_END, NOWHERE = -1, -2, -3
"""Values in place of the contact that changes next: no contact has changed yet; t = 0 is reached before a change; the
path leads nowhere."""

MOST_TURNS = 30
"""Largest number of pivots of a step with t growing. The step is then abandoned: a larger ε is cheaper than a long
path."""

REFRESH = 48
"""Number of replaced rows after which the equations are factorised anew: their columns then cost as much as that."""


def follow(problem: ContactProblem, epsilon: float, states, x, u, q, limit: int) -> tuple[bool, int, int]:
    """Withdraw the shift t q of the velocities from t = 1 to 0: (whether t = 0 is reached, pivots, factorisations).

    states, (m,), λ = x and u, (m, 2) each, are those of t = 1, and change in place. The path is abandoned after `limit`
    pivots and factorisations.
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
    """The equations of a step for states that change one contact at a time, and their solution dλ.

    states: (m,), those of the path, which changes them. Rows are scaled by the diagonal of A, so that all rows are of
    one size whatever the masses. If the equations are singular, dλ is NaN.
    """

    def __init__(self, problem: ContactProblem, epsilon: float, states: np.ndarray, q: np.ndarray):
        self.scale = problem.A.diagonal()
        self.A = sparse.csr_array(problem.A + epsilon * sparse.diags_array(self.scale))
        self.friction, self.states, self.q = problem.friction, states, q.ravel()
        self.factorizations = 0
        self.factorise()

    def factorise(self) -> None:
        """Factorise the equations of the present states, and solve them."""
        self.factorizations += 1
        self.replaced: list[tuple] = []  # the column of the inverse, the row before and the row after
        still = np.column_stack([self.states != OPEN, self.states == STICK]).ravel()
        slips = 2 * np.flatnonzero(self.states >= SLIP_UP) + 1
        ratio = np.where(self.states[slips // 2] == SLIP_UP, -1.0, 1.0) * self.friction[slips // 2]
        bounds = sparse.coo_array((ratio * self.scale[slips], (slips, slips - 1)), shape=self.A.shape)
        bounds = bounds + sparse.diags_array(np.where(still, 0.0, self.scale))
        rows = sparse.csr_array(sparse.diags_array(still.astype(np.float64)) @ self.A + bounds)
        try:
            # The rows as columns: pivots are chosen within one row, whose entries are of one kind.
            self.factors = splu(
                rows.T, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
            )
            self.dx = self.factors.solve(np.where(still, -self.q, 0.0), trans="T")
        except RuntimeError:  # the equations are singular
            self.dx = np.full(self.q.size, np.nan)

    def row(self, i: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Row i of the equations: its columns, its entries, its right-hand side."""
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
        """Update the solution after a contact has changed its state. previous: its state before."""
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
        """dλ / dt and du / dt, (m, 2) each."""
        return self.dx.reshape(-1, 2), (self.A @ self.dx + self.q).reshape(-1, 2)


@njit(cache=True)
def slack(state, to, friction, x_n, x_t, u_n, u_t):
    """The number that stays >= 0 as long as a contact does not change from `state` to `to`.

    It is linear in x and u: with their rates as arguments, the function returns its rate.
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
    """The first contact to leave its state along sign (dx, du), (m, 2) each: (length, contact or −1, its new state).

    The contact that changed last stands on the bound of its state before, but does not change back at once: with this
    sign it leaves that bound. A contact that closes gets the state of slipping up; u_t then decides its direction.
    """
    least, contact, new = math.inf, -1, OPEN
    for i in range(states.shape[0]):
        state, mu = states[i], friction[i]
        # A contact changes from open to slipping only, and from one direction of slip to the other by sticking.
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
    """Follow the path, in place, from the change of `contact` to the next change. point: (λ, u). rates: by t.

    Returns (t, the next contact, its state before, whether t grew).
    """
    (x, u), (dx, du) = point, rates
    total, sign = 0.0, -1.0
    for i in range(states.shape[0]):
        total += 0.0 * (dx[i, 0] + dx[i, 1] + du[i, 0] + du[i, 1])
    if total != 0.0:  # not finite
        return t, NOWHERE, previous, False
    if contact >= 0:
        # The contact has to go on into its new state, whether t grows by that or falls.
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
