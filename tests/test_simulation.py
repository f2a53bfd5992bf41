"""The interface of the engine: a changed time step, and what callers may hand over."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.simulation import with_time_step


@pytest.fixture(scope="module")
def pile():
    """A pile at rest."""
    return dc.simulate(dc.lattice_in_box(36, seed=1), steps=400, solver=dc.PGS(sweeps=50, tolerance=None)).state


@pytest.mark.parametrize("dt", [0.05, 0.001])
def test_a_change_of_the_time_step_does_not_kick_a_pile_at_rest(pile, dt):
    # Box2D scales carried impulses by dtRatio: m g Δt has another Δt. Unscaled, this pile jumps at 0.09 to 2 m/s.
    solver = dc.PGS(sweeps=10, tolerance=None)
    after = dc.simulate(pile, steps=1, dt=dt, solver=solver).state.bodies
    kicked = dc.simulate(pile.replace(dt=dt), steps=1, solver=solver).state.bodies
    before = np.abs(pile.bodies.velocity).max()
    assert np.abs(after.velocity).max() < before + 0.005
    assert np.abs(kicked.velocity).max() > before + 0.05


def test_a_scaled_start_carries_the_weight_of_the_new_step():
    # λ_n = m g Δt under a resting circle (Eq 2.29), so the start has to be right before any sweep.
    state = dc.simulate(dc.single_body(), steps=20).state
    start = with_time_step(state, 0.03).contacts.normal_start
    np.testing.assert_allclose(start, np.pi * 9.81 * 0.03, rtol=1e-9)


def test_the_same_time_step_changes_no_bit(pile):
    assert with_time_step(pile, pile.dt).contacts is pile.contacts


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dc.simulate("x.xml"), "state: expected a State, of dc.circles_in_box or dc.read_state"),
        (lambda: dc.World(gravity=-9.81), r"gravity: expected two finite numbers, such as \(0, -9.81\), got -9.81"),
        (lambda: dc.circles_in_box(5, radius=1.0), r"radius: expected finite 0 < smallest <= largest, .* got 1.0"),
        (lambda: dc.circles_in_box(5, radius=(1, 1, 2)), r"radius: .* got \(1, 1, 2\)"),
        (lambda: dc.circles_in_box(400), r"n_bodies: .* size=71 has room for all, and dc.lattice_in_box"),
        (lambda: dc.simulate(dc.column(2), dt=-1.0), "dt: expected a finite number > 0, got -1.0"),
    ],
)
def test_what_does_not_fit_gets_a_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_the_suggested_size_has_room():
    assert dc.circles_in_box(400, size=71).bodies.count == 400
