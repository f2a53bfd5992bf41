"""python scripts/figure_6_6_stability.py: how far each quantity can be pushed, in our engine and in two others."""

from functools import partial
from itertools import product

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import extremes
from deep_contact.studies.extremes import ABSENT, DEGRADED, ENGINES, FAILED, REFUSED, SAFE, SILOS

ROUNDING = 1e-9
"""Rise of the energy that rounding may cause, as a share of its initial value."""
MILD_START = 1e12
"""Largest misleading start, in weights, whose rounding errors stay below `ROUNDING`."""

SLOW = "straight, 1000:1 on top, most accurate"
"""Of `SILOS`, the one that other engines would take an hour for."""

RESTING = {
    "straight, 10 sweeps": "one circle wide at 10 sweeps",
    "leaning, 10 sweeps": "in which it leans from wall to wall at 10 sweeps",
    SLOW: "with 1000 times its mass on top, most accurately solved,",
}
"""Those of `SILOS` that have to come to rest -> their words in a claim."""


def compute(options, seed, jobs, progress):
    """Every value of every quantity in every engine; columns in a silo that have to rest; every method and start."""
    run = partial(figures.parallel_map, jobs=jobs, progress=progress)
    cases = extremes.cases(options["quantities"], quick=options["few"], steps=options["steps"])
    cells = [
        {"quantity": case["quantity"], "value": float(case["value"]), "engine": case["engine"], **outcome}
        for case, outcome in zip(cases, run(extremes.run_case, cases, text="scenes"))
    ]
    silos = {name: {} for name in SILOS}
    columns = [pair for pair in product(SILOS, ENGINES) if pair[0] != SLOW or pair[1] == "ours"]
    stand = partial(extremes.stand, options["silo"], 100 * options["seconds"])
    for (name, engine), stood in zip(columns, run(stand, columns, text="columns")):
        silos[name][engine] = stood
    units = {name: extremes.QUANTITIES[name].unit for name in options["quantities"]}
    solvers = run(extremes.run_solver, options["solvers"], text="methods and starts")
    return {"units": units, "cells": cells, "silos": silos, "solvers": solvers}


def unearned(cell):
    """Rise of the energy beyond the work of position correction, as a share of its initial value."""
    return cell["energy"] - (cell["correction"] or 0.0)


def is_inelastic(cell):
    """Whether a cell has e = 0, and a start that the sweeps can correct in spite of rounding."""
    if cell["quantity"].startswith("start"):
        return cell["value"] <= MILD_START
    return cell["quantity"] != "restitution" or cell["value"] == 0


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
    inelastic = [cell for cell in accepted if is_inelastic(cell)]
    if inelastic:
        worst = max(inelastic, key=unearned)
        measured = {"scenes": len(inelastic), "largest rise": unearned(worst), "of": worst["quantity"]}
        text = f"with e = 0 the energy never rises by more than {ROUNDING:g} and the work of position correction"
        yield Claim(text, None, unearned(worst) <= ROUNDING, {**measured, "at": worst["value"]})
    speeds = [cell["speed"] for cell in accepted if cell["quantity"] in ("overlap", "coinciding circles")]
    if speeds:
        text = "circles that overlap, up to the whole diameter, are parted without giving them any speed"
        yield Claim(text, None, max(speeds) == 0.0, {"largest speed (m/s)": max(speeds)})
    tried = {solver["name"]: solver["verdict"] for solver in data["solvers"] if solver["verdict"] != ABSENT}
    if tried:
        # θ is the last change and no error: after a start ten times too large it stops far from the solution.
        unsafe = [f"{name}: {found}" for name, found in tried.items() if found != SAFE and name != "start bad"]
        text = "a falling pile is safe with every method in both precisions, and from every start that is not"
        yield Claim(f"{text} misleading", None, not unsafe, {"tried": len(tried), "not safe": unsafe or "none"})
    for name, what in RESTING.items():
        depth, speed = (data["silos"][name]["ours"][key] for key in ("settled", "speed"))
        text = f"a column in a silo {what} rests, its penetration below 2 slops"
        yield Claim(text, None, depth < 2.0 and speed < 1e-3, {"slops": depth, "speed (m/s)": speed})


def by_quantity(data):
    """quantity -> engine -> its cells, by rising value."""
    found = {}
    for cell in sorted(data["cells"], key=lambda cell: cell["value"]):
        found.setdefault(cell["quantity"], {}).setdefault(cell["engine"], []).append(cell)
    return {name: found[name] for name in data["units"] if name in found}


