"""python scripts/figure_6_10_break_even.py: error against wall time, and where the learned start pays for itself."""

from itertools import product

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.break_even import SOLVERS, errors_by_sweeps, start_times, sweep_times, sweeps_to
from deep_contact.studies.tradeoff import pile, states_of

STARTS = ("builtin", "far field", "coarse", "guarded")
LEARNED = STARTS[1:]
FEWEST, SAMPLES = 10, 1000
"""States that a win is told from, at least, and samples of them that its interval is taken from (bootstrap)."""


def compute(options, seed, jobs, progress):
    """Pile by pile, in this process alone: what is timed must not share the machine with what is counted."""
    tasks = [
        (count, kind, s)
        for count in options["counts"]
        for kind in options["kinds"]
        for s in figures.seeds(seed + 20_000, options["piles"][str(count)])
    ]
    starts = make_starts(options["model"], options["coarse"])
    return {
        "sweeps": options["sweeps"],
        "piles": [one_pile(*task, starts, options) for task in progress(tasks, text="piles")],
    }


def make_starts(model, coarse):
    """Name -> start; the guarded one asks the coarse network."""
    from deep_contact.cnn.inference import Cnn, Guarded, load_model, network_file, one_thread
    from deep_contact.warm_start import Builtin

    one_thread()
    network, coarse = (load_model(network_file(path)) for path in (model, coarse))
    return dict(zip(STARTS, (Builtin(), Cnn(network), Cnn(coarse), Guarded(coarse))))


def one_pile(circles, kind, seed, starts, options):
    """Errors of every start by sweeps on states of one pile, and what starts and sweeps cost."""
    states = states_of(pile(kind, circles, seed), count=options["states"], every=options["every"])
    settings = {name: options[name] for name in ("sweeps", "past_need")} | {"exact": circles in options["exact"]}
    found = [errors_by_sweeps(state, starts, **settings) for state in states]
    return {
        "circles": circles,
        "kind": kind,
        "contacts": float(np.mean([state.contacts.count for state in states])),
        "used": [i for i, errors in enumerate(found) if errors],
        "errors": [errors for errors in found if errors],
        "start_seconds": start_times(states, starts, repeats=options["repeats"]),
        "sweep_seconds": sweep_times(states[-1], repeats=options["repeats"]),
    }


def seconds_to(data, circles, kind, start, solver, error):
    """Seconds to an error on each state of the piles of a kind with so many circles; infinite where it is not met."""
    found = []
    for one in data["piles"]:
        if one["circles"] == circles and one["kind"] == kind:
            for i, errors in zip(one["used"], one["errors"]):
                sweeps = sweeps_to(errors[start][solver], data["sweeps"], error)
                found.append(one["start_seconds"][start][i] + sweeps * one["sweep_seconds"][solver])
    return np.array(found)


def ratios(data, circles, kind, start, solver, error):
    """Time from a learned start over the time from Builtin, on each state where either gets there.

    0 where the learned one alone does. Empty where neither does on half of the states.
    """
    one, other = (seconds_to(data, circles, kind, name, solver, error) for name in (start, "builtin"))
    done = np.isfinite(one) | np.isfinite(other)
    return one[done] / other[done] if 2 * done.sum() > done.size else np.empty(0)


def ratio(*case):
    """Median of `ratios`; None where there are none."""
    found = ratios(*case)
    return float(np.median(found)) if found.size else None


def interval(*case):
    """95 % interval of the median of `ratios`, None with fewer than `FEWEST` states."""
    found = ratios(*case)
    if found.size < FEWEST:
        return None
    chosen = np.random.default_rng(0).integers(0, found.size, (SAMPLES, found.size))
    medians = np.sort(np.median(found[chosen], axis=1))
    return [float(medians[round(share * (SAMPLES - 1))]) for share in (0.025, 0.975)]


def counts_of(data):
    """Numbers of circles, rising."""
    return sorted({p["circles"] for p in data["piles"]})


def kinds_of(data):
    """Kinds of piles, in their order."""
    return list(dict.fromkeys(p["kind"] for p in data["piles"]))


def break_even(data, tolerances):
    """{kind: {solver: {start: ratios, (counts, tolerances), None where not met}}}."""
    return {
        kind: {
            solver: {
                start: [[ratio(data, c, kind, start, solver, e) for e in tolerances] for c in counts_of(data)]
                for start in LEARNED
            }
            for solver in SOLVERS
        }
        for kind in kinds_of(data)
    }


TOLERANCES = (0.5, 0.3, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01)


