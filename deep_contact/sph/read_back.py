"""Two ways back from an image that the thesis's authors programmed and the thesis does not print."""

from __future__ import annotations

import numpy as np

from deep_contact.sph import kernels
from deep_contact.sph.grid import Grid, image_of, positions


def read_by_spline(grid: Grid, image, position) -> np.ndarray:
    """The bicubic spline through all nodes at (k, 2) positions, m: (k, c) of an image (n_y, n_x, c).

    The authors' way back from the SPH image. Beyond the grid it reads the nearest point of the grid.
    Raises ValueError naming the argument and the value, also where a side has fewer than four nodes.
    """
    from scipy.interpolate import RectBivariateSpline

    if min(grid.shape) < 4:
        raise ValueError(f"grid: expected at least 4 × 4 nodes for a cubic spline, got {grid.shape}")
    x, y = grid.nodes
    at, values = _checked(grid, image, position)
    layers = np.moveaxis(values, -1, 0)
    return np.stack([RectBivariateSpline(y, x, layer).ev(at[:, 1], at[:, 0]) for layer in layers], axis=-1)


def share_out(grid: Grid, image, position, *, h: float, kernel: str = "poly6") -> np.ndarray:
    """What each particle gets where every node shares its values out, by W, among the particles within h: (k, c).

    The authors' way back from the network's image (n_y, n_x, c): the weights of a node sum to one, so nothing is lost.
    Each particle that is the only one of its nodes gets back all that it gave; others get a mean. position: (k, 2), m;
    beyond the grid its nearest point counts. h: support radius of the kernel, m.
    Raises ValueError naming the argument and the value.
    """
    h = kernels.check_support_radius(h)
    at, values = _checked(grid, image, position)
    values = values.reshape(-1, values.shape[-1])
    near, apart = [], []  # of the nodes around each particle, by axis: (k, s)
    for k, (nodes, spacing) in enumerate(zip(grid.nodes, grid.spacing)):
        x = np.clip(at[:, k], nodes[0], nodes[-1])
        reach = int(np.ceil(h / spacing))
        found = np.floor((x - nodes[0]) / spacing).astype(int)[:, None] + np.arange(-reach, reach + 2)
        near.append(found)
        # Beyond the grid there is no node, which is as far away as can be.
        distance = x[:, None] - (nodes[0] + spacing * found)
        apart.append(np.where((found < 0) | (found >= nodes.size), np.inf, distance))
    distance = np.hypot(apart[1][:, :, None], apart[0][:, None, :])
    rows, *place = np.nonzero(distance < h)
    node = near[1][rows, place[0]] * grid.shape[1] + near[0][rows, place[1]]
    weights = kernels.value(kernel, distance[rows, place[0], place[1]], h)
    total = np.bincount(node, weights, minlength=len(values))[node]
    # At almost h from its only node a particle may have no weight there.
    shares = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0.0)
    given = shares[:, None] * values[node]
    return np.stack([np.bincount(rows, part, minlength=len(at)) for part in given.T], axis=-1)


def _checked(grid: Grid, image, position) -> tuple[np.ndarray, np.ndarray]:
    if np.ndim(image) == 2:
        raise ValueError(f"image: expected shape {(*grid.shape, 'channels')}, got {np.shape(image)}")
    values, at = image_of(grid, image), positions(position)
    for name, array in (("image", values), ("position", at)):
        if not np.isfinite(array).all():
            raise ValueError(f"{name}: expected finite numbers, got {array[~np.isfinite(array)][0]}")
    return at, values
