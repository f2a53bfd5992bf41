"""python scripts/figure_3_5_bilinear.py: bilinear interpolation between four nodes, worked through."""

import numpy as np

from deep_contact import figures, sph
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting


def compute(options, seed, jobs, progress):
    """Compute the value at a point by `sph.gather`, by two 1-D interpolations, by Eq 3.16 and by Algorithm 4."""
    (x_1, x_2), (y_1, y_2), (x, y) = options["x"], options["y"], options["query"]
    image = np.array(options["values"]).reshape(2, 2)  # rows along y, columns along x
    grid = sph.Grid(origin=(x_1, y_1), spacing=(x_2 - x_1, y_2 - y_1), shape=(2, 2))
    along_x = [float(np.interp(x, (x_1, x_2), row)) for row in image]  # Eq 3.14a, b
    # Eq 3.16 has f(Q11) and f(Q12) in its first row. So its rows run along y, and it is the transpose of an image.
    left, right = np.array([x_2 - x, x - x_1]), np.array([y_2 - y, y - y_1])
    area = (x_2 - x_1) * (y_2 - y_1)
    shades = np.linspace(0.0, 1.0, options["points"])
    mesh = np.stack(np.meshgrid(x_1 + shades * (x_2 - x_1), y_1 + shades * (y_2 - y_1)), axis=-1)
    surface = sph.gather(grid, image, mesh.reshape(-1, 2)).reshape(mesh.shape[:2])
    values = {
        "gather": float(sph.gather(grid, image, np.array([[x, y]]))[0]),
        "two 1-D interpolations": float(np.interp(y, (y_1, y_2), along_x)),
        "Eq 3.16": float(left @ image.T @ right / area),
        "Algorithm 4": float(left @ image @ right / area),
    }
    cell = {name: options[name] for name in ("x", "y", "query")}
    return cell | {"nodes": image, "along x": along_x, "values": values, "surface": surface}


def claims(data):
    """Yield the claims that Eq 3.16 and Algorithm 4 compute the bilinear interpolation.

    Eq 3.16 is right. Algorithm 4 should compute the same value, but its matrix is transposed.
    """
    equal = "Eq 3.16's matrix form equals two 1-D interpolations, and so does our gather"
    same = "Algorithm 4's matrix gives the same as Eq 3.16"
    for text, thesis, *names in ((equal, "Eq 3.16", "Eq 3.16", "gather"), (same, "Algorithm 4", "Algorithm 4")):
        measured = {name: data["values"][name] for name in (*names, "two 1-D interpolations")}
        # The limit 1e-12 is above the rounding errors, which are a few times 1e-16 of the nodes' values.
        yield Claim(text, thesis, np.ptp(list(measured.values())) < 1e-12 * np.abs(data["nodes"]).max(), measured)


def draw(data, options):
    """Draw the cell, coloured by the interpolated values, with the two steps of Eq 3.14 and 3.15."""
    figure, ax = plotting.subplots(size=(5.6, 4.6))
    (x_1, x_2), (y_1, y_2), (x, y) = data["x"], data["y"], data["query"]
    ax.grid(False)
    mesh = (np.linspace(*ends, len(data["surface"])) for ends in (data["x"], data["y"]))
    shades = ax.pcolormesh(*mesh, data["surface"], shading="gouraud")
    figure.colorbar(shades, ax=ax, label="interpolated f", shrink=0.85)
    ax.plot([x_1, x_2], [y_1, y_1], [x_1, x_2], [y_2, y_2], color=plotting.BLACK, linewidth=1)
    ax.plot([x, x], [y_1, y_2], color=plotting.BLACK, linewidth=1, linestyle="--")
    corners = [(x_1, y_1, "Q$_{11}$"), (x_2, y_1, "Q$_{21}$"), (x_1, y_2, "Q$_{12}$"), (x_2, y_2, "Q$_{22}$")]
    for (a, b, name), value in zip(corners, np.ravel(data["nodes"])):
        mark(ax, a, b, plotting.VERMILION, f"{name}: f = {value:g}", b == y_1, "center")
    for b, name, value in zip((y_1, y_2), ("f(x, y$_1$)", "f(x, y$_2$)"), data["along x"]):
        mark(ax, x, b, plotting.BLUE, f"{name} = {value:.4g}", b == y_1, "center")
    mark(ax, x, y, plotting.GREEN, f"f(x, y) = {data['values']['gather']:.4g}", True, "left")
    ax.use_sticky_edges = False  # the edges of the mesh would suppress the margins
    ax.margins(0.14)
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    return figure


def mark(ax, x, y, colour, text, below, side):
    """Draw a dot at (x, y) with a text beside it.

    below: whether the text is below the dot, or else above. side: horizontal alignment of the text.
    """
    ax.plot(x, y, "o", markersize=9, color=colour, markeredgecolor="white", zorder=3, clip_on=False)
    offset = (9 if side == "left" else 0, -17 if below else 10)
    box = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8}
    ax.annotate(text, (x, y), offset, textcoords="offset points", ha=side, fontsize=8.5, bbox=box)


VALUES = [2.0, 5.0, 3.5, 12.0]
"""Values f at Q11, Q21, Q12 and Q22. They have no symmetry that would hide a transposition."""

OPTIONS = {"x": [1.0, 1.5], "y": [2.0, 2.5], "values": VALUES, "query": [1.2, 2.35], "points": 41}
FIGURE = Figure("3.5", "Bilinear interpolation between four nodes", compute, None, draw, claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
