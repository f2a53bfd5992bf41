"""Numba's threads and processes that are forked after they have run."""

import os
import subprocess
import sys

import pytest

FORK_AFTER_THREADS = """
import multiprocessing
import sys

import deep_contact as dc

SOLVER = dc.BatchedPGS(sweeps=5, order="colours", threads=2)
PILE = dc.lattice_in_box(900, gap=0.01, seed=1)


def height(_):
    return float(dc.simulate(PILE, steps=3, solver=SOLVER).state.bodies.position[:, 1].sum())


if __name__ == "__main__":
    here = height(0)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        there = pool.map_async(height, [0]).get(timeout=120)[0]
    print(here == there == height(0))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_process_that_is_forked_after_threads_have_run_lives(tmp_path):
    script = tmp_path / "fork.py"
    script.write_text(FORK_AFTER_THREADS)
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_THREADING_LAYER"}
    environment |= {"NUMBA_NUM_THREADS": "2"}
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300, env=environment)
    assert done.stdout.strip() == "True", done.stderr
