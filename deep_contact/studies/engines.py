"""Our engine and others on the same piles: piles in files, engines that run steps, and the cost of a step.

With t the time of a step of k sweeps over m contacts, the model is

    t = overhead + cost k m,

whose two unknowns follow from steps of few and of many sweeps. A "sweep" differs between engines: that of Box2D v3 is a
substep, which goes over the contacts twice and integrates positions between (`peers.Box2D3`); that of pymunk corrects
positions as well. These two also have contacts of their own, so costs are per contact of each engine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from deep_contact.constants import WALL_SKIN
from deep_contact.physics.scenes import lattice_in_box
from deep_contact.physics.solvers import PGS, BatchedPGS
from deep_contact.reporting.results import replacing
from deep_contact.simulation import simulate, step
from deep_contact.state import State, World, make_bodies
from deep_contact.studies import peers, timing
from deep_contact.studies.piles import SLOWEST, rms_speed

TIME_STEP = 0.01
FEW, MANY = 10, 100
POSITION_SWEEPS = 3
BLOCKS = (FEW, MANY, MANY, FEW)
"""Velocity sweeps of the blocks of steps that are timed. In this order, a pile's change while it falls cancels out."""

WARM_UP = 10
"""Steps of each engine before timing: caches, broad phase and starting impulses settle."""

KINDS = ("settled", "falling")
MOST_STEPS = 3000
"""Steps after which a pile counts as settled."""


def solver_of(sweeps: int, method=PGS, **options):
    """Options with a fixed number of sweeps and of position sweeps."""
    return method(sweeps=sweeps, tolerance=None, position_sweeps=POSITION_SWEEPS, **options)


def stored_pile(path: Path, make: Callable[[], State]) -> Path:
    """The file of a pile's box and bodies, made if it does not exist."""
    if not path.exists():
        state = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            np.savez(temporary, box=state.world.box, **state.bodies._asdict())
    return path


def read_pile(path: Path) -> State:
    """A stored pile, without contacts."""
    with np.load(path) as stored:
        fields = {name: stored[name] for name in ("radius", "velocity", "angle", "spin", "mass")}
        bodies = make_bodies(stored["position"], **fields)
        return State(name=path.stem, world=World(box=tuple(stored["box"])), bodies=bodies, dt=TIME_STEP)


