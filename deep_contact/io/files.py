"""Files written in one move: a reader never sees half of one, and a failed write leaves what was there before."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside `path`, renamed to it at the end of the block; after an error it is removed instead."""
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: str | os.PathLike, value) -> Path:
    """Write `value` as strict JSON for people and programs; make the folder if there is none. Returns the path.

    Objects are indented, lists without objects stay on one line, floats keep their bits. Raises ValueError for NaN and
    infinity, and TypeError for what JSON cannot hold.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(_json(value) + "\n", encoding="utf-8")
    return path


def _json(value, indent: str = "") -> str:
    inner = indent + "  "
    if isinstance(value, dict) and value:
        lines = [f"{inner}{_json(key)}: {_json(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return "[\n" + ",\n".join(inner + _json(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


_HEAP = struct.Struct("<8sQ")
_OBJECT = struct.Struct("<HHIQ")


def damaged_heap(path: str | os.PathLike) -> str:
    """What is wrong with the heaps of texts in an HDF5 file, in words; empty where nothing is.

    The HDF5 library walks through such a heap, object by object, and walks for ever where a free object of damaged size
    does not lead on (2.0, `H5HG__cache_heap_deserialize`). (HDF5 File Format Specification, III.E, Global Heap.)
    """
    data = Path(path).read_bytes()
    at = data.find(b"GCOL\x01\0\0\0")
    while at >= 0:
        if at + _HEAP.size > len(data):
            return f"a heap at byte {at} that is cut off"
        end = at + _HEAP.unpack_from(data, at)[1]
        if not at + _HEAP.size <= end <= len(data):
            return f"a heap at byte {at} of {end - at} bytes in a file of {len(data)}"
        place = at + _HEAP.size
        while place + _OBJECT.size <= end:
            index, _, _, size = _OBJECT.unpack_from(data, place)
            # Free space, object 0, counts its own head; the others do not, and are padded to 8 bytes.
            step = size if index == 0 else _OBJECT.size + (size + 7) // 8 * 8
            if step < _OBJECT.size or place + step > end:
                return f"an object at byte {place} of {size} bytes in a heap that ends at byte {end}"
            place += step
        at = data.find(b"GCOL\x01\0\0\0", end)
    return ""
