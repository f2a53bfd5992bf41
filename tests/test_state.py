"""Validation of states at the border."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.io.state_xml import format_state
from deep_contact.state import check_state


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


TWO = [[1.0, 1.0], [4.0, 1.0]]


def with_bodies(**fields):
    state = dc.column(3)
    return state.replace(bodies=state.bodies._replace(**fields))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: dc.World(gravity=-9.81), r"gravity: expected two finite numbers, such as \(0, -9.81\), got -9.81"),
        (lambda: dc.World(box="wide"), "box: expected finite .* got wide"),
        (lambda: dc.make_bodies(TWO, radius=[1, 1, 1]), r"radius: expected one value .* of the 2, got \[1, 1, 1\]"),
        (lambda: dc.make_bodies(TWO, velocity=[1, 2, 3]), "velocity: expected one pair for all circles"),
        (lambda: dc.make_bodies(TWO, mass="heavy"), "mass: expected one value .* got 'heavy'"),
        (lambda: dc.make_bodies([[1, 1], [2]]), r"position: expected numbers of shape \(n, 2\)"),
        (lambda: dc.simulate("scene.xml"), "state: expected a State, .* dc.read_state .* got 'scene.xml'"),
        (lambda: dc.simulate(dc.column(1).replace(bodies=TWO)), "bodies: expected Bodies, got list"),
        (lambda: dc.simulate(dc.column(1).replace(world=None)), "world: expected World, got NoneType"),
        (lambda: dc.step(with_bodies(mass=1j)), "bodies.mass: expected"),
        (lambda: dc.step(with_bodies(position=[[1], [1, 2]])), "bodies.position: expected"),
        (lambda: dc.step(with_bodies(spin=np.zeros(2))), r"bodies\.spin: expected shape \(3,\), got \(2,\)"),
        (lambda: check_state(dc.column(3).replace(solved=1j)), "solved: expected True or False, got 1j"),
        *(
            (lambda options=options: dc.circles_in_box(5, **options), f"{next(iter(options))}: expected")
            for options in ({"radius": 1j}, {"radius": object()}, {"size": "x"}, {"seed": [1.5]}, {"size": [1, 2, 3]})
        ),
    ],
)
def test_what_is_easily_given_wrongly_gets_a_sentence(make, message):
    with pytest.raises(ValueError, match=message):
        make()


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
