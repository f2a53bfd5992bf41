"""Starts by name: where each one is, and which start an argument `warm_start=` means."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from deep_contact.lazy import imported
from deep_contact.state.validation import brief, expect, one_of

WarmStart = Callable[[Any, Any], tuple[np.ndarray, np.ndarray]]

Classical = Literal["none", "builtin", "scaled", "support", "copy"]

Name = Literal[Classical, "sph", "sph spline", "sph consistent", "cnn", "far field", "far field, no past"]


class Network(Protocol):
    """A network that predicts impulses: `cnn.inference.LearnedModel`."""

    def predict(self, state: Any, *, problem: Any = None) -> Any: ...


Start = Name | WarmStart | Network | Path | None
"""What `warm_start=` takes: a name, a callable, a network or the path of its file; None is "none"."""


def _at(place: str, **options) -> Callable[[], WarmStart]:
    """What makes the start of a class, "module:class", with these options. The module is imported by the call."""
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
"""Name -> what makes the start with its default options."""

RENAMED = {"learned support": "far field, no past"}
"""Former name of a start -> its present name."""


def is_network(start) -> bool:
    """Whether a start is a network or the path of one, "….h5"."""
    return hasattr(start, "predict") or isinstance(start, Path) or (isinstance(start, str) and start.endswith(".h5"))


def _by_name(name: str) -> WarmStart:
    """The start of this name. Raises ValueError on a name that is none, with the new name of an old one."""
    if name in RENAMED:
        raise ValueError(f"warm_start: {name!r} is called {RENAMED[name]!r} now")
    if name not in STARTS:
        networks = _at("cnn.registry:registered")()
        hint = f"got {name!r}: a network is passed as dc.load_model({name!r})"
        expect(name not in networks, f"warm_start: expected one of {', '.join(STARTS)}, {hint}")
        one_of("warm_start", name, STARTS)
    return STARTS[name]()


def warm_start_of(start: Start) -> WarmStart:
    """The start that None, a name, a network or its path stands for; a callable is returned as it is.

    Raises ValueError on any other value.
    """
    if start is None or (isinstance(start, str) and not is_network(start)):
        return _by_name("none" if start is None else start)
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
