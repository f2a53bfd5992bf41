"""A solver from outside the package: one file of options, settings, loop and one registration, as the registry says."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest
from conftest import assert_same_bits
from numba import njit

import deep_contact as dc
from deep_contact.physics.contact_solver import sweep
from deep_contact.physics.convergence import is_over
from deep_contact.physics.solvers import Loop, register, solver_from
from deep_contact.physics.solvers.registry import tolerance_argument


@dataclass(frozen=True, kw_only=True)
class ToyPGS:
    """Two sweeps of PGS for each that is asked for. Weakness: every second sweep is not counted."""

    sweeps: int = 20
    tolerance: float | None = None
    position_sweeps: int = 10


class ToySettings(NamedTuple):
    tolerance: float


@njit
def make_counter(rows, solver_bodies):
    return np.zeros(1, np.int64)


@njit
def relax_toy(settings, rows, friction, solver_bodies, theta, workspace):
    for k in range(theta.shape[0]):
        for _ in range(2):
            theta[k] = sweep(rows, friction, solver_bodies)
            workspace[0] += 1
        if is_over(theta[k], settings.tolerance):
            return k + 1
    return theta.shape[0]


@pytest.fixture(scope="module", autouse=True)
def toy():
    loop = Loop(ToySettings, relax_toy, make_counter)
    register(ToyPGS, lambda solver: ToySettings(tolerance_argument(solver)), (loop,))


def test_a_solver_from_outside_runs_sleeps_solves_and_is_written_to_files(tmp_path):
    scene = dc.circles_in_box(20, size=12.0, seed=1)
    toy = dc.simulate(scene, steps=200, solver=ToyPGS(), sleep=True)
    pgs = dc.simulate(scene, steps=200, solver=dc.PGS(sweeps=40, tolerance=None), sleep=True)
    assert toy.contacts.max() > 15
    assert_same_bits(toy.state, pgs.state)
    np.testing.assert_array_equal(toy.theta, pgs.theta)
    assert toy.sweeps.max() == 20
    dc.write_state(tmp_path / "toy.xml", toy.state)
    assert dc.read_state(tmp_path / "toy.xml").solver == ToyPGS()
    solution = dc.solve_contacts(toy.state, solver=ToyPGS(sweeps=500))
    expected = dc.solve_contacts(toy.state, solver=dc.PGS(sweeps=1000, tolerance=None))
    np.testing.assert_array_equal(solution.velocities, expected.velocities)


def test_another_solver_of_the_same_name_is_refused():
    @dataclass(frozen=True)
    class PGS:
        sweeps: int = 1

    with pytest.raises(ValueError, match="options: expected"):
        register(PGS, lambda solver: ToySettings(0.0), ())


def test_the_precision_that_old_files_name_is_double():
    assert solver_from("PSOR", {"omega": 1.5, "precision": "double"}) == dc.PSOR(omega=1.5)
    with pytest.raises(ValueError, match="precision: expected"):
        solver_from("PSOR", {"precision": "single"})
