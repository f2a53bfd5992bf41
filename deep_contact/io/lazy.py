"""Packages whose public names are imported when they are first used: `import deep_contact` costs next to nothing.

Such a package imports its names under `if TYPE_CHECKING:`, for type checkers and editors. At run time these lines are
only read. (The stubs of `lazy_loader` know neither aliases nor the modules of a package.)
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path

_IMPORT = re.compile(r"^    from ([\w.]+) import (\([^)]*\)|.*)", re.MULTILINE)


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
