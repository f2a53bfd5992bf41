"""Learning-rate schedules by name: epoch (from 0) -> learning rate."""

from __future__ import annotations

import math
from collections.abc import Callable

Schedule = Callable[[int], float]


def algorithm_6(epoch: int) -> float:
    """Algorithm 6 of the thesis, its gaps closed: 5e-3 below epoch 100, 2e-3 below 300, 1e-3 below 500, 2e-4 after.

    As printed, the epochs 100 and 300 have no rate, and the last branch says ">300" where it must be ">500".
    """
    return 5e-3 if epoch < 100 else 2e-3 if epoch < 300 else 1e-3 if epoch < 500 else 2e-4


def appendix_b(epoch: int) -> float:
    """The scheduler of Appendix B: 0.05 up to epoch 100, 0.02 up to 400, 0.01 after."""
    return 0.05 if epoch <= 100 else 0.02 if epoch <= 400 else 0.01


def cosine(epochs: int, rate: float = 2e-3, *, warm_up: int = 1, last: float = 0.01) -> Schedule:
    """Half a cosine from `rate` down to `last` times it in the last of `epochs`, after a linear warm-up (ours).

    Raises ValueError naming the argument and the value.
    """
    if epochs < 1 or not rate > 0 or warm_up < 0 or not 0 <= last <= 1:
        raise ValueError(
            "cosine: expected epochs >= 1, rate > 0, warm_up >= 0 and last from 0 to 1, "
            f"got {epochs}, {rate}, {warm_up}, {last}"
        )

    def schedule(epoch: int) -> float:
        if epoch < min(warm_up, epochs - 1):
            return rate * (epoch + 1) / (warm_up + 1)
        done = min((epoch - warm_up) / max(epochs - 1 - warm_up, 1), 1.0) if epochs > 1 else 0.0
        return rate * (last + (1 - last) * 0.5 * (1 + math.cos(math.pi * done)))

    return schedule


def constant(rate: float) -> Schedule:
    """One rate for all epochs."""
    if not rate > 0:
        raise ValueError(f"rate: expected a number > 0, got {rate!r}")
    return lambda epoch: rate


SCHEDULES = ("algorithm 6", "appendix b", "cosine", "constant")


def schedule(name: str, *, epochs: int, rate: float) -> Schedule:
    """The schedule of that name. epochs, rate: for those that need them ("cosine", "constant").

    Raises ValueError on another name.
    """
    key = name.lower().replace("-", " ").replace("_", " ")
    if key == "algorithm 6":
        return algorithm_6
    if key == "appendix b":
        return appendix_b
    if key == "cosine":
        return cosine(epochs, rate)
    if key == "constant":
        return constant(rate)
    raise ValueError(f"schedule: expected one of {', '.join(SCHEDULES)}, got {name!r}")
