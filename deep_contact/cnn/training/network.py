"""A network in training, and the networks on images."""

from __future__ import annotations

import itertools
import sys

import numpy as np

from deep_contact.cnn import architectures
from deep_contact.cnn.backend import keras
from deep_contact.cnn.dataset import Store, evenly
from deep_contact.cnn.images import ImageSpec, input_image, label_image
from deep_contact.cnn.losses import masked_squared_error
from deep_contact.cnn.training.config import TrainingConfig
from deep_contact.io.provenance import package_versions, processor


class NetworkRun:
    """A network in training. Subclasses have `batches`, `step` and `validate`, and set `training_states`, their number.

    box: the world's box of a network of one size, or None. position: where the run is: the epoch, its batches and
    states that are done, and the sum of their losses.
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
        """All that a step changes: weights, statistics, the random states of dropout, the optimizer's."""
        self.begin(0)

    def begin(self, epoch: int) -> None:
        """Go to the first state of an epoch."""
        self.position = {"epoch": epoch, "batches": 0, "states": 0, "loss": 0.0}

    def batches_per_epoch(self) -> int:
        """Number of full batches of an epoch. Raises ValueError where there are fewer states than one batch has."""
        states, size = self.training_states, self.config.batch_size
        if states < size:
            raise ValueError(f"batch_size: expected at most the {states} states to train on, got {size}")
        return max(1, min(states, self.config.states_per_epoch or states) // size)

    def fit(self, callbacks: list, *, verbose: int) -> None:
        """Train from `position` on, until all epochs are done or a callback ends it.

        Not `keras.Model.fit`, which takes no gradient that comes from elsewhere and goes on from no point in an epoch.
        """
        epochs, per_epoch = self.config.epochs, self.batches_per_epoch() * self.config.batch_size
        called = keras.callbacks.CallbackList(callbacks, model=self.model, epochs=epochs, verbose=verbose)
        self.model.stop_training = False
        called.on_train_begin()
        for epoch in range(self.position["epoch"], epochs):
            called.on_epoch_begin(epoch)
            if verbose:
                print(f"Epoch {epoch + 1}/{epochs}")
            bar = keras.utils.Progbar(per_epoch, verbose=verbose, unit_name="state", stateful_metrics=["loss"])
            at = self.position
            for k, batch in itertools.islice(enumerate(self.batches(epoch)), at["batches"], None):
                called.on_train_batch_begin(k)
                loss, count = self.step(batch)
                at.update(batches=k + 1, states=at["states"] + count, loss=at["loss"] + loss)
                mean = at["loss"] / at["states"]
                called.on_train_batch_end(k, {"loss": mean})
                bar.update(at["states"], [("loss", mean)], finalize=False)
            found = {"loss": at["loss"] / at["states"]} | self.validate()
            shown = [(name, found[name]) for name in ("loss", "validation_loss")]
            bar.update(at["states"], shown, finalize=True)
            self.begin(epoch + 1)
            called.on_epoch_end(epoch, found | {"val_loss": found["validation_loss"]})
            if self.model.stop_training:
                break
        called.on_train_end()

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
        self.length = -(-count // batch_size) if seed is None else max(1, count // batch_size)
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
        metrics = [masked_squared_error]  # without the weights' penalty, which the loss has
        self.model.compile(self.optimizer, loss=masked_squared_error, metrics=metrics, jit_compile=False)

    def batches(self, epoch: int):
        """Batches of images, in the order of the epoch."""
        self.images.start(epoch)
        return (self.images[k] for k in range(len(self.images)))

    def step(self, batch) -> tuple[float, int]:
        """One step. Returns the sum of the losses and the number of states."""
        self.model.reset_metrics()
        loss = self.model.train_on_batch(*batch, return_dict=True)["loss"]
        return float(loss) * len(batch[0]), len(batch[0])

    def validate(self) -> dict[str, float]:
        """The loss on the validation states."""
        found = self.model.evaluate(self.validation_images, verbose=0, return_dict=True)
        return {"validation_loss": float(found["masked_squared_error"])}
