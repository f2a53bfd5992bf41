"""Impacts: if the restitution e is not 0, circles that meet rebound before forces act.

A step with e > 0 first lets all contacts whose bodies approach each other rebound, in rounds. In a round, contacts that
approach and that share circles form a cluster. A cluster rebounds at once, by one reflection. Let x_i = −v_n,i > 0 be
the speed of approach at contact i, with the bodies a and b, normal n_i and normal velocity v_n,i. The contact gets the
impulse P_i = L p_i along its normal, with

    p_i = x_i / (1 / (σ_ai m_a) + 1 / (σ_bi m_b)),  σ_ai = x_i / Σ x_j over the contacts j of the cluster at circle a,
    L = (1 + e) Σ p_i x_i / Σ p_i (n_i · u),  u = M⁻¹ Σ p_i n_i.

The factor L has one value for each cluster. If e depends on the materials of a pair, (1 + e_i) p_i takes the place of
p_i, also in u, and L = Σ (1 + e_i)² p_i x_i / Σ (1 + e_i) p_i (n_i · u). This L lies between 1 and 2 times the factor
that takes the most energy, so that a rebound never adds energy. If all e_i are equal, both forms give one L p_i. In a
cluster of a single contact, the impulse gives Newton's law, v_n⁺ = −e v_n⁻. Rounds follow one another until no contact
approaches any more, or until there are too many rebounds (`MOST_STRIKES`).

No impulse depends on the order of contacts or circles. A contact that hardly approaches changes no impulse by much.
Momentum is conserved. The energy of a cluster changes by −½ (1 − e²) (Σ p_i x_i)² / Σ p_i (n_i · u). This change is 0
at e = 1, and never positive, whatever the masses, the solver and its sweeps.

Reflections in rounds are those of Smith, Kaufman, Vouga, Tamstorf and Grinspun, Reflections on Simultaneous Impact
(2012). Vouga et al., All's Well That Ends Well (2017), showed that the rounds end. To split the mass of a circle among
its contacts is an idea of Tonge, Benevolenski and Voroshilov, Mass Splitting for Jitter-Free Parallel Rigid Body
Simulation (2012). The shares σ are our own.

Friction follows in each round, with the split masses: f_i = −k_t v_t, limited to ±μ P_i. It only takes energy, because
a body that moves with the mean velocity of its parts has less energy than the parts have.

All contacts of a step count as simultaneous. Impacts that are truly simultaneous have no unique outcome.

Gravity and the contact problem come after the impacts, and use no restitution. Symplectic Euler gives velocities of
half a step before the positions. To account for this, walls and segments move at −Δt g / 2 in the impacts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from deep_contact.compiled import njit
from deep_contact.stepping.islands import root_of
from deep_contact.stepping.log import is_asked, work_on
from deep_contact.stepping.pairs import is_table, is_table_type, largest_of, value_of
from deep_contact.stepping.rows import arms_of, row_masses
from deep_contact.stepping.segments import is_moving, surface_velocity, wall_velocity

MOST_STRIKES = 200
"""Largest number of rebounds in a step, per contact. The contact problem stops the approaches that are left then."""

ALWAYS_STRIKES = 50_000
"""Number of rebounds that are allowed in every step, even if it has few contacts."""

SLOWEST = 1e-6
"""Approach below which a contact does not rebound, divided by the fastest approach at its circles so far in the
step."""

SLOWEST_LOSSY = 1e-2
"""This number times 1 − e² replaces `SLOWEST` if the product is larger.

Otherwise rounds at e < 1 could go on for ever, and each would halve the approach that is left."""

ACROSS = 1e-3
"""Least approach that rebounds at contacts perpendicular to gravity, divided by that at contacts along gravity.

