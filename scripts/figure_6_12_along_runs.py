"""python scripts/figure_6_12_along_runs.py: starts and solvers along runs of their own, at equal wall time."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import learned_starts as study
from deep_contact.studies.learned_starts import BASE, LEARNED, at_equal_times

NETWORK, BUILTIN = f"{LEARNED}, {BASE}", f"builtin, {BASE}"
DRAWN = (NETWORK, BUILTIN, f"scaled, {BASE}", f"none, {BASE}", "builtin, NesterovPGS")


def compute(options, seed, jobs, progress):
    """Of each size first runs, in parallel; then their times, one after the other."""
    starts = study.starts_with(options["model"])
    return {"columns": options["columns"], "runs": study.measure_runs(starts, options, seed, jobs, progress)}


def at_times_of(data, start):
    """The network against the best classical setting in the time of so many sweeps from a start, cell by cell."""
    return {
        f"{cell['circles']} circles, time of {cell['sweeps']} sweeps": {"best classical": cell["best"]}
        | dict(zip(("ratio", "from", "to"), cell["ratios"][NETWORK] or [None] * 3))
        for cell in at_equal_times(data["runs"], data["columns"], start)
    }


def claims(data):
    timed, own, swept = at_times_of(data, "builtin"), at_times_of(data, LEARNED), {}
    for circles, curves in data["runs"].items():
        for k in data["columns"]:
            errors = (curves[name]["errors"][curves[name]["sweeps"].index(k)] for name in (NETWORK, BUILTIN))
            swept[f"{circles} circles, {k} sweeps"] = study.ratios_of(*errors).tolist()
    known = [r for r in timed.values() if r["ratio"] is not None]
    wins = sum(r["ratio"] <= 0.85 and r["to"] < 0.95 for r in known)
    counted = {"wins": wins, "cells": len(timed), "too slow": len(timed) - len(known)}
    text = "along runs the network leaves at most 0.85 of the best classical error at equal time, in 4 of 9 cells"
    yield Claim(text, None, wins >= 4, counted | timed)
    text = "in the time that it takes itself, the network leaves less error than the best classical setting"
    yield Claim(text, None, all(r["to"] < 1 for r in own.values()), own)
    text = "with as many sweeps, its price left out, the network leaves at most 0.85 of Builtin's error"
    yield Claim(text, None, all(r[0] <= 0.85 for r in swept.values()), swept)


def table(data):
    rows = [["circles", "setting", "time of, sweeps", "ms a step", "error", "over the best classical", "is best"]]
    for cell in at_equal_times(data["runs"], data["columns"]):
        for name, ratio in cell["ratios"].items():
            found = [float(np.mean(cell["errors"][name])), study.text_of(ratio)] if ratio else ["does not fit", None]
            best = "yes" if name == cell["best"] else ""
            rows.append([cell["circles"], name, cell["sweeps"], 1e3 * cell["seconds"], *found, best])
    return rows


def draw(data, options):
    """Mean error along runs against the time of a step, one panel a size."""
    sizes = data["runs"]
    figure, axes = plotting.subplots(1, len(sizes), size=(plotting.PAGE, 3.6), squeeze=False)
    for ax, (circles, of_size) in zip(axes[0], sizes.items()):
        for cell in at_equal_times({circles: of_size}, data["columns"]):
            ax.axvline(1e3 * cell["seconds"], color=plotting.GREY, linewidth=0.8, zorder=0)
        for name in DRAWN:
            (start, solver), curve = study.parts_of(name), of_size[name]
            look = plotting.style_of(start)
            look["label"] += f", {'PSOR' if solver == BASE else solver}"
            if solver != BASE:
                look["color"] = plotting.NESTEROV
            milliseconds = 1e3 * np.array(curve["seconds"])
            ax.plot(milliseconds, np.mean(curve["errors"], axis=1), marker="o", markersize=3, **look)
        plotting.log_axes(ax)
    titles = (f"{int(circles):,} circles" for circles in sizes)
    plotting.label_grid(axes, titles, "time of a step (ms)", ["mean velocity error along the run"])
    title = "Which start and solver leave the least error at equal time? (lines: of {} sweeps from Builtin)"
    return plotting.legend_below(figure, axes[0, 0], title.format(", ".join(map(str, data["columns"]))))


RUNS = {
    "1000": {"scenes": 6, "sweeps": [6, 10, 20, 50, 70]},
    "3000": {"scenes": 5, "sweeps": [6, 10, 20, 50, 70]},
    "10000": {"scenes": 3, "sweeps": [6, 10, 20, 50]},
}
OPTIONS = {"columns": [10, 20, 50], "runs": RUNS, "steps": 300, "every": 20, "past_need": 400, "repeats": 1}
OPTIONS |= {"model": "models/model.h5"}
QUICK = {
    "columns": [10], "runs": {"100": {"scenes": 2, "sweeps": [6, 10, 20]}}, "steps": 120, "past_need": 300,
}  # fmt: skip
FIGURE = Figure("6.12", "Starts and solvers along their own runs, at equal wall time", compute, table, draw, claims,
                options=OPTIONS, quick=QUICK, digits=5)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
