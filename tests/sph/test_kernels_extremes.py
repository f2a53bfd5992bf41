"""Kernels and transfers at the extremes: r = 0, r = h, tiny and huge h, subnormals, float32, nodes and edges.

`test_kernels.py` and `test_grid.py` hold the mathematics at ordinary sizes; here it is held where floats run out.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deep_contact import sph

SUPPORTS = [10.0**p for p in range(-6, 7)]
SUBNORMAL = 5e-324
each = pytest.mark.parametrize(("kernel", "dim"), [(kernel, dim) for kernel in sph.KERNELS for dim in (2, 3)])


@each
def test_shape_does_not_depend_on_h_from_a_millionth_to_a_million(kernel, dim):
    # W(q h, h) h^dim = W(q, 1), and one power of h more for every derivative: to a few roundings of q and of the power.
    q = np.array([0.0, 1e-9, 0.1, 0.49, 0.5, 0.51, 0.9, 0.999])
    for h in SUPPORTS:
        for order, function in enumerate((sph.value, sph.derivative)):
            found = function(kernel, q * h, h, dim) * h ** (dim + order)
            np.testing.assert_allclose(found, function(kernel, q, 1.0, dim), rtol=1e-11, atol=1e-13)


@each
@pytest.mark.parametrize("h", [1e-6, 1.0, 1e6])
def test_at_the_centre_all_is_defined(kernel, dim, h):
    assert sph.value(kernel, 0.0, h, dim) > 0
    np.testing.assert_array_equal(sph.gradient(kernel, np.zeros(dim), h, dim), np.zeros(dim))
    laplacian = sph.laplacian(kernel, 0.0, h, dim)
    assert laplacian == -math.inf if kernel == "spiky" else np.isfinite(laplacian)
    assert laplacian < 0  # a maximum


@each
@pytest.mark.parametrize("h", [1e-50, 1e-6, 1 / 3, 1.0, 1e6, 1e50])
def test_at_the_edge_all_is_zero_and_just_inside_nothing_is_negative(kernel, dim, h):
    for function in (sph.value, sph.derivative, sph.laplacian):
        assert function(kernel, h, h, dim) == 0.0
        assert function(kernel, np.nextafter(h, np.inf), h, dim) == 0.0
    inside = np.nextafter(h, 0.0)
    assert sph.value(kernel, inside, h, dim) >= 0.0
    assert sph.derivative(kernel, inside, h, dim) <= 0.0


@each
def test_subnormal_distances_are_the_centre(kernel, dim):
    assert sph.value(kernel, SUBNORMAL, 1.0, dim) == sph.value(kernel, 0.0, 1.0, dim)
    towards = np.zeros(dim)
    towards[0] = SUBNORMAL
    gradient = sph.gradient(kernel, towards, 1.0, dim)
    # The spiky kernel has its full slope however near the centre; the others have next to none.
    expected = sph.derivative(kernel, SUBNORMAL, 1.0, dim)
    np.testing.assert_allclose(gradient, expected * np.eye(dim)[0], atol=1e-300)
    assert np.isfinite(sph.laplacian(kernel, 1e-300, 1.0, dim))


@each
def test_the_laplacian_has_its_limit_from_the_smallest_distances_on(kernel, dim):
    if kernel == "spiky":
        # (dim - 1) W'(0) / r, without bound: to a rounding where r is small.
        slope = sph.derivative(kernel, 0.0, 1.0, dim)
        found = sph.laplacian(kernel, 1e-9, 1.0, dim)
        np.testing.assert_allclose(found, (dim - 1) * slope / 1e-9, rtol=1e-6)
    else:
        near = sph.laplacian(kernel, np.array([1e-300, 1e-12, 1e-8]), 1.0, dim)
        np.testing.assert_allclose(near, sph.laplacian(kernel, 0.0, 1.0, dim), rtol=1e-6)


@pytest.mark.parametrize("h", [0.0, -1.0, 9e-51, 1.1e50, SUBNORMAL, math.inf, math.nan])
def test_a_support_without_finite_kernels_is_refused_with_its_limits(h):
    with pytest.raises(ValueError, match=r"h: expected a number from 1e-50 to 1e\+50, got"):
        sph.value("poly6", 0.0, h)


@pytest.mark.parametrize("kernel", sph.KERNELS)
@pytest.mark.parametrize("h", [0.1, 0.3, 2.7])
def test_float32_support_and_distance_keep_the_open_edge(kernel, h):
    # r and h rounded alike stay equal, so the edge stays outside; r is widened exactly, never rounded again.
    single = np.float32(h)
    assert sph.value(kernel, np.float32([h]), single) == [0.0]
    inside = np.nextafter(single, np.float32(0))
    assert sph.value(kernel, inside, single) == sph.value(kernel, float(inside), float(single))


# ---- the transfer ----


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("normalization", ["particle", "consistent"])
def test_a_transfer_does_not_depend_on_the_unit_of_length(scale, normalization):
    # Lengths in units of `scale`: weights are ratios, so only coordinates round, to 1e-15 of a spacing.
    rng = np.random.default_rng(1)
    position, values = rng.uniform(0.3, 9.7, (40, 2)), rng.normal(size=(40, 1))

    def transfer(unit):
        grid = sph.Grid.over_box((0, 0, 10 * unit, 10 * unit), 0.5 * unit)
        at, options = position * unit, {"h": unit, "normalization": normalization}
        image = sph.splat(grid, at, values, **options)
        return sph.gather(grid, image, at, method="sph", **options)

    np.testing.assert_allclose(transfer(scale), transfer(1.0), rtol=1e-9, atol=1e-12)


NODE = st.sampled_from([0.0, 0.5, 5.0, 9.5, 10.0])
ALMOST = st.sampled_from([-1e-12, -0.0, 0.0, 1e-12, 1e-9, 0.25, 0.5])


@settings(max_examples=200, deadline=None)
@given(x=NODE, y=NODE, dx=ALMOST, dy=ALMOST, h=st.sampled_from([0.5, 0.75, 1.0, 3.0]))
def test_on_nodes_edges_and_corners_nothing_is_lost_and_all_comes_back(x, y, dx, dy, h):
    grid = sph.Grid.over_box((0, 0, 10, 10), 0.5)
    position = np.clip([[x + dx, y + dy]], 0.0, 10.0)
    image = sph.splat(grid, position, np.array([[2.5]]), h=h, normalization="particle")
    np.testing.assert_allclose(image.sum(), 2.5, rtol=1e-14)
    density = sph.density(grid, position, h=h)
    back = sph.gather(grid, image, position, normalization="consistent", density=density)
    np.testing.assert_allclose(back, [[2.5]], rtol=1e-13)


@pytest.mark.parametrize("value", [SUBNORMAL, 1e-310, 1e-30, 1e30, 1e300])
def test_tiny_and_huge_values_pass_through(value):
    # A subnormal has no digits to spare: half of the smallest is 0 or all of it.
    grid = sph.Grid.over_box((0, 0, 4, 4), 0.5)
    position = np.array([[1.1, 2.3]])
    image = sph.splat(grid, position, np.array([[value]]), h=0.5, normalization="particle")
    back = sph.gather(grid, image, position, normalization="consistent", density=sph.density(grid, position, h=0.5))
    np.testing.assert_allclose(back, [[value]], rtol=1e-12, atol=4 * SUBNORMAL)


@pytest.mark.parametrize("far", [1e6, 1e9])
def test_a_grid_far_away_loses_only_what_its_coordinates_round(far):
    grid = sph.Grid(origin=(far, far), spacing=0.5, shape=(9, 9))
    near = sph.Grid(origin=(0.0, 0.0), spacing=0.5, shape=(9, 9))
    position, values = np.array([[1.125, 2.375], [3.0, 0.5]]), np.array([[1.0], [-2.0]])  # exact in binary, far off too
    np.testing.assert_allclose(
        sph.splat(grid, position + far, values, h=0.75), sph.splat(near, position, values, h=0.75), rtol=1e-13
    )
