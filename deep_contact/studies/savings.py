"""What modelling only what a scene requires saves: measured here, drawn as Figure 6.7, printed by `dc.plan`.

A saving is a ratio: the cost of the general way over the cost of the special way, in the same process, interleaved.
Timed savings have the quartiles of the repeats' own ratios as spread; counted work has none.
"""

from __future__ import annotations

import functools
import json
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from deep_contact import constants
from deep_contact.physics.engine import Steps, step_input
from deep_contact.physics.islands import islands_of
from deep_contact.physics.scenes import circles_in_box
from deep_contact.physics.solvers import PGS
from deep_contact.physics.step import make_log
from deep_contact.simulation import ready, simulate, solve_contacts
from deep_contact.state import State, World, make_bodies
from deep_contact.studies import piles, timing
from deep_contact.studies.starts import solved_states

FEW, ENOUGH = 10, 1_000_000
"""The time of a sweep follows from `FEW` sweeps and from so many that they do `ENOUGH` more relaxations."""

STEP = PGS(sweeps=10, tolerance=None)
"""The step whose parts are compared."""

SCATTERED = {"size": (300.0, 30.0), "sigma_coef": 5.0}
"""A box in which circles fall into many heaps."""

interleaved = functools.partial(timing.interleaved, reduce=np.array, clock=time.thread_time)
"""Name -> times of all repeats, (repeats,), s, that this thread works: other programs and waiting do not count."""


def at_rest(scene: State) -> State:
    """The scene once all of its circles sleep, or after 60 s."""
    for _ in range(60):
        run = simulate(scene, steps=100, solver=PGS(sweeps=200), sleep=True)
        scene = run.state
        if run.relaxations[-1] == 0:
            break
    return scene


def heaps_and_one_rolling(n_bodies: int, seed: int) -> State:
    """Heaps at rest, and one circle more that rolls along the floor away from them."""
    scene = circles_in_box(n_bodies, seed=seed, **SCATTERED)
    (right, height), speed = SCATTERED["size"], 1.0
    scene = scene.replace(world=World(box=(0.0, 0.0, right + 100.0, height)))
    heaps = at_rest(scene).bodies
    position = np.vstack([heaps.position, [right + 20.0, 1.0 + constants.WALL_SKIN]])
    velocity = np.vstack([heaps.velocity, [speed, 0.0]])
    return scene.replace(bodies=make_bodies(position, velocity=velocity, spin=np.append(heaps.spin, -speed)))


def sweep_savings(n_bodies: int, seed: int, *, repeats: int) -> dict[str, dict]:
    """What rows without tangents, and single precision, save a sweep of a resting pile, ns per contact and sweep."""
    pile = ready(at_rest(piles.scene(n_bodies, seed)))
    contacts = pile.contacts._replace(tangent_start=np.zeros(pile.contacts.count))
    frictionless = pile.replace(world=replace(pile.world, friction=0.0), contacts=contacts)
    many = FEW + ENOUGH // pile.contacts.count
    ways = {"general": (pile, "double"), "frictionless": (frictionless, "double"), "single": (pile, "single")}

    def sweep(state, precision, sweeps):
        solve_contacts(state, solver=PGS(sweeps=sweeps, tolerance=None, precision=precision))

    runs = {(name, k): functools.partial(sweep, *way, k) for name, way in ways.items() for k in (FEW, many)}
    times = interleaved(runs, repeats=repeats)
    relaxations = (many - FEW) * pile.contacts.count
    cost = {name: 1e9 * (times[name, many] - times[name, FEW]) / relaxations for name in ways}
    return {name: timing.ratio(cost["general"], cost[name]) for name in ("frictionless", "single")}


def step_savings(n_bodies: int, seed: int, *, steps: int, repeats: int) -> dict[str, dict]:
    """What parts of `STEP` cost a resting pile, s per step: being awake, position correction, calls between steps."""
    pile = ready(at_rest(piles.scene(n_bodies, seed)))
    rolling = ready(heaps_and_one_rolling(n_bodies, seed))
    asleep = _Asleep(pile, np.full(n_bodies, np.inf), steps)
    all_but_one = _Asleep(rolling, np.append(np.full(n_bodies, np.inf), 0.0), steps)
    step = functools.partial(simulate, steps=steps, solver=STEP)
    runs = {
        "awake": functools.partial(step, pile),
        "asleep": asleep.run,
        "one rolling, awake": functools.partial(step, rolling),
        "one rolling, asleep": all_but_one.run,
        "uncorrected": functools.partial(step, pile, solver=replace(STEP, position_sweeps=0)),
        "called": functools.partial(step, pile, on_step=lambda *_: None),
    }
    setup = {"asleep": asleep.reset, "one rolling, asleep": all_but_one.reset}
    times = {name: found / steps for name, found in interleaved(runs, repeats=repeats, setup=setup).items()}
    return {
        "asleep": timing.ratio(times["awake"], times["asleep"]),
        "asleep but for one": timing.ratio(times["one rolling, awake"], times["one rolling, asleep"]),
        "no position correction": timing.ratio(times["awake"], times["uncorrected"]),
        "no call between steps": timing.ratio(times["called"], times["awake"]),
    }


