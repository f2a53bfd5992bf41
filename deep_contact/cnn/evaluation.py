"""Velocity errors of starts on held-out states, after few sweeps, by phase of the run."""

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

BASELINES = {
    "none": lambda state, solver: (np.zeros(state.contacts.count), np.zeros(state.contacts.count)),
    "builtin": lambda state, solver: (state.contacts.normal_start, state.contacts.tangent_start),
}
"""Name -> start without a network: `NoStart` and `Builtin` of `warm_start`, which this folder does not import."""


def velocity_errors(state: State, start: tuple[np.ndarray, np.ndarray], sweeps: Sequence[int] = SWEEPS) -> np.ndarray:
    """`metrics.velocity_error` after each number of `sweeps` of PGS from a start, (len(sweeps),).

    The reference velocities v* are those by the impulses of the solved state. The error is infinite where v* = v⁻
    but v differs. Raises ValueError on a state that is not solved.
    """
    check_solution(state)

    def swept(count, normal, tangent):
        return solve(state, PGS(sweeps=count, tolerance=None), np.asarray(normal), np.asarray(tangent))

    reference = swept(0, state.contacts.normal_impulse, state.contacts.tangent_impulse)
    return np.array([velocity_error(state, swept(k, *start), reference) for k in sweeps])


def start_quality(states: Iterable[State], start, *, sweeps: Sequence[int] = SWEEPS) -> dict[str, float]:
    """Errors of a start's impulses λ₀ against the λ of solved states with contacts, over all states together.

    Returns a dict with

    * impulse_error, ‖λ₀ − λ‖ / ‖λ‖;
    * factor, s = λ₀·λ / λ₀·λ₀, by which λ₀ fits best; 0 if λ₀ is zero everywhere;
    * scaled_error, ‖s λ₀ − λ‖ / ‖λ‖;
    * correlation of the normal impulses of λ₀ and λ; 0 if λ₀ is zero everywhere;
    * velocity_error and velocity_error_k, the means of `velocity_errors` before the first sweep and after k of
      `sweeps`.

    The velocity errors leave out states whose ‖λ‖ is below a thousandth of the median: there v* is v⁻ but for rounding.
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
    """Mean and median velocity errors of several starts on the same states, by phase and for "all", as JSON holds them.

    starts: name -> callable of `deep_contact.warm_start`. Returns {"sweeps", "phases": phase -> {"states": number,
    name -> {"mean", "median"}: one number for each of `sweeps`}}. States without a finite error, in which there is
    nothing to solve, are left out.
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
