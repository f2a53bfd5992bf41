"""The far-field network's description of a state, its symmetries and scaling, and its start."""

import numpy as np
import pytest
from conftest import circles_at, solved_states
from symmetry import transform_state

import deep_contact as dc
from deep_contact.cnn.far_field import COEFFICIENTS, FarFieldSpec, correct, corrected, description_of, window_side
from deep_contact.cnn.inference import FarFieldModel
from deep_contact.cnn.start import Cnn

SPEC = FarFieldSpec()


@pytest.fixture(scope="module")
def state(falling_states):
    return falling_states[6]


@pytest.mark.parametrize("symmetry", range(1, 8))
def test_a_turned_state_is_described_as_the_state_turned(state, symmetry):
    turned, expected = description_of(state, SPEC, symmetry), description_of(transform_state(state, symmetry), SPEC)
    np.testing.assert_allclose(turned.point, expected.point, atol=1e-12)
    np.testing.assert_allclose(turned.image, expected.image, atol=2e-5)
    # Features stay in the frame of the solver: a mirror changes the sign of λ_t.
    sign = np.array([1.0, -1.0 if symmetry >= 4 else 1.0])
    np.testing.assert_allclose(turned.features, expected.features * sign, atol=1e-9)


def test_scaling_all_velocities_scales_features_and_leaves_the_image(state):
    factor = 3.7
    world = dc.World(box=state.world.box, gravity=tuple(factor * g for g in state.world.gravity))
    contacts = state.contacts._replace(
        normal_start=factor * state.contacts.normal_start, tangent_start=factor * state.contacts.tangent_start
    )
    bodies = state.bodies._replace(velocity=factor * state.bodies.velocity, spin=factor * state.bodies.spin)
    scaled = description_of(state.replace(world=world, bodies=bodies, contacts=contacts), SPEC)
    plain = description_of(state, SPEC)
    np.testing.assert_allclose(scaled.image, plain.image, atol=2e-5)
    np.testing.assert_allclose(scaled.features, factor * plain.features, rtol=1e-9, atol=1e-12)


def test_the_window_spans_the_contacts_and_no_more(state):
    description = description_of(state, SPEC)
    x_min, y_min, x_max, y_max = description.grid.box
    low, high = state.contacts.position.min(axis=0), state.contacts.position.max(axis=0)
    assert (low - (x_min, y_min) >= 1.0 - 1e-9).all()
    assert ((x_max, y_max) - high >= 1.0 - 1e-9).all()
    assert description.image.shape[:2] == (window_side(high[1] - low[1]), window_side(high[0] - low[0]))
    assert [window_side(cells) for cells in (0.0, 6.0, 6.1, 30.0, 30.1)] == [9, 9, 17, 33, 49]


def image_beside(place):
    """The image of a circle on the floor at x = 15 m, and of one that touches nothing."""
    return description_of(dc.find_contacts(circles_at([[15.0, 1.0], place])), SPEC).image


@pytest.mark.parametrize("place", [(22.5, 3.0), (13.5, 3.0), (15.0, 7.5)])
def test_a_circle_outside_the_window_is_not_painted(place):
    # Nine nodes from a node before the contact on: x from 14 m to 22 m, y from −1 m to 7 m.
    np.testing.assert_array_equal(image_beside(place), image_beside((5.0, 25.0)))
    assert (image_beside((21.5, 3.0)) != image_beside(place)).any()


def test_an_empty_part_of_the_box_changes_nothing(state):
    world = dc.World(box=(-20.0, 0.0, 90.0, 200.0), gravity=state.world.gravity)
    np.testing.assert_array_equal(
        description_of(state.replace(world=world), SPEC).image, description_of(state, SPEC).image
    )


def test_small_circles_look_like_large_ones(state):
    # All lengths by c, masses as they are: the same velocities after the same gravity Δt, s = ω r kept.
    c = 0.25
    bodies = state.bodies._replace(
        position=c * state.bodies.position, radius=c * state.bodies.radius, spin=state.bodies.spin / c
    )
    contacts = state.contacts._replace(position=c * state.contacts.position, separation=c * state.contacts.separation)
    world = dc.World(box=tuple(c * x for x in state.world.box), gravity=state.world.gravity)
    small, plain = (
        description_of(state.replace(world=world, bodies=bodies, contacts=contacts), SPEC),
        description_of(state, SPEC),
    )
    np.testing.assert_allclose(small.image, plain.image, atol=2e-5)
    np.testing.assert_allclose(small.features, plain.features, rtol=1e-9, atol=1e-9)


def test_far_away_contacts_make_a_coarser_window():
    spread = circles_at([[0.9, 0.9], [9_999.1, 0.9]], radius=0.95, box=(0.0, 0.0, 10_000.0, 30.0))
    description = description_of(dc.find_contacts(spread), SPEC)
    assert max(description.image.shape) <= 1025
    assert description.grid.box[2] > 9_999.1


