"""Islands: found as components of the contact graph, solved and stopped each on its own."""

import numpy as np
import pytest
from conftest import circles_at, solved_states
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import deep_contact as dc
from deep_contact.stepping.islands import islands_of

WIDE = {"size": (300.0, 30.0), "sigma_coef": 5.0}
"""A box in which circles fall into many heaps."""


@pytest.mark.filterwarnings("ignore:bodies.position")  # that some nearly coincide
@pytest.mark.parametrize("seed", range(8))
def test_islands_are_the_components_of_the_contact_graph(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 200))
    side = rng.choice([10.0, 30.0, 100.0])
    state = dc.find_contacts(circles_at(rng.uniform(0, side, (n, 2)), radius=rng.uniform(0.2, 1.5, n)))
    pairs = np.column_stack(state.contacts[:2])
    pairs = pairs[pairs[:, 1] < n]
    count, label = connected_components(coo_array((np.ones(len(pairs)), pairs.T), (n, n)), directed=False)
    island = islands_of(state)
    assert len(set(island)) == count == len(set(zip(island, label)))
    for number in set(island):
        assert number == np.flatnonzero(island == number)[0]


@pytest.fixture(scope="module")
def fall():
    return solved_states(dc.circles_in_box(60, seed=3, **WIDE), steps=400, every=10)


def alone(state, island, number):
    """The state with one island of it alone."""
    keep = np.flatnonzero(island == number)
    bodies = state.bodies._make(field[keep] for field in state.bodies)
    contacts = state.contacts
    mine = np.isin(contacts.body_a, keep)
    a, b = contacts.body_a[mine], contacts.body_b[mine]
    moved = np.where(b < state.bodies.count, np.searchsorted(keep, b), b - state.bodies.count + keep.size)
    contacts = contacts._make(field[mine] for field in contacts)
    return state.replace(bodies=bodies, contacts=contacts._replace(body_a=np.searchsorted(keep, a), body_b=moved)), mine


def test_an_island_is_solved_as_if_it_were_alone(fall):
    for state in fall[::4]:
        found = dc.solve_contacts(state, solver=dc.PGS(islands=True))
        island = islands_of(state)
        longest = 0
        for number in set(island[state.contacts.body_a]):
            part, mine = alone(state, island, number)
            by_itself = dc.solve_contacts(part, solver=dc.PGS())
            np.testing.assert_array_equal(found.normal_impulses[mine], by_itself.normal_impulses)
            np.testing.assert_array_equal(found.velocities[island == number], by_itself.velocities)
            longest = max(longest, by_itself.record.sweeps)
        assert found.record.sweeps == longest


def test_islands_reach_the_tolerance_with_less_work(fall):
    # 6e-5 N·s is the change that a sweep may still make; what is left after it, slower, is no more than ten of those.
    less = 0
    for state in fall:
        one, other = (dc.simulate(state, steps=1, solver=dc.PGS(islands=islands)) for islands in (False, True))
        assert other.theta[0] <= 6e-5 or other.sweeps[0] == 3000
        assert other.relaxations[0] <= one.relaxations[0]
        less += other.relaxations[0] < one.relaxations[0]
        np.testing.assert_allclose(other.state.bodies.velocity, one.state.bodies.velocity, atol=10 * 6e-5)
    assert less > 5


@pytest.mark.filterwarnings("ignore:.*nearly coincide")
def test_islands_of_more_contacts_than_the_room_are_solved():
    # Forty circles in one place: 780 pairs, where there is room for 224.
    state = circles_at(np.full((40, 2), 15.0) + 1e-3 * np.arange(80).reshape(40, 2))
    solvers = (dc.PGS(sweeps=5, tolerance=None, islands=islands) for islands in (False, True))
    one, other = (dc.simulate(state, steps=2, solver=solver) for solver in solvers)
    assert one.contacts[0] == 780
    np.testing.assert_array_equal(one.state.bodies.position, other.state.bodies.position)


def test_a_scene_without_contacts_has_no_islands_to_solve():
    run = dc.simulate(dc.single_body(height=10.0), steps=3, solver=dc.PGS(islands=True))
    assert (run.relaxations.sum(), run.status[0]) == (0, "no_contacts")
