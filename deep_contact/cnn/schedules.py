"""Learning-rate schedules by name: epoch (from 0) -> learning rate."""

from __future__ import annotations

from collections.abc import Callable

from deep_contact.validation import integer, number, one_of

Schedule = Callable[[int], float]


def algorithm_6(epoch: int) -> float:
    """Algorithm 6 of the thesis, its gaps closed: 5e-3 below epoch 100, 2e-3 below 300, 1e-3 below 500, 2e-4 after.

    As printed, the epochs 100 and 300 have no rate, and the last branch says ">300" where it must be ">500".
    """
    return 5e-3 if epoch < 100 else 2e-3 if epoch < 300 else 1e-3 if epoch < 500 else 2e-4


def appendix_b(epoch: int) -> float:
    """The scheduler of Appendix B: 0.05 up to epoch 100, 0.02 up to 400, 0.01 after."""
    return 0.05 if epoch <= 100 else 0.02 if epoch <= 400 else 0.01


def scaled_appendix_b(epochs: int) -> Schedule:
    """`appendix_b` over so many epochs in place of its 1,000, so that a shorter run takes each of its rates."""
    integer("epochs", epochs, 1)
    return lambda epoch: appendix_b(epoch * 1000 // epochs)


def cosine(epochs: int, rate: float = 2e-3, *, warm_up: int = 1, last: float = 0.01) -> Schedule:
    """Keras's `CosineDecay` by epoch, from `rate` to `last` times it in the last of `epochs`, after a linear warm-up.

    Raises ValueError naming the argument and the value.
    """
    warm_up = min(integer("warm_up", warm_up), integer("epochs", epochs, 1) - 1)
    first = number("rate", rate, above=0) / (warm_up + 1)
    number("last", last, 0, 1)
    from deep_contact.cnn.backend import keras  # TensorFlow: imported with what needs it

    options = {"warmup_target": rate, "warmup_steps": warm_up} if warm_up else {}
    decay = keras.optimizers.schedules.CosineDecay(first, max(epochs - 1 - warm_up, 1), alpha=last, **options)
    return lambda epoch: float(decay(epoch))


def constant(rate: float) -> Schedule:
    """The same rate for all epochs."""
    number("rate", rate, above=0)
    return lambda epoch: rate


_SCHEDULES = {
    "algorithm 6": lambda epochs, rate: algorithm_6,
    "appendix b": lambda epochs, rate: appendix_b,
    "scaled appendix b": lambda epochs, rate: scaled_appendix_b(epochs),
    "cosine": cosine,
    "constant": lambda epochs, rate: constant(rate),
}
SCHEDULES = tuple(_SCHEDULES)

BY_LENGTH = ("scaled appendix b", "cosine")
"""Schedules whose rates depend on the number of epochs."""


def schedule(name: str, *, epochs: int, rate: float) -> Schedule:
    """The schedule of that name. The `BY_LENGTH` use epochs, "cosine" and "constant" the rate.

    Raises ValueError on another name.
    """
    return _SCHEDULES[one_of("schedule", name, SCHEDULES)](epochs, rate)
