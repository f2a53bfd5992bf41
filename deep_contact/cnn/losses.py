"""The loss of the thesis's training, on images (section 5.3.2, Appendix B)."""

from __future__ import annotations

from deep_contact.cnn.backend import keras

ops = keras.ops


def masked_squared_error(y_true, y_pred):
    """Loss of Appendix B (Eq 5.3): mean of (y_pred − y_true)² over the last axis, where y_true ≠ 0, else 0.

    The mask is on the label: nodes without a label count in the mean, with an error of 0 for any prediction.
    """
    return ops.mean(ops.where(ops.not_equal(y_true, 0.0), ops.square(y_pred - y_true), 0.0), axis=-1)
