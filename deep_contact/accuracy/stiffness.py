"""Stiff scenes, which a few sweeps cannot solve: how they are recognised, and the solver for them.

A sweep carries information one contact further. In a column, Projected Gauss-Seidel therefore needs sweeps in
proportion to height times load. Such columns, and scenes with mass ratios beyond those of the study, are solved by
conjugate gradients to a tolerance that is small for the lightest circle. The steps are divided into substeps, which a
mass ratio of 1e8 needs (Figure 6.6).

A high pyramid creeps apart if a step is 10 ms, however well each step is solved, since the next solve does not account
for the displacements of position correction. A pyramid is therefore solved in substeps of eight sweeps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.accuracy.scene_numbers import SceneNumbers, scene_numbers
from deep_contact.solvers import NNCG, PGS
from deep_contact.state.arrays import Bodies
from deep_contact.state.scales import FOLLOWS_SCENE
from deep_contact.state.state import State, native
from deep_contact.stepping.problem import contacts_of

MASS_RATIO = 100.0
"""Largest ratio of two masses in a scene for which the settings of the study are used."""

LOAD = 250.0
"""Largest product of a column's height, in circles, and its load (`_load`) for which the settings of the study are
used."""

SLENDER = 8.0
"""Ratio of height to width above which circles count as a column."""

NARROW = 2.0
"""Width, in circles, below which circles always count as a column."""

HEAP = 50.0
"""Height, in circles, up to which circles do not count as a heap."""

FILLED = 0.75
"""A heap fills at most this share of the rectangle around it. A pyramid fills half of the rectangle."""

TOUCHING = 1.5
"""Number of contacts per circle above which circles count as a heap at rest. Falling circles have fewer."""

HEAP_ROWS = 12.0
"""Largest height of a heap, in circles, that is solved in one substep of eight sweeps. With the height, the number of
substeps grows in proportion, rounded up to a power of two."""

SWEEPS = 5000
"""Largest number of sweeps in a substep that is solved to a tolerance."""

SUBSTEPS = 4
"""Smallest number of substeps of a step that is solved to a tolerance."""

SHARE = 1e-6
"""Tolerance of a stiff solve, divided by m g Δt of the lightest circle, where Δt is that of the substep."""


class Stiffness(NamedTuple):
    """The reason why a scene is too stiff for a few sweeps, and the numbers from which its solver follows.

    why: the reason, in words. carried: impulse that carries the weight of the lightest circle for Δt, N·s; None for a
    heap, which is not solved to a tolerance. heap: factor on the number of substeps of a heap.
    """

    why: str
    carried: float | None
    heap: int = 1

    def solver(self, substeps: int = 1, *, rolls: bool = False) -> PGS | NNCG:
        """Return the solver for the scene.

        substeps: number of substeps that the scene's Δt needs in any case (`presets.parts_for`). rolls: whether the
        scene has rolling resistance, which NNCG has not.
        """
        if self.carried is None:
            return PGS(sweeps=8, tolerance=None, substeps=substeps * self.heap)
        substeps = max(SUBSTEPS, substeps)
        tolerance = SHARE * self.carried / substeps if self.carried > 0.0 else FOLLOWS_SCENE
        return (PGS if rolls else NNCG)(sweeps=SWEEPS, tolerance=tolerance, substeps=substeps)


def stiffness(scene: State, numbers: SceneNumbers | None = None) -> Stiffness | None:
    """Return the `Stiffness` of a scene that is too stiff for a few sweeps, or None for any other scene.

    numbers: `scene_numbers(scene)`, if already computed.
    """
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
    """Return (height, width) of all circles, up and across, in mean diameters; (0, 0) without gravity."""
    if numbers.gravity == 0.0:
        return 0.0, 0.0
    high, wide = (extent / (2.0 * numbers.radius) + 1.0 for extent in (numbers.height, numbers.width))
    return min(high, numbers.count), wide  # no column is higher than all its circles


def _load(scene: State) -> float:
    """Return the largest ratio of the mass above a circle to its own mass, over all circles.

    The scene is divided into upright strips as wide as the largest circle. The mass above a circle is that of the
    higher circles in its strip, times the diameter of the circle, divided by the width of the strip.
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
    first = np.searchsorted(strip[order], strip[order])  # first index of each circle's strip
    sums = np.concatenate([[0.0], np.cumsum(bodies.mass[order])])
    return float(((sums[:-1] - sums[first]) * (bodies.radius / widest / bodies.mass)[order]).max())


def _is_heap(scene: State, high: float, wide: float) -> bool:
    if high <= HEAP or math.sqrt(0.75) * scene.bodies.count >= FILLED * high * wide:
        return False
    contacts = scene.contacts if scene.contacts is not None else contacts_of(native(scene))
    return contacts.count > TOUCHING * scene.bodies.count
