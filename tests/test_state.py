"""Validation of states at the border."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.state import check_state


def broken(state, part, field, index, value):
    arrays = getattr(state, part)
    array = getattr(arrays, field).copy()
    array[index] = value
    return state.replace(**{part: arrays._replace(**{field: array})})


@pytest.mark.parametrize(
    ("part", "field", "value", "message"),
    [
        ("bodies", "velocity", np.nan, r"bodies\.velocity\[2\]: expected a finite number"),
        ("bodies", "mass", 0.0, r"bodies\.mass\[2\]: expected a number > 0, got 0.0"),
        ("bodies", "radius", -1.0, r"bodies\.radius\[2\]: expected a number > 0, got -1.0"),
        ("contacts", "body_b", 999, r"contacts\.body_b\[2\]: expected a body after body_a, up to 63"),
        ("contacts", "body_a", -1, r"contacts\.body_a\[2\]: expected a circle, 0 to 59"),
        ("contacts", "normal", 3.0, r"contacts\.normal\[2\]: expected a unit vector"),
        ("contacts", "normal_impulse", -1.0, r"contacts\.normal_impulse\[2\]: expected a number >= 0, got -1.0"),
        ("contacts", "tangent_start", np.inf, r"contacts\.tangent_start\[2\]: expected a finite number, got inf"),
    ],
)
def test_a_broken_field_is_named(falling_states, part, field, value, message):
    with pytest.raises(ValueError, match=message):
        check_state(broken(falling_states[-1], part, field, 2, value))


def test_a_pair_twice_is_refused(falling_states):
    state = falling_states[-1]
    twice = dc.Contacts(*(np.concatenate([field, field[:1]]) for field in state.contacts))
    with pytest.raises(ValueError, match=r"the pair \(body_a \d+, body_b \d+\) appears twice"):
        check_state(state.replace(contacts=twice))


def test_contacts_are_put_into_sweep_order(falling_states):
    state = falling_states[-1]
    shuffle = np.random.default_rng(0).permutation(state.contacts.count)
    shuffled = dc.Contacts(*(field[shuffle] for field in state.contacts))
    sorted_again = check_state(state.replace(contacts=shuffled)).contacts
    for one, other in zip(sorted_again, state.contacts):
        np.testing.assert_array_equal(one, other)


def test_a_wrong_shape_is_named():
    scene = dc.column(3)
    with pytest.raises(ValueError, match=r"bodies\.spin: expected shape \(3,\), got \(2,\)"):
        check_state(scene.replace(bodies=scene.bodies._replace(spin=np.zeros(2))))


def test_inertia_is_a_solid_discs():
    bodies = dc.make_bodies([[1.0, 1.0]], radius=2.0, mass=3.0)
    np.testing.assert_allclose(bodies.inertia, 0.5 * 3.0 * 2.0**2)
