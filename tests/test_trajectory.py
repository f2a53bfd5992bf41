"""`deep_contact.trajectory`: a run as arrays, as a file, as a table and as an animation."""

import numpy as np
import pytest
from conftest import solved_states

import deep_contact as dc
from deep_contact.physics.metrics import kinetic_energy
from deep_contact.trajectory import Trajectory, load_trajectory


@pytest.fixture(scope="module")
def states():
    """Circles that fall, touch and turn."""
    return solved_states(dc.circles_in_box(12, size=10, radius=(0.5, 0.9), seed=0), steps=120, every=10)


@pytest.fixture(scope="module")
def run(states):
    return Trajectory.from_states(states)


def test_arrays_are_those_of_the_states(run, states):
    assert len(run) == len(states) > 5
    for i, state in enumerate(states):
        assert run.times[i] == state.time
        assert run.positions[i].tobytes() == state.bodies.position.tobytes()
        assert run.velocities[i].tobytes() == state.bodies.velocity.tobytes()
        assert run.angles[i].tobytes() == state.bodies.angle.tobytes()
        assert run.spins[i].tobytes() == state.bodies.spin.tobytes()
        mine = slice(*run.offsets[i : i + 2])
        c = state.contacts
        np.testing.assert_array_equal(run.pairs[mine], np.column_stack([c.body_a, c.body_b]))
        np.testing.assert_array_equal(run.impulses[mine], np.column_stack([c.normal_impulse, c.tangent_impulse]))


def test_its_states_are_those_it_was_made_of(run, states):
    assert [state.step for state in run] == [state.step for state in states]
    assert run[-1].step == states[-1].step
    assert run[2].contacts.normal_impulse.tobytes() == states[2].contacts.normal_impulse.tobytes()
    with pytest.raises(IndexError):
        run[len(states)]


def test_energies_are_those_of_mechanics(run, states):
    """m v²/2 + I ω²/2, and m g y."""
    kinetic = [kinetic_energy(state.bodies) for state in states]
    potential = [9.81 * state.bodies.mass @ state.bodies.position[:, 1] for state in states]
    np.testing.assert_allclose(run.energies, np.column_stack([kinetic, potential]), rtol=1e-12)


def test_a_file_gives_the_same_run(run, tmp_path):
    run.save(tmp_path / "runs" / "fall.h5")
    again = load_trajectory(tmp_path / "runs" / "fall.h5")
    assert again.stored.digest == run.stored.digest
    assert repr(again) == repr(run)


def test_an_animation_has_a_frame_for_each_state(run):
    from matplotlib import pyplot

    animation = run.animate(fps=10, height=2)
    assert animation.to_jshtml(default_mode="once").count("data:image/png") == len(run)
    pyplot.close("all")
    with pytest.raises(ValueError, match="fps: expected a finite number > 0, got 0"):
        run.animate(fps=0)


def test_states_that_are_no_run_are_refused(states):
    with pytest.raises(ValueError, match="at least one state"):
        Trajectory.from_states([])
    with pytest.raises(ValueError, match=r"states\[1\]\.name"):
        Trajectory.from_states([states[0], states[1].replace(name="other")])
