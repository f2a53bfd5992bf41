"""`deep_contact.cnn.dataset` and scripts/generate_data.py: exact files, honest errors, reproducible batches."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from unittest.mock import Mock

import h5py
import numpy as np
import pytest
from conftest import ROOT, load_script, run_python
from hypothesis import given, settings
from hypothesis import strategies as st

import deep_contact as dc
from deep_contact.cnn.dataset import (
    PHASES,
    Store,
    evenly,
    phase,
    phases_of,
    simulation_path,
    split_by_simulation,
    start_errors,
)
from deep_contact.io import simulation_h5
from deep_contact.io.simulation_h5 import DataFileError, pack_simulation, read_simulation, write_simulation
from deep_contact.state.arrays import no_contacts

SCRIPT = ROOT / "scripts" / "generate_data.py"


def run_of(seed):
    """Solved states of a small pile, and the sweeps and last θ of each."""
    scene, found = dc.circles_in_box(12, size=10, radius=(0.5, 0.9), seed=seed).replace(name=f"sim_{seed:04d}"), []
    dc.simulate(scene, steps=110, solver=dc.PGS(sweeps=200), on_step=lambda *both: found.append(both))
    states, records = zip(*found[40:])
    return list(states), np.array([r.sweeps for r in records]), np.array([r.theta[-1] for r in records])


@pytest.fixture(scope="module")
def run():
    return run_of(0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Four simulations of 70 states."""
    folder = tmp_path_factory.mktemp("store")
    for seed in range(4):
        states, sweeps, theta = run_of(seed)
        write_simulation(simulation_path(folder, seed), states, sweeps=sweeps, theta=theta, seed=seed)
    return folder


@pytest.fixture
def path(run, tmp_path):
    """A file that a test may spoil."""
    write_simulation(tmp_path / "sim_0000.h5", run[0], sweeps=run[1], theta=run[2], compression=None)
    return tmp_path / "sim_0000.h5"


def assert_equal(state, other):
    """To the last bit: == takes -0.0 for 0.0, the digest does not."""
    assert state == other
    assert pack_simulation([state]).digest == pack_simulation([other]).digest


# ---- files ----


@pytest.mark.parametrize("compression", ["gzip", "lzf", None])
def test_states_come_back_to_the_last_bit(run, tmp_path, compression):
    states, sweeps, theta = run
    options = {"sweeps": sweeps, "theta": theta, "seed": {"entropy": 3}, "options": {"bodies": [1, 2]}}
    digest = write_simulation(tmp_path / "a.h5", states, compression=compression, **options)
    stored = read_simulation(tmp_path / "a.h5")
    for i, state in enumerate(states):
        assert_equal(stored.state(i), state)
    assert stored.arrays["sweeps"].tolist() == sweeps.tolist()
    assert stored.arrays["theta"].tobytes() == theta.tobytes()
    assert stored.header["seed"] == {"entropy": 3}
    assert stored.header["options"] == {"bodies": [1, 2]}
    assert stored.digest == digest == write_simulation(tmp_path / "b.h5", states, compression="gzip", **options)


def test_files_outlive_options_that_a_solver_gains(run, path, monkeypatch):
    """The digest is of what the file holds, not of what a later version makes of it."""

    @dataclass(frozen=True, kw_only=True)
    class Later(dc.PGS):
        omega: float = 1.0

    monkeypatch.setitem(simulation_h5.METHODS, "PGS", Later)
    assert read_simulation(path).state(0).solver == Later(sweeps=200, tolerance=run[0][0].solver.tolerance)


def test_what_only_a_state_may_hold_is_stored_too(tmp_path):
    """No solver, unsolved, no contacts, a name beyond ASCII, scales, and all floats that are special but finite."""
    state = dc.single_body(height=3.0, scales=dc.BOX2D).replace(name="Kügelchen", contacts=no_contacts())
    state.bodies.velocity[:] = [-0.0, 5e-324]
    digest = write_simulation(tmp_path / "a.h5", [state])
    own = state.replace(world=replace(state.world, scales=None))
    assert write_simulation(tmp_path / "b.h5", [own]) != digest
    assert_equal(read_simulation(tmp_path / "a.h5").state(0), state)
    assert read_simulation(tmp_path / "a.h5").arrays["sweeps"].tolist() == [-1]


