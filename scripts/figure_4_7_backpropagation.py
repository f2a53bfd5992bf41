"""python scripts/figure_4_7_backpropagation.py: Eq 4.11-4.18 with numbers, compared with automatic differentiation."""

import numpy as np

from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting

ROUNDING = 1e-12
"""Largest relative difference that counts as a rounding error of sums of a few products in float64."""

CLAIMS = {
    "Eq 4.12": ("Eq 4.11, Eq 4.12", "Eq 4.11 and 4.12: the chain rule for the output's weights"),
    "Eq 4.13": ("Eq 4.13", "Eq 4.13: ∂L/∂w_j = −2 v_j e"),
    "Eq 4.14": ("Eq 4.14", "Eq 4.14: w_j + α v_j e is the step of Eq 4.8 (its first, without velocity)"),
    "Eq 4.15": ("Eq 4.15, Eq 4.16", "Eq 4.15 and 4.16: the chain rule for the hidden weights"),
    "Eq 4.17": ("Eq 4.17", "Eq 4.17: ∂L/∂w_ij = −2 e w_j x_i"),
    "Eq 4.18": ("Eq 4.18", "Eq 4.18: w_ij + 2 α e w_j x_i is the step of Eq 4.8"),
    "late": ("section 4.3.5", "the hidden weights can be updated by Eq 4.18 after the output's weights were"),
}
"""Name of a comparison -> (its place in the thesis, the statement there)."""


def backpropagate(x: np.ndarray, w_hidden: np.ndarray, w_output: np.ndarray, target: float) -> dict:
    """Compute the forward and the backward pass of the thesis's example by Eq 4.11-4.17.

    The network of the example has one output, and all its neurons are linear. x: inputs, (I,). w_hidden: weights of the
    hidden neurons, (I, J). w_output: weights of the output, (J,). target: true output d. Returns a dict:

    * "v": values of the hidden neurons, (J,), Eq 4.16;
    * "y": output, "e": error d − y, "loss": L = e², Eq 4.11;
    * "chain": factors in the chain rules of Eq 4.12 and 4.15, by name;
    * "output": derivatives ∂L/∂w_j with respect to the output's weights, (J,), Eq 4.13;
    * "hidden": derivatives ∂L/∂w_ij with respect to the hidden weights, (I, J), Eq 4.17.
    """
    v = x @ w_hidden
    y = float(w_output @ v)
    e = float(target - y)
    of_hidden = np.repeat(x[:, None], w_output.size, axis=1)  # ∂v_j/∂w_ij; v_j depends on no other hidden weights
    chain = {"∂L/∂e": np.array(2 * e), "∂e/∂y": np.array(-1.0), "∂y/∂v": w_output, "∂y/∂w": v, "∂v/∂w": of_hidden}
    values = {"v": v, "y": y, "e": e, "loss": e**2, "chain": chain}
    return values | {"output": -2 * v * e, "hidden": -2 * e * np.outer(x, w_output)}


def automatic_gradients(x, w_hidden, w_output, target) -> dict[str, np.ndarray]:
    """Compute the gradients of the network of `backpropagate` by automatic differentiation of the loss.

    The arguments are those of `backpropagate`. Returns a dict with "output", (J,), "hidden", (I, J), and the factors of
    the chain rules, by the names that they have in the result of `backpropagate`.
    """
    from deep_contact.cnn.backend import tensorflow as tf

    x, w_h, w_o, d = (tf.constant(value, tf.float64) for value in (x, w_hidden, w_output, target))
    with tf.GradientTape(persistent=True) as tape:
        tape.watch([w_h, w_o])
        v = tf.linalg.matvec(w_h, x, transpose_a=True)
        y = tf.reduce_sum(w_o * v)
        e = d - y
        loss = e**2
        total = tf.reduce_sum(v)
    pairs = {"output": (loss, w_o), "hidden": (loss, w_h), "∂L/∂e": (loss, e), "∂e/∂y": (e, y)}
    # w_ij affects v_j only, so the derivative of the sum of all v is that of v_j.
    pairs |= {"∂y/∂v": (y, v), "∂y/∂w": (y, w_o), "∂v/∂w": (total, w_h)}
    return {name: tape.gradient(*pair).numpy() for name, pair in pairs.items()}


