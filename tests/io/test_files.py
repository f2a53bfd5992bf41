"""JSON as it is written, and heaps of HDF5 that lead nowhere."""

import json

import h5py
import pytest

from deep_contact.cnn.model_file import ModelFileError, read_metadata
from deep_contact.io.files import write_json
from deep_contact.io.hdf5 import damaged_heap
from deep_contact.io.simulation_h5 import DataFileError, read_simulation


def test_json_keeps_bits_puts_one_object_a_line_and_holds_finite_numbers(tmp_path):
    value = {"a": [0.1, 1e-300], "θ": [{"b": None}, {"b": True}], "empty": {}}
    path = write_json(tmp_path / "new" / "a.json", value)
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == value
    assert '"a": [0.1,1e-300],\n' in text
    assert '"θ"' in text
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "b.json", {"a": float("nan")})
    assert not (tmp_path / "b.json").exists()


def test_a_heap_that_does_not_lead_on_is_found_before_hdf5_walks_through_it_for_ever(tmp_path):
    # Texts of variable length lie in a global heap: objects of (index, references, 0, size) and their bytes.
    path = tmp_path / "texts.h5"
    with h5py.File(path, "w") as file:
        file.attrs["one"] = ["a text", "and another"]
    assert damaged_heap(path) == ""
    data = bytearray(path.read_bytes())
    at = data.find(b"GCOL") + 16
    while int.from_bytes(data[at : at + 2], "little"):
        at += 16 + (int.from_bytes(data[at + 8 : at + 16], "little") + 7) // 8 * 8
    data[at + 8 : at + 16] = bytes(8)  # free space of no size
    path.write_bytes(data)
    assert damaged_heap(path).startswith(f"an object at byte {at} of 0 bytes")
    with pytest.raises(ModelFileError, match="an object at byte"):
        read_metadata(path)
    with pytest.raises(DataFileError, match="an object at byte"):
        read_simulation(path)
    path.write_bytes(data[: data.find(b"GCOL") + 12])
    assert "cut off" in damaged_heap(path)
