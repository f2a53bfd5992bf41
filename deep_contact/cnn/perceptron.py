"""The compiled part of `cnn.per_contact`: inputs, perceptron and correction of all contacts, in the steps of a solver.

The engine's compiled steps hold this code (`physics.engine` says so, for the code cache).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact.cnn.rows import row_velocity
from deep_contact.compiled.simd import doubled, load_like, most, spread, spread_like, store
from deep_contact.physics.contact_solver import (
    ARM_A,
    ARM_B,
    BODY_A,
    BODY_B,
    INVERSE_MASS,
    N_X,
    N_Y,
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    TANGENT_MASS,
    apply_impulses,
)
from deep_contact.physics.solvers.registry import Loop, make_workspace, register_loop, relax

INPUTS = (
    *("normal_free", "slip_free", "normal_velocity", "slip_velocity"),
    *("normal_impulse", "tangent_impulse", "normal_residual", "tangent_residual"),
    *("normal_jacobi", "tangent_jacobi", "impulses_sum", "impulses_difference"),
    *("residuals_sum", "residuals_difference", "fabric_normal", "fabric_tangent"),
    *("neighbours", "wall", "new", "unsolved"),
)
"""What the perceptron sees of a contact. Velocities before (free) and after Builtin's impulses; impulses and residuals
(what one relaxation would change) over effective masses; what one Jacobi step of all residuals would change here; sums
over the contacts of both bodies, and their difference; the bodies' fabric tensors Σ w λ_n n ⊗ n along normal and
tangent; number of contacts, whether one body is a wall, whether nothing is carried, share unsolved. Tangential ones
have the sign that makes slip_free positive."""

CORRECTIONS = tuple("scale normal normal_residual normal_jacobi tangent tangent_residual tangent_jacobi slip".split())
"""What the outputs gate, four for λ_n and four for λ_t: the effective mass times the scale; Builtin's impulse; the
change by one relaxation; minus the effective mass times what a Jacobi step would leave; the same for the tangent, and
the impulse that stops the free slip."""

_BOUNDED = 16
"""The inputs from here on are bounded and are not compressed."""

HIDDEN = 16
"""Width of the hidden layer."""

BLOCK = 64
"""Contacts whose inputs, hidden units and outputs are in the cache together."""

_SAMPLE = 64
"""Contacts of which the share unsolved is taken, at most."""

_SMALL = 1e-2
"""Share of the carried impulses in the scale, so that the tiny residual of a resting pile is not magnified."""

_F_N, _F_T, _V_N, _V_T, _R_N, _R_T = range(6)
"""Columns of the measures of a contact: velocity before and after impulses, m/s; change by one relaxation, N·s."""

_D_X, _D_Y, _D_S, _SUM, _RESIDUAL, _COUNT, _XX, _XY = range(8)
"""Columns of the sums of a body: velocity by a Jacobi step, Σ w λ_n, Σ w r_n, contacts, fabric tensor."""


class Perceptron(NamedTuple):
    """Weights, float32, with the two layers' biases in their last rows, and where it is left out.

    | field  | meaning                                                  | shape                        |
    |--------|----------------------------------------------------------|------------------------------|
    | first  | inputs to hidden units (ReLU)                            | (`INPUTS` + 1, `HIDDEN`)     |
    | second | hidden units to gates                                    | (`HIDDEN` + 1, `CORRECTIONS`)|
    | least  | share unsolved below which the start is Builtin's        |                              |
    """

    first: np.ndarray
    second: np.ndarray
    least: float


@njit(cache=True, error_model="numpy")
def _relaxation(rows, v_n, v_t, friction, i):
    """Change of λ_n and λ_t by relaxing contact i alone, N·s, from its velocities, m/s."""
    k_n, k_t = rows.data[i, NORMAL_MASS], rows.data[i, TANGENT_MASS]
    p_n, p_t = rows.impulse[i, NORMAL], rows.impulse[i, TANGENT]
    largest = friction * max(p_n, 0.0)
    return max(-k_n * v_n, -p_n), max(-largest, min(p_t - k_t * v_t, largest)) - p_t


@njit(cache=True, error_model="numpy")
def sampled_share(rows, after, friction):
    """Share unsolved: rms change by one relaxation over the sum of it and the rms impulse, in velocities; 0 to 1.

    after: velocities after the rows' impulses. Of `_SAMPLE` contacts at most.
    """
    m = rows.body.shape[0]
    unsolved = carried = 0.0
    for i in range(0, m, m // _SAMPLE + 1):
        k_n, k_t = rows.data[i, NORMAL_MASS], rows.data[i, TANGENT_MASS]
        v_n, v_t = row_velocity(rows, after, i)
        r_n, r_t = _relaxation(rows, v_n, v_t, friction, i)
        unsolved += (r_n / k_n) ** 2 + (r_t / k_t) ** 2
        carried += (rows.impulse[i, NORMAL] / k_n) ** 2
    unsolved, carried = math.sqrt(unsolved), math.sqrt(carried)
    return unsolved / (unsolved + carried) if unsolved > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def _measure(rows, free, after, friction):
    """(measures of the contacts (m, 6), sums of the bodies (n + 4, 8), scale in m/s, share unsolved)."""
    m = rows.body.shape[0]
    found, sums = np.empty((m, 6)), np.zeros((free.shape[0], 8))
    unsolved = carried = 0.0
    for i in range(m):
        k_n, k_t = rows.data[i, NORMAL_MASS], rows.data[i, TANGENT_MASS]
        n_x, n_y, p_n = rows.data[i, N_X], rows.data[i, N_Y], rows.impulse[i, NORMAL]
        f_n, f_t = row_velocity(rows, free, i)
        v_n, v_t = row_velocity(rows, after, i)
        r_n, r_t = _relaxation(rows, v_n, v_t, friction, i)
        found[i, _F_N], found[i, _F_T], found[i, _V_N], found[i, _V_T] = f_n, f_t, v_n, v_t
        found[i, _R_N], found[i, _R_T] = r_n, r_t
        unsolved += (r_n / k_n) ** 2 + (r_t / k_t) ** 2
        carried += (p_n / k_n) ** 2
        x, y = r_n * n_x + r_t * n_y, r_n * n_y - r_t * n_x
        xx, xy = n_x * n_x - n_y * n_y, 2.0 * n_x * n_y
        for side in range(2):
            body = rows.body[i, side]
            w, sign = free[body, INVERSE_MASS], 2.0 * side - 1.0
            sums[body, _D_X] += sign * w * x
            sums[body, _D_Y] += sign * w * y
            sums[body, _D_S] += 2.0 * w * rows.data[i, ARM_A + side] * r_t
            sums[body, _SUM] += w * p_n
            sums[body, _RESIDUAL] += w * r_n
            sums[body, _COUNT] += 1.0 if w > 0.0 else 0.0
            sums[body, _XX] += w * p_n * xx
            sums[body, _XY] += w * p_n * xy
    unsolved, carried = math.sqrt(unsolved / max(m, 1)), math.sqrt(carried / max(m, 1))
    scale = math.sqrt(unsolved**2 + (_SMALL * carried) ** 2)
    if not scale > 1e-150:
        scale = 1.0
    return found, sums, scale, unsolved / (unsolved + carried) if unsolved > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def _write_inputs(rows, found, sums, scale, unsolved, first, count, x, change):
    """Fill x (20, BLOCK) with the inputs, and change (8, BLOCK) with the corrections, of contacts from `first` on."""
    per = 1.0 / scale
    for j in range(count):
        i = first + j
        a, b = rows.body[i, BODY_A], rows.body[i, BODY_B]
        n_x, n_y = rows.data[i, N_X], rows.data[i, N_Y]
        k_n, k_t = rows.data[i, NORMAL_MASS], rows.data[i, TANGENT_MASS]
        p_n, p_t = rows.impulse[i, NORMAL], rows.impulse[i, TANGENT]
        f_t, r_n, r_t = found[i, _F_T], found[i, _R_N], found[i, _R_T]
        d_x, d_y = sums[b, _D_X] - sums[a, _D_X], sums[b, _D_Y] - sums[a, _D_Y]
        j_n = d_x * n_x + d_y * n_y
        j_t = d_x * n_y - d_y * n_x + rows.data[i, ARM_A] * sums[a, _D_S] + rows.data[i, ARM_B] * sums[b, _D_S]
        xx, xy = n_x * n_x - n_y * n_y, 2.0 * n_x * n_y
        t_xx, t_xy = sums[a, _XX] + sums[b, _XX], sums[a, _XY] + sums[b, _XY]
        u_n, u_t = per / k_n, per / k_t
        turn = 1.0 if f_t >= 0.0 else -1.0
        x[0, j], x[1, j] = per * found[i, _F_N], per * turn * f_t
        x[2, j], x[3, j] = per * found[i, _V_N], per * turn * found[i, _V_T]
        x[4, j], x[5, j] = u_n * p_n, u_n * turn * p_t
        x[6, j], x[7, j] = u_n * r_n, u_t * turn * r_t
        x[8, j], x[9, j] = per * j_n, per * turn * j_t
        x[10, j], x[11, j] = per * (sums[a, _SUM] + sums[b, _SUM]), per * abs(sums[a, _SUM] - sums[b, _SUM])
        x[12, j] = per * (sums[a, _RESIDUAL] + sums[b, _RESIDUAL])
        x[13, j] = per * abs(sums[a, _RESIDUAL] - sums[b, _RESIDUAL])
        x[14, j], x[15, j] = per * (t_xx * xx + t_xy * xy), per * turn * (t_xx * xy - t_xy * xx)
        x[16, j] = 0.5 * (sums[a, _COUNT] + sums[b, _COUNT]) - 3.0
        x[17, j] = 1.0 if sums[a, _COUNT] == 0.0 or sums[b, _COUNT] == 0.0 else 0.0
        x[18, j] = 1.0 if p_n == 0.0 and p_t == 0.0 else 0.0
        x[19, j] = 4.0 * unsolved - 1.0
        change[0, j], change[1, j], change[2, j], change[3, j] = k_n * scale, p_n, r_n, -k_n * j_n
        change[4, j], change[5, j], change[6, j], change[7, j] = p_t, r_t, -k_t * j_t, -k_t * f_t


@njit(cache=True, error_model="numpy")
def _compress(x):
    """x / (1 + |x| / 4) of the unbounded inputs, in place: bounded by 4, and vectorised, as arsinh is not."""
    flat = x[:_BOUNDED].reshape(_BOUNDED * x.shape[1])
    most_of_it = np.float32(4.0)
    for k in range(flat.shape[0]):
        flat[k] = most_of_it * flat[k] / (most_of_it + abs(flat[k]))


@njit(cache=True)
def _layer(weights, inputs, outputs, x, y, lowest):
    """y = max(lowest, W x + b), eight outputs of sixteen contacts at a time: their sums stay in registers.

    weights: flattened (inputs + 1, outputs), the biases last. x, y: flattened (inputs, BLOCK), (outputs, BLOCK).
    """
    zero = doubled(spread(np.float32(0.0)))
    least = spread_like(zero, lowest)
    for group in range(BLOCK // 16):
        for o in range(0, outputs, 8):
            at = inputs * outputs + o
            a0, a1 = spread_like(zero, weights[at]), spread_like(zero, weights[at + 1])
            a2, a3 = spread_like(zero, weights[at + 2]), spread_like(zero, weights[at + 3])
            a4, a5 = spread_like(zero, weights[at + 4]), spread_like(zero, weights[at + 5])
            a6, a7 = spread_like(zero, weights[at + 6]), spread_like(zero, weights[at + 7])
            for j in range(inputs):
                at, value = j * outputs + o, load_like(zero, x, j * (BLOCK // 8) + 2 * group)
                a0 = a0 + value * spread_like(zero, weights[at])
                a1 = a1 + value * spread_like(zero, weights[at + 1])
                a2 = a2 + value * spread_like(zero, weights[at + 2])
                a3 = a3 + value * spread_like(zero, weights[at + 3])
                a4 = a4 + value * spread_like(zero, weights[at + 4])
                a5 = a5 + value * spread_like(zero, weights[at + 5])
                a6 = a6 + value * spread_like(zero, weights[at + 6])
                a7 = a7 + value * spread_like(zero, weights[at + 7])
            to = o * (BLOCK // 8) + 2 * group
            step = BLOCK // 8
            store(y, to, most(a0, least))
            store(y, to + step, most(a1, least))
            store(y, to + 2 * step, most(a2, least))
            store(y, to + 3 * step, most(a3, least))
            store(y, to + 4 * step, most(a4, least))
            store(y, to + 5 * step, most(a5, least))
            store(y, to + 6 * step, most(a6, least))
            store(y, to + 7 * step, most(a7, least))


@njit(cache=True)
def _gate(gates, change, corrections):
    """Fill corrections (2, BLOCK) with Σ gate · change of the normal and of the tangent impulses; in vectors."""
    for k in range(2):
        at = 4 * k * BLOCK
        for j in range(BLOCK):
            first = gates[at + j] * change[at + j] + gates[at + BLOCK + j] * change[at + BLOCK + j]
            at_2 = at + 2 * BLOCK
            second = gates[at_2 + j] * change[at_2 + j] + gates[at_2 + BLOCK + j] * change[at_2 + BLOCK + j]
            corrections[k, j] = first + second


@njit(cache=True, error_model="numpy")
def correct(network, rows, free, after, friction):
    """Correct the impulses of the rows, in place. free, after: velocities before and after them, (n + 4, 4)."""
    found, sums, scale, unsolved = _measure(rows, free, after, friction)
    x, hidden = np.zeros((len(INPUTS), BLOCK), np.float32), np.empty(HIDDEN * BLOCK, np.float32)
    gates, change = np.empty(len(CORRECTIONS) * BLOCK, np.float32), np.zeros((len(CORRECTIONS), BLOCK))
    corrections, flat = np.empty((2, BLOCK)), x.reshape(x.size)
    first_weights, second_weights = (
        network.first.reshape(network.first.size),
        network.second.reshape(network.second.size),
    )
    for first in range(0, rows.body.shape[0], BLOCK):
        count = min(BLOCK, rows.body.shape[0] - first)
        _write_inputs(rows, found, sums, scale, unsolved, first, count, x, change)
        _compress(x)
        _layer(first_weights, len(INPUTS), HIDDEN, flat, hidden, np.float32(0.0))
        _layer(second_weights, HIDDEN, len(CORRECTIONS), hidden, gates, np.float32(-np.inf))
        _gate(gates, change.reshape(change.size), corrections)
        for j in range(count):
            i = first + j
            p_n = max(rows.impulse[i, NORMAL] + corrections[0, j], 0.0)
            p_t = rows.impulse[i, TANGENT] + corrections[1, j]
            rows.impulse[i, NORMAL] = p_n
            rows.impulse[i, TANGENT] = max(-friction * p_n, min(p_t, friction * p_n))


@njit(cache=True)
def apply_corrected(settings, rows, friction, solver_bodies):
    """Give the velocities, in place, the impulses of the rows, corrected first where that pays. See `registry.Loop`."""
    free = solver_bodies.copy()
    apply_impulses(rows, solver_bodies)
    if sampled_share(rows, solver_bodies, friction) >= settings.network.least:
        correct(settings.network, rows, free, solver_bodies, friction)
        solver_bodies[:] = free
        apply_impulses(rows, solver_bodies)


@njit(cache=True)
def described(rows, free, after, friction):
    found, sums, scale, unsolved = _measure(rows, free, after, friction)
    m = rows.body.shape[0]
    inputs, corrections = np.zeros((m, len(INPUTS)), np.float32), np.empty((m, len(CORRECTIONS)))
    x, change = np.zeros((len(INPUTS), BLOCK), np.float32), np.empty((len(CORRECTIONS), BLOCK))
    for first in range(0, m, BLOCK):
        count = min(BLOCK, m - first)
        _write_inputs(rows, found, sums, scale, unsolved, first, count, x, change)
        _compress(x)
        inputs[first : first + count] = x.T[:count]
        corrections[first : first + count] = change.T[:count]
    return inputs, corrections, unsolved


class LearnedSettings(NamedTuple):
    """Settings of a solver whose steps start from the perceptron: those of the solver, and the `Perceptron`."""

    inner: NamedTuple
    network: Perceptron


@njit(cache=True)
def relax_inner(settings, rows, friction, solver_bodies, theta, workspace):
    """The sweeps of the solver itself."""
    inner = settings.inner
    return relax(inner, rows, friction, solver_bodies, theta, make_workspace(inner, rows, solver_bodies))


register_loop(
    Loop(LearnedSettings, relax_inner, frictionless=False, counts_relaxations=True, apply_start=apply_corrected)
)
