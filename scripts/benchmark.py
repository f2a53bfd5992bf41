"""python scripts/benchmark.py NAME [--quick] [--set NAME=VALUE] …: computing times of this package and other engines.

engine   the time of a sweep and of a step, and the overhead, on the same piles in this package and in Box2D 2.3, pymunk
         and Box2D v3
live     the time of a step of settled piles in one call, step by step and with a callback, with 0, 1 or 2 busy
         processes beside it; and the time of the first run of a process

Each time is the least of several, which are measured in turns. No other program should run at the same time. The files
are benchmark_NAME.json and its picture, in figures/ or in --out.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import metadata
from itertools import product

import numpy as np

import deep_contact as dc
from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.measure import peers
from deep_contact.solvers import PGS, BatchedPGS
from deep_contact.state.constants import TIME_STEP
from deep_contact.state.state import State
from deep_contact.studies import piles, timing

POSITION_SWEEPS = 3
"""Largest number of sweeps of position correction in a step."""
FEW = 10
"""Number of sweeps in a step that users typically choose."""
MANY = 100
"""Number of sweeps with which nearly all the time of a step is that of its sweeps."""
BLOCKS = (FEW, MANY, MANY, FEW)
"""Number of sweeps in each block of steps that is timed. In this order the effect of a pile's change cancels."""
WARM_UP = 10
"""Number of steps that each engine does before the timing, so that caches, pairs and initial impulses have settled."""


def fixed_sweeps(sweeps: int, method=PGS, **options):
    """Return a solver that does exactly `sweeps` sweeps, and at most `POSITION_SWEEPS` sweeps of position correction.

    method: class of the solver. options: further arguments of this class.
    """
    return method(sweeps=sweeps, tolerance=None, position_sweeps=POSITION_SWEEPS, **options)


def made_pile(kind: str, n_bodies: int, seed: int) -> State:
    """Return a pile with contacts. kind: "settled", or "falling", which has at least one contact per circle."""
    kind = {"settled": "resting"}.get(kind, kind)
    return piles.pile(kind, n_bodies, seed, solver=fixed_sweeps(FEW), most=3000, make=dc.lattice_in_box)


# ---- engines ----


class Ours:
    """This package with the interface of the other engines' adapters in `peers`. A block of steps is one `simulate`.

    state: the scene. options: arguments of `fixed_sweeps`.
    """

    def __init__(self, state: State, **options):
        self.state, self.options = state, options

    def run(self, steps: int, dt: float, sweeps: int, position_sweeps: int) -> None:
        """Do `steps` steps with `sweeps` sweeps each and the Δt of the state. dt and position_sweeps are ignored."""
        self.state = dc.simulate(self.state, steps=steps, solver=fixed_sweeps(sweeps, **self.options)).state

    def contact_count(self) -> int:
        """Return the number of contacts at the present positions."""
        return self.state.contacts.count


PEERS = peers.ENGINES | {f"{one.name}, two threads": partial(one, threads=2) for one in (peers.Pymunk, peers.Box2D3)}
ENGINES = {
    "ours": Ours,
    "in colours": partial(Ours, method=BatchedPGS),
} | PEERS
"""Name of an engine -> function that returns an adapter for a state."""

GOALS = {
    "A sweep costs at most a quarter of pybox2d's": ("sweep_ns", ["Box2D 2.3"], 0, 4.0),
    "A step is at least 2x faster than pybox2d's and pymunk's from 1,000 on":
        ("step_us", ["Box2D 2.3", "pymunk"], 1000, 2.0),
    "The overhead is below pybox2d's and pymunk's": ("overhead_us", ["Box2D 2.3", "pymunk"], 0, 1.0),
    "The overhead is below Box2D v3's from 1,000 on": ("overhead_us", ["Box2D v3"], 1000, 1.0),
}  # fmt: skip
"""Claim -> (cost, other engines, number of circles from which it is judged, least ratio of their cost to ours)."""


def costs(seconds: np.ndarray, contacts: np.ndarray, steps: int) -> dict[str, float]:
    """Fit the equation: time of a step = overhead + cost · sweeps · contacts. Returns name of a cost -> value.

    The sweep of Box2D v3 is a sub-step, which passes over the contacts twice. The sweep of pymunk also corrects
    positions. seconds: time of each of `BLOCKS`, s, (4,). contacts: number of contacts in each block, summed over
    the steps, (4,). steps: number of steps in a block.
    """
    few = np.array(BLOCKS) == FEW
    ends = ((sweeps * contacts[of].sum(), seconds[of].sum()) for sweeps, of in ((FEW, few), (MANY, ~few)))
    slope, overhead = np.polyfit(*zip(*ends), 1)
    steps_few = steps * few.sum()
    cost = {"contacts": contacts.sum() / (steps * len(BLOCKS)), "sweep_ns": 1e9 * slope}
    cost |= {"overhead_us": 1e6 * overhead / steps_few, "step_us": 1e6 * seconds[few].sum() / steps_few}
    return {name: float(value) for name, value in cost.items()}


