"""Cache Numba's machine code in files, and compile it again if it is out of date or damaged.

Numba compiles a function again if its own file has changed. It does not do so if another file has changed, from which
code was compiled into the function. Here the cached code of a function is out of date as soon as any file of this
package has changed that the function's file imports, directly or through other files.

Each cached file ends with a checksum. Damaged code would crash the process, so it is compiled again. Code for classes
of other packages is not cached, because the cache would not notice a change of these classes.

Cached code is read from the folder beside the sources, even if that folder is read-only. It is written to the first
folder that can be written. If several processes need the same function for the same types at the same time, one of them
compiles it, and the others wait. Other machines can use the files, too.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import os
import pickle
import re
import sys
import time
import warnings
import zlib
from collections.abc import Callable
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace

from numba import config
from numba.core import caching, compiler
from numba.misc.appdirs import AppDirs

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

MOST_WAIT = 120.0
"""Longest time that a process waits for another process that compiles the same function, s."""

_ROOT = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(rb"^(?:from (deep_contact[\w.]*) import (\([^)]*\)|.*)|import (deep_contact[\w.]*))", re.MULTILINE)
_KNOWN = {"builtins", "copyreg", "deep_contact", "numba", "numpy"}
"""Names of packages. Compiled code is cached only if the types of all its arguments come from them."""


class CodeCache(caching.NullCache):
    """The cached compiled versions of a function, in files that `numba.core.caching` reads and writes.

    function: Python function. on_wait: function without arguments, called again and again while this process waits for
    another process that compiles the same function, from half a second on. of_inner: whether the versions are those of
    `LeanDispatcher.inner`. Python cannot call these, so they have entries of their own.
    """

    def __init__(self, function, on_wait: Callable, of_inner: bool = False):
        file = inspect.getfile(function)
        name = f"{Path(file).stem}.{function.__qualname__}-{function.__code__.co_firstlineno}".translate(_BRACKETS)
        name += f".py{sys.version_info[0]}{sys.version_info[1]}{getattr(sys, 'abiflags', '')}"
        self._py_func, self._files, self._mark = function, [], ("inner",) if of_inner else ()
        self._locator, self._lineno = SimpleNamespace(_py_file=file), function.__code__.co_firstlineno  # for a warning
        self._turn, self._writing = (_Turn(f"{name}{of}", _folders(file), on_wait) for of in ("", " index"))
        with suppress(OSError):  # no sources, as in a frozen program or a notebook
            stamp = source_stamp(Path(file))
            self._files = [_CheckedFile(folder, name, stamp) for folder in _folders(file)]

    _index_key = caching.Cache._index_key
    check_cachable = caching.CompileResultCacheImpl.check_cachable

    def load_overload(self, signature, context):
        """Return the compiled version for a signature, or None if none is cached.

        After None, this process is expected to compile the function. Other processes wait until it calls `end_turn`.
        """
        context.refresh()
        key = self._index_key(signature, context.codegen()) + self._mark
        reduced = self._load(key)
        if reduced is None and self._files and self._turn.take(str((signature, *self._mark))):
            reduced = self._load(key)
        return None if reduced is None else compiler.CompileResult._rebuild(context, *reduced)

    def _load(self, key):
        return next((data for file in self._files if (data := file.load(key)) is not None), None)

    def save_overload(self, signature, result) -> None:
        """Write the compiled version for a signature to the first folder that can be written; warn if there is none."""
        if not (self._files and self.check_cachable(result)):
            return
        key, reduced = self._index_key(signature, result.codegen) + self._mark, result._reduce()
        for file in self._files:
            with suppress(OSError):
                os.makedirs(file._cache_path, exist_ok=True)
                self._writing.take()  # two processes that write at once could lose a version, or give both one number
                try:
                    return file.save(key, reduced)
                finally:
                    self._writing.end()
        _warn_once()

    def end_turn(self) -> None:
        """Let other processes compile the function."""
        self._turn.end()


_BRACKETS = str.maketrans("", "", "<>")


def _folders(file: str) -> list[str]:
    """Return the folders in which the cached code of a source file is searched, in the order of the search.

    They are Numba's own folders. Unlike Numba, this function does not try to write to them.
    """
    inside = caching._CacheLocator.get_suitable_cache_subpath(file)
    if config.CACHE_DIR:
        return [os.path.join(config.CACHE_DIR, inside)]
    own = os.path.join(AppDirs(appname="numba", appauthor=False).user_cache_dir, inside)
    return [os.path.join(os.path.dirname(file), "__pycache__"), own]


@cache
def _warn_once() -> None:
    warnings.warn(
        "compiled code: expected a folder to keep it in, beside the package, in the home folder or in NUMBA_CACHE_DIR; "
        "none can be written, so every process compiles anew",
        stacklevel=2,
    )


class _Turn:
    """The exclusive right of this process to compile a function, or to write its files: a lock on one byte of a file.

    The operating system ends the lock at the latest when the process ends.

    name: name of the function. folders: folders in which the lock file may lie; the first that can be written is used.
    on_wait: function without arguments, called again and again while another process has the lock, from half a second
    on.
    """

    def __init__(self, name: str, folders: list[str], on_wait: Callable):
        self._name, self._folders, self._on_wait, self._file, self._byte = name, folders, on_wait, None, 0

    def take(self, signature: str = "") -> bool:
        """Wait for the lock, at most `MOST_WAIT` seconds. Returns whether this process has the lock now.

        signature: types of the arguments, as text. The name of the function and the signature determine the byte that
        is locked.
        """
        self._byte = zlib.crc32(f"{self._name} {signature}".encode()) >> 1
        file, begun = next((one for one in map(_lock_file, self._folders) if one is not None), None), time.monotonic()
        while file is not None and time.monotonic() - begun < MOST_WAIT:
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, self._byte)
                self._file = file
                return True
            except (BlockingIOError, PermissionError):  # another process has the lock
                if time.monotonic() - begun > 0.5:
                    self._on_wait()
                time.sleep(0.05)
            except OSError:  # a file system without locks
                break
        return False

    def end(self) -> None:
        if self._file is not None:
            fcntl.lockf(self._file, fcntl.LOCK_UN, 1, self._byte)
            self._file = None


@cache
def _lock_file(folder: str):
    """Return the descriptor of the file whose bytes are locked, or None if locks are impossible in this folder.

    The file stays open, because closing it would end all locks of this process on it.
    """
    with suppress(OSError):
        if fcntl is not None:
            os.makedirs(folder, exist_ok=True)
            return os.open(os.path.join(folder, "deep_contact.lock"), os.O_RDWR | os.O_CREAT, 0o666)


@cache
def source_stamp(file: Path, root: Path = _ROOT) -> str:
    """Return a checksum of a source file and of all files of `deep_contact` that it imports, directly or not.

    root: folder in which the folder `deep_contact` lies.
    """
    checksums, waiting = {}, {file}
    while waiting:
        file = waiting.pop()
        checksums[file], imported = _read(file, root)
        waiting |= imported - checksums.keys()
    return hashlib.sha256(b"".join(checksums[file] for file in sorted(checksums))).hexdigest()


@cache
def _read(file: Path, root: Path) -> tuple[bytes, set[Path]]:
    """Return the checksum of a file, and the set of files of `deep_contact` that it imports at its top level."""
    text, modules = file.read_bytes(), set()
    for origin, names, module in _IMPORT.findall(text):
        modules |= {origin or module, *(origin + b"." + name for name in re.findall(rb"\w+", names))}
    places = [root / module.decode().replace(".", "/") for module in modules]
    # The import of a module also runs the `__init__.py` of its packages. The engine imports only the package of the
    # solvers, which in turn imports their loops.
    inside = root / "deep_contact"
    packages = {package for place in places for package in (place, *place.parents) if inside in package.parents}
    files = {place.with_suffix(".py") for place in places} | {package / "__init__.py" for package in packages}
    return _checksum(text), {file for file in files if file.exists()}


class _CheckedFile(caching.IndexDataCacheFile):
    """Files of cached code: an index and its data files, each with a checksum at its end, which unpickling ignores."""

    @contextmanager
    def _open_for_write(self, path: str):
        content = io.BytesIO()
        yield content
        with super()._open_for_write(path) as file:
            file.write(content.getvalue() + _checksum(content.getvalue()))

    def save(self, key, data) -> None:
        if _modules_in(self._dump(key)) <= _KNOWN:
            super().save(key, data)

    def _load_index(self) -> dict:
        try:
            return super()._load_index() if _is_whole(self._index_path) else {}
        except (ImportError, AttributeError):  # the index names a class that no longer exists under this name
            return {}

    def _load_data(self, name: str):
        if not _is_whole(self._data_path(name)):
            raise OSError(f"{name}: expected the checksum of its contents")  # Numba treats it like a missing file
        return super()._load_data(name)


def _modules_in(pickled: bytes) -> set[str]:
    """Return the names of the packages to which the classes and functions in pickled bytes belong."""
    packages = set()

    class Reader(pickle.Unpickler):
        def find_class(self, module, name):
            packages.add(module.partition(".")[0])
            return super().find_class(module, name)

    Reader(io.BytesIO(pickled)).load()
    return packages


def _is_whole(path: str) -> bool:
    try:
        data = Path(path).read_bytes()
    except OSError:
        return False
    return data[-16:] == _checksum(data[:-16])


def _checksum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=16).digest()
