"""Chapter 4 worked through with numbers, in plain NumPy and by Keras or TensorFlow.

Each computation follows the thesis's equation literally, to be compared with the library: a convolution (Eq 4.1), a
network (Eq 4.3, 4.4), max pooling, backpropagation (Eq 4.11-4.18). The last section looks into a trained network.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

# ---- a convolution ----


def window_products(image: np.ndarray, kernel: np.ndarray, row: int, column: int) -> np.ndarray:
    """The products that Eq 4.1 sums at one place, K_ij · I_{x+i−1, y+j−1}: the shape of the kernel.

    image: (n_y, n_x, ...); kernel: (k_y, k_x, ...) with the same further axes (section 4.2.2). row, column: of the
    image's node under the kernel's first node, from 0. Raises ValueError unless the kernel lies within the image.
    """
    k_y, k_x = kernel.shape[:2]
    under = image[row : row + k_y, column : column + k_x]
    if row < 0 or column < 0 or under.shape != kernel.shape:
        within = f"one that lies within the image {image.shape} at ({row}, {column})"
        raise ValueError(f"kernel: expected {within}, got {kernel.shape}")
    return kernel * under


def correlate(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Eq 4.1 at every place where the kernel is within the image: the thesis's "convolution" I * K.

    image: (n_y, n_x) or (n_y, n_x, d); kernel: (k_y, k_x) or (k_y, k_x, d). Returns (o_y, o_x).
    """
    rows, columns = (range(n - k + 1) for n, k in zip(image.shape, kernel.shape[:2]))
    return np.array([[window_products(image, kernel, i, j).sum() for j in columns] for i in rows])


def by_keras(layer: str, *arguments, x: np.ndarray, weights: Sequence[np.ndarray] = (), **options) -> np.ndarray:
    """What a Keras layer of this name makes of x, without a batch, in float64."""
    from deep_contact.cnn.backend import keras

    made = getattr(keras.layers, layer)(*arguments, dtype="float64", **options)
    made.build((None, *x.shape))
    made.set_weights(list(weights))
    return np.asarray(made(np.asarray(x, dtype=np.float64)[None])[0])


def keras_convolution(image: np.ndarray, kernel: np.ndarray, *, stride: int = 1) -> np.ndarray:
    """`correlate` by Keras's `Conv2D`: (o_y, o_x, f). image: (n_y, n_x, d); kernel: (k_y, k_x, d, f)."""
    arguments = kernel.shape[3], kernel.shape[:2]
    return by_keras("Conv2D", *arguments, x=image, weights=[kernel], strides=stride, use_bias=False)


# ---- neurons ----


def relu(x):
    """Eq 4.4, max(0, x)."""
    return np.maximum(0.0, x)


def forward(x: np.ndarray, layers: Sequence[tuple]) -> list[np.ndarray]:
    """The values of every layer of a network, the input first; ReLU after all layers but the last (section 4.2.5).

    layers: (weights (inputs, outputs), bias (outputs,)) of each.
    """
    values = [np.asarray(x, dtype=np.float64)]
    for number, (weights, bias) in enumerate(layers, start=1):
        z = values[-1] @ weights + bias
        values.append(z if number == len(layers) else relu(z))
    return values


def random_layers(sizes: Sequence[int], seed: int) -> list[tuple]:
    """`forward`'s layers between so many neurons each, with He normal weights (Table 5.2) and small biases."""
    rng = np.random.default_rng(seed)
    return [(rng.normal(0.0, np.sqrt(2 / n), (n, m)), rng.normal(0.0, 0.1, m)) for n, m in pairwise(sizes)]


ACTIVATIONS: dict[str, tuple[Callable, Callable]] = {
    "ReLU": (relu, lambda x: np.where(x > 0, 1.0, 0.0)),
    "sigmoid": (lambda x: 1 / (1 + np.exp(-x)), lambda x: np.exp(-x) / (1 + np.exp(-x)) ** 2),
    "tanh": (np.tanh, lambda x: 1 - np.tanh(x) ** 2),
}
"""Name -> (function, derivative)."""


