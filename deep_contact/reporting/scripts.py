"""The scripts of the figures and tables: which there are, and how a number names one.

Nothing is imported from them, so that listing them is fast.
"""

from __future__ import annotations

import re
from pathlib import Path

_SCRIPT = re.compile(r"(figure|table)_([0-9]+)_([0-9]+)(_\w+)?\.py")


def find(folder: Path) -> dict[str, Path]:
    """Number -> script, "3.7" for a figure and "T5.1" for a table, figures of a number before tables.

    Raises ValueError for two scripts of one number.
    """
    scripts: dict[str, Path] = {}
    for path in sorted(folder.glob("*_*.py")):
        if match := _SCRIPT.fullmatch(path.name):
            kind, chapter, number, _ = match.groups()
            name = f"{'T' if kind == 'table' else ''}{chapter}.{number}"
            if name in scripts:
                raise ValueError(f"expected one script for {name}, got {scripts[name].name} and {path.name}")
            scripts[name] = path
    return dict(sorted(scripts.items(), key=lambda item: _order(item[0])))


def _order(name: str) -> tuple[int, int, bool]:
    chapter, number = name.lstrip("T").split(".")
    return int(chapter), int(number), name.startswith("T")


def normalized(name: str) -> str:
    """A number as `find` has it, of "3.7", "Figure 3.7", "T5.1", "T 5.1" or "table 5.1"."""
    name = re.sub(r"\s", "", name).lower()
    return name.removeprefix("figure").replace("table", "t").upper()


def choose(scripts: dict[str, Path], wanted: list[str]) -> dict[str, Path]:
    """Those of `find` that are wanted, in its order. Raises ValueError naming all for one that there is not."""
    numbers = [normalized(name) for name in wanted]
    for name, number in zip(wanted, numbers):
        if number not in scripts:
            raise ValueError(f"expected one of {', '.join(scripts)}, got {name!r}")
    return {name: path for name, path in scripts.items() if name in numbers}


def stem(script: Path) -> str:
    """The name of the files that a script writes: figure_3_7 for scripts/figure_3_7_baselines.py."""
    kind, chapter, number, _ = _SCRIPT.fullmatch(script.name).groups()
    return f"{kind}_{chapter}_{number}"


def summary(script: Path) -> str:
    """What a script draws, from the first line of its docstring, which begins with its command."""
    with script.open(encoding="utf-8") as file:
        return file.readline().strip().strip('"').partition(": ")[2]
