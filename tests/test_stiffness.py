"""Scenes that a few sweeps cannot solve: they are recognised, and what is taken for them holds."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.physics import metrics
from deep_contact.presets import PRESETS, stiffness
from deep_contact.studies.extremes import leaning_silo, loaded_silo, pyramid, silo

STIFF = {
    "1000 on top": loaded_silo(5, 1e3),
    "1e6 on top": loaded_silo(5, 1e6),
    "1e8 on top": loaded_silo(5, 1e8),
    "1e6 below": loaded_silo(5, 1e6, at=0),
    "column of 200": silo(200),
    "leaning column of 100": leaning_silo(100),
}


@pytest.mark.parametrize("name", STIFF)
def test_what_is_stiff_rests_within_a_slop_and_without_speed(name):
    # A column at rest: every preset takes the same, and nothing falls, sinks or jumps.
    state = STIFF[name]
    first = state.bodies.position
    for _ in range(10):
        state = dc.simulate(state, steps=10, accuracy="fast").state
        assert metrics.penetration(state) < state.scales.slop
    assert np.abs(state.bodies.velocity).max() < 1e-3
    assert np.abs(state.bodies.position - first).max() < 0.3 * state.bodies.count * state.scales.slop


@pytest.mark.parametrize("name", STIFF)
def test_every_preset_and_the_default_take_the_stiff_solver_and_the_plan_says_why(name):
    scene = STIFF[name]
    for accuracy in PRESETS:
        assert dc.recommend(scene, accuracy=accuracy).solver == stiffness(scene).solver
    plan = dc.plan(scene)
    assert plan.solver == stiffness(scene).solver
    assert plan["solving stiff piles"].used
    assert plan["solving stiff piles"].why == stiffness(scene).why
    assert "20,000 sweeps" in plan["solving stiff piles"].saving
    told = dc.plan(scene, solver=dc.PGS(sweeps=50, tolerance=None))["solving stiff piles"]
    assert not told.used
    assert "PGS(sweeps=50, tolerance=None) was asked for" in told.why


@pytest.mark.parametrize(
    "scene",
    [
        dc.circles_in_box(100, seed=1),
        dc.circles_in_box(40, radius=(0.1, 0.99), seed=1),
        dc.lattice_in_box(2500),
        pyramid(50),
        dc.circles_in_box(400, size=(60.0, 200.0), seed=1),
        silo(29),
        dc.State(name="one", world=dc.World(), bodies=dc.make_bodies([[5.0, 5.0]])),
        dc.State(
            name="two", world=dc.World(box=(0.0, 0.0, 9.0, 400.0)), bodies=dc.make_bodies([[5.0, 1.0], [5.0, 399.0]])
        ),
    ],
    ids=["pile", "mixed pile", "large pile", "pyramid", "cloud", "short column", "one circle", "two far apart"],
)
def test_what_the_study_covers_is_left_to_it(scene):
    assert stiffness(scene) is None
    assert not dc.plan(scene)["solving stiff piles"].used


def test_a_pyramid_of_a_hundred_rows_stands_by_the_substeps_that_are_taken_for_it():
    # With 10 sweeps, with 50, or with NNCG to a tolerance at whole steps its circles leave at 10 m/s after 300 steps.
    scene = pyramid(100)
    assert stiffness(scene).why == "a heap with slopes 87 circles high"
    choice = dc.plan(scene)["solving stiff piles"]
    assert choice.used
    assert choice.saving == "it costs 8 substeps of 2 sweeps"
    assert not dc.plan(scene, solver=dc.PGS(sweeps=50, tolerance=None))["solving stiff piles"].used
    state = dc.simulate(scene, steps=150).state
    assert metrics.penetration(state) < state.scales.slop
    assert np.abs(state.bodies.velocity).max() < 0.03
    assert np.abs(state.bodies.position - scene.bodies.position).max() < 10 * state.scales.slop
