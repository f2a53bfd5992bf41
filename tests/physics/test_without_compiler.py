"""The physics as plain Python, with Numba's compiler switched off, against the compiled one: debuggers, coverage and
mutation testing rely on it."""

import os
from pathlib import Path

import numpy as np
import pytest
from conftest import run_python

import deep_contact as dc
from deep_contact.physics.solvers import METHODS

CASES = {
    **{name: {"solver": method(sweeps=12)} for name, method in METHODS.items()},
    "PSOR, two ω": {"solver": dc.PSOR(sweeps=12, omega=1.8, friction_omega=1.4)},
    "islands": {"solver": dc.PGS(sweeps=12, islands=True)},
    "sleep": {"solver": dc.PGS(sweeps=12), "sleep": True, "steps": 70},
    **{f"start {name}": {"solver": dc.PGS(sweeps=12), "warm_start": name} for name in (None, "copy", "scaled", "sph")},
    "no friction": {"solver": dc.PGS(sweeps=12), "friction": 0.0},
    "segments": {"solver": dc.PGS(sweeps=12), "steps": 60},
}
"""Options of `simulate`, and the friction of the scene."""


def simulated(name):
    """Everything that a short run of nine falling circles computes, of a column that falls asleep, or of a terrain."""
    options = {"steps": 15, **CASES[name]}
    friction = options.pop("friction", 0.5)
    scene = dc.column(3) if "sleep" in options else dc.lattice_in_box(9, gap=0.01, friction=friction)
    if name == "segments":
        scene = dc.terrain(9, bumps=5, gap=0.01, seed=1)
        scene.bodies.velocity[:3] = [0.0, -120.0]  # fast
    run = dc.simulate(scene, **options)
    assert name != "segments" or (run.state.contacts.body_b >= 13).any()
    assert run.contacts.max() >= 3
    return [*run.state.bodies, *run.state.contacts, run.contacts, run.sweeps, run.theta]


def write_all(folder):
    """Write every case into a file of the folder; one that fails leaves its error instead."""
    for number, name in enumerate(CASES):
        try:
            np.savez(Path(folder, f"{number}.npz"), *simulated(name))
        except Exception as error:
            Path(folder, f"{number}.txt").write_text(f"{type(error).__name__}: {error}")


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory):
    """A folder with what each case computes without the compiler."""
    folder = tmp_path_factory.mktemp("interpreted")
    paths = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
    code = f"import test_without_compiler as t; t.write_all({str(folder)!r})"
    run_python("-c", code, environment={"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": paths})
    return folder


@pytest.mark.parametrize("name", CASES)
def test_interpreted_functions_compute_what_the_compiled_ones_do(interpreted, name):
    stem = str(list(CASES).index(name))
    error = interpreted / f"{stem}.txt"
    assert not error.exists(), error.read_text()
    # The compiler may fuse a multiplication and an addition, which changes the last bits.
    with np.load(interpreted / f"{stem}.npz") as found:
        for key, wanted in zip(found, simulated(name), strict=True):
            np.testing.assert_allclose(found[key], wanted, rtol=1e-9, atol=1e-9, err_msg=key)
