"""Files made to harm: each is refused by an error that names the file, in bounded memory, and the process lives on.

Hostile text files are in `test_state_xml`.
"""

import os
import zlib

import h5py
import numpy as np
import pytest

import deep_contact as dc
from deep_contact.cnn.model_file import ModelFileError, read_metadata
from deep_contact.cnn.registry import network_file
from deep_contact.io import hdf5
from deep_contact.io.simulation_h5 import DataFileError, read_simulation, simulation_info, write_simulation

MOST = 2**28


@pytest.fixture
def path(tmp_path):
    """A file whose only array is a/x."""
    with h5py.File(tmp_path / "hostile.h5", "w") as file:
        file["a/x"] = np.zeros(4)
    return tmp_path / "hostile.h5"


def read(path):
    with hdf5.opened(path) as file:
        return hdf5.read(hdf5.datasets(file), MOST)["a/x"]


def change(path, name, value, **options):
    with h5py.File(path, "r+") as file:
        del file[name]
        file.create_dataset(name, data=value, **options)


def packed_zeros(count):
    packer = zlib.compressobj(9)
    return b"".join([*(packer.compress(bytes(2**20)) for _ in range(count // 2**20)), packer.flush()])


@pytest.mark.parametrize(
    ("value", "options", "message"),
    [
        (None, {"shape": (2**27,), "dtype": "f8"}, f"a/x: expected what the file holds, got {2**30}"),
        (None, {"shape": (2**27,), "dtype": "f8", "chunks": (2**16,), "compression": "gzip"}, "what the file holds"),
        (None, {"shape": (2**27,), "dtype": "f8", "fillvalue": 1.0}, "a/x: expected what the file holds"),
        (np.zeros(2**25 + 1), {"chunks": (2**18,), "compression": "gzip"}, f"a/x: expected at most {MOST} bytes"),
        (np.ones(4), {"chunks": (4,), "scaleoffset": 3}, "a/x: expected gzip or LZF, shuffled or not, got filters"),
        ([b"a", b"b"], {}, "a/x: expected numbers, got"),
    ],
)
def test_arrays_that_the_file_does_not_hold_or_that_are_none_of_ours_are_refused(path, value, options, message):
    change(path, "a/x", value, **options)
    with pytest.raises(ValueError, match=f"hostile.h5: .*{message}"):
        read(path)


def test_a_chunk_that_unpacks_to_more_than_its_size_is_refused(path):
    change(path, "a/x", None, shape=(2**17,), dtype="f8", chunks=(2**17,), compression="gzip")
    with h5py.File(path, "r+") as file:
        file["a/x"].id.write_direct_chunk((0,), packed_zeros(2**29))
    with pytest.raises(ValueError, match=r"hostile.h5: a/x: expected chunks of 1048580 bytes"):
        read(path)


def test_a_chunk_that_was_left_unpacked_is_read(path):
    noise = np.random.default_rng(0).bytes(2**20)
    change(path, "a/x", None, shape=(2**18,), dtype="f4", chunks=(2**18,), compression="gzip")
    with h5py.File(path, "r+") as file:
        file["a/x"].id.write_direct_chunk((0,), noise, filter_mask=1)
    assert read(path).tobytes() == noise


@pytest.mark.parametrize("kind", ["soft loop", "hard loop", "other file", "text", "raw file", "virtual"])
def test_what_is_no_array_of_this_file_is_refused(path, kind):
    with h5py.File(path, "r+") as file:
        del file["a/x"]
        links = {"soft loop": h5py.SoftLink("/a/x"), "other file": h5py.ExternalLink("other.h5", "/")}
        links |= {"hard loop": file["a"], "text": "text"}
        if kind in links:
            file["a/x"] = links[kind]
        elif kind == "raw file":
            file.create_dataset("a/x", (4,), "u1", external=[(str(path), 0, 4)])
        else:
            layout = h5py.VirtualLayout((1,), "f4")
            layout[:] = h5py.VirtualSource(str(path), "data", (1,))
            file.create_virtual_dataset("a/x", layout)
    expected = "an array in this file|numbers|every object once"
    with pytest.raises(ValueError, match=rf"hostile.h5: /?a/x: expected ({expected})"):
        read(path)


def test_a_file_that_is_damaged_or_cut_off_is_refused_by_name(path):
    change(path, "a/x", np.arange(4.0), chunks=(4,), fletcher32=True)
    with h5py.File(path, "r") as file:
        at = file["a/x"].id.get_chunk_info(0).byte_offset
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    for damaged in (data, data[:100]):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"hostile.h5: expected an HDF5 file, whole and undamaged"):
            read(path)


def test_a_heap_that_does_not_lead_on_is_met_before_hdf5_walks_through_it_for_ever(path):
    # Texts of variable length lie in a global heap: objects of (index, references, 0, size) and their bytes.
    with h5py.File(path, "r+") as file:
        file.attrs["one"] = ["a text", "and another"]
    assert hdf5.endless_heap(path) == ""
    data = bytearray(path.read_bytes())
    at = data.find(b"GCOL") + 16
    while int.from_bytes(data[at : at + 2], "little"):
        at += 16 + (int.from_bytes(data[at + 8 : at + 16], "little") + 7) // 8 * 8
    for size, message in ((0, f"a free object at byte {at} of 0 bytes"), (15, "of 15 bytes")):
        data[at + 8 : at + 16] = size.to_bytes(8, "little")
        path.write_bytes(data)
        for reader, error in ((read_metadata, ModelFileError), (read_simulation, DataFileError)):
            with pytest.raises(error, match=message):
                reader(path)
    data[at + 8 : at + 16] = bytes(7 * [255]) + b"\1"  # beyond the heap: what HDF5 reports itself
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"hostile.h5: expected an HDF5 file, whole and undamaged"):
        with hdf5.opened(path) as file:
            print(file.attrs["one"])


@pytest.fixture(scope="module")
def simulation(tmp_path_factory):
    path = tmp_path_factory.mktemp("simulation") / "sim_0000.h5"
    write_simulation(path, [dc.simulate(dc.column(3), steps=3).state], options={"a": 1})
    return path.read_bytes()


@pytest.mark.parametrize(("read", "error"), [(read_simulation, DataFileError), (read_metadata, ModelFileError)])
def test_what_is_cut_off_foreign_or_no_file_is_refused_by_name(simulation, read, error, tmp_path):
    path, pipe = tmp_path / "a.h5", tmp_path / "pipe.h5"
    whole = simulation if read is read_simulation else network_file("far field, no past").read_bytes()
    cut_off = [whole[: int(share * len(whole))] for share in (0.001, 0.1, 0.5, 0.9, 0.999)]
    for data in (b"", b"<configuration/>", b"\x89HDF\r\n\x1a\n" + bytes(200), *cut_off, whole[:-1]):
        path.write_bytes(data)
        with pytest.raises(error, match=r"a\.h5: expected an HDF5 file, whole and undamaged"):
            read(path)
    with h5py.File(path, "w") as file:
        file["weights"] = np.zeros(3)
    with pytest.raises(error, match=r"a\.h5: (format|model_config): expected this attribute, got none"):
        read(path)
    os.mkfifo(pipe)
    for special in (tmp_path, pipe):
        with pytest.raises(error, match="expected a file, got a folder, pipe or device"):
            read(special)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none.h5")


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
