"""What a start is worth on held-out states: the velocity error that is left after few sweeps, by phase of the run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from deep_contact.cnn.dataset import PHASES, phase
from deep_contact.physics.engine import ContactSolution, solve
from deep_contact.physics.methods import PGS
from deep_contact.state import Bodies, State

SWEEPS = (0, 3, 10, 30)


def velocity_errors(state: State, start: tuple[np.ndarray, np.ndarray], sweeps: Sequence[int] = SWEEPS) -> np.ndarray:
    """‖v − v*‖ / ‖v* − v⁻‖ after so many PGS sweeps from a start, (len(sweeps),).

    v*: velocities by the impulses that the solved state holds; v⁻: without impulses. The norm is that of kinetic
    energy, spin included. Infinite where v* = v⁻ but v differs; 0 where it does not. Raises ValueError on a state
    that is not solved.
    """
    if state.contacts is None or not state.solved:
        raise ValueError("state.solved: expected a state that holds its solution, got False")
    contacts, zero = state.contacts, np.zeros(state.contacts.count)
    goal = _after(state, 0, contacts.normal_impulse, contacts.tangent_impulse)
    size = _distance(state.bodies, goal, _after(state, 0, zero, zero))
    off = np.array([_distance(state.bodies, _after(state, k, *start), goal) for k in sweeps])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(off == 0, 0.0, off / size)


def held_out_errors(
    states: Iterable[State], starts: Mapping[str, object], *, sweeps: Sequence[int] = SWEEPS
) -> dict[str, dict]:
    """Mean velocity errors of several starts on the same states, for each phase and for "all" (JSON-ready).

    starts: name -> callable of `deep_contact.warm_start`. Returned: phase -> {"states": number, name -> {"mean",
    "median"}: one number for each of `sweeps`}. States without a finite error (nothing to solve) are left out.
    """
    found: dict[str, list] = {name: [] for name in PHASES}
    for state in states:
        errors = [velocity_errors(state, start(state, state.solver), sweeps) for start in starts.values()]
        if np.isfinite(errors).all():
            found[phase(state)].append(errors)
    found["all"] = [errors for name in PHASES for errors in found[name]]
    summary = {}
    for name, errors in found.items():
        summary[name] = {"states": len(errors)}
        if errors:
            values = np.array(errors)
            for i, start in enumerate(starts):
                mean, median = values[:, i].mean(axis=0), np.median(values[:, i], axis=0)
                summary[name][start] = {"mean": _rounded(mean), "median": _rounded(median)}
    return {"sweeps": list(sweeps), "phases": summary}


def _after(state: State, sweeps: int, normal, tangent) -> ContactSolution:
    return solve(state, PGS(sweeps=sweeps, tolerance=None), np.asarray(normal), np.asarray(tangent))


def _distance(bodies: Bodies, one: ContactSolution, other: ContactSolution) -> float:
    v = one.velocities - other.velocities
    w = one.angular_velocities - other.angular_velocities
    return float(np.sqrt(np.sum(bodies.mass * np.sum(v * v, axis=1) + bodies.inertia * w * w)))


def _rounded(values) -> list[float]:
    return [float(f"{value:.4g}") for value in values]
