"""What several figures of chapter 4 use: layers of Keras on arrays, neurons, and a look into a trained network."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np


def by_keras(layer: str, *arguments, x: np.ndarray, weights: Sequence[np.ndarray] = (), **options) -> np.ndarray:
    """What a Keras layer of this name makes of x, without a batch, in float64."""
    from deep_contact.cnn.backend import keras

    made = getattr(keras.layers, layer)(*arguments, dtype="float64", **options)
    made.build((None, *x.shape))
    made.set_weights(list(weights))
    return np.asarray(made(np.asarray(x, dtype=np.float64)[None])[0])


def relu(x):
    """Eq 4.4, max(0, x)."""
    return np.maximum(0.0, x)


def random_layers(sizes: Sequence[int], seed: int) -> list[tuple]:
    """`forward`'s layers between so many neurons each, with He normal weights (Table 5.2) and small biases."""
    rng = np.random.default_rng(seed)
    return [(rng.normal(0.0, np.sqrt(2 / n), (n, m)), rng.normal(0.0, 0.1, m)) for n, m in pairwise(sizes)]


def feature_maps(model, image: np.ndarray, names: Sequence[str], training: bool = False) -> dict[str, np.ndarray]:
    """The outputs of some layers for one image (n_y, n_x, c): name -> (n_y', n_x', maps), float32.

    training: with dropout at work. All else stays in inference if `model.trainable` is false.
    """
    from deep_contact.cnn.backend import keras

    inside = keras.Model(model.inputs[0], {name: model.get_layer(name).output for name in names})
    return {name: np.asarray(maps)[0] for name, maps in inside(image[None], training=training).items()}


def strongest(maps: np.ndarray) -> int:
    """Index of the map, of (n_y, n_x, maps), with the largest standard deviation."""
    return int(maps.std(axis=(0, 1)).argmax())
