"""Inference of the far-field network without Keras: one compiled Numba call computes all convolutions.

A tap is an input node that the kernel, the 3 × 3 weights, covers at an output node. A layer is a row of
`Program.layers` (`LAYER`). It points to the index of each output node's first tap in the input, and to weights in
groups of eight or sixteen features.

The compiled loop computes one group of features at eight output nodes at a time. One sum per node, a SIMD vector with
the features of the group, stays in registers until all taps are added. So nearly every operation is a multiply-add of
whole SIMD registers. A transposed convolution becomes four layers, one for each parity of the output's row and column.
So no multiplication is spent on the zeros that a transposed convolution inserts between input nodes.

An image is stored with a margin of zeros, one node wide. The margin at the end of a row also serves as the margin at
the beginning of the next row. A residual block needs its input both unchanged and after ReLU, so both images are
stored.
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
    """Return the shapes of the weights of `architectures.far_field`: layer -> [shape of the kernel, shape of the bias].

    width: number of features in the images that keep every second node. The coarser images have twice as many.
    """
    channels, near, far = len(FarFieldSpec.channels), width, 2 * width
    features = {"second": near, "fourth": far, "eighth": far, "far": far, "fourth_back": far, "second_back": near}
    kernels = {f"{block}_{turn}": (3, 3, count, count) for block, count in features.items() for turn in (1, 2)}
    kernels |= {"to_second": (3, 3, channels, near), "to_fourth": (3, 3, near, far), "to_eighth": (3, 3, far, far)}
    # The kernel of a transposed convolution has the shape (3, 3, outputs, inputs).
    kernels |= {"back_to_fourth": (3, 3, far, far), "back_to_second": (3, 3, near, far)}
    kernels["coefficients"] = (1, 1, near, len(COEFFICIENTS))
    return {name: [kernel, (kernel[2 if name.startswith("back") else 3],)] for name, kernel in kernels.items()}


_WIDEST = 2 if get_host_cpu_features().get("avx512f") else 1
"""Largest number of vectors of `WIDTH` features in a group: 2 with the registers of AVX-512, else 1."""


LAYER = np.dtype(
    [
        ("first", np.int64),  # row of the layer's first output node in `Program.nodes`
        ("blocks", np.int64),  # number of blocks of `WIDTH` output nodes
        ("pitch", np.int64),  # distance of two rows of taps in the input image, in float32 numbers
        ("rows", np.int64),  # number of rows of taps, the height of the kernel
        ("run", np.int64),  # float32 numbers in a row of taps: width of the kernel times numbers in a node
        ("weights", np.int64),  # index of the first vector in `Program.weights`: for each group bias, then taps
        ("groups", np.int64),  # number of groups of features
        ("vectors", np.int64),  # number of vectors of `WIDTH` features in a group, 1 or 2
        ("skip", np.int64),  # image that is added to the result
        ("out", np.int64),  # image to which the result is written
        ("positive", np.int64),  # image to which ReLU of the result is written
    ]
)
"""A row of `Program.layers`. Images are given by their offset in the workspace, in vectors of `WIDTH`; -1: no image."""


class Image(NamedTuple):
    """An image in the workspace. The sizes leave the margin out, and `place` includes it.

    height, width: numbers of nodes. numbers: float32 numbers stored for a node, one for each channel. place: index of
    the image's first number in the workspace.
    """

    height: int
    width: int
    numbers: int
    place: int

    @property
    def pitch(self) -> int:
        """Distance between the beginnings of two rows, in float32 numbers."""
        return (self.width + 1) * self.numbers

    def nodes(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the offset of the first number of each node in some rows and columns, relative to `place`.

        rows, columns: indices of rows and columns; -1 is the margin. The offsets are flattened row by row.
        """
        return (((rows[:, None] + 1) * (self.width + 1) + columns + 1) * self.numbers).ravel()

    def view(self, space: np.ndarray) -> np.ndarray:
        """Return a view of the image in a workspace, without the margin, (height, width, numbers)."""
        first = self.place + self.pitch + self.numbers
        rows = space[first : first + self.height * self.pitch].reshape(self.height, self.width + 1, self.numbers)
        return rows[:, : self.width]


