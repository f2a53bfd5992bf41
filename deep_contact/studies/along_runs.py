"""Starts and solvers along runs of their own, at equal wall time: Figure 6.12.

A step of a run solves what the steps before have left. So a start is judged by the run that it drives: by the mean
over the steps of the velocity error, at the time of a step, everything included. Every setting runs the first seconds
of the same falling piles with several numbers of sweeps. Its error at another time is interpolated in logarithms.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from deep_contact.physics import metrics
from deep_contact.physics.engine import solve
from deep_contact.physics.scenes import lattice_in_box
from deep_contact.physics.solvers import NNCG, PSOR, NesterovPGS
from deep_contact.reporting.figures import parallel_map, seeds
from deep_contact.simulation import simulate
from deep_contact.state import State
from deep_contact.studies import timing
from deep_contact.warm_start import Builtin, NoStart, Scaled

BASE = "PSOR 1.75 | 1.45"
"""The setting whose times are the columns: ω of the normal and of the friction rows."""

SOLVERS = {
    "PSOR 1.5": (PSOR, {"omega": 1.5}),
    "PSOR 1.7": (PSOR, {"omega": 1.7}),
    BASE: (PSOR, {"omega": 1.75, "friction_omega": 1.45}),
    "PSOR 1.8 | 1.4": (PSOR, {"omega": 1.8, "friction_omega": 1.4}),
    "PSOR adaptive": (PSOR, {"adaptive": True}),
    "NesterovPGS": (NesterovPGS, {}),
    "NNCG": (NNCG, {}),
}
"""Name -> method and options; from Builtin."""

STARTS = {"none": NoStart, "scaled": Scaled}
"""Starts beside Builtin, for the solver `BASE`."""


def setting_of(name: str, sweeps: int):
    """(solver, start) of a setting: a name of `SOLVERS`, or one with a start behind a comma."""
    solver, _, start = name.partition(", ")
    method, options = SOLVERS[solver]
    made = STARTS[start]() if start else Builtin()
    return method(sweeps=sweeps, tolerance=None, **options), made


def scene_of(circles: int, seed: int) -> State:
    """A square lattice, loose or very loose, that falls on the floor and settles."""
    return lattice_in_box(circles, gap=0.1 if seed % 2 else 0.2, seed=seed)


# ---- along runs ----


def run_of(task: Mapping) -> dict:
    """One run of a setting: mean velocity error of its steps, and what a user sees of it.

    task: "circles", "seed", "setting", "sweeps", "steps", "every": steps between two that are judged, "past_need":
    sweeps of NNCG, from where a step ended, to the solution that it is held against.
    Returns {"error", "work": mean sweeps a contact, "penetration": mean of the deepest over the last two thirds, m,
    "speed": rms over the circles at the end, m/s, "height": of the centre of mass at the end, m, "energy": kinetic
    energy at ten times, J}.
    """
    solver, start = setting_of(task["setting"], task["sweeps"])
    scene = scene_of(task["circles"], task["seed"])
    run = simulate(scene, steps=task["steps"], solver=solver, warm_start=start, record=task["every"])
    states = list(run.trajectory)[1:]
    errors = [step_error(state, solver, start, task["past_need"]) for state in states if state.contacts.count]
    late = states[len(states) // 3 :]
    return {
        "error": float(np.mean(errors)),
        "work": float(task["sweeps"]),
        "penetration": float(np.mean([metrics.penetration(state) for state in late])),
        "speed": float(np.sqrt(np.mean((states[-1].bodies.velocity ** 2).sum(axis=1)))),
        "height": float(np.average(states[-1].bodies.position[:, 1], weights=states[-1].bodies.mass)),
        "energy": [_kinetic(state) for state in states[:: max(1, len(states) // 10)]],
    }


def step_error(state: State, solver, start, past_need: int) -> float:
    """Velocity error of the next step of a run, against the solution that NNCG finds from where the step ends."""
    end = solve(state, solver, *start(state, solver))
    reference = solve(state, NNCG(sweeps=past_need, tolerance=1e-9), end.normal_impulses, end.tangent_impulses)
    return metrics.nearest_velocity_error(state, end, [reference])


def _kinetic(state: State) -> float:
    return 0.5 * metrics.energy_norm(state.bodies, state.bodies.velocity, state.bodies.spin) ** 2


def step_seconds(circles: int, seed: int, settings: Sequence[tuple[str, int]], steps: int, repeats: int) -> dict:
    """Seconds of a step of each (setting, sweeps), over the whole run: the least of the repeats, taken in turns."""
    scene = scene_of(circles, seed)

    def run(name, sweeps):
        solver, start = setting_of(name, sweeps)
        return lambda: simulate(scene, steps=steps, solver=solver, warm_start=start)

    # What this thread works: a run takes seconds, and another program would interrupt all of them.
    runs = {key: run(*key) for key in settings}
    found = timing.interleaved(runs, repeats=repeats, clock=time.thread_time)
    return {key: seconds / steps for key, seconds in found.items()}


def _timed_as(name: str) -> str:
    """The setting whose time is taken for one: all fixed ω from Builtin do the same operations."""
    solver, _, start = name.partition(", ")
    return BASE if "omega" in SOLVERS[solver][1] and not start else name


def measure_runs(options: Mapping, seed: int, jobs, progress: Callable) -> list[dict]:
    """One entry for each size, setting and number of sweeps: `run_of` of every scene in columns, and its step's time.

    options: "runs": {circles as text: {"scenes", "sweeps": numbers, "settings": names}}, "steps", "every", "past_need",
    "repeats".
    """
    entries, tasks = [], []
    for text, plan in options["runs"].items():
        scenes = [int(s % 100_000) + 300_000 for s in seeds(seed + int(text), plan["scenes"])]
        for name in plan["settings"]:
            for sweeps in plan["sweeps"]:
                entries.append({"circles": int(text), "setting": name, "sweeps": sweeps})
                tasks += [
                    {**entries[-1], "seed": s, **{k: options[k] for k in ("steps", "every", "past_need")}}
                    for s in scenes
                ]
    found = iter(parallel_map(run_of, tasks, jobs=jobs, progress=progress, text="runs"))
    for entry in entries:
        runs = [next(found) for _ in range(options["runs"][str(entry["circles"])]["scenes"])]
        entry.update({name: [run[name] for run in runs] for name in runs[0]})
    for text in options["runs"]:
        here = [entry for entry in entries if entry["circles"] == int(text)]
        timed = {(_timed_as(e["setting"]), e["sweeps"]) for e in here}
        took = step_seconds(int(text), 1, sorted(timed), options["steps"], options["repeats"])
        for entry in here:
            entry["seconds"] = took[_timed_as(entry["setting"]), entry["sweeps"]]
    return entries


# ---- data of Figure 6.12: {"runs": [entry, …]} ----


def curve(entries: Sequence[Mapping], circles: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(seconds (c,), errors (c, scenes)) of a setting by its numbers of sweeps.

    No time is longer than that of more sweeps: a run of very few sweeps may take longer, because it has to correct more
    positions, and nobody would take it.
    """
    here = [entry for entry in entries if (entry["circles"], entry["setting"]) == (circles, name)]
    here.sort(key=lambda entry: np.mean(entry["work"]))
    seconds = np.minimum.accumulate([entry["seconds"] for entry in here[::-1]])[::-1]
    return seconds, np.array([entry["error"] for entry in here])


