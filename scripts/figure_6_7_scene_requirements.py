"""python scripts/figure_6_7_scene_requirements.py: what modelling only what a scene requires saves.

Times are taken in this process, one thing at a time: nothing else should run meanwhile. `dc.plan` tells the results
that are in `deep_contact/reference/figure_6_7.json`, a copy of this figure's results file.
"""

import numpy as np

import deep_contact as dc
from deep_contact import constants
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import savings

NAMES = {
    "frictionless": "no tangent rows, no spin: a sweep",
    "single": "single precision: a sweep",
    "asleep": "asleep: a step",
    "asleep but for one": "asleep but for one circle: a step",
    "no position correction": "no position correction: a step",
    "no call between steps": "no call between steps: a step",
    "islands, one pile": "islands, thesis scene: relaxations",
    "islands, one pile, time": "islands, thesis scene: time",
    "islands, heaps": "islands, scattered heaps: relaxations",
    "islands, heaps, time": "islands, scattered heaps: time",
}
CONTEXTS = {"islands, one pile": {}, "islands, heaps": savings.SCATTERED}


def compute(options, seed, jobs, progress):
    """Every saving, one after the other, whatever the number of jobs: they are times."""
    bar = progress(total=len(options["sizes"]) + 1 + 2 * options["scenes"] + len(options["jobs"]), text="savings")
    sweeps, found = {}, {}
    for n_bodies in options["sizes"]:
        sweeps[str(n_bodies)] = savings.sweep_savings(n_bodies, seed, repeats=options["repeats"])
        bar.update(1)
    found |= sweeps[str(options["sizes"][0])]
    found |= savings.step_savings(options["n_bodies"], seed, steps=options["timed"], repeats=options["repeats"])
    bar.update(1)
    islands = {}
    for name, scene in CONTEXTS.items():
        runs = []
        for s in figures.seeds(seed, options["scenes"]):
            state = dc.circles_in_box(options["n_bodies"], seed=s, **scene)
            runs.append(savings.island_savings(state, steps=options["steps"], every=options["every"]))
            bar.update(1)
        islands[name] = runs
        found[name] = by_run(runs, "together", "apart")
        found[f"{name}, time"] = by_run(runs, "seconds_together", "seconds_apart")
    measured = {}
    for name in options["jobs"]:
        measured[name] = savings.job(name)
        bar.update(1)
    return {"savings": found, "sweeps": sweeps, "islands": islands, "jobs": measured}


def by_run(runs, general, special):
    """The saving over all runs, with the quartiles of the runs' own ratios."""
    totals = np.array([[run[general].sum(), run[special].sum()] for run in runs], dtype=float)
    low, high = np.percentile(totals[:, 0] / totals[:, 1], (25, 75))
    general, special = totals.sum(axis=0)
    return {"ratio": general / special, "low": low, "high": high, "general": general, "special": special}


def claims(data):
    """The goals, held against what was measured."""
    found = []
    frictionless = {f"{n} circles": one["frictionless"]["ratio"] for n, one in data["sweeps"].items()}
    text = "without friction a sweep is at least 1.8 times cheaper"
    found.append(Claim(text, None, min(frictionless.values()) >= 1.8, frictionless))
    for name, where in (("islands, one pile", "the thesis's scene"), ("islands, heaps", "scattered heaps")):
        ratio = data["savings"][name]["ratio"]
        measured = {"ratio": ratio, "in time": data["savings"][f"{name}, time"]["ratio"]}
        found.append(
            Claim(f"islands cut sweeps times contacts at least 2 times on {where}", None, ratio >= 2, measured)
        )
    for name, where in (("islands, one pile", "the thesis's scene"), ("islands, heaps", "scattered heaps")):
        largest = {
            key: max(max(run[key]) for run in data["islands"][name])
            for key in ("difference", "error_together", "error_apart")
        }
        text = f"on {where} islands leave the velocities as they are within 6e-5 m/s"
        found.append(Claim(text, None, largest["difference"] <= constants.THETA_TOLERANCE, largest))
    share = {name: 1 / data["savings"][name]["ratio"] for name in ("asleep", "asleep but for one")}
    text = "a resting pile that sleeps costs at most 5 % of one that is awake"
    found.append(Claim(text, None, share["asleep"] <= 0.05, share))
    light = {name: one["heavy"] for name, one in data["jobs"].items()}
    holds = not light.get("import") and not {"tensorflow", "keras"} & set(light.get("simulate", ()))
    found.append(Claim("an import loads none of the packages, a simulation no TensorFlow", None, holds, light))
    return found


