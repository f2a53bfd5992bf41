"""The trade of speed for accuracy in whole runs: errors and times of settings and of other engines.

Run by `scripts/run_tradeoff.py`, read by `recommend`. A setting is a method with a fixed number of sweeps and a time
step; an engine's is its iterations and a time step. Every setting runs the same falling piles; `run_errors` holds each
ensemble against the limit of small steps. Errors need no quiet machine; times are measured one after the other on one.

Time steps are given for circles of r = 1 m under g = 9.81 m/s²: what counts is Δt √(g / r).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from deep_contact.constants import TIME_STEP
from deep_contact.physics.engine import contacts_of
from deep_contact.physics.scenes import circles_in_box, lattice_in_box
from deep_contact.physics.solvers import METHODS, solver_from
from deep_contact.physics.solvers.batched import CIRCLES_A_THREAD
from deep_contact.reporting import results
from deep_contact.simulation import simulate
from deep_contact.state import State
from deep_contact.studies import peers, timing
from deep_contact.studies.piles import SLOWEST, rms_speed
from deep_contact.studies.run_errors import Observation, intervals, observe

INTERVAL = 5 * TIME_STEP
"""Between two observations, s."""

KINDS = {
    "plain": {},
    "mixed radii": {"radius": (0.5, 1.5)},
    "no friction": {"friction": 0.0},
}
"""Kind of pile -> options of its scene."""

HELD_OUT_KINDS = {
    "plain": {},
    "narrow radii": {"radius": (0.7, 1.3)},
    "slippery": {"friction": 0.2},
    "loose": {"gap": 0.3},
}
"""Kinds of the scenes outside the study."""

PHASES = ("impact", "settling", "rest")
"""When piles are timed. The cost of a setting is that of a settling pile; the others show how it changes in a run."""

CONTACTS = {"impact": 0.5, "settling": 1.5}
"""Contacts per circle from which on a pile is in a phase, whatever its size."""

REFERENCE = {"method": "PGS", "sweeps": 20, "dt": TIME_STEP / 16}
"""Taken for the limit of small steps; Figure 6.2 shows that the steps before it come to the same within the noise."""

LIMIT = [{"method": "PGS", "sweeps": 20, "dt": TIME_STEP / k} for k in (1, 2, 4, 8, 16)]
"""The settings whose errors show the convergence to the limit."""

MODEL = {
    "a tenth of the slop": REFERENCE | {"slop": 0.1},
    "no position correction": REFERENCE | {"position_sweeps": 0},
}
"""What the contact model changes in the limit of small steps; the first has position correction leave less alone."""


def scene(kind: str, n_bodies: int, seed: int) -> State:
    """A falling pile: the thesis's scene for 100 circles and fewer, otherwise a loose lattice."""
    options = (KINDS | HELD_OUT_KINDS)[kind]
    if n_bodies <= 100:
        return circles_in_box(n_bodies, seed=seed, **{key: options[key] for key in options if key != "gap"})
    return lattice_in_box(n_bodies, seed=seed, **options)


def solver_of(setting: Mapping):
    """The options of a setting's method, without substeps."""
    options = {name: value for name, value in setting.items() if name not in ("method", "dt", "start", "slop")}
    return solver_from(setting["method"], options | {"tolerance": None})


def name_of(setting: Mapping) -> str:
    """Such as "PGS, 10 sweeps, Δt / 2", or of an engine "Box2D v3, 4 iterations, Δt / 2"; Δt is 0.01 s."""
    words = [setting.get("engine") or setting["method"]]
    counted = "sweeps" if "sweeps" in setting else "substeps"
    number, budget = setting[counted], "iterations" if "engine" in setting else counted
    words.append(f"{number} {budget if number != 1 else budget[:-1]}")
    words += [f"{key}={setting[key]}" for key in setting if key not in ("engine", "method", counted, "dt")]
    ratio = TIME_STEP / setting["dt"]
    words.append("Δt" if ratio == 1 else f"Δt / {ratio:g}" if ratio > 1 else f"{1 / ratio:g} Δt")
    return ", ".join(words)


# ---- observations ----


def observed(kind: str, n_bodies: int, seed: int, setting: Mapping, *, seconds: float) -> dict:
    """The `Observation` of one run as lists, five digits: of our engine, or of another where the setting names one."""
    if not np.isclose(INTERVAL / setting["dt"], round(INTERVAL / setting["dt"])):
        raise ValueError(f"dt: expected a step that divides {INTERVAL} s, got {setting['dt']}")
    start, frames = scene(kind, n_bodies, seed), round(seconds / INTERVAL)
    states = (_states_of_peer if "engine" in setting else _states)(start, setting, frames)
    return results.plain(observe(states)._asdict(), digits=5)


def observation(stored: Mapping) -> Observation:
    """The inverse of `observed`."""
    arrays = {name: np.array(value) if isinstance(value, list) else value for name, value in stored.items()}
    return Observation(**arrays)


def _states(state: State, setting: Mapping, frames: int) -> Iterator[State]:
    state, each = state.replace(dt=setting["dt"]), round(INTERVAL / setting["dt"])
    if "slop" in setting:  # as a multiple of the scene's own
        scales = state.scales._replace(slop=setting["slop"] * state.scales.slop)
        state = state.replace(world=replace(state.world, scales=scales))
    solver = solver_of(setting)
    for _ in range(frames):
        state = simulate(state, steps=each, solver=solver, warm_start=setting.get("start", "builtin")).state
        yield state


