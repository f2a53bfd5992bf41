"""The load of a state, and how far it may change before the carried impulses are tested."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.starts.load import KICK, NEAR, anchor_of, is_near, kept_anchor, load_of, share_of_gravity


def world_of(state, **changes):
    return state.replace(world=replace(state.world, **changes))


def bodies_of(state, **changes):
    return state.replace(bodies=state.bodies._replace(**changes))


LINES = [((0.0, 1.0), (9.0, 1.0)), ((20.0, 0.0), (20.0, 9.0))]


def laden():
    """Two circles beside a belt, under a push."""
    world = dc.World(segments=LINES, surface_speeds=(1.0, 0.0), friction=0.5, restitution=0.2, scales=dc.BOX2D)
    bodies = dc.make_bodies([[5.0, 2.0], [7.5, 2.0]], velocity=[[1.0, 0.0], [0.0, 2.0]], spin=[0.0, 1.0])
    return dc.State(name="laden", world=world, bodies=bodies, push=(np.ones((2, 2)), np.ones(2)))


def other(values):
    """The same numbers but for the last."""
    values = values.copy()
    values.flat[-1] += 0.5
    return values


CONSTANT = {
    "box": lambda s: world_of(s, box=(0.0, 0.0, 30.0, 31.0)),
    "segments": lambda s: world_of(s, segments=[LINES[0], ((20.0, 0.0), (20.0, 9.5))]),
    "surface_speeds": lambda s: world_of(s, surface_speeds=(5.0, 0.0)),
    "no belt": lambda s: world_of(s, surface_speeds=()),
    "scales": lambda s: world_of(s, scales=dc.BOX2D._replace(slop=0.004)),
    "dt": lambda s: s.replace(dt=0.02),
    "position": lambda s: bodies_of(s, position=other(s.bodies.position)),
    "mass": lambda s: bodies_of(s, mass=other(s.bodies.mass)),
    "radius": lambda s: bodies_of(s, radius=other(s.bodies.radius)),
}
"""Part of a load that no change may touch if the carried impulses are to stay untested -> a state with another."""
VARIABLE = {
    "gravity": lambda s: world_of(s, gravity=(0.0, -9.8)),
    "friction": lambda s: world_of(s, friction=0.6),
    "restitution": lambda s: world_of(s, restitution=0.3),
    "force": lambda s: s.replace(push=(other(s.push[0]), s.push[1])),
    "torque": lambda s: s.replace(push=(s.push[0], other(s.push[1]))),
    "no push": lambda s: s.replace(push=None),
}
MOTIONS = {
    "velocity": lambda s: bodies_of(s, velocity=other(s.bodies.velocity)),
    "spin": lambda s: bodies_of(s, spin=other(s.bodies.spin)),
}


def test_a_load_is_of_all_that_impulses_are_solved_for_and_of_nothing_else():
    state = laden()
    load = load_of(state)
    for name, change in (CONSTANT | VARIABLE | MOTIONS).items():
        new = load_of(change(state))
        assert (new.digest == load.digest) == (name in MOTIONS), name
        assert (new.motion == load.motion) == (name not in MOTIONS), name
        assert (new.constant == load.constant) == (name not in CONSTANT), name
    same = bodies_of(laden(), angle=np.array([1.0, 2.0])).replace(time=3.0, step=7, name="another")
    assert load_of(same) == load
    smooth = world_of(state, friction=0.0)  # a belt drags nothing then
    assert load_of(world_of(smooth, surface_speeds=(5.0, 0.0))).digest == load_of(smooth).digest


def resting(tangent=0.0):
    """A disc of 2 kg and 0.5 m on the floor, with its impulses, N·s."""
    state = circles_at([[5.0, 0.5]], radius=0.5, gravity=(0.0, -10.0), friction=0.5)
    state = dc.find_contacts(bodies_of(state, mass=np.array([2.0]))).replace(dt=0.01)
    return state.replace(
        contacts=state.contacts._replace(normal_start=np.array([0.2]), tangent_start=np.array([tangent]))
    )


LIMIT = KICK * math.sqrt(10.0 * 0.5)


def kept(state, changed):
    return kept_anchor(anchor_of(state), state.world, changed)


SPEEDS = {
    "gravity, Δt |Δg|": lambda state, speed: world_of(state, gravity=(100.0 * speed, -10.0)),
    "force, Δt |f| / m": lambda state, speed: state.replace(push=(np.array([[0.0, 200.0 * speed]]), np.zeros(1))),
    "torque, 2 Δt |τ| / (m r)": lambda state, speed: state.replace(push=(np.zeros((1, 2)), np.array([50.0 * speed]))),
    "both": lambda state, speed: world_of(state, gravity=(50.0 * speed, -10.0)).replace(
        push=(np.array([[100.0 * speed, 0.0]]), np.zeros(1))
    ),
}
"""Change of the load -> the disc with a change by which it gains this speed in a step, m/s."""


@pytest.mark.parametrize("name", SPEEDS)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_impulses_stay_up_to_a_speed_that_follows_from_newtons_law(name, sign):
    # The turned gravity is a little stronger, and the limit follows the stronger one.
    assert kept(resting(), SPEEDS[name](resting(), sign * 0.999 * LIMIT)) is not None
    assert kept(resting(), SPEEDS[name](resting(), sign * 1.001 * LIMIT)) is None


def test_opposite_changes_of_gravity_and_push_cancel():
    """Their sum acts on the disc: gravity of −10 m/s² more, and a force of 20 N up."""
    state = world_of(resting(), gravity=(0.0, -20.0))
    assert kept(resting(), state) is None
    assert kept(resting(), state.replace(push=(np.array([[0.0, 20.0]]), np.zeros(1)))) is not None


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_lower_friction_counts_by_what_it_removes(sign):
    """λ_t = 0.5 λ_n: a bound lower by δ λ_n changes the disc by δ λ_n / m = 0.1 δ m/s, a higher bound by nothing."""
    state, most = resting(sign * 0.1), LIMIT / 0.1
    assert most > NEAR  # so that it is not |Δμ| which decides
    below = kept(resting(sign * 0.1), world_of(state, friction=0.5 - 0.9 * NEAR))
    assert below.spent == pytest.approx(0.1 * 0.9 * NEAR)
    assert kept(state, world_of(state, friction=0.5 + 0.9 * NEAR)).spent == 0.0
    assert kept(resting(0.01), world_of(state, friction=0.5 - 0.9 * NEAR)).spent == pytest.approx(0.1 * 0.9 * NEAR)


def test_an_impulse_inside_the_lower_bound_loses_nothing():
    state = resting(0.05)  # half of the bound
    assert kept(state, world_of(state, friction=0.495)).spent == 0.0


def test_an_impulse_beyond_its_bound_of_before_loses_no_more_than_one_at_the_bound():
    """Sweeps change λ_n after λ_t, so that solved impulses may lie outside of the cone."""
    state = resting(0.15)
    assert kept(state, world_of(state, friction=0.495)).spent == pytest.approx(0.1 * 0.005)


def test_lower_friction_adds_up_until_the_limit_is_spent():
    """Twice the limit in steps of a tenth; each step is of impulses at the bound of their own friction."""
    state, spent = resting(0.1), []
    anchor, step = anchor_of(state), 0.1 * LIMIT / 0.1
    for _ in range(20):
        before, friction = state.world, state.world.friction - step
        anchor = anchor._replace(world=world_of(state, friction=friction).world)  # as if |Δμ| did not count
        state = world_of(state, friction=friction)
        following = kept_anchor(anchor, before, state)
        if following is None:
            break
        anchor = following
        spent.append(anchor.spent)
        contacts = state.contacts._replace(tangent_start=np.array([friction * 0.2]))
        state = state.replace(contacts=contacts)
    np.testing.assert_allclose(spent[:9], LIMIT * np.arange(0.1, 0.95, 0.1), rtol=1e-6)
    assert len(spent) in (9, 10)


@pytest.mark.parametrize("name", ["friction", "restitution"])
@pytest.mark.parametrize(
    ("begin", "end", "stays"),
    [(0.3, 0.309, True), (0.3, 0.311, False), (0.3, 0.289, False), (0, 1e-6, False), (1e-6, 0, False), (0, 0, True)],
)
def test_a_constant_of_contacts_may_change_by_little_and_not_from_or_to_0(name, begin, end, stays):
    state = world_of(resting(), **{name: begin})
    assert (kept(state, world_of(state, **{name: end})) is not None) == stays


def test_a_state_is_near_to_its_own_load_alone():
    state = resting()
    state = state.replace(load=load_of(state))
    slightly = world_of(state, gravity=(1e-3, -10.0))
    assert is_near(state)
    assert is_near(slightly)
    assert not is_near(world_of(state, gravity=(1.0, -10.0)))
    assert not is_near(bodies_of(slightly, velocity=np.ones((1, 2))))
    assert not is_near(bodies_of(slightly, position=np.array([[6.0, 0.5]])))


@pytest.mark.parametrize(
    ("gravity", "share"),
    [((0.0, -20.0), 2.0), ((0.0, -5.0), 0.5), ((0.0, 0.0), 0.0), ((0.0, 3.0), 0.0), ((10.0, 0.0), 0.0),
     ((7.0, -10.0), 1.0), ((-6.0, -8.0), 0.8)],
)  # fmt: skip
def test_impulses_are_scaled_by_the_part_of_gravity_along_the_one_before(gravity, share):
    state = resting()
    new = world_of(state, gravity=gravity)
    assert share_of_gravity(state.world, anchor_of(state), new) == pytest.approx(share)
    push = np.array([[1.0, 0.0]]), np.zeros(1)
    for before, after in ((push, None), (None, push)):
        anchor = anchor_of(state.replace(push=before))
        assert share_of_gravity(state.world, anchor, new.replace(push=after)) == 1.0
    nothing = np.zeros((1, 2)), np.zeros(1)
    assert share_of_gravity(state.world, anchor_of(state), new.replace(push=nothing)) == pytest.approx(share)
    weightless = world_of(state, gravity=(0.0, 0.0))
    assert share_of_gravity(weightless.world, anchor_of(weightless), state) == 1.0
