"""Errors of the solution of a step, with unit and source, and quantities that they are computed from.

θ is no error: it is small for a slowly converging method even far from the solution. Two errors are defined. `residual`
measures how far a solution is from solving the contact problem. `velocity_error` compares it with an exact solution, as
`analysis.exact` finds it. Impulses are not compared, because with friction many impulses of a pile give equal
velocities.
"""

from __future__ import annotations

import numpy as np

from deep_contact.state.arrays import Bodies
from deep_contact.state.state import State
from deep_contact.stepping.problem import ContactSolution, after_impacts, contacts_of
from deep_contact.stepping.segments import ground_velocities


def free_velocity(state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the velocities v⁻ = v + Δt M⁻¹ F before contact impulses: (n, 2), m/s, and spins (n,), rad/s (Eq 2.27).

    v: velocities after the impacts of the step. F: gravity and external forces.
    """
    after, _ = after_impacts(state)
    bodies = after.bodies
    velocity, spin = bodies.velocity + state.dt * np.array(state.world.gravity), bodies.spin
    if state.push is not None:
        velocity = velocity + state.dt * state.push[0] / bodies.mass[:, None]
        spin = spin + state.dt * state.push[1] / bodies.inertia
    return np.where(bodies.is_fixed[:, None], bodies.velocity, velocity), spin


def kinetic_energy(bodies: Bodies) -> float:
    """Return the kinetic energy of all free circles, of translation and rotation, J."""
    bodies = bodies._replace(mass=bodies.free_mass)
    linear = np.einsum("i,ij,ij->", bodies.mass, bodies.velocity, bodies.velocity)
    return float(0.5 * (linear + bodies.inertia @ bodies.spin**2))


def energy_norm(bodies: Bodies, velocity: np.ndarray, spin: np.ndarray) -> float:
    """Return ‖(v, ω)‖_M = √(Σ m |v|² + I ω²), √J: √2 times the square root of the kinetic energy.

    In this norm the frictionless contact problem is a projection (Moreau 1966). velocity: (n, 2), m/s. spin: (n,),
    rad/s.
    """
    bodies = bodies._replace(mass=bodies.free_mass)
    return float(np.sqrt(bodies.mass @ (velocity**2).sum(axis=1) + bodies.inertia @ spin**2))


def velocity_error(state: State, solution: ContactSolution, reference: ContactSolution) -> float:
    """Return ‖v − v*‖_M / ‖v* − v⁻‖_M: the share of what contacts do to the velocities that is still wrong.

    v: velocities of the solution. v*: velocities of the reference. v⁻: `free_velocity`. Without any contact impulse,
    the error is 1. If contacts do not change the velocities at all (v* = v⁻), the error is 0 for v = v*, and otherwise
    infinite.
    """
    free, spin = free_velocity(state)
    spinning = solution.angular_velocities - reference.angular_velocities
    error = energy_norm(state.bodies, solution.velocities - reference.velocities, spinning)
    change = energy_norm(state.bodies, reference.velocities - free, reference.angular_velocities - spin)
    if change == 0.0:
        return 0.0 if error == 0.0 else np.inf
    return error / change


def _ends(state: State) -> tuple[np.ndarray, ...]:
    """Return (a, b, arm of a, arm of b) of every contact, (m,) each: indices of its bodies, and their arms, m.

    Four bodies behind the circles stand for the walls and all segments. Their arms are 0.
    """
    n, half = state.bodies.count, 0.5 * state.contacts.separation
    a, b = state.contacts.body_a, np.minimum(state.contacts.body_b, n + 3)
    radius = np.append(state.bodies.radius, np.zeros(4))
    return a, b, radius[a] + half, np.where(b < n, radius[b] + half, 0.0)


def row_velocities(state: State, velocity: np.ndarray, spin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the relative velocities of the contacts along the normals and along the tangents, (m,) each, m/s.

    They are J v, plus the velocities of segments and of their surfaces. velocity: (n, 2), m/s. spin: (n,), rad/s.
    """
    (a, b, arm_a, arm_b), normal = _ends(state), state.contacts.normal
    v, w = np.vstack([velocity, np.zeros((4, 2))]), np.append(spin, np.zeros(4))
    apart, tangent = v[b] - v[a], np.column_stack([normal[:, 1], -normal[:, 0]])
    along_tangent = np.einsum("ij,ij->i", apart, tangent) + arm_a * w[a] + arm_b * w[b]
    of_ground = ground_velocities(state.contacts, state.world, state.bodies.count)
    return np.einsum("ij,ij->i", apart, normal) + of_ground[0], along_tangent + of_ground[1]


def effective_masses(state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the effective masses 1 / (J M⁻¹ Jᵀ) of the normal and of the tangent rows, (m,) each, kg."""
    a, b, arm_a, arm_b = _ends(state)
    w, i = np.append(1 / state.bodies.mass, np.zeros(4)), np.append(1 / state.bodies.inertia, np.zeros(4))
    return 1 / (w[a] + w[b]), 1 / (w[a] + w[b] + arm_a**2 * i[a] + arm_b**2 * i[b])


def residual(state: State, solution: ContactSolution) -> float:
    """Return the complementarity residual, m/s: the largest |λ − Π(λ − k u)| / k over all rows (the natural map).

    u: velocity of the row, m/s. k: its effective mass, kg. Π: limits λ_n to >= 0, and λ_t to ±μ λ_n. For a normal row
    the number is |min(λ_n / k, u_n)|: the speed at which bodies still approach, or at which they separate although the
    contact pushes. If it is 0 in every row, Eq 2.27 with Coulomb's law, Eq 2.29, is satisfied. (Cottle, Pang and Stone
    1992, section 1.4; Erleben 2013.)
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
    """Return the deepest penetration at the state's positions, m.

    Circles penetrate other circles, and the skin of walls and segments.
    """
    return float(max(0.0, -contacts_of(state).separation.min(initial=0.0)))
