"""python scripts/figure_6_11_next_microsecond.py: which part of an error is the solver's, the step's, the model's."""

from deep_contact.constants import TIME_STEP
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import runs

DIVISORS = (1, 2, 4, 8)
COLOURS = (plotting.VERMILION, plotting.ORANGE, plotting.GREEN, plotting.BLUE)
SHOWN = {"energy": "kinetic-energy curve", "penetration_max": "deepest penetration", "forces": "forces"}
ABSOLUTE = "penetration_max"
"""The error that is not against the reference."""

STEP, LEFT = "Δt = 10 ms", "left at the smallest Δt"
PARTS = {STEP: plotting.BLUE, LEFT: plotting.SKY} | dict(zip(runs.MODEL, (plotting.GREEN, plotting.ORANGE)))
"""Part of an error -> colour; few sweeps, whose name has their number, have another."""

SOLVED = 20
"""Sweeps that count as solved: more of them change no error beyond its interval."""


def compute(options, seed, jobs, progress):
    """The study's rows of PGS by step and sweeps."""
    names = {runs.name_of(setting): what for what, setting in runs.MODEL.items()}
    found, model = [], []
    for row in runs.read_study(options["results"])["rows"]:
        if not row["errors"]:
            continue
        setting, same = row["setting"], {"n_bodies": row["n_bodies"]}
        same["errors"] = {name: row["errors"][name] and row["errors"][name][0] for name in SHOWN}
        if row["name"] in names:
            model.append(same | {"what": names[row["name"]]})
        plain = setting.keys() == {"method", "sweeps", "dt"} and setting["method"] == "PGS"
        if plain and row["kind"] == "plain" and row["us"] is not None:
            timed = {"sweeps": setting["sweeps"], "us": row["us"]}
            found.append(same | timed | {"divisor": TIME_STEP / setting["dt"]})
    return {"rows": found, "model": model}


def line(data, n, divisor):
    """Rows of a size and a step, by sweeps."""
    rows = [row for row in data["rows"] if row["n_bodies"] == n and row["divisor"] == divisor]
    return sorted(rows, key=lambda row: row["sweeps"])


def parts(data, n, name):
    """Part -> what it adds to an error, in percent: few sweeps, the step, and what else the model may be.

    Few sweeps: the fewest with Δt over those that count as solved. The step: solved with Δt, over the smallest step.
    What the model changes is an error against the reference; of a depth it is the change of the depth.
    """
    few, solved = line(data, n, 1)[0], solved_with(data, n, 1)["errors"][name]
    limit = solved_with(data, n, DIVISORS[-1])["errors"][name] if name == ABSOLUTE else 0.0
    found = {f"{few['sweeps']} sweeps": max(0.0, few["errors"][name] - solved), STEP: max(0.0, solved - limit)}
    if name == ABSOLUTE:
        found[LEFT] = limit
    return found | {row["what"]: abs(row["errors"][name] - limit) for row in data["model"] if row["n_bodies"] == n}


def solved_with(data, n, divisor):
    """The row of a size and a step whose sweeps count as solved."""
    return next(row for row in line(data, n, divisor) if row["sweeps"] == SOLVED)


def claims(data):
    for n in runs.sizes_of(data["rows"]):
        solved = solved_with(data, n, 1)
        smaller = [row for row in data["rows"] if row["n_bodies"] == n and row["divisor"] > 1]
        cheaper = [row for row in smaller if row["us"] <= solved["us"]]
        best = min(cheaper, key=lambda row: row["errors"][ABSOLUTE])
        depths = [row["errors"][ABSOLUTE] for row in (solved, best)]
        measured = {"Δt, 20 sweeps, %": depths[0], "μs": solved["us"], "Δt /": best["divisor"]}
        measured |= {"sweeps": best["sweeps"], "%": depths[1], "its energy, %": best["errors"]["energy"]}
        text = f"for the price of 20 sweeps a smaller step halves the deepest penetration, {n} circles"
        yield Claim(text, None, depths[1] < 0.5 * depths[0], measured)


def table(data):
    rows = [["circles", "Δt /", "sweeps", "µs per 10 ms", *(f"{text}, %" for text in SHOWN.values())]]
    for n in runs.sizes_of(data["rows"]):
        for row in (row for divisor in DIVISORS for row in line(data, n, divisor)):
            rows.append([n, int(row["divisor"]), row["sweeps"], row["us"], *(row["errors"][name] for name in SHOWN)])
        for row in (row for row in data["model"] if row["n_bodies"] == n):
            rows.append([n, row["what"], None, None, *(row["errors"][name] for name in SHOWN)])
    return rows


def draw(data, options):
    """A row of panels for each size: a line for each step, along which sweeps grow; error by time; and the parts."""
    sizes = runs.sizes_of(data["rows"])
    figure, panels = plotting.subplots(len(sizes), len(SHOWN) + 1, size=(14.5, 3.2 * len(sizes)), squeeze=False)
    for row_of_panels, n in zip(panels, sizes):
        draw_parts(row_of_panels[-1], data, n)
        for ax, (name, text) in zip(row_of_panels, SHOWN.items()):
            for divisor, colour in zip(DIVISORS, COLOURS):
                rows = [row for row in line(data, n, divisor) if row["errors"][name]]
                if not rows:
                    continue
                points = [(row["us"], row["errors"][name]) for row in rows]
                label = "Δt = 10 ms" if divisor == 1 else f"Δt / {divisor}"
                ax.plot(*zip(*points), color=colour, marker="o", markersize=3.5, label=label)
                look = {"fontsize": 6, "xytext": (2, 3), "textcoords": "offset points", "color": colour}
                for end in (0, -1):
                    ax.annotate(str(rows[end]["sweeps"]), points[end], **look)
            plotting.label_axes(ax, "wall time of 10 ms", text, x_unit="µs", y_unit="%", title=f"{n:,} circles")
            plotting.log_axes(ax)
    panels[0, 0].legend(fontsize=7, title="numbers: sweeps", title_fontsize=6)
    return figure


def draw_parts(ax, data, n):
    """Bars: what each part adds to each of the errors."""
    for k, name in enumerate(SHOWN):
        for i, (part, value) in enumerate(parts(data, n, name).items()):
            colour = PARTS.get(part, plotting.VERMILION)
            ax.barh(k + 0.15 * (i - 2), value, 0.14, color=colour, label=part if name == ABSOLUTE else None)
    ax.set_yticks(range(len(SHOWN)), list(SHOWN.values()))
    ax.invert_yaxis()
    plotting.label_axes(ax, "part of the error", None, x_unit="%", title=f"{n:,} circles, by part")
    ax.legend(fontsize=6)


OPTIONS = {"results": "data/reference/run_tradeoff.json"}
FIGURE = Figure("6.11", "Where the next microsecond goes: more sweeps, or a smaller step", compute, table, draw, claims,
                options=OPTIONS)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
