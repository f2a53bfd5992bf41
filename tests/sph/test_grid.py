"""Particle–grid–particle transfer against brute force, the k-d tree and its invariants (thesis chapter 3), and at the
limits of floats."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from deep_contact import sph
from deep_contact.sph.thesis import splat_by_tree

THESIS = sph.Grid.over_box((0, 0, 30, 30), 0.5)
SMALL = sph.Grid(origin=(-1.0, 2.0), spacing=(0.5, 0.3), shape=(8, 6))
kernels = pytest.mark.parametrize("kernel", sph.KERNELS)


def random_particles(grid, count, channels=2, seed=0):
    """Positions anywhere on the grid, and values."""
    rng = np.random.default_rng(seed)
    x_min, y_min, x_max, y_max = grid.box
    position = np.stack([rng.uniform(x_min, x_max, count), rng.uniform(y_min, y_max, count)], axis=1)
    return position, rng.normal(size=(count, channels))


def brute_force(grid, position, values, h, kernel, normalization="raw"):
    """Eq 3.6 over all pairs of a node and a particle."""
    x, y = grid.nodes
    distance = np.hypot(x[None, :, None] - position[:, 0], y[:, None, None] - position[:, 1])
    w = sph.value(kernel, distance, h)
    if normalization == "particle":
        w = w / w.sum(axis=(0, 1))
    return w @ values


# ---- the grid ----


def test_a_grid_over_a_box_has_its_nodes():
    """30/0.5 + 1 in the thesis's scene; spacing and extent may differ by axis."""
    assert sph.Grid(origin=(0, 0), spacing=0.5, shape=(61, 61)) == THESIS
    assert THESIS.box == (0, 0, 30, 30)
    grid = sph.Grid.over_box((-1, 2, 5, 4), (0.5, 0.25))
    assert grid.shape == (9, 13)
    x, y = grid.nodes
    assert (x[0], x[1], x[-1], y[0], y[1], y[-1]) == (-1, -0.5, 5, 2, 2.25, 4)


@pytest.mark.parametrize(("spacing", "count"), [(0.7, 44), (0.1, 301), (7, 6), (40, 2), (30 / 7, 8), (0.75, 41)])
def test_grid_covers_the_box_with_as_few_nodes_as_can(spacing, count):
    grid = sph.Grid.over_box((0, 0, 30, 30), spacing)
    assert grid.shape == (count, count)
    # 1e-9 of a spacing of rounding is allowed, as documented.
    assert grid.box[2] >= 30 - 1e-9 * spacing
    assert count == 2 or grid.nodes[0][-2] < 30


# ---- splat ----


@kernels
@pytest.mark.parametrize("h", [0.4, 0.5, 1.7, 50.0])
@pytest.mark.parametrize("normalization", ["raw", "particle"])
def test_splat_is_the_sum_over_all_pairs(kernel, h, normalization):
    """Eq 3.6 and Appendix A, on a grid with d_x ≠ d_y; h beyond the whole grid too."""
    position, values = random_particles(SMALL, 40)
    image = sph.splat(SMALL, position, values, h=h, kernel=kernel, normalization=normalization)
    expected = brute_force(SMALL, position, values, h, kernel, normalization)
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@kernels
def test_splat_is_that_of_the_tree(kernel):
    """Algorithms 2 and 3 as the thesis ran them, on its grid."""
    position, values = random_particles(THESIS, 170)
    witness = splat_by_tree(THESIS, position, values, h=0.5, kernel=kernel)
    image = sph.splat(THESIS, position, values, h=0.5, kernel=kernel, normalization="particle")
    np.testing.assert_allclose(image, witness, rtol=0, atol=1e-12 * np.abs(witness).max())


def test_node_at_exactly_h_is_not_reached():
    """W(h) = 0; spacing and h are 0.5, exact in binary."""
    image = sph.splat(THESIS, [[10.0, 10.0]], [1.0], h=0.5, kernel="gaussian", normalization="particle")
    assert np.count_nonzero(image) == 1


def test_integers_float32_strides_and_read_only_arrays_are_taken():
    position, values = random_particles(SMALL, 10)
    expected, frozen = sph.splat(SMALL, position, values, h=0.5), values.copy()
    frozen.flags.writeable = False
    np.testing.assert_array_equal(sph.splat(SMALL, np.asfortranarray(position), frozen, h=0.5), expected)
    single = sph.splat(SMALL, position.astype(np.float32), values, h=np.float32(0.5))
    np.testing.assert_allclose(single, expected, atol=1e-4)
    whole = sph.splat(SMALL, position, np.ones(10, int), h=0.5)
    np.testing.assert_array_equal(whole, sph.splat(SMALL, position, np.ones(10), h=0.5))


def test_no_particles_give_an_empty_image_and_nothing_to_read():
    image = sph.splat(SMALL, [], np.zeros((0, 2)), h=0.5)
    np.testing.assert_array_equal(image, np.zeros((8, 6, 2)))
    assert sph.gather(SMALL, image, [], normalization="consistent", h=0.5).shape == (0, 2)


