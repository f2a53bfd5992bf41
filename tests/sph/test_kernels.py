"""Smoothing kernels (thesis section 3.2.2) against quadrature, finite differences, closed forms; limits of floats."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import gammainc

from deep_contact import sph
from deep_contact.sph.kernels import GAUSSIAN_DECAY

kernels = pytest.mark.parametrize("kernel", sph.KERNELS)
dims = pytest.mark.parametrize("dim", [2, 3])
H = 1.3
SPHERE = {2: 2 * math.pi, 3: 4 * math.pi}
SUBNORMAL = 5e-324

# ⟨r²⟩/h² of each kernel, in the plane and in space: ratios of Beta functions, and of incomplete Gamma functions for the
# cut Gaussian.
SECOND_MOMENT = {
    "poly6": (1 / 5, 3 / 11),
    "spiky": (1 / 7, 3 / 14),
    "cubic_spline": (31 / 196, 9 / 40),
    "wendland_c2": (5 / 36, 1 / 5),
    "gaussian": tuple(d / 18 * gammainc(d / 2 + 1, 9) / gammainc(d / 2, 9) for d in (2, 3)),
}


def radial_integral(f, dim, h=H):
    """∫ f(r) over the disc or ball of radius h, by adaptive quadrature split at the spline's knot."""
    return SPHERE[dim] * quad(lambda r: f(r) * r ** (dim - 1), 0, h, points=[h / 2], epsabs=1e-13)[0]


def off_the_knots(dim, n=40):
    """Random displacements with 0.1 h < r < 0.45 h or 0.55 h < r < 0.95 h."""
    rng = np.random.default_rng(7)
    direction = rng.normal(size=(n, dim))
    r = H * np.where(rng.random(n) < 0.5, rng.uniform(0.1, 0.45, n), rng.uniform(0.55, 0.95, n))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True) * r[:, None]


@kernels
@dims
def test_integral_is_one_and_the_second_moment_the_closed_form(kernel, dim):
    """Eq 3.2, in the plane and in space."""
    integral, moment = (radial_integral(lambda r, k=k: r**k * sph.value(kernel, r, H, dim), dim) for k in (0, 2))
    assert integral == pytest.approx(1, rel=1e-11)
    assert moment / H**2 == pytest.approx(SECOND_MOMENT[kernel][dim - 2], rel=1e-11)


@kernels
@dims
def test_derivatives_are_the_finite_differences(kernel, dim):
    """∇W of W, and ∇²W of ∇W. The gradient points along x, Eq 3.4a."""
    x, step, peak = off_the_knots(dim), 1e-5 * H, sph.value(kernel, 0, H, dim)
    gradient, laplacian = np.empty_like(x), 0.0
    for axis in range(dim):
        ahead, behind = (x + s * step * np.eye(dim)[axis] for s in (1, -1))
        values = (sph.value(kernel, np.linalg.norm(at, axis=1), H, dim) for at in (ahead, behind))
        gradient[:, axis] = np.subtract(*values) / (2 * step)
        jump = sph.gradient(kernel, ahead, H, dim) - sph.gradient(kernel, behind, H, dim)
        laplacian = laplacian + jump[:, axis] / (2 * step)
    # Central differences: (1e-5)² of truncation, 1e-16/1e-5 of rounding, times some tens for the derivatives.
    np.testing.assert_allclose(sph.gradient(kernel, x, H, dim), gradient, atol=1e-8 * peak)
    found = sph.laplacian(kernel, np.linalg.norm(x, axis=1), H, dim)
    np.testing.assert_allclose(found, laplacian, atol=1e-7 * peak)


@kernels
@dims
def test_value_is_positive_and_falls_to_zero(kernel, dim):
    """Eq 3.4b; the Gaussian documents a step of exp(-9) of its peak."""
    w = sph.value(kernel, np.linspace(0, H, 200, endpoint=False), H, dim)
    assert (w > 0).all()
    assert (np.diff(w) < 0).all()
    inside, step = H * (1 - 1e-7), math.exp(-GAUSSIAN_DECAY) if kernel == "gaussian" else 0.0
    assert sph.value(kernel, inside, H, dim) / w[0] == pytest.approx(step, abs=1e-9)
    assert kernel == "gaussian" or abs(sph.derivative(kernel, inside, H, dim)) < 1e-11


# ---- where floats end ----


