"""Starts along their own runs: what is interpolated, and that a run is judged as the engine steps it."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.studies import along_runs
from deep_contact.studies.along_runs import (
    BASE,
    cells,
    curve,
    error_at,
    ratio_with_interval,
    run_of,
)

SCALED = f"{BASE}, scaled"
TASK = {"circles": 30, "seed": 4, "steps": 60, "every": 10, "past_need": 200, "sweeps": 8}


def test_an_error_between_two_times_lies_on_the_line_of_logarithms():
    # e = 1 / t²: 0.25 at t = 2, 0.0625 at t = 4.
    times, errors = np.array([1.0, 4.0]), np.array([[1.0, 2.0], [0.0625, 0.125]])
    np.testing.assert_allclose(error_at(2.0, times, errors), [0.25, 0.5])
    np.testing.assert_allclose(error_at(9.0, times, errors), errors[1])
    # Less time than the fewest sweeps take is not enough.
    assert error_at(0.1, times, errors) is None
    np.testing.assert_allclose(error_at(1.0, times, errors), errors[0])


def entry(name, sweeps, seconds, errors):
    return {"circles": 30, "setting": name, "sweeps": sweeps, "work": [sweeps] * 2, "seconds": seconds, "error": errors}


def test_cells_compare_at_the_time_of_the_base():
    entries = [entry(BASE, 10, 2.0, [0.4, 0.4]), entry(BASE, 20, 3.0, [0.2, 0.2])]
    entries += [entry("PSOR 1.5", 10, 2.0, [0.5, 0.5]), entry("PSOR 1.5", 20, 3.0, [0.1, 0.1])]
    # Half a unit dearer: the time of 10 sweeps is too short for it.
    entries += [entry(SCALED, 10, 2.5, [0.3, 0.3]), entry(SCALED, 20, 3.5, [0.15, 0.15])]
    first, second = cells(entries, [10, 20])
    assert (first["best"], second["best"]) == (BASE, "PSOR 1.5")
    assert first["seconds"] == pytest.approx(2.0)
    assert first["errors"][SCALED] is None
    assert second["errors"][SCALED][0] == pytest.approx(
        np.exp(np.interp(np.log(3.0), np.log([2.5, 3.5]), np.log([0.3, 0.15])))
    )
    np.testing.assert_allclose(curve(entries, 30, BASE)[0], [2.0, 3.0])


def test_the_ratio_of_proportional_errors_has_no_interval():
    errors = np.array([0.1, 0.2, 0.4])
    np.testing.assert_allclose(ratio_with_interval(0.5 * errors, errors), 0.5)


@pytest.mark.parametrize("setting", [BASE, f"{BASE}, none", f"{BASE}, scaled"])
def test_a_run_says_what_its_steps_left(setting):
    found = run_of(TASK | {"setting": setting})
    assert 0.0 < found["error"] < 1.5
    assert found["work"] == pytest.approx(8.0, rel=0.5)
    assert found["height"] > 1.0


def test_a_well_solved_run_has_next_to_no_error():
    assert run_of(TASK | {"setting": BASE, "sweeps": 400})["error"] < 0.1 * run_of(TASK | {"setting": BASE})["error"]


def test_the_state_of_a_judged_step_is_that_of_the_run():
    scene = along_runs.scene_of(30, 4)
    solver, start = along_runs.setting_of(BASE, 8)
    state = dc.simulate(scene, steps=40, solver=solver).state
    after = dc.simulate(state, steps=1, solver=solver).state
    end = dc.solve_contacts(state, solver=solver, start=start(state, solver))
    np.testing.assert_allclose(end.velocities, after.bodies.velocity, atol=1e-12)


def test_all_settings_can_be_made():
    for name in along_runs.SOLVERS:
        solver, start = along_runs.setting_of(name, 7)
        assert (solver.sweeps, solver.tolerance) == (7, None)
        assert isinstance(start, dc.warm_start.Builtin)
