"""The state of a simulation: `World` (walls and constants), and the `State` that holds `Bodies` and `Contacts`.

Conventions, said once, here:

* SI units; an impulse λ is in N·s. Physics is float64.
* The n circles are bodies 0 … n-1. The box is one static body; its walls are numbered n + 0 (floor),
  n + 1 (right), n + 2 (ceiling) and n + 3 (left), so that two contacts of one circle in a corner differ. The
  segments of `World.segments` follow, from n + 4 on.
* A contact joins `body_a` < `body_b`. Its unit normal points from a to b, its tangent is (n_y, -n_x); relative
  velocity is b minus a; a negative separation is penetration. The contact point lies in the middle of the overlap.
  The impulse on b is λ_n n + λ_t t, on a the opposite.
* Contacts are sorted by (body_a, body_b), each pair at most once. The solver sweeps in that order, so the order is
  part of the result.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from deep_contact import constants
from deep_contact.state import notebook
from deep_contact.state.arrays import LIMITS as LIMITS
from deep_contact.state.arrays import SIDES, Bodies, Contacts, no_contacts
from deep_contact.state.checks import (
    beyond_limits,
    check_bodies,
    check_kept_contacts,
    checked_indices,
    checked_world,
    warn_of_jumps,
)
from deep_contact.state.scales import ContactScales, contact_scales
from deep_contact.validation import suggesting

S, T = TypeVar("S", bound="State"), TypeVar("T")


@suggesting
@dataclass(frozen=True, kw_only=True)
class World:
    """The box, segments, and the constants that hold for every contact.

    box: (x_min, y_min, x_max, y_max), m. gravity: (g_x, g_y), m/s². friction: Coulomb's μ. restitution: Newton's e,
    felt above (1 − e²) times the scales' threshold (`physics.impacts`). scales: `ContactScales` that hold whatever the
    scene. Without them, by default, scales follow the scene (`State.scales`): one circle more or less changes them as
    it changes the mean radius.

    segments: any number of ((x, y), (x, y)), m: lines beside the box, felt from both sides and at their ends,
    with the skin of the walls (edge shapes of Box2D). An end that lies on another one or on a wall, to 1e-4 of the
    circle's radius, is not felt: a circle rolls over the joint as over a chain of Box2D, and so it does over a gap of a
    fiftieth of its radius. Kept as (x_0, y_0, x_1, y_1) each, which is taken as well: np.reshape(segments, (-1, 2, 2))
    has the points again.

    surface_speeds: of the segments, m/s each, towards their second ends: a belt, or the wall of a drum that turns. The
    segment stays where it is, and friction drags what touches it. () where all surfaces rest.

    segment_velocities: of the ends of the segments, (S, 2, 2), m/s. A segment moves by them in every step, pushes and
    drags what it touches: the world of the next state has it elsewhere. Kept as the segments are; () where all rest.
    """

    box: tuple[float, float, float, float] = (0.0, 0.0, 30.0, 30.0)
    gravity: tuple[float, float] = constants.GRAVITY
    friction: float = constants.FRICTION
    restitution: float = constants.RESTITUTION
    scales: ContactScales | None = None
    segments: Sequence | np.ndarray = ()
    surface_speeds: Sequence | np.ndarray = ()
    segment_velocities: Sequence | np.ndarray = ()

    def __post_init__(self):
        vars(self).update(checked_world(self))  # past the dataclass, which is frozen

    @cached_property
    def is_within_limits(self) -> bool:
        """Whether the engine computes with all of it (`LIMITS`)."""
        return not any(beyond_limits(world=self, scales=self.scales))


@suggesting
@dataclass(frozen=True, kw_only=True, repr=False)
class State:
    """A moment of a simulation: the bodies before a step, and the contacts found where they are.

    A scene is a state at time 0. `contacts` is None until they have been looked for. `solver` is what the run uses
    (options of `physics.solvers`, or None).
    If `solved`, the contacts hold what they gave in the step from here, in all its substeps and rebounds; if not, they
    hold the impulses carried over from the step before, which Builtin starts from. Either way, `dc.step(state)` does
    the step from `normal_start` and `tangent_start`, and a run that is written out and read back goes on bit for bit.
    `load` is what the impulses were solved for (`physics.load`), or None where that is unknown, as in a file.
    `preset` is what chose the solver (`simulate(accuracy=…)`): a run that goes on under it keeps the solver.
    `push` is what acts on the circles in the step from here, beside gravity: forces (n, 2), N, and torques (n,), N·m;
    or None. A run sets it to its own push, or to None (`simulate(push=…)`), and `solve_contacts` applies it. No file
    has it.

    States are equal if all fields but `load`, `push` and `preset` are. The fields cannot be set; nothing in this
    package writes into the arrays of a state that it is given. No later step writes into the arrays of a state.
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
        """A copy with some fields changed, and no `preset` where its solver was chosen for other bodies, world or Δt.

        Raises ValueError where contacts are kept that would become those of other bodies: of another number of circles,
        or of another segment. Warns where a segment is put elsewhere in the course of a run.
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
        """The state without some circles and with others after the rest, ready to go on.

        Contacts of the circles that stay keep their impulses; those of the added are found. add: of `make_bodies`.
        remove: indices of circles, or a flag for each. Raises ValueError on circles that there are not.
        """
        from deep_contact import find_contacts  # by the front door: physics stands above states

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
        return find_contacts(self.replace(bodies=bodies, contacts=kept, solved=False, push=push))

    def __repr__(self) -> str:
        return f"State({self.name!r}, {', '.join(self._summary().values())})"

    def _repr_html_(self) -> str:
        """What a notebook shows: numbers, and a picture of circles and impulses."""
        from deep_contact import plotting  # by the front door: plotting stands above states

        picture = ""
        if self.bodies.count <= notebook.MOST_CIRCLES:
            figure, ax = plotting.subplots(size=(3.0, 3.0))
            plotting.draw_state(ax, self)
            picture = notebook.image("png", figure._repr_png_())
        return notebook.shown(f"State {self.name!r}", self._summary().items(), picture)

    def _summary(self) -> dict[str, str]:
        contacts = "contacts unknown" if self.contacts is None else notebook.counted(self.contacts.count, "contact")
        summary = {"bodies": notebook.counted(self.bodies.count, "circle"), "contacts": contacts}
        summary |= {"walls": self._walls()} if self._walls() else {}
        summary |= {"time": f"t = {self.time:g} s", "step": f"step {self.step:,}"}
        return summary | ({"impulses": "solved"} if self.solved else {})

    def _walls(self) -> str:
        """How many contacts the walls and all segments have: "floor 9, left 2, segments 4"."""
        beyond = np.zeros(0, int) if self.contacts is None else self.contacts.body_b - self.bodies.count
        touched = Counter(SIDES[wall] if wall < 4 else "segments" for wall in np.sort(beyond[beyond >= 0]))
        return ", ".join(f"{name} {count:,}" for name, count in touched.items())


if TYPE_CHECKING:

    class StateWithContacts(State):
        """What a run hands out. For type checkers alone: there, `contacts` is never None."""

        contacts: Contacts

else:
    StateWithContacts = State


def native(state: State) -> State:
    """The state with all arrays in the byte order of this machine: Numba compiles for no other."""
    for name, part in (("bodies", state.bodies), ("contacts", state.contacts)):
        if part is not None and not all(array.dtype.isnative for array in part):
            arrays = (array.astype(array.dtype.newbyteorder("="), copy=False) for array in part)
            state = changed(state, **{name: type(part)(*arrays)})
    return state


def changed(part: T, **fields) -> T:
    """A `State` or `World` with other fields, which are not checked: `replace` takes longer."""
    new = object.__new__(type(part))
    vars(new).update(vars(part), **fields)
    return new


def frozen(array: np.ndarray) -> np.ndarray:
    """A copy that cannot be written into."""
    array = array.copy()
    array.flags.writeable = False
    return array


def read_only(state: S) -> S:
    """The state with views of its arrays that cannot be written into."""

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
