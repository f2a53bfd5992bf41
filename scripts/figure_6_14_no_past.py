"""python scripts/figure_6_14_no_past.py: the first step of a pile without impulses, by what it starts from."""

from functools import partial
from pathlib import Path

import numpy as np

from deep_contact.cnn.inference import LearnedSupport
from deep_contact.io.provenance import commit
from deep_contact.physics.engine import step_problem
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import no_past
from deep_contact.studies.learned_starts import median_with_interval
from deep_contact.studies.parts import done
from deep_contact.warm_start import Support

COLOURS = {"zero": plotting.GREY, "support": plotting.VERMILION, "learned support": plotting.PURPLE}
CLASSICAL, LEARNED = ("zero", "support"), "learned support"
ERRORS = (0.3, 0.1, 0.03)
JOLTS = (*COLOURS, "simulate", "past")
LEVELS = np.geomspace(0.03, 0.9, 30)


def makers(state, model):
    """Start -> what makes its impulses, from rows that have been built, as a run has them."""
    nothing, problem = np.zeros(state.contacts.count), step_problem(state)
    made = {"zero": lambda: (nothing, nothing)}
    for name, start in {"support": Support(), LEARNED: LearnedSupport(model)}.items():
        made[name] = partial(start.from_problem, state, None, problem)
    return made


def measure(n_bodies, kind, radii, seed, exact, options, commit):
    """One pile: what its starts lead to, and the time of `solve_exactly` where it is asked for. commit: of the code."""
    found = no_past.pile(n_bodies, kind, options["radii"][radii], seed)
    given = {name: make() for name, make in makers(found.state, options["model"]).items()}
    ended = {"n_bodies": n_bodies, "kind": kind, "radii": radii, "seed": seed, "after": options["sweeps"]}
    ended["contacts"] = found.state.contacts.count
    ended["errors"] = no_past.errors(found, given, options["sweeps"])
    ended["jolt"] = {name: no_past.jolt(found.state, given[name], options["first"][name]) for name in given}
    ended["jolt"] |= {"simulate": no_past.jolt(found.state), "past": no_past.jolt(found.past)}
    if exact:
        ended["exact"] = no_past.exact(found.state, given)
    return ended


def compute(options, seed, jobs, progress):
    """Every size, kind and radii; times of one pile of each, alone on the machine, the others' by their contacts.

    Piles that are done are kept in the folder `work`, so that an interrupted run of one commit goes on.
    """
    cells = [
        (int(n), kind, radii) for n in options["states"] for kind in options["kinds"] for radii in options["radii"]
    ]
    common = {"options": {name: options[name] for name in ("radii", "sweeps", "model", "first")}, "commit": commit()}
    parts = [
        ("pile", {"n_bodies": n, "kind": kind, "radii": radii, "seed": s, "exact": exact} | common)
        for n, kind, radii in cells
        for k, s in enumerate(figures.seeds(seed, options["states"][str(n)]))
        for exact in [n in options["exact"] and k < options["solved_exactly"]]
    ]
    piles = done(parts, {"pile": measure}, work=Path(options["work"]), jobs=jobs, text="piles")
    timed = []
    for n, kind, radii in progress(cells, text="times"):
        state = no_past.pile(n, kind, options["radii"][radii], figures.seeds(seed, 1)[0]).state
        took = no_past.times(state, makers(state, options["model"]), options["repeats"])
        timed.append({"n_bodies": n, "kind": kind, "radii": radii} | took)
    return {"piles": piles, "times": timed}


def cell_of(one):
    """Size, kind and radii of a pile or of times."""
    return one["n_bodies"], one["kind"], one["radii"]


def by_cell(data):
    """(Size, kind, radii) -> (its piles, its times)."""
    return {
        cell_of(timed): ([pile for pile in data["piles"] if cell_of(pile) == cell_of(timed)], timed)
        for timed in data["times"]
    }


