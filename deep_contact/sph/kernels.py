"""Smoothing kernels: value W(r, h), radial derivative, gradient and Laplacian, in two and three dimensions.

A kernel is one function. It takes q = r/h and the dimension, and returns W, W' and W'' for the support radius h = 1.
The integral of W is 1. All kernels share the code for other h, the gradient's direction, the Laplacian, r = 0 and
r >= h.

For every kernel:

* The support is open: W, W' and the Laplacian are 0 for r >= h. At r = h, all kernels but the Gaussian go to 0
  continuously, with both derivatives.
* At r = 0 the gradient is the zero vector. The slope of the spiky kernel at r = 0 depends on the direction, and the
  zero vector is the mean over all directions.
* At r = 0 the Laplacian is its limit for r -> 0: dim·W''(0) if W'(0) = 0, and -inf for the spiky kernel.
* For other h, W(r, h) = W(r/h, 1) / h^dim.
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.validation import brief, expect, number, one_of, real_numbers, refuse_where

GAUSSIAN_DECAY = 9.0
"""The Gaussian is exp(-9 q²): the support radius h is 3 √2 standard deviations, σ = 0.2357 h."""

_AT_EDGE = math.exp(-GAUSSIAN_DECAY)
_GAUSSIAN_2D = GAUSSIAN_DECAY / (math.pi * (1.0 - _AT_EDGE))
_WHOLE = math.sqrt(math.pi) * math.erf(math.sqrt(GAUSSIAN_DECAY)) / GAUSSIAN_DECAY**1.5
_GAUSSIAN_3D = 1.0 / (math.pi * (_WHOLE - 2.0 * _AT_EDGE / GAUSSIAN_DECAY))

_SMALLEST_H = 1e-50
"""Smallest support radius h that is accepted, m. The powers of smaller h would leave the range of floats."""

_LARGEST_H = 1e50
"""Largest support radius h that is accepted, m. The powers of larger h would leave the range of floats."""


@njit(cache=True, error_model="numpy")
def poly6(q, dim):
    """Return W, W', W'' of W = c (1 - q²)³, for h = 1 and q = r/h < 1.

    Sources: Müller, Charypar and Gross 2003; thesis Eq 3.8 (dim = 3) and Appendix A (dim = 2).
    """
    c = 4.0 / math.pi if dim == 2 else 315.0 / (64.0 * math.pi)
    s = (1.0 - q) * (1.0 + q)
    return c * s**3, -6.0 * c * q * s**2, 6.0 * c * s * (5.0 * q**2 - 1.0)


@njit(cache=True, error_model="numpy")
def spiky(q, dim):
    """Return W, W', W'' of W = c (1 - q)³, for h = 1 and q = r/h < 1.

    Sources: Desbrun and Gascuel 1996; thesis Eq 3.11 (dim = 3).
    """
    c = 10.0 / math.pi if dim == 2 else 15.0 / math.pi
    p = 1.0 - q
    return c * p**3, -3.0 * c * p**2, 6.0 * c * p


@njit(cache=True, error_model="numpy")
def cubic_spline(q, dim):
    """Return W, W', W'' of Schoenberg's M4 spline with knots at q = 1/2 and q = 1, for h = 1 and q = r/h < 1.

    Source: Monaghan and Lattanzio 1985.
    """
    c = 40.0 / (7.0 * math.pi) if dim == 2 else 8.0 / math.pi
    if q < 0.5:
        return c * (1.0 - 6.0 * q**2 * (1.0 - q)), c * q * (18.0 * q - 12.0), c * (36.0 * q - 12.0)
    p = 1.0 - q
    return 2.0 * c * p**3, -6.0 * c * p**2, 12.0 * c * p


@njit(cache=True, error_model="numpy")
def wendland_c2(q, dim):
    """Return W, W', W'' of W = c (1 - q)⁴ (1 + 4q), for h = 1 and q = r/h < 1.

    Source: Wendland 1995, ψ₃,₁. The function is positive definite up to dim = 3.
    """
    c = 7.0 / math.pi if dim == 2 else 21.0 / (2.0 * math.pi)
    p = 1.0 - q
    return c * p**4 * (1.0 + 4.0 * q), -20.0 * c * q * p**3, 20.0 * c * p**2 * (4.0 * q - 1.0)


@njit(cache=True, error_model="numpy")
def gaussian(q, dim):
    """Return W, W', W'' of W = c exp(-9 q²), truncated at q = 1, for h = 1 and q = r/h < 1.

    c is such that the truncated kernel has a unit integral. At q = 1, W drops from exp(-9) = 1.2e-4 of its peak to 0.
    The derivatives leave this jump out.
    """
    c = _GAUSSIAN_2D if dim == 2 else _GAUSSIAN_3D
    a = 2.0 * GAUSSIAN_DECAY
    w = c * math.exp(-GAUSSIAN_DECAY * q**2)
    return w, -a * q * w, a * (a * q**2 - 1.0) * w


KERNELS = ["poly6", "spiky", "cubic_spline", "wendland_c2", "gaussian"]
"""Names of the kernels. The index of a name in this list is the number of its kernel in compiled code."""


@njit(cache=True, error_model="numpy")
def profile(kernel, q, dim):
    """Return (W, W', W'') of a kernel for h = 1 at q = r/h >= 0. All three are 0 for q >= 1.

    kernel: index of the kernel in `KERNELS`. dim: 2 or 3.
    """
    if q >= 1.0:
        return 0.0, 0.0, 0.0
    # A chain of ifs, because Numba would compile a function that is passed as an argument anew in every process.
    if kernel == 0:
        return poly6(q, dim)
    if kernel == 1:
        return spiky(q, dim)
    if kernel == 2:
        return cubic_spline(q, dim)
    if kernel == 3:
        return wendland_c2(q, dim)
    return gaussian(q, dim)


@njit(cache=True, error_model="numpy")
def _evaluate(order, kernel, r, h, dim, out):
    """Write W (order 0), dW/dr (order 1) or ∇²W = W'' + (dim - 1) W'/r (order 2) at the distances r into `out`.

    At r = 0, dW/dr is the one-sided slope and ∇²W is the limit for r -> 0. r: distances, (k,), m. h: support radius, m.
    out: (k,), m^-(dim + order). Returns the index of the first distance that is negative or not finite, -1 if there is
    none.
    """
    for k in range(r.shape[0]):
        if not (0.0 <= r[k] < math.inf):
            return k
        q = r[k] / h
        w, first, second = profile(kernel, q, dim)
        term = w if order == 0 else first
        if order == 2:
            if q > 0.0:
                term = second + (dim - 1) * first / q
            else:
                term = dim * second if first == 0.0 else math.copysign(math.inf, first)
        out[k] = term / h ** (dim + order)
    return -1


def value(kernel: str, r, h: float, dim: int = 2):
    """Return the kernel's value W(r, h), float64, in the shape of r, m^-dim.

    kernel: one of `KERNELS`. r: distances >= 0, any shape, m. h: support radius, m. dim: number of dimensions, 2 or 3.
    Raises ValueError for an unknown kernel, h or dim, and for a distance that is negative or not finite.
    """
    return _radial(0, kernel, r, h, dim)


def derivative(kernel: str, r, h: float, dim: int = 2):
    """Return dW/dr, float64, in the shape of r, m^-(dim + 1). The arguments and the errors are those of `value`."""
    return _radial(1, kernel, r, h, dim)


def gradient(kernel: str, displacement, h: float, dim: int = 2) -> np.ndarray:
    """Return ∇W at x, the derivative with respect to x, (…, dim), m^-(dim + 1) (Eq 3.9, 3.12).

    kernel, h, dim: as for `value`. displacement: x - x_k, the vector from the particle at x_k to x, (…, dim), m.
    Raises the errors of `value`.
    """
    dim = int(one_of("dim", dim, (2, 3)))
    displacement = as_floats("displacement", displacement)
    expect(displacement.shape[-1:] == (dim,), f"displacement: expected shape (..., {dim}), got {displacement.shape}")
    refuse_where(~np.isfinite(displacement), "displacement", displacement, "a finite number")
    # Divide by the largest component first, so that no square overflows and the largest square does not underflow.
    scale = np.abs(displacement).max(axis=-1, keepdims=True)
    direction = displacement / np.where(scale > 0, scale, 1.0)
    length = np.sqrt((direction**2).sum(axis=-1, keepdims=True))
    # A distance beyond the largest float lies outside every support.
    distance = np.minimum(scale, np.finfo(np.float64).max / 2.0) * length
    direction /= np.where(length > 0, length, 1.0)
    return _radial(1, kernel, distance, h, dim) * direction + 0.0  # turns -0.0 at the centre into 0.0


def laplacian(kernel: str, r, h: float, dim: int = 2):
    """Return ∇²W = W'' + (dim - 1)/r W', float64, in the shape of r, m^-(dim + 2).

    The arguments and the errors are those of `value`. The thesis prints other formulas: its Eq 3.10 has a wrong factor,
    and its Eq 3.13 is W'' alone.
    """
    return _radial(2, kernel, r, h, dim)


def _radial(order, kernel, r, h, dim):
    chosen, h, dim = kernel_number(kernel), check_support_radius(h), int(one_of("dim", dim, (2, 3)))
    r = as_floats("r", r)
    out = np.empty_like(r)
    bad = _evaluate(order, chosen, r.reshape(-1), h, dim, out.reshape(-1))
    if bad >= 0:
        where = [int(i) for i in np.unravel_index(bad, r.shape)]
        raise ValueError(f"r{where or ''}: expected a finite distance >= 0, got {r.reshape(-1)[bad]}")
    return out if out.ndim else float(out)


def kernel_number(kernel: str) -> int:
    """Return the index of a kernel's name in `KERNELS`. Raises ValueError for an unknown name."""
    return KERNELS.index(one_of("kernel", kernel, KERNELS))


def check_support_radius(h) -> float:
    """Return the support radius h as a float, m. Raises ValueError unless it is a number from 1e-50 m to 1e50 m."""
    return number("h", h, _SMALLEST_H, _LARGEST_H)


def as_floats(name: str, array) -> np.ndarray:
    """Return numbers as a writable, C-contiguous float64 array. If `array` is such an array, it is not copied.

    A read-only array is copied, because Numba would treat it as another type and compile its functions again.
    name: name of the argument in the error message. Raises ValueError unless `array` holds real numbers.
    """
    if type(array) is np.ndarray and array.dtype == np.float64 and array.flags.carray:
        return array
    numbers = real_numbers(array)
    if numbers is None:
        raise ValueError(f"{name}: expected an array of real numbers, got {brief(array)}")
    return numbers
