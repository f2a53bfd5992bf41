"""Measures of the field on single contact problems: impulses of other engines, profiles, and self-consistency."""

import math

import numpy as np
import pytest
from conftest import load_script

from deep_contact.analysis import lcp
from deep_contact.analysis.exact import solve_exactly
from deep_contact.measure import peers

measures = load_script("figure_6_18")


@pytest.fixture(scope="module")
def settling():
    """A settling pile of two sizes, whose circles move: the state, its problem, and an exact solution's velocities."""
    state = measures.problem_of("two sizes", "settling", 30, 3)
    exact = solve_exactly(state).solution
    return state, lcp.contact_problem(state), np.column_stack([exact.velocities, exact.angular_velocities]).ravel()


@pytest.mark.parametrize("engine", measures.READERS)
def test_the_impulses_of_another_engine_are_those_of_its_velocities(settling, engine):
    pytest.importorskip(peers.ENGINES[engine].package)
    state, problem, exact = settling
    errors = []
    for iterations in (1, 10, 300):
        impulse, velocity = measures.READERS[engine](state, iterations)
        assert measures.difference(problem, impulse, velocity, exact) < measures.SAME
        assert impulse[::2].min() >= 0.0
        errors.append(measures.measures_of(problem, impulse, exact, 0.0981)["velocity error"])
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.02


def test_another_problem_is_noticed(settling):
    """Impulses that the engine does not have, and a pile that has moved on by 20 steps."""
    pytest.importorskip("pymunk")
    state, problem, exact = settling
    impulse, velocity = measures.pymunk_impulses(state, 10)
    assert measures.difference(problem, 1.05 * impulse, velocity, exact) > measures.SAME
    bodies = state.bodies._replace(position=state.bodies.position + 0.2 * state.bodies.velocity)
    impulse, velocity = measures.pymunk_impulses(state.replace(bodies=bodies), 10)
    assert measures.difference(problem, impulse, velocity, exact) > 10 * measures.SAME


def data_of(**errors):
    """Data of problems: name of a solver -> the velocity errors after 1, 10 and 100 sweeps in each problem."""
    count = len(next(iter(errors.values())))
    rows = [
        {"solvers": {name: dict.fromkeys(measures.MEASURES, of[i]) for name, of in errors.items() if of[i]}}
        for i in range(count)
    ]
    return {"after": [1, 10, 100], "problems": rows}


def test_a_performance_profile_by_hand():
    quick, slow = [[0.3, 0.05, 0.01], [0.05, 0.2, 0.01], [0.3, 0.2, 0.15]], [[0.3, 0.2, 0.1], [0.3, 0.05, 0.2], None]
    data = data_of(quick=quick, slow=slow)
    # 10 and 100 sweeps; 100 (the value after one sweep does not stay) and never; the third is solved by none.
    assert measures.sweeps_to(data["problems"][1], [1, 10, 100], "slow", "velocity error") == math.inf
    ratios = measures.profile(data, "velocity error")
    assert {name: of.tolist() for name, of in ratios.items()} == {"quick": [1.0, 1.0], "slow": [10.0, math.inf]}
    assert [measures.share_within(ratios["slow"], tau) for tau in (1.0, 9.9, 10.0, 1e300)] == [0.0, 0.0, 0.5, 0.5]


def test_a_problem_is_measured_by_every_solver():
    found = measures.measure(kind="piles", phase="settling", n_bodies=20, seed=1, after=[1, 30])
    assert measures.SOLVERS.keys() <= found["solvers"].keys() | found["left out"].keys()
    for name, by_measure in found["solvers"].items():
        assert by_measure.keys() == measures.MEASURES.keys()
        first, last = by_measure["velocity error"]
        assert last < first <= 1.5, name
        assert min(map(min, by_measure.values())) >= 0.0


def test_runs_of_the_same_step_are_consistent():
    common = {"splits": [measures.FINEST, 1], "n_bodies": 20, "seeds": [1], "seconds": 3.0}
    same, other = measures.energy_changes(setting={"method": "PGS", "sweeps": 5}, **common)["errors"]
    assert same == 0.0
    assert other > 0.1
    found = measures.energy_changes(setting={"method": "PGS", "sweeps": 5, "iterations": 1}, **common)
    assert found["errors"] is None
    assert "iterations" in found["why"]
