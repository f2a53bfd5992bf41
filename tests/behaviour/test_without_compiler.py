"""The physics as plain Python, with Numba's compiler switched off, gives the golden runs: debuggers, coverage and
mutation testing rely on it."""

import pytest
from conftest import ROOT, TOOLS, run_python

from deep_contact.solvers import METHODS

RUNS = {
    "solvers": [f"pile, {name}" for name in (*METHODS, "two ω", "motion")],
    "what scenes have": ["frictionless, PGS", "elastic, PGS", "terrain, PGS", "fast, PGS", "drum, islands"],
    "starts and sleep": ["row, PGS, sleep", *(f"start, {name}" for name in ("none", "copy", "scaled", "sph"))],
}


@pytest.mark.parametrize("kind", RUNS)
def test_interpreted_functions_compute_what_the_compiled_ones_do(kind):
    run_python(TOOLS / "golden.py", *RUNS[kind], environment={"NUMBA_DISABLE_JIT": "1"})


@pytest.mark.parametrize(
    ("name", "slowest"),
    [
        ("test_pairs.py", "resting or solver1 or options1"),
        ("test_rolling.py", "collapses or solver1"),
        ("test_random_scenes.py", "4 or 5"),
        ("test_cooling_gas.py", "haffs"),
    ],
)
def test_laws_of_materials_hold_in_interpreted_steps(name, slowest):
    """Without large piles and most runs of BatchedPGS. It divides by 0 in lanes that nothing uses."""
    options = "-q", "-n", "0", "-p", "no:cacheprovider", "-W", "ignore::RuntimeWarning", "-k", f"not ({slowest})"
    run_python("-m", "pytest", *options, ROOT / "tests" / "behaviour" / name, environment={"NUMBA_DISABLE_JIT": "1"})
