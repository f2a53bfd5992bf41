"""`State`: bodies, contacts and world at one time of a simulation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from deep_contact.lazy import HOOKS, imported
from deep_contact.state import constants, html
from deep_contact.state.arrays import SIDES, Bodies, Contacts, no_contacts
from deep_contact.state.fields import check_bodies, check_kept_contacts, checked_indices, warn_of_jumps
from deep_contact.state.materials import largest
from deep_contact.state.scales import ContactScales, contact_scales
from deep_contact.state.validation import suggesting
from deep_contact.state.world import World

S, T = TypeVar("S", bound="State"), TypeVar("T")


@suggesting
@dataclass(frozen=True, kw_only=True, repr=False)
class State:
    """The state of a simulation at one time: the bodies before a step, and the contacts at their positions.

    A scene is a state at time 0. `contacts` is None until collision detection has run. `solver` has the solver options
    of the run (`solvers`), or is None.

    If `solved` is True, the contacts hold the impulses of the step that begins with this state, summed over its
    substeps and rebounds. If it is False, they hold the impulses of the step before, from which the start Builtin
    begins. In both cases `dc.step(state)` does the step from `normal_start` and `tangent_start`. A run that is written
    to a file and read back continues bit for bit.

    `load` is the load for which the impulses were solved (`starts.load.Load`), or None if the load is unknown, as in a
    state from a file. `preset` is the name of the preset that chose the solver (`simulate(accuracy=…)`). A run that
    continues under the same preset has the same solver.

    `push` is the external load on the circles besides gravity in the step that begins with this state: forces (n, 2),
    N, and torques (n,), N·m; or None. A run replaces it by its own push, or by None (`simulate(push=…)`).
    `solve_contacts` applies it. Files do not store it.

    States are equal if all their fields except `load`, `push` and `preset` are equal. The fields cannot be assigned. No
    function of this package writes into the arrays of a state, and no later step does.
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
    load: Any = field(default=None, compare=False)
    push: tuple[np.ndarray, np.ndarray] | None = field(default=None, compare=False)
    preset: str | None = field(default=None, compare=False)

    def __post_init__(self):
        if not isinstance(self.bodies, Bodies):
            raise ValueError(f"bodies: expected Bodies, as dc.make_bodies makes them, got {type(self.bodies).__name__}")
        if self.bodies.material is None:
            radius = self.bodies.radius
            material = np.zeros(len(radius) if np.iterable(radius) else 1, np.int64)
            object.__setattr__(self, "bodies", self.bodies._replace(material=material))

    @property
    def holds_solution(self) -> bool:
        """Whether the impulses solve a single contact problem, as after a step without substeps and restitution."""
        is_divided = self.solver is not None and self.solver.substeps * self.solver.motion_parts > 1
        return self.solved and largest(self.world.restitution) == 0.0 and not is_divided

    @property
    def scales(self) -> ContactScales:
        """Lengths, speeds and times of the contact model in the steps from this state (`scales.contact_scales`)."""
        return contact_scales(self.bodies.radius, self.world.gravity, self.dt, self.world.scales)

    def replace(self: S, **changes) -> S:
        """Return a copy with some fields changed. A change of bodies, dt or solver sets `preset` to None.

        If `load` is None, a change of the world does so, too. Otherwise the load shows how far the world has changed.

        Raises ValueError if the contacts stay, but would refer to other bodies: if the number of circles changes, or if
        the number of segments changes and a segment with contacts is no longer the same. Warns if a segment without
        velocity gets another position after step 0.
        """
        others = ("bodies", "dt", "solver", *(["world"] if self.load is None else []))
        if self.preset is not None and not changes.keys().isdisjoint(others):
            changes.setdefault("preset", None)
        changed = replace(self, **changes)
        if self.step > 0 and isinstance(changes.get("world"), World) and "bodies" not in changes:
            warn_of_jumps(self.world, changed.world)
        if self.contacts is not None and "contacts" not in changes and ("bodies" in changes or "world" in changes):
            check_kept_contacts(self, changed)
        return changed

    def with_bodies(self, *, add: Bodies | None = None, remove: Sequence | np.ndarray = ()) -> State:
        """Return the state with some circles removed and others appended, as the start of further steps.

        Contacts of the circles that stay keep their impulses. Contacts of the added circles are detected.

        add: circles from `make_bodies`. remove: indices of circles, or a flag for each circle. Raises ValueError on an
        index that no circle has.
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
        """Return HTML for notebooks: a summary in numbers, and a picture of circles and impulses."""
        return html.shown(f"State {self.name!r}", self._summary().items(), imported(HOOKS["picture"])(self))

    def _summary(self) -> dict[str, str]:
        contacts = "contacts unknown" if self.contacts is None else html.counted(self.contacts.count, "contact")
        summary = {"bodies": html.counted(self.bodies.count, "circle"), "contacts": contacts}
        summary |= {"walls": self._walls()} if self._walls() else {}
        summary |= {"time": f"t = {self.time:g} s", "step": f"step {self.step:,}"}
        return summary | ({"impulses": "solved"} if self.solved else {})

    def _walls(self) -> str:
        """Return the numbers of contacts of each wall and of all segments, as text: "floor 9, left 2, segments 4"."""
        beyond = np.zeros(0, int) if self.contacts is None else self.contacts.body_b - self.bodies.count
        touched = Counter(SIDES[wall] if wall < 4 else "segments" for wall in np.sort(beyond[beyond >= 0]))
        return ", ".join(f"{name} {count:,}" for name, count in touched.items())


if TYPE_CHECKING:

    class StateWithContacts(State):
        """A state whose `contacts` is not None. Runs return such states. The class exists for type checkers alone."""

        contacts: Contacts

else:
    StateWithContacts = State


def native(state: State) -> State:
    """Return the state with all arrays in the byte order of this machine, the only one that Numba supports."""
    for name, part in (("bodies", state.bodies), ("contacts", state.contacts)):
        if part is not None and not all([array.dtype.isnative for array in part]):
            arrays = [array.astype(array.dtype.newbyteorder("="), copy=False) for array in part]
            state = changed(state, **{name: type(part)(*arrays)})
    return state


def changed(part: T, **fields) -> T:
    """Return a copy of a `State` or `World` with other fields. It does not validate, and is faster than `replace`."""
    new = object.__new__(type(part))
    vars(new).update(vars(part), **fields)
    return new


def frozen(array: np.ndarray) -> np.ndarray:
    """Return a read-only copy of an array."""
    array = array.copy()
    array.flags.writeable = False
    return array


def read_only(state: S) -> S:
    """Return the state with read-only views of its arrays."""

    def view(array: np.ndarray) -> np.ndarray:
        array = array.view()
        array.flags.writeable = False
        return array

    return changed(state, bodies=Bodies(*map(view, state.bodies)), contacts=Contacts(*map(view, state.contacts)))


def contact_lines(state: State) -> np.ndarray:
    """Return the ends of a line for each contact, (m, 2, 2), m, for drawings.

    A line joins the centres of two circles, or the centre of a circle and its contact point on a wall or a segment.
    """
    bodies, contacts = state.bodies, state.contacts or no_contacts()
    ends, between = contacts.position.copy(), contacts.body_b < bodies.count
    ends[between] = bodies.position[contacts.body_b[between]]
    return np.stack([bodies.position[contacts.body_a], ends], axis=1)
