"""Crews: what a thread writes before a barrier is there for the others after it, and shares cover everything once."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from numba import config, njit

from deep_contact.compiled import crew as crews
from deep_contact.compiled.crew import ALONE, Crew, crew_size, share_of, together, wait

needs_threads = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="a crew of one without the compiler")


@njit(nogil=True)
def pass_on(values, rounds, crew):
    """Each thread adds to its number that of its neighbour, as it was in the round before."""
    for k in range(rounds):
        old, new = values[k % 2], values[(k + 1) % 2]
        new[crew.rank] = old[crew.rank] + old[(crew.rank + 1) % crew.size]
        wait(crew)
    return crew.rank


@needs_threads
@pytest.mark.parametrize("size", [1, 2, 3])
def test_nobody_runs_ahead_of_a_barrier(size):
    rounds, values = 60, np.zeros((2, size), np.int64)
    values[0] = np.arange(size) + 1
    expected = values[0].copy()
    for _ in range(rounds):
        expected = expected + np.roll(expected, -1)
    assert together(size, pass_on, values, rounds) == 0
    np.testing.assert_array_equal(values[rounds % 2], expected)


@njit(nogil=True)
def leave_alone(lost, crew):
    """The barrier, to which one rank does not come."""
    if crew.rank == lost:
        raise ZeroDivisionError
    wait(crew)
    return crew.rank


def interrupted(lost, crew):
    if crew.rank == lost:
        raise KeyboardInterrupt
    leave_alone(-1, crew)


@needs_threads
@pytest.mark.timeout(60)
@pytest.mark.parametrize(("work", "error"), [(leave_alone, ZeroDivisionError), (interrupted, KeyboardInterrupt)])
@pytest.mark.parametrize("lost", [0, 1])
def test_nobody_waits_for_a_thread_that_is_lost_and_its_error_is_raised(lost, work, error):
    with pytest.raises(error):
        together(2, work, lost)


def test_a_barrier_is_ready_for_the_next_round_before_it_opens(monkeypatch):
    """A thread that sees the new round may arrive at the next barrier at once."""
    board, arrived = np.zeros(24, np.int64), []

    def add(board, i, number):
        if i == crews.ROUND:
            arrived.append(board[crews.ARRIVED])
        board[i] += number
        return board[i] - number

    monkeypatch.setattr(crews, "_add", add)
    monkeypatch.setattr(crews, "_read", lambda board, i: board[i])
    board[crews.ARRIVED] = 1
    getattr(wait, "py_func", wait)(Crew(1, 2, board))
    assert arrived == [0]
    assert (board[crews.ARRIVED], board[crews.ROUND]) == (0, 1)


@needs_threads
@pytest.mark.timeout(60)
def test_an_interrupt_before_the_first_barrier_ends_all(monkeypatch):
    submit = ThreadPoolExecutor.submit

    def interrupted(*arguments):
        submit(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(ThreadPoolExecutor, "submit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        together(2, leave_alone, 2)


@pytest.mark.parametrize("count", [0, 1, 2, 7, 1000])
@pytest.mark.parametrize("size", [1, 2, 3, 8])
def test_shares_cover_everything_once(count, size):
    shares = [share_of(count, Crew(rank, size, ALONE.board)) for rank in range(size)]
    assert [k for first, last in shares for k in range(first, last)] == list(range(count))
    assert max(last - first for first, last in shares) - min(last - first for first, last in shares) <= 1


def test_without_the_compiler_there_is_one_thread(monkeypatch):
    monkeypatch.setattr(config, "DISABLE_JIT", 1)
    assert crew_size(4, 10**6, 1500) == 1


@needs_threads
def test_a_crew_has_as_many_threads_as_pay(monkeypatch):
    monkeypatch.setattr(crews, "cores", lambda: 4)
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 4)
    sizes = [crew_size(None, count, 1500) for count in (0, 1499, 2999, 3000, 7000, 10**6)]
    assert sizes == [1, 1, 1, 2, 4, 4]
    assert [crew_size(threads, 10, 1500) for threads in (1, 3, 9)] == [1, 3, 4]
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(crew_size, None, 10**6, 1500).result() == 1
        assert pool.submit(crew_size, 2, 10**6, 1500).result() == 2


def test_another_process_has_no_crew():
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(crew_size, None, 10**6, 1500).result() == 1
