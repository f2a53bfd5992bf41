"""The cache of compiled code: it notices damage, and a change of any source that was compiled into it; it can be moved
to another machine; other code in the process keeps Numba's own cache; and compiling is announced."""

import importlib
import pickle
import platform
import re
import shutil
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import numba
import numpy as np
import pytest
from conftest import ROOT, run_python
from numba.core import event

import deep_contact.compiled as compiled
from deep_contact.compiled import Announcement, code_cache, njit
from deep_contact.compiled.code_cache import source_stamp

needs_compiler = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")

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
        code_cache._read.cache_clear()
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
    """The files of a function, with one entry."""
    cache = code_cache._CheckedFile(str(tmp_path), "sweep", "stamp")
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
    assert code_cache._CheckedFile(str(tmp_path), "sweep", "other").load("key") is None  # of another stamp


def imported(folder, name, text, monkeypatch):
    """The module of this text."""
    (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
    module = importlib.import_module(name)
    del sys.modules[name]
    return module


@needs_compiler
def test_a_users_function_is_stale_once_the_package_changed(tmp_path, monkeypatch):
    """One that is compiled with kernels of this package has to be compiled again with them."""
    text = "from deep_contact.compiled import njit\n@njit(cache=True)\ndef f():\n    return 1\n"
    (file,) = {file._source_stamp for file in imported(tmp_path, "of_a_user", text, monkeypatch).f._cache._files}
    assert file == source_stamp(tmp_path / "of_a_user.py")
    assert file != source_stamp(tmp_path / "of_a_user.py", tmp_path)  # where no deep_contact is


@needs_compiler
def test_code_for_classes_of_other_packages_is_not_kept(tmp_path, monkeypatch):
    text = (
        "from typing import NamedTuple\nfrom deep_contact.compiled import njit\nfrom deep_contact.state import Bodies\n"
        "class Mine(NamedTuple):\n    x: float\n@njit(cache=True)\ndef f(a):\n    return a[0]\n"
    )
    module = imported(tmp_path, "of_a_solver", text, monkeypatch)
    assert module.f(module.Mine(2.0)) == 2.0
    assert not list(tmp_path.rglob("*.nbi"))
    bodies = module.Bodies(*(np.ones(1),) * len(module.Bodies._fields))
    assert module.f(bodies) == module.f((1.0, 2.0)) == 1.0
    assert len(list(tmp_path.rglob("*.nbc"))) == 2


UNTOUCHED = """
from numba.core import boxing, caching, codegen, dispatcher, pythonapi, types
from numba.core.runtime.context import NRTContext
from numba.np import linalg

def seen():
    places = caching, caching.IndexDataCacheFile, caching._SourceFileBackedLocatorMixin, dispatcher.Dispatcher
    boxers = [pythonapi._boxers.functions[one] for one in (types.NamedTuple, types.NamedUniTuple)]
    places += pythonapi.PythonAPI, codegen.JITCPUCodegen, NRTContext, linalg
    return [dict(vars(one)) for one in places], boxers

before = seen()
from deep_contact.stepping.convergence import is_over
import deep_contact.run.one_scene, deep_contact.sph.grid, deep_contact.cnn.convolution
is_over(1.0, 2.0)
print(before == seen())
"""


def test_the_package_leaves_numba_as_it_was():
    assert run_python("-c", UNTOUCHED).stdout.strip() == "True"


def test_all_functions_of_the_package_are_compiled_by_its_own_decorator():
    """Numba's own would keep code that something else in the package has made stale."""
    own = re.compile(r"from numba import .*\bn?jit\b|numba\.n?jit\(")
    assert not [str(path) for path in (ROOT / "deep_contact").rglob("*.py") if own.search(path.read_text())]


@needs_compiler
def test_numba_compiles_what_needs_blas_without_importing_it_before():
    assert numba.njit(lambda a: np.dot(a, a))(np.full((2, 2), 2.0)).tolist() == [[8.0, 8.0], [8.0, 8.0]]


SMALL = """
from deep_contact.stepping.convergence import all_finite, is_over
from deep_contact.sph.kernels import gaussian, np
for function, arguments in ((is_over, (1.0, 2.0)), (all_finite, (np.ones((3, 4)),)), (gaussian, (0.3, 2))):
    print(function(*arguments), sum(function.stats.cache_misses.values()))
"""
"""Prints what small functions return, and how many versions of each were compiled."""


def copy_of_the_package(folder):
    return shutil.copytree(ROOT / "deep_contact", folder / "deep_contact", ignore=shutil.ignore_patterns("__pycache__"))


def run_small(folder, **environment):
    """What `SMALL` prints with the package in this folder and no home."""
    nowhere = {"HOME": "/dev/null/none", "XDG_CACHE_HOME": "/dev/null/none", "NUMBA_CACHE_DIR": ""}
    environment |= nowhere | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    return run_python("-c", SMALL, environment=environment, cwd=folder)


@needs_compiler
def test_without_a_folder_to_keep_code_in_functions_are_compiled_and_one_warning_says_so(tmp_path):
    package = copy_of_the_package(tmp_path)
    for folder in (package, *(path for path in package.rglob("*") if path.is_dir())):
        (folder / "__pycache__").touch()  # a file, in whose place not even root can make a folder
    done = run_small(tmp_path)
    assert done.stderr.count("compiled code: expected a folder") == 1
    assert done.stdout.count(" 1\n") == 3


@needs_compiler
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="the name of another kind of processor")
def test_code_for_a_named_processor_travels(tmp_path):
    """As in a container: the folder is another one, nothing can be written, and nothing has to be."""
    target = {"NUMBA_CPU_NAME": "x86-64-v2", "NUMBA_CPU_FEATURES": ""}
    copy_of_the_package(tmp_path / "here")
    first = run_small(tmp_path / "here", **target).stdout
    there = (tmp_path / "here").rename(tmp_path / "there")
    before = {path: path.stat().st_mtime_ns for path in there.rglob("*")}
    assert first.count(" 1\n") == 3
    assert run_small(there, **target).stdout == first.replace(" 1\n", " 0\n")
    assert {path: path.stat().st_mtime_ns for path in there.rglob("*")} == before


