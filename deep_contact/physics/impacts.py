"""Impacts: where restitution is not 0, circles that meet rebound before forces act.

A step with e > 0 first lets all contacts that approach rebound, in rounds. In a round, the contacts that approach and
share circles form a cluster, and a cluster rebounds at once, by one reflection. Its contacts get impulses P_i = L p_i
along their normals, which push for every approach x_i = −v_n,i > 0:

    p_i = x_i / (1 / (σ_ai m_a) + 1 / (σ_bi m_b)),  σ_ai = x_i / Σ x_j over the contacts j of the cluster at circle a,
    L = (1 + e) Σ p_i x_i / Σ p_i (n_i · u),  u = M⁻¹ Σ p_i n_i.

For a single contact this is Newton's law, v_n⁺ = −e v_n⁻. Rounds follow until no contact approaches any more, at most
until `MOST_STRIKES`.

No impulse depends on the order of contacts or circles, and none changes by much for a contact that hardly approaches.
Momentum is kept. The energy of a cluster changes by −½ (1 − e²) (Σ p_i x_i)² / Σ p_i (n_i · u): by 0 at e = 1, and
never upwards, whatever the masses, the solver and its sweeps.

Reflections in rounds are those of Smith, Kaufman, Vouga, Tamstorf and Grinspun, Reflections on Simultaneous Impact
(2012); that they end was shown by Vouga et al., All's Well That Ends Well (2017). A circle that shares its mass among
its contacts is from Tonge, Benevolenski and Voroshilov, Mass Splitting for Jitter-Free Parallel Rigid Body Simulation
(2012); the shares are our own.

Friction follows in each round, from the shared masses: f_i = −k_t v_t within ±μ P_i. It takes energy only, since a body
that is the mean of its parts has less energy than these have.

Contacts of one step count as simultaneous. Impacts that truly are have no one answer.

Gravity and the contact problem come after that, without restitution. Symplectic Euler leaves velocities half a step
behind the positions, so walls and segments rise at −Δt g / 2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.physics.contact_solver import arms_of, effective_masses
from deep_contact.physics.islands import root_of
from deep_contact.physics.segments import moves, surface_velocity, wall_velocity
from deep_contact.physics.step import is_asked, work_on

MOST_STRIKES = 200
"""Most rebounds of a step per contact. What approaches after them is left to the contact problem, which stops it."""

ALWAYS_STRIKES = 50_000
"""Rebounds that a step may have however few its contacts are."""

SLOWEST = 1e-6
"""Share of the fastest approach that a circle has had in a step below which its contacts no longer rebound in it."""

SLOWEST_LOSSY = 1e-2
"""This number times 1 − e² is the share in place of `SLOWEST` where it is larger. Without it, rounds at e < 1 could go
on for ever, each halving the approach that is left."""

ACROSS = 1e-3
"""Least share of the floor of `rebound` for contacts across gravity: the noise of a pile does not rebound."""

ROUNDING = 1e-12
"""Share of the speeds of two bodies below which their approach is taken for rounding."""


class Round(NamedTuple):
    """The clusters of a round, and how fast the circles of a step have been hit. n circles, m contacts.

    | field    | meaning                                                           | shape      | unit |
    |----------|-------------------------------------------------------------------|------------|------|
    | near     | contacts to look at, which turn into those that rebound           | (m,)       | –    |
    | approach | x_i of those that rebound                                         | (m,)       | m/s  |
    | push     | P_i of those that rebound                                         | (m,)       | N·s  |
    | circle   | circles of the clusters                                           | (n,)       | –    |
    | closing  | Σ x_j of the contacts that rebound at a circle; 0 elsewhere       | (n + 1,)   | m/s  |
    | cluster  | the circle that stands for the cluster of a circle                | (n + 1,)   | –    |
    | sums     | Σ p_i x_i, which turns into L, and Σ p_i (n_i · u), of a cluster  | (n, 2)     | J    |
    | impulse  | what a circle receives: along x and y, and its moment over r      | (n + 1, 3) | N·s  |
    | fastest  | fastest approach at a circle in this step                         | (n + 1,)   | m/s  |
    | received | of second bodies in this step; (0, 2) where nobody asks           | (m, 2)     | N·s  |

    Row n stands for walls and segments.
    """

    near: np.ndarray
    approach: np.ndarray
    push: np.ndarray
    circle: np.ndarray
    closing: np.ndarray
    cluster: np.ndarray
    sums: np.ndarray
    impulse: np.ndarray
    fastest: np.ndarray
    received: np.ndarray


@njit(inline="always")
def logged_rebound(step, motion, contacts, log, drive):
    """`rebound`, with its work in the log. Returns the impulses on second bodies, (m, 2), N·s; (0, 2) if nobody asks.

    motion: of the step; None where it has no restitution.
    """
    impulse = log.loads[:0]
    if motion is not None:
        if is_asked(log) or drive is not None:
            impulse = np.zeros((contacts.body_a.shape[0], 2))
        work = rebound(step, contacts, impulse, drive)
        if drive is not None:
            log.work[0] += work + work_on(step, contacts, impulse)
    return impulse


@njit(cache=True, error_model="numpy")
def rebound(step, contacts, impulse, drive):
    """Let circles that meet rebound, in place on their velocities and spins, where e > 0: by `reflect`.

    Velocities are half a step behind the positions (see the module). So pushes act for half a step before the rebounds,
    and fixed circles rise as walls do. Returns the work of pushes in the rebounds, J. drive: of the step.
    """
    work, bodies = 0.0, step.bodies
    if step.restitution == 0.0:
        return work
    if drive is None:
        reflect(step, contacts, impulse, drive)
        return work
    velocity, before, half = bodies.velocity, bodies.velocity.copy(), 0.5 * step.dt
    for i in range(bodies.mass.shape[0]):
        for axis in range(2):
            if bodies.mass[i] == np.inf:
                velocity[i, axis] -= half * step.gravity[axis]
            else:
                velocity[i, axis] += half * drive.force[i, axis] / bodies.mass[i]
    shifted = velocity.copy()
    reflect(step, contacts, impulse, drive)
    for i in range(bodies.mass.shape[0]):
        for axis in range(2):
            change = velocity[i, axis] - shifted[i, axis]
            work -= half * drive.force[i, axis] * change
            velocity[i, axis] = before[i, axis] + change
    return work


@njit(cache=True, error_model="numpy")
def reflect(step, contacts, impulse, drive):
    """The rounds of `rebound`, whose parts are inlined: a call would count references to every array of the step.

    step: `StepInput`.
    impulse: to which what the second bodies of the contacts receive is added, (m, 2), N·s; (0, 2) where nobody asks.

    Approaches of up to (1 − e²) times the scene's `restitution_threshold`, and of what gravity gives in a step, do not
    rebound, so that piles come to rest. Both times |n · g| / |g|, or `ACROSS`: gravity presses no side wall.
    """
    m, n, floor = contacts.body_a.shape[0], step.bodies.mass.shape[0], floor_of(step)
    now = Round(
        np.arange(m), np.empty(m), np.empty(m), np.empty(n, np.int64), np.zeros(n + 1), np.empty(n + 1, np.int64),
        np.empty((n, 2)), np.empty((n + 1, 3)), np.zeros(n + 1), impulse,
    )  # fmt: skip
    slowest = max(SLOWEST, SLOWEST_LOSSY * (1.0 - step.restitution * step.restitution))
    head, following = contacts_of_circles(contacts, n)
    count, strikes = m, 0
    while count > 0 and strikes < max(MOST_STRIKES * m, ALWAYS_STRIKES):
        struck = approaching(step, contacts, count, now, floor, slowest, drive)
        circles = join(step.bodies, contacts, struck, now)
        push(step, contacts, struck, circles, now)
        rub(step, contacts, struck, circles, now, step.friction, drive)
        strikes, count = strikes + struck, 0
        for k in range(circles):
            end = head[now.circle[k]]
            while end >= 0:
                # A contact of two circles that were hit is listed by its first.
                if end % 2 == 0 or now.closing[contacts.body_a[end // 2]] == 0.0:
                    now.near[count] = end // 2
                    count += 1
                end = following[end]
        for k in range(circles):
            now.closing[now.circle[k]] = 0.0


@njit(cache=True, error_model="numpy")
def floor_of(step):
    """Approaches that do not rebound, m/s: whatever the normal; and along x and along y (`rebound`)."""
    (g_x, g_y), e = step.gravity, step.restitution
    gravity, slow = math.hypot(g_x, g_y), (1.0 - e * e) * step.scales.restitution_threshold
    if gravity == 0.0:
        return slow, 0.0, 0.0
    slow = max(slow, step.dt * gravity)
    return ACROSS * slow, slow * g_x / gravity, slow * g_y / gravity


@njit(inline="always")
def approaching(step, contacts, count, now, floor, slowest, drive):
    """Keep those of the first `count` contacts in `now.near` that rebound, in place, with x_i = −v_n. Returns how many.

    A contact rebounds where it approaches faster than the floor, and than `slowest` times the fastest at its circles.
    """
    # Out of the tuples, whose arrays would count their references in every turn of the loop.
    velocity, mass, fastest, near, approach = (
        step.bodies.velocity,
        step.bodies.mass,
        now.fastest,
        now.near,
        now.approach,
    )
    body_a, body_b, normal, n, (flat, f_x, f_y) = (
        contacts.body_a,
        contacts.body_b,
        contacts.normal,
        mass.shape[0],
        floor,
    )
    up_x, up_y = -0.5 * step.dt * step.gravity[0], -0.5 * step.dt * step.gravity[1]
    struck = np.int64(0)  # the literal 0 has a type of its own, for which `rub` would be compiled once more
    for k in range(count):
        i = near[k]
        a, b, n_x, n_y = body_a[i], body_b[i], normal[i, 0], normal[i, 1]
        a_x, a_y, b_x, b_y = velocity[a, 0], velocity[a, 1], up_x, up_y
        if b < n:
            b_x, b_y = velocity[b, 0], velocity[b, 1]
        elif drive is not None:
            b_x, b_y = ground_of(step, contacts, i, drive)
        x = (a_x - b_x) * n_x + (a_y - b_y) * n_y
        if x > 0.0:
            least = max(slowest * max(fastest[a], fastest[min(b, n)]), flat, abs(f_x * n_x + f_y * n_y))
            least = max(least, ROUNDING * (abs(a_x) + abs(a_y) + abs(b_x) + abs(b_y)), 1e-100)
            if least < x < np.inf and (mass[a] < np.inf or (b < n and mass[b] < np.inf)):
                near[struck], approach[struck] = i, x
                struck += 1
    return struck


@njit(inline="always")
def ground_of(step, contacts, i, drive):
    """Velocity of a wall or a segment at the i-th contact, m/s: see the module."""
    v_x, v_y = -0.5 * step.dt * step.gravity[0], -0.5 * step.dt * step.gravity[1]
    if drive is not None:
        s = contacts.body_b[i] - step.bodies.mass.shape[0] - 4
        if s >= 0 and moves(drive.wall, s):
            x, y = contacts.position[i, 0], contacts.position[i, 1]
            w_x, w_y = wall_velocity(step.segments.line, drive.wall, s, x, y)
            v_x, v_y = v_x + w_x, v_y + w_y
    return v_x, v_y


@njit(inline="always")
def inverse_mass(bodies, i):
    """1/kg; 0 for what does not move."""
    return 1.0 / bodies.mass[i] if i < bodies.mass.shape[0] else 0.0


@njit(cache=True)
def contacts_of_circles(contacts, n):
    """(head, following): 2 i + side, of the last contact i of a circle, and of the one before it; −1 at the end."""
    m = contacts.body_a.shape[0]
    head, following = np.full(n, -1), np.empty(2 * m, np.int64)
    for i in range(m):
        a, b = contacts.body_a[i], contacts.body_b[i]
        following[2 * i], head[a] = head[a], 2 * i
        if b < n:
            following[2 * i + 1], head[b] = head[b], 2 * i + 1
    return head, following


@njit(inline="always")
def join(bodies, contacts, struck, now):
    """Join the circles of the contacts that rebound to clusters, in place. Returns the number of these circles."""
    n, count = bodies.mass.shape[0], np.int64(0)
    for k in range(struck):
        i, x = now.near[k], now.approach[k]
        a, b = contacts.body_a[i], min(contacts.body_b[i], n)
        for c in (a, b):
            if inverse_mass(bodies, c) > 0.0:
                if now.closing[c] == 0.0:
                    now.circle[count], now.cluster[c] = c, c
                    now.sums[c, 0] = now.sums[c, 1] = 0.0
                    now.impulse[c, 0] = now.impulse[c, 1] = now.impulse[c, 2] = 0.0
                    count += 1
                now.closing[c] += x
                now.fastest[c] = max(now.fastest[c], x)
        if now.closing[a] > 0.0 and now.closing[b] > 0.0:
            now.cluster[root_of(now.cluster, a)] = root_of(now.cluster, b)
    for k in range(count):
        now.cluster[now.circle[k]] = root_of(now.cluster, now.circle[k])
    return count


@njit(inline="always")
def shared_masses(bodies, contacts, k, now):
    """Of the k-th contact that rebounds: the circle of its cluster, and 1 / (σ_a m_a), 1 / (σ_b m_b), 1/kg."""
    i = now.near[k]
    a, b = contacts.body_a[i], min(contacts.body_b[i], bodies.mass.shape[0])
    w_a = inverse_mass(bodies, a) * (now.closing[a] / now.approach[k])
    w_b = inverse_mass(bodies, b) * (now.closing[b] / now.approach[k])
    return now.cluster[a if now.closing[a] > 0.0 else b], w_a, w_b


@njit(inline="always")
def push(step, contacts, struck, circles, now):
    """Give the circles their normal impulses P_i = L p_i, in place."""
    bodies, n = step.bodies, step.bodies.mass.shape[0]
    for k in range(struck):
        i = now.near[k]
        cluster, w_a, w_b = shared_masses(bodies, contacts, k, now)
        p = now.push[k] = now.approach[k] / (w_a + w_b)
        now.sums[cluster, 0] += p * now.approach[k]
        p_x, p_y = p * contacts.normal[i, 0], p * contacts.normal[i, 1]
        give(now, contacts.body_a[i], min(contacts.body_b[i], n), p_x, p_y)
    for k in range(circles):
        c = now.circle[k]
        square = now.impulse[c, 0] * now.impulse[c, 0] + now.impulse[c, 1] * now.impulse[c, 1]
        now.sums[now.cluster[c], 1] += inverse_mass(bodies, c) * square
    for k in range(circles):
        c = now.circle[k]
        if now.cluster[c] == c:
            sums = now.sums[c]
            # Impulses that cancel change nothing.
            sums[0] = (1.0 + step.restitution) * sums[0] / sums[1] if sums[1] > 0.0 else 0.0
    for k in range(circles):
        c = now.circle[k]
        w = now.sums[now.cluster[c], 0] * inverse_mass(bodies, c)
        for axis in range(2):
            bodies.velocity[c, axis] += w * now.impulse[c, axis]
            now.impulse[c, axis] = 0.0
    for k in range(struck):
        cluster, _, _ = shared_masses(bodies, contacts, k, now)
        now.push[k] *= now.sums[cluster, 0]


@njit(inline="always")
def give(now, a, b, p_x, p_y):
    """Add an impulse on b and its reaction on a, N·s, to what they receive."""
    now.impulse[a, 0] -= p_x
    now.impulse[a, 1] -= p_y
    now.impulse[b, 0] += p_x
    now.impulse[b, 1] += p_y


@njit(cache=True, error_model="numpy")
def rub(step, contacts, struck, circles, now, friction, drive):
    """Give the circles the friction of their normal impulses, in place.

    Not inlined: only the type of an argument tells the compiler that there is no friction.
    """
    bodies, n = step.bodies, step.bodies.mass.shape[0]
    for k in range(struck):
        i, p_n, p_t = now.near[k], now.push[k], 0.0
        a, b, n_x, n_y = contacts.body_a[i], contacts.body_b[i], contacts.normal[i, 0], contacts.normal[i, 1]
        if friction is not None:
            arms, row = arms_of(bodies.radius, a, b, contacts.separation[i]), min(b, n)
            _, w_a, w_b = shared_masses(bodies, contacts, k, now)
            k_t = effective_masses(w_a, w_b, arms)[1]
            p_t = max(-friction * p_n, min(-k_t * slip_of(step, contacts, i, arms, drive), friction * p_n))
            give(now, a, row, p_t * n_y, -p_t * n_x)
            now.impulse[a, 2] += arms[0] * p_t
            now.impulse[row, 2] += arms[1] * p_t
        if now.received.shape[0] > 0:
            now.received[i, 0] += p_n * n_x + p_t * n_y
            now.received[i, 1] += p_n * n_y - p_t * n_x
    if friction is not None:
        for k in range(circles):
            c = now.circle[k]
            w = inverse_mass(bodies, c)
            bodies.velocity[c, 0] += w * now.impulse[c, 0]
            bodies.velocity[c, 1] += w * now.impulse[c, 1]
            bodies.spin[c] += 2.0 * w * now.impulse[c, 2] / bodies.radius[c]


@njit(inline="always")
def slip_of(step, contacts, i, arms, drive):
    """v_t of the i-th contact, m/s, the tangent (n_y, −n_x). arms: over radii."""
    bodies, n, a, b = step.bodies, step.bodies.mass.shape[0], contacts.body_a[i], contacts.body_b[i]
    n_x, n_y = contacts.normal[i, 0], contacts.normal[i, 1]
    v_t = arms[0] * bodies.spin[a] * bodies.radius[a] - bodies.velocity[a, 0] * n_y + bodies.velocity[a, 1] * n_x
    if b < n:
        v_t += arms[1] * bodies.spin[b] * bodies.radius[b]
        return v_t + bodies.velocity[b, 0] * n_y - bodies.velocity[b, 1] * n_x
    ground = ground_of(step, contacts, i, drive)
    v_t += ground[0] * n_y - ground[1] * n_x
    if b >= n + 4:
        v_t += surface_velocity(step.segments.line[b - n - 4], n_x, n_y)
    return v_t
