"""python scripts/figure_6_6_stability.py: how far each quantity can be pushed, in our engine and in two others."""

from collections import defaultdict
from functools import partial

from deep_contact.constants import LINEAR_SLOP
from deep_contact.physics.solvers import PGS
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import extremes
from deep_contact.studies.extremes import ABSENT, ACCURATE, DEGRADED, ENGINES, FAILED, REFUSED, SAFE

ROUNDING = 1e-9
"""Rise of the energy that rounding may cause, as a share of its initial value."""
MILD_START = 1e12
"""Largest misleading start, in weights, whose rounding errors stay below `ROUNDING`."""

TEN = PGS(sweeps=10, tolerance=None)
SILOS = {
    "straight, 10 sweeps": (extremes.silo, {}, TEN),
    "leaning, 10 sweeps": (extremes.leaning_silo, {}, TEN),
    "straight, 1000:1 on top, 10 sweeps": (extremes.loaded_silo, {"ratio": 1000.0}, TEN),
    "straight, 1000:1 on top, most accurate": (extremes.loaded_silo, {"ratio": 1000.0}, ACCURATE),
}

RESTING = {
    "straight, 10 sweeps": "one circle wide at 10 sweeps",
    "leaning, 10 sweeps": "in which it leans from wall to wall at 10 sweeps",
    "straight, 1000:1 on top, most accurate": "with 1000 times its mass on top, most accurately solved,",
}
"""Those of `SILOS` that have to come to rest -> their words in a claim."""


def compute(options, seed, jobs, progress):
    """Every value of every quantity in every engine; columns in a silo that have to rest; every method and start."""
    parallel_map = partial(figures.parallel_map, jobs=jobs, progress=progress)
    cases = extremes.cases(options["quantities"], quick=options["few"], steps=options["steps"])
    cells = [
        {"quantity": case["quantity"], "value": float(case["value"]), "engine": case["engine"], **outcome}
        for case, outcome in zip(cases, parallel_map(extremes.run_case, cases, text="scenes"))
    ]
    silos = {}
    for name, (make, arguments, solver) in SILOS.items():
        # Another engine would take an hour for the most accurate setting.
        engines = ENGINES if solver is not ACCURATE else ENGINES[:1]
        stand = partial(extremes.stand, make(options["silo"], **arguments), solver=solver, seconds=options["seconds"])
        silos[name] = {engine: stand(engine) for engine in engines}
    units = {name: extremes.QUANTITIES[name].unit for name in options["quantities"]}
    solvers = parallel_map(extremes.run_solver, options["solvers"], text="methods and starts")
    return {"units": units, "cells": cells, "silos": silos, "solvers": solvers}


def cells_of(data):
    """The cells of quantities that are still pushed."""
    return [cell for cell in data["cells"] if cell["quantity"] in extremes.QUANTITIES]


def solvers_of(data):
    """The outcomes of methods and starts that are still there."""
    return [outcome for outcome in data["solvers"] if outcome["name"] in extremes.SOLVERS]


def unearned(cell):
    """Rise of the energy beyond the work of position correction, as a share of its initial value."""
    return cell["energy"] - (cell["correction"] or 0.0)


def is_inelastic(cell):
    """Whether a cell has e = 0, and a start that the sweeps can correct in spite of rounding."""
    if cell["quantity"].startswith("start"):
        return cell["value"] <= MILD_START
    return cell["quantity"] != "restitution" or cell["value"] == 0


def claims(data):
    mine = [cell for cell in cells_of(data) if cell["engine"] == "ours"]
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
    tried = {solver["name"]: solver["verdict"] for solver in solvers_of(data) if solver["verdict"] != ABSENT}
    if tried:
        # θ is the last change and no error: after a start ten times too large it stops far from the solution.
        unsafe = [f"{name}: {found}" for name, found in tried.items() if found != SAFE and name != "start bad"]
        text = "a falling pile is safe with every method in both precisions, and from every start that is not"
        yield Claim(f"{text} misleading", None, not unsafe, {"tried": len(tried), "not safe": unsafe or "none"})
    for name, what in RESTING.items():
        silo = data["silos"][name]["ours"]
        depth, speed = silo["settled"] / LINEAR_SLOP, silo["speed"][-1]
        text = f"a column in a silo {what} rests, its penetration below 2 slops"
        yield Claim(text, None, depth < 2.0 and speed < 1e-3, {"slops": depth, "speed (m/s)": speed})


def by_quantity(data):
    """quantity -> engine -> its cells."""
    found = defaultdict(lambda: defaultdict(list))
    for cell in cells_of(data):
        found[cell["quantity"]][cell["engine"]].append(cell)
    return found


