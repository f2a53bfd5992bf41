"""A cache of Numba's machine code that stays true to the sources, whole, and usable on other machines.

Numba compiles a function again when its own file has changed, but not when something has changed that was compiled into
it from another file. Here cached code is stale once any file of this package has changed that its file imports,
directly or not. Cached bytes carry a checksum: damaged ones, which would end the process, are compiled again. Code for
classes of other packages is not kept, since it would outlive a change of them. Code is read beside the sources, even
where nothing can be written there, and written to the first folder that takes it. Processes that need the same function
for the same types at the same time compile it once.
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
"""How long a process waits for another one that compiles the same function, s."""

_ROOT = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(rb"^(?:from (deep_contact[\w.]*) import (\([^)]*\)|.*)|import (deep_contact[\w.]*))", re.MULTILINE)
_KNOWN = {"builtins", "copyreg", "deep_contact", "numba", "numpy"}
"""Compiled code is kept only if the types of all its arguments come from these packages."""


class CodeCache(caching.NullCache):
    """The compiled versions of a function, in files that `numba.core.caching` reads and writes.

    on_wait: called where another process has been compiling the function for a while. of_inner: whether the versions
    are those of `LeanDispatcher.inner`, which are entries of their own: Python cannot call them.
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
        """The compiled version for a signature. None where there is none: then it is this process's turn to compile."""
        context.refresh()
        key = self._index_key(signature, context.codegen()) + self._mark
        reduced = self._load(key)
        if reduced is None and self._files and self._turn.take(str((signature, *self._mark))):
            reduced = self._load(key)
        return None if reduced is None else compiler.CompileResult._rebuild(context, *reduced)

    def _load(self, key):
        return next((data for file in self._files if (data := file.load(key)) is not None), None)

    def save_overload(self, signature, result) -> None:
        """Keep the compiled version for a signature, where a folder can be written."""
        if not (self._files and self.check_cachable(result)):
            return
        key, reduced = self._index_key(signature, result.codegen) + self._mark, result._reduce()
        for file in self._files:
            with suppress(OSError):
                os.makedirs(file._cache_path, exist_ok=True)
                self._writing.take()  # or two processes that add a version would lose one, or number both alike
                try:
                    return file.save(key, reduced)
                finally:
                    self._writing.end()
        _warn_once()

    def end_turn(self) -> None:
        """Let other processes have their turn."""
        self._turn.end()


_BRACKETS = str.maketrans("", "", "<>")


def _folders(file: str) -> list[str]:
    """Where the code of a source file is looked for, in this order: as Numba does, but without trying to write."""
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
    """The turn of this process at a function: a lock on a byte of a file, which ends with the process at last.

    on_wait: called where another process has had it for a while.
    """

    def __init__(self, name: str, folders: list[str], on_wait: Callable):
        self._name, self._folders, self._on_wait, self._file, self._byte = name, folders, on_wait, None, 0

    def take(self, signature: str = "") -> bool:
        """Wait for the turn at the function for a signature, at most `MOST_WAIT`. Returns whether it was taken."""
        self._byte = zlib.crc32(f"{self._name} {signature}".encode()) >> 1
        file, begun = next((one for one in map(_lock_file, self._folders) if one is not None), None), time.monotonic()
        while file is not None and time.monotonic() - begun < MOST_WAIT:
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, self._byte)
                self._file = file
                return True
            except (BlockingIOError, PermissionError):  # another process has it
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
    """Descriptor of the file whose bytes are locked, or None. It stays open: closing it would end all turns."""
    with suppress(OSError):
        if fcntl is not None:
            os.makedirs(folder, exist_ok=True)
            return os.open(os.path.join(folder, "deep_contact.lock"), os.O_RDWR | os.O_CREAT, 0o666)


@cache
def source_stamp(file: Path, root: Path = _ROOT) -> str:
    """Checksum of a source file and of all that it imports of `deep_contact`, which lies in the folder `root`."""
    checksums, waiting = {}, {file}
    while waiting:
        file = waiting.pop()
        checksums[file], imported = _read(file, root)
        waiting |= imported - checksums.keys()
    return hashlib.sha256(b"".join(checksums[file] for file in sorted(checksums))).hexdigest()


@cache
def _read(file: Path, root: Path) -> tuple[bytes, set[Path]]:
    """Checksum of a file, and the files that it imports when it is loaded."""
    text, modules = file.read_bytes(), set()
    for origin, names, module in _IMPORT.findall(text):
        modules |= {origin or module, *(origin + b"." + name for name in re.findall(rb"\w+", names))}
    places = [root / module.decode().replace(".", "/") for module in modules]
    # The import of a module runs its packages, too: the engine gets the loops of the solvers by their package alone.
    inside = root / "deep_contact"
    packages = {package for place in places for package in (place, *place.parents) if inside in package.parents}
    files = {place.with_suffix(".py") for place in places} | {package / "__init__.py" for package in packages}
    return _checksum(text), {file for file in files if file.exists()}


class _CheckedFile(caching.IndexDataCacheFile):
    """An index of cached code and its data files, each ending in a checksum, which unpickling ignores."""

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
        except (ImportError, AttributeError):  # it names a class that has moved since
            return {}

    def _load_data(self, name: str):
        if not _is_whole(self._data_path(name)):
            raise OSError(f"{name}: expected the checksum of its contents")  # which Numba takes for a missing file
        return super()._load_data(name)


def _modules_in(pickled: bytes) -> set[str]:
    """The packages of the classes and functions that are named in pickled bytes."""
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
