"""`SceneNumbers`: the numbers of a scene by which presets and measurements choose solvers."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import Bodies
from deep_contact.state.materials import in_scene
from deep_contact.state.scales import mean
from deep_contact.state.state import State
from deep_contact.state.world import World


class SceneNumbers(NamedTuple):
    """Numbers of a scene. The direction up is against gravity. Without gravity `height`, `width` and `layers` are 0.

    | field         | meaning                                                                      | unit |
    |---------------|------------------------------------------------------------------------------|------|
    | count         | number of circles                                                            |      |
    | dt            | time step                                                                    | s    |
    | gravity       | magnitude of gravity                                                         | m/s² |
    | friction      | smallest μ of all pairs that can touch; `most_friction`: largest             |      |
    | restitution   | smallest e of these pairs; `most_restitution`: largest                       |      |
    | rolling       | largest ρ of these pairs                                                     | m    |
    | is_dragged    | whether the surface of any segment moves                                     |      |
    | still         | number of segments whose ends do not move                                    |      |
    | moving        | number of segments whose ends move                                           |      |
    | radius        | mean radius                                                                  | m    |
    | radius_ratio  | largest over smallest radius                                                 |      |
    | lightest      | smallest mass                                                                | kg   |
    | mass_ratio    | largest over smallest mass                                                   |      |
    | density_ratio | largest over smallest density                                                |      |
    | layers        | mean height of dense circles minus that of light circles, over `height`      |      |
    | fastest       | speed of the fastest circle, end of a segment, or surface that drags circles | m/s  |
    | squares       | sum of the squares of the radii                                              | m²   |
    | height, width | extent of all centres, up and across                                         | m    |
    | box_width     | extent of the box across gravity                                             | m    |
    | opening       | widest gap in the chain of segments at rest from wall to wall (`_opening`)   | m    |
    """

    count: int
    dt: float
    gravity: float
    friction: float
    most_friction: float
    restitution: float
    most_restitution: float
    rolling: float
    is_dragged: bool
    still: int
    moving: int
    radius: float
    radius_ratio: float
    lightest: float
    mass_ratio: float
    density_ratio: float
    layers: float
    fastest: float
    squares: float
    height: float
    width: float
    box_width: float
    opening: float


def scene_numbers(state: State) -> SceneNumbers:
    """Return the numbers of a scene, from one pass over its circles.

    Fixed circles count in `count`, `radius` and `fastest`, and in no other number.
    """
    world, bodies, free = state.world, state.bodies, state.bodies
    driven = [math.hypot(*velocity[end : end + 2]) for velocity in world.segment_velocities for end in (0, 2)]
    if (fixed := bodies.is_fixed).any():
        driven.append(float(np.hypot(*bodies.velocity[fixed].T).max()))
        free = Bodies(*(values[~fixed] for values in bodies))
    (left, low, right, high), (g_x, g_y) = world.box, world.gravity
    gravity = math.hypot(g_x, g_y)
    up = (-g_x / gravity, -g_y / gravity) if gravity > 0.0 else (0.0, 0.0)
    speeds = [abs(speed) for speed in world.surface_speeds]
    moving = sum(map(any, world.segment_velocities))
    friction, restitution = (in_scene(state, value) for value in (world.friction, world.restitution))
    rolling = in_scene(state, world.rolling_friction).max()
    pairs = friction.min(), friction.max(), restitution.min(), restitution.max(), rolling
    *measured, fastest, squares, height, width = _measured(free.position, free.velocity, free.mass, free.radius, up)
    fastest = max(fastest, *driven, 0.0)
    return SceneNumbers(
        bodies.count, state.dt, gravity, *map(float, pairs), any(speeds), len(world.segments) - moving,
        moving, mean(bodies.radius), *measured, max(fastest, *speeds, 0.0) if friction.any() else fastest,
        squares, height, width, high - low if abs(g_x) > abs(g_y) else right - left, _opening(world),
    )  # fmt: skip


def _opening(world: World) -> float:
    """Return the widest gap in the chain of segments at rest that reaches from wall to wall, across gravity, m.

    The chain has those segments that reach further to the right than all that begin left of them. Its gaps are the
    distances from the end of a segment to the next segment, and those to the walls. Without gravity, or without
    segments at rest, the result is 0. Gravity counts as parallel to the axis that it is nearer to.
    """
    if not (world.segments and any(world.gravity)):
        return 0.0
    still, velocities = np.reshape(world.segments, (-1, 4)), np.reshape(world.segment_velocities, (-1, 4))
    if len(velocities):
        still = still[~velocities.any(axis=1)]
    if not len(still):
        return 0.0
    across = int(abs(world.gravity[0]) > abs(world.gravity[1]))
    ends = np.reshape(still, (-1, 2, 2))[:, :, [across, 1 - across]]
    ends = np.take_along_axis(ends, np.argsort(ends[:, :, :1], axis=1), axis=1)
    left, right = ends[np.argsort(ends[:, 0, 0], kind="stable")].swapaxes(0, 1)
    reaches_further = np.append(True, right[1:, 0] > np.maximum.accumulate(right[:-1, 0]))
    left, right = left[reaches_further], right[reaches_further]
    (x, y), (x_0, y_0), (x_1, y_1) = right[:-1].T, left[1:].T, right[1:].T
    nearest = np.maximum(x, x_0)
    share = np.divide(nearest - x_0, x_1 - x_0, out=np.zeros(len(x)), where=x_1 > x_0)
    height = np.where(x_1 > x_0, y_0 + share * (y_1 - y_0), np.clip(y, np.minimum(y_0, y_1), np.maximum(y_0, y_1)))
    gaps = np.hypot(nearest - x, height - y)
    return float(max(0.0, left[0, 0] - world.box[across], world.box[across + 2] - right[-1, 0], gaps.max(initial=0.0)))


@njit(cache=True, error_model="numpy")
def _measured(position, velocity, mass, radius, up):
    """Return the fields `radius_ratio` to `width` of `SceneNumbers`. Without circles the ratios are 1.

    up: unit vector against gravity, or (0, 0).
    """
    n = mass.shape[0]
    if n == 0:
        return 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fastest = squares = 0.0
    low = left = smallest = lightest = lightest_density = math.inf
    high = right = largest = heaviest = densest = -math.inf
    for i in range(n):
        x, y = position[i, 0], position[i, 1]
        height, across, density = up[0] * x + up[1] * y, up[1] * x - up[0] * y, mass[i] / radius[i] ** 2
        low, high, left, right = min(low, height), max(high, height), min(left, across), max(right, across)
        smallest, largest = min(smallest, radius[i]), max(largest, radius[i])
        lightest, heaviest = min(lightest, mass[i]), max(heaviest, mass[i])
        lightest_density, densest = min(lightest_density, density), max(densest, density)
        fastest = max(fastest, velocity[i, 0] ** 2 + velocity[i, 1] ** 2)
        squares += radius[i] ** 2
    layers, heights, dense = 0.0, 0.0, 0
    if densest > lightest_density and high > low:
        middle, all_heights = math.sqrt(densest * lightest_density), 0.0
        for i in range(n):
            height = up[0] * position[i, 0] + up[1] * position[i, 1]
            all_heights += height
            if mass[i] / radius[i] ** 2 > middle:
                heights += height
                dense += 1
        if 0 < dense < n:  # densities that differ by rounding may all be on one side of their mean
            layers = (heights / dense - (all_heights - heights) / (n - dense)) / (high - low)
    return (
        largest / smallest, lightest, heaviest / lightest, densest / lightest_density, layers,
        math.sqrt(fastest), squares, high - low, right - left,
    )  # fmt: skip
