"""The networks: an exact copy of the thesis's network, and the far-field network, which is ours. `build` makes both.

Both take images (batch, n_y, n_x, channels). They consist of stock Keras layers only. So their files contain no code,
and can be opened with `keras.models.load_model(path, compile=False)`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence

from deep_contact.cnn.backend import keras
from deep_contact.cnn.far_field import COEFFICIENTS, FarFieldSpec
from deep_contact.cnn.images import CHANNELS, TARGETS
from deep_contact.state.validation import integer, number, one_of

layers = keras.layers

THESIS_STACKS = ((32, (3, 3)), (64, (3, 3, 2)), (128, (2, 2, 2)), (256, (2, 2, 2)), (512, (2, 2, 2)))
"""Stacks of convolutions. A stack is (number of filters, sides of the square kernels of its convolutions).

For example (3, 3, 2) stands for three convolutions with kernels of 3 × 3, 3 × 3 and 2 × 2 (Appendix B). Table 5.2 has
kernels of 3 × 3 for all convolutions.
"""

_NORMALIZED = (2, 4)
"""Numbers of the stacks, counted from 1, whose pooling is followed by batch normalisation (Table 5.1)."""


def build(name: str, **options) -> keras.Model:
    """Return an untrained network.

    name: "thesis" or "far field". options: arguments of the function `thesis` or `far_field`. Raises ValueError for
    another name, and for options that the function does not have.
    """
    make = ARCHITECTURES[one_of("architecture", name, ARCHITECTURES)]
    for option in options:
        one_of(f"options of {name}", option, inspect.signature(make).parameters)
    return make(**options)


def thesis(
    *,
    shape: Sequence[int] = (61, 61),
    channels: int = len(CHANNELS),
    targets: int = len(TARGETS),
    stacks: Sequence[tuple[int, Sequence[int]]] = THESIS_STACKS,
    dropout: float | Sequence[float] = 0.1,
    weight_decay: float = 1e-4,
    rank: int | None = None,
) -> keras.Model:
    """Return the thesis's network (section 5.3.1, Table 5.1, Appendix B): (b, n_y, n_x, c) -> (b, n_y · n_x · targets).

    With the defaults the network has 64,498,866 trainable parameters. The fully connected last layer has 61 million of
    them, and works for images of one size only. The ReLU of this layer excludes negative impulses, and so half of all
    friction impulses, as in the thesis.

    shape: (n_y, n_x), the nodes of an image. channels: number of channels of the input. targets: number of maps in the
    output; with 1 the network predicts one impulse alone, as in goal 8 of the thesis.
    stacks: as in `THESIS_STACKS`; every stack but the last is followed by pooling. dropout: one rate for all stacks
    (Table 5.1), or one rate for each stack; Appendix B has dropout after the last stack only.
    weight_decay: factor of the L2 regulariser. The default is that of the authors' code; the thesis prints none.
    rank: rank of the last layer's matrix, which is then a product of two smaller matrices. None is one full matrix of
    244 MB, as in the thesis.
    Raises ValueError naming the option and the value.
    """
    if len(shape) != 2:
        raise ValueError(f"shape: expected (n_y, n_x), two integers >= 1, got {shape!r}")
    n_y, n_x = (integer(f"shape[{i}]", n, 1) for i, n in enumerate(shape))
    integer("channels", channels, 1)
    integer("targets", targets, 1)
    rates = [dropout] * len(stacks) if isinstance(dropout, (int, float)) else list(dropout)
    if len(rates) != len(stacks):
        raise ValueError(f"dropout: expected a rate, or one for each of {len(stacks)} stacks, got {dropout!r}")
    for rate in rates:
        number("dropout", rate, 0, below=1)
    number("weight_decay", weight_decay, 0)
    same = {"padding": "same", "activation": "relu", "kernel_initializer": "he_normal"}
    stack = [keras.Input((n_y, n_x, channels), name="bodies")]
    for stage, (filters, kernels) in enumerate(stacks, 1):
        for turn, side in enumerate(kernels, 1):
            decay = keras.regularizers.L2(weight_decay)
            name = f"convolution_{stage}_{turn}"
            stack.append(layers.Conv2D(filters, side, kernel_regularizer=decay, name=name, **same))
        stack.append(layers.Dropout(rates[stage - 1], name=f"dropout_{stage}"))
        if stage < len(stacks):
            stack.append(layers.MaxPooling2D(2, strides=2, padding="same", name=f"pooling_{stage}"))
            if stage in _NORMALIZED:
                stack.append(layers.BatchNormalization(name=f"normalization_{stage}"))
    stack.append(layers.Flatten(name="flatten"))
    if rank is not None:
        stack.append(layers.Dense(integer("rank", rank, 1), use_bias=False, name="impulses_factor"))
    stack.append(layers.Dense(n_y * n_x * targets, activation="relu", name="impulses"))
    return keras.Sequential(stack, name="thesis")


def far_field(*, width: int = 24) -> keras.Model:
    """Return the far-field network (`cnn.far_field`): (b, n_y, n_x, 29) -> (b, (n_y + 1) / 2, (n_x + 1) / 2, 12).

    n_y and n_x have to be one more than a multiple of 8. The network is a U-Net of residual blocks. They act on images
    that keep every second, fourth and eighth node of the input, with `width`, 2 `width` and 2 `width` features. The
    weights of the last layer begin at zero. So an untrained network does not change the start that it corrects.
    width: number of features in the images that keep every second node. Raises ValueError naming the option and the
    value.
    """
    integer("width", width, 1)
    normal = {"kernel_initializer": "he_normal"}

    def block(x, features, name):
        change = x
        for turn in (1, 2):
            change = layers.ReLU(name=f"{name}_relu_{turn}")(change)
            change = layers.Conv2D(features, 3, padding="same", name=f"{name}_{turn}", **normal)(change)
        return layers.Add(name=name)([x, change])

    def down(x, features, name):
        x = layers.ZeroPadding2D(1, name=f"{name}_padding")(x)
        return layers.Conv2D(features, 3, strides=2, name=name, **normal)(x)

    def up(x, features, name):
        x = layers.Conv2DTranspose(features, 3, strides=2, name=name)(x)
        return layers.Cropping2D(1, name=f"{name}_crop")(x)

    image = keras.Input((None, None, len(FarFieldSpec.channels)), name="state")
    second = block(down(image, width, "to_second"), width, "second")
    fourth = block(down(second, 2 * width, "to_fourth"), 2 * width, "fourth")
    eighth = block(block(down(fourth, 2 * width, "to_eighth"), 2 * width, "eighth"), 2 * width, "far")
    x = layers.Add(name="join_fourth")([fourth, up(eighth, 2 * width, "back_to_fourth")])
    x = block(x, 2 * width, "fourth_back")
    x = layers.Add(name="join_second")([second, up(x, width, "back_to_second")])
    x = layers.ReLU(name="last_relu")(block(x, width, "second_back"))
    x = layers.Conv2D(len(COEFFICIENTS), 1, kernel_initializer="zeros", name="coefficients")(x)
    return keras.Model(image, x, name="far_field")


ARCHITECTURES: dict[str, Callable[..., keras.Model]] = {"thesis": thesis, "far field": far_field}
"""Name of a network -> function that builds it."""
