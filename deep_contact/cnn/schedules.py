"""Learning-rate schedules by name: epoch (from 0) -> learning rate."""

from __future__ import annotations

from collections.abc import Callable


def algorithm_6(epoch: int) -> float:
    """Algorithm 6 of the thesis, its gaps closed: 5e-3 below epoch 100, 2e-3 below 300, 1e-3 below 500, 2e-4 after.

    As printed, the epochs 100 and 300 have no rate, and the last branch says ">300" where it must be ">500".
    """
    return 5e-3 if epoch < 100 else 2e-3 if epoch < 300 else 1e-3 if epoch < 500 else 2e-4


def appendix_b(epoch: int) -> float:
    """The scheduler of Appendix B: 0.05 up to epoch 100, 0.02 up to 400, 0.01 after."""
    return 0.05 if epoch <= 100 else 0.02 if epoch <= 400 else 0.01


def cosine(epochs: int, rate: float) -> Callable[[int], float]:
    """Keras's `CosineDecay` by epoch: half of `rate`, `rate`, then down to 1 % of it in the last of `epochs`."""
    from deep_contact.cnn.backend import keras  # TensorFlow: imported with what needs it

    if epochs == 1:
        return lambda epoch: rate
    options = {"warmup_target": rate, "warmup_steps": 1}
    decay = keras.optimizers.schedules.CosineDecay(rate / 2, max(epochs - 2, 1), alpha=0.01, **options)
    return lambda epoch: float(decay(epoch))


SCHEDULES = {
    "algorithm 6": lambda epochs, rate: algorithm_6,
    "appendix b": lambda epochs, rate: appendix_b,
    # Scaled from 1,000 epochs to those of the run, so that a shorter run takes each of the rates.
    "scaled algorithm 6": lambda epochs, rate: lambda epoch: algorithm_6(epoch * 1000 // epochs),
    "scaled appendix b": lambda epochs, rate: lambda epoch: appendix_b(epoch * 1000 // epochs),
    "cosine": cosine,
    "constant": lambda epochs, rate: lambda epoch: rate,
}
"""Name -> function (number of epochs, rate) -> schedule. The number of epochs matters to those of `BY_LENGTH` alone."""

BY_LENGTH = ("scaled algorithm 6", "scaled appendix b", "cosine")
"""Schedules whose rates depend on the number of epochs."""
