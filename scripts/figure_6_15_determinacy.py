"""python scripts/figure_6_15_determinacy.py: the interval of λ_n that a motion leaves, and what labels make of it."""

import numpy as np

from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import determinacy

SHARES = {"median contact": 50, "90th percentile": 90}
"""Name -> percentile of the contacts of a pile."""


def compute(options, seed, jobs, progress):
    """Piles of the first size with every friction, and of every size with the one that is drawn by size."""
    first, mu = options["sizes"][0], options["friction"]
    wanted = [(first, other) for other in options["frictions"]] + [(n, mu) for n in options["sizes"][1:]]
    tasks = [
        (n, friction, options["contacts"], s, options["models"] if [n, friction] == [first, mu] else [])
        for n, friction in wanted
        for s in figures.seeds(seed, options["scenes"])
    ]
    return {"piles": figures.parallel_map(_measured, tasks, jobs=jobs, progress=progress, text="piles")}


def _measured(task):
    return determinacy.measure(*task)


def widths(data, n_bodies, friction):
    """Percentiles of the widths in each pile, (piles, shares)."""
    cell = {"n_bodies": n_bodies, "friction": friction}
    exact = (pile["widths"] for pile in data["piles"] if pile["exact"] and pile | cell == pile)
    open_ended = ([np.inf if width is None else width for width in one] for one in exact)
    return np.array([np.percentile(one, [*SHARES.values()], method="nearest") for one in open_ended])


def apart(data):
    """Answer -> its distances in each pile."""
    distances = [pile["apart"] for pile in data["piles"] if pile.get("apart")]
    return {name: [one[name] for one in distances] for name in distances[0]} if distances else {}


def claims(data):
    """With friction much is open; without it, what contacts within the slop carry beyond two a circle."""
    cells = dict.fromkeys((pile["n_bodies"], pile["friction"]) for pile in data["piles"] if pile["exact"])
    medians = {cell: np.median(widths(data, *cell), axis=0) for cell in cells}
    smooth = [row.max() for (_, friction), row in medians.items() if friction == 0]
    middles = {f"{n} circles, μ = {mu:g}": row[0] for (n, mu), row in medians.items()}
    if smooth:
        yield Claim("without friction the motion determines λ", None, max(smooth) < 1e-6, {"width": max(smooth)})
    text = "with friction the interval of the median contact is at least half of the mean λ_n wide"
    yield Claim(text, None, min(row[0] for (_, mu), row in medians.items() if mu > 0) >= 0.5, middles)
    middle = {name: float(np.median(values)) for name, values in apart(data).items()}
    text = "solvers and starts that know no past lie at least a tenth of the mean λ_n from the label of the run"
    yield Claim(text, None, min(v for name, v in middle.items() if "from" in name) >= 0.1, middle)


def draw(data, options):
    """Widths over friction and over circles, median and range of the piles; distances of answers beside them."""
    figure, panels = plotting.subplots(1, 3, size=(plotting.PAGE, 3.4), width_ratios=(1, 0.8, 1))
    first, mu = options["sizes"][0], options["friction"]
    sweeps = {"friction μ": [(first, x) for x in options["frictions"]], "circles": [(n, mu) for n in options["sizes"]]}
    for ax, (name, chosen) in zip(panels, sweeps.items()):
        chosen = sorted(cell for cell in chosen if len(widths(data, *cell)))
        by_cell = [widths(data, *cell) for cell in chosen]
        x = [cell[1 if name.startswith("friction") else 0] for cell in chosen]
        for k, (label, colour) in enumerate(zip(SHARES, (plotting.BLUE, plotting.VERMILION))):
            middle, low, high = (np.array([f(one[:, k]) for one in by_cell]) for f in (np.median, np.min, np.max))
            plotting.band(ax, x, middle, low, high, color=colour, marker="o", markersize=4, label=label)
        ax.set(xlabel=name, ylabel="interval of λ_n / mean λ_n", ylim=(0, None))
    panels[0].set_title(f"{first} circles")
    panels[1].set(xscale="log", xticks=options["sizes"], xticklabels=options["sizes"], title=f"μ = {mu:g}")
    panels[1].minorticks_off()
    distances, models = apart(data), options["models"]
    for y, (name, values) in enumerate(distances.items()):
        panels[2].barh(y, np.median(values), color=plotting.PURPLE if name in models else plotting.GREY)
        panels[2].plot([min(values), max(values)], [y, y], color=plotting.BLACK, linewidth=1)
    half = np.median(widths(data, first, mu)[:, 0]) / 2
    panels[2].axvline(half, color=plotting.BLUE, linestyle="--", linewidth=1)
    plotting.name_bars(panels[2], [f"{name}.h5" if name in models else name for name in distances])
    text = "median distance / mean λ_n\n(dashed: half of the interval)"
    panels[2].set(xlabel=text, title=f"{first} circles, μ = {mu:g}")
    return plotting.legend_below(figure, panels[0], "How much of λ do the positions determine?")


OPTIONS = {"sizes": [100, 30, 300], "frictions": [0, 0.1, 0.3, 0.5, 1], "friction": 0.5, "contacts": 16,
           "scenes": 5, "models": ["model", "no_past"]}  # fmt: skip
QUICK = {"sizes": [30, 60], "frictions": [0, 0.5, 1], "contacts": 8, "scenes": 2}
FIGURE = Figure("6.15", "How much of λ the positions determine", compute, None, draw, claims, options=OPTIONS,
                quick=QUICK, digits=5)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
