"""Keras and TensorFlow: the one place that imports them, without a line of TensorFlow's log on the screen."""

from __future__ import annotations

import importlib
import os
import sys
import threading
from contextlib import contextmanager, suppress

from deep_contact.validation import integer

_threads: int | None = None
"""What `limit_threads` asked for."""

_importing = threading.RLock()
"""Held while a package is imported: file descriptor 2 is the process's, and half a package is no package."""


def __getattr__(name: str):
    """`from deep_contact.cnn.backend import keras`, or `tensorflow`: the package, imported by the first who asks."""
    if name not in ("keras", "tensorflow"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    _expect_tensorflow(os.environ.get("KERAS_BACKEND", "tensorflow"))
    with _importing:
        if name not in sys.modules:
            # TensorFlow's later messages are below this level. The first ones do not know any level yet.
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
    """Let TensorFlow use so many threads for all networks of this process, now or as soon as it is imported.

    Raises RuntimeError where TensorFlow is already at work with another number.
    """
    global _threads
    _threads = integer("threads", count, 1)
    _apply_limit()


def one_thread() -> None:
    """Let TensorFlow use one thread in this process. Where it is already at work, only times depend on it."""
    with suppress(RuntimeError):
        limit_threads(1)


def _apply_limit() -> None:
    if _threads is not None and "tensorflow" in sys.modules:
        pools = sys.modules["tensorflow"].config.threading
        pools.set_intra_op_parallelism_threads(_threads)
        pools.set_inter_op_parallelism_threads(1)


@contextmanager
def _silent():
    """Drop what is written to file descriptor 2, by C++ as well."""
    try:
        before = os.dup(2)
    except OSError:  # a process without one, as under pythonw
        yield
        return
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
