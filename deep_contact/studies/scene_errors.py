"""Starts on the states of one run: sweeps to a threshold, and velocity errors after few sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from deep_contact.cnn.evaluation import velocity_errors
from deep_contact.constants import THETA_TOLERANCE
from deep_contact.physics.engine import solve
from deep_contact.physics.solvers import PGS
from deep_contact.simulation import simulate
from deep_contact.state import State


def errors_on_scene(
    scene: State,
    starts: Mapping[str, object],
    *,
    solvers: Mapping[str, object] | None = None,
    steps: int = 600,
    every: int = 5,
    sweeps: Sequence[int] = (0, 3, 10, 30, 100),
    threshold: float = THETA_TOLERANCE,
    most: int = 5000,
) -> dict[str, np.ndarray]:
    """Errors of several starts on the same states of one run, one state in `every` step that has contacts.

    The run starts from Builtin and solves to `threshold`, as the training data did. The reference solution of each
    state goes on from the run's, to θ < 1e-9 N·s or by 20,000 sweeps.
    starts: name -> callable of `deep_contact.warm_start`; "builtin" has to be among them. solvers: name of a start
    -> those that it is followed by, name -> method; by default PGS alone. A setting's name is that of its start if its
    solver is PGS, otherwise both: "builtin, NNCG".
    Returns {"step": (k,), "sweeps": {setting: (k,) sweeps until θ ≤ threshold, at most `most`}, "errors": {setting:
    (k, len(sweeps)), `cnn.evaluation.velocity_errors`}}.
    """
    solvers = solvers or {}
    settings = {
        name if solver == "PGS" else f"{name}, {solver}": (name, method)
        for name in starts
        for solver, method in solvers.get(name, {"PGS": PGS()}).items()
    }
    states: list[State] = []

    def keep(state: State, record) -> None:
        if state.step % every == 0 and state.contacts.count:
            states.append(state)

    to_threshold = PGS(sweeps=most, tolerance=threshold)
    simulate(scene, steps=steps, solver=to_threshold, on_step=keep)
    found: dict = {"step": [], "sweeps": {n: [] for n in settings}, "errors": {n: [] for n in settings}}
    for state in states:
        contacts = state.contacts
        exact = solve(state, PGS(sweeps=20_000, tolerance=1e-9), contacts.normal_impulse, contacts.tangent_impulse)
        contacts = contacts._replace(normal_impulse=exact.normal_impulses, tangent_impulse=exact.tangent_impulses)
        state = state.replace(contacts=contacts)
        given = {name: start(state, to_threshold) for name, start in starts.items()}
        errors = {
            name: velocity_errors(state, given[start], sweeps, solver=solver)
            for name, (start, solver) in settings.items()
        }
        if not all(np.isfinite(error).all() for error in errors.values()):
            continue  # contacts without anything to solve
        found["step"].append(state.step)
        for name, (start, solver) in settings.items():
            found["errors"][name].append(errors[name])
            enough = replace(solver, sweeps=most, tolerance=threshold)
            found["sweeps"][name].append(solve(state, enough, *given[start]).record.sweeps)
    return {
        "step": np.array(found["step"]),
        "sweeps": {name: np.array(counts) for name, counts in found["sweeps"].items()},
        "errors": {name: np.array(errors).reshape(-1, len(sweeps)) for name, errors in found["errors"].items()},
    }
