"""Savings: the sums behind them, and how far apart circles are at the end of two ways."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import circles_at, load_script

savings = load_script("figure_6_7")


def test_the_ratio_is_that_of_paired_times():
    found = savings.ratio(np.array([2.0, 9.0, 8.0]), np.array([1.0, 3.0, 2.0]))
    assert (found["ratio"], found["general"], found["special"]) == (3.0, 2.0, 1.0)
    assert (found["low"], found["high"]) == (2.5, 3.5)


def test_a_saving_is_the_median_of_the_ratios_of_scenes():
    """Of three scenes, 30 : 10, 40 : 20 and 10 : 5; the least of each is what is paid."""
    pairs, far = [(30, 10), (40, 20), (10, 5)], [0.0, 0.5, 0.1]
    runs = [{"relaxations": pair, "seconds": (2.0, 4.0), "difference": one} for pair, one in zip(pairs, far)]
    found = savings.saving_by_scene(runs, "relaxations")
    assert (found["ratio"], found["general"], found["special"], found["apart"]) == (2.0, 10.0, 5.0, 0.005)
    assert savings.saving_by_scene(runs, "seconds")["ratio"] == 0.5


def test_islands_that_stand_apart_relax_less_and_move_nothing():
    """A column of two and one circle alone: together all are relaxed until the last has converged."""
    found = savings.island_savings(circles_at([[5.0, 1.0], [5.0, 3.0], [15.0, 1.0]]), steps=10, every=5)
    together, islands = found["relaxations"]
    assert 0 < islands < together
    assert found["difference"] <= 1e-4
    assert min(found["seconds"]) > 0


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
