"""Experiments with trained networks: what chapter 5 of the thesis says about them.

The layers of a network (Figure 5.8, Tables 5.1 and 5.2), the CNN start beside the others (Figure 5.9), time to a
threshold by stage (Figure 5.10). Keras and TensorFlow are imported by the functions that need them; networks run on one
thread.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deep_contact.cnn.backend import one_thread
from deep_contact.cnn.inference import FarFieldModel, LearnedModel, load_model
from deep_contact.cnn.model_file import read_metadata
from deep_contact.cnn.registry import network_file
from deep_contact.sph.start import Sph
from deep_contact.state.state import State
from deep_contact.stepping.rows import projected
from deep_contact.studies import starts

# ---- networks ----

NETWORKS = {"cnn": "models/model.h5", "far field": "models/far_field.h5"}
"""Start -> model file of Figures 5.9 and 5.10: the thesis's network, and ours."""


def networks_info(networks: Mapping[str, str]) -> dict[str, dict]:
    """Facts from the cards of some model files, read without TensorFlow.

    Returns name -> {"file", "architecture", "parameters": None if the card has none, "visits": number of states shown
    in training, repetitions included}. Raises FileNotFoundError for a missing file, before anything long begins.
    """
    infos = {}
    for name, path in networks.items():
        card = card_of(path)
        about = {"file": str(path), "architecture": card["architecture"], "parameters": card.get("parameters")}
        infos[name] = about | {"visits": len(card["history"]) * card["config"]["states_per_epoch"]}
    return infos


def card_of(path) -> dict:
    """The card of a model file, which describes its training."""
    return read_metadata(network_file(path))["card"]


def image_network(path) -> LearnedModel:
    """The network on images of a model file. Raises ValueError where the file has a far-field network."""
    model = load_model(path)
    if isinstance(model, FarFieldModel):
        expected = f"a network on images, such as {NETWORKS['cnn']}"
        raise ValueError(f"model: expected {expected}, got {path}, a far-field network")
    return model


# ---- layers: Figure 5.8, Tables 5.1 and 5.2 ----

LAYER_TITLES = {"Conv2D": "Convolution", "MaxPooling2D": "MaxPooling"}
"""Class of a Keras layer -> its name in Table 5.1, if they differ."""

PRINTED = json.loads((Path(__file__).parent / "printed_tables.json").read_text(encoding="utf-8"))


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


# ---- the CNN start beside the others: Figure 5.9 ----

THESIS_VISITS = 18_208 * 1000
"""Number of states that the thesis's training showed, in 1,000 epochs. Its authors' log held out 4,553 more."""


@dataclass(frozen=True)
class ReadBySharing:
    """A network's start, its image read back as the thesis's authors programmed it: each node shares out its value."""

    model: str

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        model = starts.start_of({"model": self.model}).model
        way = Sph(spacing=model.spec.spacing, support=model.spec.support, transfer="shared")
        return projected(*way.gather(state, np.float64(model.predict_image(state))), state.world.friction)


READ_NETWORK = {"": "", ", shared": ", shared (authors' code),"}
"""Suffix of the name of a network's start, by the way its image is read back -> this suffix in claims."""


def label_of(network: Mapping) -> str:
    """The name of a network of `networks_info` in claims: the thesis's or ours, and its file."""
    return f"{'CNN' if network['architecture'] == 'thesis' else 'far field'} ({Path(network['file']).name})"
