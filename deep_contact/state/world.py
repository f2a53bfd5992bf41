"""`World`: the box, the segments, and the constants that hold for every contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deep_contact.state import constants
from deep_contact.state.fields import beyond_limits, checked_world
from deep_contact.state.scales import ContactScales
from deep_contact.state.validation import suggesting


@suggesting
@dataclass(frozen=True, kw_only=True)
class World:
    """The box, segments, and the constants that hold for every contact.

    box: (x_min, y_min, x_max, y_max), m. gravity: (g_x, g_y), m/s². friction: Coulomb's μ. restitution: Newton's e; it
    acts on approaches faster than (1 − e²) times the scales' threshold (`stepping.impacts`). scales: fixed
    `ContactScales`. Without them, by default, the scales follow the scene (`State.scales`): a circle that is added or
    removed changes them if it changes the mean radius.

    segments: pairs of points ((x, y), (x, y)), m: lines beside the box, with contacts on both sides and at their ends,
    and with the skin of the walls (edge shapes of Box2D). An end that lies on another segment or on a wall, to within
    1e-4 of the circle's radius, makes no contact of its own: a circle rolls over the joint as over a chain of Box2D. It
    also rolls over a gap of up to a fiftieth of its radius. The world keeps each segment as (x_0, y_0, x_1, y_1), which
    is accepted too; np.reshape(segments, (-1, 2, 2)) gives the points back.

    surface_speeds: speed of the surface of each segment towards its second end, (S,), m/s: a belt, or the wall of a
    rotating drum. The segment itself stays in place; friction drags the circles that touch it. () means that all
    surfaces rest.

    segment_velocities: velocities of the ends of the segments, (S, 2, 2), m/s. In every step a segment moves with them,
    and pushes and drags the circles that touch it; the world of the next state has its new position. The world keeps
    them in the form of the segments; () means that all segments rest.
    """

    box: tuple[float, float, float, float] = (0.0, 0.0, 30.0, 30.0)
    gravity: tuple[float, float] = constants.GRAVITY
    friction: float = constants.FRICTION
    restitution: float = constants.RESTITUTION
    scales: ContactScales | None = None
    segments: Sequence | np.ndarray = ()
    surface_speeds: Sequence | np.ndarray = ()
    segment_velocities: Sequence | np.ndarray = ()

    def __post_init__(self):
        vars(self).update(checked_world(self))  # around __setattr__: the dataclass is frozen

    @cached_property
    def is_within_limits(self) -> bool:
        """Whether all fields, the scales included, are within `LIMITS`, so that the engine computes with them."""
        return not any(beyond_limits(world=self, scales=self.scales))
