"""Learned starts against classical ones: Figures 6.8 and 6.10.

A setting is a start and the solver that follows it, such as "builtin, NNCG"; after "builtin" alone follows PGS. The
learned start with its best solver is compared with the best classical setting; both are chosen after the errors are
known. Errors are velocity errors (`metrics`) on the same states: setting -> (states, numbers of sweeps). Times are
measured apart, with nothing else running. No network was trained on scenes of these seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from deep_contact.parallel import parallel_map, seeds
from deep_contact.physics import metrics
from deep_contact.physics.contact_solver import projected
from deep_contact.physics.engine import solve, step_problem
from deep_contact.physics.scenes import circles_in_box
from deep_contact.physics.solvers import NNCG, PGS, PSOR, NesterovPGS
from deep_contact.simulation import solve_contacts
from deep_contact.state import State
from deep_contact.studies import piles, timing
from deep_contact.studies.starts import REFERENCE, solved_states, start_of
from deep_contact.studies.verdicts import FEWEST, interval
from deep_contact.warm_start import Sph, WarmStart, solved_impulses

BASE = "PSOR 1.75 | 1.45"
"""The best PSOR along runs: ω of the normal rows, and of the friction rows."""

SOLVERS = {
    "PGS": PGS(),
    "PSOR 1.3": PSOR(omega=1.3),
    "PSOR 1.5": PSOR(omega=1.5),
    BASE: PSOR(omega=1.75, friction_omega=1.45),
    "NesterovPGS": NesterovPGS(),
    "NNCG": NNCG(),
}

FOLLOWING = ("PGS", "PSOR 1.3", BASE, "NesterovPGS", "NNCG")
"""Solvers that follow a start where several are tried."""

CLASSICAL = ("none", "builtin", "scaled")
"""Starts that nothing was trained for."""

LEARNED = "far field"


def starts_with(model: str) -> dict:
    """Name -> description (`starts.start_of`) of the classical starts, and of that of a network."""
    return {name: name for name in CLASSICAL} | {LEARNED: {"model": model}}


def parts_of(setting: str) -> tuple[str, str]:
    """(Start, solver) of a setting's name."""
    start, _, solver = setting.partition(", ")
    return start, solver or "PGS"


def settings_with(starts: Iterable[str], solvers: Iterable[str] = FOLLOWING) -> list[str]:
    """The names of every start with every solver."""
    return [start if solver == "PGS" else f"{start}, {solver}" for start, solver in product(starts, solvers)]


def fixed(solver: str, sweeps: int):
    """A solver of `SOLVERS` that does so many sweeps."""
    return replace(SOLVERS[solver], sweeps=sweeps, tolerance=None)


def errors_of(state: State, impulses: Mapping, settings: Iterable[str], sweeps: Sequence, references: Sequence) -> dict:
    """Setting -> distances to the nearest reference after so many sweeps. impulses: start -> its impulses."""
    errors = {}
    for name in settings:
        start, solver = parts_of(name)
        ends = (solve(state, fixed(solver, k), *impulses[start]) for k in sweeps)
        errors[name] = [metrics.nearest_velocity_error(state, end, references) for end in ends]
    return errors


# ---- states of held-out scenes: Figure 6.8 ----

FEW = (3, 10, 30)
"""Numbers of sweeps that the claims are about."""

OFF = 0.05
"""Velocity error of Builtin's start above which a better start can matter."""


def errors_on_scenes(starts: Mapping, options: Mapping, seed: int, jobs, progress: Callable) -> list[dict]:
    """Errors of starts with all of `FOLLOWING` on the same states of the thesis's scenes, with μ = 0.3.

    The training data have 0.5. starts: name -> description (`starts.start_of`), among them "builtin". options: number
    of "scenes", "steps" of a scene, of which one in "every" is measured, and the numbers of sweeps "after" which errors
    are measured. Returns scene by scene {"step": (states,), "errors": {setting: (states, len(after))}}.
    """
    settings = [*starts, *settings_with(starts, FOLLOWING[1:])]
    tasks = [{**options, "starts": starts, "settings": settings, "seed": s} for s in seeds(seed, options["scenes"])]
    return parallel_map(_errors_on_scene, tasks, jobs=jobs, progress=progress, text="scenes")