# ---- gather ----


def test_bilinear_is_that_of_scipy():
    """Anywhere, and at all nodes, the last row and column too."""
    x, y = SMALL.nodes
    position = np.vstack([random_particles(SMALL, 200)[0], np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)])
    image = np.random.default_rng(1).normal(size=(8, 6, 3))
    witness = RegularGridInterpolator((y, x), image)(position[:, ::-1])
    np.testing.assert_allclose(sph.gather(SMALL, image, position), witness, atol=1e-13)


@kernels
@pytest.mark.parametrize("h", [0.5, 1.3])
def test_sph_gather_is_the_adjoint_of_the_particle_splat(kernel, h):
    """⟨splat v, G⟩ = ⟨v, gather G⟩: both use the weights of a particle over their sum."""
    position, values = random_particles(SMALL, 50)
    image = np.random.default_rng(3).normal(size=(8, 6, 2))
    left = (sph.splat(SMALL, position, values, h=h, kernel=kernel, normalization="particle") * image).sum()
    right = (values * sph.gather(SMALL, image, position, method="sph", h=h, kernel=kernel)).sum()
    assert left == pytest.approx(right, rel=1e-11)


@given(
    st.lists(st.tuples(st.floats(-1, 1.5), st.floats(2, 4.1)), min_size=1, max_size=40),
    st.floats(0.35, 3),
    st.sampled_from(sph.KERNELS),
    st.sampled_from(["bilinear", "sph"]),
)
@settings(deadline=None)
def test_consistent_transfer_reproduces_constants(position, h, kernel, method):
    """However the particles overlap: Σ w c D / Σ w D = c."""
    position, options = np.array(position), {"h": h, "kernel": kernel, "normalization": "consistent"}
    image = sph.splat(SMALL, position, np.full(len(position), -2.5), **options)
    read = sph.gather(SMALL, image, position, method=method, **options)
    np.testing.assert_allclose(read, -2.5, rtol=1e-12)


@pytest.mark.parametrize(("offset", "share"), [((0.25, 0.25), 0.25), ((0.0, 0.0), 1.0), ((0.25, 0.0), 0.5)])
def test_thesis_transfer_loses_most_of_an_isolated_contact(offset, share):
    """h = d, read bilinearly: λ Σ b_j w_j is λ/4 at a cell's centre, λ on a node, λ/2 halfway along an edge."""
    position = 10.0 + np.array([offset])
    image = sph.splat(THESIS, position, [8.0], h=0.5, normalization="particle")
    assert sph.gather(THESIS, image, position, normalization="particle")[0] == pytest.approx(8 * share, rel=1e-14)


def test_density_may_be_made_before_or_by_the_gather():
    position, _ = random_particles(SMALL, 30)
    image = np.random.default_rng(5).normal(size=(8, 6, 2)).astype(np.float32)  # any image, as from a network
    options = {"normalization": "consistent", "unreached": "zero"}
    before = sph.density(SMALL, position, h=0.5, kernel="spiky")
    read = sph.gather(SMALL, image, position, density=before, **options)
    np.testing.assert_array_equal(read, sph.gather(SMALL, image, position, h=0.5, kernel="spiky", **options))
    ratio = sph.gather(SMALL, image, position) / sph.gather(SMALL, before, position)[:, None]
    np.testing.assert_allclose(read, ratio, rtol=1e-13)


# ---- particles out of reach, particles outside ----

CENTRE = [[10.25, 10.25], [10.0, 10.0]]  # the first lies 0.354 from its four nearest nodes


def test_unreached_particle_is_an_error_that_names_it():
    """Figure 5.4a's h = 0.4 d: a contact that reaches no node must not be lost in silence, unless that is asked for."""
    with pytest.raises(ValueError, match=r"position\[0\]: expected"):
        sph.splat(THESIS, CENTRE, [1.0, 2.0], h=0.2)
    assert sph.splat(THESIS, CENTRE, [1.0, 2.0], h=0.2, normalization="particle", unreached="zero").sum() == 2.0


@pytest.mark.parametrize(("normalization", "weight"), [("particle", 1.0), ("raw", 1 / 0.25)])
def test_unreached_particle_goes_to_the_nearest_node_if_asked(normalization, weight):
    position = [[10.3, 10.7 + 1e-9]]
    image = sph.splat(THESIS, position, [3.0], h=0.1, normalization=normalization, unreached="nearest")
    assert image[21, 21] == 3.0 * weight
    assert np.count_nonzero(image) == 1
    # Read from there, it comes back, by itself or over its density.
    options = {"h": 0.1, "unreached": "nearest"}
    assert sph.gather(THESIS, image, position, method="sph", **options) == [3.0 * weight]
    if normalization == "particle":
        back = sph.gather(THESIS, image, position, normalization="consistent", **options)
        assert back == pytest.approx(3.0, rel=1e-15)


