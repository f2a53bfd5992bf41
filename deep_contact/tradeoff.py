"""The trade of speed for accuracy: what the study measures. `scripts/tradeoff.py` runs it, `recommend` reads it.

Piles are falling, settling or resting. Every setting (method, precision, start) solves the same states of a pile with
every budget, a number of sweeps or a tolerance; its errors are held against a reference (`physics.errors`). What a
budget costs in time is measured apart, one thing at a time, as overhead + cost a contact and sweep.
Tolerances are in units of a mean circle's impulse of weight, m g Δt, so that they mean the same in another scene.
With friction a pile of a thousand circles has many solutions, and which one is found depends on the method
(`physics.errors`). So every method is run far past need from the state's start, and an error is the distance from the
nearest of these solutions.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from deep_contact import peers
from deep_contact.experiments import solved_states
from deep_contact.physics import errors
from deep_contact.physics.engine import ContactSolution
from deep_contact.physics.methods import NNCG, PGS, SoftSteps
from deep_contact.physics.scenes import circles_in_box, lattice_in_box
from deep_contact.recommendation import solver_of, weight_impulse
from deep_contact.simulation import ready, simulate, solve_contacts
from deep_contact.state import State

KINDS = ("falling", "settling", "resting")
ENOUGH = 1e-3
"""Residual within which a solution is taken for a reference, m/s: a hundredth of what gravity does in a step."""

SETTLING_SPEED, RESTING_SPEED = 0.5, 0.05
"""Root mean square speeds below which a pile settles and rests, m/s."""

MOST_STEPS = 2000
"""Steps after which a pile is taken as it is."""

SETTINGS = {
    "PGS": {"method": "PGS"},
    "PGS, no start": {"method": "PGS", "start": "none"},
    "PGS, single": {"method": "PGS", "precision": "single"},
    "PSOR 1.3": {"method": "PSOR", "omega": 1.3},
    "PSOR 1.5": {"method": "PSOR", "omega": 1.5},
    "PSOR adaptive": {"method": "PSOR", "omega": 1.0, "adaptive": True},
    "SymmetricPGS": {"method": "SymmetricPGS"},
    "NNCG": {"method": "NNCG"},
    "NNCG, no start": {"method": "NNCG", "start": "none"},
    "NNCG, single": {"method": "NNCG", "precision": "single"},
    "APGD": {"method": "APGD"},
}
"""Name -> options of the method, and the start where it is not Builtin."""


def scene(n_bodies: int, seed: int) -> State:
    """The thesis's scene for 100 circles and fewer, otherwise a loose lattice to be dropped."""
    return circles_in_box(n_bodies, seed=seed) if n_bodies <= 100 else lattice_in_box(n_bodies, seed=seed)