def times(piles, timed, start, error):
    """Times of the piles to an error, ms; infinite where no method comes there."""
    return np.array([1e3 * no_past.best_time(pile, timed, start, error) for pile in piles])


def ratio(piles, timed, start, others, error):
    """Time from a start over the least from the others, pile by pile; [median, low, high] as `median_with_interval`.

    A start that never comes to the error counts with the time of the most sweeps, a bound.
    """
    one, other = times(piles, timed, start, error), np.min([times(piles, timed, o, error) for o in others], axis=0)
    done = np.isfinite(one) | np.isfinite(other)
    if 2 * done.sum() <= done.size:
        return None
    most = np.array([1e3 * no_past.time_of_all(pile, timed, start) for pile in piles])
    return median_with_interval((np.minimum(one, most) / np.minimum(other, most))[done])


def name_of(cell):
    n, kind, radii = cell
    return f"{n:,} {kind} circles, {radii} radii"


def claims(data):
    """Of the support against zero, of the network against the best of both, and of the jolt."""
    cells = by_cell(data)
    for error in ERRORS[:2]:
        found = {name_of(c): ratio(*of, "support", ["zero"], error) for c, of in cells.items() if c[1] == "resting"}
        text = f"at rest, from the support at most half of the time from zero, to a velocity error of {error:g}"
        yield from judged(text, found, lambda value: value[0] <= 0.5)
    found = {
        f"{name_of(c)}, to {error:g}": ratio(*of, LEARNED, CLASSICAL, error)
        for c, of in cells.items()
        for error in ERRORS
        if c[0] >= 1000
    }
    found = {name: value for name, value in found.items() if value is not None}
    wins = sum(value[0] <= 0.7 and value[2] < 0.85 for value in found.values())
    if found:
        text = (
            "from 1,000 circles on the learned support takes at most 0.7 of the best classical time in half the cells"
        )
        yield Claim(text, None, 2 * wins >= len(found), {"cells": len(found), "wins": wins, **found})
    found = {
        name_of(c): median_with_interval(
            np.array([pile["jolt"]["support"]["speed"] / pile["jolt"]["zero"]["speed"] for pile in piles])
        )
        for c, (piles, _) in cells.items()
        if c[1] == "resting"
    }
    text = "at rest, at equal time for the first step, the support leaves a third of the jolt at most"
    yield from judged(text, found, lambda value: value[0] <= 1 / 3)


def judged(text, found, holds):
    """A claim that holds where it does for every cell that has enough piles, if there is one."""
    found = {name: value for name, value in found.items() if value is not None}
    if found:
        yield Claim(text, None, all(map(holds, found.values())), found)


def table(data):
    """Ratios of times with intervals, and medians of what a start costs and of the largest speed of a run."""
    head = ["circles", "piles", "support, ms", "learned support, ms"]
    head += [f"support over zero, to {error:g}" for error in ERRORS[:2]]
    head += [f"learned over best classical, to {error:g}" for error in ERRORS]
    rows = [[*head, *(f"jolt, {start}, m/s" for start in JOLTS)]]
    for (n, kind, radii), (piles, timed) in by_cell(data).items():
        ratios = [ratio(piles, timed, "support", ["zero"], error) for error in ERRORS[:2]]
        ratios += [ratio(piles, timed, LEARNED, CLASSICAL, error) for error in ERRORS]
        shown = ["–" if one is None else "{:.2f} ({:.2f}–{:.2f})".format(*one) for one in ratios]
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
            if start in timed["price"]:
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
    "first": {"zero": 60, "support": 52, "learned support": 20}, "model": "no_past", "work": "runs/figure_6_14",
    "exact": [300, 1000], "solved_exactly": 5, "drawn": ["resting", "near"], "least": 1000,
}  # fmt: skip
QUICK = {"states": {"100": 4, "300": 4}, "least": 100, "solved_exactly": 1, "repeats": 1}
FIGURE = Figure("6.14", "A pile without a past: its first step", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=5)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
