"""A training run: simulated data, one epoch after the other, from wherever the last run was stopped.

A run is a folder:

| file        | holds                                                                                             |
|-------------|---------------------------------------------------------------------------------------------------|
| last.npz    | every 20 s and after an epoch: weights, optimizer, random state, position, history and settings   |
| best.h5     | the model file of the epoch with the lowest validation loss so far                                |
| history.csv | one line for each epoch, with the columns below                                                   |
| model.h5    | at the end: the best one with its card                                                            |

Each file is replaced as a whole, and what follows depends only on last.npz, the settings and the data. So a run that is
killed at any moment and started again gives the history of an undisturbed run, to the last bit on the same machine. At
most 20 seconds and a batch are lost.

| column                      | meaning                                                                                |
|-----------------------------|----------------------------------------------------------------------------------------|
| epoch, rate, loss           | number from 0; learning rate; mean training loss                                       |
| validation_loss             | on the validation states; for the far-field network over that of Builtin's start       |
| validation_velocity_error   | mean relative velocity error before any sweep (far-field network)                      |
| validation_velocity_error_k | after k sweeps, for each of `TrainingConfig.sweeps` (far-field network)                |
| seconds                     | wall time of the epoch, of its last part where it was interrupted                      |
"""

from __future__ import annotations

import csv
import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.cnn import schedules
from deep_contact.cnn.backend import keras, limit_threads, tensorflow
from deep_contact.cnn.dataset import Store, evenly, split_by_simulation
from deep_contact.cnn.evaluation import BASELINES, held_out_errors
from deep_contact.cnn.inference import Cnn, LearnedModel, load_model
from deep_contact.cnn.model_file import read_metadata, save_model
from deep_contact.cnn.training.config import TrainingConfig
from deep_contact.cnn.training.far_field_run import FarFieldRun
from deep_contact.cnn.training.network import ImageRun, NetworkRun
from deep_contact.io.files import replacing

SAVE_EVERY = 20.0
"""Seconds from one last.npz to the next within an epoch."""


class Training(NamedTuple):
    """A finished run: history (a dict an epoch, by column), best epoch, path of model.h5 and the model in it."""

    history: list[dict]
    best_epoch: int
    path: Path
    model: LearnedModel


def train(
    config: TrainingConfig,
    data,
    out,
    *,
    from_model=None,
    threads: int | None = None,
    command: str = "",
    held_out: int = 300,
    verbose: int | str = "auto",
    callbacks: Sequence[keras.callbacks.Callback] = (),
) -> Training:
    """Train until the epochs are done or a callback ends it; an unfinished run in `out` goes on.

    data: a `Store` or its folder. out: folder of the run. from_model: path of a model file whose network the run starts
    with, in place of an untrained one; its images have to be those of the settings (`config.config_of` gives them).
    threads: of TensorFlow (`limit_threads`), or None to leave them as they are. command: for the card. held_out: number
    of test states for the card. verbose: 0 prints nothing, 1 a progress bar, 2 a line an epoch, "auto" 1 on a terminal
    and 2 elsewhere; what will be written is announced first. callbacks: of Keras; a run that goes on calls them only
    from there on.
    Raises ValueError where the run in `out` was started with other settings or data (`epochs` may differ unless the
    rates depend on it); FloatingPointError where the loss is not finite.
    """
    store = data if isinstance(data, Store) else Store(data)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    if threads is not None:
        limit_threads(threads)
    tensorflow.config.experimental.enable_op_determinism()
    keras.utils.set_random_seed(config.seed)
    sims = store.simulations[: config.simulations]
    split = split_by_simulation(sims, fractions=config.fractions, seed=config.seed)
    settings = asdict(config) | {"data": store.data_hash(sims)}
    settings["from_model"] = None if from_model is None else read_metadata(from_model)["digest"]
    initial = None if from_model is None else load_model(from_model)
    if initial and initial.spec != config.spec():
        raise ValueError(f"from_model: expected a network for the images {config.spec()}, got one for {initial.spec}")
    settings = json.loads(json.dumps(settings))
    kind = FarFieldRun if config.is_far_field else ImageRun
    run = kind(config, store, split, initial and initial.network)
    about = {"command": command, "config": settings, "data_hash": settings["data"], "split": split._asdict()}
    record = Record(run, out, about)
    if verbose == "auto":
        verbose = 1 if sys.stdout.isatty() else 2
    if len(record.history) < config.epochs:
        if verbose:
            print(announcement(run, out))
        rates = schedules.schedule(config.schedule, epochs=config.epochs, rate=config.rate)
        scheduler = keras.callbacks.LearningRateScheduler(lambda epoch, rate: rates(epoch))
        run.fit([scheduler, record, *callbacks], verbose=verbose)
    history = record.history
    best_epoch = min(range(len(history)), key=lambda k: history[k]["validation_loss"])
    model = load_model(out / "best.h5")
    tested = evenly(store.states(split.test), held_out)
    errors = held_out_errors((store.state(*state) for state in tested.tolist()), BASELINES | {"cnn": Cnn(model)})
    card = record.card() | {"best_epoch": best_epoch, "held_out": errors}
    path = save_model(out / "model.h5", model.network, run.spec, card, box=run.box)
    return Training(history, best_epoch, path, load_model(path))


