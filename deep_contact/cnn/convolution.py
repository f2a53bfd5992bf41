"""The far-field network without a framework: its convolutions in Numba, as one compiled call, for inference.

A layer is a table. It has the place of each output node's first tap in the input, and weights in groups of eight or
sixteen features. Eight nodes of a group are eight vectors that stay in registers while all taps go by. So nearly every
operation multiplies and adds as many numbers as the processor can at a time. A transposed convolution is four such
layers, one for each pair of even or odd rows and columns of its output, so that no zero is multiplied.

An image is stored with a margin of one node of zeros; the margin at the end of a row is also that at the beginning of
the next. A residual block needs its input as it is and with ReLU taken, so both images are stored.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from llvmlite.binding import get_host_cpu_features
from numba import config, uint64

from deep_contact.cnn.far_field import COEFFICIENTS, FarFieldSpec
from deep_contact.compiled import njit
from deep_contact.compiled.simd import WIDTH, doubled, load_like, most, spread, spread_like, store
from deep_contact.state.validation import expect


def layer_shapes(width: int) -> dict[str, list[tuple[int, ...]]]:
    """Layer of `architectures.far_field` -> shapes of its kernel and bias."""
    channels, near, far = len(FarFieldSpec.channels), width, 2 * width
    features = {"second": near, "fourth": far, "eighth": far, "far": far, "fourth_back": far, "second_back": near}
    kernels = {f"{block}_{turn}": (3, 3, count, count) for block, count in features.items() for turn in (1, 2)}
    kernels |= {"to_second": (3, 3, channels, near), "to_fourth": (3, 3, near, far), "to_eighth": (3, 3, far, far)}
    # A transposed convolution has its outputs before its inputs.
    kernels |= {"back_to_fourth": (3, 3, far, far), "back_to_second": (3, 3, near, far)}
    kernels["coefficients"] = (1, 1, near, len(COEFFICIENTS))
    return {name: [kernel, (kernel[2 if name.startswith("back") else 3],)] for name, kernel in kernels.items()}


_WIDEST = 2 if get_host_cpu_features().get("avx512f") else 1
"""Number of vectors of `WIDTH` numbers that a register of the processor holds."""


LAYER = np.dtype(
    [
        ("first", np.int64),  # row of its first node in `Program.nodes`
        ("blocks", np.int64),  # number of blocks of `WIDTH` nodes
        ("pitch", np.int64),  # numbers from a row of taps to the next in the input
        ("rows", np.int64),  # number of rows of taps
        ("run", np.int64),  # numbers in a row of taps
        ("weights", np.int64),  # first vector in `Program.weights`: bias, then taps, group by group
        ("groups", np.int64),  # number of groups of features
        ("vectors", np.int64),  # vectors of `WIDTH` features in a group, 1 or 2
        ("skip", np.int64),  # image that is added
        ("out", np.int64),  # image that is written
        ("positive", np.int64),  # image that is written with ReLU taken
    ]
)
"""A row of `Program.layers`. Images are named by their place in the workspace, in vectors of `WIDTH`; -1: none."""


class Image(NamedTuple):
    """An image in the workspace: height and width in nodes, numbers in a node, and the place of its first number."""

    height: int
    width: int
    numbers: int
    place: int

    @property
    def pitch(self) -> int:
        """Numbers from the beginning of a row to that of the next."""
        return (self.width + 1) * self.numbers

    def nodes(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Places of the nodes in these rows and columns, row by row, relative to `place`; -1 is the margin."""
        return (((rows[:, None] + 1) * (self.width + 1) + columns + 1) * self.numbers).ravel()

    def view(self, space: np.ndarray) -> np.ndarray:
        """The image in a workspace, (height, width, numbers)."""
        first = self.place + self.pitch + self.numbers
        rows = space[first : first + self.height * self.pitch].reshape(self.height, self.width + 1, self.numbers)
        return rows[:, : self.width]


