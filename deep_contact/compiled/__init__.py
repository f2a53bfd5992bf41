"""What Numba needs and no physicist has to read: its cache of compiled code, and vector instructions."""

import multiprocessing
import sys
from collections.abc import Callable
from functools import cache

# compiled in: deep_contact.compiled.boxing


@cache
def prepare_numba() -> None:
    """Make Numba's cache and Ctrl-C safe, keep SciPy out of processes that do not use it, and say what is compiled.

    Call it before `njit` is used.
    """
    from numba.core import event
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
    if multiprocessing.parent_process() is None:
        event.register("numba:compile", announcement(lambda line: print(line, file=sys.stderr, flush=True)))


def announcement(echo: Callable[[str], None]):
    """A listener that hands one line to `echo` when Numba first compiles physics, which no cache had."""
    from numba.core import event

    class Announcement(event.Listener):
        is_made = False

        def on_start(self, event) -> None:
            if not self.is_made and event.data["dispatcher"].py_func.__module__.startswith("deep_contact.physics."):
                self.is_made = True
                echo("deep_contact: compiling for this kind of scene and solver, once; it takes 20 to 60 s")

        def on_end(self, event) -> None:
            pass

    return Announcement()
