"""The base class of training runs, which writes the files that `run` describes, and the training of networks on images.

Tests: tests/cnn/test_training.py, tests/cnn/test_architectures.py
"""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path
from time import perf_counter

import numpy as np

from deep_contact.cnn import architectures, schedules
from deep_contact.cnn.backend import keras
from deep_contact.cnn.dataset import Split, Store, evenly
from deep_contact.cnn.evaluation import start_quality
from deep_contact.cnn.images import input_image, label_image
from deep_contact.cnn.inference import LearnedModel
from deep_contact.cnn.model_file import save_model
from deep_contact.cnn.training.config import TrainingConfig
from deep_contact.io.files import replacing
from deep_contact.io.provenance import package_versions, processor
from deep_contact.state.validation import expect


def optimizer_of(config: TrainingConfig) -> keras.optimizers.Optimizer:
    """Return a new Keras optimizer with the settings of a run."""
    if config.optimizer == "adam":  # Eq 4.10
        return keras.optimizers.Adam(config.rate, global_clipnorm=1.0)
    # SGD is Eq 4.7. With momentum it is Eq 4.9, and 0.9 is the momentum of the authors' code.
    momentum = {"momentum": 0.9, "nesterov": True} if config.optimizer == "nesterov" else {}
    return keras.optimizers.SGD(config.rate, **momentum)


