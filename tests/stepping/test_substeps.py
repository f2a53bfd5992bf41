"""Substeps: a divided step is that number of short steps, and leaves the same state."""

from dataclasses import replace

import numpy as np
import pytest

import deep_contact as dc

SOLVERS = [
    dc.PGS(sweeps=5, tolerance=None),
    dc.PGS(sweeps=40, tolerance=1e-6, islands=True),
    dc.PSOR(sweeps=5, omega=1.4, tolerance=None),
    dc.NNCG(sweeps=5, tolerance=None),
    dc.BatchedPGS(sweeps=5, tolerance=None),
]


@pytest.mark.parametrize(("solver", "sleep"), [*((solver, False) for solver in SOLVERS), (SOLVERS[0], True)], ids=str)
def test_substeps_are_short_steps(solver, sleep):
    scene = dc.circles_in_box(50, size=20, seed=1)
    whole = dc.simulate(scene, steps=60, solver=replace(solver, substeps=4), sleep=sleep)
    short = dc.simulate(scene, steps=240, dt=0.0025, solver=solver, sleep=sleep)
    for one, other in zip(whole.state.bodies, short.state.bodies):
        np.testing.assert_array_equal(one, other)
    # Impulses are those of a whole step.
    np.testing.assert_array_equal(whole.state.contacts.normal_start, 4 * short.state.contacts.normal_start)
    assert (whole.state.step, whole.state.dt, whole.state.time) == (60, 0.01, 0.6)
    np.testing.assert_array_equal(whole.sweeps, short.sweeps.reshape(-1, 4).sum(axis=1))
    np.testing.assert_array_equal(whole.relaxations, short.relaxations.reshape(-1, 4).sum(axis=1))
    np.testing.assert_array_equal(whole.contacts, short.contacts[3::4])
    np.testing.assert_array_equal(whole.theta, short.theta[3::4])


@pytest.mark.parametrize("solver", SOLVERS[:1] + SOLVERS[-1:], ids=str)
@pytest.mark.parametrize("division", [{"substeps": 3}, {"most_substeps": 8}])
def test_on_step_sees_whole_steps_from_which_the_run_goes_on(solver, division):
    # A state that was seen is solved again to the bit, without the contacts that came during its step.
    scene, seen = dc.circles_in_box(20, size=15, seed=3), []
    solver = replace(solver, **division)
    run = dc.simulate(scene, steps=60, solver=solver, record=1, on_step=lambda *solved: seen.append(solved))
    assert [(state.step, state.dt) for state, _ in seen] == [(k, 0.01) for k in range(60)]
    assert run.substeps.max() > 1
    for state, record in seen[25:50:5]:
        again = dc.simulate(state, steps=60 - state.step, solver=solver)
        np.testing.assert_array_equal(again.state.bodies.position, run.state.bodies.position)
        assert dc.solve_contacts(state).normal_impulses.size == run.trajectory[state.step].contacts.count
        np.testing.assert_array_equal(record.theta[-1], run.theta[state.step])
    assert any(state.contacts.count > run.trajectory[state.step].contacts.count for state, _ in seen)
