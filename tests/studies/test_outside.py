"""The comparison on matrices: fair forms of one problem, one judge, profiles by hand, sequences that come back."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.io.fclib import write_fc2d
from deep_contact.physics import metrics
from deep_contact.physics.exact import solve_exactly
from deep_contact.physics.lcp import check_problem, contact_problem
from deep_contact.studies import mujoco_piles, outside


def test_the_padded_problem_is_the_same_with_a_tangent_that_meets_nothing(falling_states):
    problem = check_problem(contact_problem(falling_states[9]))
    W, q = outside.padded(problem)
    W, kept = W.toarray(), np.arange(q.size).reshape(-1, 3)
    np.testing.assert_array_equal(W[np.ix_(kept[:, :2].ravel(), kept[:, :2].ravel())], problem.A.toarray())
    third = kept[:, 2]
    np.testing.assert_array_equal(W[np.ix_(third, third)], np.diag(problem.A.diagonal()[1::2]))
    assert not W[np.ix_(kept[:, :2].ravel(), third)].any()
    assert not q[third].any()


def test_profile_by_hand():
    times = {"p": {"a": 1.0, "b": 3.0, "c": 0.1}, "q": {"a": 8.0, "b": 2.0, "c": 0.1}}
    errors = {"p": {"a": 0.0, "b": 0.0, "c": 1.0}, "q": {"a": 0.0, "b": 0.0, "c": 1.0}}
    # Within 1, 2, 5, 10, 100 times the fastest of those that solved it: a is 1 and 4 times, b 3 and 1; c solves none.
    expected = {"a": [0.5, 0.5, 1, 1, 1], "b": [0.5, 0.5, 1, 1, 1], "c": [0] * 5}
    assert outside.profile(times, errors, 1e-5) == expected


def test_ours_are_compared(falling_states, tmp_path):
    path = write_fc2d(tmp_path / "pile.dat.gz", falling_states[9])
    problems = outside.read_problems([path])
    found = outside.compare(problems, tolerance=1e-4, repeats=1)
    assert found["contacts"] == {"pile": falling_states[9].contacts.count}
    for name in ("PGS", "NNCG", "NesterovPGS"):
        assert found["error"]["pile"][f"ours, {name}"] <= 1e-4
        assert 0 < found["seconds"]["pile"][f"ours, {name}"] < 10
    assert set(found["missing"]) | set(found["seconds"]["pile"]) >= {f"Siconos {name}" for name in outside.SICONOS}
    assert [row[0] for row in outside.table(found)][1:5] == [f"ours, {name}" for name in outside.OURS]


def test_who_is_slow_is_left_out_of_larger_problems(falling_states, monkeypatch):
    problems = {str(k): check_problem(contact_problem(falling_states[k])) for k in (12, 2)}
    nothing = {"none": lambda problem, start: np.zeros(problem.b.size)}
    monkeypatch.setattr(outside, "methods", lambda tolerance: (nothing, {"other": "no module"}))
    found = outside.compare(problems, most=0.0)
    assert (found["error"]["12"]["none"], found["seconds"]["12"]["none"]) == (None, None)
    assert found["error"]["2"]["none"] > 0
    small, large = (f"{k}, {problems[k].friction.size} contacts" for k in ("2", "12"))
    head, row, last = outside.table(found)
    assert head == ["method", small, large]
    assert row[1].startswith("(")
    assert (row[0], row[2]) == ("none", "–")
    assert last == ["other", "left out: no module", ""]


def test_energy_error_is_the_velocity_error(falling_states):
    state = falling_states[9]
    reference, near = solve_exactly(state).solution, dc.solve_contacts(state, solver=dc.PGS(sweeps=3, tolerance=None))
    one, other = (np.column_stack([s.normal_impulses, s.tangent_impulses]).ravel() for s in (near, reference))
    expected = metrics.velocity_error(state, near, reference)
    assert outside.energy_error(contact_problem(state), one, other) == pytest.approx(expected, rel=1e-9)


def test_pinocchio_solves_to_the_error_that_is_asked_for(falling_states):
    pytest.importorskip("pinocchio", minversion="4", reason="needs pinocchio 4 of the extra rivals")
    problem = check_problem(contact_problem(falling_states[9]))
    solve = outside.pinocchio(1e-6)
    impulse = solve(problem, None)
    assert outside.siconos_error(problem, impulse) <= 1e-6
    assert outside.siconos_error(problem, solve(problem, impulse)) <= 1e-6


def test_mujoco_without_springs_is_the_convex_relaxation(falling_states):
    # As far from the exact solution, up to the share 1e-4 of the acceleration that its regularisation leaves.
    pytest.importorskip("mujoco", reason="needs the package mujoco of the extra rivals")
    pytest.importorskip("clarabel", reason="needs the package clarabel of the extra rivals")
    state = falling_states[9]
    exact = solve_exactly(state).solution
    world = mujoco_piles.MuJoCoPile(state, solver="Newton", **mujoco_piles.NO_SPRING)
    world.step()
    found = exact._replace(velocities=world.bodies().velocity, angular_velocities=world.bodies().spin)
    problem = check_problem(contact_problem(state))
    expected = outside.energy_error(problem, outside.relaxed(problem), _impulse(exact))
    assert metrics.velocity_error(state, found, exact) == pytest.approx(expected, rel=0.02)


def test_piles_in_mujoco_are_compared():
    pytest.importorskip("mujoco", reason="needs the package mujoco of the extra rivals")
    rows = mujoco_piles.compare([10], repeats=1, steps=2, settled=20)
    assert [row["engine"] for row in rows] == [*mujoco_piles.OURS, *mujoco_piles.MUJOCO]
    assert all(row["seconds"] > 0 and 0 <= row["deepest"] < 0.1 for row in rows)
    errors = {row["engine"]: row["velocity_error"] for row in rows}
    assert errors["ours, NNCG, 300 sweeps"] < 0.01 < errors["MuJoCo, Newton"]
    assert len(mujoco_piles.table(rows)) == 1 + len(rows)


def test_a_second_run_keeps_its_own_times_of_what_both_have():
    times = {"p": {"ours": 1.0, "Siconos": 3.0}}
    first = {
        "contacts": {"p": 4}, "tolerance": 1e-4, "seconds": times, "error": {"p": {"ours": 0.0, "Siconos": 0.0}},
        "profile": {"ours": [], "Siconos": []},
        "missing": {"pinocchio": "no module", "other": "no module"}, "provenance": {},
    }  # fmt: skip
    times = {"p": {"ours": 2.0, "pinocchio": 5.0}}
    errors = {"p": {"ours": 0.0, "pinocchio": 0.0}}
    second = first | {"seconds": times, "error": errors, "profile": {"ours": [], "pinocchio": []}}
    both = outside.with_second_run(first, second)
    assert both["seconds"]["p"] == {"ours": 1.0, "Siconos": 3.0, "ours, again": 2.0, "pinocchio": 5.0}
    assert both["missing"] == {"other": "no module"}
    # 5 s beside 2 s of ours are 2.5 times the fastest, on a machine that is half as fast.
    expected = {"ours": 1.0, "Siconos": 3.0, "pinocchio": 2.5}
    assert both["profile"] == {name: [float(t <= factor) for factor in outside.FACTORS] for name, t in expected.items()}
    with pytest.raises(ValueError, match="profile: expected one of ours, Siconos, got pinocchio"):
        outside.with_second_run(first, second | {"profile": {"pinocchio": []}})
    with pytest.raises(ValueError, match=r"tolerance: expected 0\.0001 as in"):
        outside.with_second_run(first, second | {"tolerance": 0.1})


def test_relaxation_without_friction_is_exact(frictionless_states):
    pytest.importorskip("clarabel", reason="needs the package clarabel of the extra rivals")
    state = frictionless_states[3]
    problem = check_problem(contact_problem(state))
    exact = solve_exactly(state, residual=1e-10).solution
    impulse = np.column_stack([exact.normal_impulses, exact.tangent_impulses]).ravel()
    assert outside.energy_error(problem, outside.relaxed(problem), impulse) < 1e-5


def test_a_sequence_is_written_and_scored(falling_states, tmp_path):
    states = falling_states[6:10]
    folder = outside.write_sequence(tmp_path / "sequence", states)
    solvers = {"NNCG": outside.ours("NNCG", 1e-6)}
    starts = outside.STARTS | {"solution": lambda problem, carried: solved[problem.friction.size]}
    solved = {}
    for state in states:
        found = solve_exactly(state).solution
        solved[state.contacts.count] = np.column_stack([found.normal_impulses, found.tangent_impulses]).ravel()
    found = outside.score_starts(folder, starts, tolerance=1e-6, solvers=solvers)["NNCG"]
    assert set(found) == {"none", "carried", "solution"}
    assert all(row["steps"] == 4 and row["unsolved"] == 0 and row["seconds"] > 0 for row in found.values())
    short = {"one": lambda problem, start: outside.solve_problem(problem, dc.PGS(sweeps=1, tolerance=None), start)[0]}
    found = outside.score_starts(folder, starts, tolerance=1e-6, solvers=short)["one"]
    assert found["solution"]["unsolved"] == 0 < found["none"]["unsolved"]


def test_the_scripts_run(tmp_path):
    root = Path(__file__).parents[2]

    def run(*arguments):
        return subprocess.run(
            [sys.executable, *map(str, arguments)], cwd=root, capture_output=True, text=True, check=True, timeout=300
        ).stdout

    folder = tmp_path / "sequence"
    assert "written: 3 problems" in run(
        "scripts/benchmark_starts.py", "write", folder, "--circles", 20, "--steps", 3, "--first", 150
    )
    assert "| ours, PGS |" in run("scripts/benchmark_starts.py", "score", folder, "--out", tmp_path)
    file = folder / "step_0000.hdf5"
    assert "ours, NNCG" in run("scripts/benchmark_outside.py", file, "--piles", "--repeats", 1, "--out", tmp_path)
    assert (tmp_path / "benchmark_outside.json").exists()
    assert (tmp_path / "benchmark_outside.png").stat().st_size > 10_000


def test_errors_of_the_relaxation_are_those_of_what_it_returns(monkeypatch):
    # Nothing done has an error of 1, the exact solution none.
    monkeypatch.setattr(outside, "relaxed", lambda problem: np.zeros(problem.b.size))
    rows = outside.relaxation_errors(["settling"], [20], [0.0, 0.5], states=2)
    assert [(row["kind"], row["circles"], row["friction"], row["states"]) for row in rows] == [
        ("settling", 20, 0.0, 2),
        ("settling", 20, 0.5, 2),
    ]
    np.testing.assert_allclose([row["errors"] for row in rows], 1.0)
    table = [["pile", "μ = 0", "μ = 0.5"], ["20 settling", "1.00, 1.00", "1.00, 1.00"]]
    assert outside.relaxation_table({"relaxation": rows}) == table
    assert outside.relaxation_table({"relaxation": [rows[0] | {"errors": [0.5]}]})[1][1] == "0.50, 0.50 (1 of 2)"
    monkeypatch.setattr(outside, "relaxed", lambda problem: _impulse(solve_exactly(problem).solution))
    (row,) = outside.relaxation_errors(["settling"], [20], [0.0], states=1)
    assert row["errors"][0] < 1e-4


def _impulse(solution):
    return np.column_stack([solution.normal_impulses, solution.tangent_impulses]).ravel()
