"""Chapter 4's computations by hand and against finite differences, and the claims of Figures 4.1-4.7.

The figures compare them with SciPy, Keras and automatic differentiation.
"""

import numpy as np
import pytest
from conftest import load_script

from deep_contact import figures
from deep_contact.figures import results
from deep_contact.studies import chapter_4 as worked

neuron, backpropagation = load_script("figure_4_4"), load_script("figure_4_7")


@pytest.fixture(scope="module")
def keras():
    return pytest.importorskip("keras")


# ---- Eq 4.1-4.4, pooling, dropout ----


@pytest.mark.parametrize("name", neuron.ACTIVATIONS)
def test_derivatives_of_activations_against_finite_differences(name):
    function, derivative = neuron.ACTIVATIONS[name]
    x, eps = np.linspace(-3, 3, 31) + 0.05, 1e-6  # away from ReLU's corner
    np.testing.assert_allclose(derivative(x), (function(x + eps) - function(x - eps)) / (2 * eps), atol=1e-8)


# ---- backpropagation ----


@pytest.fixture
def example():
    rng = np.random.default_rng(5)
    return {"x": rng.normal(size=3), "w_hidden": rng.normal(size=(3, 4)), "w_output": rng.normal(size=4), "target": 0.7}


@pytest.mark.parametrize(("weights", "gradient"), [("w_output", "output"), ("w_hidden", "hidden")])
def test_eq_4_13_and_4_17_against_finite_differences(example, weights, gradient):
    """L is quadratic in each weight, so central differences are exact but for rounding, 1e-16 / eps."""
    found, eps = backpropagation.backpropagate(**example)[gradient], 1e-4
    for index in np.ndindex(found.shape):
        losses = []
        for sign in (1, -1):
            moved = example[weights].copy()
            moved[index] += sign * eps
            losses.append(backpropagation.backpropagate(**(example | {weights: moved}))["loss"])
        assert found[index] == pytest.approx((losses[0] - losses[1]) / (2 * eps), abs=1e-9)


# ---- inside a network ----


@pytest.fixture(scope="module")
def network(keras):
    """The thesis's network, small, with weights that are not trained."""
    from deep_contact.cnn import architectures

    keras.utils.set_random_seed(0)
    return architectures.build("thesis", shape=(9, 9), channels=2)


def test_feature_maps_are_what_the_first_convolution_gives_by_eq_4_1(network):
    image = np.random.default_rng(6).normal(size=(9, 9, 2)).astype(np.float32)
    maps = worked.feature_maps(network, image, ["convolution_1_1"])["convolution_1_1"]
    kernel, bias = network.get_layer("convolution_1_1").get_weights()
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)))  # border mode "same"
    right = worked.relu(load_script("figure_4_2").correlate(padded, kernel[..., 7]) + bias[7])
    np.testing.assert_allclose(maps[..., 7], right, atol=1e-5)  # float32


def test_dropout_is_on_and_all_else_is_in_inference(network):
    image = np.random.default_rng(7).normal(size=(9, 9, 2)).astype(np.float32)
    network.trainable = False
    names = before, after, *_ = ["convolution_1_2", "dropout_1", "pooling_2", "normalization_2"]
    maps = worked.feature_maps(network, image, names, training=True)
    kept = maps[after] != 0
    np.testing.assert_allclose(maps[after][kept], maps[before][kept] / 0.9, rtol=1e-6)  # its own rate, 0.1
    assert 0.05 < 1 - kept[maps[before] > 0].mean() < 0.15  # 500 values and more
    # Batch normalisation of an untrained network does next to nothing in inference; in training it would.
    np.testing.assert_allclose(maps["normalization_2"], maps["pooling_2"] / np.sqrt(1.001), rtol=1e-4, atol=1e-6)


# ---- the figures ----


@pytest.mark.parametrize(
    ("script", "setting"),
    [("figure_4_3", "model=models/none.h5"), ("figure_5_9", 'networks={"cnn": "models/none.h5"}')],
)
def test_without_a_trained_network_its_figures_say_what_to_do(keras, tmp_path, capsys, script, setting):
    options = ["--quick", "--set", setting, "--out", str(tmp_path)]
    assert figures.main(load_script(script).FIGURE, options) == 1
    message = capsys.readouterr().err
    assert "models/none.h5" in message
    assert "`deep-contact train`" in message
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("script", ["figure_4_3", "figure_4_6"])
def test_a_far_field_network_is_none_that_they_can_look_into(keras, tmp_path, capsys, script):
    with pytest.raises(SystemExit, match="2"):
        figures.main(load_script(script).FIGURE, ["--set", "model=models/far_field.h5", "--out", str(tmp_path)])
    expected = "model: expected a network on images, such as models/model.h5, got models/far_field.h5, a"
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("script", ["figure_4_3", "figure_4_6"])
def test_figures_of_a_network_take_the_model_they_are_given(keras, tmp_path, script):
    from deep_contact.cnn import architectures, images, model_file

    model = architectures.build("thesis", shape=(21, 21), stacks=[[4, [3]], [4, [2]]])
    rng = np.random.default_rng(8)
    model.set_weights([w + rng.normal(0.0, 0.3, w.shape) for w in model.get_weights()])
    card, box = {"architecture": "thesis"}, (0.0, 0.0, 10.0, 10.0)
    path = model_file.save_model(tmp_path / "random.h5", model, images.ImageSpec(), card, box=box)
    settings = [f"model={path}", "n_bodies=6", "size=10", "steps=120"]
    arguments = [part for setting in settings for part in ("--set", setting)]
    assert figures.main(load_script(script).FIGURE, [*arguments, "--quick", "--jobs", "1", "--out", str(tmp_path)]) == 0
    claims = results.read_results(tmp_path / f"{script}.json")["claims"]
    # These do not depend on what a network has learned: kernels are as deep as their input; dropout drops its share,
    # and in training only.
    fixed = claims[: 2 if script == "figure_4_6" else 1]
    assert all(claim["holds"] for claim in fixed)
