"""Recommendations for single steps: what they choose from a study, and what they say."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.physics import metrics
from deep_contact.physics.solvers import describe
from deep_contact.recommendation import steps as advice
from deep_contact.studies import tradeoff


def row(setting, kind, error, us, *, n_bodies=100, sweeps=10, tolerance=None):
    return {
        "n_bodies": n_bodies, "kind": kind, "states": 4, "left_out": 0, "setting": setting, "start": "builtin",
        "budget": {"sweeps": sweeps, "tolerance": tolerance}, "velocity": {"p50": error / 2, "p95": error},
        "sweeps": sweeps, "us": us,
    }  # fmt: skip


def table(*rows):
    settings = {"PGS": {"method": "PGS"}, "over": {"method": "PSOR", "omega": 1.5, "start": "none"}}
    return {"data": {"rows": list(rows), "settings": settings}, "provenance": {"cpu": "a processor"}}


TABLE = table(
    row("PGS", "falling", 0.05, 10.0), row("PGS", "resting", 0.001, 10.0),
    row("PGS", "falling", 0.004, 90.0, sweeps=500), row("PGS", "resting", 0.0001, 90.0, sweeps=500),
    row("over", "falling", 0.008, 20.0, tolerance=1e-3), row("over", "resting", 0.009, 20.0, tolerance=1e-3),
    row("over", "falling", 0.008, 1.0, sweeps=3),
)  # fmt: skip


def test_the_fastest_within_the_error_of_every_kind_is_chosen():
    scene = dc.circles_in_box(50)
    found = advice.recommend_step(scene, velocity_error=0.01, table=TABLE)
    # Not the one of 1 μs, which was measured on one kind only; and the tolerance in weights of this scene.
    np.testing.assert_allclose(found.solver.tolerance, 1e-3 * np.pi * 9.81 * 0.01, rtol=1e-12)
    assert (type(found.solver), found.solver.omega, found.warm_start, found.us) == (dc.PSOR, 1.5, "none", 20.0)
    assert (found.measured, found.reached) == (0.009, True)
    assert advice.recommend_step(scene, velocity_error=0.1, table=TABLE).solver == dc.PGS(sweeps=10, tolerance=None)
    assert advice.recommend_step(scene, velocity_error=0.005, table=TABLE).solver == dc.PGS(sweeps=500, tolerance=None)


def test_out_of_reach_is_said():
    found = advice.recommend_step(dc.column(3), velocity_error=1e-6, table=TABLE)
    assert not found.reached
    assert found.measured == 0.004
    assert "does not reach 1e-06" in str(found)


def test_the_nearest_size_counts_by_ratio():
    rows = [row("PGS", "falling", 0.01, us, n_bodies=n) for n, us in ((100, 1.0), (1000, 10.0))]
    for n, expected in ((30, 100), (300, 100), (330, 1000), (5000, 1000)):
        assert advice.recommend_step(dc.lattice_in_box(n), velocity_error=0.1, table=table(*rows)).n_bodies == expected


def test_a_recommendation_tells_its_cost_and_what_it_was_measured_on():
    text = str(advice.recommend_step(dc.column(3), velocity_error=0.01, table=TABLE))
    for part in ("PSOR(tolerance=", "from none", "20 μs a step of 100 circles", "measured on 8 states", "a processor"):
        assert part in text.replace("sweeps=10, ", "")


def test_recommendations_are_read_from_the_study_in_the_package():
    assert "velocity error" in str(dc.recommend(dc.circles_in_box(30), velocity_error=0.1))


@pytest.mark.parametrize("error", [0, 2, True])
def test_bad_errors_are_refused(error):
    with pytest.raises(ValueError, match=rf"velocity_error: expected a number above 0, up to 1, got {error}"):
        dc.recommend(dc.column(2), velocity_error=error)


def test_pareto_front_has_what_nothing_beats():
    points = [(1.0, 5.0), (2.0, 6.0), (2.0, 3.0), (4.0, 3.0), (5.0, 1.0)]
    assert tradeoff.pareto(points) == [0, 2, 4]


def test_installed_rows_keep_all_kinds_of_a_budget_on_a_front():
    rows = [row("PGS", "falling", 0.1, 1.0), row("PGS", "resting", 0.1, 5.0), row("over", "resting", 0.01, 1.0)]
    slow = [row("over", kind, 0.2, 9.0, sweeps=99) for kind in ("falling", "resting")]
    assert tradeoff.installed(rows + slow) == rows


def test_condensed_rows_cost_overhead_and_sweeps():
    # 20 contacts, 10 sweeps, 5 ns and 7 μs of overhead: 8 μs.
    item = {
        "sweeps": 10,
        "tolerance": None,
        "velocity": [0.1, 0.3],
        "residual": [1, 1],
        "approach": [1, 1],
        "done": [10, 10],
    }
    settings = {name: {"sweeps": [item], "tolerance": []} for name in tradeoff.SETTINGS}
    pile = {"kind": "falling", "n_bodies": 9, "contacts": 20.0, "states": 2, "left_out": 1, "settings": settings}
    cost = {"n_bodies": 9, "overhead_us": 7.0, "sweep_ns": dict.fromkeys(tradeoff.SETTINGS, 5.0)}
    found = tradeoff.condensed([pile], [cost])[0]
    assert (found["us"], found["velocity"], found["sweeps"]) == (8.0, {"p50": 0.3, "p95": 0.3}, 10.0)


def test_small_study_of_a_pile(monkeypatch):
    monkeypatch.setattr(tradeoff, "SETTINGS", {name: tradeoff.SETTINGS[name] for name in ("PGS", "NNCG")})
    found = tradeoff.solution_errors(
        "falling", 40, 1, states=1, sweeps=[2, 200], tolerances=[1e-3], past_need=5000, exact=True
    )
    assert found["states"] + found["left_out"] == 1
    few, many = found["settings"]["PGS"]["sweeps"]
    assert np.median(many["velocity"]) < 0.2 * np.median(few["velocity"])
    assert found["settings"]["NNCG"]["tolerance"][0]["done"][0] < 200


def test_a_tolerance_ends_where_its_theta_says(monkeypatch):
    # The course far past need tells after how many sweeps a tolerance is met: the solver stops there by itself.
    monkeypatch.setattr(tradeoff, "SETTINGS", {"NNCG": tradeoff.SETTINGS["NNCG"]})
    found = tradeoff.solution_errors(
        "settling", 40, 1, states=2, sweeps=[300], tolerances=[0.1, 1e-9], past_need=5000, exact=True
    )
    states = tradeoff.states_of(tradeoff.pile("settling", 40, 1), count=2)
    loose, tight = found["settings"]["NNCG"]["tolerance"]
    for k, state in enumerate(states):
        solver = dc.NNCG(sweeps=300, tolerance=0.1 * advice.weight_impulse(state))
        assert loose["done"][k] == dc.solve_contacts(state, solver=solver).record.sweeps < 300
    assert tight["done"] == [300, 300]


def test_a_margin_asks_for_a_smaller_error():
    scene = dc.circles_in_box(50)
    found = advice.recommend_step(scene, velocity_error=0.01, table=tradeoff.with_margin(TABLE, 2.0))
    assert (found.measured, found.reached, found.margin) == (0.004, True, 2.0)
    assert not advice.recommend_step(scene, velocity_error=0.01, table=tradeoff.with_margin(TABLE, 3.0)).reached
    assert "margin of 2" in str(found)
    assert "margin" not in str(advice.recommend_step(scene, velocity_error=0.01, table=TABLE))


def test_the_least_margin_that_keeps_the_promise():
    def row(asked, margin, velocity, reached=True):
        return {"asked": asked, "margin": margin, "reached": reached, "velocity": velocity}

    good, bad = [0.05] * 19 + [0.2], [0.05] * 18 + [0.2] * 2
    rows = [row(0.1, 1.0, bad), row(0.1, 2.0, good), row(0.01, 1.0, [0.001] * 20), row(0.01, 2.0, [9.0], reached=False)]
    assert tradeoff.met(rows[:1]) == {0.1: 0.9}
    assert tradeoff.least_margin(rows) == 2.0
    assert tradeoff.least_margin(rows[:1]) is None


def test_recommendations_are_judged_on_other_scenes(monkeypatch):
    monkeypatch.setattr(tradeoff, "SETTINGS", {name: tradeoff.SETTINGS[name] for name in ("PGS", "NNCG")})
    options = {
        "states": 1,
        "asked": [0.05, 1e-6],
        "margins": [1.0, 2.0],
        "past_need": 5000,
        "exact": True,
        "table": TABLE,
    }
    rows = tradeoff.recommended_errors("resting", 40, 3, **options)
    assert [(row["asked"], row["margin"], row["reached"]) for row in rows] == [
        (0.05, 1.0, True), (0.05, 2.0, True), (1e-6, 1.0, False), (1e-6, 2.0, False)
    ]  # fmt: skip
    by_hand = advice.recommend_step(tradeoff.pile("resting", 40, 3), velocity_error=0.05, table=TABLE)
    assert rows[0]["solver"] == describe(by_hand.solver)
    assert all(len(row["velocity"]) == 1 for row in rows)


def test_references_solve_the_problem_and_differ():
    state = tradeoff.states_of(tradeoff.pile("settling", 150, 2), count=1)[0]
    ends = tradeoff.courses(state, 300, tradeoff.REFERENCES)
    assert max(metrics.residual(state, end) for end in ends.values()) > 1e-6
    found = tradeoff.references_from(state, ends.values(), exact=True)
    assert 1 <= len(found) <= 3
    assert max(metrics.residual(state, solution) for solution in found) <= 1e-8
    twice = tradeoff.references_from(state, [found[0], found[0]], exact=True)
    assert len(twice) == 1


def test_ends_that_are_not_solved_are_no_references():
    state = tradeoff.states_of(tradeoff.pile("falling", 40, 2), count=1)[0]
    ends = [dc.solve_contacts(state, solver=dc.PGS(sweeps=k, tolerance=None)) for k in (1, 5000)]
    assert metrics.residual(state, ends[0]) > tradeoff.ENOUGH
    found = tradeoff.references_from(state, ends, exact=False)
    assert [solution is ends[1] for solution in found] == [True]


def test_the_exact_solver_is_best_where_sweeps_do_not_get_there():
    def row(us, p50):
        return {"n_bodies": 9, "kind": "settling", "setting": "PGS", "us": us, "velocity": {"p50": p50, "p95": p50}}

    exact = {"n_bodies": 9, "kind": "settling", "seconds": [2e-4, 1e-4, 3e-4], "residual": [1e-9, 0.0, 1e-9]}
    data = {"rows": [row(50.0, 0.1), row(900.0, 0.01)], "exact": [exact]}
    data["costs"] = [{"n_bodies": 9, "overhead_us": 5.0}]
    assert tradeoff.best_within(data, 9, "settling", 0.1) == {"setting": "PGS", "us": 50.0, "error": 0.1}
    assert tradeoff.best_within(data, 9, "settling", 0.01) == {"setting": "exact", "us": 205.0, "error": 0.0}
    exact["residual"][1] = 1e-3
    assert tradeoff.best_within(data, 9, "settling", 0.01)["setting"] == "PGS"
    assert tradeoff.best_within(data, 9, "settling", 0.001) is None


def test_out_of_reach_the_fastest_near_the_best_is_taken_by_what_half_of_the_states_keep():
    def candidate(us, worst, median):
        return {"us": us, "worst": worst, "median": median}

    rough, near = candidate(1, 0.5, 0.1), candidate(2, 0.14, 0.1)
    halfway, best = candidate(5, 0.14, 0.01), candidate(9, 0.1, 0.001)
    assert advice._nearly([rough, near, halfway, best], 0.02) == [halfway, best]
    assert advice._nearly([rough, near, halfway, best], 1e-4) == [near, halfway, best]
