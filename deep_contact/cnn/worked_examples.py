"""Chapter 4 worked through with numbers: what its figures show, in plain NumPy, and the same by Keras or TensorFlow.

Each computation follows the thesis's equation word for word, so that it can be held against the library's: a
convolution (Eq 4.1), its size (Eq 4.2), a neuron (Eq 4.3, 4.4), max pooling, dropout, backpropagation (Eq 4.11-4.18).
They are small and meant to be read; nothing of the package computes with them. The last section looks into a trained
network. Keras and TensorFlow are imported by the functions that need them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

# ---- a convolution ----


def window_products(image: np.ndarray, kernel: np.ndarray, row: int, column: int) -> np.ndarray:
    """The products that Eq 4.1 sums at one place, K_ij · I_{x+i−1, y+j−1}: the shape of the kernel.

    image: (n_y, n_x, ...); kernel: (k_y, k_x, ...) with the same further axes (section 4.2.2: a kernel is as deep as
    its input). row, column: the image's node under the kernel's first one, from 0.
    Raises ValueError where the kernel sticks out of the image, or is not as deep.
    """
    k_y, k_x = kernel.shape[:2]
    under = image[row : row + k_y, column : column + k_x]
    if row < 0 or column < 0 or under.shape != kernel.shape:
        raise ValueError(
            f"kernel: expected one that lies within the image {image.shape} at ({row}, {column}), got {kernel.shape}"
        )
    return kernel * under


def correlate(image: np.ndarray, kernel: np.ndarray, *, stride: int = 1) -> np.ndarray:
    """Eq 4.1 everywhere that the kernel fits: the thesis's "convolution" I * K.

    image: (n_y, n_x) or (n_y, n_x, d); kernel: (k_y, k_x) or (k_y, k_x, d). Returns (o_y, o_x).
    """
    (n_y, n_x), (k_y, k_x) = image.shape[:2], kernel.shape[:2]
    rows, columns = range(0, n_y - k_y + 1, stride), range(0, n_x - k_x + 1, stride)
    return np.array([[window_products(image, kernel, i, j).sum() for j in columns] for i in rows])


def flipped(kernel: np.ndarray) -> np.ndarray:
    """The kernel turned by half a turn: correlating with it is what mathematics calls a convolution."""
    return kernel[::-1, ::-1]


def output_size(image: int, kernel: int, stride: int) -> float:
    """Eq 4.2, (I − K) / s + 1, as it is printed: a whole number only where s divides I − K."""
    return (image - kernel) / stride + 1


def keras_convolution(image: np.ndarray, kernel: np.ndarray, *, stride: int = 1) -> np.ndarray:
    """What Keras's `Conv2D` makes of it, without border, bias and activation: (o_y, o_x, f).

    image: (n_y, n_x, d); kernel: (k_y, k_x, d, f).
    """
    from deep_contact.cnn.backend import keras

    options = {"strides": stride, "use_bias": False, "dtype": "float64"}
    layer = keras.layers.Conv2D(kernel.shape[3], kernel.shape[:2], **options)
    layer.build((None, *image.shape))
    layer.set_weights([kernel])
    return np.asarray(layer(image[None])[0])


# ---- neurons ----


def relu(x):
    """Eq 4.4, max(0, x)."""
    return np.maximum(0.0, x)


def neuron(x: np.ndarray, w: np.ndarray, bias: float, activation: Callable = relu) -> float:
    """Eq 4.3: f(Σ w_i x_i + bias)."""
    return float(activation(np.sum(w * x) + bias))


class Layer(NamedTuple):
    """A fully connected layer: weights (inputs, outputs) and bias (outputs,)."""

    weights: np.ndarray
    bias: np.ndarray


def forward(x: np.ndarray, layers: Sequence[Layer]) -> list[np.ndarray]:
    """The values of every layer of a network, the input first; ReLU after all layers but the last (section 4.2.5)."""
    values = [np.asarray(x, dtype=np.float64)]
    for number, (weights, bias) in enumerate(layers, start=1):
        z = values[-1] @ weights + bias
        values.append(z if number == len(layers) else relu(z))
    return values


def random_layers(sizes: Sequence[int], seed: int) -> list[Layer]:
    """Layers between so many neurons each, with He normal weights (Table 5.2) and small biases."""
    rng = np.random.default_rng(seed)
    pairs = zip(sizes[:-1], sizes[1:])
    return [Layer(rng.normal(0.0, np.sqrt(2 / n), (n, m)), rng.normal(0.0, 0.1, m)) for n, m in pairs]


def keras_forward(x: np.ndarray, layers: Sequence[Layer]) -> np.ndarray:
    """The last of `forward`'s values by Keras's `Dense`."""
    from deep_contact.cnn.backend import keras

    network = keras.Sequential([keras.Input((len(x),), dtype="float64")])
    for number, layer in enumerate(layers, start=1):
        activation = "linear" if number == len(layers) else "relu"
        network.add(keras.layers.Dense(layer.bias.size, activation=activation, dtype="float64"))
        network.layers[-1].set_weights(list(layer))
    return np.asarray(network(np.asarray(x, dtype=np.float64)[None])[0])


ACTIVATIONS: dict[str, tuple[Callable, Callable]] = {
    "ReLU": (relu, lambda x: np.where(x > 0, 1.0, 0.0)),
    "sigmoid": (lambda x: 1 / (1 + np.exp(-x)), lambda x: np.exp(-x) / (1 + np.exp(-x)) ** 2),
    "tanh": (np.tanh, lambda x: 1 - np.tanh(x) ** 2),
}
"""Name -> (function, derivative)."""


def gradient_ratio(activation: str, *, depth: int, width: int, gain: float, seed: int) -> float:
    """How much smaller, or larger, a gradient has become on its way back through a deep network.

    depth layers of `width` neurons, weights normal with standard deviation gain · √(2 / width): He's at gain 1. A
    random input goes forward; a random gradient goes back from the last layer. Returns its size at the input over its
    size at the output.
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


