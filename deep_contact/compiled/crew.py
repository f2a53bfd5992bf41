"""Several threads that go through the same compiled function side by side, and wait for each other at barriers.

A parallel loop of Numba costs 60 µs or more to start on the layer that survives a fork; a sweep over a few thousand
contacts takes less. A barrier between threads that run already takes a fraction of a microsecond. So each thread of a
crew calls the same function with its own `Crew`; what cannot be shared is done by the one of rank 0, between barriers.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import config, njit, types
from numba.extending import intrinsic

ARRIVED, ROUND = 0, 8
"""Elements of `Crew.board`, in cache lines of their own."""

PATIENCE = 2000
"""Looks at the board before a thread lets others have its core: some microseconds."""


class Crew(NamedTuple):
    """A thread's place among others. rank: 0 to size − 1. board: (16,), shared by all."""

    rank: int
    size: int
    board: np.ndarray


ALONE = Crew(0, 1, np.zeros(16, np.int64))
"""The crew of one: its barriers are free."""


def together(size: int, function, *arguments) -> object:
    """Call the function (nogil) with the arguments and a `Crew`, in as many threads. Returns what rank 0 returns.

    Without the compiler, in one. An error of any thread is raised when all have ended; none may leave a barrier out.
    """
    size = 1 if config.DISABLE_JIT else size
    if size == 1:
        return function(*arguments, ALONE)
    board = np.zeros(16, np.int64)
    with ThreadPoolExecutor(size - 1) as pool:
        others = [pool.submit(function, *arguments, Crew(rank, size, board)) for rank in range(1, size)]
        found = function(*arguments, Crew(0, size, board))
        for other in others:
            other.result()
    return found


@njit(cache=True)
def wait(crew):
    """The barrier: returns when all of the crew have called it; what they wrote before is there to read."""
    if crew.size == 1:
        return
    current = _read(crew.board, ROUND)
    if _add(crew.board, ARRIVED, 1) == crew.size - 1:
        _add(crew.board, ARRIVED, -crew.size)
        _add(crew.board, ROUND, 1)
        return
    looks = 0
    while _read(crew.board, ROUND) == current:
        looks += 1
        if looks > PATIENCE:
            _let_others_run()


@njit(cache=True)
def share_of(count, crew):
    """(first, after the last) of the things from 0 to before `count` that are this thread's, in a row."""
    return count * crew.rank // crew.size, count * (crew.rank + 1) // crew.size


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
            name = "sched_yield"
            function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
            builder.call(function, [])
        return context.get_dummy_value()

    return types.void(), emit
