"""python scripts/figure_6_10_break_even.py: error against wall time, and where the learned start pays for itself."""

from itertools import product

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.break_even import (
    FEWEST,
    SOLVERS,
    costs_of,
    interval,
    measure_pile,
    median_ratio,
    piles_of,
    ratios,
)

STARTS = ("builtin", "far field", "coarse", "guarded")
LEARNED = STARTS[1:]
TOLERANCES = (0.5, 0.3, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01)


def compute(options, seed, jobs, progress):
    """Pile by pile, in this process alone: nothing may run beside what is timed."""
    tasks = [
        (count, kind, s)
        for count, kind in product(options["counts"], options["kinds"])
        for s in figures.seeds(seed + 20_000, options["piles"][str(count)])
    ]
    starts = make_starts(options["model"], options["coarse"])
    piles = [measure_pile(*task, starts, options) for task in progress(tasks, text="piles")]
    return {"sweeps": options["sweeps"], "piles": piles}


def make_starts(model, coarse):
    """Name -> start; the guarded one uses the coarse network."""
    from deep_contact.cnn.inference import Cnn, Guarded, load_model, network_file, one_thread
    from deep_contact.warm_start import Builtin

    one_thread()
    network, coarse = (load_model(network_file(path)) for path in (model, coarse))
    return dict(zip(STARTS, (Builtin(), Cnn(network), Cnn(coarse), Guarded(coarse))))


def counts_of(data):
    """Numbers of circles, rising."""
    return sorted({pile["circles"] for pile in data["piles"]})


def kinds_of(data):
    """Kinds of piles, in their order."""
    return list(dict.fromkeys(pile["kind"] for pile in data["piles"]))


def claims(data):
    """Whether there is a region where the learned start wins in wall time, and its cost in sweeps."""
    cases = product(counts_of(data), kinds_of(data), LEARNED, SOLVERS, TOLERANCES)
    known = {case: found for case in cases if (found := interval(data, *case))}
    wins = {case: found for case, found in known.items() if found[1] < 1}
    ties = {case: found for case, found in known.items() if found[0] <= 1 <= found[1]}
    shown = [
        {"where": ", ".join(map(str, case)), "ratio": median_ratio(data, *case), "from": low, "to": high}
        for case, (low, high) in sorted((wins or ties).items(), key=lambda item: item[1][1])[:3]
    ]
    cost = {name: {} for name in ("far field", "coarse")}
    for name, count in product(cost, counts_of(data)):
        start, sweep = costs_of(piles_of(data, circles=count), name)
        cost[name][f"{count} circles"] = {"ms": 1e3 * start, "in sweeps": start / sweep}
    smallest = cost["far field"][f"{counts_of(data)[0]} circles"]["ms"]
    text = "somewhere the learned start reaches an error sooner than Builtin with the same solver (95 %)"
    measured = {"cases": len(known), "wins": len(wins), "ties": len(ties), "best": shown, **cost}
    found = [Claim(text, None, bool(wins), measured)]
    text = "network, splat and gather together take at most 0.5 ms for 100 circles on one core"
    return [*found, Claim(text, None, smallest <= 0.5, {"ms": smallest})]


def table(data):
    """Rows: time to an error from a learned start over that from Builtin, by pile, solver and start."""
    rows = [["circles", "pile", "solver", "start", "start, ms", *(f"to {error:g}" for error in TOLERANCES)]]
    for kind, solver, start, count in product(kinds_of(data), SOLVERS, LEARNED, counts_of(data)):
        found = [median_ratio(data, count, kind, start, solver, error) for error in TOLERANCES]
        cost, _ = costs_of(piles_of(data, circles=count, kind=kind), start)
        rows.append([count, kind, solver, start, 1e3 * cost, *found])
    return rows


