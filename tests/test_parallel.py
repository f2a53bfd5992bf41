"""`deep_contact.parallel`: executors of others, errors and interrupts, and processes that end with their parent."""

import gc
import os
import subprocess
import sys
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest

from deep_contact import parallel


@pytest.fixture
def executor():
    with ThreadPoolExecutor(1) as pool:
        yield pool


def interrupted(results, **_):
    """A progress bar at which Ctrl-C is pressed after the first result."""
    yield next(results)
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("first", "progress", "error"), [(2, None, ArithmeticError), (7, interrupted, KeyboardInterrupt)]
)
def test_an_error_or_an_interrupt_leaves_no_tasks_behind(executor, first, progress, error):
    """An executor of the caller stays open."""
    begun = []

    def refuse_two(number):
        begun.append(number)
        if number == 2:
            raise ArithmeticError(f"refused: {number}")
        time.sleep(0.1)
        return number

    with pytest.raises(error):
        parallel.parallel_map(refuse_two, [first, *range(3, 200)], jobs=executor, progress=progress)
    assert parallel.parallel_map(refuse_two, [5], jobs=executor) == [5]
    assert len(begun) < 50


def test_results_are_handed_on_and_not_kept(executor):
    kept, submit = weakref.WeakSet(), executor.submit

    def submitted(*task):
        future = submit(*task)
        kept.add(future)
        return future

    executor.submit = submitted
    with closing(parallel.finished(bytes, [10] * 6, jobs=executor)) as done:
        for _ in range(4):
            next(done)
        gc.collect()
        assert len(kept) <= 3


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_processes_end_with_a_parent_that_is_killed(tmp_path):
    """They would wait for tasks for ever; the pipe of standard output ends once the last of them has."""
    code = "import time; from deep_contact import parallel\nif __name__ == '__main__':\n    print('up', flush=True)\n"
    (tmp_path / "parent.py").write_text(code + "    list(parallel.finished(time.sleep, [1, 1, 60], jobs=2))\n")
    process = subprocess.Popen([sys.executable, str(tmp_path / "parent.py")], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"up\n"
    time.sleep(1.5)  # so that the processes are there
    process.kill()
    process.communicate(timeout=30)
