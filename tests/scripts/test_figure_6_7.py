"""Savings: what is added up, and how far apart two ways lead."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import circles_at, load_script

savings = load_script("figure_6_7")


def test_a_saving_is_the_ratio_of_what_whole_runs_take():
    """Two runs of two states, 30 : 10 and 40 : 20 relaxations; velocities differ by up to 0.5 m/s, for a step."""
    runs = [
        {"together": np.array([10, 20]), "apart": np.array([4, 6]), "difference": np.array([0.1, 0.5])},
        {"together": np.array([30, 10]), "apart": np.array([5, 15]), "difference": np.array([0.2, 0.0])},
    ]
    runs = [one | {f"seconds_{name}": 2.0 * one["together"] for name in ("together", "apart")} for one in runs]
    found = savings.saving_by_run(runs)
    assert (found["ratio"], found["general"], found["special"]) == (2.5, 30.0, 10.0)
    assert found["apart"] == pytest.approx(0.01 * 0.5)
    assert savings.saving_by_run(runs, "seconds_")["ratio"] == 1.0


def test_two_states_are_as_far_apart_as_the_circle_that_is_farthest():
    one, other = circles_at([[5.0, 5.0], [9.0, 5.0]]), circles_at([[5.0, 5.1], [9.3, 5.4]])
    assert savings.apart(one, other) == pytest.approx(0.5)


def test_a_scene_is_at_rest_once_a_step_relaxes_nothing(monkeypatch):
    """Circles that sleep have no contacts to relax."""
    left, scene = iter([[9, 7], [0, 3], [8, 0], [5, 5]]), circles_at([[5.0, 5.0]])

    def simulate(state, *, steps, solver, sleep):
        assert (steps, sleep) == (100, True)
        return SimpleNamespace(state=state.replace(step=state.step + steps), relaxations=np.array(next(left)))

    monkeypatch.setattr(savings, "simulate", simulate)
    assert savings.at_rest(scene).step == 300
