"""python scripts/figure_6_11_next_microsecond.py: errors by time, with more sweeps and with a smaller step."""

from itertools import product

from deep_contact.constants import TIME_STEP
from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import runs

DIVISORS = (1, 2, 4, 8)
SHOWN = {"energy": "kinetic-energy curve", "penetration_max": "deepest penetration", "forces": "forces"}
DRAWN = ("energy", "penetration_max")


def compute(options, seed, jobs, progress):
    """The study's rows of PGS by step and sweeps."""
    rows = []
    for row in runs.read_study(options["results"])["plain"]:
        setting = row["setting"]
        if setting.keys() == {"method", "sweeps", "dt"} and setting["method"] == "PGS" and row["us"] is not None:
            errors = {name: row["errors"][name] and row["errors"][name][0] for name in SHOWN}
            about = {"n_bodies": row["n_bodies"], "divisor": TIME_STEP / setting["dt"], "sweeps": setting["sweeps"]}
            rows.append(about | {"us": row["us"], "errors": errors})
    return {"rows": rows}


def line(data, n, divisor):
    """Rows of a size and a step, by sweeps."""
    rows = [row for row in data["rows"] if row["n_bodies"] == n and row["divisor"] == divisor]
    return sorted(rows, key=lambda row: row["sweeps"])


def compared(data, n):
    """20 sweeps in a step of Δt, and what leaves the least depth for their price in smaller steps."""
    solved = next(row for row in line(data, n, 1) if row["sweeps"] == 20)  # more change no error beyond its interval
    smaller = [row for row in data["rows"] if row["n_bodies"] == n and row["divisor"] > 1]
    cheaper = [row for row in smaller if row["us"] <= solved["us"]]
    return solved, min(cheaper, key=lambda row: row["errors"]["penetration_max"])


def claims(data):
    for n in runs.sizes_of(data["rows"]):
        solved, best = compared(data, n)
        depths, energies = ([row["errors"][name] for row in (solved, best)] for name in DRAWN[::-1])
        measured = {"Δt, 20 sweeps, %": depths[0], "μs": solved["us"], "Δt /": best["divisor"]}
        measured |= {"sweeps": best["sweeps"], "%": depths[1]}
        text = f"for the price of 20 sweeps a smaller step halves the deepest penetration, {n} circles"
        yield Claim(text, None, depths[1] < 0.5 * depths[0], measured)
        text = f"its kinetic-energy curve is no worse than that of 20 sweeps, {n} circles"
        yield Claim(text, None, energies[1] <= energies[0], dict(zip(("20 sweeps, %", "smaller step"), energies)))


def table(data):
    rows = [["circles", "Δt /", "sweeps", "µs per 10 ms", *(f"{text}, %" for text in SHOWN.values())]]
    for n in runs.sizes_of(data["rows"]):
        for row in (row for divisor in DIVISORS for row in line(data, n, divisor)):
            rows.append([n, int(row["divisor"]), row["sweeps"], row["us"], *(row["errors"][name] for name in SHOWN)])
    return rows


def draw(data, options):
    """A column for each size, a row for each error: error by time, a line for each step, along which sweeps grow."""
    sizes = runs.sizes_of(data["rows"])
    size = (plotting.PAGE, 2.4 * len(DRAWN) + 0.9)
    figure, panels = plotting.subplots(len(DRAWN), len(sizes), size=size, squeeze=False, sharex="col", sharey="row")
    for ax, (name, n) in zip(panels.flat, product(DRAWN, sizes)):
        for divisor, colour in zip(DIVISORS, plotting.shades(len(DIVISORS))):
            rows = line(data, n, divisor)
            label = "Δt = 10 ms" if divisor == 1 else f"Δt / {divisor}"
            points = [(row["us"], row["errors"][name]) for row in rows]
            ax.plot(*zip(*points), color=colour, marker="o", markersize=3, label=label)
            for end in {0, len(rows) - 1}:
                look = {"fontsize": 8, "xytext": (2, 3), "textcoords": "offset points", "color": colour}
                ax.annotate(str(rows[end]["sweeps"]), points[end], **look)
        points = [(row["us"], row["errors"][name]) for row in compared(data, n)]
        look = {"color": plotting.VERMILION, "markersize": 8, "markerfacecolor": "none", "linestyle": "none"}
        ax.plot(*zip(*points), marker="o", label="20 sweeps, and the least depth for their price", **look)
        ax.margins(0.12)
        plotting.log_axes(ax)
    texts = (f"{SHOWN[name]} (%)" for name in DRAWN)
    plotting.label_grid(panels, map("{:,} circles".format, sizes), "time of 10 ms (µs)", texts)
    title = "Where should the next microsecond go: more sweeps (numbers), or a smaller step?"
    return plotting.legend_below(figure, panels[0, 0], title)


FIGURE = Figure("6.11", "Where the next microsecond goes: more sweeps, or a smaller step", compute, table, draw, claims,
                options=runs.RESULTS)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
