"""python scripts/figure_6_14_no_past.py: the first step of a pile without impulses, by what it starts from."""

from itertools import product
from pathlib import Path

import numpy as np

from deep_contact.io.provenance import commit
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import no_past
from deep_contact.studies.learned_starts import median_with_interval
from deep_contact.studies.no_past import LEARNED, curves, time_to
from deep_contact.studies.parts import done

COLOURS = {"zero": plotting.GREY, "support": plotting.VERMILION, LEARNED: plotting.PURPLE}
JOLTS = (*COLOURS, "simulate", "past")
LEVELS = np.geomspace(0.03, 0.9, 30)
COMPARED = {("support", error): ["zero"] for error in (0.3, 0.1)}
COMPARED |= {(LEARNED, error): ["zero", "support"] for error in (0.3, 0.1, 0.03)}
"""(Start, velocity error) -> the starts that its time is compared with."""


def compute(options, seed, jobs, progress):
    """Every size, kind and radii; times of one pile of each, alone on the machine, the others' by their contacts.

    Piles that are done are kept in the folder `work`, so that an interrupted run of one commit goes on.
    """
    cells = [
        {"n_bodies": int(n), "kind": kind, "radii": radii}
        for n, kind, radii in product(options["states"], options["kinds"], options["radii"])
    ]
    common = {"options": {name: options[name] for name in ("radii", "sweeps", "model", "first")}, "commit": commit()}
    parts = [
        ("pile", cell | common | {"seed": s})
        for cell in cells
        for s in figures.seeds(seed, options["states"][str(cell["n_bodies"])])
    ]
    piles = done(parts, {"pile": no_past.measure}, work=Path(options["work"]), jobs=jobs, text="piles")
    timed = []
    for cell in progress(cells, text="times"):
        given = cell["n_bodies"], cell["kind"], options["radii"][cell["radii"]], figures.seeds(seed, 1)[0]
        state, *_ = no_past.pile(*given)
        timed.append(cell | no_past.times(state, no_past.starts_of(state, options["model"]), options["repeats"]))
    return {"piles": piles, "times": timed}


def by_cell(data):
    """(Size, kind, radii) -> (its piles, its times)."""
    found = {(timed["n_bodies"], timed["kind"], timed["radii"]): ([], timed) for timed in data["times"]}
    for pile in data["piles"]:
        found[pile["n_bodies"], pile["kind"], pile["radii"]][0].append(pile)
    return found


def times(piles, timed, start, error):
    """Times of the piles to an error by the fastest method, ms; infinite where none comes there."""
    return np.array([1e3 * min(time_to(curve, error) for curve in curves(pile, timed, start)) for pile in piles])


def ratios(data):
    """(Start, error) -> name of a cell -> [median, low, high] of its time over the others' least, pile by pile.

    A start that never comes to the error counts with the time of the most sweeps, a bound. Cells are left out where too
    few piles come there.
    """
    found = {key: {} for key in COMPARED}
    for (start, error), others in COMPARED.items():
        for cell, (piles, timed) in by_cell(data).items():
            one = times(piles, timed, start, error)
            other = np.min([times(piles, timed, name, error) for name in others], axis=0)
            most = [1e3 * max(curve[-1][0] for curve in curves(pile, timed, start)) for pile in piles]
            reached = np.isfinite(one) | np.isfinite(other)
            ratio = (np.minimum(one, most) / np.minimum(other, most))[reached]
            if 2 * ratio.size > one.size and (interval := median_with_interval(ratio)):
                found[start, error][name_of(cell)] = interval
    return found


def name_of(cell):
    n, kind, radii = cell
    return f"{n:,} {kind} circles, {radii} radii"


