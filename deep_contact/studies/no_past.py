"""Piles whose contacts carry no impulses: what it takes to solve their first step, and what happens if it is not.

A settled pile loses the impulses of its contacts, as positions from elsewhere have none. Every method solves its step
from zero and from `warm_start.Support`, whose time counts; a method's error after so many sweeps is that of the
velocities against the solution that the impulses of the run lead to.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from deep_contact.physics import metrics
from deep_contact.physics.engine import step_problem
from deep_contact.physics.solvers import NNCG, PGS, PSOR, NesterovPGS
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
STARTS = ("zero", "support")


def without_past(state: StateWithContacts) -> StateWithContacts:
    """The state with contacts that carry no impulses."""
    nothing = np.zeros(state.contacts.count)
    contacts = state.contacts._replace(
        normal_impulse=nothing, tangent_impulse=nothing, normal_start=nothing, tangent_start=nothing
    )
    return state.replace(contacts=contacts, solved=False)


def cell(n_bodies: int, seed: int, *, steps: int, sweeps: list[int], repeats: int) -> dict:
    """A pile after so many steps: time, s, and error of each method from each start after so many sweeps.

    Returns {"contacts", "price": time of the support, s, "curves": {method: {start: [[time, error], …]}}, "jolt":
    {start: largest rms speed, m/s, in half a second of 10 sweeps a step, of which the first has 20 from that start}}.
    """
    past = piles.packed_pile(n_bodies, seed=seed, steps=steps)
    solved = solve_contacts(past, solver=NNCG(sweeps=20_000, tolerance=1e-9 * float(past.bodies.mass.mean())))
    state = without_past(past)
    problem, support = step_problem(state), Support()
    given = {"zero": None, "support": support.from_problem(state, None, problem)}
    price = timing.fastest(partial(support.from_problem, state, None, problem), repeats)
    curves = {}
    for name, make in METHODS.items():
        runs = {
            (start, k): partial(solve_contacts, state, solver=make(sweeps=k), start=impulses)
            for start, impulses in given.items()
            for k in sweeps
        }
        times = timing.interleaved(runs, repeats=repeats)
        errors = {key: metrics.velocity_error(state, run(), solved) for key, run in runs.items()}
        curves[name] = {
            start: [[times[start, k] + (price if start == "support" else 0.0), errors[start, k]] for k in sweeps]
            for start in STARTS
        }
    jolts = {start: jolt(state, impulses) for start, impulses in given.items()}
    return {"contacts": state.contacts.count, "price": price, "curves": curves, "jolt": jolts}


def jolt(state: StateWithContacts, impulses) -> float:
    """Largest rms speed of a pile in half a second, m/s, whose first step has 20 sweeps from these impulses."""
    first = solve_contacts(state, solver=NesterovPGS(sweeps=20, tolerance=None), start=impulses)
    contacts = state.contacts._replace(normal_start=first.normal_impulses, tangent_start=first.tangent_impulses)
    run = simulate(state.replace(contacts=contacts), steps=50, record=1, solver=PGS(sweeps=10, tolerance=None))
    return max(map(piles.rms_speed, run.trajectory))


def time_to(curve: list, error: float) -> float:
    """Time at which a curve of (time, error) first comes down to an error, s, interpolated by powers; or infinity."""
    for (before, above), (after, below) in zip([curve[0], *curve], curve):
        if below <= error:
            share = np.log(above / error) / np.log(above / below) if above > below else 1.0
            return float(before * (after / before) ** share)
    return float("inf")


def best_times(curves: dict, error: float) -> dict[str, float]:
    """Start -> time of the fastest method to an error, s."""
    return {start: min(time_to(by_start[start], error) for by_start in curves.values()) for start in STARTS}
