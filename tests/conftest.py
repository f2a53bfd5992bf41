"""Scenes and states that many tests share."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

import deep_contact as dc

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ROOT / "scripts"
TOOLS = ROOT / "tests" / "tools"


def load_script(name):
    """The script or tool of this name, or "figure_6_6" for figure_6_6_….py, as a module that pickles by name."""
    places = (folder.glob(pattern) for pattern in (f"{name}.py", f"{name}_*.py") for folder in (SCRIPTS, TOOLS))
    path = next(path for place in places for path in place)
    if path.stem not in sys.modules:
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return sys.modules[path.stem]


@pytest.fixture(scope="session")
def falling_states():
    """Every 20th solved state of the thesis's scene, from the first contacts through the impact to the settled pile."""
    return solved_states(dc.circles_in_box(60, seed=3), steps=400, every=20)


@pytest.fixture(scope="session")
def frictionless_states():
    """The same without friction."""
    return solved_states(dc.circles_in_box(60, friction=0.0, seed=4), steps=400, every=40)


def solved_states(scene, *, steps, every=1, solver=None, **options):
    """Solved states of a run, one in `every`, those without contacts left out."""
    states = []

    def keep(state, record):
        if state.step % every == 0 and state.contacts.count:
            states.append(state)

    dc.simulate(scene, steps=steps, solver=solver or dc.PGS(sweeps=500), on_step=keep, **options)
    return states


def momentum(bodies):
    """Total linear momentum, (2,), kg·m/s."""
    return bodies.mass @ bodies.velocity