def table(data):
    """Rows: every saving, then every job."""
    rows = [["what", "times cheaper", "quartiles", "general", "special"]]
    for n, one in data["sweeps"].items():
        rows += [saving_row(f"{NAMES[name]}, {n} circles, ns", saving) for name, saving in one.items()]
    rows += [saving_row(NAMES[name], one) for name, one in data["savings"].items() if name not in one_size(data)]
    for name, one in data["jobs"].items():
        rows.append([f"job: {name}, s", one["seconds"], f"{one['modules']} modules", one["memory_mb"], one["compiled"]])
    return rows


def saving_row(name, one):
    """One saving as a row of the table."""
    return [name, one["ratio"], [one["low"], one["high"]], one["general"], one["special"]]


def one_size(data):
    """Names of the savings that are measured for several sizes."""
    return next(iter(data["sweeps"].values())).keys()


def draw(data, options):
    """Left: every saving with its quartiles. Right: relaxations by step, together and apart, in both scenes."""
    figure, (left, right) = plotting.subplots(1, 2, size=(12.0, 4.6), width_ratios=(1.15, 1.0))
    rows = []
    for n, one in data["sweeps"].items():
        rows += [(f"{NAMES[name]}, {int(n):,} circles", saving) for name, saving in one.items()]
    rows += [(NAMES[name], one) for name, one in data["savings"].items() if name not in one_size(data)]
    for k, (_, one) in enumerate(rows):
        left.barh(k, one["ratio"] - 1, left=1, height=0.6, color=plotting.SKY)
        left.plot([one["low"], one["high"]], [k, k], color=plotting.BLACK)
        left.annotate(
            f"{one['ratio']:.3g}×",
            (max(one["ratio"], one["high"], 1), k),
            (4, 0),
            textcoords="offset points",
            va="center",
        )
    left.set_yticks(range(len(rows)), [name for name, _ in rows])
    left.invert_yaxis()
    left.set_xscale("log")
    left.set_xlim(0.5, 4 * max(one["ratio"] for _, one in rows))
    left.axvline(1, color=plotting.BLACK, linewidth=0.8)
    left.grid(False, axis="y")
    plotting.label_axes(left, "times cheaper (line: quartiles)", "", title="what it saves")
    colours = (plotting.VERMILION, plotting.BLUE)
    labels = ("thesis scene", "scattered heaps")
    for name, colour, label in zip(CONTEXTS, colours, labels):
        run = data["islands"][name][0]
        for way, line in (("together", "-"), ("apart", "--")):
            values = np.maximum(run[way], 1)
            right.plot(run["step"], values, line, color=colour, label=f"{label}, {way}")
    right.set_yscale("log")
    plotting.label_axes(right, "step", "sweeps × contacts", title="islands: swept together and apart")
    right.legend()
    return figure


FIGURE = Figure(
    id="6.7",
    title="What modelling only what a scene requires saves",
    options={
        "sizes": [100, 1000],
        "n_bodies": 100,
        "timed": 1000,
        "repeats": 15,
        "scenes": 5,
        "steps": 600,
        "every": 5,
        "jobs": list(savings.JOBS),
    },
    quick={
        "sizes": [100],
        "timed": 200,
        "repeats": 5,
        "scenes": 1,
        "steps": 200,
        "every": 20,
        "jobs": ["import", "simulate"],
    },
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
