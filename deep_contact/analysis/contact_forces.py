"""Forces in the user's terms: of contacts, on circles, walls and segments; stress, coordination, neighbours.

A force is an impulse over Δt. In a solved state (`on_step`, `Simulation.solved`) it is the mean over the state's step,
with all substeps and rebounds. Any other state has the solved impulses of the step before, or of its last substep,
without rebounds and without contacts that have opened since. `Simulation.force_on` has means over time that leave
nothing out.
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
"""Largest number of cells of `mean_stress`."""


@by_value
class Forces(NamedTuple):
    """The forces that the contacts of a state carry.

    | field    | meaning                                                          | shape  | unit |
    |----------|------------------------------------------------------------------|--------|------|
    | contact  | force of each contact on its second body; the first has minus it | (m, 2) | N    |
    | net      | force of all contacts on each circle, without gravity            | (n, 2) | N    |
    | torque   | torque of all contacts on each circle, counter-clockwise         | (n,)   | N·m  |
    | walls    | "floor", "right", "ceiling", "left" → force on the wall          | (2,)   | N    |
    | segments | force on each segment                                            | (S, 2) | N    |
    """

    contact: np.ndarray
    net: np.ndarray
    torque: np.ndarray
    walls: dict[str, np.ndarray]
    segments: np.ndarray


def forces(state: State) -> Forces:
    """The forces of a state's contacts. They are 0 in a state of positions alone, which no step has led to.

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
        ready(state, of_step=True)  # raises ValueError; a check before the sums would take longer than they do
    return Forces(contact, on[:n], torque, dict(zip(SIDES, on[n:])), on[n + 4 :])


@njit(cache=True)
def sum_forces(body_a, body_b, normal, separation, radius, normal_impulse, tangent_impulse, rate, segments):
    """Forces of contacts, (m, 2), N, on circles, walls and segments, (n + 4 + S, 2), N, and torques, (n,), N·m.

    The second array is empty, (0, 2), if the contacts do not fit the circles. rate: 1 / Δt, 1/s.
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
    """The mean stress in each circle, (n, 2, 2), N/m, compression positive: σ = −Σ l ⊗ f / (π r²), the virial.

    l: vector from the centre to a contact, m. f: force of the contact on the circle, N. Half of the trace is the
    pressure. At rest σ is symmetric. Source: Christoffersen, Mehrabadi and Nemat-Nasser, J. Appl. Mech. 48, 339 (1981).
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
    """The stress of the medium in square cells over the box, (rows, columns, 2, 2), N/m: rows from the bottom.

    The stress of a cell is the sum of stress times area over the circles with centres in the cell, over the cell's
    area. With fewer than about five circles in a cell it shows single contacts more than a medium.

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
    """Number of contacts of each circle that push, λ_n > 0, (n,)."""
    state = ready(state, of_step=True)
    c, n = state.contacts, state.bodies.count
    pushes = c.normal_impulse > 0
    return sum(np.bincount(body[pushes], minlength=n)[:n] for body in (c.body_a, c.body_b))


def name_of(state: State, body: int) -> int | str:
    """A body as users name it: index of a circle, name of a wall, or "segment 3"."""
    return body_name(int(body), state.bodies.count)


def neighbours(state: State, circle: int) -> list[int | str]:
    """The bodies that touch a circle: indices of circles, "floor", "right", "ceiling", "left", "segment 3"."""
    state = ready(state, of_step=True)
    circle, c = integer("circle", circle, most=state.bodies.count - 1), state.contacts
    return [name_of(state, body) for body in [*c.body_a[c.body_b == circle], *c.body_b[c.body_a == circle]]]
