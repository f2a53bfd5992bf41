"""Parallel runs of independent tasks, by processes of this machine or by an executor such as Dask's.

Local processes are those of `ProcessPoolExecutor`. Joblib's processes are not used: they outlive a killed parent, and
Ctrl-C reaches them directly.
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
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def workers(jobs: int | Executor) -> int:
    """Return how many tasks run at once. jobs: number of processes, or an executor.

    For an executor this is the number of its workers (for Dask, of all their threads), or 1 if it is unknown.
    """
    if isinstance(jobs, int):
        return jobs
    if hasattr(jobs, "_client"):  # Dask's
        return max(1, sum(jobs._client.nthreads().values()))
    return getattr(jobs, "_max_workers", 1)


def progress_bar(items: Iterable | None = None, *, total: int | None = None, text: str = ""):
    """Return a progress bar on standard error, which iterates over `items`.

    Without items, its method `update(n)` advances the bar by n. total: number of items. text: label. The bar appears
    after one second. It is redrawn every 0.2 s in a terminal, and every 10 s in a log file.
    """
    from tqdm import tqdm

    every = 0.2 if sys.stderr.isatty() else 10.0
    return tqdm(items, total=total, desc=text or None, file=sys.stderr, mininterval=every, delay=1.0, leave=False)


def seeds(seed: int, count: int) -> list[int]:
    """Return `count` independent seeds, derived from one seed, for tasks that run in parallel.

    Seed i depends on `seed` and i alone.
    """
    return [int(child.generate_state(1, np.uint64)[0]) for child in np.random.SeedSequence(seed).spawn(count)]


def parallel_map(
    function: Callable, items: Iterable, *, jobs: int | Executor = 1, progress: Callable | None = None, text: str = ""
) -> list:
    """Return the list [function(item) for item in items], computed in parallel. jobs: as in `finished`.

    The result does not depend on `jobs` if `function` depends on its item alone. A random function therefore needs a
    seed in every item (`seeds`). The first error ends the map and is raised. Ctrl-C ends the processes too. progress: a
    function such as `progress_bar`, or None. text: label of the bar.
    """
    items = list(items)
    with closing(finished(function, items, jobs=jobs)) as done:
        by_index = dict(progress(done, total=len(items), text=text) if progress else done)
    return [by_index[i] for i in range(len(items))]


def finished(function: Callable, items: Iterable, *, jobs: int | Executor = 1) -> Iterator[tuple[int, object]]:
    """Return an iterator over (i, function(items[i])), in the order in which the tasks finish.

    jobs: number of local processes, which are spawned; or an executor, which is not shut down. With `jobs` = 1, or with
    local processes and a single item, everything runs in this process. Other processes import `function` by its module
    and name; functions of a script can be imported so too. Items and results have to be picklable. An error in a task,
    Ctrl-C, or closing the iterator cancels the tasks that have not begun, and ends local processes at once. Use
    `contextlib.closing` if the loop over the results may itself raise. A result is not stored after it has been
    yielded. Raises ValueError for other `jobs`, and RuntimeError if a local process ends before its task is done.
    """
    items = list(items)
    if not isinstance(jobs, Executor) and (integer("jobs", jobs, 1) == 1 or len(items) < 2):
        return ((i, function(item)) for i, item in enumerate(items))
    return _finished(function, items, jobs)  # separate, since a generator would check `jobs` only at its first item


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
            if executor is jobs:  # local processes: `_processes` cancels the tasks, not this loop
                for future in numbers:
                    future.cancel()
            raise


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    """Context with an executor of `count` spawned local processes.

    After an error in the block the processes are ended at once, even in the middle of a task.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(1)  # this process imports a main program without a guard; the parent reports it
    # Spawned, not forked. A fork would copy locks of the parent's libraries, but not the threads that release them.
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
            # Wait until this thread has closed its pipe, because the interpreter writes to the pipe when it exits. Wait
            # for 5 s at most: in Python before 3.11.5 the thread may never end if large items are queued (gh-94777).
            if manager is not None:
                manager.join(5.0)
            raise


def _end_with_parent() -> None:
    """Start a thread that ends this process once its parent has ended.

    Without the thread, the process would go on waiting for tasks that nobody can send.
    """

    def wait():
        multiprocessing.parent_process().join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def _interrupts_held_back():
    """Context that delays Ctrl-C until its end.

    Processes that are started within it never get Ctrl-C, since they inherit the blocked signal. The parent ends them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
