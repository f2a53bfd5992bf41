"""Scenes that a few sweeps cannot solve: they are recognised, and rest with the settings that are taken for them."""

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.accuracy.presets import PRESETS
from deep_contact.accuracy.scene_numbers import scene_numbers
from deep_contact.accuracy.stiffness import height_and_width, stiffness
from deep_contact.stepping import metrics
from deep_contact.stepping.problem import contacts_of
from deep_contact.studies.hard_scenes import loaded_silo, pyramid, silo, with_bodies

pytestmark = pytest.mark.filterwarnings("ignore:.*solved to a tolerance")


def leaning_column(n):
    """Circles in zigzag, each pressed by 0.1 mm into the next and into a wall."""
    pressed, order = 1e-4, np.arange(n)
    wide, high = 0.05 + 2 * pressed, 2.0 - pressed  # from one circle to the next along x; centres' distance
    x, y = 1.01 - pressed + wide * (order % 2), 1.01 - pressed + np.sqrt(high**2 - wide**2) * order
    return circles_at(np.column_stack([x, y]), box=(0.0, 0.0, 2.07, 2 * n + 4.02))


STIFF = {
    "1000 on top": loaded_silo(5, 1e3),
    "1e6 on top": loaded_silo(5, 1e6),
    "1e8 on top": loaded_silo(5, 1e8),
    "1e6 below": loaded_silo(5, 1e6, at=0),
    "column of 200": silo(200),
    "leaning column of 100": leaning_column(100),
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
def test_every_preset_and_the_default_take_the_stiff_solver_and_the_plan_says_so(name):
    scene = STIFF[name]
    for accuracy in PRESETS:
        assert dc.recommend(scene, accuracy=accuracy).solver == stiffness(scene).solver()
    plan = dc.plan(scene)
    assert plan.solver == stiffness(scene).solver()
    assert plan["solving stiff piles"].used
    assert not dc.plan(scene, solver=dc.PGS(sweeps=50, tolerance=None))["solving stiff piles"].used


@pytest.mark.parametrize(
    "scene",
    [
        dc.circles_in_box(100, seed=1),
        dc.circles_in_box(40, radius=(0.1, 0.99), seed=1),
        dc.lattice_in_box(2500),
        pyramid(50),
        dc.circles_in_box(400, size=(60.0, 200.0), seed=1),
        silo(15),
        circles_at([[5.0, 5.0]]),
        circles_at([[5.0, 1.0], [5.0, 399.0]], box=(0, 0, 9, 400)),
    ],
    ids=["pile", "mixed pile", "large pile", "pyramid", "cloud", "short column", "one circle", "two far apart"],
)
def test_what_the_study_covers_is_left_to_it(scene):
    assert stiffness(scene) is None
    assert not dc.plan(scene)["solving stiff piles"].used


@pytest.mark.parametrize(
    ("height", "ratio", "is_stiff"),
    [(2, 99, False), (3, 60, False), (3, 99, True), (5, 30, False), (5, 99, True), (10, 30, True), (15, 1, False),
     (20, 1, True), (20, 99, True), (20, 1000, True)],
)  # fmt: skip
def test_what_is_stiff_follows_height_and_load(height, ratio, is_stiff):
    # `height` circles, the top one `ratio` times as heavy: the bottom one carries height − 2 + ratio times its mass.
    assert (stiffness(loaded_silo(height, ratio)) is not None) == is_stiff


@pytest.mark.parametrize("accuracy", PRESETS)
@pytest.mark.parametrize("wide", [3, 10])
def test_heavy_circles_on_a_pile_at_rest_are_carried_by_few_sweeps(accuracy, wide):
    # The top row, 99 times as dense: a column of the pile carries it, and nothing that is solved to a tolerance.
    pile = dc.lattice_in_box(10 * wide, columns=wide, gap=0.01, seed=1)
    mass = np.where(np.arange(10 * wide) >= 9 * wide, 99.0, 1.0) * pile.bodies.mass
    pile = pile.replace(bodies=pile.bodies._replace(mass=mass))
    assert stiffness(pile) is None
    state = dc.simulate(pile, steps=500, accuracy=accuracy).state
    assert metrics.penetration(state) < 1e-2 * PRESETS[accuracy]["penetration_max"]
    assert np.sqrt((state.bodies.velocity**2).sum(axis=1).mean()) < 0.05 * np.sqrt(9.81)


@pytest.mark.parametrize("needed", [1, 4, 32])
def test_what_is_solved_to_a_tolerance_takes_the_substeps_that_its_step_needs(needed):
    scene = loaded_silo(5, 1e3)
    solver = stiffness(scene).solver(needed)
    assert solver.substeps == max(4, needed)
    # A millionth of what carries the lightest circle for a substep.
    assert solver.tolerance == pytest.approx(1e-6 * np.pi * 9.81 * scene.dt / solver.substeps)
    long = scene.replace(dt=0.3)
    assert dc.recommend(long).solver.substeps == 32


def test_without_gravity_nothing_is_high():
    assert height_and_width(scene_numbers(dc.circles_in_box(20, gravity=(0, 0)))) == (0.0, 0.0)


@pytest.mark.parametrize(("aside", "above", "contacts"), [(0.9999, 1.0, 3.0), (0.9999, 1.1, 1.0), (1.1, 1.1, 0.0)])
def test_a_heap_lies_and_what_falls_in_its_shape_is_none(aside, above, contacts):
    # 70 rows: on one another (three contacts a circle), apart (each row a chain: one), all apart (the floor's alone).
    scene = pyramid(70)
    scene = with_bodies(scene, position=scene.bodies.position * (aside, above))
    assert contacts_of(scene).count / scene.bodies.count == pytest.approx(contacts, abs=0.1)
    assert (stiffness(scene) is not None) == (contacts == 3.0)


def test_a_pyramid_of_a_hundred_rows_stands_by_the_substeps_that_are_taken_for_it():
    # With 10 sweeps, with 50, or with NNCG to a tolerance at whole steps its circles leave at 10 m/s after 300 steps.
    scene = pyramid(100)
    assert stiffness(scene).why == "a heap with slopes 87 circles high"
    assert dc.plan(scene)["solving stiff piles"].used
    assert not dc.plan(scene, solver=dc.PGS(sweeps=50, tolerance=None))["solving stiff piles"].used
    state = dc.simulate(scene, steps=150).state
    assert metrics.penetration(state) < state.scales.slop
    assert np.abs(state.bodies.velocity).max() < 0.03
    assert np.abs(state.bodies.position - scene.bodies.position).max() < 10 * state.scales.slop
