"""Scenes that are hard to solve, for the tests and Figure 6.6, and the mechanical energy of a scene.

Tests: tests/scripts/test_figure_6_6.py, tests/accuracy/test_stiffness.py
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deep_contact.scenes import column
from deep_contact.state.arrays import Bodies
from deep_contact.state.constants import WALL_SKIN
from deep_contact.state.fields import make_bodies
from deep_contact.state.state import State
from deep_contact.state.world import World
from deep_contact.stepping import metrics


def mechanical_energy(scene: State, bodies: Bodies) -> float:
    """Return the sum of the kinetic and the potential energy of some circles, J.

    The potential energy is 0 at the lowest point of the box. scene: scene that has the box and the gravity.
    """
    x_min, y_min, x_max, y_max = scene.world.box
    gravity = np.asarray(scene.world.gravity)
    lowest = np.where(gravity < 0, (x_min, y_min), (x_max, y_max))
    height = bodies.position - lowest
    return metrics.kinetic_energy(bodies) - float(np.einsum("i,ij,j->", bodies.mass, height, gravity))


def silo(n: int, *, radius: float = 1.0, **options) -> State:
    """Return a column of n circles in a silo as wide as one circle.

    radius: radius of the circles, m. The upper wall is two diameters above the column. options: arguments of `column`.
    """
    scene = column(n, radius=radius, width=2.0 * radius * (1 + WALL_SKIN), **options)
    return with_lid(scene, 2.0 * radius * (WALL_SKIN + (n + 2)))


def with_lid(scene: State, top: float) -> State:
    """Return the scene with the upper wall of its box moved to y = `top`, m."""
    return scene.replace(world=replace(scene.world, box=(*scene.world.box[:3], top)))


def with_bodies(scene: State, **fields) -> State:
    """Return the scene with some fields of its bodies changed.

    The contacts are removed, so that the next step searches them again. fields: name of a field -> array.
    """
    return scene.replace(bodies=scene.bodies._replace(**fields), contacts=None)


def loaded_silo(n: int, ratio: float, *, at: int = -1) -> State:
    """Return a silo of n circles of radius 1 m, in which one circle has `ratio` times the mass of the others.

    at: index of this circle, from the lowest.
    """
    scene = silo(n)
    mass = scene.bodies.mass.copy()
    mass[at] *= ratio
    return with_bodies(scene, mass=mass)


def pyramid(rows: int) -> State:
    """Return a pyramid of circles of radius 1 m in hexagonal order.

    The lowest row has `rows` circles, and each other row has one circle less than the row below. The box is as wide as
    the lowest row.
    """
    places = [(row, i) for row in range(rows) for i in range(rows - row)]
    centres = [(WALL_SKIN + (1 + row + 2 * i), WALL_SKIN + (1 + np.sqrt(3) * row)) for row, i in places]
    side = 2 * (rows + WALL_SKIN)
    return State(name=f"pyramid_{rows}", world=World(box=(0, 0, side, side)), bodies=make_bodies(centres))


def channel(speed: float) -> State:
    """Return two circles that approach each other in a closed channel hardly wider than a circle.

    speed: relative velocity with which they approach, m/s.
    """
    bodies = make_bodies([[9.0, 1.01], [21.0, 1.01]], velocity=[[speed / 2, 0], [-speed / 2, 0]])
    return State(name="channel", world=World(box=(0, 0, 30, 2.02), gravity=(0, 0)), bodies=bodies)


def overlapping(share: float, n: int = 2) -> State:
    """Return a row of n overlapping circles of radius 1 m, without gravity.

    share: overlap of neighbouring circles over the diameter; with 1 their centres coincide.
    """
    centres = np.column_stack([15.0 + 2.0 * (1 - share) * np.arange(n), np.full(n, 15.0)])
    return State(name=f"overlap_{n}", world=World(gravity=(0, 0)), bodies=make_bodies(centres))
