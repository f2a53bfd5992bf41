"""Position correction eight contacts at a time against contact by contact: the same bits."""

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.stepping import position_correction
from deep_contact.stepping.position_correction import fill_levels, make_correction_workspace
from deep_contact.stepping.problem import contacts_of
from deep_contact.stepping.segment_grid import NO_SEGMENTS

SIDE = 20.0


def heap(n, seed, *, ratio=3.0):
    """A box of circles that overlap each other and the walls, a few of them with a centre in common."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, SIDE, (n, 2))
    position[n // 2 : n // 2 + n // 20] = position[: n // 20]
    radius = SIDE / np.sqrt(n) * rng.uniform(1 / ratio, 0.7, n)
    state = circles_at(position, radius=radius, mass=rng.uniform(0.1, 10.0, n), box=(0, 0, SIDE, SIDE))
    return state.replace(contacts=contacts_of(state))


def corrected(state, sweeps, room):
    """Positions after a correction."""
    bodies = state.bodies._replace(position=state.bodies.position.copy())
    position_correction.correct_positions(
        bodies, state.contacts, state.world.box, NO_SEGMENTS, state.scales, sweeps, room
    )
    return bodies.position


def in_turn(state, sweeps):
    """The same by sweeps contact by contact, with the rule for the end written out."""
    bodies = state.bodies._replace(position=state.bodies.position.copy())
    for _ in range(sweeps):
        where = state.contacts, state.world.box, NO_SEGMENTS, state.scales
        if position_correction.correct_in_turn(bodies, *where) >= -3 * state.scales.slop:
            break
    return bodies.position


@pytest.mark.parametrize("sweeps", [0, 1, 2, 3, 5, 12])
@pytest.mark.parametrize("seed", range(4))
def test_eight_at_a_time_compute_the_same_bits(seed, sweeps):
    state = heap(600, seed)
    room = make_correction_workspace(600, state.contacts.count)
    expected = in_turn(state, sweeps)
    assert (expected != state.bodies.position).any() == (sweeps > 0)
    for last in (0, 10):  # tiles from the third sweep on, and from the first
        room.memory["sweeps"] = last
        found = corrected(state, sweeps, room)
        assert room.memory["sweeps"][0] == sweeps  # so deep that none ends it early
        assert room.memory["wait"][0] == 0
        np.testing.assert_array_equal(found, expected)


@pytest.mark.filterwarnings("ignore:.*nearly coincide")
@pytest.mark.parametrize("solver", [dc.PGS(), dc.BatchedPGS()])
@pytest.mark.parametrize(("n", "apart"), [(20, 0.0), (50, 0.0), (50, 1e-6), (200, 0.0)])
def test_circles_in_one_place_fill_a_disc(n, apart, solver):
    # Whatever their radii; each pair's push once followed the first pair's: 50 circles lay in a line, 44 m × 0 m.
    rng = np.random.default_rng(n)
    box = (0.0, 0.0, 60.0, 60.0)
    state = circles_at(20.0 + apart * rng.normal(size=(n, 2)), radius=rng.uniform(0.3, 1.0, n), box=box, gravity=(0, 0))
    bodies = dc.simulate(state, steps=200, solver=solver).state.bodies
    across = 2.0 * np.sqrt((bodies.radius**2).sum() / 0.85)  # of a disc that they cover to 85 %
    assert (np.ptp(bodies.position, axis=0) > 0.65 * across).all()
    assert (np.ptp(bodies.position, axis=0) < 1.1 * across).all()


def test_the_end_is_the_same():
    state = dc.simulate(dc.lattice_in_box(400, radius=(0.5, 1.0), gap=0.05, seed=1), steps=300).state
    ends = set()
    for share in (1.0, 0.996, 0.995):
        squeezed = state.replace(bodies=state.bodies._replace(position=share * state.bodies.position))
        squeezed = squeezed.replace(contacts=contacts_of(squeezed))
        room = make_correction_workspace(400, squeezed.contacts.count)
        room.memory["sweeps"] = 10
        found = corrected(squeezed, 20_000, room)
        np.testing.assert_array_equal(found, in_turn(squeezed, 20_000))
        ends.add(int(room.memory["sweeps"][0]))
    assert max(ends) < 20_000
    assert len(ends) == 3


def test_levels_hold_every_contact_once_after_those_before_it():
    state = heap(500, 7)
    n, contacts = 500, state.contacts
    room = make_correction_workspace(n, contacts.count)
    tiles = fill_levels(contacts, n, room)
    pairs = room.body[:tiles].transpose(0, 2, 1).reshape(-1, 2).astype(int)
    used = pairs[pairs[:, 0] != n + 4]
    order = {pair: place for place, pair in enumerate(map(tuple, used))}
    listed = list(zip(contacts.body_a, contacts.body_b))
    assert sorted(order) == sorted(listed)
    for tile in pairs.reshape(tiles, 8, 2):
        circles = tile[tile < n]
        assert len(set(circles)) == len(circles)
    for circle in range(n):
        of_circle = [order[pair] for pair in listed if circle in pair]
        assert of_circle == sorted(of_circle)


@pytest.mark.filterwarnings("ignore:.*solved to a tolerance")
def test_a_column_is_corrected_contact_by_contact():
    state = dc.simulate(dc.column(40), steps=5).state
    room = make_correction_workspace(40, state.contacts.count)
    assert fill_levels(state.contacts, 40, room) == 0
    room.memory["sweeps"] = 10
    found = corrected(state, 10, room)
    assert room.memory["wait"][0] > 0
    np.testing.assert_array_equal(found, in_turn(state, 10))


def test_the_room_grows():
    state = heap(200, 3, ratio=1.5)
    found = corrected(state, 4, make_correction_workspace(200, 10))
    np.testing.assert_array_equal(found, in_turn(state, 4))
