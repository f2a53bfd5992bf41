"""Parallel runs of independent tasks: in processes of this machine, or wherever an executor sends them.

The local pool is our own, since the workers of joblib's outlive a killed parent and get Ctrl-C themselves.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, nullcontext

import numpy as np

from deep_contact.state.validation import integer


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def workers(jobs: int | Executor) -> int:
    """Number of tasks that run at once: of processes, or of the threads of all workers of an executor; 1 if unknown."""
    if isinstance(jobs, int):
        return jobs
    if hasattr(jobs, "_client"):  # Dask's
        return max(1, sum(jobs._client.nthreads().values()))
    return getattr(jobs, "_max_workers", 1)


def progress_bar(items: Iterable | None = None, *, total: int | None = None, text: str = ""):
    """A progress bar on standard error around `items`; without items, a bar that `.update(n)` moves.

    It appears after one second. A terminal is updated every 0.2 s, a log file every 10 s.
    """
    from tqdm import tqdm

    every = 0.2 if sys.stderr.isatty() else 10.0
    return tqdm(items, total=total, desc=text or None, file=sys.stderr, mininterval=every, delay=1.0, leave=False)


def seeds(seed: int, count: int) -> list[int]:
    """`count` independent seeds from one seed, for items that run in parallel. Item i always gets the same seed."""
    return [int(child.generate_state(1, np.uint64)[0]) for child in np.random.SeedSequence(seed).spawn(count)]


def parallel_map(
    function: Callable, items: Iterable, *, jobs: int | Executor = 1, progress: Callable | None = None, text: str = ""
) -> list:
    """[function(item) for item in items], in that order, by `jobs`: see `finished`.

    The result does not depend on `jobs` if `function` depends on its item alone: give every item its own seed
    (`seeds`). The first error ends the map and is raised; an interrupt ends the processes too.
    """
    items = list(items)
    with closing(finished(function, items, jobs=jobs)) as done:
        by_index = dict(progress(done, total=len(items), text=text) if progress else done)
    return [by_index[i] for i in range(len(items))]


def finished(function: Callable, items: Iterable, *, jobs: int | Executor = 1) -> Iterator[tuple[int, object]]:
    """(i, function(item i)) of all items, in the order in which they are done.

    jobs: number of local processes, which are spawned, or an executor, which stays open. With one process, or one item,
    everything runs in this process. `function` has to be found by import (a script's own functions are), and items and
    results have to be picklable. The first error, an interrupt, or closing the iterator cancels the tasks that have not
    begun, and ends local processes at once; use `contextlib.closing` if the loop itself may raise. Results are passed
    on and not kept. Raises ValueError for other `jobs`, and RuntimeError if a local process ends before its task is
    done.
    """
    items = list(items)
    if not isinstance(jobs, Executor) and (integer("jobs", jobs, 1) == 1 or len(items) < 2):
        return ((i, function(item)) for i, item in enumerate(items))
    return _finished(function, items, jobs)  # a generator would check arguments only at its first item


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


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    """Spawned processes of this machine; after an error they are ended at once, even in the middle of a task."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(1)  # a process that imports a main program without a guard; the parent reports it
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
    """Delay Ctrl-C until the context is over. Processes started within never get it: the parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
