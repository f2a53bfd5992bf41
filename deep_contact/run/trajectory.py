"""`Trajectory`: the recorded states of a run as arrays over time, with its file and its films."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deep_contact.state import html
from deep_contact.state.equality import by_value
from deep_contact.state.state import State, read_only
from deep_contact.state.validation import expect, floats, integer, list_of, number

if TYPE_CHECKING:
    from deep_contact.io.simulation_h5 import StoredSimulation
    from deep_contact.state.state import StateWithContacts
    from deep_contact.state.world import World

MOST_SHOWN = 200_000
"""Largest number of circles, summed over all states, on the page of a run in a notebook. The notebook stores this page,
about 2 MB."""


def _array(*names: str) -> property:
    """Return a property whose value is the stored array of this name, or an array with a column for each name."""

    def get(self: Trajectory) -> np.ndarray:
        arrays = [self.stored.arrays[name] for name in names]
        return arrays[0] if len(arrays) == 1 else np.column_stack(arrays)

    return property(get)


@by_value
@dataclass(frozen=True, repr=False, eq=False)
class Trajectory:
    """T states of one run of n circles, with M contacts in all. `len`, indexing and iteration refer to the states.

    | property   | meaning                                                   | shape     | unit  |
    |------------|-----------------------------------------------------------|-----------|-------|
    | times      | times of the states                                       | (T,)      | s     |
    | positions  | centres                                                   | (T, n, 2) | m     |
    | velocities | velocities of the centres                                 | (T, n, 2) | m/s   |
    | angles     | orientations, counter-clockwise                           | (T, n)    | rad   |
    | spins      | angular velocities                                        | (T, n)    | rad/s |
    | offsets    | state i has the contacts offsets[i] to offsets[i + 1] − 1 | (T + 1,)  | –     |
    | pairs      | body_a and body_b of each contact                         | (M, 2)    | –     |
    | impulses   | λ_n and λ_t of each contact                               | (M, 2)    | N·s   |
    | energies   | kinetic and potential energy                              | (T, 2)    | J     |

    Times, positions, velocities, angles, spins and offsets are the arrays of the run, not copies. The state `run[i]`
    has read-only copies. Potential energy is 0 at the origin.
    """

    stored: StoredSimulation
    """The content of the run's file (`io.simulation_h5`)."""

    @classmethod
    def from_states(cls, states: Iterable[State], *, work=None) -> Trajectory:
        """Make a run from its states, in the order of time, with contacts.

        work: work of moving segments, fixed circles and pushes until each state, (T,), J, or None. Raises ValueError
        naming state and field, also if the number of circles changes. `dc.film` shows states with different numbers of
        circles.
        """
        from deep_contact.io.simulation_h5 import pack_simulation

        return cls(pack_simulation(states, work=work))

    def save(self, path) -> None:
        """Write the run to an HDF5 file. On an error there is no partial file.

        path: path of the file, which ends in .h5 or .hdf5. Raises ValueError for another ending, and OSError if the
        file cannot be written.
        """
        from deep_contact.io.files import check_ending, write_bytes
        from deep_contact.io.simulation_h5 import simulation_file

        check_ending(
            path, (".h5", ".hdf5"), "pandas.DataFrame(trajectory.table()) writes tables, trajectory.film films"
        )
        write_bytes(path, simulation_file(self.stored))

    def __len__(self) -> int:
        return self.stored.count

    def __getitem__(self, index: int) -> StateWithContacts:
        return read_only(self.stored.state(range(len(self))[index]))

    def __iter__(self) -> Iterator[StateWithContacts]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        t = self.times
        contacts = html.counted(len(self.pairs), "contact")
        return f"Trajectory({self.positions.shape[1]} circles, {len(self)} states, {t[0]:g} to {t[-1]:g} s, {contacts})"

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: a page that plays the run.

        States are left out so that the page has at most `MOST_SHOWN` circles, summed over its states.
        """
        from deep_contact.plot.player import page

        circles = self.positions.shape[1]
        if circles > MOST_SHOWN // 2:
            return html.shown(repr(self), [("too large to play here", "trajectory.film(….html) makes a page")])
        every = -(-len(self) * circles // MOST_SHOWN)
        return html.framed(page([self[i] for i in range(0, len(self), max(every, 1))]))

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
        """Work of moving segments, fixed circles and pushes until each state, (T,), J; 0 in a run without them."""
        return self.stored.arrays.get("work", np.zeros(len(self)))

    @property
    def dissipated(self) -> np.ndarray:
        """Energy that contacts dissipate between successive states, (T − 1,), J.

        It is the work minus the change of energy. Energy that belts and position correction add counts as negative.
        Velocities belong to a time half a substep before that of the positions, since symplectic Euler is a leapfrog.
        The energies are corrected for this difference, so that free flight dissipates nothing.
        """
        header = self.stored.header
        solver = header["solver"]
        half = 0.5 * header["dt"] / (1 if solver is None else solver.substeps)
        late = half * (self.velocities @ np.array(self.world.gravity)) @ self._free_mass
        return np.diff(self.work - self.energies.sum(axis=1) - late)

    def table(self) -> dict[str, np.ndarray]:
        """Return columns with a row for each circle at each time, (T n,) each.

        They are time, circle, and the columns of `Bodies.table`.
        """
        count, n = self.positions.shape[:2]
        stored = {"material": np.zeros(n, np.int64)} | self.stored.arrays  # materials are stored if any is not 0
        of_circles = {name: np.tile(stored[name], count) for name in ("mass", "radius", "material")}
        return {
            "time": np.repeat(self.times, n), "circle": np.tile(np.arange(n), count),
            "x": self.positions[..., 0].ravel(), "y": self.positions[..., 1].ravel(),
            "v_x": self.velocities[..., 0].ravel(), "v_y": self.velocities[..., 1].ravel(),
            "angle": self.angles.ravel(), "spin": self.spins.ravel(), **of_circles,
        }  # fmt: skip

    def film(self, path, *, fps: float | None = None, size: int | None = None, every: int = 1, colour=None) -> Path:
        """Write a page that plays the run, or a film of the run. Returns the path of the file.

        path: file with the ending .html for a page, which any browser plays without a network; with .gif for a film; or
        with .mp4 for a film, which needs ffmpeg or the package imageio-ffmpeg. every: 1 shows each state, 2 every
        second state, and so on. fps: number of states a second in a film, by default 25. size: longer side of the box
        in a film, pixels, by default 640. A page takes neither fps nor size, since it plays at the run's own speed and
        fits its window. colour: a number for each circle in each state, (T, n), by which a page colours the circles. A
        page can also colour them by speed, radius, material and index.
        Raises ValueError for another ending, for numbers that do not fit, for a run that is too large for a page, and
        if ffmpeg is missing. Raises OSError if the file cannot be written.
        """
        shown = range(0, len(self), integer("every", every, 1))
        if colour is not None:
            colour = floats("colour", colour, self.positions.shape[:2])[shown]
        return film([self[i] for i in shown], path, fps=fps, size=size, colour=colour)


def film(states: Iterable[State], path, *, fps: float | None = None, size: int | None = None, colour=None) -> Path:
    """Write a page or a film of states. Their circles and segments may differ in number and position.

    Pages and films show the box of the first state. Forces are impulses over Δt. For states of `Simulation.solved` they
    are means over a step. For other states they are those of the last substep (`dc.forces`).

    colour: numbers for the circles of each state, (n,) each.

    The other arguments, the result and the errors are those of `Trajectory.film`. Raises ValueError without states.
    """
    from deep_contact.io.files import path_of

    states = list_of("states", State, states)
    expect(states, "states: expected at least one state, got none")
    if path_of(path).suffix == ".html":
        from deep_contact.plot.player import write_page

        for name, value in (("fps", fps), ("size", size)):
            expect(value is None, f"{name}: expected none for a page, which has its own speed and size, got {value!r}")
        return write_page(path, states, colour=colour)
    from deep_contact.plot.film_file import Canvas, write_film
    from deep_contact.plot.plotting import top_speed

    expect(colour is None, "colour: expected none for a film, which shows speeds; an .html takes it")
    impulses = [0.0 if state.contacts is None else state.contacts.normal_impulse.max(initial=0.0) for state in states]
    size = integer("size", 640 if size is None else size, least=32)
    canvas = Canvas(states[0].world, size=size, fastest=top_speed(states), strongest=float(max(impulses)))
    return write_film(path, states, canvas, number("fps", 25 if fps is None else fps, 0.01))


def load_trajectory(path) -> Trajectory:
    """Return the run in a file of `Trajectory.save` or in a file of a data set.

    Raises DataFileError naming file, field and value, and OSError if the file cannot be opened.
    """
    from deep_contact.io.simulation_h5 import read_simulation

    return Trajectory(read_simulation(path))
