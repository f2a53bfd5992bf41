"""Measurement of computing times. All times are in seconds.

Functions that are compared are called in turns, after a warm-up call of each. So a change of the processor's speed
affects all of them. By default the smallest of several times is returned, because other programs disturbed it least. No
other program should run at the same time.
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
    """Measure the computing times of several functions. Returns name -> reduced time, s.

    The functions are called in turns, once to warm up and then `repeats` times. A call's time does not include the
    release of its result, which `timeit` would include. The garbage collector is off during the calls.
    runs: name -> function without arguments. repeats: number of timed calls of each function. reduce: function that
    reduces the list of times to one number. clock: function that returns a time, s; `time.thread_time` counts only the
    computing time of this thread. setup: name -> function that is called before each call of the function with this
    name, and is not timed.
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
    """Run Python code in a new process, and measure its time, its imports and its memory.

    Returns {"seconds": time of the code, s, without the start of the interpreter, "heavy": names of the large packages
    that the code imports, "memory_mb": largest resident memory of the process, MiB, or None if it is unknown}. The
    memory is read from /proc, because `getrusage` would return at least the memory of the parent process.
    """
    done = subprocess.run([sys.executable, "-c", _PROBE, code], stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])
