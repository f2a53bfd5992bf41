"""python scripts/figure_5_3_grid_and_kernels.py: the grid's nodes and the supports of the contacts' kernels."""

import numpy as np

import deep_contact as dc
from deep_contact import figures, sph
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.studies import starts

SMALLEST = 0.5**0.5
"""Lower bound of h / d that the thesis names in section 5.1.3."""


def compute(options, seed, jobs, progress):
    """Simulate a pile, and count nodes and contacts in its last state.

    The counts are the nodes within h of each contact, for several h / d, and the contacts in each cell, for several d.
    """
    state = dc.simulate(starts.scene_of(options, seed), steps=options["steps"], solver=dc.PGS()).state
    if not state.contacts.count:
        raise ValueError(f"steps: expected enough of them for contacts, got none after {options['steps']}")
    box, d = state.world.box, options["d"]
    contacts = state.contacts.position
    ratios = sorted({*options["h_over_d"], SMALLEST, 1.0})
    grid = sph.Grid.over_box(box, d)
    x, y = grid.nodes
    reached, shared = {}, {}
    for ratio in ratios:
        reach = {"h": ratio * d, "unreached": "zero", "outside": "clamp"}
        weights = (sph.splat(grid, point[None], np.ones(1), **reach) for point in contacts)
        reached[f"{ratio:.4g}"] = [int((weight > 0).sum()) for weight in weights]
    for size in sorted({*options["cells"], 1.0, d}):
        _, count = np.unique(np.floor((contacts - box[:2]) / size).astype(int), axis=0, return_counts=True)
        shared[f"{size:.4g}"] = {"most": int(count.max()), "cells with several": int((count > 1).sum())}
    counts = {"nodes reached, by h / d": reached, "contacts in one cell, by d": shared}
    return {"scene": plotting.state_data(state), "d": d, "h": options["h"], "x": x, "y": y} | counts


def claims(data):
    shared = {float(d): cells["cells with several"] for d, cells in data["contacts in one cell, by d"].items()}
    measured = {f"cells with several, d = {d:.4g} m": count for d, count in shared.items()}
    several = any(count for d, count in shared.items() if d <= 1)
    yield Claim("with d <= r = 1 m no two contact points lie in one cell", "section 5.1.3", not several, measured)
    reached = {float(ratio): np.array(nodes) for ratio, nodes in data["nodes reached, by h / d"].items()}
    most = int(reached[1.0].max())
    text = "with h <= d a contact reaches four nodes at most"
    yield Claim(text, "section 5.1.3", most <= 4, {"most nodes reached, h = d": most})
    bound = min(reached, key=lambda ratio: abs(ratio - SMALLEST))
    missed = {f"share that misses, h = {r:g} d": float((nodes == 0).mean()) for r, nodes in reached.items()}
    text = "with h >= 0.71 d every contact reaches a node"
    yield Claim(text, "section 5.1.3", bool(reached[bound].all()), missed)


def draw(data, options):
    """Draw two panels. Left: the pile with the support of its contacts' kernels. Right: a part of it with the nodes."""
    from matplotlib.collections import EllipseCollection

    state, h = plotting.state_of(data["scene"]), data["h"]
    points = state.contacts.position
    centre = points[np.hypot(*(points - np.median(points, axis=0)).T).argmin()]
    x, y = data["x"], data["y"]
    figure, whole, near = plotting.scene_and_part(state, x, y, centre=centre, half=2.5)
    for ax, width in ((whole, 0.8), (near, 1.4)):
        look = {"facecolors": "none", "edgecolors": plotting.BLUE, "linewidths": width, "zorder": 2.5}
        place = {"units": "xy", "offsets": points, "offset_transform": ax.transData}
        ax.add_collection(EllipseCollection(2 * h, 2 * h, 0, **place, **look))
    near.plot(*points.T, "x", color=plotting.BLACK, markersize=5, zorder=3, label="contact points")
    near.plot([], [], "o", color=plotting.VERMILION, markersize=4, label="grid nodes")
    near.plot([], [], "o", color=plotting.BLUE, markerfacecolor="none", markersize=9, label="support radius h")
    plotting.legend_below(figure, near)
    whole.set_title(f"{len(points)} contacts, {len(x)} × {len(y)} nodes")
    near.set_title(f"d = {data['d']:g} m, h = {h:g} m")
    return figure


OPTIONS = starts.THESIS_SCENE | {
    "steps": 200, "d": 0.5, "h": 0.5, "h_over_d": [0.4, 0.71, 1.0, 2.0], "cells": [0.25, 0.5, 0.7, 1.0],
}  # fmt: skip
FIGURE = Figure("5.3", "Grid nodes and kernels over a scene", compute, None, draw, claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
