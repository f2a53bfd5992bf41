"""Faults from outside: killed processes, full disks, folders that cannot be written, damaged compiled code,
two processes in one folder, clocks that go back. Nothing corrupt stays, and nothing is lost beyond the unit in flight.

A killed data generation is in `test_dataset.py`, an interrupted figure in `test_figures.py`.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import deep_contact as dc
from deep_contact import code_cache, figures, results
from deep_contact.code_cache import drop_damaged_code, drop_stale_code, note_code
from deep_contact.state_xml import read_state, write_state

PACKAGE = Path(dc.__file__).parent
POSIX = pytest.mark.skipif(os.name != "posix", reason="signals and limits as POSIX has them")


def run(code, *arguments, **options):
    """A Python process that runs the code; its result."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **options)


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


KILLED_FIGURE = """
import os, signal, sys
from deep_contact import figures, results

def compute(options, seed, jobs, progress):
    return {"x": [1.0]}

def draw(data, options):
    from deep_contact import plotting
    if len(sys.argv) > 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return plotting.subplots()[0]

FIGURE = figures.Figure(id="9.8", title="Killed", compute=compute, table=lambda data: [["x"]], draw=draw)
raise SystemExit(figures.main(FIGURE, sys.argv[1:3]))
"""


@POSIX
def test_a_figure_killed_while_it_draws_keeps_its_numbers_and_draws_again(tmp_path):
    assert run(KILLED_FIGURE, "--out", tmp_path, "die").returncode == -signal.SIGKILL
    assert visible(tmp_path) == ["figure_9_8.json"]
    assert results.read_results(tmp_path / "figure_9_8.json")["data"] == {"x": [1.0]}
    assert run(KILLED_FIGURE, "--out", tmp_path).returncode == 0
    assert visible(tmp_path) == ["figure_9_8.json", "figure_9_8.png"]


# ---- no room, no rights ----

WRITERS = {
    "xml": "dc.write_state(out / 'it.xml', big)",
    "xml.gz": "dc.write_state(out / 'it.xml.gz', big)",
    "json": "results.write_results(out / 'it.json', found)",
    "h5": "dataset.write_simulation(out / 'it.h5', [big], compression=None)",
    "png": "plotting.save(plotting.subplots()[0], out / 'it.png')",
}

FULL = """
import resource, sys
from pathlib import Path
import numpy as np
import deep_contact as dc
from deep_contact import plotting, results
from deep_contact.cnn import dataset
from deep_contact.simulation import ready
out = Path(sys.argv[1])
big = ready(dc.lattice_in_box(1000))
claim = {{"text": "x", "thesis": None, "holds": True, "measured": {{"x": 1}}}}
found = {{"id": "9.9", "title": "x", "options": {{}}, "provenance": results.provenance(), "claims": [claim],
         "data": {{"x": list(range(9000))}}}}
plotting.subplots()  # loads what it needs, which may write caches of its own
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    {write}
except OSError as error:
    print(type(error).__name__, error)
"""


@POSIX
@pytest.mark.parametrize("suffix", WRITERS)
def test_a_full_disk_is_an_oserror_that_leaves_the_old_file_and_nothing_else(tmp_path, suffix):
    # A limit on the size of files stands for the disk: a write beyond 4 KB fails as ENOSPC does, part way through.
    old = tmp_path / f"it.{suffix}"
    old.write_bytes(b"old")
    done = run(FULL.format(write=WRITERS[suffix]), tmp_path)
    assert done.stdout.startswith("OSError [Errno 27]"), done.stdout + done.stderr
    assert old.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == [old.name]


def test_an_output_that_cannot_be_written_is_named(tmp_path, state):
    # A file where the folder should be: refused for every user, while a read-only folder does not stop root.
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(OSError, match="taken"):
        write_state(tmp_path / "taken" / "state.xml", state)
    assert (tmp_path / "taken").read_text() == "a file"


@pytest.mark.skipif(hasattr(os, "getuid") and os.getuid() == 0, reason="nothing is read-only to root")
def test_a_read_only_folder_is_a_permission_error_without_leftovers(tmp_path, state):
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    with pytest.raises(PermissionError, match="locked"):
        write_state(folder / "state.xml", state)
    assert list(folder.iterdir()) == []


def test_a_move_that_is_refused_leaves_the_old_file_and_nothing_else(tmp_path, state, monkeypatch):
    # What a read-only or full target does at the last moment, for every user.
    write_state(tmp_path / "state.xml", state)
    before = (tmp_path / "state.xml").read_bytes()

    def refuse(source, target):
        raise PermissionError(13, "Permission denied", str(target))

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(PermissionError, match=r"state\.xml"):
        write_state(tmp_path / "state.xml", state.replace(step=99))
    assert (tmp_path / "state.xml").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["state.xml"]


# ---- compiled code ----


@pytest.fixture
def cache(tmp_path):
    """A package of one source and two cached files, noted."""
    (tmp_path / "physics" / "__pycache__").mkdir(parents=True)
    (tmp_path / "physics" / "engine.py").write_text("x = 1\n")
    drop_stale_code(tmp_path)
    for name in ("engine.nbi", "engine.1.nbc"):
        (tmp_path / "physics" / "__pycache__" / name).write_bytes(b"\x80" + name.encode() * 100 + b".")
    note_code(tmp_path)
    return tmp_path


