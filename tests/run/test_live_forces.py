"""What a `Simulator` sees of its steps: `on_step`, `solved`, `force_on`. The oracle is `simulate`, and momentum."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from conftest import assert_same_bits, circles_at

import deep_contact as dc
from deep_contact.stepping.log import FINITE

PGS = dc.PGS(sweeps=8)
WAYS = {
    "fast": ({}, {"accuracy": "fast"}),
    "no start": ({}, {"solver": PGS, "warm_start": None}),
    "support": ({"restitution": 0.5}, {"solver": PGS, "warm_start": "support"}),
    "asleep": ({}, {"solver": PGS, "sleep": True}),
    "frictionless": ({"friction": 0.0}, {"solver": PGS}),
    "rebounds": ({"restitution": 0.5}, {"solver": dc.PGS(sweeps=8, substeps=2, most_substeps=8)}),
    "batches": ({"restitution": 0.3}, {"solver": dc.BatchedPGS(sweeps=8, substeps=3)}),
}
RARE = "asleep", "frictionless", "batches"  # each compiles a kind of step that no other test needs
SIDES = "floor", "right", "ceiling", "left"


def scene(**world):
    """Twelve circles, two of them fixed, that fall beside and onto a shelf that moves."""
    shelf = {"segments": [((2.0, 1.5), (9.0, 1.0)), ((12.0, 3.0), (25.0, 3.0))]}
    shelf["segment_velocities"] = [((0.0, 0.0), (0.0, 0.0)), ((0.1, 0.3), (0.1, 0.2))]
    state = dc.lattice_in_box(12, seed=1, **world)
    is_fixed = np.arange(12) < 2
    bodies = state.bodies._replace(
        velocity=np.where(is_fixed[:, None], 0.0, [3.0, -12.0]), mass=np.where(is_fixed, np.inf, state.bodies.mass)
    )
    return state.replace(bodies=bodies, world=replace(state.world, **shelf))


@pytest.mark.parametrize("way", [pytest.param(way, marks=[pytest.mark.slow] * (way in RARE)) for way in WAYS])
def test_on_step_gets_what_it_gets_in_a_run_and_changes_no_bit(way):
    world, how = WAYS[way]
    state, expected, seen = scene(**world), [], []
    dc.simulate(state, steps=60, on_step=lambda *step: expected.append(step), **how)
    live = dc.Simulator(state, on_step=lambda *step: seen.append(step), **how)
    for steps in (1, 0, 19, 40):
        live.step(steps)
    assert len(seen) == 60
    assert max(solved.contacts.normal_impulse.max(initial=0.0) for solved, _ in seen) > 0.1
    for (solved, record), (other, other_record) in zip(seen, expected):
        assert_same_bits(solved, other)
        assert solved == other
        assert record == other_record
    assert live.solved is seen[-1][0]
    assert live.state == dc.simulate(state, steps=60, **how).state


@pytest.mark.parametrize("way", [pytest.param(way, marks=[pytest.mark.slow] * (way in RARE)) for way in WAYS])
def test_forces_are_those_of_a_run_over_the_same_steps(way):
    """The mean of each part has its own interval: the floor is asked each 10 steps, circle and segment each 20."""
    world, how = WAYS[way]
    state = scene(**world)
    run = dc.simulate(state, steps=60, record=10, forces=True, **how)
    live, found = dc.Simulator(state, forces=True, **how), []
    for k in range(6):
        live.step(10)
        assert live.solved == run.solved[k]
        found.append([live.force_on(side) for side in SIDES])
        if k % 2 == 1:
            for part, index in (("segment", 1), ("circle", [3, 7, 0]), ("segment", [0])):
                expected = run.force_on(part, index)[k - 1 : k + 1].mean(axis=0)
                np.testing.assert_allclose(live.force_on(part, index), expected, rtol=1e-9, atol=1e-9)
    assert live.state == run.state
    expected = np.stack([run.force_on(side) for side in SIDES], axis=1)
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-9)


def test_two_balls_that_bounce_load_the_floor_with_their_weight_by_the_balance_of_momentum():
    """Σ F Δt = Σ m (v' − v) + m g t + shifts, to rounding, in all steps so far; in the long run it is m g."""
    state = circles_at([[3.0, 3.0], [7.0, 4.0]], box=(0.0, 0.0, 10.0, 20.0), restitution=0.9)
    shifts, weight = np.zeros(2), 9.81 * state.bodies.mass.sum()

    def add(solved, record):
        shifts[:] += record.shifts.sum(axis=0)

    for how in ({"solver": PGS}, {"accuracy": "fast"}):
        shifts[:] = 0.0
        live = dc.Simulator(state, forces=True, on_step=add, **how)
        live.step(500)
        gained = state.bodies.mass @ live.velocities - shifts + (0.0, weight * live.time)
        assert np.abs(live.velocities).max() > 1.0  # they still bounce
        force = live.force_on("floor")
        np.testing.assert_allclose(-force, gained / live.time, rtol=0, atol=1e-11 * weight)
        assert force[1] == pytest.approx(-weight, rel=0.05)
        live.step(2500)
        assert live.force_on("floor")[1] == pytest.approx(-weight, rel=0.01)


def test_steps_in_which_something_pushes_are_counted_alike():
    """A ball with e = 0.9 touches in few steps; `state` of a simulator shows none of these contacts."""
    state = circles_at([[5.0, 1.5]], box=(0.0, 0.0, 10.0, 20.0), restitution=0.9)
    counts = np.zeros(3, int)

    def count(k):
        def add(solved, record):
            counts[k] += (solved.contacts.normal_impulse > 0.0).any()

        return add

    run = dc.simulate(state, steps=150, solver=PGS, on_step=count(0))
    dc.Simulator(state, solver=PGS, on_step=count(1)).step(150)
    live = dc.Simulator(state, solver=PGS, forces=True)
    for _ in range(150):
        live.step()
        counts[2] += (live.solved.contacts.normal_impulse > 0.0).any()
        floor, solved = live.force_on("floor"), dc.forces(live.solved)
        np.testing.assert_allclose(floor, solved.walls["floor"], rtol=1e-12)
        np.testing.assert_allclose(live.force_on("circle", 0), solved.net[0], rtol=1e-12)
    assert live.state == run.state
    assert counts[0] == counts[1] == counts[2] > 1


def test_a_force_is_asked_twice_and_before_any_step():
    live = dc.Simulator(dc.column(3), solver=PGS, forces=True)
    assert live.force_on("floor").tolist() == live.force_on("circle", [0, 1]).tolist() == [0.0, 0.0]
    live.step(30)
    first = live.force_on("wall", 0)
    assert first[1] < -20.0
    assert live.force_on("floor").tolist() == first.tolist()  # nothing has happened since


def test_a_changed_scene_keeps_the_sums_of_what_stays():
    """A column of three; circle 1 is another after circle 0 is gone, and its sum goes with it."""
    live = dc.Simulator(dc.column(3, friction=0.5), solver=dc.PGS(sweeps=200), forces=True)
    weight = 9.81 * live.state.bodies.mass[0]
    live.step(100)
    live.force_on("floor"), live.force_on("circle", [0, 1, 2])
    live.step(10)
    live.set(dt=0.005)
    live.step(10)
    indices = live.add(dc.make_bodies([[2.0, 10.0]], radius=0.5))
    live.set(segments=[((20.0, 0.0), (20.0, 5.0))], segment_velocities=[((0.0, 0.1), (0.0, 0.1))])
    live.step(10)
    top = live.positions[:3, 1].argmax()
    index = live.remove([int(top)])
    live.step(5)
    # 10 steps of 0.01 s and 20 of 0.005 s with three weights, 5 of 0.005 s with two.
    floor = (0.2 * 3 + 0.025 * 2) / 0.225 * weight
    assert live.force_on("floor")[1] == pytest.approx(-floor, rel=1e-3)
    kept = index[[i for i in range(3) if i != top]]
    assert live.force_on("circle", kept)[1] == pytest.approx(2 * weight, rel=1e-3)
    assert live.force_on("circle", index[indices]).tolist() == [0.0, 0.0]
    assert live.force_on("segment", 0).tolist() == [0.0, 0.0]
    live.set(segments=[])
    with pytest.raises(ValueError, match="index: expected none"):
        live.force_on("segment", 0)


def test_an_interval_of_a_new_circle_begins_with_the_circle():
    live = dc.Simulator(dc.column(1), solver=PGS, forces=True)
    live.step(100)
    new = live.add(dc.make_bodies([[5.0, 1.005]], radius=1.0))
    live.step(50)
    weight = 9.81 * live.state.bodies.mass[0]
    assert live.force_on("circle", new)[1] == pytest.approx(weight, rel=0.02)


@pytest.mark.parametrize("error", [KeyboardInterrupt, FloatingPointError])
def test_a_step_that_is_undone_leaves_sums_and_solved_as_they_were(error, monkeypatch):
    live, plain = (dc.Simulator(scene(), forces=True, **WAYS["fast"][1]) for _ in range(2))
    live.step(45)
    plain.step(45)
    solved, steps = live.solved, live._steps

    def broken(*arguments):
        result = type(steps).__call__(steps, *arguments)
        if error is KeyboardInterrupt:
            raise error
        live._scene.bodies.position[3], arguments[2].progress[FINITE] = np.nan, False
        return result

    broken.sleep = None
    monkeypatch.setattr(live, "_steps", broken)
    with pytest.raises(error):
        live.step(20)
    monkeypatch.setattr(live, "_steps", steps)
    assert live.solved is solved
    for one in (live, plain):
        one.step(15)
    for side in SIDES:
        np.testing.assert_array_equal(live.force_on(side), plain.force_on(side))
    assert live.solved == plain.solved


def test_a_pickle_has_the_sums():
    live = dc.Simulator(scene(), forces=True, solver=PGS)
    live.step(40)
    again = pickle.loads(pickle.dumps(live))
    assert again.solved == live.solved
    for one in (live, again):
        one.step(20)
    assert np.abs(live.solved.contacts.normal_impulse).max() > 0.1
    for part, index in (("floor", None), ("segment", 1), ("circle", np.arange(12) > 6)):
        assert again.force_on(part, index).tolist() == live.force_on(part, index).tolist()


def test_on_step_may_change_the_scene_as_its_caller_may():
    def turn(solved, record):
        if live.state.step == 20:
            live.set(gravity=(5.0, -9.81))
            live.add(dc.make_bodies([[15.0, 25.0]]))

    live, other = dc.Simulator(dc.column(3), solver=PGS, on_step=turn), dc.Simulator(dc.column(3), solver=PGS)
    live.step(50)
    other.step(20)
    other.set(gravity=(5.0, -9.81))
    other.add(dc.make_bodies([[15.0, 25.0]]))
    other.step(30)
    assert live.state == other.state


def test_an_error_of_on_step_leaves_the_step_that_it_saw():
    def fail(solved, record):
        if solved.step == 4:
            raise RuntimeError("seen enough")

    live = dc.Simulator(dc.column(3), solver=PGS, on_step=fail)
    with pytest.raises(RuntimeError, match="seen enough"):
        live.step(10)
    assert (live.state.step, live.solved.step) == (5, 4)
    live.step(5)
    assert live.state == dc.simulate(dc.column(3), steps=10, solver=PGS).state


def test_what_was_not_asked_for_is_refused():
    plain, live = dc.Simulator(dc.column(1), solver=PGS), dc.Simulator(dc.column(1), solver=PGS, forces=True)
    with pytest.raises(ValueError, match=r"forces: expected a Simulator\(…, forces=True\), got one without"):
        plain.force_on("floor")
    with pytest.raises(ValueError, match=r"solved: expected a Simulator\(…, forces=True\)"):
        plain.solved  # noqa: B018
    with pytest.raises(ValueError, match="solved: expected a call of step"):
        live.solved  # noqa: B018
    with pytest.raises(ValueError, match=r"part: expected one of floor, .* did you mean 'floor'"):
        live.force_on("flor")
    with pytest.raises(ValueError, match="index: expected none of the floor, got 0"):
        live.force_on("floor", 0)
    with pytest.raises(ValueError, match="forces: expected True or False, got 1"):
        dc.Simulator(dc.column(1), forces=1)
    with pytest.raises(ValueError, match="on_step: expected a function, or None, got 3"):
        dc.Simulator(dc.column(1), on_step=3)
