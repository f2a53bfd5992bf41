"""Runs whose network predicts images of impulses, on one device or several."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np

from deep_contact.cnn import losses
from deep_contact.cnn.backend import keras
from deep_contact.cnn.dataset import Batch, ImageBatches
from deep_contact.cnn.images import ImageSpec, augment
from deep_contact.cnn.inference import padded_shape
from deep_contact.cnn.losses import CONTACT_LOSSES, ContactBatch
from deep_contact.cnn.training.config import TrainingConfig
from deep_contact.cnn.training.network import NetworkRun, evenly
from deep_contact.physics.contact_solver import projected
from deep_contact.validation import integer

ops = keras.ops


def strategy_for(config: TrainingConfig, devices: int):
    """TensorFlow's strategy for training on so many devices; None with another backend, which has one.

    Raises ValueError naming what was expected.
    """
    integer("devices", devices, 1)
    if devices > 1 and config.is_far_field:
        raise ValueError(f"devices: expected 1 for the far-field network, whose loss is the solver's, got {devices}")
    if config.batch_size % devices:
        raise ValueError(f"batch_size: expected a multiple of the {devices} devices, got {config.batch_size}")
    if keras.backend.backend() != "tensorflow":
        if devices > 1:
            raise ValueError(f"devices: expected 1 with the backend {keras.backend.backend()}, got {devices}")
        return None
    import tensorflow as tf

    if devices == 1:
        return tf.distribute.get_strategy()
    found = tf.config.list_logical_devices("GPU") or tf.config.list_logical_devices("CPU")
    if len(found) < devices:
        raise ValueError(f"devices: expected at most the {len(found)} that TensorFlow sees, got {devices}")
    # Sum on one device, always in the same order: the collectives of CPUs mix up those of batch normalisation.
    reduction = tf.distribute.ReductionToOneDevice()
    return tf.distribute.MirroredStrategy([device.name for device in found[:devices]], cross_device_ops=reduction)


def compact_options(spec: ImageSpec) -> dict:
    """Options of `architectures.compact` that follow from the spec: the channels with density and Builtin's start."""
    place = spec.channels.index
    options = {"density": place("contact_density")} if "contact_density" in spec.channels else {}
    starts = ["builtin_" + name.removesuffix("_impulse") for name in spec.targets]
    if all(name in spec.channels for name in starts):
        options["starts"] = [place(name) for name in starts]
    return options


class ImageDataset(keras.utils.PyDataset):
    """The batches of `ImageBatches` as Keras takes them, an epoch at a time: item k is (inputs, labels) of batch k.

    Both are padded with zeros to the size that the network takes: n = 1 (mod coarsening) nodes along an edge.
    contacts: an item is (inputs, labels, `ContactBatch`).
    """

    def __init__(self, batches: ImageBatches, *, coarsening: int = 1, contacts: bool = False):
        super().__init__()
        self.batches, self.spec, self.contacts = batches, batches.spec, contacts
        padding = np.subtract(padded_shape(batches.shape, coarsening), batches.shape)
        self._padding = ((0, 0), (0, padding[0]), (0, padding[1]), (0, 0))
        self._moved: dict[int, np.ndarray] = {}
        self.start(0)

    def __len__(self) -> int:
        return len(self.batches)

    def start(self, epoch: int) -> None:
        """Take the states in the order of an epoch."""
        self.epoch, self.order = epoch, self.batches.order(epoch)

    def on_epoch_end(self) -> None:
        self.start(self.epoch + 1)

    def __getitem__(self, k: int) -> tuple:
        return self.parts(k, 1)[0]

    def parts(self, k: int, count: int) -> list[tuple]:
        """Item k in so many equal parts, one for each device."""
        size = self.batches.batch_size
        chosen = (np.array_split(array[k * size : (k + 1) * size], count) for array in self.order)
        return [self.arrays(self.batches.batch(*part)) for part in zip(*chosen)]

    def arrays(self, batch: Batch) -> tuple:
        """(inputs, labels), or (inputs, labels, contacts), of an image batch."""
        images = batch.inputs, batch.labels
        if np.any(self._padding):
            images = tuple(np.pad(image, self._padding) for image in images)
        return (*images, self.contact_batch(batch)) if self.contacts else images

    def contact_batch(self, batch: Batch) -> ContactBatch:
        """The contacts of an image batch."""
        store, shape = self.batches.store, self.batches.shape
        parts = [losses.state_contacts(store.state(*state), self.spec) for state in batch.states.tolist()]
        turns = [(self._nodes_moved_by(int(k)) if k else None, k >= 4) for k in batch.symmetry]
        return losses.contact_batch(parts, shape[0] * shape[1], self.spec, turns)

    def _nodes_moved_by(self, k: int) -> np.ndarray:
        """The new number of each node of an image under symmetry k."""
        if k not in self._moved:
            shape = self.batches.shape
            # float32 holds numbers of nodes up to 2²⁴ exactly.
            number = np.arange(shape[0] * shape[1], dtype=np.float32).reshape(*shape, 1)
            plain = self.spec.replace(targets=("normal_impulse",), target_scales=None)
            _, turned = augment(np.zeros((*shape, len(self.spec.channels)), np.float32), number, plain, k)
            self._moved[k] = np.argsort(turned.reshape(-1))
        return self._moved[k]


