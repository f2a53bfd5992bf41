"""The arrays of a state: `Bodies`, `Contacts`, and the limits of the numbers with which the engine computes.

Tests: tests/state/test_checks.py, tests/behaviour/test_tables.py
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.state import html
from deep_contact.state.equality import by_value

BOTTOM, RIGHT, TOP, LEFT = range(4)
"""Numbers of the four walls of the box, counter-clockwise from the floor."""

SIDES = ("floor", "right", "ceiling", "left")
"""Names of the walls for users, in the order of their numbers."""
WALL_NORMALS = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
"""Unit normal of a contact with each wall, (4, 2), from the circle to the wall."""

LIMITS = {
    "bodies.position": (-1e12, 1e12, "m"),
    "bodies.velocity": (-1e10, 1e10, "m/s"),
    "bodies.spin": (-1e10, 1e10, "rad/s"),
    "bodies.mass": (1e-30, 1e30, "kg"),
    "bodies.radius": (1e-6, 1e11, "m"),
    "contacts.separation": (-1e13, 1e13, "m"),
    "contacts.normal_impulse": (-1e60, 1e60, "N·s"),
    "contacts.tangent_impulse": (-1e60, 1e60, "N·s"),
    "contacts.normal_start": (-1e60, 1e60, "N·s"),
    "contacts.tangent_start": (-1e60, 1e60, "N·s"),
    "world.box": (-1e12, 1e12, "m"),
    "world.segments": (-1e12, 1e12, "m"),
    "world.surface_speeds": (-1e10, 1e10, "m/s"),
    "world.segment_velocities": (-1e10, 1e10, "m/s"),
    "world.gravity": (-1e6, 1e6, "m/s²"),
    "world.friction": (0.0, 1e12, ""),
    "world.rolling_friction": (0.0, 1e12, "m"),
    "dt": (1e-9, 1.0, "s"),
    "scales.slop": (0.0, 1e11, "m"),
    "scales.wall_skin": (0.0, 1e11, "m"),
    "scales.max_correction": (0.0, 1e11, "m"),
}
"""Name of a quantity -> (smallest value, largest value, unit) with which the engine computes.

