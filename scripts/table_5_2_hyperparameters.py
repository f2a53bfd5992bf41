"""python scripts/table_5_2_hyperparameters.py: settings as printed, as built, and of the training that was run."""

from deep_contact.cnn.backend import one_thread
from deep_contact.reporting import Claim, Figure, figures
from deep_contact.studies import chapter_5

KNOWN = {
    "Kernel size": "Appendix B: 3 × 3 in the first four convolutions, 2 × 2 in all others; its weights are 64,498,866"
}
"""Settings in which the network cannot follow Table 5.2, and the reason."""


PRINTED_HYPERPARAMETERS = chapter_5.PRINTED["hyperparameters"]
"""Table 5.2 as the thesis prints it; its "1 × 5 × 10⁻³" is 0.005."""


def thesis_hyperparameters() -> dict[str, str]:
    """The lines of Table 5.2 as the built network and `training.thesis_config` have them."""
    one_thread()
    from deep_contact.cnn import architectures, schedules
    from deep_contact.cnn.training import thesis_config

    config = thesis_config()
    model = architectures.build(config.architecture, **config.options)
    layers = {}
    for layer in model.layers:
        layers.setdefault(type(layer).__name__, []).append(layer)
    convolutions = layers["Conv2D"]
    schedule = schedules.SCHEDULES[config.schedule](config.epochs, config.rate)
    spelling = {"relu": "ReLU", "HeNormal": "He normal"}

    def only(values) -> str:
        return " and ".join(spelling.get(value, str(value)) for value in dict.fromkeys(values))

    return {
        "Activation function": only(layer.activation.__name__ for layer in [*convolutions, *layers["Dense"]]),
        "Weight initialization": only(type(layer.kernel_initializer).__name__ for layer in convolutions),
        "Weight regularizer": only(type(layer.kernel_regularizer).__name__ for layer in convolutions),
        "Convolution border mode": only(layer.padding for layer in convolutions),
        "Stride": only(layer.strides[0] for layer in layers["MaxPooling2D"]),
        "Kernel size": only(tuple(layer.kernel_size) for layer in convolutions),
        "Dropout rate": only(layer.rate for layer in layers["Dropout"]),
        "Optimizer": "SGD" if config.optimizer == "nesterov" else config.optimizer,
        "Initial learning rate": f"{schedule(0):g}",
        "Batch size": str(config.batch_size),
        "Epochs": str(config.epochs),
        "Validation rate": f"{config.fractions[1]:g}",
    }


def hyperparameters_of(path: str) -> dict[str, str]:
    """The lines of Table 5.2 that a training decides, of the training that made a model file, by its card."""
    card = chapter_5.card_of(path)
    config, history = card["config"], card["history"]
    rates = dict.fromkeys(f"{epoch['rate']:g}" for epoch in history)
    return {
        "Optimizer": config["optimizer"].upper(),
        "Initial learning rate": f"{' then '.join(rates)} ({config['schedule']})",
        "Batch size": str(config["batch_size"]),
        "Epochs": f"{len(history)} of {config['states_per_epoch']:,} states",
        "Validation rate": f"{config['fractions'][1]:g} of the simulations",
        "States shown": f"{len(history) * config['states_per_epoch']:,}",
    }


def compute(options, seed, jobs, progress):
    """The columns, by the name of the setting."""
    built = thesis_hyperparameters()
    shipped = built | hyperparameters_of(options["model"])
    return {"printed": PRINTED_HYPERPARAMETERS, "built": built, "shipped": shipped}


def claims(data):
    printed, built = data["printed"], data["built"]
    differing = {name: [value, built.get(name)] for name, value in printed.items() if value != built.get(name)}
    return [
        Claim("the training's settings are those of Table 5.2", "Table 5.2", not differing, differing),
        Claim("they are, but for the sizes of the kernels", "Table 5.2", set(differing) == set(KNOWN), differing),
    ]


def table(data):
    rows = [["hyperparameter", "thesis", "here", "equal", "training of the shipped network"]]
    for name, printed in data["printed"].items():
        built = data["built"][name]
        rows.append([name, printed, built, printed == built, data["shipped"][name]])
    return [*rows, ["States shown", f"{chapter_5.THESIS_VISITS:,}", None, None, data["shipped"]["States shown"]]]


OPTIONS = {"model": chapter_5.NETWORKS["cnn thesis"]}
FIGURE = Figure("T 5.2", "Hyperparameters of the thesis's training", compute, table, claims=claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
