"""Starting impulses of a pile from its positions alone: loads are passed down from the top, circle by circle.

The method is for states whose contacts carry no impulses. Circles are visited from the highest to the lowest against
gravity. The contacts on which a circle lies are solved as if the bodies below did not move. The reactions are loads on
these bodies. This is the force half of shock propagation (Guendelman, Bridson and Fedkiw, Nonconvex Rigid Bodies with
Stacking, SIGGRAPH 2003).

Weakness: no load goes up again. Loads that an arch carries sideways are lost, and so are loads that the supports of a
circle cannot carry.
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
    friction_of,
)

LOCAL_SWEEPS = 3
"""Number of sweeps over the contacts on which one circle lies. For two contacts at 60°, each sweep leaves a quarter of
the error."""


def supported(state, problem) -> tuple[np.ndarray, np.ndarray]:
    """Return impulses (λ_n, λ_t) that carry loads down, (m,) each, N·s. Without gravity they are 0.

    problem: `StepProblem` of the state, with tangent rows.
    """
    gravity, m = np.array(state.world.gravity), state.contacts.count
    if not gravity.any():
        return np.zeros(m), np.zeros(m)
    rows, velocities, n = problem.rows, problem.solver_bodies.copy(), state.bodies.count
    height = np.full(len(velocities), -np.inf)
    height[:n] = np.where(state.bodies.is_fixed, -np.inf, state.bodies.position @ -gravity)
    still = velocities.copy()
    still[:n, :V_S] = state.bodies.velocity  # velocities before gravity has acted
    rows = rows._replace(impulse=np.zeros((m, 2)))
    order = np.argsort(-height[:n], kind="stable")
    hand_down(rows, problem.friction, velocities, still, height, order)
    return rows.impulse[:, NORMAL].copy(), rows.impulse[:, TANGENT].copy()


@njit(cache=True, error_model="numpy")
def hand_down(rows, friction, v, still, height, order):
    """Fill the impulses of the rows by passing loads down, circle by circle, in place on the impulses and on v.

    v: solver bodies, (n + 4, 4), after gravity has acted. still: solver bodies before gravity has acted. When a circle
    is visited, the bodies below it have the velocities of `still`, as if loads did not move them. height: potential g h
    of each solver body, m²/s². order: indices of the circles, the highest first.
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
            # The normal impulse has changed since the tangent impulse was clamped, so it is clamped again.
            bound = friction_of(friction, data, i) * impulse[i, NORMAL]
            impulse[i, TANGENT] = max(-bound, min(impulse[i, TANGENT], bound))
            is_a = body[i, BODY_A] == a
            b, sign = (body[i, BODY_B], 1.0) if is_a else (body[i, BODY_A], -1.0)
            arm, normal = data[i, ARM_B if is_a else ARM_A], (data[i, N_X], data[i, N_Y])
            apply_to_body(v, b, sign, normal, arm, (impulse[i, NORMAL], impulse[i, TANGENT]))


@njit(cache=True)
def upper_of(body, height, i):
    """Return the body of contact i that lies on the other body, that is, the higher body."""
    a, b = body[i, BODY_A], body[i, BODY_B]
    return a if height[a] >= height[b] else b


@njit(cache=True, error_model="numpy")
def carry(a, i, rows, friction, v, still):
    """Relax contact i of circle a, first the friction row, then the normal row.

    Only the impulse of the contact and the velocity of circle a change, in place. The other body has its velocity in
    `still`.
    """
    body, data, impulse = rows.body, rows.data, rows.impulse
    is_a = body[i, BODY_A] == a
    b, sign = (body[i, BODY_B], -1.0) if is_a else (body[i, BODY_A], 1.0)
    n_x, n_y = data[i, N_X], data[i, N_Y]
    mine, other = (data[i, ARM_A], data[i, ARM_B]) if is_a else (data[i, ARM_B], data[i, ARM_A])
    w = v[a, INVERSE_MASS]
    d_x, d_y = sign * (v[a, V_X] - still[b, V_X]), sign * (v[a, V_Y] - still[b, V_Y])
    slip = d_x * n_y - d_y * n_x + mine * v[a, V_S] + other * still[b, V_S]
    bound = friction_of(friction, data, i) * impulse[i, NORMAL]
    p_t = max(-bound, min(impulse[i, TANGENT] - slip / (w * (1.0 + 2.0 * mine * mine)), bound)) - impulse[i, TANGENT]
    p_n = max(impulse[i, NORMAL] - (d_x * n_x + d_y * n_y) / w, 0.0) - impulse[i, NORMAL]
    impulse[i, NORMAL] += p_n
    impulse[i, TANGENT] += p_t
    apply_to_body(v, a, sign, (n_x, n_y), mine, (p_n, p_t))


@njit(cache=True)
def apply_to_body(v, a, sign, normal, arm, impulse):
    """Apply an impulse (λ_n, λ_t), N·s, to one body of a contact, in place.

    a: the body. sign: −1 if the body is body_a of the contact, 1 if it is body_b. normal: unit normal of the contact.
    arm: distance of the contact point from the centre of the body, divided by the body's radius.
    """
    w, (n_x, n_y), (p_n, p_t) = v[a, INVERSE_MASS], normal, impulse
    v[a, V_X] += sign * w * (p_n * n_x + p_t * n_y)
    v[a, V_Y] += sign * w * (p_n * n_y - p_t * n_x)
    v[a, V_S] += 2.0 * w * arm * p_t