def draw(data, options):
    """Above: error against wall time with PGS, by number of circles. Below: the break-even maps.

    The maps are grey where there are fewer than `FEWEST` states.
    """
    counts, kind = counts_of(data), kinds_of(data)[0]
    columns = max(len(counts), 2)
    figure, axes = plotting.subplots(2, columns, size=(3.6 * columns, 6.6))
    for axis, count in zip(axes[0], counts):
        draw_errors(axis, data, count)
    axes[0, 0].legend()
    maps = list(product(("coarse", "far field"), SOLVERS))
    for axis, (start, solver) in zip(axes[1], maps):
        draw_map(axis, data, kind, start, solver)
    for axis in axes[1][len(maps) :]:
        axis.set_axis_off()
    return figure


def draw_errors(axis, data, count):
    """Median error and quartiles of every start against wall time, with PGS."""
    styles = plotting.styles_of(list(STARTS))
    # A pile of ten thousand may have no reference within reach.
    solved = [pile for pile in piles_of(data, circles=count) if pile["errors"]]
    kind = solved[-1]["kind"]
    piles = [pile for pile in solved if pile["kind"] == kind]
    sweep = np.median([pile["sweep_seconds"]["PGS"] for pile in piles])
    for start in STARTS:
        errors = np.array([found[start]["PGS"] for pile in piles for found in pile["errors"]])
        first = np.median([pile["start_seconds"][start][i] for pile in piles for i in pile["used"]])
        ms = 1e3 * (first + np.array(data["sweeps"]) * sweep)
        shown = ms > 0
        low, middle, high = np.quantile(errors, [0.25, 0.5, 0.75], axis=0)[:, shown]
        axis.plot(ms[shown], middle, **styles[start])
        axis.fill_between(ms[shown], low, high, color=styles[start]["color"], alpha=0.15, linewidth=0)
    axis.set(xscale="log", yscale="log")
    plotting.label_axes(axis, "wall time", "relative velocity error", x_unit="ms", title=f"{count} circles, {kind}")


def draw_map(axis, data, kind, start, solver):
    """Time from a start over that from Builtin, by number of circles and error."""
    counts = counts_of(data)
    cells = [[(data, count, kind, start, solver, error) for error in TOLERANCES] for count in counts]
    values = np.array([[median_ratio(*case) for case in row] for row in cells], dtype=np.float64)
    states = np.array([[ratios(*case).size for case in row] for row in cells])
    coloured = np.where(states >= FEWEST, np.log10(np.maximum(values, 0.1)), np.nan)
    picture = axis.imshow(coloured, cmap="PuOr_r", vmin=-1, vmax=1, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        text = "–" if np.isnan(value) else f"{value:.0f}" if value >= 10 else f"{value:.2g}"
        color = plotting.GREY if np.isnan(coloured[row, column]) else "white" if not 0.2 < value < 5 else "black"
        axis.text(column, row, text, ha="center", va="center", fontsize=7, color=color)
    axis.set_xticks(range(len(TOLERANCES)), [f"{error:g}" for error in TOLERANCES], fontsize=7)
    axis.set_yticks(range(len(counts)), [str(count) for count in counts])
    axis.grid(False)
    title = f"{start}, {kind}: time over Builtin's, {solver}"
    plotting.label_axes(axis, "velocity error asked for", "circles", title=title)
    bar = axis.figure.colorbar(picture, ax=axis, ticks=[-1, 0, 1])
    bar.set_ticklabels(["0.1", "1", "10"])


FIGURE = Figure(
    id="6.10",
    title="When the learned start pays for itself",
    options={
        "counts": [100, 300, 1000, 3000, 10000],
        "kinds": ["settling", "falling"],
        "piles": {"100": 10, "300": 24, "1000": 4, "3000": 2, "10000": 1},
        "states": 5,
        "every": 4,
        "sweeps": [0, 1, 2, 3, 5, 7, 10, 14, 20, 30, 45, 70, 100, 150, 220, 330, 500, 750, 1100, 1700, 2500, 4000],
        "past_need": 20_000,
        "exact": [100, 300, 1000],
        "repeats": 7,
        "model": "models/model.h5",
        "coarse": "models/coarse.h5",
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
