"""Lazy imports: the public names of a package, and objects that a text "module:name" names.

A package with lazy names imports them in a block `if TYPE_CHECKING:`, for type checkers and editors. At run time Python
skips this block, and `homes` reads its text. (The package `lazy_loader` reads stub files, which support neither aliases
nor the modules of a package.)

Tests: tests/test_imports.py
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path

HOOKS: dict[str, str] = {}
"""Name of a function -> its place, "module:name". Lower modules call these functions of higher modules, which they must
not import. `deep_contact/__init__.py` fills the table."""

_IMPORT = re.compile(r"^    from ([\w.]+) import (\([^)]*\)|.*)", re.MULTILINE)


def imported(place: str):
    """Import and return the object at a place, "module:name"."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def homes(source: str) -> dict[str, tuple[str, str]]:
    """Return public name -> (module that defines it, its name there) for a package. source: path of its `__init__.py`.

    The names are read from the indented imports in this file.
    """
    return {
        public or name: (module, name)
        for module, names in _IMPORT.findall(Path(source).read_text(encoding="utf-8"))
        for name, public in re.findall(r"(\w+)(?: as (\w+))?", names)
    }


def attach(package: str, source: str) -> tuple[Callable, Callable, list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` for a package with lazy names.

    package: name of the package. source: path of its `__init__.py`.
    """
    home = homes(source)
    names = [*home]

    def get(public: str):
        if public not in home:
            raise AttributeError(f"module {package!r} has no attribute {public!r}")
        module, name = home[public]
        owner = importlib.import_module(module)
        if module == package or not hasattr(owner, name):
            return importlib.import_module(f"{module}.{name}")
        # Stored as an attribute, so that the next access does not call this function. Its 3 µs would be much of the
        # overhead of `step`.
        setattr(sys.modules[package], public, getattr(owner, name))
        return getattr(owner, name)

    return get, lambda: sorted(names), names
