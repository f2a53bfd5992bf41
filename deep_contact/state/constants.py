"""Constants of the contact model, as Box2D 2.3 has them, and of the thesis's scene. SI units.

Lengths hold for circles with a mean radius of 1 m under 9.81 m/s²; `state.scales` makes them follow the scene.
"""

VERSION = "0.1.0"
"""Version of the package."""

LINEAR_SLOP = 0.005
"""Penetration that position correction leaves alone, m. It keeps the contacts of a resting pile from opening."""

WALL_SKIN = 0.01
"""Distance from its surface at which a wall makes contact, m (`b2_polygonRadius` of Box2D's edge shapes)."""

NEARLY = 1.0 + 2e-5
"""Two bodies touch if their distance is at most this factor times the sum of their radii; the radius of a wall or a
segment is its skin. For circles of 1 m this allows a gap of 4e-5 m, 1 / 125 of the slop. Without the factor, the
velocities that few sweeps leave would open contacts that touch exactly, and a contact that opens loses its impulses."""

BAUMGARTE = 0.2
"""Share of the penetration beyond the slop that one sweep of position correction removes."""

POSITION_TOLERANCE = 3.0
"""Penetration, in slops, at which position correction stops: no contact is deeper."""

MAX_ROTATION = 0.5 * 3.141592653589793
"""Largest rotation of a body in one step with the fixed scales of Box2D 2.3, rad."""

GRAVITY = (0.0, -9.81)
"""Gravity of the thesis's scene, m/s²."""

FRICTION = 0.5
RESTITUTION = 0.0
TIME_STEP = 0.01
"""Time step of the thesis's scene, s."""

THETA_TOLERANCE = 6e-5
"""Convergence rate at which the authors' data generator stopped the velocity sweeps, N·s; for π kg and Δt = 0.01 s."""
