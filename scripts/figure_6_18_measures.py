"""python scripts/figure_6_18_measures.py: solvers of single contact problems by the measures of the field.

A problem is the next step of a pile, from impulses of 0, with Δt = 10 ms, μ = 0.5 and e = 0. Each solver does some
sweeps. Box2D 2.3 and pymunk do as many iterations in one step of their own, and their contact impulses are read. Box2D
v3 is left out: its bodies move between its substeps, so that it solves another problem. The measures are:

* velocity error: ‖v − v*‖_M / ‖v* − v⁻‖_M, where v* is an exact solution (`metrics.velocity_error`);
* NCP residual: the natural map of complementarity and Coulomb's law, over g Δt (`lcp.natural_residual`; Acary, Brémond
  and Huber, On solving contact problems with Coulomb friction, 2018);
* approach: the largest speed at which two bodies in contact still approach, over g Δt (`lcp.approach`);
* Signorini gap and dissipation gap: `lcp.signorini_gap` and `lcp.dissipation_gap`, over ‖v* − v⁻‖²_M (ContactBench: Le
  Lidec and others, Contact models in robotics: a comparative analysis, 2023).

A performance profile (Dolan and Moré 2002; used by Acary and others) is the share ρ(τ) of the problems in which a
solver needs at most τ times the sweeps of the best solver. A solver that has not reached the accuracy with the most
sweeps has failed on the problem.

Self-consistency is how little Δt changes a run (Le Lidec and others). It is measured by the error of the kinetic-energy
curve, against runs of the same engine with a sixteenth of the step. Piles are chaotic, so that means over seeds are
compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from deep_contact import figures, parallel
from deep_contact.analysis import lcp
from deep_contact.analysis.exact import solve_exactly
from deep_contact.figures import Claim, Figure
from deep_contact.io.provenance import commit
from deep_contact.measure import peers
from deep_contact.measure.errors import REST, errors, observe
from deep_contact.measure.watched import readings_of
from deep_contact.plot import plotting
from deep_contact.scenes import lattice_in_box
from deep_contact.solvers import NNCG, PGS, PSOR, BatchedPGS, NesterovPGS
from deep_contact.state.state import StateWithContacts
from deep_contact.stepping.problem import solve
from deep_contact.studies import piles, runs

SOLVERS = {
    "PGS": PGS(),
    "PSOR 1.3": PSOR(omega=1.3),
    "NesterovPGS": NesterovPGS(),
    "NNCG": NNCG(),
    "BatchedPGS": BatchedPGS(),
}
"""Name -> solver of this package."""

MADE = {
    "piles": piles.pile_scene,
    "two sizes": lambda n, seed: lattice_in_box(n, seed=seed, radius=(0.5, 1.5)),
    "two densities": lambda n, seed: runs.two_densities(n, ratio=10.0, seed=seed),
}
"""Name of a set of problems -> function (n_bodies, seed=…) that makes its scenes."""

MEASURES = {
    "velocity error": "velocity error",
    "NCP residual": "NCP residual over g Δt",
    "approach": "approach over g Δt",
    "Signorini gap": "Signorini gap",
    "dissipation gap": "dissipation gap",
}
"""Name of a measure -> label of its axis."""

REACHED = {"velocity error": 0.1, "NCP residual": 0.1}
"""Name of a measure -> value at which a problem counts as solved, in a performance profile."""

OURS = "ours, PGS"
ENGINES = {
    OURS: {"method": "PGS", "sweeps": 10},
    "Box2D 2.3": {"engine": "Box2D 2.3", "sweeps": 10, "position_sweeps": 4},
    "pymunk": {"engine": "pymunk", "sweeps": 10},
    "Box2D v3": {"engine": "Box2D v3", "sweeps": 4},
}
"""Name of a line of the self-consistency -> setting without its Δt.

Numbers of iterations are near those that the engines advise.
"""

FINEST = 16
"""Number of steps in Δt of the runs with which the other runs of an engine are compared."""

SAME = 0.01
"""Largest difference of a rival's velocities from those that its impulses give here, over ‖v* − v⁻‖_M.

