"""The grid, and the transfer between particles and grid images: `splat`, `density` and `gather`.

An image is a C-contiguous array of shape (n_y, n_x, channels), with row 0 at y_min. Its channels are the quantities
that the particles carry. A transfer is a splat followed by a gather with the same `normalization`:

* "raw": node j gets Σ_k W(|x_j - x_k|, h) S_k, where S_k is the value of particle k (Algorithms 2 and 3). With values
  V_k S_k, where V_k is the particle's volume, this is Eq 3.6.
* "particle": the weights of every particle are divided by their sum over the nodes (Appendix A). So the sum of an image
  is the sum of the values. If h is the spacing and the image is read back bilinearly (Algorithm 4), as in the thesis,
  an isolated particle gets back between a quarter and all of its value.
* "consistent": the splat gives the same image as with "particle". The gather divides by the gathered density image D,
  which is the splat of ones. So an isolated particle gets back its exact value, and a constant field comes back
  exactly. D depends on positions alone.

The loops visit only the nodes at a distance r < h from a particle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from deep_contact.compiled import njit
from deep_contact.sph.kernels import as_floats, check_support_radius, kernel_number, profile
from deep_contact.state.validation import expect, integer, number, one_of, refuse_where, several

ROUNDING = 1e-9
"""Tolerance for rounding, in spacings. A point that lies at most this far beyond the last node counts as a point of the
grid. An extent that exceeds a whole number of spacings by at most this tolerance counts as that whole number."""

_MOST_NODES = 2**31 - 1
_OPTIONS = {
    "normalization": {"raw": 0, "particle": 1, "consistent": 2},
    "method": {"bilinear": 0, "sph": 1},
    "unreached": {"error": 0, "zero": 1, "nearest": 2},
    "outside": {"error": 0, "clamp": 1},
}
"""Option of `splat` or `gather` -> name of each choice -> the integer that stands for the choice in compiled code."""

_RAW, _CONSISTENT, _SPH, _CLAMP = 0, 2, 1, 1
_ZERO, _NEAREST = 1, 2
_DONE, _BAD_RESULT, _IS_OUTSIDE, _IS_UNREACHED = range(4)
_NO_DENSITY = np.empty((0, 0))


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A rectilinear grid of nodes. Node (row j, column i) lies at (x0 + i dx, y0 + j dy).

    origin: (x0, y0), the position of the first node, m. spacing: (dx, dy), or one number for both, > 0, m.
    shape: (n_y, n_x), the numbers of nodes along y and x, at least 2 each. Raises ValueError naming the field and the
    value.
    """

    origin: tuple[float, float]
    spacing: tuple[float, float]
    shape: tuple[int, int]

    def __post_init__(self):
        origin, spacing = several("origin", self.origin, 2), _spacing(self.spacing)
        nodes = partial(integer, least=2, most=_MOST_NODES)
        shape = several("shape", self.shape, 2, check=nodes, expected="integers >= 2, (n_y, n_x)")
        for x, d, n in zip(origin, spacing, reversed(shape)):
            if not x + d * (n - 2) < x + d * (n - 1) < math.inf or not x < x + d:
                raise ValueError(f"spacing: expected nodes that differ, got {spacing} at the origin {origin}")
        vars(self).update(origin=origin, spacing=spacing, shape=shape)  # a frozen dataclass forbids assignments

    @classmethod
    def over_box(cls, box, spacing) -> Grid:
        """Return the smallest grid that begins at the lower left corner of a box and covers the box.

        box: (x_min, y_min, x_max, y_max), m. spacing: (dx, dy), or one number for both, m. If the spacing does not
        divide the extent, the last nodes lie beyond the box. An extent of 30 m and a spacing of 0.5 m give 61 nodes,
        the last at 30 m. A spacing of 0.7 m gives 44 nodes, the last at 30.1 m. Raises ValueError naming the argument
        and the value.
        """
        x_min, y_min, x_max, y_max = several("box", box, 4)
        fits = x_min < x_max and y_min < y_max and math.isfinite(x_max - x_min + y_max - y_min)
        expect(fits, f"box: expected (x_min, y_min, x_max, y_max) of finite extent > 0, got {box}")
        dx, dy = _spacing(spacing)
        cells = (y_max - y_min) / dy, (x_max - x_min) / dx
        expect(max(cells) < _MOST_NODES, f"spacing: expected at most {_MOST_NODES} nodes along an edge, got {spacing}")
        shape = tuple(max(math.ceil(n - ROUNDING), 1) + 1 for n in cells)
        return cls(origin=(x_min, y_min), spacing=(dx, dy), shape=shape)

    @property
    def _geometry(self) -> tuple[float, float, float, float]:
        """The first node's position and the spacings, (x0, y0, dx, dy), m, as compiled code takes them."""
        return self.origin + self.spacing

    @property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """The x coordinates of the columns of nodes, (n_x,), and the y coordinates of the rows, (n_y,), m."""
        (x, y), (dx, dy), (n_y, n_x) = self.origin, self.spacing, self.shape
        return x + dx * np.arange(n_x), y + dy * np.arange(n_y)

    @property
    def box(self) -> tuple[float, float, float, float]:
        """The rectangle that the nodes span, (x_min, y_min, x_max, y_max), m."""
        (x, y), (dx, dy), (n_y, n_x) = self.origin, self.spacing, self.shape
        return x, y, x + dx * (n_x - 1), y + dy * (n_y - 1)


