"""`State`: a moment of a simulation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from deep_contact.lazy import HOOKS, imported
from deep_contact.state import constants, html
from deep_contact.state.arrays import SIDES, Bodies, Contacts, no_contacts
from deep_contact.state.fields import check_bodies, check_kept_contacts, checked_indices, warn_of_jumps
from deep_contact.state.scales import ContactScales, contact_scales
from deep_contact.state.validation import suggesting
from deep_contact.state.world import World

S, T = TypeVar("S", bound="State"), TypeVar("T")


@suggesting
@dataclass(frozen=True, kw_only=True, repr=False)
class State:
    """A moment of a simulation: the bodies before a step, and the contacts at their positions.

    A scene is a state at time 0. `contacts` is None until collision detection has run. `solver` is the solver of the
    run (options of `solvers`), or None.
    If `solved`, the contacts hold the impulses of the step that begins with this state, summed over its substeps and
    rebounds. If not, they hold the impulses carried over from the step before, from which the start Builtin begins.
    Either way, `dc.step(state)` does the step from `normal_start` and `tangent_start`, and a run that is written out
    and read back goes on bit for bit.
    `load` is a digest of what the impulses were solved for (`starts.changed_load`), or None if that is unknown, as in a
    file. `preset` is the name of the preset that chose the solver (`simulate(accuracy=…)`): a run that goes on under
    this preset keeps the solver.
    `push` is the external load on the circles in the step that begins with this state, beside gravity: forces (n, 2),
    N, and torques (n,), N·m; or None. A run replaces it by its own push, or by None (`simulate(push=…)`), and
    `solve_contacts` applies it. Files do not store it.

    States are equal if all their fields except `load`, `push` and `preset` are equal. The fields cannot be assigned.
    No function of this package writes into the arrays of a state, and no later step does.
    """

    name: str
    world: World
    bodies: Bodies
    contacts: Contacts | None = None
    time: float = 0.0
    step: int = 0
    dt: float = constants.TIME_STEP
    solver: object = None
    solved: bool = False
    load: tuple[int, int] | None = field(default=None, compare=False)
    push: tuple[np.ndarray, np.ndarray] | None = field(default=None, compare=False)
    preset: str | None = field(default=None, compare=False)

    def __post_init__(self):
        if not isinstance(self.bodies, Bodies):
            raise ValueError(f"bodies: expected Bodies, as dc.make_bodies makes them, got {type(self.bodies).__name__}")

    @property
    def holds_solution(self) -> bool:
        """Whether the contacts hold the solution of their contact problem: of a step without substeps and rebounds."""
        is_divided = self.solver is not None and self.solver.substeps * self.solver.motion_parts > 1
        return self.solved and self.world.restitution == 0.0 and not is_divided

    @property
    def scales(self) -> ContactScales:
        """Lengths, speeds and times of the contact model in the steps of this state (`scales.contact_scales`)."""
        return contact_scales(self.bodies.radius, self.world.gravity, self.dt, self.world.scales)

    def replace(self: S, **changes) -> S:
        """A copy with some fields changed. A change of bodies, world, dt or solver sets `preset` to None.

        Raises ValueError if the contacts are kept but would refer to other bodies: if the number of circles changes, or
        a segment that has contacts. Warns if a segment changes its position in the course of a run.
        """
        if self.preset is not None and not changes.keys().isdisjoint(("bodies", "world", "dt", "solver")):
            changes.setdefault("preset", None)
        changed = replace(self, **changes)
        if self.step > 0 and isinstance(changes.get("world"), World) and "bodies" not in changes:
            warn_of_jumps(self.world, changed.world)
        if self.contacts is not None and "contacts" not in changes and ("bodies" in changes or "world" in changes):
            check_kept_contacts(self, changed)
        return changed

    def with_bodies(self, *, add: Bodies | None = None, remove: Sequence | np.ndarray = ()) -> State:
        """The state with some circles removed and others appended, ready to go on.

        Contacts of the circles that stay keep their impulses; contacts of the added circles are found.

        add: circles of `make_bodies`. remove: indices of circles, or a flag for each. Raises ValueError on an index
        that no circle has.
        """
        n, removed = self.bodies.count, checked_indices("remove", remove, self.bodies.count)
        stays = np.delete(np.arange(n), removed)
        parts = [[values[stays] for values in self.bodies], *([check_bodies(add)] if add is not None else [])]
        bodies, push = Bodies(*map(np.concatenate, zip(*parts))), None
        if self.push is not None:
            new = bodies.count - len(stays)
            push = tuple(np.concatenate([p[stays], np.zeros((new, *p.shape[1:]))]) for p in self.push)
        if self.contacts is None:
            return self.replace(bodies=bodies, push=push)
        index = np.arange(n + 4 + len(self.world.segments)) + bodies.count - n
        index[removed], index[stays] = -1, np.arange(len(stays))
        a, b = (index[body] for body in self.contacts[:2])
        kept = Contacts(*(values[(a >= 0) & (b >= 0)] for values in (a, b, *self.contacts[2:])))
        return imported(HOOKS["find_contacts"])(self.replace(bodies=bodies, contacts=kept, solved=False, push=push))

    def __repr__(self) -> str:
        return f"State({self.name!r}, {', '.join(self._summary().values())})"

    def _repr_html_(self) -> str:
        """HTML for notebooks: numbers, and a picture of circles and impulses."""
        return html.shown(f"State {self.name!r}", self._summary().items(), imported(HOOKS["picture"])(self))

    def _summary(self) -> dict[str, str]:
        contacts = "contacts unknown" if self.contacts is None else html.counted(self.contacts.count, "contact")
        summary = {"bodies": html.counted(self.bodies.count, "circle"), "contacts": contacts}
        summary |= {"walls": self._walls()} if self._walls() else {}
        summary |= {"time": f"t = {self.time:g} s", "step": f"step {self.step:,}"}
        return summary | ({"impulses": "solved"} if self.solved else {})

    def _walls(self) -> str:
        """Numbers of contacts of the walls and of all segments, as text: "floor 9, left 2, segments 4"."""
        beyond = np.zeros(0, int) if self.contacts is None else self.contacts.body_b - self.bodies.count
        touched = Counter(SIDES[wall] if wall < 4 else "segments" for wall in np.sort(beyond[beyond >= 0]))
        return ", ".join(f"{name} {count:,}" for name, count in touched.items())


if TYPE_CHECKING:

    class StateWithContacts(State):
        """A state whose `contacts` is not None, as runs return it. The class exists for type checkers alone."""

        contacts: Contacts

else:
    StateWithContacts = State


def native(state: State) -> State:
    """The state with all arrays in the byte order of this machine: Numba compiles for no other."""
    for name, part in (("bodies", state.bodies), ("contacts", state.contacts)):
        if part is not None and not all([array.dtype.isnative for array in part]):
            arrays = [array.astype(array.dtype.newbyteorder("="), copy=False) for array in part]
            state = changed(state, **{name: type(part)(*arrays)})
    return state


def changed(part: T, **fields) -> T:
    """A copy of a `State` or `World` with other fields, unchecked, which takes less time than `replace`."""
    new = object.__new__(type(part))
    vars(new).update(vars(part), **fields)
    return new


def frozen(array: np.ndarray) -> np.ndarray:
    """A read-only copy of an array."""
    array = array.copy()
    array.flags.writeable = False
    return array


def read_only(state: S) -> S:
    """The state with read-only views of its arrays."""

    def view(array: np.ndarray) -> np.ndarray:
        array = array.view()
        array.flags.writeable = False
        return array

    return changed(state, bodies=Bodies(*map(view, state.bodies)), contacts=Contacts(*map(view, state.contacts)))


def contact_lines(state: State) -> np.ndarray:
    """A line for each contact, (m, 2, 2), m: from the centre of one circle to that of the other, or to the wall."""
    bodies, contacts = state.bodies, state.contacts or no_contacts()
    ends, between = contacts.position.copy(), contacts.body_b < bodies.count
    ends[between] = bodies.position[contacts.body_b[between]]
    return np.stack([bodies.position[contacts.body_a], ends], axis=1)
