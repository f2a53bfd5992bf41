"""Starts of the solver. Every start has one signature: `start(state, solver) -> (normal, tangent)`.

state: a `State` with contacts. solver: options of the solve. A start returns the impulses to start from, (m,) each,
N·s. The engine takes a start by its name, or any such callable. It raises an error if the impulses do not fit the
contacts; it never falls back to zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Union, get_args

import numpy as np

from deep_contact import sph
from deep_contact.physics.contact_solver import NORMAL, TANGENT, best_share
from deep_contact.physics.engine import StepProblem, solve, step_problem
from deep_contact.physics.support import supported
from deep_contact.state import State, StateWithContacts
from deep_contact.state.arrays import LARGEST_START
from deep_contact.state.scales import ContactScales
from deep_contact.validation import brief, expect, one_of, real_numbers

if TYPE_CHECKING:
    from deep_contact.cnn.inference import LearnedModel

WarmStart = Callable[[Any, Any], tuple[np.ndarray, np.ndarray]]
Classical = Literal["none", "builtin", "scaled", "support", "copy"]
Name = Literal[Classical, "sph", "sph spline", "sph consistent", "cnn", "far field", "far field, no past"]
Start = Union[Name, WarmStart, "LearnedModel", Path, None]
"""Values of `warm_start=`: a name, a callable, a `LearnedModel` or the path of its file; None is "none"."""


@dataclass(frozen=True)
class NoStart:
    """Impulses of 0 (the thesis's Non-Model)."""

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(state.contacts.count), np.zeros(state.contacts.count)


@dataclass(frozen=True)
class Builtin:
    """The solved impulses of each pair of bodies in the step before, 0 for a new pair (the thesis's Builtin-Model).

    The engine carries these impulses along, so they are the start that the state holds.
    """

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        return state.contacts.normal_start.copy(), state.contacts.tangent_start.copy()


class FromProblem:
    """A start made from the rows of a step, which then uses the same rows: `from_problem(state, solver, problem)`."""

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        return self.from_problem(state, solver, step_problem(state))


@dataclass(frozen=True)
class Scaled(FromProblem):
    """Builtin's impulses times one number α between 0 and 1: the exact line search along them (`best_share`).

    In an impact the carried impulses are too large or wrong, and α is small; at rest α is 1. It costs one pass over the
    contacts. From states of well solved runs it saves sweeps in impacts. Weakness: there is one α for all contacts.
    Builtin adds up half-solved impulses over the steps of a run, and α shrinks these, so that piles sink.
    """

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        share = best_share(problem.rows, problem.solver_bodies)
        return share * problem.rows.impulse[:, NORMAL], share * problem.rows.impulse[:, TANGENT]


@dataclass(frozen=True)
class Support(FromProblem):
    """Impulses that carry each circle's load down, from positions alone (`physics.support`): for piles without a past.

    If contacts carry impulses of a step before, Builtin is better.
    """

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        return supported(state, problem)


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


@dataclass(frozen=True)
class Cnn(FromProblem):
    """Impulses that a network predicts (the thesis's CNN-Model, Algorithm 7), projected on λ_n ≥ 0 and |λ_t| ≤ μ λ_n.

    model: a `LearnedModel`, or the path or name of a model file, which is read again only if it changes. None is the
    thesis's network, rebuilt (the start "cnn"), for its box of 30 m × 30 m. "far field" is our network, which corrects
    Builtin's impulses in any box.
    """

    model: LearnedModel | str | Path | None = None

    def __post_init__(self):
        from deep_contact.cnn.inference import model_of

        object.__setattr__(self, "model", model_of(self.model))

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        return self.model.predict(state, problem=problem)


@dataclass(frozen=True)
class FarFieldNoPast(Cnn):
    """`Support`, corrected by a far-field network that was trained on such starts, for piles without a past.

    model: as of `Cnn`. If contacts carry impulses of a step before, Builtin is better.
    """

    model: LearnedModel | str | Path | None = "far field, no past"

    def __post_init__(self):
        from deep_contact.cnn.inference import FarFieldModel, ModelFileError

        super().__post_init__()
        if not isinstance(self.model, FarFieldModel):
            raise ModelFileError(f"model: expected a far-field network, got one for {self.model.spec.targets}")

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        impulses = np.column_stack(supported(state, problem))
        if not impulses.any():
            return tuple(impulses.T.copy())
        return super().from_problem(state, solver, problem._replace(rows=problem.rows._replace(impulse=impulses)))


STARTS: dict[Name, Callable[[], WarmStart]] = {
    "none": NoStart,
    "builtin": Builtin,
    "scaled": Scaled,
    "support": Support,
    "copy": Copy,
    "sph": Sph,
    "sph spline": partial(Sph, transfer="spline"),
    "sph consistent": partial(Sph, transfer="consistent"),
    "cnn": Cnn,
    "far field": partial(Cnn, "far field"),
    "far field, no past": FarFieldNoPast,
}
"""Name -> class or function that makes the start with its default options."""

RENAMED = {"learned support": "far field, no past"}
"""Former name of a start -> its present name."""


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


def is_network(start) -> bool:
    """Whether a start is a `LearnedModel` or the path of one, "….h5"."""
    return hasattr(start, "predict") or isinstance(start, Path) or (isinstance(start, str) and start.endswith(".h5"))


def warm_start_of(start: Start) -> WarmStart:
    """The start that None, a name, a network or its path stands for; a callable is returned as it is.

    Raises ValueError on any other value.
    """
    if isinstance(start, type):
        raise ValueError(f"warm_start: expected an instance, such as {start.__name__}(), got the class")
    if any(kind.__module__.partition(".")[0] == "keras" for kind in type(start).__mro__):
        hint = "LearnedModel(source=…, spec=ImageSpec()) of deep_contact.cnn makes it a start"
        raise ValueError(f"warm_start: expected a start, got a {type(start).__name__} of Keras; {hint}")
    if callable(start):
        return start
    if is_network(start):
        return Cnn(start)
    if start is None or isinstance(start, str):
        start = "none" if start is None else start
        expect(start not in RENAMED, f"warm_start: {start!r} is called {RENAMED.get(start)!r} now")
        if start not in STARTS:
            from deep_contact.cnn.registry import registered

            hint = f"got {start!r}: a network is passed as dc.load_model({start!r})"
            expect(start not in registered(), f"warm_start: expected one of {', '.join(STARTS)}, {hint}")
        return STARTS[one_of("warm_start", start, STARTS)]()
    raise ValueError(f"warm_start: expected None, a name, a network, its path or a callable, got {brief(start)}")


def starting_impulses(
    start, state: State, solver, scales: ContactScales | None = None
) -> tuple[np.ndarray, np.ndarray, StepProblem | None]:
    """(λ_n, λ_t, problem) of a start, or of two arrays in its place. The impulses are validated copies, (m,) each, N·s.

    problem is the state's contact problem if a start with a method `from_problem(state, solver, problem)` needed it, so
    that the step can use it; otherwise None. scales: those of the state, if at hand.
    Raises ValueError on impulses that do not fit the contacts or are beyond `state.arrays.LARGEST_START`.
    """
    problem = None
    if start is None or isinstance(start, str) or callable(start) or is_network(start):
        start = warm_start_of(start)
        if isinstance(start, Builtin):
            return *start(state, solver), None  # the state's own, which have been checked
        if hasattr(start, "from_problem"):
            problem = step_problem(state, scales)
            start = start.from_problem(state, solver, problem)
        else:
            start = start(state, solver)
    try:
        normal, tangent = map(real_numbers, start)
    except (TypeError, ValueError):
        normal = tangent = None
    if normal is None or tangent is None:
        raise ValueError(f"start: expected two arrays of impulses (normal, tangent), got {brief(start)}")
    m = state.contacts.count
    for name, values in (("normal", normal), ("tangent", tangent)):
        expected = f"start: expected {name} impulses of"
        expect(values.shape == (m,), f"{expected} shape ({m},), one a contact, got {values.shape}")
        for bad in np.flatnonzero(~(np.abs(values) <= LARGEST_START))[:1]:
            raise ValueError(f"{expected} at most {LARGEST_START:g} N·s, got {values[bad]} at contact {bad}")
    return normal, tangent, problem
