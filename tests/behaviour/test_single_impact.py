"""A single impact against its closed form: Newton's restitution and Coulomb's friction of a disc, in every setting.

A contact whose surfaces part at (v_n, v_t) gets p_n = −(1 + e) k_n v_n and p_t = −k_t v_t, cut to ±μ p_n, with
k_n = 1 / (1 / m_a + 1 / m_b) and k_t = k_n / 3: a disc turns by r p_t / (m r² / 2), which adds 2 / m to its 1 / m.
"""

import warnings
from itertools import product

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.accuracy.presets import PRESETS, PresetWarning

SETTINGS = {"PGS": {"solver": dc.PGS()}} | {name: {"accuracy": name} for name in PRESETS}
SPEED = 6.0
"""Of the approach, m/s."""


def expected(velocity, spin, mass, normal, e, mu):
    """Velocities, (2, 2), and spins, (2,), of two discs of radius 1 after their impact; a wall has an infinite mass."""
    tangent, w = np.array([normal[1], -normal[0]]), 1.0 / np.asarray(mass)
    relative = velocity[1] - velocity[0] + spin.sum() * tangent  # both surfaces move along t where their discs turn
    p_n = -(1.0 + e) * (relative @ normal) / w.sum()
    p_t = np.clip(-(relative @ tangent) / (3.0 * w.sum()), -mu * p_n, mu * p_n)
    p = p_n * normal + p_t * tangent
    return velocity + np.outer([-w[0], w[1]], p), spin + 2.0 * w * p_t


def impacts(partner):
    """(velocity, spin, mass, normal) of oblique impacts of a disc with a wall, or with another at rest."""
    for slope, spin in product((0.2, -1.5), (0.0, 9.0)):
        for ratio in (1.0, 50.0) if partner == "disc" else (np.inf,):
            normal = np.array([0.6, 0.8]) if partner == "disc" else np.array([1.0, 0.0])
            tangent = np.array([normal[1], -normal[0]])
            velocity = np.array([SPEED * (normal + slope * tangent), [0.0, 0.0]])
            yield velocity, np.array([spin, 0.0]), np.array([2.0, 2.0 * ratio]), normal


def simulated(velocity, spin, mass, normal, options, bystanders=0, **world):
    """Velocities and spins after the step of the impact. The first disc touches the second, or a wall on the right."""
    count = 2 if np.isfinite(mass[1]) else 1
    first = np.array([20.0, 20.0]) if count == 2 else np.array([40.0 - 1.01 + 1e-9, 20.0])
    position = np.array([first, first + (2.0 - 1e-9) * normal])[:count]
    far = 3.0 * np.stack(np.meshgrid(np.arange(11), np.arange(9)), -1).reshape(-1, 2)[:bystanders] + [3.0, 60.0]
    bodies = {
        "velocity": np.concatenate([velocity[:count], np.zeros((bystanders, 2))]),
        "spin": np.concatenate([spin[:count], np.zeros(bystanders)]),
        "mass": np.concatenate([mass[:count], np.full(bystanders, mass[0])]),
    }
    state = circles_at(np.concatenate([position, far]), box=(0.0, 0.0, 40.0, 100.0), **bodies, **world)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PresetWarning)
        after = dc.simulate(state, steps=1, **options).state.bodies
    return after.velocity[:count], after.spin[:count]


@pytest.mark.parametrize("gravity", [0.0, 9.81])
@pytest.mark.parametrize("partner", ["wall", "disc"])
# "preview" takes PSOR, whose step without friction is a kind of its own.
@pytest.mark.parametrize(
    "setting", [pytest.param(name, marks=[pytest.mark.slow] * (name == "preview")) for name in SETTINGS]
)
def test_a_disc_rebounds_rolls_and_turns_by_newton_and_coulomb(setting, partner, gravity):
    """Within 1 % of the approach; with e > 0 and without gravity but for the overlap of 1e-9 m."""
    for e, mu in product((0.0, 0.5, 1.0), (0.0, 0.1, 2.0)):
        world = {"gravity": (0.0, -gravity), "restitution": e, "friction": mu}
        tolerance = 1e-8 if e > 0.0 and gravity == 0.0 else 0.01 * SPEED
        for impact in impacts(partner):
            velocity, spin = expected(*impact, e, mu)
            got_velocity, got_spin = simulated(*impact, SETTINGS[setting], **world)
            fall = np.array([0.0, -0.01 * gravity])
            case, count = f"e {e}, mu {mu}, {impact}", len(got_spin)
            np.testing.assert_allclose(got_velocity, velocity[:count] + fall, rtol=0, atol=tolerance, err_msg=case)
            np.testing.assert_allclose(got_spin, spin[:count], rtol=0, atol=2.0 * tolerance, err_msg=case)


@pytest.mark.parametrize("setting", SETTINGS)
def test_an_impact_is_the_same_beside_99_circles(setting):
    for e, partner in product((0.0, 0.5), ("wall", "disc")):
        impact = list(impacts(partner))[2]
        velocity, spin = expected(*impact, e, 0.3)
        world = {"gravity": (0.0, 0.0), "restitution": e, "friction": 0.3}
        got_velocity, got_spin = simulated(*impact, SETTINGS[setting], bystanders=99, **world)
        np.testing.assert_allclose(got_velocity, velocity[: len(got_spin)], rtol=0, atol=0.01 * SPEED)
        np.testing.assert_allclose(got_spin, spin[: len(got_spin)], rtol=0, atol=0.02 * SPEED)
