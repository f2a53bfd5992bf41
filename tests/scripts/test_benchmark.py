"""The benchmarks run, on small piles, and their files have what the documentation's tables read."""

import json

import numpy as np
import pytest
from conftest import load_script

from deep_contact.physics.lcp import check_problem, contact_problem, siconos_error
from deep_contact.studies import rivals

benchmark = load_script("benchmark")


@pytest.fixture
def run(tmp_path):
    def run(name, *arguments):
        path = tmp_path / f"{name}.json"
        benchmark.main([name, *map(str, arguments), "--out", str(path)])
        return json.loads(path.read_text(encoding="utf-8"))

    return run


@pytest.mark.peers
def test_engines_are_compared(run):
    pytest.importorskip("Box2D")
    pytest.importorskip("pymunk")
    pytest.importorskip("pyb2d3")
    found = run("engine", "--sizes", 20, "--repeats", 1, "--quick")
    assert [case["kind"] for case in found["data"]["cases"]] == ["settled", "falling"]
    for case in found["data"]["cases"]:
        assert set(case["engines"]) == set(benchmark.ENGINES)
        assert all(cost["step_us"] > 0 for cost in case["engines"].values())
        assert set(case["ratios"]) == set(benchmark.PEERS)
    assert {claim["text"] for claim in found["claims"]} < benchmark.GOALS.keys()


def test_steps_are_timed_as_users_run_them(run):
    found = run("step", "--sizes", 20, "--repeats", 1, "--quick")["data"]
    assert [row["kind"] for row in found["runs"]] == ["settled", "falling"]
    assert all(us > 0 for row in found["runs"] for us in row["us"].values())
    assert set(found["many"]["us"]) == {"bare", "one core", "all cores"}


def write_fc2d(path, state):
    """The contact problem of a state as Siconos's text, W dense by columns."""
    problem = contact_problem(state)
    W = problem.A.toarray()
    numbers = np.concatenate([W.ravel("F"), problem.b, problem.friction]).tolist()
    path.write_text("\n".join(map(repr, [2, len(W) // 2, 0, *W.shape, *numbers])))
    return path


def test_solvers_are_compared_on_files_and_piles_and_a_second_run_is_added(run, falling_states, tmp_path):
    path = write_fc2d(tmp_path / "pile.dat", falling_states[9])
    command = ("outside", path, "--sizes", "--repeats", 1, "--tolerance", 1e-4)
    first = run(*command, "--only", "ours, PGS")
    assert first["contacts"]["pile"] == falling_states[9].contacts.count
    both = run(*command, "--only", "ours, PGS", "ours, NesterovPGS", "--add")
    assert set(both["seconds"]["pile"]) == {"ours, PGS", "ours, PGS, again", "ours, NesterovPGS"}
    assert both["seconds"]["pile"]["ours, PGS"] == first["seconds"]["pile"]["ours, PGS"] > 0
    assert all(error <= 1e-4 for row in both["error"].values() for error in row.values())
    with pytest.raises(ValueError, match="tolerance: expected"):
        run(*command[:-1], 1e-5, "--add")


def test_who_is_slow_is_left_out_of_larger_problems(run, falling_states, tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "MOST", 0.0)
    files = [write_fc2d(tmp_path / f"pile_{k}.dat", falling_states[k]) for k in (12, 2)]
    found = run("outside", *files, "--sizes", "--only", "ours, PGS")
    small, large = found["seconds"].values()
    assert small["ours, PGS"] > 0
    assert large["ours, PGS"] is None


def test_costs_are_those_of_the_model():
    """t = overhead + cost k m: exact however the contacts differ between the blocks of 10 and of 100 sweeps."""
    contacts = np.array([700, 710, 740, 760])  # of all 4 steps of a block
    seconds = 4 * 30e-6 + 5e-9 * np.array(benchmark.BLOCKS) * contacts
    found = benchmark.costs(seconds, contacts, 4)
    expected = {"contacts": 2910 / 16, "sweep_ns": 5, "overhead_us": 30, "step_us": 30 + 5e-3 * 10 * 1460 / 8}
    assert found == pytest.approx(expected)


def test_the_padded_problem_is_the_same_with_a_tangent_that_meets_nothing(falling_states):
    problem = check_problem(contact_problem(falling_states[9]))
    W, q = rivals.padded(problem)
    W, kept = W.toarray(), np.arange(q.size).reshape(-1, 3)
    np.testing.assert_array_equal(W[np.ix_(kept[:, :2].ravel(), kept[:, :2].ravel())], problem.A.toarray())
    third = kept[:, 2]
    np.testing.assert_array_equal(W[np.ix_(third, third)], np.diag(problem.A.diagonal()[1::2]))
    assert not W[np.ix_(kept[:, :2].ravel(), third)].any()
    assert not q[third].any()


@pytest.mark.parametrize("name", ["siconos", "pinocchio"])
def test_rivals_solve_to_the_error_that_is_asked_for(name, falling_states):
    pytest.importorskip(name, minversion="4" if name == "pinocchio" else None)
    problem = check_problem(contact_problem(falling_states[9]))
    solve = rivals.pinocchio(1e-6) if name == "pinocchio" else rivals.siconos("NSGS", 1e-6)
    assert siconos_error(problem, solve(problem)) <= 1e-6
