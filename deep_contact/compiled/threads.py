"""How many threads Numba's parallel functions use, and of which library."""

from __future__ import annotations

from contextlib import contextmanager

from numba import config, get_num_threads, set_num_threads

if config.THREADING_LAYER == "default":
    # GNU's OpenMP ends every process that is forked after it has run, as joblib, multiprocessing and data loaders do.
    config.THREADING_LAYER = "forksafe"


@contextmanager
def at_most_threads(count: int):
    """Let Numba's parallel functions use `count` threads, or one a core if there are fewer cores."""
    before = get_num_threads()
    set_num_threads(min(count, config.NUMBA_NUM_THREADS))
    try:
        yield
    finally:
        set_num_threads(before)
