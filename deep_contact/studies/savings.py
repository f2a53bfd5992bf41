"""What modelling only what a scene requires saves: measured here, drawn as Figure 6.7.

A saving is a ratio: the cost of the general way over the cost of the special way, in the same process, interleaved.
It has the quartiles of the repeats' own ratios, or of the runs'. "apart" is what it costs in error: how far apart, m,
any circle is after the same steps in both ways.
"""

from __future__ import annotations

import functools
import time
from dataclasses import replace

import numpy as np

from deep_contact import constants
from deep_contact.physics.engine import Steps, step_input
from deep_contact.physics.ready import ready
from deep_contact.physics.scenes import circles_in_box
from deep_contact.physics.solvers import PGS
from deep_contact.physics.step import make_log
from deep_contact.simulation import simulate, solve_contacts
from deep_contact.state import State, World
from deep_contact.state.checks import make_bodies
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


def apart(one: State, other: State) -> float:
    """Largest distance between a circle in one state and in the other, m."""
    return float(np.hypot(*(one.bodies.position - other.bodies.position).T).max())


def sweep_saving(n_bodies: int, seed: int, *, steps: int, repeats: int) -> dict:
    """What rows without tangents save a sweep of a resting pile, ns per contact and sweep.

    "apart": what it changes in so many steps. Friction of 1e-300 needs tangent rows, and moves nothing.
    """
    pile = ready(at_rest(piles.scene(n_bodies, seed)))
    contacts = pile.contacts._replace(tangent_start=np.zeros(pile.contacts.count))
    frictionless, nearly = (
        pile.replace(world=replace(pile.world, friction=friction), contacts=contacts) for friction in (0.0, 1e-300)
    )
    many, ways = FEW + ENOUGH // pile.contacts.count, {"general": pile, "frictionless": frictionless}
    solvers = {k: PGS(sweeps=k, tolerance=None) for k in (FEW, many)}
    runs = {
        (name, k): functools.partial(solve_contacts, state, solver=solver)
        for name, state in ways.items()
        for k, solver in solvers.items()
    }
    times = interleaved(runs, repeats=repeats)
    relaxations = (many - FEW) * pile.contacts.count
    general, special = (1e9 * (times[name, many] - times[name, FEW]) / relaxations for name in ways)
    ends = (simulate(state, steps=steps, solver=STEP).state for state in (nearly, frictionless))
    return timing.ratio(general, special) | {"apart": apart(*ends)}


def step_savings(n_bodies: int, seed: int, *, steps: int, repeats: int) -> dict[str, dict]:
    """What parts of `STEP` cost a resting pile, s per step: being awake, position correction, calls between steps.

    "apart": what leaving a part out changes in so many steps. Circles may fall asleep in them.
    """
    pile, rolling = ready(at_rest(piles.scene(n_bodies, seed))), ready(heaps_and_one_rolling(n_bodies, seed))
    still = np.full(n_bodies, np.inf)
    asleep = {"asleep": _Asleep(pile, still, steps)}
    asleep["one rolling, asleep"] = _Asleep(rolling, np.append(still, 0.0), steps)
    step = functools.partial(simulate, steps=steps, solver=STEP)
    ways = {
        "awake": functools.partial(step, pile),
        "one rolling, awake": functools.partial(step, rolling),
        "uncorrected": functools.partial(step, pile, solver=replace(STEP, position_sweeps=0)),
        "called": functools.partial(step, pile, on_step=lambda *_: None),
    }
    runs, setup = ({name: getattr(one, part) for name, one in asleep.items()} for part in ("run", "reset"))
    times = {name: took / steps for name, took in interleaved(ways | runs, repeats=repeats, setup=setup).items()}
    ways |= {name: functools.partial(step, state, sleep=True) for name, state in zip(asleep, (pile, rolling))}
    ends = {name: way().state for name, way in ways.items()}
    pairs = {
        "asleep": ("awake", "asleep"),
        "asleep but for one": ("one rolling, awake", "one rolling, asleep"),
        "no position correction": ("awake", "uncorrected"),
        "no call between steps": ("called", "awake"),
    }
    return {
        name: timing.ratio(times[general], times[special]) | {"apart": apart(ends[general], ends[special])}
        for name, (general, special) in pairs.items()
    }


class _Asleep:
    """Steps of `STEP` by circles that have been still for `still`, (n,), s: `simulate` lets all start awake.

    It calls the compiled step itself. `reset` prepares a run.
    """

    def __init__(self, state: State, still: np.ndarray, steps: int):
        self._state, self._still, self._steps = state, still, steps

    def reset(self) -> None:
        parts = {"bodies": self._state.bodies, "contacts": self._state.contacts}
        copies = {name: part._make(field.copy() for field in part) for name, part in parts.items()}
        self._input, self._contacts = step_input(self._state.replace(**copies), STEP), copies["contacts"]
        self._advance = Steps(STEP, self._state.bodies.count, sleep=True)
        self._log = make_log(self._steps)
        self._advance.sleep.still[:] = self._still

    def run(self) -> None:
        self._advance(self._input, self._contacts, self._log)


def island_savings(scene: State, *, steps: int, every: int) -> dict:
    """What islands save a run, on the same states: one in `every` steps of the run without islands.

    Returns {"together", "apart": relaxations of each state, "seconds_together", "seconds_apart": the least of three,
    "difference": largest between the velocities of both, m/s}.
    """
    ways = {"together": PGS(), "apart": PGS(islands=True)}
    states = solved_states(scene, steps=steps, every=every, solver=ways["together"])
    calls = {(name, k): functools.partial(solve_contacts, state, solver=solver)
             for k, state in enumerate(states) for name, solver in ways.items()}  # fmt: skip
    took, measured = interleaved(calls, repeats=3, reduce=min), {}
    for name, solver in ways.items():
        relaxations = [simulate(state, steps=1, solver=solver).relaxations[0] for state in states]
        measured[name] = np.array(relaxations, dtype=int)
        measured[f"seconds_{name}"] = np.array([took[name, k] for k in range(len(states))])
    ends = ([calls[name, k]().velocities for name in ways] for k in range(len(states)))
    return measured | {"difference": np.array([np.abs(one - other).max() for one, other in ends])}


def saving_by_run(runs: list[dict], unit: str = "") -> dict:
    """The saving in the runs of `island_savings`, of relaxations or of "seconds_". "apart" is that of one step."""
    general, special = (
        np.array([run[f"{unit}{name}"].sum() for run in runs], dtype=float) for name in ("together", "apart")
    )
    distance = constants.TIME_STEP * max(run["difference"].max() for run in runs)
    return timing.ratio(general, special) | {"apart": distance}


JOBS = {
    "import": "import deep_contact as dc",
    "simulate": "import deep_contact as dc; dc.simulate(dc.column(10), steps=1)",
    "simulate, no friction": "import deep_contact as dc; dc.simulate(dc.column(10, friction=0.0), steps=1)",
    "predict": "import deep_contact as dc; dc.load_model().predict(dc.simulate(dc.column(10), steps=1).state)",
}
"""Job -> the code of it."""


def job(name: str) -> dict:
    """{"seconds", "heavy", "memory_mb"} of `timing.fresh`, after a first process has filled the caches."""
    timing.fresh(JOBS[name])
    took = timing.fresh(JOBS[name])
    kib = took.pop("memory_kib")
    return took | {"memory_mb": kib and kib / 1024}