With a larger difference, it has solved another problem, which is left out. A small difference remains, since the arms
of Chipmunk's contacts end at the surfaces of the circles, and those of Box2D and of this package between them.
"""


# ---- one problem ----


def problem_of(kind: str, phase: str, n_bodies: int, seed: int) -> StateWithContacts:
    """Return the state whose next step is the problem. kind: one of `MADE`. phase: one of `piles.KINDS`."""
    state = piles.pile(phase, n_bodies, seed, make=MADE[kind])
    return piles.without_past(state)


def measures_of(problem: lcp.ContactProblem, impulse: np.ndarray, exact: np.ndarray, speed: float) -> dict[str, float]:
    """Return the `MEASURES` of impulses.

    impulse: λ, (2 m,), N·s. exact: velocities of an exact solution, (3 n,). speed: g Δt, m/s.
    """
    mass = 1.0 / problem.inverse_mass
    wrong, change = problem.velocities(impulse) - exact, exact - problem.free_velocity
    energy = mass @ change**2
    return {
        "velocity error": float(math.sqrt(mass @ wrong**2 / energy)),
        "NCP residual": lcp.natural_residual(problem, impulse) / speed,
        "approach": lcp.approach(problem, impulse) / speed,
        "Signorini gap": lcp.signorini_gap(problem, impulse) / energy,
        "dissipation gap": lcp.dissipation_gap(problem, impulse) / energy,
    }


def measure(*, kind: str, phase: str, n_bodies: int, seed: int, after: list[int], **_) -> dict:
    """Measure all solvers on a problem (`problem_of`) after each number of sweeps in `after`.

    Returns {"problem": its arguments, "contacts": number of contacts, "exact": whether an exact solution was found}. If
    it was, there are "solvers", name -> measure -> values by sweeps, and "left out", rival -> why.
    """
    case = kind, phase, n_bodies, seed
    state = problem_of(*case)
    exact = solve_exactly(state)
    about = {"problem": list(case), "contacts": state.contacts.count}
    if not exact.converged or not state.contacts.count:
        return about | {"exact": False}
    problem, speed = lcp.contact_problem(state), state.dt * math.hypot(*state.world.gravity)
    true = np.column_stack([exact.solution.velocities, exact.solution.angular_velocities]).ravel()
    nothing, found, why = np.zeros(state.contacts.count), {}, {}
    for name, solver in SOLVERS.items():
        ends = [solve(state, replace(solver, sweeps=k, tolerance=None), nothing, nothing) for k in after]
        impulses = [np.column_stack([end.normal_impulses, end.tangent_impulses]).ravel() for end in ends]
        found[name] = [measures_of(problem, impulse, true, speed) for impulse in impulses]
    for name, impulses_by in READERS.items():
        try:
            ends = [impulses_by(state, k) for k in after]
        except (ImportError, ValueError) as error:
            why[name] = str(error)
            continue
        off = max(difference(problem, impulse, velocity, true) for impulse, velocity in ends)
        if off > SAME:
            why[name] = f"another problem: velocities differ by {off:.2g}"
        else:
            found[name] = [measures_of(problem, impulse, true, speed) for impulse, _ in ends]
    by_measure = {name: {one: [of[one] for of in rows] for one in MEASURES} for name, rows in found.items()}
    return about | {"exact": True, "solvers": by_measure, "left out": why}


def difference(problem: lcp.ContactProblem, impulse: np.ndarray, velocity: np.ndarray, exact: np.ndarray) -> float:
    """Return ‖v_engine − v(λ)‖_M / ‖v* − v⁻‖_M: whether an engine has solved this problem.

    impulse: λ of the engine, (2 m,), N·s. velocity: its velocities, (3 n,). exact: v*, (3 n,).
    """
    mass = 1.0 / problem.inverse_mass
    wrong, change = velocity - problem.velocities(impulse), exact - problem.free_velocity
    return float(math.sqrt(mass @ wrong**2 / (mass @ change**2)))


def box2d_impulses(state: StateWithContacts, iterations: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (λ, (2 m,), N·s, velocities, (3 n,)) of one step of Box2D 2.3 from impulses of 0.

    iterations: number of velocity iterations. Contacts that Box2D does not have get impulses of 0.
    """
    engine, n, index = peers.Box2D23(state), state.bodies.count, index_of(state)
    engine.step(state.dt, iterations, 0)
    impulse = np.zeros((state.contacts.count, 2))
    for contact in engine.world.contacts:
        a, b = contact.fixtureA.userData, contact.fixtureB.userData
        # The adapter numbers circles from 0. The box is −1, whose child is the wall, and segments follow from −5 down.
        a, b = (a if a >= 0 else n - 1 - a + contact.childIndexA), (b if b >= 0 else n - 1 - b + contact.childIndexB)
        manifold = contact.manifold  # has to be bound to a name, or its points are freed
        if (pair := (min(a, b), max(a, b))) in index and manifold.pointCount:
            point = manifold.points[0]
            impulse[index[pair]] = point.normalImpulse, point.tangentImpulse
    return impulse.ravel(), velocities_of(engine)


