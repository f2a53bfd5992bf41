"""python scripts/figure_6_6_stability.py: how far each quantity can be pushed, in our engine and in two others."""

from itertools import groupby, product

import numpy as np

from deep_contact import figures, parallel
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.state.validation import one_of
from deep_contact.studies import extremes
from deep_contact.studies.extremes import ABSENT, DEGRADED, ENGINES, FAILED, QUANTITIES, REFUSED, SAFE

ROUNDING = 1e-9
"""Rise of the energy that rounding may cause, as a share of its initial value."""
MILD_START = 1e12
"""Largest misleading start, in weights, whose rounding errors stay below `ROUNDING`."""


def compute(options, seed, jobs, progress):
    """Every value of every quantity, or every other value if "few", in every engine that has the quantity."""
    cases, units = [], {}
    for name in options["quantities"]:
        units[name], values, _ = QUANTITIES[one_of("quantities", name, QUANTITIES)]
        cells = product(values[:: 1 + options["few"]], ENGINES[:1] if name in extremes.OURS_ALONE else ENGINES)
        cases += [{"quantity": name, "value": v, "engine": engine, "steps": options["steps"]} for v, engine in cells]
    cells = parallel.parallel_map(extremes.run_case, cases, jobs=jobs, progress=progress, text="scenes")
    return {"units": units, "cells": cells}


def unearned(cell):
    """Rise of the energy beyond the work of position correction, as a share of its initial value."""
    return cell["energy"] - (cell["correction"] or 0.0)


def claims(data):
    mine = [cell for cell in data["cells"] if cell["engine"] == "ours"]
    accepted = [cell for cell in mine if cell["verdict"] != REFUSED]
    not_finite = sum(not cell["finite"] for cell in accepted)
    text = "no accepted scene ends in a number that is not finite"
    yield Claim(text, None, not not_finite, {"scenes": len(accepted), "not finite": not_finite})
    refusals = [cell["message"] for cell in mine if cell["verdict"] == REFUSED]
    explained = all("expected" in message and "got" in message for message in refusals)
    text = "every refusal names the quantity, its limits and the value"
    yield Claim(text, None, explained, {"refused": len(refusals)})
    inelastic = [cell for cell in accepted if cell["quantity"] != "restitution" or cell["value"] == 0]
    mild = [c for c in inelastic if not c["quantity"].startswith("start") or c["value"] <= MILD_START]
    if mild:
        worst = max(mild, key=unearned)
        measured = {"scenes": len(mild), "largest rise": unearned(worst), "of": worst["quantity"]}
        text = f"with e = 0 the energy never rises by more than {ROUNDING:g} and the work of position correction"
        yield Claim(text, None, unearned(worst) <= ROUNDING, {**measured, "at": worst["value"]})
    if speeds := [cell["speed"] for cell in accepted if cell["quantity"] in ("overlap", "coinciding circles")]:
        text = "circles that overlap, up to the whole diameter, are parted without giving them any speed"
        yield Claim(text, None, max(speeds) == 0.0, {"largest speed (m/s)": max(speeds)})


def by_quantity(data):
    """quantity -> engine -> its cells, by rising value; no cells for an engine without the quantity."""
    grouped = {name: {engine: [] for engine in ENGINES} for name in data["units"]}
    for cell in sorted(data["cells"], key=lambda cell: cell["value"]):
        grouped[cell["quantity"]][cell["engine"]].append(cell)
    return grouped


def ranges(cells, verdict):
    """The values that got the verdict, as text: "1 to 100; 1e+06"."""
    runs = [list(group) for said, group in groupby(cells, key=lambda cell: cell["verdict"]) if said == verdict]
    ends = [[f"{cell['value']:g}" for cell in (run[0], run[-1])] for run in runs]
    return "; ".join(low if low == high else f"{low} to {high}" for low, high in ends) or None


