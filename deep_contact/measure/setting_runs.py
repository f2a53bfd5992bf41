"""Runs with a setting, in this package or in another engine: their states, their times, and their errors over seeds.

Tests: tests/measure/test_trade.py, tests/studies/test_run_study.py
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from timeit import timeit

import numpy as np

from deep_contact.measure import peers
from deep_contact.measure.errors import Observation, errors, intervals
from deep_contact.measure.settings import group_of, name_of, solver_of
from deep_contact.run.one_scene import simulate
from deep_contact.state.state import State
from deep_contact.state.validation import expect
from deep_contact.stepping.problem import contacts_of

LONG_ENOUGH = 0.02
"""Time, s, that the timings of a run should take together. A shorter run is timed up to five times."""

WARM = 5
"""Number of steps before the timing of a run begins. These steps load code, fill an engine's memory and detect all
contacts."""

POSITION_SWEEPS = 10
"""Largest number of position iterations in a step of Box2D 2.3."""

ABSOLUTE = ("penetration", "penetration_95", "penetration_max")
"""Names of errors that are differences from 0, not from the reference."""


def rivals(scene: State) -> tuple[list, list[str]]:
    """Return (settings, sentences): settings of the other engines that can run the scene.

    The sentences say why some engines cannot run it.
    """
    settings, why = [], []
    for engine in peers.ENGINES:
        budgets = ((1, 4), (1, 10), (2, 4), (2, 10), (4, 2), (4, 4))
        mine = [{"engine": engine, "sweeps": count, "dt": scene.dt / k} for k, count in budgets]
        try:
            Run(scene, mine[0])
            settings += mine
        except (ImportError, ValueError) as error:
            why.append(f"{engine} is left out: {error}")
    return settings, why


def world_of(state: State, setting: Mapping):
    """Return the world of another engine (`peers.ENGINES`), made from the circles of a state for a setting."""
    options = {name: value for name, value in setting.items() if name in ("slop", "bias", "hertz")}
    return peers.ENGINES[setting["engine"]](state.replace(contacts=None), **options)


class Run:
    """A run of a scene with a setting, in this package or in another engine."""

    def __init__(self, start: State, setting: Mapping):
        self._state, self._setting, self._world = start.replace(dt=setting["dt"]), setting, None
        if "engine" in setting:
            self._world = world_of(self._state, setting)

    def advance(self, steps: int) -> None:
        """Do `steps` steps of the setting's Δt."""
        state, setting = self._state, self._setting
        if self._world is None:
            begin = setting.get("start", "builtin")
            self._state = simulate(state, steps=steps, solver=solver_of(setting), warm_start=begin).state
        else:
            most = setting.get("position_sweeps", POSITION_SWEEPS)
            self._world.run(steps, setting["dt"], setting["sweeps"], most)
            self._state = state.replace(time=state.time + steps * setting["dt"])

    def state(self) -> State:
        """Return the present state, with contacts."""
        if self._world is None:
            return self._state
        state = self._state.replace(bodies=self._world.bodies())
        return state.replace(contacts=contacts_of(state))


def states_of(start: State, setting: Mapping, frames: int, interval: float) -> Iterator[State]:
    """Yield `frames` states of a run, one every `interval`, s.

    Raises ValueError if the setting's Δt does not divide `interval`.
    """
    run, each = Run(start, setting), round(interval / setting["dt"])
    text = f"dt: expected a step that divides {interval:g} s, got {setting['dt']}"
    expect(math.isclose(each * setting["dt"], interval, rel_tol=1e-5), text)
    for _ in range(frames):
        run.advance(each)
        yield run.state()


def timed(start: State, setting: Mapping, seconds: float) -> float:
    """Return the thread time, s, of one call that advances a run by `seconds`, s, of the scene's time.

    If the run is short, the result is the least of several timings. Other programs disturb thread time less than wall
    time. The time in an engine's Python wrapper counts, since users pay for it. The time in which the engine's world is
    destroyed does not count.
    """
    took: list[float] = []
    while len(took) < 5 and sum(took) < LONG_ENOUGH:
        run = Run(start, setting)
        run.advance(WARM)
        steps = partial(run.advance, round(seconds / setting["dt"]))
        took.append(timeit(steps, timer=time.thread_time, number=1))
    return min(took)


def row_of(setting: Mapping, step: float, ensemble: Sequence[Observation], reference: Sequence[Observation]) -> dict:
    """Return a row of results: a setting, and its errors with intervals.

    step: Δt of the scene, s. ensemble, reference: observations of the setting's and the reference's runs of the same
    scenes.
    """
    row = {"name": name_of(setting, step), "setting": dict(setting), "group": group_of(setting)}
    return row | {"seeds": len(ensemble), "errors": intervals(ensemble, reference)}


def noise_of(half: Sequence, reference: Sequence, *, swaps: int = 20) -> dict[str, float]:
    """Return name of an error (`errors`) -> its mean size between two ensembles that differ by chance alone.

    half, reference: observations of the same scenes, with half the reference's step and with its step. If these runs
    differ only by chance, the two runs of any scene may be swapped. The errors between the two ensembles are therefore
    averaged over random choices of the scenes whose runs are swapped. swaps: number of these choices.
    """
    if len(half) < 2:
        return {}
    seen, rng = [], np.random.default_rng(0)
    for _ in range(swaps):
        pairs = [pair[::-1] if swap else pair for pair, swap in zip(zip(half, reference), rng.random(len(half)) < 0.5)]
        seen.append(errors(*zip(*pairs)))
    known = [name for name in seen[0] if name not in ABSOLUTE and all(one[name] is not None for one in seen)]
    return {name: float(np.mean([one[name] for one in seen])) for name in known}
