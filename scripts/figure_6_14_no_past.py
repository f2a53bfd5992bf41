"""python scripts/figure_6_14_no_past.py: the first step of a pile without impulses, by what it starts from."""

from collections.abc import Mapping
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from deep_contact import parallel
from deep_contact.io.provenance import commit
from deep_contact.physics.solvers import NNCG
from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.simulation import simulate, solve_contacts
from deep_contact.state import StateWithContacts
from deep_contact.studies import piles, timing
from deep_contact.studies.learned_starts import (
    BASE,
    errors_of,
    fixed,
    from_rows,
    median_with_interval,
    settings_with,
    sweep_times,
    text_of,
)
from deep_contact.studies.parts import done
from deep_contact.warm_start import LearnedSupport, Support

METHODS = ("PSOR 1.5", BASE, "NNCG", "NesterovPGS")

REFERENCE_SWEEPS = 20_000
"""Of the solves that errors are measured against, at most."""

LEARNED = "learned support"


def case(n_bodies: int, kind: str, smallest: float, seed: int) -> tuple[StateWithContacts, list, StateWithContacts]:
    """(State whose contacts carry no impulses, solutions of its step, the state as it was, with its impulses).

    kind: of `piles.KINDS`. smallest: least radius, m; the largest is 1 m.
    """
    make = partial(piles.packed_pile, steps=50, smallest=smallest)
    past = piles.pile(kind, n_bodies, seed, solver=piles.SETTLE, make=make)
    state, tolerance = piles.without_past(past), 1e-9 * float(past.bodies.mass.mean())
    ends = [solve_contacts(past, solver=NNCG(sweeps=REFERENCE_SWEEPS, tolerance=tolerance))]
    start = Support()(state, None)
    for name in ("PSOR 1.5", "NesterovPGS"):
        ends.append(solve_contacts(state, solver=fixed(name, REFERENCE_SWEEPS // 4), start=start))
    return state, piles.references_from(state, ends, exact=False) or ends[:1], past


def starts_of(state: StateWithContacts, model: str) -> dict:
    """Start -> what makes its impulses, from rows that have been built, as a run has them."""
    nothing = np.zeros(state.contacts.count)
    ours = {"support": Support(), LEARNED: LearnedSupport(model)}
    return {"zero": lambda: (nothing, nothing)} | {name: from_rows(start, state) for name, start in ours.items()}


def measure(n_bodies: int, kind: str, radii: str, seed: int, options: Mapping, **_) -> dict:
    """What the starts of one pile lead to. options: "radii": name -> smallest, "sweeps", "model", "first": of `jolt`.

    Returns "contacts", "errors": method -> start -> velocity errors "after" so many sweeps, and "jolt": of a run from
    each start, of the run that `simulate` makes of the state, and of that from its past.
    """
    state, references, past = case(n_bodies, kind, options["radii"][radii], seed)
    impulses = {name: make() for name, make in starts_of(state, options["model"]).items()}
    errors = errors_of(state, impulses, settings_with(impulses, METHODS), options["sweeps"], references)
    errors = {method: {name: errors[f"{name}, {method}"] for name in impulses} for method in METHODS}
    jolts = {name: jolt(state, start, options["first"][name]) for name, start in impulses.items()}
    jolts |= {"simulate": jolt(state), "past": jolt(past)}
    about = {"n_bodies": n_bodies, "kind": kind, "radii": radii, "seed": seed, "after": options["sweeps"]}
    return about | {"contacts": state.contacts.count, "errors": errors, "jolt": jolts}


def prices(state: StateWithContacts, starts: Mapping, repeats: int) -> dict:
    """{"contacts", "price": start -> s, "sweeps": method -> time of none and of each sweep, s}.

    starts: of `starts_of`.
    """
    swept = sweep_times(state, METHODS, (20, 220), repeats)
    sweeps = {name: [max(overhead, 0.0), slope] for name, (slope, overhead) in swept.items()}
    price = timing.interleaved(starts, repeats=repeats)
    return {"contacts": state.contacts.count, "price": price, "sweeps": sweeps}


def jolt(state: StateWithContacts, impulses=None, sweeps: int = 0) -> dict:
    """Half a second by the preset "fast", whose first step has so many sweeps of NesterovPGS from these impulses.

    Returns {"speed": largest rms speed, m/s}. Without impulses it is the run that `simulate` makes of the state.
    """
    state = state.replace(step=0)
    if impulses is not None:
        first = solve_contacts(state, solver=fixed("NesterovPGS", sweeps), start=impulses)
        contacts = state.contacts._replace(normal_start=first.normal_impulses, tangent_start=first.tangent_impulses)
        state = state.replace(contacts=contacts)
    run = simulate(state, steps=50, record=1, accuracy="fast")
    return {"speed": max(map(piles.rms_speed, run.trajectory))}


def time_to(curve: list, error: float) -> float:
    """Time at which a curve of (time, error) first comes down to an error, s, interpolated by powers; or infinity."""
    for (before, above), (after, below) in zip([curve[0], *curve], curve):
        if below <= error:
            share = np.log(above / error) / np.log(above / below) if above > below else 1.0
            return float(before * (after / before) ** share)
    return float("inf")


def curves_of(of_pile: Mapping, timed: Mapping, start: str) -> list[list[tuple]]:
    """(Time, error) after each number of sweeps from a start, whose price counts: one curve for each method.

    of_pile: of `measure`. timed: of `prices`, whose times go by contacts.
    """
    scale, after, curves = of_pile["contacts"] / timed["contacts"], np.array(of_pile["after"]), []
    for name, by_start in of_pile["errors"].items():
        overhead, sweep = timed["sweeps"][name]
        curves.append(list(zip(scale * (timed["price"][start] + overhead + sweep * after), by_start[start])))
    return curves


COLOURS = {"zero": plotting.GREY, "support": plotting.VERMILION, LEARNED: plotting.PURPLE}
JOLTS = (*COLOURS, "simulate", "past")
LEVELS = np.geomspace(0.03, 0.9, 30)
COMPARED = {("support", error): ["zero"] for error in (0.3, 0.1)}
COMPARED |= {(LEARNED, error): ["zero", "support"] for error in (0.3, 0.1, 0.03)}
"""(Start, velocity error) -> the starts that its time is compared with."""


def compute(options, seed, jobs, progress):
    """Every size, kind and radii; times of one pile of each, alone on the machine, the others' by their contacts.

    Piles that are done are kept in the folder `work`, so that an interrupted run of one commit goes on.
    """
    states = {int(n): count for n, count in options["states"].items()}
    chosen = product(states, options["kinds"], options["radii"])
    cells = [dict(zip(("n_bodies", "kind", "radii"), cell)) for cell in chosen]
    common = {"options": {name: options[name] for name in ("radii", "sweeps", "model", "first")}, "commit": commit()}
    parts = [
        ("pile", cell | common | {"seed": s}) for cell in cells for s in parallel.seeds(seed, states[cell["n_bodies"]])
    ]
    piles = done(parts, {"pile": measure}, work=Path(options["work"]), jobs=jobs, text="piles")
    timed = []
    for cell in progress(cells, text="times"):
        smallest, (first,) = options["radii"][cell["radii"]], parallel.seeds(seed, 1)
        state, *_ = case(cell["n_bodies"], cell["kind"], smallest, first)
        timed.append(cell | prices(state, starts_of(state, options["model"]), options["repeats"]))
    return {"piles": piles, "times": timed}


def cells(data):
    """The cells of size, kind and radii: name, piles, times, and ratios, [median, low, high], None of too few piles.

    "ratios": by (start, error) that of `ratio`; by "jolt" that of the jolt from the support over that from zero.
    """
    every = []
    for timed in data["times"]:
        cell = {key: timed[key] for key in ("n_bodies", "kind", "radii")}
        piles = [pile for pile in data["piles"] if pile | cell == pile]
        ratios = {key: ratio(piles, timed, *key, others) for key, others in COMPARED.items()}
        speeds = [[pile["jolt"][start]["speed"] for pile in piles] for start in ("support", "zero")]
        ratios["jolt"] = median_with_interval(np.divide(*speeds))
        name = "{n_bodies:,} {kind} circles, {radii} radii".format(**cell)
        every.append(cell | {"name": name, "piles": piles, "times": timed, "ratios": ratios})
    return every


def times(piles, timed, start, error):
    """Times of the piles to an error by the fastest method, ms; infinite where none comes there."""
    curves = (curves_of(pile, timed, start) for pile in piles)
    return np.array([1e3 * min(time_to(curve, error) for curve in of_pile) for of_pile in curves])


def ratio(piles, timed, start, error, others):
    """Time from a start over the least from the others, pile by pile; [median, low, high] or None.

    A start that never comes to the error counts with the time of the most sweeps, a bound.
    """
    one, other = times(piles, timed, start, error), np.min([times(piles, timed, o, error) for o in others], axis=0)
    most = [1e3 * max(curve[-1][0] for curve in curves_of(pile, timed, start)) for pile in piles]
    ratios = (np.minimum(one, most) / np.minimum(other, most))[np.isfinite(one) | np.isfinite(other)]
    return median_with_interval(ratios) if 2 * ratios.size > one.size else None


def claims(data):
    """Of the support against zero, of the network against the best of both, and of the jolt."""
    every = cells(data)

    def at_rest(text, most, key):
        resting = (cell for cell in every if cell["kind"] == "resting" and cell["ratios"][key])
        if ratios := {cell["name"]: cell["ratios"][key] for cell in resting}:
            yield Claim(f"at rest, {text}", None, all(value[0] <= most for value in ratios.values()), ratios)

    for error in (0.3, 0.1):
        text = f"from the support at most half of the time from zero, to a velocity error of {error:g}"
        yield from at_rest(text, 0.5, ("support", error))
    learned = {f"{cell['name']}, to {key[1]:g}": cell["ratios"][key] for cell in every for key in COMPARED
               if cell["n_bodies"] >= 1000 and key[0] == LEARNED and cell["ratios"][key]}  # fmt: skip
    if learned:
        wins = sum(middle <= 0.7 and high < 0.85 for middle, _, high in learned.values())
        text = "the learned support takes at most 0.7 of the best classical time in half the cells"
        measured = {"cells": len(learned), "wins": wins, **learned}
        yield Claim(f"from 1,000 circles on {text}", None, 2 * wins >= len(learned), measured)
    text = "at equal time for the first step, the support leaves a third of the jolt at most"
    yield from at_rest(text, 1 / 3, "jolt")


def table(data):
    """Ratios of times with intervals, and medians of what a start costs and of the largest speed of a run."""
    names = {"support": "support over zero", LEARNED: "learned over best classical"}
    head = ["circles", "piles", "support, ms", "learned support, ms"]
    head += [f"{names[start]}, to {error:g}" for start, error in COMPARED]
    rows = [[*head, *(f"jolt, {start}, m/s" for start in JOLTS)]]
    for cell in cells(data):
        piles, price = cell["piles"], cell["times"]["price"]
        shown = [one and text_of(one) for one in map(cell["ratios"].get, COMPARED)]
        jolts = [float(np.median([pile["jolt"][start]["speed"] for pile in piles])) for start in JOLTS]
        what = f"{len(piles)} {cell['kind']}, {cell['radii']}"
        rows.append([cell["n_bodies"], what, *(1e3 * price[start] for start in ("support", LEARNED)), *shown, *jolts])
    return rows


def draw(data, options):
    """Error by time of the fastest method from each start, for resting piles: a panel a size, medians and quartiles."""
    drawn = [cell for cell in cells(data) if [cell["kind"], cell["radii"]] == options["drawn"]
             and cell["n_bodies"] >= options["least"]]  # fmt: skip
    figure, panels = plotting.subplots(1, len(drawn), size=(plotting.PAGE, 3.2), squeeze=False)
    for ax, cell in zip(panels[0], drawn):
        for start, colour in COLOURS.items():
            by_level = np.array([times(cell["piles"], cell["times"], start, level) for level in LEVELS])
            low, middle, high = np.percentile(by_level, (25, 50, 75), axis=1, method="nearest")
            reached = np.isfinite(middle)
            ax.plot(middle[reached], LEVELS[reached], color=colour, label=f"from {start}")
            ends = low[reached], np.where(np.isfinite(high[reached]), high[reached], 10 * middle[reached].max())
            ax.fill_betweenx(LEVELS[reached], *ends, color=colour, alpha=0.2, linewidth=0)
        plotting.log_axes(ax)
    titles = (f"{cell['n_bodies']:,} circles" for cell in drawn)
    plotting.label_grid(panels, titles, "time of the first step (ms)", ["velocity error"])
    return plotting.legend_below(figure, panels[0, 0], "How soon is a resting pile without impulses solved?")


OPTIONS = {
    "states": {"100": 20, "300": 20, "1000": 20, "3000": 20, "10000": 10}, "kinds": ["settling", "resting"],
    "radii": {"near": 0.8, "mixed": 0.5}, "sweeps": [5, 10, 20, 40, 80, 160, 320, 640, 1280, 2560], "repeats": 5,
    "first": {"zero": 60, "support": 52, LEARNED: 20}, "model": "no_past", "work": "runs/figure_6_14",
    "drawn": ["resting", "near"], "least": 1000,
}  # fmt: skip
QUICK = {"states": {"100": 4, "300": 4}, "least": 100, "repeats": 1}
FIGURE = Figure("6.14", "A pile without a past: its first step", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=5)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
