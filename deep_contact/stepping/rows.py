"""The contact problem of one step: its rows, and a sweep of Projected Gauss-Seidel over them.

For circles the arms from the centres to the contact point are parallel to the normal. A normal impulse therefore
turns nothing, an arm is one number instead of a vector, and the two rows of a contact do not see each other
(J_n M⁻¹ J_tᵀ = 0), so that both can be relaxed from the velocities read once.

With the arm l of a body of radius r, its surface moves tangentially at ω l = (l / r) s, where s = ω r is kept in
place of ω: for a disc (I = m r² / 2) an impulse λ_t changes s by 2 (l / r) λ_t / m, whatever its radius.

Without friction no impulse turns a circle: if `friction` is None instead of a number, every function here leaves the
tangent rows out. None is a type of its own, so the choice is made when the caller is compiled, and the result has the
same bits as with μ = 0. A start with tangent impulses needs the general rows.

A contact is relaxed in scalar arithmetic here (`sweep`), eight contacts at a time in `solvers.batched.sweep_tiles`, and
backwards in `cnn.through_solver`, for the gradient of the error that sweeps leave.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.segments import moves, surface_velocity, wall_velocity

V_X, V_Y, V_S, INVERSE_MASS = range(4)
"""Columns of the solver bodies, (n + 4, 4): velocity of the centre, s = ω r (m/s each), 1 / m (1/kg).

