"""Scenes that a few sweeps cannot solve: what makes them stiff, and the solver for them.

A sweep carries information one contact further, so in a column Projected Gauss-Seidel needs sweeps in proportion to
height times load. Such scenes, and scenes with ratios of masses beyond those of the study, get conjugate gradients to a
tolerance that is small for the lightest circle, in substeps, which a ratio of 1e8 needs (Figure 6.6). A high pyramid
creeps apart at one step of 10 ms however well it is solved, since the next solve does not account for the displacements
of position correction. It gets substeps of eight sweeps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.accuracy.scene_numbers import SceneNumbers, scene_numbers
from deep_contact.solvers import NNCG, PGS
from deep_contact.state.arrays import Bodies
from deep_contact.state.scales import FOLLOWS_SCENE
from deep_contact.state.state import State
from deep_contact.stepping.problem import contacts_of

MASS_RATIO = 100.0
"""Largest ratio of masses that is left to the study's settings."""

LOAD = 250.0
"""Largest product of a column's height, in circles, and its load (`_load`) that is left to the study's settings."""

SLENDER = 8.0
"""Least ratio of height to width of a column that is not narrow."""

NARROW = 2.0
"""Width of a narrow column, in circles."""

HEAP = 50.0
"""Height of the lowest heap, in circles."""

FILLED = 0.75
"""Largest share of the rectangle around it that a heap fills; a pyramid fills half."""

TOUCHING = 1.5
"""Least number of contacts a circle in a heap: a heap lies, and does not fall."""

HEAP_ROWS = 12.0
"""Height of a heap, in circles, for each of its substeps of eight sweeps."""

SWEEPS = 5000
"""Largest number of sweeps in a substep that is solved to a tolerance."""

SUBSTEPS = 4
"""Least number of substeps of a step that is solved to a tolerance."""

SHARE = 1e-6
"""The tolerance of such a solve, over m g Δt of the lightest circle, where Δt is that of the substep."""


class Stiffness(NamedTuple):
    """The reason why a scene is too stiff for a few sweeps, and the numbers from which its solver follows.

    why: the reason, in words. carried: impulse that carries the lightest circle for Δt, N·s; None for a heap, which is
    not solved to a tolerance. heap: factor on the number of substeps of a heap.
    """

    why: str
    carried: float | None
    heap: int = 1

    def solver(self, substeps: int = 1) -> PGS:
        """The solver for the scene. substeps: number of substeps that its Δt needs (`presets.parts_for`)."""
        if self.carried is None:
            return PGS(sweeps=8, tolerance=None, substeps=substeps * self.heap)
        substeps = max(SUBSTEPS, substeps)
        tolerance = SHARE * self.carried / substeps if self.carried > 0.0 else FOLLOWS_SCENE
        return NNCG(sweeps=SWEEPS, tolerance=tolerance, substeps=substeps)


def stiffness(scene: State, numbers: SceneNumbers | None = None) -> Stiffness | None:
    """The `Stiffness` of a scene that is too stiff for a few sweeps, or None. numbers: of the scene, if at hand."""
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
    """(Height, width) of all circles, against gravity and across it, in mean diameters; (0, 0) without gravity."""
    if numbers.gravity == 0.0:
        return 0.0, 0.0
    high, wide = (extent / (2.0 * numbers.radius) + 1.0 for extent in (numbers.height, numbers.width))
    return min(high, numbers.count), wide  # circles that fall from far above are no column


def _load(scene: State) -> float:
    """The largest ratio of the mass above a circle to its own mass, over all circles.

    The mass above is counted in strips as wide as the largest circle; a circle carries the share of its width.
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
    first = np.searchsorted(strip[order], strip[order])  # first place of each circle's strip
    sums = np.concatenate([[0.0], np.cumsum(bodies.mass[order])])
    return float(((sums[:-1] - sums[first]) * (bodies.radius / widest / bodies.mass)[order]).max())


def _is_heap(scene: State, high: float, wide: float) -> bool:
    if high <= HEAP or math.sqrt(0.75) * scene.bodies.count >= FILLED * high * wide:
        return False
    contacts = scene.contacts if scene.contacts is not None else contacts_of(scene)
    return contacts.count > TOUCHING * scene.bodies.count
