"""Broad and narrow phase against brute force over all pairs."""

import numpy as np
import pytest
from conftest import circles_at
from hypothesis import given, settings
from hypothesis import strategies as st

from deep_contact.state.constants import WALL_SKIN
from deep_contact.stepping.broad_phase import TOUCHING, make_cells, sort_into_cells
from deep_contact.stepping.contacts import Exclusions, Walls, carry_impulses, detect_contacts, make_contacts
from deep_contact.stepping.problem import contacts_of


def pairs_of(contacts):
    return list(zip(contacts.body_a, contacts.body_b))


def search(position, radius, box, cells, skin=0.01):
    """`find_contacts` in a box without segments."""
    nothing = Exclusions(mass=None, touches=None)
    return detect_contacts(position, radius, Walls(box, skin), None, nothing, cells, make_contacts(4000))


def brute_force_pairs(state):
    position, radius, n = state.bodies.position, state.bodies.radius, state.bodies.count
    x_min, y_min, x_max, y_max = state.world.box
    pairs = []
    for a in range(n):
        for b in range(a + 1, n):
            if ((position[b] - position[a]) ** 2).sum() <= TOUCHING * (radius[a] + radius[b]) ** 2:
                pairs.append((a, b))
        gaps = (position[a, 1] - y_min, x_max - position[a, 0], y_max - position[a, 1], position[a, 0] - x_min)
        pairs += [(a, n + wall) for wall, gap in enumerate(gaps) if gap <= radius[a] + state.scales.wall_skin]
    return pairs


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 60),
    spread=st.sampled_from([0.5, 3.0, 12.0]),
    ratio=st.sampled_from([1.0, 3.0, 100.0]),
)
def test_pairs_equal_brute_force(seed, n, spread, ratio):
    rng = np.random.default_rng(seed)
    state = circles_at(rng.normal(15, spread, (n, 2)), radius=np.exp(rng.uniform(np.log(1 / ratio), 0, n)))
    assert pairs_of(contacts_of(state)) == brute_force_pairs(state)


@pytest.mark.parametrize("height", np.random.default_rng(0).uniform(0.0, 10.0, 8))
def test_circles_that_just_touch_are_found(height):
    # As far apart as the cells are wide: rounding may put them two cells apart.
    state = circles_at(np.column_stack([np.full(12, 15.0), height + 2.0 * np.arange(12)]))
    assert [(a, b) for a, b in pairs_of(contacts_of(state)) if b < 12] == [(a, a + 1) for a in range(11)]


