"""Validation of states at the border."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.io.state_xml import format_state
from deep_contact.state.checks import check_state


def broken(state, part, field, index, value):
    arrays = getattr(state, part)
    array = getattr(arrays, field).copy()
    array[index] = value
    return state.replace(**{part: arrays._replace(**{field: array})})


@pytest.mark.parametrize(
    ("part", "field", "value", "message"),
    [
        ("bodies", "mass", 0.0, r"bodies\.mass\[2\]: expected a number > 0, got 0.0"),
        ("contacts", "body_b", 999, r"contacts\.body_b\[2\]: expected a body after body_a, up to 63"),
        ("contacts", "body_a", -1, r"contacts\.body_a\[2\]: expected a circle, 0 to 59"),
        ("contacts", "normal", 3.0, r"contacts\.normal\[2\]: expected a unit vector"),
        ("contacts", "normal_impulse", -1.0, r"contacts\.normal_impulse\[2\]: expected a number >= 0, got -1.0"),
    ],
)
def test_a_broken_field_is_named(falling_states, part, field, value, message):
    with pytest.raises(ValueError, match=message):
        check_state(broken(falling_states[-1], part, field, 2, value))


def test_contacts_are_put_into_sweep_order_and_a_pair_twice_is_refused(falling_states):
    state = falling_states[-1]
    order = np.random.default_rng(0).permutation(state.contacts.count)
    assert check_state(state.replace(contacts=dc.Contacts(*(field[order] for field in state.contacts)))) == state
    twice = dc.Contacts(*(np.concatenate([field, field[:1]]) for field in state.contacts))
    with pytest.raises(ValueError, match=r"the pair \(body_a \d+, body_b \d+\) appears twice"):
        check_state(state.replace(contacts=twice))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"world": []}, "world: expected World, got list"),
        ({"dt": [[1], [1, 2]]}, r"dt: expected a finite number > 0, got \[\[1"),
        ({"time": 1j}, "time: expected a finite number, got 1j"),
        ({"step": 1.5}, "step: expected an integer >= 0, got 1.5"),
        ({"name": True}, "name: expected a text, got True"),
    ],
)
def test_parts_of_the_wrong_type_are_named_by_all_that_take_a_state(change, message):
    # Found by tests/tools/fuzz.py: they came back as NumPy's or Python's own errors.
    state = dc.step(dc.column(3)).replace(**change)
    for use in (dc.step, dc.solve_contacts, dc.solve_exactly, format_state):
        with pytest.raises(ValueError, match=message):
            use(state)
