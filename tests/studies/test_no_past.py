"""Piles without a past: their starts, and the data that the network learned from."""

from functools import partial

import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact.cnn.model_file import ModelFileError
from deep_contact.cnn.start import FarFieldNoPast
from deep_contact.stepping import metrics
from deep_contact.stepping.problem import step_problem
from deep_contact.studies import piles


@pytest.fixture(scope="module")
def pile():
    """A resting pile whose contacts carry nothing, and the solution of its step."""
    past = piles.pile("resting", 300, 11, solver=piles.SETTLE, make=partial(piles.packed_pile, steps=50))
    assert past.contacts.normal_start.any()
    solver = dc.NNCG(sweeps=20_000, tolerance=1e-9 * float(past.bodies.mass.mean()))
    return piles.without_past(past), dc.solve_contacts(past, solver=solver)


def test_the_network_corrects_the_support_within_the_cone(pile):
    state, solution = pile
    starts = [dc.warm_start.Support()(state, None), FarFieldNoPast()(state, None)]
    normal, tangent = starts[1]
    assert (normal >= 0).all()
    assert (np.abs(tangent) <= state.world.friction * normal + 1e-12).all()
    solver = dc.NesterovPGS(sweeps=20, tolerance=None)
    ends = (dc.solve_contacts(state, solver=solver, start=start) for start in starts)
    support, learned = (metrics.velocity_error(state, end, solution) for end in ends)
    assert learned < 0.9 * support


def test_the_network_sees_the_supports_impulses_as_those_to_correct(pile):
    state, _ = pile
    normal, tangent = dc.warm_start.Support()(state, None)
    contacts = state.contacts._replace(normal_start=normal, tangent_start=tangent)
    expected = dc.load_model("far field, no past").predict(state.replace(contacts=contacts))
    np.testing.assert_array_equal(FarFieldNoPast().from_problem(state, None, step_problem(state)), expected)


def test_without_gravity_or_contacts_it_is_zero(pile):
    state, _ = pile
    weightless = state.replace(world=dc.World(box=state.world.box, gravity=(0.0, 0.0)))
    assert not np.any(FarFieldNoPast()(weightless, None))
    alone = dc.simulate(dc.circles_in_box(3, seed=1), steps=0).state
    assert dc.warm_start.starting_impulses("far field, no past", alone, dc.PGS())[0].size == 0


def test_a_network_on_images_is_refused():
    with pytest.raises(ModelFileError, match="expected a far-field network"):
        FarFieldNoPast("model")


def test_without_a_past_contacts_carry_no_impulses(pile):
    state, _ = pile
    assert not state.solved
    assert not any(np.any(values) for values in state.contacts[5:])


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
