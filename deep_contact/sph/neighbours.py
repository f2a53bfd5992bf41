"""Sums over neighbours found by a k-d tree, as the thesis has them: the slow reference of `sph.splat`, and Eq 3.7."""

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


def field_of(points, position, values, *, h: float, kernel: str = "poly6", volume=None):
    """A, ∇A and ∇²A of particles at any points (Eq 3.6, 3.7a and 3.7b): (p, c), (p, c, 2) and (p, c).

    points: (p, 2), m. position: of the particles, (k, 2), m. values: A_k, (k, c). volume: m_k / ρ_k, (k,), m²; 1 by
    default, as in Algorithms 2 and 3. In units of the values, over m and m² for the derivatives if volumes are given.
    Raises ValueError for an unknown kernel or h, and for arrays that are not finite numbers.
    """
    from scipy.spatial import cKDTree

    h = kernels.check_support_radius(h)
    points, position = kernels.as_floats("points", points), kernels.as_floats("position", position)
    values = kernels.as_floats("values", values)
    weights = np.ones(len(position)) if volume is None else kernels.as_floats("volume", volume)
    near = cKDTree(position).query_ball_point(points, h)
    rows = np.repeat(np.arange(len(points)), [len(found) for found in near])
    columns = np.concatenate([np.array(found, dtype=int) for found in near]) if len(near) else np.zeros(0, dtype=int)
    apart = points[rows] - position[columns]
    distance = np.hypot(*apart.T)
    given = weights[columns, None] * values[columns]
    found = [np.zeros((len(points), values.shape[1], *shape)) for shape in ((), (2,), ())]
    np.add.at(found[0], rows, given * kernels.value(kernel, distance, h)[:, None])
    np.add.at(found[1], rows, given[:, :, None] * kernels.gradient(kernel, apart, h)[:, None, :])
    np.add.at(found[2], rows, given * kernels.laplacian(kernel, distance, h)[:, None])
    return tuple(found)
