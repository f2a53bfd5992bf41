"""python scripts/figure_6_7_scene_requirements.py: savings by leaving out what a scene does not require.

Examples are friction rows, position correction and the solution of sleeping circles. Times are measured in this
process, one after the other. No other program should run at the same time.
"""

import functools
import time
from dataclasses import replace

import numpy as np

import deep_contact as dc
from deep_contact import figures, parallel
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.run.one_scene import simulate, solve_contacts
from deep_contact.solvers import PGS
from deep_contact.state import constants
from deep_contact.state.state import State
from deep_contact.stepping.prepare import ready
from deep_contact.studies import piles, timing
from deep_contact.studies.starts import solved_states

FEW = 10
"""Number of sweeps in the shorter of two solves. The difference of their times gives the time of a sweep."""

ENOUGH = 1_000_000
"""Number of relaxations of contacts that the longer solve does more than the shorter one."""


STEP = PGS(sweeps=10, tolerance=None)
"""Solver of the steps that are timed."""

SCATTERED = {"size": (300.0, 30.0), "sigma_coef": 5.0}
"""Options of `circles_in_box` with which the circles fall into many separate heaps."""


interleaved = functools.partial(timing.interleaved, reduce=np.array, clock=time.thread_time)
"""`timing.interleaved` that returns name -> processor times of this thread in all repeats, (repeats,), s."""


def at_rest(scene: State) -> State:
    """Simulate a scene until all its circles sleep, or for at most 60 s, and return its state."""
    for _ in range(60):
        run = simulate(scene, steps=100, solver=PGS(sweeps=200), sleep=True)
        scene = run.state
        if run.relaxations[-1] == 0:
            break
    return scene


def apart(one: State, other: State) -> float:
    """Return the largest distance between the positions of a circle in two states, m."""
    return float(np.hypot(*(one.bodies.position - other.bodies.position).T).max())


def ratio(general: np.ndarray, special: np.ndarray) -> dict[str, float]:
    """Compare the times of one task without a saving (`general`) and with it (`special`), (repeats,) each, s.

    Returns {"ratio": median of general over special, "low", "high": its quartiles, "general", "special": least times}.
    """
    low, middle, high = np.percentile(general / special, (25, 50, 75))
    return {"ratio": middle, "low": low, "high": high, "general": general.min(), "special": special.min()}


def sweep_saving(n_bodies: int, seed: int, *, steps: int, repeats: int) -> dict:
    """Measure the time that a sweep of a resting pile saves without tangent rows. Returns the result of `ratio`.

    The times in the result are those of a contact in a sweep, ns. The entry "apart" is the largest distance between the
    positions of a circle after `steps` steps with and without tangent rows, m. For this comparison μ is 1e-300 and 0.
    The former needs tangent rows, but its friction forces are negligible.
    """
    pile = ready(at_rest(piles.pile_scene(n_bodies, seed)))
    contacts = pile.contacts._replace(tangent_start=np.zeros(pile.contacts.count))
    frictionless, nearly = (
        pile.replace(world=replace(pile.world, friction=friction), contacts=contacts) for friction in (0.0, 1e-300)
    )
    many, ways = FEW + ENOUGH // pile.contacts.count, {"general": pile, "frictionless": frictionless}
    solvers = {k: PGS(sweeps=k, tolerance=None) for k in (FEW, many)}
    runs = {
        (name, k): functools.partial(solve_contacts, state, solver=solver)
        for name, state in ways.items()
        for k, solver in solvers.items()
    }
    times = interleaved(runs, repeats=repeats)
    relaxations = (many - FEW) * pile.contacts.count
    general, special = (1e9 * (times[name, many] - times[name, FEW]) / relaxations for name in ways)
    ends = (simulate(state, steps=steps, solver=STEP).state for state in (nearly, frictionless))
    return ratio(general, special) | {"apart": apart(*ends)}


def step_savings(n_bodies: int, seed: int, *, steps: int, repeats: int) -> dict[str, dict]:
    """Measure the time that a resting pile saves if it sleeps, and without position correction.

    Returns name of the saving -> result of `ratio`, whose times are those of a step with `STEP`, s. The entry "apart"
    is the largest distance between the positions of a circle with and without the saving, m.
    """
    pile = at_rest(piles.pile_scene(n_bodies, seed))
    ways = {
        "awake": dc.Simulator(pile, solver=STEP),
        "asleep": dc.Simulator(pile, solver=STEP, sleep=True),
        "no position correction": dc.Simulator(pile, solver=replace(STEP, position_sweeps=0)),
    }
    runs = {name: functools.partial(one.step, steps) for name, one in ways.items()}
    for run in runs.values():
        run()  # circles fall asleep in these steps, which are not timed
    ends = {name: one.state for name, one in ways.items()}
    times = {name: took / steps for name, took in interleaved(runs, repeats=repeats).items()}
    return {
        name: ratio(times["awake"], times[name]) | {"apart": apart(ends["awake"], ends[name])}
        for name in ways.keys() - {"awake"}
    }


