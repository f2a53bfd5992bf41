"""Impulses of a pile from its positions alone: loads are passed down from the top, circle by circle.

The method is for states whose contacts carry no impulses. Circles are visited from the highest to the lowest against
gravity. The contacts on which a circle lies are solved as if the bodies below did not move, and the reactions are loads
on these bodies: the force half of shock propagation (Guendelman, Bridson and Fedkiw, Nonconvex Rigid Bodies with
Stacking, SIGGRAPH 2003).

Weakness: no load goes up again. Loads that an arch carries sideways, and loads that a circle's own supports cannot
carry, are lost.
"""

from __future__ import annotations

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.rows import (
    ARM_A,
    ARM_B,
    BODY_A,
    BODY_B,
    INVERSE_MASS,
    N_X,
    N_Y,
    NORMAL,
    TANGENT,
    V_S,
    V_X,
    V_Y,
)

LOCAL_SWEEPS = 3
"""Sweeps over the contacts of one circle. For two contacts at 60°, each sweep leaves a quarter of the error."""


def supported(state, problem) -> tuple[np.ndarray, np.ndarray]:
    """Impulses (λ_n, λ_t) that carry loads down, (m,) each, N·s; 0 without gravity. problem: with tangent rows."""
    gravity, m = np.array(state.world.gravity), state.contacts.count
    if not gravity.any():
        return np.zeros(m), np.zeros(m)
    rows, velocities, n = problem.rows, problem.solver_bodies.copy(), state.bodies.count
    height = np.full(len(velocities), -np.inf)
    height[:n] = np.where(state.bodies.is_fixed, -np.inf, state.bodies.position @ -gravity)
    still = velocities.copy()
    still[:n, :V_S] = state.bodies.velocity  # before gravity
    rows = rows._replace(impulse=np.zeros((m, 2)))
    order = np.argsort(-height[:n], kind="stable")
    hand_down(rows, problem.friction, velocities, still, height, order)
    return rows.impulse[:, NORMAL].copy(), rows.impulse[:, TANGENT].copy()


@njit(cache=True, error_model="numpy")
def hand_down(rows, friction, v, still, height, order):
    """Fill the impulses of the rows, and change the velocities v, (n + 4, 4), of circles after gravity, in place.

    still: solver bodies with the velocities before gravity, for bodies that do not move. height: of the solver bodies.
    order: circles from the highest down.
    """
    body, data, impulse = rows.body, rows.data, rows.impulse
    n, m = order.shape[0], body.shape[0]
    first = np.zeros(n + 2, np.int64)
    for i in range(m):
        first[upper_of(body, height, i) + 2] += 1
    for a in range(n + 1):
        first[a + 1] += first[a]
    below = np.empty(m, np.int64)
    for i in range(m):
        a = upper_of(body, height, i)
        below[first[a + 1]] = i
        first[a + 1] += 1
    for a in order:
        mine = below[first[a] : first[a + 1]]
        for _ in range(LOCAL_SWEEPS):
            for i in mine:
                carry(a, i, rows, friction, v, still)
        for i in mine:
            # The tangent impulse was bounded by the normal impulse before its last change.
            bound = friction * impulse[i, NORMAL]
            impulse[i, TANGENT] = max(-bound, min(impulse[i, TANGENT], bound))
            is_a = body[i, BODY_A] == a
            b, sign = (body[i, BODY_B], 1.0) if is_a else (body[i, BODY_A], -1.0)
            arm, normal = data[i, ARM_B if is_a else ARM_A], (data[i, N_X], data[i, N_Y])
            push(v, b, sign, normal, arm, (impulse[i, NORMAL], impulse[i, TANGENT]))


@njit(cache=True)
def upper_of(body, height, i):
    """The body of contact i that lies on the other body."""
    a, b = body[i, BODY_A], body[i, BODY_B]
    return a if height[a] >= height[b] else b


@njit(cache=True, error_model="numpy")
def carry(a, i, rows, friction, v, still):
    """Relax contact i for circle a alone, in place on its velocity and the impulse: friction row, then normal row."""
    body, data, impulse = rows.body, rows.data, rows.impulse
    is_a = body[i, BODY_A] == a
    b, sign = (body[i, BODY_B], -1.0) if is_a else (body[i, BODY_A], 1.0)
    n_x, n_y = data[i, N_X], data[i, N_Y]
    mine, other = (data[i, ARM_A], data[i, ARM_B]) if is_a else (data[i, ARM_B], data[i, ARM_A])
    w = v[a, INVERSE_MASS]
    d_x, d_y = sign * (v[a, V_X] - still[b, V_X]), sign * (v[a, V_Y] - still[b, V_Y])
    slip = d_x * n_y - d_y * n_x + mine * v[a, V_S] + other * still[b, V_S]
    bound = friction * impulse[i, NORMAL]
    p_t = max(-bound, min(impulse[i, TANGENT] - slip / (w * (1.0 + 2.0 * mine * mine)), bound)) - impulse[i, TANGENT]
    p_n = max(impulse[i, NORMAL] - (d_x * n_x + d_y * n_y) / w, 0.0) - impulse[i, NORMAL]
    impulse[i, NORMAL] += p_n
    impulse[i, TANGENT] += p_t
    push(v, a, sign, (n_x, n_y), mine, (p_n, p_t))


@njit(cache=True)
def push(v, a, sign, normal, arm, impulse):
    """Apply an impulse (λ_n, λ_t), N·s, to body a, in place. sign: −1 if it is body_a of the contact, 1 if body_b."""
    w, (n_x, n_y), (p_n, p_t) = v[a, INVERSE_MASS], normal, impulse
    v[a, V_X] += sign * w * (p_n * n_x + p_t * n_y)
    v[a, V_Y] += sign * w * (p_n * n_y - p_t * n_x)
    v[a, V_S] += 2.0 * w * arm * p_t
