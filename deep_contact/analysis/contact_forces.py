"""Forces of contacts, their sums on circles, walls and segments, and stress, coordination and neighbours.

A force is an impulse divided by Δt. In a solved state (`on_step`, `Simulation.solved`) it is the mean over the state's
step, including all substeps and rebounds. Any other state carries the solved impulses of the step before, or only of
that step's last substep. Impulses of rebounds, and of contacts that have opened since, are missing in it.
`Simulation.force_on` gives means over time that include all impulses.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import SIDES, body_name
from deep_contact.state.checks import check_types
from deep_contact.state.equality import by_value
from deep_contact.state.state import State
from deep_contact.state.validation import expect, integer, number
from deep_contact.stepping.prepare import has_engine_arrays, ready

MOST_CELLS = 10_000_000
"""Largest number of cells in `mean_stress`."""


@by_value
class Forces(NamedTuple):
    """The contact forces of a state with n circles, m contacts and S segments.

    | field    | meaning                                                          | shape  | unit |
    |----------|------------------------------------------------------------------|--------|------|
    | contact  | force on the second body of each contact; minus it on the first  | (m, 2) | N    |
    | net      | sum of the contact forces on each circle, without gravity        | (n, 2) | N    |
    | torque   | sum of the contact torques on each circle, counter-clockwise     | (n,)   | N·m  |
    | walls    | "floor", "right", "ceiling", "left" → force on the wall          | (2,)   | N    |
    | segments | sum of the contact forces on each segment                        | (S, 2) | N    |
    """

    contact: np.ndarray
    net: np.ndarray
    torque: np.ndarray
    walls: dict[str, np.ndarray]
    segments: np.ndarray


def forces(state: State) -> Forces:
    """Return the contact forces of a state. They are 0 if it has no impulses, as before its first step.

    Raises ValueError on a state that is not valid.
    """
    check_types(state)
    if not has_engine_arrays(state):
        state = ready(state, of_step=True)
    c, n, segments = state.contacts, state.bodies.count, len(state.world.segments)
    impulses = c.normal_impulse, c.tangent_impulse
    places = c.body_a, c.body_b, c.normal, c.separation, state.bodies.radius
    contact, on, torque = sum_forces(*places, *impulses, 1.0 / state.dt, segments)
    if len(on) != n + 4 + segments:
        ready(state, of_step=True)  # raises ValueError; a check of every state would take longer than the sums
    return Forces(contact, on[:n], torque, dict(zip(SIDES, on[n:])), on[n + 4 :])


@njit(cache=True)
def sum_forces(body_a, body_b, normal, separation, radius, normal_impulse, tangent_impulse, rate, segments):
    """Return the forces of contacts, their sums on bodies, and the torques on circles.

    These are three arrays: the force on the second body of each contact, (m, 2), N; the sum of the forces on each
    circle, wall and segment, (n + 4 + S, 2), N; the torque on each circle, (n,), N·m. The second array is empty, (0,
    2), if the contact arrays do not fit the circles. rate: 1 / Δt, 1/s. segments: number of segments S.
    """
    n, m, end = radius.shape[0], body_a.shape[0], radius.shape[0] + 4 + segments
    contact, on, torque = np.empty((m, 2)), np.zeros((end, 2)), np.zeros(n)
    fits = m == body_b.size == normal.shape[0] == separation.size == normal_impulse.size == tangent_impulse.size
    if not fits or normal.shape[1] != 2:
        return contact, on[:0], torque
    for i in range(m):
        a, b, n_x, n_y = body_a[i], body_b[i], normal[i, 0], normal[i, 1]
        if not 0 <= a < min(n, b) <= b < end:
            return contact, on[:0], torque
        f_n, f_t, half = rate * normal_impulse[i], rate * tangent_impulse[i], 0.5 * separation[i]
        f_x, f_y = f_n * n_x + f_t * n_y, f_n * n_y - f_t * n_x
        contact[i, 0], contact[i, 1] = f_x, f_y
        on[a, 0] -= f_x
        on[a, 1] -= f_y
        on[b, 0] += f_x
        on[b, 1] += f_y
        torque[a] += (radius[a] + half) * f_t
        if b < n:
            torque[b] += (radius[b] + half) * f_t
    return contact, on, torque


def stress(state: State) -> np.ndarray:
    """Return the mean stress in each circle, (n, 2, 2), N/m, positive in compression: the virial stress.

    It is σ = −Σ l ⊗ f / (π r²). l: vector from the centre to a contact point, m. f: force of the contact on the circle,
    N. The pressure is half of the trace. If the circles rest, σ is symmetric. Source: Christoffersen, Mehrabadi and
    Nemat-Nasser, J. Appl. Mech. 48, 339 (1981).
    """
    state = ready(state, of_step=True)
    on_contact = forces(state).contact[:, None]
    bodies, c = state.bodies, state.contacts
    total = np.zeros((bodies.count, 2, 2))
    of_circles = c.body_b < bodies.count
    b = c.body_b[of_circles]
    np.add.at(total, c.body_a, (c.position - bodies.position[c.body_a])[:, :, None] * on_contact)
    arms = (c.position[of_circles] - bodies.position[b])[:, :, None]
    np.subtract.at(total, b, arms * on_contact[of_circles])
    return total / (math.pi * bodies.radius**2)[:, None, None]


def mean_stress(state: State, spacing: float) -> np.ndarray:
    """Return the mean stress in square cells that cover the box, (rows, columns, 2, 2), N/m. Row 0 is at the bottom.

    The product of stress (`stress`) and area is summed over the circles whose centres lie in the cell. The stress of
    the cell is this sum, divided by the cell's area. With fewer than about five circles in a cell, single contacts
    dominate its stress.

    spacing: side of a cell, m.
    """
    x_min, y_min, x_max, y_max = state.world.box
    spacing = number("spacing", spacing, above=0)
    sides = (x_max - x_min) / spacing, (y_max - y_min) / spacing
    expect(
        sides[0] * sides[1] <= MOST_CELLS, f"spacing: expected at most {MOST_CELLS:,} cells in the box, got {spacing}"
    )
    columns, rows = (max(1, math.ceil(side)) for side in sides)
    place = ((state.bodies.position - (x_min, y_min)) / spacing).astype(int)
    mean = np.zeros((rows, columns, 2, 2))
    column, row = np.clip(place, 0, (columns - 1, rows - 1)).T
    np.add.at(mean, (row, column), stress(state) * (math.pi * state.bodies.radius**2)[:, None, None])
    return mean / spacing**2


def coordination(state: State) -> np.ndarray:
    """Return the coordination number of each circle, (n,): the number of its contacts with λ_n > 0."""
    state = ready(state, of_step=True)
    c, n = state.contacts, state.bodies.count
    pushes = c.normal_impulse > 0
    return sum(np.bincount(body[pushes], minlength=n)[:n] for body in (c.body_a, c.body_b))


def name_of(state: State, body: int) -> int | str:
    """Return the name of a body for users: the index of a circle, the name of a wall, or "segment 3".

    body: value of `Contacts.body_a` or `Contacts.body_b`.
    """
    return body_name(int(body), state.bodies.count)


def neighbours(state: State, circle: int) -> list[int | str]:
    """Return the bodies that touch a circle: indices of circles, "floor", "right", "ceiling", "left", "segment 3".

    circle: index of the circle.
    """
    state = ready(state, of_step=True)
    circle, c = integer("circle", circle, most=state.bodies.count - 1), state.contacts
    return [name_of(state, body) for body in [*c.body_a[c.body_b == circle], *c.body_b[c.body_a == circle]]]
