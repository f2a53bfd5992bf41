"""A load that changes: impulses that were solved for another load must not become velocity."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.starts import changed_load as load_module
from deep_contact.starts.changed_load import fitted, with_new_load, with_time_step
from deep_contact.starts.load import load_of

PRESETS = "preview", "fast", "balanced", "accurate", "reference"


def world_of(state, **changes):
    return state.replace(world=replace(state.world, **changes))


def bodies_of(state, **changes):
    return state.replace(bodies=state.bodies._replace(**changes))


def lighter(state):
    mass = state.bodies.mass.copy()
    mass[:10] /= 20.0
    return bodies_of(state, mass=mass)


def shaken(state):
    chance = np.random.default_rng(5).uniform(-1e-3, 1e-3, state.bodies.position.shape)
    return bodies_of(state, position=state.bodies.position + chance)


CHANGES = {
    "gravity off": lambda state: world_of(state, gravity=(0.0, 0.0)),
    "gravity turned": lambda state: world_of(state, gravity=(9.81, 0.0)),
    "gravity halved": lambda state: world_of(state, gravity=(0.0, -4.905)),
    "removed": lambda state: state.with_bodies(remove=[int(state.bodies.position[:, 1].argmax()), 3]),
    "added": lambda state: state.with_bodies(add=dc.make_bodies([[6.0, 30.0]], density=50.0)),
    "lighter": lighter,
    "no friction": lambda state: world_of(state, friction=0.0),
    "floor lowered": lambda state: world_of(state, box=(0.0, -0.5, 12.0, 40.0)),
    "shorter step": lambda state: state.replace(dt=0.05 * state.dt),
    "longer step": lambda state: state.replace(dt=20.0 * state.dt),
    "moved": shaken,
}


@pytest.fixture(scope="module")
def settled():
    scene = dc.circles_in_box(40, size=(12.0, 40.0), seed=3)
    return {preset: dc.simulate(scene, steps=1000, accuracy=preset).state for preset in PRESETS}


@pytest.mark.parametrize("accuracy", PRESETS)
@pytest.mark.parametrize("change", CHANGES)
def test_a_new_load_makes_no_more_speed_than_where_nothing_was_carried(settled, change, accuracy):
    state = CHANGES[change](settled[accuracy])
    forgotten = state.replace(contacts=None)
    speed = [
        np.hypot(*dc.simulate(one, steps=1, accuracy=accuracy).state.bodies.velocity.T) for one in (state, forgotten)
    ]
    assert speed[0].max() <= speed[1].max() + 0.02


@pytest.mark.parametrize("accuracy", ["fast", "reference"])
def test_a_pile_without_gravity_stays_where_it_is(settled, accuracy):
    state = CHANGES["gravity off"](settled[accuracy])
    after = dc.simulate(state, steps=100, accuracy=accuracy).state
    # Position correction parts circles that overlap by up to 0.005 m, in a pile of some ten rows.
    assert np.abs(after.bodies.position - state.bodies.position).max() < 0.02
    assert np.abs(after.bodies.velocity).max() < 1e-3


def test_a_column_stays_when_its_heavy_top_is_taken_off():
    scene = dc.column(5)
    mass = scene.bodies.mass * [1, 1, 1, 1, 50]
    state = dc.simulate(bodies_of(scene, mass=mass), steps=300, solver=dc.PGS(sweeps=300)).state
    after = dc.simulate(state.with_bodies(remove=[4]), steps=60, solver=dc.PGS())
    assert np.abs(after.state.bodies.velocity).max() < 1e-3


def test_steps_that_change_all_the_time_leave_a_pile_at_rest(settled):
    state = start = settled["fast"]
    for k in range(40):
        state = dc.simulate(state, steps=1, dt=(0.0005, 0.01)[k % 2]).state
    assert np.abs(state.bodies.velocity).max() < 0.01
    assert np.abs(state.bodies.position - start.bodies.position).max() < 1e-3


@pytest.mark.parametrize(("steps", "dt", "substeps"), [(2, 0.005, 1), (1, 0.01, 2)])
def test_a_bounce_keeps_its_height_whatever_the_caller_does_to_the_step(steps, dt, substeps):
    """On its way down the ball gets shorter steps, or more substeps."""
    scene = dc.State(
        name="ball", world=dc.World(restitution=1.0, friction=0.0), bodies=dc.make_bodies([[5.0, 3.0]], radius=0.5)
    )
    state, highest = scene, []
    for _ in range(1000):
        falls = state.bodies.velocity[0, 1] < 0.0
        how = {"steps": steps, "dt": dt, "solver": dc.PGS(substeps=substeps)} if falls else {"steps": 1, "dt": 0.01}
        state = dc.simulate(state, **{"solver": dc.PGS(), **how}).state
        highest.append(state.bodies.position[0, 1])
    assert max(highest[-200:]) == pytest.approx(3.0, rel=0.01)


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_what_flies_has_the_velocity_of_half_a_step_earlier_and_gets_that_of_another_step(e):
    """v(t − Δt / 2) of the leapfrog, under gravity and a push, where e > 0; what touches and what is fixed stays."""
    circles = [[5.0, 5.0], [9.0, 1.0], [14.0, 5.0]]
    scene = circles_at(circles, velocity=[[1.0, 2.0], [0, 0], [0, 0]], fixed=[False, False, True], restitution=e)
    push = np.array([[3.0, 1.0], [0.0, -1.0], [5.0, 5.0]])
    state = dc.simulate(scene, steps=3, solver=dc.PGS(substeps=2), push=push).state
    gained = (np.array([0.0, -9.81]) + push[0] / scene.bodies.mass[0]) * 0.5 * (e > 0.0)
    for dt in (0.002, 0.03):
        after = with_time_step(state, dt).bodies.velocity - state.bodies.velocity
        np.testing.assert_allclose(after, [gained * (0.01 - dt) / 2, [0, 0], [0, 0]], rtol=1e-9, atol=1e-12)
    again = dc.simulate(state, steps=0, solver=dc.PGS(substeps=8), push=push).state.bodies.velocity[0]
    np.testing.assert_allclose(again - state.bodies.velocity[0], gained * (0.01 / 2 - 0.01 / 8), rtol=1e-9, atol=1e-12)
    assert with_time_step(state, 0.01) is state
    early = with_time_step(dc.find_contacts(scene), 0.002)
    np.testing.assert_array_equal(early.bodies.velocity, scene.bodies.velocity)


def test_impulses_of_a_solved_state_are_kept_and_its_starts_are_scaled():
    state = dc.simulate(dc.column(2), steps=5, solver=dc.PGS()).state
    starts = state.contacts.normal_start
    unsolved, solved = (with_time_step(state.replace(solved=is_so), 0.03).contacts for is_so in (False, True))
    for contacts in (unsolved, solved):
        np.testing.assert_allclose(contacts.normal_start, 3.0 * starts)
        assert contacts.position is state.contacts.position
    np.testing.assert_allclose(unsolved.normal_impulse, 3.0 * state.contacts.normal_impulse)
    assert solved.normal_impulse is state.contacts.normal_impulse


@pytest.mark.parametrize("accuracy", [None, "accurate"])
def test_a_run_that_nothing_disturbs_knows_its_load_and_keeps_its_bits(settled, accuracy):
    state = dc.simulate(dc.circles_in_box(30, seed=1), steps=40, accuracy=accuracy).state
    assert state.load == load_of(state)
    parts = dc.simulate(dc.simulate(state, steps=20, accuracy=accuracy).state, steps=20, accuracy=accuracy).state
    assert parts == dc.simulate(state, steps=40, accuracy=accuracy).state


def test_a_gas_that_goes_on_is_divided_as_it_was():
    """Its fastest circle decides on substeps, and changes."""
    rng = np.random.default_rng(3)
    scene = dc.circles_in_box(20, size=20.0, seed=1, gravity=(0.0, 0.0), restitution=0.5)
    scene = bodies_of(scene, velocity=rng.uniform(-40.0, 40.0, (20, 2)))
    whole = dc.simulate(scene, steps=60, accuracy="fast").state
    parts = dc.simulate(dc.simulate(scene, steps=30, accuracy="fast").state, steps=30, accuracy="fast").state
    assert parts == whole


@pytest.mark.parametrize(
    ("speed", "left", "relaxed", "solved"),
    [(0.13, 0.0019, 1, 0), (0.13, 0.0021, 1, 1), (0.15, 0.0, 0, 1)],  # a step of gravity is 0.098 m/s
)
def test_what_moves_or_does_not_rest_is_solved_well(speed, left, relaxed, solved, monkeypatch):
    state, called = circles_at([[5.0, 5.0]], velocity=[[speed, 0.0]]), {"at_rest": [], "solve": []}
    solution = SimpleNamespace(normal_impulses="n", tangent_impulses="t")
    monkeypatch.setattr(load_module, "at_rest", lambda *start, **how: called["at_rest"].append(how) or ("n", "t", left))
    monkeypatch.setattr(load_module, "solve", lambda state, solver, *start: called["solve"].append(solver) or solution)
    load_module._good(state, None, None, None, None)
    expected = {"iterations": 2000, "speed": pytest.approx(1e-4 * 0.0981), "needed": pytest.approx(0.02 * 0.0981)}
    assert called["at_rest"] == [expected] * relaxed
    assert called["solve"] == [dc.NesterovPGS(sweeps=500, tolerance=None)] * solved


class Searched(Exception):
    pass


@pytest.fixture
def no_search(monkeypatch):
    """A search for other impulses raises `Searched`."""

    def search(*_, **__):
        raise Searched

    monkeypatch.setattr(load_module, "_relaxed", search)


SOLVER = dc.PGS(sweeps=20, tolerance=None)


def pile_and(bodies):
    """A column at rest with its impulses, and other circles beside it."""
    state = dc.simulate(dc.column(4, friction=0.5), steps=300, solver=SOLVER).state
    state = state.with_bodies(add=bodies)
    return state.replace(load=load_of(state))


def turned(state, angle):
    return world_of(state, gravity=(9.81 * np.sin(angle), -9.81 * np.cos(angle)))


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.0, -5.0), (3.0, 0.0)])
def test_a_circle_that_falls_or_rolls_is_no_reason_for_a_search(velocity, no_search):
    """Gravity makes it faster by g Δt, whatever the impulses of the column are."""
    height = 1.0 if velocity[0] else 6.0
    state = pile_and(dc.make_bodies([[5.0, height]], velocity=velocity))
    after = with_new_load(dc.find_contacts(turned(state, 0.004)), SOLVER)
    assert after.contacts.normal_start.max() > 1.0


KICKED = {
    "faster by less than 0.001 √(g r)": (1, [0.0], 0.003, False),
    "faster by more": (1, [0.0], 0.0032, True),
    "one contact, and as fast from zero": (1, [0.05], 0.05, False),
    "one contact, and slower from zero": (1, [0.04], 0.05, True),
    "two contacts, and as fast from zero": (2, [0.05], 0.05, True),
    "no contact": (0, [0.0], 0.05, False),
}
"""What a circle does in a step of 0.0981 m/s by gravity -> contacts, speeds from zero and now, whether it is kicked."""


@pytest.mark.parametrize("name", KICKED)
def test_a_circle_is_kicked_if_it_becomes_faster_than_all_were_and_gravity_is_not_why(name):
    """The pile has four more circles, which rest on two contacts each."""
    contacts, (free,), speed, is_kicked = KICKED[name]
    pairs = [(1, 2), (2, 3), (3, 4), (1, 6), (4, 6), *[(0, 6), (0, 7)][:contacts]]
    state, ends = circles_at([[5.0 * k, 20.0] for k in range(1, 6)]), np.array(sorted(pairs)).T
    velocity, from_zero = np.zeros((5, 2)), np.zeros((5, 2))
    velocity[0, 0], from_zero[0, 0] = speed, free
    fake = SimpleNamespace(bodies=state.bodies, world=state.world, dt=state.dt, push=None, contacts=tuple(ends))
    assert load_module._kicks(fake, velocity, from_zero) == is_kicked


@pytest.mark.parametrize(("before", "after", "is_kicked"), [(0.05, 0.14, False), (0.05, 0.16, True), (0.04, 0.1, True)])
def test_a_circle_that_moves_on_may_gain_what_gravity_gives(before, after, is_kicked):
    state = circles_at([[5.0, 1.0]], velocity=[[before, 0.0]])
    fake = SimpleNamespace(
        bodies=state.bodies, world=state.world, dt=0.01, push=None, contacts=np.array([[0, 0], [1, 2]])
    )
    assert load_module._kicks(fake, np.array([[after, 0.0]]), np.zeros((1, 2))) == is_kicked


def test_after_a_small_change_impulses_stay_and_after_many_they_are_tested(monkeypatch):
    """Gravity turned in steps of 1e-3 rad: each is Δt g 1e-3, and the limit is 0.001 √(g r), 31.9 of them."""
    tested = []
    monkeypatch.setattr(load_module, "with_new_load", lambda state, *_, **__: tested.append(state) or state)
    state = dc.simulate(dc.column(4, friction=0.5), steps=300, solver=SOLVER).state
    carried, load = state.contacts, state.load
    near, anchor = fitted(turned(state, 1e-3), SOLVER)
    np.testing.assert_allclose(near.contacts.normal_start, carried.normal_start, rtol=1e-6)
    assert anchor == load.anchor
    counts = []
    for k in range(1, 70):
        state = dc.simulate(turned(state, 1e-3 * k), steps=1, solver=SOLVER).state
        counts.append(len(tested))
    assert (counts[30], counts[31], counts[62], counts[63]) == (0, 1, 1, 2)


def test_impulses_follow_gravity_and_gravity_that_is_switched_off_leaves_none(no_search, monkeypatch):
    state = dc.simulate(dc.column(4, friction=0.5), steps=300, solver=SOLVER).state
    carried = state.contacts.normal_start
    for factor in (1.001, 0.5, 3.0, 0.0):
        after, _ = fitted(world_of(state, gravity=(0.0, -9.81 * factor)), SOLVER)
        np.testing.assert_allclose(after.contacts.normal_start, factor * carried, rtol=1e-12)
    monkeypatch.setattr(load_module, "_left", None)  # no solve is needed to see this
    assert not fitted(world_of(state, gravity=(0.0, 0.0)), SOLVER)[0].contacts.have_past


def test_a_state_keeps_what_it_carries_where_its_load_is_its_own_or_unknown(no_search):
    state = dc.simulate(dc.column(4), steps=5, solver=SOLVER).state
    assert fitted(state, SOLVER)[0] is state
    unknown = world_of(state.replace(load=None), gravity=(1.0, 0.0))
    after, anchor = fitted(unknown, SOLVER)
    assert after is unknown
    assert anchor.world is unknown.world


@pytest.mark.parametrize("flies", [False, True])
def test_a_pile_whose_gravity_comes_back_rests_whatever_flies_above_it(settled, flies):
    """Its impulses are 0 by then. A circle that is faster than all others must not hide that the pile sinks."""
    state = settled["fast"]
    if flies:
        state = state.with_bodies(add=dc.make_bodies([[6.0, 30.0]], velocity=(0.0, 2.0)))
    off = world_of(dc.simulate(state, steps=1).state, gravity=(0.0, 0.0))
    after = dc.simulate(world_of(dc.simulate(off, steps=3).state, gravity=(0.0, -9.81)), steps=1).state
    assert np.hypot(*after.bodies.velocity[:40].T).max() < 0.03


def test_impulses_by_which_circles_move_faster_than_they_fall_are_solved_well(settled, monkeypatch):
    """The floor is gone, and with it all that can rest: the relaxation parts circles that slide."""
    called, solved = [], load_module._solved
    monkeypatch.setattr(load_module, "_solved", lambda *arguments: called.append(0) or solved(*arguments))
    dc.simulate(CHANGES["floor lowered"](settled["fast"]), steps=1)
    assert called


@pytest.mark.parametrize(
    ("speeds", "is_changed", "expected"),
    [
        ([0.0, 0.0, 5.0], True, {"speed": 0.02, "needed": np.inf}),
        ([0.0, 0.0, 0.1], True, {"speed": 0.02, "needed": 0.02}),
        ([0.0, 0.0, 0.1], False, {"speed": 1e-4, "needed": 0.02}),
        ([0.0, 0.0, 5.0], False, None),
        ([0.0, 5.0, 5.0], True, None),
    ],
)
def test_after_a_change_it_is_enough_that_most_circles_rest(speeds, is_changed, expected, monkeypatch):
    """Speeds at which a search ends, as multiples of g Δt = 0.0981 m/s; without a search, impulses stay."""
    called = []
    monkeypatch.setattr(load_module, "at_rest", lambda *_, **how: called.append(how) or ("n", "t", 0.0))
    state = circles_at([[5.0 * k, 5.0] for k in (1, 2, 3)], velocity=[[v, 0.0] for v in speeds])
    found = load_module._relaxed(state, 1, 2, None, is_changed=is_changed)
    if expected is None:
        assert (called, found) == ([], (1, 2, False))
    else:
        assert found == ("n", "t", True)
        assert called == [{"iterations": 2000} | {name: pytest.approx(0.0981 * x) for name, x in expected.items()}]
