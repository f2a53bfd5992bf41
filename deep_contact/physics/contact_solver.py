"""The contact problem of one step: its rows, a sweep of Projected Gauss-Seidel over them, position correction.

For circles the arms from the centres to the contact point are parallel to the normal. A normal impulse therefore
turns nothing, an arm is one number instead of a vector, and the two rows of a contact do not see each other
(J_n M⁻¹ J_tᵀ = 0), so that both can be relaxed from the velocities read once.

With the arm l of a body of radius r, its surface moves tangentially at ω l = (l / r) s, where s = ω r is kept in
place of ω: for a disc (I = m r² / 2) an impulse λ_t changes s by 2 (l / r) λ_t / m, whatever its radius.

Without friction nothing turns and there are no tangent rows: where `friction` is None instead of a number, every stage
here leaves them out. None is a type of its own, so the choice falls when the caller is compiled. What is left computes
the same bits as μ = 0 does, since adding zeros changes none; a start with tangent impulses needs the general rows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.constants import (
    BAUMGARTE,
    LINEAR_SLOP,
    MAX_CORRECTION,
    POSITION_TOLERANCE,
    RESTITUTION_THRESHOLD,
    WALL_SKIN,
)
from deep_contact.physics.collision import SMALLEST_DISTANCE, wall_gap
from deep_contact.state import WALL_NORMALS


class Rows(NamedTuple):
    """The m contacts as the sweep wants them: packed row by row, so that one contact is one run of memory.

    | field   | meaning                                                                    | shape  |
    |---------|----------------------------------------------------------------------------|--------|
    | body    | a, b as indices into the moving velocities                                 | (m, 2) |
    | data    | n_x, n_y, normal mass, tangent mass, arm_a / r_a, arm_b / r_b, target v_n  | (m, 7) |
    | impulse | λ_n, λ_t, N·s                                                              | (m, 2) |

    Without friction, data is n_x, n_y, normal mass, target v_n, (m, 4), and impulse is λ_n, (m, 1).
    """

    body: np.ndarray
    data: np.ndarray
    impulse: np.ndarray


CONTRACT = {"contract"}
"""Let a * b + c be one fused operation: a fifth faster, nothing else is relaxed."""


@njit(cache=True)
def make_rows(capacity, dtype, friction=0.0):
    """Room for the rows of so many contacts, with numbers of the given kind: that of the moving velocities."""
    if friction is None:
        return Rows(np.empty((capacity, 2), np.uint32), np.empty((capacity, 4), dtype), np.empty((capacity, 1), dtype))
    return Rows(np.empty((capacity, 2), np.uint32), np.empty((capacity, 7), dtype), np.empty((capacity, 2), dtype))


@njit(cache=True, error_model="numpy")
def integrate_velocities(bodies, gravity, dt, moving):
    """Velocities after Δt of gravity (v + Δt M⁻¹ F of Eq 2.27), packed for the sweep.

    Fills moving, (n + 4, 4): v_x, v_y, s = ω r (m/s), 1 / m (1/kg). Its last four rows are the walls, at rest and
    infinitely heavy.
    """
    n = bodies.mass.shape[0]
    for i in range(n):
        moving[i, 0] = bodies.velocity[i, 0] + dt * gravity[0]
        moving[i, 1] = bodies.velocity[i, 1] + dt * gravity[1]
        moving[i, 2] = bodies.spin[i] * bodies.radius[i]
        moving[i, 3] = 1.0 / bodies.mass[i]
    moving[n:] = 0.0


@njit(cache=True, error_model="numpy")
def contact_rows(bodies, contacts, moving, restitution, room, friction=0.0):
    """Rows of all contacts, with the impulses that they start from. Returns `Rows` in the room, or in a larger one.

    Effective masses: 1 / (J M⁻¹ Jᵀ). Target of a contact that approaches faster than the threshold: -e v_n.
    """
    m = contacts.body_a.shape[0]
    if m > room.body.shape[0]:
        room = make_rows(m, room.data.dtype, friction)
    rows = Rows(room.body[:m], room.data[:m], room.impulse[:m])
    if friction is None:
        write_normal_rows(contacts, moving, restitution, rows)
    else:
        write_rows(bodies, contacts, moving, restitution, rows)
    return rows, room


@njit(cache=True, error_model="numpy")
def write_rows(bodies, contacts, moving, restitution, rows):
    """Fill the rows of all contacts: see `contact_rows`."""
    n = bodies.mass.shape[0]
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        n_x, n_y = contacts.normal[i, 0], contacts.normal[i, 1]
        arm_a = 1.0 + 0.5 * contacts.separation[i] / bodies.radius[a]
        arm_b = 1.0 + 0.5 * contacts.separation[i] / bodies.radius[b] if b < n else 0.0
        w_a, w_b = moving[a, 3], moving[b, 3]
        v_n = (moving[b, 0] - moving[a, 0]) * n_x + (moving[b, 1] - moving[a, 1]) * n_y
        rows.body[i, 0] = a
        rows.body[i, 1] = b
        rows.data[i, 0] = n_x
        rows.data[i, 1] = n_y
        rows.data[i, 2] = 1.0 / (w_a + w_b)
        rows.data[i, 3] = 1.0 / (w_a + w_b + 2.0 * (arm_a * arm_a * w_a + arm_b * arm_b * w_b))
        rows.data[i, 4] = arm_a
        rows.data[i, 5] = arm_b
        rows.data[i, 6] = -restitution * v_n if v_n < -RESTITUTION_THRESHOLD else 0.0
        rows.impulse[i, 0] = contacts.normal_start[i]
        rows.impulse[i, 1] = contacts.tangent_start[i]


@njit(cache=True, error_model="numpy")
def write_normal_rows(contacts, moving, restitution, rows):
    """Fill the rows of all contacts without friction: see `contact_rows`."""
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        n_x, n_y = contacts.normal[i, 0], contacts.normal[i, 1]
        v_n = (moving[b, 0] - moving[a, 0]) * n_x + (moving[b, 1] - moving[a, 1]) * n_y
        rows.body[i, 0] = a
        rows.body[i, 1] = b
        rows.data[i, 0] = n_x
        rows.data[i, 1] = n_y
        rows.data[i, 2] = 1.0 / (moving[a, 3] + moving[b, 3])
        rows.data[i, 3] = -restitution * v_n if v_n < -RESTITUTION_THRESHOLD else 0.0
        rows.impulse[i, 0] = contacts.normal_start[i]


@njit(cache=True)
def apply_impulses(rows, moving, friction=0.0):
    """Give the velocities, in place, the impulses that the rows start from: v ← v + M⁻¹ Jᵀ λ."""
    if friction is None:
        apply_normal_impulses(rows, moving)
    else:
        apply_both_impulses(rows, moving)


@njit(cache=True)
def apply_normal_impulses(rows, moving):
    """`apply_impulses` of rows without friction."""
    for i in range(rows.body.shape[0]):
        a, b = rows.body[i, 0], rows.body[i, 1]
        p_x, p_y = rows.impulse[i, 0] * rows.data[i, 0], rows.impulse[i, 0] * rows.data[i, 1]
        moving[a, 0] -= moving[a, 3] * p_x
        moving[a, 1] -= moving[a, 3] * p_y
        moving[b, 0] += moving[b, 3] * p_x
        moving[b, 1] += moving[b, 3] * p_y


@njit(cache=True)
def apply_both_impulses(rows, moving):
    """`apply_impulses` of rows with friction."""
    two = moving.dtype.type(2.0)
    for i in range(rows.body.shape[0]):
        a, b = rows.body[i, 0], rows.body[i, 1]
        n_x, n_y = rows.data[i, 0], rows.data[i, 1]
        p_n, p_t = rows.impulse[i, 0], rows.impulse[i, 1]
        p_x = p_n * n_x + p_t * n_y
        p_y = p_n * n_y - p_t * n_x
        w_a, w_b = moving[a, 3], moving[b, 3]
        moving[a, 0] -= w_a * p_x
        moving[a, 1] -= w_a * p_y
        moving[a, 2] += two * w_a * rows.data[i, 4] * p_t
        moving[b, 0] += w_b * p_x
        moving[b, 1] += w_b * p_y
        moving[b, 2] += two * w_b * rows.data[i, 5] * p_t


@njit(cache=True)
def sweep(rows, friction, moving):
    """One sweep of Projected Gauss-Seidel over all contacts, in place. Returns θ.

    θ = max over all rows of |λ_k − λ_{k−1}|, N·s (Algorithm 1, two-sided).
    """
    if friction is None:
        return sweep_normals(rows, moving)
    return sweep_both(rows, friction, moving)


@njit(cache=True, fastmath=CONTRACT)
def sweep_normals(rows, moving):
    """`sweep` without friction: the normal rows alone, clamped at 0. What is not said here is as in `sweep_both`."""
    body, data, impulse = rows.body, rows.data, rows.impulse
    theta = moving.dtype.type(0.0)
    in_hand = np.uint32(0)
    a_x, a_y, w_a = moving[0, 0], moving[0, 1], moving[0, 3]
    for i in range(body.shape[0]):
        a, b = body[i, 0], body[i, 1]
        if a != in_hand:
            moving[in_hand, 0], moving[in_hand, 1] = a_x, a_y
            a_x, a_y, w_a = moving[a, 0], moving[a, 1], moving[a, 3]
            in_hand = a
        b_x, b_y, w_b = moving[b, 0], moving[b, 1], moving[b, 3]
        n_x, n_y, k_n, target = data[i, 0], data[i, 1], data[i, 2], data[i, 3]
        old_n = impulse[i, 0]

        x_n, y_n = k_n * n_x, k_n * n_y
        free_n = k_n * target - x_n * b_x - y_n * b_y + x_n * a_x + y_n * a_y
        p_n = max(free_n, -old_n)
        impulse[i, 0] = old_n + p_n
        theta = max(theta, abs(p_n))

        a_x = a_x - w_a * n_x * p_n
        a_y = a_y - w_a * n_y * p_n
        moving[b, 0] = b_x + w_b * n_x * p_n
        moving[b, 1] = b_y + w_b * n_y * p_n
    moving[in_hand, 0], moving[in_hand, 1] = a_x, a_y
    return theta


@njit(cache=True, fastmath=CONTRACT)
def sweep_both(rows, friction, moving):
    """`sweep` with friction.

    Every contact relaxes its friction row, clamped by μ times the normal impulse it has, and its normal row, clamped
    at 0 (Box2D's order; Algorithm 1 of the thesis for the normal rows).
    """
    body, data, impulse = rows.body, rows.data, rows.impulse
    # In the precision of the velocities: a float64 among float32 would make all of them float64.
    two, mu, theta = moving.dtype.type(2.0), moving.dtype.type(friction), moving.dtype.type(0.0)
    # Contacts are sorted by body a, so its velocity stays in registers until the next a: it saves the trip through
    # memory that successive contacts of one body would wait for.
    in_hand = np.uint32(0)
    a_x, a_y, a_s, w_a = moving[0, 0], moving[0, 1], moving[0, 2], moving[0, 3]
    for i in range(body.shape[0]):
        a, b = body[i, 0], body[i, 1]
        if a != in_hand:
            moving[in_hand, 0], moving[in_hand, 1], moving[in_hand, 2] = a_x, a_y, a_s
            a_x, a_y, a_s, w_a = moving[a, 0], moving[a, 1], moving[a, 2], moving[a, 3]
            in_hand = a
        b_x, b_y, b_s, w_b = moving[b, 0], moving[b, 1], moving[b, 2], moving[b, 3]
        n_x, n_y, k_n, k_t = data[i, 0], data[i, 1], data[i, 2], data[i, 3]
        arm_a, arm_b, target = data[i, 4], data[i, 5], data[i, 6]
        old_n, old_t = impulse[i, 0], impulse[i, 1]

        # The change −k (v_b − v_a)·n, and likewise along t = (n_y, −n_x), cut to what keeps λ admissible. What a
        # contributes comes last, and λ is added outside of the chain of operations that the next contact waits for.
        x_n, y_n, x_t, y_t = k_n * n_x, k_n * n_y, k_t * n_y, k_t * n_x
        free_n = k_n * target - x_n * b_x - y_n * b_y + x_n * a_x + y_n * a_y
        free_t = -(k_t * arm_b) * b_s - x_t * b_x + y_t * b_y + x_t * a_x - y_t * a_y - k_t * arm_a * a_s
        largest = mu * old_n
        p_t = max(-largest - old_t, min(free_t, largest - old_t))
        p_n = max(free_n, -old_n)
        impulse[i, 0] = old_n + p_n
        impulse[i, 1] = old_t + p_t
        theta = max(theta, max(abs(p_n), abs(p_t)))

        a_x = a_x - w_a * n_x * p_n - w_a * n_y * p_t
        a_y = a_y - w_a * n_y * p_n + w_a * n_x * p_t
        a_s = a_s + two * w_a * arm_a * p_t
        moving[b, 0] = b_x + w_b * n_x * p_n + w_b * n_y * p_t
        moving[b, 1] = b_y + w_b * n_y * p_n - w_b * n_x * p_t
        moving[b, 2] = b_s + two * w_b * arm_b * p_t
    moving[in_hand, 0], moving[in_hand, 1], moving[in_hand, 2] = a_x, a_y, a_s
    return theta


@njit(cache=True)
def store_impulses(rows, contacts):
    """Write the solved impulses into the contacts, in place."""
    last = rows.impulse.shape[1] - 1
    for i in range(rows.body.shape[0]):
        contacts.normal_impulse[i] = rows.impulse[i, 0]
        contacts.tangent_impulse[i] = rows.impulse[i, last] if last else 0.0


@njit(cache=True, error_model="numpy")
def correct_positions(bodies, contacts, box, sweeps):
    """Push the circles apart, in place, until none penetrates deeper than three slops, or `sweeps` sweeps are done.

    Nonlinear Gauss-Seidel as in Box2D 2.3: each contact, at the positions as they are by then, moves its bodies by
    a share of the penetration beyond the slop, by their inverse masses. For circles nothing turns.
    """
    n = bodies.mass.shape[0]
    position, radius, mass = bodies.position, bodies.radius, bodies.mass
    for _ in range(sweeps):
        deepest = 0.0
        for i in range(contacts.body_a.shape[0]):
            a, b = contacts.body_a[i], contacts.body_b[i]
            x, y = position[a, 0], position[a, 1]
            if b < n:
                d_x, d_y = position[b, 0] - x, position[b, 1] - y
                reach = radius[a] + radius[b]
                least = max(reach - LINEAR_SLOP, 0.0)  # circles smaller than the slop must not be drawn together
                if d_x * d_x + d_y * d_y >= least * least:
                    continue  # Nothing to correct; found without a square root, and most contacts end here.
                distance = math.sqrt(d_x * d_x + d_y * d_y)
                separation = distance - reach
                push = min(BAUMGARTE * (least - distance), MAX_CORRECTION) / (mass[a] + mass[b])
                if distance < SMALLEST_DISTANCE:
                    d_x, d_y = 1.0, 0.0
                else:
                    push /= distance
                position[b, 0] += push * mass[a] * d_x
                position[b, 1] += push * mass[a] * d_y
                position[a, 0] = x - push * mass[b] * d_x
                position[a, 1] = y - push * mass[b] * d_y
            else:
                separation = wall_gap(x, y, box, b - n) - radius[a] - WALL_SKIN
                push = max(0.0, min(-BAUMGARTE * (separation + LINEAR_SLOP), MAX_CORRECTION))
                position[a, 0] = x - push * WALL_NORMALS[b - n, 0]
                position[a, 1] = y - push * WALL_NORMALS[b - n, 1]
            deepest = min(deepest, separation)
        if deepest >= -POSITION_TOLERANCE:
            break


def projected(normal: np.ndarray, tangent: np.ndarray, friction) -> tuple[np.ndarray, np.ndarray]:
    """Impulses (m,) with the normal ones cut at 0 and the tangent ones at the friction cone, as a sweep would.

    friction: one number, or one a contact.
    """
    return _projected(normal, tangent, np.broadcast_to(friction, normal.shape))


@njit(cache=True)
def _projected(normal, tangent, friction):
    p_n, p_t = np.empty_like(normal), np.empty_like(tangent)
    for i in range(normal.shape[0]):
        p_n[i] = max(normal[i], 0.0)
        p_t[i] = max(-friction[i] * p_n[i], min(tangent[i], friction[i] * p_n[i]))
    return p_n, p_t
