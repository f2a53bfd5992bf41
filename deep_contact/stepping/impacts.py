"""Impacts: where restitution is not 0, circles that meet rebound before forces act.

A step with e > 0 first lets all contacts that approach rebound, in rounds. In a round, the contacts that approach and
share circles form a cluster, and a cluster rebounds at once, by one reflection. Its contacts get impulses P_i = L p_i
along their normals, which push for every approach x_i = −v_n,i > 0:

    p_i = x_i / (1 / (σ_ai m_a) + 1 / (σ_bi m_b)),  σ_ai = x_i / Σ x_j over the contacts j of the cluster at circle a,
    L = (1 + e) Σ p_i x_i / Σ p_i (n_i · u),  u = M⁻¹ Σ p_i n_i.

For a single contact this is Newton's law, v_n⁺ = −e v_n⁻. Rounds follow until no contact approaches any more, at most
until `MOST_STRIKES`.

No impulse depends on the order of contacts or circles, and a contact that hardly approaches changes no impulse by much.
Momentum is conserved. The energy of a cluster changes by −½ (1 − e²) (Σ p_i x_i)² / Σ p_i (n_i · u). This is 0 at
e = 1, and never positive, whatever the masses, the solver and its sweeps.

Reflections in rounds are those of Smith, Kaufman, Vouga, Tamstorf and Grinspun, Reflections on Simultaneous Impact
(2012); Vouga et al., All's Well That Ends Well (2017), showed that the rounds end. Splitting the mass of a circle among
its contacts is from Tonge, Benevolenski and Voroshilov, Mass Splitting for Jitter-Free Parallel Rigid Body Simulation
(2012); the shares are our own.

Friction follows in each round, from the shared masses: f_i = −k_t v_t within ±μ P_i. It only takes energy, since a body
whose velocity is the mean of those of its parts has less energy than the parts have.

All contacts of a step count as simultaneous. Impacts that truly are simultaneous have no unique outcome.

Gravity and the contact problem come after the impacts, without restitution. Symplectic Euler leaves velocities half a
step behind the positions, so that in the impacts walls and segments move at −Δt g / 2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.stepping.islands import root_of
from deep_contact.stepping.log import is_asked, work_on
from deep_contact.stepping.rows import arms_of, row_masses
from deep_contact.stepping.segments import moves, surface_velocity, wall_velocity

MOST_STRIKES = 200
"""Largest number of rebounds in a step per contact. The contact problem stops the approaches that are left."""

ALWAYS_STRIKES = 50_000
"""Number of rebounds that a step may always have, however few its contacts are."""

SLOWEST = 1e-6
"""Approach, over the fastest approach at a circle in the step so far, below which the circle's contacts do not
rebound."""

SLOWEST_LOSSY = 1e-2
"""This number times 1 − e² replaces `SLOWEST` if it is larger. Otherwise rounds at e < 1 could go on for ever, each
halving the approach that is left."""

ACROSS = 1e-3
"""Least approach that rebounds at contacts across gravity, as a share of that at contacts along gravity: the noise of a
pile does not rebound."""

ROUNDING = 1e-12
"""Share of the speeds of two bodies below which their approach is taken for rounding."""


class Round(NamedTuple):
    """The clusters of a round, and the fastest approaches in the step so far, of n circles and m contacts.

    | field    | meaning                                                           | shape      | unit |
    |----------|-------------------------------------------------------------------|------------|------|
    | near     | contacts to examine, and then those that rebound                  | (m,)       | –    |
    | approach | x_i of the contacts that rebound                                  | (m,)       | m/s  |
    | push     | P_i of the contacts that rebound                                  | (m,)       | N·s  |
    | circle   | circles of the clusters                                           | (n,)       | –    |
    | closing  | Σ x_j of the contacts that rebound at a circle; 0 elsewhere       | (n + 1,)   | m/s  |
    | cluster  | the circle that stands for the cluster of a circle                | (n + 1,)   | –    |
    | sums     | Σ p_i x_i, and later L, and Σ p_i (n_i · u) of a cluster          | (n, 2)     | J    |
    | impulse  | impulse on a circle, along x and y, and its moment over r         | (n + 1, 3) | N·s  |
    | fastest  | fastest approach at a circle in this step                         | (n + 1,)   | m/s  |
    | received | impulses on second bodies in this step; (0, 2): not needed        | (m, 2)     | N·s  |

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
    pair_impulses: np.ndarray


@njit(cache=True, error_model="numpy")
def logged_rebound(context, motion, contacts, log, actuation):
    """`rebound`, with its work in the log. Returns the impulses on second bodies, (m, 2), N·s; (0, 2) if not needed.

    context: `StepContext`. motion: `Motion` of its step; None without optional features, and so without restitution.
    """
    impulse = log.loads[:0]
    if motion is not None:
        step = context.substep
        if is_asked(log) or actuation is not None:
            impulse = np.zeros((contacts.body_a.shape[0], 2))
        work = rebound(step, contacts, impulse, actuation)
        if actuation is not None:
            log.work[0] += work + work_on(step, contacts, impulse)
    return impulse