def test_the_file_is_the_same_where_its_parts_are_held_open(run, tmp_path, monkeypatch):
    """The same states make the same file, also where a profiler keeps frames: HDF5 places what is compressed when it
    is flushed or closed."""
    write_simulation(tmp_path / "a.h5", run[0])
    create, held = h5py.Group.create_dataset, []
    monkeypatch.setattr(h5py.Group, "create_dataset", lambda *a, **k: held.append(create(*a, **k)) or held[-1])
    write_simulation(tmp_path / "b.h5", run[0])
    assert len(held) > 10
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dt": 0.02}, r"states\[1\].dt"),
        ({"name": "other"}, r"states\[1\].name"),
        ({"contacts": None}, r"states\[1\].contacts"),
        ({"solver": None}, r"states\[1\].solver"),
        ({"time": float("nan")}, "time"),
    ],
)
def test_states_that_are_not_of_one_simulation_are_refused(run, tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        write_simulation(tmp_path / "a.h5", [run[0][0], run[0][1].replace(**change)])
    with pytest.raises(ValueError, match="at least one"):
        write_simulation(tmp_path / "a.h5", [])
    assert list(tmp_path.iterdir()) == []


# ---- tampered files; what any HDF5 file may hold is in `test_hostile` ----


def _set(name, at, value):
    return lambda file: file[name].__setitem__(at, value)


def _attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def _replace(name, **options):
    return lambda file: (file.pop(name), options and file.create_dataset(name, **options))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_set("position", (3, 1, 0), 5.25), "digest"),
        (_set("theta", 3, 0.5), "digest"),
        (_attribute("dt", 0.02), "digest"),
        (_set("velocity", (3, 1, 0), np.nan), r"velocity\[3, 1, 0\]"),
        (_set("body_b", 4, 99), r"body_b\[4\].*99"),
        (_set("normal", 4, [0.5, 0.5]), r"normal\[4\]"),
        (_set("contact_offset", 5, 10**9), r"contact_offset\[5\]"),
        (_set("solved", 5, 7), r"solved\[5\]"),
        (_attribute("format", np.bytes_(b"other")), "format.*other"),
        (_attribute("version", 2), "version.*2"),
        (_attribute("dt", [1.0, 2.0]), "dt"),
        (_attribute("friction", -1.0), "friction"),
        (_attribute("solver", np.bytes_(b"{")), "solver"),
        (_attribute("solver", np.bytes_(b'{"method": "PGS", "speed": 1}')), "solver.*speed"),
        (_attribute("name", "of changing length"), "name"),
        (_replace("spin"), "spin"),
        (_replace("spin", data=np.zeros((70, 3))), "spin"),
        (_replace("mass", data=np.zeros(12, "<f4")), "mass.*f4"),
    ],
)
def test_a_tampered_file_is_refused_by_name(path, spoil, message):
    with h5py.File(path, "r+") as file:
        spoil(file)
    with pytest.raises(DataFileError, match=message):
        read_simulation(path)


