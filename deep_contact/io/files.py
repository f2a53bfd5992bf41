"""Writing of files in one move, so that a reader never sees half a file, and reading of files up to a limit of size."""

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
    """Error: a file does not contain what it should. The message names file, field and value."""


def path_of(path: str | os.PathLike) -> Path:
    """Return `path` as a Path. Raises ValueError if it is neither a text nor a path."""
    if not isinstance(path, (str, os.PathLike)):
        from deep_contact.state.validation import brief  # here, since the command line starts without NumPy

        raise ValueError(f"path: expected the path of a file, as a text or a Path, got {brief(path)}")
    return Path(path)


def check_ending(path: str | os.PathLike, endings: tuple[str, ...], hint: str) -> None:
    """Raise ValueError unless the name of a file ends as its content needs. hint: what writes other kinds of files."""
    if not path_of(path).name.endswith(endings):
        raise ValueError(f"path: expected a name that ends in {' or '.join(endings)}, got {str(path)!r}; {hint}")


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Context with a temporary path beside `path`. At the end of the block the temporary file is renamed to `path`.

    After an error in the block the temporary file is removed instead. The folder is made if it is missing. If `path` is
    a symbolic link, the file to which it points is replaced. The new file takes over the permissions of a file that it
    replaces. Raises OSError, which names `path`, if it cannot be written.
    """
    with _beside(path) as (target, temporary):
        yield temporary
        if target.exists():
            temporary.chmod(stat.S_IMODE(target.stat().st_mode))
        os.replace(temporary, target)


def check_writable(path: str | os.PathLike) -> None:
    """Raise OSError, which names the path, if `replacing` could not write to it.

    The folder of the path is made if it is missing, and stays.
    """
    with _beside(path) as (_, temporary):
        temporary.touch()


@contextmanager
def _beside(path: str | os.PathLike) -> Iterator[tuple[Path, Path]]:
    """Context with (target, temporary): the file to which a path leads, and a new temporary path in its folder.

    No other process uses the temporary path. Its file is removed at the end.
    """
    target = Path(os.path.realpath(path_of(path)))
    if target.exists():
        refuse_special(target, OSError)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
    try:
        yield target, temporary
    except OSError as error:
        is_nameless = error.filename is None and error.errno is not None  # the error names no file, as on a full disk
        if is_nameless or error.filename == str(temporary):
            error.filename = str(path)
            del error.filename2  # with None, the text of the error would end in "-> None"
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: str | os.PathLike, data: bytes) -> Path:
    """Write bytes to a file in one move. The folder is made if it is missing. Returns the path."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    return Path(path)


def write_json(path: str | os.PathLike, value) -> Path:
    """Write `value` to a file as strict JSON. The folder is made if it is missing. Returns the path.

    Objects are indented, lists without objects stay on one line, and floats are written with all their digits. Raises
    ValueError for NaN and infinity, and TypeError for values that JSON cannot represent.
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
    """Raise `error` if a path is a folder, a device or a pipe; a read from a pipe would wait for its writer.

    Raises OSError if there is no file.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise error(f"{path}: expected a file, got a folder, pipe or device")


def read_bytes(path: str | os.PathLike, most: int, error: type[ValueError] = ValueError) -> bytes:
    """Return the bytes of a file. They are decompressed if they begin as gzip data do, or if its name ends in .gz.

    most: largest number of bytes, both before and after decompression. Raises `error`, which names the file, if the
    file is larger, or if its gzip data are damaged or incomplete. Raises OSError if the file cannot be opened.
    """
    path = path_of(path)
    refuse_special(path, error)
    if (size := path.stat().st_size) > most:
        raise error(f"{path}, line 1: expected at most {most} bytes, got {size}")
    data = path.read_bytes()
    if path.suffix != ".gz" and data[:2] != b"\x1f\x8b":
        return data
    # Not by the module `gzip`: it has no limit of size, and takes microseconds for each empty member.
    member = zlib.decompressobj(wbits=31)
    try:
        unpacked = member.decompress(data, most + 1)
        if len(unpacked) > most or not member.eof or member.unused_data:
            raise zlib.error(f"expected at most {most} bytes in one whole member")
    except zlib.error as damage:
        raise error(f"{path}: expected gzip data, whole and undamaged: {damage}") from None
    return unpacked
