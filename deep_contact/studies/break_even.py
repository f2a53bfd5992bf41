"""When a start pays for itself: the velocity error against wall time, including the start's own time.

Settings, a start with a solver, are compared on the same states. The time of a start is measured on each state, the
time of a sweep on each pile; the errors after each number of sweeps are counted. The time to an error is then
start + sweeps to it × time of a sweep. A learned start is held against the best classical setting: for each number of
circles, kind of pile and error, the one with the least median time. The learned start may choose its solver as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from deep_contact.physics import metrics
from deep_contact.physics.engine import solve, step_problem
from deep_contact.physics.solvers import NNCG, PGS, PSOR, NesterovPGS
from deep_contact.simulation import solve_contacts
from deep_contact.state import State
from deep_contact.studies import timing
from deep_contact.studies.piles import pile, references_from, states_of

SOLVERS = {
    "PGS": PGS(),
    "PSOR": PSOR(omega=1.75, friction_omega=1.45),
    "NNCG": NNCG(),
    "NesterovPGS": NesterovPGS(),
}
"""Name -> method of the sweeps after the start."""

CLASSICAL = {
    "none": ("PSOR",),
    "builtin": ("PGS", "PSOR", "NNCG", "NesterovPGS"),
    "scaled": ("PSOR", "NNCG", "NesterovPGS"),
}
LEARNED = {"far field": ("PSOR", "NNCG", "NesterovPGS")}
"""Start -> the solvers that follow it."""

FEWEST, SAMPLES = 10, 1000
"""Fewest states that decide a win, and samples of them for its interval (bootstrap)."""


def errors_by_sweeps(
    state: State,
    starts: Mapping[str, object],
    *,
    settings: Mapping[str, Sequence[str]] = CLASSICAL | LEARNED,
    sweeps: Sequence[int],
    past_need: int,
    exact: bool,
) -> dict[str, dict[str, list[float]]]:
    """Errors of every setting, {start: {solver: (len(sweeps),)}}, on a state with contacts.

    starts: name -> callable of `deep_contact.warm_start`. settings: start -> the solvers that follow it. An error is
    the distance to the nearest of the references that `past_need` sweeps of NNCG and of PGS from each start lead to
    (`piles.references_from`). Without references, {} is returned.
    """
    impulses = {name: start(state, PGS()) for name, start in starts.items()}
    ends = [
        solve(state, method(sweeps=past_need, tolerance=1e-9), *start)
        for start in impulses.values()
        for method in (PGS, NNCG)
    ]
    references = references_from(state, ends, exact=exact)
    if not references:
        return {}

    def error(solver, k, start):
        solution = solve(state, replace(SOLVERS[solver], sweeps=k, tolerance=None), *start)
        return float(f"{metrics.nearest_velocity_error(state, solution, references):.4g}")

    return {
        name: {solver: [error(solver, k, start) for k in sweeps] for solver in settings[name]}
        for name, start in impulses.items()
    }


def start_times(states: Sequence[State], starts: Mapping[str, object], *, repeats: int) -> dict[str, list[float]]:
    """Seconds that each start takes on each state, whose rows have been built: the least of the repeats."""
    found = {name: [] for name in starts}
    for state in states:
        problem = step_problem(state)
        for name, start in starts.items():

            def call(start=start, state=state, problem=problem):
                if hasattr(start, "from_problem"):
                    return start.from_problem(state, PGS(), problem)
                return start(state, PGS())

            found[name].append(timing.fastest(call, repeats))
    return found


def sweep_times(state: State, *, repeats: int) -> dict[str, float]:
    """Seconds of one sweep of each solver on a state's contacts, from the difference of many and few sweeps."""

    def solved(method):
        return lambda k: solve_contacts(state, solver=replace(method, sweeps=k, tolerance=None))

    m = state.contacts.count
    return {name: timing.sweep_time(solved(method), m, repeats=repeats) for name, method in SOLVERS.items()}


def errors_of_pile(task: Mapping) -> dict:
    """Errors of every setting by sweeps on states of one pile.

    task: "circles", "kind", "seed", "starts": name -> description of `held_out.start_of`, "states" and "every" of the
    pile, "sweeps", "past_need", "exact": numbers of circles that are solved exactly.
    """
    from deep_contact.studies.held_out import start_of

    starts = {name: start_of(description) for name, description in task["starts"].items()}
    settings = {name: task[name] for name in ("sweeps", "past_need")} | {"exact": task["circles"] in task["exact"]}
    states = states_of_pile(task)
    found = [errors_by_sweeps(state, starts, **settings) for state in states]
    return {
        "circles": task["circles"],
        "kind": task["kind"],
        "contacts": float(np.mean([state.contacts.count for state in states])),
        "used": [i for i, errors in enumerate(found) if errors],
        "errors": [errors for errors in found if errors],
    }


