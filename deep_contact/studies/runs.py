"""The trade of speed for accuracy in whole runs: errors and times of settings and of other engines.

Run by `scripts/run_tradeoff.py`, read by the presets. A setting is a method with a fixed number of sweeps and a time
step; an engine's is its iterations and a time step. Every setting runs the same falling piles. A pile is chaotic: two
runs differ after a second, whatever the solver. So errors compare means and distributions over ensembles of seeds with
those of the limit of small steps. Errors need no quiet machine; times are measured one after the other on one.

Time steps are given for circles of r = 1 m under g = 9.81 m/s²: what counts is Δt √(g / r). Errors count lengths in
mean radii r and speeds in √(g r): the numbers are the same at every scale. Without gravity a tenth of the fastest
circle's speed stands in for √(g r), as in `presets.longest_step`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from deep_contact.constants import GRAVITY, TIME_STEP
from deep_contact.io import shipped
from deep_contact.physics.engine import contacts_of
from deep_contact.physics.scenes import drum, hopper, lattice_in_box, terrain
from deep_contact.physics.solvers import METHODS, solver_from
from deep_contact.physics.solvers.batched import CIRCLES_A_THREAD
from deep_contact.presets import FASTEST, PRESETS, keeping
from deep_contact.reporting import results
from deep_contact.simulation import simulate
from deep_contact.state import State
from deep_contact.studies import peers, piles, timing
from deep_contact.studies.verdicts import interval
from deep_contact.validation import one_of

RESULTS = {"results": "data/reference/run_tradeoff.json"}
"""The option of figures that draw the study: its results file."""

INTERVAL = 5 * TIME_STEP
"""Between two observations, s."""


def gas(n_bodies: int, *, gap: float = 1.0, restitution: float = 0.8, seed: int = 0) -> State:
    """Circles on a loose lattice without gravity, whose velocities are drawn; collisions cool it.

    The fastest one has the speed that the time steps are meant for, `FASTEST` √(g r) of r = 1 m under 9.81 m/s².
    """
    rng = np.random.default_rng(seed)
    lattice = lattice_in_box(n_bodies, gap=gap, restitution=restitution, gravity=(0.0, 0.0), seed=rng)
    most = FASTEST * math.sqrt(-0.5 * GRAVITY[1])  # of a component
    velocity = rng.uniform(-most, most, (n_bodies, 2))
    return lattice.replace(name=f"gas_{n_bodies}", bodies=lattice.bodies._replace(velocity=velocity))


def two_densities(n_bodies: int, *, ratio: float, heavy: str = "mixed", seed: int = 0) -> State:
    """A pile in which some circles are `ratio` times as dense as the others.

    heavy: which of them: "mixed", 30 % drawn by chance, or the half "above" or "below" at the start.
    """
    pile = piles.scene(n_bodies, seed)
    height = pile.bodies.position[:, 1]
    chosen = {
        "mixed": np.random.default_rng((seed, 1)).permutation(n_bodies) < 0.3 * n_bodies,
        "above": height > np.median(height),
        "below": height < np.median(height),
    }[one_of("heavy", heavy, ("mixed", "above", "below"))]
    return pile.replace(bodies=pile.bodies._replace(mass=np.where(chosen, ratio, 1.0) * pile.bodies.mass))


def dam_break(n_bodies: int, *, aspect: float = 2.0, room: float = 4.0, seed: int = 0, **options) -> State:
    """A loose lattice `aspect` times as high as wide at the left wall of a box `room` times as wide: it collapses.

    options: those of `lattice_in_box`.
    """
    lattice = lattice_in_box(n_bodies, columns=max(1, round(math.sqrt(n_bodies / aspect))), seed=seed, **options)
    _, _, width, height = lattice.world.box
    return lattice.replace(name=f"dam_{n_bodies}", world=replace(lattice.world, box=(0, 0, room * width, height)))


KINDS = {
    "plain": {},
    "mixed radii": {"radius": (0.5, 1.5)},
    "no friction": {"friction": 0.0},
    "elastic 0.3": {"restitution": 0.3},
    "elastic 0.8": {"restitution": 0.8},
    "gas": {"make": gas},
    "drum": {"make": drum, "froude": 0.1, "sides": 24},
    "densities 1 : 2": {"make": two_densities, "ratio": 2.0},
    "densities 1 : 10": {"make": two_densities, "ratio": 10.0},
    "heavy on light 1 : 10": {"make": two_densities, "ratio": 10.0, "heavy": "above"},
    "light on heavy 1 : 10": {"make": two_densities, "ratio": 10.0, "heavy": "below"},
    "densities 1 : 100": {"make": two_densities, "ratio": 100.0},
    "heavy on light 1 : 100": {"make": two_densities, "ratio": 100.0, "heavy": "above"},
    "dam break": {"make": dam_break},
}
"""Kind of scene -> options of `piles.scene`, or of the scene that is named."""

DENSE_KINDS = [kind for kind in KINDS if "1 : " in kind or kind == "dam break"]
"""Kinds that need more sweeps: two densities, and a dam that breaks."""

HELD_OUT_KINDS = {
    "plain": {},
    "narrow radii": {"radius": (0.7, 1.3)},
    "slippery": {"friction": 0.2},
    "loose": {"gap": 0.3},
    "bouncing": {"restitution": 0.3, "radius": (0.7, 1.3)},
    "elastic": {"restitution": 0.6},
    "thin gas": {"make": gas, "gap": 2.0, "restitution": 0.9},
    "slow drum": {"make": drum, "froude": 0.05, "sides": 40},
    "rough": {"friction": 1.0},
    "wide radii": {"radius": (0.15, 1.5)},
    "hopper": {"make": hopper},
    "terrain": {"make": terrain},
    "low dam": {"make": dam_break, "aspect": 1.0, "room": 3.0, "radius": (0.8, 1.0)},
    "densities 1 : 5": {"make": two_densities, "ratio": 5.0},
    "densities 1 : 30": {"make": two_densities, "ratio": 30.0},
    "heavy on light 1 : 5": {"make": two_densities, "ratio": 5.0, "heavy": "above"},
    "light on heavy 1 : 30": {"make": two_densities, "ratio": 30.0, "heavy": "below"},
}
"""Kinds of the scenes outside the study."""

MOMENTS = (0.75, 2.25, 3.75, 5.25)
"""When piles are timed, s after the start. The cost of a setting is the mean over these: that of a run of 6 s."""

POSITION_SWEEPS = 10
"""Of Box2D 2.3, at most."""

WARM = 5
"""Steps of another engine before its time counts: the first ones fill its memory and find all contacts anew."""

PHASES = ("impact", "rest")
"""Phases in which piles are timed as well, to show how a cost changes in a run."""

TWENTY = METHODS["PGS"](sweeps=20, tolerance=None)
"""Drives the piles that are timed."""

REFERENCE = {"method": "PGS", "sweeps": 20, "dt": TIME_STEP / 16}
"""Taken for the limit of small steps; Figure 6.2 shows that the steps before it come to the same within the noise."""


def scene(kind: str, n_bodies: int, seed: int) -> State:
    """A scene of a kind. Piles: the thesis's scene for 100 circles and fewer, otherwise a loose lattice that falls."""
    options = dict((KINDS | HELD_OUT_KINDS)[kind])
    if make := options.pop("make", None):
        return make(n_bodies, seed=seed, **options)
    return piles.scene(n_bodies, seed, **{key: options[key] for key in options if key != "gap" or n_bodies > 100})


