"""The transfer as the thesis's authors programmed it: a splat by k-d tree, and two ways back that are not in print."""

from __future__ import annotations

import numpy as np

from deep_contact.sph import kernels
from deep_contact.sph.grid import Grid, image_of, positions
from deep_contact.state.validation import expect, refuse_where


def splat_by_tree(grid: Grid, position, values, *, h: float, kernel="poly6") -> np.ndarray:
    """Particles to image, shape (n_y, n_x, c): for every node its neighbours, then Σ_k w S_k (Algorithms 2 and 3).

    position: (k, 2), m. values: (k, c). The weights of a particle sum to one (Appendix A); a particle with no node
    within h adds nothing. Raises ValueError for an unknown kernel or h.
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
        # A particle at exactly r = h has no weight here, and may have no other node.
        share = np.divide(w, total[particles], out=np.zeros_like(w), where=total[particles] > 0)
        image[node] = share @ values[particles]
    return image.reshape(*grid.shape, -1)


def read_by_spline(grid: Grid, image, position) -> np.ndarray:
    """Values, (k, c), of the bicubic spline through all nodes of an image (n_y, n_x, c), at positions (k, 2), m.

    This is the authors' way back from the SPH image. At a position beyond the grid the spline is read at the nearest
    point of the grid.
    Raises ValueError naming the argument and the value, also where a side has fewer than four nodes.
    """
    from scipy.interpolate import RectBivariateSpline

    expect(min(grid.shape) >= 4, f"grid: expected at least 4 × 4 nodes for a cubic spline, got {grid.shape}")
    x, y = grid.nodes
    at, values = _checked(grid, image, position)
    layers = np.moveaxis(values, -1, 0)
    return np.stack([RectBivariateSpline(y, x, layer).ev(at[:, 1], at[:, 0]) for layer in layers], axis=-1)


def share_out(grid: Grid, image, position, *, h: float, kernel: str = "poly6") -> np.ndarray:
    """Values of particles, (k, c), where every node shares its values out, by W, among the particles within h.

    This is the authors' way back from the network's image (n_y, n_x, c). The weights of a node sum to one, so nothing
    is lost. A particle that shares no node with another gets back all that it gave; any other particle gets a mean.
    position: (k, 2), m; for a position beyond the grid the nearest point of the grid counts. h: support radius of the
    kernel, m.
    Raises ValueError naming the argument and the value.
    """
    from scipy.spatial import cKDTree

    h = kernels.check_support_radius(h)
    at, values = _checked(grid, image, position)
    nodes, inside = _nodes(grid), np.clip(at, grid.box[:2], grid.box[2:])
    pairs = cKDTree(nodes).sparse_distance_matrix(cKDTree(inside), h, output_type="ndarray")
    node, particle = pairs["i"], pairs["j"]
    weights = kernels.value(kernel, pairs["v"], h)
    total = np.bincount(node, weights, minlength=len(nodes))[node]
    # A particle at exactly r = h from its only node has no weight there.
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
