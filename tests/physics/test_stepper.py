"""`dc.step` in a loop: what goes along from state to state saves time and changes no bit."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.physics import stepper

TEN = dc.PGS(sweeps=10, tolerance=None)


@pytest.fixture(scope="module")
def falling():
    return dc.simulate(dc.lattice_in_box(60, seed=3), steps=100, solver=TEN).state


def plain(state):
    """The state as a user would make it: with nothing beside its fields."""
    return pickle.loads(pickle.dumps(state))


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("solver", [TEN, dc.PGS(sweeps=50), dc.PGS(sweeps=20, islands=True), dc.NNCG(sweeps=10)])
def test_a_loop_of_steps_is_a_run_to_the_last_bit(falling, solver, friction):
    # Without friction and tangent impulses to start from, no tangent rows are swept.
    contacts = (
        falling.contacts if friction else falling.contacts._replace(tangent_start=0 * falling.contacts.tangent_start)
    )
    world = dc.World(box=falling.world.box, friction=friction)
    one = other = start = falling.replace(world=world, contacts=contacts, solver=None)
    for _ in range(20):
        one, other = dc.step(one, solver=solver), dc.simulate(other, steps=1, solver=solver).state
        assert one == other
    assert one == dc.simulate(start, steps=20, solver=solver).state


def test_a_loop_of_steps_among_segments_is_a_run(falling):
    line = [(0.0, 4.0), (6.0, 2.0), (12.0, 3.0)]
    world = dc.World(box=falling.world.box, segments=list(zip(line, line[1:])))
    state = start = falling.replace(world=world, contacts=None)
    for _ in range(20):
        state = dc.step(state, solver=TEN)
    assert (state.contacts.body_b >= state.bodies.count + 4).any()
    assert state == dc.simulate(start, steps=20, solver=TEN).state


def test_a_step_leaves_the_state_as_it_is(falling):
    state = dc.step(falling, solver=TEN)
    before = plain(state)
    after = dc.step(state)
    assert state == before
    assert dc.step(state) == after  # from a state that others came from


@pytest.mark.parametrize("field", ["velocity", "mass", "radius"])
def test_new_bodies_are_stepped_as_those_of_a_new_state(falling, field):
    state = dc.step(falling, solver=dc.PGS(sweeps=20))  # whose tolerance and scales follow mass and radius
    changed = state.replace(bodies=state.bodies._replace(**{field: 0.9 * getattr(state.bodies, field)}))
    found, expected = dc.step(changed, solver=dc.PGS(sweeps=20)), dc.step(plain(changed), solver=dc.PGS(sweeps=20))
    assert found == expected
    assert dc.step(found) == dc.step(plain(found))


def test_fewer_circles_get_a_stepper_of_their_own(falling):
    state = dc.step(falling, solver=TEN)
    fewer = state.replace(bodies=dc.Bodies(*(values[:40] for values in state.bodies)), contacts=None)
    assert dc.step(fewer) == dc.step(plain(fewer))


@pytest.mark.parametrize("change", [{"dt": 0.005}, {"solver": dc.PGS(sweeps=3)}, {"world": dc.World(friction=0.1)}])
def test_another_setting_is_not_what_the_stepper_knows(falling, change):
    changed = dc.step(falling, solver=TEN).replace(**change)
    assert dc.step(changed) == dc.step(plain(changed))


def test_another_solver_is_not_what_the_stepper_knows(falling):
    state = dc.step(falling, solver=TEN)
    assert dc.step(state, solver=dc.PGS(sweeps=3)) == dc.step(plain(state), solver=dc.PGS(sweeps=3))
    assert dc.step(state, solver=dc.BatchedPGS(sweeps=3)) == dc.step(plain(state), solver=dc.BatchedPGS(sweeps=3))


def test_the_solver_that_was_asked_for_and_that_of_the_state_keep_the_stepper(falling):
    state = dc.step(falling, solver=dc.PGS(sweeps=20))
    assert state.solver != dc.PGS(sweeps=20)  # its tolerance is that of the state
    for solver in (None, dc.PGS(sweeps=20), state.solver):
        assert vars(dc.step(state, solver=solver))["_stepper"] is vars(state)["_stepper"]


@pytest.mark.parametrize(("part", "field"), [("bodies", "velocity"), ("contacts", "normal"), ("contacts", "body_b")])
def test_what_somebody_wrote_into_the_arrays_is_looked_at(falling, part, field):
    state = dc.step(falling, solver=TEN)
    getattr(getattr(state, part), field)[0] = 10**9 if field == "body_b" else np.nan
    with pytest.raises(ValueError, match=rf"{part}\.{field}\[0\]"):
        dc.step(state)


def test_where_a_step_comes_to_no_position_simulate_is_asked(falling, monkeypatch):
    state = dc.step(falling, solver=TEN)
    function, made = stepper.take_step, []
    monkeypatch.setattr(
        stepper, "take_step", lambda numbers, *others: made.append(numbers) or function(np.nan * numbers, *others)
    )
    assert dc.step(state) == dc.simulate(plain(state), steps=1).state
    assert len(made) == 1


def test_steps_on_threads_do_not_share_memory(falling):
    states = [dc.step(falling, solver=TEN)]
    for _ in range(7):
        states.append(dc.step(states[-1]))

    def run(state):
        for _ in range(100):
            state = dc.step(state)
        return state

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(run, states))
    assert found == [dc.simulate(state, steps=100).state for state in states]


def test_a_stepped_state_is_a_state(falling):
    state = dc.step(falling, solver=TEN)
    for other in (plain(state), copy.copy(state), copy.deepcopy(state), state.replace()):
        assert other == state
    assert "_stepper" not in vars(plain(state))
    assert "60 circles" in repr(state)
    with pytest.raises(AttributeError, match="no attribute 'velocity'"):
        state.velocity  # noqa: B018


def test_other_solvers_are_left_to_simulate():
    for solver in (dc.BatchedPGS(), dc.PGS(precision="single"), dc.PGS(substeps=2)):
        assert not stepper.can_step(solver)
