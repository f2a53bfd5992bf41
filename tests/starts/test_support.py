"""Impulses of a pile from its positions: which circle lies on which, and how a run without a past begins."""

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.starts.classical import Support
from deep_contact.stepping import metrics
from deep_contact.stepping.problem import contacts_of

WEIGHT = np.pi * 9.81 * 0.01  # of a step, N·s


def without_past(state):
    """The state with contacts that carry nothing."""
    return state.replace(contacts=contacts_of(state), solved=False)


def supported(scene):
    """(State with contacts, λ_n, λ_t) of the support."""
    state = dc.simulate(scene, steps=0).state
    return state, *Support()(state, dc.PGS())


def test_a_column_carries_what_lies_above():
    state, normal, tangent = supported(dc.column(4))
    above = 4 - state.contacts.body_a - (state.contacts.body_b < 4)
    np.testing.assert_allclose(normal, above * WEIGHT, rtol=1e-6)
    np.testing.assert_allclose(tangent, 0.0, atol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 0.5 * np.pi, np.pi, 1.0])
def test_a_circle_on_two_presses_on_each_by_half_its_weight_over_cos_30_degrees(turn):
    # In any direction of gravity, on a segment far from the walls. The local sweeps leave a quarter of the error each.
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    place = np.array([[-1.0, 1.0], [1.0, 1.0], [0.0, 1.0 + np.sqrt(3.0)]]) @ turned.T + 10.0
    floor = tuple(map(tuple, np.array([[-5.0, 0.0], [5.0, 0.0]]) @ turned.T + 10.0))
    world = {"box": (0.0, 0.0, 20.0, 20.0), "gravity": turned @ (0.0, -9.81), "segments": (sum(floor, ()),)}
    state, normal, _ = supported(circles_at(place, friction=0.0, **world))
    on_floor = state.contacts.body_b >= 3
    upper = (state.contacts.body_a == 2) | (state.contacts.body_b == 2)
    np.testing.assert_allclose(normal[upper], 0.5 * WEIGHT / np.cos(np.pi / 6), rtol=0.05)
    np.testing.assert_allclose(normal[on_floor], 1.5 * WEIGHT, rtol=0.05)


def test_without_gravity_nothing_is_carried():
    state = dc.simulate(dc.column(3, friction=0.3), steps=0).state
    state = state.replace(world=dc.World(gravity=(0.0, 0.0), box=state.world.box))
    assert not np.any(Support()(state, dc.PGS()))


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_the_impulses_of_a_pile_are_admissible_and_a_better_start_than_none(friction):
    shares, solver = [], dc.NesterovPGS(sweeps=20, tolerance=None)
    for seed in range(5):
        scene = dc.lattice_in_box(80, friction=friction, radius=(0.6, 1.4), seed=seed)
        state = dc.simulate(scene, steps=900, solver=dc.PGS(sweeps=30, tolerance=None)).state
        exact = dc.solve_contacts(state, solver=dc.NNCG(sweeps=4000, tolerance=1e-9))
        state = without_past(state)
        normal, tangent = Support()(state, dc.PGS())
        assert (normal >= 0).all()
        assert (np.abs(tangent) <= friction * normal + 1e-12).all()
        none, ours = (dc.solve_contacts(state, solver=solver, start=start) for start in (None, (normal, tangent)))
        none, ours = (metrics.velocity_error(state, solution, exact) for solution in (none, ours))
        shares.append(ours / none)
    assert np.median(shares) < 0.7


def test_a_pile_without_a_past_does_not_fall_into_itself():
    scene = dc.simulate(dc.lattice_in_box(150, seed=3), steps=900, solver=dc.PGS(sweeps=50, tolerance=None)).state
    speeds = {}
    for name, options in {"preset": {}, "none": {"solver": dc.PGS(sweeps=6, tolerance=None)}}.items():
        bare = scene.replace(solver=None, contacts=None)  # of any step: without contacts no run goes on
        run = dc.simulate(bare, steps=50, record=1, **options)
        speeds[name] = max(np.sqrt((s.bodies.velocity**2).sum(axis=1).mean()) for s in run.trajectory)
    assert speeds["preset"] < 0.06 < speeds["none"]
