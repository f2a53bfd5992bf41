"""Piles whose contacts carry no impulses: what it takes to solve their first step, and what happens if it is not.

A pile loses the impulses of its contacts, as positions from elsewhere have none. Every method solves its step from
each start, whose price counts. Its error is that of the velocities against the nearest of several solutions
(`metrics.nearest_velocity_error`): what the impulses of the run lead to, and where the methods end from the support.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from deep_contact.physics import metrics
from deep_contact.physics.exact import solve_exactly
from deep_contact.physics.solvers import NNCG, PSOR, NesterovPGS
from deep_contact.simulation import simulate, solve_contacts
from deep_contact.state import StateWithContacts
from deep_contact.studies import piles, timing
from deep_contact.warm_start import Support

METHODS = {
    "PSOR 1.5": partial(PSOR, omega=1.5, tolerance=None),
    "PSOR 1.75 | 1.45": partial(PSOR, omega=1.75, friction_omega=1.45, tolerance=None),
    "NNCG": partial(NNCG, tolerance=None),
    "NesterovPGS": partial(NesterovPGS, tolerance=None),
}
REFERENCE_SWEEPS = 20_000


class PileWithoutPast(NamedTuple):
    """A state whose contacts carry no impulses, solutions of its step, and the state as it was, with its impulses."""

    state: StateWithContacts
    references: list
    past: StateWithContacts


def without_past(state: StateWithContacts) -> StateWithContacts:
    """The state with contacts that carry no impulses."""
    nothing = np.zeros(state.contacts.count)
    contacts = state.contacts._replace(
        normal_impulse=nothing, tangent_impulse=nothing, normal_start=nothing, tangent_start=nothing
    )
    return state.replace(contacts=contacts, solved=False)


def pile(n_bodies: int, kind: str, smallest: float, seed: int) -> PileWithoutPast:
    """A packed pile of radii from `smallest` to 1 m, of a kind of `piles.KINDS`."""
    make = partial(piles.packed_pile, steps=50, smallest=smallest)
    past = piles.pile(kind, n_bodies, seed, solver=piles.SETTLE, make=make)
    state, tolerance = without_past(past), 1e-9 * float(past.bodies.mass.mean())
    ends = [solve_contacts(past, solver=NNCG(sweeps=REFERENCE_SWEEPS, tolerance=tolerance))]
    start = Support()(state, None)
    for name in ("PSOR 1.5", "NesterovPGS"):
        ends.append(solve_contacts(state, solver=METHODS[name](sweeps=REFERENCE_SWEEPS // 4), start=start))
    return PileWithoutPast(state, piles.references_from(state, ends, exact=False) or ends[:1], past)


def errors(found: PileWithoutPast, starts: dict, sweeps: list[int]) -> dict:
    """Method -> start -> velocity errors after so many sweeps. starts: name -> impulses."""

    def error(make, start, count):
        solution = solve_contacts(found.state, solver=make(sweeps=count), start=start)
        return metrics.nearest_velocity_error(found.state, solution, found.references)

    return {
        name: {start: [error(make, given, k) for k in sweeps] for start, given in starts.items()}
        for name, make in METHODS.items()
    }


def times(state: StateWithContacts, starts: dict, repeats: int) -> dict:
    """{"contacts", "price": start -> s, "sweeps": method -> time of none and of each sweep, s}.

    starts: name -> what makes the impulses.
    """
    few, many, found = 20, 220, {}
    for name, make in METHODS.items():
        runs = {k: partial(solve_contacts, state, solver=make(sweeps=k)) for k in (few, many)}
        took = timing.interleaved(runs, repeats=repeats)
        slope, overhead = timing.slope_and_overhead((few, took[few]), (many, took[many]))
        found[name] = [max(overhead, 0.0), slope]
    price = timing.interleaved(starts, repeats=repeats)
    return {"contacts": state.contacts.count, "price": price, "sweeps": found}


def jolt(state: StateWithContacts, impulses=None, sweeps: int = 0) -> dict:
    """Half a second by the preset "fast", whose first step has so many sweeps of NesterovPGS from these impulses.

    Returns {"speed": largest rms speed, m/s, "sinking": fall of the centre of mass, m}. Without impulses it is the run
    that `simulate` makes of the state.
    """
    state = state.replace(step=0)
    if impulses is not None:
        first = solve_contacts(state, solver=NesterovPGS(sweeps=sweeps, tolerance=None), start=impulses)
        contacts = state.contacts._replace(normal_start=first.normal_impulses, tangent_start=first.tangent_impulses)
        state = state.replace(contacts=contacts)
    run = simulate(state, steps=50, record=1, accuracy="fast")
    height = [float(np.average(one.bodies.position[:, 1], weights=one.bodies.mass)) for one in run.trajectory]
    return {"speed": max(map(piles.rms_speed, run.trajectory)), "sinking": height[0] - min(height)}


def exact(state: StateWithContacts, starts: dict) -> dict:
    """Start -> {"time": of `solve_exactly` from there, s, "pivots", "converged"}. starts: name -> impulses."""
    found = {}
    for name, given in starts.items():
        seconds, solution = timing.timed(partial(solve_exactly, state, *given))
        found[name] = {"time": seconds, "pivots": solution.pivots, "converged": solution.converged}
    return found


def time_to(curve: list, error: float) -> float:
    """Time at which a curve of (time, error) first comes down to an error, s, interpolated by powers; or infinity."""
    for (before, above), (after, below) in zip([curve[0], *curve], curve):
        if below <= error:
            share = np.log(above / error) / np.log(above / below) if above > below else 1.0
            return float(before * (after / before) ** share)
    return float("inf")


def best_time(of_pile: dict, timed: dict, start: str, error: float) -> float:
    """Time of the fastest method from a start to an error, s, the start's included; times go by contacts.

    of_pile: {"contacts", "after": numbers of sweeps, "errors": of `errors`}. timed: of `times`.
    """
    return min(time_to(curve, error) for curve in _curves(of_pile, timed, start))


def time_of_all(of_pile: dict, timed: dict, start: str) -> float:
    """Time of the most sweeps of the slowest method, s; arguments as of `best_time`."""
    return max(curve[-1][0] for curve in _curves(of_pile, timed, start))


def _curves(of_pile, timed, start):
    """(time, error) after each number of sweeps, a list for each method."""
    scale, after = of_pile["contacts"] / timed["contacts"], np.array(of_pile["after"])
    for name, by_start in of_pile["errors"].items():
        overhead, sweep = timed["sweeps"][name]
        yield list(zip(scale * (timed["price"][start] + overhead + sweep * after), by_start[start]))
