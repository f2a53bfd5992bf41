"""python scripts/figure_6_10_break_even.py: error against wall time, and where the learned start pays for itself."""

from itertools import product

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure, parallel_map
from deep_contact.studies.break_even import (
    CLASSICAL,
    FEWEST,
    LEARNED,
    best_setting,
    costs_of,
    errors_of_pile,
    interval,
    median_ratio,
    piles_of,
    ratios,
    times_of_pile,
)
from deep_contact.studies.held_out import start_of

TOLERANCES = (0.5, 0.3, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01)


def compute(options, seed, jobs, progress):
    """Errors pile by pile, in parallel; then times in this process alone: nothing may run beside what is timed."""
    starts = {name: name for name in CLASSICAL}
    starts["far field"] = {"model": options["model"]}
    tasks = [
        {**options, "circles": count, "kind": kind, "seed": s, "starts": starts}
        for count, kind in product(options["counts"], options["kinds"])
        for s in figures.seeds(seed + 20_000, options["piles"][str(count)])
    ]
    piles = parallel_map(errors_of_pile, tasks, jobs=jobs, progress=progress, text="piles")
    made = {name: start_of(description) for name, description in starts.items()}
    for pile, task in zip(piles, progress(tasks, text="times")):
        pile.update(times_of_pile(task, made, options["repeats"]))
    return {"sweeps": options["sweeps"], "piles": piles}


def counts_of(data):
    """Numbers of circles, rising."""
    return sorted({pile["circles"] for pile in data["piles"]})


def kinds_of(data):
    """Kinds of piles, in their order."""
    return list(dict.fromkeys(pile["kind"] for pile in data["piles"]))


def claims(data):
    """Whether there is a region where a learned start wins in wall time, and its cost in sweeps."""
    cases = product(counts_of(data), kinds_of(data), LEARNED, TOLERANCES)
    known = {case: found for case in cases if (found := interval(data, *case))}
    wins = {case: found for case, found in known.items() if found[1] < 1}
    ties = {case: found for case, found in known.items() if found[0] <= 1 <= found[1]}
    shown = [
        {"where": ", ".join(map(str, case)), "ratio": median_ratio(data, *case), "from": low, "to": high}
        for case, (low, high) in sorted((wins or ties).items(), key=lambda item: item[1][1])[:3]
    ]
    cost = {name: {} for name in LEARNED}
    for name, count in product(cost, counts_of(data)):
        start, sweep = costs_of(piles_of(data, circles=count), name)
        cost[name][f"{count} circles"] = {"ms": 1e3 * start, "in sweeps": start / sweep}
    smallest = cost["far field"][f"{counts_of(data)[0]} circles"]["ms"]
    text = "somewhere a learned start reaches an error sooner than the best classical setting (95 %)"
    measured = {"cases": len(known), "wins": len(wins), "ties": len(ties), "best": shown, **cost}
    found = [Claim(text, None, bool(wins), measured)]
    text = "network, splat and gather together take at most 0.5 ms for 100 circles on one core"
    return [*found, Claim(text, None, smallest <= 0.5, {"ms": smallest})]


def table(data):
    """Rows: time to an error from a learned start over that of the best classical setting, by pile; and which it is."""
    rows = [["circles", "pile", "start", "start, ms", *(f"to {error:g}" for error in TOLERANCES)]]
    for kind, count in product(kinds_of(data), counts_of(data)):
        for start in LEARNED:
            found = [median_ratio(data, count, kind, start, error) for error in TOLERANCES]
            cost, _ = costs_of(piles_of(data, circles=count, kind=kind), start)
            rows.append([count, kind, start, 1e3 * cost, *found])
        best = [best_setting(data, count, kind, CLASSICAL, error) for error in TOLERANCES]
        names = [f"{one[0]}, {one[1]}" if one and np.isfinite(np.median(one[2])) else None for one in best]
        rows.append([count, kind, "best classical", None, *names])
    return rows


