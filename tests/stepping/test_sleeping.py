"""Sleeping: the rule of Box2D 2.3 (0.5 s below 0.01 m/s and 2°/s, whole islands, woken by touch)."""

import numpy as np
import pytest
from conftest import assert_same_bits, circles_at

import deep_contact as dc
from deep_contact.stepping.context import with_optional
from deep_contact.stepping.inputs import step_input
from deep_contact.stepping.problem import contacts_of
from deep_contact.stepping.sleeping import make_sleep_memory, wake_and_put_to_sleep

RESTING = dc.PGS(sweeps=200, tolerance=1e-9)

pushes_and_sleeps = pytest.mark.slow  # a kind of step of its own; test_without_compiler.py runs it interpreted


def test_a_resting_column_falls_asleep_after_half_a_second():
    # Box2D: a step whose circles are still adds Δt; at 0.5 s they sleep, so 50 steps of 0.01 s are solved (51 if 50
    # times 0.01 rounds to less).
    resting = dc.simulate(dc.column(5), steps=100, solver=RESTING).state
    early, run = (dc.simulate(resting, steps=steps, solver=RESTING, sleep=True) for steps in (60, 100))
    solved = np.count_nonzero(run.relaxations)
    assert solved in (50, 51)
    np.testing.assert_array_equal(run.contacts[solved:], 0)
    np.testing.assert_array_equal(run.state.bodies.velocity, 0.0)
    assert set(run.status[solved:]) == {"no_contacts"}
    # What sleeps keeps its place and its impulses, k m g Δt in the contact below k circles.
    np.testing.assert_array_equal(early.state.bodies.position, run.state.bodies.position)
    expected = np.arange(1, 6) * np.pi * 9.81 * 0.01
    np.testing.assert_allclose(np.sort(run.state.contacts.normal_impulse), expected, rtol=1e-6)


def test_until_the_first_island_sleeps_the_run_is_the_same_bit_for_bit():
    scene = dc.circles_in_box(40, seed=1)
    one, other = (dc.simulate(scene, steps=150, sleep=sleep) for sleep in (False, True))
    assert_same_bits(one.state, other.state)
    np.testing.assert_array_equal(one.theta, other.theta)


def test_islands_sleep_on_their_own():
    # One rests on the floor, the other falls beside it from 10 m: 1.43 s.
    scene = circles_at([[5.0, 1.01], [20.0, 11.01]])
    run = dc.simulate(scene, steps=120, solver=RESTING, sleep=True)
    np.testing.assert_allclose(run.state.bodies.velocity[1, 1], -9.81 * 1.2, rtol=1e-12)
    assert np.count_nonzero(run.contacts) in (50, 51)


def test_a_touch_wakes_the_whole_island():
    # Three in a row on the floor sleep; a fourth comes rolling in and pushes them on. Friction turns none measurably.
    centres, velocity = [[10.0, 1.01], [12.0, 1.01], [14.0, 1.01], [3.0, 1.01]], [[0, 0]] * 3 + [[2.0, 0]]
    scene = circles_at(centres, velocity=velocity, friction=1e-12)
    asleep, moved = (dc.simulate(scene, steps=n, solver=RESTING, sleep=True).state.bodies for n in (200, 300))
    np.testing.assert_array_equal(asleep.position[:3], scene.bodies.position[:3])
    # Without friction and restitution all four go on with a quarter of the momentum.
    np.testing.assert_allclose(moved.velocity[:, 0], 0.5, rtol=1e-6)


@pytest.mark.parametrize("slope", [0.003, 0.001, 3e-4])
def test_what_rolls_down_a_gentle_slope_does_not_fall_asleep(slope):
    # a = ⅔ g sin θ: after half a second it is slower than 0.01 m/s, and Box2D leaves it there. On the way up it turns.
    for start in (0.0, 0.012):
        down = (9.81 * np.sin(slope), -9.81 * np.cos(slope))
        state = circles_at([[100.0, 1.01]], velocity=[-start, 0.0], spin=start, gravity=down, box=(0, 0, 200, 30))
        run = dc.simulate(state, steps=500, solver=dc.PGS(), sleep=True)
        np.testing.assert_allclose(run.state.bodies.velocity[0, 0], 2 / 3 * down[0] * 5.0 - start, rtol=1e-2)


def test_nothing_falls_asleep_in_flight():
    # At the top of its flight a circle is slow for 2 v / g = 2 ms only; this one is back on the floor after 2.04 s.
    run = dc.simulate(circles_at([[15.0, 5.0]], velocity=[0.0, 8.0]), steps=300, sleep=True)
    np.testing.assert_allclose(run.state.bodies.position[0, 1], 1.01, atol=0.01)


