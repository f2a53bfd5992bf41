"""Time to an error: sweeps counted, start and sweep timed."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.studies.break_even import (
    CLASSICAL,
    LEARNED,
    SOLVERS,
    best_setting,
    errors_by_sweeps,
    ratios,
    start_times,
    sweep_times,
    sweeps_to,
)
from deep_contact.warm_start import Builtin, NoStart


def test_sweeps_to_an_error_lie_between_the_counts_by_the_logarithm():
    # Error 10^(-k / 10) after k sweeps.
    sweeps = (0, 10, 20, 40)
    errors = [10.0 ** (-k / 10) for k in sweeps]
    assert sweeps_to(errors, sweeps, 1.0) == 0.0
    assert sweeps_to(errors, sweeps, 10**-1.5) == pytest.approx(15.0)
    assert sweeps_to(errors, sweeps, 10**-3.0) == pytest.approx(30.0)
    assert sweeps_to(errors, sweeps, 1e-5) == np.inf


def test_an_error_has_to_stay_within():
    assert sweeps_to([0.05, 0.5, 0.05], (0, 10, 20), 0.1) > 10
    assert sweeps_to([0.05, 0.05, 0.5], (0, 10, 20), 0.1) == np.inf


def test_the_solution_as_a_start_has_no_error(falling_states):
    state = falling_states[6]
    exact = dc.solve_contacts(state, solver=dc.NNCG(sweeps=5000, tolerance=1e-9))
    starts = {"none": NoStart(), "solution": lambda s, solver: (exact.normal_impulses, exact.tangent_impulses)}
    settings = dict.fromkeys(starts, tuple(SOLVERS))
    found = errors_by_sweeps(state, starts, settings=settings, sweeps=(0, 3, 30), past_need=5000, exact=True)
    assert set(found) == set(starts)
    for solver in SOLVERS:
        assert max(found["solution"][solver]) < 1e-6
        assert found["none"][solver][0] == pytest.approx(1.0, abs=0.02)  # nothing done yet
        assert found["none"][solver][2] < found["none"][solver][0]


def test_a_learned_start_is_held_against_the_best_classical_setting():
    # Two states; a sweep takes 1 s with PGS and with PSOR, 2 s with the others. Error 10^(-k / 10) after k sweeps with
    # PGS, with PSOR in half as many; the learned start saves PSOR two sweeps and takes 1 s.
    sweeps = [0, 10, 20]
    slow, fast = [10.0 ** (-k / 10) for k in sweeps], [10.0 ** (-k / 5) for k in sweeps]
    saved = [10.0 ** (-(k + 2) / 5) for k in sweeps]
    errors = {start: {s: fast if s == "PSOR" else slow for s in solvers} for start, solvers in CLASSICAL.items()}
    errors |= {start: {s: saved if s == "PSOR" else slow for s in solvers} for start, solvers in LEARNED.items()}
    pile = {
        "circles": 9,
        "kind": "falling",
        "used": [0, 1],
        "errors": [errors, errors],
        "start_seconds": {name: [float(name in LEARNED)] * 2 for name in (*CLASSICAL, *LEARNED)},
        "sweep_seconds": {"PGS": 1.0, "PSOR": 1.0, "NNCG": 2.0, "NesterovPGS": 2.0},
    }
    data = {"sweeps": sweeps, "piles": [pile]}
    start, solver, seconds = best_setting(data, 9, "falling", CLASSICAL, 0.01)
    assert (start, solver) == ("none", "PSOR")
    np.testing.assert_allclose(seconds, 10.0)
    np.testing.assert_allclose(ratios(data, 9, "falling", "far field", 0.01), (1.0 + 8.0) / 10.0)
    assert ratios(data, 9, "falling", "far field", 1e-9).size == 0


def test_a_state_that_nothing_solves_has_no_errors(falling_states):
    assert errors_by_sweeps(falling_states[6], {"builtin": Builtin()}, sweeps=(0,), past_need=1, exact=False) == {}


def test_starts_are_timed_by_state_and_sweeps_by_solver(falling_states):
    times = start_times(falling_states[5:7], {"builtin": Builtin(), "none": NoStart()}, repeats=1)
    assert {name: len(found) for name, found in times.items()} == {"builtin": 2, "none": 2}
    assert sweep_times(falling_states[6], repeats=1).keys() == SOLVERS.keys()
