"""`deep_contact.trajectory`: a run as arrays, as a file, as a table and as an animation."""

import numpy as np
import pytest
from conftest import solved_states

import deep_contact as dc
from deep_contact.io import simulation_h5
from deep_contact.physics.metrics import kinetic_energy
from deep_contact.trajectory import Trajectory, load_trajectory


@pytest.fixture(scope="module")
def states():
    """Circles that fall, touch and turn."""
    return solved_states(dc.circles_in_box(12, size=10, radius=(0.5, 0.9), seed=0), steps=120, every=10)


@pytest.fixture(scope="module")
def run(states):
    return Trajectory.from_states(states)


def test_arrays_and_states_are_those_it_was_made_of(run, states):
    assert len(run) == len(states) > 5
    assert list(run) == states
    assert run[-1] == states[-1]
    with pytest.raises(IndexError):
        run[len(states)]
    columns = zip(run.times, run.positions, run.velocities, run.angles, run.spins, strict=True)
    for i, (state, (time, *motion)) in enumerate(zip(states, columns, strict=True)):
        assert time == state.time
        assert all(map(np.array_equal, motion, state.bodies))
        mine, c = slice(*run.offsets[i : i + 2]), state.contacts
        np.testing.assert_array_equal(run.pairs[mine], np.column_stack([c.body_a, c.body_b]))
        np.testing.assert_array_equal(run.impulses[mine], np.column_stack([c.normal_impulse, c.tangent_impulse]))


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


def test_a_recorded_run_has_no_digest_before_somebody_asks_for_it(monkeypatch):
    monkeypatch.setattr(simulation_h5, "_digest", lambda attributes, arrays: 1 / 0)
    recorded = dc.simulate(dc.column(2), steps=4, record=1).trajectory
    assert len(recorded) == 5
    with pytest.raises(ZeroDivisionError):
        _ = recorded.stored.digest


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
