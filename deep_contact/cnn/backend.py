"""Keras and TensorFlow: the one place that imports them, without a line of TensorFlow's log on the screen."""

from __future__ import annotations

import importlib
import os
import sys
import threading
from contextlib import contextmanager, suppress

from deep_contact.state.validation import integer

_threads: int | None = None
"""Number of threads that `limit_threads` has set. None: TensorFlow chooses."""

_importing = threading.RLock()
"""Lock of an import: file descriptor 2 belongs to the whole process, and no thread may see half a package."""


def __getattr__(name: str):
    """`from deep_contact.cnn.backend import keras`, or `tensorflow`: the package, imported on first use."""
    if name not in ("keras", "tensorflow"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    _expect_tensorflow(os.environ.get("KERAS_BACKEND", "tensorflow"))
    with _importing:
        if name not in sys.modules:
            # This level hides TensorFlow's later messages. The first ones come before the level is read: `_silent`.
            os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
            try:
                with _silent():
                    importlib.import_module(name)
            except ModuleNotFoundError as error:
                needs = "expected the package, which training and networks on images need, got none"
                ways = 'pip install keras tensorflow; the network "far field" needs neither'
                raise ModuleNotFoundError(f"{error.name}: {needs}: {ways}") from error
            _apply_limit()
    if name == "keras":
        _expect_tensorflow(sys.modules[name].backend.backend())
    return sys.modules[name]


def _expect_tensorflow(backend: str) -> None:
    if backend != "tensorflow":
        needs = "expected it as the backend of Keras, which training and networks on images need"
        raise ModuleNotFoundError(f"tensorflow: {needs}, got {backend!r}: unset KERAS_BACKEND, or change keras.json")


def limit_threads(count: int) -> None:
    """Let TensorFlow use `count` threads for all networks of this process, now or as soon as it is imported.

    Raises RuntimeError where TensorFlow already works with another number of threads.
    """
    global _threads
    _threads = integer("threads", count, 1)
    _apply_limit()


def one_thread() -> None:
    """Let TensorFlow use one thread in this process. Where it already works with more, it keeps them."""
    with suppress(RuntimeError):
        limit_threads(1)


def _apply_limit() -> None:
    if _threads is not None and "tensorflow" in sys.modules:
        pools = sys.modules["tensorflow"].config.threading
        pools.set_intra_op_parallelism_threads(_threads)
        pools.set_inter_op_parallelism_threads(1)


@contextmanager
def _silent():
    """Drop all output to file descriptor 2, that of C++ included."""
    try:
        before = os.dup(2)
    except OSError:  # a process without this descriptor, as under pythonw
        yield
        return
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
