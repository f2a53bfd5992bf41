"""Speed for accuracy of single steps: errors and times of all settings. Run by `scripts/tradeoff.py`.

Piles are falling, settling or resting. Every setting (method, precision, start) solves the same states of a pile with
every budget: a number of sweeps, or a tolerance in units of m g Δt of the mean circle, so that it means the same in
every scene. Errors do not depend on the machine and can be computed in parallel. Times are measured separately, one at
a time on a quiet machine, as overhead + cost per contact and sweep.

With friction a pile has many solutions, and each method approaches its own. So every setting first runs for far more
sweeps than needed; its θ by sweep tells when it meets each tolerance. From where these long runs end, `physics.exact`
finds exact solutions: the reference solutions. An error is the distance to the nearest of them. For piles of more than
1,000 circles exact solutions cost too much, and the ends themselves serve as references (`ENOUGH`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from deep_contact.physics import metrics
from deep_contact.physics.engine import ContactSolution
from deep_contact.physics.exact import solve_exactly
from deep_contact.physics.scenes import circles_in_box, lattice_in_box
from deep_contact.physics.solvers import NNCG, PGS, describe
from deep_contact.recommendation.steps import recommend_step, solver_of, weight_impulse
from deep_contact.simulation import ready, simulate, solve_contacts
from deep_contact.state import State
from deep_contact.studies import peers, timing
from deep_contact.studies.comparison import solved_states

KINDS = ("falling", "settling", "resting")
ENOUGH = 1e-3
"""Residual below which the end of a long run serves as a reference, m/s: a hundredth of gravity's change in a step."""

EXACT = 1e-8
"""Largest residual of an exact solution, m/s."""

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

REFERENCES = ("PGS", "NNCG", "NesterovPGS")
"""Settings whose long runs lead to references where those of all settings cost too much."""

_SAME = 1e-6
"""Velocity error below which two references count as one."""

_MEASURED = ("velocity", "residual", "approach", "done")


def scene(n_bodies: int, seed: int) -> State:
    """The thesis's scene for 100 circles and fewer, otherwise a loose lattice that falls."""
    return circles_in_box(n_bodies, seed=seed) if n_bodies <= 100 else lattice_in_box(n_bodies, seed=seed)


