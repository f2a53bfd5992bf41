"""How many threads Numba's parallel functions use."""

from __future__ import annotations

from contextlib import contextmanager

from numba import config, get_num_threads, set_num_threads


@contextmanager
def at_most_threads(count: int):
    """Let Numba's parallel functions use `count` threads, or one a core if there are fewer cores."""
    before = get_num_threads()
    set_num_threads(min(count, config.NUMBA_NUM_THREADS))
    try:
        yield
    finally:
        set_num_threads(before)
