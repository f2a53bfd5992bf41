"""Constants of the contact model, taken from Box2D 2.3, and constants of the thesis's scene, in SI units.

The lengths are meant for circles with a mean radius of 1 m under 9.81 m/s². `state.scales` scales them to other scenes.

Tests: tests/behaviour/test_scales.py
"""

VERSION = "0.1.0"
"""Version of the package."""

LINEAR_SLOP = 0.005
"""Penetration up to which position correction leaves a contact as it is, m. Without this slop the contacts of a resting
pile would open."""

WALL_SKIN = 0.01
"""Distance from the surface of a wall at which a circle touches the wall, m (`b2_polygonRadius` of Box2D's edge
shapes)."""

NEARLY = 1.0 + 2e-5
"""Factor on the sum of two radii: two bodies touch if their distance is at most the product. The radius of a wall or a
segment is its skin. For circles of 1 m this allows a gap of 4e-5 m, 1 / 125 of the slop. Without the factor, circles
that touch exactly would separate because of the velocity errors that few sweeps leave. A contact that opens loses its
impulses."""

BAUMGARTE = 0.2
"""Share of the penetration beyond the slop that one sweep of position correction removes."""

POSITION_TOLERANCE = 3.0
"""Largest penetration that position correction accepts, in slops: its sweeps end once no contact is deeper."""

MAX_ROTATION = 0.5 * 3.141592653589793
"""Largest rotation of a body in one step, rad, in scenes with the fixed scales of Box2D 2.3."""

GRAVITY = (0.0, -9.81)
"""Gravitational acceleration (g_x, g_y) of the thesis's scene, m/s²."""

FRICTION = 0.5
RESTITUTION = 0.0
TIME_STEP = 0.01
"""Time step of the thesis's scene, s."""

THETA_TOLERANCE = 6e-5
"""θ, the largest change of an impulse in a sweep, at which the data generator of the thesis's authors ended the
velocity sweeps, N·s. It is meant for circles of π kg and Δt = 0.01 s."""
