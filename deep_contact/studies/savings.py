"""What modelling only what a scene requires saves: measured here, drawn as Figure 6.7, told by `dc.plan`.

A saving is a ratio: what the general way costs over what the special way costs, in the same process, by turns. Times
are repeated, and the quartiles of the repeats' own ratios are the spread; counted work has none.

Tried on resting piles of 100 to 10,000 circles and not built: one inverse and one effective mass for equal circles (a
sweep 1 to 7 % slower, for it leaves fewer registers), and no target velocities where nothing bounces (1 to 7 % faster).
Not tried: a gravity of 0, which is two additions a circle and step.
"""

from __future__ import annotations

import functools
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping

import numpy as np

from deep_contact import constants
from deep_contact.physics.engine import advance_of, moving_room, solve_velocities, world_arguments
from deep_contact.physics.islands import islands_of
from deep_contact.physics.scenes import circles_in_box, lattice_in_box
from deep_contact.physics.solvers import PGS
from deep_contact.physics.solvers.registry import settings_of
from deep_contact.simulation import ready, simulate, solve_contacts
from deep_contact.state import State, World, make_bodies
from deep_contact.studies.comparison import solved_states

FEW, ENOUGH = 10, 1_000_000
"""Sweeps, and relaxations, between which the time of a sweep is taken."""

STEP = PGS(sweeps=10, tolerance=None)
UNCORRECTED = PGS(sweeps=10, tolerance=None, position_sweeps=0)
"""The step whose parts are compared, and the same without position correction."""

SCATTERED = {"size": (300.0, 30.0), "sigma_coef": 5.0}
"""A box in which circles fall into many heaps."""


def by_turns(runs: Mapping[str, Callable[[], float]], repeats: int) -> dict[str, np.ndarray]:
    """Name -> result of each repeat, (repeats,): all once unheeded, which compiles, then taking turns."""
    found = [{name: run() for name, run in runs.items()} for _ in range(repeats + 1)][1:]
    return {name: np.array([one[name] for one in found]) for name in runs}


def seconds(run: Callable[[], object]) -> float:
    """Time that this thread works for a call, s: what else runs on the machine does not count, waiting neither."""
    begin = time.thread_time()
    run()
    return time.thread_time() - begin


def saving(general: np.ndarray, special: np.ndarray) -> dict:
    """Median and quartiles of the ratios repeat by repeat, and the least times themselves."""
    low, ratio, high = np.percentile(general / special, (25, 50, 75))
    return {"ratio": ratio, "low": low, "high": high, "general": general.min(), "special": special.min()}


def at_rest(scene: State) -> State:
    """The scene once all of its circles sleep, or after 60 s."""
    for _ in range(60):
        run = simulate(scene, steps=100, solver=PGS(sweeps=200), sleep=True)
        scene = run.state
        if run.relaxations[-1] == 0:
            break
    return scene


def resting_pile(n_bodies: int, seed: int) -> State:
    """A pile at rest in the thesis's box, or a lattice that has collapsed in its own."""
    return at_rest(circles_in_box(n_bodies, seed=seed) if n_bodies <= 100 else lattice_in_box(n_bodies, seed=seed))


def heaps_and_one_rolling(n_bodies: int, seed: int) -> State:
    """Heaps at rest, and one circle more that rolls along the floor away from them."""
    scene = circles_in_box(n_bodies, seed=seed, **SCATTERED)
    right, height = SCATTERED["size"]
    world = World(box=(0.0, 0.0, right + 100.0, height))
    heaps, speed = at_rest(scene.replace(world=world)).bodies, 1.0
    position = np.vstack([heaps.position, [right + 20.0, 1.0 + constants.WALL_SKIN]])
    velocity = np.vstack([heaps.velocity, [speed, 0.0]])
    bodies = make_bodies(position, radius=1.0, velocity=velocity, spin=np.append(heaps.spin, -speed))
    return scene.replace(world=world, bodies=bodies)


def sweep_savings(n_bodies: int, seed: int, *, repeats: int) -> dict[str, dict]:
    """What rows without tangents, and single precision, save a sweep of a resting pile, ns a contact and sweep."""
    state = resting_pile(n_bodies, seed)
    box, gravity, friction, restitution = world_arguments(state)
    m = state.contacts.count
    many = FEW + ENOUGH // m

    def cost(friction, precision="double"):
        solver = PGS(sweeps=many, tolerance=None, precision=precision)
        settings, moving, theta = settings_of(solver), moving_room(n_bodies, solver), np.empty(many)
        arguments = state.bodies, state.contacts, (box, gravity, friction, restitution), state.dt, settings, moving
        few = seconds(lambda: solve_velocities(*arguments, theta[:FEW]))
        return (seconds(lambda: solve_velocities(*arguments, theta)) - few) / ((many - FEW) * m) * 1e9

    times = by_turns(
        {
            "general": lambda: cost(friction),
            "frictionless": lambda: cost(None),
            "single": lambda: cost(friction, "single"),
        },
        repeats,
    )
    return {name: saving(times["general"], times[name]) for name in ("frictionless", "single")}