class ImageRun(NetworkRun):
    """A run whose network predicts images of impulses."""

    def __init__(self, config, store, split, spec, *, strategy=None, initial=None):
        super().__init__(config, store, split, spec)
        self.strategy = strategy or strategy_for(config, 1)
        self.devices = self.strategy.num_replicas_in_sync if self.strategy else 1
        options = {"batch_size": config.batch_size, "seed": config.seed, "augment": config.augment, "drop_last": True}
        chosen = store.states(split.train, phases=config.phases)
        batches = ImageBatches(store, split.train, spec, states=chosen, **options)
        self.training_states, self.shape = len(batches.states), batches.shape
        self.steps = self.batches_per_epoch()
        options = dict(config.options)
        if config.architecture == "thesis":
            options["shape"] = self.shape
            self.box = store.info(split.train[0]).header["world"].box
        else:
            options = compact_options(spec) | options
        with self.strategy.scope() if self.strategy else nullcontext():
            self.build(initial, **options)
        self.contact_loss = CONTACT_LOSSES.get(config.loss)
        self.images = ImageDataset(batches, coarsening=self.coarsening, contacts=self.contact_loss is not None)
        chosen = evenly(store.states(split.validation), config.validation_states)
        options = {"batch_size": config.batch_size, "shuffle": False}
        validation = ImageBatches(store, split.validation, spec, states=chosen, **options)
        self.validation = ImageDataset(validation, coarsening=self.coarsening, contacts=True)
        self.step, self.predict = _compiled_steps(self)

    def epoch(self, epoch: int, callbacks: keras.callbacks.CallbackList) -> float:
        """Train on one epoch's batches. Returns the mean loss."""
        self.images.start(epoch)
        total = 0.0
        # The images of the next step are made while this one is computed.
        with ThreadPoolExecutor(1) as ahead:
            made = ahead.submit(self.images.parts, 0, self.devices)
            for k in range(self.steps):
                callbacks.on_train_batch_begin(k)
                parts = made.result()
                if k + 1 < self.steps:
                    made = ahead.submit(self.images.parts, k + 1, self.devices)
                # As a number at once: the sum must not depend on how losses are accumulated elsewhere.
                total += float(self.step(*parts))
                callbacks.on_train_batch_end(k, {"loss": total / (k + 1)})
        return total / self.steps

    def validate(self) -> dict[str, float]:
        """Loss on the validation states, and mean relative errors of the projected prediction before any sweep."""
        totals, count = np.zeros(3), 0
        for k in range(len(self.validation)):
            inputs, labels, contacts = self.validation[k]
            images, loss = self.predict(inputs, labels, *([contacts] if self.contact_loss else []))
            normal, tangent = ops.convert_to_numpy(losses.read_at_contacts(images, contacts)).T
            impulses = ops.convert_to_tensor(np.stack(projected(normal, tangent, contacts.friction), axis=1))
            squares = (f(impulses, contacts) for f in (losses.velocity_errors, losses.impulse_errors))
            errors = [float(np.mean(np.sqrt(ops.convert_to_numpy(found)))) for found in squares]
            totals += len(inputs) * np.array([float(loss), *errors])
            count += len(inputs)
        names = ("validation_loss", "validation_velocity_error", "validation_impulse_error")
        return dict(zip(names, (totals / max(count, 1)).tolist()))


