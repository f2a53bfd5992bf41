"""What a first run compiles is counted, and does not grow unnoticed."""

import sys

import llvmlite
import numba
import numpy as np
import pytest
from conftest import ROOT, load_script

from deep_contact.compiled import njit

if numba.config.DISABLE_JIT:
    pytest.skip("nothing is compiled", allow_module_level=True)

compile_cost = load_script("compile_cost")

COUNTS = {
    "pile": (110, 154, 104_740),
    "bounces": (211, 293, 236_005),
}
"""Kind -> functions, modules and lines, by Python 3.11 and the versions of constraints.txt."""

VERSIONS = {f"{one.__name__}=={one.__version__}" for one in (numba, llvmlite, np)}
same_versions = pytest.mark.skipif(
    sys.version_info[:2] != (3, 11) or not VERSIONS <= {*(ROOT / "constraints.txt").read_text().split()},
    reason="counts are of other versions",
)


@njit
def third(x):
    return x / 3.0


@njit
def two_thirds(x):
    return third(x) + third(x)


def test_the_tool_counts_what_a_call_compiles():
    njit(lambda x: -x)(1.0)  # since the first of all functions brings a module of Numba's along
    for expected in ({"third": (1, 1), "two_thirds": (1, 2)}, {}):  # the function that Python calls has a wrapper
        counted, _ = compile_cost.count(lambda: two_thirds(1.0))
        names = {name.rpartition(".")[2]: name for name in counted.versions}
        assert {one: (counted.versions[name], counted.modules[name]) for one, name in names.items()} == expected
        assert all(20 < counted.lines[name] < 500 for name in names.values())


@pytest.mark.slow
@same_versions
@pytest.mark.parametrize("kind", COUNTS)
def test_a_first_run_compiles_no_more_than_it_did(kind):
    """Within a tenth. Where it is less on purpose, write the new counts: `python tests/tools/compile_cost.py`."""
    assert compile_cost.sums_of(compile_cost.cost(kind)) == pytest.approx(COUNTS[kind], rel=0.1)
