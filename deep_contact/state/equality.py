"""Equality of objects that hold arrays: `==` and `in` for states and results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TypeVar

import numpy as np

K = TypeVar("K", bound=type)


def by_value(kind: K) -> K:
    """Decorate a class so that two of its instances are equal if all their fields are equal by `same`.

    Without the decorator, `==` and `in` raise an error for NamedTuples of arrays, since `==` of two arrays is an array.
    Instances of different classes are not equal. Instances cannot be hashed.
    """

    def is_equal(self, other):
        return same(_parts(self), _parts(other)) if type(self) is type(other) else NotImplemented

    kind.__eq__, kind.__ne__, kind.__hash__ = is_equal, object.__ne__, None
    return kind


def same(one, other) -> bool:
    """Return whether two values are equal: numbers, arrays, texts, and containers of these. NaN equals NaN."""
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return _same_arrays(np.asarray(one), np.asarray(other)) if type(one) is type(other) else False
    if hasattr(one, "nnz") and hasattr(other, "nnz"):  # sparse matrices of SciPy
        return one.shape == other.shape and (one != other).nnz == 0
    if hasattr(one, "get_weights") and hasattr(other, "get_weights"):  # models of Keras
        return one.to_json() == other.to_json() and same(one.get_weights(), other.get_weights())
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(value, other[key]) for key, value in one.items())
    if isinstance(one, (tuple, list)) and type(one) is type(other):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other) or (one != one and other != other)


def _parts(value) -> tuple:
    """Return the values of the fields that count in a comparison of two instances."""
    if is_dataclass(value):
        return tuple(getattr(value, field.name) for field in fields(value) if field.compare)
    return tuple(value)


def _same_arrays(one: np.ndarray, other: np.ndarray) -> bool:
    if one.shape != other.shape:
        return False
    are_equal = one == other
    return bool(np.all(are_equal | ((one != one) & (other != other))))
