"""Keep Numba's on-disk cache true to the sources, and whole.

Numba notices when the file of a cached function changes, but not when a function or a constant changes that lies in
another file and has been compiled into it. After an update of the package, old physics would go on silently. Nor does
it notice a file that a disk or a copy has damaged: depending on where, that ends in an error that says nothing of a
cache, or in the end of the process.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import os
from functools import cache
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_COMPILED = ("state.py", "constants.py", "physics/", "sph/", "cnn/", "compiled/")
_STAMP, _SUMS = "sources.stamp", "code.sums"


@cache
def drop_unfit_code(package: Path = _PACKAGE) -> None:
    """Delete what is stale and what is damaged of the package's cached machine code; when the process ends, note what
    is there by then. Once a process: later, what differs from the notes is what this process has compiled."""
    drop_stale_code(package)
    drop_damaged_code(package)
    atexit.register(note_code, package)


def drop_stale_code(package: Path = _PACKAGE) -> bool:
    """Delete the package's cached machine code if any of its sources changed since it was made. Says whether it did.

    Sources are compared by name, size and time of change. Where the folder cannot be written there is nothing to do:
    Numba then keeps its cache elsewhere, and a package that cannot be written is replaced as a whole.
    """
    stamp_file = package / "__pycache__" / _STAMP
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix()
        if not name.startswith(_COMPILED):
            continue
        stat = path.stat()
        digest.update(f"{name} {stat.st_size} {stat.st_mtime_ns}\n".encode())
    stamp = digest.hexdigest()
    try:
        if stamp_file.read_text() == stamp:
            return False
    except (OSError, UnicodeDecodeError):
        pass
    try:
        for path in _cached(package):
            path.unlink(missing_ok=True)
        _replace(stamp_file, stamp)
    except OSError:
        return False
    return True


def drop_damaged_code(package: Path = _PACKAGE) -> int:
    """Delete the cached files that are not whole. Returns how many there were.

    A file that has not been written since `note_code` has to have the checksum that was noted; one that has, and one
    that was never noted, has at least to begin and to end as what Numba writes, which is pickled.
    """
    noted = _noted(package)
    dropped = 0
    for path in _cached(package):
        try:
            *times, checksum = noted.get(_name(path, package), (0, 0, ""))
            data = path.read_bytes()
            same = times == _times(path)
            if (_digest(data) != checksum) if same else not (data[:1] == b"\x80" and data[-1:] == b"."):
                path.unlink(missing_ok=True)
                dropped += 1
        except OSError:
            continue
    return dropped


def note_code(package: Path = _PACKAGE) -> None:
    """Note a checksum of every cached file, for `drop_damaged_code` to compare. Only what is new is read."""
    before, now = _noted(package), {}
    try:
        for path in _cached(package):
            name, times = _name(path, package), _times(path)
            known = before.get(name, ())
            now[name] = known if list(known[:2]) == times else [*times, _digest(path.read_bytes())]
        if now != before:
            _replace(package / "__pycache__" / _SUMS, json.dumps(now))
    except OSError:
        pass  # a file that went meanwhile, or a package that cannot be written: noted next time, or never needed


def _cached(package: Path) -> list[Path]:
    return sorted(path for pattern in ("*.nbi", "*.nbc") for path in package.rglob(f"__pycache__/{pattern}"))


def _name(path: Path, package: Path) -> str:
    return path.relative_to(package).as_posix()


def _times(path: Path) -> list[int]:
    stat = path.stat()
    return [stat.st_size, stat.st_mtime_ns]


def _digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def _noted(package: Path) -> dict:
    """Name of a cached file -> [size, time of change, checksum]; empty where nothing sensible is noted."""
    try:
        noted = json.loads((package / "__pycache__" / _SUMS).read_text())
        return noted if all(len(entry) == 3 for entry in noted.values()) else {}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


def _replace(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        temporary.write_text(text)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
