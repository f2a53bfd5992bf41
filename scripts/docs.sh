#!/usr/bin/env bash
# The API reference from the docstrings, as web pages in build/docs: makes .venv if needed and installs pdoc.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv "[docs]"
# Without compilation the kernels are plain functions, whose signatures and docstrings pdoc can see.
NUMBA_DISABLE_JIT=1 TF_CPP_MIN_LOG_LEVEL=3 "$PYTHON" - <<'PYTHON'
import pkgutil
import sys
import typing
from importlib import import_module
from pathlib import Path

import pdoc

import deep_contact

names = [found.name for found in pkgutil.walk_packages(deep_contact.__path__, "deep_contact.")]
modules = [import_module(name) for name in ["deep_contact", *names] if not name.endswith("__main__")]
for module in modules:
    if not hasattr(module, "__path__"):
        continue
    # pdoc looks names up where they are stored; ours are found when they are first asked for. And all modules get a
    # page, not only those that can be reached without an import of their own.
    for name in getattr(module, "__all__", ()):
        vars(module)[name] = getattr(module, name)
    prefix = f"{module.__name__}."
    below = [other.__name__.removeprefix(prefix) for other in modules if other.__name__.startswith(prefix)]
    module.__all__ = [*dict.fromkeys([*getattr(module, "__all__", ()), *(name for name in below if "." not in name)])]
for module in modules:
    for found in vars(module).values():
        if isinstance(found, type) and issubclass(found, tuple) and hasattr(found, "_fields"):
            # The class's table says what the fields are; "Alias for field number 0" says nothing.
            found.__new__.__annotations__ = typing.get_type_hints(found, vars(sys.modules[found.__module__]))
            found.__new__.__doc__ = ""
            for name in found._fields:
                if type(getattr(found, name)).__name__ == "_tuplegetter":
                    getattr(found, name).__doc__ = ""
pdoc.pdoc("deep_contact", output_directory=Path("build/docs"))
PYTHON
echo "The reference is build/docs/index.html."