class Program:
    """The network `architectures.far_field` for images (n_y, n_x, channels), n = 1 (mod 8).

    weights: layer -> kernel and bias, as `model_file.StoredNetwork` has them. Several threads may call a program: each
    call has a workspace of its own. Raises ValueError where the network has other layers (see `layer_shapes`).
    """

    def __init__(self, weights: dict[str, list[np.ndarray]], shape: tuple[int, int]):
        expect(is_far_field(weights), f"network: expected the layers of architectures.far_field, got {sorted(weights)}")
        self._of = weights
        self._layers, self._nodes, self._weights, self._size, self._filled = [], [], [], 0, 0
        image = self._image(*shape, len(FarFieldSpec.channels))
        second = self._block("second", self._down("to_second", image))
        fourth = self._block("fourth", self._down("to_fourth", second[0]))
        eighth = self._block("far", self._block("eighth", self._down("to_eighth", fourth[0])))
        fourth = self._block("fourth_back", self._up("back_to_fourth", eighth[0], fourth[0]))
        second = self._block("second_back", self._up("back_to_second", fourth[0], second[0]))
        last = self._image(second[1].height, second[1].width, len(COEFFICIENTS))
        self._convolution("coefficients", second[1], last)
        # Without the compiler only a record array has its columns as attributes.
        layers, self.nodes = np.array(self._layers, LAYER), np.concatenate(self._nodes)
        self.layers = layers.view(np.recarray) if config.DISABLE_JIT else layers
        self.weights, self._input, self._output = np.concatenate(self._weights), image, last
        self._workspaces = [_aligned(self._size)]  # workspaces that no call is using
        del self._of, self._layers, self._nodes, self._weights

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Coefficients (rows, columns, outputs) for an image of the program's shape, both float32."""
        expect(image.shape == self._input[:3], f"image: expected shape {self._input[:3]}, got {image.shape}")
        try:
            workspace = self._workspaces.pop()
        except IndexError:  # other threads have all workspaces
            workspace = _aligned(self._size)
        self._input.view(workspace)[:] = image
        _run(self.layers, self.nodes, self.weights, workspace)
        output = self._output.view(workspace)[:, :, : len(COEFFICIENTS)].copy()
        self._workspaces.append(workspace)
        return output

    def _image(self, height, width, features) -> Image:
        """Reserve the place of an image in the workspace, whose zeros are the margin."""
        numbers = features if self._size == 0 else _whole(features)
        image = Image(height, width, numbers, self._size)
        self._size += _whole(((height + 2) * (width + 1) + 1) * numbers)
        return image

    def _pair(self, *size):
        """Reserve the places of an image as it is, and with ReLU taken."""
        return self._image(*size), self._image(*size)

    def _down(self, name, image):
        """Every second node: a convolution with stride 2."""
        made = self._pair((image.height + 1) // 2, (image.width + 1) // 2, self._of[name][0].shape[3])
        self._convolution(name, image, *made, stride=2)
        return made

    def _block(self, name, images):
        """A residual block: x + conv(ReLU(conv(ReLU(x))))."""
        raw, positive = images
        between, made = self._image(*raw[:3]), self._pair(*raw[:3])
        self._convolution(f"{name}_1", positive, positive=between)
        self._convolution(f"{name}_2", between, *made, skip=raw)
        return made

    def _up(self, name, image, skip):
        """2 n − 1 nodes of n: a transposed convolution without its outer nodes, to which the image `skip` is added."""
        made = self._pair(skip.height, skip.width, self._of[name][0].shape[2])
        for odd_row in (0, 1):
            for odd_column in (0, 1):
                rows, columns = np.arange(image.height - odd_row), np.arange(image.width - odd_column)
                here = made[0].nodes(2 * rows + odd_row, 2 * columns + odd_column)
                # An even node meets the kernel's middle; an odd one its end at the node before, its start at the next.
                taps = [(1,), (2, 0)][odd_row], [(1,), (2, 0)][odd_column]
                kernel = self._of[name][0].transpose(0, 1, 3, 2)[np.ix_(*taps)]
                self._layer(name, kernel, image, image.nodes(rows, columns), here, *made, skip=skip)
        return made

    def _convolution(self, name, image, out=None, positive=None, *, stride=1, skip=None):
        """A convolution with zeros around the image."""
        kernel, made = self._of[name][0], out or positive
        reach, rows, columns = kernel.shape[0] // 2, np.arange(made.height), np.arange(made.width)
        nodes = image.nodes(stride * rows - reach, stride * columns - reach)
        self._layer(name, kernel, image, nodes, made.nodes(rows, columns), out, positive, skip=skip)

    def _layer(self, name, kernel, image, nodes, here, out, positive, *, skip):
        """Add a layer that computes the nodes at `here` from the taps that begin at `nodes` of the image."""
        rows, columns, channels, features = kernel.shape
        every = _whole(features) // WIDTH
        # A row of vectors for the bias, then one for each tap and channel.
        wide = np.zeros((1 + rows * columns * image.numbers, every, WIDTH), np.float32)
        wide[0].ravel()[:features] = self._of[name][1]
        wide[1:].reshape(rows, columns, image.numbers, -1)[:, :, :channels, :features] = kernel
        # The places left in the last block compute the last node again.
        count = _whole(len(nodes))
        places = np.stack([nodes + image.place, here // WIDTH], axis=1).astype(np.uint32)
        first = sum(part.shape[0] for part in self._nodes)
        self._nodes.append(np.pad(places, ((0, count - len(nodes)), (0, 0)), mode="edge"))
        row, begin = (first, count // WIDTH, image.pitch, rows, columns * image.numbers), 0
        for vectors in (_WIDEST, 1):
            if groups := (every - begin) // vectors:
                pieces = [-1 if image is None else image.place // WIDTH + begin for image in (skip, out, positive)]
                self._layers.append((*row, self._filled, groups, vectors, *pieces))
                packed = wide[:, begin : begin + groups * vectors].reshape(len(wide), groups, -1).swapaxes(0, 1)
                self._weights.append(packed.ravel())
                self._filled += packed.size // WIDTH
                begin += groups * vectors


def is_far_field(weights: dict[str, list[np.ndarray]]) -> bool:
    """Whether a network has the layers of `architectures.far_field`."""
    shapes = {name: [array.shape for array in arrays] for name, arrays in weights.items() if arrays}
    first = shapes.get("to_second", [()])[0]
    return len(first) > 0 and shapes == layer_shapes(first[-1])


def _whole(count: int) -> int:
    """The next multiple of `WIDTH`."""
    return -(-count // WIDTH) * WIDTH


def _aligned(size: int) -> np.ndarray:
    """`size` zeros, float32, the first of them at the beginning of a cache line."""
    line = 64
    room = np.zeros(size + line // 4, np.float32)
    return room[(-room.ctypes.data % line) // 4 :][:size]


# Unsigned indices spare Numba the test for negative ones, which count from the end.
@njit(cache=True, error_model="numpy")
def _convolve(layer, b, nodes, weights, space, zero):
    """Compute block b of a layer in place: `WIDTH` nodes, all groups of as many features as `zero` has lanes."""
    first, pitch, vectors = layer.first + b * WIDTH, uint64(layer.pitch), layer.vectors
    x0, x1, x2 = nodes[uint64(first), 0], nodes[uint64(first + 1), 0], nodes[uint64(first + 2), 0]
    x3, x4, x5 = nodes[uint64(first + 3), 0], nodes[uint64(first + 4), 0], nodes[uint64(first + 5), 0]
    x6, x7 = nodes[uint64(first + 6), 0], nodes[uint64(first + 7), 0]
    w, next_w, one = uint64(layer.weights), uint64(vectors), uint64(1)
    for g in range(layer.groups):
        a0 = load_like(zero, weights, w)
        w += next_w
        a1, a2, a3, a4, a5, a6, a7 = a0, a0, a0, a0, a0, a0, a0
        for r in range(layer.rows):
            o = uint64(r) * pitch
            for _ in range(layer.run):
                c = load_like(zero, weights, w)
                a0 = a0 + c * spread_like(zero, space[x0 + o])
                a1 = a1 + c * spread_like(zero, space[x1 + o])
                a2 = a2 + c * spread_like(zero, space[x2 + o])
                a3 = a3 + c * spread_like(zero, space[x3 + o])
                a4 = a4 + c * spread_like(zero, space[x4 + o])
                a5 = a5 + c * spread_like(zero, space[x5 + o])
                a6 = a6 + c * spread_like(zero, space[x6 + o])
                a7 = a7 + c * spread_like(zero, space[x7 + o])
                w += next_w
                o += one
        k = 0
        for a in (a0, a1, a2, a3, a4, a5, a6, a7):
            place = np.int64(nodes[first + k, 1]) + g * vectors
            if layer.skip >= 0:
                a = a + load_like(zero, space, layer.skip + place)
            if layer.out >= 0:
                store(space, layer.out + place, a)
            if layer.positive >= 0:
                store(space, layer.positive + place, most(a, zero))
            k += 1


@njit(cache=True, error_model="numpy")
def _run(layers, nodes, weights, space):
    zero = spread(np.float32(0.0))
    for layer in layers:
        for b in range(layer.blocks):
            if layer.vectors == 2:
                _convolve(layer, b, nodes, weights, space, doubled(zero))
            else:
                _convolve(layer, b, nodes, weights, space, zero)
