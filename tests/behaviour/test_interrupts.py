"""Ctrl-C ends what runs within half a second, as KeyboardInterrupt, and the process goes on.

The signal comes as from a terminal: to a process of its own whose SIGINT is not ignored, at any moment.
"""

import random
import signal
import subprocess
import sys
import time

import pytest

from deep_contact.solvers import METHODS

CHILD = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
import deep_contact as dc
from deep_contact.solvers import METHODS

scene = dc.circles_in_box(50, seed=1)

def simulate(solver, **options):
    return lambda steps: dc.simulate(scene, steps=steps, solver=solver, **options)

def stepped(steps):
    state = scene
    for _ in range(steps):
        state = dc.step(state, solver=dc.PGS())

def exactly(steps):
    for _ in range(steps):
        dc.solve_exactly(settled, residual=1e-300, most_pivots=200)

runs = {
    **{name: simulate(method()) for name, method in METHODS.items()},
    "asleep": simulate(dc.PGS(), sleep=True),
    "on_step": simulate(dc.PGS(), on_step=lambda state, record: None),
    "simulate_many": lambda steps: dc.simulate_many([scene] * 4, steps=steps, solver=dc.PGS(), threads=2),
    "step": stepped,
    "solve_exactly": exactly,
}
run = runs[sys.argv[1]]
if run is exactly:
    settled = dc.simulate(dc.circles_in_box(100, seed=1), steps=300, solver=dc.PGS()).state
run({"on_step": 5, "step": 5, "solve_exactly": 1}.get(sys.argv[1], 4_000))  # compiles all that a run needs
for _ in range(int(sys.argv[2])):
    try:
        print("running", flush=True)
        run(1_000_000_000 if run in (stepped, exactly) else 3_000_000)
    except KeyboardInterrupt:
        print(time.monotonic(), flush=True)
    run(1)
"""
RUNS = [*METHODS, "asleep", "on_step", "simulate_many", "step", "solve_exactly"]


def delays(name, count):
    """Seconds from each of so many signals to the KeyboardInterrupt, in a child that has to end well."""
    rng, found = random.Random(name), []
    command = [sys.executable, "-c", CHILD, name, str(count)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as child:
        try:
            for _ in range(count):
                assert child.stdout.readline() == "running\n", child.poll()
                time.sleep(rng.uniform(0.0, 1.0))
                sent = time.monotonic()
                child.send_signal(signal.SIGINT)
                answer = child.stdout.readline()
                assert answer, f"ended with {child.poll()}"
                found.append(float(answer) - sent)
        except BaseException:
            child.kill()
            raise
    assert child.returncode == 0
    return found


@pytest.mark.skipif(sys.platform == "win32", reason="a signal to a process of its own is POSIX's")
@pytest.mark.parametrize(
    ("name", "count"),
    [("PGS", 3)] + [pytest.param(name, 20, marks=pytest.mark.slow) for name in RUNS],
)
def test_ctrl_c_is_raised_at_once_and_the_next_call_works(name, count):
    # Ten times the half second that a quiet machine takes at most.
    assert max(delays(name, count)) < 5.0
