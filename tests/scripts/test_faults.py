"""Faults from outside: killed processes, full disks, folders that cannot be written, two processes in one
folder. Nothing corrupt stays, and nothing is lost beyond the unit in flight.

A killed data generation is in `test_dataset.py`, a killed training in `test_training.py`, an interrupted figure in
`test_figures.py`, a damaged part of a study in `test_run_study.py`, damaged machine code in `test_code_cache.py`.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import SCRIPTS, run_python

import deep_contact as dc
from deep_contact import figures
from deep_contact.io.state_xml import read_state

PACKAGE = Path(dc.__file__).parent
POSIX = pytest.mark.skipif(os.name != "posix", reason="signals and limits as POSIX has them")


@pytest.fixture
def state():
    return dc.simulate(dc.column(4), steps=3).state


def visible(folder):
    """Names in a folder that a user, or a reader that globs, would see."""
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


# ---- killed ----

WRITE_FOREVER = """
import sys, itertools
from pathlib import Path
import deep_contact as dc
scene = dc.circles_in_box(30, seed=1)
for step in itertools.count():
    dc.write_state(Path(sys.argv[1]) / "state.xml", scene.replace(step=step))
    print(step, flush=True)
"""


@POSIX
@pytest.mark.parametrize("moment", [0.0, 0.0007, 0.0031])
def test_a_process_killed_while_it_writes_leaves_the_last_whole_file(tmp_path, moment):
    process = subprocess.Popen([sys.executable, "-c", WRITE_FOREVER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        for _ in range(5):
            written = int(process.stdout.readline())
        time.sleep(moment)
    finally:
        process.kill()
        process.wait()
    assert visible(tmp_path) == ["state.xml"]
    assert read_state(tmp_path / "state.xml").step >= written


KILLED_STUDY = """
import os, signal, sys
from pathlib import Path
from deep_contact.studies.runs import done

def compute(n_bodies, k):
    print(k, flush=True)
    if k == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
    return {"k": k}

parts = [{"n_bodies": 1, "k": k} for k in range(4)]
found = done("part", compute, parts, work=Path(sys.argv[1]), jobs=1)
assert found == [{"k": k} for k in range(4)]
"""


@POSIX
def test_a_killed_study_loses_the_part_in_flight(tmp_path):
    assert run_python("-c", KILLED_STUDY, tmp_path, 2, status=-signal.SIGKILL).stdout.split() == ["0", "1", "2"]
    assert run_python("-c", KILLED_STUDY, tmp_path, -1).stdout.split() == ["2", "3"]


# ---- no room, no rights ----

WRITERS = {
    "xml": "dc.write_state(out / 'it.xml', big)",
    "h5": "cnn.write_simulation(out / 'it.h5', [big], compression=None)",
    "png": "plotting.save(plotting.subplots()[0], out / 'it.png')",
    "model.h5": "model_file.save_model(out / 'it.model.h5', model, spec, {})",
}

FULL = """
import resource, sys
from pathlib import Path
import numpy as np
import deep_contact as dc
from deep_contact.plot import plotting
from deep_contact import cnn
from deep_contact.stepping.prepare import ready
out = Path(sys.argv[1])
big = ready(dc.lattice_in_box(1000))
{prepare}
plotting.subplots()  # loads what it needs, which may write caches of its own
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    {write}
except OSError as error:
    print(type(error).__name__, error)
"""

PREPARE = {
    "model.h5": """
