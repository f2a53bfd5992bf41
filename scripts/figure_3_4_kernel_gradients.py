"""python scripts/figure_3_4_kernel_gradients.py: the kernels' gradients along a line through the centre."""

import numpy as np

from deep_contact import sph
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure

DIMENSIONS = {"3": "in space, the constants of Eq 3.9 and 3.12", "2": "on the plane"}
CENTRE = 1e-9
"""Distance from the centre at which the gradient there is taken, in support radii."""

VANISHES = "poly6's gradient vanishes at the centre"
LARGEST = "spiky's gradient does not vanish at the centre: it is largest there"


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
    """section 3.2.2: poly6's gradient approaches zero at the centre; the spiky kernel is proposed to solve this."""
    found = []
    for kernel, sizes in data["sizes"].items():
        share = {f"{dim}-D, centre / largest": size["at the centre"] / size["largest"] for dim, size in sizes.items()}
        if kernel == "poly6":
            found.append(Claim(VANISHES, "section 3.2.2", max(share.values()) < 1e-6, share))
        if kernel == "spiky":
            found.append(Claim(LARGEST, "section 3.2.2", min(share.values()) > 1 - 1e-6, share))
    return found


def table(data):
    rows = [["kernel", "dimension", "|∇W| at the centre", "largest |∇W|"]]
    for kernel, size in data["sizes"].items():
        rows += [[kernel, dim, found["at the centre"], found["largest"]] for dim, found in size.items()]
    return rows


def draw(data, options):
    """One panel for each dimension; the jump of the spiky kernel's gradient is left open."""
    figure, panels = plotting.subplots(1, 2, size=(8.4, 3.6), sharey=True)
    styles = plotting.styles_of(data["curves"])
    half = len(data["x"]) // 2
    for ax, (dim, text) in zip(panels, DIMENSIONS.items()):
        for kernel, curves in data["curves"].items():
            ax.plot(data["x"][:half], curves[dim][:half], **styles[kernel])
            ax.plot(data["x"][half:], curves[dim][half:], **{**styles[kernel], "label": None})
        unit = f"m$^{{-{int(dim) + 1}}}$"
        plotting.label_axes(ax, "x", "∂W/∂x", x_unit="m", y_unit=unit, title=f"{dim}-D: {text}")
        ax.yaxis.set_tick_params(labelleft=True)
        ax.legend()
    return figure


OPTIONS = {"h": 1.0, "points": 220, "kernels": ["poly6", "spiky"]}
FIGURE = Figure("3.4", "Gradients of the smoothing kernels", compute, table, draw, claims, options=OPTIONS)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
