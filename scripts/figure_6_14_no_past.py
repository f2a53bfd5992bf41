"""python scripts/figure_6_14_no_past.py: the first step of a pile without impulses, from zero and from the support."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import no_past

COLOURS = {"zero": plotting.GREY, "support": plotting.VERMILION}
ERRORS = (0.3, 0.1)


def compute(options, seed, jobs, progress):
    """The cells of every size, one a seed."""
    parts = [(n, s) for n in options["n_bodies"] for s in figures.seeds(seed, options["scenes"])]
    common = {name: options[name] for name in ("steps", "sweeps", "repeats")}
    return {"cells": [{"n_bodies": n} | no_past.cell(n, s, **common) for n, s in progress(parts, text="piles")]}


def by_size(data):
    """Circles -> cells."""
    found = {}
    for cell in data["cells"]:
        found.setdefault(cell["n_bodies"], []).append(cell)
    return found


def times(cells, error):
    """Start -> times of the cells, ms."""
    found = [no_past.best_times(cell["curves"], error) for cell in cells]
    return {start: [1e3 * one[start] for one in found] for start in no_past.STARTS}


def claims(data):
    """The support halves the time to an error, and a third of the jolt is left."""
    for error in ERRORS:
        ratios = {}
        for n, cells in by_size(data).items():
            zero, support = map(np.array, times(cells, error).values())
            if np.isfinite(zero).all():
                ratios[f"{n} circles"] = float(np.median(support / zero))
        if not ratios:
            continue
        text = f"from the support at most half of the time from zero, to a velocity error of {error:g}"
        yield Claim(text, None, max(ratios.values()) <= 0.5, ratios)
    ratios = {f"{n} circles": float(np.median([cell["jolt"]["support"] / cell["jolt"]["zero"] for cell in cells]))
              for n, cells in by_size(data).items()}  # fmt: skip
    yield Claim("the support leaves a third of the jolt at most", None, max(ratios.values()) <= 1 / 3, ratios)


def table(data):
    head = ["circles", "support, ms", *(f"{start} to {e:g}, ms" for e in ERRORS for start in no_past.STARTS)]
    rows = [[*head, *(f"jolt from {start}, m/s" for start in no_past.STARTS)]]
    for n, cells in by_size(data).items():
        found = [np.median(times(cells, e)[start]) for e in ERRORS for start in no_past.STARTS]
        jolts = [float(np.median([cell["jolt"][start] for cell in cells])) for start in no_past.STARTS]
        price = 1e3 * float(np.median([cell["price"] for cell in cells]))
        rows.append([n, price, *(float(time) if np.isfinite(time) else None for time in found), *jolts])
    return rows


def draw(data, options):
    """A panel for each size: error by time of the fastest method, from each start; a line a pile."""
    sizes = by_size(data)
    figure, panels = plotting.subplots(1, len(sizes), size=(3.4 * len(sizes), 3.6), squeeze=False)
    levels = np.geomspace(0.03, 0.9, 40)
    for ax, (n, cells) in zip(panels[0], sizes.items()):
        for start, colour in COLOURS.items():
            for k, cell in enumerate(cells):
                found = [1e3 * no_past.best_times(cell["curves"], level)[start] for level in levels]
                ax.plot(
                    np.where(np.isfinite(found), found, np.nan),
                    levels,
                    color=colour,
                    linewidth=1.2,
                    label=None if k else f"from {start}",
                )
        plotting.label_axes(ax, "time of the step", "velocity error", x_unit="ms", title=f"{n:,} circles")
        plotting.log_axes(ax)
    plotting.legend_below(figure, panels[0, 0])
    return figure


OPTIONS = {"n_bodies": [300, 1000, 3000, 10000], "scenes": 3, "steps": 600, "repeats": 2,
           "sweeps": [5, 10, 20, 40, 80, 160, 320, 640, 1280, 2560]}  # fmt: skip
FIGURE = Figure("6.14", "A pile without a past: its first step", compute, table, draw, claims, options=OPTIONS,
                quick={"n_bodies": [100, 300], "scenes": 2, "steps": 200, "repeats": 1})  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