def ranges(cells, verdict):
    """The values that got the verdict, as text: "1 to 100; 1e+06"."""
    spans = extremes.spans([cell["value"] for cell in cells], [cell["verdict"] for cell in cells])
    texts = [f"{low:g}" if low == high else f"{low:g} to {high:g}" for found, low, high in spans if found == verdict]
    return "; ".join(texts) or None


def table(data):
    verdicts = (SAFE, DEGRADED, FAILED, REFUSED)
    rows = [["quantity", "unit", *(f"ours: {v}" for v in verdicts), "worst (slops)", "back after (steps)"]]
    rows[0] += [f"{engine}: safe" for engine in ENGINES[1:]]
    for name, engines in by_quantity(data).items():
        mine = engines["ours"]
        good = [cell for cell in mine if cell["verdict"] == SAFE]
        worst = max((cell["worst"] / cell["slop"] for cell in good), default=None)
        recovered = max((cell["recovered"] for cell in good if cell["recovered"] is not None), default=None)
        peers = [ranges(engines[engine], SAFE) for engine in ENGINES[1:]]
        rows.append([name, data["units"][name], *(ranges(mine, v) for v in verdicts), worst, recovered, *peers])
    for name, engines in data["silos"].items():
        settled = {e: found["settled"] / LINEAR_SLOP for e, found in engines.items() if "settled" in found}
        text = "; ".join(f"{engine} {depth:.3g}" for engine, depth in settled.items())
        rows.append([f"silo: {name}", "slops at rest", text, *[None] * 7])
    for solver in solvers_of(data):
        names = [solver["name"] if solver["verdict"] == v else None for v in verdicts]
        worst = solver["worst"] and solver["worst"] / LINEAR_SLOP
        rows.append(["pile", "", *names, worst, solver["recovered"], None, None])
    return rows


LOOKS = {
    SAFE: (plotting.GREEN, ""),
    DEGRADED: (plotting.YELLOW, "d"),
    FAILED: (plotting.VERMILION, "F"),
    REFUSED: (plotting.GREY, "R"),
    ABSENT: ("white", "–"),
}


def draw(data, options):
    """A row per quantity, a stripe per engine, a cell per value; colour and letter show the verdict."""
    from matplotlib.patches import Patch, Rectangle

    grouped = by_quantity(data)
    most = max(len(engines["ours"]) for engines in grouped.values())
    figure, ax = plotting.subplots(size=(3.6 + 0.52 * most, 1.2 + 0.62 * len(grouped)))
    for row, engines in enumerate(grouped.values()):
        for stripe, engine in enumerate(ENGINES):
            for column, cell in enumerate(sorted(engines.get(engine, []), key=lambda cell: cell["value"])):
                colour, letter = LOOKS[cell["verdict"]]
                low = row + 0.30 + 0.21 * stripe
                ax.add_patch(Rectangle((column, low), 0.94, 0.19, facecolor=colour, edgecolor="none"))
                ax.text(column + 0.47, low + 0.1, letter, ha="center", va="center", fontsize=6)
                if stripe == 0:
                    ax.text(column + 0.47, row + 0.17, f"{cell['value']:g}", ha="center", va="center", fontsize=6.5)
            if engine in engines:
                ax.text(-0.1, row + 0.40 + 0.21 * stripe, engine, ha="right", va="center", fontsize=5.5)
    labels = [f"{name} ({data['units'][name]})" if data["units"][name] else name for name in grouped]
    ax.set_yticks([row + 0.5 for row in range(len(grouped))], labels)
    ax.tick_params(axis="y", length=0, pad=44)
    ax.set(xticks=[], xlim=(-0.2, most), ylim=(len(grouped), 0))
    ax.grid(False)
    ax.spines[["left", "bottom"]].set_visible(False)
    handles = [
        Patch(facecolor=colour, edgecolor=plotting.GREY, label=f"{verdict} ({letter})" if letter else verdict)
        for verdict, (colour, letter) in list(LOOKS.items())[:4]  # those that an engine can get
    ]
    ax.legend(handles=handles, loc="lower right", ncols=4, bbox_to_anchor=(1.0, 1.0), fontsize=8)
    return figure


OPTIONS = {
    "quantities": list(extremes.QUANTITIES), "solvers": list(extremes.SOLVERS), "few": False, "steps": 1000,
    "silo": 50, "seconds": 60,
}  # fmt: skip
FIGURE = Figure("6.6", "Stability at the extremes: what is safe, degraded, failed and refused", compute, table, draw,
                claims, options=OPTIONS, quick={"few": True, "steps": 300})  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
