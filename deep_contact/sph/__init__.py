"""Smoothed particle hydrodynamics as a transfer between particles and grid images (the thesis's chapter 3).

Kernels: `value`, `derivative`, `gradient`, `laplacian`; their names are in `KERNELS`.
Transfer: `Grid`, `splat`, `density`, `gather`, and the authors' two ways back from an image, `read_by_spline` and
`share_out`.
"""

from deep_contact.sph.grid import Grid, density, gather, splat
from deep_contact.sph.kernels import KERNELS, derivative, gradient, laplacian, value
from deep_contact.sph.thesis import read_by_spline, share_out

__all__ = [
    "KERNELS", "Grid", "density", "derivative", "gather", "gradient", "laplacian", "read_by_spline", "share_out",
    "splat", "value",
]  # fmt: skip
