"""Safe reading of HDF5 files from any source: limits of size, no links to other files, errors that name the file.

`opened` opens a file. `dataset` finds an array of the file, and `datasets` finds all arrays below a group; neither
reads their numbers. `read` reads arrays after a check of their total size. Without these functions, the HDF5 library
follows links into other files, fills memory with default values that are not stored in the file, and decompresses a
chunk to any size.

Tests: tests/io/test_hostile.py
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import product
from pathlib import Path

import h5py
import numpy as np

from deep_contact.io.files import path_of, refuse_special
from deep_contact.state.validation import expect

MOST_PACKED = 1032
"""Largest ratio of compression by gzip. If the size of an array exceeds its stored bytes by more than this ratio, the
array is not in its file."""

_FILTERS = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_LZF, h5py.h5z.FILTER_FLETCHER32}
_HARMLESS = 2**28
"""Size to which a chunk may decompress without a check, bytes."""

_MOST_TEXTS = 1000


@contextmanager
def opened(path, error: type[ValueError] = ValueError) -> Iterator[h5py.File]:
    """Context with a file, open for reading. Errors that its contents cause in the block are raised as `error`.

    The message of `error` names the file. Raises OSError if the file cannot be opened.
    """
    path = path_of(path)
    refuse_special(path, error)
    if damage := endless_heap(path):
        raise error(f"{path}: expected an HDF5 file, whole and undamaged, got {damage}")
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except ValueError as fault:
        raise error(f"{path}: {fault}") from None
    except OSError as fault:
        if "already open" in str(fault) or "flag values" in str(fault):
            raise error(f"{path}: expected a closed file, got one that this process has open: close it first") from None
        raise error(f"{path}: expected an HDF5 file, whole and undamaged: {fault}") from fault
    except Exception as fault:  # h5py raises errors of many types for damaged files: RuntimeError, KeyError …
        raise error(f"{path}: expected an HDF5 file, whole and undamaged: {fault}") from fault


def member(group, name: str):
    """Return the group or array of this name, or None if there is none.

    If the name is a link to another place, the link itself is returned.
    """
    link = group.get(name, getlink=True)
    return group[name] if isinstance(link, h5py.HardLink) else link


def dataset(group, name: str) -> h5py.Dataset:
    """Return an array of the group, before its numbers are read.

    Raises ValueError unless the numbers are in this file.
    """
    array, where = member(group, name), f"{group.name}/{name}".strip("/")
    is_here = isinstance(array, h5py.Dataset) and not (array.is_virtual or array.external)
    expect(is_here, f"{where}: expected an array in this file, got {array}")
    is_held = array.nbytes <= MOST_PACKED * array.id.get_storage_size()
    expect(is_held, f"{where}: expected what the file holds, got {array.nbytes} bytes that are not in it")
    _check_chunks(array, where)
    return array


def datasets(group, prefix: str = "", seen: frozenset | set = frozenset()) -> dict[str, h5py.Dataset]:
    """Return path -> array (`dataset`) for all arrays below the group. Raises ValueError if two links lead to one
    object.
    """
    below, seen = {}, seen or set()
    for name in sorted(group):
        item = member(group, name)
        if isinstance(item, (h5py.Group, h5py.Dataset)):
            place = h5py.h5o.get_info(item.id).addr
            expect(place not in seen, f"{group.name}/{name}: expected every object once, got a second link to one")
            seen.add(place)
        if isinstance(item, h5py.Group):
            below |= datasets(item, f"{prefix}{name}/", seen)
        else:
            below[prefix + name] = dataset(group, name)
    return below


def read(arrays: Mapping[str, h5py.Dataset], most: int) -> dict[str, np.ndarray]:
    """Read the numbers of arrays. Returns name -> NumPy array.

    Raises ValueError if an array does not contain numbers, or if all together have more than `most` bytes.
    """
    for name, data in arrays.items():
        expect(data.dtype.kind in "iuf", f"{name}: expected numbers, got {data.dtype}")
    size = sum(data.nbytes for data in arrays.values())
    expect(size <= most, f"{', '.join(arrays)[:80]}: expected at most {most} bytes unpacked, got {size}")
    return {name: data[()] for name, data in arrays.items()}


def attribute(item, name: str):
    """Return an attribute of a group or file.

    Raises ValueError if it is missing, or if it is larger than the file.
    """
    expect(name in item.attrs, f"{name}: expected this attribute, got none")
    stored = item.attrs.get_id(name)
    count = math.prod(stored.shape or ())
    is_long = h5py.check_vlen_dtype(stored.dtype) or h5py.check_string_dtype(stored.dtype)
    is_held = count * stored.dtype.itemsize <= item.file.id.get_filesize() and not (is_long and count > _MOST_TEXTS)
    expect(is_held, f"{name}: expected an attribute that lies in the file, got shape {stored.shape}")
    return item.attrs[name]


def _check_chunks(data: h5py.Dataset, name: str) -> None:
    """Raise ValueError if an array is compressed by a filter not in `_FILTERS`, or a chunk decompresses to too many
    bytes.
    """
    if data.chunks is None:
        return
    packing = data.id.get_create_plist()
    filters = [packing.get_filter(k)[0] for k in range(packing.get_nfilters())]
    are_ours = len(set(filters)) == len(filters) and set(filters) <= _FILTERS
    expect(are_ours, f"{name}: expected gzip or LZF, shuffled or not, got filters {filters}")
    if h5py.h5z.FILTER_DEFLATE not in filters or data.id.get_storage_size() * MOST_PACKED <= _HARMLESS:
        return
    size = math.prod(data.chunks) * data.dtype.itemsize + 4  # bytes of a chunk and of its checksum
    for place in product(*(range(0, length, step) for length, step in zip(data.shape, data.chunks))):
        if (data.id.get_chunk_info_by_coord(place).size or 0) * MOST_PACKED > _HARMLESS:
            left_out, packed = data.id.read_direct_chunk(place)
            is_packed = not left_out >> filters.index(h5py.h5z.FILTER_DEFLATE) & 1  # a chunk may be uncompressed
            if is_packed and len(zlib.decompressobj().decompress(packed, size + 1)) > size:
                raise ValueError(f"{name}: expected chunks of {size} bytes, got one that unpacks to more")


def endless_heap(path) -> str:
    """Return a description of damage that makes the HDF5 library loop for ever, or "" if there is none.

    HDF5 stores texts in a heap. The library walks through the heap by the size of each free object, however small this
    size is (1.14 and 2.0, `H5HG__cache_heap_deserialize`). It reports all other damage itself. (HDF5 File Format
    Specification, III.E, Global Heap.)
    """
    data, at = Path(path).read_bytes(), 0
    while (at := data.find(b"GCOL\x01\0\0\0", at)) >= 0:
        end, at = at + int.from_bytes(data[at + 8 : at + 16], "little"), at + 16
        while at + _OBJECT.size <= min(end, len(data)):
            index, _, _, size = _OBJECT.unpack_from(data, at)
            if index == 0 and size < _OBJECT.size:
                return f"a free object at byte {at} of {size} bytes"
            # The size of free space (object 0) includes its header. The size of any other object does not, and is
            # padded to a multiple of 8 bytes.
            at += size if index == 0 else _OBJECT.size + (size + 7) // 8 * 8
    return ""


_OBJECT = struct.Struct("<HHIQ")
