"""The path of a proximal step of `exact`, by Lemke's algorithm, and how impulses change along it.

Where the bodies are known this is found in the space of velocities. With the contacts in given states, as t grows
dλ = −S (q + J dv), where S holds, for every contact, the 2 × 2 block diag(1 / ε d_n, 1 / ε d_t) if it sticks,
((1 / ε d_n, 0), (±μ / ε d_n, 0)) if it slips, and 0 if it is open. With velocities scaled by the roots of the masses,
dv = Jᵀ dλ gives (I + Jᵀ S J) dv = −Jᵀ S q: one block of 3 × 3 for each body and each touching pair, whatever the number
of contacts. A contact that changes its state changes S by a product of two vectors, so the inverse by one column
(Sherman and Morrison 1950).

Of matrices alone there are the equations of the impulses, 2 m rows, which SuperLU factorises at every pivot.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy import sparse
from scipy.sparse.linalg import splu

from deep_contact.physics import block_lu
from deep_contact.physics.lcp import ContactProblem

OPEN, STICK, SLIP_UP, SLIP_DOWN = range(4)
"""States of a contact: λ = 0; u = 0; u_n = 0 and λ_t = μ λ_n, where u_t <= 0; λ_t = −μ λ_n, where u_t >= 0."""

MOST_TURNS = 30
"""A step is given up after so many pivots with t growing: a larger ε is cheaper than a long path."""

REFRESH = 48
"""Columns after which the matrix is factorised anew: by then they cost as much as a solve."""

MOST_KEPT = 16
"""Columns up to which the next step with the same ε takes the matrix over instead of factorising it anew."""


class Bodies(NamedTuple):
    """A contact problem by bodies, those that move and touch something."""

    pattern: block_lu.Pattern  # of the factors
    end: np.ndarray  # (m, 2): places of a contact's two bodies; the number of bodies stands for one at rest
    block: np.ndarray  # (m,): index of the pair's block below the diagonal, or −1
    jacobian: np.ndarray  # (m, 12): J M^(−½): two rows of three columns for each of the two bodies


class Inverse(NamedTuple):
    """The inverse of I + Jᵀ S J for some states and one ε, as factors for other states and columns that change them."""

    factors: block_lu.Factors
    states: np.ndarray  # (m,): what the inverse stands for
    column: np.ndarray  # (k, n, 3): c of every change since the factors: it takes c r·(J v)_i from a v
    coefficient: np.ndarray  # (k, 2): r of every change
    contact: np.ndarray  # (k,): i of every change
    used: np.ndarray  # (1,): the number of changes, and −1 before the first factorisation
    epsilon: np.ndarray  # (1,): ε of the factors


def make_inverse(bodies: Bodies) -> Inverse:
    """An inverse that stands for nothing yet."""
    n, m = bodies.pattern.place.size, bodies.end.shape[0]
    return Inverse(
        block_lu.make_factors(bodies.pattern), np.zeros(m, np.int64), np.empty((REFRESH, n + 1, 3)),
        np.empty((REFRESH, 2)), np.empty(REFRESH, np.int64), np.full(1, -1), np.zeros(1),
    )  # fmt: skip


def bodies_of(problem: ContactProblem) -> Bodies | None:
    """The problem by bodies; None where it has none, or a contact of more than two."""
    if problem.jacobian is None:
        return None
    m = problem.b.size // 2
    J = problem.jacobian.tocoo()
    row, column = J.coords
    moves = (problem.inverse_mass[column] > 0) & (J.data != 0)
    contact, side, entry = row[moves] // 2, row[moves] % 2, J.data[moves] * np.sqrt(problem.inverse_mass[column[moves]])
    body, axis = column[moves] // 3, column[moves] % 3
    touched, body = np.unique(body, return_inverse=True)
    n = touched.size
    pair, which = np.unique(contact * max(n, 1) + body, return_inverse=True)
    contact_of, body_of = np.divmod(pair, max(n, 1))
    if np.bincount(contact_of).max(initial=0) > 2:
        return None
    rank = (np.diff(contact_of, prepend=-1) == 0).astype(np.int64)
    end = np.full((m, 2), n)
    end[contact_of, rank] = body_of
    jacobian = np.zeros((m, 2, 2, 3))
    jacobian[contact, side, rank[which], axis] = entry
    both = end.max(axis=1) < n
    pattern = block_lu.pattern_of(n, end[both, 0], end[both, 1])
    place = np.append(pattern.place, n)[end]
    upper, lower = place.max(axis=1), place.min(axis=1)
    blocks = np.repeat(np.arange(n), np.diff(pattern.first)) * n + pattern.row  # rising
    block = np.where(upper < n, np.searchsorted(blocks, lower * n + upper), -1)
    return Bodies(pattern, place, block, jacobian.reshape(m, 12))


@njit(cache=True)
def slack(state, to, friction, x_n, x_t, u_n, u_t):
    """What must stay >= 0 for a contact not to go from its state to another. Linear, so its rate is that of x, u."""
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

    The one that changed last does not go straight back, though it stands on that bound: the sign is such that it
    leaves it. One that closes is said to slip up: which way it slips is told by u_t there.
    """
    least, contact, new = math.inf, -1, OPEN
    for i in range(states.shape[0]):
        state, mu = states[i], friction[i]
        # A contact goes from open to slipping only, and from one slip to the other by sticking.
        first = OPEN if state >= SLIP_UP else SLIP_UP
        for to in (first, SLIP_DOWN if state == STICK else STICK if state != OPEN and mu > 0.0 else first):
            rate = sign * slack(state, to, mu, dx[i, 0], dx[i, 1], du[i, 0], du[i, 1])
            if rate < 0.0:
                length = max(slack(state, to, mu, x[i, 0], x[i, 1], u[i, 0], u[i, 1]), 0.0) / -rate
                if length < least:
                    least, contact, new = length, i, to
    return least, contact, new


