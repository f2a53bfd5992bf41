"""A solver from outside the package, the example of the gallery: it runs, sleeps and is stored as the package's."""

import shutil
from dataclasses import dataclass

import numpy as np
import pytest
from conftest import ROOT, assert_same_bits, load_script

import deep_contact as dc
from deep_contact.compiled import code_cache
from deep_contact.solvers import METHODS, register, solver_from
from deep_contact.stepping.interface import SolverOptions


@pytest.fixture(scope="module")
def Twice():
    """A solver that sweeps twice for each sweep that is asked for."""
    return load_script("own_solver").Twice


@pytest.mark.slow  # a kind of step of its own; test_without_compiler.py runs it interpreted
def test_a_solver_from_outside_runs_sleeps_solves_and_is_written_to_files(Twice, tmp_path):
    scene = dc.circles_in_box(20, size=12.0, seed=1)
    toy = dc.simulate(scene, steps=200, solver=Twice(), sleep=True)
    pgs = dc.simulate(scene, steps=200, solver=dc.PGS(sweeps=40, tolerance=None), sleep=True)
    assert toy.contacts.max() > 15
    assert_same_bits(toy.state, pgs.state)
    np.testing.assert_array_equal(toy.theta, pgs.theta)
    assert toy.sweeps.max() == 20
    dc.write_state(tmp_path / "toy.xml", toy.state)
    assert dc.read_state(tmp_path / "toy.xml").solver == Twice()
    solution = dc.solve_contacts(toy.state, solver=Twice(sweeps=500))
    expected = dc.solve_contacts(toy.state, solver=dc.PGS(sweeps=1000, tolerance=None))
    np.testing.assert_array_equal(solution.velocities, expected.velocities)


def test_a_step_is_compiled_again_once_a_loop_has_changed(tmp_path):
    """A step imports no solver: loops are registered, and compiled into it."""
    package = tmp_path / "deep_contact"
    shutil.copytree(ROOT / "deep_contact", package, ignore=shutil.ignore_patterns("__pycache__"))

    def stamp():
        code_cache.source_stamp.cache_clear()
        code_cache._read.cache_clear()
        return code_cache.source_stamp(package / "stepping" / "algorithm.py", tmp_path)

    before = stamp()
    with (package / "solvers" / "psor.py").open("a") as file:
        file.write("# changed\n")
    assert stamp() != before


def test_another_solver_of_the_same_name_is_refused():
    @dataclass(frozen=True, kw_only=True)
    class PGS(SolverOptions):
        sweeps: int = 1

    with pytest.raises(ValueError, match="options: expected a new name"):
        register(PGS, lambda solver: None, ())


def test_options_without_those_of_stepping_are_refused():
    @dataclass(frozen=True)
    class Alone:
        sweeps: int = 1

    with pytest.raises(ValueError, match="options: expected a subclass of SolverOptions, got Alone"):
        register(Alone, lambda solver: None, ())


def test_every_solver_has_the_options_of_stepping_under_the_same_defaults():
    of_stepping = {"position_sweeps": 10, "substeps": 1, "most_substeps": None, "approach": 0.03, "slop": 1.0}
    for kind in METHODS.values():
        assert {name: getattr(kind(), name) for name in of_stepping} == of_stepping, kind
    assert dc.PSOR(substeps=2, most_substeps=8).motion_parts == 4


def test_islands_that_old_files_name_are_those_of_pgs_alone():
    assert solver_from("NNCG", {"islands": False, "sweeps": 7}) == dc.NNCG(sweeps=7)
    assert solver_from("PGS", {"islands": True}).islands
    with pytest.raises(ValueError, match="option of NNCG: expected"):
        solver_from("NNCG", {"islands": True})


def test_the_precision_that_old_files_name_is_double():
    assert solver_from("PSOR", {"omega": 1.5, "precision": "double"}) == dc.PSOR(omega=1.5)
    with pytest.raises(ValueError, match="precision: expected"):
        solver_from("PSOR", {"precision": "single"})


def test_the_threads_that_old_files_name_change_nothing():
    with pytest.raises(ValueError, match=r"option of PSOR: expected one of .*, got 'omga'; did you mean 'omega'"):
        solver_from("PSOR", {"omga": 1.5})
    assert solver_from("BatchedPGS", {"sweeps": 7, "threads": 2}) == dc.BatchedPGS(sweeps=7)