def costs_of_engines(state: State, steps: int, repeats: int) -> dict[str, dict]:
    """Return the costs of each engine on a pile: name of the engine -> result of `costs`.

    state: the pile, with which every repeat begins. steps: number of steps in a block. repeats: number of timed runs.
    The contacts are counted in a run that is not timed.
    """
    worlds, contacts = {}, {}

    def run(name, steps, sweeps):
        worlds[name].run(steps, TIME_STEP, sweeps, POSITION_SWEEPS)

    def restart(name):
        worlds[name] = ENGINES[name](state)
        run(name, WARM_UP, FEW)

    def count(name, sweeps):
        total = 0
        for _ in range(steps):
            total += worlds[name].contact_count()
            run(name, 1, sweeps)
        return total

    for name in ENGINES:
        restart(name)
        contacts[name] = np.array([count(name, sweeps) for sweeps in BLOCKS])
    runs = {
        (name, block): partial(run, name, steps, BLOCKS[block]) for name, block in product(ENGINES, range(len(BLOCKS)))
    }
    setup = {(name, 0): partial(restart, name) for name in ENGINES}
    least = timing.interleaved(runs, repeats=repeats, setup=setup)
    seconds = {name: np.array([least[name, block] for block in range(len(BLOCKS))]) for name in ENGINES}
    return {name: costs(seconds[name], contacts[name], steps) for name in ENGINES}


