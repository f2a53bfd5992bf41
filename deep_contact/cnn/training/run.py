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
|----------------------------|-----------------------------------------------------------------------------------------|
| epoch, rate, loss           | number from 0; learning rate; mean training loss                                       |
| validation_loss             | on the validation states; for the far-field network over that of Builtin's start       |
| validation_velocity_error   | mean relative velocity error of the projected prediction, before any sweep             |
| validation_velocity_error_k | after k sweeps, for each of `TrainingConfig.sweeps` (far-field network)                |
| validation_impulse_error    | mean relative error of the projected impulses, before any sweep (images)               |
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
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.cnn import schedules
from deep_contact.cnn.backend import keras
from deep_contact.cnn.dataset import Store, fit_scales, split_by_simulation
from deep_contact.cnn.evaluation import BASELINES, held_out_errors
from deep_contact.cnn.images import ImageSpec
from deep_contact.cnn.inference import Cnn, LearnedModel, limit_threads, load_model
from deep_contact.cnn.model_file import read_metadata, save_model
from deep_contact.cnn.training.config import TrainingConfig
from deep_contact.cnn.training.far_field_run import FarFieldRun
from deep_contact.cnn.training.image_run import ImageRun, strategy_for
from deep_contact.cnn.training.network import Checkpoint, evenly, read_checkpoint
from deep_contact.io.files import replacing


class Training(NamedTuple):
    """A finished run: history (a dict an epoch, by column), best epoch, path of model.h5 and the model in it."""

    history: list[dict]
    best_epoch: int
    path: Path
    model: LearnedModel


def set_up(seed: int, threads: int | None = None) -> None:
    """Make training repeatable: seeds, deterministic kernels, number of threads. Call it before anything is built."""
    if keras.backend.backend() == "tensorflow":
        import tensorflow as tf

        if threads is not None:
            limit_threads(threads)
        tf.config.experimental.enable_op_determinism()
    keras.utils.set_random_seed(seed)


def train(
    config: TrainingConfig,
    data,
    out,
    *,
    from_model=None,
    threads: int | None = None,
    devices: int = 1,
    command: str = "",
    held_out: int = 300,
    tensorboard=None,
    verbose: int | str = "auto",
    callbacks: Sequence[keras.callbacks.Callback] = (),
) -> Training:
    """Train until the epochs are done or patience runs out; an unfinished run in `out` goes on.

    data: a `Store` or its folder. out: folder of the run. from_model: path of a model file whose network the run starts
    with, in place of an untrained one; its images have to be those of the settings (`config.config_of` gives them).
    threads: of TensorFlow (`limit_threads`), or None to leave them as they are. devices: of TensorFlow (GPUs, else its
    logical CPUs) that share every batch; a step equals that of one device except for rounding and dropout masks.
    command: for the card. held_out: number of test states for the card. tensorboard: folder for event files.
    verbose: 0 prints nothing, 1 Keras's progress bar, 2 a line an epoch, "auto" 1 on a terminal and 2 elsewhere.
    callbacks: of Keras. Their logs hold the columns of history.csv, and validation_loss by Keras's name val_loss too.
    The schedule sets the rate before each epoch. A run that goes on calls them only from there on.
    Raises ValueError where the run in `out` was started with other settings or data (`patience` may differ, and
    `epochs` unless the rates depend on it), and for devices that are not there or cannot share the batches;
    FloatingPointError where the loss is not finite.
    """
    store = data if isinstance(data, Store) else Store(data)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    set_up(config.seed, threads)
    strategy = strategy_for(config, devices)
    sims = store.simulations[: config.simulations]
    split = split_by_simulation(sims, fractions=config.fractions, seed=config.seed)
    settings = asdict(config) | {"data": store.data_hash(sims)}
    settings["from_model"] = None if from_model is None else read_metadata(from_model)["digest"]
    settings = json.loads(json.dumps(settings))
    saved = read_checkpoint(out / "last.npz")
    if saved is not None:
        _check_settings(saved, settings, out)
    with _layers_in(config.precision):
        run = _run_of(config, store, split, saved, from_model, strategy)
    history = saved.history if saved is not None else []

    def card(**more):
        known = {"command": command, "config": settings, "data_hash": settings["data"], "split": split._asdict()}
        seconds = round(sum(line["seconds"] for line in history), 1)
        return run.card() | known | {"history": history, "seconds": seconds} | more

    called = _callbacks(config, run, history, callbacks, tensorboard, verbose)
    rates = schedules.schedule(config.schedule, epochs=config.epochs, rate=config.rate)
    best = min((line["validation_loss"] for line in history), default=math.inf)
    while len(history) < config.epochs and not run.model.stop_training:
        epoch, start = len(history), time.perf_counter()
        run.optimizer.learning_rate = rate = rates(epoch)
        called.on_epoch_begin(epoch)
        loss = run.epoch(epoch, called)
        if not math.isfinite(loss):
            raise FloatingPointError(f"loss: expected a finite number, got {loss} in epoch {epoch}; try a lower rate")
        line = {"epoch": epoch, "rate": rate, "loss": loss, **run.validate()}
        # In float32, in which Keras's callbacks compare it.
        line["validation_loss"] = float(np.float32(line["validation_loss"]))
        line["seconds"] = round(time.perf_counter() - start, 2)
        history.append(line)
        # The best one first: killed between the two, the epoch is repeated with the same result.
        if line["validation_loss"] < best:
            best = line["validation_loss"]
            run.save(out / "best.h5", card())
        run.write_checkpoint(out / "last.npz", settings, history)
        _write_history(out / "history.csv", history)
        logs = {name: value for name, value in line.items() if name != "epoch"}
        called.on_epoch_end(epoch, logs | {"val_loss": line["validation_loss"]})
    called.on_train_end()
    best_epoch = min(range(len(history)), key=lambda k: history[k]["validation_loss"])
    model = load_model(out / "best.h5")
    tested = evenly(store.states(split.test), held_out)
    errors = held_out_errors((store.state(*state) for state in tested.tolist()), BASELINES | {"cnn": Cnn(model)})
    more = {"best_epoch": best_epoch, "held_out": errors}
    path = save_model(out / "model.h5", model.network, run.spec, card(**more), coarsening=model.coarsening, box=run.box)
    return Training(history, best_epoch, path, load_model(path))


