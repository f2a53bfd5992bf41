"""The data of a scene: `World` (box, segments, constants), and `State`, which holds a world, `Bodies` and `Contacts`.

Conventions, said once, here:

* SI units; an impulse λ is in N·s. Physics is float64.
* The n circles are bodies 0 … n-1. The box is one static body. Its walls have the numbers n + 0 (floor), n + 1 (right),
  n + 2 (ceiling) and n + 3 (left), so that the two contacts of a circle in a corner differ. The segments of
  `World.segments` follow, from n + 4 on.
* A contact joins `body_a` < `body_b`. Its unit normal points from a to b, its tangent is (n_y, -n_x). Relative velocity
  is b minus a. A negative separation is penetration. The contact point lies in the middle of the overlap. The impulse
  on b is λ_n n + λ_t t, and the impulse on a is the opposite.
* Contacts are sorted by (body_a, body_b), and each pair occurs at most once. The solver sweeps in that order, so the
  order is part of the result.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.lazy import attach

if TYPE_CHECKING:
    from deep_contact.state.arrays import Bodies as Bodies
    from deep_contact.state.arrays import Contacts as Contacts
    from deep_contact.state.state import State as State
    from deep_contact.state.state import StateWithContacts as StateWithContacts
    from deep_contact.state.world import World as World

__getattr__, __dir__, __all__ = attach(__name__, __file__)
