"""The common part of all runs: the network, its optimizer, model files and checkpoints."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.cnn import architectures
from deep_contact.cnn.backend import keras
from deep_contact.cnn.dataset import Split, Store
from deep_contact.cnn.far_field import FarFieldSpec
from deep_contact.cnn.images import ImageSpec
from deep_contact.cnn.inference import LearnedModel
from deep_contact.cnn.model_file import save_model
from deep_contact.cnn.training.config import TrainingConfig
from deep_contact.io.files import replacing
from deep_contact.reporting.results import package_versions, processor

ops = keras.ops


class Checkpoint(NamedTuple):
    """A run as it was after an epoch: arrays by name, history (a dict an epoch), settings, images."""

    arrays: dict[str, np.ndarray]
    history: list[dict]
    settings: dict
    spec: ImageSpec | FarFieldSpec


class NetworkRun:
    """A network in training. Subclasses have `epoch` and `validate`, and set the attributes below.

    box: the world's box of a network of one size, or None. training_states: their number. steps: number of batches of
    an epoch, or None if it is unknown.
    """

    def __init__(self, config: TrainingConfig, store: Store, split: Split, spec: ImageSpec | FarFieldSpec):
        self.config, self.store, self.split, self.spec = config, store, split, spec
        self.box = None

    def build(self, initial: LearnedModel | None, **options) -> None:
        """The network, that of a model if one is given, and its optimizer."""
        config = self.config
        if initial is None:
            sizes = {"channels": len(self.spec.channels), "outputs": len(self.spec.targets)}
            self.model = architectures.build(config.architecture, **sizes, **options)
            self.coarsening = architectures.coarsening(config.architecture)
        else:
            self.model, self.coarsening = initial.network, initial.coarsening
        if config.optimizer in ("sgd", "nesterov"):  # Eq 4.8, Eq 4.9
            options = {"momentum": config.momentum, "nesterov": config.optimizer == "nesterov"}
            self.optimizer = keras.optimizers.SGD(config.rate, global_clipnorm=config.clip, **options)
        else:
            self.optimizer = keras.optimizers.Adam(config.rate, global_clipnorm=config.clip)
        self.optimizer.build(self.model.trainable_variables)
        self.model.optimizer = self.optimizer  # where Keras's callbacks look for it

    def batches_per_epoch(self) -> int:
        """Number of full batches of an epoch. Raises ValueError where there are fewer states than one batch has."""
        states, size = self.training_states, self.config.batch_size
        if states < size:
            raise ValueError(f"batch_size: expected at most the {states} states to train on, got {size}")
        return max(1, min(states, self.config.states_per_epoch or states) // size)

    def save(self, path, card: dict) -> None:
        """Write a model file; see `model_file.save_model`."""
        save_model(path, self.model, self.spec, card, coarsening=self.coarsening, box=self.box)

    def card(self) -> dict:
        """Fields of the model card about the network and its training."""
        return {
            "architecture": self.config.architecture,
            "options": dict(self.config.options),
            "parameters": int(self.model.count_params()),
            "trainable_parameters": int(sum(np.prod(v.shape) for v in self.model.trainable_variables)),
            "training_states": self.training_states,
            "seed": self.config.seed,
            "versions": {**package_versions(), "python": sys.version.split()[0], "backend": keras.backend.backend()},
            "cpu": processor(),
        }

    def _variables(self) -> dict:
        kinds = {"model": self.model.variables, "optimizer": self.optimizer.variables}
        return {f"{kind}_{i:04d}": variable for kind, found in kinds.items() for i, variable in enumerate(found)}

    def write_checkpoint(self, path: Path, settings: dict, history: list[dict]) -> None:
        """Write a `Checkpoint`, with all random states.

        `keras.callbacks.BackupAndRestore` loses that of dropout: a resumed run would differ from an undisturbed one.
        """
        arrays = {name: ops.convert_to_numpy(variable) for name, variable in self._variables().items()}
        text = json.dumps({"settings": settings, "history": history, "spec": self.spec.to_dict()})
        with replacing(path) as temporary, open(temporary, "wb") as file:
            # Uncompressed, since weights do not shrink.
            np.savez(file, state=np.frombuffer(text.encode(), np.uint8), **arrays)

    def restore(self, saved: Checkpoint) -> None:
        """Set network and optimizer to a checkpoint."""
        for name, variable in self._variables().items():
            variable.assign(saved.arrays[name])


def read_checkpoint(path: Path) -> Checkpoint | None:
    """The checkpoint in a file, or None where there is no file."""
    if not path.exists():
        return None
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    state = json.loads(arrays.pop("state").tobytes())
    kind = FarFieldSpec if state["spec"].get("kind") else ImageSpec
    return Checkpoint(arrays, state["history"], state["settings"], kind.from_dict(state["spec"]))


def evenly(states: np.ndarray, count: int) -> np.ndarray:
    """About `count` of the states (k, 2), at equal distances."""
    return states[:: max(1, len(states) // max(count, 1))]