class NetworkRun:
    """A training run of a network. Subclasses define the methods `batches`, `step` and `validate`.

    config: settings. store: the simulations. states, validation: training and validation states as pairs (simulation,
    index), (k, 2). network: the network to train, or None to build one. options: arguments of `architectures.build`.
    Attributes: box is the world's box, m, for a network of fixed size, or None. history has a dict for each finished
    epoch, name of the column in history.csv -> value.
    """

    box = None

    def __init__(self, config: TrainingConfig, store: Store, states, validation, network, **options):
        self.config, self.spec, self.store = config, config.spec(), store
        self.states, self.validation = states, evenly(validation, config.validation_states)
        self.model = network or architectures.build(config.architecture, **(options | config.options))
        self.optimizer = optimizer_of(config)
        self.optimizer.build(self.model.trainable_variables)
        self.model.optimizer = self.optimizer  # Keras's callbacks read this attribute
        kinds = {"model": self.model.variables, "optimizer": self.optimizer.variables}
        self.variables = {f"{kind}_{i:04d}": v for kind, of_kind in kinds.items() for i, v in enumerate(of_kind)}
        """All variables that a training step changes.

        They are weights, statistics of batch normalisation, random states of dropout, and variables of the optimizer.
        """
        self.history = []

    def batches_per_epoch(self) -> int:
        """Return the number of full batches in an epoch. Raises ValueError if the run has fewer states than a batch."""
        states, size = len(self.states), self.config.batch_size
        expect(states >= size, f"batch_size: expected at most the {states} states to train on, got {size}")
        return max(1, min(states, self.config.states_per_epoch or states) // size)

    def resume(self, out: Path, about: dict) -> None:
        """Load history and variables from the folder `out`, if it has a run.

        about: entries for the card that describe the run; "config" has its settings. Raises ValueError if the run in
        the folder was started with other settings.
        """
        self.out, self.about = out, about
        if (out / "last.npz").exists():
            with np.load(out / "last.npz", allow_pickle=False) as file:
                stored = json.loads(file["state"].tobytes())
                before, settings = stored["settings"], about["config"]
                # The number of epochs may change, unless the learning rates depend on it.
                free = () if settings["schedule"] in schedules.BY_LENGTH else {"epochs"}
                for name in (before.keys() | settings.keys()).difference(free):
                    expected = f"{before.get(name)!r}, with which the run in {out} was started"
                    same = before.get(name) == settings.get(name)
                    way = f"`--from {out / 'best.h5'}` and another `--out` go on from its network"
                    expect(same, f"{name}: expected {expected}, got {settings.get(name)!r}; {way}")
                self.history = stored["history"]
                for name, variable in self.variables.items():
                    variable.assign(file[name])

    def fit(self, callbacks: list, *, verbose: int) -> None:
        """Train until all epochs are done or a callback ends the run. The run's files are written after each epoch.

        `keras.Model.fit` is not used, because it takes no gradient from outside of TensorFlow. Keras's
        `BackupAndRestore` is not used, because it does not store the optimizer's state and the random states of
        dropout. callbacks: Keras callbacks. verbose: 0, 1 or 2, as for `run.train`.
        """
        options = {"epochs": self.config.epochs, "steps": None, "verbose": verbose}
        called = keras.callbacks.CallbackList(callbacks, add_progbar=bool(verbose), model=self.model, **options)
        self.model.stop_training = False
        called.on_train_begin()
        for epoch in range(len(self.history), self.config.epochs):
            called.on_epoch_begin(epoch)
            states, total, start = 0, 0.0, perf_counter()
            for k, batch in enumerate(self.batches(epoch)):
                called.on_train_batch_begin(k)
                loss, count = self.step(batch)
                states, total = states + count, total + loss
                called.on_train_batch_end(k, {"loss": total / states})
            mean = total / states
            if not math.isfinite(mean):
                raise FloatingPointError(f"loss: expected a finite number, got {mean} in epoch {epoch}; lower the rate")
            measured = {"loss": mean} | self.validate()
            self._end_epoch(epoch, measured, perf_counter() - start)
            called.on_epoch_end(epoch, measured | {"val_loss": measured["validation_loss"]})
            if self.model.stop_training:
                break
        called.on_train_end()

    def _end_epoch(self, epoch: int, measured: dict, seconds: float) -> None:
        """Add an epoch to the history, and write the run's files.

        epoch: number of the epoch, from 0. measured: name of the column in history.csv -> value. seconds: duration of
        the epoch, s.
        """
        rate = float(f"{float(self.optimizer.learning_rate):.7g}")
        best = min((line["validation_loss"] for line in self.history), default=math.inf)
        self.history.append({"epoch": epoch, "rate": rate} | measured | {"seconds": round(seconds, 2)})
        # best.h5 is written before last.npz. A run that is killed between the two repeats the epoch with the same
        # result.
        if measured["validation_loss"] < best:
            save_model(self.out / "best.h5", self.model, self.spec, self.card(), box=self.box)
        self.save()
        with replacing(self.out / "history.csv") as temporary, open(temporary, "w", newline="") as file:
            writer = csv.DictWriter(file, self.history[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.history)

    def save(self) -> None:
        """Write the file last.npz, from which `resume` continues the run."""
        arrays = {name: keras.ops.convert_to_numpy(variable) for name, variable in self.variables.items()}
        state = {"settings": self.about["config"], "history": self.history}
        with replacing(self.out / "last.npz") as temporary, open(temporary, "wb") as file:
            np.savez(file, state=np.frombuffer(json.dumps(state).encode(), np.uint8), **arrays)

    def card(self) -> dict:
        """Return the card of a model file, which describes the network and the run up to now."""
        return {
            "architecture": self.config.architecture,
            "options": dict(self.config.options),
            "parameters": int(self.model.count_params()),
            "trainable_parameters": int(sum(np.prod(v.shape) for v in self.model.trainable_variables)),
            "training_states": len(self.states),
            "seed": self.config.seed,
            "versions": {**package_versions(), "python": sys.version.split()[0], "backend": keras.backend.backend()},
            "cpu": processor(),
            **self.about,
            "history": self.history,
            "seconds": round(sum(line["seconds"] for line in self.history), 1),
        }


def masked_squared_error(y_true, y_pred):
    """Return the loss of Appendix B (Eq 5.3): the mean squared error over the last axis, masked by the label.

    The squared error of a node is (y_pred − y_true)² where the label y_true is not 0. Where the label is 0, the squared
    error is 0 for any prediction, and the node counts in the mean.
    """
    ops = keras.ops
    off = ops.cast(y_pred, y_true.dtype) - y_true  # predictions may have a lower precision than the labels
    return ops.mean(ops.where(ops.not_equal(y_true, 0.0), ops.square(off), 0.0), axis=-1)


JUDGED = 200
"""Approximate number of validation states for which the predicted impulses are judged as a start after each epoch."""


class ImageRun(NetworkRun):
    """A training run of a network that predicts images of impulses.

    Raises ValueError if the images of the simulations have different shapes.
    """

    def __init__(self, config: TrainingConfig, store: Store, split: Split, network: keras.Model | None):
        worlds = [store.info(sim).header["world"] for sim in split.train + split.validation]
        boxes = {config.spec().shape(world): world.box for world in worlds}
        expect(len(boxes) == 1, f"data: expected boxes of one size, got {' and '.join(map(str, boxes.values()))}")
        self.box = worlds[0].box
        sides = store.states(split.train), store.states(split.validation)
        super().__init__(config, store, *sides, network, shape=next(iter(boxes)))
        for layer in self.model.layers:
            layer.dtype_policy = config.precision
        self.judged = [store.state(*state) for state in evenly(self.validation, JUDGED).tolist()]
        self.learned = LearnedModel(source=self.model, spec=self.spec)
        metrics = [masked_squared_error]  # the loss alone; what Keras calls the loss includes the L2 penalty
        self.model.compile(self.optimizer, loss=masked_squared_error, metrics=metrics, jit_compile=False)

    def _images(self, states: np.ndarray, count: int):
        """Yield the first `count` batches of some states, in order, as pairs (input images, label images).

        states: pairs (simulation, index of the state), (k, 2). A batch has b = `config.batch_size` states; the last
        batch may have fewer. Input images are (b, n_y, n_x, c) with c channels. Label images are flat, (b, n_y · n_x ·
        t), with t target maps. Both are float32.
        """
        size = self.config.batch_size
        for k in range(count):
            batch = [self.store.state(*state) for state in states[k * size : (k + 1) * size].tolist()]
            labels = [label_image(state, self.spec).ravel() for state in batch]
            yield np.stack([input_image(state, self.spec) for state in batch]), np.stack(labels)

    def batches(self, epoch: int):
        """Return an iterator over the full batches of an epoch, in a random order that depends on seed and epoch."""
        order = np.random.default_rng((self.config.seed, epoch)).permutation(self.states)
        return self._images(order, self.batches_per_epoch())

    def step(self, batch) -> tuple[float, int]:
        """Do one step of the optimizer. Returns the sum of the states' losses, and the number of states.

        The losses do not include the L2 penalty of the weights. batch: inputs and labels, as `_images` yields them.
        """
        self.model.reset_metrics()
        loss = self.model.train_on_batch(*batch, return_dict=True)["masked_squared_error"]
        return float(loss) * len(batch[0]), len(batch[0])

    def validate(self) -> dict[str, float]:
        """Measure the network on the validation states. Returns name of the column in history.csv -> value.

        The values are the loss, the L2 penalty of the weights, and the errors of the predicted impulses as a start,
        which `start_quality` measures on the states `judged`.
        """
        steps = -(-len(self.validation) // self.config.batch_size)
        measured = self.model.evaluate(self._images(self.validation, steps), steps=steps, verbose=0, return_dict=True)
        losses = {"penalty": measured["loss"] - measured["masked_squared_error"]}
        losses |= {"validation_loss": measured["masked_squared_error"]}
        quality = start_quality(self.judged, lambda state, solver: self.learned.predict(state))
        return losses | {f"validation_{name}": value for name, value in quality.items()}
