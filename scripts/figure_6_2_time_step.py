"""python scripts/figure_6_2_time_step.py: errors of a run as the time step goes to 0."""

import numpy as np

from deep_contact.constants import TIME_STEP
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import runs

COLOURS = (plotting.VERMILION, plotting.BLUE, plotting.GREEN)
SHOWN = {
    "energy": "kinetic-energy curve, %",
    "forces": "distribution of forces, %",
    "penetration": "mean penetration, % of r",
    "penetration_max": "deepest penetration, % of r",
}


def compute(options, seed, jobs, progress):
    """The study's rows of the well solved settings on plain piles, by time step."""
    rows = runs.read_study(options["results"])["rows"]
    names = {runs.name_of(setting): setting["dt"] for setting in runs.LIMIT}
    return {
        "rows": [
            {"n_bodies": row["n_bodies"], "dt": names[row["name"]], "errors": row["errors"]}
            for row in rows
            if row["kind"] == "plain" and row["name"] in names and row["errors"]
        ]
    }


def of_size(data, n):
    """Rows of one size, the shortest step first."""
    return sorted((row for row in data["rows"] if row["n_bodies"] == n), key=lambda row: row["dt"])


def order(rows, name):
    """The power of Δt with which an error falls, fitted over all steps."""
    x, y = np.log([row["dt"] for row in rows]), np.log([row["errors"][name][0] for row in rows])
    return float(np.polyfit(x, y, 1)[0])


def claims(data):
    """Penetration falls with the step; energy and forces stop changing within their intervals."""
    found = []
    for n in sorted({row["n_bodies"] for row in data["rows"]}):
        rows = of_size(data, n)
        powers = {name: order(rows, name) for name in ("penetration", "penetration_max")}
        text = f"penetration falls with the time step, {n} circles"
        found.append(Claim(text, None, min(powers.values()) > 0.5, powers))
        # The last two steps differ from the limit by chance alone if their intervals meet.
        last, before = (row["errors"]["energy"] for row in rows[:2])
        measured = {"Δt / 8": last, "Δt / 4": before}
        text = f"the energy curve stops changing within its intervals, {n} circles"
        found.append(Claim(text, None, before[1] <= last[2], measured))
    return found


def table(data):
    """Rows: each size and step, with the interval of each error."""
    rows = [["circles", "Δt, s", *SHOWN.values()]]
    for n in sorted({row["n_bodies"] for row in data["rows"]}):
        for row in of_size(data, n):
            cells = [row["errors"][name] for name in SHOWN]
            rows.append([n, f"{row['dt']:g}", *(c and f"{c[0]:.2g} ({c[1]:.2g} to {c[2]:.2g})" for c in cells)])
    return rows


def draw(data, options):
    """An error in each panel against Δt, a line for each size."""
    figure, panels = plotting.subplots(1, len(SHOWN), size=(13.0, 3.4))
    for ax, (name, text) in zip(panels, SHOWN.items()):
        for n, colour in zip(sorted({row["n_bodies"] for row in data["rows"]}), COLOURS):
            rows = [row for row in of_size(data, n) if row["errors"][name]]
            values = np.array([row["errors"][name] for row in rows])
            ax.errorbar([row["dt"] for row in rows], values[:, 0],
                        np.abs(values[:, 1:].T - values[:, 0]), color=colour, marker="o", markersize=4,
                        label=f"{n:,} circles")  # fmt: skip
        ax.axvline(TIME_STEP, color=plotting.GREY, linewidth=0.6, linestyle=":")
        plotting.label_axes(ax, "time step Δt", text, x_unit="s")
        plotting.log_axes(ax)
    panels[0].legend(fontsize=7)
    return figure


FIGURE = Figure(
    id="6.2",
    title="The limit of small steps",
    options={"results": "data/reference/run_tradeoff.json"},
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