def pile(kind: str, n_bodies: int, seed: int) -> State:
    """A pile, simulated until it has a contact per circle and, by its rms speed, is falling, settling or resting."""
    if kind not in KINDS:
        raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    slowest = {"falling": np.inf, "settling": SETTLING_SPEED, "resting": RESTING_SPEED}[kind]
    state = scene(n_bodies, seed)
    for _ in range(MOST_STEPS // 10):
        state = simulate(state, steps=10, solver=NNCG(sweeps=300)).state
        if state.contacts.count >= n_bodies and rms_speed(state) < slowest:
            break
    return state


def rms_speed(state: State) -> float:
    """Root mean square speed of the circles, m/s."""
    return float(np.sqrt(np.mean((state.bodies.velocity**2).sum(axis=1))))


def states_of(start: State, *, count: int, every: int = 4) -> list[State]:
    """`count` solved states of the run that continues from a pile, one in `every` steps."""
    found = solved_states(start, steps=count * every, solver=NNCG(sweeps=2000), every=1)
    return found[every - 1 :: every]


def courses(state: State, sweeps: int, names: Sequence[str] | None = None) -> dict[str, ContactSolution]:
    """Long runs, setting -> solution after `sweeps` sweeps. By default of every setting of double precision."""
    if names is None:
        names = [name for name, setting in SETTINGS.items() if setting.get("precision", "double") == "double"]
    return {name: _solved(state, SETTINGS[name], sweeps, tolerance=1e-9) for name in names}


def references_from(state: State, ends: Iterable[ContactSolution], *, exact: bool) -> list[ContactSolution]:
    """Reference solutions, perhaps none: the exact solutions found from the ends of long runs, without repeats.

    Not exact: those of the ends whose residual is below `ENOUGH`.
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

    past_need: sweeps of the long runs. exact: see `references_from`. Returns {"kind", "n_bodies", "seed", "contacts":
    mean, "states", "left_out": states without a reference, "spread": [largest distance between the references of each
    state], "settings": {name: {"sweeps": […], "tolerance": […]}}}; each item of a list holds a budget and, state by
    state, the errors and the sweeps done.
    """
    budgets = [{"sweeps": int(k), "tolerance": None} for k in sweeps]
    budgets += [{"sweeps": int(max(sweeps)), "tolerance": float(t)} for t in tolerances]
    items = {name: [budget | {key: [] for key in _MEASURED} for budget in budgets] for name in SETTINGS}
    contacts, spread = [], []
    for state in states_of(pile(kind, n_bodies, seed), count=states):
        far, references = _far_and_references(state, past_need, exact)
        if not references:
            continue
        contacts.append(state.contacts.count)
        spread.append(_rounded(max(metrics.velocity_error(state, other, references[0]) for other in references)))
        for name, setting in SETTINGS.items():
            course = far[name] if name in far else _solved(state, setting, max(sweeps))
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


def _far_and_references(state: State, past_need: int, exact: bool) -> tuple[dict, list[ContactSolution]]:
    far = courses(state, past_need, None if exact else REFERENCES)
    return far, references_from(state, far.values(), exact=exact)


def _solved(state: State, setting: dict, sweeps: int, tolerance: float | None = None) -> ContactSolution:
    solver = solver_of(setting, sweeps=sweeps, tolerance=tolerance)
    return solve_contacts(state, solver=solver, start=setting.get("start", "builtin"))


def _rounded(value: float) -> float | None:
    """Three digits; None for what is not finite: single precision can overflow."""
    return float(f"{value:.3g}") if np.isfinite(value) else None


def _add_errors(items: list[dict], state: State, setting: dict, course: ContactSolution, references) -> None:
    """Append to each budget's item its errors on this state. course: a longer run, whose θ tells where budgets end."""
    measured = {}
    for item in items:
        done = item["sweeps"]
        if item["tolerance"] is not None:
            met = np.flatnonzero(course.record.theta[:done] <= item["tolerance"] * weight_impulse(state))
            done = int(met[0]) + 1 if met.size else done
        if done not in measured:
            # A long run that ended before this budget is its result too.
            solution = course if done >= course.record.sweeps else _solved(state, setting, done)
            measured[done] = (
                metrics.nearest_velocity_error(state, solution, references),
                metrics.residual(state, solution),
                metrics.approach(state, solution),
            )
        for name, value in zip(_MEASURED, measured[done]):
            item[name].append(_rounded(value))
        item["done"].append(done)


# ---- times ----


def costs(n_bodies: int, seed: int, *, repeats: int) -> dict:
    """Cost of every setting on a settling pile.

    Returns {"n_bodies", "contacts", "overhead_us", "sweep_ns": {setting: ns per contact and sweep}}. The overhead is
    that of a step without sweeps: contacts, integration, ten sweeps of position correction.
    """
    state = pile("settling", n_bodies, seed)
    m = state.contacts.count
    sweep_ns = {}
    for name, setting in SETTINGS.items():

        def solve(k, setting=setting):
            solve_contacts(state, solver=solver_of(setting, sweeps=k, tolerance=None))

        sweep_ns[name] = timing.sweep_time(solve, m, repeats=repeats) / m * 1e9
    step = timing.fastest(lambda: simulate(state, steps=20, solver=PGS(sweeps=1, tolerance=None)), repeats) / 20
    overhead_us = 1e6 * step - sweep_ns["PGS"] * m * 1e-3
    return {"n_bodies": n_bodies, "contacts": m, "overhead_us": overhead_us, "sweep_ns": sweep_ns}


def exact_solutions(kind: str, n_bodies: int, seed: int, *, states: int) -> dict:
    """Time and effort of exact solutions on states of one pile, 3,000 sweeps of NesterovPGS before them included.

    Returns {"kind", "n_bodies", "seed", "seconds", "residual", "pivots", "factorizations": (states,) each}.
    """
    rows = [
        timing.timed(lambda state=state: solve_exactly(state, residual=EXACT))
        for state in states_of(pile(kind, n_bodies, seed), count=states)
    ]
    columns = {name: [getattr(found, name) for _, found in rows] for name in ("residual", "pivots", "factorizations")}
    return {"kind": kind, "n_bodies": n_bodies, "seed": seed, "seconds": [seconds for seconds, _ in rows], **columns}


# ---- other engines ----

SOLVES_AT_NEW_POSITIONS = ("pymunk",)
"""Engines that move the bodies first: a step solves contacts at the positions that it ends with."""


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

    The error is that of the velocities after a step, against our references for the bodies before it. The engine starts
    from impulses of its own (`warm_up` steps). Sub-stepping and contacts found ahead (Box2D v3) are another model, so
    its error has a floor. Returns [{"engine", "n_bodies", "budget", "velocity": […]}].
    """
    start = pile("settling", n_bodies, seed)
    rows = []
    for budget in budgets:
        world = peers.ENGINES[name](start)
        found = []
        for step in range(warm_up + 4 * samples):
            before = world.bodies()
            world.step(dt, budget, 10)
            if step >= warm_up and step % 4 == 0:
                after = world.bodies()
                if name in SOLVES_AT_NEW_POSITIONS:
                    before = before._replace(position=after.position)
                found.append(_step_error(start.replace(bodies=before, contacts=None, dt=dt), after, past_need, exact))
        velocity = [error for error in found if error is not None]
        rows.append({"engine": name, "n_bodies": n_bodies, "budget": budget, "velocity": velocity})
    return rows


def peer_times(
    name: str, n_bodies: int, seed: int, *, budgets: Sequence[int], steps: int = 30, dt: float = 0.01, warm_up: int = 10
) -> list[dict]:
    """Time of the fastest step of another engine in the same runs: [{"engine", "n_bodies", "budget", "us"}]."""
    start = pile("settling", n_bodies, seed)
    rows = []
    for budget in budgets:
        world = peers.ENGINES[name](start)
        least = timing.fastest(lambda: world.step(dt, budget, 10), warm_up + steps - 1)  # noqa: B023
        rows.append({"engine": name, "n_bodies": n_bodies, "budget": budget, "us": least * 1e6})
    return rows


def _step_error(state: State, after, past_need: int, exact: bool) -> float | None:
    """Velocity error of a step from `state` to the bodies `after`; None without contacts or references."""
    state = ready(state)
    if state.contacts.count == 0:
        return None
    # The engine's impulses are not known. A solution from zero is near them.
    guess = solve_contacts(state, solver=PGS(sweeps=300, tolerance=None), start=None)
    starts = {"normal_start": guess.normal_impulses, "tangent_start": guess.tangent_impulses}
    state = state.replace(contacts=state.contacts._replace(**starts))
    references = references_from(state, courses(state, past_need, REFERENCES).values(), exact=exact)
    if not references:
        return None
    left = references[0]._replace(velocities=after.velocity, angular_velocities=after.spin)
    return float(f"{metrics.nearest_velocity_error(state, left, references):.3g}")


# ---- recommendations on other scenes ----


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
    """Errors of what a study (`table`) recommends on states of a pile, by the error asked for and the margin.

    Returns [{"kind", "n_bodies", "asked", "margin", "reached", "solver", "us", "velocity": [error, state by state]}].
    """
    start = pile(kind, n_bodies, seed)
    rows = []
    for error, margin in product(asked, margins):
        found = recommend_step(start, velocity_error=error, table=with_margin(table, margin))
        common = {"kind": kind, "n_bodies": n_bodies, "asked": float(error), "margin": float(margin)}
        rows.append((common | {"reached": found.reached, "us": found.us, "velocity": []}, found))
    for state in states_of(start, count=states):
        _, references = _far_and_references(state, past_need, exact)
        measured: dict = {}
        for row, found in rows if references else ():
            key = (found.solver, found.warm_start)
            if key not in measured:
                solution = solve_contacts(state, solver=found.solver, start=found.warm_start)
                measured[key] = float(f"{metrics.nearest_velocity_error(state, solution, references):.3g}")
            row["velocity"].append(measured[key])
    return [row | {"solver": describe(found.solver), "start": found.warm_start} for row, found in rows]


def with_margin(table: dict, margin: float) -> dict:
    """The same study with a margin that its recommendations keep: see `recommend_step`."""
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

    Errors that the study does not reach with a margin do not count for it.
    """
    for margin in sorted({row["margin"] for row in rows}):
        shares = met([row for row in rows if row["margin"] == margin])
        if shares and min(shares.values()) >= share:
            return margin
    return None


# ---- from errors and costs to rows ----


def condensed(piles: Sequence[dict], measured: Sequence[dict]) -> list[dict]:
    """What `recommend_step` reads: for every number of circles, kind, setting and budget, the errors over all states.

    piles: of `solution_errors`. measured: of `costs`. Returns [{"n_bodies", "kind", "states", "left_out", "setting",
    "start", "budget": {"sweeps", "tolerance"}, "velocity": {"p50", "p95"}, "sweeps": mean done, "us": mean of a step}].
    The error of a state that overflowed counts as infinite.
    """
    cost = {found["n_bodies"]: found for found in measured}
    rows = []
    for n, kind in product(sorted({found["n_bodies"] for found in piles}), KINDS):
        group = [found for found in piles if (found["n_bodies"], found["kind"]) == (n, kind) and found["states"]]
        if not group:
            continue
        contacts = float(np.mean([found["contacts"] for found in group]))
        counts = {key: sum(found[key] for found in group) for key in ("states", "left_out")}
        for name, by in product(SETTINGS, ("sweeps", "tolerance")):
            for items in zip(*(found["settings"][name][by] for found in group)):
                velocity = [np.inf if v is None else v for item in items for v in item["velocity"]]
                p50, p95 = np.quantile(velocity, [0.5, 0.95], method="higher")
                if not np.isfinite(p95):
                    continue
                done = float(np.mean([k for item in items for k in item["done"]]))
                us = cost[n]["overhead_us"] + cost[n]["sweep_ns"][name] * contacts * done * 1e-3
                rows.append(
                    {
                        "n_bodies": n,
                        "kind": kind,
                        **counts,
                        "setting": name,
                        "start": SETTINGS[name].get("start", "builtin"),
                        "budget": {key: items[0][key] for key in ("sweeps", "tolerance")},
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
    """The rows that `recommend_step` needs: budgets on the Pareto front of time and error of some kind of pile.

    A budget stays for all kinds of piles of its size if it is on the front of one kind.
    """

    def key(row):
        return row["n_bodies"], row["setting"], *row["budget"].values()

    groups: dict = {}
    for row in rows:
        groups.setdefault((row["n_bodies"], row["kind"]), []).append(row)
    fronts = ([g[i] for i in pareto([(row["us"], row["velocity"]["p95"]) for row in g])] for g in groups.values())
    kept = {key(row) for front in fronts for row in front}
    return [row for row in rows if key(row) in kept]


def rows_of(data: dict, **values) -> list[dict]:
    """The rows of a study with these values, such as n_bodies=100, kind="settling"."""
    return [row for row in data["rows"] if all(row[name] == value for name, value in values.items())]


def fastest_within(rows: Sequence[dict], error: float, quantile: str = "p95") -> dict | None:
    """The row of least time whose error is at most the given one; None if there is none."""
    within = [row for row in rows if row["velocity"][quantile] <= error]
    return min(within, key=lambda row: row["us"], default=None)


def best_within(data: dict, n_bodies: int, kind: str, error: float) -> dict | None:
    """What solves piles of a kind fastest to a median velocity error: {"setting", "us", "error"}, or None.

    data: of the study. The setting is one of `SETTINGS`, or "exact" (`exact_solutions`), where all were solved.
    """
    row = fastest_within(rows_of(data, n_bodies=n_bodies, kind=kind), error, "p50")
    found = [] if row is None else [{"setting": row["setting"], "us": row["us"], "error": row["velocity"]["p50"]}]
    parts = [part for part in data["exact"] if (part["n_bodies"], part["kind"]) == (n_bodies, kind)]
    if parts and max(residual for part in parts for residual in part["residual"]) <= EXACT:
        overhead = next(cost["overhead_us"] for cost in data["costs"] if cost["n_bodies"] == n_bodies)
        seconds = [seconds for part in parts for seconds in part["seconds"]]
        found.append({"setting": "exact", "us": float(1e6 * np.median(seconds) + overhead), "error": 0.0})
    return min(found, key=lambda one: one["us"], default=None)


def rivals(data: dict, n_bodies: int, error: float) -> dict[str, dict]:
    """What PGS from Builtin, and the fastest other engine, take to a median velocity error on settling piles.

    Name -> {"setting", "us", "error", "gets there"}. What never gets there counts with its longest run. Of engines of
    which none gets there, the one nearest to the error counts.
    """
    pgs = rows_of(data, n_bodies=n_bodies, kind="settling", setting="PGS")
    found = {"PGS": [{"setting": "PGS", "us": row["us"], "error": row["velocity"]["p50"]} for row in pgs]}
    for row in data["peers"]:
        if row["n_bodies"] == n_bodies and row["velocity"]:
            middle = sorted(row["velocity"])[len(row["velocity"]) // 2]
            one = {"setting": row["engine"], "us": row["us"], "error": middle}
            found.setdefault(row["engine"], []).append(one)
    reached = {}
    for name, rows in found.items():
        within = [row for row in rows if row["error"] <= error]
        best = min(within, key=lambda row: row["us"]) if within else max(rows, key=lambda row: row["us"])
        reached[name] = best | {"gets there": bool(within)}
    named = {"PGS from Builtin": reached.pop("PGS")}
    if reached:
        named["the fastest peer"] = min(
            reached.values(), key=lambda r: (not r["gets there"], r["us"] if r["gets there"] else r["error"])
        )
    return named
