"""What is imported when it is first used: the public names of a package, and what is known by its place alone.

A package with such names imports them under `if TYPE_CHECKING:`, for type checkers and editors. At run time these lines
are only read. (The stubs of `lazy_loader` know neither aliases nor the modules of a package.)
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path

HOOKS: dict[str, str] = {}
"""What a part of the package asks of parts above it, which it never imports -> its place. `deep_contact` fills it."""

_IMPORT = re.compile(r"^    from ([\w.]+) import (\([^)]*\)|.*)", re.MULTILINE)


def imported(place: str):
    """What is at a place, "module:name"."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def homes(source: str) -> dict[str, tuple[str, str]]:
    """Public name of a package -> (module or package, name in it), by the indented imports of its source file."""
    return {
        public or name: (module, name)
        for module, names in _IMPORT.findall(Path(source).read_text(encoding="utf-8"))
        for name, public in re.findall(r"(\w+)(?: as (\w+))?", names)
    }


def attach(package: str, source: str) -> tuple[Callable, Callable, list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package with this source file."""
    home = homes(source)
    names = [*home]

    def get(public: str):
        if public not in home:
            raise AttributeError(f"module {package!r} has no attribute {public!r}")
        module, name = home[public]
        owner = importlib.import_module(module)
        if module == package or not hasattr(owner, name):
            return importlib.import_module(f"{module}.{name}")
        # Kept as an attribute: a look-up takes 3 µs, a good part of what `step` takes beside its computation.
        setattr(sys.modules[package], public, getattr(owner, name))
        return getattr(owner, name)

    return get, lambda: sorted(names), names
