"""The only module that imports Keras and TensorFlow. It keeps TensorFlow's log messages off the screen.

Tests: tests/cnn/test_inference.py, tests/cnn/test_training.py, tests/behaviour/test_without_keras.py
"""

from __future__ import annotations

import importlib
import os
import sys
import threading
from contextlib import contextmanager, suppress

from deep_contact.state.validation import integer

_threads: int | None = None
"""Number of threads that `limit_threads` has set, or None, with which TensorFlow chooses the number."""

_importing = threading.RLock()
"""Lock that a thread holds during an import. No other thread may see a package that is half imported.

The import also redirects file descriptor 2, which all threads of the process share.
"""


def __getattr__(name: str):
    """Return the package "keras" or "tensorflow", and import it on first use.

    Python calls this function for `from deep_contact.cnn.backend import keras`. Raises AttributeError for another name,
    and ModuleNotFoundError if the package is missing or Keras has another backend.
    """
    if name not in ("keras", "tensorflow"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    _expect_tensorflow(os.environ.get("KERAS_BACKEND", "tensorflow"))
    with _importing:
        if name not in sys.modules:
            # This level hides TensorFlow's later messages. `_silent` hides those that come before the level is read.
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
    """Set the number of threads that TensorFlow uses for all networks of this process.

    If TensorFlow has not been imported yet, the number is set when it is. Raises RuntimeError if TensorFlow already
    works with another number of threads.
    """
    global _threads
    _threads = integer("threads", count, 1)
    _apply_limit()


def one_thread() -> None:
    """Set the number of TensorFlow's threads in this process to 1, unless TensorFlow already works with more."""
    with suppress(RuntimeError):
        limit_threads(1)


def _apply_limit() -> None:
    if _threads is not None and "tensorflow" in sys.modules:
        pools = sys.modules["tensorflow"].config.threading
        pools.set_intra_op_parallelism_threads(_threads)
        pools.set_inter_op_parallelism_threads(1)


@contextmanager
def _silent():
    """Discard all output to file descriptor 2, the standard error, including the output of C++ code."""
    try:
        before = os.dup(2)
    except OSError:  # the process has no standard error, as under pythonw
        yield
        return
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