A state may hold any finite number, and a file stores it. The engine raises ValueError for a number outside of these
limits (`checks.check_limits`). Within the limits no combination of numbers overflows: λ / m is at most 1e90 m/s, and
its square is still a float64. A step that begins within the limits ends within them, because it limits speeds and spins
to `scales.FASTEST`, and the walls stop the circles. Impulses are the exception: after a start of 1e50 N·s they may
leave their limits. Circles whose radius is below 1e-13 of their distance from the origin sink into each other, because
float64 resolves their positions too coarsely.
"""

LARGEST_START = 1e50
"""Largest absolute value of an impulse from which a solve may start, N·s. It is below the limits of the impulses in
`Contacts`, because solved impulses may exceed the starting impulses."""


@by_value
class Bodies(NamedTuple):
    """n circles (solid discs).

    | field    | meaning                           | shape  | unit  |
    |----------|-----------------------------------|--------|-------|
    | position | centre                            | (n, 2) | m     |
    | velocity | velocity of the centre            | (n, 2) | m/s   |
    | angle    | orientation, counter-clockwise    | (n,)   | rad   |
    | spin     | angular velocity ω                | (n,)   | rad/s |
    | mass     | mass; infinite for a fixed circle | (n,)   | kg    |
    | radius   | radius                            | (n,)   | m     |
    | material | index in the tables of the world  | (n,)   | –     |

    A fixed circle moves with its own velocity and spin, which no force or contact changes. If both are 0 it is a peg,
    otherwise a roller. Fixed circles, walls and segments have no contacts among themselves.

    Materials are integers from 0 on (`World`). Without an array of materials, a `State` has 0 for every circle.

    `pandas.DataFrame(bodies.table())` has a row for each circle; `pandas.DataFrame(bodies)` raises an error.
    """

    position: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    spin: np.ndarray
    mass: np.ndarray
    radius: np.ndarray
    material: np.ndarray | None = None

    @property
    def count(self) -> int:
        """Number of circles, n. (`len(bodies)` is the number of fields, as for every NamedTuple.)"""
        return self.mass.shape[0]

    @property
    def inertia(self) -> np.ndarray:
        """Moment of inertia of each circle as a solid disc, m r² / 2, (n,), kg·m²."""
        # The product m r² comes first: half of the smallest float is 0, and 0 times an infinite r² would be NaN.
        return 0.5 * (self.mass * self.radius**2)

    @property
    def is_fixed(self) -> np.ndarray:
        """Whether each circle is fixed, that is, whether its mass is infinite, (n,), bool."""
        return np.isinf(self.mass)

    @property
    def free_mass(self) -> np.ndarray:
        """Mass of each circle for sums of momentum and energy, (n,), kg. It is 0 for fixed circles."""
        return np.where(self.is_fixed, 0.0, self.mass)

    def table(self) -> dict[str, np.ndarray]:
        """Return the columns x, y, v_x, v_y, angle, spin, mass, radius and material by name, (n,) each.

        The units are those of the fields. `pandas.DataFrame` and polars accept the result.
        """
        (x, y), (v_x, v_y) = self.position.T, self.velocity.T
        return {"x": x, "y": y, "v_x": v_x, "v_y": v_y} | dict(zip(self._fields[2:], self[2:]))

    def _repr_html_(self) -> str:
        shown = self._asdict()
        if self.material is None or not self.material.any():
            del shown["material"]
        return html.arrays_shown(html.counted(self.count, "circle"), shown)


@by_value
class Contacts(NamedTuple):
    """m contacts, sorted by (body_a, body_b).

    | field           | meaning                                                                      | shape  | unit |
    |-----------------|------------------------------------------------------------------------------|--------|------|
    | body_a          | index of the first circle                                                    | (m,)   | –    |
    | body_b          | index of the second circle; n + number of a wall; n + 4 + index of a segment | (m,)   | –    |
    | position        | contact point, in the middle of the overlap                                  | (m, 2) | m    |
    | normal          | unit normal from a to b                                                      | (m, 2) | –    |
    | separation      | gap along the normal; negative for a penetration                             | (m,)   | m    |
    | normal_impulse  | solved λ_n; in an unsolved state the starting λ_n                            | (m,)   | N·s  |
    | tangent_impulse | solved λ_t; in an unsolved state the starting λ_t                            | (m,)   | N·s  |
    | normal_start    | λ_n from which the solver starts                                             | (m,)   | N·s  |
    | tangent_start   | λ_t from which the solver starts                                             | (m,)   | N·s  |

    `pandas.DataFrame(contacts.table())` has a row for each contact. `pandas.DataFrame(contacts)` has a row for each
    field.
    """

    body_a: np.ndarray
    body_b: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    separation: np.ndarray
    normal_impulse: np.ndarray
    tangent_impulse: np.ndarray
    normal_start: np.ndarray
    tangent_start: np.ndarray

    @property
    def count(self) -> int:
        """Number of contacts, m."""
        return self.body_a.shape[0]

    @property
    def have_past(self) -> bool:
        """Whether any starting impulse differs from 0, as after an earlier step.

        In a state made from positions alone, all starting impulses are 0.
        """
        return bool(self.normal_start.any() or self.tangent_start.any())

    def table(self) -> dict[str, np.ndarray]:
        """Return the columns body_a, body_b, x, y, n_x, n_y and the other fields by name, (m,) each.

        The units are those of the fields. `dc.contact_table(state)` also names walls and segments, and has forces.
        """
        (x, y), (n_x, n_y) = self.position.T, self.normal.T
        places = {"x": x, "y": y, "n_x": n_x, "n_y": n_y}
        return {"body_a": self.body_a, "body_b": self.body_b} | places | dict(zip(self._fields[4:], self[4:]))

    def _repr_html_(self) -> str:
        title = f"{html.counted(self.count, 'contact')} (dc.contact_table(state) names walls and segments)"
        return html.arrays_shown(title, self._asdict())


def body_name(body: int, circles: int) -> int | str:
    """Return a body of a contact as users name it: the index of a circle, "floor", or "segment 3".

    body: value of `body_a` or `body_b`. circles: number of circles, n. The names of the walls are those of `SIDES`.
    """
    beyond = body - circles
    return body if beyond < 0 else SIDES[beyond] if beyond < 4 else f"segment {beyond - 4}"


def corners(box: tuple) -> list[tuple[float, float]]:
    """Return the four corners (x, y) of a box, m, counter-clockwise from (x_min, y_min).

    The edge from corner k to the next corner is wall k. box: (x_min, y_min, x_max, y_max), m.
    """
    x_min, y_min, x_max, y_max = box
    return [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]


def no_contacts() -> Contacts:
    """Return `Contacts` of length 0."""
    return Contacts(*(np.zeros(0, np.int64),) * 2, *(np.zeros((0, 2)),) * 2, *(np.zeros(0),) * 5)
