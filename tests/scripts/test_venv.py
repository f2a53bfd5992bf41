"""Installing, and what compiling says of itself."""

import os
import shutil
import subprocess

import pytest
from conftest import ROOT, SCRIPTS

from deep_contact.compiled import announcement

PIP = """#!/bin/sh
case "$2" in venv) mkdir -p "$3/bin"; cp "$0" "$3/bin/python" ;;
pip) echo "a notice of pip" >&2; exit {status} ;; esac
"""


def install(folder, status, *extras):
    """Ensure an environment with some extras, one after the other; pip ends with this status."""
    (folder / "python").write_text(PIP.format(status=status))
    (folder / "python").chmod(0o755)
    shutil.copy(ROOT / "setup.cfg", folder)
    command = "; ".join(["set -e", f". {SCRIPTS / 'venv.sh'}", *(f"ensure_venv '{extra}'" for extra in extras)])
    environment = os.environ | {"DEEP_CONTACT_PYTHON": str(folder / "python"), "DEEP_CONTACT_VENV": ".venv"}
    return subprocess.run(["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.skipif(os.name != "posix", reason="a shell script")
@pytest.mark.parametrize("status", [0, 1])
def test_pip_is_heard_only_if_it_fails(tmp_path, status):
    done = install(tmp_path, status, "")
    assert done.stdout == "installing into .venv (a few minutes; TensorFlow is a few hundred MB)\n"
    assert (done.returncode, done.stderr) == ((0, "") if status == 0 else (1, "a notice of pip\n"))
    assert (tmp_path / ".venv" / "installed").exists() == (status == 0)


def test_what_is_installed_is_not_installed_again(tmp_path):
    """Extras one by one: documentation and tests share an environment."""
    done = install(tmp_path, 0, "[test,docs]", "[docs]", "", "[peers]")
    assert done.stdout.count("installing into .venv") == 2


def test_compiling_is_announced_once_and_only_where_physics_are_compiled():
    from numba import njit
    from numba.core import event

    one, two, other = (njit(lambda x, k=k: x + k) for k in range(3))
    one.py_func.__module__ = two.py_func.__module__ = "deep_contact.physics.engine"
    for functions, lines in (((other,), 0), ((one, two), 1), ((one,), 0)):
        said = []
        with event.install_listener("numba:compile", announcement(said.append)):
            for function in functions:
                function(1)
        assert len(said) == lines