def pile(kind: str, n_bodies: int, seed: int) -> State:
    """The pile at its moment: falling, with a contact for every circle; settling; or resting (by rms speed)."""
    if kind not in KINDS:
        raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    state = scene(n_bodies, seed)
    for _ in range(MOST_STEPS // 10):
        state = simulate(state, steps=10, solver=NNCG(sweeps=300)).state
        speed = float(np.sqrt(np.mean((state.bodies.velocity**2).sum(axis=1))))
        if state.contacts.count < n_bodies:
            continue
        if kind == "falling" or speed < (SETTLING_SPEED if kind == "settling" else RESTING_SPEED):
            break
    return state


def states_of(start: State, *, count: int, every: int = 4) -> list[State]:
    """So many solved states of the run that goes on from a pile, one in `every` step."""
    found = solved_states(start, steps=count * every, solver=NNCG(sweeps=2000), every=1)
    return found[every - 1 :: every]


def references_of(state: State, sweeps: int) -> list[ContactSolution]:
    """Solutions of a state's contact problem, one by each method with so many sweeps, far past need.

    Those whose residual is not within `ENOUGH` are left out, which can be all of them.
    """
    found = []
    for setting in SETTINGS.values():
        if setting.get("precision", "double") == "double":
            solver = solver_of(setting, sweeps=sweeps, tolerance=1e-9)
            solution = solve_contacts(state, solver=solver, start=setting.get("start", "builtin"))
            if errors.residual(state, solution) < ENOUGH:
                found.append(solution)
    return found


def solution_errors(
    kind: str,
    n_bodies: int,
    seed: int,
    *,
    states: int,
    sweeps: Sequence[int],
    tolerances: Sequence[float],
    past_need: int,
) -> dict:
    """Errors of every setting with every budget on states of one pile; past_need: sweeps of the references.

    Returns {"kind", "n_bodies", "seed", "contacts": mean, "states", "left_out": those without a reference, "spread":
    [how far the references lie apart, state by state], "settings": {name: {"sweeps": […], "tolerance": […]}}} where
    each item of a list holds a budget and, state by state, the errors and the sweeps done.
    """
    chosen, references, spread = [], [], []
    for state in states_of(pile(kind, n_bodies, seed), count=states):
        found = references_of(state, past_need)
        if found:
            chosen.append(state)
            references.append(found)
            spread.append(max(errors.velocity_error(state, other, found[0]) for other in found))
    settings = {}
    for name, setting in SETTINGS.items():
        by_sweeps = [{"sweeps": int(k), "tolerance": None} for k in sweeps]
        by_theta = [{"sweeps": int(max(sweeps)), "tolerance": float(t)} for t in tolerances]
        settings[name] = {
            "sweeps": [_errors_of(setting, budget, chosen, references) for budget in by_sweeps],
            "tolerance": [_errors_of(setting, budget, chosen, references) for budget in by_theta],
        }
    return {
        "kind": kind,
        "n_bodies": n_bodies,
        "seed": seed,
        "contacts": float(np.mean([state.contacts.count for state in chosen])) if chosen else 0.0,
        "states": len(chosen),
        "left_out": states - len(chosen),
        "spread": [float(f"{value:.3g}") for value in spread],
        "settings": settings,
    }


def _errors_of(setting: dict, budget: dict, states, references) -> dict:
    found = {"velocity": [], "residual": [], "approach": [], "done": []}
    for state, nearest in zip(states, references):
        tolerance = budget["tolerance"]
        absolute = None if tolerance is None else tolerance * weight_impulse(state)
        solver = solver_of(setting, sweeps=budget["sweeps"], tolerance=absolute)
        solution = solve_contacts(state, solver=solver, start=setting.get("start", "builtin"))
        measured = {
            "velocity": errors.nearest_velocity_error(state, solution, nearest),
            "residual": errors.residual(state, solution),
            "approach": errors.approach(state, solution),
        }
        for name, value in measured.items():
            # Single precision can overflow; a number that is missing is None.
            found[name].append(float(f"{value:.3g}") if np.isfinite(value) else None)
        found["done"].append(solution.record.sweeps)
    return {**budget, **found}


def costs(n_bodies: int, seed: int, *, repeats: int) -> dict:
    """Cost of every setting on a settling pile.

    Returns {"n_bodies", "contacts", "overhead_us", "sweep_ns": {setting: ns a contact and sweep}}. The overhead is that
    of a step without sweeps: contacts, integration, ten sweeps of position correction. Times are the least of the
    repeats. Nothing else should run meanwhile.
    """
    state = pile("settling", n_bodies, seed)
    m = state.contacts.count
    few, many = 10, 10 + max(20, 400_000 // m)
    sweep_ns = {}
    for name, setting in SETTINGS.items():
        best = {few: np.inf, many: np.inf}
        for _ in range(repeats + 1):  # the first compiles
            for k in best:
                solver = solver_of(setting, sweeps=k, tolerance=None)
                begin = time.perf_counter()
                solve_contacts(state, solver=solver)
                best[k] = min(best[k], time.perf_counter() - begin)
        sweep_ns[name] = (best[many] - best[few]) / ((many - few) * m) * 1e9
    overhead = np.inf
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        simulate(state, steps=20, solver=PGS(sweeps=1, tolerance=None))
        overhead = min(overhead, (time.perf_counter() - begin) / 20 * 1e6)
    overhead -= sweep_ns["PGS"] * m * 1e-3
    return {"n_bodies": n_bodies, "contacts": m, "overhead_us": overhead, "sweep_ns": sweep_ns}


RUNS = {
    "PGS": [PGS(sweeps=k, tolerance=None) for k in (4, 10, 30, 100)],
    "NNCG": [NNCG(sweeps=k, tolerance=None) for k in (4, 10, 30, 100)],
    "SoftSteps": [SoftSteps(substeps=k) for k in (2, 4, 8, 16)],
}
"""Method -> solvers of the runs of a pile at rest."""


def resting_runs(n_bodies: int, seed: int, *, seconds: float, steps: Sequence[float]) -> list[dict]:
    """Errors and time of runs of a resting pile, for every method and its budgets, and every time step (s).

    Returns [{"engine", "budget", "dt", "us_per_second", **`errors.RunErrors`}]. The time is that of a second of the
    simulation, by the fastest tenth of the run. As many seconds before are let go: a pile made by one method gives
    way a little under another.
    """
    start = pile("resting", n_bodies, seed)
    rows = []
    for name, solvers in RUNS.items():
        for solver in solvers:
            for dt in steps:
                budget = solver.substeps if name == "SoftSteps" else solver.sweeps
                rows.append({"engine": name, "budget": budget, "dt": dt, **_run(start, solver, dt, seconds)})
    return rows


def _run(start: State, solver, dt: float, seconds: float) -> dict:
    each = max(1, round(seconds / dt / 10))
    state = simulate(start.replace(contacts=None), steps=10 * each, dt=dt, solver=solver).state
    states, least = [state], np.inf
    for _ in range(10):
        begin = time.perf_counter()
        state = simulate(state, steps=each, solver=solver).state
        least = min(least, time.perf_counter() - begin)
        states.append(state)
    return {"us_per_second": least / (each * dt) * 1e6, **errors.run_errors(states)._asdict()}


PEERS = {"Box2D 2.3": peers.Box2D23, "pymunk": peers.Pymunk, "Box2D v3": peers.Box2D3}
SOLVES_AT_NEW_POSITIONS = ("pymunk",)
"""Engines that move the bodies first, so that a step solves contacts at the positions which it leaves behind."""


def peer_errors(
    name: str,
    n_bodies: int,
    seed: int,
    *,
    budgets: Sequence[int],
    samples: int,
    past_need: int,
    dt: float = 0.01,
    warm_up: int = 10,
) -> list[dict]:
    """Velocity error and time of single steps of another engine in its own run from a settling pile.

    A step's error is that of the velocities it leaves, against our reference from the bodies it had. The engine starts
    from impulses of its own (`warm_up` steps). Sub-stepping and contacts found ahead (Box2D v3) are another model, so
    its error has a floor. Returns [{"engine", "n_bodies", "budget", "velocity": […], "us": least of the steps}].
    """
    start = pile("settling", n_bodies, seed)
    rows = []
    for budget in budgets:
        world = PEERS[name](start)
        found, least = [], np.inf
        for step in range(warm_up + 4 * samples):
            before = world.bodies()
            begin = time.perf_counter()
            world.step(dt, budget, 10)
            least = min(least, time.perf_counter() - begin)
            if step >= warm_up and step % 4 == 0:
                error = _step_error(start, before, world.bodies(), dt, past_need, name in SOLVES_AT_NEW_POSITIONS)
                if error is not None:
                    found.append(error)
        rows.append({"engine": name, "n_bodies": n_bodies, "budget": budget, "velocity": found, "us": least * 1e6})
    return rows


def _step_error(start: State, before, after, dt: float, past_need: int, at_new_positions: bool) -> float | None:
    """Velocity error of a step that made `after` of `before`; None where there is nothing to hold it against."""
    bodies = before._replace(position=after.position) if at_new_positions else before
    state = ready(start.replace(bodies=bodies, contacts=None, dt=dt))
    if state.contacts.count == 0:
        return None
    # Its own impulses are not to be had; near them lies what its velocities ask for.
    guess = solve_contacts(state, solver=PGS(sweeps=300, tolerance=None), start=None)
    starts = {"normal_start": guess.normal_impulses, "tangent_start": guess.tangent_impulses}
    state = state.replace(contacts=state.contacts._replace(**starts))
    references = references_of(state, past_need)
    if not references:
        return None
    left = references[0]._replace(velocities=after.velocity, angular_velocities=after.spin)
    return float(f"{errors.nearest_velocity_error(state, left, references):.3g}")


def condensed(piles: Sequence[dict], measured: Sequence[dict]) -> list[dict]:
    """What `recommend` reads: for every number of circles, kind, setting and budget, the errors over all states.

    piles: of `solution_errors`. measured: of `costs`. Returns [{"n_bodies", "kind", "states", "left_out", "setting",
    "start", "budget": {"sweeps", "tolerance"}, "velocity": {"p50", "p95"}, "sweeps": mean done, "us": mean of a step}].
    A state that overflowed counts as wholly wrong.
    """
    cost = {found["n_bodies"]: found for found in measured}
    rows = []
    for n in sorted({found["n_bodies"] for found in piles}):
        for kind in KINDS:
            group = [found for found in piles if found["n_bodies"] == n and found["kind"] == kind and found["states"]]
            if not group:
                continue
            contacts = float(np.mean([found["contacts"] for found in group]))
            common = {
                "n_bodies": n,
                "kind": kind,
                "states": sum(found["states"] for found in group),
                "left_out": sum(found["left_out"] for found in group),
            }
            for name in SETTINGS:
                for by in ("sweeps", "tolerance"):
                    for items in zip(*(found["settings"][name][by] for found in group)):
                        velocity = [np.inf if v is None else v for item in items for v in item["velocity"]]
                        done = float(np.mean([k for item in items for k in item["done"]]))
                        p50, p95 = np.quantile(velocity, [0.5, 0.95], method="higher")
                        if not np.isfinite(p95):
                            continue
                        us = cost[n]["overhead_us"] + cost[n]["sweep_ns"][name] * contacts * done * 1e-3
                        rows.append(
                            {
                                **common,
                                "setting": name,
                                "start": SETTINGS[name].get("start", "builtin"),
                                "budget": {"sweeps": items[0]["sweeps"], "tolerance": items[0]["tolerance"]},
                                "velocity": {"p50": float(p50), "p95": float(p95)},
                                "sweeps": done,
                                "us": float(f"{us:.4g}"),
                            }
                        )
    return rows


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points (time, error) that no other beats in both, by time."""
    best, front = np.inf, []
    for i in sorted(range(len(points)), key=lambda i: points[i]):
        if points[i][1] < best:
            best = points[i][1]
            front.append(i)
    return front


def installed(rows: Sequence[dict]) -> list[dict]:
    """The rows that `recommend` can make use of: budgets for which some error is worth its time, of any kind of pile.

    A budget stays, for all kinds of piles of its size, if for one kind nothing is both faster and more accurate.
    """
    kept = set()
    groups: dict = {}
    for row in rows:
        groups.setdefault((row["n_bodies"], row["kind"]), []).append(row)
    for group in groups.values():
        for i in pareto([(row["us"], row["velocity"]["p95"]) for row in group]):
            kept.add((group[i]["n_bodies"], group[i]["setting"], *group[i]["budget"].values()))
    return [row for row in rows if (row["n_bodies"], row["setting"], *row["budget"].values()) in kept]


def fastest_within(rows: Sequence[dict], error: float, quantile: str = "p95") -> dict | None:
    """The row of least time whose error is at most the given one; None if there is none."""
    within = [row for row in rows if row["velocity"][quantile] <= error]
    return min(within, key=lambda row: row["us"]) if within else None