def solver_of(setting: Mapping):
    """The options of a setting's method, without substeps."""
    options = {name: value for name, value in setting.items() if name not in ("method", "dt", "start")}
    return solver_from(setting["method"], options | {"tolerance": None})


def name_of(setting: Mapping) -> str:
    """Such as "PGS, 10 sweeps, Δt / 2", or of an engine "Box2D v3, 4 iterations, Δt / 2"; Δt is 0.01 s."""
    budget = "iteration" if "engine" in setting else "sweep"
    words = [
        setting.get("engine") or setting["method"],
        f"{setting['sweeps']} {budget}{'s' * (setting['sweeps'] != 1)}",
    ]
    words += [f"{key}={setting[key]}" for key in setting if key not in ("engine", "method", "sweeps", "dt")]
    ratio = TIME_STEP / setting["dt"]
    words.append("Δt" if ratio == 1 else f"Δt / {ratio:g}" if ratio > 1 else f"{1 / ratio:g} Δt")
    return ", ".join(words)


# ---- observations ----


def observed(kind: str, n_bodies: int, seed: int, setting: Mapping, *, seconds: float) -> dict:
    """The `Observation` of one run as lists, five digits: of our engine, or of another where the setting names one."""
    if not np.isclose(INTERVAL / setting["dt"], round(INTERVAL / setting["dt"])):
        raise ValueError(f"dt: expected a step that divides {INTERVAL} s, got {setting['dt']}")
    start, frames = scene(kind, n_bodies, seed), round(seconds / INTERVAL)
    states = (_states_of_peer if "engine" in setting else _states)(start, setting, frames)
    return results.plain(observe(states)._asdict(), digits=5)