def claims(data):
    """Of the support against zero, of the network against the best of both, and of the jolt."""
    found, cells = ratios(data), by_cell(data)

    def at_rest(text, most, measured):
        kept = {name_of(cell): measured.get(name_of(cell)) for cell in cells if cell[1] == "resting"}
        kept = {name: value for name, value in kept.items() if value}
        return [Claim(f"at rest, {text}", None, all(value[0] <= most for value in kept.values()), kept)] if kept else []

    for error in (0.3, 0.1):
        text = f"from the support at most half of the time from zero, to a velocity error of {error:g}"
        yield from at_rest(text, 0.5, found["support", error])
    large = [name_of(cell) for cell in cells if cell[0] >= 1000]
    learned = {f"{name}, to {error:g}": of[name] for (start, error), of in found.items() if start == LEARNED
               for name in large if name in of}  # fmt: skip
    if learned:
        wins = sum(middle <= 0.7 and high < 0.85 for middle, _, high in learned.values())
        text = "the learned support takes at most 0.7 of the best classical time in half the cells"
        measured = {"cells": len(learned), "wins": wins, **learned}
        yield Claim(f"from 1,000 circles on {text}", None, 2 * wins >= len(learned), measured)
    jolts = {}
    for cell, (piles, _) in cells.items():
        ratio = [pile["jolt"]["support"]["speed"] / pile["jolt"]["zero"]["speed"] for pile in piles]
        jolts[name_of(cell)] = median_with_interval(np.array(ratio))
    yield from at_rest("at equal time for the first step, the support leaves a third of the jolt at most", 1 / 3, jolts)


def table(data):
    """Ratios of times with intervals, and medians of what a start costs and of the largest speed of a run."""
    names = {"support": "support over zero", LEARNED: "learned over best classical"}
    head = ["circles", "piles", "support, ms", "learned support, ms"]
    head += [f"{names[start]}, to {error:g}" for start, error in COMPARED]
    rows, found = [[*head, *(f"jolt, {start}, m/s" for start in JOLTS)]], ratios(data)
    for cell, (piles, timed) in by_cell(data).items():
        n, kind, radii = cell
        shown = [of.get(name_of(cell)) for of in found.values()]
        shown = ["–" if one is None else "{:.2f} ({:.2f}–{:.2f})".format(*one) for one in shown]
        jolts = [float(np.median([pile["jolt"][start]["speed"] for pile in piles])) for start in JOLTS]
        prices = [1e3 * timed["price"][start] for start in ("support", LEARNED)]
        rows.append([n, f"{len(piles)} {kind}, {radii}", *prices, *shown, *jolts])
    return rows


def draw(data, options):
    """Error by time of the fastest method from each start, for resting piles: a panel a size, medians and quartiles."""
    cells = {c: of for c, of in by_cell(data).items() if [c[1], c[2]] == options["drawn"] and c[0] >= options["least"]}
    figure, panels = plotting.subplots(1, len(cells), size=(plotting.PAGE, 3.2), squeeze=False)
    for ax, ((n, *_), (piles, timed)) in zip(panels[0], cells.items()):
        for start, colour in COLOURS.items():
            found = np.array([times(piles, timed, start, level) for level in LEVELS])
            low, middle, high = np.percentile(found, (25, 50, 75), axis=1, method="nearest")
            reached = np.isfinite(middle)
            ax.plot(middle[reached], LEVELS[reached], color=colour, label=f"from {start}")
            ends = low[reached], np.where(np.isfinite(high[reached]), high[reached], 10 * middle[reached].max())
            ax.fill_betweenx(LEVELS[reached], *ends, color=colour, alpha=0.2, linewidth=0)
        plotting.label_axes(ax, "time of the first step", "", x_unit="ms", title=f"{n:,} circles")
        plotting.log_axes(ax)
    panels[0, 0].set_ylabel("velocity error")
    figure.suptitle("How soon is a resting pile without impulses solved?", fontsize=10)
    plotting.legend_below(figure, panels[0, 0])
    return figure


OPTIONS = {
    "states": {"100": 20, "300": 20, "1000": 20, "3000": 20, "10000": 10}, "kinds": ["settling", "resting"],
    "radii": {"near": 0.8, "mixed": 0.5}, "sweeps": [5, 10, 20, 40, 80, 160, 320, 640, 1280, 2560], "repeats": 5,
    "first": {"zero": 60, "support": 52, LEARNED: 20}, "model": "no_past", "work": "runs/figure_6_14",
    "drawn": ["resting", "near"], "least": 1000,
}  # fmt: skip
QUICK = {"states": {"100": 4, "300": 4}, "least": 100, "repeats": 1}
FIGURE = Figure("6.14", "A pile without a past: its first step", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=5)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
