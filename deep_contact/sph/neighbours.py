"""Sums over neighbours found by a k-d tree, as the thesis has them: the slow reference of `sph.splat`."""

from __future__ import annotations

import numpy as np

from deep_contact.sph import kernels
from deep_contact.sph.grid import Grid
from deep_contact.validation import one_of


def splat_by_tree(
    grid: Grid,
    position,
    values,
    *,
    h: float,
    kernel: str = "poly6",
    normalization: str = "raw",
    one_query: bool = False,
) -> np.ndarray:
    """Particles to image, shape (n_y, n_x, c): for every node its neighbours, then Σ_k W S_k.

    Algorithms 2 and 3 as they are written. position: (k, 2), m. values: (k, c). normalization: "raw", or "particle"
    (Appendix A: the weights of a particle sum to one). A particle with no node within h adds nothing. one_query: look
    up all nodes in one call of scipy, which the thesis did not do and which is several times faster.
    Raises ValueError for an unknown kernel, h or normalization.
    """
    from scipy.spatial import cKDTree

    h = kernels.check_support_radius(h)
    kernels.kernel_number(kernel)
    one_of("normalization", normalization, ("raw", "particle"))
    position, values = np.asarray(position, dtype=np.float64), np.asarray(values, dtype=np.float64)
    x, y = grid.nodes
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    tree = cKDTree(position)
    near = tree.query_ball_point(nodes, h) if one_query else [tree.query_ball_point(x, h) for x in nodes]
    weights = {}
    total = np.zeros(len(position))
    for node, found in enumerate(near):
        if found:
            distance = np.hypot(*(position[found] - nodes[node]).T)
            weights[node] = kernels.value(kernel, distance, h)
            total[found] += weights[node]
    image = np.zeros((len(nodes), values.shape[1]))
    for node, w in weights.items():
        found = near[node]
        if normalization == "particle":
            # A neighbour at exactly r = h has no weight, and may have no other node either.
            w = np.divide(w, total[found], out=np.zeros_like(w), where=total[found] > 0)
        image[node] = w @ values[found]
    return image.reshape(*grid.shape, -1)
