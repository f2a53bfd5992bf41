"""Starts and solvers along runs of their own, at equal wall time: Figure 6.12.

A step of a run solves what the steps before have left. So a start is judged by the run that it drives: by the mean
over the steps of the velocity error, at the time of a step, everything included. Every setting runs the first seconds
of the same falling piles with several numbers of sweeps. Its error at another time is interpolated in logarithms.

The second part is the thesis's experiment: time to a velocity error from given states, those of well solved runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from deep_contact.cnn.per_contact import PerContact
from deep_contact.cnn.perceptron import sampled_share
from deep_contact.physics import metrics
from deep_contact.physics.contact_solver import apply_impulses
from deep_contact.physics.engine import solve, step_problem
from deep_contact.physics.scenes import lattice_in_box
from deep_contact.physics.solvers import NNCG, PSOR, NesterovPGS
from deep_contact.reporting.figures import parallel_map, seeds
from deep_contact.simulation import simulate
from deep_contact.state import State
from deep_contact.studies import timing
from deep_contact.studies.break_even import sweeps_to
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

STARTS = {"none": NoStart, "scaled": Scaled, "learned": PerContact}
"""Starts beside Builtin, for the solver `BASE`."""

BY_NEED = "by need"
"""Builtin and the solver `BASE`, with sweeps in proportion to the share unsolved, so many on average."""

LEARNED = f"{BASE}, learned"

_FEWEST, _MOST = 0.2, 5.0
"""Limits of the sweeps by need, as shares of the mean."""

_MEMORY = 0.02
"""Share of the newest step in the running mean of the share unsolved."""


def setting_of(name: str, sweeps: int):
    """(solver, start) of a setting: a name of `SOLVERS`, or one with a start behind a comma."""
    solver, _, start = name.partition(", ")
    method, options = SOLVERS[solver]
    made = Builtin() if start in ("", BY_NEED) else STARTS[start]()
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
    if task["setting"].endswith(BY_NEED):
        states, solvers, work = _run_by_need(scene, solver, task)
    else:
        run = simulate(scene, steps=task["steps"], solver=solver, warm_start=start, record=task["every"])
        states, work = list(run.trajectory)[1:], float(task["sweeps"])
        solvers = [solver] * len(states)
    judged = [(state, used) for state, used in zip(states, solvers) if state.contacts.count]
    errors = [step_error(state, used, start, task["past_need"]) for state, used in judged]
    late = states[len(states) // 3 :]
    return {
        "error": float(np.mean(errors)),
        "work": work,
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


def _run_by_need(scene: State, solver, task: Mapping) -> tuple[list[State], list, float]:
    """(states, solver of each, mean sweeps a contact) of a run that divides its sweeps by the share unsolved."""
    state, mean, weight, done, contacts = simulate(scene, steps=0).state, 0.0, 0.0, 0.0, 0
    states, solvers = [], []
    for k in range(task["steps"]):
        m, sweeps = state.contacts.count, task["sweeps"]
        if m:
            problem = step_problem(state)
            apply_impulses(problem.rows, problem.solver_bodies)
            share = sampled_share(problem.rows, problem.solver_bodies, problem.friction)
            mean, weight = (1 - _MEMORY) * mean + _MEMORY * m * share, (1 - _MEMORY) * weight + _MEMORY * m
            most = share * weight / mean if mean > 0 else 1.0
            sweeps = max(1, round(sweeps * min(_MOST, max(_FEWEST, most))))
        used = type(solver)(**{**vars(solver), "sweeps": sweeps})
        if k % task["every"] == 0 and k > 0:
            states.append(state)
            solvers.append(used)
        state = simulate(state, steps=1, solver=used).state
        done, contacts = done + m * sweeps, contacts + m
    return states, solvers, done / max(1, contacts)


def _kinetic(state: State) -> float:
    return 0.5 * metrics.energy_norm(state.bodies, state.bodies.velocity, state.bodies.spin) ** 2


def step_seconds(circles: int, seed: int, settings: Sequence[tuple[str, int]], steps: int, repeats: int) -> dict:
    """Seconds of a step of each (setting, sweeps), over the whole run: the least of the repeats, taken in turns.

    A run by need is not timed: its steps are made in Python here.
    """
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
        timed = {(_timed_as(e["setting"]), e["sweeps"]) for e in here if not e["setting"].endswith(BY_NEED)}
        took = step_seconds(int(text), 1, sorted(timed), options["steps"], options["repeats"])
        for entry in here:
            entry["seconds"] = took.get((_timed_as(entry["setting"]), entry["sweeps"]))
        for entry in here:
            if entry["seconds"] is None:
                # The sweeps cost what they cost the solver that it uses; sampling the share is left out.
                base = sorted((e["sweeps"], e["seconds"]) for e in here if e["setting"] == BASE)
                slope, overhead = timing.slope_and_overhead(base[0], base[-1])
                entry["seconds"] = overhead + slope * float(np.mean(entry["work"]))
    return entries


def measure_rest(options: Mapping) -> list[dict]:
    """What a step with ten sweeps costs in piles at rest: {"circles", "builtin", "learned"}, seconds.

    options: "rest": numbers of circles, "rest_steps" until they rest, "repeats".
    """
    found = []
    for circles in options["rest"]:
        solver, _ = setting_of(BASE, 10)
        state = simulate(lattice_in_box(circles, gap=0.05, seed=9), steps=options["rest_steps"], solver=solver).state
        starts = {"builtin": Builtin(), "learned": PerContact()}

        def run(start, state=state, solver=solver):
            return lambda: simulate(state, steps=200, solver=solver, warm_start=start)

        runs = {name: run(start) for name, start in starts.items()}
        took = timing.interleaved(runs, repeats=5 * options["repeats"], clock=time.thread_time)
        found.append({"circles": circles} | {name: seconds / 200 for name, seconds in took.items()})
    return found


# ---- data of Figure 6.12: {"runs": [entry, …], "given": [entry, …], "rest": [entry, …]} ----


def at_equal_sweeps(entries: Sequence[Mapping], circles: int, sweeps: int, key: str) -> list[np.ndarray]:
    """[of the learned start, of Builtin] with the solver `BASE` and so many sweeps: values of `key`, (scenes,)."""
    return [
        np.array(entry[key])
        for name in (LEARNED, BASE)
        for entry in entries
        if (entry["circles"], entry["setting"], entry["sweeps"]) == (circles, name, sweeps)
    ]


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


def names_of(entries: Sequence[Mapping], circles: int) -> list[str]:
    """The settings that were run with so many circles."""
    return list(dict.fromkeys(entry["setting"] for entry in entries if entry["circles"] == circles))


def cells(entries: Sequence[Mapping], columns: Sequence[int]) -> list[dict]:
    """For every size and time of so many sweeps of `BASE`: errors of all settings at this time, and the best classical.

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
            classical = {name: mean for name, mean in done.items() if name != LEARNED}
            best = min(classical, key=classical.get)
            found.append({"circles": circles, "sweeps": sweeps, "seconds": seconds, "errors": errors, "best": best})
    return found


