"""python scripts/figure_6_7_scene_requirements.py: what modelling only what a scene requires saves.

Times are taken in this process, one after the other: nothing else should run meanwhile.
"""

import deep_contact as dc
from deep_contact import constants, parallel
from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import savings

NAMES = {
    "asleep": ("asleep: a step", "µs"),
    "asleep but for one": ("asleep but for one circle: a step", "µs"),
    "no position correction": ("no position correction: a step", "µs"),
    "no call between steps": ("no call between steps: a step", "µs"),
    "islands, one pile": ("islands, thesis scene: relaxations", ""),
    "islands, one pile, time": ("islands, thesis scene: time", "ms"),
    "islands, heaps": ("islands, scattered heaps: relaxations", ""),
    "islands, heaps, time": ("islands, scattered heaps: time", "ms"),
}
"""Saving -> in words, unit of what is paid with and without it. That of a sweep is named by its number of circles."""

PER_SECOND = {"µs": 1e6, "ms": 1e3}
"""Unit of a time -> how many a second has. A sweep is stored in ns."""

SMALLEST = 1e-15
"""Where no difference is drawn, m."""

CONTEXTS = {"islands, one pile": ("the thesis's scene", {}), "islands, heaps": ("scattered heaps", savings.SCATTERED)}
"""Saving of islands -> the scenes in words, and their options."""


def compute(options, seed, jobs, progress):
    """Every saving, one after the other: nothing may run beside what is timed."""
    n, timed, sweeps, islands = options["n_bodies"], {"steps": options["timed"], "repeats": options["repeats"]}, {}, {}
    for size in progress(options["sizes"], text="sweeps"):
        sweeps[str(size)] = {"frictionless": savings.sweep_saving(size, seed, **timed)}
    measured = next(iter(sweeps.values())) | savings.step_savings(n, seed, **timed)
    for name, (_, scene) in CONTEXTS.items():
        seeds = progress(parallel.seeds(seed, options["scenes"]), text=name)
        scenes = (dc.circles_in_box(n, seed=s, **scene) for s in seeds)
        islands[name] = [savings.island_savings(s, steps=options["steps"], every=options["every"]) for s in scenes]
        measured[name] = savings.saving_by_run(islands[name])
        measured[f"{name}, time"] = savings.saving_by_run(islands[name], "seconds_")
    jobs = {name: savings.job(name) for name in progress(options["jobs"], text="jobs")}
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
        largest = max(max(run["difference"]) for run in data["islands"][name])
        text = f"on {where} islands leave the velocities as they are within 6e-5 m/s"
        yield Claim(text, None, largest <= constants.THETA_TOLERANCE, {"largest difference": largest})
    share = {name: 1 / ratios[name] for name in ("asleep", "asleep but for one")}
    text = "a resting pile that sleeps costs at most 5 % of one that is awake"
    yield Claim(text, None, share["asleep"] <= 0.05, share)
    light = {name: one["heavy"] for name, one in data["jobs"].items()}
    holds = not light.get("import") and not {"tensorflow", "keras"} & set(light.get("simulate", ()))
    yield Claim("an import loads none of the packages, a simulation no TensorFlow", None, holds, light)


def named_savings(data):
    """(name, unit, saving) of all savings: those of a sweep by number of circles, then others."""
    text, sweeps = "no tangent rows, no spin: a sweep, {:,} circles", data["sweeps"].items()
    rows = [(text.format(int(n)), "ns a contact", one["frictionless"]) for n, one in sweeps]
    return rows + [(*names, data["savings"][name]) for name, names in NAMES.items()]


def table(data):
    """With and without each saving; a job is a process of its own."""
    rows = [["what", "times cheaper", "quartiles", "apart, m", "general", "special", "unit"]]
    for name, unit, one in named_savings(data):
        paid = [PER_SECOND.get(unit, 1) * one[which] for which in ("general", "special")]
        rows.append([name, one["ratio"], [one["low"], one["high"]], one["apart"], *paid, unit])
    for name, one in data["jobs"].items():
        rows.append([f"job: {name}, {one['memory_mb']:.0f} MB", None, None, None, None, one["seconds"], "s"])
    return rows


def draw(data, options):
    """Left: how many times cheaper each saving is, with quartiles. Right: what it changes in where circles are."""
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
    "jobs": list(savings.JOBS),
}  # fmt: skip
QUICK = {
    "sizes": [100], "timed": 200, "repeats": 5, "scenes": 1, "steps": 200, "every": 20, "jobs": ["import", "simulate"],
}  # fmt: skip
FIGURE = Figure("6.7", "What modelling only what a scene requires saves", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
