"""Piles without a past: their starts, their study, and the data that the network learned from."""

import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact.cnn.model_file import ModelFileError
from deep_contact.physics import metrics
from deep_contact.physics.engine import step_problem
from deep_contact.studies import piles
from deep_contact.warm_start import LearnedSupport

no_past = load_script("figure_6_14")


@pytest.fixture(scope="module")
def pile():
    return no_past.case(300, "resting", 0.8, 11)


def test_the_network_corrects_the_support_within_the_cone(pile):
    state, references, _ = pile
    starts = [dc.warm_start.Support()(state, None), LearnedSupport()(state, None)]
    normal, tangent = starts[1]
    assert (normal >= 0).all()
    assert (np.abs(tangent) <= state.world.friction * normal + 1e-12).all()
    solver = dc.NesterovPGS(sweeps=20, tolerance=None)
    ends = (dc.solve_contacts(state, solver=solver, start=start) for start in starts)
    support, learned = (metrics.nearest_velocity_error(state, end, references) for end in ends)
    assert learned < 0.9 * support


def test_the_network_sees_the_supports_impulses_as_those_to_correct(pile):
    state, *_ = pile
    normal, tangent = dc.warm_start.Support()(state, None)
    contacts = state.contacts._replace(normal_start=normal, tangent_start=tangent)
    expected = dc.load_model("no_past").predict(state.replace(contacts=contacts))
    np.testing.assert_array_equal(LearnedSupport().from_problem(state, None, step_problem(state)), expected)


def test_without_gravity_or_contacts_it_is_zero(pile):
    state, *_ = pile
    weightless = state.replace(world=dc.World(box=state.world.box, gravity=(0.0, 0.0)))
    assert not np.any(LearnedSupport()(weightless, None))
    alone = dc.simulate(dc.circles_in_box(3, seed=1), steps=0).state
    assert dc.warm_start.starting_impulses("learned support", alone, dc.PGS())[0].size == 0


def test_a_network_on_images_is_refused():
    with pytest.raises(ModelFileError, match="expected a far-field network"):
        LearnedSupport("thesis_factored")


def test_the_state_that_is_judged_carries_nothing_and_its_references_solve_it(pile):
    state, references, past = pile
    assert not state.solved
    assert not any(np.any(values) for values in state.contacts[5:])
    assert past.contacts.normal_start.any()
    assert all(metrics.residual(state, one) < piles.ENOUGH for one in references)


def test_time_to_an_error_is_interpolated_between_sweeps_and_counts_the_start():
    of_pile = {"contacts": 20, "after": [10, 20], "errors": {"a": {"s": [0.4, 0.1]}, "b": {"s": [0.9, 0.3]}}}
    timed = {"contacts": 10, "price": {"s": 5.0}, "sweeps": {"a": [1.0, 1.0], "b": [0.0, 0.1]}}
    one, other = no_past.curves_of(of_pile, timed, "s")
    assert no_past.time_to(one, 0.1) == pytest.approx(2 * (5 + 1 + 20))
    assert no_past.time_to(other, 0.3) == pytest.approx(2 * (5 + 2))
    half = no_past.time_to(one, 0.2)  # halfway in the logarithm
    assert half == pytest.approx(2 * np.sqrt((5 + 1 + 10) * (5 + 1 + 20)))
    assert no_past.time_to(one, 0.01) == np.inf


def test_the_data_are_solved_states_that_start_from_the_support(tmp_path):
    generate = load_script("generate_data")
    command = ["--packings", "--simulations", "1", "--jobs", "1", "--out", str(tmp_path)]
    assert generate.main(command) == 0
    (path,) = tmp_path.iterdir()
    stored = dc.cnn.read_simulation(path)
    state = stored.state(stored.count - 1)
    normal, tangent = dc.warm_start.Support()(piles.without_past(state), None)
    np.testing.assert_array_equal(state.contacts.normal_start, normal)
    np.testing.assert_array_equal(state.contacts.tangent_start, tangent)
    written = path.stat().st_mtime_ns
    assert generate.main(command) == 0  # what is there stays
    assert state.solved
    assert path.stat().st_mtime_ns == written
