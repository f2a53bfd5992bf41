"""Runs of the far-field network, trained through the solver. They need TensorFlow."""

from __future__ import annotations

import numpy as np

from deep_contact.cnn.backend import tensorflow as tf
from deep_contact.cnn.dataset import start_errors
from deep_contact.cnn.far_field import COARSENING, corrected, description_of, nodes_of
from deep_contact.cnn.through_solver import errors_after, loss_and_gradient, solved_problem
from deep_contact.cnn.training.network import NetworkRun

_LEARN_FROM = 0.02
"""Least relative error of Builtin's start in states that are learned from."""

_JUDGE_BY = 0.05
"""Least relative error of Builtin's start in states of the validation side."""


class FarFieldRun(NetworkRun):
    """A run whose network corrects Builtin, trained through the solver."""

    def __init__(self, config, store, split, network):
        sides = (split.train, _LEARN_FROM), (split.validation, _JUDGE_BY)
        super().__init__(config, store, *(_states_with_error(store, *side) for side in sides), network)
        self.per_epoch = self.batches_per_epoch() * config.batch_size
        # Equal weight for each number of sweeps, although the errors get smaller.
        errors = self.errors(self.validation, learned=False)[:, 1:]
        self.weights = 1.0 / (errors.mean(axis=0) * len(config.sweeps))
        images = tf.TensorSpec((None, None, None, len(self.spec.channels)), tf.float32)
        nodes = [tf.TensorSpec((None, 4), kind) for kind in (tf.int32, tf.float32)]
        self._coefficients = tf.function(self._read, input_signature=[images, *nodes])
        # As one program: one by one, the optimizer's small operations take as long as the network.
        self._apply = tf.function(lambda gradients: self.optimizer.apply(gradients, self.model.trainable_variables))

    def _read(self, images, node, weight):
        """Coefficients (K, 12) at K contacts, from images and the arrays of `nodes_of`; differentiable."""
        nodes = tf.reshape(self.model(images, training=True), (-1, len(self.spec.targets)))
        return tf.reduce_sum(tf.gather(nodes, node) * weight[:, :, None], axis=1)

    def examples(self, states: np.ndarray, symmetry: np.ndarray):
        """Yields (description, problem) of each of the states (k, 2)."""
        for place, k in zip(states.tolist(), symmetry.tolist()):
            state = self.store.state(*place)
            yield description_of(state, self.spec, k), solved_problem(state)

    def coefficients(self, descriptions):
        """The network's coefficients at the contacts of descriptions with windows of one shape, (K, 12)."""
        shape = descriptions[0].image.shape[:2]
        out = tuple((n - 1) // COARSENING + 1 for n in shape)
        read = [nodes_of(description, out) for description in descriptions]
        node = np.concatenate([node + k * out[0] * out[1] for k, (node, _) in enumerate(read)]).astype(np.int32)
        images = np.stack([description.image for description in descriptions])
        return self._coefficients(images, node, np.concatenate([weight for _, weight in read]))

    def batches(self, epoch: int):
        """Yields the examples of an epoch in lists, each with windows of one shape."""
        rng = np.random.default_rng((self.config.seed, epoch))
        states = self.states[rng.permutation(len(self.states))[: self.per_epoch]]
        return _by_shape(self.examples(states, rng.integers(0, 8, self.per_epoch)), self.config.batch_size)

    def step(self, batch) -> tuple[float, int]:
        """One optimizer step on examples with windows of one shape. Returns the sum and the number of their losses."""
        descriptions, problems = zip(*batch)
        with tf.GradientTape() as tape:
            coefficients = self.coefficients(descriptions)
        total, by_coefficient = 0.0, []
        for description, problem, start in zip(descriptions, problems, _starts(descriptions, coefficients)):
            loss, gradient, _ = loss_and_gradient(problem, start, self.config.sweeps, self.weights)
            by_coefficient.append(np.einsum("ik,ijk->ij", gradient, description.features))
            total += loss
        # Divided by the size of a full batch: a few states with a rare window do not weigh as much as a batch.
        gradients = tf.constant(np.concatenate(by_coefficient) / self.config.batch_size, tf.float32)
        self._apply(tape.gradient(coefficients, self.model.trainable_variables, output_gradients=gradients))
        return total, len(batch)

    def errors(self, states: np.ndarray, *, learned: bool) -> np.ndarray:
        """Velocity errors before any sweep and after each of `sweeps`, (k, 1 + sweeps), of the network or Builtin."""
        sweeps = sorted({0, *self.config.sweeps})
        errors = []
        for batch in _by_shape(self.examples(states, np.zeros(len(states), np.int64)), 64):
            descriptions, problems = zip(*batch)
            starts = [problem.rows.impulse for problem in problems]
            if learned:
                starts = _starts(descriptions, self.coefficients(descriptions))
            errors += [errors_after(problem, start, sweeps) for problem, start in zip(problems, starts)]
        return np.array(errors)[:, [0, *(sweeps.index(k) for k in self.config.sweeps)]]

    def validate(self) -> dict[str, float]:
        """Loss on the validation states over Builtin's, and mean velocity errors before and after `sweeps` sweeps."""
        errors = self.errors(self.validation, learned=True).mean(axis=0)
        loss = {"validation_loss": float(errors[1:] @ self.weights), "validation_velocity_error": float(errors[0])}
        after = zip(self.config.sweeps, errors[1:].tolist())
        return loss | {f"validation_velocity_error_{k}": error for k, error in after}


def _states_with_error(store, sims, least: float) -> np.ndarray:
    """States (k, 2) of the simulations in which the relative error of Builtin's start is larger than `least`."""
    pairs = [[sim, i] for sim in sims for i in np.flatnonzero(start_errors(store.simulation(sim).arrays) > least)]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _starts(descriptions, coefficients) -> list[np.ndarray]:
    """The corrected start of each description, by its rows of the coefficients (K, 12)."""
    ends = np.cumsum([len(description.start) for description in descriptions])
    parts = np.split(coefficients.numpy().astype(np.float64), ends[:-1])
    return [corrected(description, part) for description, part in zip(descriptions, parts)]


def _by_shape(examples, size: int):
    """Yields lists of up to `size` examples with windows of one shape, full lists first."""
    waiting: dict[tuple, list] = {}
    for example in examples:
        batch = waiting.setdefault(example[0].image.shape, [])
        batch.append(example)
        if len(batch) == size:
            yield waiting.pop(example[0].image.shape)
    yield from waiting.values()
