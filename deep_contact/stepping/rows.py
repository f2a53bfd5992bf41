"""The contact problem of one step: its rows, and a sweep of Projected Gauss-Seidel over them.

For circles the arms from the centres to the contact point are parallel to the normal. A normal impulse therefore causes
no rotation, an arm is one number instead of a vector, and the two rows of a contact are decoupled (J_n M⁻¹ J_tᵀ = 0).
Both rows can be relaxed from velocities that are read once.

If l is the arm of a body of radius r, its surface moves tangentially at ω l = (l / r) s, with s = ω r. The engine
stores s in place of ω: for a disc (I = m r² / 2) an impulse λ_t changes s by 2 (l / r) λ_t / m, whatever its radius.

If μ depends on the materials of a pair, `friction` is a `PairTable`, and each row has its own μ in a column of its own
(`friction_of`).

Rolling resistance adds a third row to each contact: a torque impulse λ_r with |λ_r| ≤ ρ λ_n against the difference of
the two spins (elastic-plastic models reduce to this for rigid contacts: Ai, Chen, Rotter and Ooi, Powder Technology
206, 2011, type A). Then `friction` is a `Rough`. λ_r is not carried from step to step: `start_rolling` finds it anew
from the other impulses.

Without friction no impulse rotates a circle. If `friction` is None instead of a number, every function here leaves the
tangent rows out. For Numba, None has a type of its own. So the choice is made when the caller is compiled, and costs no
time in a sweep. The result has the same bits as with μ = 0. A start with tangent impulses needs rows with tangents.

`sweep` relaxes one contact at a time. `solvers.batched.sweep_tiles` relaxes eight at a time. `cnn.through_solver` goes
through sweeps backwards, for the gradient of the error that they leave.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import overload

from deep_contact.compiled import njit
from deep_contact.stepping.pairs import PairTable, Rough, is_rough, is_rough_type, is_table, is_table_type, value_of
from deep_contact.stepping.segments import is_moving, surface_velocity, wall_velocity

V_X, V_Y, V_S, INVERSE_MASS = range(4)
"""Columns of the array of solver bodies, (n + 4, 4): velocity of the centre, m/s; s = ω r, m/s; 1 / m, 1/kg.

The last four rows stand for the walls: at rest, with an inverse mass of 0. Segments share the last of these rows. If
surfaces move, s of this row is 1, and the arm of a contact with a segment is the speed of the surface, so that the
segment drags the circle (`move_surfaces`). If segments move, there are further rows: one for each contact with a moving
segment, with the segment's velocity at this contact (`move_walls`)."""

BODY_A, BODY_B = range(2)
"""Columns of `Rows.body`: the two bodies of a contact."""

N_X, N_Y, NORMAL_MASS, TANGENT_MASS, ARM_A, ARM_B, FRICTION, ROLLING, ROLL_MASS, TURN_A, TURN_B = range(11)
"""Columns of `Rows.data`: unit normal; effective masses of the normal and the tangent row, kg; arm over radius of each
body; μ, only if it depends on the pair. With rolling resistance also ρ, m; effective inertia of the rolling row, kg·m²;
1 / radius of each body, 1/m, 0 for a wall."""

NORMAL, TANGENT, ROLL = range(3)
"""Columns of `Rows.impulse`: λ_n and λ_t, N·s; with rolling resistance λ_r, N·m·s."""

ROLLING_STARTS = 10
"""Number of sweeps over the rolling rows alone before the sweeps over all rows (`start_rolling`)."""


class Rows(NamedTuple):
    """The rows of m contacts. All numbers of one contact lie side by side, so that a sweep reads memory in order."""

    body: np.ndarray  # (m, 2): indices of two solver bodies: `BODY_A`, `BODY_B`
    data: np.ndarray  # (m, 6): `N_X` to `ARM_B`; (m, 7) with μ; (m, 11) with rolling; (m, 3) without friction
    impulse: np.ndarray  # (m, 2): `NORMAL`, `TANGENT`; (m, 3) with rolling; without friction (m, 1): λ_n


CONTRACT = {"contract"}
"""Fast-math flag: a * b + c may be one fused operation. No other rule of arithmetic is relaxed."""

SUMS = {"contract", "reassoc"}
"""Fast-math flags of sums over all rows: several partial sums at once, in an order that is fixed at compile time."""


