"""python scripts/figure_3_4_kernel_gradients.py: the kernels' gradients along a line through the centre."""

import numpy as np

from deep_contact import sph
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure

DIMENSIONS = {"3": "in space, the constants of Eq 3.9 and 3.12", "2": "on the plane"}
CENTRE = 1e-9
"""Distance from the centre at which the gradient there is taken, in support radii."""


def compute(options, seed, jobs, progress):
    """dW/dx on the x axis, the largest size of the gradient, and its size at the centre."""
    h = options["h"]
    x = np.linspace(-1.1 * h, 1.1 * h, 2 * options["points"])  # even: at the centre itself no direction is defined
    centre, radius = np.array([CENTRE * h]), np.linspace(CENTRE * h, h, 2001)
    curves, sizes = {}, {}
    for kernel in options["kernels"]:
        curves[kernel] = {dim: along_x(kernel, x, h, dim) for dim in DIMENSIONS}
        sizes[kernel] = {
            dim: {
                "at the centre": float(abs(along_x(kernel, centre, h, dim)[0])),
                "largest": float(np.abs(along_x(kernel, radius, h, dim)).max()),
            }
            for dim in DIMENSIONS
        }
    return {"h": h, "x": x, "curves": curves, "sizes": sizes}


def along_x(kernel, x, h, dim):
    """dW/dx at (x, 0) or (x, 0, 0)."""
    displacement = np.zeros((x.size, int(dim)))
    displacement[:, 0] = x
    return sph.gradient(kernel, displacement, h, dim=int(dim))[:, 0]


def claims(data):
    texts = {
        "poly6": "poly6's gradient vanishes at the centre",
        "spiky": "spiky's gradient does not vanish at the centre: it is largest there",
    }
    for kernel in (name for name in texts if name in data["sizes"]):
        share = {f"{dim}-D, centre / largest": size["at the centre"] / size["largest"]
                 for dim, size in data["sizes"][kernel].items()}  # fmt: skip
        holds = max(share.values()) < 1e-6 if kernel == "poly6" else min(share.values()) > 1 - 1e-6
        yield Claim(texts[kernel], "section 3.2.2", holds, share)


def draw(data, options):
    """One panel for each dimension; the jump of the spiky kernel's gradient is left open."""
    figure, panels = plotting.subplots(1, 2, size=(8.4, 3.6), sharey=True)
    styles = plotting.styles_of(data["curves"])
    half = len(data["x"]) // 2
    for ax, (dim, text) in zip(panels, DIMENSIONS.items()):
        for kernel, curves in data["curves"].items():
            ax.plot(data["x"][:half], curves[dim][:half], **styles[kernel])
            ax.plot(data["x"][half:], curves[dim][half:], **{**styles[kernel], "label": None})
        title = f"{dim}-D: {text}"
        plotting.label_axes(ax, "x", "∂W/∂x", x_unit="m", y_unit=f"m$^{{-{int(dim) + 1}}}$", title=title)
        ax.yaxis.set_tick_params(labelleft=True)
        ax.legend()
    return figure


OPTIONS = {"h": 1.0, "points": 220, "kernels": ["poly6", "spiky"]}
FIGURE = Figure("3.4", "Gradients of the smoothing kernels", compute, None, draw, claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
