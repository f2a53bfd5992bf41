"""python scripts/figure_6_16_walls.py: times of presets and of other engines in scenes with shaped walls."""

from pathlib import Path

import numpy as np

from deep_contact import figures
from deep_contact.accuracy.presets import PRESETS, excess
from deep_contact.accuracy.scene_numbers import scene_numbers
from deep_contact.accuracy.stiffness import stiffness
from deep_contact.figures import Claim, Figure
from deep_contact.measure import setting_runs, settings
from deep_contact.plot import plotting
from deep_contact.scenes import drum, hopper, terrain
from deep_contact.studies import runs

SCENES = {
    "terrain, 24 segments": (terrain, {"bumps": 24}),
    "terrain, 400 segments": (terrain, {"bumps": 400}),
    "drum, 24 sides": (drum, {"froude": 0.1, "sides": 24}),
    "drum, 240 sides": (drum, {"froude": 0.1, "sides": 240}),
    "hopper": (hopper, {}),
}
KNOBS = {"pymunk": {"slop": 0.25}, "Box2D 2.3": {"position_sweeps": 3}, "Box2D v3": {"hertz": 120.0}}
"""Engine -> option with which it took less time on plain piles. Each setting runs with this option and without it."""


def scene(name, n_bodies, seed):
    """Return a scene. name: one of `SCENES`."""
    make, options = SCENES[name]
    return make(n_bodies, seed=seed, **options)


def settings_of(start):
    """Return the settings with which a scene is run.

    The first is that of the reference. Then come those of this package, which include those of the presets. The last
    are those of other engines. start: the scene.
    """
    numbers, stiff, (others, _) = scene_numbers(start), stiffness(start), setting_runs.rivals(start)
    tuned = [setting | KNOBS[setting["engine"]] for setting in others]
    ours = *settings.settings_of_presets(numbers, stiff).values(), *settings.ladder(numbers)
    return [settings.reference_of(numbers, stiff), *ours, *others, *tuned]


def compute(options, seed, jobs, progress):
    """Measure all settings on every scene, and choose the settings of the presets.

    The results of finished runs are in the folder `work`, so that a run of the same commit can be resumed.
    """
    cases = [(name, int(n)) for n, names in options["scenes"].items() for name in names]
    return {"scenes": [measure(*case, options, seed, jobs) for case in progress(cases, text="scenes")]}


def measure(name, n, options, seed, jobs):
    """Measure a scene of n circles. Returns its rows and presets, as in the study of runs, and the presets' settings.

    The result's entry "chosen" is preset -> name of the setting that `simulate(accuracy=…)` takes for the scene.
    """
    start, common = scene(name, n, seed), {"work": Path(options["work"]), "seconds": options["seconds"], "seed": seed}
    cases = {(name, n, settings.name_of(one, start.dt)): (one, options["seeds"][str(n)]) for one in settings_of(start)}
    _, *others = runs.observed_rows(scene, cases, **common, jobs=jobs).items()
    rows = runs.timed_rows(scene, dict(others), dict.fromkeys(cases, options["timed"][str(n)]), **common)
    rows = [row | {"kind": "plain"} for row in rows]  # `runs.presets` compares engines on plain piles
    taken = settings.settings_of_presets(scene_numbers(start), stiffness(start))
    chosen = {preset: settings.name_of(setting, start.dt) for preset, setting in taken.items()}
    return {"scene": name, "n_bodies": n, "rows": rows, "presets": runs.presets(rows), "chosen": chosen}


def worst(row, preset, at=0):
    """Return the largest ratio of a row's errors to the preset's tolerances.

    at: 0 for the errors, 1 for the lower bounds of their confidence intervals.
    """
    return excess({name: error and error[at] for name, error in row["errors"].items()}, PRESETS[preset])


def verdict(one, preset):
    """Return which engines keep the tolerances of a preset in a scene. one: result of `measure`.

    If this package and another engine, a rival, keep them, the result is the ratio of their times, [ratio, low, high].
    Otherwise it is "ours", "a rival" or "none". It is "undecided" if this package keeps them, and a rival keeps them
    only with its errors at the lower bounds of their confidence intervals.
    """
    row = one["presets"][list(PRESETS).index(preset)]
    mine, theirs = row["kinds"]["plain"], [other for other in one["rows"] if "engine" in other["setting"]]
    if mine and any(row["peers"].values()):
        return row["ratio"]
    if mine:
        return "undecided" if any(worst(other, preset, 1) <= 1 for other in theirs) else "ours"
    return "a rival" if any(row["peers"].values()) else "none"


