"""The trade of speed for accuracy: what the study measures. `scripts/tradeoff.py` runs it, `recommend` reads it.

Piles are falling, settling or resting. Every setting (method, precision, start) solves the same states of a pile with
every budget, a number of sweeps or a tolerance; its errors are held against references (`physics.errors`). None of
that depends on the machine or on what else it does. What a budget costs in time is measured apart, one thing at a
time on a quiet machine, as overhead + cost a contact and sweep.
Tolerances are in units of a mean circle's impulse of weight, m g Δt, so that they mean the same in another scene.
With friction a pile has many solutions, and which one is found depends on the method (`physics.errors`). So every
setting is run far past need once, which gives its θ by sweep, from which follows when it meets a tolerance. Where it
ends is no solution yet in a pile of a thousand circles that settles, so it is led on to one exactly (`physics.exact`);
an error is the distance from the nearest of these references. For larger piles the ends have to do (`ENOUGH`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

import numpy as np

from deep_contact.physics import metrics
from deep_contact.physics.engine import ContactSolution
from deep_contact.physics.exact import solve_exactly
from deep_contact.physics.scenes import circles_in_box, lattice_in_box
from deep_contact.physics.solvers import NNCG, PGS, SoftSteps, describe
from deep_contact.recommendation import recommend, solver_of, weight_impulse
from deep_contact.simulation import ready, simulate, solve_contacts
from deep_contact.state import State
from deep_contact.studies import peers
from deep_contact.studies.comparison import solved_states

KINDS = ("falling", "settling", "resting")
ENOUGH = 1e-3
"""Residual within which an end is taken for a reference without more, m/s: a hundredth of gravity's doing in a step."""

EXACT = 1e-8
"""Residual of what `physics.exact` calls a solution, m/s."""

SETTLING_SPEED, RESTING_SPEED = 0.5, 0.05
"""Root mean square speeds below which a pile settles and rests, m/s."""

MOST_STEPS = 2000
"""Steps after which a pile is taken as it is."""

