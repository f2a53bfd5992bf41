"""Starts of the contact solver that are made from the solved impulses: unchanged, or after a transfer to an image.

The transfer to an image and back is that of the thesis's section 3.4.

Tests: tests/starts/test_starts.py, tests/sph/test_thesis.py
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from deep_contact import sph
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.validation import one_of
from deep_contact.stepping.problem import solve


@dataclass(frozen=True)
class Copy:
    """A start that equals the solved impulses (the thesis's Copy-Model)."""

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return solved_impulses(state, solver)


Transfer = Literal["thesis", "consistent", "spline", "shared"]

TRANSFERS: tuple[Transfer, ...] = get_args(Transfer)
"""Names of the ways to transfer impulses to an image and back. `Sph` explains each."""


@dataclass(frozen=True, kw_only=True)
class Sph:
    """A start that is the solved impulses after a transfer to a grid image and back.

    This is the thesis's SPH-Model (Algorithm 5).
    spacing: distance d of neighbouring nodes, m. support: support radius h of the kernel, m; by default h = d.
    kernel: one of `sph.KERNELS`. transfer: one of `TRANSFERS`. All transfers spread an impulse over the nodes by
    weights that sum to 1 (Appendix A). They differ in how they read the impulse back:

    - "thesis" (the start "sph") reads bilinearly (Algorithm 4). It returns a fraction of the impulse, and 0 where no
      node is within h.
    - "consistent" (the start "sph consistent", ours) reads bilinearly, and divides by the value that impulses
      of 1 N·s at all contacts would give in the same way.
    - "spline" (the start "sph spline") reads by `sph.read_by_spline`, as the thesis's authors programmed this start.
    - "shared" reads by `sph.share_out`, as the thesis's authors programmed the start of their network.

    Raises ValueError on an unknown transfer. `deep_contact.sph` checks the other fields when the start is called.
    """

    spacing: float = 0.5
    support: float | None = None
    kernel: str = "poly6"
    transfer: Transfer = "thesis"

    def __post_init__(self):
        one_of("transfer", self.transfer, TRANSFERS)

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return self.round_trip(state, np.column_stack(solved_impulses(state, solver)))

    def round_trip(
        self, state: State, impulses: np.ndarray, *, method: str = "bilinear"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the impulses (λ_n, λ_t), (m,) each, N·s, after a splat and a gather.

        impulses: λ_n and λ_t before the splat, (m, 2), N·s. method: as for `gather`.
        """
        return self.gather(state, self.splat(state, impulses), method=method)

    def splat(self, state: State, impulses: np.ndarray) -> np.ndarray:
        """Return the image of the impulses, (n_y, n_x, 2), N·s. impulses: λ_n and λ_t at the contacts, (m, 2), N·s."""
        grid, points, options = self._transfer(state)
        return sph.splat(grid, points, impulses, normalization="particle", **options)

    def gather(self, state: State, image: np.ndarray, *, method: str = "bilinear") -> tuple[np.ndarray, np.ndarray]:
        """Return (λ_n, λ_t) at the contacts, (m,) each, N·s, read from an image (n_y, n_x, 2), N·s.

        method: "bilinear" or "sph", as for `sph.gather`. Only the transfer "thesis" uses it.
        """
        (grid, points, options), ends = self._transfer(state), {"outside": "clamp", "unreached": "zero"}
        if self.transfer == "spline":
            back = sph.read_by_spline(grid, image, points)
        elif self.transfer == "shared":
            back = sph.share_out(grid, image, points, h=options["h"], kernel=self.kernel)
        elif self.transfer == "thesis":
            back = sph.gather(grid, image, points, method=method, h=options["h"], kernel=self.kernel, **ends)
        else:
            density = sph.density(grid, points, **options)
            back = sph.gather(grid, image, points, normalization="consistent", density=density, **ends)
        return back[:, 0].copy(), back[:, 1].copy()

    def _transfer(self, state: State) -> tuple:
        """Return the `Grid`, the contact points, (m, 2), m, and the keyword arguments of `sph.splat`.

        The contact point at a wall lies half of the penetration outside the box, so it is moved to the edge of the
        grid. If no node is within h of a contact, the transfer "consistent" gives the contact's impulse to the nearest
        node. The other transfers lose the impulse.
        """
        h = self.spacing if self.support is None else self.support
        unreached = "nearest" if self.transfer == "consistent" else "zero"
        options = {"h": h, "kernel": self.kernel, "outside": "clamp", "unreached": unreached}
        return sph.Grid.over_box(state.world.box, self.spacing), state.contacts.position, options


def solved_impulses(state: State, solver) -> tuple[np.ndarray, np.ndarray]:
    """Return the solved impulses (λ_n, λ_t) of a state, (m,) each, N·s.

    If the state holds its solution (`State.holds_solution`), they are read from it. Otherwise `solver` solves the state
    here, from the impulses of the step before (the start "builtin"). The thesis does the same with a copy of the world
    that it runs one step ahead (Algorithm 5).
    """
    contacts = state.contacts
    if state.holds_solution:
        return contacts.normal_impulse.copy(), contacts.tangent_impulse.copy()
    solution = solve(state, solver, contacts.normal_start, contacts.tangent_start)
    return solution.normal_impulses, solution.tangent_impulses
