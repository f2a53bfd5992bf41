"""The networks: the thesis's own, exactly, and two that are small enough to ship. `build(name, ...)` makes each.

All take images (batch, n_y, n_x, channels) and consist of stock Keras layers only, so that their files hold no code
and open with plain `keras.models.load_model(path, compile=False)`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence

import numpy as np

from deep_contact.cnn.backend import keras
from deep_contact.validation import flag, integer, number, one_of

layers = keras.layers

THESIS_SHAPE = (61, 61)
"""Nodes of the thesis's images: 30 m / 0.5 m + 1."""

THESIS_CHANNELS = 5
THESIS_OUTPUTS = 2
"""λ_n, λ_t."""

_THESIS_STACKS = (
    (32, (3, 3)),
    (64, (3, 3, 2)),
    (128, (2, 2, 2)),
    (256, (2, 2, 2)),
    (512, (2, 2, 2)),
)
"""Filters, and the sides of the kernels (Appendix B; Table 5.2 has 3 × 3 for all)."""

_NORMALIZED = (64, 256)
"""Stacks whose pooling is followed by batch normalisation (Table 5.1)."""

COMPACT_COARSENING = 4
"""The compact network works on every fourth node: it gives back as many nodes as it gets if n = 1 (mod 4)."""


def build(name: str, **options) -> keras.Model:
    """The network of that name, untrained: "thesis", "compact" or "far field", with the options of the function below.

    Raises ValueError on another name, and on options that the network does not have.
    """
    make = ARCHITECTURES[one_of("architecture", name, ARCHITECTURES)]
    for option in options:
        one_of(f"options of {name}", option, inspect.signature(make).parameters)
    return make(**options)


def thesis(
    *,
    shape: Sequence[int] = THESIS_SHAPE,
    channels: int = THESIS_CHANNELS,
    outputs: int = THESIS_OUTPUTS,
    dropout: float = 0.1,
    weight_decay: float = 5e-4,
    input_normalization: bool = False,
) -> keras.Model:
    """The thesis's network (section 5.3.1, Table 5.1, Appendix B): (b, n_y, n_x, c) -> (b, n_y · n_x · outputs).

    With the defaults: 64,498,866 trainable parameters. The fully connected last layer holds 61 million of them and ties
    the network to images of one size. Its ReLU excludes negative impulses, and with them half of all friction,
    as in the thesis.

    dropout: after every stack (Table 5.1). weight_decay: of the L2 regulariser; the thesis does not print its value.
    input_normalization: batch normalisation after the input, as in section 5.3.1, not in Table 5.1 or Appendix B.
    Raises ValueError naming the option and the value.
    """
    if len(shape) != 2:
        raise ValueError(f"shape: expected (n_y, n_x), two integers >= 1, got {shape!r}")
    n_y, n_x = (integer(f"shape[{i}]", n, 1) for i, n in enumerate(shape))
    _counts(channels=channels, outputs=outputs)
    number("dropout", dropout, 0, below=1)
    number("weight_decay", weight_decay, 0)
    stack = [keras.Input((n_y, n_x, channels), name="bodies")]
    if flag("input_normalization", input_normalization):
        stack.append(layers.BatchNormalization(name="normalization_0"))
    for stage, (filters, kernels) in enumerate(_THESIS_STACKS, 1):
        for turn, side in enumerate(kernels, 1):
            stack.append(
                layers.Conv2D(
                    filters,
                    side,
                    padding="same",
                    activation="relu",
                    kernel_initializer="he_normal",
                    kernel_regularizer=keras.regularizers.L2(weight_decay),
                    name=f"convolution_{stage}_{turn}",
                )
            )
        stack.append(layers.Dropout(dropout, name=f"dropout_{stage}"))
        if stage < len(_THESIS_STACKS):
            stack.append(layers.MaxPooling2D(2, strides=2, padding="same", name=f"pooling_{stage}"))
            if filters in _NORMALIZED:
                stack.append(layers.BatchNormalization(name=f"normalization_{stage}"))
    stack.append(layers.Flatten(name="flatten"))
    stack.append(layers.Dense(n_y * n_x * outputs, activation="relu", name="impulses"))
    return keras.Sequential(stack, name="thesis")


