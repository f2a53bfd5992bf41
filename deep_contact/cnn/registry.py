"""Trained networks by name: `models/registry.json` says which file each is, its SHA-256, and how it was trained."""

from __future__ import annotations

import hashlib
import json
import os
from functools import lru_cache
from pathlib import Path

from deep_contact.cnn.model_file import ModelFileError
from deep_contact.io.shipped import ROOT

FOLDER = "DEEP_CONTACT_MODELS"
"""Environment variable: a folder that is searched before the shipped `models/`."""


def path_of(name: str) -> Path:
    """The file of a registered network, "model" or "comparison/width_8", with its contents checked.

    Raises FileNotFoundError naming the network, the file and the folders where none has it, ModelFileError where the
    file is not the registered one.
    """
    entries = registered()
    if name not in entries:
        known = ", ".join(entries) or "a registry.json, which is part of the source repository"
        raise FileNotFoundError(f"model: expected one of {known}, or the path of a file, got {name!r}")
    entry = entries[name]
    for folder in _folders():
        path = folder / entry["file"]
        if path.is_file():
            status = path.stat()
            found = _sha256(path, status.st_mtime_ns, status.st_size)
            if found != entry["sha256"]:
                raise ModelFileError(f"{path}: sha256: expected {entry['sha256']}, as registered, got {found}")
            return path
    raise FileNotFoundError(
        f"model {name}: expected {entry['file']} in {' or '.join(map(str, _folders()))}, which does not exist; it is "
        f"part of the source repository, not of every wheel; {FOLDER} names another folder, and `{entry['command']}` "
        "trains such a network"
    )


def registered() -> dict[str, dict]:
    """Name -> {"file": path below the folder, "sha256", "command": how it was trained, "data": their hash}.

    Raises ModelFileError where a registry.json is something else.
    """
    for folder in sorted(_folders(), key=lambda folder: folder != ROOT / "models"):
        path = folder / "registry.json"
        if not path.is_file():
            continue
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            for name, entry in found.items():
                if any(not isinstance(entry[field], str) for field in ("file", "sha256", "command")):
                    raise ValueError(f"{name}: expected texts, got {entry}")
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ModelFileError(f"{path}: expected a name -> file, sha256 and command, got {error!r}") from None
        return found
    return {}


def _folders() -> list[Path]:
    given = os.environ.get(FOLDER)
    folders = [ROOT / "models", Path.cwd() / "models"]
    return list(dict.fromkeys(folders if not given else [Path(given), *folders]))


@lru_cache(maxsize=64)
def _sha256(path: Path, changed_ns: int, size: int) -> str:
    """Of a file, computed once as long as it does not change."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
