"""python scripts/figure_6_5_cost.py: what the presets cost by number of circles, in impact and at rest, and rivals."""

import numpy as np

from deep_contact.presets import PRESETS
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import runs


def compute(options, seed, jobs, progress):
    """The presets of the study on plain piles."""
    found = runs.read_study(options["results"])["presets"]
    return {
        "presets": [
            {"n_bodies": row["n_bodies"], "preset": row["preset"], "ours": row["kinds"]["plain"], "peers": row["peers"]}
            for row in found
        ]
    }


def rows_of(data, preset):
    """The rows of a preset by size, those without a setting of ours left out."""
    rows = [row for row in data["presets"] if row["preset"] == preset and row["ours"]]
    return sorted(rows, key=lambda row: row["n_bodies"])


def fastest_rival(row, phase="us"):
    """(Engine, time) of the other engine that keeps the preset soonest, or None."""
    found = [(peer["us"], name, peer[phase]) for name, peer in row["peers"].items() if peer]
    return min(found)[1:] if found else None


def claims(data):
    powers = {}
    for preset in PRESETS:
        large = [(row["n_bodies"], row["ours"]["us"]) for row in rows_of(data, preset) if row["n_bodies"] >= 1000]
        if len(large) > 1:
            powers[preset] = float(np.polyfit(*np.log(large).T, 1)[0])
    if powers:
        text = "a preset's cost grows with circles to the power of at most 1.15, from 1,000 circles on"
        yield Claim(text, None, max(powers.values()) <= 1.15, powers)
    for phase in ("impact", "rest"):
        ratios = {
            f"{row['preset']}, {row['n_bodies']}": rival[1] / row["ours"][phase]
            for row in data["presets"]
            if row["ours"] and (rival := fastest_rival(row, phase))
        }
        if ratios:
            text = f"no preset is dearer than with the fastest rival, {phase}"
            yield Claim(text, None, min(ratios.values()) >= 1, ratios)


def table(data):
    head = ["circles", "preset", "setting", "impact, µs", "run, µs", "rest, µs"]
    rows = [[*head, "fastest rival", "impact, µs", "run, µs", "rest, µs"]]
    for row in data["presets"]:
        ours, rival = row["ours"], fastest_rival(row)
        theirs = row["peers"][rival[0]] if rival else None
        cells = [row["n_bodies"], row["preset"]]
        for cost in (ours, theirs):
            cells += [cost["name"], cost["impact"], cost["us"], cost["rest"]] if cost else [None] * 4
        rows.append(cells)
    return rows


def draw(data, options):
    """Left: the cost of each preset by size. Right: that of the fastest rival for the same tolerances, over ours."""
    figure, (left, right) = plotting.subplots(1, 2, size=(plotting.PAGE, 3.8))
    for preset, colour in zip(PRESETS, plotting.shades(len(PRESETS))):
        rows = rows_of(data, preset)
        us = [row["ours"]["us"] for row in rows]
        left.plot([row["n_bodies"] for row in rows], us, color=colour, marker="o", markersize=4, label=preset)
        rivals = [(row["n_bodies"], *rival, row["ours"]["us"]) for row in rows if (rival := fastest_rival(row))]
        right.plot([n for n, *_ in rivals], [us / ours for *_, us, ours in rivals], color=colour)
        for n, engine, us, ours in rivals:
            right.plot(n, us / ours, plotting.ENGINE_MARKER[engine], color=colour, markersize=5)
    for engine, marker in plotting.ENGINE_MARKER.items():
        left.plot([], [], marker, color=plotting.GREY, markersize=5, label=engine)
    right.axhline(1, color=plotting.GREY, linewidth=0.8, linestyle=":")
    for ax in (left, right):
        plotting.log_axes(ax)
    plotting.label_axes(left, "circles", "time of 10 ms", y_unit="µs", title="What does a preset cost?")
    plotting.label_axes(right, "circles", "times as long as ours", title="And with the fastest rival?")
    return plotting.legend_below(figure, left)


FIGURE = Figure("6.5", "What the presets cost, from 100 circles to 10,000", compute, table, draw, claims,
                options=runs.RESULTS)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