def compact(
    *,
    channels: int,
    outputs: int = 2,
    stem: int = 24,
    width: int = 64,
    decoder: int = 32,
    dilations: Sequence[int] = (1, 2, 4, 1, 2, 4),
    density: int | None = None,
    starts: Sequence[int] | None = None,
) -> keras.Model:
    """Ours: fully convolutional, signed, (b, n_y, n_x, channels) -> (b, n_y, n_x, outputs) where n = 1 (mod 4).

    An hourglass of three resolutions. Two convolutions with stride 2 lead to every fourth node (2 m where d = 0.5),
    where residual convolutions of growing dilation cover the thesis's box: with the defaults 61 nodes to every side.
    Two transposed convolutions lead back, joined by the features at half the resolution. All strided layers are padded
    such that their outputs lie on the nodes 0, 2, 4, … and 0, 4, 8, …, so that mirrored input gives mirrored geometry.
    Other sizes are padded with zeros at the top and right (`inference.padded_shape`).

    stem, width, decoder: features at half resolution, at a quarter, and at half on the way back. dilations: one
    residual convolution each. The last layer starts from zero, so an untrained network predicts nothing.

    density: the input channel with the density of contacts. The output is then a smooth field times this density, so
    that the network need not predict where the contacts are.
    starts: the input channels with Builtin's start, one for each output. They are added to the output, multiplied by a
    gate between 0 and 1 at each node: in a resting pile they already are the solution.
    Both select their channels by a 1 × 1 convolution, initialised with that choice and trained with the rest.
    Raises ValueError naming the option and the value.
    """
    dilations = tuple(dilations)
    _counts(channels=channels, outputs=outputs, stem=stem, width=width, decoder=decoder)
    _counts(**{f"dilations[{i}]": dilation for i, dilation in enumerate(dilations)})
    same = {"padding": "same", "activation": "relu", "kernel_initializer": "he_normal"}
    image = keras.Input((None, None, channels), name="state")
    half = _halved(image, stem, "half")
    x = _halved(half, width, "quarter")
    for i, dilation in enumerate(dilations, 1):
        change = layers.Conv2D(width, 3, dilation_rate=dilation, name=f"far_{i}", **same)(x)
        x = layers.Add(name=f"sum_{i}")([x, change])
    x = _doubled(x, stem, "back_to_half", activation="relu", kernel_initializer="he_normal")
    x = layers.Concatenate(name="beside_half")([x, half])
    near = layers.Conv2D(decoder, 3, name="near", **same)(x)
    x = _doubled(near, outputs, "field", kernel_initializer="zeros")
    chosen = {}
    if density is not None:
        chosen["density"] = [density] * outputs
        x = layers.Multiply(name="impulses")([x, _choice(image, outputs, "density")])
    if starts is not None:
        chosen["start"] = list(starts)
        gate = _doubled(near, outputs, "gate", activation="sigmoid", kernel_initializer="zeros")
        kept = layers.Multiply(name="kept")([gate, _choice(image, outputs, "start")])
        x = layers.Add(name="start_and_impulses")([x, kept])
    model = keras.Model(image, x, name="compact")
    for name, picked in chosen.items():
        if len(picked) != outputs or not all(isinstance(i, int) and 0 <= i < channels for i in picked):
            raise ValueError(f"{name}: expected {outputs} of the channels 0 to {channels - 1}, got {picked}")
        kernel = np.zeros((1, 1, channels, outputs), np.float32)
        kernel[0, 0, picked, range(outputs)] = 1.0
        model.get_layer(name).set_weights([kernel])
    return model


def far_field(*, channels: int, outputs: int, width: int = 24) -> keras.Model:
    """The far-field network (`cnn.far_field`): (b, n_y, n_x, channels) -> every second node, where n = 1 (mod 8).

    A U-Net of residual blocks on every second, fourth and eighth node of the input, of `width`, 2 `width` and
    2 `width` features. The last layer starts from zero, so that an untrained network leaves Builtin as it is.
    Raises ValueError naming the option and the value.
    """
    _counts(channels=channels, outputs=outputs, width=width)

    def block(x, features, name):
        change = x
        for turn in (1, 2):
            change = layers.ReLU(name=f"{name}_relu_{turn}")(change)
            same = {"padding": "same", "kernel_initializer": "he_normal"}
            change = layers.Conv2D(features, 3, name=f"{name}_{turn}", **same)(change)
        return layers.Add(name=name)([x, change])

    def down(x, features, name):
        x = layers.ZeroPadding2D(1, name=f"{name}_padding")(x)
        return layers.Conv2D(features, 3, strides=2, kernel_initializer="he_normal", name=name)(x)

    image = keras.Input((None, None, channels), name="state")
    second = block(down(image, width, "to_second"), width, "second")
    fourth = block(down(second, 2 * width, "to_fourth"), 2 * width, "fourth")
    eighth = block(block(down(fourth, 2 * width, "to_eighth"), 2 * width, "eighth"), 2 * width, "far")
    x = layers.Add(name="join_fourth")([fourth, _doubled(eighth, 2 * width, "back_to_fourth")])
    x = block(x, 2 * width, "fourth_back")
    x = layers.Add(name="join_second")([second, _doubled(x, width, "back_to_second")])
    x = layers.ReLU(name="last_relu")(block(x, width, "second_back"))
    return keras.Model(
        image, layers.Conv2D(outputs, 1, kernel_initializer="zeros", name="coefficients")(x), name="far_field"
    )


ARCHITECTURES: dict[str, Callable[..., keras.Model]] = {"thesis": thesis, "compact": compact, "far field": far_field}
"""Name -> function that builds the network."""

_COARSENING = {"compact": COMPACT_COARSENING, "far field": 8}


def coarsening(name: str) -> int:
    """k such that the network of that name takes images of n = 1 (mod k) nodes along each edge; 1 is any."""
    return _COARSENING.get(name, 1)


def _halved(x, filters, name):
    x = layers.ZeroPadding2D(1, name=f"{name}_padding")(x)
    options = {"strides": 2, "activation": "relu", "kernel_initializer": "he_normal"}
    return layers.Conv2D(filters, 3, name=name, **options)(x)


def _doubled(x, filters, name, **options):
    x = layers.Conv2DTranspose(filters, 3, strides=2, name=name, **options)(x)
    return layers.Cropping2D(1, name=f"{name}_crop")(x)


def _choice(image, outputs, name):
    return layers.Conv2D(outputs, 1, use_bias=False, name=name)(image)


def _counts(**numbers):
    for name, value in numbers.items():
        integer(name, value, 1)
