"""Machine code for a target processor, and the wheel that brings it."""

import subprocess
import sys
import sysconfig

import pytest
from conftest import ROOT, run_python
from llvmlite.binding import get_host_cpu_features
from numba import config

from deep_contact import compiled

TARGET = "x86-64-v3"
CAN_RUN = all(get_host_cpu_features().get(name) for name in compiled._NEEDED[TARGET])

FIRST_STEPS = """
from numba.core import event
import deep_contact as dc
from deep_contact.stepping.algorithm import advance
class Heard(event.Listener):
    count = 0
    def on_start(self, event): self.count += event.data["dispatcher"].py_func.__module__.startswith("deep_contact")
    def on_end(self, event): pass
heard = Heard()
event.register("numba:compile", heard)
dc.simulate(dc.circles_in_box(20), steps=3, accuracy="fast")
dc.simulate(dc.terrain(20), steps=3, accuracy="fast")
dc.simulate(dc.drum(20, froude=0.5), steps=3, accuracy="fast")
print(heard.count, advance.stats.cache_hits.total(), dc.__file__)
"""
"""A program that prints how many functions of the package Numba compiles for three kinds of scenes."""


@pytest.fixture
def no_target(monkeypatch):
    monkeypatch.setattr(config, "CPU_NAME", None)
    monkeypatch.setattr(config, "CPU_FEATURES", None)


@pytest.mark.skipif(not CAN_RUN, reason=f"this processor does not run code for {TARGET}")
def test_a_file_names_the_target_of_a_wheel(tmp_path, no_target):
    (tmp_path / "target.txt").write_text(f"{TARGET}\n")
    compiled.use_target(tmp_path / "target.txt")
    assert (config.CPU_NAME, config.CPU_FEATURES) == (TARGET, "")


def test_a_processor_that_lacks_a_feature_compiles_for_itself(tmp_path, no_target, monkeypatch):
    (tmp_path / "target.txt").write_text(TARGET)
    monkeypatch.setattr(compiled, "get_host_cpu_features", lambda: {"avx2": True, "fma": False})
    compiled.use_target(tmp_path / "target.txt")
    assert config.CPU_NAME is None


def test_a_checkout_names_no_target_and_the_variable_goes_first(tmp_path, no_target, monkeypatch):
    compiled.use_target(tmp_path / "target.txt")
    assert config.CPU_NAME is None
    (tmp_path / "target.txt").write_text(TARGET)
    monkeypatch.setattr(config, "CPU_NAME", "x86-64-v2")
    compiled.use_target(tmp_path / "target.txt")
    assert config.CPU_NAME == "x86-64-v2"


@pytest.mark.slow
@pytest.mark.skipif(not CAN_RUN or sys.platform != "linux", reason=f"builds a wheel for {TARGET} on Linux")
def test_a_wheel_that_brings_its_code_compiles_nothing(tmp_path):
    subprocess.run(["bash", ROOT / "scripts" / "wheel_with_code.sh", tmp_path], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    folder = tmp_path / "installed"
    install = "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", folder, wheel
    run_python(*install)
    paths = f"{folder}:{sysconfig.get_path('purelib')}"
    environment = {"PYTHONPATH": paths, "NUMBA_CACHE_DIR": ""}
    said = run_python("-c", FIRST_STEPS, environment=environment, cwd=tmp_path).stdout
    functions, hits, place = said.split()
    assert place.startswith(str(folder))
    assert int(functions) == 0
    assert int(hits) > 0
