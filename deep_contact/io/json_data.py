"""Conversion of values to types that strict JSON can store.

Tests: tests/figures/test_results.py
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from deep_contact.io.provenance import provenance  # noqa: F401 (scripts take it from here)


class ResultsError(ValueError):
    """Error: results that JSON cannot store, or that do not follow their format."""


def plain(value, *, digits: int | None = None, where: str = "data"):
    """Return `value` in types that JSON can store: dict, list, str, int, float, bool and None.

    A NamedTuple becomes a dict. digits: number of significant digits of floats in NumPy arrays, so that long curves
    stay small; None leaves all digits. where: name of the value for error messages. Raises ResultsError, which names
    the place and the value, for NaN, infinity, a key that is not a string, or a type that JSON does not know.
    """
    if isinstance(value, np.ndarray) and value.ndim:
        if value.dtype.kind not in "biufU":
            raise ResultsError(f"{where}: expected an array of numbers or text, got dtype {value.dtype}")
        if digits and value.dtype.kind == "f":
            value = np.array([float(f"{x:.{digits}g}") for x in value.ravel().tolist()]).reshape(value.shape)
        value = value.tolist()
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        raise ResultsError(f"{where}: expected a finite number (None where one is missing), got {value}")
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise ResultsError(f"{where}: expected keys that are strings, got {key!r}")
        return {key: plain(item, digits=digits, where=f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        if all(type(item) is int or (type(item) is float and math.isfinite(item)) for item in value):
            return list(value)  # long curves: no name for messages is made for each number
        return [plain(item, digits=digits, where=f"{where}[{i}]") for i, item in enumerate(value)]
    raise ResultsError(f"{where}: expected numbers, text, lists or dicts, got {type(value).__name__}")
