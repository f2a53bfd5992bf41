"""Our engine against Box2D 2.3, pymunk and Box2D v3 on the same piles, in one run.

    python scripts/benchmark_engine.py [--quick] [--sizes 100,1000,10000] [--repeats 5] [--json FILE]

A pile is made by our engine and handed, circle by circle, to every engine. "falling" is the moment when
there are as many contacts as circles, about half of what there will be; "settled" is the pile at rest. Each
engine steps it with 3 sweeps of position correction, where it has them (ours, Box2D 2.3), in four blocks of
steps: of 10, 100, 100 and 10 velocity sweeps, so that what changes while a pile falls cancels out. Ours is
timed as users run it, one `dc.simulate` a block, and once more by one `dc.step` a step, which validates the
state every time; the others by their step functions through `deep_contact.studies.peers`.

An engine does the same work every time it starts from the same pile, so the run is repeated, engines taking
turns, and block by block the fastest of the repeats counts. A pass that is not timed counts the contacts of
every step. With t the time of a step of k sweeps over m contacts, the model is

    t = overhead + cost k m,

whose two unknowns follow from the sums over the steps of 10 and of 100 sweeps. "Whole step" is the mean
step of 10.

What a sweep is differs: Box2D v3's is a substep, which goes over the contacts twice and integrates
positions between (`peers.Box2D3`); pymunk's corrects positions as well. v3 and pymunk also count contacts
of their own, so costs are per contact of each engine and the counts are reported.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
from importlib import metadata
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact.reporting import results
from deep_contact.state import State, World, make_bodies
from deep_contact.studies import peers

TIME_STEP = 0.01
FEW, MANY = 10, 100
POSITION_SWEEPS = 3
BLOCKS = (FEW, MANY, MANY, FEW)
"""Velocity sweeps of the blocks of steps that are timed."""
WARM_UP = 10
"""Steps that each engine takes before timing: caches, broad phase and starting impulses settle."""
KINDS = ("settled", "falling")
REST_SPEED = 0.05
"""Root mean square speed below which a pile counts as settled, m/s. A step of gravity is 0.098 m/s."""
MOST_STEPS = 3000
"""Steps after which a pile is taken as settled anyway."""
PILES = Path(__file__).resolve().parents[1] / "runs" / "piles"
PEER_PACKAGES = {"Box2D 2.3": "Box2D", "pymunk": "pymunk", "Box2D v3": "pyb2d3"}


class Ours:
    """Our engine, a block of steps at a time."""

    name = "ours"

    def __init__(self, state: State):
        self.state = state

    def run(self, steps: int, sweeps: int) -> None:
        self.state = simulated(self.state, steps, sweeps).state

    def count(self, steps: int, sweeps: int) -> int:
        """`run`, telling the sum of the contacts of all steps."""
        done = simulated(self.state, steps, sweeps)
        self.state = done.state
        return int(done.contacts.sum())


class OursByStep(Ours):
    """Our engine, a step at a time."""

    name = "dc.step"

    def run(self, steps: int, sweeps: int) -> None:
        for _ in range(steps):
            self.state = dc.step(self.state, solver=solver(sweeps), warm_start="builtin")


class Peer:
    """An adapter of `deep_contact.studies.peers`, with the methods of `Ours`."""

    def __init__(self, adapter):
        self.adapter = adapter
        self.name = adapter.name

    def __call__(self, state: State) -> Peer:
        self.world = self.adapter(state)
        return self

    def run(self, steps: int, sweeps: int) -> None:
        step = self.world.step
        for _ in range(steps):
            step(TIME_STEP, sweeps, POSITION_SWEEPS)

    def count(self, steps: int, sweeps: int) -> int:
        contacts = 0
        for _ in range(steps):
            # Box2D v3 tells the contacts ahead of a step, the others after it.
            ahead = self.world.contact_count() if self.adapter.counts_next_step else 0
            self.run(1, sweeps)
            contacts += ahead if self.adapter.counts_next_step else self.world.contact_count()
        return contacts


ENGINES = (Ours, OursByStep, Peer(peers.Box2D23), Peer(peers.Pymunk), Peer(peers.Box2D3))
PEERS = tuple(engine.name for engine in ENGINES[2:])


def solver(sweeps: int):
    return dc.PGS(sweeps=sweeps, tolerance=None, position_sweeps=POSITION_SWEEPS)


def simulated(state: State, steps: int, sweeps: int):
    return dc.simulate(state, steps=steps, dt=TIME_STEP, solver=solver(sweeps), warm_start="builtin")


def pile(kind: str, n_bodies: int, seed: int) -> State:
    """The pile, simulated if it is not in the folder of piles yet."""
    path = PILES / f"{kind}_{n_bodies}_seed_{seed}_dt_{TIME_STEP}_sweeps_{FEW}_rest_{REST_SPEED}.npz"
    if path.exists():
        with np.load(path) as stored:
            state = State(
                name=path.stem,
                world=World(box=tuple(stored["box"])),
                bodies=make_bodies(
                    stored["position"],
                    **{k: stored[k] for k in ("radius", "velocity", "angle", "spin", "mass")},
                ),
            )
    else:
        state = dropped_pile(kind, n_bodies, seed)
        path.parent.mkdir(parents=True, exist_ok=True)
        with results.replacing(path) as temporary:
            np.savez(temporary, box=state.world.box, **state.bodies._asdict())
    return state.replace(contacts=None, solved=False, dt=TIME_STEP)


def dropped_pile(kind: str, n_bodies: int, seed: int) -> State:
    """A loose lattice, dropped: until it has as many contacts as circles, or until it rests."""
    state = dc.lattice_in_box(n_bodies=n_bodies, seed=seed)
    for _ in range(MOST_STEPS // 10):
        state = simulated(state, 10, FEW).state
        if kind == "falling" and state.contacts.count >= n_bodies:
            break
        if kind == "settled" and state.contacts.count > n_bodies and rms_speed(state) < REST_SPEED:
            break
    return state


def rms_speed(state: State) -> float:
    return float(np.sqrt((state.bodies.velocity**2).sum(axis=1).mean()))


def run(engine, state: State, steps: int) -> np.ndarray:
    """Seconds of every block of so many steps, (4,)."""
    world = engine(state)
    world.run(WARM_UP, FEW)
    seconds = []
    for sweeps in BLOCKS:
        start = time.perf_counter()
        world.run(steps, sweeps)
        seconds.append(time.perf_counter() - start)
    return np.array(seconds)


def count(engine, state: State, steps: int) -> np.ndarray:
    """Contacts of every block of `run`, summed over its steps, (4,)."""
    world = engine(state)
    world.run(WARM_UP, FEW)
    return np.array([world.count(steps, sweeps) for sweeps in BLOCKS])


def measure(state: State, steps: int, repeats: int) -> dict[str, dict]:
    """Name of the engine -> its costs on the pile."""
    contacts = {engine.name: count(engine, state, steps) for engine in ENGINES}
    fastest = {engine.name: np.full(len(BLOCKS), np.inf) for engine in ENGINES}
    for _ in range(repeats):
        for engine in ENGINES:
            gc.collect()
            gc.disable()
            try:
                np.minimum(fastest[engine.name], run(engine, state, steps), out=fastest[engine.name])
            finally:
                gc.enable()
    return {name: costs(fastest[name], contacts[name], steps) for name in fastest}


def costs(seconds: np.ndarray, contacts: np.ndarray, steps: int) -> dict[str, float]:
    """The two unknowns of the model, from seconds and contacts of the blocks, both (4,)."""
    few = np.array(BLOCKS) == FEW
    time_few, time_many = seconds[few].sum(), seconds[~few].sum()
    work_few, work_many = FEW * contacts[few].sum(), MANY * contacts[~few].sum()
    slope = (time_many - time_few) / (work_many - work_few)
    steps_few = steps * few.sum()
    return {
        "contacts": float(contacts.sum() / (steps * len(BLOCKS))),
        "sweep_ns": float(1e9 * slope),
        "overhead_us": float(1e6 * (time_few - slope * work_few) / steps_few),
        "step_us": float(1e6 * time_few / steps_few),
    }


def ratios(measured: dict[str, dict]) -> dict[str, dict]:
    """Peer -> its costs as multiples of ours."""
    ours = measured[Ours.name]
    return {
        name: {cost: theirs[cost] / ours[cost] for cost in ("sweep_ns", "overhead_us", "step_us")}
        for name, theirs in measured.items()
        if name in PEERS
    }


def claims(cases: list[dict]) -> list[results.Claim]:
    """What the engine is meant to reach, held against the measured ratios; the worst case decides."""
    old, both = ["Box2D 2.3"], ["Box2D 2.3", "pymunk"]
    goals = [
        ("A sweep costs at most a quarter of pybox2d's", "sweep_ns", old, 0, 4.0),
        (
            "A step is at least 2x faster than pybox2d's and pymunk's from 1,000 on",
            "step_us",
            both,
            1000,
            2.0,
        ),
        ("The overhead is below pybox2d's and pymunk's", "overhead_us", both, 0, 1.0),
        ("The overhead is below Box2D v3's from 1,000 on", "overhead_us", ["Box2D v3"], 1000, 1.0),
    ]
    found = []
    for text, cost, names, smallest, factor in goals:
        met = {
            f"{name}, {case['kind']}, {case['n_bodies']}": case["ratios"][name][cost]
            for case in cases
            for name in names
            if case["n_bodies"] >= smallest
        }
        if met:
            worst = min(met, key=met.get)
            holds = bool(met[worst] > factor or (met[worst] == factor and factor > 1))
            found.append(results.Claim(text, None, holds, {"worst case": worst, "ratio": met[worst]}))
    return found


def report(case: dict) -> None:
    print(f"\n{case['n_bodies']} circles, {case['kind']} (rms speed {case['rms_speed']:.3f} m/s)")
    print("             contacts   ns/contact/sweep        overhead, µs       whole step, µs")
    for name, cost in case["engines"].items():
        line = f"  {name:10s}{cost['contacts']:9.0f}"
        for key, digits in (("sweep_ns", 2), ("overhead_us", 1), ("step_us", 1)):
            ratio = f"({case['ratios'][name][key]:.2f}x)" if name in case["ratios"] else ""
            line += f"{cost[key]:12.{digits}f} {ratio:8s}"
        print(line, flush=True)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    parser.add_argument("--sizes", help="numbers of circles, with commas (100,1000,10000; quick: 100,1000)")
    parser.add_argument("--repeats", type=int, help="runs of each engine on each pile (5; quick: 3)")
    parser.add_argument("--seed", type=int, default=0, help="of the piles")
    parser.add_argument("--quick", action="store_true", help="smaller piles, fewer steps")
    options = parser.parse_args(arguments)
    sizes = options.sizes or ("100,1000" if options.quick else "100,1000,10000")
    repeats = options.repeats or (3 if options.quick else 5)
    try:
        sizes = [int(size) for size in sizes.split(",")]
    except ValueError:
        parser.error(f"--sizes: expected integers with commas between, got {sizes!r}")
    if min(sizes) < 1 or repeats < 1:
        parser.error(f"expected sizes and repeats of at least 1, got {sizes} and {repeats}")

    start = time.perf_counter()
    cases = []
    for n_bodies in sizes:
        # A block is long enough to outlast the cost of a call of `dc.simulate`, as a run is.
        steps = int(np.clip(20_000 // n_bodies, 10, 10 if options.quick else 30))
        for kind in KINDS:
            state = pile(kind, n_bodies, options.seed)
            measured = measure(state, steps, repeats)
            case = {
                "n_bodies": n_bodies,
                "kind": kind,
                "rms_speed": rms_speed(state),
                "steps": steps * len(BLOCKS),
                "engines": measured,
                "ratios": ratios(measured),
            }
            report(case)
            cases.append(case)
    found = claims(cases)
    print()
    for claim in found:
        verdict = "holds" if claim.holds else "does not hold"
        print(f"{claim.text}: {verdict} ({claim.measured['ratio']:.2f}x, {claim.measured['worst case']})")
    if options.json:
        wall_s = time.perf_counter() - start
        results.write_results(
            options.json,
            {
                "id": "B.1",
                "title": "Cost of a sweep and of a step, against other engines",
                "options": {
                    "sizes": sizes,
                    "repeats": repeats,
                    "quick": options.quick,
                    "dt": TIME_STEP,
                    "sweeps": [FEW, MANY],
                    "position_sweeps": POSITION_SWEEPS,
                    "peers": {name: metadata.version(package) for name, package in PEER_PACKAGES.items()},
                },
                "provenance": results.provenance(seed=options.seed, wall_s=wall_s),
                "claims": found,
                "data": {"cases": cases},
            },
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
