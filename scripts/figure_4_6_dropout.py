"""python scripts/figure_4_6_dropout.py: dropout on and off, in a small network and in the thesis's."""

import numpy as np

import deep_contact as dc
from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.studies import chapter_4 as worked
from deep_contact.studies import chapter_5


def compute(options, seed, jobs, progress):
    """Compute the effect of dropout, in a small random network and in the trained network of a model file.

    For the trained network, the data have a feature map before and after dropout, and the changes of the prediction
    from run to run with dropout off and on.
    """
    from deep_contact.cnn.backend import keras

    keras.utils.set_random_seed(seed)  # seeds the random masks of dropout
    model = chapter_5.image_network(options["model"])
    network = model.network
    network.trainable = False  # in training mode, only dropout is then active, and batch normalisation is not
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    state = dc.simulate(scene, steps=options["steps"], solver=dc.PGS()).state
    names = [layer.name for layer in network.layers]
    dropout = next(layer for layer in network.layers if isinstance(layer, keras.layers.Dropout) and layer.rate)
    source = names[names.index(dropout.name) - 1]

    def maps_and_normal(layer, training):
        maps = worked.feature_maps(network, model.input(state), [layer, names[-1]], training=training)
        return maps[layer], model.impulses(state, maps[names[-1]], project=False)[0]

    (before, first), (_, second) = (maps_and_normal(source, training=False) for _ in range(2))
    mean, normal = np.zeros_like(before), []
    for _ in progress(range(options["masks"]), text="masks"):
        after, impulses = maps_and_normal(dropout.name, training=True)
        mean += after / options["masks"]
        normal.append(impulses)
    strongest = worked.strongest(before)
    active = before > 0
    kept = active & (after > 0)
    rng = np.random.default_rng(seed)
    hidden = [(rng.random(5) < options["rate drawn"]).tolist() for _ in range(2)]
    return {
        "small network": {
            "weights": [weights for weights, _ in worked.random_layers([3, 5, 5, 2], seed)],
            "dropped": [[False] * 3, *hidden, [False] * 2],
        },
        "rate": dropout.rate,
        "layer": source,
        "map": strongest,
        "before": before[..., strongest],
        "after": after[..., strongest],
        "change off": float(np.abs(first - second).max()),
        "change on": float(np.abs(normal[0] - normal[1]).max()),
        "dropped": float(np.mean(after[active] == 0)),
        "values": int(active.sum()),
        "scaled": float(np.median(after[kept] / before[kept])),
        "mean over masks": float(mean[active].sum() / before[active].sum()),
    }


def claims(data):
    rate = data["rate"]
    # Three standard deviations of the share that is dropped, if each value is dropped independently.
    allowed = float(3 * np.sqrt(rate * (1 - rate) / data["values"]))
    repeats = {"largest change of λ_n from run to run, off (N·s)": data["change off"], "on": data["change on"]}
    share = {"share dropped": data["dropped"], "rate": rate, "values": data["values"], "allowed": allowed}
    mean = {"values kept are multiplied by": data["scaled"], "mean over masks, over the value": data["mean over masks"]}
    random = "nodes are dropped at random, a share of them as large as the rate"
    yield Claim(random, "section 4.3.2", abs(data["dropped"] - rate) <= allowed, share)
    training = "dropout is at work in training only: without it the network repeats itself, with it it does not"
    yield Claim(training, "section 4.3.2", data["change off"] == 0 < data["change on"], repeats)
    scaled = "what is kept is scaled up so that the mean stays, within a hundredth"
    yield Claim(scaled, None, abs(data["mean over masks"] - 1) < 0.01, mean)


def draw(data, options):
    """Draw four panels. Above: a small network without and with dropout. Below: a map of the trained one, likewise."""
    figure, (above, below) = plotting.subplots(2, 2, size=(9.0, 6.4), height_ratios=[1, 1.1])
    small = data["small network"]
    titles = ("a small network", f"the same with a dropout rate of {options['rate drawn']:g}")
    for ax, title, dropped in zip(above, titles, (None, small["dropped"])):
        plotting.draw_network(ax, small["dropped"], small["weights"], dropped=dropped, numbers="")
        ax.set_title(title)
    before, after = np.array(data["before"]), np.array(data["after"])
    high = np.percentile(before[before > 0], 95)
    titles = (f"{data['layer'].replace('_', ' ')}, map {data['map'] + 1}", f"with its dropout rate of {data['rate']:g}")
    for ax, values, title in zip(below, (before, after), titles):
        shown = ax.imshow(values, origin="lower", interpolation="nearest", vmin=0, vmax=high)
        ax.axis("off")
        ax.set_title(title)
    below[1].plot(*np.nonzero((before > 0) & (after == 0))[::-1], "s", color=plotting.VERMILION, markersize=2.2)
    figure.colorbar(shown, ax=below, shrink=0.7, label="activation (vermilion: dropped)")
    figure.suptitle("Dropout in training: a share of the neurons, drawn at random, gives zero", fontsize=11)
    return figure


OPTIONS = {
    "model": "models/model.h5", "rate drawn": 0.4, "masks": 100, "n_bodies": 100, "size": 30.0, "steps": 150,
}  # fmt: skip
QUICK = {"masks": 40}
FIGURE = Figure("4.6", "Dropout, off and on", compute, None, draw, claims, options=OPTIONS, quick=QUICK, seed=5,
                digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
