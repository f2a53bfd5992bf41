"""Scenes that a few sweeps cannot solve: masses that differ much, and tall columns.

A sweep carries information one contact further, and a light circle under a heavy one gives way by the ratio of their
masses: Projected Gauss-Seidel needs about L² R sweeps for L circles on one another whose masses differ R times. The
study of runs has neither, so its settings do not hold there. `stiff_solver` recognises such scenes and takes conjugate
gradients to a tolerance that the lightest circle can feel, in substeps, which a ratio of 1e8 needs (Figure 6.6).
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.physics.solvers import NNCG
from deep_contact.scales import FOLLOWS_SCENE, mean
from deep_contact.state import State

MASS_RATIO = 100.0
"""Largest ratio of masses that is left to the study's settings."""

COLUMN, SLENDER = 30.0, 8.0
"""A column is more circles high than the first, and more times as high as it is wide than the second."""

SWEEPS, SUBSTEPS = 5000, 4
"""Most sweeps of a substep, and substeps of a step, for such scenes."""

SHARE = 1e-6
"""Tolerance, as a share of the impulse that carries the lightest circle for Δt."""


def why_stiff(scene: State) -> str:
    """What makes a scene too stiff for a few sweeps, in words; empty where nothing does."""
    bodies, gravity = scene.bodies, np.asarray(scene.world.gravity, float)
    if bodies.count < 2:
        return ""
    ratio = float(bodies.mass.max() / bodies.mass.min())
    if ratio > MASS_RATIO:
        return f"masses differ {ratio:.3g} times"
    strength = math.hypot(*gravity)
    if strength == 0.0:
        return ""
    down = gravity / strength
    diameter = 2.0 * mean(bodies.radius)
    high, wide = (
        float(np.ptp(bodies.position @ axis)) / diameter + 1.0 for axis in (down, np.array([-down[1], down[0]]))
    )
    high = min(high, bodies.count)  # what falls from far above is no column
    return f"a column {high:.0f} circles high" if high > COLUMN and high > SLENDER * wide else ""


def stiff_solver(scene: State, substeps: int = 1) -> NNCG | None:
    """The solver for a scene that is too stiff for a few sweeps; None for one that is not.

    substeps: that the scene needs for its Δt (`runs.substeps_of`); at least `SUBSTEPS` are taken.
    """
    if not why_stiff(scene):
        return None
    lightest = float(scene.bodies.mass.min()) * math.hypot(*scene.world.gravity) * scene.dt
    tolerance = SHARE * lightest / max(SUBSTEPS, substeps) if lightest > 0.0 else FOLLOWS_SCENE
    return NNCG(sweeps=SWEEPS, tolerance=tolerance, substeps=max(SUBSTEPS, substeps))
