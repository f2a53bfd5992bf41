"""Validation of arguments. Most functions here check one argument of a public function and return it as a plain value.

They raise ValueError in the form "name: expected …, got …". The argument `name` is the name in this message.
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
    """Return `repr(value)` for messages, on one line and shortened if it is long."""
    return " ".join(_SHORT.repr(value).split())


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Emit a warning that names the line of the caller outside of the package."""
    frame, level = sys._getframe(1), 2
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "deep_contact":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def expect(condition, message: str) -> None:
    """Raise ValueError with the message unless the condition holds."""
    if not condition:
        raise ValueError(message)


def refuse_where(bad: np.ndarray, name: str, values: np.ndarray, expected: str) -> None:
    """Raise ValueError if any flag of `bad` is True. The message names the first such index and the value there.

    values: array, whose first dimensions are those of `bad`. expected: the rule in words, for the message.
    """
    if bad.any():
        place = np.argwhere(bad)[0].tolist()
        raise ValueError(f"{name}{place or ''}: expected {expected}, got {values[tuple(place)]}")


def integer(name: str, value, least: int = 0, most: int | None = None, *, hint: str = "") -> int:
    """Return `value` as an int from `least` to `most`, both included.

    A bool or a float, such as 2.0, is not an integer. hint: advice at the end of the message.
    """
    is_one = type(value) is int or (isinstance(value, Integral) and not isinstance(value, bool))
    if not is_one or value < least:
        raise ValueError(f"{name}: expected an integer >= {least}, got {brief(value)}{hint}")
    if most is not None and value > most:
        raise ValueError(f"{name}: expected an integer <= {most}, got {brief(value)}")
    return int(value)


def number(name: str, value, low=None, high=None, *, above=None, below=None) -> float:
    """Return `value` as a finite float with low <= value <= high and above < value < below.

    A limit of None is not tested.
    """
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
    """Return `count` values as a tuple. Each is the result of `check(name, value)`.

    expected: description of the values for the message.
    """
    try:
        checked = tuple(check(name, value) for value in values)
    except (TypeError, ValueError):
        checked = ()
    expect(len(checked) == count, f"{name}: expected {count} {expected}, got {brief(values)}")
    return checked


def list_of(name: str, kind: type, values) -> list:
    """Return several values of the type `kind` as a list.

    Raises ValueError on a single value, and on a value of another type.
    """
    expected = f"{name}: expected several {kind.__name__} objects, such as a list,"
    expect(isinstance(values, Iterable) and not isinstance(values, (str, bytes)), f"{expected} got {brief(values)}")
    listed = list(values)
    for k, value in enumerate(listed):
        expect(isinstance(value, kind), f"{name}[{k}]: expected a {kind.__name__}, got {brief(value)}")
    return listed


