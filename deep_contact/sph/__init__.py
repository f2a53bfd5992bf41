"""Smoothed particle hydrodynamics as a transfer between particles and grid images (the thesis's chapter 3).

Kernel functions: `value`, `derivative`, `gradient` and `laplacian`. `KERNELS` lists the names of the kernels.
Transfer: `Grid`, `splat`, `density` and `gather`. `read_by_spline` and `share_out` read an image back as the thesis's
authors programmed it.
"""

from deep_contact.sph.grid import Grid, density, gather, splat
from deep_contact.sph.kernels import KERNELS, derivative, gradient, laplacian, value
from deep_contact.sph.thesis import read_by_spline, share_out

__all__ = [
    "KERNELS", "Grid", "density", "derivative", "gather", "gradient", "laplacian", "read_by_spline", "share_out",
    "splat", "value",
]  # fmt: skip
