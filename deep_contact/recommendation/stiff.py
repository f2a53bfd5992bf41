"""Scenes that a few sweeps cannot solve: masses that differ much, tall columns, and high heaps with slopes.

A sweep carries information one contact further, and a light circle under a heavy one gives way by the ratio of their
masses: Projected Gauss-Seidel needs about L² R sweeps for L circles on one another whose masses differ R times. The
study of runs has neither, so its settings do not hold there. `stiffness` recognises such scenes and takes conjugate
gradients to a tolerance that the lightest circle can feel, in substeps, which a ratio of 1e8 needs (Figure 6.6).

A pyramid of more than 60 rows creeps apart at one step of 10 ms, with 10 sweeps as with 2000: what position correction
pushes out of each other in one step, the next solve does not expect. Substeps are what it needs, of two sweeps each.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.physics.engine import contacts_of
from deep_contact.physics.solvers import NNCG, PGS
from deep_contact.scales import FOLLOWS_SCENE, mean
from deep_contact.state import State

MASS_RATIO = 100.0
"""Largest ratio of masses that is left to the study's settings."""

COLUMN, SLENDER = 30.0, 8.0
"""A column is more circles high than the first, and more times as high as it is wide than the second."""

HEAP, FILLED, TOUCHING = 50.0, 0.75, 1.5
"""A heap is more circles high than the first, fills less than the second of the rectangle around it (a pyramid half),
and has more contacts a circle than the third, so that it lies."""

HEAP_ROWS = 12.0
"""Circles on one another for each substep of two sweeps."""

SWEEPS, SUBSTEPS = 5000, 4
"""Most sweeps of a substep, and substeps of a step, for such scenes."""

SHARE = 1e-6
"""Tolerance, as a share of the impulse that carries the lightest circle for Δt."""


class Stiffness(NamedTuple):
    """Of a scene that a few sweeps cannot solve."""

    why: str
    """What makes it so, in words."""
    solver: PGS
    """What is taken for it."""


def stiffness(scene: State, substeps: int = 1) -> Stiffness | None:
    """What makes a scene too stiff for a few sweeps, and the solver for it; None where nothing does.

    substeps: that the scene needs for its Δt (`runs.substeps_of`); a solver to a tolerance takes at least `SUBSTEPS`.
    """
    bodies = scene.bodies
    if bodies.count < 2:
        return None
    ratio = float(bodies.mass.max() / bodies.mass.min())
    if ratio > MASS_RATIO:
        return Stiffness(f"masses differ {ratio:.3g} times", _to_tolerance(scene, substeps))
    high, wide = _height_and_width(scene)
    if high > COLUMN and high > SLENDER * wide:
        return Stiffness(f"a column {high:.0f} circles high", _to_tolerance(scene, substeps))
    if not _is_heap(scene, high, wide):
        return None
    parts = substeps * 2 ** math.ceil(math.log2(high / HEAP_ROWS))
    return Stiffness(f"a heap with slopes {high:.0f} circles high", PGS(sweeps=2, tolerance=None, substeps=parts))


def _to_tolerance(scene: State, substeps: int) -> NNCG:
    substeps = max(SUBSTEPS, substeps)
    lightest = float(scene.bodies.mass.min()) * math.hypot(*scene.world.gravity) * scene.dt
    tolerance = SHARE * lightest / substeps if lightest > 0.0 else FOLLOWS_SCENE
    return NNCG(sweeps=SWEEPS, tolerance=tolerance, substeps=substeps)


def _height_and_width(scene: State) -> tuple[float, float]:
    """Of all circles, along gravity and across it, in mean diameters; (0, 0) without gravity."""
    bodies, gravity = scene.bodies, np.asarray(scene.world.gravity, float)
    strength = math.hypot(*gravity)
    if strength == 0.0:
        return 0.0, 0.0
    down = gravity / strength
    diameter = 2.0 * mean(bodies.radius)
    high, wide = (
        float(np.ptp(bodies.position @ axis)) / diameter + 1.0 for axis in (down, np.array([-down[1], down[0]]))
    )
    return min(high, bodies.count), wide  # what falls from far above is no column


def _is_heap(scene: State, high: float, wide: float) -> bool:
    if high <= HEAP or math.sqrt(0.75) * scene.bodies.count >= FILLED * high * wide:
        return False
    found = scene.contacts if scene.contacts is not None else contacts_of(scene)
    return found.count > TOUCHING * scene.bodies.count
