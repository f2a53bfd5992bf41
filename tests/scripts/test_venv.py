"""Installing, and what compiling says of itself."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import ROOT, SCRIPTS

from deep_contact.compiled import announced

PIP = """#!/bin/sh
case "$2" in venv) mkdir -p "$3/bin"; cp "$0" "$3/bin/python" ;;
pip) echo "a notice of pip" >&2; exit {status} ;; esac
"""


@pytest.mark.skipif(os.name != "posix", reason="a shell script")
@pytest.mark.parametrize("status", [0, 1])
def test_pip_is_heard_only_if_it_fails(tmp_path, status):
    (tmp_path / "python").write_text(PIP.format(status=status))
    (tmp_path / "python").chmod(0o755)
    shutil.copy(ROOT / "setup.cfg", tmp_path)
    command = f"set -e; . {SCRIPTS / 'venv.sh'}; ensure_venv ''"
    environment = os.environ | {"DEEP_CONTACT_PYTHON": str(tmp_path / "python"), "DEEP_CONTACT_VENV": ".venv"}
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.stdout == "installing into .venv (a few minutes; TensorFlow is a few hundred MB)\n"
    assert (done.returncode, done.stderr) == ((0, "") if status == 0 else (1, "a notice of pip\n"))
    assert Path(tmp_path / ".venv" / "installed").exists() == (status == 0)


def test_what_is_installed_is_not_installed_again(tmp_path):
    """Extras one by one: documentation and tests share an environment."""
    (tmp_path / "python").write_text(PIP.format(status=0))
    (tmp_path / "python").chmod(0o755)
    shutil.copy(ROOT / "setup.cfg", tmp_path)
    calls = "; ".join(f"ensure_venv '{extras}'" for extras in ("[test,docs]", "[docs]", "", "[peers]"))
    command = f". {SCRIPTS / 'venv.sh'}; {calls}"
    environment = os.environ | {"DEEP_CONTACT_PYTHON": str(tmp_path / "python"), "DEEP_CONTACT_VENV": ".venv"}
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.stdout.count("installing into .venv") == 2


def test_compiling_is_announced_once_and_only_where_something_is_compiled():
    from numba import njit

    said = []
    one, two = njit(lambda x: x + 1), njit(lambda x: x + 2)
    with announced(said.append):
        one(1), two(1)
    assert said == ["compiling, once"]
    with announced(said.append):
        one(1)
    one(1.0)
    assert len(said) == 1
