"""Scenes that are hard on a solver, of the tests and of Figure 6.6, and the energy that a scene has."""

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
    """Kinetic energy, and potential energy above the lowest place in the box, J."""
    x_min, y_min, x_max, y_max = scene.world.box
    gravity = np.asarray(scene.world.gravity)
    lowest = np.where(gravity < 0, (x_min, y_min), (x_max, y_max))
    height = bodies.position - lowest
    return metrics.kinetic_energy(bodies) - float(np.einsum("i,ij,j->", bodies.mass, height, gravity))


def silo(n: int, *, radius: float = 1.0, **options) -> State:
    """`column` in a silo one circle wide, its lid two circles above it."""
    scene = column(n, radius=radius, width=2.0 * radius * (1 + WALL_SKIN), **options)
    return with_lid(scene, 2.0 * radius * (WALL_SKIN + (n + 2)))


def with_lid(scene: State, top: float) -> State:
    """The scene in a box whose upper wall is at y = `top`, m."""
    return scene.replace(world=replace(scene.world, box=(*scene.world.box[:3], top)))


def with_bodies(scene: State, **fields) -> State:
    """The scene with some fields of its bodies changed, and without contacts, so that they are found again."""
    return scene.replace(bodies=scene.bodies._replace(**fields), contacts=None)


def loaded_silo(n: int, ratio: float, *, at: int = -1) -> State:
    """A silo of circles of radius 1 m, one of which (`at`) weighs `ratio` times as much as the others."""
    scene = silo(n)
    mass = scene.bodies.mass.copy()
    mass[at] *= ratio
    return with_bodies(scene, mass=mass)


def pyramid(rows: int) -> State:
    """Circles in hexagonal order on a floor as wide as the lowest row, each row one shorter."""
    places = [(row, i) for row in range(rows) for i in range(rows - row)]
    centres = [(WALL_SKIN + (1 + row + 2 * i), WALL_SKIN + (1 + np.sqrt(3) * row)) for row, i in places]
    side = 2 * (rows + WALL_SKIN)
    return State(name=f"pyramid_{rows}", world=World(box=(0, 0, side, side)), bodies=make_bodies(centres))


def channel(speed: float) -> State:
    """Two circles that run into each other with closing `speed`, m/s, in a channel that they cannot leave."""
    bodies = make_bodies([[9.0, 1.01], [21.0, 1.01]], velocity=[[speed / 2, 0], [-speed / 2, 0]])
    return State(name="channel", world=World(box=(0, 0, 30, 2.02), gravity=(0, 0)), bodies=bodies)


def overlapping(share: float, n: int = 2) -> State:
    """n circles without gravity, each overlapping the next by this share of the diameter: 1 is coinciding centres."""
    centres = np.column_stack([15.0 + 2.0 * (1 - share) * np.arange(n), np.full(n, 15.0)])
    return State(name=f"overlap_{n}", world=World(gravity=(0, 0)), bodies=make_bodies(centres))