def observation(stored: Mapping) -> Observation:
    """The inverse of `observed`."""
    arrays = {name: np.array(value) if isinstance(value, list) else value for name, value in stored.items()}
    return Observation(**arrays)


def _states(state: State, setting: Mapping, frames: int) -> Iterator[State]:
    state, each = state.replace(dt=setting["dt"]), round(INTERVAL / setting["dt"])
    solver = solver_of(setting)
    for _ in range(frames):
        state = simulate(state, steps=each, solver=solver, warm_start=setting.get("start", "builtin")).state
        yield state


def _world(start: State, setting: Mapping, **threads):
    """The scene in the engine that a setting names, with the setting's knobs."""
    knobs = {name: value for name, value in setting.items() if name in ("slop", "bias", "hertz")}
    return peers.ENGINES[setting["engine"]](start.replace(dt=setting["dt"], contacts=None), **knobs, **threads)


def _run(world, setting: Mapping, steps: int) -> None:
    """So many steps of the setting's Δt."""
    world.run(steps, setting["dt"], setting["sweeps"], setting.get("position_sweeps", POSITION_SWEEPS))


def _states_of_peer(start: State, setting: Mapping, frames: int) -> Iterator[State]:
    world, each = _world(start, setting), round(INTERVAL / setting["dt"])
    for k in range(frames):
        _run(world, setting, each)
        state = start.replace(bodies=world.bodies(), time=(k + 1) * INTERVAL)
        yield state.replace(contacts=contacts_of(state))


# ---- errors of an ensemble of runs ----

LOADS = np.linspace(0.0, 6.0, 121)
"""Where the distribution of λ_n / mean λ_n is kept."""

REST = 20
"""The last so many observations are those at rest."""

SETTLED = 0.2
"""Root mean square speed of the reference at rest, √(g r), below which heights are settled: those in a drum are not."""

TOUCHING = 1e-3
"""Gap, in radii, below which two circles count as in contact: rigid ones that touch have a gap of 0."""

ERRORS = {
    "energy": "kinetic-energy curve: Σ |⟨E_k⟩ − ⟨E_k⟩*| / Σ ⟨E_k⟩* over the whole run, %",
    "height": "settled height of the centre of mass: difference, % of the reference's",
    "creep": "change of the settled height: difference of speeds, % of √(g r)",
    "penetration": "penetration at rest, mean over contacts, % of r",
    "penetration_95": "penetration at rest, 95th percentile over contacts, % of r",
    "penetration_max": "deepest penetration at any time, mean over seeds, % of r",
    "restlessness": "rms speed at rest above the reference's, % of √(g r)",
    "contacts": "contacts per circle at rest, gap below 0.1 % of r: difference",
    "forces": "distribution of λ_n / mean λ_n at rest: Kolmogorov-Smirnov distance, %",
    "impact": "largest force on the box in an interval: difference, % of the reference's",
}
"""Name -> what it is, and its unit. All but the penetrations, which should be 0, are against the reference.

Energy, height and force are those of the whole pile (the force from its momentum: M (g + dv_y / dt), in weights; its
mean at rest is 1, exactly). The distribution of forces is the classical fingerprint of a granular packing (Radjai et
al., Phys. Rev. Lett. 77, 1996); penetration and restlessness are what engine users look at (Catto, Solver2D, 2024).
"""


class Observation(NamedTuple):
    """What is looked at of one run, at T equally spaced times.

    | field       | meaning                                                                    | shape    | unit    |
    |-------------|----------------------------------------------------------------------------|----------|---------|
    | kinetic     | kinetic energy                                                             | (T,)     | M u²    |
    | height      | of the centre of mass above the floor                                      | (T,)     | r       |
    | speed       | root mean square over the circles                                          | (T,)     | u       |
    | penetration | mean, 95th percentile and largest over the contacts                        | (T, 3)   | r       |
    | contacts    | pairs whose gap is below `TOUCHING`, per circle                            | (T,)     | –       |
    | force       | mean vertical force on the box since the time before; None without gravity | (T − 1,) | M g     |
    | loads       | share of the λ_n > 0 at rest that are at most LOADS · mean; None if unknown | (121,)   | –       |
    | interval    | between two times                                                          | ()       | r / u   |

    u = √(g r); without gravity a tenth of the fastest circle's speed at the first time.
    """

    kinetic: np.ndarray
    height: np.ndarray
    speed: np.ndarray
    penetration: np.ndarray
    contacts: np.ndarray
    force: np.ndarray | None
    loads: np.ndarray | None
    interval: float


