"""The arrays of a state, `Bodies` and `Contacts`, and the limits within which the engine computes with them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.state import html
from deep_contact.state.equality import by_value

BOTTOM, RIGHT, TOP, LEFT = range(4)
"""Numbers of the walls."""

SIDES = ("floor", "right", "ceiling", "left")
"""Names of the walls for users, in the order of their numbers."""
WALL_NORMALS = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
"""Contact normals of the four walls, from circle to wall."""

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
    "dt": (1e-9, 1.0, "s"),
    "scales.slop": (0.0, 1e11, "m"),
    "scales.wall_skin": (0.0, 1e11, "m"),
    "scales.max_correction": (0.0, 1e11, "m"),
}
"""Name -> smallest and largest value that the engine computes with, and their unit.

A state may hold any finite number, and files keep it; the engine refuses numbers beyond these limits
(`checks.check_limits`). Within the limits nothing overflows, whatever the combination: λ / m <= 1e90 m/s, whose square
is a float. A step that begins within the limits ends within them: a body leaves it with at most `scales.FASTEST` m/s
and rad/s, and the walls stop it. (Only impulses may grow beyond them, after a start of 1e50 N·s.) Circles whose radius
is below 1e-13 of their distance from the origin sink into each other.
"""

LARGEST_START = 1e50
"""Largest impulse of a start, N·s. It is below the limit of contacts, so that the solved impulses may exceed it."""


@by_value
class Bodies(NamedTuple):
    """n circles (solid discs).

    | field    | meaning                         | shape  | unit  |
    |----------|---------------------------------|--------|-------|
    | position | centre                          | (n, 2) | m     |
    | velocity | velocity of the centre          | (n, 2) | m/s   |
    | angle    | orientation, counter-clockwise  | (n,)   | rad   |
    | spin     | angular velocity ω              | (n,)   | rad/s |
    | mass     | mass; infinite: a fixed circle  | (n,)   | kg    |
    | radius   | radius                          | (n,)   | m     |

    A fixed circle moves with its own velocity and spin, which no force or contact changes: if both are 0 it is a peg,
    otherwise a roller. Fixed circles, walls and segments have no contacts among themselves.

    `pandas.DataFrame(bodies.table())` has a row for each circle; `pandas.DataFrame(bodies)` raises an error.
    """

    position: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    spin: np.ndarray
    mass: np.ndarray
    radius: np.ndarray

    @property
    def count(self) -> int:
        """Number of circles. (`len` of a NamedTuple is its number of fields.)"""
        return self.mass.shape[0]

    @property
    def inertia(self) -> np.ndarray:
        """Moment of inertia of a solid disc, m r² / 2, shape (n,), kg·m²."""
        # m r² first: half of the smallest mass is 0, and 0 times an infinite r² would be no number.
        return 0.5 * (self.mass * self.radius**2)

    @property
    def is_fixed(self) -> np.ndarray:
        """Whether a circle is fixed, (n,)."""
        return np.isinf(self.mass)

    @property
    def free_mass(self) -> np.ndarray:
        """Masses for sums over momentum and energy, (n,), kg: 0 for fixed circles, which belong to the walls."""
        return np.where(self.is_fixed, 0.0, self.mass)

    def table(self) -> dict[str, np.ndarray]:
        """Columns x, y, v_x, v_y, angle, spin, mass, radius, (n,) each, which `pandas.DataFrame` and polars take."""
        (x, y), (v_x, v_y) = self.position.T, self.velocity.T
        return {"x": x, "y": y, "v_x": v_x, "v_y": v_y} | dict(zip(self._fields[2:], self[2:]))

    def _repr_html_(self) -> str:
        return html.arrays_shown(html.counted(self.count, "circle"), self._asdict())


@by_value
class Contacts(NamedTuple):
    """m contacts, sorted by (body_a, body_b).

    | field           | meaning                                          | shape  | unit |
    |-----------------|--------------------------------------------------|--------|------|
    | body_a          | index of the first circle                        | (m,)   | –    |
    | body_b          | second circle, n + wall, or n + 4 + segment      | (m,)   | –    |
    | position        | contact point, in the middle of the overlap      | (m, 2) | m    |
    | normal          | unit normal from a to b                          | (m, 2) | –    |
    | separation      | gap along the normal; penetration if negative    | (m,)   | m    |
    | normal_impulse  | λ_n, solved; in an unsolved state the start      | (m,)   | N·s  |
    | tangent_impulse | λ_t, solved; in an unsolved state the start      | (m,)   | N·s  |
    | normal_start    | λ_n that the solver starts from                  | (m,)   | N·s  |
    | tangent_start   | λ_t that the solver starts from                  | (m,)   | N·s  |

    `pandas.DataFrame(contacts.table())` has a row for each contact; `pandas.DataFrame(contacts)` has one a field.
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
        """Number of contacts."""
        return self.body_a.shape[0]

    @property
    def have_past(self) -> bool:
        """Whether any contact starts from an impulse of an earlier step. Contacts of positions alone do not."""
        return bool(self.normal_start.any() or self.tangent_start.any())

    def table(self) -> dict[str, np.ndarray]:
        """Columns body_a, body_b, x, y, n_x, n_y and the other fields by name, (m,) each; units as above.

        `dc.contact_table(state)` names walls and segments, and has forces.
        """
        (x, y), (n_x, n_y) = self.position.T, self.normal.T
        places = {"x": x, "y": y, "n_x": n_x, "n_y": n_y}
        return {"body_a": self.body_a, "body_b": self.body_b} | places | dict(zip(self._fields[4:], self[4:]))

    def _repr_html_(self) -> str:
        title = f"{html.counted(self.count, 'contact')} (dc.contact_table(state) names walls and segments)"
        return html.arrays_shown(title, self._asdict())


def body_name(body: int, circles: int) -> int | str:
    """A body of a contact, as users name it: index of a circle, "floor", or "segment 3". circles: their number."""
    beyond = body - circles
    return body if beyond < 0 else SIDES[beyond] if beyond < 4 else f"segment {beyond - 4}"


def corners(box: tuple) -> list[tuple[float, float]]:
    """Corners of a box, counter-clockwise from (x_min, y_min), so that the edge from corner k to the next is wall k."""
    x_min, y_min, x_max, y_max = box
    return [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]


def no_contacts() -> Contacts:
    """`Contacts` of length 0."""
    return Contacts(*(np.zeros(0, np.int64),) * 2, *(np.zeros((0, 2)),) * 2, *(np.zeros(0),) * 5)