def real_numbers(value) -> np.ndarray | None:
    """Return `value` as a new float64 array, or None if it contains anything other than real numbers.

    NumPy alone would convert text, dates and masked values silently, and would cut complex numbers.
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


def array_of(value) -> np.ndarray:
    """Return `value` as an array, without a copy if possible.

    Rows of unequal length, of which NumPy makes no array, give an array of one object and of shape (), which fits
    nothing that expects several numbers.
    """
    try:
        return np.asarray(value)
    except ValueError:
        return np.array(None)


def floats(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    """Return `value` as a new float64 array of finite numbers of this shape."""
    array = real_numbers(value)
    if array is None or array.shape != shape:
        got = brief(value) if array is None else f"shape {array.shape}"
        raise ValueError(f"{name}: expected finite numbers of shape {shape}, got {got}")
    refuse_where(~np.isfinite(array), name, array, "a finite number")
    return array


SYNONYMS = {
    "body": "bodies", "callback": "on_step", "collide": "touches", "collisions": "touches", "cor": "restitution",
    "count": "n_bodies", "crr": "rolling_friction", "duration": "steps", "e": "restitution", "every": "record",
    "filter": "touches", "g": "gravity", "hook": "on_step", "iterations": "sweeps", "lines": "segments",
    "mask": "touches", "mu": "friction", "mu_r": "rolling_friction", "n": "n_bodies", "omega": "spin",
    "pos": "position", "r": "radius", "rolling": "rolling_friction", "rolling_resistance": "rolling_friction",
    "rtol": "tolerance", "start": "warm_start", "time": "steps", "time_step": "dt", "timestep": "dt",
    "tol": "tolerance", "v": "velocity", "velocities": "fixed_velocities", "velocity": "fixed_velocities",
    "walls": "segments", "workers": "jobs",
}  # fmt: skip
"""Keyword that users try by mistake -> the keyword of this package."""

_OWNERS = {
    "dc.World": (
        "box gravity friction restitution scales segments surface_speeds segment_velocities wall_materials "
        "segment_materials touches rolling_friction"
    ),
    "dc.make_bodies": "position radius velocity angle spin density mass fixed material",
    "dc.State": "world bodies contacts dt",
    "dc.simulate": "steps solver warm_start accuracy sleep push record forces until on_step",
    "dc.PGS": "sweeps tolerance position_sweeps substeps most_substeps approach slop",
    "dc.PSOR": "omega",
    "dc.simulate_many": "threads jobs",
    "dc.circles_in_box": "n_bodies size seed",
    "dc.Simulator.set": "fixed_velocities fixed_spins",
    "dc.film": "fps colour",
    "dc.recommend": "budget_ms",
}
OWNERS = {name: owner for owner, names in _OWNERS.items() for name in names.split()}
"""Keyword -> the function or class that has it, for messages of calls that do not."""

ALIKE = 0.7
"""Smallest similarity (`difflib`) of a keyword and its suggestion. With 0.6, "save" would suggest "state"."""

F = TypeVar("F", bound=Callable)


def suggesting(function: F) -> F:
    """Decorate a function or class so that the TypeError of a wrong call has a suggestion.

    For an unknown keyword the suggestion is the most similar keyword, or the function that has a keyword of this name.
    For too many positional values the suggestion names the first options, which are keyword-only.
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
    """Return the message of a TypeError with a suggestion, if there is one.

    keywords: the keywords of the call. is_ours: whether the call itself raised the error, not the body of the function.
    """
    known, wrong = inspect.signature(function).parameters, re.search(r"unexpected keyword argument '(\w+)'", message)
    if is_ours and "positional argument" in message:
        named = [f"{name}=…" for name, one in known.items() if one.kind is one.KEYWORD_ONLY][:3]
        return f"{message}; name the options: {', '.join(named)}" if named else message
    if wrong is None or wrong[1] not in keywords or "did you mean" in message:
        return message
    plain, name = message[: wrong.end()], wrong[1]
    meant = SYNONYMS.get(name, name)
    near = [meant] if meant in known else [] if name in OWNERS else difflib.get_close_matches(name, known, 1, ALIKE)
    if near:
        return f"{plain}; did you mean {near[0]!r}?"
    if plain != message and "; dc." in message:
        return message  # with the owner that an inner function has named
    owned = name if name in OWNERS else meant
    return f"{plain}; {OWNERS[owned]} has {owned!r}" if owned in OWNERS else plain


def flag(name: str, value) -> bool:
    """Return `value` as a bool. A bool of NumPy is accepted, an integer is refused."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    raise ValueError(f"{name}: expected True or False, got {brief(value)}")


def function(name: str, value) -> None:
    """Raise ValueError unless `value` can be called. It is for options that may also be None, which is not passed."""
    if not callable(value):
        raise ValueError(f"{name}: expected a function, or None, got {brief(value)}")


def one_of(name: str, value, known: Collection):
    """Return `value` if it is one of `known`.

    known: sequence of the choices, or table whose keys are the choices. Raises ValueError on another value. The message
    suggests the most similar choice.
    """
    try:
        if value in known:
            return value
    except (TypeError, ValueError):  # values that cannot be hashed, and arrays, which compare element by element
        pass
    names = {str(one).lower(): one for one in known}
    near = difflib.get_close_matches(value.lower(), names, 1) if isinstance(value, str) else ()
    hint = "".join(f"; did you mean {names[one]!r}?" for one in near)
    raise ValueError(f"{name}: expected one of {', '.join(map(str, known))}, got {brief(value)}{hint}")