def make_rows(capacity, friction):
    """Return uninitialised rows for `capacity` contacts.

    friction: as in `StepInput`; None for rows without tangents.
    """
    columns, kinds = (3, 1) if friction is None else sizes_of(friction)
    return Rows(np.empty((capacity, 2), np.uint32), np.empty((capacity, columns)), np.empty((capacity, kinds)))


def sizes_of(friction) -> tuple[int, int]:
    """Return the numbers of columns of `Rows.data` and `Rows.impulse` with tangents. friction: as in `StepInput`."""
    return (11, 3) if isinstance(friction, Rough) else (7, 2) if isinstance(friction, PairTable) else (6, 2)


@overload(sizes_of)
def _overload_sizes_of(friction):
    if is_rough_type(friction):
        return lambda friction: (11, 3)
    return (lambda friction: (7, 2)) if is_table_type(friction) else (lambda friction: (6, 2))


more_rows = njit(cache=True)(make_rows)
"""`make_rows`, compiled, for compiled callers."""


def friction_of(friction, data, i):
    """Return μ of row i. friction: as in `StepInput`. data: `Rows.data`."""
    return data[i, FRICTION] if is_table(friction) else value_of(friction, 0, 0)


def write_friction(friction, rows, i, bodies, inverse_masses, radius) -> None:
    """Write the columns of friction into row i, in place: μ if it is a table, ρ and its masses if there is rolling.

    λ_r becomes 0. friction: as in `StepInput`. bodies: indices (a, b) as in `Contacts`. inverse_masses: inverse masses
    of both bodies, 1/kg. radius: (n,), m.
    """
    if is_table(friction):
        rows.data[i, FRICTION] = value_of(friction, *bodies)
    if is_rough(friction):
        write_rolling(friction.rolling, rows, i, bodies, inverse_masses, radius)


def relax_rolling(friction, body, data, impulse, i, v, spin, inverse_masses, largest):
    """Relax the rolling row i, if there is one (`roll`). Returns s of the first body, and the largest change so far.

    The fields of `Rows` are arguments of their own, since Numba would count references to arrays in a tuple.
    """
    if is_rough(friction):
        return roll(body, data, impulse, i, v, spin, inverse_masses, largest)
    return spin, largest


def scale_rolling(friction, rows, i, omega) -> None:
    """Multiply the effective inertia of the rolling row i by ω, in place, if there is such a row."""
    if is_rough(friction):
        rows.data[i, ROLL_MASS] *= omega


def start_rolling(friction, rows, v) -> None:
    """Do `ROLLING_STARTS` sweeps over the rolling rows alone, if there are any, in place.

    Only λ_r and the spins change. In a pile at rest, the torques of friction are then in balance before the first sweep
    over all rows.
    """
    if is_rough(friction):
        roll_all(rows, v)


@njit(cache=True, error_model="numpy")
def write_rolling(rolling, rows, i, bodies, inverse_masses, radius):
    """Write the columns of rolling resistance into row i, in place. The arguments are those of `write_friction`."""
    (a, b), (w_a, w_b), data = bodies, inverse_masses, rows.data
    turn_a, turn_b = 1.0 / radius[a], 1.0 / radius[b] if b < radius.shape[0] else 0.0
    data[i, ROLLING], data[i, TURN_A], data[i, TURN_B] = value_of(rolling, a, b), turn_a, turn_b
    data[i, ROLL_MASS] = 0.5 / (w_a * turn_a * turn_a + w_b * turn_b * turn_b)
    rows.impulse[i, ROLL] = 0.0


@njit(cache=True, fastmath=CONTRACT)
def roll(body, data, impulse, i, v, spin, inverse_masses, largest):
    """Relax the rolling row i: λ_r against the difference ω_b − ω_a of the spins, clamped to ±ρ λ_n.

    The change of λ_r is −k (ω_b − ω_a), where k is the effective inertia. s of the second body changes in place. spin:
    s of the first body, m/s. inverse_masses: of both bodies, 1/kg. Returns the new s of the first body, m/s, and the
    larger of `largest` and the change of λ_r over the smaller radius, N·s.
    """
    b, (w_a, w_b) = body[i, BODY_B], inverse_masses
    turn_a, turn_b = data[i, TURN_A], data[i, TURN_B]
    old, bound = impulse[i, ROLL], data[i, ROLLING] * max(impulse[i, NORMAL], 0.0)
    free = data[i, ROLL_MASS] * (turn_a * spin - turn_b * v[b, V_S])
    p = max(-bound - old, min(free, bound - old))
    impulse[i, ROLL] = old + p
    v[b, V_S] += 2.0 * w_b * turn_b * p
    return spin - 2.0 * w_a * turn_a * p, max(largest, abs(p) * max(turn_a, turn_b))


