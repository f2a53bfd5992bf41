"""`deep_contact.cnn.images`: the channels and the two transfers; the symmetries of a state."""

import json

import numpy as np
import pytest
from conftest import circles_at
from symmetry import transform_state

import deep_contact as dc
from deep_contact.cnn.images import CHANNELS, ImageSpec, input_image, label_image, read_back
from deep_contact.stepping.prepare import ready

FLOAT32 = 2.0**-23


@pytest.fixture(scope="module")
def states():
    """Solved states of a pile that falls, settles and nearly rests, radii 0.6 to 1, each wall touched."""
    scene = dc.circles_in_box(30, size=12, radius=(0.6, 1.0), seed=5)
    rng = np.random.default_rng(1)
    scene = scene.replace(bodies=scene.bodies._replace(spin=rng.normal(size=30), velocity=rng.normal(0, 4, (30, 2))))
    kept = []
    dc.simulate(scene, steps=150, solver=dc.PGS(sweeps=300), on_step=lambda state, record: kept.append(state))
    return kept[20:150:16]


def one_contact(position, impulse=(3.0, -1.0), **world):
    """Two circles one above the other whose contact point is at `position`, solved with that impulse."""
    x, y = position
    state = ready(circles_at([[x, y - 0.998], [x, y + 0.998]], **world))
    assert state.contacts.count == 1
    n, t = (np.array([v]) for v in impulse)
    return state.replace(contacts=state.contacts._replace(normal_impulse=n, tangent_impulse=t), solved=True)


# ---- the spec ----


def test_a_spec_is_read_to_the_last_bit_and_one_of_an_earlier_version_if_its_images_are_the_same():
    spec = ImageSpec(spacing=0.1 + 0.2, support=1 / 3)
    assert ImageSpec.from_dict(json.loads(json.dumps(spec.to_dict()))) == spec
    before = {"kernel": "poly6", "transfer": "thesis", "normalization": "particle", "scale_free": False}
    before |= {"scales": [1.0] * 5, "target_scales": [1.0, 1.0]}
    assert ImageSpec.from_dict(ImageSpec().to_dict() | before) == ImageSpec()
    now = ImageSpec().to_dict()
    for given, field in (
        (now | {"colour": 1}, "colour"),
        ({"spacing": 0.5}, "support"),
        (now | before | {"target_scales": [1.0, 2.0]}, r"target_scales: expected \[1.0, 1.0\], the only one left"),
        (now | {"channels": ["mass"]}, "channels: expected"),
        (now | {"transfer": "consistent"}, "transfer: expected 'thesis', the only one left"),
    ):
        with pytest.raises(ValueError, match=field):
            ImageSpec.from_dict(given)


def test_the_default_is_the_thesis_network_s_input():
    """61 x 61 x 5 in the order of its training: section 5.2.3 of the thesis, and n_x."""
    state = one_contact((15, 15))
    assert ImageSpec().channels == ("mass", "velocity_x", "velocity_y", "spin", "normal_x") == CHANNELS
    assert input_image(state, ImageSpec()).shape == (61, 61, 5)
    assert label_image(state, ImageSpec()).shape == (61, 61, 2)
    assert input_image(state, ImageSpec()).dtype == label_image(state, ImageSpec()).dtype == np.float32


# ---- channels ----


def test_a_channel_sums_to_what_the_bodies_carry(states):
    """Appendix A: the weights of a particle sum to one."""
    bodies = states[-1].bodies
    sums = input_image(states[-1], ImageSpec()).astype(float).sum(axis=(0, 1))
    carried = [bodies.mass, *bodies.velocity.T, bodies.spin, states[-1].contacts.normal[:, 0]]
    for name, total, values in zip(CHANNELS, sums, carried):
        assert total == pytest.approx(values.sum(), abs=4 * FLOAT32 * np.abs(values).sum()), name


def test_row_zero_is_the_floor_and_columns_go_right():
    image = label_image(one_contact((10, 7)), ImageSpec())
    assert np.argwhere(image[:, :, 0] == 3).tolist() == [[14, 20]]  # y = 7, x = 10 at d = 0.5


def test_a_state_without_contacts_has_empty_contact_channels():
    state = ready(dc.single_body(height=5.0)).replace(solved=True)
    image, label = input_image(state, ImageSpec()), label_image(state, ImageSpec())
    assert image[..., 0].sum() == pytest.approx(np.pi)
    assert not image[..., 4:].any()
    assert not label.any()
    assert [values.shape for values in read_back(label, state, ImageSpec())] == [(0,), (0,)]


@pytest.mark.filterwarnings("ignore:.*outside of the box")
def test_a_body_pushed_out_of_the_box_acts_from_its_edge():
    assert input_image(ready(circles_at([[-0.2, 15.0]])), ImageSpec())[30, 0, 0] == pytest.approx(np.pi)


# ---- transfers ----


def test_a_contact_within_reach_of_no_node_goes_to_the_nearest():
    """The node at (15, 7.5): a bilinear read returns (1 − 0.21 / 0.5) (1 − 0.13 / 0.5) of it."""
    spec, state = ImageSpec(support=0.1), one_contact((15.21, 7.37))
    _, tangent = read_back(label_image(state, spec), state, spec)
    np.testing.assert_allclose(tangent, [-0.58 * 0.74], rtol=8 * FLOAT32)


# ---- symmetries ----


@pytest.mark.parametrize("k", range(8))
def test_the_turned_state_is_solved_by_the_turned_solution(states, k):
    """The engine's own word on `transform_state`: velocities after the solve turn along. Witness: hand-made matrix."""
    state = states[2]
    mirror, turn = np.diag([-1.0, 1.0]), np.array([[0.0, -1.0], [1.0, 0.0]])
    m = np.linalg.matrix_power(turn, k % 4) @ (mirror if k >= 4 else np.eye(2))
    solver = dc.PGS(sweeps=20_000, tolerance=1e-11)
    here, there = (dc.solve_contacts(s, solver=solver) for s in (state, transform_state(state, k)))
    assert here.record.status == there.record.status == "converged"
    np.testing.assert_allclose(there.velocities, here.velocities @ m.T, atol=1e-8)  # θ to 1e-11, a thousand sweeps
    np.testing.assert_allclose(there.angular_velocities, np.linalg.det(m) * here.angular_velocities, atol=1e-8)