from deep_contact.cnn import model_file, registry
network, spec, _ = model_file.read_model(registry.network_file("far field"))
model = network.build()
model.to_json()"""
}


@POSIX
@pytest.mark.parametrize("suffix", [pytest.param(one, marks=[pytest.mark.slow] * (one != "xml")) for one in WRITERS])
def test_a_full_disk_is_an_oserror_that_leaves_the_old_file_and_nothing_else(tmp_path, suffix):
    # A limit on the size of files stands for the disk: a write beyond 4 KB fails as ENOSPC does, part way through.
    old = tmp_path / f"it.{suffix}"
    old.write_bytes(b"old")
    code = FULL.format(write=WRITERS[suffix], prepare=PREPARE.get(suffix, ""))
    assert run_python("-c", code, tmp_path).stdout.startswith("OSError [Errno 27]")
    assert old.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == [old.name]


def test_a_figure_refuses_a_folder_that_cannot_be_written_before_it_computes(tmp_path, capsys):
    (tmp_path / "taken").write_text("a file")
    never = figures.Figure(id="T 9.6", title="Never", compute=lambda *_: pytest.fail("computed"), table=lambda data: [])
    with pytest.raises(SystemExit, match="2"):
        figures.main(never, ["--out", str(tmp_path / "taken" / "figures")])
    assert "--out: expected a folder that can be written, got" in capsys.readouterr().err


@POSIX
@pytest.mark.slow
def test_training_survives_a_full_disk_and_two_processes_in_one_folder(tmp_path):
    import resource

    few = "--simulations 5 --steps 170 --bodies 8 9 --jobs 1".split()
    run_python(SCRIPTS / "generate_data.py", *few, "--out", tmp_path / "data")
    tiny = "--batch-size 8 --fractions 0.6 0.2 0.2 --held-out 5 --threads 1 --rate 0.01 --options width=2".split()
    tiny += ["--data", tmp_path / "data", "--schedule", "constant"]  # of which a run may be prolonged

    def train(out, epochs, **options):
        command = [sys.executable, SCRIPTS / "train.py", "--out", tmp_path / out, "--epochs", epochs, *tiny]
        return subprocess.Popen(list(map(str, command)), stderr=subprocess.PIPE, text=True, **options)

    def epochs_of(out):
        return [line.split(",")[:3] for line in (tmp_path / out / "history.csv").read_text().splitlines()]

    assert train("alone", 3).wait(300) == 0
    assert train("run", 1).wait(300) == 0
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    full = train("run", 3, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)))
    message = full.communicate(timeout=300)[1]
    assert full.returncode != 0
    assert "File too large" in message
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before
    both = [train("run", 3), train("run", 3)]
    assert [process.wait(300) for process in both] == [0, 0]
    assert epochs_of("run") == epochs_of("alone")


# ---- two at once ----

SAME_FOLDER = """
import sys
from pathlib import Path
import deep_contact as dc
scene = dc.circles_in_box(30, seed=int(sys.argv[2]))
for step in range(60):
    dc.write_state(Path(sys.argv[1]) / "state.xml", scene.replace(step=step))
"""


def test_two_processes_that_write_one_file_leave_one_whole(tmp_path):
    command = [sys.executable, "-c", SAME_FOLDER, str(tmp_path)]
    both = [subprocess.Popen([*command, seed]) for seed in ("1", "2")]
    until = time.monotonic() + 60
    while any(process.poll() is None for process in both):
        assert time.monotonic() < until
        if (tmp_path / "state.xml").exists():
            assert read_state(tmp_path / "state.xml").bodies.count == 30  # whole at any moment
    assert [process.returncode for process in both] == [0, 0]
    assert [path.name for path in tmp_path.iterdir()] == ["state.xml"]


@pytest.mark.slow
def test_two_processes_that_generate_into_one_folder_make_what_one_makes(tmp_path):
    command = [sys.executable, SCRIPTS / "generate_data.py", "--steps", "150", "--bodies", "8", "9", "--jobs", "1"]
    command += ["--simulations", "3", "--out"]
    subprocess.run([*command, tmp_path / "alone"], check=True, timeout=600, capture_output=True)
    both = [subprocess.Popen([*command, tmp_path / "both"], stderr=subprocess.DEVNULL) for _ in range(2)]
    assert [process.wait(600) for process in both] == [0, 0]
    alone, found = ({p.name: p.read_bytes() for p in (tmp_path / k).iterdir()} for k in ("alone", "both"))
    assert found == alone