Because of this limit, the small velocity errors in a pile do not rebound."""

ROUNDING = 1e-12
"""Largest approach that counts as a rounding error, divided by the sum of |v_x| + |v_y| over the two bodies."""


class Round(NamedTuple):
    """Work arrays of rounds of impacts, for n circles and m contacts. Clusters, p_i, P_i, x_i, L and u: see the module.

    | field         | meaning                                                                    | shape      | unit |
    |---------------|----------------------------------------------------------------------------|------------|------|
    | near          | indices of the contacts to examine; later of those that rebound            | (m,)       | –    |
    | approach      | x_i of the contacts that rebound, in the sequence of `near`                | (m,)       | m/s  |
    | push          | p_i, later P_i, of the contacts that rebound, in the same sequence         | (m,)       | N·s  |
    | circle        | indices of the circles of all clusters                                     | (n,)       | –    |
    | closing       | Σ x_j of the contacts that rebound at each circle; 0 for other circles     | (n + 1,)   | m/s  |
    | cluster       | for each circle the circle whose index stands for its cluster              | (n + 1,)   | –    |
    | sums          | for each cluster Σ p_i x_i, later L (no unit), and Σ p_i (n_i · u)         | (n, 2)     | J    |
    | impulse       | impulse on each circle along x and y, and its moment divided by the radius | (n + 1, 3) | N·s  |
    | fastest       | fastest approach at each circle in the step so far                         | (n + 1,)   | m/s  |
    | inverse       | inverse masses; 0 for fixed circles                                        | (n + 1,)   | 1/kg |
    | head          | first element of the list of contacts of each circle (`begin_rounds`)      | (n,)       | –    |
    | following     | element that follows each element in such a list                           | (2 m,)     | –    |
    | pair_impulses | impulses on the second bodies in this step; (0, 2) if not needed           | (m, 2)     | N·s  |

    Element n of the arrays with n + 1 elements stands for all walls and segments.
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
    inverse: np.ndarray
    head: np.ndarray
    following: np.ndarray
    pair_impulses: np.ndarray


@njit(cache=True, error_model="numpy")
def logged_rebound(context, motion, contacts, log, actuation):
    """Do `rebound`, and log the work that is done in it. Returns the impulses on second bodies, (m, 2), N·s.

    The array is (0, 2) if the impulses are not needed, or if e is 0, so that there are none. context: `StepContext`.
    motion: `Motion` of its step, or None if no optional features are compiled; then there is no restitution either.
    contacts: m contacts. log: `StepLog`. actuation: `Actuation` of the step, or None.
    """
    impulse = log.loads[:0]
    if motion is not None:
        step = context.substep
        if largest_of(step.restitution) > 0.0 and (is_asked(log) or actuation is not None):
            impulse = np.zeros((contacts.body_a.shape[0], 2))
        work = rebound(step, contacts, impulse, actuation)
        if actuation is not None:
            log.work[0] += work + work_on(step, contacts, impulse)
    return impulse


@njit(cache=True, error_model="numpy")
def rebound(step, contacts, impulse, actuation):
    """If e > 0, let circles that meet rebound, in place on their velocities and spins (`reflect`).

    Velocities are those of half a step before the positions. Therefore external forces act for half a step before the
    rebounds. Fixed circles get an additional velocity of −Δt g / 2 in the rebounds, as walls do. Returns the work of
    the external forces in the rebounds, J. step: `StepInput`. impulse: see `reflect`. actuation: `Actuation` of the
    step, or None.
    """
    work, bodies = 0.0, step.bodies
    if largest_of(step.restitution) == 0.0:
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
    """Do the rounds of `rebound`, in place on velocities and spins.

    Slow approaches do not rebound, so that piles come to rest. The limit of the approach is a speed times a factor. The
    speed is the larger of Δt |g| and of (1 − e²) times the scene's `restitution_threshold`. The factor is the larger of
    |n · g| / |g| and `ACROSS`. It is small at contacts perpendicular to gravity, for example with side walls, because
    gravity does not press on them. Without gravity the speed is (1 − e²) times the threshold, and the factor is 1.

    step: `StepInput`. impulse: array to which the impulses on the second bodies of the m contacts are added, (m, 2),
    N·s; (0, 2) if they are not needed. actuation: `Actuation` of the step, or None.
    """
    m, n = contacts.body_a.shape[0], step.bodies.mass.shape[0]
    now = Round(
        np.arange(m), np.empty(m), np.empty(m), np.empty(n, np.int64), np.zeros(n + 1), np.empty(n + 1, np.int64),
        np.empty((n, 2)), np.empty((n + 1, 3)), np.zeros(n + 1), np.empty(n + 1), np.empty(n, np.int64),
        np.empty(2 * m, np.int64), impulse,
    )  # fmt: skip
    do_rounds(step, contacts, now, actuation)


