"""Piles with which studies start: falling, settling or resting.

Tests: tests/studies/test_no_past.py, tests/starts/test_impulses_at_rest.py, tests/analysis/test_bounds.py
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.run.one_scene import simulate
from deep_contact.scenes import circles_in_box, lattice_in_box
from deep_contact.solvers import NNCG, BatchedPGS
from deep_contact.state.constants import WALL_SKIN
from deep_contact.state.fields import make_bodies
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.validation import one_of
from deep_contact.state.world import World
from deep_contact.studies.starts import solved_states

KINDS = {
    "falling": (1.0, np.inf),
    "settling": (1.0, 0.5),
    "resting": (1.0, 0.05),
}
"""Kind of pile -> (smallest number of contacts per circle, upper limit of the root mean square speed, m/s)."""

THOROUGH = NNCG(sweeps=300)
"""Solver with which `pile` simulates."""

SETTLE = BatchedPGS(sweeps=10, tolerance=None, position_sweeps=3)
"""Solver with which `packed_pile` simulates the settling of a packing."""


def pile_scene(n_bodies: int, seed: int, **options) -> State:
    """Return the thesis's scene if there are at most 100 circles, otherwise a loose lattice of circles that falls.

    options: arguments of `circles_in_box` or `lattice_in_box`, which make these scenes.
    """
    return (circles_in_box if n_bodies <= 100 else lattice_in_box)(n_bodies, seed=seed, **options)


def pile(kind: str, n_bodies: int, seed: int, *, solver=THOROUGH, most: int = 2000, make=pile_scene) -> State:
    """Make a scene, simulate it until it is a pile of some kind, and return its state.

    kind: one of `KINDS`. solver: solver of the simulation. most: largest number of time steps; after these the state is
    returned as it is. make: function (n_bodies, seed=seed) -> scene.
    """
    contacts, slowest = KINDS[one_of("kind", kind, KINDS)]
    state = make(n_bodies, seed=seed)
    for _ in range(most // 10):
        state = simulate(state, steps=10, solver=solver).state
        if state.contacts.count >= contacts * n_bodies and rms_speed_of_state(state) < slowest:
            break
    return state


def packing(n_bodies: int, rng, *, smallest: float = 0.8, width: float = 1.0, friction: float = 0.5) -> State:
    """Return a scene of unequal circles close to a hexagonal packing, which need not fall before they form a pile.

    rng: numpy Generator. smallest: smallest radius, m; the radii are drawn uniformly between it and 1 m. With 0.8 m no
    crystal forms, and there are about as many contacts as in a pile that was dropped. width: width of the packing over
    the width that it has as a square. friction: Coulomb's μ.
    """
    columns, pitch, jitter = math.ceil(math.sqrt(n_bodies) * width), 1.85, 0.02
    row, column = np.divmod(np.arange(n_bodies), columns)
    centres = np.column_stack([(column + 0.5 * (row % 2)) * pitch, row * pitch * math.sqrt(0.75)])
    centres = centres + 1.0 + WALL_SKIN + jitter * rng.uniform(-0.5, 0.5, centres.shape)
    size = centres.max(axis=0) + np.array([1.0 + WALL_SKIN, 20.0])
    bodies = make_bodies(centres, radius=rng.uniform(smallest, 1.0, n_bodies))
    return State(name=f"packed_{n_bodies}", world=World(box=(0, 0, *size), friction=friction), bodies=bodies)


def packed_pile(n_bodies: int, seed: int = 0, *, steps: int) -> State:
    """Return the state of a `packing` that has settled for `steps` time steps."""
    scene = packing(n_bodies, np.random.default_rng(seed))
    return simulate(scene, steps=steps, solver=SETTLE).state


def rms_speed_of_state(state: State) -> float:
    """Return the root mean square speed of the circles, m/s."""
    return float(np.sqrt(np.mean((state.bodies.velocity**2).sum(axis=1))))


def pile_states(start: State, *, count: int, every: int = 4) -> list[State]:
    """Continue the simulation of a pile, and return `count` solved states, one every `every` steps."""
    return solved_states(start, steps=count * every, solver=NNCG(sweeps=2000))[every - 1 :: every]


def without_past(state: StateWithContacts) -> StateWithContacts:
    """Return the state with all impulses of its contacts set to 0, so that they carry none from a step before."""
    nothing = np.zeros(state.contacts.count)
    contacts = state.contacts._replace(
        normal_impulse=nothing, tangent_impulse=nothing, normal_start=nothing, tangent_start=nothing
    )
    return state.replace(contacts=contacts, solved=False)