class _Asleep:
    """Steps of `STEP` by circles that have been still for `still`, (n,), s: `simulate` lets all start awake.

    It calls the compiled step itself. `reset` prepares a run.
    """

    def __init__(self, state: State, still: np.ndarray, steps: int):
        self._state, self._still, self._log = state, still, make_log(steps)

    def reset(self) -> None:
        bodies, contacts = (
            part._make(field.copy() for field in part) for part in (self._state.bodies, self._state.contacts)
        )
        self._given = step_input(self._state.replace(bodies=bodies, contacts=contacts), STEP)
        self._advance = Steps(STEP, self._state.bodies.count, sleep=True)
        self._advance.memory(self._given).sleep.still[:] = self._still

    def run(self) -> None:
        self._advance(self._given, self._log)


def island_savings(scene: State, *, steps: int, every: int) -> dict:
    """What islands save a run, on the same states: one in `every` steps of the run without islands.

    Returns {"step", "contacts", "islands", "together", "apart": relaxations of each state, "seconds_together",
    "seconds_apart": the least of three, "difference": largest between the velocities of both, m/s, "error_together",
    "error_apart": largest velocity error of each, m/s}. The reference solution is swept on to 1e-10 N·s.
    """
    found: dict[str, list] = {}
    ways = {"together": PGS(), "apart": PGS(islands=True)}
    for state in solved_states(scene, steps=steps, every=every, solver=ways["together"]):
        calls = {name: functools.partial(solve_contacts, state, solver=solver) for name, solver in ways.items()}
        together, apart = (call() for call in calls.values())
        start = together.normal_impulses, together.tangent_impulses
        reference = solve_contacts(state, solver=PGS(sweeps=100_000, tolerance=1e-10), start=start)
        now = {"step": state.step, "contacts": state.contacts.count, "difference": largest_difference(apart, together)}
        now["islands"] = len(np.unique(islands_of(state)[state.contacts.body_a]))
        for (name, seconds), end in zip(interleaved(calls, repeats=3, reduce=min).items(), (together, apart)):
            now[name] = int(simulate(state, steps=1, solver=ways[name]).relaxations[0])
            now |= {f"seconds_{name}": seconds, f"error_{name}": largest_difference(end, reference)}
        for name, value in now.items():
            found.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in found.items()}


def largest_difference(one, other) -> float:
    """Between the velocities of two solutions, component by component, m/s."""
    return float(np.abs(one.velocities - other.velocities).max())


def saving_by_run(runs: list[dict], general: str, special: str) -> dict:
    """The saving over all runs of `island_savings`, with the quartiles of the runs' own ratios."""
    totals = np.array([[run[general].sum(), run[special].sum()] for run in runs], dtype=float).T
    found, (all_general, all_special) = timing.ratio(*totals), totals.sum(axis=1)
    return found | {"ratio": all_general / all_special, "general": all_general, "special": all_special}


JOBS = {
    "import": "import deep_contact as dc",
    "simulate": "import deep_contact as dc; dc.simulate(dc.column(10), steps=1)",
    "simulate, no friction": "import deep_contact as dc; dc.simulate(dc.column(10, friction=0.0), steps=1)",
    "predict": "import deep_contact as dc; dc.load_model().predict(dc.simulate(dc.column(10), steps=1).state)",
}
"""Job -> the code of it."""

_PROBE = """
import gc, json, sys, time
begin = time.perf_counter()
exec(sys.argv[1])
took = time.perf_counter() - begin
heavy = [name for name in ("numpy", "numba", "scipy", "lxml", "h5py", "keras", "tensorflow") if name in sys.modules]
found = {"seconds": took, "modules": len(sys.modules), "heavy": heavy, "memory_mb": None, "compiled": 0}
try:
    lines = open("/proc/self/status").read().splitlines()
    found["memory_mb"] = next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))
except OSError:
    pass
if "numba" in sys.modules:
    from numba.core.dispatcher import Dispatcher
    found["compiled"] = sum(len(one.stats.cache_misses) for one in gc.get_objects() if isinstance(one, Dispatcher))
print(json.dumps(found))
"""


def job(name: str) -> dict:
    """What a job takes in a fresh process, after a first one has filled the caches.

    Returns {"seconds", "modules": number loaded, "heavy": packages among them, "memory_mb": peak resident memory, or
    None where it is unknown, "compiled": number of functions compiled}. The seconds exclude the interpreter's start.
    """
    command = [sys.executable, "-c", _PROBE, JOBS[name]]
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])