def ranges(cells, verdict):
    """The values that got the verdict, as text: "1 to 100; 1e+06"."""
    spans = extremes.spans([cell["value"] for cell in cells], [cell["verdict"] for cell in cells])
    texts = [f"{low:g}" if low == high else f"{low:g} to {high:g}" for found, low, high in spans if found == verdict]
    return "; ".join(texts) or None


def spread(cells, key):
    """[least, median, largest] of a number over the scenes that were run to the end; None where there are none."""
    kept = [cell[key] for cell in cells if cell["verdict"] in (SAFE, DEGRADED) and cell[key] is not None]
    return [float(value) for value in np.percentile(kept, (0, 50, 100))] if kept else None


def table(data):
    verdicts = (SAFE, DEGRADED, FAILED, REFUSED)
    rows = [["quantity", "unit", *(f"ours: {v}" for v in verdicts), *(f"{engine}: safe" for engine in ENGINES[1:])]]
    rows[0] += [f"{engine}: {what}" for what in ("slops at rest", "µs a step") for engine in ENGINES]
    for name, engines in by_quantity(data).items():
        safe = [ranges(engines.get(engine, []), SAFE) for engine in ENGINES[1:]]
        medians = [
            of and of[1] for key in ("settled", "us") for of in (spread(engines.get(e, []), key) for e in ENGINES)
        ]
        rows.append([name, data["units"][name], *(ranges(engines["ours"], v) for v in verdicts), *safe, *medians])
    for name, engines in data["silos"].items():
        numbers = [engines.get(engine, {}).get(key) for key in ("settled", "us") for engine in ENGINES]
        rows.append([f"silo: {name}", *[None] * 7, *numbers])
    for solver in data["solvers"]:
        names = [solver["name"] if solver["verdict"] == v else None for v in verdicts]
        rows.append(["pile", "", *names, None, None, solver["settled"], None, None, solver["us"], None, None])
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
        cells, y, (colour, marker) = engines.get(engine, []), row + 0.25 * (stripe - 1), LOOKS[engine]
        for i, cell in enumerate(cells):
            if cell["verdict"] != ABSENT:
                left.barh(y, 1 / len(cells), 0.21, i / len(cells), color=COLOURS[cell["verdict"]])
        for ax, key in ((middle, "settled"), (right, "us")):
            if of := spread(cells, key):
                low, value, high = np.maximum(of, 0.01)
                ax.plot([low, high], [y, y], color=colour, linewidth=0.8)
                ax.plot(value, y, marker, color=colour, markersize=3.5)
    left.set_yticks(range(len(grouped)), [f"{name}, {data['units'][name]}".rstrip(", ") for name in grouped])
    left.set(ylim=(len(grouped) - 0.5, -0.5), xlim=(0, 1), xticks=[0.02, 0.98])
    left.set_xticklabels(["least value", "largest"])
    middle.axvline(3, color=plotting.GREEN, linewidth=0.8)
    for ax in (middle, right):
        ax.set_xscale("log")
    for ax in (left, middle, right):
        ax.grid(False, axis="y")
        ax.tick_params(axis="y", length=0)
    left.set_title("Is it safe? (ours above)")
    plotting.label_axes(middle, "slops (3 are safe)", "", title="How deep at rest?")
    plotting.label_axes(right, "time of a step", "", x_unit="µs", title="At which cost?")
    handles = [Patch(color=colour, label=verdict) for verdict, colour in COLOURS.items()]
    for name, (colour, marker) in LOOKS.items():
        handles += middle.plot([], [], color=colour, marker=marker, markersize=3.5, linewidth=0.8, label=name)
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


OPTIONS = {
    "quantities": list(extremes.QUANTITIES), "solvers": list(extremes.SOLVERS), "few": False, "steps": 400,
    "silo": 50, "seconds": 60,
}  # fmt: skip
QUICK = {
    "quantities": ["mass", "radius ratio", "speed", "overlap", "sweeps"], "few": True,
    "solvers": ["method NNCG, single", "start sph"], "steps": 100, "silo": 20, "seconds": 10,
}  # fmt: skip
FIGURE = Figure("6.6", "Stability at the extremes: what is safe, degraded, failed and refused", compute, table, draw,
                claims, options=OPTIONS, quick=QUICK)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