def draw(data, options):
    """Above: error against wall time, by number of circles. Below: the break-even maps.

    The maps are grey where there are fewer than `FEWEST` states.
    """
    counts, kinds = counts_of(data), kinds_of(data)
    maps = list(product(kinds, LEARNED))
    columns = max(len(counts), len(maps))
    figure, axes = plotting.subplots(2, columns, size=(3.4 * columns, 6.8))
    for axis, count in zip(axes[0], counts):
        draw_errors(axis, data, options, count)
    axes[0, 0].legend(fontsize=7)
    for axis, (kind, start) in zip(axes[1], maps):
        draw_map(axis, data, kind, start)
    for axis in (*axes[0][len(counts) :], *axes[1][len(maps) :]):
        axis.set_axis_off()
    return figure


def draw_errors(axis, data, options, count):
    """Error against the median time to it: of the best classical setting, and of each learned start."""
    solved = [pile for pile in piles_of(data, circles=count) if pile["errors"]]
    if not solved:
        axis.set_axis_off()
        axis.set_title(f"{count:,} circles:\nno reference within {options['past_need']:,} sweeps")
        return
    kind = solved[-1]["kind"]
    errors = np.geomspace(1.0, 0.005, 40)
    groups = {"best classical": CLASSICAL} | {start: {start: solvers} for start, solvers in LEARNED.items()}
    styles = plotting.styles_of(list(groups))
    for name, settings in groups.items():
        seconds = [np.median(best_setting(data, count, kind, settings, error)[2]) for error in errors]
        shown = np.isfinite(seconds) & (np.array(seconds) > 0)
        axis.plot(1e3 * np.array(seconds)[shown], errors[shown], **styles[name])
    plotting.label_axes(axis, "wall time", "relative velocity error", x_unit="ms", title=f"{count:,} circles, {kind}")
    plotting.log_axes(axis)


def draw_map(axis, data, kind, start):
    """Time from a start over that of the best classical setting, by number of circles and error."""
    counts = counts_of(data)
    cells = [[(data, count, kind, start, error) for error in TOLERANCES] for count in counts]
    values = np.array([[median_ratio(*case) for case in row] for row in cells], dtype=np.float64)
    states = np.array([[ratios(*case).size for case in row] for row in cells])
    coloured = np.where(states >= FEWEST, np.log10(np.maximum(values, 0.1)), np.nan)
    picture = axis.imshow(coloured, cmap="PuOr_r", vmin=-1, vmax=1, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        text = "–" if np.isnan(value) else f"{value:.0f}" if value >= 10 else f"{value:.2g}"
        color = plotting.GREY if np.isnan(coloured[row, column]) else "white" if not 0.2 < value < 5 else "black"
        axis.text(column, row, text, ha="center", va="center", fontsize=7, color=color)
    axis.set_xticks(range(len(TOLERANCES)), [f"{error:g}" for error in TOLERANCES], fontsize=7)
    axis.set_yticks(range(len(counts)), [f"{count:,}" for count in counts])
    axis.grid(False)
    plotting.label_axes(axis, "velocity error asked for", "circles", title=f"{start}, {kind}:\ntime over the rival's")
    bar = axis.figure.colorbar(picture, ax=axis, ticks=[-1, 0, 1])
    bar.set_ticklabels(["0.1", "1", "10"])


FIGURE = Figure(
    id="6.10",
    title="When a learned start pays for itself",
    options={
        "counts": [100, 300, 1000, 3000, 10000],
        "kinds": ["settling", "falling"],
        "piles": {"100": 10, "300": 12, "1000": 4, "3000": 2, "10000": 1},
        "states": 5,
        "every": 4,
        "sweeps": [0, 1, 2, 3, 5, 7, 10, 14, 20, 30, 45, 70, 100, 150, 220, 330, 500, 750, 1100, 1700, 2500, 4000],
        "past_need": 20_000,
        "exact": [100, 300, 1000],
        "repeats": 7,
        "model": "models/model.h5",
    },
    quick={
        "counts": [100, 1000],
        "kinds": ["settling"],
        "piles": {"100": 2, "1000": 1},
        "states": 2,
        "sweeps": [0, 1, 3, 10, 30, 100, 300],
        "past_need": 2000,
        "repeats": 3,
    },
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
    digits=4,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
