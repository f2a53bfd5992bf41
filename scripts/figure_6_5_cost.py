"""python scripts/figure_6_5_cost.py: what the presets cost by number of circles, in impact and at rest, and rivals."""

import numpy as np

from deep_contact.presets import PRESETS
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import runs

COLOURS = dict(zip(PRESETS, (plotting.SKY, plotting.GREEN, plotting.BLUE, plotting.ORANGE, plotting.VERMILION)))
MARKERS = {"Box2D 2.3": "s", "pymunk": "^", "Box2D v3": "D"}


def compute(options, seed, jobs, progress):
    """The presets of the study."""
    return {"presets": runs.read_study(options["results"])["presets"]}


def rows_of(data, preset):
    """The rows of a preset by size, those without a setting of ours left out."""
    rows = [row for row in data["presets"] if row["preset"] == preset and row["ours_plain"]]
    return sorted(rows, key=lambda row: row["n_bodies"])


def presets_of(data):
    """Preset -> colour, of those in the data."""
    return {name: COLOURS[name] for name in dict.fromkeys(row["preset"] for row in data["presets"])}


def fastest_rival(row, phase="us"):
    """(Engine, time) of the other engine that keeps the preset soonest, or None."""
    found = [(peer["us"], name, peer[phase]) for name, peer in row["peers"].items() if peer]
    return min(found)[1:] if found else None


def claims(data):
    powers = {}
    for preset in presets_of(data):
        large = [(row["n_bodies"], row["ours_plain"]["us"]) for row in rows_of(data, preset) if row["n_bodies"] >= 1000]
        if len(large) > 1:
            powers[preset] = float(np.polyfit(*np.log(large).T, 1)[0])
    if powers:
        text = "a preset's cost grows with circles to the power of at most 1.15, from 1,000 circles on"
        yield Claim(text, None, max(powers.values()) <= 1.15, powers)
    for phase in ("impact", "rest"):
        ratios = {
            f"{row['preset']}, {row['n_bodies']}": rival[1] / row["ours_plain"][phase]
            for row in data["presets"]
            if row["ours_plain"] and (rival := fastest_rival(row, phase))
        }
        if ratios:
            text = f"no preset is dearer than with the fastest rival, {phase}"
            yield Claim(text, None, min(ratios.values()) >= 1, ratios)


def table(data):
    head = ["circles", "preset", "setting", "impact, µs", "run, µs", "rest, µs"]
    rows = [[*head, "fastest rival", "impact, µs", "run, µs", "rest, µs"]]
    for row in data["presets"]:
        ours, rival = row["ours_plain"], fastest_rival(row)
        theirs = row["peers"][rival[0]] if rival else None
        cells = [row["n_bodies"], row["preset"]]
        for cost in (ours, theirs):
            cells += [cost["name"], cost["impact"], cost["us"], cost["rest"]] if cost else [None] * 4
        rows.append(cells)
    return rows


def draw(data, options):
    """Cost by size, with the fastest rival's; in impact and at rest, by that of a run; rival's by ours."""
    figure, (left, middle, right) = plotting.subplots(1, 3, size=(13.5, 4.4))
    drawn = set()
    for preset, colour in presets_of(data).items():
        rows, look = rows_of(data, preset), {"color": colour, "marker": "o", "markersize": 4}
        sizes = [row["n_bodies"] for row in rows]
        left.plot(sizes, [row["ours_plain"]["us"] for row in rows], label=preset, **look)
        for phase, line in (("impact", "--"), ("rest", "-")):
            ratios = [row["ours_plain"][phase] / row["ours_plain"]["us"] for row in rows]
            middle.plot(sizes, ratios, linestyle=line, **look)
        against = [(row["n_bodies"], *rival, row["ours_plain"]["us"]) for row in rows if (rival := fastest_rival(row))]
        for n, engine, us, ours in against:
            look = {"color": colour, "marker": MARKERS[engine], "linestyle": ""}
            label = None if engine in drawn else f"fastest rival: {engine}"
            drawn.add(engine)
            left.plot([n], [us], markerfacecolor="none", label=label, **look)
            right.plot([n], [us / ours], **look)
        right.plot([row[0] for row in against], [row[2] / row[3] for row in against], color=colour)
    middle.plot([], [], color=plotting.GREY, linestyle="--", label="impact")
    middle.plot([], [], color=plotting.GREY, label="rest")
    for ax in (middle, right):
        ax.axhline(1, color=plotting.GREY, linewidth=0.6)
        ax.set_ylim(0, 1.15 * ax.get_ylim()[1])
        ax.set_xscale("log")
    plotting.label_axes(left, "circles", "wall time of 10 ms", y_unit="µs", title="Runs of 6 s")
    plotting.label_axes(middle, "circles", "cost by that of a run", title="Impact and rest")
    plotting.label_axes(right, "circles", "fastest rival's cost by ours", title="For the same tolerances")
    plotting.log_axes(left)
    left.legend(fontsize=7)
    middle.legend(fontsize=8)
    return figure


OPTIONS = {"results": "data/reference/run_tradeoff.json"}
FIGURE = Figure("6.5", "What the presets cost, from 100 circles to 10,000", compute, table, draw, claims,
                options=OPTIONS)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
