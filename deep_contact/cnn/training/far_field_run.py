"""Training runs of the far-field network: the loss is the velocity error after some sweeps of the solver.

This module imports TensorFlow.

Tests: tests/cnn/test_training.py
"""

from __future__ import annotations

import numpy as np

from deep_contact.cnn.backend import tensorflow as tf
from deep_contact.cnn.dataset import start_errors
from deep_contact.cnn.far_field import COARSENING, corrected, description_of, nodes_of
from deep_contact.cnn.through_solver import errors_after, loss_and_gradient, solved_problem
from deep_contact.cnn.training.network import NetworkRun

_LEARN_FROM = 0.02
"""Relative error of Builtin's start, the impulses of the step before, above which a state is trained on."""

_JUDGE_BY = 0.05
"""Relative error of Builtin's start above which a state is used for validation."""


class FarFieldRun(NetworkRun):
    """A training run of a far-field network, which corrects Builtin's start."""

    def __init__(self, config, store, split, network):
        sides = (split.train, _LEARN_FROM), (split.validation, _JUDGE_BY)
        super().__init__(config, store, *(_states_with_error(store, *side) for side in sides), network)
        self.per_epoch = self.batches_per_epoch() * config.batch_size
        # The errors decrease with the number of sweeps. These weights give all numbers of sweeps an equal share of the
        # loss.
        errors = self.errors(self.validation, learned=False)[:, 1:]
        self.weights = 1.0 / (errors.mean(axis=0) * len(config.sweeps))
        images = tf.TensorSpec((None, None, None, len(self.spec.channels)), tf.float32)
        nodes = [tf.TensorSpec((None, 4), kind) for kind in (tf.int32, tf.float32)]
        self._coefficients = tf.function(self._read, input_signature=[images, *nodes])
        # TensorFlow compiles the update as one graph. One by one, its small operations take as long as the network.
        self._apply = tf.function(lambda gradients: self.optimizer.apply(gradients, self.model.trainable_variables))

    def _read(self, images, node, weight):
        """Return the network's coefficients at K contacts, (K, 12). TensorFlow can differentiate them.

        images: input images, (b, n_y, n_x, c). node, weight: result of `nodes_of` for all K contacts, (K, 4) each, with
        indices of nodes counted over the outputs of all images.
        """
        nodes = tf.reshape(self.model(images, training=True), (-1, len(self.spec.targets)))
        return tf.reduce_sum(tf.gather(nodes, node) * weight[:, :, None], axis=1)

    def examples(self, states: np.ndarray, symmetry: np.ndarray):
        """Yield an example (`Description`, `SolvedProblem`) for each state.

        states: pairs (simulation, index), (k, 2). symmetry: symmetry of each description, as for `description_of`,
        (k,).
        """
        for place, k in zip(states.tolist(), symmetry.tolist()):
            state = self.store.state(*place)
            yield description_of(state, self.spec, k), solved_problem(state)

    def coefficients(self, descriptions):
        """Return the network's coefficients at all K contacts of some descriptions, (K, 12).

        The images of the descriptions have to have the same shape.
        """
        shape = descriptions[0].image.shape[:2]
        out = tuple((n - 1) // COARSENING + 1 for n in shape)
        read = [nodes_of(description, out) for description in descriptions]
        node = np.concatenate([node + k * out[0] * out[1] for k, (node, _) in enumerate(read)]).astype(np.int32)
        images = np.stack([description.image for description in descriptions])
        return self._coefficients(images, node, np.concatenate([weight for _, weight in read]))

    def batches(self, epoch: int):
        """Yield the batches of an epoch: lists of examples whose images have the same shape."""
        rng = np.random.default_rng((self.config.seed, epoch))
        states = self.states[rng.permutation(len(self.states))[: self.per_epoch]]
        return _by_shape(self.examples(states, rng.integers(0, 8, self.per_epoch)), self.config.batch_size)

    def step(self, batch) -> tuple[float, int]:
        """Do one step of the optimizer on a batch of examples. Returns the sum of their losses, and their number."""
        descriptions, problems = zip(*batch)
        with tf.GradientTape() as tape:
            coefficients = self.coefficients(descriptions)
        total, by_coefficient = 0.0, []
        for description, problem, start in zip(descriptions, problems, _starts(descriptions, coefficients)):
            loss, gradient, _ = loss_and_gradient(problem, start, self.config.sweeps, self.weights)
            by_coefficient.append(np.einsum("ik,ijk->ij", gradient, description.features))
            total += loss
        # Divided by the size of a full batch. So a batch of a few states counts less than a full batch.
        gradients = tf.constant(np.concatenate(by_coefficient) / self.config.batch_size, tf.float32)
        self._apply(tape.gradient(coefficients, self.model.trainable_variables, output_gradients=gradients))
        return total, len(batch)

    def errors(self, states: np.ndarray, *, learned: bool) -> np.ndarray:
        """Return the velocity errors before any sweep and after each number of `config.sweeps`, (k, 1 + len(sweeps)).

        The result has one row for each state, not in the order of `states`.
        states: pairs (simulation, index), (k, 2). learned: whether the start is the network's; otherwise it is
        Builtin's.
        """
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
        """Measure the network on the validation states. Returns name of the column in history.csv -> value.

        The values are the loss over the loss of Builtin's start, and the mean velocity errors before the first sweep
        and after each number of `config.sweeps`.
        """
        errors = self.errors(self.validation, learned=True).mean(axis=0)
        loss = {"validation_loss": float(errors[1:] @ self.weights), "validation_velocity_error": float(errors[0])}
        after = zip(self.config.sweeps, errors[1:].tolist())
        return loss | {f"validation_velocity_error_{k}": error for k, error in after}


def _states_with_error(store, sims, least: float) -> np.ndarray:
    """Return the states in which the relative error of Builtin's start is larger than `least`.

    sims: numbers of the simulations. The result has pairs (simulation, index), (k, 2).
    """
    pairs = [[sim, i] for sim in sims for i in np.flatnonzero(start_errors(store.simulation(sim).arrays) > least)]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _starts(descriptions, coefficients) -> list[np.ndarray]:
    """Return the corrected impulses of each description, (m, 2), N·s.

    coefficients: a tensor with the coefficients at the contacts of all descriptions, one after the other, (K, 12).
    """
    ends = np.cumsum([len(description.start) for description in descriptions])
    parts = np.split(coefficients.numpy().astype(np.float64), ends[:-1])
    return [corrected(description, part) for description, part in zip(descriptions, parts)]


def _by_shape(examples, size: int):
    """Yield lists of at most `size` examples whose images have the same shape. Lists that are not full come last."""
    waiting: dict[tuple, list] = {}
    for example in examples:
        batch = waiting.setdefault(example[0].image.shape, [])
        batch.append(example)
        if len(batch) == size:
            yield waiting.pop(example[0].image.shape)
    yield from waiting.values()