@njit(cache=True)
def roll_all(rows, v):
    """Do the sweeps of `start_rolling`, in place."""
    for _ in range(ROLLING_STARTS):
        for i in range(rows.body.shape[0]):
            a, b = rows.body[i, BODY_A], rows.body[i, BODY_B]
            masses = v[a, INVERSE_MASS], v[b, INVERSE_MASS]
            v[a, V_S], _ = roll(rows.body, rows.data, rows.impulse, i, v, v[a, V_S], masses, 0.0)


def work_of_rolling(friction, rows, bodies) -> float:
    """Return the work of fixed circles on free circles by rolling resistance, J; 0 if there are no rolling rows.

    A fixed circle that turns at ω does the work −ω τ Δt, where τ Δt is the torque impulse on it: λ_r if it is the
    second body, and −λ_r if it is the first. friction: as in `StepInput`. bodies: `Bodies`.
    """
    return work_of_rows(rows.body, rows.impulse, bodies.mass, bodies.spin) if is_rough(friction) else 0.0


@njit(cache=True)
def work_of_rows(body, impulse, mass, spin):
    """Do `work_of_rolling` for rows with rolling resistance. mass, spin: of the circles, (n,), kg and rad/s."""
    work, n = 0.0, mass.shape[0]
    for i in range(body.shape[0]):
        a, b = body[i, BODY_A], body[i, BODY_B]
        if mass[a] == np.inf:
            work += impulse[i, ROLL] * spin[a]
        if b < n and mass[b] == np.inf:
            work -= impulse[i, ROLL] * spin[b]
    return work


@overload(friction_of)
def _overload_friction_of(friction, data, i):
    if is_table_type(friction):
        return lambda friction, data, i: data[i, FRICTION]
    if is_rough_type(friction):
        return lambda friction, data, i: friction.friction
    return lambda friction, data, i: friction


@overload(write_friction)
def _overload_write_friction(friction, rows, i, bodies, inverse_masses, radius):
    def nothing(friction, rows, i, bodies, inverse_masses, radius):
        pass

    def of_table(friction, rows, i, bodies, inverse_masses, radius):
        rows.data[i, FRICTION] = value_of(friction, bodies[0], bodies[1])

    def of_rolling(friction, rows, i, bodies, inverse_masses, radius):
        write_rolling(friction.rolling, rows, i, bodies, inverse_masses, radius)

    def of_both(friction, rows, i, bodies, inverse_masses, radius):
        rows.data[i, FRICTION] = value_of(friction, bodies[0], bodies[1])
        write_rolling(friction.rolling, rows, i, bodies, inverse_masses, radius)

    choices = {(False, False): nothing, (True, False): of_table, (False, True): of_rolling, (True, True): of_both}
    return choices[is_table_type(friction), is_rough_type(friction)]


@overload(relax_rolling)
def _overload_relax_rolling(friction, body, data, impulse, i, v, spin, inverse_masses, largest):
    def relax(friction, body, data, impulse, i, v, spin, inverse_masses, largest):
        return roll(body, data, impulse, i, v, spin, inverse_masses, largest)

    def keep(friction, body, data, impulse, i, v, spin, inverse_masses, largest):
        return spin, largest

    return relax if is_rough_type(friction) else keep


@overload(scale_rolling)
def _overload_scale_rolling(friction, rows, i, omega):
    if is_rough_type(friction):

        def scale(friction, rows, i, omega):
            rows.data[i, ROLL_MASS] *= omega

        return scale
    return lambda friction, rows, i, omega: None


@overload(start_rolling)
def _overload_start_rolling(friction, rows, v):
    if is_rough_type(friction):
        return lambda friction, rows, v: roll_all(rows, v)
    return lambda friction, rows, v: None


@overload(work_of_rolling)
def _overload_work_of_rolling(friction, rows, bodies):
    if is_rough_type(friction):
        return lambda friction, rows, bodies: work_of_rows(rows.body, rows.impulse, bodies.mass, bodies.spin)
    return lambda friction, rows, bodies: 0.0