AT_START, AT_END, NOWHERE = -1, -2, -3
"""In place of a contact that changes: none has yet, t = 0 is reached before, or the path leads nowhere."""


@njit(cache=True, error_model="numpy")
def _next_pivot(states, friction, x, u, dx, du, t, contact, previous):
    """Go on, in place, from the change of `contact` to the next.

    Returns (t, the next contact, its state before, whether t grew).
    """
    total, sign = 0.0, -1.0
    for i in range(states.shape[0]):
        total += 0.0 * (dx[i, 0] + dx[i, 1] + du[i, 0] + du[i, 1])
    if total != 0.0:  # not finite
        return t, NOWHERE, previous, False
    if contact >= 0:
        # The contact has to go on into its new state, whichever way that makes t go.
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


@njit(cache=True)
def _side(state):
    """The sign of λ_t / μ λ_n where the contact slips, otherwise 0."""
    return 1.0 if state == SLIP_UP else -1.0 if state == SLIP_DOWN else 0.0


@njit(cache=True)
def _softness(state, friction, weight_n, weight_t):
    """S of a contact: nn, nt, tn, tt."""
    if state == OPEN:
        return 0.0, 0.0, 0.0, 0.0
    if state == STICK:
        return weight_n, 0.0, 0.0, weight_t
    return weight_n, 0.0, _side(state) * friction * weight_n, 0.0


@njit(cache=True, fastmath={"contract"})
def _product(G, end, v, i):
    """(J v)_n and (J v)_t of contact i."""
    a, b = end[i, 0], end[i, 1]
    n = G[i, 0] * v[a, 0] + G[i, 1] * v[a, 1] + G[i, 2] * v[a, 2]
    n += G[i, 3] * v[b, 0] + G[i, 4] * v[b, 1] + G[i, 5] * v[b, 2]
    t = G[i, 6] * v[a, 0] + G[i, 7] * v[a, 1] + G[i, 8] * v[a, 2]
    t += G[i, 9] * v[b, 0] + G[i, 10] * v[b, 1] + G[i, 11] * v[b, 2]
    return n, t