def claims(data):
    """Yield claims for each number of circles.

    They are on the ratios of times, on presets that only one engine keeps, and on whether the setting that `accuracy=`
    takes keeps the tolerances of its preset.
    """
    for n in runs.sizes_of(data["scenes"]):
        cells = {f"{one['scene']}, {preset}": (one, preset) for one in data["scenes"] if one["n_bodies"] == n
                 for preset in PRESETS}  # fmt: skip
        verdicts = {name: verdict(*cell) for name, cell in cells.items()}
        ratios = {name: one for name, one in verdicts.items() if not isinstance(one, str)}
        text = f"no preset is dearer than with the fastest rival, {n:,} circles"
        yield Claim(text, None, min((ratio[0] for ratio in ratios.values()), default=0) >= 1, ratios)
        who = {who: [name for name, one in verdicts.items() if one == who] for who in ("ours", "undecided", "a rival")}
        text = f"ours keeps what a rival keeps, {n:,} circles"
        yield Claim(text, None, not who["a rival"], {f"{name} alone": "; ".join(which) for name, which in who.items()})
        over = {}
        for name, (one, preset) in cells.items():
            taken = next(row for row in one["rows"] if row["name"] == one["chosen"][preset])
            over[name] = [worst(taken, preset, at) for at in (0, 1)]
        missed = {name: both for name, both in over.items() if both[0] > 1}
        measured = {
            "of": len(over),
            "missed": len(missed),
            "beyond the interval": sum(low > 1 for _, low in over.values()),
        }
        text = f"what accuracy= takes keeps its preset, {n:,} circles"
        yield Claim(text, None, not missed, measured | missed)


def table(data):
    """Return the rows of the table: for each scene and size the `verdict` for each preset."""
    rows = [["circles", "scene", *PRESETS]]
    for one in data["scenes"]:
        rows.append([one["n_bodies"], one["scene"], *(cell(verdict(one, preset)) for preset in PRESETS)])
    return rows


def cell(one):
    """Return the text of a result of `verdict` for the table."""
    if isinstance(one, str):
        return f"{one} alone" if one in ("ours", "a rival") else one
    value, *ends = one
    return f"{value:.2g}" + (" ({:.2g}–{:.2g})".format(*ends) if all(ends) else "")


def draw(data, options):
    """Draw the ratios of times with their intervals.

    There is a panel for each size, a line for each scene and a colour for each preset. An arrow means that only this
    package keeps the preset.
    """
    sizes, names = runs.sizes_of(data["scenes"]), list(dict.fromkeys(one["scene"] for one in data["scenes"]))
    size = (plotting.PAGE, 0.7 * len(names) + 1.3)
    figure, panels = plotting.subplots(1, len(sizes), size=size, squeeze=False, sharey=True)
    for ax, n in zip(panels[0], sizes):
        here = [one for one in data["scenes"] if one["n_bodies"] == n]
        most = max((row["ratio"][0] or 0.0 for one in here for row in one["presets"]), default=1.0)
        for k, (preset, colour) in enumerate(zip(PRESETS, plotting.shades(len(PRESETS)))):
            value, *ends = np.array([one["presets"][k]["ratio"] for one in here], dtype=float).T
            places = np.array([names.index(one["scene"]) for one in here]) + 0.14 * (k - 2)
            reach = np.nan_to_num(np.abs(ends - value))
            look = {"markersize": 4, "linewidth": 0.8, "linestyle": "none", "color": colour}
            ax.errorbar(value, places, xerr=reach, marker="o", label=preset, **look)
            alone = places[[verdict(one, preset) == "ours" for one in here]]
            ax.plot(np.full(alone.size, 1.4 * most), alone, marker=">", markerfacecolor="none", **look)
        ax.axvline(1.0, color=plotting.BLACK, linewidth=0.7, linestyle=":")
        ax.set_xlim(left=0.0)
        ax.set(ylim=(-0.5, len(names) - 0.5), title=f"{n:,} circles", xlabel="fastest rival / ours")
    plotting.name_bars(panels[0, 0], names)
    title = "What does the same accuracy cost where walls have shapes? (arrows: no rival keeps it)"
    return plotting.legend_below(figure, panels[0, 0], title)


LARGE = ["terrain, 400 segments", "drum, 240 sides", "hopper"]
OPTIONS = {"scenes": {"100": [*SCENES], "1000": [*SCENES], "3000": LARGE},
           "seeds": {"100": 12, "1000": 6, "3000": 3}, "timed": {"100": 2, "1000": 2, "3000": 1}, "seconds": 6.0,
           "work": "runs/figure_6_16"}  # fmt: skip
QUICK = {"scenes": {"100": ["terrain, 24 segments"]}, "seeds": {"100": 3}, "timed": {"100": 1}, "seconds": 2.0}
FIGURE = Figure("6.16", "Speed for accuracy where walls have shapes", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