def _compiled_steps(run: ImageRun):
    """(step, predict): arrays for each device -> loss, having trained on them; arrays -> (images, loss)."""
    model, (n_y, n_x), targets = run.model, run.shape, len(run.spec.targets)

    def forward(inputs, training):
        found = ops.cast(model(inputs, training=training), "float32")
        images = ops.reshape(found, (-1, *inputs.shape[1:3], targets))
        return images[:, :n_y, :n_x]

    def loss_of(images, labels, contacts=None):
        if contacts is not None:
            return run.contact_loss(losses.read_at_contacts(images, contacts), contacts)
        flat = (-1, n_y * n_x * targets)
        labels = ops.reshape(labels[:, :n_y, :n_x], flat)
        return ops.mean(losses.masked_squared_error(labels, ops.reshape(images, flat)))

    def penalized(inputs, labels, *contacts):
        loss = loss_of(forward(inputs, True), labels, *contacts)
        return loss + sum(model.losses) if model.losses else loss

    def predict(inputs, labels, *contacts):
        images = forward(inputs, False)
        return images, loss_of(images, labels, *contacts)

    backend = keras.backend.backend()
    if backend == "tensorflow":
        return _tensorflow_steps(run, penalized, predict)
    if backend != "torch":
        raise RuntimeError(f"KERAS_BACKEND: expected tensorflow or torch for training, got {backend}")
    import torch

    def tensors(inputs, labels, *contacts):
        convert = ops.convert_to_tensor
        return convert(inputs), convert(labels), *(ContactBatch(*map(convert, batch)) for batch in contacts)

    def step(arrays):
        model.zero_grad()
        loss = penalized(*tensors(*arrays))
        loss.backward()
        variables = model.trainable_variables
        with torch.no_grad():
            run.optimizer.apply([v.value.grad for v in variables], variables)
        return loss.detach()

    return step, torch.no_grad()(lambda *arrays: predict(*tensors(*arrays)))


def _tensorflow_steps(run: ImageRun, penalized, predict):
    import tensorflow as tf

    model, optimizer, strategy, devices = run.model, run.optimizer, run.strategy, run.devices
    # One signature for all batches, whatever their number of contacts, so that they are traced once.
    signature = keras.tree.map_structure(lambda x: tf.TensorSpec((None, *x.shape[1:]), x.dtype), list(run.images[0]))
    width = len(signature)
    normalizations = [layer for layer in model.layers if isinstance(layer, keras.layers.BatchNormalization)]
    if optimizer.global_clipnorm:
        optimizer.global_clipnorm /= devices  # of shares of the gradient: see below

    @tf.function(input_signature=signature * devices)
    def step(*arrays):
        def on_device():
            context = tf.distribute.get_replica_context()
            k = int(tf.get_static_value(context.replica_id_in_sync_group))
            with tf.GradientTape() as tape:
                loss = penalized(*arrays[k * width : (k + 1) * width]) / devices
            # Keras's optimizer clips the gradient of each device and then sums over the devices: each gets an equal
            # share of the whole gradient.
            total = context.all_reduce(tf.distribute.ReduceOp.SUM, tape.gradient(loss, model.trainable_variables))
            optimizer.apply([gradient / devices for gradient in total], model.trainable_variables)
            return loss

        # Over the whole batch, while this is traced; model files do not depend on the devices of their training.
        for layer in normalizations:
            layer.synchronized = devices > 1
        losses_of = strategy.run(on_device)
        for layer in normalizations:
            layer.synchronized = False
        return strategy.reduce(tf.distribute.ReduceOp.SUM, losses_of, axis=None)

    return (lambda *parts: step(*(x for part in parts for x in part))), tf.function(predict, input_signature=signature)