SETTINGS = {
    "PGS": {"method": "PGS"},
    "PGS, no start": {"method": "PGS", "start": "none"},
    "PGS, single": {"method": "PGS", "precision": "single"},
    "PSOR 1.5": {"method": "PSOR", "omega": 1.5},
    "PSOR adaptive": {"method": "PSOR", "omega": 1.0, "adaptive": True},
    "SymmetricPGS": {"method": "SymmetricPGS"},
    "NNCG": {"method": "NNCG"},
    "NNCG, no start": {"method": "NNCG", "start": "none"},
    "NNCG, single": {"method": "NNCG", "precision": "single"},
    "NesterovPGS": {"method": "NesterovPGS"},
    "NesterovPGS, no start": {"method": "NesterovPGS", "start": "none"},
    "NesterovPGS, single": {"method": "NesterovPGS", "precision": "single"},
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


REFERENCES = ("PGS", "NNCG", "NesterovPGS")
"""Settings whose ends are references where those of all settings cost too much."""


def courses(state: State, sweeps: int, names: Sequence[str] | None = None) -> dict[str, ContactSolution]:
    """Setting -> what it finds with so many sweeps, far past need: each setting of double precision, or those named."""
    if names is None:
        names = [name for name, setting in SETTINGS.items() if setting.get("precision", "double") == "double"]
    return {name: _solved(state, SETTINGS[name], sweeps, tolerance=1e-9) for name in names}


def references_from(state: State, ends: Iterable[ContactSolution], *, exact: bool) -> list[ContactSolution]:
    """What errors are measured from, which can be nothing: exact solutions come to from the ends of courses.

    Not exact: those of the ends themselves whose residual is within `ENOUGH`.
    """
    if not exact:
        return [end for end in ends if metrics.residual(state, end) < ENOUGH]
    found: list[ContactSolution] = []
    for end in ends:
        if not np.isfinite(metrics.residual(state, end)):
            continue
        led = solve_exactly(state, end.normal_impulses, end.tangent_impulses, residual=EXACT)
        if led.converged and all(metrics.velocity_error(state, led.solution, other) > _SAME for other in found):
            found.append(led.solution)
    return found


_SAME = 1e-6
"""Velocity error within which two references are one."""


def solution_errors(
    kind: str,
    n_bodies: int,
    seed: int,
    *,
    states: int,
    sweeps: Sequence[int],
    tolerances: Sequence[float],
    past_need: int,
    exact: bool,
) -> dict:
    """Errors of every setting with every budget on states of one pile.

    past_need: sweeps of the courses whose ends are references, or, if exact, lead to them (`references_from`).
    Returns {"kind", "n_bodies", "seed", "contacts": mean, "states", "left_out": those without a reference, "spread":
    [how far the references lie apart, state by state], "settings": {name: {"sweeps": […], "tolerance": […]}}} where
    each item of a list holds a budget and, state by state, the errors and the sweeps done.
    """
    budgets = [{"sweeps": int(k), "tolerance": None} for k in sweeps]
    budgets += [{"sweeps": int(max(sweeps)), "tolerance": float(t)} for t in tolerances]
    items = {name: [budget | {key: [] for key in _MEASURED} for budget in budgets] for name in SETTINGS}
    contacts, spread = [], []
    for state in states_of(pile(kind, n_bodies, seed), count=states):
        far = courses(state, past_need, None if exact else REFERENCES)
        references = references_from(state, far.values(), exact=exact)
        if not references:
            continue
        contacts.append(state.contacts.count)
        apart = max(metrics.velocity_error(state, other, references[0]) for other in references)
        spread.append(float(f"{apart:.3g}"))
        for name, setting in SETTINGS.items():
            course = far.get(name)
            if course is None:
                course = _solved(state, setting, max(sweeps))
            _add_errors(items[name], state, setting, course, references)
    return {
        "kind": kind,
        "n_bodies": n_bodies,
        "seed": seed,
        "contacts": float(np.mean(contacts)) if contacts else 0.0,
        "states": len(contacts),
        "left_out": states - len(contacts),
        "spread": spread,
        "settings": {
            name: {"sweeps": found[: len(sweeps)], "tolerance": found[len(sweeps) :]} for name, found in items.items()
        },
    }


_MEASURED = ("velocity", "residual", "approach", "done")


def _solved(state: State, setting: dict, sweeps: int, tolerance: float | None = None) -> ContactSolution:
    solver = solver_of(setting, sweeps=sweeps, tolerance=tolerance)
    return solve_contacts(state, solver=solver, start=setting.get("start", "builtin"))


def _add_errors(items: list[dict], state: State, setting: dict, course: ContactSolution, references) -> None:
    """Append to each budget's item its errors on this state; course: a longer run, whose θ says where budgets end."""
    measured = {}
    for item in items:
        done = item["sweeps"]
        if item["tolerance"] is not None:
            met = np.flatnonzero(course.record.theta[:done] <= item["tolerance"] * weight_impulse(state))
            done = int(met[0]) + 1 if met.size else done
        if done not in measured:
            # A course that ended on the way would do nothing more.
            solution = course if done >= course.record.sweeps else _solved(state, setting, done)
            measured[done] = (
                metrics.nearest_velocity_error(state, solution, references),
                metrics.residual(state, solution),
                metrics.approach(state, solution),
            )
        for name, value in zip(_MEASURED, measured[done]):
            # Single precision can overflow; a number that is missing is None.
            item[name].append(float(f"{value:.3g}") if np.isfinite(value) else None)
        item["done"].append(done)


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


def exact_solutions(kind: str, n_bodies: int, seed: int, *, states: int) -> dict:
    """What an exact solution takes on states of one pile, from where 3,000 sweeps of NesterovPGS end, these included.

    Returns {"kind", "n_bodies", "seed", "seconds", "residual", "pivots", "factorizations": (states,) each}. Nothing
    else should run meanwhile.
    """
    rows = []
    for state in states_of(pile(kind, n_bodies, seed), count=states):
        begin = time.perf_counter()
        found = solve_exactly(state, residual=EXACT)
        seconds = time.perf_counter() - begin
        rows.append((seconds, found.residual, found.pivots, found.factorizations))
    names = ("seconds", "residual", "pivots", "factorizations")
    return {"kind": kind, "n_bodies": n_bodies, "seed": seed, **dict(zip(names, map(list, zip(*rows))))}


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
    return {"us_per_second": least / (each * dt) * 1e6, **metrics.run_errors(states)._asdict()}


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
    exact: bool,
    dt: float = 0.01,
    warm_up: int = 10,
) -> list[dict]:
    """Velocity error of single steps of another engine in its own run from a settling pile.

    A step's error is that of the velocities it leaves, against our references from the bodies it had. The engine starts
    from impulses of its own (`warm_up` steps). Sub-stepping and contacts found ahead (Box2D v3) are another model, so
    its error has a floor. Returns [{"engine", "n_bodies", "budget", "velocity": […]}].
    """
    start = pile("settling", n_bodies, seed)
    rows = []
    for budget in budgets:
        world = PEERS[name](start)
        found = []
        for step in range(warm_up + 4 * samples):
            before = world.bodies()
            world.step(dt, budget, 10)
            if step >= warm_up and step % 4 == 0:
                at_new = name in SOLVES_AT_NEW_POSITIONS
                error = _step_error(start, before, world.bodies(), dt, at_new, past_need, exact)
                if error is not None:
                    found.append(error)
        rows.append({"engine": name, "n_bodies": n_bodies, "budget": budget, "velocity": found})
    return rows


def peer_times(
    name: str, n_bodies: int, seed: int, *, budgets: Sequence[int], steps: int = 30, dt: float = 0.01, warm_up: int = 10
) -> list[dict]:
    """Time of a step of another engine in the same runs: [{"engine", "n_bodies", "budget", "us": least of the steps}].

    Nothing else should run meanwhile.
    """
    start = pile("settling", n_bodies, seed)
    rows = []
    for budget in budgets:
        world, least = PEERS[name](start), np.inf
        for _ in range(warm_up + steps):
            begin = time.perf_counter()
            world.step(dt, budget, 10)
            least = min(least, time.perf_counter() - begin)
        rows.append({"engine": name, "n_bodies": n_bodies, "budget": budget, "us": least * 1e6})
    return rows


