"""python scripts/figure_6_12_along_runs.py: starts and solvers along runs of their own, at equal wall time."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.learned_starts import BASE, at_equal_times, curves, measure_runs, ratios_of

LEARNED = f"guarded, {BASE}"
CLASSICAL = [f"builtin, {solver}" for solver in (BASE, "PSOR 1.7", "PSOR 1.8 | 1.4", "NesterovPGS")]
"""Those that are run at every size; the others were behind them at 1,000 circles."""

MORE = [f"builtin, {solver}" for solver in ("PSOR 1.5", "NNCG")] + [f"none, {BASE}", f"scaled, {BASE}"]
SINGLE = [f"builtin, {solver}" for solver in ("PSOR 1.5", "PSOR 1.7")]
DOUBLE = [f"builtin, {solver}" for solver in (BASE, "PSOR 1.8 | 1.4")]


def compute(options, seed, jobs, progress):
    """Runs first, in parallel; then their times, one after the other."""
    starts = {name: name for name in ("none", "builtin", "scaled")} | {"guarded": {"guarded": options["model"]}}
    return {"columns": options["columns"], "runs": measure_runs(starts, options, seed, jobs, progress)}


def ratio(one, other):
    """Ratio of the mean errors of two settings with its interval; three times None where there is no error."""
    return [None] * 3 if one is None else ratios_of(np.array(one)[:, None], np.array(other)[:, None])[0].tolist()


def claims(data):
    timed, swept, own = {}, {}, {}
    error = {(entry["circles"], entry["setting"], entry["sweeps"]): entry["error"] for entry in data["runs"]}
    for cell in at_equal_times(data["runs"], data["columns"]):
        circles, sweeps, errors = cell["circles"], cell["sweeps"], cell["errors"]
        where = f"{circles} circles, time of {sweeps} sweeps"
        found = ratio(errors[LEARNED], errors[cell["best"]])
        timed[where] = {"best classical": cell["best"]} | dict(zip(("ratio", "from", "to"), found))
        swept[f"{circles} circles, {sweeps} sweeps"] = ratio(*(error[circles, s, sweeps] for s in (LEARNED, DOUBLE[0])))
        best = [min((n for n in names if n in errors), key=lambda n: np.mean(errors[n])) for names in (DOUBLE, SINGLE)]
        own[where] = ratio(*(errors[name] for name in best))
    wins = sum(r["ratio"] is not None and r["ratio"] <= 0.85 and r["to"] < 0.95 for r in timed.values())
    text = "along runs the network leaves at most 0.85 of the best classical error at equal time, in 4 of 9 cells"
    yield Claim(text, None, wins >= 4, {"wins": wins, **timed})
    text = "with as many sweeps, its price left out, the network leaves at most 0.85 of Builtin's error"
    yield Claim(text, None, all(r[0] <= 0.85 for r in swept.values()), swept)
    text = "an ω of its own for friction leaves less than any single ω at equal time, at all sizes and times"
    yield Claim(text, None, all(r[0] < 1 for r in own.values()), own)


def table(data):
    rows = [["circles", "setting", "time of, sweeps", "ms a step", "error", "over the best classical", "is best"]]
    for cell in at_equal_times(data["runs"], data["columns"]):
        for name, errors in cell["errors"].items():
            found = ratio(errors, cell["errors"][cell["best"]])
            text = None if errors is None else "{:.2f} ({:.2f}–{:.2f})".format(*found)
            error, best = None if errors is None else float(np.mean(errors)), "yes" if name == cell["best"] else ""
            rows.append([str(cell["circles"]), name, cell["sweeps"], 1e3 * cell["seconds"], error, text, best])
    return rows


def draw(data, options):
    """Mean error against time of a step, one panel a size."""
    sizes = curves(data["runs"])
    figure, axes = plotting.subplots(1, len(sizes), size=(4.2 * len(sizes), 3.8), squeeze=False)
    styles = plotting.styles_of([*CLASSICAL, LEARNED])
    for axis, (circles, of_size) in zip(axes[0], sizes.items()):
        for name, (_, seconds, errors) in of_size.items():
            if name in styles:
                axis.plot(1e3 * seconds, errors.mean(axis=1), marker="o", markersize=3, **styles[name])
        plotting.log_axes(axis)
        plotting.label_axes(axis, "time of a step", "mean velocity error", x_unit="ms", title=f"{circles:,} circles")
    axes[0, 0].legend()
    return figure


RUNS = {
    "1000": {"scenes": 6, "sweeps": [6, 10, 20, 50, 70], "settings": [*CLASSICAL, LEARNED, *MORE]},
    "3000": {"scenes": 5, "sweeps": [6, 10, 20, 50, 70], "settings": [*CLASSICAL, LEARNED]},
    "10000": {"scenes": 3, "sweeps": [6, 10, 20, 50], "settings": [*CLASSICAL, LEARNED]},
}
OPTIONS = {"columns": [10, 20, 50], "runs": RUNS, "steps": 300, "every": 20, "past_need": 400, "repeats": 1}
OPTIONS |= {"model": "models/model.h5"}
QUICK = {
    "columns": [10], "runs": {"100": {"scenes": 2, "sweeps": [6, 10, 20], "settings": [*CLASSICAL, LEARNED]}},
    "steps": 120, "past_need": 300, "repeats": 1,
}  # fmt: skip
FIGURE = Figure("6.12", "Starts and solvers along their own runs, at equal wall time", compute, table, draw, claims,
                options=OPTIONS, quick=QUICK, digits=5)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
