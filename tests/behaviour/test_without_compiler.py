"""The physics as plain Python, with Numba's compiler switched off, gives the golden runs: debuggers, coverage and
mutation testing rely on it."""

import pytest
from conftest import ROOT, TOOLS, run_python

from deep_contact.solvers import METHODS

RUNS = {
    "solvers": [f"pile, {name}" for name in (*METHODS, "two ω", "motion", "motion of substeps")],
    "what scenes have": [
        *("frictionless, PGS", "frictionless, motion", "elastic, PGS", "elastic, PSOR"),
        *("terrain, PGS", "fast, PGS", "drum, islands"),
    ],
    "starts and sleep": ["row, PGS, sleep", *(f"start, {name}" for name in ("none", "copy", "scaled", "sph"))],
}


@pytest.mark.parametrize("kind", RUNS)
def test_interpreted_functions_compute_what_the_compiled_ones_do(kind):
    run_python(TOOLS / "golden.py", *RUNS[kind], environment={"NUMBA_DISABLE_JIT": "1"})


ALONE = {
    "behaviour/test_pairs.py": "not (resting or solver1 or options1 or passes_through or energy[1 or energy[2)",
    "behaviour/test_rolling.py": "not (collapses or solver1 or solver2 or solver3 or energy[1)",
    "behaviour/test_driven_bounces.py": "25.0-0.5 and (Batched or PSOR or NNCG or Nesterov)",
    "behaviour/test_random_scenes.py": "not (4 or 5)",
    "behaviour/test_cooling_gas.py": "not haffs",
    "stepping/test_interface.py": "from_outside",
    "stepping/test_sleeping.py": "push or torque",
    "state/test_materials.py": "added",
}
"""File -> tests whose kinds of steps no other test compiles: without large piles, and without most of BatchedPGS."""


def test_kinds_of_steps_that_no_other_test_compiles_work_interpreted():
    """BatchedPGS divides by 0 in lanes that nothing uses."""
    which = " or ".join(f"({name.split('/')[1]} and {of})" for name, of in ALONE.items())
    options = "-q", "-n", "0", "-p", "no:cacheprovider", "-W", "ignore::RuntimeWarning", "-m", "", "-k", which
    files = (ROOT / "tests" / name for name in ALONE)
    run_python("-m", "pytest", *options, *files, environment={"NUMBA_DISABLE_JIT": "1"})
