"""What a start is worth on held-out states: the velocity error that is left after few sweeps, by phase of the run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from deep_contact.cnn.dataset import PHASES, phase
from deep_contact.constants import THETA_TOLERANCE
from deep_contact.physics.engine import ContactSolution, solve
from deep_contact.physics.solvers import PGS
from deep_contact.simulation import simulate
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


def errors_on_scene(
    scene: State,
    starts: Mapping[str, object],
    *,
    steps: int = 600,
    every: int = 5,
    sweeps: Sequence[int] = (0, 3, 10, 30, 100),
    threshold: float = THETA_TOLERANCE,
    most: int = 5000,
) -> dict[str, np.ndarray]:
    """What several starts are worth on the states of one run, all on the same ones.

    The run starts from Builtin and solves to `threshold`, as the training data did; one state in `every` step that
    has contacts is judged against a solution of its own, to θ < 1e-9 N·s or 20,000 sweeps from the run's.
    starts: name -> callable of `deep_contact.warm_start`; "builtin" has to be among them.
    Returns {"step": (k,), "sweeps": {name: (k,) sweeps until θ ≤ threshold, at most `most`}, "errors": {name:
    (k, len(sweeps)) velocity errors as in `velocity_errors`}}.
    """
    states: list[State] = []

    def keep(state: State, record) -> None:
        if state.step % every == 0 and state.contacts.count:
            states.append(state)

    simulate(scene, steps=steps, solver=PGS(sweeps=most, tolerance=threshold), on_step=keep)
    to_threshold = PGS(sweeps=most, tolerance=threshold)
    found: dict = {"step": [], "sweeps": {n: [] for n in starts}, "errors": {n: [] for n in starts}}
    for state in states:
        contacts = state.contacts
        exact = solve(state, PGS(sweeps=20_000, tolerance=1e-9), contacts.normal_impulse, contacts.tangent_impulse)
        contacts = contacts._replace(normal_impulse=exact.normal_impulses, tangent_impulse=exact.tangent_impulses)
        state = state.replace(contacts=contacts)
        given = {name: start(state, to_threshold) for name, start in starts.items()}
        errors = {name: velocity_errors(state, impulses, sweeps) for name, impulses in given.items()}
        if not all(np.isfinite(error).all() for error in errors.values()):
            continue  # contacts without anything to solve
        found["step"].append(state.step)
        for name, impulses in given.items():
            found["errors"][name].append(errors[name])
            found["sweeps"][name].append(solve(state, to_threshold, *impulses).record.sweeps)
    return {
        "step": np.array(found["step"]),
        "sweeps": {name: np.array(counts) for name, counts in found["sweeps"].items()},
        "errors": {name: np.array(errors).reshape(-1, len(sweeps)) for name, errors in found["errors"].items()},
    }
