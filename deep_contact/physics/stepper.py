"""One step at a time, called from Python: what does not change from step to step is resolved once.

A step of 100 circles takes 20 µs. Every array that crosses the border between Python and compiled code costs a tenth of
a microsecond there and a third back, a named tuple several; looking at a state, its scales and its options some more;
and without the pairs that were near in the step before, contacts are searched anew: 85 µs in all. So a state that a
`Stepper` has made keeps its numbers in two arrays, of which those of its bodies and contacts are views that are made
when somebody looks at them, and remembers its stepper, whose buffers compiled code knows by one reference.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import config, njit, types
from numba.experimental import structref

from deep_contact.physics.engine import advance_with, is_valid, make_memory, step_input
from deep_contact.physics.solvers.registry import entry_of, settings_of
from deep_contact.physics.step import StepInput, StepLog, StepOptions, StepWorkspace
from deep_contact.scales import ContactScales
from deep_contact.state import Bodies, Contacts, State


@njit(cache=True)
def bodies_in(numbers, n):
    """The `Bodies` of n circles as views of the first 8n numbers of a packed state."""
    return Bodies(
        numbers[: 2 * n].reshape(n, 2), numbers[2 * n : 4 * n].reshape(n, 2),
        numbers[4 * n : 5 * n], numbers[5 * n : 6 * n], numbers[6 * n : 7 * n], numbers[7 * n : 8 * n],
    )  # fmt: skip


@njit(cache=True)
def contacts_in(numbers, pairs, n):
    """The `Contacts` as views: of the 9m numbers after the bodies', and of the pairs, body_a before body_b, (2m,)."""
    m, c = pairs.shape[0] // 2, 8 * n
    return Contacts(
        pairs[:m], pairs[m:], numbers[c : c + 2 * m].reshape(m, 2), numbers[c + 2 * m : c + 4 * m].reshape(m, 2),
        numbers[c + 4 * m : c + 5 * m], numbers[c + 5 * m : c + 6 * m], numbers[c + 6 * m : c + 7 * m],
        numbers[c + 7 * m : c + 8 * m], numbers[c + 8 * m :],
    )  # fmt: skip


class _Room(NamedTuple):
    """What a step needs beside the state.

    sizes: masses and radii that the settings were made for, (2n,). constants: (16,), box, gravity, restitution, Δt and
    `ContactScales`. segments: (S, 5), m and m/s. friction: None for rows without tangents. settings: of the solver.
    memory: `engine.StepMemory`.
    """

    sizes: np.ndarray
    constants: np.ndarray
    segments: np.ndarray
    friction: float | None
    settings: NamedTuple
    position_sweeps: int
    memory: NamedTuple
    workspace: StepWorkspace
    log: StepLog


if config.DISABLE_JIT:
    Room = _Room
else:

    @structref.register
    class _RoomType(types.StructRef):
        """Numba's type of a `Room`."""

        def preprocess_fields(self, fields):
            return tuple((name, types.unliteral(kind)) for name, kind in fields)

    class Room(structref.StructRefProxy):
        """`_Room` as one reference, which is all that crosses the border."""

    structref.define_proxy(Room, _RoomType, _Room._fields)


@njit(cache=True)
def make_room(sizes, constants, segments, friction, settings, sweeps, position_sweeps):
    """A `Room` for steps of so many sweeps."""
    n = sizes.shape[0] // 2
    workspace = StepWorkspace(np.empty((n + 4, 4)), np.empty(sweeps), np.empty(0))
    whole = np.empty(1, np.int64)
    log = StepLog(whole, np.empty(1, np.int64), np.empty(1), np.empty(1, np.int64), np.zeros(2, np.int64))
    memory = make_memory(n, workspace.solver_bodies.dtype, friction)
    return Room(sizes, constants, segments, friction, settings, position_sweeps, memory, workspace, log)


@njit(cache=True)
def differ(values, others):
    """Whether some numbers are not those of another array of that length."""
    found = False
    for i in range(values.shape[0]):
        found |= values[i] != others[i]
    return found


@njit(cache=True)
def copy_into(array, values):
    """Write values into an array, (k,) each. A loop costs a tenth of what Numba's `array[:] = values` does."""
    for i in range(values.shape[0]):
        array[i] = values[i]