def states_of_pile(task: Mapping) -> list[State]:
    """The states of a task of `errors_of_pile`."""
    return states_of(pile(task["kind"], task["circles"], task["seed"]), count=task["states"], every=task["every"])


def times_of_pile(task: Mapping, starts: Mapping[str, object], repeats: int) -> dict:
    """Times of the starts and sweeps on the states of one pile; nothing else may run beside it."""
    states = states_of_pile(task)
    return {
        "start_seconds": start_times(states, starts, repeats=repeats),
        "sweep_seconds": sweep_times(states[-1], repeats=repeats),
    }


def sweeps_to(found: Sequence[float], sweeps: Sequence[int], error: float) -> float:
    """Sweeps after which an error stays within `error`, interpolated in its logarithm; infinite if it does not.

    found: errors after each of `sweeps`, increasing.
    """
    off = np.asarray(found, dtype=np.float64)
    above = np.flatnonzero(~(off <= error))
    if above.size == 0:
        return float(sweeps[0])
    last = int(above[-1])
    if last == len(off) - 1:
        return np.inf
    high, low = np.log(off[last]), np.log(max(off[last + 1], 1e-300))
    share = (high - np.log(error)) / (high - low) if high > low else 1.0
    return float(sweeps[last] + share * (sweeps[last + 1] - sweeps[last]))


# ---- data of Figure 6.10: {"sweeps", "piles": [`errors_of_pile` | `times_of_pile`, …]} ----


def piles_of(data: Mapping, **values) -> list[dict]:
    """The piles with these values, such as circles=100, kind="settling"."""
    return [pile for pile in data["piles"] if all(pile[name] == value for name, value in values.items())]


def costs_of(piles: Sequence[Mapping], start: str) -> tuple[float, float]:
    """Median seconds of a start and of a sweep of PGS on some piles."""
    seconds = np.concatenate([pile["start_seconds"][start] for pile in piles])
    return float(np.median(seconds)), float(np.median([pile["sweep_seconds"]["PGS"] for pile in piles]))


def seconds_to(data: Mapping, circles: int, kind: str, start: str, solver: str, error: float) -> np.ndarray:
    """Seconds to an error on each state of the piles of a kind and size; infinite where it is not reached."""
    return np.array(
        [
            pile["start_seconds"][start][i]
            + sweeps_to(errors[start][solver], data["sweeps"], error) * pile["sweep_seconds"][solver]
            for pile in piles_of(data, circles=circles, kind=kind)
            for i, errors in zip(pile["used"], pile["errors"])
        ]
    )


def best_setting(
    data: Mapping, circles: int, kind: str, settings: Mapping, error: float
) -> tuple[str, str, np.ndarray] | None:
    """(start, solver, seconds to the error on each state) of the setting with the least median; None without states.

    settings: start -> solvers, such as `CLASSICAL`.
    """
    found = [
        (start, solver, seconds_to(data, circles, kind, start, solver, error))
        for start, solvers in settings.items()
        for solver in solvers
    ]
    return min(found, key=lambda one: np.median(one[2])) if found[0][2].size else None


def ratios(data: Mapping, circles: int, kind: str, start: str, error: float) -> np.ndarray:
    """Time from a learned start with its best solver over that of the best classical setting, on each state where
    either reaches the error.

    0 where only the learned start does. Empty where neither does on half of the states.
    """
    one = best_setting(data, circles, kind, {start: LEARNED[start]}, error)
    other = best_setting(data, circles, kind, CLASSICAL, error)
    if one is None or other is None:
        return np.empty(0)
    done = np.isfinite(one[2]) | np.isfinite(other[2])
    return one[2][done] / other[2][done] if 2 * done.sum() > done.size else np.empty(0)


def median_ratio(*case) -> float | None:
    """Median of `ratios`; None where there are none."""
    found = ratios(*case)
    return float(np.median(found)) if found.size else None


def interval(*case) -> list[float] | None:
    """95 % interval of the median of `ratios`, None with fewer than `FEWEST` states."""
    found = ratios(*case)
    if found.size < FEWEST:
        return None
    chosen = np.random.default_rng(0).integers(0, found.size, (SAMPLES, found.size))
    medians = np.sort(np.median(found[chosen], axis=1))
    return [float(medians[round(share * (SAMPLES - 1))]) for share in (0.025, 0.975)]
