"""python scripts/figure_3_2_sph.py: a point, its support radius, and the SPH weights of its neighbours."""

import numpy as np

from deep_contact import figures, sph
from deep_contact.figures import Figure
from deep_contact.plot import plotting


def compute(options, seed, jobs, progress):
    """Make random particles around a point, and compute their distances r, m, and weights W(r, h), m⁻²."""
    half = options["size"] / 2
    position = np.random.default_rng(seed).uniform(-half, half, (options["particles"], 2))
    distance = np.hypot(*position.T)
    r = np.linspace(0.0, half, options["points"])
    return {
        "h": options["h"],
        "position": position,
        "distance": distance,
        "weight": sph.value(options["kernel"], distance, options["h"]),
        "curve": {"r": r, "weight": sph.value(options["kernel"], r, options["h"])},
    }


def draw(data, options):
    """Draw two panels. Left: the particles around the point. Right: their weights against their distances."""
    from matplotlib.patches import Circle

    figure, (ax, curve) = plotting.subplots(1, 2, size=(8.4, 3.9), width_ratios=(1, 1.1))
    position, distance, weight = (np.array(data[name]) for name in ("position", "distance", "weight"))
    near, h, half = weight > 0, data["h"], options["size"] / 2
    colours = {"c": weight[near], "vmin": 0, "vmax": max(data["curve"]["weight"])}
    inside = {"s": 36, "edgecolor": "#333333", "linewidth": 0.5, "zorder": 3, **colours}
    outside = {"color": "#AAAAAA", "s": 22, "zorder": 2}

    plotting.scene_axes(ax, (-half, -half, half, half), walls=False)
    ax.add_patch(Circle((0, 0), h, facecolor="#EAF4FB", edgecolor=plotting.BLUE, linewidth=1.2))
    for (x, y), share in zip(position[near], weight[near] / weight.max(initial=1e-300)):
        ax.plot([0, x], [0, y], color=plotting.BLUE, linewidth=0.3 + 2.7 * share, zorder=1.5)
    ax.scatter(*position[~near].T, **outside)
    ax.scatter(*position[near].T, **inside)
    ax.plot(0, 0, "P", color=plotting.VERMILION, markersize=9, markeredgecolor="white", zorder=4)
    box = {"boxstyle": "round,pad=0.15", "fc": "#EAF4FB", "ec": "none"}
    ax.text(0, 0.07 - h, f"h = {h:g} m", fontsize=8, color=plotting.BLUE, ha="center", va="bottom", bbox=box, zorder=5)

    line = data["curve"]
    curve.plot(line["r"], line["weight"], color=plotting.BLACK, label=f"{options['kernel']}, 2-D", zorder=1.5)
    curve.scatter(distance[near], weight[near], label="particles within h", **inside)
    curve.scatter(distance[~near], weight[~near], label="particles outside: no weight", **outside)
    curve.axvline(h, color=plotting.BLUE, linewidth=1.0, linestyle="--")
    curve.set(xlabel="distance r (m)", ylabel="weight W(r, h) (m$^{-2}$)")
    curve.legend()
    return figure


OPTIONS = {"h": 1.0, "kernel": "poly6", "particles": 60, "size": 3.4, "points": 171}
FIGURE = Figure("3.2", "A point, its support radius and the weights of its neighbours", compute, None, draw,
                options=OPTIONS, seed=3)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
