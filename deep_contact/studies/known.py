"""Scenes of circles in a long box whose motion is known analytically, for Table 6.5 and `scripts/run_tradeoff.py`.

Tests: tests/scripts/test_run_tradeoff.py
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, radians, sin

from deep_contact.measure.setting_runs import Run
from deep_contact.state.constants import GRAVITY
from deep_contact.state.fields import make_bodies
from deep_contact.state.state import State
from deep_contact.state.world import World

G = -GRAVITY[1]


def end(setting: Mapping, scene: State, seconds: float) -> State:
    """Simulate a scene for some time, and return the last state.

    setting: solver and time step of the run, as for `setting_runs.Run`. seconds: simulated time, s.
    """
    run = Run(scene, setting)
    run.advance(round(seconds / setting["dt"]))
    return run.state()


def known_scene(places, *, slope=0.0, gravity=G, friction=0.0, restitution=0.0, segments=(), **bodies) -> State:
    """Return a scene of circles of radius 1 m in a box of 400 m × 40 m.

    places: centres of the circles, (n, 2), m. slope: angle of the floor, degrees; the box stays upright, and the
    gravity is tilted instead. gravity: acceleration, m/s². friction: Coulomb's μ. restitution: Newton's e. segments:
    as in `World`. bodies: further arguments of `make_bodies`.
    """
    leaning = gravity * sin(radians(slope)), -gravity * cos(radians(slope))
    constants = {"friction": friction, "restitution": restitution, "segments": segments}
    world = World(box=(0.0, 0.0, 400.0, 40.0), gravity=leaning, **constants)
    return State(name="known", world=world, bodies=make_bodies(places, **bodies))
