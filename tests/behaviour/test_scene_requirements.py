"""Only what a scene requires: without friction the rows have no tangents, and the result is that of μ = 0."""

import numpy as np
import pytest
from conftest import assert_same_bits

import deep_contact as dc
from deep_contact.run import simulator
from deep_contact.stepping import inputs
from deep_contact.stepping.context import with_optional


def spinning_scene(**options):
    """A frictionless scene whose circles differ, bounce and spin."""
    scene = dc.circles_in_box(40, friction=0.0, restitution=0.3, radius=(0.7, 1.3), seed=3, **options)
    return scene.replace(bodies=scene.bodies._replace(spin=np.linspace(-3.0, 3.0, 40)))


@pytest.fixture
def general(monkeypatch):
    """A run with tangent rows, whatever the friction."""

    def run(scene, **options):
        with monkeypatch.context() as patch:
            patch.setattr(inputs, "leaves_tangents_out", lambda state, settings: False)
            return dc.simulate(scene, **options)

    return run


@pytest.mark.parametrize("solver", [dc.PGS(), pytest.param(dc.PSOR(), marks=pytest.mark.slow)])
def test_frictionless_runs_are_those_of_the_general_rows_bit_for_bit(solver, general):
    one, other = (run(spinning_scene(), steps=200, solver=solver) for run in (dc.simulate, general))
    assert one.contacts.max() > 25
    assert_same_bits(one.state, other.state)
    np.testing.assert_array_equal(one.theta, other.theta)


def test_a_start_with_tangents_is_worked_off_without_friction(frictionless_states):
    state = frictionless_states[-1]
    m = state.contacts.count
    found = dc.solve_contacts(state, solver=dc.PGS(sweeps=5), start=(np.zeros(m), np.ones(m)))
    np.testing.assert_array_equal(found.tangent_impulses, 0.0)
    assert found.record.theta[0] >= 1.0


def test_the_first_fast_circle_of_a_run_stops_as_if_it_had_been_waited_for(monkeypatch):
    # What stops fast circles is compiled when one comes: the call ends before its step, and the next one knows how.
    scene = dc.circles_in_box(20, size=12.0, radius=(0.1, 0.2), gravity=(0.0, -30.0), seed=2)
    found = dc.simulate(scene, steps=120, solver=dc.PGS(), record=1)
    x = np.array([state.bodies.position for state in found.trajectory])
    fast = (np.linalg.norm(np.diff(x, axis=0), axis=2) > 0.5 * scene.bodies.radius).any(axis=1)
    assert 5 < np.argmax(fast) < 60
    plain = simulator.step_input
    monkeypatch.setattr(simulator, "step_input", lambda *arguments: with_optional(plain(*arguments)))
    expected = dc.simulate(scene, steps=120, solver=dc.PGS())
    assert_same_bits(found.state, expected.state)
    for one, other in zip(found[1:6], expected[1:6]):
        np.testing.assert_array_equal(one, other)
