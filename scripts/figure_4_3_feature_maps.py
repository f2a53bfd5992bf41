"""python scripts/figure_4_3_feature_maps.py: feature maps of a trained network on a state."""

import numpy as np

import deep_contact as dc
from deep_contact.cnn.inference import load_model
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import chapter_4 as worked
from deep_contact.studies import starts


def compute(options, seed, jobs, progress):
    """Input channels, the strongest maps of some layers, the prediction, and the solution beside it."""
    model = load_model(options["model"])
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    state = starts.solved_states(scene, steps=options["steps"], contacts_only=False)[-1]
    if not state.contacts.count:
        raise ValueError(f"steps: expected enough of them for contacts, got none after {options['steps']}")
    image = model.input(state)
    layers = worked.convolutions(model.network)
    maps = worked.feature_maps(model.network, image, [layer.name for layer in layers])
    evenly = np.unique(np.linspace(0, len(layers) - 1, options["layers"]).round().astype(int))
    panels = [panel("input", image, model.spec.channels, options["maps"])]
    panels += [panel(layers[i].name, maps[layers[i].name], None, options["maps"]) for i in evenly]
    solved = np.array([state.contacts.normal_impulse, state.contacts.tangent_impulse])
    predicted = np.array(model.predict(state, project=False))
    given = {"network": predicted, "Builtin": [state.contacts.normal_start, state.contacts.tangent_start], "None": 0.0}
    depths = [(layer.name, int(layer.input.shape[-1]), int(layer.kernel.shape[2])) for layer in layers]
    errors = {name: float(np.linalg.norm(one - solved) / np.linalg.norm(solved)) for name, one in given.items()}
    return {
        "scene": plotting.state_data(state),
        "panels": panels,
        "predicted": {"normal": predicted[0]},
        "convolutions": [dict(zip(("name", "input depth", "kernel depth"), depth)) for depth in depths],
        "relative error of λ": errors,
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
    """The strongest map of the input and of some layers, and the impulses predicted over those solved."""
    figure, axes = plotting.subplots(2, 3, size=(9.0, 6.4))
    *panels, last = axes.flat
    state = plotting.state_of(data["scene"])
    x_min, y_min, x_max, y_max = state.world.box
    look = {"origin": "lower", "extent": (x_min, x_max, y_min, y_max), "interpolation": "nearest"}
    for ax, part in zip(panels, data["panels"]):
        i = part["shown"].index("mass") if "mass" in part["shown"] else 0
        values = np.array(part["values"][i])
        # Impacts are much larger than all else: the colours end at the 95th percentile.
        size = np.percentile(np.abs(values)[np.nonzero(values)], 95) if np.any(values) else 1.0
        shown = ax.imshow(values, vmin=-size if values.min() < 0 else 0.0, vmax=size, **look)
        figure.colorbar(shown, ax=ax, shrink=0.8)
        which = part["shown"][i] + f" of {part['maps in all']}" * part["shown"][i].startswith("map")
        ax.set_title(f"{part['layer'].replace('_', ' ')}\n{which}, {len(values)} × {values.shape[1]} nodes")
        ax.axis("off")
    for ax in panels[len(data["panels"]) :]:
        ax.remove()
    last.plot(state.contacts.normal_impulse, data["predicted"]["normal"], "o", color=plotting.PURPLE, markersize=3)
    last.axline((0, 0), slope=1, color=plotting.GREY, linewidth=1)
    most = 1.05 * max(state.contacts.normal_impulse.max(), np.max(data["predicted"]["normal"]))
    last.set(xlim=(-0.03 * most, most), ylim=(-0.03 * most, most), aspect="equal")
    plotting.label_axes(last, "solved λ$_n$", "predicted λ$_n$", x_unit="N·s", y_unit="N·s")
    last.set_title(f"output\nrelative error of λ: {data['relative error of λ']['network']:.2f}")
    figure.suptitle(f"What the thesis's network sees of a falling pile ({options['model']})", fontsize=11)
    return figure


OPTIONS = {"model": "models/thesis_factored.h5", "n_bodies": 100, "size": 30.0, "steps": 150, "layers": 4, "maps": 6}
FIGURE = Figure("4.3", "Feature maps of the trained network on a state of the falling pile", compute, None, draw,
                claims, options=OPTIONS, seed=5, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
