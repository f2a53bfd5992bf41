"""Processes that are forked after threads have run: a team's, and Numba's."""

import os
import subprocess
import sys

import pytest

FORK_AFTER_THREADS = """
import multiprocessing

import numpy as np

import deep_contact as dc
from deep_contact.cnn.convolution import Program, dimensions
from deep_contact.cnn.model_file import weights_of

PILE = dc.lattice_in_box(900, gap=0.01, seed=1)


def team(_):
    solver = dc.BatchedPGS(sweeps=5, threads=2)
    return float(dc.simulate(PILE, steps=3, solver=solver).state.bodies.position[:, 1].sum())


def network(_):
    weights = weights_of(dc.load_model().source)
    program = Program(weights, (65, 65), threads=2)
    return float(program(np.ones((65, 65, dimensions(weights)[0]), np.float32)).sum())


if __name__ == "__main__":
    here = WORK(0)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        there = pool.map_async(WORK, [0]).get(timeout=120)[0]
    print(here == there == WORK(0))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.parametrize("work", ["team", "network"])
def test_a_process_that_is_forked_after_threads_have_run_lives(tmp_path, work):
    script = tmp_path / "fork.py"
    script.write_text(FORK_AFTER_THREADS.replace("WORK", work))
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_THREADING_LAYER"}
    environment |= {"NUMBA_NUM_THREADS": "2"}
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300, env=environment)
    assert done.stdout.strip() == "True", done.stderr