# ---- Numba: weights of one particle on the nodes around it ----


@njit(cache=True, error_model="numpy")
def _place(x, first, spacing, count, outside):
    """Return the coordinate x of a particle along one axis, m, and whether it lies on the grid.

    If x lies outside the grid and `outside` is the number of "clamp", the nearest coordinate of the grid is returned.
    first, spacing, count: coordinate of the first node, m, distance of neighbouring nodes, m, and number of nodes.
    """
    on = -ROUNDING <= (x - first) / spacing <= count - 1 + ROUNDING
    if not on and outside == _CLAMP:
        return min(max(x, first), first + spacing * (count - 1)), True
    return x, on


@njit(cache=True, error_model="numpy")
def _reach(x, first, spacing, count, h):
    """Return the half-open range of the nodes along one axis whose distance from x may be less than h.

    first, spacing, count: as for `_place`. The range may contain nodes that are farther away.
    """
    u, reach = (x - first) / spacing, h / spacing + ROUNDING
    # The bounds are clamped as floats, because h over the spacing may exceed the largest integer.
    return int(max(math.ceil(u - reach), 0.0)), int(min(math.floor(u + reach), count - 1.0)) + 1


@njit(cache=True, error_model="numpy")
def _kernel_weights(geometry, n_y, n_x, x, y, h, kernel, weights):
    """Write the weights h² W(r, h) of the nodes around (x, y) into `weights`, row by row.

    geometry: `Grid._geometry`. x, y: position of the particle, m. h: support radius, m. kernel: number of the kernel.
    Returns (i0, i1, j0, j1, total): the half-open ranges of columns i and rows j, and the sum of the weights.
    """
    x0, y0, dx, dy = geometry
    i0, i1 = _reach(x, x0, dx, n_x, h)
    j0, j1 = _reach(y, y0, dy, n_y, h)
    total, n = 0.0, 0
    for j in range(j0, j1):
        q_y = (y - (y0 + dy * j)) / h
        for i in range(i0, i1):
            q_x = (x - (x0 + dx * i)) / h
            w = profile(kernel, math.sqrt(q_x * q_x + q_y * q_y), 2)[0]
            weights[n] = w
            total += w
            n += 1
    return i0, i1, j0, j1, total


@njit(cache=True, error_model="numpy")
def bilinear_weights(geometry, n_y, n_x, x, y, weights):
    """Write the bilinear weights of the four corners of the cell around (x, y) into `weights`, Eq 3.16.

    The order of the corners is lower left, lower right, upper left, upper right. For a point outside the grid, the
    nearest point of the grid is taken. Returns (i0, i1, j0, j1, total) like `_kernel_weights`; the total is 1.
    geometry: `Grid._geometry`. n_y, n_x: numbers of nodes along y and x.
    """
    x0, y0, dx, dy = geometry
    u, v = min(max((x - x0) / dx, 0.0), n_x - 1.0), min(max((y - y0) / dy, 0.0), n_y - 1.0)
    i, j = min(int(u), n_x - 2), min(int(v), n_y - 2)
    s, t = u - i, v - j
    weights[0], weights[1] = (1.0 - s) * (1.0 - t), s * (1.0 - t)
    weights[2], weights[3] = (1.0 - s) * t, s * t
    return i, i + 2, j, j + 2, 1.0


