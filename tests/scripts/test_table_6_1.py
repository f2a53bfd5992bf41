"""One network for both maps or one for each: what is trained, the errors of known images, and the verdicts."""

import numpy as np
import pytest
from conftest import load_script

from deep_contact.cnn.images import ImageSpec, label_image

table = load_script("table_6_1")


@pytest.mark.parametrize(
    ("factors", "holds"),
    [
        ([1.0, 1.01, 0.99], True),
        ([1.3, 1.4, 1.35], False),
        ([0.6, 0.7, 0.65], False),
        ([1.0, 1.0, 1.3], None),  # one training differs
        ([1.12, 1.0, 1.0], None),
    ],
)
def test_two_errors_are_equal_if_every_pair_of_trainings_is_within_a_tenth(factors, holds):
    scenes = np.random.default_rng(0).uniform(0.8, 1.2, (1, 12)) * np.array(factors)[:, None]
    claim = table.equal("equal", None, scenes, np.tile(scenes[:1] / factors[0], (3, 1)))
    assert claim.holds is holds
    assert table.equal("equal", None, scenes[:, :9], scenes[:, :9]).verdict == "open: 9 scenes"


def test_errors_are_those_of_each_map_and_none_for_the_true_image(falling_states):
    spec, scenes = ImageSpec(), [falling_states[4:6], falling_states[6:8]]
    true = np.array([label_image(state, spec) for of_scene in scenes for state in of_scene])
    half = true * [0.5, 1.0]
    half[true == 0] = 7.0  # where the loss does not look
    errors = table.errors_of(scenes, half, spec)
    np.testing.assert_allclose(errors["error of the λ_n map"], 0.5, rtol=1e-6)
    np.testing.assert_allclose(errors["error of the λ_t map"], 0.0, atol=1e-6)
    zero = table.errors_of(scenes, 0 * true, spec)
    assert all(len(zero[measure]) == 2 for measure in table.MEASURES)
    near = table.errors_of(scenes, true, spec)
    assert sum(near["velocity error after 3 sweeps"]) < sum(zero["velocity error after 3 sweeps"])


@pytest.mark.slow
def test_networks_for_one_map_each_fill_both(tmp_path):
    pytest.importorskip("keras")
    rng = np.random.default_rng(0)
    for name, maps in (("train_x", 5), ("train_y", 2), ("test_x", 5)):
        np.save(tmp_path / f"{name}.npy", rng.uniform(0.1, 1.0, (4, 17, 17, maps)).astype(np.float32))
    options = {"filters and rank": {variant: [2, 3] for variant in table.MAPS}, "rate": 0.01, "batch": 2, "epochs": 1}
    one, large, each = (table.trained_maps((variant, 0), tmp_path, options) for variant in table.MAPS)
    assert one[1].shape == each[1].shape == (4, 17, 17, 2)
    assert (each[1] != 0).any(axis=(0, 1, 2)).all()
    np.testing.assert_array_equal(one[1], large[1])  # of the same size here, and from the same beginning
    assert one[0] < each[0] < 2 * one[0]
