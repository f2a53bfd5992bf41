"""The package's types as a user's type checker sees them: the examples of the documentation pass."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
from conftest import ROOT

from deep_contact import warm_start
from deep_contact.accuracy import presets

pytest.importorskip("mypy")

PAGES = ("README.md", "docs/guide.md", "docs/starts.md", "docs/solvers.md")

WRONG = """
import deep_contact as dc

state = dc.column(3)
state.contacts.count  # a scene has none yet
dc.simulate(state).state.contacts.count
dc.simulate(state, step=3)
state.time = 1.0
dc.PGS(sweeps="many")
dc.step(state, warm_start="buildin")
dc.solve_contacts(state, start="SPH")
dc.simulate(state, accuracy="quick")
dc.recommend(state, accuracy="best")
dc.simulate_many([state], warm_start="sph")
dc.plan(state, warm_start="cn")
dc.warm_start.Sph(transfer="splines")
"""


def blocks(page):
    """The Python of a page, one program: its blocks share their names."""
    return "\n".join(re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(encoding="utf-8"), re.M | re.S))


@pytest.mark.slow  # tests/tools/check_wheel.sh has two type checkers read a program of a user
def test_the_examples_pass_a_type_checker_and_mistakes_do_not(tmp_path):
    for example in (ROOT / "docs" / "gallery").glob("*.py"):
        shutil.copy(example, tmp_path)
    for page in PAGES:
        (tmp_path / f"page_{Path(page).stem.lower()}.py").write_text(blocks(page), encoding="utf-8")
    (tmp_path / "wrong.py").write_text(WRONG, encoding="utf-8")
    # The package is read as an installed one is: its own lines are not reported.
    silent = "[mypy]\nallow_redefinition = true\n[mypy-deep_contact.*]\nfollow_imports = silent\n"
    for package in ("distributed", "meshio", "pandas"):  # of the extra `docs`, which tests do without
        silent += f"[mypy-{package}.*]\nignore_missing_imports = true\n"
    (tmp_path / "mypy.ini").write_text(silent, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "--no-error-summary"]
    command += ["--cache-dir", str(ROOT / "build" / "mypy"), "."]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env=os.environ | {"MYPYPATH": str(ROOT)}
    )
    found = done.stdout.splitlines()
    wrong = [line for line in found if line.startswith("wrong.py")]
    assert [line for line in found if line not in wrong] == [], done.stderr
    assert [int(line.split(":")[1]) for line in wrong if " error: " in line] == [5, *range(7, 17)]


def test_names_that_a_checker_knows_are_those_that_there_are():
    assert get_args(presets.Accuracy) == tuple(presets.PRESETS)
    assert get_args(warm_start.Name) == tuple(warm_start.STARTS)
