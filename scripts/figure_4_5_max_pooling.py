"""python scripts/figure_4_5_max_pooling.py: 2 × 2 max pooling of an image, compared with Keras's."""

import numpy as np

from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.studies import chapter_4 as worked


def max_pool(image: np.ndarray) -> np.ndarray:
    """Return the largest value in each window of 2 × 2 neighbouring nodes (section 4.2.4).

    The last window along an edge may be incomplete, as with Keras's border mode "same" (Table 5.2). So 61 nodes become
    31. image: (n_y, n_x, ...).
    """
    rows, columns = (range(0, n, 2) for n in image.shape[:2])
    return np.array([[image[i : i + 2, j : j + 2].max(axis=(0, 1)) for j in columns] for i in rows])


def compute(options, seed, jobs, progress):
    """Compute the pooling of an image by our code and by Keras, and its effect in the thesis's network.

    The effect is the size of the images after each pooling, and the number of weights in the last layer.
    """
    image = np.array(options["image"], dtype=float)
    rng = np.random.default_rng(seed)
    whole = rng.normal(size=(options["nodes"], options["nodes"], 3))
    by_keras = worked.by_keras("MaxPooling2D", 2, x=whole, padding="same")
    sizes = [-(-options["nodes"] // 2**i) for i in range(options["poolings"] + 1)]  # nodes along an edge
    outputs = options["nodes"] ** 2 * 2
    return {
        "image": image,
        "pooled": max_pool(image),
        "Keras": worked.by_keras("MaxPooling2D", 2, x=image[..., None], padding="same")[..., 0],
        "difference on a whole image": float(np.abs(max_pool(whole) - by_keras).max()),
        "sizes": sizes,
        "weights of the last layer": {
            "with pooling": sizes[-1] ** 2 * options["channels"] * outputs,
            "without": sizes[0] ** 2 * options["channels"] * outputs,
        },
    }


def claims(data):
    small = float(np.abs(np.subtract(data["pooled"], data["Keras"])).max())
    differences = {"largest difference to Keras": small, "on a whole image": data["difference on a whole image"]}
    text = "the output holds the largest value within each window: equal to Keras's"
    yield Claim(text, "section 4.2.4", max(differences.values()) == 0, differences)
    sizes, weights = data["sizes"], data["weights of the last layer"]
    smaller = all(after < before for before, after in zip(sizes, sizes[1:]))
    yield Claim("pooling decreases the size of the output", "section 4.2.4", smaller, {"nodes along an edge": sizes})
    fewer = weights["with pooling"] < weights["without"]
    yield Claim("pooling decreases the number of weights", "section 4.2.4", fewer, weights)


def draw(data, options):
    """Draw the image and the pooled image. A window and its largest value have the same colour."""
    from matplotlib.colors import ListedColormap

    image, pooled = np.array(data["image"]), np.array(data["pooled"])
    figure, panels = plotting.subplots(1, 2, size=(6.8, 3.7), width_ratios=[image.shape[1], pooled.shape[1]])
    colours = ListedColormap(["#CFE6F5", "#F6D9B8", "#D6EBDD", "#EED9E6"])
    rows, columns = np.indices(pooled.shape)
    window = 2 * (rows % 2) + columns % 2
    spread = window.repeat(2, axis=0).repeat(2, axis=1)[: image.shape[0], : image.shape[1]]
    for ax, values, kinds in ((panels[0], image, spread), (panels[1], pooled, window)):
        ax.pcolormesh(kinds, cmap=colours, vmin=0, vmax=3, edgecolors="white", linewidth=1.5)
        ax.grid(False)
        ax.set(xticks=[], yticks=[], aspect="equal")
        ax.invert_yaxis()
        for (i, j), value in np.ndenumerate(values):
            largest = ax is panels[1] or value == pooled[i // 2, j // 2]
            ax.text(j + 0.5, i + 0.5, f"{value:g}", ha="center", va="center", weight="bold" if largest else "normal")
    panels[0].set_title(f"{image.shape[0]} × {image.shape[1]} values")
    panels[1].set_title("largest of each 2 × 2")
    sizes = " → ".join(str(n) for n in data["sizes"])
    figure.supxlabel(f"the thesis's images, nodes along an edge: {sizes}", fontsize=9)
    return figure


IMAGE = [[1, 3, 2, 1, 0], [4, 6, 5, 7, 2], [8, 2, 1, 0, 3], [3, -1, 4, 9, -5]]
"""The image that is shown. Its number of columns is odd, like the 61 nodes of the thesis's images."""

OPTIONS = {"image": IMAGE, "nodes": 61, "poolings": 4, "channels": 512}
FIGURE = Figure("4.5", "2 × 2 max pooling worked through", compute, None, draw, claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