def cached(package):
    return sorted(path.name for path in package.rglob("*.nb?"))


@pytest.mark.parametrize("how", ["flipped", "cut", "empty", "longer"])
def test_a_damaged_cached_file_goes_and_the_others_stay(cache, how):
    path = cache / "physics" / "__pycache__" / "engine.1.nbc"
    data, times = path.read_bytes(), path.stat()
    middle = len(data) // 2
    flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
    path.write_bytes({"flipped": flipped, "cut": data[:50], "empty": b"", "longer": data + b"x"}[how])
    if how == "flipped":
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))  # a disk that fails does not tell
    assert drop_damaged_code(cache) == 1
    assert cached(cache) == ["engine.nbi"]


def test_whole_files_and_new_ones_stay(cache):
    (cache / "physics" / "__pycache__" / "engine.2.nbc").write_bytes(b"\x80compiled since.")
    (cache / "physics" / "__pycache__" / "engine.nbi").write_bytes(b"\x80with one more signature.")
    assert drop_damaged_code(cache) == 0
    assert len(cached(cache)) == 3


@pytest.mark.parametrize("notes", ["", "{", "[]", '{"a": 1}', '{"a": [1]}', "\x00"])
def test_damaged_notes_are_no_notes(cache, notes):
    (cache / "__pycache__" / "code.sums").write_text(notes)
    assert drop_damaged_code(cache) == 0
    note_code(cache)
    assert set(code_cache._noted(cache)) == {"physics/__pycache__/engine.nbi", "physics/__pycache__/engine.1.nbc"}


@pytest.mark.parametrize("hours", [-24, 24])
def test_a_clock_set_back_or_ahead_does_not_keep_stale_code(cache, hours):
    # Times are compared for being equal, not for their order: a source edited "before" it was compiled is still new.
    source = cache / "physics" / "engine.py"
    stamp = source.stat().st_mtime_ns + hours * 3600 * 10**9
    source.write_text("x = 2\n")
    os.utime(source, ns=(stamp, stamp))
    assert drop_stale_code(cache)
    assert cached(cache) == []


SHORT_RUN = """
import deep_contact as dc, hashlib
state = dc.simulate(dc.column(3), steps=20, solver=dc.PGS(sweeps=5)).state
print(hashlib.sha256(state.bodies.position.tobytes() + state.contacts.normal_impulse.tobytes()).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", ["garbage", "cut", "flipped code", "index"])
def test_damaged_machine_code_is_compiled_again_with_the_same_result(tmp_path, how):
    # Without `drop_damaged_code` these end in an UnpicklingError, an EOFError, or a segmentation fault.
    shutil.copytree(PACKAGE, tmp_path / "deep_contact", ignore=shutil.ignore_patterns("__pycache__"))
    whole = run(SHORT_RUN, cwd=tmp_path)
    assert whole.returncode == 0, whole.stderr
    for path in (tmp_path / "deep_contact" / "physics" / "__pycache__").glob("*.nbi" if how == "index" else "*.nbc"):
        data, times = bytearray(path.read_bytes()), path.stat()
        if how == "flipped code":
            middle = slice(len(data) // 2, len(data) // 2 + 40)
            data[middle] = bytes(byte ^ 255 for byte in data[middle])
        path.write_bytes(data if how == "flipped code" else data[: len(data) // 3] if how == "cut" else b"garbage")
        if how == "flipped code":
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    again = run(SHORT_RUN, cwd=tmp_path)
    assert (again.returncode, again.stdout) == (0, whole.stdout), again.stderr


# ---- two at once, and time ----

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


def test_a_clock_set_back_during_a_figure_makes_no_negative_time(tmp_path, monkeypatch):
    clock = iter(np.arange(1e9, 0, -1e6))
    monkeypatch.setattr(time, "time", lambda: next(clock))
    figure = figures.Figure(id="T 9.7", title="Clock", compute=lambda *_: {"x": [1.0]}, table=lambda data: [["x"], [1]])
    found = figures.produce(figure, out=tmp_path, echo=lambda line: None)
    assert 0 <= found["provenance"]["wall_s"] < 60


# ---- loaders ----


@pytest.mark.slow
def test_a_damaged_model_file_is_a_model_file_error(tmp_path):
    """One byte changed or the end cut off, a thousand times: read as before, or refused; nothing else."""
    from deep_contact.cnn.model_file import ModelFileError, default_model_path, read_metadata

    try:
        whole = default_model_path().read_bytes()
    except FileNotFoundError:
        pytest.skip("there is no shipped model")
    rng = np.random.default_rng(0)
    damaged = tmp_path / "model.h5"
    for _ in range(1000):
        data = bytearray(whole)
        if rng.random() < 0.2:
            data = data[: rng.integers(0, len(data))]
        else:
            # Half of the damage where the structure is, half among the weights.
            at = rng.integers(0, len(data) if rng.random() < 0.5 else 4096)
            data[at] ^= 1 << rng.integers(0, 8)
        damaged.write_bytes(data)
        try:
            read_metadata(damaged)
        except ModelFileError as error:
            assert "model.h5" in str(error)  # noqa: PT017 (some damage lies in unused bytes and raises nothing)
