"""python scripts/figure_4_3_feature_maps.py: feature maps of a trained network on a state."""

import numpy as np

import deep_contact as dc
from deep_contact.cnn.images import input_image
from deep_contact.cnn.inference import load_model, network_file
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import chapter_4 as worked
from deep_contact.studies import starts


def compute(options, seed, jobs, progress):
    """Input channels, the strongest maps of some layers, the prediction, and the solution beside it."""
    model = load_model(network_file(options["model"]))
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    state = starts.solved_states(scene, steps=options["steps"], contacts_only=False)[-1]
    if not state.contacts.count:
        raise ValueError(f"steps: expected enough of them for contacts, got none after {options['steps']}")
    image = input_image(state, model.spec)
    layers = worked.convolutions(model.network)
    maps = worked.feature_maps(model.network, image, [layer.name for layer in layers])
    evenly = np.unique(np.linspace(0, len(layers) - 1, options["layers"]).round().astype(int))
    panels = [panel("input", image, model.spec.channels, options["maps"])]
    panels += [panel(layers[i].name, maps[layers[i].name], None, options["maps"]) for i in evenly]
    contacts = state.contacts
    solved = np.concatenate([contacts.normal_impulse, contacts.tangent_impulse])
    normal, tangent = model.predict(state)

    def error(normal, tangent):
        return float(np.linalg.norm(np.concatenate([normal, tangent]) - solved) / np.linalg.norm(solved))

    return {
        "scene": plotting.state_data(state),
        "model": {key: model.card.get(key) for key in ("architecture", "parameters", "seed", "training_states")},
        "panels": panels,
        "predicted": {"normal": normal, "tangent": tangent},
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
        "relative error of λ": {
            "network": error(normal, tangent),
            "Builtin": error(contacts.normal_start, contacts.tangent_start),
            "None": 1.0,
        },
    }


def panel(name, maps, labels, count):
    """The strongest maps of a layer, as stored data."""
    chosen = worked.strongest(maps, count)
    return {
        "layer": name,
        "maps in all": int(maps.shape[2]),
        "shown": [str(labels[i]) if labels else f"map {i}" for i in chosen],
        "values": [maps[..., i] for i in chosen],
    }


def claims(data):
    layers, error = data["convolutions"], data["relative error of λ"]
    depths = {c["name"]: f"{c['kernel depth']} of {c['input depth']}" for c in layers}
    deep = all(c["kernel depth"] == c["input depth"] for c in layers)
    yield Claim("a kernel is as deep as its layer's input", "section 4.2.2", deep, depths)
    nearer = "the trained network's impulses are nearer to the solution than zero is"
    yield Claim(nearer, None, error["network"] < 1, error)


def draw(data, options):
    """A row of maps for each layer; below, the impulses predicted and solved."""
    columns, rows = options["maps"], len(data["panels"])
    figure = plotting.new_figure((1.75 * columns, 2.2 * rows + 3.9))
    above, below = figure.subfigures(2, 1, height_ratios=[2.2 * rows, 3.9])
    state = plotting.state_of(data["scene"])
    x_min, y_min, x_max, y_max = state.world.box
    for row, part in zip(above.subplots(rows, columns, squeeze=False), data["panels"]):
        for ax in row:
            ax.axis("off")
        for ax, name, values in zip(row, part["shown"], part["values"]):
            # Impacts are much larger than all else: the colour scale ends at the 95th percentile.
            size = np.percentile(np.abs(values)[np.nonzero(values)], 95) if np.any(values) else 1.0
            look = {"origin": "lower", "extent": (x_min, x_max, y_min, y_max), "interpolation": "nearest"}
            shown = ax.imshow(values, cmap="cividis", vmin=-size, vmax=size, **look)
            ax.set_title(name.replace("_", " "), fontsize=8)
            bar = above.colorbar(shown, ax=ax, location="bottom", shrink=0.9, pad=0.02, ticks=[-size, 0, size])
            bar.ax.set_xticklabels([f"{-size:.2g}", "0", f"{size:.2g}"], fontsize=6)
        n_y, n_x = np.shape(part["values"][0])
        text = f"{part['layer'].replace('_', ' ')}\n{n_y} × {n_x}, {part['maps in all']} maps"
        look = {"rotation": 90, "ha": "right", "va": "center", "fontsize": 8}
        row[0].text(-0.06, 0.5, text, transform=row[0].transAxes, **look)
    draw_impulses(below.subplots(1, 3), state, data["predicted"])
    return figure


def draw_impulses(panels, state, predicted):
    """The pile with the solved impulses and with the predicted ones, and one plotted over the other."""
    solved = state.contacts
    found = solved._replace(normal_impulse=np.maximum(0.0, predicted["normal"]))
    largest = max(solved.normal_impulse.max(), found.normal_impulse.max())
    for ax, contacts, text in ((panels[0], solved, "solved λ$_n$"), (panels[1], found, "predicted λ$_n$, if positive")):
        plotting.draw_state(ax, state.replace(contacts=contacts), colour_by=None, largest_impulse=largest)
        ax.set_title(f"{text}, {contacts.count} contacts" if contacts is solved else text)
    ax = panels[2]
    ax.plot(solved.normal_impulse, predicted["normal"], "o", color=plotting.BLUE, markersize=3, label="normal")
    ax.plot(solved.tangent_impulse, predicted["tangent"], "x", color=plotting.VERMILION, markersize=4, label="tangent")
    ax.axline((0, 0), slope=1, color=plotting.GREY, linewidth=1)
    plotting.label_axes(ax, "solved λ", "predicted λ", x_unit="N·s", y_unit="N·s")
    ax.legend()


OPTIONS = {"model": "models/thesis_factored.h5", "n_bodies": 100, "size": 30.0, "steps": 150, "layers": 4, "maps": 6}
FIGURE = Figure("4.3", "Feature maps of the trained network on a state of the falling pile", compute, None, draw,
                claims, options=OPTIONS, seed=5, digits=4)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
