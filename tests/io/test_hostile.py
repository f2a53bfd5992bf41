"""Files made to harm: each is refused by an error that names the file, in bounded memory, and the process lives on."""

import gzip
import zlib

import h5py
import numpy as np
import pytest
from scipy import sparse
from test_fclib import TEXT

import deep_contact as dc
from deep_contact.io import hdf5
from deep_contact.io.fclib import MAX_TEXT, read_problem, write_fclib
from deep_contact.io.simulation_h5 import DataFileError, read_simulation, simulation_info, write_simulation
from deep_contact.physics.lcp import ContactProblem

PROBLEM = ContactProblem(sparse.csr_array(np.eye(4)), np.zeros(4), friction=np.ones(2))


@pytest.fixture
def path(tmp_path):
    return write_fclib(tmp_path / "hostile.hdf5", PROBLEM)


def change(path, name, value, **options):
    with h5py.File(path, "r+") as file:
        del file[name]
        file.create_dataset(name, data=value, **options)


def packed_zeros(count):
    packer = zlib.compressobj(9)
    return b"".join([*(packer.compress(bytes(2**20)) for _ in range(count // 2**20)), packer.flush()])


@pytest.mark.parametrize("kind", ["u1", "u8"])
@pytest.mark.parametrize("offsets", [[0, 200, 1, 2, 4], [0, 1, 2, 3, 255]])
def test_unsigned_offsets_out_of_order_are_refused(path, kind, offsets):
    # Their differences are never negative; taken as they are they end the process.
    change(path, "fclib_local/W/p", np.array(offsets, kind))
    with pytest.raises(ValueError, match=r"hostile.hdf5: W/p: expected 5 offsets"):
        read_problem(path)


@pytest.mark.parametrize("value", [2**63, 2**64 - 1])
@pytest.mark.parametrize("name", ["spacedim", "W/m", "W/nz", "W/i"])
def test_integers_beyond_64_bits_are_refused(path, name, value):
    change(path, f"fclib_local/{name}", np.array([value], "u8"))
    with pytest.raises(ValueError, match=f"hostile.hdf5: {name}: expected an integer"):
        read_problem(path)


@pytest.mark.parametrize(("part", "i"), [("p", [0, 1, 2, 4]), ("i", [0, -1, 2, 3])])
def test_triplets_out_of_range_are_refused(path, part, i):
    for name, value in {"nz": [4], "p": range(4), "i": range(4), part: i}.items():
        change(path, f"fclib_local/W/{name}", np.array(value))
    with pytest.raises(ValueError, match=f"W/{part}: expected indices from 0 to 3"):
        read_problem(path)


def test_a_matrix_of_more_rows_than_velocities_is_refused_before_it_is_made(path):
    for name, value in {"m": 10**12, "n": 10**12, "nz": 4, "p": np.arange(4)}.items():
        change(path, f"fclib_local/W/{name}", np.atleast_1d(value))
    with pytest.raises(ValueError, match=r"vectors/q: expected 1000000000000 numbers"):
        read_problem(path)


@pytest.mark.parametrize("options", [{}, {"chunks": (2**16,), "compression": "gzip"}, {"fillvalue": 1.0}])
def test_fill_values_that_no_file_holds_are_refused(path, options):
    change(path, "fclib_local/W/x", None, shape=(2**27,), dtype="f8", **options)
    with pytest.raises(ValueError, match=f"hostile.hdf5: fclib_local/W/x: expected what the file holds, got {2**30}"):
        read_problem(path)


def test_arrays_beyond_the_limit_together_are_refused(path):
    for name in ("x", "i"):
        change(path, f"fclib_local/W/{name}", np.zeros(2**24 + 1), chunks=(2**18,), compression="gzip")
    with pytest.raises(ValueError, match=r"hostile.hdf5: .* expected at most 268435456 bytes unpacked"):
        read_problem(path)


def test_a_chunk_that_unpacks_to_more_than_its_size_is_refused(path):
    change(path, "fclib_local/W/x", None, shape=(2**17,), dtype="f8", chunks=(2**17,), compression="gzip")
    with h5py.File(path, "r+") as file:
        file["fclib_local/W/x"].id.write_direct_chunk((0,), packed_zeros(2**29))
    with pytest.raises(ValueError, match=r"hostile.hdf5: fclib_local/W/x: expected chunks of 1048580 bytes"):
        read_problem(path)


def test_a_chunk_that_was_left_unpacked_is_read(path):
    noise = np.random.default_rng(0).bytes(2**20)
    change(path, "fclib_local/W/x", None, shape=(2**18,), dtype="f4", chunks=(2**18,), compression="gzip")
    with h5py.File(path, "r+") as file:
        file["fclib_local/W/x"].id.write_direct_chunk((0,), noise, filter_mask=1)
        assert hdf5.dataset(file, "fclib_local/W/x")[()].tobytes() == noise


def test_filters_of_others_are_refused(path):
    change(path, "fclib_local/W/x", np.ones(4), chunks=(4,), scaleoffset=3)
    with pytest.raises(ValueError, match=r"hostile.hdf5: fclib_local/W/x: expected gzip or LZF"):
        read_problem(path)


@pytest.mark.parametrize("kind", ["soft loop", "hard loop", "other file", "text"])
def test_what_is_no_array_of_this_file_is_refused(path, kind):
    with h5py.File(path, "r+") as file:
        del file["fclib_local/W"]
        links = {"soft loop": h5py.SoftLink("/fclib_local/W"), "other file": h5py.ExternalLink("other.hdf5", "/")}
        file["fclib_local/W"] = links.get(kind, file["fclib_local"] if kind == "hard loop" else "text")
    with pytest.raises(ValueError, match=r"hostile.hdf5: fclib_local/W/m: expected an array in this file"):
        read_problem(path)


def test_groups_that_hold_themselves_are_refused(tmp_path):
    with h5py.File(tmp_path / "loop.h5", "w") as file:
        file["a/b"] = np.zeros(3)
        file["a/c/again"] = file["a"]
        with pytest.raises(ValueError, match="/a/c/again: expected every object once"):
            hdf5.datasets(file)
        del file["a/c/again"]
        assert list(hdf5.datasets(file)) == ["a/b"]


def test_a_damaged_checksum_is_refused_by_name(path, tmp_path):
    change(path, "fclib_local/vectors/q", np.arange(4.0), chunks=(4,), fletcher32=True)
    with h5py.File(path, "r") as file:
        at = file["fclib_local/vectors/q"].id.get_chunk_info(0).byte_offset
    text = tmp_path / "pile.dat.gz"
    text.write_bytes(gzip.compress(TEXT.encode()))
    for damaged, place, expected in ((path, at, "an HDF5 file"), (text, -6, "gzip data")):
        data = bytearray(damaged.read_bytes())
        data[place] ^= 1
        damaged.write_bytes(data)
        with pytest.raises(ValueError, match=rf"{damaged.name}: expected {expected}, whole and undamaged"):
            read_problem(damaged)


def test_a_file_that_is_cut_off_is_refused_by_name(path):
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"hostile.hdf5: expected an HDF5 file"):
        read_problem(path)


def test_text_that_unpacks_beyond_the_limit_is_refused(tmp_path):
    path = tmp_path / "zeros.dat"
    path.write_bytes(gzip.compress(bytes(MAX_TEXT + 1), compresslevel=1))
    with pytest.raises(ValueError, match=f"zeros.dat: .* expected at most {MAX_TEXT} bytes"):
        read_problem(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [(" 0 : 2", f" {10**30} : 2"), (" 0 : 2", f" {'9' * 5000} : 2"), ("nnz: 6", f"nnz: {'9' * 5000}")],
)
def test_long_integers_in_text_are_refused_by_name(tmp_path, old, new):
    path = tmp_path / "long.dat"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(ValueError, match=r"long.dat: "):
        read_problem(path)


@pytest.fixture(scope="module")
def simulation(tmp_path_factory):
    path = tmp_path_factory.mktemp("simulation") / "sim_0000.h5"
    write_simulation(path, [dc.simulate(dc.column(3), steps=3).state], options={"a": 1})
    return path.read_bytes()


@pytest.mark.parametrize("name", ["solver", "options"])
@pytest.mark.parametrize(
    "text", ["[" * 30_000, '{"a":' * 10_000, "9" * 5000, '{"method": "PGS", "sweeps": ' + "9" * 400 + "}", '"\\ud800"']
)
def test_json_that_no_reader_bears_is_refused_by_name(simulation, tmp_path, name, text):
    path = spelt(simulation, tmp_path / "sim.h5", **{name: text.encode()})
    for read in (read_simulation, simulation_info):
        try:
            read(path)
        except DataFileError as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017 (what the header alone shows is not read by info)


def spelt(simulation, path, **attributes):
    path.write_bytes(simulation)
    with h5py.File(path, "r+") as file:
        for name, text in attributes.items():
            file.attrs[name] = np.bytes_(text)
    return path


@pytest.mark.parametrize("solver", [b'{"method": "Unheard", "sweeps": 3}', b"[1]", b"3", b'{"sweeps": 3}'])
def test_a_simulation_of_an_unknown_solver_is_refused(simulation, tmp_path, solver):
    with pytest.raises(DataFileError, match=r"sim.h5: solver: expected null, or a method and its options, got "):
        simulation_info(spelt(simulation, tmp_path / "sim.h5", solver=solver))


@pytest.mark.parametrize(
    ("solver", "name"),
    [(b'{"method": "APGD", "sweeps": 3}', "APGD"), (b'{"method": "BatchedPGS", "order": "levels"}', "BatchedPGS")],
)
def test_a_simulation_of_a_solver_that_is_gone_is_read_with_a_warning(simulation, tmp_path, solver, name):
    with pytest.warns(UserWarning, match=rf"solver: {name}.* is no longer part of Deep Contact"):
        assert simulation_info(spelt(simulation, tmp_path / "sim.h5", solver=solver)).header["solver"] is None


def test_a_simulation_whose_arrays_are_not_in_it_is_refused(simulation, tmp_path):
    path = spelt(simulation, tmp_path / "sim.h5")
    change(path, "position", None, shape=(1, 3, 2), dtype="<f8", maxshape=(None, 3, 2))
    with pytest.raises(DataFileError, match=r"sim.h5: position: expected what the file holds"):
        read_simulation(path)
