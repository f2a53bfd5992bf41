"""Several threads that go through the same compiled function side by side, and wait for each other at barriers.

A parallel loop of Numba takes longer to start than a sweep over a few thousand contacts; a barrier is a few cache
misses. Each thread calls the function with its own `Team`; what cannot be shared rank 0 does between barriers.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import config, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

ARRIVED, ROUND, BROKEN = 0, 8, 16
"""Elements of `Team.board`, in cache lines of their own: threads at the barrier, barriers passed, a thread is lost."""

PATIENCE = 2000
"""Looks at the board before a thread lets others have its core: some microseconds."""


class Team(NamedTuple):
    """A thread's place among others. rank: 0 to size − 1. board: (24,), shared by all."""

    rank: int
    size: int
    board: np.ndarray


ALONE = Team(0, 1, np.zeros(24, np.int64))
"""The team of one: its barriers are free."""


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def team_size(threads: int | None, count: int, least: int) -> int:
    """How many threads a team for so many things has: at most `threads`, and one without the compiler.

    By default as many as there are cores, `least` things for each, and one in a thread or a process that another one
    started: it will not be the only one.
    """
    if config.DISABLE_JIT:
        return 1
    if threads is None:
        first = threading.current_thread() is threading.main_thread() and multiprocessing.parent_process() is None
        threads = min(cores(), max(1, count // least)) if first else 1
    return min(threads, config.NUMBA_NUM_THREADS)


def together(size: int, function, *arguments) -> object:
    """Call the function (nogil) with the arguments and a `Team`, in as many threads. Returns what rank 0 returns.

    An error of one thread, or an interrupt, ends the others at their next barrier, and is raised.
    """
    if size == 1:
        return function(*arguments, ALONE)
    board = np.zeros(24, np.int64)

    def run(rank: int) -> object:
        try:
            return function(*arguments, Team(rank, size, board))
        except BaseException:
            board[BROKEN] = 1
            raise

    with ThreadPoolExecutor(size - 1) as pool:
        try:
            others = [pool.submit(run, rank) for rank in range(1, size)]
            result = run(0)
        except BrokenTeam:
            result = None
        except BaseException:
            board[BROKEN] = 1
            raise
        errors = [error for other in others if (error := other.exception()) is not None]
    # Of the thread that was lost first, not of those that it left waiting.
    for error in sorted(errors, key=lambda error: isinstance(error, BrokenTeam)):
        raise error
    return result


class BrokenTeam(RuntimeError):
    """A thread of the team will not come to this barrier."""


@njit(cache=True)
def wait(team):
    """The barrier: returns when all of the team have called it; what they wrote before is there to read.

    Raises `BrokenTeam` where one of them has ended with an error.
    """
    if team.size == 1:
        return
    current = _read(team.board, ROUND)
    if _add(team.board, ARRIVED, 1) == team.size - 1:
        _add(team.board, ARRIVED, -team.size)
        _add(team.board, ROUND, 1)
        return
    looks = 0
    while _read(team.board, ROUND) == current:
        looks += 1
        if looks > PATIENCE:
            if _read(team.board, BROKEN) != 0:
                raise BrokenTeam
            _let_others_run()


@njit(cache=True)
def share_of(count, team):
    """(first, after the last) of the things from 0 to before `count` that are this thread's, in a row."""
    return count * team.rank // team.size, count * (team.rank + 1) // team.size


def _element(context, builder, array_type, array, i):
    return builder.gep(context.make_array(array_type)(context, builder, array).data, [i])


@intrinsic
def _read(context, board, i):
    def emit(context, builder, signature, values):
        return builder.load_atomic(_element(context, builder, board, *values), "seq_cst", 8)

    return types.int64(board, types.int64), emit


@intrinsic
def _add(context, board, i, number):
    """Add a number to an element; returns what it was before."""

    def emit(context, builder, signature, values):
        element = _element(context, builder, board, *values[:2])
        return builder.atomic_rmw("add", element, values[2], "seq_cst")

    return types.int64(board, types.int64, types.int64), emit


@intrinsic
def _let_others_run(context):
    def emit(context, builder, signature, values):
        if os.name == "posix":
            kind = ir.FunctionType(ir.IntType(32), [])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        return context.get_dummy_value()

    return types.void(), emit
