"""How long calls take. All times are in seconds.

Calls that are compared run in turns, after a run of each to warm up, so that a change of the processor's speed meets
all of them. Of several times the least is kept by default: other programs disturbed it least. Nothing else should run
meanwhile.
"""

from __future__ import annotations

import gc
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping


def interleaved(
    runs: Mapping,
    *,
    repeats: int,
    reduce: Callable = min,
    clock: Callable[[], float] = time.perf_counter,
    setup: Mapping | None = None,
) -> dict:
    """Times of several callables: name -> `reduce` of a list of `repeats` times, s, after a warm-up run of each.

    runs: name -> callable without arguments; they take turns in this order. setup: name -> callable that is called
    before each run of that name and is not timed. The release of a run's result, which `timeit` would count, is not
    timed either. The garbage collector waits until all runs are done. clock: such as `time.thread_time`, which counts
    only the work of this thread.
    """
    times, setup, was_enabled = {name: [] for name in runs}, setup or {}, gc.isenabled()
    gc.disable()
    try:
        for _ in range(repeats + 1):
            for name, run in runs.items():
                if name in setup:
                    setup[name]()
                begin = clock()
                result = run()
                times[name].append(clock() - begin)
                del result
    finally:
        if was_enabled:
            gc.enable()
    return {name: reduce(took[1:]) for name, took in times.items()}


_PROBE = """
import json, sys, time
begin = time.perf_counter()
exec(sys.argv[1])
took = time.perf_counter() - begin
heavy = [name for name in ("numpy", "numba", "scipy", "lxml", "h5py", "keras", "tensorflow") if name in sys.modules]
try:
    with open("/proc/self/status") as status:
        memory = next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))
except OSError:
    memory = None
print(json.dumps({"seconds": took, "heavy": heavy, "memory_mb": memory}))
"""


def fresh(code: str) -> dict:
    """Time, packages and memory of Python code in a process of its own.

    Returns {"seconds": without the interpreter's start, "heavy": packages that it loads, "memory_mb": largest resident
    memory, with the interpreter's, or None where it is unknown}. (`getrusage` returns at least the memory of the parent
    process.)
    """
    done = subprocess.run([sys.executable, "-c", _PROBE, code], stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])
