"""Lengths, speeds and times of the contact model, as multiples of what a scene has.

Slop and skin belong to the model, not to physics, so they have no absolute lengths. They follow the scene's mean radius
r̄, its gravity g and Δt, so that a scene in millimetres behaves as the same scene in metres. If lengths are multiplied
by s, times by √s and masses by s², the run stays the same in the new units, to the last bit if s is a power of four.
At r̄ = 1 m, g = 9.81 m/s² and Δt = 0.01 s, as in the thesis's scene, the scales are the absolute values of Box2D 2.3
(`BOX2D`).

Without gravity a scene has no speed of its own. No approach is then too slow to bounce, only circles exactly at rest
fall asleep, and times are counted in steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.state import constants

_GRAVITY = -constants.GRAVITY[1]

FASTEST = 2e9
"""Largest speed, m/s, and spin, rad/s, of a body at the end of a step. It is below `LIMITS`, so that the next step
accepts the state."""

FOLLOWS_SCENE = "scene"
"""Value of a solver's option that follows the scene: `SolverOptions.for_state` puts a number in its place."""


class ContactScales(NamedTuple):
    """Lengths, speeds and times of the contact model. Position correction stops at three slops.

    | field                 | meaning                                                               | unit  |
    |-----------------------|-----------------------------------------------------------------------|-------|
    | slop                  | penetration that position correction leaves alone                     | m     |
    | wall_skin             | distance from its surface at which a wall makes contact               | m     |
    | max_correction        | largest displacement of one row in one sweep of position correction   | m     |
    | max_translation       | largest displacement of a body in one step; set by `BOX2D` alone      | m     |
    | restitution_threshold | speed s: contacts that approach slower than (1 − e²) s do not bounce  | m/s   |
    | sleep_speed           | largest speed of a circle that counts as still                        | m/s   |
    | sleep_spin            | largest angular velocity of a circle that counts as still             | rad/s |
    | sleep_time            | time for which an island is still before it falls asleep              | s     |
    """

    slop: float
    wall_skin: float
    max_correction: float
    max_translation: float
    restitution_threshold: float
    sleep_speed: float
    sleep_spin: float
    sleep_time: float


BOX2D = ContactScales(
    slop=constants.LINEAR_SLOP,
    wall_skin=constants.WALL_SKIN,
    max_correction=0.2,
    max_translation=2.0,
    restitution_threshold=1.0,
    sleep_speed=0.01,
    sleep_spin=2.0 / 180.0 * math.pi,
    sleep_time=0.5,
)
"""The absolute values of Box2D 2.3, whatever the size of the circles: `World(scales=BOX2D)`."""


def contact_scales(radius, gravity, dt: float, fixed: ContactScales | None = None) -> ContactScales:
    """The scales of a scene's steps: the fixed scales, or those that follow from its radii, (n,), m, gravity and Δt.

    `max_translation` is at most `FASTEST` times Δt, m. Only fixed scales can set a smaller limit: otherwise a fast
    circle may move far, and continuous collision finds what it meets (`stepping.continuous`).
    """
    length = mean(radius)
    felt = math.sqrt(math.hypot(*gravity) * length / _GRAVITY)  # 0 without gravity
    speed = felt if felt > 0.0 else length * constants.TIME_STEP / dt
    scales = fixed or ContactScales(
        slop=BOX2D.slop * length,
        wall_skin=BOX2D.wall_skin * length,
        max_correction=BOX2D.max_correction * length,
        max_translation=math.inf,
        restitution_threshold=BOX2D.restitution_threshold * felt,
        sleep_speed=BOX2D.sleep_speed * felt,
        sleep_spin=BOX2D.sleep_spin * felt / length,
        sleep_time=BOX2D.sleep_time * length / speed,
    )
    return scales._replace(max_translation=min(scales.max_translation, FASTEST * dt))


def theta_tolerance(mass, radius, gravity, dt: float) -> float:
    """θ at which sweeps end by default, N·s: the 6e-5 N·s of the authors' code, scaled by the scene's impulses.

    The factor is m̄ g Δt over that of the thesis's scene, π kg · 9.81 m/s² · 0.01 s. Without gravity it is m̄ r̄ / Δt
    over that of the thesis's scene.

    mass: (n,), kg. radius: (n,), m. gravity: (g_x, g_y), m/s². dt: s.
    """
    felt, thesis_dt = math.hypot(*gravity), constants.TIME_STEP
    mass = mass[np.isfinite(mass)]  # without fixed circles
    # In this order of operations the factor of the thesis's scene is exactly 1.
    if felt > 0.0:
        return constants.THETA_TOLERANCE * (mean(mass) * felt * dt / (math.pi * _GRAVITY * thesis_dt))
    return constants.THETA_TOLERANCE * (mean(mass) * mean(radius) / dt / (math.pi * 1.0 / thesis_dt))


def mean(values: np.ndarray) -> float:
    """Mean of positive numbers, (n,): exactly their value if all are equal, and 1 of an empty array.

    Sums of equal numbers round: without care, the mean of ten radii of 0.1 would differ from 0.1.
    """
    if len(values) == 0:
        return 1.0
    least, most = float(np.min(values)), float(np.max(values))
    # Numbers are divided by the largest, so that no sum overflows.
    return most if least == most else most * float(np.mean(np.divide(values, most)))
