"""Log steps: numbers of each step, sums over the steps, and the impulses of each pair of bodies in a watched step.

A substep is one of the equal parts of a step. A relaxation is the update of the impulses of one contact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.segments import is_moving, wall_velocity

DONE, WORK, LAST_SWEEPS, WATCHED, FINITE, PASSED = range(6)
"""Elements of `StepLog.progress`.

DONE: number of substeps of the solver that are done. WORK: work that is left until the call ends, in relaxations.
LAST_SWEEPS: number of sweeps of the last solve. WATCHED: whether the call is a single step whose impulses are logged in
`StepLog.pair_impulses`. FINITE: whether all positions are finite. PASSED: 1 + index of the circle over which a moving
segment has passed last, or 0."""

PAIR, X, Y, N_X, N_Y, SEPARATION, P_X, P_Y = range(8)
"""Columns of `StepLog.pair_impulses`.

PAIR: the two bodies as one number (`pair_of`). X, Y: contact point, m. N_X, N_Y: unit normal. SEPARATION: separation,
m. P_X, P_Y: impulse on the second body, N·s. Point, normal and separation are those at the moment at which the contact
appeared."""

MOST_BODIES = 2**26
"""Largest number of bodies, with walls and segments, for which a float64 represents the number of a pair exactly."""

BESIDE_SWEEPS = 20
"""Work of a substep without its sweeps, in relaxations per contact."""


class StepLog(NamedTuple):
    """Log of steps. The first five arrays have one number for each step, (steps,).

    If a step is divided into substeps, `contacts` and `theta` are those of its last substep, and the other numbers are
    sums over its substeps. The impulses of rebounds and those of solves are added up in `pair_impulses`.
    """

    contacts: np.ndarray  # number of contacts
    sweeps: np.ndarray  # number of sweeps
    theta: np.ndarray  # θ of the last sweep, N·s
    relaxations: np.ndarray  # number of relaxations of a contact
    substeps: np.ndarray  # number of substeps
    progress: np.ndarray  # (6,): `DONE`, `WORK`, `LAST_SWEEPS`, `WATCHED`, `FINITE`, `PASSED`
    loads: np.ndarray  # (4 + S, 2): sum of the impulses on each wall and segment, N·s; (0, 2): not logged
    pair_impulses: np.ndarray  # (k, 8): impulses of k pairs in a watched step, sorted by `PAIR`
    on_circles: np.ndarray  # (n, 2): sum of the contact impulses on each circle, N·s; (0, 2): not logged
    work: np.ndarray  # (1,): work of moving segments, fixed circles and external forces, J
    shifts: np.ndarray  # (n, 2): momentum from gravity and external forces beyond Δt (m g + f), N·s; (0, 2): not logged
    deepest: np.ndarray  # (1,): least separation of a contact at the start of a substep, at most 0, m; (0,): not logged


def make_log(steps: int, loads: int = 0, circles: int = 0, shifts: int = 0) -> StepLog:
    """Return an empty log for `steps` steps, without a bound on the work of a call.

    loads: number of walls and segments, or 0 to log no impulses on them. circles: number of circles, or 0 to log no
    `on_circles`. shifts: number of circles, or 0 to log no `shifts`.
    """
    counts, theta = np.zeros((4, steps), np.int64), np.zeros(steps)
    progress = np.array([0, 2**63 - 1, 0, 0, 1, 0])  # without a bound on the work
    sums = np.zeros((loads, 2)), np.zeros((0, 8)), np.zeros((circles, 2)), np.zeros(1), np.zeros((shifts, 2))
    return StepLog(counts[0], counts[1], theta, counts[2], counts[3], progress, *sums, np.zeros(0))


def some_steps(log: StepLog, first: int, count: int, work: int, is_watched: bool) -> StepLog:
    """Return `count` rows of a log from row `first` on, as views, for one call.

    work: bound on the work, after which the call ends, in relaxations. is_watched: whether the impulses of each pair
    are logged.
    """
    progress = np.array([0, work, 0, is_watched, 1, 0])
    return StepLog(*[column[first : first + count] for column in log[:5]], progress, *log[6:])


@njit(cache=True)
def log_substep(log, k, contacts, sweeps, theta, relaxations):
    """Add a substep of the k-th step to the log, in place.

    contacts: number of contacts. sweeps: number of sweeps of the solve. theta: θ of each sweep, N·s. relaxations:
    number of relaxations of a contact.
    """
    log.contacts[k] = contacts
    log.sweeps[k] += sweeps
    log.theta[k] = theta[sweeps - 1] if sweeps > 0 else np.inf
    log.relaxations[k] += relaxations
    log.substeps[k] += 1
    log.progress[WORK] -= relaxations + BESIDE_SWEEPS * contacts
    log.progress[LAST_SWEEPS] = sweeps


@njit(cache=True, error_model="numpy")
def log_work(step, contacts, solver_bodies, of_rolling, log):
    """Add the work of moving segments, fixed circles and external forces in a substep to `StepLog.work`, J, in place.

    The power of an external force is the force times the mean of the velocities before and after the substep. step:
    `StepInput` of the substep. contacts: contacts with their solved impulses. solver_bodies: (N, 4), with the solved
    velocities. of_rolling: work by rolling resistance (`rows.work_of_rolling`), J.
    """
    bodies, actuation, of_pushes = step.bodies, step.actuation, 0.0
    for i in range(bodies.mass.shape[0]):
        if bodies.mass[i] < np.inf:
            v_x, v_y = bodies.velocity[i, 0] + solver_bodies[i, 0], bodies.velocity[i, 1] + solver_bodies[i, 1]
            turn = bodies.spin[i] + solver_bodies[i, 2] / bodies.radius[i]
            of_pushes += actuation.force[i, 0] * v_x + actuation.force[i, 1] * v_y + actuation.torque[i] * turn
    of_contacts = work_on(step, contacts, impulses_of(contacts, 1.0 / step.substeps))
    log.work[0] += of_contacts + 0.5 * step.dt * of_pushes + of_rolling


@njit(cache=True, error_model="numpy")
def work_on(step, contacts, impulse):
    """Return the work of moving segments and fixed circles on the free circles, J.

    The work of moving surfaces (`World.surface_speeds`) is not included. step: `StepInput`. contacts: m contacts at the
    positions of the circles. impulse: impulses on the second bodies of the contacts, (m, 2), N·s.
    """
    bodies, actuation, work = step.bodies, step.actuation, 0.0
    n = bodies.mass.shape[0]
    for i in range(impulse.shape[0]):
        a, b, x, y = contacts.body_a[i], contacts.body_b[i], contacts.position[i, 0], contacts.position[i, 1]
        v_x, v_y, sign = 0.0, 0.0, -1.0
        if b >= n:
            if b >= n + 4 and is_moving(actuation.wall, b - n - 4):
                v_x, v_y = wall_velocity(step.segments.line, actuation.wall, b - n - 4, x, y)
        else:
            fixed = b
            if bodies.mass[a] == np.inf:
                fixed, sign = a, 1.0
            if bodies.mass[fixed] == np.inf:
                v_x = bodies.velocity[fixed, 0] - bodies.spin[fixed] * (y - bodies.position[fixed, 1])
                v_y = bodies.velocity[fixed, 1] + bodies.spin[fixed] * (x - bodies.position[fixed, 0])
        work += sign * (impulse[i, 0] * v_x + impulse[i, 1] * v_y)
    return work


@njit(cache=True)
def is_asked(log):
    """Return whether the log stores impulses or separations of contacts."""
    is_summed = log.loads.shape[0] > 0 or log.on_circles.shape[0] > 0
    return is_summed or log.deepest.shape[0] > 0 or log.progress[WATCHED] != 0


@njit(cache=True)
def impulses_of(contacts, share):
    """Return the impulses of m contacts on their second bodies, multiplied by `share`, (m, 2), N·s."""
    impulse = np.empty((contacts.body_a.shape[0], 2))
    for i in range(impulse.shape[0]):
        p_n, p_t = share * contacts.normal_impulse[i], share * contacts.tangent_impulse[i]
        impulse[i, 0] = p_n * contacts.normal[i, 0] + p_t * contacts.normal[i, 1]
        impulse[i, 1] = p_n * contacts.normal[i, 1] - p_t * contacts.normal[i, 0]
    return impulse


@njit(cache=True)
def log_impulses(log, pair_impulses, contacts, impulse, n):
    """Add the impulses of m contacts to `StepLog.loads` and `StepLog.on_circles`, in place. `StepLog.deepest` follows.

    pair_impulses: array described in `StepLog.pair_impulses`. impulse: impulses on the second bodies of the contacts,
    (m, 2), N·s. n: number of circles. Returns `pair_impulses` with these impulses added if the step is watched. It is
    the same array if it has a row for each contact, and otherwise a larger one.
    """
    m = impulse.shape[0]
    for i in range(m if log.loads.shape[0] > 0 else 0):
        wall = contacts.body_b[i] - n
        if wall >= 0:
            log.loads[wall, 0] += impulse[i, 0]
            log.loads[wall, 1] += impulse[i, 1]
    for i in range(m if log.on_circles.shape[0] > 0 else 0):
        a, b = contacts.body_a[i], contacts.body_b[i]
        for axis in range(2):
            log.on_circles[a, axis] -= impulse[i, axis]
            if b < n:
                log.on_circles[b, axis] += impulse[i, axis]
    for i in range(m if log.deepest.shape[0] > 0 else 0):
        log.deepest[0] = min(log.deepest[0], contacts.separation[i])
    if m == 0 or log.progress[WATCHED] == 0:
        return pair_impulses
    # In most cases the contacts have the same pairs as the rows.
    added = add_to_rows(pair_impulses, contacts, impulse, 0)
    if added < m:
        pair_impulses = with_pairs(pair_impulses, contacts)
        add_to_rows(pair_impulses, contacts, impulse, added)
    return pair_impulses


@njit(cache=True, _nrt=False)
def add_to_rows(rows, contacts, impulse, first):
    """Add the impulses of the contacts from index `first` on to `StepLog.pair_impulses`, in place, if they have rows.

    impulse: (m, 2), N·s. Returns the index of the first contact whose pair has no row, or the number of contacts.
    """
    k, m, j = rows.shape[0], contacts.body_a.shape[0], first
    for i in range(first, m):
        pair = pair_of(contacts, i)
        while j < k and rows[j, PAIR] < pair:
            j += 1
        if j == k or rows[j, PAIR] > pair:
            return i
        rows[j, P_X] += impulse[i, 0]
        rows[j, P_Y] += impulse[i, 1]
        j += 1
    return m


@njit(cache=True)
def log_pairs(context, log, contacts, impulse):
    """Log the impulses of a substep by `log_impulses`, and set `context.pair_impulses` to the sums that it returns.

    context: `StepContext`. impulse: impulses on the second bodies of the contacts, (m, 2), N·s.
    """
    n = context.step.bodies.mass.shape[0]
    context.pair_impulses = log_impulses(log, context.pair_impulses, contacts, impulse, n)


@njit(cache=True)
def log_rest(context, log):
    """Log a substep in which all circles sleep, in place.

    The impulses of the contacts stay as they are, and are logged. context: `StepContext`.
    """
    log_substep(log, context.row, 0, 0, context.memory.theta, 0)
    if is_asked(log):
        log_pairs(context, log, context.contacts, impulses_of(context.contacts, 1.0 / context.step.substeps))


@njit(cache=True)
def with_pairs(pair_impulses, contacts):
    """Return `StepLog.pair_impulses` with a row for each of these contacts, sorted by `PAIR`.

    New rows have impulses of 0. If no row is missing, the array itself is returned.
    """
    k, m, new, j = pair_impulses.shape[0], contacts.body_a.shape[0], 0, 0
    for i in range(m):
        while j < k and pair_impulses[j, PAIR] < pair_of(contacts, i):
            j += 1
        new += j == k or pair_impulses[j, PAIR] > pair_of(contacts, i)
    if new == 0:
        return pair_impulses
    merged, i, j = np.zeros((k + new, 8)), 0, 0
    for row in range(k + new):
        if j < k and (i == m or pair_impulses[j, PAIR] <= pair_of(contacts, i)):
            i += i < m and pair_impulses[j, PAIR] == pair_of(contacts, i)
            for column in range(8):  # to assign a whole row would compile 37 more functions, for an error message
                merged[row, column] = pair_impulses[j, column]
            j += 1
        else:
            merged[row, PAIR], merged[row, SEPARATION] = pair_of(contacts, i), contacts.separation[i]
            merged[row, X], merged[row, Y] = contacts.position[i, 0], contacts.position[i, 1]
            merged[row, N_X], merged[row, N_Y] = contacts.normal[i, 0], contacts.normal[i, 1]
            i += 1
    return merged


@njit(inline="always")
def pair_of(contacts, i):
    """Return the two bodies of the i-th contact as one number, which increases along the sorted list of contacts."""
    return contacts.body_a[i] * MOST_BODIES + contacts.body_b[i]


@njit(cache=True, _nrt=False)
def write_rows(contacts, rows):
    """Write a row of `StepLog.pair_impulses` with an impulse of 0 for each of m contacts. rows: (m, 8)."""
    for i in range(contacts.body_a.shape[0]):
        rows[i, PAIR], rows[i, SEPARATION] = pair_of(contacts, i), contacts.separation[i]
        rows[i, X], rows[i, Y] = contacts.position[i, 0], contacts.position[i, 1]
        rows[i, N_X], rows[i, N_Y] = contacts.normal[i, 0], contacts.normal[i, 1]
        rows[i, P_X] = rows[i, P_Y] = 0.0


@njit(cache=True, error_model="numpy", _nrt=False)
def write_step(moved, contacts, pair_impulses, pairs, numbers):
    """Write copies of circles, and all contacts of a step with their impulses summed over it, into two flat arrays.

    In a divided step a pair of circles may turn around each other, until the sum of its impulses pulls along the normal
    with which the contact appeared. That normal is then replaced by a normal perpendicular to the sum. In this way λ_n
    is 0, and the impulse on the bodies is still the sum.

    moved: positions, (n, 2), m, velocities, (n, 2), m/s, angles, (n,), rad, and spins, (n,), rad/s. contacts: m
    contacts at the start of the step. pair_impulses: `StepLog.pair_impulses` with a row for each contact of the step;
    without rows, the contacts are copied as they are. pairs: body_a and body_b of the k contacts that are written, (2
    k,). numbers: all of `moved`, followed by the seven other arrays of the k contacts, (6 n + 9 k,).
    """
    position, velocity, angle, spin = moved
    n, m, rows = angle.shape[0], contacts.body_a.shape[0], pair_impulses.shape[0]
    for i in range(n):
        for axis in range(2):
            numbers[2 * i + axis], numbers[2 * (n + i) + axis] = position[i, axis], velocity[i, axis]
        numbers[4 * n + i], numbers[5 * n + i] = angle[i], spin[i]
    k, j = rows if rows > 0 else m, 0
    at, on, of = 6 * n, 6 * n + 2 * k, 6 * n + 4 * k  # where positions, normals, and the other arrays begin
    if rows == 0:
        for i in range(m):
            pairs[i], pairs[k + i] = contacts.body_a[i], contacts.body_b[i]
            for axis in range(2):
                numbers[at + 2 * i + axis] = contacts.position[i, axis]
                numbers[on + 2 * i + axis] = contacts.normal[i, axis]
            numbers[of + i] = contacts.separation[i]
            numbers[of + k + i], numbers[of + 2 * k + i] = contacts.normal_impulse[i], contacts.tangent_impulse[i]
            numbers[of + 3 * k + i], numbers[of + 4 * k + i] = contacts.normal_start[i], contacts.tangent_start[i]
        return
    for i in range(rows):
        pair = np.int64(pair_impulses[i, PAIR])
        pairs[i], pairs[k + i] = pair // MOST_BODIES, pair % MOST_BODIES
        n_x, n_y = pair_impulses[i, N_X], pair_impulses[i, N_Y]
        p_x, p_y = pair_impulses[i, P_X], pair_impulses[i, P_Y]
        if p_x * n_x + p_y * n_y < 0.0:
            size = math.hypot(p_x, p_y)
            a_x, a_y = p_y / size, -p_x / size
            if a_x * n_x + a_y * n_y < 0.0:
                a_x, a_y = -a_x, -a_y
            n_x, n_y = a_x, a_y
        numbers[at + 2 * i], numbers[at + 2 * i + 1] = pair_impulses[i, X], pair_impulses[i, Y]
        numbers[on + 2 * i], numbers[on + 2 * i + 1] = n_x, n_y
        numbers[of + i] = pair_impulses[i, SEPARATION]
        numbers[of + k + i] = max(p_x * n_x + p_y * n_y, 0.0)
        numbers[of + 2 * k + i] = p_x * n_y - p_y * n_x
        started = j < m and pair_of(contacts, j) == pair
        numbers[of + 3 * k + i] = contacts.normal_start[j] if started else 0.0
        numbers[of + 4 * k + i] = contacts.tangent_start[j] if started else 0.0
        j += started
