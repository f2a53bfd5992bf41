"""Time to an error: sweeps counted, start and sweep timed."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.studies.break_even import SOLVERS, errors_by_sweeps, start_times, sweep_times, sweeps_to
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
    found = errors_by_sweeps(state, starts, sweeps=(0, 3, 30), past_need=5000, exact=True)
    assert set(found) == set(starts)
    for solver in SOLVERS:
        assert max(found["solution"][solver]) < 1e-6
        assert found["none"][solver][0] == pytest.approx(1.0, abs=0.02)  # nothing done yet
        assert found["none"][solver][2] < found["none"][solver][0]


def test_a_state_that_nothing_solves_has_no_errors(falling_states):
    assert errors_by_sweeps(falling_states[6], {"builtin": Builtin()}, sweeps=(0,), past_need=1, exact=False) == {}


def test_starts_are_timed_by_state_and_sweeps_by_solver(falling_states):
    times = start_times(falling_states[5:7], {"builtin": Builtin(), "none": NoStart()}, repeats=1)
    assert {name: len(found) for name, found in times.items()} == {"builtin": 2, "none": 2}
    assert sweep_times(falling_states[6], repeats=1).keys() == SOLVERS.keys()