def frictions(rows: Rows, friction) -> float | np.ndarray:
    """Return μ of the rows for Python: one number, or the number of each row, (m,). friction: as in `StepInput`."""
    return rows.data[:, FRICTION] if is_table(friction) else value_of(friction, 0, 0)


@njit(inline="always")
def with_wall_bodies(solver_bodies, contacts, n, actuation):
    """Return solver bodies with one more row for each contact with a moving segment.

    Without such contacts the result is the array `solver_bodies`; otherwise it is a larger one, uninitialised. n:
    number of circles. actuation: `Actuation` of the step, or None.
    """
    if actuation is None:
        return solver_bodies
    more = 0
    for i in range(contacts.body_b.shape[0]):
        s = contacts.body_b[i] - n - 4
        more += s >= 0 and is_moving(actuation.wall, s)
    return solver_bodies if more == 0 else np.empty((n + 4 + more, 4))


@njit(cache=True, error_model="numpy")
def contact_rows(contacts, radius, segments, solver_bodies, buffer, friction, share):
    """Return the rows of the contacts. Their starting impulses are those of the contacts times the number `share`.

    The rows are views of `buffer`, which is a `Rows`, or of a larger one. Effective masses are 1 / (J M⁻¹ Jᵀ). If
    segments move, `move_walls` has to follow. radius: (n,), m. segments: `Segments`, or None. solver_bodies: (N, 4),
    with inverse masses. friction: as in `StepInput`, or None for rows without tangents.
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
            pair = contacts.body_a[i], contacts.body_b[i]
            write_friction(friction, rows, i, pair, (v[a, INVERSE_MASS], v[b, INVERSE_MASS]), radius)
            rows.impulse[i, TANGENT] = share * contacts.tangent_start[i]
    if friction is not None:
        if segments is not None:
            move_surfaces(contacts, segments, solver_bodies, rows, last)
    return rows


@njit(cache=True)
def relative_velocity(rows, v, i):
    """Return the velocity of the second body relative to the first at contact i, along normal and tangent, m/s.

    v: solver bodies, (N, 4).
    """
    a, b, n_x, n_y = rows.body[i, BODY_A], rows.body[i, BODY_B], rows.data[i, N_X], rows.data[i, N_Y]
    d_x, d_y = v[b, V_X] - v[a, V_X], v[b, V_Y] - v[a, V_Y]
    turn = rows.data[i, ARM_A] * v[a, V_S] + rows.data[i, ARM_B] * v[b, V_S]
    return d_x * n_x + d_y * n_y, d_x * n_y - d_y * n_x + turn


@njit(cache=True, error_model="numpy")
def arms_of(radius, a, b, separation):
    """Return the arms of the bodies a and b of a contact, divided by their radii; 0 for a wall or segment.

    radius: (n,), m. separation: m.
    """
    arm_b = 1.0 + 0.5 * separation / radius[b] if b < radius.shape[0] else 0.0
    return 1.0 + 0.5 * separation / radius[a], arm_b


@njit(cache=True, error_model="numpy")
def row_masses(w_a, w_b, arms):
    """Return the effective masses of the normal and the tangent row, kg.

    w_a, w_b: inverse masses of the two bodies, 1/kg. arms: arms over radii, from `arms_of`.
    """
    arm_a, arm_b = arms
    return 1.0 / (w_a + w_b), 1.0 / (w_a + w_b + 2.0 * (arm_a * arm_a * w_a + arm_b * arm_b * w_b))


@njit(cache=True)
def move_surfaces(contacts, segments, solver_bodies, rows, last):
    """Write the speeds of the segments' surfaces into rows with tangents and into the solver bodies, in place.

    last: index of the solver body that the segments share.
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
    """Add a solver body with the velocity of the segment for each contact with a moving segment, in place.

    n: number of circles. actuation: `Actuation` of the step.
    """
    row = last = n + 3
    for i in range(contacts.body_a.shape[0]):
        s = contacts.body_b[i] - last - 1
        if s >= 0 and is_moving(actuation.wall, s):
            row += 1
            v_x, v_y = wall_velocity(segments.line, actuation.wall, s, contacts.position[i, 0], contacts.position[i, 1])
            solver_bodies[row, V_X], solver_bodies[row, V_Y], solver_bodies[row, V_S] = v_x, v_y, 1.0
            rows.body[i, BODY_B] = row


