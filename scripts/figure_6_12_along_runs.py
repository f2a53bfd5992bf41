"""python scripts/figure_6_12_along_runs.py: starts and solvers along runs of their own, at equal wall time."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.along_runs import (
    BASE,
    LEARNED,
    at_equal_sweeps,
    cells,
    curve,
    given_seconds,
    measure_given,
    measure_rest,
    measure_runs,
    median_ratio_with_interval,
    names_of,
    prices_of,
    ratio_with_interval,
)

ERRORS = (0.2, 0.1)
"""Velocity errors to which the time from given states is taken."""

CLASSICAL = [BASE, "PSOR 1.7", "PSOR 1.8 | 1.4", "NesterovPGS"]
"""Those that are run at every size; the others were behind them at 1,000 circles."""


def compute(options, seed, jobs, progress):
    """Runs first, in parallel, then their times, one after the other; then given states."""
    return {
        "columns": options["columns"],
        "runs": measure_runs(options, seed, jobs, progress),
        "given": measure_given(options, seed, jobs, progress),
        "rest": measure_rest(options),
    }


def given_cases(data):
    """(circles, error, best classical, median ratio of times learned / best with interval) of every case.

    The best is that of the least median time. Cases that either reaches on at most half of the states are left out.
    """
    found = []
    for entry in data["given"]:
        for error in ERRORS:
            times = {name: given_seconds(entry, name, error) for name in entry["errors"]}
            best = min((name for name in times if name != LEARNED), key=lambda name: np.median(times[name]))
            ratios = median_ratio_with_interval(times[LEARNED], times[best])
            if ratios is not None:
                found.append((entry["circles"], error, best, ratios))
    return found


def over(one, other):
    """`ratio_with_interval`, or three times None where the time does not suffice for the first."""
    return [None] * 3 if one is None else ratio_with_interval(one, other)


def claims(data):
    """Whether the learned start wins, along runs and from given states, and whether the friction's own ω does."""
    ratios, own = {}, {}
    for cell in cells(data["runs"], data["columns"]):
        where = f"{cell['circles']} circles, time of {cell['sweeps']} sweeps"
        best = cell["errors"][cell["best"]]
        found = over(cell["errors"][LEARNED], best)
        ratios[where] = {"best classical": cell["best"], "ratio": found[0], "from": found[1], "to": found[2]}
        errors = {name: values for name, values in cell["errors"].items() if values is not None}
        single = [name for name in errors if name in ("PSOR 1.5", "PSOR 1.7", "PSOR adaptive")]
        double = [name for name in errors if name in (BASE, "PSOR 1.8 | 1.4")]
        means = {name: np.mean(values) for name, values in errors.items()}
        pair = [errors[min(group, key=means.get)] for group in (double, single)]
        own[where] = dict(zip(("ratio", "from", "to"), ratio_with_interval(*pair)))
    wins = sum(r["ratio"] is not None and r["ratio"] <= 0.85 and r["to"] < 0.95 for r in ratios.values())
    text = "along runs the learned start leaves at most 0.85 of the best classical error at equal time, in 4 of 9 cells"
    found = [Claim(text, None, wins >= 4, {"wins": wins, **ratios})]
    text = "an ω of its own for friction leaves less than any single ω at equal time, at all sizes and times"
    found.append(Claim(text, None, all(r["ratio"] < 1.0 for r in own.values()), own))
    given = {
        f"{circles} circles, to {error:g}": {"best classical": best, "ratio": r[0], "from": r[1], "to": r[2]}
        for circles, error, best, r in given_cases(data)
    }
    wins = sum(r["ratio"] <= 1 / 1.3 and r["to"] < 1 / 1.15 for r in given.values())
    text = "from given states the learned start is 1.3 times faster than the best classical setting, in 4 of 6 cases"
    found.append(Claim(text, None, wins >= 4, {"wins": wins, **given}))
    prices = {f"{circles} circles": price for circles, price in prices_of(data["runs"]).items()}
    text = "the learned start costs at most 5 sweeps"
    found.append(Claim(text, None, max(prices.values()) <= 5.0, {"sweeps": prices}))
    return [*found, *claims_at_equal_sweeps(data), claim_at_rest(data)]


def claims_at_equal_sweeps(data):
    """Were it for nothing: whether the learned start leaves less after as many sweeps, and what a user sees of it."""
    errors, seen = {}, {}
    for cell in cells(data["runs"], data["columns"]):
        circles, sweeps = cell["circles"], cell["sweeps"]
        where = f"{circles} circles, {sweeps} sweeps"
        pair = at_equal_sweeps(data["runs"], circles, sweeps, "error")
        errors[where] = dict(zip(("ratio", "from", "to"), ratio_with_interval(*pair)))
        for key in ("penetration", "speed", "height"):
            one, other = at_equal_sweeps(data["runs"], circles, sweeps, key)
            found = ratio_with_interval(one, other)
            # Low piles are worse, and so are deep contacts and fast circles at the end.
            if found[2] < 1.0 if key == "height" else found[1] > 1.0:
                seen[f"{where}, {key}"] = found
    text = "with as many sweeps, its price left out, the learned start leaves at most 0.85 of Builtin's error"
    found = [Claim(text, None, all(r["ratio"] <= 0.85 for r in errors.values()), errors)]
    text = "with as many sweeps, penetration, final speed and height are nowhere worse than Builtin's (95 %)"
    return [*found, Claim(text, None, not seen, {"worse": seen})]


def claim_at_rest(data):
    """Whether a pile at rest pays for the start that it leaves out."""
    shares = {f"{entry['circles']} circles": entry["learned"] / entry["builtin"] - 1.0 for entry in data["rest"]}
    return Claim("at rest the learned start costs less than 2 % of a step", None, max(shares.values()) < 0.02, shares)


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
                    *(f"{BASE}, {start}" for start in ("none", "scaled", "by need", "learned")),
                ],
            },
            "3000": {"scenes": 8, "sweeps": [6, 10, 20, 50, 70], "settings": [*CLASSICAL, LEARNED]},
            "10000": {"scenes": 5, "sweeps": [6, 10, 20, 50], "settings": [*CLASSICAL, LEARNED]},
        },
        "steps": 300,
        "every": 20,
        "past_need": 400,
        "given": {"1000": 5, "3000": 3, "10000": 2},
        "given_sweeps": [0, 5, 10, 15, 20, 25, 30, 40, 50, 60, 75, 100, 150, 200],
        "states": 4,
        "past_need_given": 1500,
        "rest": [100, 1000, 3000],
        "rest_steps": 2000,
        "repeats": 2,
    },
    quick={
        "columns": [10],
        "runs": {
            "100": {"scenes": 2, "sweeps": [6, 10, 20], "settings": [*CLASSICAL, f"{BASE}, by need", LEARNED]},
        },
        "steps": 120,
        "given": {"100": 2},
        "rest": [100],
        "rest_steps": 600,
        "states": 2,
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
