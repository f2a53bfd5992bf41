"""Constants of the contact model, as Box2D 2.3 has them, and of the thesis's scene. SI units.

Lengths hold for circles with a mean radius of 1 m under 9.81 m/s²; `state.scales` makes them follow the scene.
"""

VERSION = "0.1.0"
"""Of the package."""

LINEAR_SLOP = 0.005
"""Penetration that position correction leaves alone, m. Contacts stay alive in a resting pile because of it."""

WALL_SKIN = 0.01
"""Walls are felt this far ahead of their surface, m (`b2_polygonRadius` of Box2D's edge shapes)."""

NEARLY = 1.0 + 2e-5
"""Circles, walls and segments touch within so many times their reach: circles of 1 m with a gap of 4e-5 m, 1 / 125 of
the slop. What few sweeps leave of a velocity parts what touches exactly, and a contact that is lost comes back without
its impulses."""

BAUMGARTE = 0.2
"""Share of the penetration beyond the slop that one sweep of position correction removes."""

POSITION_TOLERANCE = 3.0
"""Position correction stops once no contact penetrates deeper, in slops."""

MAX_ROTATION = 0.5 * 3.141592653589793
"""Largest rotation of a body in one step with the fixed scales of Box2D 2.3, rad."""

GRAVITY = (0.0, -9.81)
"""m/s²"""

FRICTION = 0.5
RESTITUTION = 0.0
TIME_STEP = 0.01
"""s"""

THETA_TOLERANCE = 6e-5
"""Convergence rate at which the authors' data generator stopped the velocity sweeps, N·s; for π kg and Δt = 0.01 s."""