class Program:
    """The network `architectures.far_field` compiled for images of one shape.

    weights: name of a layer -> [kernel, bias], as in `model_file.StoredNetwork`. shape: (n_y, n_x), the numbers of
    nodes of an image along y and x, each one more than a multiple of 8. Several threads may call a program at once,
    because each call has its own workspace. Raises ValueError if the layers are not those of `layer_shapes`.
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
        # Without Numba's compiler, `layer.first` and other columns are attributes of a record array only.
        layers, self.nodes = np.array(self._layers, LAYER), np.concatenate(self._nodes)
        self.layers = layers.view(np.recarray) if config.DISABLE_JIT else layers
        self.weights, self._input, self._output = np.concatenate(self._weights), image, last
        self._workspaces = [_aligned(self._size)]  # workspaces that no call uses at the moment
        del self._of, self._layers, self._nodes, self._weights

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Return the coefficients that the network predicts, (rows, columns, 12), float32.

        image: (n_y, n_x, channels), float32, of the program's shape.
        """
        expect(image.shape == self._input[:3], f"image: expected shape {self._input[:3]}, got {image.shape}")
        try:
            workspace = self._workspaces.pop()
        except IndexError:  # other threads use all workspaces
            workspace = _aligned(self._size)
        self._input.view(workspace)[:] = image
        _run(self.layers, self.nodes, self.weights, workspace)
        output = self._output.view(workspace)[:, :, : len(COEFFICIENTS)].copy()
        self._workspaces.append(workspace)
        return output

    def _image(self, height, width, features) -> Image:
        """Reserve a range of the workspace for an image and its margin. The workspace is zero, and so is the margin."""
        numbers = features if self._size == 0 else _whole(features)
        image = Image(height, width, numbers, self._size)
        self._size += _whole(((height + 2) * (width + 1) + 1) * numbers)
        return image

    def _pair(self, *size):
        """Reserve two images of one size in the workspace: for a result, and for ReLU of the result."""
        return self._image(*size), self._image(*size)

    def _down(self, name, image):
        """Add a convolution with stride 2. Returns the images of its result and of ReLU of the result."""
        made = self._pair((image.height + 1) // 2, (image.width + 1) // 2, self._of[name][0].shape[3])
        self._convolution(name, image, *made, stride=2)
        return made

    def _block(self, name, images):
        """Add a residual block, x + conv(ReLU(conv(ReLU(x)))). Returns the images of its result and ReLU of its result.

        images: image of x, and image of ReLU(x).
        """
        raw, positive = images
        between, made = self._image(*raw[:3]), self._pair(*raw[:3])
        self._convolution(f"{name}_1", positive, positive=between)
        self._convolution(f"{name}_2", between, *made, skip=raw)
        return made

    def _up(self, name, image, skip):
        """Add a transposed convolution with stride 2 that makes 2 n − 1 nodes of n, and add the image `skip` to it.

        The outermost nodes of the transposed convolution are left out. Returns the images of the sum and of ReLU of the
        sum.
        """
        made = self._pair(skip.height, skip.width, self._of[name][0].shape[2])
        for odd_row in (0, 1):
            for odd_column in (0, 1):
                rows, columns = np.arange(image.height - odd_row), np.arange(image.width - odd_column)
                here = made[0].nodes(2 * rows + odd_row, 2 * columns + odd_column)
                # Along an axis, an even output node takes the kernel's tap 1 at one input node. An odd output node
                # takes tap 2 at the input node before it, and tap 0 at the input node after it.
                taps = [(1,), (2, 0)][odd_row], [(1,), (2, 0)][odd_column]
                kernel = self._of[name][0].transpose(0, 1, 3, 2)[np.ix_(*taps)]
                self._layer(name, kernel, image, image.nodes(rows, columns), here, *made, skip=skip)
        return made

    def _convolution(self, name, image, out=None, positive=None, *, stride=1, skip=None):
        """Add a convolution of an image that is padded with zeros.

        name: layer. out, positive: images for the result and for ReLU of the result, or None. skip: image that is added
        to the result, or None.
        """
        kernel, made = self._of[name][0], out or positive
        reach, rows, columns = kernel.shape[0] // 2, np.arange(made.height), np.arange(made.width)
        nodes = image.nodes(stride * rows - reach, stride * columns - reach)
        self._layer(name, kernel, image, nodes, made.nodes(rows, columns), out, positive, skip=skip)

    def _layer(self, name, kernel, image, nodes, here, out, positive, *, skip):
        """Append a layer to the program's tables.

        kernel: (rows, columns, channels, features). nodes: offset of the first tap of each output node in the input
        `image`. here: offset of each output node in its image. out, positive, skip: as for `_convolution`.
        """
        rows, columns, channels, features = kernel.shape
        every = _whole(features) // WIDTH
        # The first row has the bias, and each other row has the weights of a tap and channel. A row has all features.
        wide = np.zeros((1 + rows * columns * image.numbers, every, WIDTH), np.float32)
        wide[0].ravel()[:features] = self._of[name][1]
        wide[1:].reshape(rows, columns, image.numbers, -1)[:, :, :channels, :features] = kernel
        # If the last block of `WIDTH` nodes is not full, its remaining entries compute the last node again.
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
    """Return whether a network has the layers of `architectures.far_field`. weights: layer -> [kernel, bias]."""
    shapes = {name: [array.shape for array in arrays] for name, arrays in weights.items() if arrays}
    first = shapes.get("to_second", [()])[0]
    return len(first) > 0 and shapes == layer_shapes(first[-1])


def _whole(count: int) -> int:
    """Return the smallest multiple of `WIDTH` that is at least `count`."""
    return -(-count // WIDTH) * WIDTH


def _aligned(size: int) -> np.ndarray:
    """Return `size` zeros, float32, whose address is that of a cache line of 64 bytes."""
    line = 64
    room = np.zeros(size + line // 4, np.float32)
    return room[(-room.ctypes.data % line) // 4 :][:size]


# The indices are unsigned. For signed ones Numba would test whether they are negative, since those count from the end.
@njit(cache=True, error_model="numpy")
def _convolve(layer, b, nodes, weights, space, zero):
    """Compute block b of a layer, `WIDTH` output nodes, and write the result into the workspace `space`.

    layer: a row of `Program.layers`. nodes, weights: tables of the `Program`. zero: a SIMD vector of zeros with as many
    lanes as a group has features, 8 or 16.
    """
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
