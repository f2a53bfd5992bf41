"""Files are written in one move, to the path that was meant, also by several writers at once."""

import errno
import gzip
import os
import signal
from concurrent.futures import ThreadPoolExecutor

import h5py
import pytest

import deep_contact as dc
from deep_contact.__main__ import main
from deep_contact.io import contacts_csv, files
from deep_contact.io.files import check_writable, write_bytes
from deep_contact.measure import measurement

NOWHERE = "/proc/run.xml"
"""In a folder that takes no file, not even of the superuser."""


def test_a_link_stays_a_link_and_a_mode_stays(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "state.xml").write_bytes(b"old")
    (tmp_path / "far" / "state.xml").chmod(0o640)
    (tmp_path / "link.xml").symlink_to("far/state.xml")
    (tmp_path / "broken.xml").symlink_to("far/later.xml")
    for name in ("link", "broken"):
        write_bytes(tmp_path / f"{name}.xml", b"new")
        assert (tmp_path / f"{name}.xml").is_symlink()
        assert (tmp_path / f"{name}.xml").read_bytes() == b"new"
    assert (tmp_path / "far" / "state.xml").stat().st_mode & 0o777 == 0o640
    assert sorted(path.name for path in (tmp_path / "far").iterdir()) == ["later.xml", "state.xml"]


def test_threads_that_write_one_name_write_whole_files(tmp_path):
    path, texts = tmp_path / "one", [bytes([65 + k]) * 100_000 for k in range(8)]

    def write(k):
        write_bytes(path, texts[k % 8])
        return path.read_bytes() in texts

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(write, range(200)))
    assert os.listdir(tmp_path) == ["one"]


@pytest.mark.parametrize("write", [check_writable, lambda path: write_bytes(path, b"x")])
@pytest.mark.parametrize("name", ["pipe", "folder", "file/run.xml", NOWHERE])
def test_what_takes_no_file_is_an_error_that_names_it(write, name, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_bytes(b"old")
    with pytest.raises(OSError, match=name.removesuffix("/run.xml")):
        write(tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder", "pipe"]
    assert (tmp_path / "pipe").is_fifo()


def test_an_error_without_a_name_gets_that_of_the_file(tmp_path):
    """As of a full disk: [Errno 27] File too large."""
    with pytest.raises(OSError, match=r"File too large: '[^']*run\.h5'$"), files.replacing(tmp_path / "run.h5"):
        raise OSError(errno.EFBIG, "File too large")
    with pytest.raises(OSError, match=r"^no number$"), files.replacing(tmp_path / "run.h5"):
        raise OSError("no number")


def test_a_file_that_this_process_has_open_is_named_so(tmp_path):
    path = tmp_path / "run.h5"
    dc.simulate(dc.column(2), steps=1, record=1).trajectory.save(path)
    with h5py.File(path, "a"), pytest.raises(ValueError, match=r"run\.h5: expected a closed file, .*close it first"):
        dc.load_trajectory(path)
    assert len(dc.load_trajectory(path)) == 2


def test_a_segment_too_far_away_is_read_and_refused_by_the_engine(tmp_path):
    state = dc.column(2).replace(world=dc.World(segments=[((0, 20), (1, 25.0))]))
    dc.write_state(tmp_path / "far.xml", state)
    text = (tmp_path / "far.xml").read_text(encoding="utf-8")
    (tmp_path / "far.xml").write_text(text.replace('x_0="0.0"', 'x_0="1e300"'), encoding="utf-8")
    far = dc.read_state(tmp_path / "far.xml")
    assert far.world.segments[0][0] == 1e300
    with pytest.raises(ValueError, match=r"world.segments\[0, 0\]: expected -1e\+12 to 1e\+12 m, got 1e\+300"):
        dc.simulate(far, steps=1)


def test_a_check_leaves_what_is_there(tmp_path):
    (tmp_path / "one").write_bytes(b"old")
    check_writable(tmp_path / "one")
    check_writable(tmp_path / "two")
    assert os.listdir(tmp_path) == ["one"]
    assert (tmp_path / "one").read_bytes() == b"old"


def test_an_error_leaves_the_old_file(tmp_path):
    (tmp_path / "one").write_bytes(b"old")
    with pytest.raises(TypeError):
        write_bytes(tmp_path / "one", "text")
    assert os.listdir(tmp_path) == ["one"]
    assert (tmp_path / "one").read_bytes() == b"old"


def test_a_table_of_contacts_is_written_whole(tmp_path, monkeypatch):
    def half(path, *_, **__):
        path.write_text("a,b")
        raise OSError("full")

    monkeypatch.setattr(contacts_csv.np, "savetxt", half)
    with pytest.raises(OSError, match="full"):
        dc.contact_table(dc.simulate(dc.column(2), steps=1).state, tmp_path / "contacts.csv")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("words", [["simulate"], ["trade", "--scene", "column"]])
def test_a_command_refuses_what_it_could_not_write_before_it_runs(words, monkeypatch, capsys):
    for name in ("simulate", "measure_trade"):
        monkeypatch.setattr(dc, name, lambda *_, **__: pytest.fail("it has run"), raising=False)
    suffix = ".xml" if words[0] == "simulate" else ".json"
    assert main([*words, "--steps", "20", "--out", f"/proc/run{suffix}"]) == 3
    assert f"/proc/run{suffix}" in capsys.readouterr().err


@pytest.fixture
def sigterm():
    """Nothing that a test does to SIGTERM outlives it, and nothing that it fails to do ends the tests."""
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGTERM, before)


def test_sigterm_keeps_what_a_trade_has_measured_as_ctrl_c_does(tmp_path, monkeypatch, sigterm):
    out, real, calls = tmp_path / "trade.json", measurement._task, []

    def terminated(task):
        calls.append(task)
        if len(calls) == 12:
            os.kill(os.getpid(), signal.SIGTERM)
        return real(task)

    monkeypatch.setattr(measurement, "_task", terminated)
    words = ["--bodies", "20", "--steps", "20", "--seeds", "3", "--out", str(out)]
    assert main(["trade", *words]) == 0
    assert len(calls) == 12
    assert "interrupted: this is what was known then" in dc.load_trade(out).notes


@pytest.mark.parametrize("pack", [bytes, gzip.compress], ids=["plain", "packed"])
def test_a_file_has_at_most_the_bytes_that_are_read(pack, tmp_path):
    path, content = tmp_path / "file", bytes(200)
    path.write_bytes(pack(content))
    assert files.read_bytes(path, 200) == content
    with pytest.raises(ValueError, match="expected at most 199 bytes"):
        files.read_bytes(path, 199)