# ---- max pooling and dropout ----


def max_pool(image: np.ndarray, size: int = 2) -> np.ndarray:
    """The largest value of each window of size × size nodes, side by side (section 4.2.4); (n_y, n_x, ...).

    What is left over at the far edges is a window too, as with Keras's border mode "same" (Table 5.2): 61 nodes -> 31.
    """
    rows, columns = (range(0, n, size) for n in image.shape[:2])
    return np.array([[image[i : i + size, j : j + size].max(axis=(0, 1)) for j in columns] for i in rows])


def keras_max_pool(image: np.ndarray, size: int = 2) -> np.ndarray:
    """The same by Keras's `MaxPooling2D`; image: (n_y, n_x, d)."""
    from deep_contact.cnn.backend import keras

    layer = keras.layers.MaxPooling2D(size, strides=size, padding="same", dtype="float64")
    return np.asarray(layer(image[None])[0])


def pooled_sizes(n: int, times: int) -> list[int]:
    """Nodes along an edge before and after each of so many 2 × 2 poolings."""
    sizes = [n]
    for _ in range(times):
        sizes.append(len(max_pool(np.zeros((sizes[-1], 1)))))
    return sizes


def dropout(values: np.ndarray, rate: float, rng: np.random.Generator) -> np.ndarray:
    """Each value zero with probability `rate`, and else divided by 1 − rate, so that its mean stays (section 4.3.2).

    Raises ValueError for a rate outside [0, 1).
    """
    if not 0 <= rate < 1:
        raise ValueError(f"rate: expected a number from 0 to below 1, got {rate!r}")
    return np.where(rng.random(values.shape) < rate, 0.0, values / (1 - rate))


# ---- backpropagation, section 4.3.5 ----


class Backpropagation(NamedTuple):
    """The forward and the backward pass of the thesis's example: I inputs, J hidden neurons, one output, all linear.

    | field     | meaning                                                              | shape  |
    |-----------|----------------------------------------------------------------------|--------|
    | v         | hidden values, Eq 4.16                                               | (J,)   |
    | y         | output, Eq 4.11                                                      | scalar |
    | e         | error d − y, Eq 4.11                                                 | scalar |
    | loss      | L = e², Eq 4.11                                                      | scalar |
    | chain     | ∂L/∂e, ∂e/∂y, ∂y/∂v_j, ∂y/∂w_j, ∂v_j/∂w_ij: factors of Eq 4.12, 4.15 | dict   |
    | output    | ∂L/∂w_j of the output's weights, Eq 4.13                             | (J,)   |
    | hidden    | ∂L/∂w_ij of the hidden weights, Eq 4.17                              | (I, J) |
    """

    v: np.ndarray
    y: float
    e: float
    loss: float
    chain: dict[str, np.ndarray]
    output: np.ndarray
    hidden: np.ndarray


def backpropagate(x: np.ndarray, w_hidden: np.ndarray, w_output: np.ndarray, target: float) -> Backpropagation:
    """Eq 4.11-4.17 for inputs x (I,), weights w_hidden (I, J) and w_output (J,), and the true output `target`, d."""
    v = x @ w_hidden
    y = float(w_output @ v)
    e = float(target - y)
    chain = {
        "∂L/∂e": np.array(2 * e),
        "∂e/∂y": np.array(-1.0),
        "∂y/∂v": w_output.copy(),
        "∂y/∂w": v.copy(),
        "∂v/∂w": np.repeat(x[:, None], w_output.size, axis=1),  # of v_j by w_ij; the other ones are zero
    }
    return Backpropagation(v, y, e, e**2, chain, -2 * v * e, -2 * e * np.outer(x, w_output))