def dropped_pile(kind: str, n_bodies: int, seed: int) -> State:
    """A loose lattice that has fallen: "falling" until it has as many contacts as circles, "settled" until it rests."""
    state = lattice_in_box(n_bodies=n_bodies, seed=seed)
    for _ in range(MOST_STEPS // 10):
        state = simulate(state, steps=10, dt=TIME_STEP, solver=solver_of(FEW)).state
        if kind == "falling" and state.contacts.count >= n_bodies:
            break
        if kind == "settled" and state.contacts.count > n_bodies and rms_speed(state) < SLOWEST["resting"]:
            break
    return state


def packed_pile(n_bodies: int, *, seed: int = 0, steps: int = 200) -> State:
    """A pile that does not have to fall first: unequal circles close to a hexagonal packing settle for `steps` steps.

    Radii are uniform in 0.8 to 1 m, so that no crystal forms and there are about as many contacts as in a pile
    that was dropped.
    """
    rng = np.random.default_rng(seed)
    columns = math.ceil(math.sqrt(n_bodies))
    pitch, jitter = 1.85, 0.02
    row, column = np.divmod(np.arange(n_bodies), columns)
    centres = np.column_stack([(column + 0.5 * (row % 2)) * pitch, row * pitch * math.sqrt(0.75)])
    centres += 1.0 + WALL_SKIN + jitter * rng.uniform(-0.5, 0.5, centres.shape)
    size = centres.max(axis=0) + np.array([1.0 + WALL_SKIN, 20.0])
    bodies = make_bodies(centres, radius=rng.uniform(0.8, 1.0, n_bodies))
    scene = State(name=f"packed_{n_bodies}", world=World(box=(0, 0, *size)), bodies=bodies)
    return simulate(scene, steps=steps, solver=solver_of(FEW, BatchedPGS)).state


class Ours:
    """Our engine as users run it, one `simulate` for a block of steps. options: of `solver_of`."""

    def __init__(self, state: State, **options):
        self.state, self.options = state, options

    def run(self, steps: int, sweeps: int, *, count: bool = False) -> int:
        """Do so many steps. Returns the sum of their contacts."""
        done = simulate(self.state, steps=steps, dt=TIME_STEP, solver=solver_of(sweeps, **self.options))
        self.state = done.state
        return int(done.contacts.sum())


class OursByStep(Ours):
    """Our engine by `step`, which validates the state every time."""

    def run(self, steps: int, sweeps: int, *, count: bool = False) -> int:
        """As `Ours.run`; 0 unless the contacts are to be counted."""
        if count:
            return super().run(steps, sweeps)
        for _ in range(steps):
            self.state = step(self.state, solver=solver_of(sweeps))
        return 0


class Peer:
    """An adapter of `peers`, with the method of `Ours`."""

    def __init__(self, state: State, *, adapter):
        self.world = adapter(state)

    def run(self, steps: int, sweeps: int, *, count: bool = False) -> int:
        """As `Ours.run`; 0 unless the contacts are to be counted."""
        world, contacts = self.world, 0
        for _ in range(steps):
            if count and world.counts_next_step:
                contacts += world.contact_count()
            world.step(TIME_STEP, sweeps, POSITION_SWEEPS)
            if count and not world.counts_next_step:
                contacts += world.contact_count()
        return contacts


PEERS = {name: partial(Peer, adapter=adapter) for name, adapter in peers.ENGINES.items()} | {
    f"{name}, two threads": partial(Peer, adapter=partial(adapter, threads=2))
    for name, adapter in peers.ENGINES.items()
    if adapter.takes_threads
}
ENGINES = {
    "ours": Ours,
    "in colours": partial(Ours, method=BatchedPGS, threads=1),
    "two threads": partial(Ours, method=BatchedPGS, threads=2),
    "dc.step": OursByStep,
} | PEERS
"""Name -> callable that takes a state and returns an engine that can `run`. Colours change the order of the contacts,
as Box2D v3 does, and presets take them for large piles."""


def measure(state: State, engines: Mapping[str, Callable], *, steps: int, repeats: int) -> dict[str, dict]:
    """Name of the engine -> its `costs` on a pile, in blocks of so many steps.

    Engines are interleaved, and every repeat starts from the same pile. Contacts are counted in a run that is not
    timed: an engine does the same work every time.
    """
    worlds, contacts, runs, setup = {}, {}, {}, {}
    for name, engine in engines.items():

        def restart(name=name, engine=engine):
            worlds[name] = engine(state)
            worlds[name].run(WARM_UP, FEW)

        restart()
        contacts[name] = np.array([worlds[name].run(steps, sweeps, count=True) for sweeps in BLOCKS])
        setup[name, 0] = restart
        for block, sweeps in enumerate(BLOCKS):
            runs[name, block] = lambda name=name, sweeps=sweeps: worlds[name].run(steps, sweeps)
    least = timing.interleaved(runs, repeats=repeats, setup=setup)
    seconds = {name: np.array([least[name, block] for block in range(len(BLOCKS))]) for name in engines}
    return {name: costs(seconds[name], contacts[name], steps) for name in engines}


def costs(seconds: np.ndarray, contacts: np.ndarray, steps: int) -> dict[str, float]:
    """The two unknowns of the model, from seconds and contacts of the blocks, both (4,), and the mean step of `FEW`."""
    few = np.array(BLOCKS) == FEW
    slope, overhead = timing.slope_and_overhead(
        (FEW * contacts[few].sum(), seconds[few].sum()), (MANY * contacts[~few].sum(), seconds[~few].sum())
    )
    steps_few = steps * few.sum()
    return {
        "contacts": float(contacts.sum() / (steps * len(BLOCKS))),
        "sweep_ns": float(1e9 * slope),
        "overhead_us": float(1e6 * overhead / steps_few),
        "step_us": float(1e6 * seconds[few].sum() / steps_few),
    }


def ratios(measured: dict[str, dict]) -> dict[str, dict]:
    """Other engine -> its costs as multiples of ours."""
    names = ("sweep_ns", "overhead_us", "step_us")
    return {peer: {name: measured[peer][name] / measured["ours"][name] for name in names} for peer in PEERS}
