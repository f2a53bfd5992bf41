"""Schedules of the learning rate. A schedule is a function: number of the epoch, from 0 -> learning rate.

Tests: tests/cnn/test_architectures.py, tests/studies/test_chapter_5.py
"""

from __future__ import annotations

from collections.abc import Callable


def algorithm_6(epoch: int) -> float:
    """Return the learning rate of the thesis's Algorithm 6, with its gaps closed.

    The rate is 5e-3 before epoch 100, 2e-3 before epoch 300, 1e-3 before epoch 500, and 2e-4 from epoch 500 on. As
    printed, Algorithm 6 has no rate for the epochs 100 and 300, and its last branch says ">300" instead of ">500".
    """
    return 5e-3 if epoch < 100 else 2e-3 if epoch < 300 else 1e-3 if epoch < 500 else 2e-4


def appendix_b(epoch: int) -> float:
    """Return the learning rate of Appendix B: 0.05 up to epoch 100, 0.02 up to epoch 400, and 0.01 after it."""
    return 0.05 if epoch <= 100 else 0.02 if epoch <= 400 else 0.01


def cosine(epochs: int, rate: float) -> Callable[[int], float]:
    """Return Keras's `CosineDecay` as a schedule. epochs: number of epochs. rate: the largest learning rate.

    The rate is `rate` / 2 in the first epoch and `rate` in the second. Then it falls to 1 % of `rate` in the last
    epoch.
    """
    from deep_contact.cnn.backend import keras  # imports TensorFlow, which only this schedule needs

    if epochs == 1:
        return lambda epoch: rate
    options = {"warmup_target": rate, "warmup_steps": 1}
    decay = keras.optimizers.schedules.CosineDecay(rate / 2, max(epochs - 2, 1), alpha=0.01, **options)
    return lambda epoch: float(decay(epoch))


SCHEDULES = {
    "algorithm 6": lambda epochs, rate: algorithm_6,
    "appendix b": lambda epochs, rate: appendix_b,
    # The next two are scaled from 1,000 epochs to the run's number of epochs. So a shorter run has all the rates.
    "scaled algorithm 6": lambda epochs, rate: lambda epoch: algorithm_6(epoch * 1000 // epochs),
    "scaled appendix b": lambda epochs, rate: lambda epoch: appendix_b(epoch * 1000 // epochs),
    "cosine": cosine,
    "constant": lambda epochs, rate: lambda epoch: rate,
}
"""Name -> function (number of epochs, rate) -> schedule. Only the schedules of `BY_LENGTH` use the number of epochs."""

BY_LENGTH = ("scaled algorithm 6", "scaled appendix b", "cosine")
"""Names of the schedules whose rates depend on the number of epochs."""