def _step_error(
    start: State, before, after, dt: float, at_new_positions: bool, past_need: int, exact: bool
) -> float | None:
    """Velocity error of a step that made `after` of `before`; None where there is nothing to hold it against."""
    bodies = before._replace(position=after.position) if at_new_positions else before
    state = ready(start.replace(bodies=bodies, contacts=None, dt=dt))
    if state.contacts.count == 0:
        return None
    # Its own impulses are not to be had; near them lies what its velocities ask for.
    guess = solve_contacts(state, solver=PGS(sweeps=300, tolerance=None), start=None)
    starts = {"normal_start": guess.normal_impulses, "tangent_start": guess.tangent_impulses}
    state = state.replace(contacts=state.contacts._replace(**starts))
    references = references_from(state, courses(state, past_need, REFERENCES).values(), exact=exact)
    if not references:
        return None
    left = references[0]._replace(velocities=after.velocity, angular_velocities=after.spin)
    return float(f"{metrics.nearest_velocity_error(state, left, references):.3g}")


def recommended_errors(
    kind: str,
    n_bodies: int,
    seed: int,
    *,
    states: int,
    asked: Sequence[float],
    margins: Sequence[float],
    past_need: int,
    exact: bool,
    table: dict,
) -> list[dict]:
    """What the recommendations of a study (`table`) leave on states of a pile, by the error asked for and the margin.

    Returns [{"kind", "n_bodies", "asked", "margin", "reached", "solver", "us", "velocity": [error, state by state]}].
    """
    start = pile(kind, n_bodies, seed)
    rows = []
    for error in asked:
        for margin in margins:
            found = recommend(start, velocity_error=error, table=with_margin(table, margin))
            common = {"kind": kind, "n_bodies": n_bodies, "asked": float(error), "margin": float(margin)}
            rows.append((common | {"reached": found.reached, "us": found.us, "velocity": []}, found))
    for state in states_of(start, count=states):
        far = courses(state, past_need, None if exact else REFERENCES)
        references = references_from(state, far.values(), exact=exact)
        measured: dict = {}
        for row, found in rows if references else ():
            key = (found.solver, found.warm_start)
            if key not in measured:
                solution = solve_contacts(state, solver=found.solver, start=found.warm_start)
                measured[key] = float(f"{metrics.nearest_velocity_error(state, solution, references):.3g}")
            row["velocity"].append(measured[key])
    return [row | {"solver": describe(found.solver), "start": found.warm_start} for row, found in rows]


def with_margin(table: dict, margin: float) -> dict:
    """The same study, whose recommendations keep a margin: see `recommend`."""
    return {**table, "data": {**table["data"], "margin": float(margin)}}


def met(rows: Sequence[dict]) -> dict[float, float]:
    """Error asked for -> share of the states in which its recommendations met it, where the study reaches it."""
    shares = {}
    for error in sorted({row["asked"] for row in rows}):
        found = [v <= error for row in rows if row["asked"] == error and row["reached"] for v in row["velocity"]]
        if found:
            shares[error] = float(np.mean(found))
    return shares


def least_margin(rows: Sequence[dict], share: float = 0.95) -> float | None:
    """The smallest margin with which each error asked for is met in that share of the states; None if none is enough.

    Errors that are out of the study's reach with a margin do not count for it.
    """
    for margin in sorted({row["margin"] for row in rows}):
        shares = met([row for row in rows if row["margin"] == margin])
        if shares and min(shares.values()) >= share:
            return margin
    return None


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


def best_within(data: dict, n_bodies: int, kind: str, error: float) -> dict | None:
    """What solves piles of a kind fastest to a median velocity error: {"setting", "us", "error"}, or None.

    data: of the study. The setting is one of `SETTINGS`, or "exact" (`exact_solutions`), where all were solved.
    """
    rows = [row for row in data["rows"] if (row["n_bodies"], row["kind"]) == (n_bodies, kind)]
    row = fastest_within(rows, error, "p50")
    found = [] if row is None else [{"setting": row["setting"], "us": row["us"], "error": row["velocity"]["p50"]}]
    parts = [part for part in data["exact"] if (part["n_bodies"], part["kind"]) == (n_bodies, kind)]
    if parts and max(residual for part in parts for residual in part["residual"]) <= EXACT:
        overhead = next(cost["overhead_us"] for cost in data["costs"] if cost["n_bodies"] == n_bodies)
        seconds = [seconds for part in parts for seconds in part["seconds"]]
        found.append({"setting": "exact", "us": float(1e6 * np.median(seconds) + overhead), "error": 0.0})
    return min(found, key=lambda one: one["us"], default=None)
