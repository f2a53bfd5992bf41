"""python scripts/figure_6_10_break_even.py: where the time of a learned start is repaid, from given states."""

from itertools import product

import numpy as np

from deep_contact import parallel
from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import learned_starts
from deep_contact.studies.learned_starts import CLASSICAL, FEWEST, LEARNED, time_ratios
from deep_contact.studies.starts import start_of

TOLERANCES = (0.5, 0.3, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01)


def compute(options, seed, jobs, progress):
    """Errors pile by pile, in parallel; then times in this process alone: nothing may run beside what is timed."""
    starts = learned_starts.starts_with(options["model"])
    tasks = [
        {**options, "circles": count, "kind": kind, "seed": s, "starts": starts}
        for count, kind in product(options["counts"], options["kinds"])
        for s in parallel.seeds(seed + 20_000, options["piles"][str(count)])
    ]
    errors = parallel.parallel_map(learned_starts.errors_of_pile, tasks, jobs=jobs, progress=progress, text="piles")
    made = {name: start_of(description) for name, description in starts.items()}
    times = (learned_starts.times_on(states, made, options["repeats"]) for _, states in progress(errors, text="times"))
    return {"sweeps": options["sweeps"], "piles": [pile | took for (pile, _), took in zip(errors, times)]}


def cases(data):
    """(Kind, circles) -> its piles of which a state has a reference, and ratios of times on their states by tolerance.

    By kind, and by rising numbers of circles.
    """
    by_case = {}
    for pile in sorted(data["piles"], key=lambda pile: pile["circles"]):
        if pile["start_seconds"][LEARNED]:
            by_case.setdefault((pile["kind"], pile["circles"]), []).append(pile)
    return {
        case: (by_case[case], [time_ratios(by_case[case], data["sweeps"], error) for error in TOLERANCES])
        for case in sorted(by_case, key=lambda case: case[0], reverse=True)
    }


def claims(data):
    known, sizes = [], {}
    for (kind, n), (piles, ratios) in cases(data).items():
        sizes[n] = sizes.get(n, []) + piles
        with np.errstate(invalid="ignore"):  # a time that never comes is infinite, and so are its ratios
            intervals = [*map(learned_starts.median_with_interval, ratios)]
        for error, interval in zip(TOLERANCES, intervals):
            if interval:
                known.append({"where": f"{n}, {kind}, {error}"} | dict(zip(("ratio", "from", "to"), interval)))
    known.sort(key=lambda one: one["to"])
    wins, ties = sum(one["to"] < 1 for one in known), sum(one["from"] <= 1 <= one["to"] for one in known)
    prices = {f"{n} circles": learned_starts.price_of(piles) for n, piles in sorted(sizes.items())}
    measured = {"cases": len(known), "wins": wins, "ties": ties, "best": known[:3], LEARNED: prices}
    text = "somewhere a learned start reaches an error sooner than the best classical setting (95 %)"
    yield Claim(text, None, wins > 0, measured)
    least = next(iter(prices.values()))["ms"]
    text = "network, splat and gather together take at most 0.5 ms for 100 circles on one core"
    yield Claim(text, None, least <= 0.5, {"ms": least})


def table(data):
    rows = [["circles", "pile", "start", "start, ms", *(f"to {error:g}" for error in TOLERANCES)]]
    for (kind, n), (piles, ratios) in cases(data).items():
        price = learned_starts.price_of(piles)["ms"]
        rows.append([n, kind, LEARNED, price, *(float(np.median(r)) if r.size else None for r in ratios)])
        best = [learned_starts.best_timed(piles, data["sweeps"], CLASSICAL, error) for error in TOLERANCES]
        names = [name if seconds.size and np.isfinite(np.median(seconds)) else None for name, seconds in best]
        rows.append([n, kind, "best classical", None, *names])
    return rows


def draw(data, options):
    """Time from the network over that of the best classical setting, by circles and error asked for.

    Grey where there are fewer than `FEWEST` states; ∞ where the network alone does not reach the error.
    """
    by_case = {case: ratios for case, (_, ratios) in cases(data).items()}
    kinds = list(dict.fromkeys(kind for kind, _ in by_case))
    figure, axes = plotting.subplots(1, len(kinds), size=(plotting.PAGE, 3.2), squeeze=False, sharey=True)
    for ax, kind in zip(axes[0], kinds):
        counts = [n for other, n in by_case if other == kind]
        values = np.array([[np.median(r) if r.size else np.nan for r in by_case[kind, n]] for n in counts])
        enough = np.array([[r.size >= FEWEST for r in by_case[kind, n]] for n in counts])
        coloured = np.where(enough, np.log10(np.clip(values, 0.1, 10)), np.nan)
        picture = ax.imshow(coloured, cmap="PuOr_r", vmin=-1, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(values):
            text = "–" if np.isnan(value) else f"{value:.0f}".replace("inf", "∞") if value >= 10 else f"{value:.2g}"
            color = plotting.GREY if not enough[row, column] else "black" if 0.2 < value < 5 else "white"
            ax.text(column, row, text, ha="center", va="center", fontsize=8, color=color)
        ax.set_xticks(range(len(TOLERANCES)), [f"{error:g}" for error in TOLERANCES])
        ax.set_yticks(range(len(counts)), [f"{n:,}" for n in counts])
        ax.grid(False)
        ax.set(xlabel="velocity error asked for", ylabel="circles", title=f"{kind} piles")
    figure.suptitle("Is the network's start sooner at an error? (below 1: yes)", fontsize=10)
    label = "time over that of the\nbest classical setting"
    figure.colorbar(picture, ax=axes, ticks=[-1, 0, 1], label=label).set_ticklabels(["0.1", "1", "10"])
    return figure


OPTIONS = {
    "counts": [100, 300, 1000, 3000], "kinds": ["settling", "falling"],
    "piles": {"100": 10, "300": 12, "1000": 4, "3000": 3}, "states": 5, "every": 4,
    "sweeps": [0, 1, 2, 3, 5, 7, 10, 14, 20, 30, 45, 70, 100, 150, 220, 330, 500, 750, 1100, 1700, 2500, 4000],
    "past_need": 20_000, "exact": [100, 300, 1000], "repeats": 7, "model": "models/model.h5",
}  # fmt: skip
QUICK = {
    "counts": [100, 300], "kinds": ["settling"], "piles": {"100": 1, "300": 1}, "states": 2, "exact": [100],
    "sweeps": [0, 1, 3, 10, 30, 100, 300], "past_need": 2000, "repeats": 3,
}  # fmt: skip
FIGURE = Figure("6.10", "When a learned start pays for itself", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
