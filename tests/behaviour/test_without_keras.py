"""Everything but training, networks on images and bounds works where Keras, TensorFlow and HiGHS cannot be imported.

Programs are slow tests, because `tests/tools/check_core.sh` runs them in CI, where these packages are missing indeed.
"""

from configparser import ConfigParser

import pytest
from conftest import ROOT, run_python

PROGRAM = """
import sys

class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("keras", "tensorflow", "highspy"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hide())
import deep_contact as dc
from deep_contact.__main__ import main

run = dc.simulate(dc.column(3), steps=4, record=2)
state = run.state
dc.write_state("s.xml", state)
assert dc.read_state("s.xml") == state
run.trajectory.save("run.h5")
assert dc.load_trajectory("run.h5")[-1] == state
dc.solve_contacts(state, solver=dc.PGS(sweeps=5))
dc.recommend(state), dc.plan(state, warm_start="far field")
figure, ax = dc.plotting.subplots()
dc.plotting.draw_state(ax, state)
dc.plotting.save(figure, "s.png")
normal, tangent = dc.load_model("far field").predict(state)
assert normal.shape == (state.contacts.count,)
for start in ("far field", "sph"):
    dc.simulate(state, steps=1, solver=dc.PGS(sweeps=5), warm_start=start)
assert main(["predict", "s.xml", "--model", "far field"]) == 0
assert main(["figure", "5.3", "--quick"]) == 0
print("all of it")
def bounds():
    dc.force_bounds(state)

def train():
    from deep_contact.cnn.training import train

def start():
    dc.simulate(state, steps=1, warm_start="cnn")

for needs in (bounds, train, dc.load_model, start):
    try:
        needs()
    except ModuleNotFoundError as error:
        print(error)
print(*(main(words) for words in (
    ["figure", "4.2", "--quick"], ["predict", "s.xml"], ["simulate", "s.xml", "--warm-start", "cnn", "--steps", "1"]
)))
"""


@pytest.mark.slow
def test_what_needs_no_keras_works_without_it_and_what_needs_it_says_so(tmp_path):
    done = run_python("-c", PROGRAM, cwd=tmp_path)
    assert "all of it" in done.stdout
    *refused, statuses = done.stdout.partition("all of it\n")[2].splitlines()
    bounds, *refused = refused
    assert bounds == "highspy: expected the package, which force_bounds needs, got none: pip install highspy"
    said = "keras: expected the package, which training and networks on images need, got none: pip install keras tens"
    assert len(refused) == 3
    assert all(line.startswith(said) and 'the network "far field" needs neither' in line for line in refused)
    assert statuses == "4 4 4"
    for command in ("figure 4.2", "predict", "simulate"):
        assert f"{command}: {said}" in done.stderr


@pytest.mark.slow
def test_another_backend_of_keras_is_refused_in_a_line():
    arguments = "-m", "deep_contact", "figure", "4.2", "--quick"
    done = run_python(*arguments, environment={"KERAS_BACKEND": "jax"}, status=4)
    assert len(done.stderr.splitlines()) == 1
    assert "tensorflow: expected it as the backend of Keras" in done.stderr


def test_the_small_installation_is_all_but_networks_and_bounds():
    config = ConfigParser()
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    needed = {line for line in config["options"]["install_requires"].split("\n") if line}
    small = (ROOT / "requirements-core.txt").read_text(encoding="utf-8").splitlines()
    assert set(small[1:]) == {one for one in needed if one.split()[0] not in ("keras", "tensorflow", "highspy")}
    assert len(needed) - len(small[1:]) == 3
