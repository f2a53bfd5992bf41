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
from deep_contact.state.arrays import Bodies
from deep_contact.state.scales import FOLLOWS_SCENE

MASS_RATIO = 100.0
"""Largest ratio of masses that is left to the study's settings."""

LOAD = 250.0
"""Largest height of a column, in circles, times its load (`_load`) that is left to them."""

SLENDER = 8.0
"""A column is at least so many times as high as it is wide."""

NARROW = 2.0
"""Or it is narrower than so many circles."""

HEAP = 50.0
"""A heap is higher than so many circles."""

FILLED = 0.75
"""Share of the rectangle around it that a heap fills at most; a pyramid fills half."""

TOUCHING = 1.5
"""Contacts a circle that a heap has at least: it lies, and does not fall."""

HEAP_ROWS = 12.0
"""Circles on one another for each substep of eight sweeps."""

SWEEPS = 5000
"""Most sweeps of a substep of what is solved to a tolerance."""

SUBSTEPS = 4
"""Least substeps of a step of what is solved to a tolerance."""

SHARE = 1e-6
"""The tolerance of such a solve, as a share of m g Δt of the lightest circle, Δt being that of the substep."""


class Stiffness(NamedTuple):
    """What makes a scene too stiff for a few sweeps, in words, and the numbers that its solver follows from.

    carried: impulse that carries the lightest circle for Δt, N·s; None for a heap, which is not solved to a tolerance.
    heap: how many times as many substeps a heap gets as it would otherwise.
    """

    why: str
    carried: float | None
    heap: int = 1

    def solver(self, substeps: int = 1) -> PGS:
        """The solver for the scene. substeps: that its Δt needs (`presets.parts_for`)."""
        if self.carried is None:
            return PGS(sweeps=8, tolerance=None, substeps=substeps * self.heap)
        substeps = max(SUBSTEPS, substeps)
        tolerance = SHARE * self.carried / substeps if self.carried > 0.0 else FOLLOWS_SCENE
        return NNCG(sweeps=SWEEPS, tolerance=tolerance, substeps=substeps)


def stiffness(scene: State, numbers: SceneNumbers | None = None) -> Stiffness | None:
    """What makes a scene too stiff for a few sweeps; None where nothing does. numbers: the scene's, if at hand."""
    numbers = numbers or scene_numbers(scene)
    if numbers.count < 2:
        return None
    carried = numbers.lightest * numbers.gravity * numbers.dt
    if numbers.mass_ratio > 1.001 * MASS_RATIO:
        return Stiffness(f"masses differ {numbers.mass_ratio:.3g} times", carried)
    if numbers.gravity == 0.0:
        return None
    high, wide = height_and_width(numbers)
    if (high > SLENDER * wide or wide < NARROW) and (high * (load := _load(scene)) > LOAD):
        return Stiffness(f"{load:.0f} times its own mass lies on a circle, {high:.0f} circles high", carried)
    if not _is_heap(scene, high, wide):
        return None
    return Stiffness(f"a heap with slopes {high:.0f} circles high", None, 2 ** math.ceil(math.log2(high / HEAP_ROWS)))


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
    if bodies.is_fixed.all():
        return 0.0
    bodies = Bodies(*(values[~bodies.is_fixed] for values in bodies))
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
