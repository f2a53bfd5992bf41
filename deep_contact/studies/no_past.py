"""Piles whose contacts carry no impulses: what it takes to solve their first step, and what happens if it is not.

A pile loses the impulses of its contacts, as positions from elsewhere have none. Every method solves its step from
each start, whose price counts. Its error is that of the velocities against the nearest of several solutions
(`metrics.nearest_velocity_error`): what the impulses of the run lead to, and where the methods end from the support.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from deep_contact.physics.solvers import NNCG
from deep_contact.simulation import simulate, solve_contacts
from deep_contact.state import StateWithContacts
from deep_contact.studies import piles, timing
from deep_contact.studies.learned_starts import BASE, errors_of, fixed, from_rows, settings_with, sweep_times
from deep_contact.warm_start import LearnedSupport, Support

METHODS = ("PSOR 1.5", BASE, "NNCG", "NesterovPGS")
REFERENCE_SWEEPS = 20_000
LEARNED = "learned support"


def without_past(state: StateWithContacts) -> StateWithContacts:
    """The state with contacts that carry no impulses."""
    nothing = np.zeros(state.contacts.count)
    contacts = state.contacts._replace(
        normal_impulse=nothing, tangent_impulse=nothing, normal_start=nothing, tangent_start=nothing
    )
    return state.replace(contacts=contacts, solved=False)


def case(n_bodies: int, kind: str, smallest: float, seed: int) -> tuple[StateWithContacts, list, StateWithContacts]:
    """(State whose contacts carry no impulses, solutions of its step, the state as it was, with its impulses).

    kind: of `piles.KINDS`. smallest: least radius, m; the largest is 1 m.
    """
    make = partial(piles.packed_pile, steps=50, smallest=smallest)
    past = piles.pile(kind, n_bodies, seed, solver=piles.SETTLE, make=make)
    state, tolerance = without_past(past), 1e-9 * float(past.bodies.mass.mean())
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


def times(state: StateWithContacts, starts: Mapping, repeats: int) -> dict:
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


def curves(of_pile: Mapping, timed: Mapping, start: str) -> list[list[tuple]]:
    """(Time, error) after each number of sweeps from a start, whose price counts: one curve for each method.

    of_pile: of `measure`. timed: of `times`, whose times go by contacts.
    """
    scale, after, curves = of_pile["contacts"] / timed["contacts"], np.array(of_pile["after"]), []
    for name, by_start in of_pile["errors"].items():
        overhead, sweep = timed["sweeps"][name]
        curves.append(list(zip(scale * (timed["price"][start] + overhead + sweep * after), by_start[start])))
    return curves
