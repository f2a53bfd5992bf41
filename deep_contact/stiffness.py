"""Scenes that a few sweeps cannot solve: what makes them so, and the solver that is taken for them.

A sweep carries information one contact further, so in a column Projected Gauss-Seidel needs sweeps in proportion to
height times load: such scenes, and ratios of masses beyond those of the study, get conjugate gradients to a tolerance
that the lightest circle can feel, in substeps, which a ratio of 1e8 needs (Figure 6.6). A high pyramid creeps apart at
one step of 10 ms however well it is solved, since the next solve does not expect what position correction moves: it
gets substeps of eight sweeps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.physics.engine import contacts_of
from deep_contact.physics.solvers import NNCG, PGS
from deep_contact.scene_numbers import SceneNumbers, scene_numbers
from deep_contact.state import State
from deep_contact.state.scales import FOLLOWS_SCENE

MASS_RATIO, LOAD = 100.0, 250.0
"""Largest ratio of masses that is left to the study's settings, and the largest height of a column, in circles, times
its load (`_load`)."""

SLENDER, NARROW = 8.0, 2.0
"""A column is so many times as high as it is wide, or narrower than so many circles."""

HEAP, FILLED, TOUCHING = 50.0, 0.75, 1.5
"""A heap is more circles high than the first, fills less than the second of the rectangle around it (a pyramid half),
and has more contacts a circle than the third, so that it lies."""

HEAP_ROWS = 12.0
"""Circles on one another for each substep of eight sweeps."""

SWEEPS, SUBSTEPS = 5000, 4
"""Most sweeps of a substep, and least substeps of a step, for what is solved to a tolerance."""

SHARE = 1e-6
"""Tolerance, as a share of the impulse that carries the lightest circle for Δt."""


class Stiffness(NamedTuple):
    """Of a scene that a few sweeps cannot solve: what makes it so, in words, and the solver that is taken for it."""

    why: str
    solver: PGS


def stiffness(scene: State, substeps: int = 1, numbers: SceneNumbers | None = None) -> Stiffness | None:
    """What makes a scene too stiff for a few sweeps, and the solver for it; None where nothing does.

    substeps: that the scene needs for its Δt (`presets.parts_for`); a solver to a tolerance takes at least `SUBSTEPS`.
    numbers: the scene's, if at hand.
    """
    numbers = numbers or scene_numbers(scene)
    if numbers.count < 2:
        return None
    ratio = numbers.mass_ratio
    if ratio > 1.001 * MASS_RATIO:
        return Stiffness(f"masses differ {ratio:.3g} times", _to_tolerance(numbers, substeps))
    if numbers.gravity == 0.0:
        return None
    high, wide = height_and_width(numbers)
    if (high > SLENDER * wide or wide < NARROW) and (high * (load := _load(scene)) > LOAD):
        why = f"{load:.0f} times its own mass lies on a circle, {high:.0f} circles high"
        return Stiffness(why, _to_tolerance(numbers, substeps))
    if not _is_heap(scene, high, wide):
        return None
    parts = substeps * 2 ** math.ceil(math.log2(high / HEAP_ROWS))
    return Stiffness(f"a heap with slopes {high:.0f} circles high", PGS(sweeps=8, tolerance=None, substeps=parts))


def _to_tolerance(numbers: SceneNumbers, substeps: int) -> NNCG:
    substeps = max(SUBSTEPS, substeps)
    carries = numbers.lightest * numbers.gravity * numbers.dt
    tolerance = SHARE * carries / substeps if carries > 0.0 else FOLLOWS_SCENE
    return NNCG(sweeps=SWEEPS, tolerance=tolerance, substeps=substeps)


def height_and_width(numbers: SceneNumbers) -> tuple[float, float]:
    """Of all circles, against gravity and across it, in mean diameters; (0, 0) without gravity."""
    if numbers.gravity == 0.0:
        return 0.0, 0.0
    high, wide = (extent / (2.0 * numbers.radius) + 1.0 for extent in (numbers.height, numbers.width))
    return min(high, numbers.count), wide  # what falls from far above is no column


def _load(scene: State) -> float:
    """The most mass that lies above a circle, over its own.

    What lies above is counted in strips as wide as the largest circle; a circle takes the share of its width.
    """
    bodies, gravity = scene.bodies, np.asarray(scene.world.gravity, float)
    up = -gravity / math.hypot(*gravity)
    up, across = np.array([up, (up[1], -up[0])]) @ bodies.position.T
    widest = float(bodies.radius.max())
    strip = np.floor((across - across.min()) / (2.0 * widest) + 1e-9)
    order = np.lexsort((-up, strip))
    first = np.searchsorted(strip[order], strip[order])  # of the strip that each circle is in
    sums = np.concatenate([[0.0], np.cumsum(bodies.mass[order])])
    return float(((sums[:-1] - sums[first]) * (bodies.radius / widest / bodies.mass)[order]).max())


def _is_heap(scene: State, high: float, wide: float) -> bool:
    if high <= HEAP or math.sqrt(0.75) * scene.bodies.count >= FILLED * high * wide:
        return False
    contacts = scene.contacts if scene.contacts is not None else contacts_of(scene)
    return contacts.count > TOUCHING * scene.bodies.count
