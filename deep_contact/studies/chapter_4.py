"""Functions for the figures of chapter 4: Keras layers on arrays, random layers, feature maps of a trained network."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np


def by_keras(layer: str, *arguments, x: np.ndarray, weights: Sequence[np.ndarray] = (), **options) -> np.ndarray:
    """Return the output of a Keras layer for an array x, float64.

    layer: name of the layer's class. arguments, options: arguments of this class. x: input without the batch dimension,
    which the output does not have either. weights: arrays of the layer's weights, in Keras's order.
    """
    from deep_contact.cnn.backend import keras

    made = getattr(keras.layers, layer)(*arguments, dtype="float64", **options)
    made.build((None, *x.shape))
    made.set_weights(list(weights))
    return np.asarray(made(np.asarray(x, dtype=np.float64)[None])[0])


def relu(x):
    """Return max(0, x), element by element (Eq 4.4)."""
    return np.maximum(0.0, x)


def random_layers(sizes: Sequence[int], seed: int) -> list[tuple]:
    """Return random (weights, bias) for each pair of neighbouring fully connected layers.

    sizes: number of neurons in each layer. The weights, (n, m), are drawn from the He normal distribution (Table 5.2),
    and the biases, (m,), from a normal distribution with standard deviation 0.1.
    """
    rng = np.random.default_rng(seed)
    return [(rng.normal(0.0, np.sqrt(2 / n), (n, m)), rng.normal(0.0, 0.1, m)) for n, m in pairwise(sizes)]


def feature_maps(model, image: np.ndarray, names: Sequence[str], training: bool = False) -> dict[str, np.ndarray]:
    """Return the outputs of some layers of a network for one image: name of the layer -> (n_y', n_x', maps), float32.

    model: a `keras.Model`. image: input, (n_y, n_x, c). names: names of the layers. training: whether the layers run in
    training mode, in which dropout is active. If `model.trainable` is false, all layers but dropout stay in inference
    mode.
    """
    from deep_contact.cnn.backend import keras

    inside = keras.Model(model.inputs[0], {name: model.get_layer(name).output for name in names})
    return {name: np.asarray(maps)[0] for name, maps in inside(image[None], training=training).items()}


def strongest(maps: np.ndarray) -> int:
    """Return the index of the map with the largest standard deviation. maps: (n_y, n_x, number of maps)."""
    return int(maps.std(axis=(0, 1)).argmax())