def automatic_gradients(x, w_hidden, w_output, target) -> dict[str, np.ndarray]:
    """The gradients of the same network by automatic differentiation, which knows only how L is computed.

    Returns "output" (J,), "hidden" (I, J) and the factors of the chain as `Backpropagation.chain` names them.
    """
    from deep_contact.cnn.backend import tensorflow as tf

    x, w_h, w_o, d = (tf.constant(value, tf.float64) for value in (x, w_hidden, w_output, target))
    with tf.GradientTape(persistent=True) as tape:
        tape.watch([w_h, w_o])
        v = tf.linalg.matvec(w_h, x, transpose_a=True)
        tape.watch(v)
        y = tf.reduce_sum(w_o * v)
        tape.watch(y)
        e = d - y
        tape.watch(e)
        loss = e**2
        total = tf.reduce_sum(v)
    found = {
        "output": tape.gradient(loss, w_o),
        "hidden": tape.gradient(loss, w_h),
        "∂L/∂e": tape.gradient(loss, e),
        "∂e/∂y": tape.gradient(e, y),
        "∂y/∂v": tape.gradient(y, v),
        "∂y/∂w": tape.gradient(y, w_o),
        # w_ij acts on v_j alone, so the derivative of the sum of v is that of v_j.
        "∂v/∂w": tape.gradient(total, w_h),
    }
    return {name: value.numpy() for name, value in found.items()}


def momentum_step(weights, gradient, *, rate: float, velocity=0.0, gamma: float = 0.0):
    """(new weights, new velocity) by Eq 4.8: v ← γ v + η ∇L, w ← w − v."""
    velocity = gamma * np.asarray(velocity) + rate * np.asarray(gradient)
    return weights - velocity, velocity


def printed_output_update(w_output, found: Backpropagation, rate: float) -> np.ndarray:
    """Eq 4.14 as printed, w_j + α v_j e, its e_j read as the e_l of Eq 4.11."""
    return w_output + rate * found.v * found.e


def printed_hidden_update(w_hidden, w_output, x, found: Backpropagation, rate: float) -> np.ndarray:
    """Eq 4.18 as printed, w_ij + 2 α e w_j x_i. w_output: the weights it is given, before or after their own update."""
    return w_hidden + 2 * rate * found.e * np.outer(x, w_output)


# ---- inside a trained network ----


def convolutions(model) -> list:
    """The layers of a Keras model that see a neighbourhood, in the order in which they work."""
    from deep_contact.cnn.backend import keras

    kinds = (keras.layers.Conv2D, keras.layers.Conv2DTranspose)
    return [layer for layer in model.layers if isinstance(layer, kinds) and max(layer.kernel_size) > 1]


def feature_maps(model, image: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray]:
    """What the layers of these names give for one image (n_y, n_x, c): name -> (n_y', n_x', maps), float32.

    Raises ValueError for a name that the model does not have.
    """
    from deep_contact.cnn.backend import keras

    known = {layer.name: layer for layer in model.layers}
    for name in names:
        if name not in known:
            raise ValueError(f"layer: expected one of {', '.join(known)}, got {name!r}")
    inside = keras.Model(model.inputs[0], {name: known[name].output for name in names})
    found = inside(image[None])  # in inference; to say so by `training` would switch off what `with_dropout` put on
    return {name: np.asarray(found[name])[0] for name in names}


def strongest(maps: np.ndarray, count: int) -> np.ndarray:
    """Numbers of the maps (n_y, n_x, maps) that differ most from place to place, the strongest first."""
    return np.argsort(-maps.std(axis=(0, 1)), kind="stable")[:count]


def with_dropout(model, rate: float, seed: int = 0):
    """A copy of a trained model in which dropout is on, as in training: (Keras model, a layer, its dropout).

    Where the model has dropout layers, those are switched on, with their own rates. Where it has none, one with `rate`
    follows every hidden convolution, as in the thesis's Table 5.2. Everything else stays as in inference: the batch
    normalisation of a network that is "in training" would change the numbers too. The names returned are those of the
    first layer with dropout and of the dropout that follows it. The masks are drawn anew in every call.
    """
    from deep_contact.cnn.backend import keras

    own = [layer.name for layer in model.layers if isinstance(layer, keras.layers.Dropout)]
    hidden = [layer.name for layer in convolutions(model) if getattr(layer.activation, "__name__", "") == "relu"]
    names = [layer.name for layer in model.layers]
    dropped, dropping = (names[names.index(own[0]) - 1], own[0]) if own else (hidden[0], f"dropout_after_{hidden[0]}")

    def call(layer, *arguments, **options):
        if layer.name in own:
            return layer(*arguments, **{**options, "training": True})
        if isinstance(layer, keras.layers.BatchNormalization):
            # Keras hands the mode of one layer on to those after it, unless they are told theirs.
            options = {**options, "training": False}
        out = layer(*arguments, **options)
        if not own and layer.name in hidden:
            number = hidden.index(layer.name)
            out = keras.layers.Dropout(rate, seed=seed + number, name=f"dropout_after_{layer.name}")(out, training=True)
        return out

    functional = keras.Model(model.inputs[0], model.outputs[0])  # a list of layers has no calls to change
    copy = keras.models.clone_model(functional, call_function=call)
    weights = {layer.name: layer.get_weights() for layer in model.layers}
    for layer in copy.layers:
        if weights.get(layer.name):
            layer.set_weights(weights[layer.name])
    return copy, dropped, dropping