def _run_of(config, store, split, saved: Checkpoint | None, from_model, strategy) -> ImageRun | FarFieldRun:
    """The run at its checkpoint, or at its beginning."""
    initial, spec = None, config.spec()
    if from_model is not None:
        with strategy.scope() if strategy else nullcontext():
            initial = load_model(from_model)
        if _without_scales(initial.spec) != spec:
            raise ValueError(f"from_model: expected a network for the images {spec}, got one for {initial.spec}")
        spec = initial.spec
    elif saved is None and config.measure_scales and isinstance(spec, ImageSpec):
        spec = fit_scales(store, split.train, spec, seed=config.seed)
    if saved is not None:
        spec = saved.spec
    if config.is_far_field:
        run = FarFieldRun(config, store, split, spec, initial=initial)
    else:
        run = ImageRun(config, store, split, spec, strategy=strategy, initial=initial)
    if saved is not None:
        run.restore(saved)
    return run


@contextmanager
def _layers_in(precision: str):
    """Keras builds layers of that precision within; `keras.config` has no context of its own."""
    before = keras.config.dtype_policy()
    keras.config.set_dtype_policy(precision)
    try:
        yield
    finally:
        keras.config.set_dtype_policy(before)


def _without_scales(spec):
    return spec.replace(scales=None, target_scales=None) if isinstance(spec, ImageSpec) else spec


def _check_settings(saved: Checkpoint, settings: dict, out: Path) -> None:
    """Raise ValueError if the run in `out` was started with other settings."""
    # The length of a run may change, unless the rates depend on it.
    free = {"patience"} if settings["schedule"] in schedules.BY_LENGTH else {"patience", "epochs"}
    # A run from before a setting existed was started with its default.
    started_with = json.loads(json.dumps(asdict(TrainingConfig()))) | {"from_model": None} | saved.settings
    for name, value in settings.items():
        if name not in free and started_with.get(name) != value:
            raise ValueError(
                f"{name}: expected {started_with.get(name)!r}, with which the run in {out} was started, "
                f"got {value!r}; take another folder, or delete it"
            )


def _callbacks(config, run, history, given, tensorboard, verbose) -> keras.callbacks.CallbackList:
    """Keras's callbacks and the user's, begun."""
    patience = keras.callbacks.EarlyStopping("validation_loss", patience=config.patience or math.inf, mode="min")
    if verbose == "auto":
        verbose = 1 if sys.stdout.isatty() else 2
    called = keras.callbacks.CallbackList(
        [patience, *given, *([EventFiles(tensorboard)] if tensorboard else [])],
        add_progbar=verbose != 0,
        model=run.model,
        verbose=verbose,
        epochs=config.epochs,
        steps=run.steps,
    )
    run.model.stop_training = False
    called.on_train_begin()
    for line in history:  # it counts from the beginning, also in a run that goes on
        patience.on_epoch_end(line["epoch"], line)
    return called


def _write_history(path: Path, history: list[dict]) -> None:
    """Replace history.csv as a whole; `keras.callbacks.CSVLogger` appends, and loses a line where a run is killed."""
    text = io.StringIO()
    writer = csv.DictWriter(text, dict.fromkeys(name for line in history for name in line), lineterminator="\n")
    writer.writeheader()
    writer.writerows(history)
    with replacing(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


class EventFiles(keras.callbacks.Callback):
    """Event files for TensorBoard: a scalar for each column of the history.

    `keras.callbacks.TensorBoard` needs the package tensorboard, which TensorFlow does not install any more.
    """

    def __init__(self, folder):
        super().__init__()
        import tensorflow as tf

        self.tf, self.writer = tf, tf.summary.create_file_writer(str(folder))
        self.metadata = tf.compat.v1.SummaryMetadata(plugin_data={"plugin_name": "scalars"}, data_class=1)

    def on_epoch_end(self, epoch, logs=None):
        with self.writer.as_default():
            for name, value in logs.items():
                value = self.tf.constant(value, self.tf.float32)
                self.tf.summary.write(name, value, step=epoch, metadata=self.metadata)
        self.writer.flush()
