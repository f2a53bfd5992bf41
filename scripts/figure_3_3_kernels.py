"""python scripts/figure_3_3_kernels.py: the smoothing kernels W(r), with constants for three and for two dimensions."""

from itertools import product

import numpy as np
from scipy.integrate import quad

from deep_contact import figures, sph
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting

SPACES = {"the plane": lambda r: 2 * np.pi * r, "space": lambda r: 4 * np.pi * r**2}
"""Name of the space over which a kernel is integrated -> length or area of the shell at the distance r."""
DIMENSIONS = {"3": "in space, the constants of Eq 3.8 and 3.11", "2": "on the plane, as the simulation is"}


def compute(options, seed, jobs, progress):
    """Compute W at distances up to 1.1 h, and its integrals over space and over the plane by quadrature."""
    h, r, kernels = options["h"], np.linspace(0.0, 1.1 * options["h"], options["points"]), options["kernels"]
    curves = {kernel: {dim: sph.value(kernel, r, h, dim=int(dim)) for dim in DIMENSIONS} for kernel in kernels}
    integrals = {}
    for kernel, dim, (space, shell) in product(kernels, DIMENSIONS, SPACES.items()):
        integral, _ = quad(lambda r: shell(r) * sph.value(kernel, r, h, dim=int(dim)), 0, h)  # noqa: B023
        integrals[f"{kernel}, {dim}-D constant over {space}"] = integral
    return {"h": h, "r": r, "curves": curves, "integrals": integrals}


def claims(data):
    """Yield claims on the integrals of the kernels, which are one by Eq 3.2, and on their sign.

    The thesis uses the constants of three dimensions in its simulation on the plane.
    """
    right = "2-D constant over the plane", "3-D constant over space"
    for text, thesis, chosen in (
        ("each kernel integrates to one in the dimension of its constant", "Eq 3.2", right),
        ("the kernels of Eq 3.8 and 3.11 integrate to one on the plane of the simulation", "Eq 3.8, Eq 3.11",
         "3-D constant over the plane"),
    ):  # fmt: skip
        integrals = {name: value for name, value in data["integrals"].items() if name.endswith(chosen)}
        yield Claim(text, thesis, all(abs(value - 1) < 1e-6 for value in integrals.values()), integrals)
    least = {kernel: min(min(w) for w in curves.values()) for kernel, curves in data["curves"].items()}
    yield Claim("no kernel is negative anywhere", "Eq 3.4b", min(least.values()) >= 0, least)


def draw(data, options):
    """Draw W against the distance, with a panel for each dimension."""
    figure, panels = plotting.subplots(1, 2, size=(8.4, 3.6), sharey=True)
    styles = plotting.styles_of(data["curves"])
    for ax, (dim, text) in zip(panels, DIMENSIONS.items()):
        for kernel, curves in data["curves"].items():
            ax.plot(data["r"], curves[dim], **styles[kernel])
        ax.set(xlabel="distance r (m)", ylabel=f"W(r) (m$^{{-{dim}}}$)", title=f"{dim}-D: {text}")
        ax.axvline(data["h"], color=plotting.BLACK, linewidth=0.8)
        place = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "ha": "right"}
        ax.annotate(f"h = {data['h']:g} m", (data["h"], 0.55), (-4, 0), fontsize=8, **place)
        ax.yaxis.set_tick_params(labelleft=True)
        ax.legend(loc="upper right", bbox_to_anchor=(0.88, 1.0))
    return figure


OPTIONS = {"h": 1.0, "points": 221, "kernels": ["poly6", "spiky"]}
FIGURE = Figure("3.3", "Smoothing kernels", compute, None, draw, claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
