"""The record of where results come from."""

import json
import platform
import shutil
import subprocess
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


@pytest.mark.parametrize(
    ("of_python", "machine", "of_linux", "expected"),
    [
        ("any86", "m", None, "any86"),
        ("", "m", None, "m"),
        ("", "", None, "unknown"),
        ("any86", "m", "x\nmodel name\t: A CPU\nflags: y\nmodel name: B", "A CPU"),
        ("", "m", "no names", "m"),
    ],
)
def test_a_processor_has_the_name_that_the_system_knows(of_python, machine, of_linux, expected, monkeypatch):
    def read(path, **_):
        if of_linux is None:
            raise OSError
        return of_linux

    monkeypatch.setattr(platform, "processor", lambda: of_python)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(provenance.Path, "read_text", read)
    monkeypatch.setattr(provenance.os, "cpu_count", lambda: 3)
    assert provenance.processor() == f"{expected}, 3 cores"


def test_without_git_there_is_no_commit(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert provenance.commit() == "unknown"
    assert provenance.provenance()["commit"] == "unknown"


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_results_do_not_make_a_checkout_dirty_and_sources_do(tmp_path, monkeypatch):
    package, stored = tmp_path / "deep_contact", tmp_path / "data" / "reference" / "figure_3_7.json"
    for path in (package / "__init__.py", package / "io" / "provenance.py", stored):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("1")
    monkeypatch.setattr(provenance, "__file__", str(package / "io" / "provenance.py"))
    name = ["-c", "user.name=any", "-c", "user.email=any@example.org"]
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    assert provenance.commit() == "unknown"  # a checkout, but not one that tracks the package
    for command in (["add", "."], [*name, "commit", "-qm", "one"]):
        subprocess.run(["git", *command], cwd=tmp_path, check=True)
    done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=tmp_path, capture_output=True, text=True, check=True)
    clean = provenance.commit()
    assert clean == done.stdout.strip()
    stored.write_text("2")
    assert provenance.commit() == clean
    (package / "__init__.py").write_text("2")
    assert provenance.commit() == clean + "+changes"


def test_inputs_are_known_by_their_digests_wherever_the_options_name_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.h5").write_bytes(b"abc")
    abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-2, appendix B.1
    options = {"model": "a.h5", "more": {"x": ["a.h5", 3, None]}, "kernel": "poly6", "gone": "b.h5", "name": "e.g."}
    assert provenance.provenance(options=options)["inputs"] == {"a.h5": abc}
    assert "inputs" not in provenance.provenance()
