"""Shared by the figures of chapter 4: Keras layers on arrays, random layers, feature maps of a trained network."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np


def by_keras(layer: str, *arguments, x: np.ndarray, weights: Sequence[np.ndarray] = (), **options) -> np.ndarray:
    """The output of the Keras layer `layer` for x, both without a batch, float64."""
    from deep_contact.cnn.backend import keras

    made = getattr(keras.layers, layer)(*arguments, dtype="float64", **options)
    made.build((None, *x.shape))
    made.set_weights(list(weights))
    return np.asarray(made(np.asarray(x, dtype=np.float64)[None])[0])


def relu(x):
    """Eq 4.4, max(0, x)."""
    return np.maximum(0.0, x)


def random_layers(sizes: Sequence[int], seed: int) -> list[tuple]:
    """(weights, bias) between layers of `sizes` neurons: He normal weights (Table 5.2) and small biases."""
    rng = np.random.default_rng(seed)
    return [(rng.normal(0.0, np.sqrt(2 / n), (n, m)), rng.normal(0.0, 0.1, m)) for n, m in pairwise(sizes)]


def feature_maps(model, image: np.ndarray, names: Sequence[str], training: bool = False) -> dict[str, np.ndarray]:
    """The outputs of some layers for one image (n_y, n_x, c): name -> (n_y', n_x', maps), float32.

    training: whether dropout is at work. All other layers stay in inference if `model.trainable` is false.
    """
    from deep_contact.cnn.backend import keras

    inside = keras.Model(model.inputs[0], {name: model.get_layer(name).output for name in names})
    return {name: np.asarray(maps)[0] for name, maps in inside(image[None], training=training).items()}


def strongest(maps: np.ndarray) -> int:
    """Index of the map with the largest standard deviation. maps: (n_y, n_x, number of maps)."""
    return int(maps.std(axis=(0, 1)).argmax())
