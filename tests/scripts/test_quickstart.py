"""The first output that anybody sees: one screen of our own lines."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, SCRIPTS, load_script

from deep_contact.compiled import announced


@pytest.fixture
def quickstart(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    module = load_script("quickstart")
    monkeypatch.setattr(module, "SCENE", {"n_bodies": 20, "size": 14.0})
    small = module.SCENE | {"steps": 120, "sweeps": 60, "scenes": 1, "velocity_sweeps": [3, 10, 30]}
    monkeypatch.setattr(module, "SETTINGS", small)
    return module


def test_the_quickstart_prints_one_screen(quickstart, tmp_path, capsys):
    assert quickstart.main(["--out", str(tmp_path)]) == 0
    printed = [line for line in capsys.readouterr().out.splitlines() if line != "compiling, once"]
    assert len(printed) == 9
    assert all(len(line) <= 120 for line in printed[:8])  # the last one names a path
    assert printed[0].startswith("a pile: 20 circles, ")
    verdicts = ("  as in the reference run, ", "  too few states to tell: ")
    assert all(line.startswith(verdicts) for line in printed[4:8])
    assert printed[8].startswith(f"picture: {tmp_path / 'quickstart.png'}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["quickstart.json", "quickstart.png"]
    quickstart.main(["--out", str(tmp_path), "--verbose"])
    assert len(capsys.readouterr().out.splitlines()) > 20


def test_the_quickstart_needs_no_tensorflow(tmp_path):
    code = "import sys, quickstart as q\nq.SETTINGS.update(steps=120, sweeps=30)\n"
    code += "q.main(['--out', sys.argv[1]]); assert 'tensorflow' not in sys.modules"
    path = os.pathsep.join([str(SCRIPTS), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert done.returncode == 0, done.stderr
    assert not [line for line in done.stderr.splitlines() if "scenes and starts" not in line and line.strip()]


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