def observe(states: Iterable[State]) -> Observation:
    """What is looked at of a run: of its states, with contacts, at equally spaced times (a `Trajectory` has them).

    Impulses are those that unsolved states carry. Raises ValueError with fewer than `REST` states, or where there is
    neither gravity nor motion.
    """
    rows, momentum, loads, times, unit = [], [], [], [], None
    for state in states:
        bodies = state.bodies
        g, r, mass = float(np.hypot(*state.world.gravity)), float(bodies.radius.mean()), float(bodies.mass.sum())
        squares = (bodies.velocity**2).sum(axis=1)
        unit = unit or math.sqrt(g * r) or math.sqrt(squares.max()) / FASTEST
        if unit == 0:
            raise ValueError("states: expected gravity or motion, by which errors of a run are scaled, got none")
        kinetic = 0.5 * (bodies.mass @ squares + bodies.inertia @ bodies.spin**2) / (mass * unit**2)
        height = (bodies.mass @ bodies.position[:, 1] / mass - state.world.box[1]) / r
        speed = np.sqrt(squares.mean()) / unit
        depth = np.maximum(0.0, -state.contacts.separation) / r
        deep = (depth.mean(), np.percentile(depth, 95), depth.max()) if depth.size else (0.0, 0.0, 0.0)
        touching = np.count_nonzero(state.contacts.separation <= TOUCHING * r) / bodies.count
        rows.append((kinetic, height, speed, *deep, touching))
        momentum.append(bodies.mass @ bodies.velocity[:, 1] / mass / unit)
        impulses = state.contacts.normal_start
        loads.append(impulses[impulses > 0])
        times.append(state.time * unit / r)
    if len(rows) < REST:
        raise ValueError(f"states: expected at least {REST}, got {len(rows)}")
    table = np.array(rows)
    interval = (times[-1] - times[0]) / (len(times) - 1)
    force = 1.0 + np.diff(momentum) / interval if g else None
    at_rest = np.concatenate([found / found.mean() for found in loads[-REST:] if found.size] or [np.empty(0)])
    known = np.searchsorted(np.sort(at_rest), LOADS, side="right") / at_rest.size if at_rest.size else None
    return Observation(table[:, 0], table[:, 1], table[:, 2], table[:, 3:6], table[:, 6], force, known, interval)


def errors(found: Sequence[Observation], reference: Sequence[Observation]) -> dict[str, float | None]:
    """The `ERRORS` of an ensemble against the reference's ensemble of the same scenes; None for an unknown one.

    Without gravity nothing comes to rest: the energy and the deepest penetration are left.
    """
    mean, true = _means(found), _means(reference)
    at_rest = slice(-REST, None)

    def creep(means):
        """Slope of the straight line through the settled heights, √(g r)."""
        return np.polyfit(reference[0].interval * np.arange(REST), means["height"][at_rest], 1)[0]

    values = {
        "energy": np.abs(mean["kinetic"] - true["kinetic"]).sum() / true["kinetic"].sum(),
        "height": abs(mean["height"][at_rest].mean() / true["height"][at_rest].mean() - 1),
        "creep": abs(creep(mean) - creep(true)) if true["speed"][at_rest].mean() < SETTLED else None,
        "penetration": mean["penetration"][at_rest, 0].mean(),
        "penetration_95": mean["penetration"][at_rest, 1].mean(),
        "penetration_max": np.mean([one.penetration[:, 2].max() for one in found]),
        "restlessness": max(0.0, mean["speed"][at_rest].mean() - true["speed"][at_rest].mean()),
        "contacts": abs(mean["contacts"][at_rest].mean() - true["contacts"][at_rest].mean()),
        "forces": None if mean["loads"] is None else np.abs(mean["loads"] - true["loads"]).max(),
        "impact": mean["peak"] and abs(mean["peak"] / true["peak"] - 1),
    }
    if true["peak"] is None:
        values |= dict.fromkeys(values.keys() - {"energy", "penetration_max"})
    return {
        name: None if value is None else float(value) * (1.0 if name == "contacts" else 100.0)
        for name, value in values.items()
    }