@njit(cache=True, error_model="numpy", _nrt=False)
def do_rounds(step, contacts, now, actuation):
    """Do `reflect` in the arrays of `now`, a `Round`.

    This function and the stages of a round allocate no arrays. With `_nrt=False`, Numba therefore counts no references
    to arrays, which took half of the time of the rounds. The stages, except `rub`, are inlined, because a call would
    copy all fields of the step.
    """
    m, head, following = contacts.body_a.shape[0], now.head, now.following
    scale = step.gravity, step.dt, step.scales.restitution_threshold
    limits = limits_of(largest_of(step.restitution), scale)
    count, strikes = m, 0
    while count > 0 and strikes < max(MOST_STRIKES * m, ALWAYS_STRIKES):
        struck = approaching(step, contacts, count, now, scale, limits, actuation)
        if struck == 0:
            break
        if strikes == 0:
            begin_rounds(step.bodies, contacts, now)
        circles = join(step.bodies, contacts, struck, now)
        push(step, contacts, struck, circles, now)
        rub(step, contacts, struck, circles, now, step.friction, actuation)
        strikes, count = strikes + struck, 0
        for k in range(circles):
            end = head[now.circle[k]]
            while end >= 0:
                # A contact of two circles that have both rebounded is listed once, for its first circle.
                if end % 2 == 0 or now.closing[contacts.body_a[end // 2]] == 0.0:
                    now.near[count] = end // 2
                    count += 1
                end = following[end]
        for k in range(circles):
            now.closing[now.circle[k]] = 0.0


@njit(cache=True, error_model="numpy", _nrt=False)
def limits_of(e, scale):
    """Return (flat, f_x, f_y, slowest), which describe the slowest approach that rebounds (`reflect`).

    An approach along the unit normal n rebounds if it is faster than flat, than |f · n|, m/s each, and than `slowest`
    times the fastest approach at its circles. e: restitution of the contact. scale: gravity, m/s², Δt, s, and
    `ContactScales.restitution_threshold`, m/s.
    """
    (g_x, g_y), dt, threshold = scale
    gravity, slow = math.hypot(g_x, g_y), (1.0 - e * e) * threshold
    slowest = max(SLOWEST, SLOWEST_LOSSY * (1.0 - e * e))
    if gravity == 0.0:
        return slow, 0.0, 0.0, slowest
    slow = max(slow, dt * gravity)
    return ACROSS * slow, slow * g_x / gravity, slow * g_y / gravity, slowest


def limits_at(restitution, a, b, scale, limits):
    """Return `limits_of` the pair of bodies a and b. limits: those of the largest e in the scene."""
    return limits_of(value_of(restitution, a, b), scale) if is_table(restitution) else limits


def bounce_of(restitution, a, b):
    """Return 1 + e of the pair of bodies a and b if e depends on the pair, and otherwise 1."""
    return 1.0 + value_of(restitution, a, b) if is_table(restitution) else 1.0


def bounce_of_all(restitution):
    """Return 1 + e if all pairs have one e, and otherwise 1, since the sums then contain 1 + e_i already."""
    return 1.0 if is_table(restitution) else 1.0 + restitution


@overload(limits_at)
def _overload_limits_at(restitution, a, b, scale, limits):
    if is_table_type(restitution):
        return lambda restitution, a, b, scale, limits: limits_of(value_of(restitution, a, b), scale)
    return lambda restitution, a, b, scale, limits: limits


@overload(bounce_of)
def _overload_bounce_of(restitution, a, b):
    if is_table_type(restitution):
        return lambda restitution, a, b: 1.0 + value_of(restitution, a, b)
    return lambda restitution, a, b: 1.0


@overload(bounce_of_all)
def _overload_bounce_of_all(restitution):
    if is_table_type(restitution):
        return lambda restitution: 1.0
    return lambda restitution: 1.0 + restitution


@njit(inline="always")
def approaching(step, contacts, count, now, scale, limits, actuation):
    """Select the contacts that rebound, in place in `now.near`, and write their x_i = −v_n into `now.approach`.

    A contact rebounds if its bodies approach each other faster than the limits (`limits_of`). scale, limits: as in
    `limits_at`. count: number of contacts in `now.near`, of which the function selects. Returns the number of contacts
    that rebound.
    """
    # The arrays are unpacked here, because Numba would count references to arrays in tuples in every iteration.
    velocity, mass, fastest, near, approach = (
        step.bodies.velocity,
        step.bodies.mass,
        now.fastest,
        now.near,
        now.approach,
    )
    body_a, body_b, normal, n, restitution = (
        contacts.body_a,
        contacts.body_b,
        contacts.normal,
        mass.shape[0],
        step.restitution,
    )
    up_x, up_y = -0.5 * step.dt * step.gravity[0], -0.5 * step.dt * step.gravity[1]
    flat, f_x, f_y, _ = limits  # of the largest e: no other contact rebounds at a slower approach
    struck = np.int64(0)  # the literal 0 has a type of its own, for which `rub` would be compiled a second time
    for k in range(count):
        i = near[k]
        a, b, n_x, n_y = body_a[i], body_b[i], normal[i, 0], normal[i, 1]
        a_x, a_y, b_x, b_y = velocity[a, 0], velocity[a, 1], up_x, up_y
        if b < n:
            b_x, b_y = velocity[b, 0], velocity[b, 1]
        elif actuation is not None:
            b_x, b_y = ground_of(step, contacts, i, actuation)
        x, least = (a_x - b_x) * n_x + (a_y - b_y) * n_y, max(flat, abs(f_x * n_x + f_y * n_y))
        if x > least:  # in a pile at rest hardly ever, while half of the contacts approach at all
            flat_i, x_i, y_i, slowest = limits_at(restitution, a, b, scale, limits)
            least = max(slowest * max(fastest[a], fastest[min(b, n)]), flat_i, abs(x_i * n_x + y_i * n_y))
            least = max(least, ROUNDING * (abs(a_x) + abs(a_y) + abs(b_x) + abs(b_y)), 1e-100)
            if least < x < np.inf and (mass[a] < np.inf or (b < n and mass[b] < np.inf)):
                near[struck], approach[struck] = i, x
                struck += 1
    return struck


@njit(inline="always")
def ground_of(step, contacts, i, actuation):
    """Return the velocity (v_x, v_y) of the wall or segment of the i-th contact in the impacts, m/s.

    At rest it is −Δt g / 2 (see the module). actuation: `Actuation` of the step, or None.
    """
    v_x, v_y = -0.5 * step.dt * step.gravity[0], -0.5 * step.dt * step.gravity[1]
    if actuation is not None:
        s = contacts.body_b[i] - step.bodies.mass.shape[0] - 4
        if s >= 0 and is_moving(actuation.wall, s):
            x, y = contacts.position[i, 0], contacts.position[i, 1]
            w_x, w_y = wall_velocity(step.segments.line, actuation.wall, s, x, y)
            v_x, v_y = v_x + w_x, v_y + w_y
    return v_x, v_y


@njit(cache=True, error_model="numpy", _nrt=False)
def begin_rounds(bodies, contacts, now):
    """Fill the inverse masses and a linked list of the contacts of each circle, in place in `now`, a `Round`.

    An element of a list is the number 2 i + side. It stands for contact i, with the circle as its first body (side 0)
    or second body (side 1). A −1 ends a list.
    """
    n, head, following = bodies.mass.shape[0], now.head, now.following
    now.inverse[n] = 0.0
    for c in range(n):
        now.inverse[c], head[c] = 1.0 / bodies.mass[c], -1
    for i in range(contacts.body_a.shape[0]):
        a, b = contacts.body_a[i], contacts.body_b[i]
        following[2 * i], head[a] = head[a], 2 * i
        if b < n:
            following[2 * i + 1], head[b] = head[b], 2 * i + 1


@njit(inline="always")
def join(bodies, contacts, struck, now):
    """Join the circles of the contacts that rebound into clusters, in place. Returns the number of these circles.

    struck: number of contacts that rebound, the first ones in `now.near`.
    """
    n, count = bodies.mass.shape[0], np.int64(0)
    for k in range(struck):
        i, x = now.near[k], now.approach[k]
        a, b = contacts.body_a[i], min(contacts.body_b[i], n)
        for c in (a, b):
            if now.inverse[c] > 0.0:
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
    """Return (cluster, 1 / (σ_a m_a), 1 / (σ_b m_b)) of the k-th contact that rebounds, the inverse masses in 1/kg.

    cluster: index of the circle that stands for the cluster. σ: see the module.
    """
    i = now.near[k]
    a, b = contacts.body_a[i], min(contacts.body_b[i], bodies.mass.shape[0])
    w_a = now.inverse[a] * (now.closing[a] / now.approach[k])
    w_b = now.inverse[b] * (now.closing[b] / now.approach[k])
    return now.cluster[a if now.closing[a] > 0.0 else b], w_a, w_b


@njit(inline="always")
def push(step, contacts, struck, circles, now):
    """Apply the normal impulses P_i = L p_i of all clusters to the circles, in place on their velocities.

    struck: number of contacts that rebound. circles: number of their circles.
    """
    bodies, n = step.bodies, step.bodies.mass.shape[0]
    for k in range(struck):
        i = now.near[k]
        cluster, w_a, w_b = shared_masses(bodies, contacts, k, now)
        bounce = bounce_of(step.restitution, contacts.body_a[i], contacts.body_b[i])
        p = now.push[k] = bounce * (now.approach[k] / (w_a + w_b))
        now.sums[cluster, 0] += bounce * (p * now.approach[k])
        p_x, p_y = p * contacts.normal[i, 0], p * contacts.normal[i, 1]
        give(now, contacts.body_a[i], min(contacts.body_b[i], n), p_x, p_y)
    for k in range(circles):
        c = now.circle[k]
        square = now.impulse[c, 0] * now.impulse[c, 0] + now.impulse[c, 1] * now.impulse[c, 1]
        now.sums[now.cluster[c], 1] += now.inverse[c] * square
    for k in range(circles):
        c = now.circle[k]
        if now.cluster[c] == c:
            sums = now.sums[c]
            # Impulses that cancel each other change no velocity.
            sums[0] = bounce_of_all(step.restitution) * sums[0] / sums[1] if sums[1] > 0.0 else 0.0
    for k in range(circles):
        c = now.circle[k]
        w = now.sums[now.cluster[c], 0] * now.inverse[c]
        for axis in range(2):
            bodies.velocity[c, axis] += w * now.impulse[c, axis]
            now.impulse[c, axis] = 0.0
    for k in range(struck):
        cluster, _, _ = shared_masses(bodies, contacts, k, now)
        now.push[k] *= now.sums[cluster, 0]


@njit(inline="always")
def give(now, a, b, p_x, p_y):
    """Add an impulse (p_x, p_y) on body b, N·s, and its reaction on body a to `now.impulse`, in place."""
    now.impulse[a, 0] -= p_x
    now.impulse[a, 1] -= p_y
    now.impulse[b, 0] += p_x
    now.impulse[b, 1] += p_y


@njit(cache=True, error_model="numpy", _nrt=False)
def rub(step, contacts, struck, circles, now, friction, actuation):
    """Apply the friction of the normal impulses to the circles, in place on their velocities and spins.

    Add all impulses to `now.pair_impulses`. struck: number of contacts that rebound. circles: number of their circles.
    friction: as in `StepInput`, or None without friction. This function is not inlined, because the compiler leaves the
    code of friction out only if an argument has the type of None.
    """
    bodies, n = step.bodies, step.bodies.mass.shape[0]
    for k in range(struck):
        i, p_n, p_t = now.near[k], now.push[k], 0.0
        a, b, n_x, n_y = contacts.body_a[i], contacts.body_b[i], contacts.normal[i, 0], contacts.normal[i, 1]
        if friction is not None:
            arms, row = arms_of(bodies.radius, a, b, contacts.separation[i]), min(b, n)
            _, w_a, w_b = shared_masses(bodies, contacts, k, now)
            k_t, mu = row_masses(w_a, w_b, arms)[1], value_of(friction, a, b)
            p_t = max(-mu * p_n, min(-k_t * slip_of(step, contacts, i, arms, actuation), mu * p_n))
            give(now, a, row, p_t * n_y, -p_t * n_x)
            now.impulse[a, 2] += arms[0] * p_t
            now.impulse[row, 2] += arms[1] * p_t
        if now.pair_impulses.shape[0] > 0:
            now.pair_impulses[i, 0] += p_n * n_x + p_t * n_y
            now.pair_impulses[i, 1] += p_n * n_y - p_t * n_x
    if friction is not None:
        for k in range(circles):
            c = now.circle[k]
            w = now.inverse[c]
            bodies.velocity[c, 0] += w * now.impulse[c, 0]
            bodies.velocity[c, 1] += w * now.impulse[c, 1]
            bodies.spin[c] += 2.0 * w * now.impulse[c, 2] / bodies.radius[c]


@njit(inline="always")
def slip_of(step, contacts, i, arms, actuation):
    """Return the tangential velocity v_t of the i-th contact along the tangent (n_y, −n_x), m/s.

    arms: arm of each body of the contact, divided by its radius. actuation: `Actuation` of the step, or None.
    """
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