@njit(cache=True, error_model="numpy")
def rebound(step, contacts, impulse, actuation):
    """If e > 0, let circles that meet rebound, in place on their velocities and spins (`reflect`).

    Velocities are half a step behind the positions (see the module). Pushes therefore act for half a step before the
    rebounds, and fixed circles move at −Δt g / 2 in addition, as walls do. Returns the work of pushes in the rebounds,
    J. actuation: `Actuation` of the step, or None.
    """
    work, bodies = 0.0, step.bodies
    if step.restitution == 0.0:
        return work
    if actuation is None:
        reflect(step, contacts, impulse, actuation)
        return work
    velocity, before, half = bodies.velocity, bodies.velocity.copy(), 0.5 * step.dt
    for i in range(bodies.mass.shape[0]):
        for axis in range(2):
            if bodies.mass[i] == np.inf:
                velocity[i, axis] -= half * step.gravity[axis]
            else:
                velocity[i, axis] += half * actuation.force[i, axis] / bodies.mass[i]
    shifted = velocity.copy()
    reflect(step, contacts, impulse, actuation)
    for i in range(bodies.mass.shape[0]):
        for axis in range(2):
            change = velocity[i, axis] - shifted[i, axis]
            work -= half * actuation.force[i, axis] * change
            velocity[i, axis] = before[i, axis] + change
    return work


