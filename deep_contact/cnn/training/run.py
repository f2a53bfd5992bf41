"""A training run: simulated data, one epoch after the other, from wherever the last run was stopped.

A run is a folder:

| file        | holds                                                                                             |
|-------------|---------------------------------------------------------------------------------------------------|
| last.npz    | after every epoch: weights, optimizer, random state, history and settings; a run goes on from it   |
| best.h5     | the model file of the epoch with the lowest validation loss so far                                |
| history.csv | one line for each epoch, with the columns below                                                   |
| model.h5    | at the end: the best one with its card                                                            |

Each file is replaced as a whole, and an epoch depends only on last.npz, the settings and the data. So a run that is
killed at any moment and started again gives the history of an undisturbed run, to the last bit on the same machine.
At most the epoch in progress is lost.

| column                      | meaning                                                                                |
|-----------------------------|----------------------------------------------------------------------------------------|
| epoch, rate, loss           | number from 0; learning rate; mean training loss                                       |
| validation_loss             | on the validation states; for the far-field network over that of Builtin's start       |
| validation_velocity_error   | mean relative velocity error before any sweep (far-field network)                      |
| validation_velocity_error_k | after k sweeps, for each of `TrainingConfig.sweeps` (far-field network)                |
| seconds                     | wall time of the epoch                                                                 |
"""

from __future__ import annotations

