"""Learned starts: what is interpolated, what is compared, and that a setting is judged as the engine steps it."""

import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact.studies import learned_starts
from deep_contact.studies.learned_starts import BASE, CLASSICAL, LEARNED, SOLVERS, TIMED, parts_of
from deep_contact.warm_start import NoStart

TASK = {"circles": 30, "seed": 4, "steps": 60, "every": 10, "past_need": 200, "sweeps": 8, "start": "builtin"}


def test_sweeps_to_an_error_lie_between_the_counts_by_the_logarithm():
    sweeps = (0, 10, 20, 40)
    errors = [10.0 ** (-k / 10) for k in sweeps]
    for error, expected in ((1.0, 0.0), (10**-1.5, 15.0), (10**-3.0, 30.0), (1e-5, np.inf)):
        assert learned_starts.sweeps_to(errors, sweeps, error) == pytest.approx(expected)
    assert learned_starts.sweeps_to([0.05, 0.5, 0.05], (0, 10, 20), 0.1) > 10  # it has to stay within
    assert learned_starts.sweeps_to([0.05, 0.05, 0.5], (0, 10, 20), 0.1) == np.inf


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_solution_as_a_start_has_no_error_and_sweeps_from_zero_lower_it(falling_states, solver):
    state = falling_states[6]
    exact = dc.solve_contacts(state, solver=dc.NNCG(sweeps=5000, tolerance=1e-9))
    given = {"exact": (exact.normal_impulses, exact.tangent_impulses), "none": NoStart()(state, None)}
    names = [f"{start}, {solver}" for start in given]
    solved, errors = learned_starts.errors_of(state, given, names, (0, 3, 30), [exact]).values()
    assert max(solved) < 1e-6
    assert errors[0] == pytest.approx(1.0, abs=0.02)  # nothing done yet
    assert errors[2] < errors[0]


def test_errors_on_scenes_name_every_setting():
    options = {"scenes": 1, "steps": 60, "every": 20, "after": [0, 3]}
    starts = {"none": "none", "builtin": "builtin"}
    kinds = [{}, {"circles": [12, 12], "dt": 0.005, "columns": 3}]
    chosen = {"several": ["builtin"], "kinds": kinds}
    found = learned_starts.errors_on_scenes(starts, options, 1, 1, lambda items, **_: items, **chosen)
    (few,) = found[1]
    assert few["errors"].keys() == {"none", "builtin", *(f"builtin, {name}" for name in learned_starts.FOLLOWING[1:])}
    assert all(np.shape(errors) == (len(few["step"]), 2) for errors in few["errors"].values())
    assert max(step for scene in found[1] for step in scene["step"]) > 60  # twice the steps of half of Δt


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
    np.testing.assert_allclose(learned_starts.ratios_to_best(scenes, LEARNED), 0.8)  # proportional: no spread
    np.testing.assert_allclose(learned_starts.ratios_to_builtin(scenes, LEARNED), 0.6)
    np.testing.assert_allclose(learned_starts.mean_errors(scenes, "builtin", "off")[0], [1.0, 0.5])


def test_a_learned_start_is_timed_against_the_best_classical_setting():
    # Two states; a sweep takes 1 s with PGS and with PSOR, 2 s with the others. Error 10^(-k / 10) after k sweeps with
    # PGS, with PSOR in half as many; the learned start saves PSOR two sweeps and takes 1 s.
    sweeps = [0, 10, 20]
    slow, fast = [10.0 ** (-k / 10) for k in sweeps], [10.0 ** (-k / 5) for k in sweeps]
    errors = {name: [fast if parts_of(name)[1] == BASE else slow] * 2 for name in TIMED}
    errors[f"{LEARNED}, {BASE}"] = [[10.0 ** (-(k + 2) / 5) for k in sweeps]] * 2
    pile = {
        "errors": errors,
        "start_seconds": {name: [float(name == LEARNED)] * 2 for name in (*CLASSICAL, LEARNED)},
        "sweep_seconds": {"PGS": 1.0, BASE: 1.0, "NNCG": 2.0, "NesterovPGS": 2.0},
    }
    name, seconds = learned_starts.best_timed([pile], sweeps, CLASSICAL, 0.01)
    assert name == f"none, {BASE}"
    np.testing.assert_allclose(seconds, 10.0)
    ratios = learned_starts.time_ratios([pile], sweeps, 0.01)
    np.testing.assert_allclose(ratios, (1.0 + 8.0) / 10.0)
    assert learned_starts.time_ratios([pile], sweeps, 1e-9).size == 0
    assert learned_starts.median_with_interval(ratios) is None
    np.testing.assert_allclose(learned_starts.median_with_interval(np.tile(ratios, 5)), 0.9)
    assert learned_starts.price_of([pile]) == {"ms": 1000.0, "in sweeps": 1.0}


def test_an_error_between_two_times_lies_on_the_line_of_logarithms():
    # e = 1 / t²: 0.25 at t = 2, 0.0625 at t = 4.
    curve = {"seconds": [1.0, 4.0], "errors": [[1.0, 2.0], [0.0625, 0.125]]}
    np.testing.assert_allclose(learned_starts.error_at(2.0, curve), [0.25, 0.5])
    np.testing.assert_allclose(learned_starts.error_at(9.0, curve), curve["errors"][1])
    assert learned_starts.error_at(0.1, curve) is None  # less time than the fewest sweeps take


def test_settings_are_compared_at_the_time_of_the_base():
    def curve(*rows):
        sweeps, seconds, errors = zip(*rows)
        return {"sweeps": list(sweeps), "seconds": list(seconds), "errors": [[e, e] for e in errors]}

    base, single, learned = f"builtin, {BASE}", "builtin, PSOR 1.7", f"{LEARNED}, {BASE}"
    curves = {base: curve((10, 2.0, 0.4), (20, 3.0, 0.2)), single: curve((10, 2.0, 0.5), (20, 3.0, 0.1))}
    # Half a unit dearer: the time of 10 sweeps is too short for it.
    curves[learned] = curve((10, 2.5, 0.3), (20, 3.5, 0.15))
    first, second = learned_starts.at_equal_times({"30": curves}, [10, 20])
    assert (first["best"], second["best"]) == (base, single)
    assert first["errors"][learned] is None
    right = np.exp(np.interp(np.log(3.0), np.log([2.5, 3.5]), np.log([0.3, 0.15])))
    assert second["errors"][learned][0] == pytest.approx(right)
    won, own, swept = load_script("figure_6_12").claims({"columns": [10, 20], "runs": {"30": curves}})
    assert (won.holds, won.measured["wins"], won.measured["cells"], won.measured["too slow"]) == (False, 0, 2, 1)
    # In the time of 10 sweeps of its own, against the better of two lines of logarithms.
    found = own.measured["30 circles, time of 10 sweeps"]
    share = np.log(2.5 / 2.0) / np.log(3.0 / 2.0)
    assert found["ratio"] == pytest.approx(0.3 / min(0.4 ** (1 - share) * 0.2**share, 0.5 ** (1 - share) * 0.1**share))
    np.testing.assert_allclose(swept.measured["30 circles, 20 sweeps"], 0.75)


@pytest.mark.parametrize("start", ["none", "builtin", "scaled"])
def test_more_sweeps_leave_less_error_along_a_run(start):
    task = TASK | {"setting": f"{start}, {BASE}", "start": start}
    few, many = (learned_starts.error_along_run(task | {"sweeps": sweeps}) for sweeps in (8, 400))
    assert 0.0 < few < 1.5
    assert many < 0.1 * few