def compute(options, seed, jobs, progress):
    """Compute one forward and one backward pass and one update of the weights, by Eq 4.11-4.18 and automatically.

    For each name in `CLAIMS`, "compared" has the numbers by the thesis's equations, and those by automatic
    differentiation.
    """
    x, w_h, w_o = (np.array(options[name]) for name in ("x", "hidden weights", "output weights"))
    target, rate = options["target"], options["rate"]
    values = backpropagate(x, w_h, w_o, target)
    right = automatic_gradients(x, w_h, w_o, target)
    chain, e = values["chain"], values["e"]
    factors = [right[name] for name in chain]
    common = chain["∂L/∂e"] * chain["∂e/∂y"]
    step_o, step_h = -rate * right["output"], -rate * right["hidden"]  # the first step of Eq 4.8
    compared = {
        "Eq 4.12": ([*chain.values(), common * chain["∂y/∂w"]], [*factors, right["output"]]),
        "Eq 4.13": ([values["output"]], [right["output"]]),
        "Eq 4.14": ([rate * values["v"] * e], [step_o]),
        "Eq 4.15": ([*chain.values(), common * chain["∂y/∂v"] * chain["∂v/∂w"]], [*factors, right["hidden"]]),
        "Eq 4.17": ([values["hidden"]], [right["hidden"]]),
        "Eq 4.18": ([2 * rate * e * np.outer(x, w_o)], [step_h]),
        "late": ([2 * rate * e * np.outer(x, w_o + step_o)], [step_h]),
    }
    stepped = backpropagate(x, w_h + step_h, w_o + step_o, target)
    return {
        **{name: options[name] for name in ("x", "hidden weights", "output weights", "target")},
        **{name: values[name] for name in ("v", "y", "e")},
        "loss": {"before": values["loss"], "after the step of Eq 4.8": stepped["loss"]},
        "compared": {name: [np.hstack([*map(np.ravel, side)]) for side in sides] for name, sides in compared.items()},
    }


def claims(data):
    for number, (thesis, text) in CLAIMS.items():
        printed, right = map(np.array, data["compared"][number])
        apart = float(np.abs(printed - right).max() / np.abs(right).max())
        size = float(np.linalg.norm(printed) / np.linalg.norm(right))
        measured = {"relative difference to automatic differentiation": apart, "size, over its": size}
        yield Claim(text, thesis, apart < ROUNDING, measured)
    loss = data["loss"]
    yield Claim("a step decreases the loss", "section 4.3.5", loss["after the step of Eq 4.8"] < loss["before"], loss)


def draw(data, options):
    """Draw two panels. Left: the network with the numbers of the forward pass. Right: the gradients in both ways."""
    figure, (ax, bars) = plotting.subplots(1, 2, size=(10.0, 4.2), width_ratios=[1.1, 1])
    weights = [data["hidden weights"], [[w] for w in data["output weights"]]]
    titles = ("inputs x$_i$", "hidden v$_j$ (Eq 4.16)", "output y (Eq 4.11)")
    plotting.draw_network(ax, [data["x"], data["v"], [data["y"]]], weights, titles=titles)
    text = f"d = {data['target']:g}\ne = d − y = {data['e']:.3g}\nL = e² = {data['loss']['before']:.3g}"
    ax.text(2, 0.55, text, ha="center", va="bottom", fontsize=9)
    printed, automatic = np.hstack([data["compared"][equation] for equation in ("Eq 4.13", "Eq 4.17")])
    indices = [("o", *i) for i in np.ndindex(np.shape(data["output weights"]))]
    indices += [("h", *i) for i in np.ndindex(np.shape(data["hidden weights"]))]
    names = [f"$w^{part}_{{{''.join(str(i + 1) for i in index)}}}$" for part, *index in indices]
    bars.barh(range(len(names)), printed, height=0.6, color=plotting.SKY, label="Eq 4.13 and 4.17")
    bars.plot(automatic, range(len(names)), "x", color=plotting.BLACK, label="automatic differentiation")
    bars.axvline(0, color=plotting.GREY, linewidth=0.8)
    plotting.name_bars(bars, names)
    bars.set_xlabel("gradient ∂L/∂w")
    bars.legend()
    return figure


# `digits=None` stores all digits of the data. So the compared numbers can differ by rounding errors only.
OPTIONS = {
    "x": [0.5, -1.0], "hidden weights": [[0.4, -0.6, 0.9], [-0.3, 0.8, 0.2]], "output weights": [0.7, -0.5, 0.3],
    "target": 2.0, "rate": 0.1,
}  # fmt: skip
FIGURE = Figure("4.7", "Backpropagation by Eq 4.11-4.18, with numbers", compute, None, draw, claims, options=OPTIONS,
                digits=None)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
