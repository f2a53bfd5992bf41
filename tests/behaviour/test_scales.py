"""No hidden length: with lengths · s, times · √s and masses · s² at the same g, a run is the same run in other units.

Then velocities are times √s, spins over √s, impulses times s^2.5. Where s is a power of four all of these are powers of
two, so nothing rounds otherwise and every bit but the exponents is the same.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.analysis.lcp import contact_problem
from deep_contact.solvers import METHODS
from deep_contact.state import constants
from deep_contact.state.arrays import LIMITS
from deep_contact.state.scales import FASTEST, mean, theta_tolerance
from deep_contact.stepping.prepare import ready

POWERS_OF_FOUR = [4.0**k for k in (-6, -3, 3, 6)]
"""From a quarter of a millimetre to four kilometres."""

MIXED, EQUAL = (0.5, 1.2), (1.0, 1.0)


def times(state, s):
    """The same scene, s times as large."""
    world, bodies = state.world, state.bodies
    bodies = bodies._replace(
        position=s * bodies.position,
        velocity=math.sqrt(s) * bodies.velocity,
        spin=bodies.spin / math.sqrt(s),
        mass=s**2 * bodies.mass,
        radius=s * bodies.radius,
    )
    world = replace(
        world,
        box=tuple(s * x for x in world.box),
        segments=[tuple(s * x for x in segment) for segment in world.segments],
        surface_speeds=[math.sqrt(s) * speed for speed in world.surface_speeds],
    )
    return state.replace(world=world, bodies=bodies, dt=math.sqrt(s) * state.dt)


def in_units_of(run, s):
    """What a run of `times(scene, s)` has computed, in the units of the scene's run."""
    bodies, contacts = run.state.bodies, run.state.contacts
    impulse = s**2 * math.sqrt(s)
    return {
        "position": bodies.position / s,
        "velocity": bodies.velocity / math.sqrt(s),
        "angle": bodies.angle,
        "spin": bodies.spin * math.sqrt(s),
        "pairs": np.column_stack([contacts.body_a, contacts.body_b]),
        "separation": contacts.separation / s,
        "normal_impulse": contacts.normal_impulse / impulse,
        "tangent_impulse": contacts.tangent_impulse / impulse,
        "contacts": run.contacts,
        "sweeps": run.sweeps,
        "theta": run.theta / impulse,
    }


def assert_same_run(scene, s, *, steps, **options):
    one = in_units_of(dc.simulate(scene, steps=steps, **options), 1.0)
    assert one["contacts"].any()
    other = in_units_of(dc.simulate(times(scene, s), steps=steps, **options), s)
    for name, expected in one.items():
        np.testing.assert_array_equal(other[name], expected, err_msg=name)


def falling(radius=MIXED, **world):
    """A pile that falls, meets the walls, and bounces."""
    options = {"friction": 0.5, "restitution": 0.3, "seed": 4} | world
    return dc.lattice_in_box(30, radius=radius, **options)


@pytest.mark.parametrize("s", POWERS_OF_FOUR)
@pytest.mark.parametrize("method", METHODS)
def test_a_scene_times_a_power_of_four_is_the_same_run_to_the_last_bit(method, s):
    assert_same_run(falling(), s, steps=150, solver=METHODS[method](sweeps=40))


@pytest.mark.parametrize("s", POWERS_OF_FOUR[1:3])
@pytest.mark.parametrize(
    ("scene", "options"),
    [
        (falling(friction=0.0), {}),
        (falling(EQUAL, restitution=0.0), {}),
        (falling(gravity=(3.0, -5.0)), {"warm_start": None}),
        (falling(), {"solver": dc.PGS(islands=True), "warm_start": "copy"}),
        # No gravity gives a time, so Δt does: the same number of steps.
        (dc.drifting_circles(30, size=16.0, speed=4.0, seed=3, restitution=0.5), {"solver": dc.PGS()}),
        (dc.drum(40, froude=0.1, seed=4, radius=(0.7, 1.0)), {"solver": dc.PGS(sweeps=30)}),
    ],
    ids=str,
)
def test_what_a_scene_has_and_how_it_is_solved_changes_nothing_of_that(scene, options, s):
    assert_same_run(scene, s, steps=100, **options)


@pytest.mark.parametrize("s", POWERS_OF_FOUR)
def test_the_same_scene_sleeps_after_the_same_step(s):
    scene = dc.simulate(dc.column(5, width=2.02), steps=100).state
    scene = scene.replace(contacts=None, time=0.0, step=0, solver=None)
    run = dc.simulate(scene, steps=120, sleep=True)
    assert 0 < np.count_nonzero(run.contacts) < 120
    assert_same_run(scene, s, steps=120, sleep=True)


def tolerance_of(state):
    return theta_tolerance(state.bodies.mass, state.bodies.radius, state.world.gravity, state.dt)


@pytest.mark.parametrize("n", [1, 7, 40, 1000])
def test_the_thesis_scene_has_the_values_of_box2d_exactly(n):
    scene = dc.lattice_in_box(n)
    assert scene.scales == dc.BOX2D._replace(max_translation=FASTEST * scene.dt)
    for found in (scene, dc.drifting_circles(20)):
        assert tolerance_of(found) == constants.THETA_TOLERANCE == dc.PGS().for_state(found).tolerance


