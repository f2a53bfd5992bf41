"""python scripts/figure_3_1_grid.py: the grid over a scene, with its nodes, its cells and their size d."""

import numpy as np

import deep_contact as dc
from deep_contact import figures, sph
from deep_contact.figures import Figure
from deep_contact.plot import plotting


def compute(options, seed, jobs, progress):
    """Make the thesis's scene and the nodes of a grid over its box."""
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    x, y = sph.Grid.over_box(scene.world.box, options["d"]).nodes
    return {"scene": plotting.state_data(scene), "d": options["d"], "x": x, "y": y}


def draw(data, options):
    """Draw two panels. Left: the whole scene. Right: one circle with the grid's nodes, a cell and its sides."""
    from matplotlib.patches import Rectangle

    scene, d = plotting.state_of(data["scene"]), data["d"]
    x, y = np.array(data["x"]), np.array(data["y"])
    middle = np.mean(np.reshape(data["scene"]["box"], (2, 2)), axis=0)
    centre = scene.bodies.position[np.hypot(*(scene.bodies.position - middle).T).argmin()]
    half = 4 * d + 0.5
    figure, whole, near = plotting.scene_and_part(scene, x, y, centre=centre, half=half)
    whole.set_title(f"{len(x)} × {len(y)} nodes")
    near.set_title("nodes, and a cell")
    a, b = (nodes[np.searchsorted(nodes, low) + 1] for nodes, low in zip((x, y), centre - half))
    near.add_patch(Rectangle((a, b), d, d, facecolor=plotting.YELLOW, edgecolor=plotting.BLACK, zorder=3))
    text = {"fontsize": 9, "zorder": 4, "bbox": {"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none"}}
    near.text(a + d / 2, b - 0.12 * d, "d$_x$ = d", ha="center", va="top", **text)
    near.text(a - 0.12 * d, b + d / 2, "d$_y$ = d", ha="right", va="center", rotation=90, **text)
    return figure


OPTIONS = {"n_bodies": 100, "size": 30.0, "d": 0.5}
FIGURE = Figure("3.1", "The grid over a scene", compute, draw=draw, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
