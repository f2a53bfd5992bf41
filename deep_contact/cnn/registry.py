"""Trained networks by name. `models/registry.json` has the file, the SHA-256 and the training command of each network.

Tests: tests/cnn/test_inference.py, tests/io/test_hostile.py
"""

from __future__ import annotations

import hashlib
import json
import os
from functools import lru_cache
from pathlib import Path

from deep_contact.cnn.model_file import ModelFileError
from deep_contact.io.shipped import ROOT
from deep_contact.state.validation import brief, expect

FOLDER = "DEEP_CONTACT_MODELS"
"""Name of the environment variable for a folder that is searched for models before the shipped folder `models/`."""

RENAMED = {"no_past": "far field, no past", "thesis_factored": "model"}
"""Name of a network in earlier versions -> its present name."""


OWN = "LearnedModel(source=keras.models.load_model(…), spec=ImageSpec(…)) of deep_contact.cnn takes your own network"
"""Hint in error messages for users who have a Keras network of their own."""


def network_file(model=None) -> Path:
    """Return the path of a model file.

    model: a name in the registry, by default "model", or a path relative to the current folder or to `ROOT`. If there
    is no file at a path "models/x.h5", the registered file "x.h5" is taken. Raises FileNotFoundError if there is no
    such file, ValueError for a name of an earlier version, and ModelFileError if the SHA-256 of a registered file is
    not the registered one.
    """
    is_name = model is None or isinstance(model, (str, os.PathLike))
    expect(is_name, f"model: expected a name or the path of a file of this package, got {brief(model)}; {OWN}")
    text, known = "model" if model is None else os.fspath(model), registered()
    expect(not text.endswith(".keras"), f"model: expected a file of this package, ….h5, got {text}; {OWN}")
    for place in () if text in known else (Path(text), ROOT / text):
        if place.exists() and not place.is_dir():
            return place
    stem = text.removeprefix("models/").removesuffix(".h5")
    name = {Path(entry["file"]).stem: name for name, entry in known.items()}.get(stem, stem)
    if name not in known:
        expect(stem not in RENAMED, f"model file: {text} is called {RENAMED.get(stem)!r} now")
        raise FileNotFoundError(
            f"model file: expected a file or one of {', '.join(map(repr, known))}, got {text}, which does not exist; "
            "`deep-contact train` makes one"
        )
    entry = known[name]
    path = next((path for folder in _folders() if (path := folder / entry["file"]).is_file()), None)
    if path is None:
        raise FileNotFoundError(
            f"model {name}: expected {entry['file']} in {' or '.join(map(str, _folders()))}, which does not exist; the "
            f"source repository has it as models/{entry['file']}, {FOLDER} names another folder, and "
            f"`{entry['command']}` trained it"
        )
    status = path.stat()
    if (digest := _sha256(path, status.st_mtime_ns, status.st_size)) != entry["sha256"]:
        raise ModelFileError(f"{path}: sha256: expected {entry['sha256']}, as registered, got {digest}")
    return path


def registered() -> dict[str, dict]:
    """Return the entries of registry.json by the name of the network, {} if there is no such file.

    An entry is {"file": path relative to the models folder, "sha256": digest of the file, "command": the command that
    trained the network, "data": hash of the training data}. Raises ModelFileError if registry.json has other contents.
    """
    paths = [folder / "registry.json" for folder in (ROOT / "models", *_folders())]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        return {}
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
        for name, entry in entries.items():
            if any(not isinstance(entry[field], str) for field in ("file", "sha256", "command")):
                raise ValueError(f"{name}: expected texts, got {entry}")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ModelFileError(f"{path}: expected a name -> file, sha256 and command, got {error!r}") from None
    return entries


def _folders() -> list[Path]:
    first = [Path(os.environ[FOLDER])] if os.environ.get(FOLDER) else []
    return list(dict.fromkeys([*first, ROOT / "models", Path.cwd() / "models"]))


@lru_cache(maxsize=64)
def _sha256(path: Path, changed_ns: int, size: int) -> str:
    """Return the SHA-256 of a file, from a cache if its time of change and its size are the same as before."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