@njit(cache=True)
def apply_impulses(rows, solver_bodies, friction):
    """Apply the starting impulses of the rows to the velocities of the solver bodies, in place: v ← v + M⁻¹ Jᵀ λ.

    Rolling rows start from λ_r = 0 (`start_rolling`).
    """
    arms, p_t = (0.0, 0.0), 0.0
    for i in range(rows.body.shape[0]):
        normal, p_n = (rows.data[i, N_X], rows.data[i, N_Y]), rows.impulse[i, NORMAL]
        if friction is not None:
            arms, p_t = (rows.data[i, ARM_A], rows.data[i, ARM_B]), rows.impulse[i, TANGENT]
        apply_impulse(solver_bodies, rows.body[i, BODY_A], rows.body[i, BODY_B], normal, arms, (p_n, p_t))
    start_rolling(friction, rows, solver_bodies)


@njit(cache=True)
def apply_impulse(v, a, b, normal, arms, impulse):
    """Apply an impulse (λ_n, λ_t), N·s, to two solver bodies, in place. arms: arms of the bodies over their radii.

    v: solver bodies, (N, 4). a, b: indices of the two.
    """
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
    """Do one sweep of Projected Gauss-Seidel over all contacts, in place. Returns θ, N·s.

    Every contact relaxes its friction row, clamped to ±μ times its present normal impulse, and its normal row, clamped
    at 0 (Box2D's order; Algorithm 1 of the thesis for the normal rows). θ = max over all rows of |λ_k − λ_{k−1}|, where
    k counts the sweeps. friction: as in `StepInput`, or None for rows without tangents. solver_bodies: (N, 4).
    """
    v = solver_bodies
    body, data, impulse = rows.body, rows.data, rows.impulse
    theta = 0.0
    # Contacts are sorted by body a. Its velocity stays in registers until the next a, so that successive contacts of
    # one body need not wait for memory.
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

        # The change of λ_n is −k (v_b − v_a)·n, clamped so that λ_n stays >= 0. The contribution of a comes last, and
        # λ_n is added separately, because the next contact waits for the velocity of a.
        x_n, y_n = k_n * n_x, k_n * n_y
        free_n = 0.0 - x_n * b_x - y_n * b_y + x_n * a_x + y_n * a_y
        p_n = max(free_n, -old_n)
        largest = abs(p_n)
        if friction is not None:
            # The rolling row, if there is one, is relaxed first. Its bound is ρ times the present λ_n.
            a_s, largest = relax_rolling(friction, body, data, impulse, i, v, a_s, (w_a, w_b), largest)
        impulse[i, NORMAL] = old_n + p_n
        if friction is not None:
            # The change of λ_t along t = (n_y, −n_x), clamped to Coulomb's bounds.
            b_s, k_t, arm_a, arm_b = v[b, V_S], data[i, TANGENT_MASS], data[i, ARM_A], data[i, ARM_B]
            old_t, bound = impulse[i, TANGENT], friction_of(friction, data, i) * max(old_n, 0.0)
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
    """Write the solved impulses of a substep, times the number of substeps, into the contacts, in place."""
    last = min(rows.impulse.shape[1] - 1, TANGENT)
    for i in range(rows.body.shape[0]):
        contacts.normal_impulse[i] = substeps * rows.impulse[i, NORMAL]
        contacts.tangent_impulse[i] = substeps * rows.impulse[i, last] if last else 0.0


@njit(cache=True, error_model="numpy")
def best_share(rows, solver_bodies):
    """Return α = clip(−(b·λ) / (λ·A λ), 0, 1) for the impulses λ of the rows; 1 if these change no velocity.

    Of all factors from 0 to 1, α gives the least energy ½ α² λ·A λ + α b·λ, with A = J M⁻¹ Jᵀ and b = J v⁻. One pass
    over the contacts is enough, because λ·A λ is twice the kinetic energy of the velocity changes by λ:
    Σ m |Δv|² + ½ m Δs², with s = ω r. rows: `Rows` with tangents. solver_bodies: velocities v⁻ before impulses, (N, 4).
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
    """Return impulses clamped to the friction cone as in a sweep: λ_n to >= 0, then λ_t to ±μ λ_n.

    normal, tangent: λ_n and λ_t, (m,) each, N·s. friction: μ, one number, or a number for each contact.
    """
    p_n = np.maximum(normal, 0.0)
    return p_n, np.clip(tangent, -friction * p_n, friction * p_n).astype(tangent.dtype, copy=False)
