"""A process that is forked after a team of threads has run."""

import os
import subprocess
import sys

import pytest

FORK_AFTER_THREADS = """
import multiprocessing

import deep_contact as dc

PILE = dc.lattice_in_box(900, gap=0.01, seed=1)


def team(_):
    solver = dc.BatchedPGS(sweeps=5, threads=2)
    return float(dc.simulate(PILE, steps=3, solver=solver).state.bodies.position[:, 1].sum())


if __name__ == "__main__":
    here = team(0)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        there = pool.map_async(team, [0]).get(timeout=120)[0]
    print(here == there == team(0))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_process_that_is_forked_after_threads_have_run_lives(tmp_path):
    script = tmp_path / "fork.py"
    script.write_text(FORK_AFTER_THREADS)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300)
    assert done.stdout.strip() == "True", done.stderr