def intervals(
    found: Sequence[Observation], reference: Sequence[Observation], *, resamples: int = 400
) -> dict[str, tuple[float, float, float] | None]:
    """Each of the `errors` with its interval (`verdicts.interval`): name -> (value, low, high), or None.

    The same seeds are drawn for both ensembles. Raises ValueError where these differ in length.
    """
    if len(found) != len(reference):
        raise ValueError(f"found: expected {len(reference)} runs, as the reference has, got {len(found)}")
    values = errors(found, reference)
    known = [name for name, value in values.items() if value is not None]

    def of_seeds(drawn):
        pairs = [([found[i] for i in row], [reference[i] for i in row]) for row in drawn]
        return np.array([[value for name, value in errors(*pair).items() if name in known] for pair in pairs])

    three = interval(of_seeds, len(found), resamples=resamples).T.tolist()
    return dict.fromkeys(values) | {name: tuple(numbers) for name, numbers in zip(known, three)}


def _means(runs: Sequence[Observation]) -> dict:
    """Mean curves of an ensemble, and its mean peak of the force."""
    names = ("kinetic", "height", "speed", "penetration", "contacts")
    means = {name: np.mean([getattr(run, name) for run in runs], axis=0) for name in names}
    known = all(run.loads is not None for run in runs)
    means["peak"] = None if runs[0].force is None else np.mean([run.force.max() for run in runs])
    return means | {"loads": np.mean([run.loads for run in runs], axis=0) if known else None}


# ---- times ----


def times(
    kind: str, n_bodies: int, seed: int, settings: Sequence[Mapping], *, steps: int, repeats: int, phase: str | float
) -> dict[str, float]:
    """Wall time of TIME_STEP of a scene with each setting, μs, by name; they take turns, the least counts.

    phase: one of `PHASES` of a pile, or seconds after the start. steps: of TIME_STEP in each run. Other engines start
    from the same bodies, in worlds that have done `WARM` steps before and are not destroyed until the times are known;
    what their Python wrapper costs a step is part of what their users pay. Of scenes for which ours takes two threads,
    they are run on one and on two, where they can, and the lesser time counts.
    """
    if phase in PHASES:
        start = piles.pile(phase, n_bodies, seed, solver=TWENTY, most=6000, make=partial(scene, kind))
    else:
        start = simulate(scene(kind, n_bodies, seed), steps=round(phase / TIME_STEP), solver=TWENTY).state
    runs, setup, worlds = {}, {}, {}

    def warmed(key, setting, threads):
        worlds[key] = _world(start, setting, **threads)  # here the world of the run before is destroyed
        _run(worlds[key], setting, WARM)

    for setting in settings:
        name, count = name_of(setting), round(steps * TIME_STEP / setting["dt"])
        if "engine" not in setting:
            options = {"solver": solver_of(setting), "warm_start": setting.get("start", "builtin")}
            runs[name, 1] = partial(simulate, start.replace(dt=setting["dt"]), steps=count, **options)
            continue
        two = peers.ENGINES[setting["engine"]].takes_threads and n_bodies >= 2 * CIRCLES_A_THREAD
        for threads in (1, 2) if two else (1,):
            key = name, threads
            setup[key] = partial(warmed, key, setting, {"threads": threads} if threads > 1 else {})
            runs[key] = lambda key=key, setting=setting, count=count: _run(worlds[key], setting, count)
    found: dict[str, float] = {}
    for (name, _), seconds in timing.interleaved(runs, repeats=repeats, setup=setup).items():
        found[name] = min(found.get(name, math.inf), 1e6 * seconds / steps)
    return found


# ---- what the study says ----


def rows(ensembles: Mapping) -> list[dict]:
    """A row for each kind, size and setting: its errors with their intervals; the reference itself has none.

    ensembles: (kind, n_bodies) -> {name: (setting, [Observation, …])}.
    """
    found = []
    for (kind, n_bodies), ensemble in ensembles.items():
        true = ensemble[name_of(REFERENCE)][1]
        for name, (setting, seen) in ensemble.items():
            row = {"kind": kind, "n_bodies": n_bodies, "name": name, "setting": dict(setting), "seeds": len(seen)}
            found.append(row | {"errors": None if seen is true else intervals(seen, true[: len(seen)])})
    return found


