"""python scripts/figure_4_7_backpropagation.py: Eq 4.11-4.18 with numbers, held against automatic differentiation."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import chapter_4 as worked

LATE = "Eq 4.18, output weights updated before"
ROUNDING = 1e-12
"""Largest relative difference that counts as none: of sums of a few products in float64."""


def compute(options, seed, jobs, progress):
    """One forward and one backward pass by the thesis's equations and automatically, and one update of the weights."""
    x, w_h, w_o = (np.array(options[name]) for name in ("x", "hidden weights", "output weights"))
    target, rate = options["target"], options["rate"]
    found = worked.backpropagate(x, w_h, w_o, target)
    automatic = worked.automatic_gradients(x, w_h, w_o, target)
    step_o, step_h = w_o - rate * automatic["output"], w_h - rate * automatic["hidden"]  # Eq 4.8, the first step
    chain = found["chain"]
    common, by_hidden = chain["∂L/∂e"] * chain["∂e/∂y"], chain["∂y/∂v"] * chain["∂v/∂w"]
    early, late = (w_h + 2 * rate * found["e"] * np.outer(x, w) for w in (w_o, step_o))
    stepped = worked.backpropagate(x, step_h, step_o, target)
    loss = {"before": found["loss"], "after the step of Eq 4.8": stepped["loss"]}
    output, hidden = automatic["output"], automatic["hidden"]
    return {
        **{name: np.array(options[name]) for name in ("x", "hidden weights", "output weights", "target")},
        **{name: found[name] for name in ("v", "y", "e", "chain")},
        "loss": loss,
        "gradients": {
            "output": {"Eq 4.12": common * chain["∂y/∂w"], "Eq 4.13": found["output"], "automatic": output},
            "hidden": {"Eq 4.15": common * by_hidden, "Eq 4.17": found["hidden"], "automatic": hidden},
        },
        "chain, automatic": {name: automatic[name] for name in chain},
        "updated": {
            "output": {"Eq 4.14": w_o + rate * found["v"] * found["e"], "Eq 4.8": step_o},
            "hidden": {"Eq 4.18": early, LATE: late, "Eq 4.8": step_h},
        },
    }


def apart(a, b):
    """Largest difference, over the largest size of b."""
    return float(np.abs(np.subtract(a, b)).max() / np.abs(b).max())


def claims(data):
    gradients, updated = data["gradients"], data["updated"]
    factors = {name: apart(value, data["chain, automatic"][name]) for name, value in data["chain"].items()}

    def gradient(number, part, thesis, text, **measured):
        measured |= {"relative difference to automatic": apart(gradients[part][number], gradients[part]["automatic"])}
        return Claim(text, thesis, max(measured.values()) < ROUNDING, measured)

    def update(number, part, thesis, text):
        before = np.array(data[f"{part} weights"])
        printed, right = (np.array(updated[part][name]) - before for name in (number, "Eq 4.8"))
        measured = {
            "relative difference to Eq 4.8's step": apart(printed, right),
            "size, over that of Eq 4.8": float(np.linalg.norm(printed) / np.linalg.norm(right)),
        }
        return Claim(text, thesis, measured["relative difference to Eq 4.8's step"] < ROUNDING, measured)

    loss = data["loss"]
    chain = "Eq 4.11 and 4.12: the chain rule for the output's weights"
    hidden_chain = "Eq 4.15 and 4.16: the chain rule for the hidden weights"
    step = "Eq 4.14: w_j + α v_j e is the step of Eq 4.8 (its first, without velocity)"
    after = "the hidden weights can be updated by Eq 4.18 after the output's weights were"
    return [
        gradient("Eq 4.12", "output", "Eq 4.11, Eq 4.12", chain, **factors),
        gradient("Eq 4.13", "output", "Eq 4.13", "Eq 4.13: ∂L/∂w_j = −2 v_j e"),
        update("Eq 4.14", "output", "Eq 4.14", step),
        gradient("Eq 4.15", "hidden", "Eq 4.15, Eq 4.16", hidden_chain, **factors),
        gradient("Eq 4.17", "hidden", "Eq 4.17", "Eq 4.17: ∂L/∂w_ij = −2 e w_j x_i"),
        update("Eq 4.18", "hidden", "Eq 4.18", "Eq 4.18: w_ij + 2 α e w_j x_i is the step of Eq 4.8"),
        update(LATE, "hidden", "section 4.3.5", after),
        Claim("a step decreases the loss", "section 4.3.5", loss["after the step of Eq 4.8"] < loss["before"], loss),
    ]


def draw(data, options):
    """Left: the network with the numbers of the forward pass. Right: the gradients, by the equations and automatic."""
    figure, (ax, bars) = plotting.subplots(1, 2, size=(10.0, 4.2), width_ratios=[1.1, 1])
    weights = [data["hidden weights"], [[w] for w in data["output weights"]]]
    titles = ("inputs x$_i$", "hidden v$_j$ (Eq 4.16)", "output y (Eq 4.11)")
    plotting.draw_network(ax, [data["x"], data["v"], [data["y"]]], weights, titles=titles)
    text = f"d = {data['target']:g}\ne = d − y = {data['e']:.3g}\nL = e² = {data['loss']['before']:.3g}"
    ax.text(2, 0.55, text, ha="center", va="bottom", fontsize=9)
    names, printed, automatic = [], [], []
    for part, equation in (("output", "Eq 4.13"), ("hidden", "Eq 4.17")):
        found = data["gradients"][part]
        printed += np.ravel(found[equation]).tolist()
        automatic += np.ravel(found["automatic"]).tolist()
        for index in np.ndindex(np.shape(found[equation])):
            names.append(f"$w^{part[0]}_{{{''.join(str(i + 1) for i in index)}}}$")
    place = np.arange(len(names))
    bars.barh(place, printed, height=0.6, color=plotting.SKY, label="Eq 4.13 and 4.17")
    bars.plot(automatic, place, "x", color=plotting.BLACK, label="automatic differentiation")
    bars.axvline(0, color=plotting.GREY, linewidth=0.8)
    bars.set_yticks(place, names)
    bars.invert_yaxis()
    plotting.label_axes(bars, "gradient ∂L/∂w", "")
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
