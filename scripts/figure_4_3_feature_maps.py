"""python scripts/figure_4_3_feature_maps.py: feature maps of a trained network on a state."""

import numpy as np

import deep_contact as dc
from deep_contact.cnn.images import label_image
from deep_contact.cnn.inference import load_model
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import chapter_4 as worked
from deep_contact.studies import starts


def compute(options, seed, jobs, progress):
    """The mass, the strongest map of three convolutions, and λ_n as predicted and as solved."""
    model = load_model(options["model"])
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    state = starts.solved_states(scene, steps=options["steps"], contacts_only=False)[-1]
    if not state.contacts.count:
        raise ValueError(f"steps: expected enough of them for contacts, got none after {options['steps']}")
    image = model.input(state)
    layers = worked.convolutions(model.network)
    maps = worked.feature_maps(model.network, image, [layer.name for layer in layers])
    panels = [{"layer": "input", "map": "mass", "values": image[..., model.spec.channels.index("mass")]}]
    for i in np.unique(np.linspace(0, len(layers) - 1, 3).round().astype(int)):
        found = maps[layers[i].name]
        best = int(worked.strongest(found, 1)[0])
        shown = f"map {best + 1} of {found.shape[2]}"
        panels.append({"layer": layers[i].name, "map": shown, "values": found[..., best]})
    panels.append({"layer": "output", "map": "λ_n, predicted", "values": model.run(image)[..., 0]})
    panels.append({"layer": "label", "map": "λ_n, solved", "values": label_image(state, model.spec)[..., 0]})
    contacts = state.contacts
    solved = np.concatenate([contacts.normal_impulse, contacts.tangent_impulse])
    builtin, none = (contacts.normal_start, contacts.tangent_start), (0.0 * contacts.normal_start,) * 2
    given = {"network": model.predict(state), "Builtin": builtin, "None": none}
    off = {name: float(np.linalg.norm(np.concatenate(pair) - solved)) for name, pair in given.items()}
    return {
        "model": {"file": options["model"]} | {key: model.card.get(key) for key in ("architecture", "parameters")},
        "contacts": contacts.count,
        "box": state.world.box,
        "panels": panels,
        "convolutions": [
            {
                "name": layer.name,
                "border": layer.padding,
                "stride": int(layer.strides[0]),
                "input depth": int(layer.input.shape[-1]),
                "kernel depth": int(layer.kernel.shape[2]),
                "nodes": int(maps[layer.name].shape[0]),
            }
            for layer in layers
        ],
        "relative error of λ": {name: size / float(np.linalg.norm(solved)) for name, size in off.items()},
    }


def claims(data):
    layers, error = data["convolutions"], data["relative error of λ"]
    depths = {c["name"]: f"{c['kernel depth']} of {c['input depth']}" for c in layers}
    deep = all(c["kernel depth"] == c["input depth"] for c in layers)
    yield Claim("a kernel is as deep as its layer's input", "section 4.2.2", deep, depths)
    nearer = "the trained network's impulses are nearer to the solution than zero is"
    yield Claim(nearer, None, error["network"] < 1, error)


def draw(data, options):
    """Six images of one state: from the input through the layers to the output, and the solution."""
    figure, panels = plotting.subplots(2, 3, size=(9.0, 6.6))
    x_min, y_min, x_max, y_max = data["box"]
    for ax, part in zip(panels.flat, data["panels"]):
        values = np.array(part["values"])
        # Impacts are much larger than all else: the colours end at the 95th percentile.
        largest = np.percentile(np.abs(values)[np.nonzero(values)], 95) if np.any(values) else 1.0
        look = {"origin": "lower", "extent": (x_min, x_max, y_min, y_max), "interpolation": "nearest"}
        shown = ax.imshow(values, vmin=min(0.0, -largest * (values.min() < 0)), vmax=largest, **look)
        unit = {"input": "kg", "output": "N·s", "label": "N·s"}.get(part["layer"], "activation")
        figure.colorbar(shown, ax=ax, shrink=0.8, label=unit)
        n_y, n_x = values.shape
        ax.set_title(f"{part['layer'].replace('_', ' ')}, {n_y} × {n_x} nodes\n{part['map'].replace('λ_n', 'λ$_n$')}")
        ax.axis("off")
    for ax in list(panels.flat)[len(data["panels"]) :]:
        ax.remove()
    error = data["relative error of λ"]["network"]
    text = f"What a network sees: {data['model']['file']} on a falling pile; error of λ: {100 * error:.0f} %"
    figure.suptitle(text, fontsize=11)
    return figure


OPTIONS = {"model": "models/thesis_factored.h5", "n_bodies": 100, "size": 30.0, "steps": 150}
FIGURE = Figure("4.3", "Feature maps of the thesis's network on a state of the falling pile", compute, None, draw,
                claims, options=OPTIONS, seed=5, digits=4)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