def spread(cells, key):
    """[least, median, largest] of a number over the scenes that were run to the end; None without such a scene."""
    kept = [cell[key] for cell in cells if cell["verdict"] in (SAFE, DEGRADED) and cell[key] is not None]
    return [float(value) for value in np.percentile(kept, (0, 50, 100))] if kept else None


def table(data):
    verdicts = (SAFE, DEGRADED, FAILED, REFUSED)
    rows = [["quantity", "unit", *(f"ours: {v}" for v in verdicts), *(f"{engine}: safe" for engine in ENGINES[1:])]]
    for name, engines in by_quantity(data).items():
        mine, *others = engines.values()
        row = [ranges(mine, verdict) for verdict in verdicts] + [ranges(cells, SAFE) for cells in others]
        rows.append([name, data["units"][name], *row])
    return rows


COLOURS = {SAFE: plotting.GREEN, DEGRADED: plotting.YELLOW, FAILED: plotting.VERMILION, REFUSED: "#BBBBBB"}
LOOKS = {"ours": (plotting.BLUE, "o")} | {name: (plotting.GREY, plotting.ENGINE_MARKER[name]) for name in ENGINES[1:]}


def draw(data, options):
    """Left: which of the pushed values are safe, from the least to the largest, ours above the others. Middle and
    right: depth at rest and time of a step, median and range over the values that were run to the end.
    """
    from matplotlib.patches import Patch

    grouped = by_quantity(data)
    size = (plotting.PAGE, 1.4 + 0.36 * len(grouped))
    figure, (left, middle, right) = plotting.subplots(1, 3, size=size, sharey=True, width_ratios=(1.3, 1, 1))
    for (row, engines), (stripe, engine) in product(enumerate(grouped.values()), enumerate(ENGINES)):
        cells, y, (colour, marker) = engines[engine], row + 0.25 * (stripe - 1), LOOKS[engine]
        for i, cell in enumerate(cells):
            if cell["verdict"] != ABSENT:
                left.barh(y, 1 / len(cells), 0.21, i / len(cells), color=COLOURS[cell["verdict"]])
        for ax, key in ((middle, "settled"), (right, "us")):
            if of := spread(cells, key):
                low, value, high = np.maximum(of, 0.01)
                ax.plot([low, high], [y, y], color=colour, linewidth=0.8)
                ax.plot(value, y, marker, color=colour, markersize=3.5)
    ends = ((of["ours"][0]["value"], of["ours"][-1]["value"]) for of in grouped.values())
    names = (f"{name}, {data['units'][name]}".rstrip(", ") for name in grouped)
    left.set_yticks(range(len(grouped)), [f"{name}\n{low:g} to {high:g}" for name, (low, high) in zip(names, ends)])
    left.set(ylim=(len(grouped) - 0.5, -0.5), xlim=(0, 1), title="Is it safe? (ours above)")
    left.set_xticks([0, 1], ["least", "largest"])
    left.set_xlabel("values tried, in order:\nbeside each name")
    middle.axvline(3, color=plotting.BLACK, linewidth=0.8, linestyle=":")
    for ax in (left, middle, right):
        ax.grid(False, axis="y")
        ax.tick_params(axis="y", length=0)
    middle.set(xscale="log", xlabel="slops (dotted: 3 are safe)", title="How deep at rest?")
    right.set(xscale="log", xlabel="time of a step (µs)", title="At which cost?")
    handles = [Patch(color=colour, label=verdict) for verdict, colour in COLOURS.items()]
    for name, (colour, marker) in LOOKS.items():
        handles += middle.plot([], [], color=colour, marker=marker, markersize=3.5, linewidth=0.8, label=name)
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


OPTIONS = {"quantities": list(QUANTITIES), "few": False, "steps": 400}
QUICK = {"quantities": ["mass", "radius ratio", "speed", "overlap", "sweeps"], "few": True, "steps": 100}
FIGURE = Figure("6.6", "Stability at the extremes: what is safe, degraded, failed and refused", compute, table, draw,
                claims, options=OPTIONS, quick=QUICK)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