@njit(cache=True, error_model="numpy")
def _nearest_weight(geometry, n_y, n_x, x, y, weights):
    """Write the weight 1 of the node nearest to (x, y) into `weights`.

    Returns (i0, i1, j0, j1, total) like `_kernel_weights`, for this node alone.
    """
    x0, y0, dx, dy = geometry
    i = int(min(max(math.floor((x - x0) / dx + 0.5), 0.0), n_x - 1.0))
    j = int(min(max(math.floor((y - y0) / dy + 0.5), 0.0), n_y - 1.0))
    weights[0] = 1.0
    return i, i + 1, j, j + 1, 1.0


@njit(cache=True, error_model="numpy")
def _most_nodes(geometry, n_y, n_x, h):
    """Return an upper bound on the number of nodes within the distance h of a particle, at least 4.

    The 4 are the corners of a cell, which bilinear reading needs.
    """
    across = min(2.0 * (h / geometry[2] + ROUNDING) + 2.0, float(n_x))
    along = min(2.0 * (h / geometry[3] + ROUNDING) + 2.0, float(n_y))
    return max(int(across) * int(along), 4)


# ---- Numba: the transfers ----
# Each function returns a code and the index of the particle at which the code arose. Unless the code is _DONE, the
# loop stopped there and the output is incomplete. The callers have checked that all input is finite.


@njit(cache=True, error_model="numpy")
def _splat_core(geometry, position, values, h, kernel, normalization, unreached, outside, image):
    """Add Σ_k w_jk S_k to every node j of `image`, in place (Algorithms 2 and 3). w_jk: weight of particle k at node j.

    geometry: `Grid._geometry`. position: particles, (k, 2), m. values: S, (k, c). h: support radius, m. kernel: number
    of the kernel. normalization, unreached, outside: integers of `_OPTIONS`. image: (n_y, n_x, c).
    """
    n_y, n_x, channels = image.shape
    weights = np.empty(_most_nodes(geometry, n_y, n_x, h))
    for k in range(position.shape[0]):
        x, in_x = _place(position[k, 0], geometry[0], geometry[2], n_x, outside)
        y, in_y = _place(position[k, 1], geometry[1], geometry[3], n_y, outside)
        if not (in_x and in_y):
            return _IS_OUTSIDE, k
        i0, i1, j0, j1, total = _kernel_weights(geometry, n_y, n_x, x, y, h, kernel, weights)
        if total > 0.0:
            factor = 1.0 / (h * h) if normalization == _RAW else 1.0 / total
        else:
            if unreached == _ZERO:
                continue
            if unreached != _NEAREST:
                return _IS_UNREACHED, k
            i0, i1, j0, j1, total = _nearest_weight(geometry, n_y, n_x, x, y, weights)
            # The raw weights of a particle, times the area of a cell, sum to about 1. This weight keeps that sum.
            factor = 1.0 / (geometry[2] * geometry[3]) if normalization == _RAW else 1.0
        n = 0
        for j in range(j0, j1):
            for i in range(i0, i1):
                w = weights[n] * factor
                n += 1
                for c in range(channels):
                    image[j, i, c] += w * values[k, c]
    return _DONE, 0


@njit(cache=True, error_model="numpy")
def _density_at(weights, density, i0, i1, j0, j1, total):
    """Return Σ_j w_j D_j over the columns i0 to i1 − 1 and the rows j0 to j1 − 1.

    weights: w, row by row. density: D, (n_y, n_x). If `density` is empty, D = 1, and `total` = Σ_j w_j is returned.
    """
    if density.shape[0] == 0:
        return total
    total, n = 0.0, 0
    for j in range(j0, j1):
        for i in range(i0, i1):
            total += weights[n] * density[j, i]
            n += 1
    return total


