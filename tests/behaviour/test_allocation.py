"""Memory inside a run: workspaces are allocated before the first step, and no later step allocates more.

Numba's runtime counts what compiled code allocates. A run of any length allocates its workspaces and its results.
"""

import json

import pytest
from conftest import run_python

RUNS = {
    "PGS": "dict(solver=dc.PGS(sweeps=20))",
    "PGS without friction": "dict(solver=dc.PGS(sweeps=20), friction=0.0)",
    "PGS with islands": "dict(solver=dc.PGS(sweeps=20, islands=True))",
    "PGS with sleeping": "dict(solver=dc.PGS(sweeps=20), sleep=True)",
    "NNCG": "dict(solver=dc.NNCG(sweeps=20))",
    "NesterovPGS": "dict(solver=dc.NesterovPGS(sweeps=20))",
    "BatchedPGS": "dict(solver=dc.BatchedPGS(sweeps=20))",
}

CODE = f"""
import json
from numba.core.runtime import rtsys
import deep_contact as dc

def allocations(friction=0.5, **options):
    scene = dc.lattice_in_box(60, seed=1, friction=friction)
    start = dc.simulate(scene, steps=150, **options).state.replace(name="begin")  # of no run that a call takes over
    found = []
    for steps in (1, 1, 100):
        before = rtsys.get_allocation_stats().alloc
        run = dc.simulate(start, steps=steps, **options)
        found.append(rtsys.get_allocation_stats().alloc - before)
    return found, int(run.contacts[0])

print(json.dumps({{{", ".join(f"{name!r}: allocations(**{options})" for name, options in RUNS.items())}}}))
"""


@pytest.fixture(scope="module")
def allocations():
    """Name of a run -> (allocations in two runs of one step and one of a hundred, contacts of a step)."""
    return json.loads(run_python("-c", CODE, environment={"NUMBA_NRT_STATS": "1"}).stdout)


@pytest.mark.parametrize("name", RUNS)
def test_no_step_after_the_first_allocates(name, allocations):
    (first, second, hundred), contacts = allocations[name]
    assert contacts > 50
    assert 0 < first == second == hundred