import csv
import io
import json
import math
import sys
import time
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.cnn import architectures, schedules
from deep_contact.cnn.backend import keras
from deep_contact.cnn.dataset import Store, evenly, split_by_simulation
from deep_contact.cnn.evaluation import BASELINES, held_out_errors
from deep_contact.cnn.images import ImageSpec, input_image, label_image
from deep_contact.cnn.inference import Cnn, LearnedModel, limit_threads, load_model
from deep_contact.cnn.losses import masked_squared_error
from deep_contact.cnn.model_file import read_metadata, save_model
from deep_contact.cnn.training.config import TrainingConfig
from deep_contact.io.files import replacing
from deep_contact.reporting.results import package_versions, processor


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
    of test states for the card. verbose: 0 prints nothing, 1 Keras's progress bar, 2 a line an epoch, "auto" 1 on a
    terminal and 2 elsewhere. callbacks: of Keras; a run that goes on calls them only from there on.
    Raises ValueError where the run in `out` was started with other settings or data (`epochs` may differ unless the
    rates depend on it); FloatingPointError where the loss is not finite.
    """
    from deep_contact.cnn.training.far_field_run import FarFieldRun

    store = data if isinstance(data, Store) else Store(data)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    set_up(config.seed, threads)
    sims = store.simulations[: config.simulations]
    split = split_by_simulation(sims, fractions=config.fractions, seed=config.seed)
    settings = asdict(config) | {"data": store.data_hash(sims)}
    settings["from_model"] = None if from_model is None else read_metadata(from_model)["digest"]
    settings = json.loads(json.dumps(settings))
    with _layers_in(config.precision):
        run = (FarFieldRun if config.is_far_field else ImageRun)(config, store, split, _initial(from_model, config))
    about = {"command": command, "config": settings, "data_hash": settings["data"], "split": split._asdict()}
    record = Record(run, out, about)
    rates = schedules.schedule(config.schedule, epochs=config.epochs, rate=config.rate)
    if verbose == "auto":
        verbose = 1 if sys.stdout.isatty() else 2
    if len(record.history) < config.epochs:
        scheduler = keras.callbacks.LearningRateScheduler(lambda epoch, rate: rates(epoch))
        run.fit([scheduler, record, *callbacks], epochs=config.epochs, first=len(record.history), verbose=verbose)
    history = record.history
    best_epoch = min(range(len(history)), key=lambda k: history[k]["validation_loss"])
    model = load_model(out / "best.h5")
    tested = evenly(store.states(split.test), held_out)
    errors = held_out_errors((store.state(*state) for state in tested.tolist()), BASELINES | {"cnn": Cnn(model)})
    card = record.card() | {"best_epoch": best_epoch, "held_out": errors}
    path = save_model(out / "model.h5", model.network, run.spec, card, box=run.box)
    return Training(history, best_epoch, path, load_model(path))


def set_up(seed: int, threads: int | None = None) -> None:
    """Make training repeatable: seeds, deterministic kernels, number of threads. Call it before anything is built."""
    if keras.backend.backend() == "tensorflow":
        import tensorflow as tf

        if threads is not None:
            limit_threads(threads)
        tf.config.experimental.enable_op_determinism()
    keras.utils.set_random_seed(seed)


@contextmanager
def _layers_in(precision: str):
    """Keras builds layers of that precision within; `keras.config` has no context of its own."""
    before = keras.config.dtype_policy()
    keras.config.set_dtype_policy(precision)
    try:
        yield
    finally:
        keras.config.set_dtype_policy(before)


def _initial(from_model, config: TrainingConfig) -> keras.Model | None:
    if from_model is None:
        return None
    initial = load_model(from_model)
    if initial.spec != config.spec():
        raise ValueError(f"from_model: expected a network for the images {config.spec()}, got one for {initial.spec}")
    return initial.network


class NetworkRun:
    """A network in training. Subclasses have `fit`, which trains it, and set `training_states`, their number.

    box: the world's box of a network of one size, or None.
    """

    box = None

    def __init__(self, config: TrainingConfig, network: keras.Model | None, **options):
        self.config, self.spec = config, config.spec()
        sizes = {"channels": len(self.spec.channels), "outputs": len(self.spec.targets)}
        self.model = network or architectures.build(config.architecture, **sizes, **(options | config.options))
        if config.optimizer == "sgd":  # Eq 4.8
            self.optimizer = keras.optimizers.SGD(config.rate)
        else:
            self.optimizer = keras.optimizers.Adam(config.rate, global_clipnorm=1.0)
        self.optimizer.build(self.model.trainable_variables)
        self.model.optimizer = self.optimizer  # where Keras's callbacks look for it
        kinds = {"model": self.model.variables, "optimizer": self.optimizer.variables}
        self.variables = {f"{kind}_{i:04d}": v for kind, found in kinds.items() for i, v in enumerate(found)}
        """All that an epoch changes: weights, statistics, the random states of dropout, the optimizer's."""

    def batches_per_epoch(self) -> int:
        """Number of full batches of an epoch. Raises ValueError where there are fewer states than one batch has."""
        states, size = self.training_states, self.config.batch_size
        if states < size:
            raise ValueError(f"batch_size: expected at most the {states} states to train on, got {size}")
        return max(1, min(states, self.config.states_per_epoch or states) // size)

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


class Record(keras.callbacks.Callback):
    """Sets a run to where the one in its folder was stopped, and writes the folder after every epoch.

    Keras's `BackupAndRestore` loses the random states of dropout, and its `CSVLogger` a line where a run is killed.
    """

    def __init__(self, run: NetworkRun, out: Path, about: dict):
        super().__init__()
        self.run, self.out, self.about, self.history = run, out, about, []
        if (out / "last.npz").exists():
            with np.load(out / "last.npz", allow_pickle=False) as file:
                stored = json.loads(file["state"].tobytes())
                _check_settings(stored["settings"], about["config"], out)
                self.history = stored["history"]
                for name, variable in run.variables.items():
                    variable.assign(file[name])

    def card(self) -> dict:
        """The card of a model file: of the network, and of the run so far."""
        seconds = round(sum(line["seconds"] for line in self.history), 1)
        return self.run.card() | self.about | {"history": self.history, "seconds": seconds}

    def on_epoch_begin(self, epoch, logs=None):
        self.start = time.perf_counter()

    def on_epoch_end(self, epoch, logs=None):
        if not math.isfinite(logs["loss"]):
            raise FloatingPointError(
                f"loss: expected a finite number, got {logs['loss']} in epoch {epoch}; try a lower rate"
            )
        line = {
            "epoch": epoch,
            "rate": float(f"{float(self.run.optimizer.learning_rate):.7g}"),
            "loss": float(logs["loss"]),
        }
        line |= self.run.validated(logs) | {"seconds": round(time.perf_counter() - self.start, 2)}
        best = min((before["validation_loss"] for before in self.history), default=math.inf)
        self.history.append(line)
        # The best one first: killed between the two, the epoch is repeated with the same result.
        if line["validation_loss"] < best:
            save_model(self.out / "best.h5", self.run.model, self.run.spec, self.card(), box=self.run.box)
        arrays = {name: keras.ops.convert_to_numpy(variable) for name, variable in self.run.variables.items()}
        state = json.dumps({"settings": self.about["config"], "history": self.history})
        with replacing(self.out / "last.npz") as temporary, open(temporary, "wb") as file:
            np.savez(file, state=np.frombuffer(state.encode(), np.uint8), **arrays)
        text = io.StringIO()
        writer = csv.DictWriter(text, self.history[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.history)
        with replacing(self.out / "history.csv") as temporary:
            temporary.write_text(text.getvalue(), encoding="utf-8")


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


# ---- networks on images, trained by Keras ----


class ImageDataset(keras.utils.PyDataset):
    """Batches of images as Keras takes them: item k is (inputs (b, n_y, n_x, c), labels (b, n_y · n_x · t)), float32.

    store, states: (k, 2) of (simulation, index) in it. seed: they come in a random order, another one each epoch, and
    in full batches only; None: in their order, all of them. states_per_epoch: at most so many, or None.
    Raises ValueError where two simulations have images of different shapes.
    """

    def __init__(self, store: Store, states, spec: ImageSpec, *, batch_size: int, seed=None, states_per_epoch=None):
        super().__init__()
        self.store, self.spec, self.batch_size, self.seed = store, spec, batch_size, seed
        self.states = np.asarray(states, np.int64).reshape(-1, 2)
        count = min(len(self.states), states_per_epoch or len(self.states))
        self.length = -(-count // batch_size) if seed is None else count // batch_size
        worlds = [store.info(sim).header["world"] for sim in np.unique(self.states[:, 0]).tolist()]
        shapes = {spec.shape(world): world for world in worlds}
        if len(shapes) > 1:
            raise ValueError(f"states: expected boxes of one size, got {' and '.join(str(w.box) for w in worlds)}")
        self.box = worlds[0].box if worlds else None
        self.start(0)

    def __len__(self) -> int:
        return self.length

    def start(self, epoch: int) -> None:
        """Take the states in the order of an epoch."""
        self.epoch, self.order = epoch, self.states
        if self.seed is not None:
            self.order = np.random.default_rng((self.seed, epoch)).permutation(self.states)

    def on_epoch_end(self) -> None:
        self.start(self.epoch + 1)

    def __getitem__(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        chosen = self.order[k * self.batch_size : (k + 1) * self.batch_size].tolist()
        states = [self.store.state(*state) for state in chosen]
        labels = np.stack([label_image(state, self.spec) for state in states])
        return np.stack([input_image(state, self.spec) for state in states]), labels.reshape(len(states), -1)


class ImageRun(NetworkRun):
    """A run whose network predicts images of impulses."""

    def __init__(self, config: TrainingConfig, store: Store, split, network: keras.Model | None):
        spec, options = config.spec(), {"batch_size": config.batch_size}
        states, tested = store.states(split.train), evenly(store.states(split.validation), config.validation_states)
        more = {"seed": config.seed, "states_per_epoch": config.states_per_epoch}
        self.images = ImageDataset(store, states, spec, **options, **more)
        self.validation_images = ImageDataset(store, tested, spec, **options)
        self.training_states, self.box = len(states), self.images.box
        super().__init__(config, network, shape=spec.shape(store.info(split.train[0]).header["world"]))
        self.batches_per_epoch()

    def fit(self, callbacks: list, *, epochs: int, first: int, verbose: int) -> None:
        """Train from epoch `first` on."""
        loss = {"loss": masked_squared_error, "metrics": [masked_squared_error], "jit_compile": False}
        self.model.compile(self.optimizer, **loss)
        self.images.start(first)
        given = {"validation_data": self.validation_images, "callbacks": callbacks, "shuffle": False}
        self.model.fit(self.images, epochs=epochs, initial_epoch=first, verbose=verbose, **given)

    def validated(self, logs: dict) -> dict[str, float]:
        """The columns of the history on the validation states: the loss without the weights' penalty."""
        return {"validation_loss": float(logs["val_masked_squared_error"])}
