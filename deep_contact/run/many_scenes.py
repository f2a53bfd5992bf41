"""`simulate_many`: independent runs of many scenes, on all cores."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from typing import Literal

from deep_contact.accuracy.presets import Accuracy, MeasuredAccuracy
from deep_contact.parallel import cores, parallel_map, workers
from deep_contact.run.method import RunOptions
from deep_contact.run.one_scene import _simulate
from deep_contact.run.result import Simulation
from deep_contact.starts.classical import Builtin, NoStart
from deep_contact.starts.names import warm_start_of
from deep_contact.state.state import State
from deep_contact.state.validation import expect, integer, list_of, suggesting

TASKS = 16
"""Number of tasks for each worker of `simulate_many(jobs=…)`. An executor that replaces a lost worker repeats one task
only."""


@suggesting
def simulate_many(
    states: Iterable[State],
    *,
    steps: int = 600,
    dt: float | None = None,
    solver=None,
    warm_start: Literal["builtin", "none"] | Builtin | NoStart | None = "builtin",
    accuracy: Accuracy | MeasuredAccuracy | None = None,
    sleep: bool = False,
    record: int | None = None,
    forces: bool = False,
    threads: int | None = None,
    jobs: int | Executor | None = None,
) -> list[Simulation]:
    """Run many scenes independently, on all cores. Returns a `Simulation` for each scene, in order.

    Each result has the same bits as that of `simulate`. Compiled steps release the interpreter's lock, so that threads
    run in parallel.

    threads: largest number of threads, by default one for each core. jobs: number of processes in place of threads, or
    an executor, such as that of a cluster. warm_start: "builtin", None or "none", the starts that need no Python
    between steps.

    The other arguments are those of `simulate`. Raises ValueError and FloatingPointError as `simulate` does, with the
    number of the state.
    """
    expect(threads is None or jobs is None, f"threads: expected none beside jobs, got {threads!r}")
    threads = cores() if threads is None else integer("threads", threads, least=1)
    start = warm_start_of(warm_start)
    fits, states = isinstance(start, (Builtin, NoStart)), list_of("states", State, states)
    expect(fits, f"warm_start: expected 'builtin', 'none' or None for many scenes, got {warm_start!r}")
    options = RunOptions(
        steps=steps, dt=dt, solver=solver, warm_start=start, accuracy=accuracy, sleep=sleep, record=record,
        forces=forces,
    )  # fmt: skip
    if jobs is not None:
        # A task has several scenes, since scheduling a task takes as long as running a small scene.
        numbered, size = list(enumerate(states)), max(1, len(states) // (TASKS * max(1, workers(jobs))))
        tasks = [numbered[first : first + size] for first in range(0, len(states), size)]
        return [run for runs in parallel_map(partial(_some_of_many, options), tasks, jobs=jobs) for run in runs]
    stopped = threading.Event()

    def one(number: int) -> Simulation:
        return _one_of_many(options, (number, states[number]), stopped)

    with ThreadPoolExecutor(min(threads, max(1, len(states)))) as pool:
        runs = [pool.submit(one, number) for number in range(len(states))]
        try:
            return [future.result() for future in runs]
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _some_of_many(options: RunOptions, numbered: list[tuple[int, State]]) -> list[Simulation]:
    """Return the runs of several numbered states (`_one_of_many`)."""
    return [_one_of_many(options, one) for one in numbered]


def _one_of_many(
    options: RunOptions, numbered: tuple[int, State], stopped: threading.Event | None = None
) -> Simulation:
    """Return the run of one numbered state (`_simulate`). Error messages name the number."""
    number, state = numbered
    try:
        return _simulate(state, options, stopped)
    except (ValueError, FloatingPointError) as error:
        raise type(error)(f"states[{number}]: {error}") from error
