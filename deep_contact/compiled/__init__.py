"""What Numba needs and no physicist has to read: its cache of compiled code, and vector instructions."""

import multiprocessing
import sys
import time
from collections.abc import Callable
from functools import cache

from numba.core import event

# compiled in: deep_contact.compiled.boxing

PATIENCE, ESTIMATE = 0.5, "it takes half a minute to a minute; `deep-contact warm-up` does it ahead"
"""After how many seconds a process says that it is compiling, and how long it may take."""


@cache
def prepare_numba() -> None:
    """Make Numba's cache and Ctrl-C safe, keep SciPy out of processes that do not use it, and say what is compiled.

    Call it before `njit` is used.
    """
    from numba.np import linalg

    from deep_contact.compiled import boxing, code_cache

    code_cache.install()
    boxing.install()
    # Numba imports scipy.linalg only to know whether it can compile `np.dot`, which takes a quarter of the time to the
    # first step. This package depends on SciPy, and Numba checks again when it compiles a call of BLAS.
    check, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = check
    if multiprocessing.parent_process() is None or multiprocessing.current_process().name.endswith("-1"):
        event.register("numba:compile", Announcement(lambda line: print(line, file=sys.stderr, flush=True)))


class Announcement(event.Listener):
    """Hands one line to `echo` once physics, which no cache had, take Numba longer than `PATIENCE`."""

    is_made, running, begun = False, 0, 0.0

    def __init__(self, echo: Callable[[str], None]):
        self.echo = echo

    def on_start(self, event) -> None:
        self.begun = self.begun if self.running else time.perf_counter()
        self.running += 1
        is_long = time.perf_counter() - self.begun >= PATIENCE
        module = str(event.data["dispatcher"].py_func.__module__)  # Numba makes functions of no module
        if is_long and not self.is_made and "deep_contact.physics." in module:
            self.is_made = True
            self.echo(f"deep_contact: compiling for this kind of scene and solver, once; {ESTIMATE}")

    def on_end(self, event) -> None:
        self.running -= 1
