"""Scenes and states that many tests share."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import optimize

import deep_contact as dc
from deep_contact.analysis.lcp import contact_problem
from deep_contact.measure.errors import Observation, Reading
from deep_contact.studies.starts import solved_states

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ROOT / "scripts"
TOOLS = ROOT / "tests" / "tools"
FOLDERS = SCRIPTS, TOOLS, ROOT / "docs" / "gallery"

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell sets it for the background; processes inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


ENGINE_LAST = (
    "run/",
    "analysis/",
    "accuracy/",
    "documents/test_readme.py",
    "stepping/",
    "solvers/",
    "starts/",
    "behaviour/",
    "studies/",
    "scripts/test_figure_6_6.py",
)
"""Files whose tests need many kinds of steps, and so run last."""


SELDOM = "stepping/", "behaviour/", "scripts/"
"""Folders whose runs by NesterovPGS are slow tests: they compile a kind of step that no scene gets by itself."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Golden runs first: one process compiles their kinds of steps, while others run the tests that need few kinds.

    Where two processes need the same kind at the same time, one of them waits for the other.
    """

    def place(item):
        name = item.path.relative_to(Path(__file__).parent).as_posix()
        kinds = [k for k, start in enumerate(ENGINE_LAST) if name.startswith(start)]
        return name != "test_golden.py", *kinds

    items.sort(key=place)
    for item in items:
        is_seldom = item.path.relative_to(Path(__file__).parent).as_posix().startswith(SELDOM)
        if is_seldom and hasattr(item, "callspec") and "NesterovPGS" in item.callspec.id:
            item.add_marker(pytest.mark.slow)


def load_script(name):
    """The script, tool or example `name` as a module that pickles by name; "figure_6_6" stands for figure_6_6_….py."""
    places = (folder.glob(pattern) for pattern in (f"{name}.py", f"{name}_*.py") for folder in FOLDERS)
    path = next(path for place in places for path in place)
    if path.stem not in sys.modules:
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return sys.modules[path.stem]


def run_python(*arguments, status=0, environment=(), **options):
    """Run Python with these arguments, and expect this exit status. Returns the process, with its output."""
    command = [sys.executable, *map(str, arguments)]
    options |= {"env": os.environ | dict(environment), "capture_output": True, "text": True, "timeout": 600}
    done = subprocess.run(command, **options)
    assert done.returncode == status, done.stdout + done.stderr
    return done


def circles_at(position, *, dt=0.01, **options):
    """A scene of circles at these centres; options of `World`, such as `box`, and of `make_bodies`."""
    world = {name: options.pop(name) for name in dc.World.__dataclass_fields__ if name in options}
    return dc.State(name="circles", world=dc.World(**world), bodies=dc.make_bodies(position, **options), dt=dt)


def observation(
    kinetic=1.0, height=10.0, speed=0.0, penetration=0.0, contacts=1.5, loads=None, count=30, quantities=None
):
    """The observation of a run. A number stands for a curve that does not change."""

    def curve(value):
        return np.full(count, float(value)) if np.isscalar(value) else np.asarray(value, float)

    depth = np.repeat(curve(penetration)[:, None], 3, axis=1)
    own = {name: curve(value) for name, value in (quantities or {}).items()}
    flat = curve(kinetic), curve(height), curve(speed), depth, curve(contacts), np.ones(count)
    return Observation(*flat, loads, 0.1, own)


def readings(states):
    """Readings of states that nothing has watched: a step is the time between two, and the first is as the second."""
    states = list(states)
    shares = (state.bodies.free_mass / state.bodies.free_mass.sum() for state in states)
    centres = np.array([share @ state.bodies.velocity for share, state in zip(shares, states)])
    before = np.vstack([2.0 * centres[0] - centres[1], centres]) if len(states) > 1 else centres[[0, 0]]
    step = states[1].time - states[0].time if len(states) > 1 else 1.0
    return [Reading(state, 0.0, before[k : k + 2], step) for k, state in enumerate(states)]


@pytest.fixture(scope="session")
def falling_states():
    """Every 20th solved state of the thesis's scene, from the first contacts through the impact to the settled pile."""
    return solved_states(dc.circles_in_box(60, seed=3), steps=400, every=20)


@pytest.fixture(scope="session")
def frictionless_states():
    """Every 40th solved state of the thesis's scene without friction."""
    return solved_states(dc.circles_in_box(60, friction=0.0, seed=4), steps=400, every=40)


@pytest.fixture(scope="session")
def nnls_velocities(frictionless_states):
    """Velocities (n, 3) of min over λ >= 0 of ½ |B λ + M^½ v|², B = M^-½ Jᵀ: unique without friction."""
    found = []
    for state in frictionless_states:
        problem = contact_problem(state)
        problem = problem._replace(jacobian=problem.jacobian[::2])
        root = np.sqrt(problem.inverse_mass)
        B = root[:, None] * problem.jacobian.T.toarray()
        expected, _ = optimize.nnls(B, -problem.free_velocity / root, maxiter=100_000)
        found.append(problem.velocities(expected).reshape(-1, 3))
    return found


def stacked(solution):
    """The impulses of a solution as `contact_problem` numbers its rows, λ_n and λ_t by turns, (2 m,)."""
    return np.column_stack([solution.normal_impulses, solution.tangent_impulses]).ravel()


def carried(state):
    """The impulses that a state starts from, (2 m,), numbered as those of `stacked`."""
    return np.column_stack([state.contacts.normal_start, state.contacts.tangent_start]).ravel()


def assert_same_bits(first, second):
    """Two states hold the same bodies and contacts."""
    for one, other in ((first.bodies, second.bodies), (first.contacts, second.contacts)):
        for name in one._fields:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def momentum(bodies):
    """Total linear momentum, (2,), kg·m/s."""
    return bodies.mass @ bodies.velocity
