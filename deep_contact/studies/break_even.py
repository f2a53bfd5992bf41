"""When a start pays for itself: the velocity error against wall time, including the start's own time.

Starts are compared on the same states with the same solver. The time of a start is measured on each state, the time of
a sweep on each pile; the errors after each number of sweeps are counted. The time to an error is then
start + sweeps to it × time of a sweep.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from deep_contact.physics import metrics
from deep_contact.physics.engine import solve
from deep_contact.physics.solvers import NNCG, PGS
from deep_contact.simulation import solve_contacts
from deep_contact.state import State
from deep_contact.studies import timing
from deep_contact.studies.tradeoff import pile, references_from, states_of

SOLVERS = {"PGS": PGS, "NNCG": NNCG}
"""Name -> method of the sweeps after the start."""

FEWEST, SAMPLES = 10, 1000
"""Fewest states that decide a win, and samples of them for its interval (bootstrap)."""


def errors_by_sweeps(
    state: State, starts: Mapping[str, object], *, sweeps: Sequence[int], past_need: int, exact: bool
) -> dict[str, dict[str, list[float]]]:
    """Errors of every start with every solver, {start: {solver: (len(sweeps),)}}, on a state with contacts.

    starts: name -> callable of `deep_contact.warm_start`. An error is the distance to the nearest of the references
    that `past_need` sweeps of each solver from each start lead to (`tradeoff.references_from`). Without references, {}
    is returned.
    """
    impulses = {name: start(state, PGS()) for name, start in starts.items()}
    ends = [
        solve(state, method(sweeps=past_need, tolerance=1e-9), *start)
        for start in impulses.values()
        for method in SOLVERS.values()
    ]
    references = references_from(state, ends, exact=exact)
    if not references:
        return {}

    def error(method, k, start):
        solution = solve(state, method(sweeps=k, tolerance=None), *start)
        return float(f"{metrics.nearest_velocity_error(state, solution, references):.4g}")

    return {
        name: {solver: [error(method, k, start) for k in sweeps] for solver, method in SOLVERS.items()}
        for name, start in impulses.items()
    }


def start_times(states: Sequence[State], starts: Mapping[str, object], *, repeats: int) -> dict[str, list[float]]:
    """Seconds that each start takes on each state: the least of the repeats, after a warm-up run."""
    return {
        name: [timing.fastest(lambda: start(state, PGS()), repeats) for state in states]  # noqa: B023
        for name, start in starts.items()
    }


def sweep_times(state: State, *, repeats: int) -> dict[str, float]:
    """Seconds of one sweep of each solver on a state's contacts, from the difference of many and few sweeps."""

    def solved(method):
        return lambda k: solve_contacts(state, solver=method(sweeps=k, tolerance=None))

    m = state.contacts.count
    return {name: timing.sweep_time(solved(method), m, repeats=repeats) for name, method in SOLVERS.items()}


def measure_pile(circles: int, kind: str, seed: int, starts: Mapping[str, object], options: Mapping) -> dict:
    """Errors of every start by sweeps on states of one pile, and the times of starts and sweeps.

    options: "states" and "every" of the pile, "sweeps", "past_need", "exact": numbers of circles, "repeats".
    """
    states = states_of(pile(kind, circles, seed), count=options["states"], every=options["every"])
    settings = {name: options[name] for name in ("sweeps", "past_need")} | {"exact": circles in options["exact"]}
    found = [errors_by_sweeps(state, starts, **settings) for state in states]
    return {
        "circles": circles,
        "kind": kind,
        "contacts": float(np.mean([state.contacts.count for state in states])),
        "used": [i for i, errors in enumerate(found) if errors],
        "errors": [errors for errors in found if errors],
        "start_seconds": start_times(states, starts, repeats=options["repeats"]),
        "sweep_seconds": sweep_times(states[-1], repeats=options["repeats"]),
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


# ---- data of Figure 6.10: {"sweeps", "piles": [`measure_pile`, …]} ----


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


def ratios(data: Mapping, circles: int, kind: str, start: str, solver: str, error: float) -> np.ndarray:
    """Time from a learned start over the time from Builtin, on each state where either reaches the error.

    0 where only the learned start does. Empty where neither does on half of the states.
    """
    one, other = (seconds_to(data, circles, kind, name, solver, error) for name in (start, "builtin"))
    done = np.isfinite(one) | np.isfinite(other)
    return one[done] / other[done] if 2 * done.sum() > done.size else np.empty(0)


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
