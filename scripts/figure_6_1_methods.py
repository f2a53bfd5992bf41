"""python scripts/figure_6_1_methods.py: velocity error against sweeps and against time, for every method and start."""

import numpy as np

from deep_contact.io import shipped
from deep_contact.reporting import figures, plotting, results
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import tradeoff

LOOKS = {
    "PGS": (plotting.VERMILION, "-"),
    "PGS, no start": (plotting.VERMILION, ":"),
    "PGS, single": (plotting.VERMILION, "--"),
    "PSOR 1.5": (plotting.ORANGE, "--"),
    "PSOR adaptive": (plotting.ORANGE, "-"),
    "SymmetricPGS": (plotting.SKY, "-"),
    "NNCG": (plotting.BLUE, "-"),
    "NNCG, no start": (plotting.BLUE, ":"),
    "NNCG, single": (plotting.BLUE, "--"),
    "NesterovPGS": (plotting.GREEN, "-"),
    "NesterovPGS, no start": (plotting.GREEN, ":"),
    "NesterovPGS, single": (plotting.GREEN, "--"),
    "APGD": (plotting.PURPLE, "-"),
}
MARKERS = {"Box2D 2.3": "s", "pymunk": "^", "Box2D v3": "D"}


def compute(options, seed, jobs, progress):
    """The rows of the study for piles of one size: from its results file, or from a small study made here."""
    if options["results"]:
        found = results.read_results(shipped.find(options["results"]))["data"]
    else:
        settings = {name: options[name] for name in ("n_bodies", "states", "sweeps", "tolerances", "past_need")}
        kinds = progress(options["kinds"], text="piles")
        piles = [tradeoff.solution_errors(kind, seed=seed, exact=True, **settings) for kind in kinds]
        rows = tradeoff.condensed(piles, [tradeoff.costs(options["n_bodies"], seed, repeats=2)])
        found = {"rows": rows, "peers": [], "piles": piles}
    rows, peers, piles = (
        [row for row in found[name] if row["n_bodies"] == options["n_bodies"]] for name in ("rows", "peers", "piles")
    )
    return {
        "rows": [row for row in rows if row["kind"] in options["kinds"]],
        "peers": [row for row in peers if row["velocity"]],
        "spread": [value for pile in piles for value in pile["spread"]],
        "left_out": sum(pile["left_out"] for pile in piles),
    }


def curve(data, kind, setting):
    """Rows of a setting with numbers of sweeps as budgets, in their order."""
    rows = tradeoff.rows_of(data, kind=kind, setting=setting)
    return sorted((row for row in rows if row["budget"]["tolerance"] is None), key=lambda row: row["sweeps"])


def claims(data):
    """Which method is ahead at small and at large budgets, what a start is worth, and the floor of float32."""
    kinds = [row["kind"] for row in data["rows"]]
    kind = "settling" if "settling" in kinds else kinds[-1]
    found = []
    for error in (1e-1, 1e-2):
        times = {
            name: tradeoff.fastest_within(tradeoff.rows_of(data, kind=kind, setting=name), error, "p50")
            for name in ("PGS", "NNCG", "NesterovPGS", "PSOR adaptive")
        }
        measured = {f"{name}, μs": row and row["us"] for name, row in times.items()}
        for name in ("NNCG", "NesterovPGS", "PSOR adaptive"):
            holds = times[name] is not None and (times["PGS"] is None or times[name]["us"] < times["PGS"]["us"])
            found.append(Claim(f"{name} reaches a median error of {error:g} sooner than PGS", None, holds, measured))
    floor = {name: min(row["velocity"]["p50"] for row in curve(data, kind, name)) for name in ("NNCG", "NNCG, single")}
    text = "single precision has a floor ten times that of double"
    return [*found, Claim(text, None, floor["NNCG, single"] > 10 * floor["NNCG"], floor)]


def table(data):
    """Rows: the time at which each setting first reaches each median error."""
    errors = (3e-1, 1e-1, 1e-2, 1e-3)
    rows = [["kind", "setting", *(f"μs to {error:g}" for error in errors)]]
    for kind in dict.fromkeys(row["kind"] for row in data["rows"]):
        for name in dict.fromkeys(row["setting"] for row in data["rows"]):
            mine = tradeoff.rows_of(data, kind=kind, setting=name)
            best = [tradeoff.fastest_within(mine, error, "p50") for error in errors]
            rows.append([kind, name, *(row and row["us"] for row in best)])
    return rows


def draw(data, options):
    """A row of panels for each kind of pile: error by sweeps, and error by time with the Pareto front and the peers."""
    kinds = list(dict.fromkeys(row["kind"] for row in data["rows"]))
    figure, panels = plotting.subplots(len(kinds), 2, size=(10.0, 3.4 * len(kinds)), squeeze=False, sharey="row")
    for (left, right), kind in zip(panels, kinds):
        for name, (colour, line) in LOOKS.items():
            rows = curve(data, kind, name)
            errors = [row["velocity"]["p50"] for row in rows]
            left.plot([row["sweeps"] for row in rows], errors, line, color=colour, label=name)
            right.plot([row["us"] for row in rows], errors, line, color=colour, alpha=0.6)
        points = [(row["us"], row["velocity"]["p50"]) for row in tradeoff.rows_of(data, kind=kind)]
        front = [points[i] for i in tradeoff.pareto(points)]
        right.plot(*zip(*front), color=plotting.BLACK, linewidth=2.2, drawstyle="steps-post", label="Pareto front")
        for engine, marker in MARKERS.items() if kind == "settling" else ():
            mine = [row for row in data["peers"] if row["engine"] == engine]
            if mine:
                medians = [float(np.median(row["velocity"])) for row in mine]
                right.plot([row["us"] for row in mine], medians, color=plotting.GREY, marker=marker, label=engine)
        plotting.label_axes(left, "sweeps", "velocity error, median", title=f"{kind}: by sweeps")
        plotting.label_axes(right, "time of a step", "", x_unit="μs", title=f"{kind}: by time")
        for ax in (left, right):
            ax.set(xscale="log", yscale="log", ylim=(1e-5, 2))
        right.legend(fontsize=7)
    panels[0][0].legend(fontsize=7, ncols=2)
    return figure


FIGURE = Figure(
    id="6.1",
    title="Accuracy against sweeps and time",
    options={
        "results": "data/reference/tradeoff.json",
        "n_bodies": 1000,
        "kinds": list(tradeoff.KINDS),
        "states": 8,
        "sweeps": [1, 3, 10, 30, 100, 300, 1000],
        "tolerances": [1e-1, 1e-2, 1e-3, 1e-4],
        "past_need": 20_000,
    },
    quick={"results": "", "n_bodies": 60, "kinds": ["settling"], "states": 3, "sweeps": [1, 3, 10, 30, 100, 300]},
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