@pushes_and_sleeps
def test_a_push_wakes_the_whole_island_when_it_comes_and_when_it_goes():
    # Two circles on top of each other and one beside them sleep. From 1 s to 2 s the upper one is lifted, by less than
    # its weight: the two stay where they are, and are solved for half a second after each change.
    scene = circles_at([[10.0, 1.01], [10.0, 3.01], [20.0, 1.01]])
    lift = np.array([[0.0, 0.0], [0.0, 4.0 * np.pi], [0.0, 0.0]])
    options = {"sleep": True, "push": lambda state: lift * (99.5 < state.step < 199.5)}
    contacts = dc.simulate(scene, steps=260, solver=RESTING, **options).contacts
    for change in (100, 200):
        assert contacts[change - 1] == contacts[change + 55] == 0
        np.testing.assert_array_equal(contacts[change : change + 50], 2)


@pushes_and_sleeps
@pytest.mark.parametrize("push", [([[0.0, 50.0]], [0.0]), ([[0.0, 0.0]], [5.0])])
def test_a_force_or_a_torque_wakes_as_it_moves_who_is_awake(push):
    runs = []
    for sleep in (False, True):
        scene = circles_at([[15.0, 1.01]], friction=0.5)
        options = {"push": lambda state: tuple(map(np.array, push if state.time > 1.0 else ([[0.0, 0.0]], [0.0])))}
        runs.append(dc.simulate(scene, steps=200, solver=RESTING, sleep=sleep, **options).state.bodies)
    assert abs(runs[1].velocity).max() > 0.5
    np.testing.assert_allclose(runs[1].velocity, runs[0].velocity, atol=1e-6)


@pushes_and_sleeps
def test_who_sleeps_under_a_push_that_stays_sleeps_on():
    # A drag of what is still is 0, to rounding: it wakes nobody.
    scene, weight = dc.column(3), np.full((3, 2), [0.0, -5.0])
    for push in (lambda state: weight, lambda state: -0.1 * state.bodies.velocity):
        run = dc.simulate(scene, steps=250, solver=RESTING, sleep=True, push=push)
        assert not run.contacts[-100:].any()


def still_after_a_step(scene, still):
    """For how long the only circle of a scene has been still 0.01 s later; infinite if it has fallen asleep."""
    scene = scene.replace(contacts=contacts_of(scene))
    sleep = make_sleep_memory(1, 4)
    sleep.still[:], sleep.place[:] = still, scene.bodies.position
    wake_and_put_to_sleep(with_optional(step_input(scene, dc.PGS())), scene.contacts, sleep, None)
    return sleep.still[0]


@pytest.mark.parametrize(
    ("velocity", "spin", "awake"), [(0.0099, 0.0, 0), (0.0101, 0.0, 1), (0.0, 0.034, 0), (0.0, 0.036, 1)]
)
def test_the_tolerances_are_those_of_box2d(velocity, spin, awake):
    # 2° a second are 0.0349 rad/s.
    scene = circles_at([[5.0, 5.0]], velocity=[velocity, 0.0], spin=spin)
    assert np.isfinite(still_after_a_step(scene, 1.0)) == awake
    # Nor does what penetrates sleep, however still.
    assert still_after_a_step(circles_at([[5.0, 0.9]], gravity=(0.0, 0.0)), 10.0) == 10.01


def test_a_resumed_run_starts_awake(tmp_path):
    state = dc.simulate(dc.column(3), steps=80, solver=RESTING, sleep=True).state
    dc.write_state(tmp_path / "state.xml", state)
    run = dc.simulate(dc.read_state(tmp_path / "state.xml"), steps=80, sleep=True)
    assert run.relaxations[0] > 0
    np.testing.assert_allclose(run.state.bodies.position, state.bodies.position, atol=1e-6)
    pushed = state.replace(bodies=state.bodies._replace(velocity=np.tile([1.0, 0.0], (3, 1))))
    assert dc.simulate(pushed, steps=10, sleep=True).state.bodies.position[0, 0] > 15.01


def test_a_pile_sleeps_where_it_would_have_stayed_awake():
    # What may be lost is the rest of a motion below 0.01 m/s.
    slept = dc.simulate(dc.circles_in_box(40, seed=2), steps=1500, solver=dc.PGS(), sleep=True)
    assert slept.relaxations[-1] == 0
    awake = dc.simulate(slept.state, steps=200).state
    np.testing.assert_allclose(slept.state.bodies.position, awake.bodies.position, atol=2.0 * 0.01)


# ---- beside what moves, is fixed, or pushes ----

BED = {"box": (-20.0, 0.0, 20.0, 20.0), "friction": 0.5}


def nest(**changes):
    """A ball on two pegs, and a ball on the floor, far from each other."""
    options = {"fixed": [True, True, False, False]} | BED | changes
    return circles_at([[-1.2, 1.0], [1.2, 1.0], [0.0, 2.6], [9.0, 1.0]], **options)


