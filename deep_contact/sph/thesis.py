"""The transfer as the thesis's authors programmed it.

The splat finds neighbours by a k-d tree. The thesis does not print the two ways to read an image back.
"""

from __future__ import annotations

import numpy as np

from deep_contact.sph import kernels
from deep_contact.sph.grid import Grid, image_of, positions
from deep_contact.state.validation import expect, refuse_where


def splat_by_tree(grid: Grid, position, values, *, h: float, kernel="poly6") -> np.ndarray:
    """Return the image of the particles' values, (n_y, n_x, c), by a search of each node's neighbours.

    Node j gets Σ_k w_jk S_k over the particles k within h (Algorithms 2 and 3). The weights of a particle sum to 1
    (Appendix A). A particle with no node within h adds nothing.
    position: particles, (k, 2), m. values: S, (k, c). h: support radius, m. kernel: one of `sph.KERNELS`. Raises
    ValueError for an unknown kernel, and for an h that is out of range.
    """
    from scipy.spatial import cKDTree

    h = kernels.check_support_radius(h)
    kernels.kernel_number(kernel)
    position, values = np.asarray(position, dtype=np.float64), np.asarray(values, dtype=np.float64)
    nodes = _nodes(grid)
    tree = cKDTree(position)
    near = [tree.query_ball_point(x, h) for x in nodes]
    weights = {}
    total = np.zeros(len(position))
    for node, particles in enumerate(near):
        if particles:
            distance = np.hypot(*(position[particles] - nodes[node]).T)
            weights[node] = kernels.value(kernel, distance, h)
            total[particles] += weights[node]
    image = np.zeros((len(nodes), values.shape[1]))
    for node, w in weights.items():
        particles = near[node]
        # At r = h the weight is 0. So the sum of a particle whose only node is at r = h is 0.
        share = np.divide(w, total[particles], out=np.zeros_like(w), where=total[particles] > 0)
        image[node] = share @ values[particles]
    return image.reshape(*grid.shape, -1)


def read_by_spline(grid: Grid, image, position) -> np.ndarray:
    """Return the values at some points, (k, c), of the bicubic spline through all nodes of an image.

    The thesis's authors read the SPH image back in this way. For a point outside the grid, the spline is read at the
    nearest point of the grid.
    image: (n_y, n_x, c). position: points, (k, 2), m. Raises ValueError naming the argument and the value, also if the
    grid has fewer than four nodes along an edge.
    """
    from scipy.interpolate import RectBivariateSpline

    expect(min(grid.shape) >= 4, f"grid: expected at least 4 × 4 nodes for a cubic spline, got {grid.shape}")
    x, y = grid.nodes
    at, values = _checked(grid, image, position)
    layers = np.moveaxis(values, -1, 0)
    return np.stack([RectBivariateSpline(y, x, layer).ev(at[:, 1], at[:, 0]) for layer in layers], axis=-1)


def share_out(grid: Grid, image, position, *, h: float, kernel: str = "poly6") -> np.ndarray:
    """Return the values of particles, (k, c), where each node distributes its value among the particles within h.

    The thesis's authors read the network's image back in this way. A node's weights are proportional to W and sum to 1.
    So the values of all nodes with a particle within h are distributed completely. A particle that shares no node with
    another one gets back all that it gave. Particles that share nodes get mixtures of their values.
    image: (n_y, n_x, c). position: particles, (k, 2), m; a particle outside the grid is moved to the nearest point of
    the grid. h: support radius, m. kernel: one of `sph.KERNELS`. Raises ValueError naming the argument and the value.
    """
    from scipy.spatial import cKDTree

    h = kernels.check_support_radius(h)
    at, values = _checked(grid, image, position)
    nodes, inside = _nodes(grid), np.clip(at, grid.box[:2], grid.box[2:])
    pairs = cKDTree(nodes).sparse_distance_matrix(cKDTree(inside), h, output_type="ndarray")
    node, particle = pairs["i"], pairs["j"]
    weights = kernels.value(kernel, pairs["v"], h)
    total = np.bincount(node, weights, minlength=len(nodes))[node]
    # At r = h the weight is 0. So the sum of a node whose only particles are at r = h is 0.
    shares = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0.0)
    parts = shares[:, None] * values.reshape(len(nodes), -1)[node]
    return np.stack([np.bincount(particle, part, minlength=len(at)) for part in parts.T], axis=-1)


def _nodes(grid: Grid) -> np.ndarray:
    return np.stack(np.meshgrid(*grid.nodes), axis=-1).reshape(-1, 2)


def _checked(grid: Grid, image, position) -> tuple[np.ndarray, np.ndarray]:
    expect(np.ndim(image) != 2, f"image: expected shape {(*grid.shape, 'channels')}, got {np.shape(image)}")
    values = image_of(grid, image)
    refuse_where(~np.isfinite(values), "image", values, "a finite number")
    return positions(position), values
