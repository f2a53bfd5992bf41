"""Starts from the solution: as it is, after a way through an image (section 3.4), and made wrong."""

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
    """The solution itself (the thesis's Copy-Model)."""

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return solved_impulses(state, solver)


Transfer = Literal["thesis", "consistent", "spline", "shared"]

TRANSFERS: tuple[Transfer, ...] = get_args(Transfer)
"""Ways to transfer impulses to an image and back, see `Sph`."""


@dataclass(frozen=True, kw_only=True)
class Sph:
    """The solution after a round trip through a grid image (the thesis's SPH-Model, Algorithm 5).

    spacing: d of the grid, m. support: h of the kernel, m; by default h = d. transfer: one of `TRANSFERS`. All of them
    spread an impulse over nodes by weights that sum to one (Appendix A), and differ in how they read the impulse back:

    - "thesis" (the start "sph"): bilinearly (Algorithm 4), which returns a part of the impulse, and 0 where no node is
      within h.
    - "consistent" ("sph consistent", ours): bilinearly, divided by the value that a field of ones returns.
    - "spline" ("sph spline"): as the thesis's authors programmed it for this start (`sph.thesis`).
    - "shared": as the thesis's authors programmed it for the start of their network.

    Raises ValueError on an unknown transfer; `deep_contact.sph` checks the rest.
    """

    spacing: float = 0.5
    support: float | None = None
    kernel: str = "poly6"
    transfer: Transfer = "thesis"

    def __post_init__(self):
        one_of("transfer", self.transfer, TRANSFERS)

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return self.round_trip(state, np.column_stack(solved_impulses(state, solver)))

    def round_trip(self, state: State, impulses: np.ndarray, *, method="bilinear") -> tuple[np.ndarray, np.ndarray]:
        """(λ_n, λ_t) after splat and gather, (m,) each, of impulses (m, 2), N·s. method: as of `gather`."""
        return self.gather(state, self.splat(state, impulses), method=method)

    def splat(self, state: State, impulses: np.ndarray) -> np.ndarray:
        """The image of the impulses, (n_y, n_x, 2), N·s."""
        grid, points, options = self._transfer(state)
        return sph.splat(grid, points, impulses, normalization="particle", **options)

    def gather(self, state: State, image: np.ndarray, *, method: str = "bilinear") -> tuple[np.ndarray, np.ndarray]:
        """(λ_n, λ_t) of an image at the contacts. method: of `sph.gather`, for the transfer "thesis" alone."""
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
        """(Grid, the contacts' places, options of a splat).

        A contact with a wall lies half its penetration outside the box. Where no node is within h, the thesis's
        transfer loses the contact; the consistent one gives it to the nearest node.
        """
        h = self.spacing if self.support is None else self.support
        unreached = "nearest" if self.transfer == "consistent" else "zero"
        options = {"h": h, "kernel": self.kernel, "outside": "clamp", "unreached": unreached}
        return sph.Grid.over_box(state.world.box, self.spacing), state.contacts.position, options


def solved_impulses(state: State, solver) -> tuple[np.ndarray, np.ndarray]:
    """(λ_n, λ_t) of the state's solution, (m,) each, N·s.

    If the state holds its solution (`State.holds_solution`), they are read from it. Otherwise the state is solved here,
    from Builtin, like the copy of the world that the thesis runs one step ahead (Algorithm 5).
    """
    contacts = state.contacts
    if state.holds_solution:
        return contacts.normal_impulse.copy(), contacts.tangent_impulse.copy()
    solution = solve(state, solver, contacts.normal_start, contacts.tangent_start)
    return solution.normal_impulses, solution.tangent_impulses
