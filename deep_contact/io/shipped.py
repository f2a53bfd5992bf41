"""Files that come with the package: `models/`, `scripts/`, `data/`. In a wheel they lie inside it, else beside it."""

from __future__ import annotations

import os
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]

ROOT = _PACKAGE if (_PACKAGE / "models").is_dir() else _PACKAGE.parent
"""The folder of `models/`, `scripts/` and `data/`. `setup.py` says which of their files a wheel has."""

_STATE = ".xml.gz"


def sample_file(name: str = "impact_154") -> Path:
    """The path of a state of `data/sample`, for `dc.read_state`: 71 circles of the thesis's scene.

    name: "impact_154", "settling_349", "rest_362", …: the phase of the fall, and the step. Raises ValueError naming
    the samples, and FileNotFoundError where none came with the package.
    """
    from deep_contact.state.validation import one_of

    return ROOT / "data" / "sample" / f"{one_of('sample', name, sample_names())}{_STATE}"


def sample_names() -> list[str]:
    """The names that `sample_file` knows, ordered by step. Raises FileNotFoundError where there are none."""
    folder = ROOT / "data" / "sample"
    names = [path.name.removesuffix(_STATE) for path in folder.glob(f"*{_STATE}")]
    if not names:
        raise FileNotFoundError(f"{folder}: expected states *{_STATE}, got none; they are in the source repository")
    return sorted(names, key=lambda name: int(name.rpartition("_")[2]))


def find(path: str | os.PathLike) -> Path:
    """A file by its path from the current folder, or else from `ROOT`, such as "data/reference/run_tradeoff.json".

    Raises FileNotFoundError naming the path where neither has it.
    """
    for place in (Path(path), ROOT / path):
        if place.is_file():
            return place
    raise FileNotFoundError(f"{path}: expected a file here or in {ROOT}, got none; it is part of the source repository")
