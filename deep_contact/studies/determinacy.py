"""How much of the impulses of a resting pile its motion determines, and how far apart labels of one state lie."""

from __future__ import annotations

import numpy as np

from deep_contact.bounds import force_bounds
from deep_contact.physics.exact import solve_exactly
from deep_contact.physics.solvers import NNCG, PGS
from deep_contact.simulation import simulate, solve_contacts
from deep_contact.state import StateWithContacts
from deep_contact.studies import piles
from deep_contact.studies.no_past import without_past
from deep_contact.warm_start import Cnn, LearnedSupport, Support

SWEEPS, MOST_PIVOTS = 20_000, 5_000
"""Of a solver that makes a label, and of the exact solution."""


def at_rest(n_bodies: int, seed: int, friction: float) -> StateWithContacts:
    """A packing that settles to a rms speed below 1e-3 m/s, or for 1,050 steps."""
    scene = piles.packing(n_bodies, np.random.default_rng(seed), friction=friction)
    state = simulate(scene, steps=50, solver=piles.SETTLE).state
    for _ in range(20):
        state = simulate(state, steps=50, solver=NNCG(sweeps=200)).state
        if piles.rms_speed(state) < 1e-3:
            break
    return state


def measure(n_bodies: int, friction: float, contacts: int, seed: int, models: list[str]) -> dict:
    """Intervals of λ_n, and distances of other answers, of a resting pile; all over the mean λ_n.

    contacts: how many are drawn, for the intervals. models: files of networks that correct a past and a support.
    Returns "exact": whether the exact solver converged, "fastest": speed of its circles, m/s, "widths", and with models
    "apart": answer → median distance of λ_n from the exact solution that the pile's past leads to.
    """
    past = at_rest(n_bodies, seed, friction)
    exact = solve_exactly(past, most_pivots=MOST_PIVOTS)
    measured: dict = {"n_bodies": n_bodies, "friction": friction, "exact": exact.converged}
    if not exact.converged:
        return measured
    measured["fastest"] = np.abs(exact.solution.velocities).max()
    normal, tangent = exact.solution.normal_impulses, exact.solution.tangent_impulses
    solved = past.contacts._replace(normal_impulse=normal, tangent_impulse=tangent)
    drawn = np.random.default_rng(seed).choice(normal.size, min(contacts, normal.size), replace=False)
    bounds = force_bounds(past.replace(contacts=solved, solved=True), np.sort(drawn))
    measured |= {"widths": np.ptp(bounds.normal, axis=1) / normal.mean(), "apart": {}}
    if not models:
        return measured
    state, pgs, nncg = without_past(past), PGS(sweeps=SWEEPS, tolerance=None), NNCG(sweeps=SWEEPS, tolerance=None)
    answers = {
        "Builtin": solve_contacts(past, solver=pgs)[0],
        "PGS from zero": solve_contacts(state, solver=pgs, start="none")[0],
        "NNCG from zero": solve_contacts(state, solver=nncg, start="none")[0],
        "PGS from support": solve_contacts(state, solver=pgs, start=Support())[0],
        models[0]: Cnn(models[0])(past, pgs)[0],
        models[1]: LearnedSupport(models[1])(state, pgs)[0],
    }
    apart = {name: np.median(np.abs(answer - normal)) / normal.mean() for name, answer in answers.items()}
    return measured | {"apart": apart}