@njit(cache=True, error_model="numpy")
def reflect(step, contacts, impulse, actuation):
    """The rounds of `rebound`. Their stages are inlined: a call would count references to every array of the step.

    step: `StepInput`. impulse: the impulses on the second bodies of the contacts are added to it, (m, 2), N·s; (0, 2)
    if they are not needed.

    Slow approaches do not rebound, so that piles come to rest. The limit is the larger of Δt |g| and (1 − e²) times the
    scene's `restitution_threshold`, times the larger of |n · g| / |g| and `ACROSS`: gravity presses on no side wall.
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
        struck = approaching(step, contacts, count, now, floor, slowest, actuation)
        circles = join(step.bodies, contacts, struck, now)
        push(step, contacts, struck, circles, now)
        rub(step, contacts, struck, circles, now, step.friction, actuation)
        strikes, count = strikes + struck, 0
        for k in range(circles):
            end = head[now.circle[k]]
            while end >= 0:
                # A contact of two circles that were both hit is listed once, by its first circle.
                if end % 2 == 0 or now.closing[contacts.body_a[end // 2]] == 0.0:
                    now.near[count] = end // 2
                    count += 1
                end = following[end]
        for k in range(circles):
            now.closing[now.circle[k]] = 0.0


@njit(cache=True, error_model="numpy")
def floor_of(step):
    """(flat, f_x, f_y), m/s: an approach along n rebounds if it is faster than flat and than |f · n| (`reflect`)."""
    (g_x, g_y), e = step.gravity, step.restitution
    gravity, slow = math.hypot(g_x, g_y), (1.0 - e * e) * step.scales.restitution_threshold
    if gravity == 0.0:
        return slow, 0.0, 0.0
    slow = max(slow, step.dt * gravity)
    return ACROSS * slow, slow * g_x / gravity, slow * g_y / gravity


@njit(inline="always")
def approaching(step, contacts, count, now, floor, slowest, actuation):
    """Keep those of the first `count` contacts in `now.near` that rebound, in place, with x_i = −v_n.

    Returns the number of contacts that rebound.
    A contact rebounds if it approaches faster than the floor, and faster than `slowest` times the fastest approach at
    its circles.
    """
    # Unpacked here: arrays inside tuples would count references in every iteration of the loop.
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
        elif actuation is not None:
            b_x, b_y = ground_of(step, contacts, i, actuation)
        x = (a_x - b_x) * n_x + (a_y - b_y) * n_y
        if x > 0.0:
            least = max(slowest * max(fastest[a], fastest[min(b, n)]), flat, abs(f_x * n_x + f_y * n_y))
            least = max(least, ROUNDING * (abs(a_x) + abs(a_y) + abs(b_x) + abs(b_y)), 1e-100)
            if least < x < np.inf and (mass[a] < np.inf or (b < n and mass[b] < np.inf)):
                near[struck], approach[struck] = i, x
                struck += 1
    return struck


@njit(inline="always")
def ground_of(step, contacts, i, actuation):
    """Velocity of a wall or a segment at the i-th contact, m/s: see the module."""
    v_x, v_y = -0.5 * step.dt * step.gravity[0], -0.5 * step.dt * step.gravity[1]
    if actuation is not None:
        s = contacts.body_b[i] - step.bodies.mass.shape[0] - 4
        if s >= 0 and moves(actuation.wall, s):
            x, y = contacts.position[i, 0], contacts.position[i, 1]
            w_x, w_y = wall_velocity(step.segments.line, actuation.wall, s, x, y)
            v_x, v_y = v_x + w_x, v_y + w_y
    return v_x, v_y


@njit(inline="always")
def inverse_mass(bodies, i):
    """Inverse mass of body i, 1/kg; 0 for fixed circles, walls and segments."""
    return 1.0 / bodies.mass[i] if i < bodies.mass.shape[0] else 0.0


@njit(cache=True)
def contacts_of_circles(contacts, n):
    """(head, following): linked lists of the contacts i of each circle, as numbers 2 i + side; −1 ends a list.

    head, (n,): the last contact of each circle. following, (2 m,): the contact of the circle before that one.
    """
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
    """Join the circles of the contacts that rebound into clusters, in place. Returns the number of these circles."""
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
    """(cluster, 1 / (σ_a m_a), 1 / (σ_b m_b)) of the k-th contact that rebounds; the inverse masses in 1/kg."""
    i = now.near[k]
    a, b = contacts.body_a[i], min(contacts.body_b[i], bodies.mass.shape[0])
    w_a = inverse_mass(bodies, a) * (now.closing[a] / now.approach[k])
    w_b = inverse_mass(bodies, b) * (now.closing[b] / now.approach[k])
    return now.cluster[a if now.closing[a] > 0.0 else b], w_a, w_b


@njit(inline="always")
def push(step, contacts, struck, circles, now):
    """Apply the normal impulses P_i = L p_i to the circles, in place."""
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
    """Add an impulse on b, N·s, and its reaction on a to `now.impulse`, in place."""
    now.impulse[a, 0] -= p_x
    now.impulse[a, 1] -= p_y
    now.impulse[b, 0] += p_x
    now.impulse[b, 1] += p_y


@njit(cache=True, error_model="numpy")
def rub(step, contacts, struck, circles, now, friction, actuation):
    """Apply the friction of the normal impulses to the circles, in place.

    The function is not inlined: only by the type of an argument does the compiler know that there is no friction.
    """
    bodies, n = step.bodies, step.bodies.mass.shape[0]
    for k in range(struck):
        i, p_n, p_t = now.near[k], now.push[k], 0.0
        a, b, n_x, n_y = contacts.body_a[i], contacts.body_b[i], contacts.normal[i, 0], contacts.normal[i, 1]
        if friction is not None:
            arms, row = arms_of(bodies.radius, a, b, contacts.separation[i]), min(b, n)
            _, w_a, w_b = shared_masses(bodies, contacts, k, now)
            k_t = row_masses(w_a, w_b, arms)[1]
            p_t = max(-friction * p_n, min(-k_t * slip_of(step, contacts, i, arms, actuation), friction * p_n))
            give(now, a, row, p_t * n_y, -p_t * n_x)
            now.impulse[a, 2] += arms[0] * p_t
            now.impulse[row, 2] += arms[1] * p_t
        if now.pair_impulses.shape[0] > 0:
            now.pair_impulses[i, 0] += p_n * n_x + p_t * n_y
            now.pair_impulses[i, 1] += p_n * n_y - p_t * n_x
    if friction is not None:
        for k in range(circles):
            c = now.circle[k]
            w = inverse_mass(bodies, c)
            bodies.velocity[c, 0] += w * now.impulse[c, 0]
            bodies.velocity[c, 1] += w * now.impulse[c, 1]
            bodies.spin[c] += 2.0 * w * now.impulse[c, 2] / bodies.radius[c]


@njit(inline="always")
def slip_of(step, contacts, i, arms, actuation):
    """v_t of the i-th contact along the tangent (n_y, −n_x), m/s. arms: over radii."""
    bodies, n, a, b = step.bodies, step.bodies.mass.shape[0], contacts.body_a[i], contacts.body_b[i]
    n_x, n_y = contacts.normal[i, 0], contacts.normal[i, 1]
    v_t = arms[0] * bodies.spin[a] * bodies.radius[a] - bodies.velocity[a, 0] * n_y + bodies.velocity[a, 1] * n_x
    if b < n:
        v_t += arms[1] * bodies.spin[b] * bodies.radius[b]
        return v_t + bodies.velocity[b, 0] * n_y - bodies.velocity[b, 1] * n_x
    ground = ground_of(step, contacts, i, actuation)
    v_t += ground[0] * n_y - ground[1] * n_x
    if b >= n + 4:
        v_t += surface_velocity(step.segments.line[b - n - 4], n_x, n_y)
    return v_t
