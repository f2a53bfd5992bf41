"""Finds the scripts of the figures and tables by their numbers.

No script is imported, so that listing them is fast.

Tests: tests/test_command_line.py, tests/documents/test_reference.py
"""

from __future__ import annotations

import re
from pathlib import Path

_SCRIPT = re.compile(r"((figure|table)_([0-9]+)_([0-9]+))(_\w+)?\.py")


def find(folder: Path) -> dict[str, Path]:
    """Return number -> script for the scripts in a folder, such as "3.7" for a figure and "T5.1" for a table.

    A figure comes before the table of the same number. Raises ValueError if two scripts have one number.
    """
    matches = [(match, path) for path in folder.glob("*_*.py") if (match := _SCRIPT.fullmatch(path.name))]
    matches.sort(key=lambda one: (int(one[0][3]), int(one[0][4]), one[0][2] == "table", one[1].name))
    paths: dict[str, Path] = {}
    for match, path in matches:
        name = f"{'T' * (match[2] == 'table')}{match[3]}.{match[4]}"
        if name in paths:
            raise ValueError(f"expected one script for {name}, got {paths[name].name} and {path.name}")
        paths[name] = path
    return paths


def normalized(name: str) -> str:
    """Return the number in the form of `find`, for "3.7", "Figure 3.7", "T5.1", "T 5.1" or "table 5.1"."""
    return re.sub(r"\s", "", name).lower().removeprefix("figure").replace("table", "t").upper()


def choose(scripts: dict[str, Path], wanted: list[str]) -> dict[str, Path]:
    """Return number -> script for the wanted numbers, in the order of `find`.

    Raises ValueError, which lists all numbers, for an unknown one.
    """
    from deep_contact.state.validation import one_of

    numbers = {one_of("number", normalized(name), scripts) for name in wanted}
    return {name: path for name, path in scripts.items() if name in numbers}


def stem(script: Path) -> str:
    """Return the stem of the files that a script writes: "figure_3_7" for scripts/figure_3_7_baselines.py."""
    return _SCRIPT.fullmatch(script.name)[1]


def summary(script: Path) -> str:
    """Return the subject of a script: the text after the command and ": " in the first line of its docstring."""
    with script.open(encoding="utf-8") as file:
        return file.readline().strip().strip('"').partition(": ")[2]
