"""`World`: the box, the segments, and the constants of all contacts.

Tests: tests/state/test_checks.py, tests/behaviour/test_refusals.py
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deep_contact.state import constants
from deep_contact.state.fields import beyond_limits, checked_world
from deep_contact.state.materials import table_size
from deep_contact.state.scales import ContactScales
from deep_contact.state.validation import suggesting


@suggesting
@dataclass(frozen=True, kw_only=True)
class World:
    """The box, the segments, gravity, and the constants of all contacts.

    box: (x_min, y_min, x_max, y_max), m. gravity: (g_x, g_y), m/s². friction: Coulomb's μ. restitution: Newton's e;
    contacts that approach slower than (1 − e²) times `ContactScales.restitution_threshold` do not bounce
    (`stepping.impacts`). Both are one number, or a symmetric table (k, k) with a value for each pair of the materials 0
    to k − 1. scales: fixed `ContactScales`; None, the default, lets the scales follow the scene
    (`State.scales`), so that they change if added or removed circles change the mean radius.

    segments: pairs of points ((x, y), (x, y)), m, each a line in addition to the box. Circles touch both sides and both
    ends of a segment, which has the skin of the walls (edge shapes of Box2D). An end makes no contact of its own if it
    lies on another segment or on a wall, to within 1e-4 of the circle's radius: a circle rolls over the joint as over a
    chain of Box2D. It also rolls over a gap of up to 1/50 of its radius. The world stores each segment as (x_0, y_0,
    x_1, y_1), and accepts this form too; np.reshape(segments, (-1, 2, 2)) returns the points.

    surface_speeds: speed of the surface of each segment towards its second end, (S,), m/s, as of a belt or of the wall
    of a rotating drum. The segment itself does not move, but its friction drags the circles that touch it. () means
    that no surface moves.

    segment_velocities: velocities of both ends of each segment, (S, 2, 2), m/s. In every step the ends move with these
    velocities, and the segment pushes and drags the circles that touch it. The world of the next state has the new
    positions. The world stores the velocities in the form of the segments. () means that no segment moves.

    wall_materials: materials of floor, right wall, ceiling and left wall, integers. segment_materials: material of each
    segment, (S,), integers; () means 0. Circles have theirs in `Bodies.material`. All tables have the same k.

    rolling_friction: ρ, m, a number or a table: a contact resists rolling with a torque of up to ρ times its normal
    force, against the difference of the two spins. `PGS`, `PSOR` and `BatchedPGS` have rolling resistance.

    touches: True, or a symmetric table (k, k) of True and False. A pair of materials with False has no contacts: its
    bodies pass through each other. The walls of the box hold every circle, whatever the table says.
    """

    box: tuple[float, float, float, float] = (0.0, 0.0, 30.0, 30.0)
    gravity: tuple[float, float] = constants.GRAVITY
    friction: float | Sequence | np.ndarray = constants.FRICTION
    restitution: float | Sequence | np.ndarray = constants.RESTITUTION
    scales: ContactScales | None = None
    segments: Sequence | np.ndarray = ()
    surface_speeds: Sequence | np.ndarray = ()
    segment_velocities: Sequence | np.ndarray = ()
    wall_materials: Sequence[int] | np.ndarray = (0, 0, 0, 0)
    segment_materials: Sequence[int] | np.ndarray = ()
    touches: bool | Sequence | np.ndarray = True
    rolling_friction: float | Sequence | np.ndarray = 0.0

    def __post_init__(self):
        vars(self).update(checked_world(self))  # without __setattr__, since the dataclass is frozen

    @cached_property
    def materials(self) -> int | None:
        """Number k of the materials in the tables, or None if the world has no table."""
        names = "friction", "restitution", "rolling_friction", "touches"
        return table_size({name: getattr(self, name) for name in names})

    @cached_property
    def is_uniform(self) -> bool:
        """Whether all pairs have one friction and one restitution, touch, and have no rolling resistance."""
        tables = self.friction, self.restitution, self.touches, self.rolling_friction
        return self.rolling_friction == 0.0 and tuple not in map(type, tables)

    @cached_property
    def is_within_limits(self) -> bool:
        """Whether all fields, also those of `scales`, are within `LIMITS`, as the engine requires."""
        return not any(beyond_limits(world=self, scales=self.scales))