def _errors_on_scene(task: Mapping) -> dict:
    starts = {name: start_of(description) for name, description in task["starts"].items()}
    rng = np.random.default_rng(task["seed"])
    scene = circles_in_box(int(rng.integers(70, 110, endpoint=True)), friction=0.3, seed=rng)
    solved: dict = {"step": [], "errors": {name: [] for name in task["settings"]}}
    for state in solved_states(scene, steps=task["steps"], every=task["every"], solver=PGS(sweeps=5000)):
        solution = solve(state, REFERENCE, state.contacts.normal_impulse, state.contacts.tangent_impulse)
        impulses = {name: start(state, PGS()) for name, start in starts.items()}
        errors = errors_of(state, impulses, task["settings"], task["after"], [solution])
        if np.isfinite(list(errors.values())).all():  # not where contacts have nothing to solve
            solved["step"].append(state.step)
            for name, values in errors.items():
                solved["errors"][name].append(values)
    return solved


def mean_errors(scenes: Sequence[Mapping], setting: str, where: str = "all") -> np.ndarray:
    """Mean velocity errors of a setting, (scenes, numbers of sweeps).

    where: "all" states, or only those where Builtin is "off" by more than `OFF`; scenes without any are left out.
    """
    means = []
    for scene in scenes:
        errors, builtin = (np.array(scene["errors"][name]) for name in (setting, "builtin"))
        chosen = builtin[:, 0] > OFF if where == "off" else np.ones(len(errors), bool)
        if chosen.any():
            means.append(errors[chosen].mean(axis=0))
    return np.array(means)


def best_settings(scenes: Sequence[Mapping], starts: Sequence[str], where: str = "all") -> list[str]:
    """For each number of sweeps the setting of some starts with the least mean error."""
    names = [name for name in settings_with(starts) if name in scenes[0]["errors"]]
    means = np.array([mean_errors(scenes, name, where).mean(axis=0) for name in names])
    return [names[i] for i in means.argmin(axis=0)]


def best_errors(scenes: Sequence[Mapping], starts: Sequence[str], where: str = "all") -> np.ndarray:
    """`mean_errors` of the best setting of some starts for each number of sweeps."""
    names = best_settings(scenes, starts, where)
    return np.column_stack([mean_errors(scenes, name, where)[:, i] for i, name in enumerate(names)])