@pytest.fixture(scope="module")
def file_to_flip(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("flipped") / "a.h5"
    digest = write_simulation(path, run[0][:3])
    return path, path.read_bytes(), digest


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_a_flipped_byte_never_goes_unnoticed(file_to_flip, data):
    """Anywhere in the file: the same states, or a DataFileError; nothing else."""
    path, good, digest = file_to_flip
    at = data.draw(st.integers(0, len(good) - 1))
    bad = bytearray(good)
    bad[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(bad)
    with suppress(DataFileError):
        assert read_simulation(path).digest == digest


# ---- the store ----


def test_the_store_knows_its_simulations_and_yields_their_states_in_order(folder):
    store = Store(folder)
    assert store.simulations == (0, 1, 2, 3)
    assert len(store) == 280
    assert store.info(2).count == 70
    assert store.info(2).header["seed"] == 2
    states = [store.state(sim, index) for sim, index in store.states().tolist()]
    assert [(state.name, state.step) for state in states[:2]] == [("sim_0000", 40), ("sim_0000", 41)]
    assert_equal(states[145], run_of(2)[0][5])
    store.state(2, 5).bodies.position[:] = 0  # the caller's own
    assert_equal(store.state(2, 5), states[145])
    with pytest.raises(KeyError, match="9"):
        store.state(9, 0)
    with pytest.raises(IndexError, match="70"):
        store.state(2, 70)
    with pytest.raises(DataFileError, match="generate_data"):
        Store(folder / "nothing here")


def test_the_cache_stays_within_its_bound(folder):
    size = Store(folder).simulation(0).bytes
    store = Store(folder, cache_bytes=2 * size + size // 2)
    for sim in (0, 1, 2, 3, 0):
        store.state(sim, 0)
        assert sum(kept.bytes for kept in store._cache.values()) <= store.cache_bytes
    assert list(store._cache) == [3, 0]


def test_the_data_hash_is_that_of_the_contents(folder, tmp_path):
    for sim in Store(folder).simulations:
        packed = simulation_h5.simulation_file(Store(folder).simulation(sim), compression="lzf")
        simulation_path(tmp_path, sim).write_bytes(packed)
    assert Store(tmp_path).data_hash() == Store(folder).data_hash()
    simulation_path(tmp_path, 3).unlink()
    assert Store(tmp_path).data_hash() != Store(folder).data_hash()


def test_phases_go_by_how_far_off_builtin_started(run, path):
    states, _, _ = run
    phases = [PHASES[index] for index in phases_of(read_simulation(path).arrays)]
    assert phases == list(map(phase, states))
    assert len(set(phases)) > 1
    c = states[-1].contacts
    for share, name in ((1.0, "rest"), (0.8, "settling"), (0.2, "impact")):
        start = {"normal_start": share * c.normal_impulse, "tangent_start": share * c.tangent_impulse}
        state = states[-1].replace(contacts=c._replace(**start))
        assert start_errors(pack_simulation([state]).arrays) == pytest.approx([1 - share], abs=1e-12)
        assert phase(state) == name


def test_states_of_a_phase_are_found(folder):
    store = Store(folder)
    by_phase = [store.states((0, 2), phases=name) for name in PHASES]
    assert sorted(map(tuple, np.concatenate(by_phase).tolist())) == [(sim, i) for sim in (0, 2) for i in range(70)]
    for name, states in zip(PHASES, by_phase):
        assert all(phase(store.state(sim, index)) == name for sim, index in states[:5])
    assert evenly(store.states((1,)), 2).tolist() == [[1, 0], [1, 35]]


@settings(max_examples=50, deadline=None)
@given(
    ids=st.sets(st.integers(0, 500), min_size=3, max_size=60),
    fractions=st.sampled_from([(0.8, 0.1, 0.1), (1 / 3, 1 / 3, 1 / 3), (0.9, 0.1, 0.0), (0.0, 0.0, 1.0)]),
    seed=st.integers(0, 5),
)
def test_no_simulation_is_on_both_sides(ids, fractions, seed):
    """What is learned from is never tested on."""
    split = split_by_simulation(ids, fractions=fractions, seed=seed)
    assert sorted(split.train + split.validation + split.test) == sorted(ids)
    assert split == split_by_simulation(sorted(ids, reverse=True), fractions=fractions, seed=seed)
    for side, share in zip(split, fractions):
        assert len(side) >= 1 if share else len(side) == 0
        assert abs(len(side) - share * len(ids)) < 2


def test_splits_that_cannot_be_are_refused():
    assert [len(side) for side in split_by_simulation(range(150))] == [120, 15, 15]
    assert split_by_simulation(range(150), seed=1) != split_by_simulation(range(150))
    for count, fractions, message in ((9, (0.5, 0.2, 0.2), "fractions"), (2, (0.8, 0.1, 0.1), "2 simulations")):
        with pytest.raises(ValueError, match=message):
            split_by_simulation(range(count), fractions=fractions)


# ---- scripts/generate_data.py ----

SMALL = ["--steps", "170", "--bodies", "24", "30", "--seed", "5"]


@pytest.fixture(scope="module")
def generate():
    return load_script("generate_data")


def command(out, simulations, *more):
    return [sys.executable, str(SCRIPT), "--out", str(out), "--simulations", str(simulations), *SMALL, *more]


def contents(out):
    return {path.name: path.read_bytes() for path in out.glob("sim_*")}


@pytest.fixture(scope="module")
def undisturbed(generate, tmp_path_factory):
    """Twenty simulations, made in one process: name -> bytes."""
    out = tmp_path_factory.mktemp("made")
    assert generate.main(["--out", str(out), "--simulations", "20", *SMALL, "--jobs", "1"]) == 0
    return contents(out)


def test_generated_states_have_contacts_and_the_generator_s_solver(undisturbed, tmp_path):
    """Those of the thesis's code: 5000 sweeps, velocity threshold 6e-5. States without contacts are left out."""
    (tmp_path / "sim_0001.h5").write_bytes(undisturbed["sim_0001.h5"])
    stored = read_simulation(tmp_path / "sim_0001.h5")
    assert np.diff(stored.arrays["contact_offset"]).min() > 0
    assert 0 < stored.count < 170
    assert stored.header["solver"] == dc.PGS(sweeps=5000, tolerance=6e-5)
    assert ((stored.arrays["theta"] <= 6e-5) | (stored.arrays["sweeps"] == 5000)).all()
    assert 24 <= stored.arrays["mass"].size <= 30
    assert (np.diff(stored.arrays["step"]) > 0).all()


@pytest.mark.slow
def test_jobs_change_no_bit(undisturbed, tmp_path):
    run_python(*command(tmp_path, 4, "--jobs", "2")[1:])
    assert contents(tmp_path) == {f"sim_{i:04d}.h5": undisturbed[f"sim_{i:04d}.h5"] for i in range(4)}


def stopped_after_the_first(out, how):
    """Start twenty simulations and stop the process once one is finished. Returns its exit status."""
    with subprocess.Popen(command(out, 20, "--jobs", "1"), stderr=subprocess.DEVNULL) as process:
        until = time.monotonic() + 60
        while not simulation_path(out, 0).exists() and process.poll() is None and time.monotonic() < until:
            time.sleep(0.001)
        process.send_signal(how if time.monotonic() < until else signal.SIGKILL)
        return process.wait(30)


def test_a_killed_run_loses_at_most_the_simulation_it_was_at(generate, undisturbed, tmp_path):
    """What is there is whole; the same command finishes the rest, and redoes nothing."""
    assert stopped_after_the_first(tmp_path, signal.SIGKILL) == -signal.SIGKILL
    finished = sorted(tmp_path.glob("sim_*.h5"))
    assert 1 <= len(finished) < 20
    kept = {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in finished}
    assert {name: data for name, (data, _) in kept.items()}.items() <= undisturbed.items()
    assert generate.main(["--out", str(tmp_path), "--simulations", "20", *SMALL, "--jobs", "1"]) == 0
    assert contents(tmp_path) == undisturbed
    assert all((tmp_path / name).stat().st_mtime_ns == written for name, (_, written) in kept.items())


@pytest.mark.slow
def test_ctrl_c_ends_it_cleanly(undisturbed, tmp_path):
    assert stopped_after_the_first(tmp_path, signal.SIGINT) == 130
    assert contents(tmp_path).items() <= undisturbed.items()


def test_xml_holds_the_same_states_and_other_options_are_not_mixed(generate, tmp_path, capsys):
    """Also where the simulation itself is there already; nothing is simulated again."""
    run = ["--out", str(tmp_path), "--simulations", "1", "--steps", "170", "--bodies", "12", "12", "--jobs", "1"]
    assert generate.main(run) == 0
    before = contents(tmp_path)
    assert generate.main([*run, "--seed", "7"]) == 3
    assert "seed" in capsys.readouterr().err
    assert contents(tmp_path) == before
    assert generate.main([*run, "--xml", "--gzip"]) == 0
    stored, xml = Store(tmp_path).simulation(0), tmp_path / "xml" / "sim_0000"
    assert len(list(xml.iterdir())) == stored.count
    for i in range(0, stored.count, 5):
        assert_equal(dc.read_state(xml / f"sim_0000_{stored.state(i).step}.xml.gz"), stored.state(i))


@pytest.mark.parametrize(
    "bad", [["--jobs", "0"], ["--bodies", "9", "3"], ["--gzip"], ["--sample", "--quick"], ["--speed", "1"]]
)
def test_bad_options_are_refused(generate, bad):
    with pytest.raises(SystemExit):
        generate.main(bad)


def test_the_tracked_sample_is_what_its_readme_says():
    """data/README.md: two states a phase as XML, one short simulation as HDF5."""
    files = sorted(ROOT.joinpath("data", "sample").glob("*.xml.gz"))
    phases = [phase(dc.read_state(path)) for path in files]
    assert phases == [path.name.split("_")[0] for path in files]
    assert sorted(phases) == sorted(2 * PHASES)
    assert len(Store(ROOT / "data" / "sample")) == 81


def test_a_full_disk_ends_the_generation_with_one_line_and_without_half_a_file(generate, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(os, "replace", Mock(side_effect=OSError(28, "No space left on device")))
    arguments = ["--out", str(tmp_path), "--simulations", "1", *SMALL, "--jobs", "1"]
    assert generate.main(arguments) == 3
    assert "No space left on device" in capsys.readouterr().err.splitlines()[-1]
    assert not list(tmp_path.iterdir())