def engine(options, seed, jobs, progress):
    """Measure the costs of this package and of other engines on settled and falling piles."""
    cases, names = [], ("sweep_ns", "overhead_us", "step_us")
    for n_bodies, kind in progress([*product(options["sizes"], ("settled", "falling"))], text="piles"):
        # The steps are so many that the fixed cost of `simulate` is negligible, and so few that a falling pile still
        # falls.
        steps = int(np.clip(300_000 // n_bodies, 10, options["steps"][kind]))
        state = made_pile(kind, n_bodies, seed).replace(contacts=None, solver=None, solved=False)
        measured = costs_of_engines(state, steps, options["repeats"])
        ratios = {peer: {name: measured[peer][name] / measured["ours"][name] for name in names} for peer in PEERS}
        cases.append({"n_bodies": n_bodies, "kind": kind, "engines": measured, "ratios": ratios})
    return {"cases": cases, "versions": {name: metadata.version(one.package) for name, one in peers.ENGINES.items()}}


def engine_table(data):
    """Return the rows of the table: the costs of every engine on every pile."""
    names = ["contacts", "sweep_ns", "overhead_us", "step_us"]
    rows = [[case["n_bodies"], case["kind"], engine, *(cost[name] for name in names)]
            for case in data["cases"] for engine, cost in case["engines"].items()]  # fmt: skip
    return [["circles", "pile", "engine", *names], *rows]


def claims(data: dict) -> Iterator[Claim]:
    """Yield the claims of `GOALS`, which the worst measured ratios decide."""
    for text, (cost, names, smallest, factor) in GOALS.items():
        large = [case for case in data["cases"] if case["n_bodies"] >= smallest]
        if met := {
            f"{name}, {case['kind']}, {case['n_bodies']}": case["ratios"][name][cost]
            for case, name in product(large, names)
        }:
            worst = min(met, key=met.get)
            yield Claim(text, None, bool(met[worst] >= factor), {"worst case": worst, "ratio": met[worst]})


# ---- as users step ----

DEFAULTS = {"Box2D 2.3": (8, 3), "pymunk": (10, 0), "Box2D v3": (4, 0)}
"""Engine -> (sweeps or sub-steps, position sweeps) of a step that its documentation recommends.

This package runs with the preset "fast".
"""

FIRST = """
import deep_contact as dc
dc.simulate({scene}, steps=1, accuracy={accuracy!r})
"""
SCENES = {
    "100 circles, fast": ("dc.lattice_in_box(100)", "fast"),
    "1,000 circles, fast": ("dc.lattice_in_box(1000)", "fast"),
    "3,000 circles, fast": ("dc.lattice_in_box(3000)", "fast"),
    "100 circles, reference": ("dc.lattice_in_box(100)", "reference"),
    "hopper, fast": ("dc.hopper(100, opening=4.0)", "fast"),
    "drum, fast": ("dc.drum(100, froude=0.5)", "fast"),
}
"""Name of the first run of a new process -> (its scene, its preset). The code has been compiled before."""


def ways_of(state: State, steps: int) -> dict:
    """Return functions that do `steps` steps of a pile: name -> function.

    This package does them in four ways, and each other engine step by step.
    """
    live, each = dc.Simulator(state, accuracy="fast"), [state]

    def one_by_one():
        for _ in range(steps):
            live.step()

    def function_by_function():
        for _ in range(steps):
            each[0] = dc.simulate(each[0], steps=1, accuracy="fast").state

    def of_peer(world, name):
        for _ in range(steps):
            world.step(TIME_STEP, *DEFAULTS[name])

    run = partial(dc.simulate, state, steps=steps, accuracy="fast")
    ways = {"one call": run, "Simulator": one_by_one, "on_step": partial(run, on_step=lambda state, record: None)}
    ways["simulate, one step each"] = function_by_function
    return ways | {name: partial(of_peer, adapter(state), name) for name, adapter in peers.ENGINES.items()}


@contextmanager
def beside(count: int):
    """Run `count` other processes in the background, each of which uses a core."""
    with ExitStack() as stack:
        for _ in range(count):
            busy = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(busy.kill)
        yield


def live(options, seed, jobs, progress):
    """Measure the time of a step, μs: least, median and largest of all repeats, beside 0, 1 and 2 busy processes."""
    runs = []
    for n_bodies in progress(options["sizes"], text="sizes"):
        state = made_pile("settled", n_bodies, seed).replace(contacts=None, solver=None, solved=False)
        # The pile starts from zero impulses. A step takes longer until it rests: 150 steps with 10,000 circles.
        state = dc.simulate(state, steps=400, accuracy="fast").state
        steps = int(np.clip(options["work"] // n_bodies, 5, 1000))
        for busy in options["busy"]:
            with beside(busy):
                times = timing.interleaved(ways_of(state, steps), repeats=options["repeats"], reduce=np.array)
            us = {name: np.percentile(1e6 * took / steps, (0, 50, 100)).tolist() for name, took in times.items()}
            runs.append({"n_bodies": n_bodies, "busy": busy, "us": us})
    first = {}
    for name in options["first"]:
        scene, accuracy = SCENES[name]
        first[name] = [timing.fresh(FIRST.format(scene=scene, accuracy=accuracy))["seconds"] for _ in range(4)][1:]
    versions = {name: metadata.version(one.package) for name, one in peers.ENGINES.items()}
    return {"runs": runs, "first": {name: min(took) for name, took in first.items()}, "versions": versions}


def live_table(data):
    """Return the rows of the table: the time of a step for every way of stepping, μs.

    It is the least of the repeats without busy processes, and the median beside busy processes.
    """
    rows = [[run["n_bodies"], run["busy"], *(f"{us[run['busy'] > 0]:,.1f}" for us in run["us"].values())]
            for run in data["runs"]]  # fmt: skip
    return [["circles", "busy processes", *(f"{way}, µs" for way in data["runs"][0]["us"])], *rows]


FIGURES = {
    "engine": Figure(
        "B.1", "Cost of a sweep and of a step, against other engines", engine, engine_table, claims=claims,
        options={"sizes": [100, 1000, 10_000], "repeats": 5, "steps": {"settled": 200, "falling": 30}},
        quick={"sizes": [100, 1000], "steps": {"settled": 10, "falling": 10}}, file="benchmark_engine",
    ),
    "live": Figure(
        "B.2", "Time of a step as users step", live, live_table,
        options={"sizes": [10, 100, 1000, 3000, 10_000], "busy": [0, 1, 2], "work": 200_000, "repeats": 5,
                 "first": list(SCENES)},
        quick={"sizes": [10], "busy": [0, 1], "work": 50, "repeats": 2, "first": []}, file="benchmark_live",
    ),
}  # fmt: skip
"""Name of a benchmark on the command line -> its figure."""

if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1] in FIGURES:
        raise SystemExit(figures.main(FIGURES[sys.argv[1]], sys.argv[2:]))
    print(__doc__)
    raise SystemExit(0 if "--help" in sys.argv else 2)
