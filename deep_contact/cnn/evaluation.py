"""Errors of starts on held-out states: of the velocities after a few solver sweeps, by phase, and of the impulses.

A start is the vector of impulses λ₀ from which the contact solver begins.

Tests: tests/cnn/test_inference.py, tests/cnn/test_through_solver.py, tests/studies/test_chapter_5.py
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from deep_contact.cnn.dataset import PHASES, phase
from deep_contact.solvers import PGS
from deep_contact.state.checks import check_solution
from deep_contact.state.state import State
from deep_contact.stepping.metrics import velocity_error
from deep_contact.stepping.problem import solve

SWEEPS = (0, 3, 10, 30)
"""Numbers of sweeps after which errors are measured."""

BASELINES = {
    "none": lambda state, solver: (np.zeros(state.contacts.count), np.zeros(state.contacts.count)),
    "builtin": lambda state, solver: (state.contacts.normal_start, state.contacts.tangent_start),
}
"""Name -> function (state, solver) -> (λ_n, λ_t), for two starts that need no network.

"none" is zero impulses, and "builtin" is the impulses of the step before. They equal `NoStart` and `Builtin` of
`warm_start`, which this folder may not import.
"""


def velocity_errors(state: State, start: tuple[np.ndarray, np.ndarray], sweeps: Sequence[int] = SWEEPS) -> np.ndarray:
    """Return the relative velocity errors (`metrics.velocity_error`) after some sweeps of PGS, (len(sweeps),).

    The error compares v, the velocities after the sweeps, with v*, the velocities that the impulses of the solved state
    give. It is infinite if v* equals v⁻, the velocities without impulses, and v does not.
    state: a solved state. start: impulses before the first sweep, (λ_n, λ_t), (m,) each, N·s. sweeps: numbers of sweeps
    after which the error is measured. Raises ValueError on a state that is not solved.
    """
    check_solution(state)

    def swept(count, normal, tangent):
        return solve(state, PGS(sweeps=count, tolerance=None), np.asarray(normal), np.asarray(tangent))

    reference = swept(0, state.contacts.normal_impulse, state.contacts.tangent_impulse)
    return np.array([velocity_error(state, swept(k, *start), reference) for k in sweeps])


def start_quality(states: Iterable[State], start, *, sweeps: Sequence[int] = SWEEPS) -> dict[str, float]:
    """Measure the errors of a start's impulses λ₀ against the solved impulses λ, over all states together.

    states: solved states with contacts. start: function (state, solver) -> (λ_n, λ_t), N·s. sweeps: numbers of sweeps k
    after which velocity errors are measured. Returns a dict with

    * impulse_error, ‖λ₀ − λ‖ / ‖λ‖;
    * factor, s = λ₀·λ / λ₀·λ₀, by which λ₀ fits best; 0 if λ₀ is zero everywhere;
    * scaled_error, ‖s λ₀ − λ‖ / ‖λ‖;
    * correlation of the normal impulses of λ₀ and λ; 0 if λ₀ is zero everywhere;
    * velocity_error and velocity_error_k, the means of `velocity_errors` over the states, before the first sweep and
      after k sweeps.

    The means leave out states whose ‖λ‖ is at most a thousandth of the median ‖λ‖. In such states the impulses change
    the velocities by hardly more than rounding errors.
    """
    pairs, errors = [], []
    for state in states:
        made = start(state, state.solver)
        pairs.append([made, (state.contacts.normal_impulse, state.contacts.tangent_impulse)])
        errors.append(velocity_errors(state, made, sweeps))
    ours, solved = (np.concatenate([np.stack(pair[side]) for pair in pairs], axis=1) for side in (0, 1))
    factor = float(np.sum(ours * solved) / max(np.sum(ours**2), np.finfo(float).tiny))
    off = {"impulse_error": ours - solved, "scaled_error": factor * ours - solved}
    quality = {name: float(np.linalg.norm(value) / np.linalg.norm(solved)) for name, value in off.items()}
    correlation = float(np.corrcoef(ours[0], solved[0])[0, 1]) if np.ptp(ours[0]) else 0.0
    quality |= {"factor": factor, "correlation": correlation}
    sizes = np.array([np.linalg.norm(pair[1]) for pair in pairs])
    means = np.array(errors)[sizes > 1e-3 * np.median(sizes)].mean(axis=0).tolist()
    return quality | {f"velocity_error_{k}" if k else "velocity_error": error for k, error in zip(sweeps, means)}


def held_out_errors(
    states: Iterable[State], starts: Mapping[str, object], *, sweeps: Sequence[int] = SWEEPS
) -> dict[str, dict]:
    """Return the mean and median velocity errors of several starts on the same states, by phase.

    states: solved states. starts: name -> function (state, solver) -> (λ_n, λ_t), N·s. sweeps: numbers of sweeps after
    which the errors are measured. Returns a dict that JSON can hold: {"sweeps": `sweeps`, "phases": phase -> {"states":
    number of states, name of a start -> {"mean": errors, "median": errors}}}. Each list of errors has one number for
    each of `sweeps`. The phases are `PHASES` and "all". States in which an error is not finite are left out, because
    there is nothing to solve in them.
    """
    by_phase: dict[str, list] = {name: [] for name in PHASES}
    for state in states:
        errors = [velocity_errors(state, start(state, state.solver), sweeps) for start in starts.values()]
        if np.isfinite(errors).all():
            by_phase[phase(state)].append(errors)
    by_phase["all"] = [errors for name in PHASES for errors in by_phase[name]]
    summary = {}
    for name, errors in by_phase.items():
        summary[name] = {"states": len(errors)}
        for start, values in zip(starts, np.moveaxis(np.array(errors), 1, 0) if errors else ()):
            means = {"mean": values.mean(axis=0), "median": np.median(values, axis=0)}
            summary[name][start] = {kind: [float(f"{x:.4g}") for x in numbers] for kind, numbers in means.items()}
    return {"sweeps": list(sweeps), "phases": summary}
