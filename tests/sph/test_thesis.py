"""The authors' ways back from an image: a spline, and nodes that share out their values."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact import sph
from deep_contact.sph import kernels
from deep_contact.sph.start import Sph
from deep_contact.studies import starts

GRID = sph.Grid.over_box((0.0, 0.0, 4.0, 3.0), 0.5)


def test_a_spline_returns_a_cubic():
    # Bicubic splines contain all cubics.
    x, y = np.meshgrid(*GRID.nodes)
    at = np.random.default_rng(0).uniform((0, 0), (4, 3), (50, 2))

    def cubic(x, y):
        return 1.0 + x - 2.0 * y + 0.3 * x * y**2 - 0.1 * x**3 + 0.05 * x**2 * y

    image = np.stack([cubic(x, y), -x], axis=-1)
    back = sph.read_by_spline(GRID, image, at)
    np.testing.assert_allclose(back, np.stack([cubic(*at.T), -at[:, 0]], axis=-1), atol=1e-12)
    beyond = sph.read_by_spline(GRID, image, [[4.1, -0.2]])
    np.testing.assert_allclose(beyond[0], image[0, -1], atol=1e-12)


@pytest.mark.parametrize("kernel", ["poly6", "spiky"])
@pytest.mark.parametrize("h", [0.5, 0.8])
def test_sharing_is_what_the_sums_say(kernel, h):
    rng = np.random.default_rng(1)
    at, image = rng.uniform((-0.05, 0), (4, 3), (30, 2)), rng.normal(size=(*GRID.shape, 2))
    nodes = np.stack(np.meshgrid(*GRID.nodes), axis=-1)
    inside = np.clip(at, 0.0, (4.0, 3.0))
    distance = np.linalg.norm(nodes[:, :, None] - inside, axis=-1)
    weights = np.where(distance < h, kernels.value(kernel, distance, h), 0.0)
    total = weights.sum(axis=2, keepdims=True)
    shares = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)
    found = sph.share_out(GRID, image, at, h=h, kernel=kernel)
    np.testing.assert_allclose(found, np.einsum("yxk,yxc->kc", shares, image), atol=1e-12)


def test_sharing_loses_nothing():
    state = starts.solved_states(dc.circles_in_box(60, seed=3), steps=200, every=190)[-1]
    given = np.column_stack([state.contacts.normal_impulse, state.contacts.tangent_impulse])
    for h in (0.5, 1.0):
        back = np.column_stack(Sph(transfer="shared", support=h).round_trip(state, given))
        np.testing.assert_allclose(back.sum(axis=0), given.sum(axis=0), rtol=1e-12)
