"""The benchmarks run, on small piles, and their files have what the documentation's tables read."""

import numpy as np
import pytest
from conftest import load_script

from deep_contact import figures

benchmark = load_script("benchmark")


@pytest.fixture
def run(tmp_path):
    def run(name, **options):
        return figures.produce(benchmark.FIGURES[name], options=options, quick=True, out=tmp_path)

    return run


@pytest.mark.peers
def test_engines_are_compared(run):
    pytest.importorskip("Box2D")
    pytest.importorskip("pymunk")
    pytest.importorskip("pyb2d3")
    found = run("engine", sizes=[20], repeats=1)
    assert [case["kind"] for case in found["data"]["cases"]] == ["settled", "falling"]
    for case in found["data"]["cases"]:
        assert set(case["engines"]) == set(benchmark.ENGINES)
        assert all(cost["step_us"] > 0 for cost in case["engines"].values())
        assert set(case["ratios"]) == set(benchmark.PEERS)
    assert {claim["text"] for claim in found["claims"]} < benchmark.GOALS.keys()


@pytest.mark.peers
def test_ways_to_step_are_timed_beside_busy_processes(run):
    pytest.importorskip("Box2D")
    pytest.importorskip("pymunk")
    pytest.importorskip("pyb2d3")
    quiet, busy = run("live", sizes=[10], busy=[0, 1], work=50, repeats=2)["data"]["runs"]
    assert (quiet["busy"], busy["busy"]) == (0, 1)
    for us in (quiet["us"], busy["us"]):
        assert {"one call", "Simulator", "on_step", "simulate, one step each", *benchmark.DEFAULTS} == us.keys()
        assert all(0 < least <= median <= most for least, median, most in us.values())


def test_costs_are_those_of_the_model():
    """t = overhead + cost k m: exact however the contacts differ between the blocks of 10 and of 100 sweeps."""
    contacts = np.array([700, 710, 740, 760])  # of all 4 steps of a block
    seconds = 4 * 30e-6 + 5e-9 * np.array(benchmark.BLOCKS) * contacts
    found = benchmark.costs(seconds, contacts, 4)
    expected = {"contacts": 2910 / 16, "sweep_ns": 5, "overhead_us": 30, "step_us": 30 + 5e-3 * 10 * 1460 / 8}
    assert found == pytest.approx(expected)
