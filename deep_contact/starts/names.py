"""The table of starts by name, and the start that an argument `warm_start=` means.

Tests: tests/starts/test_starts.py, tests/cnn/test_inference.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from deep_contact.lazy import imported
from deep_contact.state.validation import brief, one_of

WarmStart = Callable[[Any, Any], tuple[np.ndarray, np.ndarray]]

Classical = Literal["none", "builtin", "scaled", "support", "copy"]

Name = Literal[Classical, "sph", "sph spline", "sph consistent", "cnn", "far field", "far field, no past"]


class Network(Protocol):
    """A network that predicts impulses, such as `cnn.inference.LearnedModel`."""

    def predict(self, state: Any, *, problem: Any = None) -> Any: ...


Start = Name | WarmStart | Network | Path | None
"""Type of `warm_start=`: a name, a callable, a network, the path of its file, or None, which means "none"."""


def _at(place: str, **options) -> Callable[[], WarmStart]:
    """Return a function that makes a start of the class at `place`, "module:class", with these options.

    The module is imported when the function is called.
    """
    return lambda: imported(f"deep_contact.{place}")(**options)


STARTS: dict[Name, Callable[[], WarmStart]] = {
    "none": _at("starts.classical:NoStart"),
    "builtin": _at("starts.classical:Builtin"),
    "scaled": _at("starts.classical:Scaled"),
    "support": _at("starts.classical:Support"),
    "copy": _at("sph.start:Copy"),
    "sph": _at("sph.start:Sph"),
    "sph spline": _at("sph.start:Sph", transfer="spline"),
    "sph consistent": _at("sph.start:Sph", transfer="consistent"),
    "cnn": _at("cnn.start:Cnn"),
    "far field": _at("cnn.start:Cnn", model="far field"),
    "far field, no past": _at("cnn.start:FarFieldNoPast"),
}
"""Name of a start -> function that makes the start with its default options."""

RENAMED = {"learned support": "far field, no past"}
"""Former name of a start -> its present name."""


def is_network(start) -> bool:
    """Return whether a start is a network or the path of a network file.

    Texts that end in .h5 or .keras are paths. A file of Keras is refused when it is read, with the way to use it.
    """
    is_file = isinstance(start, str) and start.endswith((".h5", ".keras"))
    return hasattr(start, "predict") or isinstance(start, Path) or is_file


def _refuse_name(name: str) -> None:
    """Raise ValueError, since no start has this name. For a former name the message has the present name."""
    if name in RENAMED:
        raise ValueError(f"warm_start: {name!r} is called {RENAMED[name]!r} now")
    if name in _at("cnn.registry:registered")():
        hint = f"got {name!r}: a network is passed as dc.load_model({name!r})"
        raise ValueError(f"warm_start: expected one of {', '.join(STARTS)}, {hint}")
    one_of("warm_start", name, STARTS)


def warm_start_of(start: Start) -> WarmStart:
    """Return the start that None, a name, a network or the path of its file stands for.

    A callable is returned as it is. Raises ValueError on any other value.
    """
    start = "none" if start is None else start
    if isinstance(start, str) and start in STARTS:
        return STARTS[start]()
    if isinstance(start, str) and not is_network(start):
        _refuse_name(start)
    if isinstance(start, type):
        raise ValueError(f"warm_start: expected an instance, such as {start.__name__}(), got the class")
    if any(kind.__module__.partition(".")[0] == "keras" for kind in type(start).__mro__):
        hint = "LearnedModel(source=…, spec=ImageSpec()) of deep_contact.cnn makes it a start"
        raise ValueError(f"warm_start: expected a start, got a {type(start).__name__} of Keras; {hint}")
    if callable(start):
        return start
    if is_network(start):
        return _at("cnn.start:Cnn", model=start)()
    raise ValueError(f"warm_start: expected None, a name, a network, its path or a callable, got {brief(start)}")
