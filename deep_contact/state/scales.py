"""Scales of the contact model: lengths, speeds and times that follow the size and the gravity of a scene.

Slop and skin belong to the model, not to physics, so they have no absolute lengths. The scales follow the scene's mean
radius r̄, its gravity g and Δt, so that a scene in millimetres behaves like the same scene in metres. If lengths are
multiplied by s, times by √s and masses by s², the run stays the same in the new units, to the last bit if s is a power
of four. At r̄ = 1 m, g = 9.81 m/s² and Δt = 0.01 s, as in the thesis's scene, the scales are the absolute values of
Box2D 2.3 (`BOX2D`).

Without gravity a scene has no speed of its own. If e > 0, contacts then bounce at any approach speed. Only circles
exactly at rest fall asleep, after 50 steps.

Tests: tests/behaviour/test_scales.py
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.state import constants

_GRAVITY = -constants.GRAVITY[1]

FASTEST = 2e9
"""Largest speed, m/s, and largest spin, rad/s, of a body at the end of a step. It is below `LIMITS`, so that the next
step accepts the state."""

FOLLOWS_SCENE = "scene"
"""Value of a solver option that depends on the scene. `SolverOptions.for_state` replaces it by a number."""


class ContactScales(NamedTuple):
    """Lengths, speeds and times of the contact model.

    | field                 | meaning                                                               | unit  |
    |-----------------------|-----------------------------------------------------------------------|-------|
    | slop                  | penetration up to which position correction leaves a contact as it is | m     |
    | wall_skin             | distance from the surface of a wall at which a circle touches it      | m     |
    | max_correction        | largest displacement by one contact in a sweep of position correction | m     |
    | max_translation       | largest displacement of a body in one step (`contact_scales`)         | m     |
    | restitution_threshold | speed s: contacts that approach slower than (1 − e²) s do not bounce  | m/s   |
    | sleep_speed           | largest speed of a circle that counts as still                        | m/s   |
    | sleep_spin            | largest angular velocity of a circle that counts as still             | rad/s |
    | sleep_time            | time for which an island has to be still before it falls asleep       | s     |

    Position correction ends once no penetration exceeds three slops.
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
"""The scales of Box2D 2.3, which are absolute, whatever the size of the circles. `World(scales=BOX2D)` uses them."""


def contact_scales(radius, gravity, dt: float, fixed: ContactScales | None = None) -> ContactScales:
    """Return the scales for the steps of a scene: `fixed`, or scales that follow from its radii, its gravity and Δt.

    `max_translation` is at most `FASTEST` times Δt. Only fixed scales can set a smaller limit. Otherwise a fast circle
    may move far in a step, and continuous collision detection finds the bodies in its way (`stepping.continuous`).

    radius: (n,), m. gravity: (g_x, g_y), m/s². dt: time step, s. fixed: `ContactScales`, or None.
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
    """Return the default tolerance of a solver, the θ at which sweeps end, N·s.

    It is the 6e-5 N·s of the thesis authors' code times a factor. With gravity the factor is m̄ g Δt divided by its
    value in the thesis's scene, π kg · 9.81 m/s² · 0.01 s. Without gravity it is m̄ r̄ / Δt divided by its value in the
    thesis's scene, π kg · 1 m / 0.01 s. m̄ and r̄ are the mean mass and the mean radius.

    mass: (n,), kg. radius: (n,), m. gravity: (g_x, g_y), m/s². dt: time step, s.
    """
    felt, thesis_dt = math.hypot(*gravity), constants.TIME_STEP
    mass = mass[np.isfinite(mass)]  # fixed circles do not count
    # In this order of operations the factor of the thesis's scene is exactly 1.
    if felt > 0.0:
        return constants.THETA_TOLERANCE * (mean(mass) * felt * dt / (math.pi * _GRAVITY * thesis_dt))
    return constants.THETA_TOLERANCE * (mean(mass) * mean(radius) / dt / (math.pi * 1.0 / thesis_dt))


def mean(values: np.ndarray) -> float:
    """Return the mean of positive numbers, (n,). It is exactly their value if all are equal, and 1 if there are none.

    `np.mean` rounds: its mean of three radii of 0.1 m is not exactly 0.1 m.
    """
    if len(values) == 0:
        return 1.0
    least, most = float(np.min(values)), float(np.max(values))
    # The numbers are divided by the largest number, so that their sum does not overflow.
    return most if least == most else most * float(np.mean(np.divide(values, most)))
