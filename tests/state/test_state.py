"""Validation of states at the border."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.io.state_xml import format_state
from deep_contact.state import fields
from deep_contact.state.checks import check_state


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
        ({"world": []}, "world: expected"),
        ({"dt": [[1], [1, 2]]}, "dt: expected"),
        ({"time": 1j}, "time: expected"),
        ({"step": 1.5}, "step: expected"),
        ({"name": True}, "name: expected"),
    ],
)
def test_parts_of_the_wrong_type_are_named_by_all_that_take_a_state(change, message):
    # Found by tests/tools/fuzz.py: they came back as NumPy's or Python's own errors.
    state = dc.step(dc.column(3)).replace(**change)
    for use in (dc.step, dc.solve_contacts, dc.solve_exactly, format_state):
        with pytest.raises(ValueError, match=message):
            use(state)


@pytest.fixture(scope="module")
def pile():
    """Circles at rest on the floor of a box with a slope in it."""
    world = {"box": (0.0, 0.0, 12.0, 12.0), "segments": [((0.0, 11.0), (1.0, 12.0)), ((6.0, 0.0), (12.0, 2.0))]}
    scene = circles_at([[2, 1], [3, 2.6], [4, 1], [9, 2.1], [6, 8]], mass=[1, 2, 3, 4, 5], **world)
    return dc.simulate(scene, steps=60, solver=dc.PGS()).state


def carried(state):
    """Names of the bodies that touch -> their impulses. A circle's name is its mass."""
    n, c = state.bodies.count, state.contacts
    names = [*state.bodies.mass, "floor", "right", "ceiling", "left", "0", "1"]
    assert (c.body_b < n + 6).all()
    return {(names[a], names[b]): (p, q) for a, b, p, q in zip(c.body_a, c.body_b, c.normal_start, c.tangent_start)}


def test_contacts_that_do_not_fit_the_bodies_are_refused(pile):
    # They were kept: what lay on the floor fell, and the new circle was pushed.
    more = dc.make_bodies(np.vstack([pile.bodies.position, [[10.0, 10.0]]]))
    with pytest.raises(ValueError, match="bodies: expected"):
        pile.replace(bodies=more)
    with pytest.raises(ValueError, match=r"segments\[1\]: expected"):
        pile.replace(world=replace(pile.world, segments=pile.world.segments[:1]))
    assert pile.replace(bodies=more, contacts=None).contacts is None
    assert pile.replace(world=replace(pile.world, friction=0.1)).contacts is pile.contacts


@pytest.mark.parametrize(
    ("remove", "stays"),
    [([], [0, 1, 2, 3, 4]), ([1], [0, 2, 3, 4]), ([4, 0], [1, 2, 3]), ([True, *[False] * 4], [1, 2, 3, 4])],
)
def test_circles_come_and_go_and_the_contacts_of_the_others_keep_their_impulses(pile, remove, stays):
    state = pile.with_bodies(add=dc.make_bodies([[10.0, 10.0], [0.99, 6.0]], mass=[8.0, 9.0]), remove=remove)
    np.testing.assert_array_equal(state.bodies.position[:-2], pile.bodies.position[stays])
    there = {*(np.array(stays) + 1.0), "floor", "1"}
    expected = {pair: value for pair, value in carried(pile).items() if there.issuperset(pair)}
    assert len(expected) >= 3
    assert carried(state) == {**expected, (9.0, "left"): (0.0, 0.0)}
    for wrong in ([5], [0, 0], [0.5], [True]):
        with pytest.raises(ValueError, match="remove: expected"):
            pile.with_bodies(remove=wrong)


def test_contacts_are_found_and_nothing_is_solved(pile):
    # `simulate(state, steps=0)`, which was called the way to find them, solved 2,000 sweeps into them.
    found = dc.find_contacts(pile.replace(contacts=None))
    assert not any(values.any() for values in found.contacts[5:])
    assert dc.find_contacts(pile) == pile
    lifted = pile.bodies.position + np.eye(5)[:, :1] * [0.0, 7.0]
    moved = dc.find_contacts(pile.replace(bodies=pile.bodies._replace(position=lifted)))
    assert carried(moved) == {pair: value for pair, value in carried(pile).items() if pair[0] != pile.bodies.mass[0]}
    solved = dc.experiments.solved_states(pile, steps=2)[-1]
    assert solved.solved
    assert dc.find_contacts(solved) == solved


def test_a_check_that_finds_nothing_wrong_writes_no_text_of_bodies(monkeypatch):
    written = []
    monkeypatch.setattr(fields, "brief", lambda value: written.append(type(value)) or "")
    check_state(circles_at([[5.0, 5.0]]))
    assert not {dc.Bodies, dc.Contacts, np.ndarray} & set(written)
