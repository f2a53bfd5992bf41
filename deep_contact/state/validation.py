"""Validation at the border of the package: every function checks one argument and returns it as a plain Python value.

All functions raise ValueError in the form "name: expected …, got …".
"""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import re
import reprlib
import sys
import warnings
from collections.abc import Callable, Collection, Iterable
from numbers import Integral, Real
from typing import TypeVar

import numpy as np

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 120


def brief(value) -> str:
    """`repr(value)` on one line, cut where it is long: for messages."""
    return " ".join(_SHORT.repr(value).split())


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn, with the line of the caller outside of the package."""
    frame, level = sys._getframe(1), 2
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "deep_contact":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def expect(condition, message: str) -> None:
    """Raise ValueError with the message unless the condition holds."""
    if not condition:
        raise ValueError(message)


def refuse_where(bad: np.ndarray, name: str, values: np.ndarray, expected: str) -> None:
    """Raise ValueError naming the first index at which `bad` holds, and the value, or row of values, at this index."""
    if bad.any():
        place = np.argwhere(bad)[0].tolist()
        raise ValueError(f"{name}{place or ''}: expected {expected}, got {values[tuple(place)]}")


def integer(name: str, value, least: int = 0, most: int | None = None, *, hint: str = "") -> int:
    """`value` as an int from `least` to `most`, both included. A bool, and a float such as 2.0, is not an integer.

    hint: advice at the end of the message.
    """
    is_one = type(value) is int or (isinstance(value, Integral) and not isinstance(value, bool))
    if not is_one or value < least:
        raise ValueError(f"{name}: expected an integer >= {least}, got {brief(value)}{hint}")
    if most is not None and value > most:
        raise ValueError(f"{name}: expected an integer <= {most}, got {brief(value)}")
    return int(value)


def number(name: str, value, low=None, high=None, *, above=None, below=None) -> float:
    """`value` as a finite float with low <= value <= high and above < value < below, each unless None."""
    try:
        checked = float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    except OverflowError:
        checked = math.inf
    is_above = (low is None or checked >= low) and (above is None or checked > above)
    is_below = (high is None or checked <= high) and (below is None or checked < below)
    if not (math.isfinite(checked) and is_above and is_below):
        limits = {">=": low, ">": above, "<=": high, "<": below}
        expected = " and".join(f" {sign} {limit}" for sign, limit in limits.items() if limit is not None)
        raise ValueError(f"{name}: expected a finite number{expected}, got {brief(value)}")
    return checked


def several(name: str, values, count: int, *, check=number, expected: str = "finite numbers") -> tuple:
    """`count` values as a tuple, each as `check` returns it. expected: a description of them for the message."""
    try:
        checked = tuple(check(name, value) for value in values)
    except (TypeError, ValueError):
        checked = ()
    expect(len(checked) == count, f"{name}: expected {count} {expected}, got {brief(values)}")
    return checked


def list_of(name: str, kind: type, values) -> list:
    """Several values of a type as a list. Raises ValueError on a single value, and on a value of another type."""
    expected = f"{name}: expected several {kind.__name__} objects, such as a list,"
    expect(isinstance(values, Iterable) and not isinstance(values, (str, bytes)), f"{expected} got {brief(values)}")
    listed = list(values)
    for k, value in enumerate(listed):
        expect(isinstance(value, kind), f"{name}[{k}]: expected a {kind.__name__}, got {brief(value)}")
    return listed


def real_numbers(value) -> np.ndarray | None:
    """`value` as a new float64 array; None unless it consists of real numbers only.

    NumPy converts text, dates and the hidden values of masked arrays without a word, and cuts complex numbers.
    """
    if any(map(np.ma.is_masked, value if isinstance(value, (list, tuple)) else [value])):
        return None
    try:
        array = np.asarray(value)
        mixed = array.flat if array.dtype == object else ()
        if array.dtype.kind not in "biufO" or any(one is None or isinstance(one, (str, bytes)) for one in mixed):
            return None
        return np.array(array, np.float64, order="C")
    except (ValueError, TypeError, OverflowError):
        return None


def floats(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    """`value` as a new float64 array of finite numbers of this shape."""
    array = real_numbers(value)
    if array is None or array.shape != shape:
        got = brief(value) if array is None else f"shape {array.shape}"
        raise ValueError(f"{name}: expected finite numbers of shape {shape}, got {got}")
    refuse_where(~np.isfinite(array), name, array, "a finite number")
    return array


SYNONYMS = {
    "cor": "restitution", "count": "n_bodies", "e": "restitution", "g": "gravity",
    "iterations": "sweeps", "lines": "segments", "mu": "friction", "n": "n_bodies", "omega": "spin", "pos": "position",
    "r": "radius", "rtol": "tolerance", "start": "warm_start", "time_step": "dt",
    "timestep": "dt", "tol": "tolerance", "v": "velocity", "walls": "segments", "workers": "jobs",
}  # fmt: skip
"""Wrong keyword that people try -> the right keyword."""

F = TypeVar("F", bound=Callable)


def suggesting(function: F) -> F:
    """Decorator of a function or class: the TypeError of a wrong call suggests what was meant.

    For an unknown keyword it names the nearest keyword; for too many values, the first options, which have to be named.
    """
    if isinstance(function, type):
        function.__init__ = suggesting(function.__init__)  # type: ignore[misc]
        return function

    @functools.wraps(function)
    def called(*values, **keywords):
        try:
            return function(*values, **keywords)
        except TypeError as error:
            error.args = (_with_hint(str(error), function, keywords, error.__traceback__.tb_next is None),)
            raise

    return called


def _with_hint(message: str, function: Callable, keywords: dict, is_ours: bool) -> str:
    """The message of a TypeError, with a suggestion. is_ours: whether the error is of the call itself."""
    known, wrong = inspect.signature(function).parameters, re.search(r"unexpected keyword argument '(\w+)'", message)
    if is_ours and "positional argument" in message:
        named = [f"{name}=…" for name, one in known.items() if one.kind is one.KEYWORD_ONLY][:3]
        return f"{message}; name the options: {', '.join(named)}" if named else message
    if wrong is None or wrong[1] not in keywords or "did you mean" in message:
        return message
    meant = [SYNONYMS[wrong[1]]] if SYNONYMS.get(wrong[1]) in known else difflib.get_close_matches(wrong[1], known, 1)
    return message.partition(". Did you")[0] + "".join(f"; did you mean {name!r}?" for name in meant)


def flag(name: str, value) -> bool:
    """`value` as a bool; NumPy's bools are accepted, integers are not."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    raise ValueError(f"{name}: expected True or False, got {brief(value)}")


def one_of(name: str, value, known: Collection):
    """`value`, which has to be among `known`: a table by its names, or a sequence. Errors suggest the nearest name."""
    try:
        if value in known:
            return value
    except (TypeError, ValueError):  # values without a hash, and arrays, which compare element by element
        pass
    names = {str(one).lower(): one for one in known}
    near = difflib.get_close_matches(value.lower(), names, 1) if isinstance(value, str) else ()
    hint = "".join(f"; did you mean {names[one]!r}?" for one in near)
    raise ValueError(f"{name}: expected one of {', '.join(map(str, known))}, got {brief(value)}{hint}")