def _states_of_peer(start: State, setting: Mapping, frames: int) -> Iterator[State]:
    world = peers.ENGINES[setting["engine"]](start.replace(dt=setting["dt"]))
    each = round(INTERVAL / setting["dt"])
    for k in range(frames):
        for _ in range(each):
            world.step(setting["dt"], setting["sweeps"], 10)
        state = start.replace(bodies=world.bodies(), time=(k + 1) * INTERVAL)
        yield state.replace(contacts=contacts_of(state))


# ---- times ----


def times(
    n_bodies: int, seed: int, settings: Sequence[Mapping], *, steps: int, repeats: int, phase: str = "settling"
) -> dict[str, float]:
    """Wall time of TIME_STEP of a pile with each setting, μs, by name; they take turns, the least counts.

    steps: of TIME_STEP in each run. Other engines start from the same bodies; what their Python wrapper costs a step is
    part of what their users pay. Of piles for which ours takes two threads, they are run on one and on two, where they
    can, and the lesser time counts.
    """
    start = pile(n_bodies, seed, phase)
    worlds: dict = {}
    runs, setup = {}, {}
    for setting in settings:
        name, count = name_of(setting), round(steps * TIME_STEP / setting["dt"])
        if "engine" in setting:
            adapter, scene_of_peer = peers.ENGINES[setting["engine"]], start.replace(dt=setting["dt"], contacts=None)
            makers = [adapter]
            if adapter.takes_threads and n_bodies >= 2 * CIRCLES_A_THREAD:
                makers.append(partial(adapter, threads=2))
            for make in makers:
                key = name, make
                setup[key] = lambda key=key, given=scene_of_peer: worlds.update({key: key[1](given)})
                runs[key] = lambda key=key, setting=setting, count=count: _step_peer(worlds.pop(key), setting, count)
        else:
            state, options = start.replace(dt=setting["dt"]), {"solver": solver_of(setting), "steps": count}
            options["warm_start"] = setting.get("start", "builtin")
            runs[name, None] = lambda state=state, options=options: simulate(state, **options)
    found: dict[str, float] = {}
    for (name, _), seconds in timing.interleaved(runs, repeats=repeats, setup=setup).items():
        found[name] = min(found.get(name, math.inf), 1e6 * seconds / steps)
    return found


def pile(n_bodies: int, seed: int, phase: str) -> State:
    """A plain pile at the first tenth of a second at which it is in the phase of `PHASES`, or after 60 s.

    It is at rest when it has been settling and its rms speed is below that of a resting pile.
    """
    state = scene("plain", n_bodies, seed)
    least = CONTACTS.get(phase, CONTACTS["settling"])
    for _ in range(600):
        state = simulate(state, steps=10, solver=METHODS["PGS"](sweeps=20, tolerance=None)).state
        if state.contacts.count >= least * n_bodies and (phase != "rest" or rms_speed(state) < SLOWEST["resting"]):
            break
    return state


def _step_peer(world, setting: Mapping, count: int) -> None:
    for _ in range(count):
        world.step(setting["dt"], setting["sweeps"], 10)


# ---- what the study says ----


def rows(ensembles: Mapping, took: Mapping) -> list[dict]:
    """A row for each kind, size and setting: its errors with their intervals, and its times, μs, where measured.

    ensembles: (kind, n_bodies) -> {name: (setting, [Observation, …])}. took: (n_bodies, phase) -> {name: μs}. "us" is
    the time of a settling pile, "phases" has those of the other phases. The reference itself has no errors.
    """
    found = []
    for (kind, n_bodies), ensemble in ensembles.items():
        true = ensemble[name_of(REFERENCE)][1]
        for name, (setting, seen) in ensemble.items():
            found.append(
                {
                    "kind": kind,
                    "n_bodies": n_bodies,
                    "name": name,
                    "setting": dict(setting),
                    "seeds": len(seen),
                    "errors": intervals(seen, true[: len(seen)]) if seen is not true else None,
                }
                | times_of(name, n_bodies, took)
            )
    return found


def times_of(name: str, n_bodies: int, took: Mapping) -> dict:
    """What a row says of the times of a setting: "us" and "phases"."""
    phases = {phase: by_name[name] for (size, phase), by_name in took.items() if size == n_bodies and name in by_name}
    return {"us": phases.pop("settling", None), "phases": phases}


def worst_errors(found: Iterable[Mapping]) -> dict[str, float]:
    """Of rows of one setting and size: the largest of each error over the kinds of piles, unknown ones left out."""
    worst: dict[str, float] = {}
    for row in found:
        for name, value in (row["errors"] or {}).items():
            if value is not None:
                worst[name] = max(worst.get(name, 0.0), value[0])
    return worst


def meets(worst: Mapping[str, float], tolerances: Mapping[str, float]) -> bool:
    """Whether every error that is known is within its tolerance."""
    return all(worst[name] <= most for name, most in tolerances.items() if name in worst)


def small_study(n_bodies: int, seeds: Sequence[int], settings: Sequence[Mapping], *, seconds: float) -> list[dict]:
    """The rows of a study of one size on plain piles, made in this process: for quick forms of the figures."""
    ensemble = {
        name_of(setting): (
            setting,
            [observation(observed("plain", n_bodies, seed, setting, seconds=seconds)) for seed in seeds],
        )
        for setting in [REFERENCE, *settings]
    }
    took = {
        (n_bodies, phase): times(n_bodies, seeds[0], settings, steps=10, repeats=1, phase=phase) for phase in PHASES
    }
    return rows({("plain", n_bodies): ensemble}, took)
