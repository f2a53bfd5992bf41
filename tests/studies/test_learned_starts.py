"""Learned starts: what is interpolated, and what is compared."""

import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact.studies import learned_starts
from deep_contact.studies.learned_starts import BASE, CLASSICAL, LEARNED, SOLVERS, TIMED, parts_of
from deep_contact.warm_start import NoStart


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
    (few,) = learned_starts.errors_on_scenes(starts, options, 1, 1, lambda items, **_: items)
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
    np.testing.assert_allclose(learned_starts.ratios_to_best(scenes, LEARNED), 0.8)  # proportional: no spread
    means = (learned_starts.mean_errors(scenes, name) for name in (LEARNED, "builtin"))
    np.testing.assert_allclose(learned_starts.ratios_of(*means), 0.6)
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


def test_a_learned_start_that_reaches_an_error_on_half_of_the_states_alone_has_no_ratio():
    """One sweep takes 1 s, the start none; of four states the error is reached on two, by the learned start alone."""
    never, soon = [1.0, 1.0], [1.0, 0.01]
    errors = {name: [never] * 4 for name in TIMED} | {f"{LEARNED}, {BASE}": [soon, soon, never, never]}
    seconds = {"start_seconds": {name: [0.0] * 4 for name in (*CLASSICAL, LEARNED)}}
    pile = {"errors": errors, **seconds, "sweep_seconds": dict.fromkeys(("PGS", BASE, "NNCG", "NesterovPGS"), 1.0)}
    assert learned_starts.time_ratios([pile], (0, 10), 0.1).size == 0
    pile["errors"][f"{LEARNED}, {BASE}"] = [soon, soon, soon, never]
    np.testing.assert_array_equal(learned_starts.time_ratios([pile], (0, 10), 0.1), 0.0)
    assert learned_starts.median_with_interval(np.ones(9)) is None
    assert learned_starts.median_with_interval(np.ones(10)) == [1.0, 1.0, 1.0]


def test_break_even_counts_what_is_below_1_by_its_interval(monkeypatch):
    """Wins: whole intervals below 1; ties: intervals that hold 1. The price is that of the fewest circles."""
    script = load_script("figure_6_10")
    none, low, around, high = np.ones(3), np.full(12, 0.5), np.repeat([0.5, 2.0], 6), np.full(12, 2.0)
    ratios = [low, around, high, *[none] * (len(script.TOLERANCES) - 3)]
    piles = {
        n: [{"start_seconds": {LEARNED: [ms / 1e3]}, "sweep_seconds": {"PGS": 1e-4}}]
        for n, ms in ((100, 0.5), (1000, 9.0))
    }
    cases = {("resting", 1000): (piles[1000], ratios), ("falling", 100): (piles[100], [none] * len(ratios))}
    monkeypatch.setattr(script, "cases", lambda data: cases)
    wins, price = script.claims(None)
    assert {name: wins.measured[name] for name in ("cases", "wins", "ties")} == {"cases": 3, "wins": 1, "ties": 1}
    assert wins.measured["best"][0] == {"where": "1000, resting, 0.5", "ratio": 0.5, "from": 0.5, "to": 0.5}
    assert wins.holds
    assert (price.holds, price.measured) == (True, {"ms": 0.5})
    cases["falling", 100][0][0]["start_seconds"][LEARNED] = [0.51e-3]
    assert [*script.claims(None)][1].holds is False