@njit(cache=True)
def _add_transposed(G, end, p_n, p_t, i, v):
    """v ← v + Jᵀ p of contact i, in place."""
    for side in range(2):
        k = end[i, side]
        for c in range(3):
            v[k, c] += G[i, 3 * side + c] * p_n + G[i, 6 + 3 * side + c] * p_t


@njit(cache=True)
def _assemble(bodies, weight, friction, states, factors):
    """I + Jᵀ S J as blocks, in place."""
    G, end, n = bodies.jacobian, bodies.end, factors.inverse.shape[0]
    factors.inverse[:] = 0.0
    factors.lower[:] = 0.0
    factors.upper[:] = 0.0
    for k in range(n):
        factors.inverse[k, 0] = factors.inverse[k, 4] = factors.inverse[k, 8] = 1.0
    for i in range(states.shape[0]):
        if states[i] == OPEN:
            continue
        nn, nt, tn, tt = _softness(states[i], friction[i], weight[i, 0], weight[i, 1])
        for one in range(2):
            for other in range(2):
                k, l = end[i, one], end[i, other]
                if k == n or l == n:
                    continue
                if k == l:
                    target = factors.inverse[k]
                else:
                    target = factors.lower[bodies.block[i]] if k > l else factors.upper[bodies.block[i]]
                for r in range(3):
                    g_n, g_t = G[i, 3 * one + r], G[i, 6 + 3 * one + r]
                    s_n, s_t = g_n * nn + g_t * tn, g_n * nt + g_t * tt
                    for c in range(3):
                        target[3 * r + c] += s_n * G[i, 3 * other + c] + s_t * G[i, 6 + 3 * other + c]


@njit(cache=True)
def _factorise(bodies, weight, epsilon, friction, states, inverse):
    """Let the inverse stand for these states, by factors alone. Returns whether it can."""
    _assemble(bodies, weight, friction, states, inverse.factors)
    inverse.states[:] = states
    inverse.epsilon[0] = epsilon
    inverse.used[0] = 0 if block_lu.factorise(bodies.pattern, inverse.factors) else -1
    return inverse.used[0] == 0


@njit(cache=True)
def _take_over(bodies, weight, epsilon, friction, states, inverse):
    """Let the inverse of another step stand for these states by few columns. Returns whether it does."""
    if inverse.used[0] < 0 or inverse.epsilon[0] != epsilon:
        return False
    changes = 0
    for i in range(states.shape[0]):
        changes += states[i] != inverse.states[i]
    if inverse.used[0] + 2 * changes > MOST_KEPT:
        return False
    for i in range(states.shape[0]):
        old, new = inverse.states[i], states[i]
        if old != new:
            # A column changes one row of S: from open to sticking, or from one slip to the other, it takes two.
            between = new
            if old != OPEN and new != OPEN and old != STICK and new != STICK:
                between = STICK
            elif (old == OPEN and new == STICK) or (old == STICK and new == OPEN):
                between = SLIP_UP
            if between != new and not _change(bodies, weight, friction, i, between, inverse):
                return False
            if not _change(bodies, weight, friction, i, new, inverse):
                return False
    return True


@njit(cache=True)
def _apply(bodies, inverse, v, begin):
    """v ← the inverse times v, in place; begin as in `block_lu.solve`."""
    block_lu.solve(bodies.pattern, inverse.factors, v[:-1], begin)
    for k in range(inverse.used[0]):
        g_n, g_t = _product(bodies.jacobian, bodies.end, v, inverse.contact[k])
        _subtract(v, inverse.column[k], inverse.coefficient[k, 0] * g_n + inverse.coefficient[k, 1] * g_t)


@njit(cache=True)
def _solve(bodies, weight, friction, q, inverse, dv):
    """dv of the states that the inverse stands for, in place."""
    dv[:] = 0.0
    for i in range(q.shape[0]):
        nn, nt, tn, tt = _softness(inverse.states[i], friction[i], weight[i, 0], weight[i, 1])
        p_n, p_t = -(nn * q[i, 0] + nt * q[i, 1]), -(tn * q[i, 0] + tt * q[i, 1])
        _add_transposed(bodies.jacobian, bodies.end, p_n, p_t, i, dv)
    dv[-1] = 0.0
    _apply(bodies, inverse, dv, -1)