def test_with_no_coefficients_the_start_is_builtins(state):
    start = corrected(description_of(state, SPEC), np.zeros((state.contacts.count, len(COEFFICIENTS))))
    np.testing.assert_array_equal(start[:, 0], state.contacts.normal_start)
    np.testing.assert_array_equal(start[:, 1], state.contacts.tangent_start)


def test_a_uniform_stress_gives_impulses_by_the_normal(state):
    # S = [[1, 0], [0, -1]] plus the trace 2: λ_n = 2 + n_x² − n_y², λ_t = t·S·n = 2 n_x n_y, in units of k_n s.
    description = description_of(state, SPEC)
    coefficients = np.zeros((state.contacts.count, len(COEFFICIENTS)))
    coefficients[:, COEFFICIENTS.index("stress_trace")] = 2.0
    coefficients[:, COEFFICIENTS.index("stress_xx")] = 1.0
    change = corrected(description, coefficients) - description.start
    unit = description.features[:, 0, 0]
    n_x, n_y = state.contacts.normal.T
    np.testing.assert_allclose(change[:, 0], unit * (2 + n_x**2 - n_y**2), atol=1e-9)
    np.testing.assert_allclose(change[:, 1], unit * 2 * n_x * n_y, atol=1e-9)


def test_coefficients_are_read_bilinearly(state):
    # A linear field of stress is read exactly.
    description = description_of(state, SPEC)
    x, y = np.meshgrid(*(nodes[::2] for nodes in description.grid.nodes))
    image = np.zeros((*x.shape, len(COEFFICIENTS)), np.float32)
    image[:, :, COEFFICIENTS.index("stress_trace")] = 1.0 + 2.0 * x - 0.5 * y
    found = correct(image, description)
    p_x, p_y = description.point.T
    coefficients = np.zeros((state.contacts.count, len(COEFFICIENTS)))
    coefficients[:, COEFFICIENTS.index("stress_trace")] = 1.0 + 2.0 * p_x - 0.5 * p_y
    np.testing.assert_allclose(found, corrected(description, coefficients), atol=1e-4 * np.abs(found).max())


def test_spec_goes_through_json():
    assert FarFieldSpec.from_dict(FarFieldSpec(spacing=0.75).to_dict()) == FarFieldSpec(spacing=0.75)
    with pytest.raises(ValueError, match="spacing: expected"):
        FarFieldSpec(spacing=-1)
    before = FarFieldSpec().to_dict() | {"inputs": "all", "correction": True}
    assert FarFieldSpec.from_dict(before) == FarFieldSpec()
    with pytest.raises(ValueError, match="inputs: expected"):
        FarFieldSpec.from_dict(before | {"inputs": "bodies"})
    with pytest.raises(ValueError, match="FarFieldSpec: expected"):
        FarFieldSpec.from_dict({"kind": "far field"})


def test_a_model_file_gives_a_start_in_the_cone(tmp_path, state):
    from deep_contact.cnn import architectures
    from deep_contact.cnn.model_file import save_model

    network = architectures.far_field(width=4)
    # Away from zero, where an untrained network starts, so that it does something.
    last = network.get_layer("coefficients")
    last.set_weights([np.full_like(w, 0.05) for w in last.get_weights()])
    start = Cnn(save_model(tmp_path / "far.h5", network, SPEC, {}))
    assert (type(start.model), start.model.spec) == (FarFieldModel, SPEC)
    normal, tangent = start(state, dc.PGS())
    assert not np.array_equal(normal, state.contacts.normal_start)
    assert (normal >= 0).all()
    assert (np.abs(tangent) <= state.world.friction * normal + 1e-12).all()


@pytest.mark.slow
def test_training_resumes_and_beats_builtin_a_little(tmp_path):
    # Ten seconds of training: two epochs at once, and one and one, give the same history.
    from deep_contact.cnn import write_simulation
    from deep_contact.cnn.training import TrainingConfig, train

    for sim in range(4):
        states = solved_states(dc.circles_in_box(60, seed=sim), steps=250, solver=dc.PGS(sweeps=2000))
        write_simulation(tmp_path / f"sim_{sim:04d}.h5", states)
    settings = {"epochs": 2, "states_per_epoch": 320, "schedule": "constant", "fractions": (0.5, 0.25, 0.25)}
    settings |= {"options": {"width": 8}, "validation_states": 60}
    # Of all states for the card the first has no impulses to correct: no reason to warn who trains.
    through = train(TrainingConfig(**settings), tmp_path, tmp_path / "a", held_out=1000)
    train(TrainingConfig(**settings | {"epochs": 1}), tmp_path, tmp_path / "b", held_out=30)
    resumed = train(TrainingConfig(**settings), tmp_path, tmp_path / "b", held_out=30)
    losses = [[line["validation_loss"] for line in run.history] for run in (through, resumed)]
    assert losses[0] == losses[1]
    assert losses[0][-1] < 1.0  # Builtin's is 1