def test_unreached_query_without_density_is_an_error_or_zero():
    position = [[20.0, 20.0]]
    density = sph.density(THESIS, [[10.0, 10.0]], h=0.5)
    options = {"normalization": "consistent", "density": density}
    for unreached in ("error", "nearest"):
        with pytest.raises(ValueError, match=r"position\[0\]: expected"):
            sph.gather(THESIS, density, position, unreached=unreached, **options)
    assert sph.gather(THESIS, density, position, unreached="zero", **options)[0] == 0.0


@pytest.mark.parametrize("outlier", [[-0.001, 5], [30.001, 5], [5, -0.001], [5, 30.001], [1e300, -1e300]])
def test_particle_outside_is_an_error_that_names_it(outlier):
    message = r"position\[1\]: expected a point of the grid .*outside='clamp'"
    with pytest.raises(ValueError, match=message):
        sph.splat(THESIS, [[1.0, 1.0], outlier], [1.0, 1.0], h=0.5)
    with pytest.raises(ValueError, match=message):
        sph.gather(THESIS, np.zeros((61, 61)), [[1.0, 1.0], outlier])


@pytest.mark.parametrize(
    ("outlier", "moved"), [([-3, 5.2], [0, 5.2]), ([31, 5.2], [30, 5.2]), ([5.2, -1], [5.2, 0]), ([40, 40], [30, 30])]
)
def test_clamped_particle_acts_from_the_nearest_point_of_the_grid(outlier, moved):
    image = sph.splat(THESIS, [outlier], [1.0], h=0.7, outside="clamp")
    np.testing.assert_array_equal(image, sph.splat(THESIS, [moved], [1.0], h=0.7))
    field = np.random.default_rng(6).normal(size=(61, 61))
    read = sph.gather(THESIS, field, [outlier], outside="clamp")
    np.testing.assert_array_equal(read, sph.gather(THESIS, field, [moved]))


def test_rounding_beyond_the_last_node_is_not_outside():
    """0.1·3 > 0.3: a point computed otherwise than the node may lie an ulp beyond."""
    grid = sph.Grid.over_box((0, 0, 0.3, 0.3), 0.1)
    image = sph.splat(grid, [[np.nextafter(0.1 * 3, 1), -1e-17]], [1.0], h=0.1, normalization="particle")
    assert image[0, 3] == pytest.approx(1.0, rel=1e-12)


# ---- where floats end ----


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("normalization", ["particle", "consistent"])
def test_a_transfer_does_not_depend_on_the_unit_of_length(scale, normalization):
    """Weights are ratios, so only coordinates round, to 1e-15 of a spacing."""
    rng = np.random.default_rng(1)
    position, values = rng.uniform(0.3, 9.7, (40, 2)), rng.normal(size=(40, 1))

    def transfer(unit):
        grid = sph.Grid.over_box((0, 0, 10 * unit, 10 * unit), 0.5 * unit)
        at, options = position * unit, {"h": unit, "normalization": normalization}
        return sph.gather(grid, sph.splat(grid, at, values, **options), at, method="sph", **options)

    np.testing.assert_allclose(transfer(scale), transfer(1.0), rtol=1e-9, atol=1e-12)


NODE = st.sampled_from([0.0, 0.5, 5.0, 9.5, 10.0])
ALMOST = st.sampled_from([-1e-12, -0.0, 0.0, 1e-12, 1e-9, 0.25, 0.5])


@settings(max_examples=200, deadline=None)
@given(
    x=NODE, y=NODE, dx=ALMOST, dy=ALMOST, h=st.sampled_from([0.5, 0.75, 1.0, 3.0]),
    value=st.sampled_from([5e-324, 1e-310, 1e-30, 2.5, 1e30, 1e300]),
    kernel=st.sampled_from(sph.KERNELS), method=st.sampled_from(["bilinear", "sph"]),
)  # fmt: skip
def test_an_isolated_particle_comes_back_whatever_its_place_and_value(x, y, dx, dy, h, value, kernel, method):
    """On nodes, edges, corners. A subnormal has no digits to spare: half of the smallest is 0 or all of it."""
    grid = sph.Grid.over_box((0, 0, 10, 10), 0.5)
    position, options = np.clip([[x + dx, y + dy]], 0.0, 10.0), {"h": h, "kernel": kernel}
    image = sph.splat(grid, position, [[value]], normalization="particle", **options)
    np.testing.assert_allclose(image.sum(), value, rtol=1e-12, atol=1e-320)
    back = sph.gather(grid, image, position, normalization="consistent", method=method, **options)
    np.testing.assert_allclose(back, [[value]], rtol=1e-12, atol=1e-320)


def test_the_tree_adds_nothing_for_a_particle_whose_nodes_lie_at_exactly_h():
    """Half a metre to either node, all exact in binary: W(h) = 0, and 0 / 0 would spread from there."""
    grid = sph.Grid(origin=(0, 0), spacing=1.0, shape=(3, 3))
    image = splat_by_tree(grid, [[0.5, 0.0], [2.0, 2.0]], [[1.0], [3.0]], h=0.5)
    expected = np.zeros((3, 3, 1))
    expected[2, 2] = 3.0
    np.testing.assert_array_equal(image, expected)
