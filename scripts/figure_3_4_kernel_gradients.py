"""python scripts/figure_3_4_kernel_gradients.py: the kernels' gradients along a line through the centre."""

import numpy as np

from deep_contact import figures, sph
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting

DIMENSIONS = {"3": "in space, the constants of Eq 3.9 and 3.12", "2": "on the plane"}
CENTRE = 1e-9
"""Smallest distance from the centre that is drawn, in support radii. At the centre itself no direction is defined."""


def compute(options, seed, jobs, progress):
    """Compute dW/dx on the positive x axis. On the negative x axis it has the opposite sign."""
    h = options["h"]
    x = np.concatenate([[CENTRE * h], np.linspace(0, 1.1 * h, options["points"])[1:]])

    def along_x(kernel, dim):
        return sph.gradient(kernel, x[:, None] * np.eye(dim)[0], h, dim=dim)[:, 0]

    curves = {kernel: {dim: along_x(kernel, int(dim)) for dim in DIMENSIONS} for kernel in options["kernels"]}
    return {"h": h, "x": x, "curves": curves}


def claims(data):
    texts = {
        "poly6": "poly6's gradient vanishes at the centre",
        "spiky": "spiky's gradient does not vanish at the centre: it is largest there",
    }
    for kernel in (name for name in texts if name in data["curves"]):
        share = {f"{dim}-D, centre / largest": w[0] / min(w) for dim, w in data["curves"][kernel].items()}
        holds = max(share.values()) < 1e-6 if kernel == "poly6" else min(share.values()) > 1 - 1e-6
        yield Claim(texts[kernel], "section 3.2.2", holds, share)


def draw(data, options):
    """Draw dW/dx with a panel for each dimension. No line joins the two sides of the jump of the spiky kernel."""
    figure, panels = plotting.subplots(1, 2, size=(8.4, 3.6), sharey=True)
    styles, x = plotting.styles_of(data["curves"]), np.array(data["x"])
    for ax, (dim, text) in zip(panels, DIMENSIONS.items()):
        for kernel, curves in data["curves"].items():
            ax.plot(x, curves[dim], **styles[kernel])
            ax.plot(-x, -np.array(curves[dim]), **{**styles[kernel], "label": None})
        ax.set(xlabel="x (m)", ylabel=f"∂W/∂x (m$^{{-{int(dim) + 1}}}$)", title=f"{dim}-D: {text}")
        ax.yaxis.set_tick_params(labelleft=True)
        ax.legend()
    return figure


OPTIONS = {"h": 1.0, "points": 220, "kernels": ["poly6", "spiky"]}
FIGURE = Figure("3.4", "Gradients of the smoothing kernels", compute, None, draw, claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