def test_what_lies_on_pegs_falls_asleep_and_loads_them_with_its_weight():
    scene, weight = nest(), np.pi * 9.81
    run = dc.simulate(scene, steps=160, solver=RESTING, sleep=True, record=40, forces=True)
    assert run.contacts[:20].max() > 0
    np.testing.assert_array_equal(run.contacts[120:], 0)
    np.testing.assert_array_equal(run.state.bodies.velocity, 0.0)
    np.testing.assert_allclose(run.force_on("circle", [0, 1])[-1], [0.0, -weight], rtol=1e-6, atol=1e-6 * weight)
    np.testing.assert_allclose(run.force_on("circle", 2)[-1], [0.0, weight], rtol=1e-6, atol=1e-6 * weight)
    np.testing.assert_allclose(run.force_on("floor")[-1], [0.0, -weight], rtol=1e-6, atol=1e-6 * weight)
    assert run.trajectory.work[-1] == pytest.approx(run.trajectory.work[-2])


@pytest.mark.parametrize("kind", ["roller", "peg that creeps", "wall that creeps"])
def test_nothing_sleeps_on_what_moves_and_all_else_does(kind):
    """However slowly. The ball on the floor is far from it."""
    changes = {"roller": {"spin": [1e-3, 0.0, 0.0, 0.0]}, "peg that creeps": {"velocity": [[0, 1e-3], *[[0, 0]] * 3]}}
    wall = {"segments": [((-3.0, 0.5), (3.0, 0.5))], "segment_velocities": [((0.0, 1e-3), (0.0, 1e-3))]}
    scene = nest(**changes.get(kind, {}))
    if kind == "wall that creeps":
        scene = circles_at([[0.0, 1.5], [9.0, 1.0]], **BED, **wall)
    run = dc.simulate(scene, steps=200, solver=RESTING, sleep=True)
    assert run.contacts[-1] == {"wall that creeps": 1}.get(kind, 2)
    np.testing.assert_array_equal(run.state.bodies.velocity[-1], 0.0)
    np.testing.assert_allclose(run.state.bodies.position[-1], [9.0, 1.0], atol=0.02)
    if kind != "roller":
        rise = (run.state.world.segments or [(0, run.state.bodies.position[0, 1])])[0][1]
        assert rise == pytest.approx({"wall that creeps": 0.5}.get(kind, 1.0) + 2e-3)


@pytest.mark.parametrize("kind", ["paddle", "wall", "wall that is set"])
def test_who_sleeps_wakes_when_what_moves_comes_and_goes_with_it(kind):
    """At 1 m/s from 4.5 m on; it takes 4.5 s, of which the ball sleeps three at least."""
    centres, comes = [[9.0, 1.0]], {}
    if kind == "paddle":
        centres, comes = [[9.0, 1.0], [2.5, 1.2]], {"velocity": [[0, 0], [1.0, 0.0]], "fixed": [False, True]}
    else:
        comes = {"segments": [((3.5, 0.2), (3.5, 3.0))], "segment_velocities": [((1.0, 0.0),) * 2]}
        if kind == "wall that is set":
            comes["segment_velocities"] = [((0.001, 0.0),) * 2]
    run = dc.Simulator(circles_at(centres, **BED, **comes), solver=RESTING, sleep=True)
    run.step(150)
    assert run._steps.sleep.still[0] == np.inf
    if kind == "wall that is set":
        run.set(segment_velocities=[((1.0, 0.0),) * 2])
        assert run._steps.sleep.still[0] == 0.0
    run.step(200)
    np.testing.assert_allclose(run.positions[0], [9.0, 1.0], atol=0.02)
    run.step(350)
    assert run.velocities[0, 0] == pytest.approx(1.0, abs=0.05)
    ahead = run.positions[1, 0] + 2.0 if kind == "paddle" else run.state.world.segments[0][0] + 1.0
    assert run.positions[0, 0] == pytest.approx(ahead, abs=0.03)


@pushes_and_sleeps
@pytest.mark.parametrize(
    "change", [{"gravity": (3.0, -9.0)}, {"push": np.full((4, 2), [0.0, 40.0])}, {"friction": 0.4}]
)
def test_who_sleeps_wakes_when_the_world_or_the_push_is_set(change):
    run = dc.Simulator(nest(), solver=RESTING, sleep=True, push=np.zeros((4, 2)))
    run.step(150)
    np.testing.assert_array_equal(run._steps.sleep.still, np.inf)
    run.set(**change)
    np.testing.assert_array_equal(run._steps.sleep.still, 0.0)
    run.step(60)
    moved = np.abs(run.positions - nest().bodies.position).max() > 0.05
    assert moved == ("friction" not in change)