KILLED = """
import os, signal, sys
from numba.core import event
from deep_contact.compiled import code_cache

def die(*arguments):
    os.kill(os.getpid(), signal.SIGKILL)

if sys.argv[1] == "compiling":
    class Death(event.Listener):
        on_start, on_end = die, die
    event.register("numba:compile", Death())
else:
    setattr(code_cache._CheckedFile, sys.argv[1], die)
"""
"""Kills its process when the first function of `SMALL` is compiled, or when a file of its cache is written."""


@needs_compiler
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal on this system")
@pytest.mark.parametrize(
    "when", [pytest.param(when, marks=pytest.mark.slow) for when in ("compiling", "_save_data")] + ["_save_index"]
)
def test_a_process_that_is_killed_leaves_a_cache_that_works(tmp_path, when):
    """The code that it was about to keep is compiled by the next process, and read by the one after that."""
    copy_of_the_package(tmp_path)
    environment = {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": ""}
    run_python("-c", KILLED + SMALL, when, status=-signal.SIGKILL, environment=environment, cwd=tmp_path)
    first = run_small(tmp_path).stdout
    assert first.count(" 1\n") == 3
    assert run_small(tmp_path).stdout == first.replace(" 1\n", " 0\n")


def double(x):
    return x + x


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Where the code of all functions is looked for."""
    paths = [str(tmp_path / name) for name in ("beside", "own")]
    monkeypatch.setattr(code_cache, "_folders", lambda file: paths)
    return paths


def hits_and_misses(function):
    return tuple(sum(counts.values()) for counts in (function.stats.cache_hits, function.stats.cache_misses))


@needs_compiler
def test_code_is_read_where_nothing_can_be_written_and_written_elsewhere(folders, monkeypatch):
    njit(double, cache=True)(1)
    save = code_cache._CheckedFile.save

    def refuse(file, *entry):
        if file._cache_path == folders[0]:
            raise PermissionError
        save(file, *entry)

    monkeypatch.setattr(code_cache._CheckedFile, "save", refuse)
    for counts in ((1, 1), (2, 0)):
        again = njit(double, cache=True)
        assert [again(1), again(0.5)] == [2, 1.0]
        assert hits_and_misses(again) == counts


LARGE = np.arange(200_000.0)  # so large that compiled code holds its address, which another process does not have


def read_large(i):
    return LARGE[i]


@needs_compiler
def test_code_that_holds_an_address_is_not_kept(folders):
    for _ in range(2):
        read = njit(read_large, cache=True)
        with pytest.warns(numba.NumbaWarning, match='Cannot cache compiled function "read_large"'):
            assert read(3) == 3.0
        assert hits_and_misses(read) == (0, 1)


@needs_compiler
def test_what_another_process_has_compiled_meanwhile_is_not_compiled_again(folders, monkeypatch):
    mine, others = (njit(double, cache=True) for _ in range(2))

    def wait(turn, signature):
        monkeypatch.setattr(code_cache._Turn, "take", lambda turn, signature="": False)
        return others(1) == 2

    monkeypatch.setattr(code_cache._Turn, "take", wait)
    assert mine(1) == 2
    assert hits_and_misses(mine) == (1, 0)


TAKEN = """
import sys
from deep_contact.compiled.code_cache import _Turn
print(_Turn("f", sys.argv[1:], None).take("int64"), flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(code_cache.fcntl is None, reason="no locks on this system")
def test_another_processs_turn_is_waited_for_as_long_as_it_lives_but_not_for_ever(tmp_path, monkeypatch):
    said, command = [], [sys.executable, "-c", TAKEN, str(tmp_path)]
    turn = code_cache._Turn("f", [str(tmp_path)], lambda: said.append("compiling"))
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "True\n"
        assert code_cache._Turn("g", [str(tmp_path)], None).take("int64")  # of another function
        assert code_cache._Turn("f", [str(tmp_path)], None).take("float64")  # of other types
        monkeypatch.setattr(code_cache, "MOST_WAIT", 0.7)
        assert not turn.take("int64")
        assert said
        other.kill()
    assert turn.take("int64")


TWO = """
import sys, time
from deep_contact.compiled.code_cache import _CheckedFile
sys.path.insert(0, sys.argv[1])
from both import double, types
save = _CheckedFile._save_index
_CheckedFile._save_index = lambda *arguments: (time.sleep(0.1), save(*arguments))  # the other one reads the index now
print(flush=True)
sys.stdin.readline()
for kind in types[int(sys.argv[2]) :: 2]:
    double(kind(1))
"""


@needs_compiler
@pytest.mark.skipif(code_cache.fcntl is None, reason="no locks on this system")
def test_processes_that_compile_for_different_types_at_once_keep_every_version(tmp_path, monkeypatch):
    (tmp_path / "both.py").write_text(
        "import numpy as np\nfrom deep_contact.compiled import njit\n"
        "types = [np.int8, np.int16, np.int32, np.int64, np.float32, np.float64, np.complex64, np.complex128]\n"
        "@njit(cache=True)\ndef double(x):\n    return 2 * x\n"
    )
    command = [sys.executable, "-c", TWO, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with ExitStack() as stack:
        both = [stack.enter_context(subprocess.Popen([*command, str(i)], **pipes)) for i in range(2)]
        for process in both:
            process.stdout.readline()
        for process in both:
            process.stdin.write("\n")
            process.stdin.close()
    monkeypatch.syspath_prepend(tmp_path)
    import both as module

    assert [module.double(kind(1)) for kind in module.types] == [2] * 8
    assert hits_and_misses(module.double) == (8, 0)


def test_an_index_that_names_a_class_which_has_moved_counts_as_none(tmp_path):
    file = code_cache._CheckedFile(str(tmp_path), "moved", "stamp")
    named = b"cdeep_contact.moved_away\nState\n."  # pickled: a class of a module that is gone
    content = pickle.dumps(file._version) + named
    Path(file._index_path).write_bytes(content + code_cache._checksum(content))
    assert file._load_index() == {}
    file.save(("key",), "code")  # and is written anew
    assert file.load(("key",)) == "code"


@needs_compiler
def test_compiling_is_announced_once_and_only_where_physics_are_compiled(monkeypatch):
    monkeypatch.setattr(compiled, "PATIENCE", 0.0)
    one, two, other = (njit(lambda x, k=k: x + k) for k in range(3))
    one.py_func.__module__ = two.py_func.__module__ = "deep_contact.stepping.algorithm"
    other.py_func.__module__ = None  # as of functions that Numba makes
    for functions, lines in (((other,), 0), ((one, two), 1), ((one,), 0)):
        said = []
        with event.install_listener("numba:compile", Announcement(said.append)):
            for function in functions:
                function(1)
        assert len(said) == lines