def test_scales_follow_mean_radius_gravity_mass_and_time_step():
    scene = dc.column(3, radius=0.25, density=2.0, gravity=(0.0, -2 * 9.81)).replace(dt=0.02)
    speed = math.sqrt(0.5)  # √(2 · 0.25)
    expected = dc.ContactScales(
        slop=0.00125, wall_skin=0.0025, max_correction=0.05, max_translation=FASTEST * 0.02,
        restitution_threshold=speed, sleep_speed=0.01 * speed,
        sleep_spin=math.radians(2) * speed / 0.25, sleep_time=0.5 * 0.25 / speed,
    )  # fmt: skip
    np.testing.assert_allclose(scene.scales, expected, rtol=1e-15)
    # m is 2/16 of π kg, g and Δt are twice those of the thesis.
    np.testing.assert_allclose(tolerance_of(scene), 6e-5 * 2 / 16 * 2 * 2, rtol=1e-15)


def test_without_gravity_everything_bounces_and_only_exact_rest_sleeps():
    scales = dc.drifting_circles(5, seed=1).replace(dt=0.02).scales
    assert (scales.restitution_threshold, scales.sleep_speed, scales.sleep_spin) == (0.0, 0.0, 0.0)
    assert scales.sleep_time == 1.0  # 50 steps
    state = ready(dc.two_bodies(speed=0.1, restitution=0.5))
    np.testing.assert_allclose(contact_problem(state).b[0], 0.05, rtol=1e-12)
    after = dc.simulate(state, steps=60, sleep=True).state.bodies.velocity
    np.testing.assert_allclose(after[1, 0] - after[0, 0], 0.05, rtol=1e-9)


def test_scales_that_are_set_hold_whatever_the_scene():
    scene = dc.column(3, radius=0.1)
    scales = scene.scales._replace(slop=0.02, restitution_threshold=0)
    held = scene.replace(world=replace(scene.world, scales=scales))
    assert held.scales == scales
    assert isinstance(held.world.scales.restitution_threshold, float)
    # A circle pressed into the floor by less than the slop stays there; by the scene's own slop it is pushed out.
    deep = scene.bodies._replace(position=scene.bodies.position - [0.0, 0.015])
    stays, rises = (
        dc.simulate(state.replace(bodies=deep), steps=50).state.bodies.position[0, 1] for state in (held, scene)
    )
    np.testing.assert_allclose(stays, deep.position[0, 1], atol=1e-4)
    assert rises > stays + 0.01


@pytest.mark.filterwarnings("ignore:.*outside of the box")
@pytest.mark.parametrize("scales", [None, dc.BOX2D._replace(max_translation=1e300)])
@pytest.mark.parametrize("dt", LIMITS["dt"][:2])
def test_no_body_leaves_a_step_faster_than_a_state_may_be(scales, dt):
    scene = dc.single_body(radius=1e9, scales=scales, box=(-1e9, -1e9, 1e9, 1e9), gravity=(0, 0)).replace(dt=dt)
    scene = scene.replace(bodies=scene.bodies._replace(velocity=np.array([[1e10, 0.0]])))
    state = dc.step(scene, solver=dc.PGS(sweeps=0))
    assert np.abs(state.bodies.velocity).max() <= FASTEST * (1 + 1e-12)
    dc.step(state)


@pytest.mark.parametrize("gravity", [(0.0, -9.81), (0.0, 0.0)])
def test_fixed_circles_have_no_part_in_the_tolerance_of_a_solver(gravity):
    """It follows the mean mass of those that move; the peg's is infinite."""
    scene = circles_at([[5.0, 1.0], [9.0, 1.0]], mass=[1.0, 3.0], gravity=gravity)
    pegged = scene.with_bodies(add=dc.make_bodies([[5.0, 9.0]], fixed=True))
    one, other = (dc.simulate(state, steps=1, solver=dc.PGS()).state.solver.tolerance for state in (scene, pegged))
    assert 0.0 < one == other
    only = circles_at([[5.0, 9.0]], fixed=True, gravity=gravity)
    assert 0.0 < dc.simulate(only, steps=2, solver=dc.PGS()).state.solver.tolerance < 1.0


def test_a_tolerance_of_the_user_is_absolute_and_a_run_holds_numbers():
    scene = dc.column(3, radius=0.01)
    for tolerance, held in ((1e-3, 1e-3), (None, None), ("scene", tolerance_of(scene))):
        assert dc.simulate(scene, steps=1, solver=dc.PGS(tolerance=tolerance)).state.solver == dc.PGS(tolerance=held)


def test_the_mean_of_equal_numbers_is_the_number():
    for value in (0.1, 0.3, np.pi, 1e308, 5e-324):
        assert mean(np.full(40, value)) == value
    assert mean(np.array([1.0, 2.0, 6.0])) == 3.0
    assert mean(np.array([1e308, 0.5e308])) == 0.75e308
