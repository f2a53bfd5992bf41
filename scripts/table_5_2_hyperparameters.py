"""python scripts/table_5_2_hyperparameters.py: settings of the training: printed, authors' code, recipe, shipped file.

The settings of the authors' code are from cnn_training.py and visual_deep_learning/cnn_model.py of
github.com/JaggerWu/Deep-Contact. The sizes of the kernels are from Appendix B. The SGD of this code also has
decay=1e-6, which lowers the learning rates by 8 % in 1,000 epochs.
"""

import shlex
from collections.abc import Sequence

from deep_contact import figures
from deep_contact.cnn.backend import one_thread
from deep_contact.figures import Claim, Figure
from deep_contact.studies import chapter_5

PRINTED, CODE = chapter_5.PRINTED["hyperparameters"], chapter_5.PRINTED["authors' code"]
"""Table 5.2 as the thesis prints it, with the learning rates of Algorithm 6, and the settings of its authors' code.

The thesis's "1 × 5 × 10⁻³" is 0.005.
"""

SPELLING = {"relu": "ReLU", "HeNormal": "He normal"}
"""Name in Keras -> name in the thesis."""


def settings_of(network, config, rates: Sequence[float]) -> dict[str, str]:
    """Return the hyperparameters of a training: name in Table 5.2 -> value as a text.

    network: a `keras.Model`. config: its `TrainingConfig`. rates: learning rate of each epoch.
    """
    from deep_contact.cnn.training.network import optimizer_of

    layers, optimizer = {}, optimizer_of(config)
    for layer in network.layers:
        layers.setdefault(type(layer).__name__, []).append(layer)
    convolutions, drops = layers["Conv2D"], [layer.rate for layer in layers["Dropout"]]
    first, *later = (f"{rate:g}" for rate in dict.fromkeys(rates))

    def only(values) -> str:
        return " and ".join(SPELLING.get(value, str(value)) for value in dict.fromkeys(values))

    stacks = ", ".join(f"{rate:g} after stack {k}" for k, rate in enumerate(drops, 1) if rate)
    momentum = f", {'Nesterov' if optimizer.nesterov else 'plain'}'s momentum {optimizer.momentum:g}"
    return {
        "Activation function": only(layer.activation.__name__ for layer in [*convolutions, *layers["Dense"][-1:]]),
        "Weight initialization": only(type(layer.kernel_initializer).__name__ for layer in convolutions),
        "Weight regularizer": only(type(layer.kernel_regularizer).__name__ for layer in convolutions),
        "Convolution border mode": only(layer.padding for layer in convolutions),
        "Stride": only(layer.strides[0] for layer in layers["MaxPooling2D"]),
        "Kernel size": only(tuple(layer.kernel_size) for layer in convolutions),
        "Dropout rate": f"{drops[0]:g}" if len(set(drops)) == 1 else stacks,
        "Optimizer": type(optimizer).__name__ + (momentum if optimizer.momentum else ""),
        "Initial learning rate": first,
        "Batch size": str(config.batch_size),
        "Epochs": str(len(rates)),
        "Validation rate": f"{config.fractions[1]:g}",
        "Later learning rates": ", ".join(later),
        "Weight decay": only(f"{float(layer.kernel_regularizer.l2):g}" for layer in convolutions),
        "States shown": f"{len(rates) * config.states_per_epoch:,}",
        "Rank of the last layer": str(layers["Dense"][0].units) if len(layers["Dense"]) > 1 else "full",
    }


def recipe_of(command: str) -> str | None:
    """Return the recipe that the command on a model card names, or None if it names none."""
    words = shlex.split(command)
    return words[words.index("--recipe") + 1] if "--recipe" in words else None


def compute(options, seed, jobs, progress):
    """Collect the columns of the table, each a dict: name of the hyperparameter -> value."""
    one_thread()
    from deep_contact.cnn import architectures, schedules
    from deep_contact.cnn.model_file import read_metadata
    from deep_contact.cnn.registry import network_file
    from deep_contact.cnn.training import config_of, recipe

    metadata = read_metadata(network_file(options["model"]))
    card, run = metadata["card"], {}
    if name := recipe_of(card["command"]):
        config = recipe(name)
        rate = schedules.SCHEDULES[config.schedule](config.epochs, config.rate)
        network = architectures.build(config.architecture, **config.options)
        run = settings_of(network, config, [rate(epoch) for epoch in range(config.epochs)])
    rates = [epoch["rate"] for epoch in card["history"]]
    shipped = settings_of(chapter_5.image_network(options["model"]).network, config_of(metadata), rates)
    # A model file has no initializers.
    shipped["Weight initialization"] = None
    return {"printed": PRINTED, "authors' code": CODE, "recipe": name, "run": run, "shipped": shipped}


def claims(data):
    for which, named in (("printed", "Table 5.2"), ("authors' code", "its authors' code")):
        known = {name: [value, data["shipped"][name]] for name, value in data[which].items() if data["shipped"][name]}
        differing = {name: both for name, both in known.items() if both[0] != both[1]}
        text = f"the shipped network was trained by the settings of {named}"
        yield Claim(text, "Table 5.2", not differing, differing)


def table(data):
    shown = f"{chapter_5.THESIS_VISITS:,}"
    columns = [data["printed"] | {"States shown": shown}, data["authors' code"] | {"States shown": shown}]
    head = ["hyperparameter", "thesis", "authors' code"]
    if data["recipe"]:
        columns, head = [*columns, data["run"]], [*head, f"recipe {data['recipe']}"]
    columns, head = [*columns, data["shipped"]], [*head, "shipped file"]
    return [head, *([name, *(column.get(name) for column in columns)] for name in data["shipped"])]


OPTIONS = {"model": chapter_5.NETWORKS["cnn"]}
FIGURE = Figure("T 5.2", "Hyperparameters of the thesis's training", compute, table, claims=claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