@dims
def test_gradient_of_tiny_and_huge_displacements(dim):
    """Neither underflow nor overflow of the squares may lose a direction."""
    x = np.array([1e-300, -1e-300] + [0.0] * (dim - 2))
    expected = sph.derivative("spiky", 0.0, 1.0, dim) * (x / 1e-300) / math.sqrt(2)
    np.testing.assert_allclose(sph.gradient("spiky", x, 1.0, dim), expected, rtol=1e-14)
    np.testing.assert_array_equal(sph.gradient("spiky", np.full(dim, 1.7e308), 1.0, dim), 0.0)


@kernels
@dims
def test_shape_does_not_depend_on_h_from_a_millionth_to_a_million(kernel, dim):
    """W(q h, h) h^dim = W(q, 1), and one power of h more for the derivative: to a few roundings of q and the power."""
    q = np.array([0.0, 1e-9, 0.1, 0.49, 0.5, 0.51, 0.9, 0.999])
    for h in 10.0 ** np.arange(-6, 7):
        for order, function in enumerate((sph.value, sph.derivative)):
            found = function(kernel, q * h, h, dim) * h ** (dim + order)
            np.testing.assert_allclose(found, function(kernel, q, 1.0, dim), rtol=1e-11, atol=1e-13)


@kernels
@dims
@pytest.mark.parametrize("h", [1e-50, 1e-6, 1 / 3, 1.0, 1e50])
def test_the_centre_is_a_maximum_and_at_the_edge_all_is_zero(kernel, dim, h):
    np.testing.assert_array_equal(sph.gradient(kernel, np.zeros(dim), h, dim), np.zeros(dim))
    laplacian = sph.laplacian(kernel, 0.0, h, dim)
    assert laplacian < 0
    assert np.isfinite(laplacian) == (kernel != "spiky")
    for function in (sph.value, sph.derivative, sph.laplacian):
        assert function(kernel, h, h, dim) == function(kernel, np.nextafter(h, np.inf), h, dim) == 0.0
    inside = np.nextafter(h, 0.0)
    assert sph.value(kernel, inside, h, dim) >= 0.0 >= sph.derivative(kernel, inside, h, dim)


@kernels
@dims
def test_the_smallest_distances_are_the_centre(kernel, dim):
    assert sph.value(kernel, SUBNORMAL, 1.0, dim) == sph.value(kernel, 0.0, 1.0, dim)
    slope = sph.derivative(kernel, SUBNORMAL, 1.0, dim)
    towards = SUBNORMAL * np.eye(dim)[0]
    np.testing.assert_allclose(sph.gradient(kernel, towards, 1.0, dim), slope * np.eye(dim)[0], atol=1e-300)
    if kernel == "spiky":  # the full slope however near, so (dim - 1) W'(0) / r without bound
        np.testing.assert_allclose(sph.laplacian(kernel, 1e-9, 1.0, dim), (dim - 1) * slope / 1e-9, rtol=1e-6)
    else:
        near = sph.laplacian(kernel, np.array([1e-300, 1e-12, 1e-8]), 1.0, dim)
        np.testing.assert_allclose(near, sph.laplacian(kernel, 0.0, 1.0, dim), rtol=1e-6)


def test_values_have_the_shape_of_the_distances():
    assert isinstance(sph.value("poly6", 0.5, 1.0), float)
    assert sph.gradient("poly6", np.zeros((4, 5, 3)), 1.0, dim=3).shape == (4, 5, 3)


@kernels
@dims
def test_derivatives_of_a_field_are_sums_of_those_of_the_kernel(kernel, dim):
    """Eq 3.7: ∇A = Σ V_i A_i ∇W and ∇²A = Σ V_i A_i ∇²W of A = Σ V_i A_i W (Eq 3.6), at one point."""
    places, rng, step = off_the_knots(dim), np.random.default_rng(3), 1e-4 * H
    values, volumes, axes = rng.normal(size=len(places)), rng.uniform(0.5, 1.5, len(places)), step * np.eye(dim)

    def field(x):
        return np.sum(volumes * values * sph.value(kernel, np.linalg.norm(x - places, axis=1), H, dim))

    here = np.zeros(dim)
    ahead, behind = np.array([field(here + axis) for axis in axes]), np.array([field(here - axis) for axis in axes])
    gradient = (volumes * values) @ sph.gradient(kernel, here - places, H, dim)
    np.testing.assert_allclose(gradient, (ahead - behind) / (2 * step), atol=1e-6 * abs(gradient).max())
    laplacian = np.sum(volumes * values * sph.laplacian(kernel, np.linalg.norm(here - places, axis=1), H, dim))
    second = (ahead - 2 * field(here) + behind).sum() / step**2
    assert laplacian == pytest.approx(second, rel=1e-4, abs=1e-4)