def with_times(row: Mapping, took: Sequence[Mapping]) -> dict:
    """The row with its times, μs: "times", the mean over `MOMENTS` in each process that measured them, "us", their
    median, or None, and "phases", the medians of the phases.

    took: for each process (kind, n_bodies, phase) -> {name: μs}.
    """
    scene, name = (row["kind"], row["n_bodies"]), row["name"]
    by_phase: dict = {}
    for of_process in took:
        for (*of, phase), by_name in of_process.items():
            if (*of,) == scene and name in by_name:
                by_phase.setdefault(phase, []).append(by_name[name])
    moments = [by_phase.pop(moment) for moment in MOMENTS if moment in by_phase]
    times = np.mean(moments, axis=0).tolist() if moments else []
    phases = {phase: float(np.median(us)) for phase, us in by_phase.items()}
    return row | {"us": float(np.median(times)) if times else None, "times": times, "phases": phases}


def read_study(path) -> dict:
    """The "plain" rows of a results file, of plain piles with errors, and the "presets" that all of its rows make.

    path: from the current folder, or else of a file that comes with the package.
    """
    found = results.read_results(shipped.find(path))["data"]["rows"]
    return {"plain": [row for row in found if row["kind"] == "plain" and row["errors"]], "presets": presets(found)}


def presets(found: Sequence[Mapping]) -> list[dict]:
    """For each size and preset the setting that it takes, and the cheapest of each rival that keeps it.

    found: rows. Returns [{"n_bodies", "preset", "kinds": kind -> ours, "peers": engine -> on plain piles, "ratio"}] of
    {"name", "us", "times", "seeds", "impact", "rest"} or None each. Ours is what `simulate(accuracy=…)` takes, which
    leaves a margin (`presets.keeping`); a rival's setting may use up all of its tolerances.
    ratio: time of the fastest rival over ours on plain piles, [value, low, high] or None each. The value is the median
    over the processes that measured times. Low is the least of them, and of those where all our errors are at the upper
    and all of theirs at the lower ends of their intervals; high the largest, and of those the other way round.
    """

    def cheapest(n, engine, preset, kind="plain", at=0):
        candidates = [
            {"name": row["name"], "us": row["us"], "times": row["times"], "seeds": row["seeds"], **row["phases"]}
            | {"errors": {name: rounded(error[at]) for name, error in row["errors"].items() if error}}
            for row in found
            if (row["n_bodies"], row["kind"], row["setting"].get("engine")) == (n, kind, engine)
            and row["us"] is not None
            and row["errors"]
        ]
        kept = keeping(candidates, preset, margin=engine is None and at == 0)
        best = min(kept, key=lambda one: one["us"], default=None)
        return best and {key: value for key, value in best.items() if key != "errors"}

    def ratios(n, preset, ours, theirs):
        mine = cheapest(n, None, preset, at=ours)
        rivals = [rival for name in peers.ENGINES if (rival := cheapest(n, name, preset, at=theirs))]
        fastest = min(rivals, key=lambda one: one["us"], default=None)
        return (
            [a / b for a, b in zip(fastest["times"], mine["times"])] if mine and fastest else None
        )  # the same processes

    def ratio(n, preset):
        value, low, high = (ratios(n, preset, *ends) for ends in ((0, 0), (2, 1), (1, 2)))
        if value is None:
            return [None] * 3
        # The value too: the margin that `accuracy=` leaves can make it dearer than what keeps at the ends.
        return [float(np.median(value)), low and min(*low, *value), high and max(*high, *value)]

    kinds = {n: dict.fromkeys(row["kind"] for row in found if row["n_bodies"] == n) for n in sizes_of(found)}
    return [
        {
            "n_bodies": n,
            "preset": preset,
            "kinds": {kind: cheapest(n, None, preset, kind) for kind in kinds[n]},
            "peers": {engine: cheapest(n, engine, preset) for engine in peers.ENGINES},
            "ratio": ratio(n, preset),
        }
        for n, preset in product(kinds, PRESETS)
    ]


def rounded(error: float) -> float:
    """An error with the three digits that the presets' table has, so that it and the study choose alike."""
    return float(f"{error:.3g}")


def with_reach(error: Sequence[float]) -> tuple[float, np.ndarray]:
    """An error of `intervals`, and how far its interval reaches down and up, (2, 1).

    A bootstrap interval by percentiles can lie beside the value, where the value is the largest of what is possible.
    """
    value, low, high = error
    return value, np.maximum([[value - low], [high - value]], 0.0)


def sizes_of(rows: Iterable[Mapping]) -> list[int]:
    """Numbers of circles, ascending."""
    return sorted({row["n_bodies"] for row in rows})
