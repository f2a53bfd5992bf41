"""python scripts/figure_4_3_feature_maps.py: feature maps of a trained network on a state."""

import numpy as np

import deep_contact as dc
from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import chapter_4 as worked
from deep_contact.studies import chapter_5, starts


def compute(options, seed, jobs, progress):
    """The masses that enter, the strongest maps of some layers, the prediction, and the solution beside it."""
    model = chapter_5.image_network(options["model"])
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    state = starts.solved_states(scene, steps=options["steps"], contacts_only=False)[-1]
    if not state.contacts.count:
        raise ValueError(f"steps: expected enough of them for contacts, got none after {options['steps']}")
    image, network = model.input(state), model.network
    layers = [layer for layer in network.layers if max(getattr(layer, "kernel_size", (1,))) > 1]
    maps = worked.feature_maps(network, image, [layer.name for layer in layers])
    panels = [{"layer": "input", "map": "mass", "values": image[..., model.spec.channels.index("mass")]}]
    for i in np.unique(np.linspace(0, len(layers) - 1, options["layers"]).round().astype(int)):
        of_layer = maps[layers[i].name]
        best = worked.strongest(of_layer)
        about = {"layer": layers[i].name.replace("_", " "), "map": f"map {best} of {of_layer.shape[2]}"}
        panels.append(about | {"values": of_layer[..., best]})
    solved = np.array([state.contacts.normal_impulse, state.contacts.tangent_impulse])
    predicted = np.array(model.predict(state, project=False))
    shared = chapter_5.ReadBySharing(options["model"])(state, None)
    guess = {"network": predicted, "network, shared (authors' code)": shared, "None": 0.0}
    guess["Builtin"] = [state.contacts.normal_start, state.contacts.tangent_start]
    return {
        "box": state.world.box,
        "panels": panels,
        "solved": solved[0],
        "predicted": predicted[0],
        "depths": {layer.name: [int(layer.kernel.shape[2]), int(layer.input.shape[-1])] for layer in layers},
        "relative error of λ": {
            name: float(np.linalg.norm(one - solved) / np.linalg.norm(solved)) for name, one in guess.items()
        },
    }


def claims(data):
    error = data["relative error of λ"]
    deep = all(kernel == of_input for kernel, of_input in data["depths"].values())
    depths = {name: f"{kernel} of {of_input}" for name, (kernel, of_input) in data["depths"].items()}
    yield Claim("a kernel is as deep as its layer's input", "section 4.2.2", deep, depths)
    nearer = "the trained network's impulses are nearer to the solution than zero is"
    yield Claim(nearer, None, error["network"] < 1, error)
    for name in (name for name in error if name.startswith("network")):
        well = f"the {name} predicts the grid values well: λ is off by at most a half"
        yield Claim(well, "section 6.2.2", error[name] <= 0.5, error)


def draw(data, options):
    """The masses, the strongest map of some layers, and the impulses predicted over those solved."""
    figure, axes = plotting.subplots(2, 3, size=(9.0, 6.4))
    *panels, last = axes.flat
    x_min, y_min, x_max, y_max = data["box"]
    look = {"origin": "lower", "extent": (x_min, x_max, y_min, y_max), "interpolation": "nearest"}
    for ax, part in zip(panels, data["panels"]):
        values = np.array(part["values"])
        # Impacts are much larger than all else: the colours end at the 95th percentile.
        size = np.percentile(np.abs(values)[np.nonzero(values)], 95) if np.any(values) else 1.0
        shown = ax.imshow(values, vmin=-size if values.min() < 0 else 0.0, vmax=size, **look)
        figure.colorbar(shown, ax=ax, shrink=0.8, label="mass (kg)" if part["layer"] == "input" else "activation")
        block, _, layer = part["layer"].rpartition(" ")
        name = f"{block}, layer {layer}" if block else layer
        ax.set_title(f"{name}\n{part['map']}\n{len(values)} × {values.shape[1]} nodes")
        ax.axis("off")
    for ax in panels[len(data["panels"]) :]:
        ax.remove()
    last.plot(data["solved"], data["predicted"], "o", color=plotting.PURPLE, markersize=3)
    last.axline((0, 0), slope=1, color=plotting.GREY, linewidth=1)
    most = 1.05 * max(data["solved"] + data["predicted"])
    last.set(xlim=(-0.03 * most, most), ylim=(-0.03 * most, most), aspect="equal")
    last.set(xlabel="solved λ$_n$ (N·s)", ylabel="predicted λ$_n$ (N·s)")
    last.set_title(f"output\nrelative error of λ: {data['relative error of λ']['network']:.2f}")
    figure.suptitle(f"What the thesis's network sees of a falling pile ({options['model']})", fontsize=11)
    return figure


OPTIONS = {"model": "models/thesis_factored.h5", "n_bodies": 100, "size": 30.0, "steps": 150, "layers": 4}
FIGURE = Figure("4.3", "Feature maps of the trained network on a state of the falling pile", compute, None, draw,
                claims, options=OPTIONS, seed=5, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
