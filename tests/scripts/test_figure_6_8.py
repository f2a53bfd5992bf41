"""Learned starts: their errors, and the classical setting with which they are compared."""

import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact import parallel
from deep_contact.starts.classical import NoStart

learned_starts = load_script("figure_6_8")
CLASSICAL, LEARNED, SOLVERS = learned_starts.CLASSICAL, learned_starts.LEARNED, learned_starts.SOLVERS


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_solution_as_a_start_has_no_error_and_sweeps_from_zero_lower_it(falling_states, solver):
    state = falling_states[6]
    exact = dc.solve_contacts(state, solver=dc.NNCG(sweeps=5000, tolerance=1e-9))
    given = {"exact": (exact.normal_impulses, exact.tangent_impulses), "none": NoStart()(state, None)}
    settings = {f"{start}, {solver}": (start, SOLVERS[solver]) for start in given}
    solved, errors = learned_starts.errors_of(state, given, settings, (0, 3, 30), exact).values()
    assert max(solved) < 1e-6
    assert errors[0] == pytest.approx(1.0, abs=0.02)  # nothing done yet
    assert errors[2] < errors[0]


def test_errors_on_scenes_name_every_setting():
    task = {"steps": 60, "every": 20, "after": [0, 3], "seed": parallel.seeds(1, 1)[0]}
    starts = {"none": "none", "builtin": "builtin"}
    few = learned_starts.errors_on_scene(task | {"starts": starts})
    assert few["errors"].keys() == set(learned_starts.settings_with(starts))
    assert all(np.shape(errors) == (len(few["step"]), 2) for errors in few["errors"].values())


def scenes_of(**errors):
    """Two scenes of two states, of which Builtin is off in one: errors of every setting after 0 and 10 sweeps."""
    base = np.array([[1.0, 0.5], [0.01, 0.005]])
    return [
        {"errors": {name: (factor * size * base).tolist() for name, factor in errors.items()}} for size in (1, 2, 3)
    ]


def test_the_best_classical_setting_is_chosen_after_the_fact():
    errors = {"builtin": 1.0, "builtin, NNCG": 0.5, "scaled, PSOR 1.3": 0.8, LEARNED: 0.6, f"{LEARNED}, NNCG": 0.4}
    errors |= {"builtin, PSOR adaptive": 0.1}  # a solver that is gone
    scenes = scenes_of(**errors)
    assert learned_starts.best_settings(scenes, CLASSICAL) == ["builtin, NNCG"] * 2
    np.testing.assert_allclose(learned_starts.ratios_to_best(scenes), 0.8)  # proportional: no spread
    means = (learned_starts.mean_errors(scenes, name) for name in (LEARNED, "builtin"))
    np.testing.assert_allclose(learned_starts.ratios_of(*means), 0.6)
    np.testing.assert_allclose(learned_starts.mean_errors(scenes, "builtin", "off")[0], [1.0, 0.5])
