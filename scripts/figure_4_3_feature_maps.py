"""python scripts/figure_4_3_feature_maps.py: feature maps of a trained network on a state."""

import numpy as np

import deep_contact as dc
from deep_contact import figures
from deep_contact.cnn.images import label_image
from deep_contact.figures import Claim, Figure
from deep_contact.parallel import seeds
from deep_contact.plot import plotting
from deep_contact.sph.start import Sph
from deep_contact.studies import chapter_4 as worked
from deep_contact.studies import chapter_5, starts, verdicts

GRID, CONTACTS = "error of grid values", "error of λ at contacts"
NETWORK = "network"


def compute(options, seed, jobs, progress):
    """Compute feature maps of a network on a state, its prediction, and the errors of its prediction.

    The data have the input channel of the masses, the strongest map of some layers, and the predicted and the solved
    impulses, all of the first scene. The errors are those of all scenes.
    """
    model = chapter_5.image_network(options["model"])
    states = [fallen(options, one) for one in progress(seeds(seed, options["scenes"]), text="scenes")]
    state, network = states[0], model.network
    image = model.input(state)
    layers = [layer for layer in network.layers if max(getattr(layer, "kernel_size", (1,))) > 1]
    maps = worked.feature_maps(network, image, [layer.name for layer in layers])
    panels = [{"layer": "input", "map": "mass", "values": image[..., model.spec.channels.index("mass")]}]
    for i in np.unique(np.linspace(0, len(layers) - 1, options["layers"]).round().astype(int)):
        of_layer = maps[layers[i].name]
        best = worked.strongest(of_layer)
        about = {"layer": layers[i].name.replace("_", " "), "map": f"map {best} of {of_layer.shape[2]}"}
        panels.append(about | {"values": of_layer[..., best]})
    predicted, _ = model.predict(state, project=False)
    return {
        "box": state.world.box,
        "panels": panels,
        "solved": state.contacts.normal_impulse,
        "predicted": predicted,
        "depths": {layer.name: [int(layer.kernel.shape[2]), int(layer.input.shape[-1])] for layer in layers},
        GRID: of_scenes(errors_of_grid(model, one) for one in states),
        CONTACTS: of_scenes(errors_at_contacts(model, options["model"], one) for one in states),
    }


def fallen(options, seed):
    """Return the solved state of a falling pile after options["steps"] time steps.

    Raises ValueError if the state has no contacts.
    """
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    state = starts.solved_states(scene, steps=options["steps"], contacts_only=False)[-1]
    if not state.contacts.count:
        raise ValueError(f"steps: expected enough of them for contacts, got none after {options['steps']}")
    return state


def errors_of_grid(model, state):
    """Return the errors of images of impulses, N·s: name of the start -> error.

    An error is the norm of the difference to the image of the solution. Only nodes count at which the solution's image
    is not 0, as in the loss of Appendix B.
    """
    contacts = state.contacts
    past = contacts._replace(normal_impulse=contacts.normal_start, tangent_impulse=contacts.tangent_start)
    true = label_image(state, model.spec)
    images = {NETWORK: model.predict_image(state), "Builtin": label_image(state.replace(contacts=past), model.spec)}
    images |= {"true image": true, "None": np.zeros_like(true)}
    return {name: float(np.linalg.norm((image - true)[true != 0])) for name, image in images.items()}


def errors_at_contacts(model, path, state):
    """Return the errors of the impulses at the contacts, N·s: name of the start -> error.

    An error is the norm of the difference to the solution, over normal and tangent impulses together. path: path of the
    model file.
    """
    contacts = state.contacts
    solved = np.array([contacts.normal_impulse, contacts.tangent_impulse])
    image = {"spacing": model.spec.spacing, "support": model.spec.support}
    impulses = {
        NETWORK: model.predict(state, project=False),
        f"{NETWORK}, shared (authors' code)": chapter_5.ReadBySharing(path)(state, None),
        "Builtin": [contacts.normal_start, contacts.tangent_start],
        "true image": Sph(**image)(state, None),
        "true image, shared (authors' code)": Sph(**image, transfer="shared")(state, None),
        "None": np.zeros_like(solved),
    }
    return {name: float(np.linalg.norm(np.array(one) - solved)) for name, one in impulses.items()}


def of_scenes(errors):
    """Collect the errors of all scenes. Returns name of the start -> list with an error for each scene."""
    errors = list(errors)
    return {name: [one[name] for one in errors] for name in errors[0]}


def claims(data):
    deep = all(kernel == of_input for kernel, of_input in data["depths"].values())
    depths = {name: f"{kernel} of {of_input}" for name, (kernel, of_input) in data["depths"].items()}
    yield Claim("a kernel is as deep as its layer's input", "section 4.2.2", deep, depths)
    for measure, thesis, text in (
        (GRID, "section 6.2.2", "the {} predicts the grid values well: they are off by at most a half"),
        (CONTACTS, None, "λ at the contacts, as the {} predicts it, is off by at most a half"),
    ):
        errors, also = data[measure], {measure: relative(data[measure])}
        for name in (name for name in errors if name.startswith(NETWORK)):
            one = text.format(name), thesis
            yield verdicts.judged_values(errors[name], errors["None"], *one, within=(0.0, 0.5), also=also)


def relative(errors):
    """Return the mean error of each start over the mean error of the start None: name of the start -> ratio.

    None is zero impulses, so its error is the norm of the solution. errors: name of the start -> error in each scene.
    """
    return {name: float(np.mean(one) / np.mean(errors["None"])) for name, one in errors.items()}


def table(data):
    grid, contacts = (relative(data[of]) for of in (GRID, CONTACTS))
    return [["start", GRID, CONTACTS], *([name, grid.get(name), error] for name, error in contacts.items())]


def draw(data, options):
    """Draw the masses, the strongest map of some layers, and the predicted impulses against the solved ones."""
    figure, axes = plotting.subplots(2, 3, size=(9.0, 6.4))
    *panels, last = axes.flat
    x_min, y_min, x_max, y_max = data["box"]
    look = {"origin": "lower", "extent": (x_min, x_max, y_min, y_max), "interpolation": "nearest"}
    for ax, part in zip(panels, data["panels"]):
        values = np.array(part["values"])
        # Values at impacts are much larger than all others, so the scale of colours ends at the 95th percentile.
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
    first = relative({name: errors[:1] for name, errors in data[CONTACTS].items()})
    network, builtin, true = (first[name] for name in (NETWORK, "Builtin", "true image"))
    last.set_title(f"output: λ is off by {network:.2f}\n(Builtin {builtin:.2f}, true image {true:.2f})")
    figure.suptitle(f"What the thesis's network sees of a falling pile ({options['model']})", fontsize=11)
    return figure


OPTIONS = {"model": "models/model.h5", "n_bodies": 100, "size": 30.0, "steps": 150, "layers": 4}
OPTIONS |= {"scenes": 12}
FIGURE = Figure("4.3", "Feature maps of the trained network on a state of the falling pile", compute, table, draw,
                claims, options=OPTIONS, quick={"scenes": 2}, seed=5, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
