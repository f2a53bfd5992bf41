"""Impacts: where restitution is not 0, circles that meet rebound one pair after the other, before forces act.

A step with e > 0 first lets every contact that approaches fast rebound by Newton's law, v_n⁺ = −e v_n⁻, with Coulomb's
friction, again and again until none approaches any more (Guendelman, Bridson and Fedkiw, Nonconvex Rigid Bodies with
Stacking, 2003). Gravity and the contact problem come after that, without restitution.

Symplectic Euler leaves velocities half a step behind the positions, so walls and segments rise at −Δt g / 2.

Each rebound changes the energy by −½ k (1 − e²) v_n² and by what friction takes: never upwards, whatever the solver,
its sweeps, friction and masses; by 0 for e = 1 without friction. Newton's law for all contacts at once (Moreau 1988)
keeps this only where the contact problem is solved exactly, and not with friction (Kane and Levinson 1985).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deep_contact.physics.contact_solver import arms_of, effective_masses
from deep_contact.physics.segments import surface_velocity

MOST_PASSES = 1000
"""Passes over the contacts after which what still approaches is left to the contact problem, which stops it."""

SLOWEST = 1e-4
"""Share of the fastest approach of a step below which a contact no longer rebounds in it."""


@njit(cache=True, error_model="numpy")
def rebound(step, contacts, impulse):
    """Let circles that meet rebound, in place on their velocities and spins, where e > 0. step: `StepInput`.

    impulse: to which what the second bodies of the contacts receive is added, (m, 2), N·s; (0, 2) where nobody asks.

    Approaches of up to (1 − e²) times the scene's `restitution_threshold`, and of what gravity gives in a step, do not
    rebound, so that piles come to rest.
    """
    bodies, restitution, half = step.bodies, step.restitution, -0.5 * step.dt
    if restitution == 0.0:
        return
    ground, fastest = (half * step.gravity[0], half * step.gravity[1]), 0.0
    for i in range(contacts.body_a.shape[0]):
        fastest = max(fastest, -parting_speed(bodies, contacts, i, ground))
    slow = (1.0 - restitution * restitution) * step.scales.restitution_threshold
    least = max(slow, step.dt * math.hypot(step.gravity[0], step.gravity[1]), SLOWEST * fastest)
    if not least < fastest < np.inf:
        return
    n = bodies.mass.shape[0]
    changed = np.zeros(n + 1, np.int64)  # pass in which a circle was last hit; the last is for all that does not move
    for k in range(1, MOST_PASSES + 1):
        hits = 0
        for i in range(contacts.body_a.shape[0]):
            a, b = contacts.body_a[i], min(contacts.body_b[i], n)
            if max(changed[a], changed[b]) >= k - 1 and parting_speed(bodies, contacts, i, ground) < -least:
                p_x, p_y = strike(bodies, contacts, i, ground, restitution, step.friction, step.segments)
                changed[a] = k
                if b < n:
                    changed[b] = k
                if impulse.shape[0] > 0:
                    impulse[i, 0] += p_x
                    impulse[i, 1] += p_y
                hits += 1
        if hits == 0:
            return


@njit(cache=True)
def parting_speed(bodies, contacts, i, ground):
    """v_n of the i-th contact, m/s: negative where it closes. ground: velocity of walls and segments, m/s."""
    velocity, normal, a, b = bodies.velocity, contacts.normal, contacts.body_a[i], contacts.body_b[i]
    b_x, b_y = (velocity[b, 0], velocity[b, 1]) if b < velocity.shape[0] else ground
    return (b_x - velocity[a, 0]) * normal[i, 0] + (b_y - velocity[a, 1]) * normal[i, 1]


@njit(cache=True, error_model="numpy")
def strike(bodies, contacts, i, ground, restitution, friction, segments):
    """Let the two bodies of a contact rebound, in place: λ_n = −(1 + e) k_n v_n, λ_t = −k_t v_t within ±μ λ_n.

    Returns the impulse on the second, (x, y), N·s.
    """
    n, a, b = bodies.mass.shape[0], contacts.body_a[i], contacts.body_b[i]
    n_x, n_y = contacts.normal[i, 0], contacts.normal[i, 1]
    w_a, w_b = 1.0 / bodies.mass[a], 1.0 / bodies.mass[b] if b < n else 0.0
    arms = arms_of(bodies.radius, a, b, contacts.separation[i])
    k_n, k_t = effective_masses(w_a, w_b, arms)
    v_n = parting_speed(bodies, contacts, i, ground)
    p_n, p_t = -(1.0 + restitution) * k_n * v_n, 0.0
    if friction is not None:
        v_t = arms[0] * bodies.spin[a] * bodies.radius[a] - bodies.velocity[a, 0] * n_y + bodies.velocity[a, 1] * n_x
        if b < n:
            v_t += arms[1] * bodies.spin[b] * bodies.radius[b]
            v_t += bodies.velocity[b, 0] * n_y - bodies.velocity[b, 1] * n_x
        else:
            v_t += ground[0] * n_y - ground[1] * n_x
            if b >= n + 4:
                v_t += surface_velocity(segments.line[b - n - 4], n_x, n_y)
        largest = friction * p_n
        p_t = max(-largest, min(-k_t * v_t, largest))
    p_x, p_y = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x
    bodies.velocity[a, 0] -= w_a * p_x
    bodies.velocity[a, 1] -= w_a * p_y
    bodies.spin[a] += 2.0 * w_a * arms[0] * p_t / bodies.radius[a]
    if b < n:
        bodies.velocity[b, 0] += w_b * p_x
        bodies.velocity[b, 1] += w_b * p_y
        bodies.spin[b] += 2.0 * w_b * arms[1] * p_t / bodies.radius[b]
    return p_x, p_y
