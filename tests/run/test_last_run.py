"""`run.last_run`: a call of `simulate` goes on with the run behind a state, unless somebody has changed the state."""

import threading

import numpy as np
import pytest
from conftest import assert_same_bits

import deep_contact as dc
from deep_contact.run.last_run import _last_run
from deep_contact.state.arrays import Bodies, Contacts

HOW = (dc.PGS(sweeps=10, tolerance=None), None, "builtin", False)
OPTIONS = {"solver": HOW[0]}


@pytest.fixture
def state():
    """The state that a run of a small pile has led to."""
    return dc.simulate(dc.circles_in_box(12, size=9.0, seed=3), steps=60, **OPTIONS).state


def copied(state):
    """A state with the same values, behind which there is no run."""
    bodies, contacts = Bodies(*map(np.copy, state.bodies)), Contacts(*map(np.copy, state.contacts))
    return state.replace(bodies=bodies, contacts=contacts)


def test_a_call_goes_on_with_the_run_behind_the_state(state):
    run = _last_run.kept[2]
    after = dc.simulate(state, steps=3, **OPTIONS).state
    assert _last_run.kept[2] is run
    assert after.step == 63


CHANGES = {
    "bodies.position": 0.01, "bodies.velocity": 0.5, "bodies.angle": 0.1, "bodies.spin": 0.5, "bodies.mass": 0.5,
    "bodies.radius": -0.05, "contacts.normal_impulse": 0.1, "contacts.tangent_impulse": 0.01,
    "contacts.normal_start": 0.1, "contacts.tangent_start": 0.01, "contacts.separation": 1e-4,
}  # fmt: skip
"""Array of a state -> what is added to its first element."""


@pytest.mark.parametrize(("name", "change"), CHANGES.items())
def test_a_state_that_somebody_wrote_into_starts_a_run_of_its_own(state, name, change):
    owner, field = name.split(".")
    getattr(getattr(state, owner), field).flat[0] += change
    expected = dc.simulate(copied(state), steps=3, **OPTIONS).state
    dc.simulate(dc.circles_in_box(12, size=9.0, seed=3), steps=1, **OPTIONS)  # another run is the last one now
    other = dc.simulate(dc.circles_in_box(12, size=9.0, seed=3), steps=60, **OPTIONS).state
    getattr(getattr(other, owner), field).flat[0] += change
    assert _last_run.take(other, HOW) is None
    assert_same_bits(dc.simulate(other, steps=3, **OPTIONS).state, expected)


def test_another_state_another_method_and_another_thread_take_no_run(state):
    kept = _last_run.kept
    assert _last_run.take(copied(state), HOW) is None
    _last_run.kept = kept  # `take` lets the run go
    assert _last_run.take(state, (dc.PGS(), *HOW[1:])) is None
    _last_run.kept = kept
    found = []
    thread = threading.Thread(target=lambda: found.append(_last_run.take(state, HOW)))
    thread.start()
    thread.join()
    assert found == [None]
    assert _last_run.take(state, HOW) is kept[2]


def test_a_run_is_let_go_with_its_state():
    dc.simulate(dc.circles_in_box(12, size=9.0, seed=3), steps=3, **OPTIONS)
    assert _last_run.kept is None
