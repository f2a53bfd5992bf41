"""States turned and mirrored, for tests that nothing depends on the axes."""

import math
from dataclasses import replace

import numpy as np

from deep_contact.state.fields import check_contacts
from deep_contact.state.state import State

SYMMETRIES = tuple(range(8))


def transform_state(state: State, k: int) -> State:
    """The state turned and mirrored with its box, segments and gravity, by symmetry k (0 … 7).

    k ≥ 4 mirrors x, then k mod 4 quarter turns counter-clockwise follow. The box keeps its lower left corner.
    """
    mirrored, turns = k >= 4, k % 4
    x_min, y_min, x_max, y_max = state.world.box
    width, height = x_max - x_min, y_max - y_min
    quarter, mirror = np.array([[0.0, -1.0], [1.0, 0.0]]), np.diag([-1.0 if mirrored else 1.0, 1.0])
    m = np.linalg.matrix_power(quarter, turns) @ mirror

    def moved(points):
        # As distances from the walls: x_max - x is exact near the wall.
        x, y = points[:, 0] - x_min, points[:, 1] - y_min
        x = width - x if mirrored else x
        for turn in range(turns):
            x, y = (height, width)[turn % 2] - y, x
        return np.stack([x + x_min, y + y_min], axis=1)

    sign = -1.0 if mirrored else 1.0
    box = (x_min, y_min, x_min + height, y_min + width) if turns % 2 else state.world.box
    bodies = state.bodies._replace(
        position=moved(state.bodies.position),
        velocity=state.bodies.velocity @ m.T,
        angle=sign * state.bodies.angle + turns * (math.pi / 2),
        spin=sign * state.bodies.spin,
    )
    gravity = tuple(m @ np.array(state.world.gravity))
    segments = moved(np.reshape(state.world.segments, (-1, 2))).reshape(-1, 4)
    world = replace(state.world, box=box, gravity=gravity, segments=segments)
    if state.contacts is None:
        return state.replace(world=world, bodies=bodies, load=None)
    contacts, n = state.contacts, state.bodies.count
    # Walls are numbered counter-clockwise from the bottom; the mirror swaps right and left.
    wall = ((-1 if mirrored else 1) * (contacts.body_b - n) + turns) % 4
    found = contacts._replace(
        body_b=np.where((contacts.body_b < n) | (contacts.body_b >= n + 4), contacts.body_b, n + wall),
        position=moved(contacts.position),
        normal=contacts.normal @ m.T,
        tangent_impulse=sign * contacts.tangent_impulse,
        tangent_start=sign * contacts.tangent_start,
    )
    return state.replace(world=world, bodies=bodies, contacts=check_contacts(found, bodies, len(segments)), load=None)
