"""The record of where results come from."""

import importlib.metadata
import json
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import deep_contact
from deep_contact.io import provenance


def test_provenance_holds_seed_time_and_versions_and_names_no_place():
    found = provenance.provenance(seed=5, wall_s=0.25)
    assert found["seed"] == 5
    assert found["wall_s"] == 0.25
    assert found["packages"]["numpy"] == np.__version__
    text = json.dumps(found)
    assert str(Path(deep_contact.__file__).parents[1]) not in text
    assert platform.node() not in text.split('"')


def test_the_commit_is_the_checkout_s():
    here = Path(__file__)
    tracked = ["git", "ls-files", "--error-unmatch", here.name]  # sources within another project's checkout are not
    if shutil.which("git") is None or subprocess.run(tracked, cwd=here.parent, capture_output=True).returncode:
        pytest.skip("not a checkout")
    done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=here.parent, capture_output=True, text=True, check=True)
    assert provenance.commit().startswith(done.stdout.strip())


def test_without_git_there_is_no_commit(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert provenance.commit() == "unknown"
    assert provenance.provenance()["commit"] == "unknown"


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_a_package_outside_a_checkout_has_no_commit(tmp_path, monkeypatch):
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)  # a checkout, but not one that tracks the package
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "deep_contact" / "io" / "provenance.py"))
    assert provenance.commit() == "unknown"


def test_versions_are_known_without_importing_the_packages():
    code = "import sys; from deep_contact.io import provenance; provenance.provenance(); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & {"tensorflow", "keras", "numba", "scipy", "lxml", "matplotlib", "numpy"}


def test_a_package_that_is_not_installed_is_left_out(monkeypatch):
    def version(name):
        if name == "tensorflow-cpu":
            return "2.16"
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(provenance.metadata, "version", version)
    assert provenance.package_versions() == {"tensorflow": "2.16"}
