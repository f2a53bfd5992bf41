"""When a start pays for itself: the velocity error against wall time, the start's own time included.

Starts are compared on the same states with the same solver. What a start costs is measured with the states as they
are, what a sweep costs on each pile, one thing at a time; the errors after each number of sweeps are counted, not
timed. The time to an error is then start + sweeps to it times cost of a sweep.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np

from deep_contact.physics import metrics
from deep_contact.physics.engine import solve
from deep_contact.physics.solvers import NNCG, PGS
from deep_contact.simulation import solve_contacts
from deep_contact.state import State
from deep_contact.studies.tradeoff import references_from

SOLVERS = {"PGS": PGS, "NNCG": NNCG}
"""Name -> method of the sweeps after the start."""


def errors_by_sweeps(
    state: State, starts: Mapping[str, object], *, sweeps: Sequence[int], past_need: int, exact: bool
) -> dict[str, dict[str, list[float]]]:
    """Errors of every start with every solver, {start: {solver: (len(sweeps),)}}, on a state with contacts.

    starts: name -> callable of `deep_contact.warm_start`. An error is the distance from the nearest of the references
    to which the courses of the solvers from each start lead, of `past_need` sweeps (`tradeoff.references_from`).
    Without any, {} is returned.
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
    found = {}
    for name, start in impulses.items():
        found[name] = {}
        for solver, method in SOLVERS.items():
            solutions = (solve(state, method(sweeps=k, tolerance=None), *start) for k in sweeps)
            off = [metrics.nearest_velocity_error(state, solution, references) for solution in solutions]
            found[name][solver] = [float(f"{value:.4g}") for value in off]
    return found


def start_times(states: Sequence[State], starts: Mapping[str, object], *, repeats: int) -> dict[str, list[float]]:
    """Seconds that each start takes on each state: the least of the repeats, after one that is not counted."""
    best = {name: [np.inf] * len(states) for name in starts}
    for i, state in enumerate(states):
        for name, start in starts.items():
            start(state, PGS())
            for _ in range(repeats):
                begin = time.perf_counter()
                start(state, PGS())
                best[name][i] = min(best[name][i], time.perf_counter() - begin)
    return best


def sweep_times(state: State, *, repeats: int) -> dict[str, float]:
    """Seconds of one sweep of each solver on a state's contacts, from the difference of many and few sweeps."""
    few, many = 10, 10 + max(20, 400_000 // state.contacts.count)
    found = {}
    for name, method in SOLVERS.items():
        best = {few: np.inf, many: np.inf}
        for _ in range(repeats + 1):
            for k in best:
                begin = time.perf_counter()
                solve_contacts(state, solver=method(sweeps=k, tolerance=None))
                best[k] = min(best[k], time.perf_counter() - begin)
        found[name] = (best[many] - best[few]) / (many - few)
    return found


def sweeps_to(found: Sequence[float], sweeps: Sequence[int], error: float) -> float:
    """Sweeps after which an error stays within `error`, between the counts by the logarithm; infinite if it does not.

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
