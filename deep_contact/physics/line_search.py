"""How far to go along an impulse: the exact minimum of the contact energy on a line through zero."""

from __future__ import annotations

import numpy as np
from numba import njit

from deep_contact.physics.contact_solver import (
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


@njit(cache=True, error_model="numpy")
def best_share(rows, solver_bodies):
    """α = clip(−b·λ / λ·A λ, 0, 1) for the impulses λ of the rows; 1 where these change no velocity.

    α λ has the least energy ½ α² λ·A λ + α b·λ, with A = J M⁻¹ Jᵀ and b = J v⁻. rows: `Rows` with
    tangents. solver_bodies: velocities v⁻ before impulses, (n + 4, 4). One pass over the contacts, for λ·A λ is the
    kinetic energy, times 2, of what λ does to the bodies: Σ m |Δv|² + ½ m Δs², s = ω r.
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