The last four rows are the walls: at rest, with an inverse mass of 0. Segments share the last of these rows. Its s is 1
if surfaces move: with the speed of its surface as the arm of the contact, a segment drags (`move_surfaces`). Further
rows follow if segments move: one for each contact with a moving segment, with the segment's velocity there
(`move_walls`).
"""

BODY_A, BODY_B = range(2)
"""Columns of `Rows.body`."""

N_X, N_Y, NORMAL_MASS, TANGENT_MASS, ARM_A, ARM_B = range(6)
"""Columns of `Rows.data`: unit normal, effective masses (kg), arms over radii."""

NORMAL, TANGENT = range(2)
"""Columns of `Rows.impulse`."""


class Rows(NamedTuple):
    """The rows of m contacts. All numbers of one contact lie side by side, so that a sweep reads memory in order."""

    body: np.ndarray  # (m, 2): rows of the solver bodies: `BODY_A`, `BODY_B`
    data: np.ndarray  # (m, 6): `N_X` to `ARM_B`; without friction (m, 3): `N_X` to `NORMAL_MASS`
    impulse: np.ndarray  # (m, 2): λ_n and λ_t, N·s: `NORMAL`, `TANGENT`; without friction (m, 1): λ_n


CONTRACT = {"contract"}
"""Fast-math flag: a * b + c may be one fused operation; nothing else is relaxed."""

SUMS = {"contract", "reassoc"}
"""Fast-math flags of sums over all rows: several partial sums at once, in an order fixed at compile time."""


def make_rows(capacity, friction):
    """Uninitialised rows for `capacity` contacts."""
    columns, kinds = (3, 1) if friction is None else (6, 2)
    return Rows(np.empty((capacity, 2), np.uint32), np.empty((capacity, columns)), np.empty((capacity, kinds)))


more_rows = njit(cache=True)(make_rows)
"""`make_rows` for compiled callers."""


@njit(inline="always")
def with_wall_bodies(solver_bodies, contacts, n, actuation):
    """Solver bodies with a row for each contact with a moving segment: the same array, or a larger one if needed."""
    if actuation is None:
        return solver_bodies
    more = 0
    for i in range(contacts.body_b.shape[0]):
        s = contacts.body_b[i] - n - 4
        more += s >= 0 and moves(actuation.wall, s)
    return solver_bodies if more == 0 else np.empty((n + 4 + more, 4))


@njit(cache=True, error_model="numpy")
def contact_rows(contacts, radius, segments, solver_bodies, buffer, friction, share):
    """Rows of the contacts, with their starting impulses times `share`: views of the buffer, or of a larger one.

    Effective masses are 1 / (J M⁻¹ Jᵀ). radius: (n,), m. segments: `Segments`. If segments move, `move_walls` follows.
    """
    v, m, last = solver_bodies, contacts.body_a.shape[0], radius.shape[0] + 3
    if m > buffer.body.shape[0]:
        buffer = more_rows(m, friction)
    rows = Rows(buffer.body[:m], buffer.data[:m], buffer.impulse[:m])
    for i in range(m):
        a, b = contacts.body_a[i], min(contacts.body_b[i], last)
        rows.body[i, BODY_A], rows.body[i, BODY_B] = a, b
        rows.data[i, N_X], rows.data[i, N_Y] = contacts.normal[i, 0], contacts.normal[i, 1]
        rows.impulse[i, NORMAL] = share * contacts.normal_start[i]
        if friction is None:
            rows.data[i, NORMAL_MASS] = 1.0 / (v[a, INVERSE_MASS] + v[b, INVERSE_MASS])
        else:
            arms = arms_of(radius, a, b, contacts.separation[i])
            masses = row_masses(v[a, INVERSE_MASS], v[b, INVERSE_MASS], arms)
            rows.data[i, NORMAL_MASS], rows.data[i, TANGENT_MASS] = masses
            rows.data[i, ARM_A], rows.data[i, ARM_B] = arms
            rows.impulse[i, TANGENT] = share * contacts.tangent_start[i]
    if friction is not None:
        if segments is not None:
            move_surfaces(contacts, segments, solver_bodies, rows, last)
    return rows


@njit(cache=True)
def relative_velocity(rows, v, i):
    """(Along the normal, along the tangent) of the i-th contact, m/s. v: velocities of the solver bodies."""
    a, b, n_x, n_y = rows.body[i, BODY_A], rows.body[i, BODY_B], rows.data[i, N_X], rows.data[i, N_Y]
    d_x, d_y = v[b, V_X] - v[a, V_X], v[b, V_Y] - v[a, V_Y]
    turn = rows.data[i, ARM_A] * v[a, V_S] + rows.data[i, ARM_B] * v[b, V_S]
    return d_x * n_x + d_y * n_y, d_x * n_y - d_y * n_x + turn


@njit(cache=True, error_model="numpy")
def arms_of(radius, a, b, separation):
    """Arms of a contact over the radii of its bodies; 0 for a wall or segment. radius: (n,), m. separation: m."""
    arm_b = 1.0 + 0.5 * separation / radius[b] if b < radius.shape[0] else 0.0
    return 1.0 + 0.5 * separation / radius[a], arm_b


@njit(cache=True, error_model="numpy")
def row_masses(w_a, w_b, arms):
    """Effective masses of the normal and the tangent row, kg. w_a, w_b: inverse masses, 1/kg. arms: of `arms_of`."""
    arm_a, arm_b = arms
    return 1.0 / (w_a + w_b), 1.0 / (w_a + w_b + 2.0 * (arm_a * arm_a * w_a + arm_b * arm_b * w_b))


@njit(cache=True)
def move_surfaces(contacts, segments, solver_bodies, rows, last):
    """Write the speeds of the segments' surfaces into rows with tangents and into the solver bodies, in place.

    last: row of the solver bodies that the segments share.
    """
    if segments.line.shape[0] == 0:
        return
    solver_bodies[last, V_S] = 1.0
    for i in range(contacts.body_a.shape[0]):
        s = contacts.body_b[i] - last - 1
        if s >= 0:
            rows.data[i, ARM_B] = surface_velocity(segments.line[s], contacts.normal[i, 0], contacts.normal[i, 1])


@njit(cache=True, error_model="numpy")
def move_walls(contacts, segments, solver_bodies, rows, n, actuation):
    """Give each contact with a moving segment a solver body of its own, in place. n: number of circles."""
    row = last = n + 3
    for i in range(contacts.body_a.shape[0]):
        s = contacts.body_b[i] - last - 1
        if s >= 0 and moves(actuation.wall, s):
            row += 1
            v_x, v_y = wall_velocity(segments.line, actuation.wall, s, contacts.position[i, 0], contacts.position[i, 1])
            solver_bodies[row, V_X], solver_bodies[row, V_Y], solver_bodies[row, V_S] = v_x, v_y, 1.0
            rows.body[i, BODY_B] = row


@njit(cache=True)
def apply_impulses(rows, solver_bodies, friction):
    """Apply the impulses that the rows start from to the velocities, in place: v ← v + M⁻¹ Jᵀ λ."""
    arms, p_t = (0.0, 0.0), 0.0
    for i in range(rows.body.shape[0]):
        normal, p_n = (rows.data[i, N_X], rows.data[i, N_Y]), rows.impulse[i, NORMAL]
        if friction is not None:
            arms, p_t = (rows.data[i, ARM_A], rows.data[i, ARM_B]), rows.impulse[i, TANGENT]
        apply_impulse(solver_bodies, rows.body[i, BODY_A], rows.body[i, BODY_B], normal, arms, (p_n, p_t))


@njit(cache=True)
def apply_impulse(v, a, b, normal, arms, impulse):
    """Apply an impulse (λ_n, λ_t), N·s, to two solver bodies, in place. arms: over radii."""
    (n_x, n_y), (p_n, p_t) = normal, impulse
    p_x = p_n * n_x + p_t * n_y
    p_y = p_n * n_y - p_t * n_x
    w_a, w_b = v[a, INVERSE_MASS], v[b, INVERSE_MASS]
    v[a, V_X] -= w_a * p_x
    v[a, V_Y] -= w_a * p_y
    v[a, V_S] += 2.0 * w_a * arms[0] * p_t
    v[b, V_X] += w_b * p_x
    v[b, V_Y] += w_b * p_y
    v[b, V_S] += 2.0 * w_b * arms[1] * p_t


@njit(cache=True, fastmath=CONTRACT)
def sweep(rows, friction, solver_bodies):
    """One sweep of Projected Gauss-Seidel over all contacts, in place. Returns θ.

    Every contact relaxes its friction row, clamped by μ times the normal impulse it has, and its normal row, clamped
    at 0 (Box2D's order; Algorithm 1 of the thesis for the normal rows). θ = max over all rows of |λ_k − λ_{k−1}|, N·s.
    """
    v = solver_bodies
    body, data, impulse = rows.body, rows.data, rows.impulse
    theta = 0.0
    # Contacts are sorted by body a, so its velocity stays in registers until the next a: successive contacts of one
    # body need not wait for a trip through memory.
    held = np.uint32(0)
    a_x, a_y, a_s, w_a = v[0, V_X], v[0, V_Y], v[0, V_S], v[0, INVERSE_MASS]
    for i in range(body.shape[0]):
        a, b = body[i, BODY_A], body[i, BODY_B]
        if a != held:
            v[held, V_X], v[held, V_Y], v[held, V_S] = a_x, a_y, a_s
            a_x, a_y, a_s, w_a = v[a, V_X], v[a, V_Y], v[a, V_S], v[a, INVERSE_MASS]
            held = a
        b_x, b_y, w_b = v[b, V_X], v[b, V_Y], v[b, INVERSE_MASS]
        n_x, n_y, k_n, old_n = data[i, N_X], data[i, N_Y], data[i, NORMAL_MASS], impulse[i, NORMAL]

        # The change −k (v_b − v_a)·n, cut so that λ stays admissible. The contribution of a comes last, and λ is added
        # outside of the chain of operations that the next contact waits for.
        x_n, y_n = k_n * n_x, k_n * n_y
        free_n = 0.0 - x_n * b_x - y_n * b_y + x_n * a_x + y_n * a_y
        p_n = max(free_n, -old_n)
        largest = abs(p_n)
        impulse[i, NORMAL] = old_n + p_n
        if friction is not None:
            # The change along t = (n_y, −n_x), cut to Coulomb's bounds.
            b_s, k_t, arm_a, arm_b = v[b, V_S], data[i, TANGENT_MASS], data[i, ARM_A], data[i, ARM_B]
            old_t, bound = impulse[i, TANGENT], friction * max(old_n, 0.0)
            x_t, y_t = k_t * n_y, k_t * n_x
            free_t = -(k_t * arm_b) * b_s - x_t * b_x + y_t * b_y + x_t * a_x - y_t * a_y - k_t * arm_a * a_s
            p_t = max(-bound - old_t, min(free_t, bound - old_t))
            largest = max(largest, abs(p_t))
            impulse[i, TANGENT] = old_t + p_t
        theta = max(theta, largest)

        a_x = a_x - w_a * n_x * p_n
        a_y = a_y - w_a * n_y * p_n
        b_x = b_x + w_b * n_x * p_n
        b_y = b_y + w_b * n_y * p_n
        if friction is not None:
            a_x = a_x - w_a * n_y * p_t
            a_y = a_y + w_a * n_x * p_t
            a_s = a_s + 2.0 * w_a * arm_a * p_t
            b_x = b_x + w_b * n_y * p_t
            b_y = b_y - w_b * n_x * p_t
            v[b, V_S] = b_s + 2.0 * w_b * arm_b * p_t
        v[b, V_X], v[b, V_Y] = b_x, b_y
    v[held, V_X], v[held, V_Y], v[held, V_S] = a_x, a_y, a_s
    return theta


@njit(cache=True)
def store_impulses(rows, contacts, substeps):
    """Write the solved impulses of a substep, times the number `substeps` of substeps, into the contacts, in place."""
    last = rows.impulse.shape[1] - 1
    for i in range(rows.body.shape[0]):
        contacts.normal_impulse[i] = substeps * rows.impulse[i, NORMAL]
        contacts.tangent_impulse[i] = substeps * rows.impulse[i, last] if last else 0.0


@njit(cache=True, error_model="numpy")
def best_share(rows, solver_bodies):
    """α = clip(−b·λ / λ·A λ, 0, 1) for the impulses λ of the rows; 1 where these change no velocity.

    α λ has the least energy ½ α² λ·A λ + α b·λ, with A = J M⁻¹ Jᵀ and b = J v⁻. One pass over the contacts is enough,
    because λ·A λ is twice the kinetic energy of the velocity changes by λ: Σ m |Δv|² + ½ m Δs², s = ω r. rows: `Rows`
    with tangents. solver_bodies: velocities v⁻ before impulses, (N, 4).
    """
    v = solver_bodies
    change = np.zeros((v.shape[0], 3))
    along = 0.0
    for i in range(rows.body.shape[0]):
        a, b = rows.body[i, BODY_A], rows.body[i, BODY_B]
        n_x, n_y = rows.data[i, N_X], rows.data[i, N_Y]
        arm_a, arm_b = rows.data[i, ARM_A], rows.data[i, ARM_B]
        p_n, p_t = rows.impulse[i, NORMAL], rows.impulse[i, TANGENT]
        p_x, p_y = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x
        v_x, v_y = v[b, V_X] - v[a, V_X], v[b, V_Y] - v[a, V_Y]
        turn = arm_a * v[a, V_S] + arm_b * v[b, V_S]
        along += v_x * p_x + v_y * p_y + turn * p_t
        change[a, 0] -= p_x
        change[a, 1] -= p_y
        change[a, 2] += 2.0 * arm_a * p_t
        change[b, 0] += p_x
        change[b, 1] += p_y
        change[b, 2] += 2.0 * arm_b * p_t
    energy = 0.0
    for i in range(v.shape[0]):
        # Δv = w p: m |Δv|² = w |p|². Walls have w = 0.
        p_x, p_y, p_s = change[i, 0], change[i, 1], change[i, 2]
        energy += v[i, INVERSE_MASS] * (p_x * p_x + p_y * p_y + 0.5 * p_s * p_s)
    return min(1.0, max(0.0, -along / energy)) if energy > 0.0 else 1.0


def projected(normal: np.ndarray, tangent: np.ndarray, friction) -> tuple[np.ndarray, np.ndarray]:
    """Impulses, (m,) each, cut to the friction cone as in a sweep. friction: one number, or one number a contact."""
    p_n = np.maximum(normal, 0.0)
    return p_n, np.clip(tangent, -friction * p_n, friction * p_n).astype(tangent.dtype, copy=False)
