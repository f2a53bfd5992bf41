"""Experiments with trained networks: what chapter 5 of the thesis says about them.

The layers of a network (Figure 5.8, Tables 5.1 and 5.2), the CNN start beside the others (Figure 5.9), time to a
threshold by stage (Figure 5.10). Keras and TensorFlow are imported by the functions that need them; networks run on one
thread.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np

from deep_contact.cnn.backend import one_thread
from deep_contact.cnn.images import ImageSpec
from deep_contact.cnn.model_file import read_metadata
from deep_contact.cnn.registry import network_file
from deep_contact.physics.contact_solver import projected
from deep_contact.physics.engine import solve
from deep_contact.physics.solvers import PGS
from deep_contact.reporting.figures import Claim
from deep_contact.state import State
from deep_contact.studies import timing, verdicts
from deep_contact.studies.learned_starts import stages_of
from deep_contact.studies.starts import READ, THRESHOLD, start_of, sweeps_to
from deep_contact.warm_start import Sph, WarmStart

# ---- networks ----

NETWORKS = {"cnn": "models/model.h5", "cnn thesis": "models/thesis_factored.h5"}
"""Model files of Figures 5.9 and 5.10."""


def networks_info(networks: Mapping[str, str]) -> dict[str, dict]:
    """What the cards of some model files say, read without TensorFlow.

    Returns name -> {"file", "architecture", "parameters": None if the card has none, "visits": states shown in
    training, each as often as it was}. Raises FileNotFoundError for a missing file, before anything long begins.
    """
    infos = {}
    for name, path in networks.items():
        card = card_of(path)
        about = {"file": str(path), "architecture": card["architecture"], "parameters": card.get("parameters")}
        infos[name] = about | {"visits": len(card["history"]) * card["config"]["states_per_epoch"]}
    return infos


def card_of(path) -> dict:
    """What a model file says of its training."""
    return read_metadata(network_file(path))["card"]


# ---- layers: Figure 5.8, Tables 5.1 and 5.2 ----

LAYER_TITLES = {"Conv2D": "Convolution", "MaxPooling2D": "MaxPooling"}
"""Class of a Keras layer -> its name in Table 5.1, if they differ."""

PRINTED = json.loads((Path(__file__).parent / "printed_tables.json").read_text(encoding="utf-8"))

PRINTED_LAYERS = PRINTED["layers"]
"""Table 5.1 as the thesis prints it, misprints included: (layer, output shape without the batch)."""

PRINTED_HYPERPARAMETERS = PRINTED["hyperparameters"]
"""Table 5.2 as the thesis prints it; its "1 × 5 × 10⁻³" is 0.005."""


def thesis_layers(channels: int = 5) -> list[dict]:
    """The layers of the thesis's network as built here, input included; channels: of its input.

    Each {"kind": as in Table 5.1, "shape": of the output without the batch, "parameters", "trainable", "kernel": sides
    of a convolution's kernel or None}.
    """
    one_thread()
    from deep_contact.cnn import architectures

    model = architectures.thesis(channels=channels)
    images = {"kind": "Input", "shape": list(model.input_shape[1:])}
    rows = [images | {"parameters": 0, "trainable": 0, "kernel": None}]
    for layer in model.layers:
        kind, kernel = type(layer).__name__, getattr(layer, "kernel_size", None)
        kind = LAYER_TITLES.get(kind, kind) + (f"({layer.filters})" if kernel else "")
        trainable = int(sum(np.prod(v.shape) for v in layer.trainable_variables))
        about = {"kind": kind, "shape": list(layer.output.shape[1:]), "parameters": int(layer.count_params())}
        rows.append(about | {"trainable": trainable, "kernel": list(kernel) if kernel else None})
    return rows


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
        "Optimizer": config.optimizer.upper(),
        "Initial learning rate": f"{schedule(0):g}",
        "Batch size": str(config.batch_size),
        "Epochs": str(config.epochs),
        "Validation rate": f"{config.fractions[1]:g}",
    }


def hyperparameters_of(path: str) -> dict[str, str]:
    """The lines of Table 5.2 that a training decides, of the training that made a model file, by its card."""
    card = card_of(path)
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


# ---- the CNN start beside the others: Figure 5.9 ----

CLOSE = (0.5, 2.0)
"""Range of θ over θ of two starts that count as similar."""

PLACE = "section 5.4, Figure 5.9"

THESIS_VISITS = 18_208 * 8 // 10 * 1000
"""States that the thesis's training showed: its samples without the fifth that is held out, in each of its epochs."""

BOUND = "at rest positions leave λ_n open by ±0.74 of its mean: Figure 6.15"
OPEN = f"open: the rebuilt network starts little better than None ({BOUND})"
"""Verdict on what the thesis says of its network; half of the median interval is the error that no network can promise
to go below."""


@dataclass(frozen=True)
class ReadBySharing:
    """A network's start, its image read back as the thesis's authors programmed it: each node shares out its value."""

    model: str

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        model = start_of({"model": self.model}).model
        way = Sph(spacing=model.spec.spacing, support=model.spec.support, transfer="shared")
        return projected(*way.gather(state, np.float64(model.predict_image(state))), state.world.friction)


READ_NETWORK = {"": "", ", shared": ", shared (authors' code),"}
"""What follows the name of a network's start, by how its image is read back -> the same in claims."""


def label_of(network: Mapping) -> str:
    """A network of `networks_info` in claims, by its file."""
    return f"CNN ({Path(network['file']).name})"


def of_network(network: Mapping, claim: Claim) -> Claim:
    """The claim; of the thesis's network it is left open, and `measured` has the verdict on the rebuilt one."""
    if network["architecture"] != "thesis":
        return claim
    return claim._replace(holds=None, verdict=OPEN, measured=claim.measured | {"verdict, rebuilt": claim.verdict})


def claims_of_network(data: Mapping, name: str) -> Iterator[Claim]:
    """The thesis's claims on Figure 5.9 for one network.

    data: of `starts.compare_starts` with the starts "none", "builtin", those of `READ`, "copy" and this one, with the
    cards of the networks (`networks_info`) under "networks".
    """
    network = data["networks"][name]

    def judged(*names, **keywords):
        return of_network(network, verdicts.judged(data, *names, PLACE, **keywords))

    for read, how in READ_NETWORK.items():
        if name + read in data["independent"]:
            start, label = name + read, label_of(network) + how
            for sph, way in READ.items():
                similar = f"{label} performs similarly to SPH, {way}: θ from half to twice of it"
                yield judged(start, sph, similar, within=CLOSE)
                yield judged(sph, start, f"{label} is not as good as SPH, {way}")
            yield judged(start, "builtin", f"{label} converges faster than Builtin")
            small = f"{label} is just a small improvement to Builtin: θ from half of Builtin's to Builtin's"
            yield judged(start, "builtin", small, within=(0.5, 1.0))
            yield judged("copy", start, f"{label} does not converge as rapidly as Copy")
            useful = f"{label} is a start: its θ is at most half of None's"
            yield verdicts.judged(data, start, "none", useful, within=verdicts.MUCH_FASTER)


# ---- time to a threshold, by stage: Figure 5.10 ----

STAGES = ("splat", "network", "gather", "solve")
"""Stages of a step's contact solution: particles to image, image to image, image to contacts, sweeps."""


CLOCK = {"reduce": np.median, "clock": process_time}
"""Processor time of this process, so that what else runs is not counted; its networks run on one thread."""


def time_to_threshold(
    states: Sequence[State], starts: Mapping[str, WarmStart], *, most: int, repeats: int, progress: Callable
) -> dict[str, dict]:
    """Sweeps and seconds of the processor from each start to θ < `THRESHOLD`, on the same states.

    most: sweeps after which a start is given up. repeats: interleaved runs of every timing; their median counts.
    Returns {name: {"sweeps": one a state, all of them where given up, "missed": states given up, "seconds": {stage: one
    a state}}}; a start has the stages that it needs.
    """
    solver = PGS(sweeps=most, tolerance=THRESHOLD)
    times = {name: {"sweeps": [], "missed": 0, "seconds": {}} for name in starts}
    for state in progress(states, total=len(states), text="states"):
        calls = {}
        for name, start in starts.items():
            impulses = start(state, solver)
            theta = solve(state, solver, *impulses).record.theta
            times[name]["sweeps"].append(sweeps_to(theta))
            times[name]["missed"] += int(theta[-1] > THRESHOLD)
            counted = partial(solve, state, PGS(sweeps=sweeps_to(theta), tolerance=None), *impulses)
            calls |= {(name, stage): call for stage, call in (stages_of(start, state) | {"solve": counted}).items()}
        for (name, stage), seconds in timing.interleaved(calls, repeats=repeats, **CLOCK).items():
            times[name]["seconds"].setdefault(stage, []).append(float(seconds))
    return times


def time_by_tree(state: State, *, repeats: int) -> float:
    """Median seconds of the splat of the bodies by k-d tree (the thesis's Algorithm 2, d = h = 0.5 m)."""
    from deep_contact.sph.thesis import splat_by_tree

    spec, bodies = ImageSpec(), state.bodies
    values = np.column_stack([bodies.mass, bodies.velocity, bodies.spin])
    splat = partial(splat_by_tree, spec.grid(state.world), bodies.position, values, h=spec.support)
    return timing.interleaved({"": splat}, repeats=repeats, **CLOCK)[""]