def announcement(run: NetworkRun, out: Path) -> str:
    """What a run will write, with its size."""
    last = sum(np.prod(v.shape) * np.dtype(v.dtype).itemsize for v in run.variables.values()) / 1e6
    model = 4e-6 * run.model.count_params()
    weights = f"{run.model.count_params():,} weights, {run.training_states:,} states to train on"
    sizes = f"last.npz {last:.1f} MB, best.h5 and model.h5 {model:.1f} MB each, {last + 2 * model:.1f} MB in all"
    return f"{weights}\n{out} will hold {sizes}"


class Record(keras.callbacks.Callback):
    """Sets a run to where the one in its folder was stopped, and writes the folder while it trains.

    Keras's `BackupAndRestore` loses the optimizer's state and the random states of dropout, and its `CSVLogger` a line
    where a run is killed.
    """

    def __init__(self, run: NetworkRun, out: Path, about: dict):
        super().__init__()
        self.run, self.out, self.about, self.history = run, out, about, []
        if (out / "last.npz").exists():
            with np.load(out / "last.npz", allow_pickle=False) as file:
                stored = json.loads(file["state"].tobytes())
                _check_settings(stored["settings"], about["config"], out)
                self.history, run.position = stored["history"], stored["position"]
                for name, variable in run.variables.items():
                    variable.assign(file[name])

    def card(self) -> dict:
        """The card of a model file: of the network, and of the run so far."""
        seconds = round(sum(line["seconds"] for line in self.history), 1)
        return self.run.card() | self.about | {"history": self.history, "seconds": seconds}

    def on_epoch_begin(self, epoch, logs=None):
        self.start = self.saved = time.perf_counter()

    def on_train_batch_end(self, batch, logs=None):
        if time.perf_counter() - self.saved >= SAVE_EVERY and math.isfinite(logs["loss"]):
            self.save()

    def on_epoch_end(self, epoch, logs=None):
        if not math.isfinite(logs["loss"]):
            raise FloatingPointError(
                f"loss: expected a finite number, got {logs['loss']} in epoch {epoch}; try a lower rate"
            )
        rate = float(f"{float(self.run.optimizer.learning_rate):.7g}")
        line = {"epoch": epoch, "rate": rate, "loss": logs["loss"]}
        line |= {name: value for name, value in logs.items() if name.startswith("validation_")}
        line |= {"seconds": round(time.perf_counter() - self.start, 2)}
        best = min((before["validation_loss"] for before in self.history), default=math.inf)
        self.history.append(line)
        # The best one first: killed between the two, the last part is repeated with the same result.
        if line["validation_loss"] < best:
            save_model(self.out / "best.h5", self.run.model, self.run.spec, self.card(), box=self.run.box)
        self.save()
        with replacing(self.out / "history.csv") as temporary, open(temporary, "w", newline="") as file:
            writer = csv.DictWriter(file, self.history[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.history)

    def save(self) -> None:
        """Write last.npz."""
        arrays = {name: keras.ops.convert_to_numpy(variable) for name, variable in self.run.variables.items()}
        state = {"settings": self.about["config"], "history": self.history, "position": self.run.position}
        with replacing(self.out / "last.npz") as temporary, open(temporary, "wb") as file:
            np.savez(file, state=np.frombuffer(json.dumps(state).encode(), np.uint8), **arrays)
        self.saved = time.perf_counter()


def _check_settings(before: dict, settings: dict, out: Path) -> None:
    """Raise ValueError if the run in `out` was started with other settings."""
    for name in before.keys() | settings.keys():
        # The length of a run may change, unless the rates depend on it.
        if name == "epochs" and settings["schedule"] not in schedules.BY_LENGTH:
            continue
        if before.get(name) != settings.get(name):
            raise ValueError(
                f"{name}: expected {before.get(name)!r}, with which the run in {out} was started, "
                f"got {settings.get(name)!r}; take another folder, or delete it"
            )