def step_savings(n_bodies: int, seed: int, *, steps: int, repeats: int) -> dict[str, dict]:
    """What parts of `STEP` cost a resting pile, s a step: being awake, position correction, a call between steps."""
    pile = ready(resting_pile(n_bodies, seed))
    rolling = ready(heaps_and_one_rolling(n_bodies, seed))
    asleep = np.full(n_bodies, np.inf)
    times = by_turns(
        {
            "awake": lambda: seconds(lambda: simulate(pile, steps=steps, solver=STEP)),
            "asleep": lambda: time_asleep(pile, asleep, steps),
            "one rolling, awake": lambda: seconds(lambda: simulate(rolling, steps=steps, solver=STEP)),
            "one rolling, asleep": lambda: time_asleep(rolling, np.append(asleep, 0.0), steps),
            "uncorrected": lambda: seconds(lambda: simulate(pile, steps=steps, solver=UNCORRECTED)),
            "told": lambda: seconds(lambda: simulate(pile, steps=steps, solver=STEP, on_step=lambda *_: None)),
        },
        repeats,
    )
    times = {name: values / steps for name, values in times.items()}
    return {
        "asleep": saving(times["awake"], times["asleep"]),
        "asleep but for one": saving(times["one rolling, awake"], times["one rolling, asleep"]),
        "no position correction": saving(times["awake"], times["uncorrected"]),
        "no call between steps": saving(times["told"], times["awake"]),
    }


def time_asleep(state: State, rest: np.ndarray, steps: int) -> float:
    """Time of so many steps of `STEP` with sleeping, s, by circles that have been still for `rest`, (n,), s."""
    advance, method = advance_of(STEP, sleep=True)
    bodies, contacts = (part._make(field.copy() for field in part) for part in (state.bodies, state.contacts))
    room = moving_room(rest.size, STEP), np.empty(STEP.sweeps), np.empty((steps, 4)), rest.copy()
    return seconds(lambda: advance(bodies, contacts, world_arguments(state), state.dt, *method, True, steps, *room))


def island_savings(scene: State, *, steps: int, every: int) -> dict:
    """What islands save a run, on the same states: those of every so many steps of the run that sweeps all together.

    Returns {"step", "contacts", "islands", "together", "apart": relaxations of each state, "seconds_together",
    "seconds_apart": the least of three, "difference": largest between the velocities of both, m/s, "error_together",
    "error_apart": largest velocity error of each, m/s}. Errors are held against the solution swept on to 1e-10 N·s.
    """
    found = {name: [] for name in ("step", "contacts", "islands", "difference")}
    ways = {"together": PGS(), "apart": PGS(islands=True)}
    for name in ways:
        found |= {name: [], f"seconds_{name}": [], f"error_{name}": []}
    for state in solved_states(scene, steps=steps, every=every, solver=ways["together"]):
        found["step"].append(state.step)
        found["contacts"].append(state.contacts.count)
        found["islands"].append(len(np.unique(islands_of(state)[state.contacts.body_a])))
        solutions = {name: solve_contacts(state, solver=solver) for name, solver in ways.items()}
        together = solutions["together"]
        goal = solve_contacts(
            state,
            solver=PGS(sweeps=100_000, tolerance=1e-10),
            start=(together.normal_impulses, together.tangent_impulses),
        )
        for name, solver in ways.items():
            found[name].append(int(simulate(state, steps=1, solver=solver).relaxations[0]))
            solve = functools.partial(solve_contacts, state, solver=solver)
            found[f"seconds_{name}"].append(min(seconds(solve) for _ in range(3)))
            found[f"error_{name}"].append(largest_difference(solutions[name], goal))
        found["difference"].append(largest_difference(solutions["apart"], together))
    return {name: np.array(values) for name, values in found.items()}


def largest_difference(one, other) -> float:
    """Between the velocities of two solutions, component by component, m/s."""
    return float(np.abs(one.velocities - other.velocities).max())


JOBS = {
    "import": "import deep_contact as dc",
    "simulate": "import deep_contact as dc; dc.simulate(dc.column(10), steps=1)",
    "simulate, no friction": "import deep_contact as dc; dc.simulate(dc.column(10, friction=0.0), steps=1)",
    "predict": "import deep_contact as dc\n"
    "state = dc.simulate(dc.column(10), steps=1).state\n"
    "dc.load_model().predict(state)",
}
"""Job -> the code of it."""

_PROBE = """
import json, sys, time
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
    import gc
    from numba.core.dispatcher import Dispatcher
    functions = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    found["compiled"] = sum(len(one.stats.cache_misses) for one in functions)
print(json.dumps(found))
"""


def job(name: str) -> dict:
    """What a job takes in a process of its own, after a first one has filled the caches.

    Returns {"seconds", "modules": how many are loaded, "heavy": packages among them, "memory_mb": at most resident,
    "compiled": functions that had to be compiled}. The interpreter's own start is not in the seconds. Memory is None
    where the system does not tell it.
    """
    command = [sys.executable, "-c", _PROBE, JOBS[name]]
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])