@njit(cache=True, error_model="numpy", nogil=True)
def take_step(numbers, pairs, room):
    """One step, as `engine.advance` does it, of a packed state, which stays as it is. Returns the next one.

    What is returned is empty where the state is not valid, has other masses or radii than the room or tangents where
    none are swept, or where the step diverged: `simulation.simulate` tells.
    """
    c, friction, sizes = room.constants, room.friction, room.sizes
    n, m = sizes.shape[0] // 2, pairs.shape[0] // 2
    contacts = contacts_in(numbers, pairs, n)
    if differ(numbers[6 * n : 8 * n], sizes) or not is_valid(bodies_in(numbers, n), contacts, room.segments.shape[0]):
        return numbers[:0], pairs[:0]
    if friction is None and contacts.tangent_start.any():
        return numbers[:0], pairs[:0]
    moved = numbers[: 8 * n].copy()
    given = StepInput(
        bodies_in(moved, n),
        Contacts(
            contacts.body_a, contacts.body_b, contacts.position, contacts.normal, contacts.separation,
            np.empty(m), np.empty(m), contacts.normal_start, contacts.tangent_start,
        ),
        (c[0], c[1], c[2], c[3]), room.segments, (c[4], c[5]), friction, c[6], c[7],
        ContactScales(c[8], c[9], c[10], c[11], c[12], c[13], c[14], c[15]),
    )  # fmt: skip
    options = StepOptions(room.settings, room.position_sweeps, True)
    # One step needs no second buffer of contacts.
    _, found = advance_with(room.memory, room.memory.contacts, given, options, room.workspace, room.log)
    if not math.isfinite(given.bodies.position.sum()):
        return numbers[:0], pairs[:0]
    m = found.body_a.shape[0]
    next_numbers, next_pairs = np.empty(8 * n + 9 * m), np.empty(2 * m, np.int64)
    next_numbers[: 8 * n] = moved
    packed = contacts_in(next_numbers, next_pairs, n)
    for array, values in ((packed.body_a, found.body_a), (packed.body_b, found.body_b)):
        copy_into(array, values)
    for array, values in (
        (packed.position.reshape(-1), found.position.reshape(-1)),
        (packed.normal.reshape(-1), found.normal.reshape(-1)),
        (packed.separation, found.separation),
        (packed.normal_impulse, found.normal_impulse),
        (packed.tangent_impulse, found.tangent_impulse),
        (packed.normal_start, found.normal_start),
        (packed.tangent_start, found.tangent_start),
    ):
        copy_into(array, values)
    return next_numbers, next_pairs


_bodies_in = getattr(bodies_in, "py_func", bodies_in)
_contacts_in = getattr(contacts_in, "py_func", contacts_in)


def can_step(solver) -> bool:
    """Whether a `Stepper` does the steps of this solver."""
    return entry_of(solver).advance is None and solver.precision == "double" and getattr(solver, "substeps", 1) == 1


class Stepper:
    """What steps of a state and of those after it need from one to the next. They start from what the states carry.

    state: valid, with contacts. asked: the solver that was asked for. solver: the same for this state (`for_state`).
    """

    __slots__ = ("asked", "given", "n_bodies", "rooms", "solver")

    def __init__(self, state: State, asked, solver):
        self.asked, self.solver, self.n_bodies = asked, solver, state.bodies.count
        given, settings = step_input(state, settings_of(solver)), settings_of(solver)
        sizes = np.concatenate([state.bodies.mass, state.bodies.radius])
        constants = np.array([*given.box, *given.gravity, given.restitution, given.dt, *given.scales])
        self.given = (sizes, constants, given.segments, given.friction, settings, solver.sweeps, solver.position_sweeps)
        # Rooms in which nothing is being done: several threads may do steps at a time.
        self.rooms: list[Room] = []

    def solves_with(self, solver) -> bool:
        """Whether a step of a state that this one has made is the same with this solver, or with the state's own."""
        if solver is None or solver is self.asked or solver is self.solver:
            return True
        return type(solver) is type(self.asked) and solver == self.asked

    def step(self, state: State) -> State | None:
        """The state after one step; None where only `simulate` can tell what it comes to."""
        own = state.__dict__
        numbers, pairs = own["_packed"] if "_packed" in own else packed(state)
        try:
            room = self.rooms.pop()
        except IndexError:
            room = make_room(*self.given)
        numbers, pairs = take_step(numbers, pairs, room)
        self.rooms.append(room)
        if not numbers.size:
            return None
        step, dt = state.step + 1, state.dt
        found = object.__new__(State)
        # From the number of steps, not by adding up, so that time does not depend on how a run was divided.
        time = step * dt if state.time == state.step * dt else state.time + dt
        found.__dict__.update(
            name=state.name, world=state.world, time=time, step=step, dt=dt, solver=self.solver, solved=False,
            _packed=(numbers, pairs), _stepper=self,
        )  # fmt: skip
        return found

    def part(self, name: str, numbers: np.ndarray, pairs: np.ndarray) -> Bodies | Contacts:
        """The bodies or the contacts of a packed state, which asks for them when it is asked (`State.__getattr__`)."""
        return _bodies_in(numbers, self.n_bodies) if name == "bodies" else _contacts_in(numbers, pairs, self.n_bodies)


def packed(state: State) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of bodies and contacts, (8n + 9m,), and the pairs, (2m,), in arrays of their own."""
    pairs, numbers = state.contacts[:2], (*state.bodies, *state.contacts[2:])
    return np.concatenate([array.ravel() for array in numbers]), np.concatenate(pairs)