def gradient_ratio(activation: str, *, depth: int, width: int, gain: float, seed: int) -> float:
    """Size of a gradient at the input of a deep network over its size at the output.

    The network has `depth` layers of `width` neurons with normal weights of standard deviation gain · √(2 / width): at
    gain 1 He's. A random input goes forward, then a random gradient goes back from the last layer.
    """
    rng = np.random.default_rng(seed)
    function, derivative = ACTIVATIONS[activation]
    weights = rng.normal(0.0, gain * np.sqrt(2 / width), (depth, width, width))
    x, sums = rng.normal(size=width), []
    for w in weights:
        sums.append(x @ w)
        x = function(sums[-1])
    last = gradient = rng.normal(size=width)
    for w, z in zip(weights[::-1], sums[::-1]):
        gradient = w @ (gradient * derivative(z))
    return float(np.linalg.norm(gradient) / np.linalg.norm(last))


# ---- max pooling ----


def max_pool(image: np.ndarray) -> np.ndarray:
    """The largest value of each window of 2 × 2 adjacent nodes (section 4.2.4); (n_y, n_x, ...).

    Incomplete windows at the far edges count, as with Keras's border mode "same" (Table 5.2): 61 nodes -> 31.
    """
    rows, columns = (range(0, n, 2) for n in image.shape[:2])
    return np.array([[image[i : i + 2, j : j + 2].max(axis=(0, 1)) for j in columns] for i in rows])


# ---- backpropagation, section 4.3.5 ----


def backpropagate(x: np.ndarray, w_hidden: np.ndarray, w_output: np.ndarray, target: float) -> dict:
    """Eq 4.11-4.17 for inputs x (I,), weights w_hidden (I, J) and w_output (J,), and the true output `target`, d.

    The thesis's example has one output, and all neurons are linear. Returns "v": hidden values (J,), Eq 4.16; "y":
    output, "e": error d − y, "loss": e², all Eq 4.11; "chain": factors of Eq 4.12 and 4.15 by name; "output": ∂L/∂w_j
    of the output's weights (J,), Eq 4.13; "hidden": ∂L/∂w_ij (I, J), Eq 4.17.
    """
    v = x @ w_hidden
    y = float(w_output @ v)
    e = float(target - y)
    of_hidden = np.repeat(x[:, None], w_output.size, axis=1)  # of v_j by w_ij; the others are zero
    chain = {"∂L/∂e": np.array(2 * e), "∂e/∂y": np.array(-1.0), "∂y/∂v": w_output, "∂y/∂w": v, "∂v/∂w": of_hidden}
    values = {"v": v, "y": y, "e": e, "loss": e**2, "chain": chain}
    return values | {"output": -2 * v * e, "hidden": -2 * e * np.outer(x, w_output)}


def automatic_gradients(x, w_hidden, w_output, target) -> dict[str, np.ndarray]:
    """The gradients of the same network by automatic differentiation of L.

    Returns "output" (J,), "hidden" (I, J), and the factors of `backpropagate`'s chain by their names.
    """
    from deep_contact.cnn.backend import tensorflow as tf

    x, w_h, w_o, d = (tf.constant(value, tf.float64) for value in (x, w_hidden, w_output, target))
    with tf.GradientTape(persistent=True) as tape:
        tape.watch([w_h, w_o])
        v = tf.linalg.matvec(w_h, x, transpose_a=True)
        y = tf.reduce_sum(w_o * v)
        e = d - y
        loss = e**2
        total = tf.reduce_sum(v)
    pairs = {"output": (loss, w_o), "hidden": (loss, w_h), "∂L/∂e": (loss, e), "∂e/∂y": (e, y)}
    # w_ij acts on v_j alone, so the derivative of the sum of v is that of v_j.
    pairs |= {"∂y/∂v": (y, v), "∂y/∂w": (y, w_o), "∂v/∂w": (total, w_h)}
    return {name: tape.gradient(*pair).numpy() for name, pair in pairs.items()}


# ---- inside a trained network ----


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