@njit(cache=True, error_model="numpy")
def _gather_core(geometry, image, density, position, h, kernel, method, unreached, outside, out):
    """Write Σ_j w_j G_j / Σ_j w_j D_j at every position into `out`, where G is the image.

    With bilinear weights and D = 1 this is Algorithm 4. geometry: `Grid._geometry`. image: G, (n_y, n_x, c). density:
    D, (n_y, n_x), or empty for D = 1. position: (k, 2), m. h: support radius, m. kernel: number of the kernel.
    method, unreached, outside: integers of `_OPTIONS`. out: (k, c). If a result is not finite, the loop stops and
    returns the code _BAD_RESULT.
    """
    n_y, n_x, channels = image.shape
    weights = np.empty(_most_nodes(geometry, n_y, n_x, h if method == _SPH else 0.0))
    for k in range(position.shape[0]):
        out[k] = 0.0
        x, in_x = _place(position[k, 0], geometry[0], geometry[2], n_x, outside)
        y, in_y = _place(position[k, 1], geometry[1], geometry[3], n_y, outside)
        if not (in_x and in_y):
            return _IS_OUTSIDE, k
        if method == _SPH:
            i0, i1, j0, j1, total = _kernel_weights(geometry, n_y, n_x, x, y, h, kernel, weights)
        else:
            i0, i1, j0, j1, total = bilinear_weights(geometry, n_y, n_x, x, y, weights)
        total = _density_at(weights, density, i0, i1, j0, j1, total)
        if not total > 0.0 and unreached == _NEAREST:
            i0, i1, j0, j1, total = _nearest_weight(geometry, n_y, n_x, x, y, weights)
            total = _density_at(weights, density, i0, i1, j0, j1, total)
        if not total > 0.0:
            if unreached == _ZERO and not math.isnan(total):
                continue
            return _BAD_RESULT if math.isnan(total) else _IS_UNREACHED, k
        n = 0
        for j in range(j0, j1):
            for i in range(i0, i1):
                for c in range(channels):
                    out[k, c] += weights[n] * image[j, i, c]
                n += 1
        for c in range(channels):
            out[k, c] /= total
            if not math.isfinite(out[k, c]):
                return _BAD_RESULT, k
    return _DONE, 0


# ---- what users call ----


def splat(
    grid: Grid,
    position,
    values,
    *,
    h: float,
    kernel: str = "poly6",
    normalization: str = "raw",
    unreached: str = "error",
    outside: str = "error",
) -> np.ndarray:
    """Return the image of the particles' values, float64, (n_y, n_x, c), or (n_y, n_x) for values of shape (k,).

    position: particles, (k, 2), m. values: (k, c) or (k,). h: support radius, m. kernel: one of `KERNELS`, in two
    dimensions.
    normalization: "raw", "particle" or "consistent", as the module's docstring defines them. "consistent" gives the
    same image as "particle".
    unreached: treatment of a particle with no node within h. "error" raises ValueError. With "zero" the particle adds
    nothing. With "nearest" its value goes to the nearest node, with the weight 1, or 1 / (dx dy) if raw.
    outside: treatment of a particle outside the grid. "error" raises ValueError. "clamp" moves the particle to the
    nearest point of the grid. Contact points at a wall need "clamp": they lie beyond the wall by half of the
    penetration.

    Raises ValueError naming the argument, what was expected and the value.
    """
    chosen, h = kernel_number(kernel), check_support_radius(h)
    codes = _code("normalization", normalization), _code("unreached", unreached), _code("outside", outside)
    position = positions(position)
    samples = _finite("values", as_floats("values", values))
    columns = samples.reshape(-1, 1) if samples.ndim == 1 else samples
    if columns.ndim != 2 or columns.shape[0] != position.shape[0]:
        raise ValueError(f"values: expected shape ({position.shape[0]}, channels), got {samples.shape}")
    image = np.zeros((*grid.shape, columns.shape[1]))
    _raise_unless_done(*_splat_core(grid._geometry, position, columns, h, chosen, *codes, image), grid, position, h)
    return image if samples.ndim == 2 else image.reshape(grid.shape)


def density(
    grid: Grid, position, *, h: float, kernel: str = "poly6", unreached: str = "error", outside: str = "error"
) -> np.ndarray:
    """Return the density image D_j = Σ_k w_jk, (n_y, n_x): the splat of ones with the normalization "particle".

    The arguments and the errors are those of `splat`.
    """
    options = {"normalization": "consistent", "unreached": unreached, "outside": outside}
    return splat(grid, position, np.ones(len(position)), h=h, kernel=kernel, **options)


