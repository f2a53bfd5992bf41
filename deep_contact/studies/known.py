"""Motions with known answers, which a setting of the study has to get right beside piles.

An over-relaxed solver with few sweeps can be good at piles and wrong in the simplest impact: a sweep with ω leaves
1 − ω of a lone contact's error. A study of piles does not show this error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import cos, radians, sin, sqrt

import numpy as np

from deep_contact.measure.setting_runs import Run
from deep_contact.state.arrays import Bodies
from deep_contact.state.constants import GRAVITY
from deep_contact.state.fields import make_bodies
from deep_contact.state.state import State
from deep_contact.state.world import World

G = -GRAVITY[1]


def error(setting: Mapping) -> float:
    """The largest error of a setting among `motions`, % of their speeds. setting: as `solver_of` reads it."""
    return 100.0 * max(wrong(end(setting, scene, seconds).bodies) for scene, seconds, wrong in motions())


def end(setting: Mapping, scene: State, seconds: float) -> State:
    """The state of a run of a scene with a setting after `seconds`, s."""
    run = Run(scene, setting)
    run.advance(round(seconds / setting["dt"]))
    return run.state()


def motions() -> Iterator[tuple[State, float, Callable[[Bodies], float]]]:
    """Yields (scene, duration, s, function from the bodies at the end to their error, as a share of the scene's speed).

    A disc of 1 m hits the floor at 6 m/s: k_t = m / 3, so it sticks where μ (1 + e) v_n ≥ v_t / 3, and otherwise slides
    on (Coulomb's law). Two discs meet (Newton's law). A disc slides until it rolls (Coriolis 1835), rolls or slides
    down a slope.
    """
    for friction, restitution in ((5.0, 0.0), (0.1, 0.0), (0.1, 0.5)):
        tangent = min(friction * (1.0 + restitution) * 6.0, 3.0 / 3.0)  # λ_t / m, m/s
        after = 3.0 - tangent, 6.0 * restitution, -2.0 * tangent
        material = {"friction": friction, "restitution": restitution}
        disc = scene_of([[10.0, 2.0]], gravity=0.0, **material, velocity=[3.0, -6.0])
        yield disc, 0.4, lambda bodies, after=after: _off((*bodies.velocity[0], bodies.spin[0]), after) / 6.0
    for mass in (1.0, 100.0):
        velocity = [[4.0, 0.0], [-4.0, 0.0]]
        pair = scene_of([[10.0, 20.0], [13.0, 20.0]], gravity=0.0, mass=[1.0, mass], velocity=velocity)
        together = 4.0 * (1.0 - mass) / (1.0 + mass)
        yield pair, 0.6, lambda bodies, v=together: _off(bodies.velocity[:, 0], v) / 4.0
    sliding = scene_of([[10.0, 1.0]], friction=0.3, velocity=[4.0, 0.0])
    yield sliding, 1.5, lambda bodies: _off(bodies.velocity[0, 0], 8.0 / 3.0) / 4.0
    slopes = (0.5, 20.0, 4.0 / 3.0 * G * sin(radians(20.0))), (0.2, 45.0, 1.6 * G * sqrt(0.5))
    for friction, angle, speed in slopes:
        disc = scene_of([[10.0, 1.0]], slope=angle, friction=friction)
        yield disc, 2.0, lambda bodies, v=speed: _off(bodies.velocity[0, 0], v) / v


def scene_of(places, *, slope=0.0, gravity=G, friction=0.0, restitution=0.0, segments=(), **bodies) -> State:
    """Circles of radius 1 m in a box of 400 m × 40 m.

    slope: angle of the floor, degrees; the box stays upright, and gravity leans. bodies: further arguments of
    `make_bodies`.
    """
    leaning = gravity * sin(radians(slope)), -gravity * cos(radians(slope))
    constants = {"friction": friction, "restitution": restitution, "segments": segments}
    world = World(box=(0.0, 0.0, 400.0, 40.0), gravity=leaning, **constants)
    return State(name="known", world=world, bodies=make_bodies(places, **bodies))


def _off(values, right) -> float:
    return float(np.abs(np.subtract(values, right)).max())