def pymunk_impulses(state: StateWithContacts, iterations: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (λ, (2 m,), N·s, velocities, (3 n,)) of one step of Chipmunk from impulses of 0.

    Chipmunk moves bodies before it detects contacts. So they begin where they were Δt before, to be at the positions of
    the state. iterations: number of iterations. Contacts that Chipmunk does not have get impulses of 0.
    """
    bodies, n, index = state.bodies, state.bodies.count, index_of(state)
    engine = peers.Pymunk(state.replace(bodies=bodies._replace(position=bodies.position - state.dt * bodies.velocity)))
    engine.step(state.dt, iterations)
    walls = [shape for shape in engine.space.shapes if shape.body is engine.space.static_body]
    of_shape = {shape: n + k for k, shape in enumerate(walls)}
    of_shape |= {shape: i for i, body in enumerate(engine.space.bodies) for shape in body.shapes}
    impulse, normal = np.zeros((state.contacts.count, 2)), state.contacts.normal

    def read(arbiter):
        pair = tuple(sorted(of_shape[shape] for shape in arbiter.shapes))
        if pair in index:
            i, total = index[pair], np.array(arbiter.total_impulse)
            total *= math.copysign(1.0, total @ normal[i])  # a contact pushes: whose impulse it is does not matter
            impulse[i] = total @ normal[i], total @ (normal[i, 1], -normal[i, 0])

    for body in engine.space.bodies:
        body.each_arbiter(read)
    return impulse.ravel(), velocities_of(engine)


READERS = {"Box2D 2.3": box2d_impulses, "pymunk": pymunk_impulses}
"""Name of another engine -> function (state, iterations) that reads the impulses of one step."""


def index_of(state: StateWithContacts) -> dict[tuple[int, int], int]:
    """Return the two bodies of each contact -> its index."""
    pairs = zip(state.contacts.body_a.tolist(), state.contacts.body_b.tolist())
    return {pair: i for i, pair in enumerate(pairs)}


def velocities_of(engine) -> np.ndarray:
    """Return (v_x, v_y, ω) of the circles of another engine, (3 n,)."""
    bodies = engine.bodies()
    return np.column_stack([bodies.velocity, bodies.spin]).ravel()


# ---- self-consistency ----


def energy_changes(
    *, setting: Mapping, splits: list[int], n_bodies: int, seeds: list[int], seconds: float, **_
) -> dict:
    """Return {"errors": the error of the energy, %, for each number of steps in Δt, or None if a run fails, "why"}.

    The error is that against runs of the same engine with `FINEST` steps in Δt. setting: setting without its Δt.
    splits: numbers of steps in Δt. seeds: those of the piles. seconds: duration of a run, s.
    """
    frames = max(REST, round(seconds / runs.INTERVAL))

    def ensemble(split):
        scenes = (piles.pile_scene(n_bodies, seed) for seed in seeds)
        each = ((scene, {**setting, "dt": scene.dt / split}) for scene in scenes)
        return [observe(readings_of(scene, one, frames, runs.INTERVAL)) for scene, one in each]

    try:
        finest = ensemble(FINEST)
        return {"errors": [errors(ensemble(split), finest)["energy"] for split in splits], "why": ""}
    except (ImportError, ValueError, FloatingPointError) as error:
        return {"errors": None, "why": str(error)}


def compute(options, seed, jobs, progress):
    """Measure all solvers on all problems, and the self-consistency of the engines.

    The results of finished parts are in the folder `work`, so that a run of the same commit can be resumed.
    """
    common, how = {"commit": commit(), "after": options["after"]}, {"work": Path(options["work"]), "jobs": jobs}
    cases = [
        common | {"kind": kind, "phase": phase, "n_bodies": int(n), "seed": one}
        for n, count in options["problems"].items()
        for kind in MADE
        for phase in piles.KINDS
        for one in parallel.seeds(seed, count)
    ]
    found = runs.done("problem", measure, cases, **how)
    several = {name: options[name] for name in ("splits", "seconds")} | {"n_bodies": options["circles"]}
    lines = [
        common | several | {"setting": setting, "seeds": parallel.seeds(seed, options["seeds"])}
        for setting in ENGINES.values()
    ]
    return {
        "after": options["after"],
        "problems": [one for one in found if one["exact"]],
        "without an exact solution": [one["problem"] for one in found if not one["exact"]],
        "splits": options["splits"],
        "self-consistency": dict(zip(ENGINES, runs.done("energy", energy_changes, lines, **how))),
    }


# ---- results ----


def names_of(data: Mapping) -> list[str]:
    """Return the names of all solvers that were measured on any problem."""
    return list(dict.fromkeys(name for one in data["problems"] for name in one["solvers"]))


def medians(data: Mapping, solver: str, measure: str) -> np.ndarray:
    """Return the medians of a measure over the problems, by number of sweeps."""
    curves = [one["solvers"][solver][measure] for one in data["problems"] if solver in one["solvers"]]
    return np.median(curves, axis=0)


def sweeps_to(one: Mapping, after: list[int], solver: str, measure: str) -> float:
    """Return the sweeps after which a measure stays at most its value of `REACHED`, or infinity. one: a problem."""
    if solver not in one["solvers"]:
        return math.inf
    over = np.flatnonzero(np.array(one["solvers"][solver][measure]) > REACHED[measure])
    first = 0 if over.size == 0 else over[-1] + 1
    return float(after[first]) if first < len(after) else math.inf


def profile(data: Mapping, measure: str) -> dict[str, np.ndarray]:
    """Return the ratios of a performance profile: solver -> sweeps over those of the best, (problems,), or infinity.

    Problems that no solver has solved are left out.
    """
    names, rows = names_of(data), []
    for one in data["problems"]:
        needed = np.array([sweeps_to(one, data["after"], name, measure) for name in names])
        if np.isfinite(needed.min()):
            rows.append(needed / needed.min())
    return dict(zip(names, np.reshape(rows, (-1, len(names))).T))


def share_within(ratios: np.ndarray, tau: float) -> float:
    """Return ρ(τ), the share of problems whose ratio is at most τ."""
    return float(np.mean(ratios <= tau)) if ratios.size else math.nan


def table(data):
    """Return the rows of the table: the medians of each solver after 10 and 100 sweeps, and its performance profile."""
    head = ["solver", "sweeps", *MEASURES, "solved", "best", "within 2 times"]
    rows, ratios = [head], profile(data, "velocity error")
    shown = [k for k in (10, 100) if k in data["after"]]
    for name in names_of(data):
        for k in shown:
            values = [float(medians(data, name, one)[data["after"].index(k)]) for one in MEASURES]
            of = [share_within(ratios[name], tau) for tau in (np.finfo(float).max, 1.0, 2.0)]
            rows.append([name, k, *values, *(of if k == shown[0] else (None,) * 3)])
    return rows


def claims(data) -> Iterator[Claim]:
    """Yield claims on the solvers, the other engines and the self-consistency."""
    for measure, value in REACHED.items():
        ratios = profile(data, measure)
        best = {name: share_within(of, 1.0) for name, of in ratios.items()}
        solved = {f"{name}, solved": share_within(of, np.finfo(float).max) for name, of in ratios.items()}
        ours = {name: share for name, share in best.items() if name in SOLVERS}
        text = f"one solver here is the first to reach {value:g} of the {measure} in half of the problems"
        yield Claim(text, None, max(ours.values(), default=0.0) >= 0.5, best | solved)
    same = {}
    for rival in (name for name in names_of(data) if name in ENGINES):
        both = [one["solvers"] for one in data["problems"] if rival in one["solvers"]]
        ratio = [np.divide(*(one[name]["velocity error"] for name in (rival, "PGS"))) for one in both]
        same[rival] = float(np.median(ratio))
    if same:
        text = "a sweep of another engine is worth as much as one of PGS, to a tenth of the velocity error"
        yield Claim(text, None, all(0.9 <= ratio <= 1.1 for ratio in same.values()), same)
    known = {name: of["errors"] for name, of in data["self-consistency"].items() if of["errors"]}
    if len(known) > 1:
        at_whole = {name: of[data["splits"].index(1)] for name, of in known.items()}
        least = min(at_whole, key=at_whole.get)
        text = "the step of 10 ms changes the energy of ours less than that of the other engines"
        yield Claim(text, None, least == OURS, at_whole)


def draw(data, options):
    """Draw the measures by sweeps, the performance profile, and the self-consistency."""
    figure, axes = plotting.subplots(2, 3, size=(plotting.PAGE, 6.2))
    names, panels = names_of(data), axes.ravel()
    looks = plotting.styles_of(names)
    for name in names:
        if name in plotting.ENGINE_MARKER:
            looks[name] |= {"color": plotting.GREY, "marker": plotting.ENGINE_MARKER[name], "markersize": 3}
    shown = ("velocity error", "NCP residual", "Signorini gap", "dissipation gap")
    for ax, measure in zip(panels, shown):
        for name in names:
            ax.plot(data["after"], np.maximum(medians(data, name, measure), 1e-9), **looks[name])
        plotting.log_axes(ax)
        plotting.label_axes(ax, "sweeps", MEASURES[measure])
    panels[0].legend(fontsize=6.5)
    tau = np.geomspace(1.0, 64.0, 200)
    for name, ratios in profile(data, "velocity error").items():
        panels[4].plot(tau, [share_within(ratios, t) for t in tau], **(looks[name] | {"marker": None}))
    panels[4].set(xscale="log", ylim=(-0.02, 1.02))
    panels[4].set_xticks([1, 2, 4, 8, 16, 32, 64], ["1", "2", "4", "8", "16", "32", "64"])
    plotting.label_axes(panels[4], "τ, sweeps over those of the best", "share of problems ρ(τ)")
    for name, of in data["self-consistency"].items():
        if of["errors"]:
            mark = plotting.ENGINE_MARKER.get(name)
            look = {"color": plotting.GREY, "marker": mark} if mark else {"color": plotting.BLUE, "marker": "o"}
            panels[5].plot([10.0 / split for split in data["splits"]], of["errors"], label=name, markersize=4, **look)
    plotting.log_axes(panels[5])
    panels[5].legend(fontsize=6.5)
    plotting.label_axes(panels[5], "Δt", "energy against Δt / 16", x_unit="ms", y_unit="%")
    return figure


OPTIONS = {
    "problems": {"100": 5}, "after": [1, 2, 3, 4, 6, 8, 10, 14, 20, 28, 40, 56, 80, 100, 160, 230, 320, 450],
    "circles": 100, "seeds": 8, "splits": [1, 2, 4, 8], "seconds": 4.0, "work": "runs/figure_6_18",
}  # fmt: skip
QUICK = {"problems": {"30": 1}, "after": [1, 3, 10, 30, 100], "circles": 30, "seeds": 2, "splits": [1, 2],
         "seconds": 3.0}  # fmt: skip
FIGURE = Figure("6.18", "Solvers and engines by the measures of the field", compute, table, draw, claims,
                options=OPTIONS, quick=QUICK, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