def island_savings(scene: State, *, steps: int, every: int) -> dict:
    """Measure what solving islands one by one saves in a run.

    Returns {"relaxations": number of relaxations [without islands, with them], "seconds": time of the run [without,
    with], s, "difference": m/s}. The difference is the largest one between the velocities that the solvers without and
    with islands compute for the same state. The states are taken every `every` steps from the run without islands.
    """
    ways = {"together": PGS(), "islands": PGS(islands=True)}
    runs = {name: functools.partial(simulate, scene, steps=steps, solver=solver) for name, solver in ways.items()}
    seconds = interleaved(runs, repeats=3, reduce=min)
    relaxations, difference = [int(run().relaxations.sum()) for run in runs.values()], 0.0
    for state in solved_states(scene, steps=steps, every=every, solver=ways["together"]):
        one, other = (solve_contacts(state, solver=solver).velocities for solver in ways.values())
        difference = max(difference, float(np.abs(one - other).max()))
    return {"relaxations": relaxations, "seconds": list(seconds.values()), "difference": difference}


def saving_by_scene(runs: list[dict], unit: str) -> dict:
    """Return the `ratio` of relaxations or times without islands to those with islands, over several runs.

    runs: results of `island_savings`. unit: "relaxations" or "seconds". The entry "apart" is the largest distance
    between the positions of a circle with and without islands after one step, m.
    """
    general, special = np.array([run[unit] for run in runs], dtype=float).T
    return ratio(general, special) | {"apart": constants.TIME_STEP * max(run["difference"] for run in runs)}


JOBS = {
    "import": "import deep_contact as dc",
    "simulate": "import deep_contact as dc; dc.simulate(dc.column(10), steps=1)",
    "simulate, no friction": "import deep_contact as dc; dc.simulate(dc.column(10, friction=0.0), steps=1)",
    "predict": "import deep_contact as dc; state = dc.simulate(dc.column(10), steps=1).state; "
    "dc.load_model('far field').predict(state)",
}
"""Name of a job -> its Python code."""


def job(name: str) -> dict:
    """Return the result of `timing.fresh` for a job. A first process, which is not measured, has filled the caches."""
    timing.fresh(JOBS[name])
    return timing.fresh(JOBS[name])


NAMES = {
    "asleep": ("asleep: a step", "µs"),
    "no position correction": ("no position correction: a step", "µs"),
    "islands, one pile": ("islands, thesis scene: relaxations", ""),
    "islands, one pile, time": ("islands, thesis scene: time", "ms"),
    "islands, heaps": ("islands, scattered heaps: relaxations", ""),
    "islands, heaps, time": ("islands, scattered heaps: time", "ms"),
}
"""Name of a saving in the data -> (its name in the figure, unit of its times). Savings of a sweep have other names."""

PER_SECOND = {"µs": 1e6, "ms": 1e3}
"""Unit of a time -> number of such units in a second."""

SMALLEST = 1e-15
"""Distance at which a distance of 0 is drawn on the logarithmic axis, m."""

CONTEXTS = {"islands, one pile": ("the thesis's scene", {}), "islands, heaps": ("scattered heaps", SCATTERED)}
"""Name of a saving by islands -> (words for its scenes, their options)."""


def compute(options, seed, jobs, progress):
    """Measure every saving, one after the other, since no other program may run at the same time."""
    n, timed, sweeps, islands = options["n_bodies"], {"steps": options["timed"], "repeats": options["repeats"]}, {}, {}
    for size in progress(options["sizes"], text="sweeps"):
        sweeps[str(size)] = {"frictionless": sweep_saving(size, seed, **timed)}
    measured = next(iter(sweeps.values())) | step_savings(n, seed, **timed)
    for name, (_, scene) in CONTEXTS.items():
        seeds = progress(parallel.seeds(seed, options["scenes"]), text=name)
        scenes = (dc.circles_in_box(n, seed=s, **scene) for s in seeds)
        islands[name] = [island_savings(s, steps=options["steps"], every=options["every"]) for s in scenes]
        measured[name] = saving_by_scene(islands[name], "relaxations")
        measured[f"{name}, time"] = saving_by_scene(islands[name], "seconds")
    jobs = {name: job(name) for name in progress(options["jobs"], text="jobs")}
    return {"savings": measured, "sweeps": sweeps, "islands": islands, "jobs": jobs}