def claims(data):
    """Whether there is a region where the learned start wins in wall time, and what a start costs in sweeps."""
    cases = product(counts_of(data), kinds_of(data), LEARNED, SOLVERS, TOLERANCES)
    known = {case: found for case in cases if (found := interval(data, *case))}
    wins = {case: found for case, found in known.items() if found[1] < 1}
    ties = {case: found for case, found in known.items() if found[0] <= 1 <= found[1]}
    shown = [
        {"where": ", ".join(map(str, case)), "ratio": ratio(data, *case), "from": known[case][0], "to": known[case][1]}
        for case in sorted(wins or ties, key=lambda case: known[case][1])[:3]
    ]
    cost = {name: {} for name in ("far field", "coarse")}
    for name, by_count in cost.items():
        for count in counts_of(data):
            piles = [p for p in data["piles"] if p["circles"] == count]
            start = np.median(np.concatenate([p["start_seconds"][name] for p in piles]))
            sweep = np.median([p["sweep_seconds"]["PGS"] for p in piles])
            by_count[f"{count} circles"] = {"ms": float(1e3 * start), "in sweeps": float(start / sweep)}
    smallest = cost["far field"][f"{counts_of(data)[0]} circles"]["ms"]
    return [
        Claim(
            "somewhere the learned start reaches an error sooner than Builtin with the same solver (95 %)",
            None,
            bool(wins),
            {"cases": len(known), "wins": len(wins), "ties": len(ties), "best": shown, **cost},
        ),
        Claim(
            "network, splat and gather together take at most 0.5 ms for 100 circles on one core",
            None,
            smallest <= 0.5,
            {"ms": smallest},
        ),
    ]


def table(data):
    """Rows: time to an error from a learned start over that from Builtin, by pile, solver and start."""
    rows = [["circles", "pile", "solver", "start", "start, ms", *(f"to {error:g}" for error in TOLERANCES)]]
    for kind, by_solver in break_even(data, TOLERANCES).items():
        for solver, by_start in by_solver.items():
            for start, values in by_start.items():
                for count, row in zip(counts_of(data), values):
                    piles = [p for p in data["piles"] if p["circles"] == count and p["kind"] == kind]
                    cost = 1e3 * np.median(np.concatenate([p["start_seconds"][start] for p in piles]))
                    rows.append([count, kind, solver, start, float(cost), *row])
    return rows


def draw(data, options):
    """Above: error against wall time with PGS, by number of circles. Below: the break-even maps.

    They are grey where there are fewer than `FEWEST` states.
    """
    counts = counts_of(data)
    figure, axes = plotting.subplots(2, max(len(counts), 2), size=(3.6 * max(len(counts), 2), 6.6))
    styles = plotting.styles_of(list(STARTS))
    for axis, count in zip(axes[0], counts):
        # A pile of ten thousand may have no solution within reach to hold errors against.
        kind = [p["kind"] for p in data["piles"] if p["circles"] == count and p["errors"]][-1]
        piles = [p for p in data["piles"] if p["circles"] == count and p["kind"] == kind and p["errors"]]
        for start in STARTS:
            errors = np.array([found[start]["PGS"] for p in piles for found in p["errors"]])
            first = np.median([p["start_seconds"][start][i] for p in piles for i in p["used"]])
            sweep = np.median([p["sweep_seconds"]["PGS"] for p in piles])
            seconds = first + np.array(data["sweeps"]) * sweep
            shown = seconds > 0
            low, middle, high = np.quantile(errors, [0.25, 0.5, 0.75], axis=0)
            axis.plot(1e3 * seconds[shown], middle[shown], **styles[start])
            axis.fill_between(
                1e3 * seconds[shown], low[shown], high[shown], color=styles[start]["color"], alpha=0.15, linewidth=0
            )
        axis.set_xscale("log")
        axis.set_yscale("log")
        plotting.label_axes(axis, "wall time", "relative velocity error", x_unit="ms", title=f"{count} circles, {kind}")
    axes[0, 0].legend()
    maps, kind = list(product(("coarse", "far field"), SOLVERS)), kinds_of(data)[0]
    for axis, (start, solver) in zip(axes[1], maps):
        cells = [[(data, c, kind, start, solver, e) for e in TOLERANCES] for c in counts]
        values = np.array([[ratio(*case) for case in row] for row in cells], dtype=np.float64)
        states = np.array([[ratios(*case).size for case in row] for row in cells])
        told = np.where(states >= FEWEST, np.log10(np.maximum(values, 0.1)), np.nan)
        picture = axis.imshow(told, cmap="PuOr_r", vmin=-1, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(values):
            text = "–" if np.isnan(value) else f"{value:.0f}" if value >= 10 else f"{value:.2g}"
            color = plotting.GREY if np.isnan(told[row, column]) else "white" if not 0.2 < value < 5 else "black"
            axis.text(column, row, text, ha="center", va="center", fontsize=7, color=color)
        axis.set_xticks(range(len(TOLERANCES)), [f"{error:g}" for error in TOLERANCES], fontsize=7)
        axis.set_yticks(range(len(counts)), [str(count) for count in counts])
        axis.grid(False)
        plotting.label_axes(
            axis, "velocity error asked for", "circles", title=f"{start}, {kind}: time over Builtin's, {solver}"
        )
        bar = figure.colorbar(picture, ax=axis, ticks=[-1, 0, 1])
        bar.set_ticklabels(["0.1", "1", "10"])
    for axis in axes[1][len(maps) :]:
        axis.set_axis_off()
    return figure


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
