"""The networks, their loss and schedules: sections 5.3.1 to 5.3.3, Appendix B. `test_chapter_5` has Tables 5.1, 5.2."""

import numpy as np
import pytest

from deep_contact.cnn import schedules
from deep_contact.cnn.architectures import build
from deep_contact.cnn.training.network import masked_squared_error


@pytest.fixture(scope="module")
def thesis():
    return build("thesis")


def test_thesis_network_has_the_parameters_of_section_5_3_1(thesis):
    assert sum(int(np.prod(v.shape)) for v in thesis.trainable_variables) == 64_498_866
    # and the moving mean and variance of 64 and 256 channels
    assert thesis.count_params() == 64_499_506


def test_thesis_network_cannot_pull(thesis):
    made = thesis(np.random.default_rng(0).normal(size=(2, 61, 61, 5)).astype(np.float32), training=False)
    assert float(np.min(made)) == 0.0


def test_weight_decay_is_that_of_the_authors_code(thesis):
    """1e-4 in their model.py; the thesis prints none."""
    decays = [float(layer.kernel_regularizer.l2) for layer in thesis.layers if hasattr(layer, "kernel_size")]
    assert decays == pytest.approx([1e-4] * 14)


def test_the_last_layer_may_be_a_product_of_lower_rank(thesis):
    """8192 x 7442 becomes 8192 x 170 x 7442; what comes before, and what goes in and out, stays."""
    small = build("thesis", rank=170)
    assert thesis.count_params() - small.count_params() == 8192 * 7442 - 170 * (8192 + 7442)
    assert (small.input_shape, small.output_shape) == (thesis.input_shape, thesis.output_shape)
    assert np.linalg.matrix_rank(small.layers[-2].kernel @ small.layers[-1].kernel[:, :300]) == 170


def test_a_network_may_give_one_map():
    assert build("thesis", targets=1, stacks=[[2, [3]]]).output_shape == (None, 61 * 61)


@pytest.mark.parametrize(
    ("name", "options", "field"),
    [
        ("alexnet", {}, "architecture"),
        ("thesis", {"shape": (61, 0)}, r"shape\[1\]"),
        ("thesis", {"dropout": 1.0}, "dropout"),
        ("thesis", {"dropout": [0, 0, 0, 0.25]}, "dropout: expected a rate, or one for each of 5 stacks"),
        ("thesis", {"dropout": [0, 0, 0, 0, 1]}, "dropout: expected"),
        ("thesis", {"rank": 0}, "rank"),
        ("thesis", {"targets": 0}, "targets"),
        ("far field", {"widht": 8}, "options of far field: expected"),
    ],
)
def test_bad_options_are_named(name, options, field):
    with pytest.raises(ValueError, match=field):
        build(name, **options)


@pytest.mark.parametrize(("dropout", "rates"), [(0.1, [0.1] * 5), ((0, 0, 0, 0, 0.25), [0, 0, 0, 0, 0.25])])
def test_dropout_has_one_rate_or_one_for_each_stack(dropout, rates):
    """Table 5.1, and the authors' code."""
    network = build("thesis", stacks=[[2, [2]]] * 5, dropout=dropout)
    assert [layer.rate for layer in network.layers if layer.name.startswith("dropout")] == rates


def test_masked_squared_error_is_eq_5_3():
    y_true = np.array([[0.0, 2.0, -1.0, 0.0]], np.float32)
    y_pred = np.array([[9.0, 1.0, 1.0, -3.0]], np.float32)
    # g = 0, 1, 1, 0: (1 + 4) / 4
    np.testing.assert_allclose(masked_squared_error(y_true, y_pred), [1.25])


@pytest.mark.parametrize(
    ("name", "rates"),
    [
        # Without the gaps of the thesis's Algorithm 6, and the scheduler of Appendix B.
        ("algorithm 6", {0: 5e-3, 99: 5e-3, 100: 2e-3, 299: 2e-3, 300: 1e-3, 499: 1e-3, 500: 2e-4}),
        ("appendix b", {0: 0.05, 100: 0.05, 101: 0.02, 400: 0.02, 401: 0.01}),
        ("constant", {0: 1.0, 500: 1.0}),
    ],
)
def test_rates_are_those_of_the_thesis(name, rates):
    rate = schedules.SCHEDULES[name](1, 1.0)
    assert {epoch: rate(epoch) for epoch in rates} == rates


SHARES = {
    "scaled algorithm 6": {5e-3: 0.1, 2e-3: 0.2, 1e-3: 0.2, 2e-4: 0.5},
    "scaled appendix b": {0.05: 0.1, 0.02: 0.3, 0.01: 0.6},
}


@pytest.mark.parametrize("epochs", [7, 100, 1000])
@pytest.mark.parametrize("name", SHARES)
def test_scaled_scheduler_takes_each_rate_for_its_share(name, epochs):
    rates = [schedules.SCHEDULES[name](epochs, 1.0)(epoch) for epoch in range(epochs)]
    for rate, share in SHARES[name].items():
        assert rates.count(rate) / epochs == pytest.approx(share, abs=1.5 / epochs)  # 101, 300 and 599 of 1,000
    whole = schedules.SCHEDULES[name.removeprefix("scaled ")](1000, 1.0)
    assert epochs != 1000 or rates == [whole(epoch) for epoch in range(1000)]


def test_cosine_warms_up_falls_and_ends():
    rates = [schedules.cosine(10, 1.0)(epoch) for epoch in range(10)]
    assert rates[:2] == pytest.approx([0.5, 1.0])
    assert rates[1:] == sorted(rates[1:], reverse=True)
    assert rates[-1] == pytest.approx(0.01)