def prices_of(entries: Sequence[Mapping]) -> dict[int, float]:
    """Circles -> what the learned start costs a step, in sweeps of `BASE`: the median over the numbers of sweeps."""
    found = {}
    for circles in dict.fromkeys(entry["circles"] for entry in entries):
        times = {
            name: {e["sweeps"]: e["seconds"] for e in entries if (e["circles"], e["setting"]) == (circles, name)}
            for name in (BASE, LEARNED)
        }
        sweep = np.polyfit(list(times[BASE]), list(times[BASE].values()), 1)[0]
        found[circles] = float(np.median([times[LEARNED][k] - times[BASE][k] for k in times[BASE]]) / sweep)
    return found


def ratio_with_interval(one: Sequence[float], other: Sequence[float], samples: int = 2000) -> list[float]:
    """[ratio of the means, low, high]: the 95 % interval over the scenes, which are drawn in pairs (bootstrap)."""
    one, other = np.asarray(one), np.asarray(other)
    chosen = np.random.default_rng(0).integers(0, len(one), (samples, len(one)))
    drawn = np.sort(one[chosen].mean(axis=1) / other[chosen].mean(axis=1))
    low, high = (float(drawn[round(share * (samples - 1))]) for share in (0.025, 0.975))
    return [float(one.mean() / other.mean()), low, high]


# ---- from given states ----


