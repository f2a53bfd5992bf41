"""Keep Numba's cache of machine code true to the sources, and whole.

Numba compiles a function again when its own file has changed, but not when something has changed that was compiled into
it from another file. Here cached code is stale once any file of this package has changed that its file imports,
directly or not. A file that must not import what is compiled into it names that in a comment, `# compiled in:
deep_contact.…`. Cached bytes carry a checksum: damaged ones, which would end the process, are compiled again. Code for
classes of other packages is not kept, since it would outlive a change of them. Where no folder can be written, nothing
is kept. All replace details of `numba.core.caching`, and hold for everything that the process compiles.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import re
import warnings
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from numba.core import caching
from numba.core.dispatcher import Dispatcher

_ROOT = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(
    rb"^(?:from (deep_contact[\w.]*) import (\([^)]*\)|.*)|(?:import|# compiled in:) (deep_contact[\w.]*))",
    re.MULTILINE,
)
_KNOWN = {"builtins", "copyreg", "deep_contact", "numba", "numpy"}
"""Packages whose types compiled code is kept for."""

_enable = Dispatcher.enable_caching
_stamp_of_one_file = caching._SourceFileBackedLocatorMixin.get_source_stamp


def install() -> None:
    """Make the caches of this process behave as the module says."""
    caching.IndexDataCacheFile = _CheckedFile
    caching._SourceFileBackedLocatorMixin.get_source_stamp = _stamp
    Dispatcher.enable_caching = _enable_caching


def _enable_caching(dispatcher) -> None:
    try:
        _enable(dispatcher)
    except RuntimeError as error:
        if "no locator" not in str(error):
            raise
        _warn_once()


@cache
def _warn_once() -> None:
    warnings.warn(
        "compiled code: expected a folder to keep it in, beside the package, in the home folder or in NUMBA_CACHE_DIR; "
        "none can be written, so every process compiles anew",
        stacklevel=2,
    )


def _stamp(locator):
    try:
        return source_stamp(Path(locator._py_file))
    except OSError:  # a frozen program has no sources
        return _stamp_of_one_file(locator)


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
    data = Path(path).read_bytes() if Path(path).exists() else b""
    return data[-16:] == _checksum(data[:-16])


def _checksum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=16).digest()