def claims(data):
    ratios = {name: one["ratio"] for name, one in data["savings"].items()}
    frictionless = {f"{n} circles": one["frictionless"]["ratio"] for n, one in data["sweeps"].items()}
    text = "without friction a sweep is at least 1.8 times cheaper"
    yield Claim(text, None, min(frictionless.values()) >= 1.8, frictionless)
    for name, (where, _) in CONTEXTS.items():
        text = f"islands cut sweeps times contacts at least 2 times on {where}"
        measured = {"ratio": ratios[name], "in time": ratios[f"{name}, time"]}
        yield Claim(text, None, ratios[name] >= 2, measured)
    for name, (where, _) in CONTEXTS.items():
        largest = max(run["difference"] for run in data["islands"][name])
        text = f"on {where} islands leave the velocities as they are within 6e-5 m/s"
        yield Claim(text, None, largest <= constants.THETA_TOLERANCE, {"largest difference": largest})
    text, share = "a resting pile that sleeps costs at most 5 % of one that is awake", 1 / ratios["asleep"]
    yield Claim(text, None, share <= 0.05, {"share": share})
    light = {name: one["heavy"] for name, one in data["jobs"].items()}
    holds = not light.get("import") and not {"tensorflow", "keras"} & set(light.get("simulate", ()))
    yield Claim("an import loads none of the packages, a simulation no TensorFlow", None, holds, light)


def named_savings(data):
    """Return (name in the figure, unit of the times, result of `ratio`) for all savings.

    The savings of a sweep come first, one for each number of circles.
    """
    text, sweeps = "no tangent rows, no spin: a sweep, {:,} circles", data["sweeps"].items()
    rows = [(text.format(int(n)), "ns a contact", one["frictionless"]) for n, one in sweeps]
    return rows + [(*names, data["savings"][name]) for name, names in NAMES.items()]


def table(data):
    """Return the rows of the table: the times with and without each saving, and the time of each job."""
    rows = [["what", "times cheaper", "quartiles", "apart, m", "general", "special", "unit"]]
    for name, unit, one in named_savings(data):
        paid = [PER_SECOND.get(unit, 1) * one[which] for which in ("general", "special")]
        rows.append([name, one["ratio"], [one["low"], one["high"]], one["apart"], *paid, unit])
    for name, one in data["jobs"].items():
        rows.append([f"job: {name}, {one['memory_mb']:.0f} MB", None, None, None, None, one["seconds"], "s"])
    return rows


def draw(data, options):
    """Draw two panels. Left: the ratio of times for each saving, with quartiles. Right: how far each moves circles."""
    rows = named_savings(data)
    figure, (left, right) = plotting.subplots(
        1, 2, size=(plotting.PAGE, 0.3 * len(rows) + 1.2), sharey=True, width_ratios=(1.6, 1)
    )
    for k, (_, _, one) in enumerate(rows):
        left.barh(k, one["ratio"] - 1, left=1, height=0.6, color=plotting.SKY)
        left.plot([one["low"], one["high"]], [k, k], color=plotting.BLACK)
        left.annotate(f"{one['ratio']:.3g}×", (max(one["high"], 1), k), (4, 0), textcoords="offset points", va="center")
        right.plot(max(one["apart"], SMALLEST), k, "o", color=plotting.VERMILION, markersize=4)
    plotting.name_bars(left, [name for name, _, _ in rows])
    ratios = [one[end] for _, _, one in rows for end in ("low", "high")]
    left.set(xscale="log", xlim=(0.8 * min(1, *ratios), 5 * max(ratios)))
    left.set(xlabel="times cheaper (line: quartiles)", title="What is saved?")
    left.axvline(1, color=plotting.BLACK, linewidth=0.8)
    right.axvline(constants.LINEAR_SLOP, color=plotting.GREY, linewidth=0.8, linestyle=":")
    right.set(xscale="log", xlim=(SMALLEST / 10, 1), xlabel="circles apart, m", title="At what error?")
    right.set_xticks([SMALLEST, 1e-9, constants.LINEAR_SLOP], ["0", "1e-9", "slop"])
    right.minorticks_off()
    right.grid(False, axis="y")
    return figure


OPTIONS = {
    "sizes": [100, 1000], "n_bodies": 100, "timed": 1000, "repeats": 15, "scenes": 5, "steps": 600, "every": 5,
    "jobs": list(JOBS),
}  # fmt: skip
QUICK = {
    "sizes": [100], "timed": 200, "repeats": 5, "scenes": 1, "steps": 200, "every": 20, "jobs": ["import", "simulate"],
}  # fmt: skip
FIGURE = Figure("6.7", "What modelling only what a scene requires saves", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
