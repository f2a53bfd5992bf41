"""What steps log: numbers of each step, sums over the steps, and the impulses of each pair in a watched step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import Contacts
from deep_contact.stepping.segments import moves, wall_velocity

DONE, WORK, LAST_SWEEPS, WATCHED, FINITE, PASSED = range(6)
"""Elements of `StepLog.progress`: number of the solver's substeps that are done; work, in relaxations, until the call
ends; sweeps of the last solve; whether the call is a single step whose impulses are logged in `StepLog.pair_impulses`;
whether all positions are finite; 1 + the circle over which a moving segment has passed last, or 0."""

PAIR, X, Y, N_X, N_Y, SEPARATION, P_X, P_Y = range(8)
"""Columns of `StepLog.pair_impulses`: the two bodies as one number (`pair_of`); contact point, m, normal and
separation, m,
of the contact when it came; impulse on its second body, N·s."""

MOST_BODIES = 2**26
"""Largest number of bodies, walls and segments included, with which float64 holds the number of a pair exactly."""

BESIDE_SWEEPS = 20
"""Work of a substep outside of its sweeps, in relaxations per contact."""


class StepLog(NamedTuple):
    """Log of steps, (steps,) each. Of a divided step: contacts and θ of its last substep, sums of the other columns."""

    contacts: np.ndarray
    sweeps: np.ndarray
    theta: np.ndarray  # θ of the last sweep, N·s
    relaxations: np.ndarray
    substeps: np.ndarray  # number of substeps
    progress: np.ndarray  # (6,): `DONE`, `WORK`, `LAST_SWEEPS`, `WATCHED`, `FINITE`, `PASSED`
    loads: np.ndarray  # (4 + S, 2): sum of the impulses on walls and segments, N·s; (0, 2): not logged
    pair_impulses: (
        np.ndarray
    )  # (k, 8): impulses of each pair in a watched step, of rebounds and solves, sorted by `PAIR`
    on_circles: np.ndarray  # (n, 2): sum of the contact impulses on the circles, N·s; (0, 2): not logged
    work: np.ndarray  # (1,): work of moving segments, fixed circles and pushes, J
    shifts: np.ndarray  # (n, 2): momentum from gravity and pushes beyond Δt (m g + f), N·s; (0, 2): not logged


def make_log(steps: int, loads: int = 0, circles: int = 0, shifts: int = 0) -> StepLog:
    """A log of `steps` steps, all of which one call may do.

    loads: number of walls and segments, or 0 to log no impulses on them. circles, shifts: number of circles, or 0 to
    log no `on_circles` or no `shifts`.
    """
    counts, theta = np.zeros((4, steps), np.int64), np.zeros(steps)
    progress = np.array([0, 2**63 - 1, 0, 0, 1, 0])  # without a bound on the work
    sums = np.zeros((loads, 2)), np.zeros((0, 8)), np.zeros((circles, 2)), np.zeros(1), np.zeros((shifts, 2))
    return StepLog(counts[0], counts[1], theta, counts[2], counts[3], progress, *sums)


def some_steps(log: StepLog, first: int, count: int, work: int, is_watched: bool) -> StepLog:
    """`count` rows of a log from `first` on, as views, for a call that ends after `work` relaxations."""
    progress = np.array([0, work, 0, is_watched, 1, 0])
    return StepLog(*[column[first : first + count] for column in log[:5]], progress, *log[6:])


@njit(cache=True)
def log_substep(log, k, contacts, sweeps, theta, relaxations):
    """Add a substep of the k-th step to the log, in place."""
    log.contacts[k] = contacts
    log.sweeps[k] += sweeps
    log.theta[k] = theta[sweeps - 1] if sweeps > 0 else np.inf
    log.relaxations[k] += relaxations
    log.substeps[k] += 1
    log.progress[WORK] -= relaxations + BESIDE_SWEEPS * contacts
    log.progress[LAST_SWEEPS] = sweeps


@njit(cache=True, error_model="numpy")
def log_work(step, contacts, solver_bodies, log):
    """Log the work of the actuation in a substep: the work of its solved impulses, and that of pushes.

    The power of a push is its force times the mean of the velocities before and after the substep.
    """
    bodies, actuation, of_pushes = step.bodies, step.actuation, 0.0
    for i in range(bodies.mass.shape[0]):
        if bodies.mass[i] < np.inf:
            v_x, v_y = bodies.velocity[i, 0] + solver_bodies[i, 0], bodies.velocity[i, 1] + solver_bodies[i, 1]
            turn = bodies.spin[i] + solver_bodies[i, 2] / bodies.radius[i]
            of_pushes += actuation.force[i, 0] * v_x + actuation.force[i, 1] * v_y + actuation.torque[i] * turn
    log.work[0] += work_on(step, contacts, impulses_of(contacts, 1.0 / step.substeps)) + 0.5 * step.dt * of_pushes


@njit(cache=True, error_model="numpy")
def work_on(step, contacts, impulse):
    """The work of moving segments and fixed circles, J, from the impulses on second bodies, (m, 2), N·s.

    The work of moving surfaces (`World.surface_speeds`) is not included. contacts: at the positions of the circles.
    """
    bodies, actuation, work = step.bodies, step.actuation, 0.0
    n = bodies.mass.shape[0]
    for i in range(impulse.shape[0]):
        a, b, x, y = contacts.body_a[i], contacts.body_b[i], contacts.position[i, 0], contacts.position[i, 1]
        v_x, v_y, sign = 0.0, 0.0, -1.0
        if b >= n:
            if b >= n + 4 and moves(actuation.wall, b - n - 4):
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
    """Whether impulses are logged."""
    return log.loads.shape[0] > 0 or log.on_circles.shape[0] > 0 or log.progress[WATCHED] != 0


@njit(cache=True)
def impulses_of(contacts, share):
    """The impulses of contacts on their second bodies, times `share`, (m, 2), N·s."""
    impulse = np.empty((contacts.body_a.shape[0], 2))
    for i in range(impulse.shape[0]):
        p_n, p_t = share * contacts.normal_impulse[i], share * contacts.tangent_impulse[i]
        impulse[i, 0] = p_n * contacts.normal[i, 0] + p_t * contacts.normal[i, 1]
        impulse[i, 1] = p_n * contacts.normal[i, 1] - p_t * contacts.normal[i, 0]
    return impulse


@njit(cache=True)
def log_impulses(log, pair_impulses, contacts, impulse, n):
    """Log impulses on the second bodies of contacts, (m, 2), N·s: `loads` and `on_circles` change in place.

    n: number of circles. Returns `StepLog.pair_impulses` with these impulses.
    """
    m, j = impulse.shape[0], 0
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
    if m == 0 or log.progress[WATCHED] == 0:
        return pair_impulses
    pair_impulses = with_pairs(pair_impulses, contacts)
    for i in range(m):
        while pair_impulses[j, PAIR] < pair_of(contacts, i):
            j += 1
        pair_impulses[j, P_X] += impulse[i, 0]
        pair_impulses[j, P_Y] += impulse[i, 1]
    return pair_impulses


@njit(cache=True)
def log_pairs(context, log, contacts, impulse):
    """`log_impulses`, in place on the context. impulse: on second bodies, (m, 2), N·s."""
    n = context.step.bodies.mass.shape[0]
    context.pair_impulses = log_impulses(log, context.pair_impulses, contacts, impulse, n)


@njit(cache=True)
def log_rest(context, log):
    """Log a substep in which all circles sleep, in place: contacts keep their impulses."""
    log_substep(log, context.row, 0, 0, context.memory.theta, 0)
    if is_asked(log):
        log_pairs(context, log, context.contacts, impulses_of(context.contacts, 1.0 / context.step.substeps))


@njit(cache=True)
def with_pairs(pair_impulses, contacts):
    """`StepLog.pair_impulses` with a row for each of these contacts, in their order; itself if it has all rows."""
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
            for column in range(8):  # an assignment of rows brings 37 functions along, for the text of its error
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
    """The two bodies of the i-th contact as one number, which increases along the list of contacts."""
    return contacts.body_a[i] * MOST_BODIES + contacts.body_b[i]


def of_whole_step(contacts: Contacts, pair_impulses: np.ndarray) -> Contacts:
    """The contacts of a step, also those that came during it, with their impulses summed over the step.

    While a pair turns in a divided step, its sum may come to pull along the normal with which it came. A normal across
    the sum replaces that normal, so that λ_n is 0, and the impulse on the bodies is that of the step.

    contacts: at the start of the step. pair_impulses: of `StepLog`.
    """
    pair, x, y, n_x, n_y, separation, p_x, p_y = pair_impulses.T
    starts = np.zeros((2, len(pair)))
    starts[:, np.searchsorted(pair, contacts.body_a * MOST_BODIES + contacts.body_b)] = contacts[7:]
    normal, pulls = np.column_stack([n_x, n_y]), p_x * n_x + p_y * n_y < 0.0
    across = np.column_stack([p_y, -p_x])[pulls] / np.hypot(p_x, p_y)[pulls, None]
    normal[pulls] = np.where((across * normal[pulls]).sum(axis=1, keepdims=True) < 0.0, -across, across)
    n_x, n_y = normal.T
    impulses = np.maximum(p_x * n_x + p_y * n_y, 0.0), p_x * n_y - p_y * n_x
    places = np.column_stack([x, y]), normal, separation.copy()
    return Contacts(*np.divmod(pair.astype(np.int64), MOST_BODIES), *places, *impulses, *starts)
