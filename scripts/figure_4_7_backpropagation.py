"""python scripts/figure_4_7_backpropagation.py: Eq 4.11-4.18 with numbers, held against automatic differentiation."""

import numpy as np

from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import chapter_4 as worked

ROUNDING = 1e-12
"""Largest relative difference that counts as none: of sums of a few products in float64."""

CLAIMS = {
    "Eq 4.12": ("Eq 4.11, Eq 4.12", "Eq 4.11 and 4.12: the chain rule for the output's weights"),
    "Eq 4.13": ("Eq 4.13", "Eq 4.13: ∂L/∂w_j = −2 v_j e"),
    "Eq 4.14": ("Eq 4.14", "Eq 4.14: w_j + α v_j e is the step of Eq 4.8 (its first, without velocity)"),
    "Eq 4.15": ("Eq 4.15, Eq 4.16", "Eq 4.15 and 4.16: the chain rule for the hidden weights"),
    "Eq 4.17": ("Eq 4.17", "Eq 4.17: ∂L/∂w_ij = −2 e w_j x_i"),
    "Eq 4.18": ("Eq 4.18", "Eq 4.18: w_ij + 2 α e w_j x_i is the step of Eq 4.8"),
    "late": ("section 4.3.5", "the hidden weights can be updated by Eq 4.18 after the output's weights were"),
}
"""What is compared -> where the thesis says it, and what."""


def compute(options, seed, jobs, progress):
    """One forward and one backward pass by the thesis's equations and automatically, and one update of the weights.

    "compared" has, for each of `CLAIMS`, the thesis's numbers and those by automatic differentiation.
    """
    x, w_h, w_o = (np.array(options[name]) for name in ("x", "hidden weights", "output weights"))
    target, rate = options["target"], options["rate"]
    values = worked.backpropagate(x, w_h, w_o, target)
    right = worked.automatic_gradients(x, w_h, w_o, target)
    chain, e = values["chain"], values["e"]
    factors = [right[name] for name in chain]
    common = chain["∂L/∂e"] * chain["∂e/∂y"]
    step_o, step_h = -rate * right["output"], -rate * right["hidden"]  # Eq 4.8, the first step
    compared = {
        "Eq 4.12": ([*chain.values(), common * chain["∂y/∂w"]], [*factors, right["output"]]),
        "Eq 4.13": ([values["output"]], [right["output"]]),
        "Eq 4.14": ([rate * values["v"] * e], [step_o]),
        "Eq 4.15": ([*chain.values(), common * chain["∂y/∂v"] * chain["∂v/∂w"]], [*factors, right["hidden"]]),
        "Eq 4.17": ([values["hidden"]], [right["hidden"]]),
        "Eq 4.18": ([2 * rate * e * np.outer(x, w_o)], [step_h]),
        "late": ([2 * rate * e * np.outer(x, w_o + step_o)], [step_h]),
    }
    stepped = worked.backpropagate(x, w_h + step_h, w_o + step_o, target)
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
    """Left: the network with the numbers of the forward pass. Right: the gradients, by the equations and automatic."""
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


# Every number exact, so that rounding is the only difference there may be
OPTIONS = {
    "x": [0.5, -1.0], "hidden weights": [[0.4, -0.6, 0.9], [-0.3, 0.8, 0.2]], "output weights": [0.7, -0.5, 0.3],
    "target": 2.0, "rate": 0.1,
}  # fmt: skip
FIGURE = Figure("4.7", "Backpropagation by Eq 4.11-4.18, with numbers", compute, None, draw, claims, options=OPTIONS,
                digits=None)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
