"""python scripts/figure_5_8_architecture.py: the thesis's network, drawn from the layers of the built model."""

import math

import numpy as np

from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.studies import chapter_5

COLOURS = {
    "Input": "#DDDDDD",
    "Convolution": plotting.SKY,
    "Dropout": "#FFFFFF",
    "MaxPooling": plotting.ORANGE,
    "BatchNormalization": plotting.YELLOW,
    "Flatten": plotting.GREY,
    "Dense": plotting.PURPLE,
}
TITLES = {"MaxPooling": "max pooling", "BatchNormalization": "batch normalisation"}


def compute(options, seed, jobs, progress):
    """Collect the network's layers, and the number of weights with an input of four channels, as in section 5.3.1."""
    four = sum(layer["trainable"] for layer in chapter_5.thesis_layers(channels=4))
    return {"layers": chapter_5.thesis_layers(), "trainable with 4 channels": four}


def claims(data):
    trainable, every = (sum(layer[what] for layer in data["layers"]) for what in ("trainable", "parameters"))
    measured = {"trainable": trainable, "with the moving statistics": every}
    yield Claim("the network has 64,498,866 weights", "section 5.3.1", trainable == 64_498_866, measured)
    four = data["trainable with 4 channels"]
    text = "it has 51,599,092 weights for an input of 61 × 61 × 4"
    channels = {"trainable with 4 channels": four, "trainable with 5 channels": trainable}
    yield Claim(text, "section 5.3.1", four == 51_599_092, channels)


def draw(data, options):
    """Draw two panels.

    Above, each layer is a bar, whose height shows the height of its image, and whose width shows the number of its
    channels. Below are the numbers of the layers' parameters.
    """
    from matplotlib.patches import Patch

    layers = data["layers"]
    kinds = [layer["kind"].split("(")[0] for layer in layers]
    look = {"color": [COLOURS[kind] for kind in kinds], "edgecolor": "#333333", "linewidth": 0.5}
    shapes, weights = [layer["shape"] for layer in layers], [layer["trainable"] for layer in layers]
    sides = np.array([shape[0] if len(shape) > 1 else 48 for shape in shapes])
    widths = [0.15 + 0.07 * math.log2(shape[2]) if len(shape) > 1 else 0.3 for shape in shapes]
    figure, (top, bottom) = plotting.subplots(2, 1, size=(11.0, 5.6), height_ratios=[1.3, 1.0], sharex=True)
    top.bar(range(len(layers)), sides, widths, bottom=-sides / 2, **look)
    for i, (shape, before) in enumerate(zip(shapes, [None, *shapes])):
        if shape != before:
            size = " × ".join(map(str, shape))
            top.text(i, -sides[i] / 2 - 2, size, ha="center", va="top", rotation=90, fontsize=8)
    top.set(ylim=(-62, 62))
    top.axis("off")
    keys = [Patch(facecolor=COLOURS[kind], edgecolor="#333333", label=TITLES.get(kind, kind.lower()))
            for kind in dict.fromkeys(kinds)]  # fmt: skip
    top.legend(handles=keys, loc="upper right", ncols=4, fontsize=8)
    bottom.bar(range(len(layers)), weights, width=0.6, **look)
    bottom.set(yscale="log", ylim=(3e1, 3e10), xticks=[], ylabel="trainable parameters")
    bottom.grid(axis="x", visible=False)
    for i, count in enumerate(weights):
        if count:
            bottom.text(i, count * 1.4, f"{count:,}", ha="center", va="bottom", rotation=90, fontsize=8)
    bottom.set_xlabel(f"layers, from input to output; {sum(weights):,} trainable parameters in all")
    return figure


FIGURE = Figure("5.8", "Architecture of the thesis's network", compute, None, draw, claims)
figures.run_as_script(FIGURE, __name__)
