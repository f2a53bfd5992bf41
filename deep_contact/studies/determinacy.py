"""How much of a pile's impulses its motion determines, and how far answers for one state lie from each other."""

from __future__ import annotations

import numpy as np

from deep_contact.bounds import force_bounds
from deep_contact.physics import engine, metrics
from deep_contact.physics.exact import solve_exactly
from deep_contact.physics.scenes import circles_in_box
from deep_contact.physics.solvers import NNCG, PGS
from deep_contact.simulation import simulate, solve_contacts
from deep_contact.state import StateWithContacts
from deep_contact.studies import piles
from deep_contact.studies.no_past import without_past
from deep_contact.warm_start import Cnn, LearnedSupport, Support

SWEEPS = 20_000
"""Of a solver that makes a label."""


def packed(kind: str, n_bodies: int, friction: float, smallest: float, seed: int) -> StateWithContacts:
    """A packing after 51 steps ("settling"), or at a rms speed below 1e-3 m/s or after 1,050 ("resting").

    smallest: radius, m; the largest is 1 m. "thesis": the thesis's scene, of one radius, likewise, or after 1,600.
    """
    if kind == "thesis":
        scene, first = circles_in_box(n_bodies=n_bodies, friction=friction, seed=seed), 600
    else:
        scene, first = piles.packing(n_bodies, np.random.default_rng(seed), smallest=smallest, friction=friction), 50
    state, well = simulate(scene, steps=first, solver=piles.SETTLE).state, NNCG(sweeps=200)
    if kind == "settling":
        return simulate(state, steps=1, solver=well).state
    for _ in range(20):
        state = simulate(state, steps=50, solver=well).state
        if piles.rms_speed(state) < 1e-3:
            break
    return state


def measure(past: StateWithContacts, contacts: int, seed: int, models: list[str]) -> dict:
    """Intervals of λ_n of a pile's next step, over the mean λ_n, and the errors of other answers.

    contacts: how many are drawn, for the intervals. models: networks that correct a past, but for the last, which
    corrects a support. Returns "exact": whether an exact motion was found, "fastest": speed of its circles, m/s,
    "widths", and with models "errors": answer → median distance of λ_n from the exact solution that the pile's past
    leads to, over the mean λ_n, and the velocity error, in which other impulses with its motion have none.
    """
    exact = solve_exactly(past)
    if not exact.converged:
        return {"exact": False}
    normal, tangent = exact.solution.normal_impulses, exact.solution.tangent_impulses
    solved = past.contacts._replace(normal_impulse=normal, tangent_impulse=tangent)
    drawn = np.random.default_rng(seed).choice(normal.size, min(contacts, normal.size), replace=False)
    bounds = force_bounds(past.replace(contacts=solved, solved=True), np.sort(drawn))
    measured = {"exact": True, "fastest": np.abs(exact.solution.velocities).max(),
                "widths": np.ptp(bounds.normal, axis=1) / normal.mean()}  # fmt: skip
    if not models:
        return measured
    state, pgs, nncg = without_past(past), PGS(sweeps=SWEEPS, tolerance=None), NNCG(sweeps=SWEEPS, tolerance=None)
    answers = {
        "Builtin": solve_contacts(past, solver=pgs),
        "PGS from zero": solve_contacts(state, solver=pgs, start="none"),
        "NNCG from zero": solve_contacts(state, solver=nncg, start="none"),
        "PGS from support": solve_contacts(state, solver=pgs, start=Support()),
    }
    starts = {f"{name}.h5": Cnn(name)(past, pgs) for name in models[:-1]}
    starts |= {f"{name}.h5": LearnedSupport(name)(state, pgs) for name in models[-1:]}
    answers |= {name: engine.solve(past, PGS(sweeps=0), *start) for name, start in starts.items()}
    errors = {
        name: [
            float(np.median(np.abs(answer.normal_impulses - normal)) / normal.mean()),
            metrics.velocity_error(past, answer, exact.solution),
        ]
        for name, answer in answers.items()
    }
    return measured | {"errors": errors}
