"""Files written in one move, so that a reader never sees half a file; and files of any origin, read with a limit."""

from __future__ import annotations

import json
import os
import secrets
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class FileError(ValueError):
    """A file does not hold what it should; the message names file, field and value."""


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside `path`, renamed to it at the end of the block; after an error it is removed instead.

    The folder is made if there is none. A symbolic link stays one: the file that it names is replaced. A file that is
    replaced hands on its mode. Raises OSError, naming `path`, where it cannot be written.
    """
    with _beside(path) as (target, temporary):
        yield temporary
        if target.exists():
            temporary.chmod(stat.S_IMODE(target.stat().st_mode))
        os.replace(temporary, target)


def check_writable(path: str | os.PathLike) -> None:
    """Raise OSError, naming the path, where `replacing` could not write. Only the folder of the path is left behind."""
    with _beside(path) as (_, temporary):
        temporary.touch()


@contextmanager
def _beside(path: str | os.PathLike) -> Iterator[tuple[Path, Path]]:
    """The file that a path leads to, and a temporary path beside it that no other writer has; removed at the end."""
    target = Path(os.path.realpath(path))
    if target.exists():
        refuse_special(target, OSError)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
    try:
        yield target, temporary
    except OSError as error:
        is_nameless = error.filename is None and error.errno is not None  # as on a full disk
        if is_nameless or error.filename == str(temporary):
            error.filename, error.filename2 = str(path), None
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: str | os.PathLike, data: bytes) -> Path:
    """Write a file in one move; make its folder if there is none. Returns the path."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    return Path(path)


def write_json(path: str | os.PathLike, value) -> Path:
    """Write `value` as strict JSON for people and programs; make the folder if there is none. Returns the path.

    Objects are indented, lists without objects stay on one line, floats keep their bits. Raises ValueError for NaN and
    infinity, and TypeError for what JSON cannot hold.
    """
    return write_bytes(path, (_json(value) + "\n").encode())


def _json(value, indent: str = "") -> str:
    inner = indent + "  "
    if isinstance(value, dict) and value:
        lines = [f"{inner}{_json(key)}: {_json(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return "[\n" + ",\n".join(inner + _json(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def refuse_special(path: Path, error: type[Exception]) -> None:
    """Raise an `error` for a folder, a device, or a pipe, which would wait for its writer; OSError without a file."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise error(f"{path}: expected a file, got a folder, pipe or device")


def read_bytes(path: str | os.PathLike, most: int, error: type[ValueError] = ValueError) -> bytes:
    """The bytes of a file, unpacked where it begins as gzip does, or its name ends in .gz.

    Raises an `error` naming the file where it has more than `most` bytes, packed or not, or is not whole; OSError where
    it cannot be opened.
    """
    path = Path(path)
    refuse_special(path, error)
    if (size := path.stat().st_size) > most:
        raise error(f"{path}, line 1: expected at most {most} bytes, got {size}")
    data = path.read_bytes()
    if path.suffix != ".gz" and data[:2] != b"\x1f\x8b":
        return data
    member = zlib.decompressobj(wbits=31)  # not `gzip`, which has no limit and takes microseconds for an empty member
    try:
        unpacked = member.decompress(data, most + 1)
        if len(unpacked) > most or not member.eof or member.unused_data:
            raise zlib.error(f"expected at most {most} bytes in one whole member")
    except zlib.error as damage:
        raise error(f"{path}: expected gzip data, whole and undamaged: {damage}") from None
    return unpacked
