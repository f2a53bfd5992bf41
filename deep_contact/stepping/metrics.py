"""Measure errors of the solution of a step, and compute the quantities that the errors need.

The largest change of an impulse in a sweep, θ, is not an error: with a slowly converging method it is small even far
from the solution. Two errors are defined. `residual` measures how far a solution is from solving the contact problem.
`velocity_error` compares a solution with an exact solution, which `analysis.exact` finds. Impulses are not compared,
because with friction many different impulses give a pile the same velocities.
"""

from __future__ import annotations

import numpy as np

from deep_contact.state.arrays import Bodies
from deep_contact.state.materials import at_contacts
from deep_contact.state.state import State, native
from deep_contact.stepping.problem import ContactSolution, after_impacts, contacts_of
from deep_contact.stepping.segments import ground_velocities


def free_velocity(state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the velocities v⁻ = v + Δt M⁻¹ F before contact impulses: (n, 2), m/s, and spins (n,), rad/s (Eq 2.27).

    v: velocities after the impacts of the step. F: gravity and external forces. Fixed circles have their own
    velocities.
    """
    after, _ = after_impacts(state)
    bodies = after.bodies
    velocity, spin = bodies.velocity + state.dt * np.array(state.world.gravity), bodies.spin
    if state.push is not None:
        velocity = velocity + state.dt * state.push[0] / bodies.mass[:, None]
        spin = spin + state.dt * state.push[1] / bodies.inertia
    return np.where(bodies.is_fixed[:, None], bodies.velocity, velocity), spin


def kinetic_energy(bodies: Bodies) -> float:
    """Return the kinetic energy of all free circles, translation and rotation together, J."""
    bodies = bodies._replace(mass=bodies.free_mass)
    linear = np.einsum("i,ij,ij->", bodies.mass, bodies.velocity, bodies.velocity)
    return float(0.5 * (linear + bodies.inertia @ bodies.spin**2))


def energy_norm(bodies: Bodies, velocity: np.ndarray, spin: np.ndarray) -> float:
    """Return ‖(v, ω)‖_M = √(Σ m |v|² + I ω²) over the free circles, √J: √2 times the square root of the kinetic energy.

    In this norm the solution of the frictionless contact problem is a projection (Moreau 1966). velocity: v, (n, 2),
    m/s. spin: ω, (n,), rad/s.
    """
    bodies = bodies._replace(mass=bodies.free_mass)
    return float(np.sqrt(bodies.mass @ (velocity**2).sum(axis=1) + bodies.inertia @ spin**2))


def velocity_error(state: State, solution: ContactSolution, reference: ContactSolution) -> float:
    """Return ‖v − v*‖_M / ‖v* − v⁻‖_M: the error of the velocities, relative to the change that the contacts cause.

    v: velocities of the solution. v*: velocities of the reference, an exact solution. v⁻: velocities before contact
    impulses (`free_velocity`). ‖·‖_M: `energy_norm`. A solution without any contact impulse has an error of 1. If
    contacts do not change the velocities at all (v* = v⁻), the error is 0 for v = v*, and otherwise infinite.
    """
    free, spin = free_velocity(state)
    spinning = solution.angular_velocities - reference.angular_velocities
    error = energy_norm(state.bodies, solution.velocities - reference.velocities, spinning)
    change = energy_norm(state.bodies, reference.velocities - free, reference.angular_velocities - spin)
    if change == 0.0:
        return 0.0 if error == 0.0 else np.inf
    return error / change


def _ends(state: State) -> tuple[np.ndarray, ...]:
    """Return (a, b, arm of a, arm of b) of each contact, (m,) each: indices of its two bodies, and their arms, m.

    Walls and segments have the indices n to n + 3, and all segments share n + 3. Their arms are 0.
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
    """Return the effective masses 1 / (J M⁻¹ Jᵀ) of the normal rows and of the tangent rows, (m,) each, kg."""
    a, b, arm_a, arm_b = _ends(state)
    w, i = np.append(1 / state.bodies.mass, np.zeros(4)), np.append(1 / state.bodies.inertia, np.zeros(4))
    return 1 / (w[a] + w[b]), 1 / (w[a] + w[b] + arm_a**2 * i[a] + arm_b**2 * i[b])


def residual(state: State, solution: ContactSolution) -> float:
    """Return the complementarity residual, m/s: the largest |λ − Π(λ − k u)| / k over all rows (the natural map).

    λ: impulse of the row, N·s. u: relative velocity of the row, m/s. k: effective mass of the row, kg. Π: limits λ_n to
    >= 0, and λ_t to ±μ λ_n. For a normal row the number is |min(λ_n / k, u_n)|. This is the speed at which bodies still
    approach, or at which they separate although the contact pushes. If the residual is 0 in every row, Eq 2.27 with
    Coulomb's law, Eq 2.29, is satisfied. (Cottle, Pang and Stone 1992, section 1.4; Erleben 2013.)
    """
    if state.contacts.count == 0:
        return 0.0
    normal, tangent = row_velocities(state, solution.velocities, solution.angular_velocities)
    k_n, k_t = effective_masses(state)
    p_n, p_t = solution.normal_impulses, solution.tangent_impulses
    largest = at_contacts(state, state.world.friction) * np.maximum(p_n, 0.0)
    wrong_n = (p_n - np.maximum(p_n - k_n * normal, 0.0)) / k_n
    wrong_t = (p_t - np.clip(p_t - k_t * tangent, -largest, largest)) / k_t
    return float(max(np.abs(wrong_n).max(), np.abs(wrong_t).max()))


def penetration(state: State) -> float:
    """Return the deepest penetration at the positions of a state, m; 0 if nothing penetrates.

    Circles penetrate other circles, walls and segments. Penetration of a wall or a segment is measured from its skin,
    which lies `ContactScales.wall_skin` in front of the surface, and not from the surface itself.
    """
    return float(max(0.0, -contacts_of(native(state)).separation.min(initial=0.0)))
