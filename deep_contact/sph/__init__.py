"""Smoothed particle hydrodynamics as a transfer between particles and grid images (the thesis's chapter 3).

Kernels: `value`, `derivative`, `gradient`, `laplacian`, and their names in `KERNELS`.
Transfer: `Grid`, `splat`, `density`, `gather`. The slow witness, by k-d tree, is in
`deep_contact.sph.neighbours`.
"""

from deep_contact.compiled import prepare_numba

prepare_numba()

from deep_contact.sph.grid import Grid, density, gather, splat  # noqa: E402
from deep_contact.sph.kernels import KERNELS, derivative, gradient, laplacian, value  # noqa: E402

__all__ = ["KERNELS", "Grid", "density", "derivative", "gather", "gradient", "laplacian", "splat", "value"]
