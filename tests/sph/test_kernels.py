"""Smoothing kernels against quadrature, finite differences and closed forms (thesis section 3.2.2)."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import gammainc

from deep_contact import sph
from deep_contact.sph.kernels import GAUSSIAN_DECAY

kernels = pytest.mark.parametrize("kernel", sph.KERNELS)
dims = pytest.mark.parametrize("dim", [2, 3])
H = 1.3
SPHERE = {2: 2 * math.pi, 3: 4 * math.pi}

# ⟨r²⟩/h² of each kernel: ratios of Beta functions, and of incomplete Gamma functions for the cut Gaussian.
SECOND_MOMENT = {
    ("poly6", 2): 1 / 5,
    ("poly6", 3): 3 / 11,
    ("spiky", 2): 1 / 7,
    ("spiky", 3): 3 / 14,
    ("cubic_spline", 2): 31 / 196,
    ("cubic_spline", 3): 9 / 40,
    ("wendland_c2", 2): 5 / 36,
    ("wendland_c2", 3): 1 / 5,
    **{("gaussian", d): d / 18 * gammainc(d / 2 + 1, 9) / gammainc(d / 2, 9) for d in (2, 3)},
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
def test_integral_is_one(kernel, dim):
    """Eq 3.2, in the plane and in space."""
    assert radial_integral(lambda r: sph.value(kernel, r, H, dim), dim) == pytest.approx(1, rel=1e-11)


@kernels
def test_first_moment_vanishes_and_the_sum_over_a_fine_lattice_is_one(kernel):
    """∫ W dx = 1 and ∫ x W dx = 0 by the midpoint rule of Eq 3.5; the lattice knows nothing of r."""
    s = H * (np.arange(400) - 199.5) / 200
    x, y = np.meshgrid(s, s)
    w = sph.value(kernel, np.hypot(x, y), H) * (H / 200) ** 2
    # Midpoint rule: second order in 1/200; the Gaussian's small step at r = h is felt in first order.
    assert w.sum() == pytest.approx(1, abs=1e-4)
    assert abs((x * w).sum()) < 1e-13


@pytest.mark.parametrize(("kernel", "dim"), SECOND_MOMENT)
def test_second_moment_is_the_closed_form(kernel, dim):
    moment = radial_integral(lambda r: r**2 * sph.value(kernel, r, H, dim), dim)
    assert moment / H**2 == pytest.approx(SECOND_MOMENT[kernel, dim], rel=1e-11)


@kernels
@dims
def test_gradient_is_the_finite_difference_of_the_value(kernel, dim):
    x, step = off_the_knots(dim), 1e-5 * H
    numeric = np.empty_like(x)
    for axis in range(dim):
        e = step * np.eye(dim)[axis]
        ahead, behind = (sph.value(kernel, np.linalg.norm(x + s * e, axis=1), H, dim) for s in (1, -1))
        numeric[:, axis] = (ahead - behind) / (2 * step)
    # Central differences: (1e-5)² of truncation, 1e-16/1e-5 of rounding, times some tens for the derivatives.
    peak = sph.value(kernel, 0, H, dim)
    np.testing.assert_allclose(sph.gradient(kernel, x, H, dim), numeric, atol=1e-8 * peak)


@kernels
@dims
def test_laplacian_is_the_divergence_of_the_gradient(kernel, dim):
    x, step = off_the_knots(dim), 1e-5 * H
    numeric = 0.0
    for axis in range(dim):
        e = step * np.eye(dim)[axis]
        jump = sph.gradient(kernel, x + e, H, dim) - sph.gradient(kernel, x - e, H, dim)
        numeric = numeric + jump[:, axis] / (2 * step)
    laplacian = sph.laplacian(kernel, np.linalg.norm(x, axis=1), H, dim)
    np.testing.assert_allclose(laplacian, numeric, atol=1e-7 * sph.value(kernel, 0, H, dim))


@pytest.mark.parametrize(("kernel", "thesis"), [("poly6", 315 / (64 * math.pi)), ("spiky", 15 / math.pi)])
def test_constants_of_equations_3_8_and_3_11_hold_in_space_only(kernel, thesis):
    """Erratum: the thesis uses its 3-D constants on the plane (also Appendix A for spiky)."""
    plane = {"poly6": 4 / math.pi, "spiky": 10 / math.pi}[kernel]
    assert sph.value(kernel, 0.0, 1.0, dim=3) == pytest.approx(thesis, rel=1e-15)
    assert sph.value(kernel, 0.0, 1.0) == pytest.approx(plane, rel=1e-15)
    shape = radial_integral(lambda r: sph.value(kernel, r, 1.0) / plane, 2, h=1.0)
    assert plane * shape == pytest.approx(1, rel=1e-11)
    assert thesis * shape > 1.2


@pytest.mark.parametrize("h", [1.0, 0.5, 2.0])
def test_poly6_laplacian_has_half_the_factor_of_equation_3_10(h):
    """Erratum: −945/(32πh⁹), not −945/(16πh⁹), in space; 48/(πh⁸)(h²−r²)(3r²−h²) in the plane."""
    r = h * np.array([0.0, 0.2, 0.5, 0.9])
    thesis = -945 / (16 * math.pi * h**9) * (h**2 - r**2) * (3 * h**2 - 7 * r**2)
    plane = 48 / (math.pi * h**8) * (h**2 - r**2) * (3 * r**2 - h**2)
    np.testing.assert_allclose(sph.laplacian("poly6", r, h, dim=3), thesis / 2, rtol=1e-12)
    np.testing.assert_allclose(sph.laplacian("poly6", r, h), plane, rtol=1e-12)


@pytest.mark.parametrize("h", [1.0, 0.5, 2.0])
def test_spiky_laplacian_is_not_equation_3_13(h):
    """Erratum: that is W'' alone; −90/(πh⁶)(h−r)(h−2r)/r in space, 30/(πh⁵)(h−r)(3r−h)/r in the plane."""
    r = h * np.array([0.1, 0.2, 0.6, 0.9])
    space = -90 / (math.pi * h**6) * (h - r) * (h - 2 * r) / r
    plane = 30 / (math.pi * h**5) * (h - r) * (3 * r - h) / r
    np.testing.assert_allclose(sph.laplacian("spiky", r, h, dim=3), space, rtol=1e-12)
    np.testing.assert_allclose(sph.laplacian("spiky", r, h), plane, rtol=1e-12)
    thesis = 90 / (math.pi * h**6) * (h - r)
    assert (np.abs(thesis - space) > 0.1 * np.abs(space)).all()


def test_equations_3_9_and_3_12_hold_in_space():
    x = off_the_knots(3)
    r = np.linalg.norm(x, axis=1, keepdims=True)
    poly6 = -945 / (32 * math.pi * H**9) * x * (H**2 - r**2) ** 2
    spiky = -45 / (math.pi * H**6) * x / r * (H - r) ** 2
    np.testing.assert_allclose(sph.gradient("poly6", x, H, dim=3), poly6, rtol=1e-12)
    np.testing.assert_allclose(sph.gradient("spiky", x, H, dim=3), spiky, rtol=1e-12)


@kernels
def test_value_and_gradient_go_to_zero_continuously(kernel):
    """All but the Gaussian, which documents a step of exp(-9) of its peak."""
    step = math.exp(-GAUSSIAN_DECAY) if kernel == "gaussian" else 0.0
    inside = H * (1 - 1e-7)
    assert sph.value(kernel, inside, H) / sph.value(kernel, 0, H) == pytest.approx(step, abs=1e-9)
    if kernel != "gaussian":
        assert abs(sph.derivative(kernel, inside, H)) < 1e-11


@dims
@pytest.mark.parametrize("order", ["value", "derivative", "laplacian"])
def test_cubic_spline_joins_at_its_knot(order, dim):
    """M4 is twice continuously differentiable."""
    function = getattr(sph, order)
    below, above = (function("cubic_spline", H / 2 * (1 + s * 1e-12), H, dim) for s in (-1, 1))
    # 1e-12 to either side of the knot, times the next derivative, some hundreds of the peak.
    assert below == pytest.approx(above, abs=1e-9 * sph.value("cubic_spline", 0, H, dim))


@kernels
@dims
def test_value_is_positive_and_falls_with_distance(kernel, dim):
    """Eq 3.4b."""
    w = sph.value(kernel, np.linspace(0, H, 200, endpoint=False), H, dim)
    assert (w > 0).all()
    assert (np.diff(w) < 0).all()


@dims
def test_gradient_of_tiny_and_huge_displacements(dim):
    """Neither underflow nor overflow of the squares may lose a direction."""
    x = np.array([1e-300, -1e-300] + [0.0] * (dim - 2))
    expected = sph.derivative("spiky", 0.0, 1.0, dim) * (x / 1e-300) / math.sqrt(2)
    np.testing.assert_allclose(sph.gradient("spiky", x, 1.0, dim), expected, rtol=1e-14)
    np.testing.assert_array_equal(sph.gradient("spiky", np.full(dim, 1.7e308), 1.0, dim), 0.0)


@given(st.sampled_from(sph.KERNELS), st.floats(1e-200, 2), st.floats(0, 2 * math.pi), st.sampled_from([2, 3]))
def test_gradient_turns_with_its_argument(kernel, r, angle, dim):
    """Eq 3.4a: W depends on the distance alone, so ∇W points along x with the length |dW/dr|."""
    x = np.zeros(dim)
    x[-2:] = r * math.cos(angle), r * math.sin(angle)
    gradient = sph.gradient(kernel, x, 1.0, dim)
    radial = sph.derivative(kernel, r, 1.0, dim)
    expected = radial * np.array([math.cos(angle), math.sin(angle)])
    # 1e-9: next to r = h, and at the Gaussian's step, a rounding of r decides.
    if abs(r - 1) > 1e-9:
        np.testing.assert_allclose(gradient[-2:], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("poly7", 0.5, 1.0), "kernel: expected one of poly6.*'poly7'"),
        (("poly6", 0.5, 0.0), "h: expected a number from 1e-50 to 1e.50, got 0.0"),
        (("poly6", 0.5, -1.0), "h: .*-1.0"),
        (("poly6", 0.5, math.nan), "h: .*nan"),
        (("poly6", 0.5, math.inf), "h: .*inf"),
        (("poly6", 0.5, "1"), "h: .*'1'"),
        (("poly6", 0.5, 1.0, 1), "dim: expected one of 2, 3, got 1"),
        (("poly6", [0.5, math.nan], 1.0), r"r\[1\]: .*nan"),
        (("poly6", [[0.5], [-0.1]], 1.0), r"r\[1, 0\]: .*-0.1"),
        (("poly6", math.inf, 1.0), "r: .*inf"),
        (("poly6", [0.5j], 1.0), "r: expected an array of real numbers.*complex"),
    ],
)
def test_errors_name_the_argument_and_the_value(arguments, message):
    with pytest.raises(ValueError, match=message):
        sph.value(*arguments)


def test_displacements_of_other_shapes_or_without_numbers_are_refused():
    assert isinstance(sph.value("poly6", 0.5, 1.0), float)
    assert sph.gradient("poly6", np.zeros((4, 5, 3)), 1.0, dim=3).shape == (4, 5, 3)
    for displacement, message in (([1.0, 2.0, 3.0], r"shape \(..., 2\)"), ([[0.0, math.nan]], r"\[0, 1\].*nan")):
        with pytest.raises(ValueError, match=message):
            sph.gradient("poly6", displacement, 1.0)
