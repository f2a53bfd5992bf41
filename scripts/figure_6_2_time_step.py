"""python scripts/figure_6_2_time_step.py: runs of a pile at rest, by method, budget and time step."""

from deep_contact.io import shipped
from deep_contact.reporting import figures, plotting, results
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import tradeoff

COLOURS = {"PGS": plotting.VERMILION, "NNCG": plotting.BLUE, "SoftSteps": plotting.GREEN}
LINES = ("-", "--", ":")
SHOWN = {"speed": "m/s", "mean_penetration": "m", "height_drift": "m"}


def compute(options, seed, jobs, progress):
    """The runs of the study on a pile of one size: from its results file, or from short runs made here."""
    if options["results"]:
        rows = results.read_results(shipped.find(options["results"]))["data"]["runs"]
    else:
        rows = tradeoff.resting_runs(options["n_bodies"], seed, seconds=options["seconds"], steps=options["steps"])
        rows = [{"n_bodies": options["n_bodies"], **row} for row in rows]
    return {"rows": [row for row in rows if row["n_bodies"] == options["n_bodies"]]}


def claims(data):
    """Whether small steps with few sweeps beat large steps with many, at the same cost."""
    found = []
    steps = sorted({row["dt"] for row in data["rows"]})
    for name, error in (("speed", "restlessness"), ("mean_penetration", "penetration")):
        least = {}
        for engine in COLOURS:
            best = min(tradeoff.rows_of(data, engine=engine), key=lambda row: abs(row[name]))
            least[f"{engine}, {'m/s' if name == 'speed' else 'm'}"] = abs(best[name])
            least[f"{engine}, Δt, s"] = best["dt"]
        holds = all(least[f"{engine}, Δt, s"] == steps[0] for engine in COLOURS)
        found.append(Claim(f"the smallest time step leaves every method the least {error}", None, holds, least))
    return found


def table(data):
    """Rows: every run."""
    head = ["method", "sweeps or substeps", "Δt, s", "μs a second", "rms speed, m/s", "mean penetration, m", "drift, m"]
    names = ("engine", "budget", "dt", "us_per_second", "speed", "mean_penetration", "height_drift")
    return [head, *([row[name] for name in names] for row in data["rows"])]


def draw(data, options):
    """Three errors of a run by what a second of it costs; a line for each method and time step."""
    figure, panels = plotting.subplots(1, len(SHOWN), size=(12.0, 3.8))
    steps = sorted({row["dt"] for row in data["rows"]})
    for ax, (name, unit) in zip(panels, SHOWN.items()):
        for engine, colour in COLOURS.items():
            for dt, line in zip(steps, LINES):
                mine = sorted(tradeoff.rows_of(data, engine=engine, dt=dt), key=lambda row: row["budget"])
                errors = [max(abs(row[name]), 1e-7) for row in mine]
                times = [row["us_per_second"] for row in mine]
                ax.plot(times, errors, line, color=colour, marker="o", markersize=3, label=f"{engine}, Δt = {dt:g} s")
        points = [(row["us_per_second"], max(abs(row[name]), 1e-7)) for row in data["rows"]]
        front = [points[i] for i in tradeoff.pareto(points)]
        ax.plot(*zip(*front), color=plotting.BLACK, drawstyle="steps-post", linewidth=2.2, label="Pareto front")
        plotting.label_axes(ax, "time of a simulated second", name.replace("_", " "), x_unit="μs", y_unit=unit)
        ax.set(xscale="log", yscale="log")
    panels[-1].legend(fontsize=6, loc="upper right")
    return figure


FIGURE = Figure(
    id="6.2",
    title="Time step, sweeps and substeps in a pile at rest",
    options={"results": "data/reference/tradeoff.json", "n_bodies": 1000, "seconds": 2.0, "steps": [0.02, 0.01, 0.005]},
    quick={"results": "", "n_bodies": 60, "seconds": 0.3, "steps": [0.02, 0.01]},
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
