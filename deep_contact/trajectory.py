"""A recorded run: its states as arrays over time, its file (`deep_contact.io.simulation_h5`), and how it is shown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from deep_contact.state import State, notebook, read_only
from deep_contact.state.equality import by_value
from deep_contact.validation import expect, integer, list_of, number

if TYPE_CHECKING:
    from deep_contact.io.simulation_h5 import StoredSimulation
    from deep_contact.state import StateWithContacts, World

MOST_FRAMES = 40
"""Of the film in a notebook, which keeps it."""


def _array(*names: str) -> property:
    """A property: the run's array of this name, or its arrays as columns of one."""

    def get(self: Trajectory) -> np.ndarray:
        arrays = [self.stored.arrays[name] for name in names]
        return arrays[0] if len(arrays) == 1 else np.column_stack(arrays)

    return property(get)


@by_value
@dataclass(frozen=True, repr=False, eq=False)
class Trajectory:
    """T states of one run of n circles, with M contacts in all. `len`, indexing and iteration give its states.

    | property   | meaning                                              | shape     | unit   |
    |------------|------------------------------------------------------|-----------|--------|
    | times      |                                                      | (T,)      | s      |
    | positions  | of the centres                                       | (T, n, 2) | m      |
    | velocities | of the centres                                       | (T, n, 2) | m/s    |
    | angles     | orientations, counter-clockwise                      | (T, n)    | rad    |
    | spins      | angular velocities                                   | (T, n)    | rad/s  |
    | offsets    | the contacts of state i: offsets[i] … offsets[i + 1] | (T + 1,)  | –      |
    | pairs      | body_a and body_b of each contact                    | (M, 2)    | –      |
    | impulses   | λ_n and λ_t of each contact                          | (M, 2)    | N·s    |
    | energies   | kinetic and potential                                | (T, 2)    | J      |

    Arrays are those of the run, not copies; `run[i]` has copies, which cannot be written into. Potential energy is zero
    at the origin.
    """

    stored: StoredSimulation
    """All that its file holds."""

    @classmethod
    def from_states(cls, states: Iterable[State], *, work=None) -> Trajectory:
        """A run from its states, in the order of time, with contacts.

        work: what moving segments, fixed circles and pushes did until each, (T,), J, or None. Raises ValueError naming
        state and field, also where the number of circles changes: `dc.film` shows such states.
        """
        from deep_contact.io.simulation_h5 import pack_simulation

        return cls(pack_simulation(states, work=work))

    def save(self, path) -> None:
        """Write the run to an HDF5 file, whole or not at all. Raises OSError where that cannot be written."""
        from deep_contact.io.files import write_bytes
        from deep_contact.io.simulation_h5 import simulation_file

        write_bytes(path, simulation_file(self.stored))

    def __len__(self) -> int:
        return self.stored.count

    def __getitem__(self, index: int) -> StateWithContacts:
        return read_only(self.stored.state(range(len(self))[index]))

    def __iter__(self) -> Iterator[StateWithContacts]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        t = self.times
        contacts = notebook.counted(len(self.pairs), "contact")
        return f"Trajectory({self.positions.shape[1]} circles, {len(self)} states, {t[0]:g} to {t[-1]:g} s, {contacts})"

    def _repr_html_(self) -> str:
        """What a notebook shows: a film of at most `MOST_FRAMES` states, at the run's own speed."""
        seconds, every = max(float(self.times[-1] - self.times[0]), 1e-3), -(-len(self) // MOST_FRAMES)
        with TemporaryDirectory() as folder:
            film = self.film(Path(folder, "run.gif"), fps=max(len(self) / every / seconds, 1.0), size=400, every=every)
            return notebook.image("gif", film.read_bytes())

    times, positions, velocities = _array("time"), _array("position"), _array("velocity")
    angles, spins, offsets = _array("angle"), _array("spin"), _array("contact_offset")
    pairs, impulses = _array("body_a", "body_b"), _array("normal_impulse", "tangent_impulse")

    @property
    def world(self) -> World:
        return self.stored.header["world"]

    @property
    def energies(self) -> np.ndarray:
        mass, radius = self._free_mass, self.stored.arrays["radius"]
        linear, turning = (self.velocities**2).sum(axis=2) @ mass, self.spins**2 @ (0.5 * mass * radius**2)
        potential = -(self.positions @ np.array(self.world.gravity)) @ mass
        return np.column_stack([0.5 * (linear + turning), potential])

    @property
    def _free_mass(self) -> np.ndarray:
        mass = self.stored.arrays["mass"]
        return np.where(np.isinf(mass), 0.0, mass)

    @property
    def work(self) -> np.ndarray:
        """What moving segments, fixed circles and pushes did until each state, (T,), J; 0 in a run without such."""
        return self.stored.arrays.get("work", np.zeros(len(self)))

    @property
    def dissipated(self) -> np.ndarray:
        """The energy that contacts took from the circles between each state and the next, (T − 1,), J.

        It is work less the change of energy. What belts and position correction gave is negative. Velocities are those
        half a substep before the positions (symplectic Euler is a leapfrog), so that free flight dissipates nothing.
        """
        header = self.stored.header
        half = 0.5 * header["dt"] / getattr(header["solver"], "substeps", 1)
        late = half * (self.velocities @ np.array(self.world.gravity)) @ self._free_mass
        return np.diff(self.work - self.energies.sum(axis=1) - late)

    def table(self) -> dict[str, np.ndarray]:
        """A row for each circle at each time, (T n,) a column: time, circle, and the columns of `Bodies.table`."""
        count, n = self.positions.shape[:2]
        of_circles = {name: np.tile(self.stored.arrays[name], count) for name in ("mass", "radius")}
        return {
            "time": np.repeat(self.times, n), "circle": np.tile(np.arange(n), count),
            "x": self.positions[..., 0].ravel(), "y": self.positions[..., 1].ravel(),
            "v_x": self.velocities[..., 0].ravel(), "v_y": self.velocities[..., 1].ravel(),
            "angle": self.angles.ravel(), "spin": self.spins.ravel(), **of_circles,
        }  # fmt: skip

    def film(self, path, *, fps: float = 25, size: int = 640, every: int = 1) -> Path:
        """Write a film of the circles, coloured by speed, and of their impulses. Returns its path.

        path: of a .gif, or of an .mp4, for which ffmpeg is needed. size: of the longer side, pixels. every: one in so
        many states is shown. Raises ValueError for another ending and where ffmpeg is missing, OSError where the file
        cannot be written.
        """
        from deep_contact.reporting.film import Canvas, write_film

        fastest = float(np.hypot(*self.velocities.reshape(-1, 2).T).max(initial=0.0))
        strongest = float(self.impulses[:, 0].max(initial=0.0))
        canvas = Canvas(self.world, size=integer("size", size, least=32), fastest=fastest, strongest=strongest)
        shown = range(0, len(self), integer("every", every, 1))
        return write_film(path, (canvas(self[i]) for i in shown), number("fps", fps, above=0))


def film(states: Iterable[State], path, *, fps: float = 25, size: int = 640) -> Path:
    """Write a film of states, which may have any number of circles and segments anywhere, in the box of the first.

    Arguments, result and errors as of `Trajectory.film`. Raises ValueError without states.
    """
    from deep_contact.reporting.film import Canvas, write_film

    states = list_of("states", State, states)
    expect(states, "states: expected at least one state, got none")
    fastest = max(float(np.hypot(*state.bodies.velocity.T).max(initial=0.0)) for state in states)
    impulses = [0.0 if state.contacts is None else state.contacts.normal_impulse.max(initial=0.0) for state in states]
    size = integer("size", size, least=32)
    canvas = Canvas(states[0].world, size=size, fastest=fastest, strongest=float(max(impulses)))
    return write_film(path, map(canvas, states), number("fps", fps, above=0))


def load_trajectory(path) -> Trajectory:
    """The run in a file of `Trajectory.save`, or of a data set.

    Raises DataFileError naming file, field and value, and OSError where the file cannot be opened.
    """
    from deep_contact.io.simulation_h5 import read_simulation

    return Trajectory(read_simulation(path))
