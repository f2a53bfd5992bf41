"""python scripts/figure_4_1_network.py: a network of three layers, with the values of its neurons and weights."""

from collections.abc import Sequence

import numpy as np

from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.studies import chapter_4 as worked


def forward(x: np.ndarray, layers: Sequence[tuple]) -> list[np.ndarray]:
    """Return the values of the neurons in every layer of a network, the input first (section 4.2.5).

    ReLU is applied after all layers but the last. x: input, (inputs,). layers: weights (inputs, outputs) and bias
    (outputs,) of each layer.
    """
    values = [np.asarray(x, dtype=np.float64)]
    for number, (weights, bias) in enumerate(layers, start=1):
        z = values[-1] @ weights + bias
        values.append(z if number == len(layers) else worked.relu(z))
    return values


def compute(options, seed, jobs, progress):
    """Compute the values of all neurons for one input, and the output of the same network by Keras's `Dense` layers."""
    sizes = [len(options["input"]), options["hidden"], options["output"]]
    layers, by_keras = worked.random_layers(sizes, seed), np.array(options["input"])
    for (weights, bias), activation in zip(layers, ("relu", "linear")):
        by_keras = worked.by_keras("Dense", bias.size, x=by_keras, weights=(weights, bias), activation=activation)
    return {
        "values": forward(options["input"], layers),
        "weights": [weights for weights, _ in layers],
        "Keras": by_keras,
        "parameters": sum(weights.size + bias.size for weights, bias in layers),
    }


def claims(data):
    difference = float(np.abs(np.subtract(data["values"][-1], data["Keras"])).max())
    text = "matrix multiplications and biases, with ReLU between, complete a fully connected network: equal to Keras's"
    measured = {"largest difference": difference, "parameters": data["parameters"]}
    holds = difference <= 1e-12 * np.abs(data["Keras"]).max()  # allows for rounding errors in sums of a few products
    return [Claim(text, "section 4.2.5", bool(holds), measured)]


def draw(data, options):
    """Draw the neurons in three columns. The lines between them show the weights."""
    figure, ax = plotting.subplots(size=(6.4, 4.2))
    titles = ("input layer", "hidden layer (ReLU)", "output layer")
    plotting.draw_network(ax, data["values"], data["weights"], titles=titles)
    ax.plot([], [], color=plotting.BLUE, label="weight > 0")
    ax.plot([], [], color=plotting.VERMILION, linestyle="--", label="weight < 0")
    ax.legend(loc="upper right")
    return figure


OPTIONS = {"input": [1.0, -0.5, 0.25], "hidden": 4, "output": 2}
FIGURE = Figure("4.1", "A network of three layers", compute, None, draw, claims, options=OPTIONS, seed=1, digits=None)
figures.run_as_script(FIGURE, __name__)