def ratios_of(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Ratio of the means over scenes of two errors, (scenes,) or (scenes, k), with its interval, (3,) or (k, 3)."""
    one, other = np.asarray(one), np.asarray(other)
    return interval(lambda drawn: one[drawn].mean(axis=1) / other[drawn].mean(axis=1), len(one)).T


def ratios_to_best(scenes: Sequence[Mapping], start: str, where: str = "all") -> np.ndarray:
    """`ratios_of` a start with its best solver to the best classical setting."""
    return ratios_of(best_errors(scenes, [start], where), best_errors(scenes, CLASSICAL, where))


def text_of(ratio: Sequence[float], digits: int = 2) -> str:
    """A ratio with its interval as text."""
    return "{:.{d}f} ({:.{d}f}–{:.{d}f})".format(*ratio, d=digits)


# ---- times of starts and sweeps ----


def from_rows(start: WarmStart, state: State) -> Callable[[], object]:
    """What makes the impulses of a start from rows that have been built, as a run has them."""
    rows, make = ([step_problem(state)], start.from_problem) if hasattr(start, "from_problem") else ([], start)
    return partial(make, state, PGS(), *rows)


def sweep_times(state: State, solvers: Iterable[str], counts: tuple[int, int], repeats: int) -> dict:
    """Solver -> (time of a sweep, time of none), s, by two numbers of sweeps."""
    swept = {name: lambda k, name=name: solve_contacts(state, solver=fixed(name, k)) for name in solvers}
    return {name: timing.line(solve, *counts, repeats=repeats) for name, solve in swept.items()}


def stages_of(start: WarmStart, state: State) -> dict[str, Callable[[], object]]:
    """The stages of a start as calls that need none of each other: "splat", "network" and "gather", whose result it is.

    The solution that SPH transfers is known, and rows have been built. A start without an image has no stages.
    """
    if isinstance(start, Sph):
        impulses = np.column_stack(solved_impulses(state, PGS()))
        image = start.splat(state, impulses)
        return {"splat": lambda: start.splat(state, impulses), "gather": lambda: start.gather(state, image)}
    if not hasattr(start, "model"):
        return {}
    model, splat = start.model, partial(start.model.seen, state, step_problem(state))
    image, read = splat()
    out = model.run(image)
    gather = lambda: projected(*read(out), state.world.friction)  # noqa: E731
    return {"splat": splat, "network": partial(model.run, image), "gather": gather}


# ---- time to an error on the same states: Figure 6.10 ----

TIMED = [
    *settings_with(["none"], [BASE]),
    *settings_with(["builtin"], ["PGS", BASE, "NNCG", "NesterovPGS"]),
    *settings_with(["scaled", LEARNED], [BASE, "NNCG", "NesterovPGS"]),
]
"""The settings whose time to an error is measured."""


def errors_of_pile(task: Mapping) -> tuple[dict, list[State]]:
    """Errors of `TIMED` by sweeps on states of one pile, and those states that have a reference.

    task: "circles", "kind", "seed", "starts": name -> description, "states" and "every" of the pile, "sweeps",
    "past_need": sweeps from each start to the references, "exact": numbers of circles whose references are exact.
    """
    starts, used, errors = {name: start_of(one) for name, one in task["starts"].items()}, [], []
    far = [method(sweeps=task["past_need"], tolerance=1e-9) for method in (PGS, NNCG)]
    start = piles.pile(task["kind"], task["circles"], task["seed"])
    for state in piles.states_of(start, count=task["states"], every=task["every"]):
        impulses = {name: start(state, PGS()) for name, start in starts.items()}
        ends = [solve(state, solver, *start) for start in impulses.values() for solver in far]
        if references := piles.references_from(state, ends, exact=task["circles"] in task["exact"]):
            used.append(state)
            errors.append(errors_of(state, impulses, TIMED, task["sweeps"], references))
    about = {"circles": task["circles"], "kind": task["kind"], "contacts": [s.contacts.count for s in used]}
    return about | {"errors": {name: [one[name] for one in errors] for name in TIMED}}, used


def times_on(states: Sequence[State], starts: Mapping[str, WarmStart], repeats: int) -> dict:
    """Seconds of every start on every state, whose rows are built before, and of a sweep of every solver of `TIMED` on
    the last state: the least of the repeats.
    """
    times = {name: [timing.fastest(from_rows(start, s), repeats) for s in states] for name, start in starts.items()}
    sweeps = {}
    if states:
        many = 10 + max(20, 400_000 // states[-1].contacts.count)
        swept = sweep_times(states[-1], sorted({parts_of(name)[1] for name in TIMED}), (10, many), repeats)
        sweeps = {name: a_sweep for name, (a_sweep, _) in swept.items()}
    return {"start_seconds": times, "sweep_seconds": sweeps}


def sweeps_to(errors: Sequence[float], sweeps: Sequence[int], error: float) -> float:
    """Sweeps after which an error stays within `error`, interpolated in its logarithm; infinite if it does not.

    errors: after each of `sweeps`, increasing.
    """
    above = np.flatnonzero(np.asarray(errors) > error)
    if above.size == 0:
        return float(sweeps[0])
    last = above[-1]
    if last == len(errors) - 1:
        return np.inf
    high, low = np.log(errors[last]), np.log(max(errors[last + 1], 1e-300))
    return float(sweeps[last] + (high - np.log(error)) / (high - low) * (sweeps[last + 1] - sweeps[last]))


def price_of(piles: Iterable[Mapping]) -> dict[str, float]:
    """Median time of the learned start on piles of one size, "ms", and "in sweeps" of PGS."""
    seconds = float(np.median(np.concatenate([pile["start_seconds"][LEARNED] for pile in piles])))
    a_sweep = float(np.median([pile["sweep_seconds"]["PGS"] for pile in piles]))
    return {"ms": 1e3 * seconds, "in sweeps": seconds / a_sweep}


def best_timed(
    piles: Iterable[Mapping], sweeps: Sequence[int], starts: Sequence[str], error: float
) -> tuple[str, np.ndarray]:
    """(Name, seconds to an error on each state) of the setting of some starts with the least median time.

    The time is infinite where the error is not reached, and there are no states where nothing was solved.
    """
    timed = {}
    for name, (start, solver) in zip(TIMED, map(parts_of, TIMED)):
        if start in starts:
            timed[name] = np.array([
                seconds + sweeps_to(errors, sweeps, error) * pile["sweep_seconds"][solver]
                for pile in piles
                for seconds, errors in zip(pile["start_seconds"][start], pile["errors"][name])
            ])  # fmt: skip
    return min(timed.items(), key=lambda one: np.median(one[1]) if one[1].size else np.inf)


def time_ratios(piles: Iterable[Mapping], sweeps: Sequence[int], error: float) -> np.ndarray:
    """Time of the learned start with its best solver over that of the best classical setting, state by state.

    0 where only the learned start reaches the error. Empty where neither does on half of the states.
    """
    (_, one), (_, other) = (best_timed(piles, sweeps, starts, error) for starts in ([LEARNED], CLASSICAL))
    done = np.isfinite(one) | np.isfinite(other)
    return one[done] / other[done] if 2 * done.sum() > done.size else np.empty(0)


def median_with_interval(ratios: np.ndarray) -> list[float] | None:
    """[median, low, high]; None from fewer than `FEWEST` states."""
    if ratios.size < FEWEST:
        return None
    return interval(lambda drawn: np.median(ratios[drawn], axis=1), ratios.size).tolist()
