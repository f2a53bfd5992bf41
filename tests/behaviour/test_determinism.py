"""Bit for bit: the same run in this process, in others, with compiled code cold or warm, from any kind of array.

Not promised, and not tested: other processors (fused operations and vector widths differ), other versions of Numba or
LLVM.
"""

import hashlib
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import run_python

import deep_contact as dc
from deep_contact.compiled import njit
from deep_contact.solvers import METHODS

PACKAGE = Path(dc.__file__).parent


def fingerprint(state):
    """SHA-256 of everything that a run has computed."""
    return hashlib.sha256(b"".join(array.tobytes() for array in (*state.bodies, *state.contacts))).hexdigest()


def run(seed, *, method="PGS"):
    """A short run of the thesis's scene; its fingerprint."""
    scene = dc.circles_in_box(40, seed=seed, restitution=0.2)
    return fingerprint(dc.simulate(scene, steps=120, solver=METHODS[method]()).state)


def in_another_process(seed, *, method="PGS", folder=None, **environment):
    """`run` in a process of its own that starts in a folder, whose package it then takes."""
    code = f"import test_determinism as t; print(t.run({seed}, method={method!r}))"
    paths = [*map(str, Path(__file__).parents[:2]), os.environ.get("PYTHONPATH", "")]
    environment |= {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    return run_python("-c", code, environment=environment, cwd=folder).stdout.strip()


@pytest.mark.parametrize("method", ["PGS", pytest.param("NNCG", marks=pytest.mark.slow)])
def test_another_process_with_other_threads_and_hash_seeds_computes_the_same(method):
    environment = {"NUMBA_NUM_THREADS": "1", "PYTHONHASHSEED": "7", "OMP_NUM_THREADS": "3"}
    assert in_another_process(5, method=method, **environment) == run(5, method=method)


@pytest.mark.parametrize("kind", ["strided", "big-endian", "list", "read-only", "Fortran"])
def test_the_kind_of_array_changes_nothing(kind):
    scene = dc.circles_in_box(30, seed=3)
    position = scene.bodies.position
    given = {
        "strided": np.repeat(position, 2, axis=0)[::2],
        "big-endian": position.astype(">f8"),
        "list": position.tolist(),
        "read-only": np.frombuffer(position.tobytes()).reshape(-1, 2),
        "Fortran": np.asfortranarray(position),
    }[kind]
    bodies = dc.make_bodies(given) if kind == "list" else scene.bodies._replace(position=given)
    other = scene.replace(bodies=bodies)
    one, two = (dc.simulate(s, steps=120, solver=dc.PGS(sweeps=50)).state for s in (scene, other))
    assert fingerprint(one) == fingerprint(two)


@pytest.mark.slow
def test_cold_and_warm_compiled_code_compute_the_same(tmp_path):
    # A copy of the package without any cache: compiled afresh, then loaded from its own cache.
    shutil.copytree(PACKAGE, tmp_path / "deep_contact", ignore=shutil.ignore_patterns("__pycache__"))
    cold = in_another_process(5, folder=tmp_path)
    assert list((tmp_path / "deep_contact" / "stepping" / "__pycache__").glob("algorithm.advance-*.nbi"))
    warm = in_another_process(5, folder=tmp_path)
    assert cold == warm == run(5)


def test_a_function_keeps_its_flags_whoever_calls_it_first():
    """With the flags of its first caller x y − z would be fused, which gives 2⁻⁶⁰ here. Unfused it gives 0."""

    @njit
    def product_and_difference(x, y, z):
        return x * y - z

    @njit(fastmath={"contract"})
    def caller(x, y, z):
        return product_and_difference(x, y, z)

    numbers = 1.0 + 2.0**-30, 1.0 + 2.0**-30, 1.0 + 2.0**-29
    caller(*numbers)
    assert product_and_difference(*numbers) == 0.0
