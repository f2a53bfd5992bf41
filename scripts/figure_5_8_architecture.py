"""python scripts/figure_5_8_architecture.py: the thesis's network, drawn from the layers of the built model."""

import math

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
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
    """The layers, and the number of weights with the four channels that section 5.3.1 names."""
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
    """Each layer as a slab as high as its image is and as thick as its channels are many; below, its parameters."""
    layers = data["layers"]
    figure, (top, bottom) = plotting.subplots(2, 1, size=(11.0, 5.6), height_ratios=[1.5, 1.0])
    middles = draw_slabs(top, layers)
    weights = [layer["trainable"] for layer in layers]
    bars = {"color": [colour_of(layer) for layer in layers], "edgecolor": "#333333", "linewidth": 0.5}
    bottom.bar(middles, weights, width=0.6, **bars)
    bottom.set(yscale="log", ylim=(3e1, 3e10), xlim=top.get_xlim(), xticks=[], ylabel="trainable parameters")
    bottom.grid(axis="x", visible=False)
    for middle, count in zip(middles, weights):
        if count:
            bottom.text(middle, count * 1.4, f"{count:,}", ha="center", va="bottom", rotation=90, fontsize=8)
    bottom.set_xlabel(f"layers, from input to output; {sum(weights):,} trainable parameters in all")
    return figure


def draw_slabs(ax, layers):
    """Slabs in oblique projection, from left to right; returns the middles of their fronts."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch, Polygon

    tall, scale, slant, gap = 48, 0.05, 0.22, 0.45
    x, middles, written = 0.0, [], None
    for layer in layers:
        shape, colour = layer["shape"], colour_of(layer)
        flat = len(shape) == 1
        side = scale * (tall if flat else shape[0])
        thick = 0.3 if flat else 0.12 + 0.075 * math.log2(shape[2])
        shift = 0.0 if flat else slant * side
        low, high, right = -side / 2, side / 2, x + thick
        front = [(x, low), (right, low), (right, high), (x, high)]
        roof = [(x, high), (right, high), (right + shift, high + shift), (x + shift, high + shift)]
        face = [(right, low), (right, high), (right + shift, high + shift), (right + shift, low + shift)]
        for corners, shade in ((roof, 0.85), (face, 0.65), (front, 1.0)):
            darker = shade * np.array(to_rgb(colour))
            ax.add_patch(Polygon(corners, facecolor=darker, edgecolor="#333333", linewidth=0.6))
        middles.append(x + thick / 2)
        if shape != written:
            size = " × ".join(map(str, shape))
            ax.text(x + thick / 2, low - 0.12, size, ha="center", va="top", rotation=90, fontsize=8)
            written = shape
        x = right + max(shift + 0.12, gap)
    ax.set(xlim=(-0.6, x + 0.2), ylim=(-2.9, 2.3))
    ax.axis("off")
    kinds = list(dict.fromkeys(layer["kind"].split("(")[0] for layer in layers))
    keys = [Patch(facecolor=COLOURS[kind], edgecolor="#333333", label=TITLES.get(kind, kind.lower())) for kind in kinds]
    ax.legend(handles=keys, loc="upper right", ncols=4, fontsize=8)
    return middles


def colour_of(layer):
    """The colour of a layer's kind."""
    return COLOURS[layer["kind"].split("(")[0]]


FIGURE = Figure("5.8", "Architecture of the thesis's network", compute, None, draw, claims)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