def error_at(seconds: float, times: np.ndarray, errors: np.ndarray) -> np.ndarray | None:
    """Errors (scenes,) at a time, between those of the nearest two, in logarithms; beyond the last, the last ones.

    None if the fewest sweeps take longer.
    """
    if seconds < times[0]:
        return None
    k = int(np.searchsorted(times, seconds, side="right"))
    if k == len(times):
        return errors[-1]
    low, high = np.log(times[k - 1]), np.log(times[k])
    share = (np.log(seconds) - low) / (high - low)
    return np.exp((1 - share) * np.log(errors[k - 1]) + share * np.log(errors[k]))


def is_known(name: str) -> bool:
    """Whether a setting can be made: a stored result may hold others."""
    solver, _, start = name.partition(", ")
    return solver in SOLVERS and start in ("", *STARTS)


def names_of(entries: Sequence[Mapping], circles: int) -> list[str]:
    """The settings that were run with so many circles."""
    found = dict.fromkeys(entry["setting"] for entry in entries if entry["circles"] == circles)
    return [name for name in found if is_known(name)]


def cells(entries: Sequence[Mapping], columns: Sequence[int]) -> list[dict]:
    """For every size and time of so many sweeps of `BASE`: errors of all settings at this time, and the best.

    Each {"circles", "sweeps", "seconds", "errors": {setting: (scenes,), or None: see `error_at`}, "best": its name}.
    """
    found = []
    for circles in dict.fromkeys(entry["circles"] for entry in entries):
        for sweeps in columns:
            base = [e for e in entries if (e["circles"], e["setting"], e["sweeps"]) == (circles, BASE, sweeps)]
            if not base:
                continue
            at = sorted(e["sweeps"] for e in entries if (e["circles"], e["setting"]) == (circles, BASE))
            seconds = float(curve(entries, circles, BASE)[0][at.index(sweeps)])
            names = names_of(entries, circles)
            errors = {name: error_at(seconds, *curve(entries, circles, name)) for name in names}
            done = {name: values.mean() for name, values in errors.items() if values is not None}
            best = min(done, key=done.get)
            found.append({"circles": circles, "sweeps": sweeps, "seconds": seconds, "errors": errors, "best": best})
    return found


def ratio_with_interval(one: Sequence[float], other: Sequence[float], samples: int = 2000) -> list[float]:
    """[ratio of the means, low, high]: the 95 % interval over the scenes, which are drawn in pairs (bootstrap)."""
    one, other = np.asarray(one), np.asarray(other)
    chosen = np.random.default_rng(0).integers(0, len(one), (samples, len(one)))
    drawn = np.sort(one[chosen].mean(axis=1) / other[chosen].mean(axis=1))
    low, high = (float(drawn[round(share * (samples - 1))]) for share in (0.025, 0.975))
    return [float(one.mean() / other.mean()), low, high]