@njit(cache=True)
def _rates(bodies, weight, friction, state, q, dv, i):
    """dλ_n, dλ_t, du_n, du_t of contact i: how they change as t grows. Those that the state holds are exactly 0."""
    g_n, g_t = _product(bodies.jacobian, bodies.end, dv, i)
    u_n, u_t = q[i, 0] + g_n, q[i, 1] + g_t
    if state == OPEN:
        return 0.0, 0.0, u_n, u_t
    x_n = -weight[i, 0] * u_n
    if state == STICK:
        return x_n, -weight[i, 1] * u_t, 0.0, 0.0
    x_t = _side(state) * friction[i] * x_n
    return x_n, x_t, 0.0, u_t + x_t / weight[i, 1]


@njit(cache=True)
def _change(bodies, weight, friction, i, new, inverse):
    """Let the inverse stand for another state of contact i, by a column of its own. Returns whether it can."""
    old, used = inverse.states[i], inverse.used[0]
    side = _side(new) + _side(old)
    if old == OPEN or new == OPEN:
        a_n, a_t = 1.0, side * friction[i]
        r_n, r_t = weight[i, 0] if old == OPEN else -weight[i, 0], 0.0
    else:
        sign = 1.0 if old == STICK else -1.0
        a_n, a_t = 0.0, 1.0
        r_n, r_t = sign * side * friction[i] * weight[i, 0], -sign * weight[i, 1]
    c = inverse.column[used]
    c[:] = 0.0
    _add_transposed(bodies.jacobian, bodies.end, a_n, a_t, i, c)
    c[-1] = 0.0
    _apply(bodies, inverse, c, min(bodies.end[i, 0], bodies.end[i, 1]))
    g_n, g_t = _product(bodies.jacobian, bodies.end, c, i)
    denominator = 1.0 + r_n * g_n + r_t * g_t
    if denominator == 0.0 or not math.isfinite(denominator):
        inverse.used[0] = -1
        return False
    inverse.coefficient[used, 0], inverse.coefficient[used, 1] = r_n / denominator, r_t / denominator
    inverse.contact[used], inverse.states[i], inverse.used[0] = i, new, used + 1
    return True


@njit(cache=True, fastmath={"contract"})
def _subtract(v, c, share):
    """v ← v − share c, in place."""
    to, by = v.reshape(v.size), c.reshape(c.size)
    for k in range(to.size):
        to[k] -= share * by[k]


@njit(cache=True, error_model="numpy")
def _turn(bodies, weight, epsilon, friction, states, contact, q, inverse, dv, dx, du):
    """Fill dv, and dx and du, (m, 2), for states in which `contact` has changed, or for those of a new step.

    dv is that of the last call. NaN where the matrix is singular. Returns the factorisations.
    """
    m, factorizations, is_regular = states.shape[0], 0, True
    if contact >= 0 and inverse.used[0] < REFRESH:
        is_regular = _change(bodies, weight, friction, contact, states[contact], inverse)
        if is_regular:
            k = inverse.used[0] - 1
            g_n, g_t = _product(bodies.jacobian, bodies.end, dv, contact)
            r_n, r_t = inverse.coefficient[k, 0], inverse.coefficient[k, 1]
            share = r_n * (g_n + q[contact, 0]) + r_t * (g_t + q[contact, 1])
            _subtract(dv, inverse.column[k], share)
    else:
        if contact >= 0 or not _take_over(bodies, weight, epsilon, friction, states, inverse):
            factorizations, is_regular = 1, _factorise(bodies, weight, epsilon, friction, states, inverse)
        if is_regular:
            _solve(bodies, weight, friction, q, inverse, dv)
    if not is_regular:
        dv[:] = np.nan
    for i in range(m):
        dx[i, 0], dx[i, 1], du[i, 0], du[i, 1] = _rates(bodies, weight, friction, states[i], q, dv, i)
    return factorizations


