"""Functions for the figures and tables of chapter 5 that use networks.

They are the layers of a network (Figure 5.8, Tables 5.1 and 5.2), the comparison of the CNN start with other starts
(Figure 5.9), and the time to a threshold by stage (Figure 5.10). The functions that need Keras and TensorFlow import
them. Networks run on one thread.
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
"""Start -> model file, for Figures 5.9 and 5.10. "cnn" is our copy of the thesis's network."""


def networks_info(networks: Mapping[str, str]) -> dict[str, dict]:
    """Return facts about some networks from the cards of their model files, which are read without TensorFlow.

    networks: name -> model file. Returns name -> {"file", "architecture", "parameters": number of weights, or None if
    the card has none, "visits": number of states shown in training, with repetitions}. Raises FileNotFoundError if a
    file is missing. Figures call this function first, so that the error comes before long computations.
    """
    infos = {}
    for name, path in networks.items():
        card = card_of(path)
        about = {"file": str(path), "architecture": card["architecture"], "parameters": card.get("parameters")}
        infos[name] = about | {"visits": len(card["history"]) * card["config"]["states_per_epoch"]}
    return infos


def card_of(path) -> dict:
    """Return the card of a model file, which describes how the network was trained."""
    return read_metadata(network_file(path))["card"]


def image_network(path) -> LearnedModel:
    """Return the network of a model file. Raises ValueError if it is a far-field network, not a network on images."""
    model = load_model(path)
    if isinstance(model, FarFieldModel):
        expected = f"a network on images, such as {NETWORKS['cnn']}"
        raise ValueError(f"model: expected {expected}, got {path}, a far-field network")
    return model


# ---- layers: Figure 5.8, Tables 5.1 and 5.2 ----

LAYER_TITLES = {"Conv2D": "Convolution", "MaxPooling2D": "MaxPooling"}
"""Name of a Keras layer's class -> name of the layer in Table 5.1, for the layers whose names differ."""

PRINTED = json.loads((Path(__file__).parent / "printed_tables.json").read_text(encoding="utf-8"))


def thesis_layers(channels: int = 5) -> list[dict]:
    """Return a description of each layer of our copy of the thesis's network, the input included.

    channels: number of channels of the input. A description is a dict: {"kind": name as in Table 5.1, "shape": shape of
    the output without the batch, "parameters": number of parameters, "trainable": number of trainable parameters,
    "kernel": sides of a convolution's kernel, or None}.
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
"""Number of states shown to the thesis's network in training: 18,208 states in each of 1,000 epochs.

According to its authors' log, 4,553 further states were held out.
"""


@dataclass(frozen=True)
class ReadBySharing:
    """A start that a network predicts, with its image read back as the thesis's authors programmed it.

    Each node distributes its value among the contacts within the support radius (`sph.share_out`). model: path or name
    of a model file of a network on images.
    """

    model: str

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        model = starts.start_of({"model": self.model}).model
        way = Sph(spacing=model.spec.spacing, support=model.spec.support, transfer="shared")
        return projected(*way.gather(state, np.float64(model.predict_image(state))), state.world.friction)


READ_NETWORK = {"": "", ", shared": ", shared (authors' code),"}
"""Suffix in the name of a network's start -> suffix in the text of claims. It tells how the image is read back."""


def label_of(network: Mapping) -> str:
    """Return the name of a network in claims, such as "CNN (model.h5)". network: an entry of `networks_info`."""
    return f"{'CNN' if network['architecture'] == 'thesis' else 'far field'} ({Path(network['file']).name})"
