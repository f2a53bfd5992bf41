"""The golden runs of `tests/tools/golden.py`: to the bit on the processor of the file, elsewhere within 1e-9."""

from functools import partial
from itertools import product

import pytest
from conftest import load_script

golden = load_script("golden")


SCENES, SOLVERS = ("frictionless", "elastic", "gas", "drum", "hopper"), ("islands", "NesterovPGS", "NNCG")
RARE = {f"{scene}, {solver}" for scene, solver in product(SCENES, SOLVERS)} | {
    "frictionless, PSOR",
    "frictionless, motion",
    "elastic, PSOR",
    "row, islands, sleep",
    "pile, NesterovPGS",
    "pile, motion of substeps",
}
"""Runs whose kinds no other test compiles, which takes ten seconds each."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in RARE)) for name in golden.RUNS]
)
def test_a_run_is_what_it_was(name):
    assert golden.difference(name) == ""


def test_the_file_has_the_runs_and_those_that_share_their_bits():
    record, numbers = golden.stored()
    assert record["runs"].keys() == golden.RUNS.keys()
    assert numbers.keys() == {name for name, run in golden.RUNS.items() if not run.same_as}
    for name, run in golden.RUNS.items():
        assert not run.same_as or record["runs"][name]["sha256"] == record["runs"][run.same_as]["sha256"]


@pytest.mark.parametrize("share", [1e-15, 1e-7])
def test_a_small_change_is_told_from_rounding(share, monkeypatch):
    monkeypatch.setattr(golden, "machine", lambda: "another")
    found = golden.difference("elastic, motion", partial(golden.moved, share=share))
    assert bool(found) == (share > 1e-9)


def test_on_the_same_processor_a_bit_is_found(monkeypatch):
    monkeypatch.setattr(golden, "machine", lambda: golden.stored()[0]["machine"])
    assert golden.difference("elastic, motion", golden.moved).startswith("elastic, motion: ")
