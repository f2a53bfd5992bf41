"""python scripts/figure_6_12_along_runs.py: starts and solvers along runs of their own, at equal wall time."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.along_runs import (
    BASE,
    cells,
    curve,
    measure_runs,
    names_of,
    ratio_with_interval,
)

CLASSICAL = [BASE, "PSOR 1.7", "PSOR 1.8 | 1.4", "NesterovPGS"]
"""Those that are run at every size; the others were behind them at 1,000 circles."""


def compute(options, seed, jobs, progress):
    """Runs first, in parallel, then their times, one after the other."""
    return {
        "columns": options["columns"],
        "runs": measure_runs(options, seed, jobs, progress),
    }


def over(one, other):
    """`ratio_with_interval`, or three times None where the time does not suffice for the first."""
    return [None] * 3 if one is None else ratio_with_interval(one, other)


def claims(data):
    """Whether the friction's own ω wins along runs, and whether another start than Builtin does."""
    own, starts = {}, {}
    for cell in cells(data["runs"], data["columns"]):
        where = f"{cell['circles']} circles, time of {cell['sweeps']} sweeps"
        errors = {name: values for name, values in cell["errors"].items() if values is not None}
        means = {name: np.mean(values) for name, values in errors.items()}
        single = [name for name in errors if name in ("PSOR 1.5", "PSOR 1.7", "PSOR adaptive")]
        double = [name for name in errors if name in (BASE, "PSOR 1.8 | 1.4")]
        pair = [errors[min(group, key=means.get)] for group in (double, single)]
        own[where] = dict(zip(("ratio", "from", "to"), ratio_with_interval(*pair)))
        for name in (name for name in errors if ", " in name):
            starts[f"{where}, {name}"] = dict(
                zip(("ratio", "from", "to"), ratio_with_interval(errors[name], errors[BASE]))
            )
    text = "an ω of its own for friction leaves less than any single ω at equal time, at all sizes and times"
    found = [Claim(text, None, all(r["ratio"] < 1.0 for r in own.values()), own)]
    text = "no other start leaves less than Builtin at equal time"
    return [*found, Claim(text, None, all(r["to"] > 1.0 for r in starts.values()), starts)] if starts else found


def table(data):
    """Rows: errors along runs at equal times, ratio to the best classical setting, and what a user sees."""
    rows = [["circles", "setting", "time of, sweeps", "ms a step", "error", "over the best classical", "is best"]]
    for cell in cells(data["runs"], data["columns"]):
        for name, errors in cell["errors"].items():
            ratio = over(errors, cell["errors"][cell["best"]])
            text = None if ratio[0] is None else "{:.2f} ({:.2f}–{:.2f})".format(*ratio)
            error = None if errors is None else float(np.mean(errors))
            milliseconds, best = 1e3 * cell["seconds"], "yes" if name == cell["best"] else ""
            rows.append([str(cell["circles"]), name, cell["sweeps"], milliseconds, error, text, best])
    return rows


def draw(data, options):
    """Mean error against time of a step, one panel a size."""
    sizes = list(dict.fromkeys(entry["circles"] for entry in data["runs"]))
    figure, axes = plotting.subplots(1, len(sizes), size=(4.2 * len(sizes), 3.8))
    names = names_of(data["runs"], sizes[0])
    styles = plotting.styles_of(names)
    for axis, circles in zip(np.atleast_1d(axes), sizes):
        for name in names_of(data["runs"], circles):
            seconds, errors = curve(data["runs"], circles, name)
            axis.plot(1e3 * seconds, errors.mean(axis=1), marker="o", markersize=3, **styles[name])
        plotting.log_axes(axis)
        plotting.label_axes(axis, "time of a step", "mean velocity error", x_unit="ms", title=f"{circles} circles")
    named = np.atleast_1d(axes)[0].get_legend_handles_labels()  # the first size has all settings
    axis.legend(*named, fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


FIGURE = Figure(
    id="6.12",
    title="Starts and solvers along their own runs, at equal wall time",
    options={
        "columns": [10, 20, 50],
        "runs": {
            "1000": {
                "scenes": 8,
                "sweeps": [3, 6, 10, 20, 50, 70],
                "settings": [
                    *(*CLASSICAL, "PSOR 1.5", "PSOR adaptive", "NNCG"),
                    *(f"{BASE}, {start}" for start in ("none", "scaled")),
                ],
            },
            "3000": {"scenes": 8, "sweeps": [6, 10, 20, 50, 70], "settings": CLASSICAL},
            "10000": {"scenes": 5, "sweeps": [6, 10, 20, 50], "settings": CLASSICAL},
        },
        "steps": 300,
        "every": 20,
        "past_need": 400,
        "repeats": 2,
    },
    quick={
        "columns": [10],
        "runs": {
            "100": {"scenes": 2, "sweeps": [6, 10, 20], "settings": [*CLASSICAL, f"{BASE}, scaled"]},
        },
        "steps": 120,
        "past_need": 300,
        "repeats": 1,
    },
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
    digits=5,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