@njit(cache=True, error_model="numpy")
def _follow(bodies, weight, epsilon, friction, states, x, u, q, limit, inverse):
    """`path_by_bodies`: one loop, since a call of Python a pivot would take as long as the pivot where m is small."""
    t, contact, previous, pivots, turns, factorizations = 1.0, AT_START, OPEN, 0, 0, 0
    dv, dx, du = np.empty((bodies.pattern.place.shape[0] + 1, 3)), np.empty_like(x), np.empty_like(x)
    while True:
        factorizations += _turn(bodies, weight, epsilon, friction, states, contact, q, inverse, dv, dx, du)
        t, contact, previous, grows = _next_pivot(states, friction, x, u, dx, du, t, contact, previous)
        turns += grows
        if contact < 0 or pivots + factorizations > limit or turns > MOST_TURNS:
            return contact == AT_END, pivots, factorizations
        pivots += 1


def path_by_bodies(problem: ContactProblem, bodies: Bodies) -> Callable:
    """The path of a problem by bodies.

    A path is a function (ε, states, λ, u, q, limit) -> (whether it ends at t = 0, pivots, factorisations). It withdraws
    the shift q of the velocities, t q from t = 1 to 0. States, λ and u belong to t = 1 and are changed in place. It is
    given up after `limit` pivots and factorisations.
    """
    inverse, diagonal = make_inverse(bodies), problem.A.diagonal().reshape(-1, 2)

    def path(epsilon: float, states, x, u, q, limit: int):
        weight = 1.0 / (epsilon * diagonal)
        return _follow(bodies, weight, epsilon, problem.friction, states, x, u, q, limit, inverse)

    return path


def path_by_matrices(problem: ContactProblem) -> Callable:
    """The path (`path_by_bodies`) of a problem without bodies, by the equations of its impulses."""

    def path(epsilon: float, states, x, u, q, limit: int):
        t, contact, previous, pivots, turns = 1.0, AT_START, OPEN, 0, 0
        while True:
            dx, du = _rates_by_matrices(problem, epsilon, states, q)
            t, contact, previous, grows = _next_pivot(states, problem.friction, x, u, dx, du, t, contact, previous)
            turns += grows
            if contact < 0 or pivots + 1 > limit or turns > MOST_TURNS:
                return contact == AT_END, pivots, 1
            pivots += 1

    return path


def _rates_by_matrices(problem: ContactProblem, epsilon: float, states: np.ndarray, q: np.ndarray):
    """dλ / dt and du / dt, (m, 2) each; NaN where the equations are singular.

    A dλ = −q in the rows where u stays 0, and λ on its bounds, scaled by the diagonal of A, in the others: so all rows
    are of one size whatever the masses.
    """
    A = problem.A + sparse.diags_array(epsilon * problem.A.diagonal(), format="csr")
    still = np.column_stack([states != OPEN, states == STICK]).ravel()
    slips = 2 * np.flatnonzero(states >= SLIP_UP) + 1
    ratio = np.where(states[slips // 2] == SLIP_UP, -1.0, 1.0) * problem.friction[slips // 2]
    scale = A.diagonal()
    edges = sparse.coo_array((ratio * scale[slips], (slips, slips - 1)), shape=A.shape)
    bounds = sparse.diags_array(np.where(still, 0.0, scale))
    B = sparse.csr_array(sparse.diags_array(still.astype(np.float64)) @ A + bounds + edges)
    dx = np.full(q.size, np.nan)
    try:
        # The rows of B as columns: pivots are chosen within one row, whose entries are of one kind.
        factors = splu(B.T, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True})
        dx = factors.solve(np.where(still, -q.ravel(), 0.0), trans="T")
    except RuntimeError:
        pass  # it is singular
    return dx.reshape(-1, 2), (A @ dx).reshape(-1, 2) + q
