"""What Numba needs and no physicist has to read: its cache of compiled code, and vector instructions."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

# compiled in: deep_contact.compiled.boxing


@cache
def prepare_numba() -> None:
    """Make Numba's cache and Ctrl-C safe, and keep SciPy out of processes that do not use it.

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


@contextmanager
def announced(echo: Callable[[str], None]) -> Iterator[None]:
    """Within the block, hand one line to `echo` if Numba compiles something, which it does where no cache has it."""
    from numba.core import event

    class Announcement(event.Listener):
        told = False

        def on_start(self, event) -> None:
            if not self.told:
                self.told = True
                echo("compiling, once")

        def on_end(self, event) -> None:
            pass

    with event.install_listener("numba:compile", Announcement()):
        yield