def crowd(n, seed, *, smallest, side=30.0):
    """Many small circles, and a few large ones among them: the cells of one grid would each hold many."""
    rng = np.random.default_rng(seed)
    radius = np.exp(rng.uniform(np.log(smallest), np.log(40 * smallest), n))
    radius[:: n // 3] = (6.0, 2.0, 0.5, 3.0)[: radius[:: n // 3].size]
    return circles_at(rng.uniform(0, side, (n, 2)) * (1.0, 0.4), radius=radius, box=(0, 0, side, side))


@pytest.mark.parametrize("smallest", [1e-5, 1e-3, 0.01])
@pytest.mark.parametrize("seed", range(2))
def test_pairs_of_all_sizes_equal_brute_force(seed, smallest):
    state, cells = crowd(400, seed, smallest=smallest), make_cells(400)
    bodies = state.bodies
    found = search(bodies.position, bodies.radius, state.world.box, cells, state.scales.wall_skin)
    assert len(np.unique(cells.level)) > 1  # sorted by size
    assert (found.body_a == 0).sum() > 40  # a long list of one circle is sorted as well
    assert pairs_of(found) == brute_force_pairs(state)


def test_pairs_of_all_sizes_that_fit_no_list_are_found():
    rng = np.random.default_rng(1)
    state = circles_at(rng.normal(15, 0.2, (200, 2)), radius=np.exp(rng.uniform(np.log(0.01), 0, 200)))
    contacts = contacts_of(state)
    assert contacts.count > 8 * 200 + 40
    assert pairs_of(contacts) == brute_force_pairs(state)


def test_one_large_circle_crowds_no_cells():
    # In one grid of cells as wide as it, every small circle would be compared with hundreds of others.
    position, radius, cells = np.random.default_rng(0).uniform(1, 79, (2000, 2)), np.full(2000, 0.5), make_cells(2000)
    radius[1000] = 30.0
    search(position, radius, (0, 0, 80, 80), cells)
    columns, rows = cells.grid[1][["columns", "rows"]]
    assert columns * rows > 2000
    np.testing.assert_array_equal(np.flatnonzero(cells.level == 0), [1000])


def test_a_level_of_size_that_is_empty_now_has_no_cells_of_an_earlier_search():
    # In the second search the middle level is empty, between one large circle and many small ones.
    position, cells = np.random.default_rng(0).uniform(1, 9, (2000, 2)), make_cells(2000)
    radius = np.full(2000, 0.01)
    radius[:3], radius[3:300] = 1.0, 0.1
    search(position, radius, (0, 0, 10, 10), cells)
    assert set(cells.level) == {0, 1, 2}
    radius[3:300] = 0.01
    found, fresh = (search(position, radius, (0, 0, 10, 10), of) for of in (cells, make_cells(2000)))
    assert set(cells.level) == {0, 2}
    assert pairs_of(found) == pairs_of(fresh)


def test_far_outlier_does_not_cost_a_cell_a_metre():
    state = circles_at([[0.0, 0.0], [1.5, 0.0], [1e9, 1e9]], box=(-10, -10, 2e9, 2e9))
    assert pairs_of(contacts_of(state)) == [(0, 1)]


@pytest.mark.parametrize("stretch", [(1.0, 1.0), (1.0, 0.0), (1.0, 0.2), (1.0, 0.01)])
@pytest.mark.parametrize("n", [1, 2, 10, 100, 3000])
def test_cells_have_room_however_small_and_scattered_the_circles_are(n, stretch):
    # The widest grids: circles much smaller than their distances, whose cells would be countless.
    cells = make_cells(n)
    position = np.random.default_rng(n).uniform(0, 1e3, (n, 2)) * stretch
    position[: min(n, 2)] = np.array([[0.0, 0.0], [1e3, 1e3]])[:n] * stretch
    assert sort_into_cells(position, np.full(n, 1e-6), 0.0, cells) == 1
    columns, rows = cells.grid[0][["columns", "rows"]]
    assert columns * rows + 1 <= cells.start.size
    assert cells.start[columns * rows] == n
    assert sorted(cells.order) == list(range(n))


def test_geometry_of_a_pair():
    coinciding = contacts_of(circles_at([[5.0, 5.0], [5.0, 5.0]]))
    np.testing.assert_array_equal(coinciding.normal, [[1.0, 0.0]])
    contacts = contacts_of(circles_at([[10.0, 10.0], [11.2, 11.6]], radius=[1.0, 1.1]))
    # Centres 2 apart along (0.6, 0.8), radii 1 and 1.1: overlap 0.1, whose middle is 0.95 from the first centre.
    np.testing.assert_allclose(contacts.normal, [[0.6, 0.8]], atol=1e-14)
    np.testing.assert_allclose(contacts.separation, [-0.1], atol=1e-14)
    np.testing.assert_allclose(contacts.position, [[10 + 0.95 * 0.6, 10 + 0.95 * 0.8]], atol=1e-14)


@pytest.mark.parametrize(
    ("centre", "wall", "gap"),
    [((0.0, 7.5), 0, 0.5), ((11.25, 20.0), 1, 0.75), ((3.0, 39.0), 2, 1.0), ((-3.25, 20.0), 3, -0.25)],
)
def test_every_wall_is_felt_at_its_own_side_of_the_box(centre, wall, gap):
    # A box of which no two coordinates are alike.
    contacts = contacts_of(circles_at([centre], box=(-3.0, 7.0, 12.0, 40.0)))
    assert list(contacts.body_b) == [1 + wall]
    np.testing.assert_array_equal(contacts.normal[0], [[0, -1], [1, 0], [0, 1], [-1, 0]][wall])
    np.testing.assert_allclose(contacts.separation, gap - 1.0 - WALL_SKIN, rtol=1e-14)


def test_impulses_are_carried_by_pair():
    def some(pairs):
        contacts = make_contacts(len(pairs))
        contacts.body_a[:], contacts.body_b[:] = np.array(pairs).T
        return contacts

    old, new = some([(0, 1), (0, 7), (2, 3), (4, 5)]), some([(0, 2), (0, 7), (1, 3), (2, 3), (6, 8)])
    old.normal_impulse[:] = [1, 2, 3, 4]
    old.tangent_impulse[:] = [-1, -2, -3, -4]
    carry_impulses(old, new, True)
    np.testing.assert_array_equal(new.normal_start, [0, 2, 0, 3, 0])
    np.testing.assert_array_equal(new.tangent_start, [0, -2, 0, -3, 0])


@pytest.mark.parametrize("drift", [0.0, 0.4])
@pytest.mark.parametrize("smallest", [1.0, 0.4])
@pytest.mark.parametrize("move", [1e-3, 0.02, 0.1, 0.5])
def test_pairs_are_those_of_a_fresh_search_however_circles_move(move, smallest, drift):
    """And what all have moved together makes no list end."""
    rng = np.random.default_rng(5)
    radius = rng.uniform(smallest, 1.0, 120)
    position, cells, made = rng.uniform(0, 22, (120, 2)), make_cells(120), 0
    way = rng.normal(size=position.shape)
    for step in range(60):
        position += move * way / np.linalg.norm(way, axis=1).max() + (drift, -drift)
        if step % 20 == 0:
            way = rng.normal(size=position.shape)
        found, fresh = (search(position, radius, (0, 0, 22, 22), of) for of in (cells, make_cells(120)))
        made += cells.memory["searches"][0] == 0
        for one, other in zip(found[:5], fresh[:5]):
            np.testing.assert_array_equal(one, other)
    assert (made == 60) == (move * 2 > smallest / 3)
    assert move > 0.01 or made <= 4


def test_a_heap_whose_list_does_not_fit_is_searched_without_one_for_a_while():
    rng, cells, waits = np.random.default_rng(2), make_cells(60), []
    position = rng.uniform(0, 1, (60, 2))
    for _ in range(45):
        position += rng.normal(0, 1e-4, position.shape)
        found, fresh = (search(position, np.ones(60), (-5, -5, 5, 5), of) for of in (cells, make_cells(60)))
        assert found.body_a.size > 8 * 60 + 40
        np.testing.assert_array_equal(found.body_b, fresh.body_b)
        waits.append(cells.memory["wait"][0])
    assert waits == [-1, *range(20, -1, -1), *range(20, -1, -1), 20, 19]


def test_what_a_search_by_size_remembers_changes_no_pair():
    state, cells = crowd(300, 3, smallest=0.01), make_cells(300)
    bodies, box, skin = state.bodies, state.world.box, state.scales.wall_skin
    rng, lasted = np.random.default_rng(3), 0
    for step in range(25):
        bodies.position[:] += rng.normal(0, 1e-4 if step % 10 else 1e-2, bodies.position.shape)
        lasted += cells.memory["searches"][0] >= 0
        assert pairs_of(search(bodies.position, bodies.radius, box, cells, skin)) == brute_force_pairs(state)
    assert lasted > 15
