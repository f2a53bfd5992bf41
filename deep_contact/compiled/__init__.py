"""`njit`, the decorator of compiled functions, whose machine code is cached in files.

The other modules of this folder change or extend Numba's compiler. No module here has any physics.

Tests: tests/compiled/test_code_cache.py, tests/compiled/test_target.py, tests/compiled/test_lean.py
"""

import multiprocessing
import sys
import time
from functools import partial
from pathlib import Path

from llvmlite.binding import get_host_cpu_features
from numba import config
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock
from numba.np import linalg

from deep_contact.compiled.boxing import safe_results
from deep_contact.compiled.code_cache import CodeCache

_NEEDED = {"x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")}
"""Target processor -> features that a processor needs to run code for it."""


def use_target(file: Path) -> None:
    """Let Numba compile for the processor that a file names, in this process, if this processor can run such code.

    Only wheels with machine code have the file (`scripts/wheel_with_code.sh`). The variable NUMBA_CPU_NAME has
    precedence. Code that Numba has compiled before in this process stays as it is.
    """
    if config.CPU_NAME is None and file.is_file():
        target, features = file.read_text().strip(), get_host_cpu_features()
        if target in _NEEDED and all(features.get(name) for name in _NEEDED[target]):
            config.CPU_NAME, config.CPU_FEATURES = target, ""


use_target(Path(__file__).with_name("target.txt"))

PATIENCE = 0.5
"""Time, s, after which a process says that it is compiling."""

ESTIMATE = "it takes a quarter of a minute to a minute; `deep-contact warm-up` does it ahead"
"""The part of the announcement that says how long compiling takes."""

PHYSICS = tuple(f"deep_contact.{folder}." for folder in ("stepping", "solvers", "starts", "analysis"))
"""Beginnings of the names of the modules whose compilation is announced to the user."""

# Numba imports scipy.linalg only to know whether it can compile `np.dot`, which takes a quarter of the time to the
# first step. This package depends on SciPy, and Numba checks again when it compiles a call of BLAS.
_check, linalg.ensure_blas = linalg.ensure_blas, lambda: None
try:
    from numba.np import arraymath  # noqa: F401

    from deep_contact.compiled.lean import LeanDispatcher, counted_alone, lazy_machine_code, uncollected
finally:
    linalg.ensure_blas = _check


class Announcement(event.Listener):
    """Prints a line once Numba has compiled for longer than `PATIENCE`, when it compiles a function of `PHYSICS`.

    echo: function that prints the line.
    """

    is_made, running, begun = False, 0, 0.0

    def __init__(self, echo):
        self.echo = echo

    def make(self) -> None:
        """Print the line, unless it has been printed."""
        if not self.is_made:
            self.is_made = True
            self.echo(f"deep_contact: compiling for this kind of scene and solver, once; {ESTIMATE}")

    def on_start(self, event) -> None:
        self.begun = self.begun if self.running else time.perf_counter()
        self.running += 1
        module = str(event.data["dispatcher"].py_func.__module__)  # Numba makes functions of no module
        if time.perf_counter() - self.begun >= PATIENCE and module.startswith(PHYSICS):
            self.make()

    def on_end(self, event) -> None:
        self.running -= 1


_announcement = Announcement(lambda line: print(line, file=sys.stderr, flush=True))
_process = multiprocessing.current_process()
if multiprocessing.parent_process() is None or _process.name.endswith("-1"):  # only one process of a pool prints it
    event.register("numba:compile", _announcement)
else:
    _announcement.is_made = True


class _Dispatcher(LeanDispatcher):
    """A compiled function. While Numba compiles it, Numba's compiler has the changes that this package needs."""

    def make_inner(self, options):
        inner = super().make_inner(options)
        if isinstance(self._cache, CodeCache):
            inner._cache = CodeCache(self.py_func, _announcement.make, of_inner=True)
        return inner

    def compile(self, signature):
        with global_compiler_lock, safe_results(), uncollected(), counted_alone(), lazy_machine_code():
            try:
                return super().compile(signature)
            finally:
                if isinstance(self._cache, CodeCache):
                    self._cache.end_turn()


def njit(function=None, *, cache=False, **options):
    """Return a compiled function, as `numba.njit` does. For functions of this package, and functions that call them.

    With cache=True, a `CodeCache` stores the machine code. Compiled code returns its results by `boxing.safe_results`.
    """
    if function is None:
        return partial(njit, cache=cache, **options)
    if config.DISABLE_JIT:
        return function
    # A function without fast-math flags would get those of its first caller from Numba. Its bits would then depend on
    # what the process compiled before. So every function gets flags here. The same holds for `_nrt`, whether references
    # to arrays are counted: a function that returns an array has to count them, whichever function calls it first.
    # No caller takes these functions by a pointer of C, whose wrappers took a twentieth of the time of compiling.
    fixed = {"nopython": True, "boundscheck": None, "no_cfunc_wrapper": True}
    options = {"fastmath": False, "_nrt": True} | options | fixed
    dispatcher = _Dispatcher(function, targetoptions=options)
    if cache:
        dispatcher._cache = CodeCache(function, _announcement.make)
    return dispatcher
