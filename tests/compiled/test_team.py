"""Teams: what a thread writes before a barrier is there for the others after it, and shares cover everything once."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from conftest import run_python
from numba import config, njit

from deep_contact.compiled import team as teams
from deep_contact.compiled.team import ALONE, Team, share_of, team_size, together, wait

needs_threads = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="a team of one without the compiler")


@njit(nogil=True)
def pass_on(values, rounds, team):
    """Each thread adds to its number that of its neighbour, as it was in the round before."""
    for k in range(rounds):
        old, new = values[k % 2], values[(k + 1) % 2]
        new[team.rank] = old[team.rank] + old[(team.rank + 1) % team.size]
        wait(team)
    return team.rank


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
def leave_alone(lost, team):
    """The barrier, to which one rank does not come."""
    if team.rank == lost:
        raise ZeroDivisionError
    wait(team)
    return team.rank


def interrupted(lost, team):
    if team.rank == lost:
        raise KeyboardInterrupt
    leave_alone(-1, team)


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
        if i == teams.ROUND:
            arrived.append(board[teams.ARRIVED])
        board[i] += number
        return board[i] - number

    monkeypatch.setattr(teams, "_add", add)
    monkeypatch.setattr(teams, "_read", lambda board, i: board[i])
    board[teams.ARRIVED] = 1
    getattr(wait, "py_func", wait)(Team(1, 2, board))
    assert arrived == [0]
    assert (board[teams.ARRIVED], board[teams.ROUND]) == (0, 1)


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
    shares = [share_of(count, Team(rank, size, ALONE.board)) for rank in range(size)]
    assert [k for first, last in shares for k in range(first, last)] == list(range(count))
    assert max(last - first for first, last in shares) - min(last - first for first, last in shares) <= 1


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system has no affinity")
def test_cores_are_those_that_the_process_may_use(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0})
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    assert teams.cores() == 1


@needs_threads
def test_a_team_has_as_many_threads_as_pay(monkeypatch):
    monkeypatch.setattr(teams, "cores", lambda: 4)
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 4)
    sizes = [team_size(None, count, 1500) for count in (0, 1499, 2999, 3000, 7000, 10**6)]
    assert sizes == [1, 1, 1, 2, 4, 4]
    assert [team_size(threads, 10, 1500) for threads in (1, 3, 9)] == [1, 3, 4]
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(team_size, None, 10**6, 1500).result() == 1
        assert pool.submit(team_size, 2, 10**6, 1500).result() == 2
    monkeypatch.setattr(config, "DISABLE_JIT", 1)
    assert team_size(4, 10**6, 1500) == 1


def test_another_process_has_no_team():
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(team_size, None, 10**6, 1500).result() == 1


FORK_AFTER_THREADS = """
import multiprocessing

import deep_contact as dc

PILE = dc.lattice_in_box(900, gap=0.01, seed=1)


def team(_):
    solver = dc.BatchedPGS(sweeps=5, threads=2)
    return float(dc.simulate(PILE, steps=3, solver=solver).state.bodies.position[:, 1].sum())


if __name__ == "__main__":
    here = team(0)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        there = pool.map_async(team, [0]).get(timeout=120)[0]
    print(here == there == team(0))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_process_that_is_forked_after_threads_have_run_lives(tmp_path):
    script = tmp_path / "fork.py"
    script.write_text(FORK_AFTER_THREADS)
    assert run_python(script).stdout.strip() == "True"
