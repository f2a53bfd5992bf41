"""python scripts/figure_6_2_time_step.py: errors of a run against its time step, down to that of the reference."""

import numpy as np

from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.measure import errors
from deep_contact.plot import plotting
from deep_contact.state.constants import TIME_STEP
from deep_contact.studies import runs

SHOWN = {
    "energy": "kinetic-energy curve, %",
    "forces": "distribution of forces, %",
    "penetration": "mean penetration, % of r",
    "penetration_max": "deepest penetration, % of r",
}


def compute(options, seed, jobs, progress):
    """Read the study's rows for plain piles whose setting differs from the reference in the time step only."""
    rows = [
        {"n_bodies": row["n_bodies"], "dt": row["setting"]["dt"], "errors": row["errors"]}
        for row in runs.read_study(options["results"])["plain"]
        if row["setting"] | {"dt": 0} == runs.REFERENCE | {"dt": 0}
    ]
    return {"rows": rows}


def by_size(data):
    """Return the rows whose time step is not below the reference's: number of circles -> rows, by ascending step."""
    rows = sorted((row for row in data["rows"] if not is_below(row)), key=lambda row: row["dt"])
    return {n: [row for row in rows if row["n_bodies"] == n] for n in runs.sizes_of(rows)}


def is_below(row):
    """Return whether a row's time step is shorter than the reference's. Its error is then mainly the reference's."""
    return row["dt"] < runs.REFERENCE["dt"]


def claims(data):
    for n, rows in by_size(data).items():
        powers = {}
        for name in ("penetration", "penetration_max"):
            x, y = np.log([row["dt"] for row in rows]), np.log([row["errors"][name][0] for row in rows])
            powers[name] = float(np.polyfit(x, y, 1)[0])
        yield Claim(f"penetration falls with the time step, {n} circles", None, min(powers.values()) > 0.5, powers)
        if rows[1]["dt"] > 2 * rows[0]["dt"]:
            continue
        # If the intervals of the two shortest steps overlap, their errors differ by chance only.
        last, before = (row["errors"]["energy"] for row in rows[:2])
        text = f"the energy curve stops changing within its intervals, {n} circles"
        names = (f"Δt / {TIME_STEP / row['dt']:g}".removesuffix(" / 1") for row in rows)
        yield Claim(text, None, before[1] <= last[2], dict(zip(names, (last, before))))
    for row in filter(is_below, data["rows"]):
        energy, before = row["errors"]["energy"], by_size(data)[row["n_bodies"]][0]["errors"]["energy"]
        text = f"half of the reference's step is no farther from it than twice its step, {row['n_bodies']} circles"
        yield Claim(text, None, energy[1] <= before[2], {"half, energy, %": energy, "twice": before})


def table(data):
    rows = [["circles", "Δt, s", *SHOWN.values()]]
    for row in sorted(data["rows"], key=lambda row: (row["n_bodies"], row["dt"])):
        cells = [row["errors"][name] for name in SHOWN]
        cells = [c and f"{c[0]:.2g} ({c[1]:.2g} to {c[2]:.2g})" for c in cells]
        rows.append([row["n_bodies"], f"{row['dt']:g}" + " (below the reference)" * is_below(row), *cells])
    return rows


def draw(data, options):
    """Draw an error in each panel against Δt down to the reference's Δt, with its interval and a line for each size."""
    figure, panels = plotting.subplots(2, 2, size=(plotting.PAGE, 5.6), sharex=True)
    sizes = by_size(data)
    for ax, (name, text) in zip(panels.flat, SHOWN.items()):
        for (n, rows), colour in zip(sizes.items(), plotting.shades(len(sizes))):
            steps, values = zip(*((row["dt"], row["errors"][name]) for row in rows if row["errors"][name]))
            values, reach = zip(*map(errors.with_reach, values))
            look = {"color": colour, "marker": "o", "markersize": 4, "label": f"{n:,} circles"}
            ax.errorbar(steps, values, np.concatenate(reach, axis=1), **look)
        for dt, look, line in ((TIME_STEP, "--", "10 ms"), (runs.REFERENCE["dt"], ":", "Δt of the reference")):
            ax.axvline(dt, color=plotting.GREY, linewidth=0.9, linestyle=look, label=line)
        ax.set_ylabel(text)
        plotting.log_axes(ax)
    for ax in panels[1]:
        ax.set_xlabel("time step Δt (s)")
    return plotting.legend_below(figure, panels[0, 0], "How far from the reference is a run, by its time step?", rows=2)


FIGURE = Figure("6.2", "The limit of small steps", compute, table, draw, claims, options=runs.RESULTS)
figures.run_as_script(FIGURE, __name__)
