"""Numba's cache does not outlive a change of any source that was compiled into it, nor does damage go unnoticed; and
compiling is announced."""

import importlib
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import njit
from numba.core import caching, event

import deep_contact.compiled as compiled
from deep_contact.compiled import Announcement, code_cache
from deep_contact.compiled.code_cache import source_stamp

SOURCES = {
    "constants.py": "SLOP = 1\n",
    "physics/rows.py": "from deep_contact import constants\n",
    "physics/sweep.py": "import numba\nfrom deep_contact.physics import (\n    islands,\n    rows,\n)\n",
    "physics/islands.py": "x = 1\n",
    "physics/__init__.py": "from deep_contact.physics.loops import pgs\n",
    "physics/loops/__init__.py": "",
    "physics/loops/pgs.py": "x = 1\n",
    "plotting.py": "import deep_contact.physics.sweep\n",
}


@pytest.fixture
def stamp(tmp_path):
    """A function that writes a source and tells the stamp of the module sweep after it."""
    (tmp_path / "deep_contact" / "physics" / "loops").mkdir(parents=True)
    for name, text in SOURCES.items():
        (tmp_path / "deep_contact" / name).write_text(text)

    def write(name, text):
        source_stamp.cache_clear()
        compiled.code_cache._read.cache_clear()
        (tmp_path / "deep_contact" / name).write_text(text)
        return source_stamp(tmp_path / "deep_contact" / "physics" / "sweep.py", tmp_path)

    return write


@pytest.mark.parametrize(
    "name", ["constants.py", "physics/rows.py", "physics/sweep.py", "physics/islands.py", "physics/loops/pgs.py"]
)
def test_code_is_stale_once_anything_changed_that_its_module_imports(stamp, name):
    before = stamp(name, SOURCES[name])
    assert stamp(name, SOURCES[name] + "# changed\n") != before
    assert stamp(name, SOURCES[name]) == before


def test_code_stays_when_another_module_changes_and_circles_of_imports_have_a_stamp(stamp):
    assert stamp("plotting.py", "x = 2\n") == stamp("plotting.py", SOURCES["plotting.py"])
    assert stamp("constants.py", "from deep_contact.physics.sweep import x\n")


@pytest.fixture
def cached(tmp_path):
    """A cache as `prepare_numba` has Numba make it, with one entry."""
    compiled.prepare_numba()
    cache = caching.IndexDataCacheFile(str(tmp_path), "sweep", "stamp")
    cache.save("key", {"code": np.arange(100)})
    return cache


@pytest.mark.parametrize("name", ["sweep.nbi", "sweep.1.nbc"])
@pytest.mark.parametrize("how", ["flipped", "cut", "empty", "garbage", "missing"])
def test_a_damaged_file_counts_as_missing_and_is_replaced(cached, tmp_path, name, how):
    assert cached.load("key")["code"].sum() == 4950
    path = tmp_path / name
    data = path.read_bytes()
    middle = len(data) // 2
    flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
    path.write_bytes({"flipped": flipped, "cut": data[:50], "empty": b"", "garbage": b"garbage"}.get(how, b""))
    if how == "missing":
        path.unlink()
    assert cached.load("key") is None
    cached.save("key", {"code": np.ones(1)})
    assert cached.load("key")["code"].sum() == 1
    assert caching.IndexDataCacheFile(str(tmp_path), "sweep", "other").load("key") is None  # of another stamp


def test_a_users_function_is_stale_once_the_package_changed(tmp_path, monkeypatch):
    """One that is compiled with kernels of this package has to be compiled again with them."""
    (tmp_path / "of_a_user.py").write_text(
        "from numba import njit\nfrom deep_contact.physics import collision\n"
        "@njit(cache=True)\ndef f():\n    return 1\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    compiled.prepare_numba()
    found = importlib.import_module("of_a_user").f._cache._cache_file._source_stamp
    del sys.modules["of_a_user"]
    assert found == source_stamp(tmp_path / "of_a_user.py")
    assert found != source_stamp(tmp_path / "of_a_user.py", tmp_path)  # where no deep_contact is


def test_code_for_classes_of_other_packages_is_not_kept(tmp_path, monkeypatch):
    (tmp_path / "of_a_solver.py").write_text(
        "from typing import NamedTuple\nfrom numba import njit\nfrom deep_contact.state import Bodies\n"
        "class Mine(NamedTuple):\n    x: float\n@njit(cache=True)\ndef f(a):\n    return a[0]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    compiled.prepare_numba()
    module = importlib.import_module("of_a_solver")
    assert module.f(module.Mine(2.0)) == 2.0
    assert not list(tmp_path.rglob("*.nbi"))
    bodies = module.Bodies(*(np.ones(1),) * len(module.Bodies._fields))
    assert module.f(bodies) == module.f((1.0, 2.0)) == 1.0
    assert len(list(tmp_path.rglob("*.nbc"))) == 2


def test_numba_compiles_what_needs_blas_without_importing_it_before():
    compiled.prepare_numba()
    assert njit(lambda a: np.dot(a, a))(np.full((2, 2), 2.0)).tolist() == [[8.0, 8.0], [8.0, 8.0]]


def test_without_a_folder_to_keep_code_in_functions_are_compiled_and_one_warning_says_so(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    code_cache._warn_once.cache_clear()
    with pytest.warns(UserWarning, match="compiled code: expected") as warned:
        functions = [njit(cache=True)(lambda x: x + 1) for _ in range(2)]
    assert [function(1) for function in functions] == [2, 2]
    assert len(warned) == 1


def test_an_index_that_names_a_class_which_has_moved_counts_as_none(tmp_path):
    file = code_cache._CheckedFile(str(tmp_path), "moved", "stamp")
    named = b"cdeep_contact.moved_away\nState\n."  # pickled: a class of a module that is gone
    content = pickle.dumps(file._version) + named
    Path(file._index_path).write_bytes(content + code_cache._checksum(content))
    assert file._load_index() == {}
    file.save(("key",), "code")  # and is written anew
    assert file.load(("key",)) == "code"


def test_compiling_is_announced_once_and_only_where_physics_are_compiled(monkeypatch):
    monkeypatch.setattr(compiled, "PATIENCE", 0.0)
    one, two, other = (njit(lambda x, k=k: x + k) for k in range(3))
    one.py_func.__module__ = two.py_func.__module__ = "deep_contact.physics.engine"
    other.py_func.__module__ = None  # as of functions that Numba makes
    for functions, lines in (((other,), 0), ((one, two), 1), ((one,), 0)):
        said = []
        with event.install_listener("numba:compile", Announcement(said.append)):
            for function in functions:
                function(1)
        assert len(said) == lines