def gather(
    grid: Grid,
    image,
    position,
    *,
    normalization: str = "raw",
    density: np.ndarray | None = None,
    method: str = "bilinear",
    h: float | None = None,
    kernel: str = "poly6",
    unreached: str = "error",
    outside: str = "error",
) -> np.ndarray:
    """Return the values of an image at some points, float64, (k, c), or (k,) for an image of shape (n_y, n_x).

    position: points at which the image is read, (k, 2), m. image: (n_y, n_x, c) or (n_y, n_x), from any source, such as
    a network.
    normalization: "raw" and "particle" read the image as it is. "consistent" divides by the gathered density.
    density: the density image D of `sph.density`, (n_y, n_x), for "consistent" only. If it is None, `position` has to
    hold the particles that were splatted. D is then computed from them, with h and kernel.
    method: "bilinear" is Algorithm 4 with the matrix of Eq 3.16, which Algorithm 4 prints transposed. "sph" is the mean
    of the nodes within h, weighted by W. This mean is the adjoint of the splat with the normalization "particle".
    h, kernel: as for `splat`. h may be None with the method "bilinear", unless D has to be computed.
    unreached: treatment of a point with no node within h (method "sph") or with no density around it ("consistent").
    "error" raises ValueError. With "zero" the value is 0. With "nearest" the value is that of the nearest node over the
    node's density, and a density of 0 there raises ValueError.
    outside: treatment of a point outside the grid. "error" raises ValueError. "clamp" reads the nearest point of the
    grid.

    Raises ValueError naming the argument, what was expected and the value, also if a result is not finite.
    """
    chosen, consistent = kernel_number(kernel), _code("normalization", normalization) == _CONSISTENT
    codes = _code("method", method), _code("unreached", unreached), _code("outside", outside)
    if h is not None:
        h = check_support_radius(h)
    elif method == "sph" or (consistent and density is None):
        raise ValueError("h: expected the support radius, for method 'sph' or to make the density, got None")
    position = positions(position)
    layers = image_of(grid, image)
    if not consistent:
        expect(density is None, f"density: only for the normalization 'consistent', not {normalization!r}")
        divisor = _NO_DENSITY
    elif density is None:
        options = {"normalization": normalization, "unreached": unreached, "outside": outside}
        divisor = splat(grid, position, np.ones(len(position)), h=h, kernel=kernel, **options)
    else:
        divisor = as_floats("density", density)
        expect(divisor.shape == grid.shape, f"density: expected shape {grid.shape}, got {divisor.shape}")
    out = np.empty((position.shape[0], layers.shape[2]))
    done = _gather_core(grid._geometry, layers, divisor, position, h or 0.0, chosen, *codes, out)
    _raise_unless_done(*done, grid, position, h)
    return out if np.ndim(image) == 3 else out.reshape(-1)


def _spacing(lengths):
    both = (lengths,) * 2 if np.ndim(lengths) == 0 else lengths
    return several("spacing", both, 2, check=partial(number, above=0), expected="finite numbers > 0")


def image_of(grid: Grid, pixels) -> np.ndarray:
    """Return an image as an array (n_y, n_x, c), float64.

    pixels: (n_y, n_x, c), or (n_y, n_x) for one channel. Raises ValueError unless n_y and n_x are those of the grid.
    """
    image = as_floats("image", pixels)
    if image.ndim not in (2, 3) or image.shape[:2] != grid.shape:
        raise ValueError(f"image: expected shape {(*grid.shape, 'channels')}, got {image.shape}")
    return image if image.ndim == 3 else image.reshape(*grid.shape, 1)


def positions(points) -> np.ndarray:
    """Return points as an array (k, 2), float64, m. Raises ValueError for other shapes and for numbers not finite."""
    position = as_floats("position", points)
    if position.size == 0 and position.ndim == 1:
        position = position.reshape(0, 2)
    expect(position.ndim == 2 and position.shape[1] == 2, f"position: expected shape (k, 2), got {position.shape}")
    return _finite("position", position)


def _finite(name: str, array: np.ndarray) -> np.ndarray:
    """Return the array unchanged. Raises ValueError naming the first of its numbers that is not finite."""
    refuse_where(~np.isfinite(array), name, array, "a finite number")
    return array


def _code(name, choice):
    """Return the integer of a choice of the option `name` in `_OPTIONS`. Raises ValueError for an unknown choice."""
    return _OPTIONS[name][one_of(name, choice, _OPTIONS[name])]


def _raise_unless_done(code, k, grid, position, h) -> None:
    """Raise the ValueError for a code that `_splat_core` or `_gather_core` returned, unless the code is _DONE.

    k: index of the particle at which the code arose. position: all particles, (k, 2), m. h: support radius, m, or None.
    """
    if code == _DONE:
        return
    at = f"({position[k, 0]}, {position[k, 1]})"
    if code == _BAD_RESULT:
        raise ValueError(f"image, density: expected finite numbers around position[{k}] = {at}")
    if code == _IS_OUTSIDE:
        expected, hint = f"a point of the grid {grid.box}, got {at}", "outside='clamp' allows for it"
    else:
        expected = f"a node, or density, within reach, got {at} at h = {h}, spacing {grid.spacing}"
        hint = "unreached='zero' or 'nearest' allow for it"
    raise ValueError(f"position[{k}]: expected {expected}; {hint}")