def measure_given(options: Mapping, seed: int, jobs, progress: Callable) -> list[dict]:
    """Errors by sweeps from given states of falling piles, and times of starts and sweeps.

    options: "given": {circles as text: scenes}, "given_sweeps": numbers, "states" of each scene, "past_need_given":
    sweeps of NNCG to the reference solutions, "repeats". Returns per size {"circles", "contacts", "errors": {setting:
    [by sweeps, one a state]}, "sweeps", "sweep_seconds", "start_seconds"}.
    """
    tasks, found = [], []
    for text, scenes in options["given"].items():
        chosen = [int(s % 100_000) + 500_000 for s in seeds(seed + int(text), scenes)]
        tasks += [{**options, "circles": int(text), "seed": s} for s in chosen]
    results = parallel_map(_errors_of_pile, tasks, jobs=jobs, progress=progress, text="piles")
    for text in options["given"]:
        here = [result for result, task in zip(results, tasks) if task["circles"] == int(text)]
        errors = {name: [e for result in here for e in result[name]] for name in here[0]}
        state = falling_states(int(text), 500_000, 1)[0]
        solver, _ = setting_of(BASE, 1)

        def solved(k, state=state, solver=solver):
            return solve(state, type(solver)(**{**vars(solver), "sweeps": k}), *Builtin()(state, solver))

        sweep = timing.sweep_time(solved, state.contacts.count, repeats=options["repeats"])
        took = start_seconds(state, solver, options["repeats"])
        took = {name: max(0.0, seconds - took["builtin"]) for name, seconds in took.items()}
        entry = {"circles": int(text), "contacts": state.contacts.count, "errors": errors}
        found.append(entry | {"sweep_seconds": sweep, "start_seconds": took, "sweeps": list(options["given_sweeps"])})
    return found


def start_seconds(state: State, solver, repeats: int) -> dict[str, float]:
    """Seconds of Builtin and of each of `STARTS` on a state whose rows have been built."""
    problem, starts = step_problem(state), {"builtin": Builtin(), **{name: make() for name, make in STARTS.items()}}

    def call(start):
        if hasattr(start, "from_problem"):
            return lambda: start.from_problem(state, solver, problem)
        return lambda: start(state, solver)

    return timing.interleaved({name: call(start) for name, start in starts.items()}, repeats=10 * repeats)


def falling_states(circles: int, seed: int, count: int, every: int = 4) -> list[State]:
    """States of a well solved run, one in `every` steps from the time on when there is a contact for each circle."""
    state = scene_of(circles, seed)
    for _ in range(100):
        state = simulate(state, steps=10, solver=NNCG(sweeps=300)).state
        if state.contacts.count >= circles:
            break
    return list(simulate(state, steps=count * every, solver=NNCG(sweeps=1000), record=every).trajectory)[1:]


def _errors_of_pile(task: Mapping) -> dict:
    found: dict = {}
    for state in falling_states(task["circles"], task["seed"], task["states"]):
        ends, references = {}, []
        for name in (*SOLVERS, *(f"{BASE}, {start}" for start in STARTS)):
            ends[name] = _ends(state, name, task["given_sweeps"])
        for name in (BASE, LEARNED):
            end = ends[name][-1]
            far = NNCG(sweeps=task["past_need_given"], tolerance=1e-9)
            references.append(solve(state, far, end.normal_impulses, end.tangent_impulses))
        for name, solutions in ends.items():
            errors = [metrics.nearest_velocity_error(state, s, references) for s in solutions]
            found.setdefault(name, []).append(errors)
    return found


def _ends(state: State, name: str, sweeps: Sequence[int]) -> list:
    """Solutions after so many sweeps; each from the start, since momentum and adaptive ω do not restart."""
    solver, start = setting_of(name, 1)
    impulses = start(state, solver)
    return [solve(state, type(solver)(**{**vars(solver), "sweeps": k}), *impulses) for k in sweeps]


def given_seconds(entry: Mapping, name: str, error: float) -> np.ndarray:
    """Seconds to an error on each state, the start included; infinite where it is not reached."""
    start = name.partition(", ")[2]
    price = entry["start_seconds"].get(start, 0.0)
    counts = np.array([sweeps_to(errors, entry["sweeps"], error) for errors in entry["errors"][name]])
    return price + counts * entry["sweep_seconds"]


def median_ratio_with_interval(one: np.ndarray, other: np.ndarray, samples: int = 2000) -> list[float] | None:
    """[median ratio of paired times, low, high] with its 95 % interval over the states (bootstrap).

    Over the states on which both are finite; None if these are half or less.
    """
    done = np.isfinite(one) & np.isfinite(other)
    if 2 * done.sum() <= done.size:
        return None
    ratios = one[done] / other[done]
    chosen = np.random.default_rng(0).integers(0, ratios.size, (samples, ratios.size))
    drawn = np.sort(np.median(ratios[chosen], axis=1))
    low, high = (float(drawn[round(share * (samples - 1))]) for share in (0.025, 0.975))
    return [float(np.median(ratios)), low, high]
