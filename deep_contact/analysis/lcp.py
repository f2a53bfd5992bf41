"""The contact problem as sparse matrices, A λ + b, which is the form of textbooks.

The engine never builds these matrices. `matrix_solvers` and `exact` solve problems in this form. Such a problem may
come from another program, and its bodies may be unknown.

Tests: tests/analysis/test_exact.py, tests/stepping/test_metrics.py
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from deep_contact.state.equality import by_value
from deep_contact.state.materials import at_contacts
from deep_contact.state.state import State
from deep_contact.state.validation import expect, floats, refuse_where
from deep_contact.stepping.metrics import free_velocity
from deep_contact.stepping.segments import ground_velocities


@by_value
class ContactProblem(NamedTuple):
    """Find λ with 0 ≤ λ_n ⟂ (A λ + b)_n ≥ 0, and |λ_t| ≤ μ λ_n against the slip (A λ + b)_t (Eq 2.27, 2.29).

    m contacts have r = 2 m rows: contact i has the rows 2 i (normal) and 2 i + 1 (tangent). If the bodies are unknown,
    as in problems of other programs, jacobian, inverse_mass and free_velocity are None. The thesis writes A = J M⁻¹ Jᵀ
    Δt because its λ is a force; here λ is an impulse, N·s.
    """

    A: sparse.csr_array  # (r, r), 1/kg: J M⁻¹ Jᵀ
    b: np.ndarray  # (r,), m/s: J (v + Δt M⁻¹ F), v after impacts, plus velocities of segments and surfaces
    jacobian: sparse.csr_array | None = None  # (r, 3n): J, from the velocities of n circles to those of the rows
    inverse_mass: np.ndarray | None = None  # (3n,): diagonal of M⁻¹ for (v_x, v_y, ω) of every circle
    free_velocity: np.ndarray | None = None  # (3n,), m/s, rad/s: v + Δt M⁻¹ F for (v_x, v_y, ω) of every circle
    friction: np.ndarray | None = None  # (m,): μ of every contact

    def velocities(self, impulse: np.ndarray) -> np.ndarray:
        """Return (v_x, v_y, ω) of every circle with the impulses λ, (3n,), m/s and rad/s: v + M⁻¹ (Δt F + Jᵀ λ).

        impulse: λ, (r,), N·s. Raises ValueError if the problem has no bodies.
        """
        if self.jacobian is None or self.inverse_mass is None or self.free_velocity is None:
            raise ValueError("jacobian: expected that of the bodies, got None: a problem of matrices has no bodies")
        return self.free_velocity + self.inverse_mass * (self.jacobian.T @ impulse)


def check_problem(problem: ContactProblem) -> ContactProblem:
    """Validate a contact problem. Returns it in float64, with the column indices of A sorted.

    Raises ValueError, which names field and value.
    """
    A = sparse.csr_array(problem.A, dtype=np.float64)
    A.sort_indices()
    size = A.shape[0]
    if A.shape != (size, size) or size % 2:
        raise ValueError(f"A: expected a square matrix with two rows a contact, got shape {A.shape}")
    b, friction = floats("b", problem.b, (size,)), floats("friction", problem.friction, (size // 2,))
    if not np.isfinite(A.data).all():
        raise ValueError(f"A: expected finite entries, got {A.data[~np.isfinite(A.data)][0]}")
    diagonal = A.diagonal()
    for i in np.flatnonzero(~(diagonal > 0)):
        raise ValueError(f"A[{i}, {i}]: expected a number > 0, got {diagonal[i]}")
    refuse_where(friction < 0, "friction", friction, "a number >= 0")
    jacobian = problem.jacobian
    if jacobian is None:
        return ContactProblem(A, b, friction=friction)
    jacobian = sparse.csr_array(jacobian, dtype=np.float64)
    columns = jacobian.shape[1]
    if jacobian.shape[0] != size or columns % 3:
        raise ValueError(f"jacobian: expected {size} rows and three columns a body, got shape {jacobian.shape}")
    inverse_mass = floats("inverse_mass", problem.inverse_mass, (columns,))
    least = inverse_mass.min(initial=0.0)
    expect(least >= 0, f"inverse_mass: expected numbers >= 0, got {least}")
    free_velocity = floats("free_velocity", problem.free_velocity, (columns,))
    return ContactProblem(A, b, jacobian, inverse_mass, free_velocity, friction)


def natural_residual(problem: ContactProblem, impulse: np.ndarray) -> float:
    """Return `metrics.residual`, computed from matrices, m/s: the largest |λ − Π(λ − u / d)| d over all rows.

    u: velocity of the row, A λ + b, m/s. d: its element of A's diagonal, 1/kg. Π: limits λ_n to >= 0, and λ_t to ±μ
    λ_n. impulse: λ, (2 m,), N·s.
    """
    diagonal = problem.A.diagonal()
    free = impulse - (problem.A @ impulse + problem.b) / diagonal
    largest = problem.friction * np.maximum(impulse[::2], 0.0)
    wrong = np.empty_like(impulse)
    wrong[::2] = impulse[::2] - np.maximum(free[::2], 0.0)
    wrong[1::2] = impulse[1::2] - np.clip(free[1::2], -largest, largest)
    return float(np.max(np.abs(wrong) * diagonal, initial=0.0))


def approach(problem: ContactProblem, impulse: np.ndarray) -> float:
    """Return the largest speed at which two bodies in contact still approach, m/s: max(0, −u_n) over all contacts.

    It is how far the velocities are from being feasible. u = A λ + b. impulse: λ, (2 m,), N·s.
    """
    return float(np.max(-(problem.A @ impulse + problem.b)[::2], initial=0.0))


def signorini_gap(problem: ContactProblem, impulse: np.ndarray) -> float:
    """Return Σ |λ_n u_n| over all contacts, J: how far the normal impulses are from Signorini's complementarity.

    A contact adds to it if it pushes although its bodies separate or approach. Without impulses it is 0, so that it
    says little without `approach`. u = A λ + b. impulse: λ, (2 m,), N·s. ContactBench (Le Lidec and others, Contact
    models in robotics: a comparative analysis, 2023) takes the largest contact in place of the sum.
    """
    velocity = problem.A @ impulse + problem.b
    return float(np.abs(impulse[::2] * velocity[::2]).sum())


def dissipation_gap(problem: ContactProblem, impulse: np.ndarray) -> float:
    """Return Σ |μ λ_n |u_t| + λ_t u_t| over all contacts, J: the energy by which friction misses the most dissipation.

    By the principle of maximum dissipation, λ_t minimises λ_t u_t over |λ_t| ≤ μ λ_n; the minimum is −μ λ_n |u_t|
    (Moreau 1973). It is 0 for a contact that sticks, and for one that slips with all its friction against the slip.
    Without impulses it is 0. For impulses in the friction cone, `signorini_gap` and this gap add up to the
    complementarity of De Saxcé's bipotential, λ · (u + (μ |u_t|, 0)), if no λ_n u_n is negative. u = A λ + b. impulse:
    λ, (2 m,), N·s.
    """
    velocity, normal = problem.A @ impulse + problem.b, np.maximum(impulse[::2], 0.0)
    most = problem.friction * normal * np.abs(velocity[1::2])
    return float(np.abs(most + impulse[1::2] * velocity[1::2]).sum())


def contact_problem(state: State) -> ContactProblem:
    """Return the `ContactProblem` of a state that has contacts."""
    if state.contacts is None:
        raise ValueError("state.contacts: expected the contacts to have been found, got None (see dc.step)")
    bodies, contacts = state.bodies, state.contacts
    n, m = bodies.count, contacts.count
    inverse_mass = np.repeat(1 / bodies.mass, 3)
    inverse_mass[2::3] = 1 / bodies.inertia
    free = np.column_stack(free_velocity(state)).ravel()

    rows, columns, entries = [], [], []
    tangent = np.column_stack([contacts.normal[:, 1], -contacts.normal[:, 0]])
    for body, side in ((contacts.body_a, -1.0), (contacts.body_b, 1.0)):
        i = np.flatnonzero(body < n)
        k = body[i]
        arm = contacts.position[i] - bodies.position[k]
        if side > 0:
            # The engine computes the arm of b from the separation. From the contact point it would differ by rounding.
            arm = -(bodies.radius[k] + 0.5 * contacts.separation[i])[:, None] * contacts.normal[i]
        for kind, direction in enumerate((contacts.normal, tangent)):
            turn = arm[:, 0] * direction[i, 1] - arm[:, 1] * direction[i, 0]
            for axis, value in enumerate((direction[i, 0], direction[i, 1], turn)):
                rows.append(2 * i + kind)
                columns.append(3 * k + axis)
                entries.append(side * value)
    index = (np.concatenate(rows), np.concatenate(columns))
    jacobian = sparse.csr_array(sparse.coo_array((np.concatenate(entries), index), shape=(2 * m, 3 * n)))
    b = jacobian @ free
    b += ground_velocities(contacts, state.world, n).T.ravel()
    A = sparse.csr_array(jacobian @ sparse.diags_array(inverse_mass) @ jacobian.T)
    A.sort_indices()
    friction = np.full(m, at_contacts(state, state.world.friction))
    return ContactProblem(A, b, jacobian, inverse_mass, free, friction)
