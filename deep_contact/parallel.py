"""Where independent tasks run: in processes of this machine, or on the workers of a Dask cluster.

An argument `jobs` takes the number of local processes, or an executor such as that of `cluster("tcp://10.0.0.1:8786")`;
the results have the same bits. docs/guide.md says how a cluster is started. Workers need no file system of the client:
tasks and results are sent. A task that reads a file, such as a network of `models/`, reads the worker's own.

The local pool is not joblib's: its workers outlive a killed parent and get Ctrl-C themselves.
"""

from __future__ import annotations

import gc
import hashlib
import multiprocessing
import os
import platform
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from pathlib import Path

from deep_contact.constants import VERSION
from deep_contact.io import provenance
from deep_contact.validation import integer

_PACKAGES = ("numba", "numpy", "scipy", "keras", "tensorflow")
"""Packages on whose versions results depend."""

SCHEDULER_HELP = "a Dask cluster, such as tcp://10.0.0.1:8786, in place of local processes"
"""Of the option `--scheduler`."""

_one_task = threading.Lock()


class ClusterError(RuntimeError):
    """A cluster that cannot be used; names the address or the worker, what was expected and what was found."""


def finished(function: Callable, items: Iterable, *, jobs: int | Executor = 1) -> Iterator[tuple[int, object]]:
    """(i, function(item i)) of all items, in the order in which they are done.

    jobs: number of local processes, which are spawned; with one, or one item, everything happens in this process.
    Or an executor, which stays open. `function` has to be found by import (a script's own functions are), and items and
    results have to be picklable. The first error, an interrupt, or closing the iterator cancels the tasks that have not
    begun, and ends local processes at once; use `contextlib.closing` where the loop itself may raise. Results are
    handed on and not kept. Raises ValueError for other `jobs`.
    """
    items = list(items)
    if not isinstance(jobs, Executor) and (integer("jobs", jobs, 1) == 1 or len(items) < 2):
        return ((i, function(item)) for i, item in enumerate(items))
    return _finished(function, items, jobs)  # a generator, which would raise at the first item alone


def _finished(function: Callable, items: list, jobs: int | Executor) -> Iterator[tuple[int, object]]:
    numbers = {}
    with nullcontext(jobs) if isinstance(jobs, Executor) else _processes(min(jobs, len(items))) as executor:
        try:
            with _interrupts_held_back():
                for i, item in enumerate(items):
                    numbers[executor.submit(function, item)] = i
            for future in as_completed(list(numbers)):
                yield numbers.pop(future), future.result()
        except BrokenProcessPool:
            guard = 'a program that imports as a module does, with its calls below `if __name__ == "__main__":`'
            raise RuntimeError(f"jobs: a process ended before its task was done; expected {guard}, or jobs=1") from None
        except BaseException:
            if executor is jobs:  # a pool of our own cancels its tasks itself, and must not find them cancelled
                for future in numbers:
                    future.cancel()
            raise


def opened(jobs: int, scheduler: str | None = None) -> AbstractContextManager[int | Executor]:
    """What `--jobs` and `--scheduler` ask for, as `jobs` of everything else: see `cluster`."""
    return nullcontext(jobs) if scheduler is None else cluster(scheduler)


@contextmanager
def cluster(address: str, *, timeout: float = 10.0) -> Iterator[Executor]:
    """The workers of the Dask cluster whose scheduler is at `address`, as an executor.

    timeout: seconds within which the scheduler has to answer. Tasks wait until there is a worker. If a worker dies,
    another does its task, up to Dask's limit (`distributed.scheduler.allowed-failures`). Worker processes do one task
    at a time, and refuse it where sources or versions differ from those of this process. Tasks that have begun cannot
    be stopped: after an error or Ctrl-C the workers finish them, and the results are dropped.
    Raises ClusterError naming the address if no scheduler answers or the connection is lost, and if the package
    `distributed` is missing.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError(
            f"scheduler: expected the package `distributed` to be installed for {address}, got none: "
            "it comes with the extra `cluster`, pip install 'deep-contact[cluster]'"
        ) from None
    try:
        client, fault = Client(address, timeout=timeout, set_as_default=False), None
    except Exception as error:  # OSError, ValueError, TypeError and others, depending on what is wrong with the address
        fault = str(error) or type(error).__name__
    if fault is not None:
        # The client that came to nothing closes itself here. Left to the garbage collector it may do so while another
        # one starts, and both wait for each other for ever.
        gc.collect()
        expected = f"a Dask scheduler that answers at {address} within {timeout:g} s"
        raise ClusterError(f"scheduler: expected {expected}, got none: {fault}")
    with client:
        try:
            yield _Cluster(client)
        except CancelledError:
            raise ClusterError(f"scheduler: expected {address} to be there until the end, got no answer") from None


class _Cluster(Executor):
    """Dask's executor; the workers check that they run our code before each task."""

    def __init__(self, client):
        # Impure: Dask must neither merge two equal tasks nor return a result that older code has computed.
        self._executor = client.get_executor(pure=False)

    def submit(self, function, /, *args, **kwargs):
        import cloudpickle

        task, expected = cloudpickle.dumps((function, args, kwargs)), code()

        # A nested function and bytes are pickled by value. A worker that cannot import the task, or this package, then
        # reports an ordinary error; a message that it cannot unpickle would end the worker.
        def task_of_deep_contact():
            from deep_contact.parallel import on_worker

            return on_worker(task, expected)

        return self._executor.submit(task_of_deep_contact)


def on_worker(task: bytes, expected: dict[str, str]):
    """Do a pickled task (function, args, kwargs) here. Raises ClusterError if `code` is not what is expected."""
    import cloudpickle

    for name, ours in code().items():
        if ours != expected[name]:
            difference = f"{name}: expected {expected[name]} as the client has it, got {ours}"
            raise ClusterError(f"worker on {platform.node()}: {difference}; install the same and start it again")
    # Neither the compiled kernels, which hold the interpreter anyway, nor the peer engines are made for threads.
    with _one_task:
        function, args, kwargs = cloudpickle.loads(task)
        return function(*args, **kwargs)


@cache
def code() -> dict[str, str]:
    """Versions, and a digest of the sources, by name: results depend on them beside the task."""
    digest, folder = hashlib.sha256(), Path(__file__).parent
    # A wheel has the scripts below the package; a checkout beside it runs the same code.
    for path in sorted(set(folder.rglob("*.py")) - set(folder.glob("scripts/*"))):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    versions = provenance.package_versions()
    ours = {"deep_contact": VERSION, "sources of deep_contact": digest.hexdigest()[:16]}
    return ours | {name: versions.get(name, "none") for name in _PACKAGES}


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    """Spawned processes of this machine; after an error they are ended at once, even in the middle of a task."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(1)  # a process that imports a main program without a guard; the parent says so
    # Spawned, not forked: a fork would copy the threads of the parent's libraries in an unknown state.
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with ProcessPoolExecutor(count, mp_context=context, initializer=_end_with_parent) as executor:
        try:
            yield executor
        except BaseException:
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            manager = getattr(executor, "_executor_manager_thread", None)
            executor.shutdown(wait=False, cancel_futures=True)
            # The end of the interpreter would write to the pipe that this thread is closing. It may wait for ever where
            # large items are queued, in Python before 3.11.5 (gh-94777).
            if manager is not None:
                manager.join(5.0)
            raise


def _end_with_parent() -> None:
    """End this process once its parent is gone; a pool's process would wait for tasks that nobody can send."""

    def wait():
        multiprocessing.parent_process().join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def _interrupts_held_back():
    """Ctrl-C waits until this is over. Processes started within never get it: the parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
