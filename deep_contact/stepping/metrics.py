"""Errors of the solution of a step, each defined once, with its unit and source.

θ is no error: a method that creeps takes small steps far from the solution. A solution is compared with the contact
problem itself (`residual`: what is left unsolved) and with an exact solution, as `analysis.exact` finds it
(`velocity_error`). Impulses are not compared: with friction, many impulses of a pile give the same velocities.
"""

from __future__ import annotations

import numpy as np

from deep_contact.state.arrays import Bodies
from deep_contact.state.state import State
from deep_contact.stepping.problem import ContactSolution, after_impacts, contacts_of
from deep_contact.stepping.segments import ground_velocities


def free_velocity(state: State) -> tuple[np.ndarray, np.ndarray]:
    """v⁻ = v + Δt M⁻¹ F before contacts, after impacts: velocities (n, 2), m/s, and spins (n,), rad/s (Eq 2.27).

    F: forces of gravity and pushes.
    """
    after, _ = after_impacts(state)
    bodies = after.bodies
    velocity, spin = bodies.velocity + state.dt * np.array(state.world.gravity), bodies.spin
    if state.push is not None:
        velocity = velocity + state.dt * state.push[0] / bodies.mass[:, None]
        spin = spin + state.dt * state.push[1] / bodies.inertia
    return np.where(bodies.is_fixed[:, None], bodies.velocity, velocity), spin


def kinetic_energy(bodies: Bodies) -> float:
    """Kinetic energy of all circles, translation and rotation, J."""
    bodies = bodies._replace(mass=bodies.free_mass)
    linear = np.einsum("i,ij,ij->", bodies.mass, bodies.velocity, bodies.velocity)
    return float(0.5 * (linear + bodies.inertia @ bodies.spin**2))


def energy_norm(bodies: Bodies, velocity: np.ndarray, spin: np.ndarray) -> float:
    """‖(v, ω)‖_M = √(Σ m |v|² + I ω²), √J: √2 times the root of the kinetic energy.

    In this norm the frictionless contact problem is a projection (Moreau 1966). velocity: (n, 2), m/s. spin: (n,).
    """
    bodies = bodies._replace(mass=bodies.free_mass)
    return float(np.sqrt(bodies.mass @ (velocity**2).sum(axis=1) + bodies.inertia @ spin**2))


def velocity_error(state: State, solution: ContactSolution, reference: ContactSolution) -> float:
    """‖v − v*‖_M / ‖v* − v⁻‖_M, relative: the share of what contacts do to the velocities that is still wrong.

    1 is the error of doing nothing. v*: velocities of the reference; v⁻: `free_velocity`. If contacts do nothing at
    all, the error is 0 for v = v*, and otherwise infinite.
    """
    free, spin = free_velocity(state)
    spinning = solution.angular_velocities - reference.angular_velocities
    error = energy_norm(state.bodies, solution.velocities - reference.velocities, spinning)
    change = energy_norm(state.bodies, reference.velocities - free, reference.angular_velocities - spin)
    if change == 0.0:
        return 0.0 if error == 0.0 else np.inf
    return error / change


def _ends(state: State) -> tuple[np.ndarray, ...]:
    """(a, b, arm of a, arm of b) of every contact, (m,) each, arms in m.

    Walls and segments are the four bodies behind the circles.
    """
    n, half = state.bodies.count, 0.5 * state.contacts.separation
    a, b = state.contacts.body_a, np.minimum(state.contacts.body_b, n + 3)
    radius = np.append(state.bodies.radius, np.zeros(4))
    return a, b, radius[a] + half, np.where(b < n, radius[b] + half, 0.0)


def row_velocities(state: State, velocity: np.ndarray, spin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Relative velocities of the contacts along the normals and along the tangents, (m,) each, m/s.

    They are J v, plus the velocities of segments and of their surfaces.
    """
    (a, b, arm_a, arm_b), normal = _ends(state), state.contacts.normal
    v, w = np.vstack([velocity, np.zeros((4, 2))]), np.append(spin, np.zeros(4))
    apart, tangent = v[b] - v[a], np.column_stack([normal[:, 1], -normal[:, 0]])
    along_tangent = np.einsum("ij,ij->i", apart, tangent) + arm_a * w[a] + arm_b * w[b]
    of_ground = ground_velocities(state.contacts, state.world, state.bodies.count)
    return np.einsum("ij,ij->i", apart, normal) + of_ground[0], along_tangent + of_ground[1]


def effective_masses(state: State) -> tuple[np.ndarray, np.ndarray]:
    """Effective masses 1 / (J M⁻¹ Jᵀ) of the normal and of the tangent rows, (m,) each, kg."""
    a, b, arm_a, arm_b = _ends(state)
    w, i = np.append(1 / state.bodies.mass, np.zeros(4)), np.append(1 / state.bodies.inertia, np.zeros(4))
    return 1 / (w[a] + w[b]), 1 / (w[a] + w[b] + arm_a**2 * i[a] + arm_b**2 * i[b])


def residual(state: State, solution: ContactSolution) -> float:
    """Complementarity residual, m/s: the largest |λ − Π(λ − k u)| / k over all rows (the natural map).

    u: the row's velocity; k: its effective mass; Π puts λ_n above 0 and λ_t within ±μ λ_n. For a
    normal row that is |min(λ_n / k, u_n)|: an approach that is left, or a pull apart that is still pushed. 0 in
    every row is Eq 2.27 with Coulomb's law, Eq 2.29. (Cottle, Pang and Stone 1992, section 1.4; Erleben 2013.)
    """
    if state.contacts.count == 0:
        return 0.0
    normal, tangent = row_velocities(state, solution.velocities, solution.angular_velocities)
    k_n, k_t = effective_masses(state)
    p_n, p_t = solution.normal_impulses, solution.tangent_impulses
    largest = state.world.friction * np.maximum(p_n, 0.0)
    wrong_n = (p_n - np.maximum(p_n - k_n * normal, 0.0)) / k_n
    wrong_t = (p_t - np.clip(p_t - k_t * tangent, -largest, largest)) / k_t
    return float(max(np.abs(wrong_n).max(), np.abs(wrong_t).max()))


def penetration(state: State) -> float:
    """Deepest penetration at the state's positions, m, into circles and into the skin of walls and segments."""
    return float(max(0.0, -contacts_of(state).separation.min(initial=0.0)))
