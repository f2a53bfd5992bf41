"""Paths of files that come with the package, in the folders `models/`, `scripts/` and `data/`.

A wheel has these folders inside the package, the source repository beside it.
"""

from __future__ import annotations

import os
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]

ROOT = _PACKAGE if (_PACKAGE / "models").is_dir() else _PACKAGE.parent
"""The folder that contains `models/`, `scripts/` and `data/`. `setup.py` selects which of their files a wheel has."""

_STATE = ".xml.gz"


def sample_file(name: str = "impact_154") -> Path:
    """Return the path of a sample state for `dc.read_state`: a step of the thesis's scene with 71 circles.

    name: the phase of the fall and the number of the step, as in "impact_154", "settling_349" or "rest_362". Raises
    ValueError, which lists the samples, for an unknown name, and FileNotFoundError if the package came without samples.
    """
    from deep_contact.state.validation import one_of

    return ROOT / "data" / "sample" / f"{one_of('sample', name, sample_names())}{_STATE}"


def sample_names() -> list[str]:
    """Return the names that `sample_file` accepts, ordered by step. Raises FileNotFoundError if there are none."""
    folder = ROOT / "data" / "sample"
    names = [path.name.removesuffix(_STATE) for path in folder.glob(f"*{_STATE}")]
    if not names:
        raise FileNotFoundError(f"{folder}: expected states *{_STATE}, got none; they are in the source repository")
    return sorted(names, key=lambda name: int(name.rpartition("_")[2]))


def find(path: str | os.PathLike) -> Path:
    """Return the path of a file, relative to the current folder or else to `ROOT`.

    path: for example "data/reference/run_tradeoff.json". Raises FileNotFoundError, which names the path, if neither
    folder has the file.
    """
    for place in (Path(path), ROOT / path):
        if place.is_file():
            return place
    raise FileNotFoundError(f"{path}: expected a file here or in {ROOT}, got none; it is part of the source repository")
