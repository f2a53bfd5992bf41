"""python scripts/figure_4_4_neuron.py: a neuron computed step by step, and ReLU beside other activation functions."""

from collections.abc import Callable

import numpy as np

from deep_contact import figures, parallel
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.studies import chapter_4 as worked

ACTIVATIONS: dict[str, tuple[Callable, Callable]] = {
    "ReLU": (worked.relu, lambda x: np.where(x > 0, 1.0, 0.0)),
    "sigmoid": (lambda x: 1 / (1 + np.exp(-x)), lambda x: np.exp(-x) / (1 + np.exp(-x)) ** 2),
    "tanh": (np.tanh, lambda x: 1 - np.tanh(x) ** 2),
}
"""Name of an activation function -> (the function, its derivative)."""


def gradient_ratio(activation: str, *, depth: int, width: int, gain: float, seed: int) -> float:
    """Return the norm of a gradient at the input of a deep network over its norm at the output.

    The network has `depth` layers of `width` neurons. Its weights are normal with the standard deviation
    gain · √(2 / width), which for gain = 1 is He's initialisation. A random input is propagated forward, and then a
    random gradient at the output is propagated back. activation: one of `ACTIVATIONS`.
    """
    rng = np.random.default_rng(seed)
    function, derivative = ACTIVATIONS[activation]
    weights = rng.normal(0.0, gain * np.sqrt(2 / width), (depth, width, width))
    x, sums = rng.normal(size=width), []
    for w in weights:
        sums.append(x @ w)
        x = function(sums[-1])
    last = gradient = rng.normal(size=width)
    for w, z in zip(weights[::-1], sums[::-1]):
        gradient = w @ (gradient * derivative(z))
    return float(np.linalg.norm(gradient) / np.linalg.norm(last))


def compute(options, seed, jobs, progress):
    """Compute a neuron by Eq 4.3, the activation functions and their derivatives, and ratios of `gradient_ratio`."""
    x, w, bias = options["x"], options["w"], options["bias"]
    total = float(np.dot(x, w) + bias)
    line = np.linspace(-4.0, 4.0, options["points"])
    seeds = parallel.seeds(seed, options["networks"])
    size = {"depth": options["depth"], "width": options["width"]}
    ratios = {
        name: {
            f"{gain:g}": float(np.median([gradient_ratio(name, gain=gain, seed=s, **size) for s in seeds]))
            for gain in options["gains"]
        }
        for name in ACTIVATIONS
    }
    return {
        **{"x": x, "w": w, "bias": bias, "sum": total, "output": float(worked.relu(total))},
        "line": line,
        "functions": {name: f(line) for name, (f, _) in ACTIVATIONS.items()},
        "derivatives": {name: df(line) for name, (_, df) in ACTIVATIONS.items()},
        "gradient ratio, by gain": ratios,
        **size,
    }


def claims(data):
    ratios = data["gradient ratio, by gain"]
    below = np.array(data["line"]) < 0
    lost = {
        f"largest {what} for x < 0": float(np.max(np.array(data[part]["ReLU"])[below]))
        for what, part in (("value", "functions"), ("derivative", "derivatives"))
    }
    yield Claim("ReLU gets rid of every piece of negative information", "section 4.2.3", not any(lost.values()), lost)
    he = {name: by_gain["1"] for name, by_gain in ratios.items()}
    text = "vanishing or exploding gradients hardly affect ReLU: with the thesis's He normal weights (Table 5.2) a"
    text += f" gradient keeps its size through {data['depth']} layers, within a factor of ten"
    yield Claim(text, "section 4.2.3, Table 5.2", 0.1 <= he["ReLU"] <= 10, he)
    relu = {f"{gain} × He": ratio for gain, ratio in ratios["ReLU"].items()}
    text = f"with weights of {' and '.join(ratios['ReLU'])} times He's it keeps it too"
    yield Claim(text, None, all(0.1 <= ratio <= 10 for ratio in relu.values()), relu)


def draw(data, options):
    """Draw three panels. Left: the neuron with its numbers. Middle and right: the functions and their derivatives."""
    figure, (ax, functions, derivatives) = plotting.subplots(1, 3, size=(11.0, 3.6), width_ratios=[1.5, 1, 1])
    values, weights = [[*data["x"], 1.0], [data["sum"]], [data["output"]]], [*data["w"], data["bias"]]
    parts = [[[w] for w in weights], [[1.0]]]
    plotting.draw_network(ax, values, parts, titles=("x$_i$, and 1", "sum", "y"), numbers="{:g}")
    names = [*(f"w$_{i}$" for i in range(1, len(weights))), "bias"]
    for i, (name, weight) in enumerate(zip(names, weights)):
        ax.text(-0.3, 0.5 * len(data["x"]) - i, f"{name} = {weight:g}", ha="right", va="center", fontsize=9)
    ax.set(xlim=(-1.2, 2.4), title="y = ReLU(Σ w$_i$ x$_i$ + bias)")
    for panel, part, title in ((functions, "functions", "f(x)"), (derivatives, "derivatives", "f'(x)")):
        styles = plotting.styles_of(data[part])
        for name, values in data[part].items():
            panel.plot(data["line"], values, **styles[name])
        panel.set(xlabel="x", ylabel=title)
    functions.set_ylim(-1.2, 2.2)
    functions.legend()
    return figure


GAINS = [0.5, 1.0, 2.0]
"""Standard deviations of the weights over those of He's initialisation."""

OPTIONS = {"x": [1.5, -2.0, 0.5], "w": [0.8, 0.3, -1.2], "bias": 0.4, "points": 401}
OPTIONS |= {"depth": 20, "width": 100, "gains": GAINS, "networks": 20}
FIGURE = Figure("4.4", "A neuron and its activation function", compute, None, draw, claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
