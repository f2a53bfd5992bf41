"""Batches of contacts against brute force, and against the sequential sweep."""

import numpy as np
import pytest
from conftest import assert_same_bits, circles_at

import deep_contact as dc
from deep_contact.solvers import batched, batches
from deep_contact.state.arrays import no_contacts
from deep_contact.stepping import inputs, interface, memory, position_correction, problem
from deep_contact.stepping.log import make_log
from deep_contact.stepping.rows import Rows
from deep_contact.stepping.segment_grid import NO_SEGMENTS, segment_gap
from deep_contact.studies.piles import packed_pile


@pytest.fixture(scope="module")
def pile():
    """A pile of unlike circles that still moves, large enough for several blocks; with its contacts."""
    return packed_pile(2500, seed=3, steps=10)


def plan_of(state):
    """The plan of a state's contacts."""
    n, m = state.bodies.count, state.contacts.count
    return batches.plan_batches(*state.contacts[:2], n, batches.make_plan(n, m))


def circles_of(state, contacts):
    """The circles, without the walls, of some contacts, one entry for each contact that has it."""
    pair = np.concatenate([state.contacts.body_a[contacts], state.contacts.body_b[contacts]])
    return pair[pair < state.bodies.count]


def test_every_contact_has_one_place_of_its_own(pile):
    plan, m = plan_of(pile), pile.contacts.count
    assert m > 2 * batches.BLOCK
    assert np.unique(plan.place[:m]).size == m
    tiles = plan.count[batches.TILES]
    assert plan.place[:m].min() >= 0
    np.testing.assert_array_equal(np.bincount(plan.place[:m] // 8, minlength=tiles), plan.used[:tiles])
    of_two = (body[: 2 * batches.BLOCK] for body in pile.contacts[:2])
    two = batches.plan_batches(*of_two, pile.bodies.count, batches.make_plan(pile.bodies.count, m))
    assert two.count[batches.BLOCKS] == 2  # full ones: no empty block after them


def test_a_plan_holds_as_long_as_the_pairs_are_the_same(pile):
    n, contacts = pile.bodies.count, pile.contacts
    fresh = batches.make_plan(n, contacts.count)
    assert not batches.is_plan_of(fresh, n, contacts, contacts)
    plan = batches.plan_batches(contacts.body_a, contacts.body_b, n, fresh)
    others = contacts._replace(body_a=contacts.body_a.copy(), body_b=contacts.body_b.copy())
    assert batches.is_plan_of(plan, n, others, contacts)
    others.body_b[-1] += 1
    assert not batches.is_plan_of(plan, n, others, contacts)
    fewer = contacts._replace(**{name: field[:-1] for name, field in contacts._asdict().items()})
    assert not batches.is_plan_of(plan, n, fewer, contacts)


def test_a_plan_that_is_kept_changes_no_bit():
    # A pile of a hundred at rest, whose pairs are mostly those of the step before.
    solver = dc.BatchedPGS(sweeps=10)
    rest = dc.simulate(dc.circles_in_box(100, seed=3), steps=400, solver=solver).state
    once, pairs, state = dc.simulate(rest, steps=40, solver=solver).state, [], rest
    for _ in range(40):  # each with a plan of its own
        pairs.append((*state.contacts.body_a, *state.contacts.body_b))
        state = dc.simulate(state, steps=1, solver=solver).state
    assert 0 < sum(a == b for a, b in zip(pairs, pairs[1:])) < 39
    assert_same_bits(once, state)


def test_no_circle_occurs_twice_in_a_batch(pile):
    # By brute force, batch by batch, not only tile by tile: within a batch no tile may wait for another.
    plan, m = plan_of(pile), pile.contacts.count
    block = np.searchsorted(plan.first[1 : plan.count[batches.BLOCKS] + 1], plan.place[:m] // 8, side="right")
    for key in np.unique(block * m + plan.batch[:m]):
        circles = circles_of(pile, np.flatnonzero(block * m + plan.batch[:m] == key))
        assert np.unique(circles).size == circles.size


def test_blocks_of_a_phase_share_no_circle(pile):
    plan = plan_of(pile)
    blocks, order = np.arange(pile.contacts.count) // batches.BLOCK, plan.order[: plan.count[batches.BLOCKS]]
    for phase in np.unique(plan.phase[order]):
        mine = order[plan.phase[order] == phase]
        found = np.concatenate([np.unique(circles_of(pile, np.flatnonzero(blocks == k))) for k in mine])
        assert np.unique(found).size == found.size
    assert sorted(order) == list(range(plan.count[batches.BLOCKS]))
    assert (np.diff(plan.phase[order]) >= 0).all()


@pytest.mark.filterwarnings("ignore:.*solved to a tolerance")
def test_more_contacts_than_a_mask_has_colours():
    # A circle of 10 m with 90 small ones on it: 90 batches at the least, each with one of its contacts.
    angle = 2 * np.pi * np.arange(90) / 90
    position = np.vstack([[[15.0, 15.0]], 15 + 10.3 * np.column_stack([np.cos(angle), np.sin(angle)])])
    radius, velocity = np.r_[10.0, np.full(90, 0.32)], np.r_[[[0, 0]], 15 - position[1:]]
    state = dc.find_contacts(circles_at(position, radius=radius, velocity=velocity, gravity=(0, 0)))
    plan = plan_of(state)
    of_the_large = np.flatnonzero(state.contacts.body_a == 0)
    assert of_the_large.size == 90
    assert np.unique(plan.place[of_the_large] // 8).size == 90
    exact = {"sweeps": 20_000, "tolerance": 1e-12}
    expected, found = (dc.solve_contacts(state, solver=s(**exact), start=None) for s in (dc.PGS, dc.BatchedPGS))
    np.testing.assert_allclose(found.velocities, expected.velocities, atol=1e-9)


def in_the_order_of_batches(plan):
    """The contacts of a plan in the order in which its sweeps relax them."""
    m = plan.count[batches.CONTACTS]
    turn = np.argsort(plan.order[: plan.count[batches.BLOCKS]])
    return np.lexsort((plan.place[:m], turn[np.arange(m) // batches.BLOCK]))


def test_a_sweep_is_the_sequential_one_in_the_order_of_the_batches(pile):
    # The same numbers up to rounding, θ and all.
    (rows, solver_bodies, friction, _), found = problem.step_problem(pile), []
    for solver, order in ((dc.PGS, in_the_order_of_batches(plan_of(pile))), (dc.BatchedPGS, slice(None))):
        copies, v, theta = Rows(*(f[order].copy() for f in rows)), solver_bodies.copy(), np.empty(30)
        options = solver(tolerance=None)
        problem.solve_velocities(copies, friction, interface.entry_of(options).settings(options), v, theta)
        found.append((v, theta))
    tolerance = 1e4 * np.finfo(float).eps * np.abs(solver_bodies[:, :3]).max()
    for one, other in zip(*found):
        np.testing.assert_allclose(one, other, atol=tolerance)


def test_positions_are_corrected_in_the_order_of_the_batches(pile):
    rng = np.random.default_rng(0)
    deep = pile.bodies._replace(position=pile.bodies.position + rng.uniform(-0.15, 0.15, pile.bodies.position.shape))
    state = dc.simulate(pile.replace(bodies=deep, contacts=None), steps=0).state
    expected, found = (deep._replace(position=deep.position.copy()) for _ in range(2))
    plan, n = plan_of(state), state.bodies.count
    sorted_contacts = type(state.contacts)(*(field[in_the_order_of_batches(plan)] for field in state.contacts))
    for _ in range(3):
        position_correction.correct_in_turn(expected, sorted_contacts, state.world.box, NO_SEGMENTS, state.scales)
    rows, solver_bodies, *_ = problem.step_problem(state)
    tiles = batches.fill_tiles(rows, solver_bodies, plan, batches.make_tiles(n + 5, 1, 0.5), 0.5)
    for ground in range(n, plan.count[batches.ROWS], 5):
        position_correction.fill_ground(state.world.box, state.scales, tiles.centre[ground : ground + 5])
    batched.correct_positions_in_batches(plan, tiles, found, state.scales, 3)
    assert np.abs(expected.position - deep.position).max() > 0.05
    np.testing.assert_array_equal(found.position, expected.position)


@pytest.mark.parametrize(("sweeps", "tolerance"), [(1, 1e-13), (30, 2e-4)])
def test_overlaps_with_segments_are_corrected_as_contact_by_contact(sweeps, tolerance):
    """The same push at first; then PGS turns the normal of an end, by a share of the depth squared."""
    x = np.arange(2.0, 60.0, 3.0)
    line = [(4.0 * k, 5.0 + k % 3, 4.0 * k + 4.0, 5.0 + (k + 1) % 3) for k in range(15)]
    gap = [min(segment_gap(np.array([*one, 0.0]), at, 6.9)[0] for one in line[::2]) for at in x]
    world = {"box": (0.0, 0.0, 62.0, 20.0), "gravity": (0.0, 0.0), "segments": line[::2]}
    scene = circles_at(np.column_stack([x, np.full(len(x), 6.9)]), **world)
    assert np.sum(np.array(gap) < 0.95) > 3
    options = {"sweeps": 1, "tolerance": None, "position_sweeps": sweeps}
    states = [dc.simulate(scene, steps=1, solver=one(**options)).state for one in (dc.PGS, dc.BatchedPGS)]
    np.testing.assert_allclose(*(state.bodies.position for state in states), atol=tolerance)
    assert np.abs(states[0].bodies.position - scene.bodies.position).max() > 0.01


def gas():
    """Fast circles that bounce about: no list of near pairs lasts."""
    scene = dc.lattice_in_box(1200, gap=0.5, seed=5, restitution=1.0)
    velocity = np.random.default_rng(5).normal(0.0, 30.0, (1200, 2))
    return dc.simulate(scene.replace(bodies=scene.bodies._replace(velocity=velocity)), steps=2).state


def test_batches_search_for_contacts_as_often_as_pgs():
    # What is asked twice in a step seems not to have moved in between, and a list is made that does not last.
    state, cells = gas(), []
    for solver in (dc.PGS(sweeps=3, tolerance=None), dc.BatchedPGS(sweeps=3, tolerance=None)):
        bodies, contacts = (type(part)(*(field.copy() for field in part)) for part in (state.bodies, state.contacts))
        given = inputs.step_input(state.replace(bodies=bodies, contacts=contacts), solver)
        steps = memory.Steps(solver, state.bodies.count)
        steps(given, contacts, make_log(6))
        cells.append(steps.memory(given).cells.memory)
    np.testing.assert_array_equal(*cells)
    assert cells[0]["pairs"] == -1


def test_a_new_plan_is_none_even_of_no_circles():
    """Else its places, which nobody has written, would be those of points that move."""
    nothing = no_contacts()
    assert not batches.is_plan_of(batches.make_plan(0, 0), 0, nothing, nothing)
    assert batches.is_plan_of(batches.plan_batches(*nothing[:2], 0, batches.make_plan(0, 0)), 0, nothing, nothing)


@pytest.mark.parametrize("fixed", [[False, True], [True, False], [False, False]])
def test_circles_with_one_centre_part_as_with_pgs_also_from_a_fixed_one(fixed):
    world = dc.World(box=(0.0, 0.0, 20.0, 20.0), gravity=(0.0, 0.0))
    state = dc.State(name="one centre", world=world, bodies=dc.make_bodies([[5.0, 5.0]] * 2, radius=1.0, fixed=fixed))
    with pytest.warns(UserWarning, match="nearly coincide"):
        parted, known = (dc.simulate(state, steps=5, solver=one).state for one in (dc.BatchedPGS(), dc.PGS()))
    assert abs(known.bodies.position[1, 0] - known.bodies.position[0, 0]) > 1.9
    np.testing.assert_allclose(parted.bodies.position, known.bodies.position, atol=1e-9)
