"""Model files: a Keras network in .h5 together with all that is needed to use it.

The file is Keras's own HDF5 format, which plain `keras.models.load_model(path, compile=False)` opens. Beside it stands
one more dataset, `deep_contact`, a JSON object:

| field        | meaning                                                                                      |
|--------------|----------------------------------------------------------------------------------------------|
| format       | 1                                                                                            |
| spec         | `ImageSpec.to_dict()`: channels, targets, grid, kernel, transfer, normalisation, statistics, |
|              | or `FarFieldSpec.to_dict()`                                                                  |
| coarsening   | k: the network takes n = 1 (mod k) nodes along an edge                                       |
| box          | (width, height) that a network of one fixed size was made for, m; null if any fits           |
| card         | where it comes from and what it is worth: data, seed, command, versions, errors              |
| digest       | SHA-256 over the network's configuration, its weights and the other fields                   |

Loading runs no code from the file: only a dense list of stock layers is let through to Keras, before Keras sees it;
there is no pickle, no Lambda. The digest tells damage and carelessness, not malice: whoever changes a file on purpose
can write a new one.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import warnings
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from deep_contact.cnn.far_field import FarFieldSpec
from deep_contact.cnn.images import ImageSpec

FORMAT = 1
METADATA = "deep_contact"
"""Name of the dataset with our metadata."""

MODELS = "models"
"""Folder of the shipped models, from the root of the checkout."""

DEFAULT_MODEL = "model.h5"

_FIELDS = ("format", "spec", "coarsening", "box", "card", "digest")

_LAYERS = frozenset(
    "Activation Add Average AveragePooling2D BatchNormalization Concatenate Conv2D Conv2DTranspose Cropping2D Dense "
    "DepthwiseConv2D Dropout Flatten GlobalAveragePooling2D InputLayer LayerNormalization LeakyReLU MaxPooling2D "
    "Multiply ReLU Rescaling Reshape SeparableConv2D Subtract UpSampling2D ZeroPadding2D".split()
)
_MODELS = ("Functional", "Sequential")
_PARTS = {
    "keras.initializers": None,
    "keras.regularizers": ("L1", "L2", "L1L2"),
    "keras": ("DTypePolicy",),
}
"""Module -> which of its classes a layer's configuration may hold; None is all."""

_ACTIVATIONS = (None, "linear", "relu", "leaky_relu", "elu", "gelu", "silu", "swish", "tanh", "sigmoid", "softplus")


class ModelFileError(ValueError):
    """A model file is not what it should be, or does not fit the scene; the message names the field."""


def save_model(path, model, spec: ImageSpec | FarFieldSpec, card: dict, *, coarsening: int = 1, box=None) -> Path:
    """Write a network and its metadata, at once or not at all. Returns the path.

    card: anything that JSON holds. coarsening: `architectures.coarsening(name)`. box: the world's box that a network
    of fixed size was made for, (x_min, y_min, x_max, y_max), m.
    Raises ValueError where the network does not fit the spec, or is of layers that a model file may not hold.
    """
    import keras

    path = Path(path)
    size = None if box is None else [float(box[2]) - float(box[0]), float(box[3]) - float(box[1])]
    metadata = {"format": FORMAT, "spec": spec.to_dict(), "coarsening": int(coarsening), "box": size, "card": card}
    _check_fit(model, spec, metadata, path)
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem}.{os.getpid()}.h5")
    try:
        with _quiet():
            # Without its optimizer and loss, which would only tie the file to the code that trained it.
            keras.saving.save_model(model, beside, include_optimizer=False)
        with h5py.File(beside, "r+") as file:
            _check_layers(_model_config(file, path), path)
            metadata["digest"] = _digest(file, metadata)
            file.create_dataset(METADATA, data=json.dumps(metadata, allow_nan=False))
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
    return path


def read_metadata(path) -> dict:
    """The metadata of a model file, checked against its contents; Keras and TensorFlow stay out of it.

    Raises FileNotFoundError where there is no file, ModelFileError where it is not a whole one of ours.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"model file: {path} does not exist")
    try:
        with h5py.File(path, "r") as file:
            _check_layers(_model_config(file, path), path)
            metadata = _metadata(file, path)
            if _digest(file, metadata) != metadata["digest"]:
                raise ModelFileError(
                    f"{path}: digest: expected that of the file's contents, got another; it was changed or damaged"
                )
    except ModelFileError:
        raise
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        # What h5py raises on a damaged file depends on where the damage is; text that is no UTF-8 is a ValueError.
        raise ModelFileError(f"{path}: expected a whole HDF5 file, got one that cannot be read ({error})") from error
    return metadata


def read_model(path):
    """(network, spec, metadata) of a model file. Raises as `read_metadata`."""
    path = Path(path)
    metadata = read_metadata(path)
    try:
        kind = metadata["spec"].get("kind") if isinstance(metadata["spec"], dict) else None
        spec = (FarFieldSpec if kind == "far field" else ImageSpec).from_dict(metadata["spec"])
    except ValueError as error:
        raise ModelFileError(f"{path}: spec: {error}") from error
    import keras

    with _quiet():
        try:
            model = keras.models.load_model(path, compile=False, safe_mode=True)
        except Exception as error:
            # Keras raises what it happens to meet: TypeError, KeyError, IndexError …
            raise ModelFileError(f"{path}: model_config: Keras cannot build the network ({error})") from error
    _check_fit(model, spec, metadata, path)
    return model, spec, metadata


def default_model_path() -> Path:
    """The shipped model, models/model.h5, of this checkout, or below the current folder.

    Raises FileNotFoundError naming where it was looked for.
    """
    roots = (Path(__file__).resolve().parents[2], Path.cwd())
    for root in roots:
        if (root / MODELS / DEFAULT_MODEL).is_file():
            return root / MODELS / DEFAULT_MODEL
    places = " and ".join(dict.fromkeys(str(root / MODELS / DEFAULT_MODEL) for root in roots))
    raise FileNotFoundError(
        f"model file: expected {MODELS}/{DEFAULT_MODEL}, looked for {places}; it is part of the repository, "
        "and `python scripts/train.py` makes another"
    )


@contextmanager
def _quiet():
    """Without Keras's advice to use its other format: .h5 is what is asked for here."""
    logger = logging.getLogger("absl")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _model_config(file, path) -> dict:
    try:
        given = file.attrs["model_config"]
    except KeyError:
        raise ModelFileError(f"{path}: model_config: expected a Keras network, got none") from None
    try:
        config = json.loads(given)
    except (TypeError, ValueError) as error:
        raise ModelFileError(f"{path}: model_config: expected JSON, got {str(given)[:60]!r}") from error
    if "model_weights" not in file or not isinstance(file["model_weights"], h5py.Group):
        raise ModelFileError(f"{path}: model_weights: expected the network's weights, got none")
    return config


def _metadata(file, path) -> dict:
    if METADATA not in file:
        raise ModelFileError(f"{path}: {METADATA}: expected our metadata, got none; it is another Keras file")
    try:
        metadata = json.loads(file[METADATA][()])
    except (TypeError, ValueError) as error:
        raise ModelFileError(f"{path}: {METADATA}: expected JSON, got {error}") from error
    if not isinstance(metadata, dict) or set(metadata) != set(_FIELDS):
        got = sorted(metadata) if isinstance(metadata, dict) else type(metadata).__name__
        raise ModelFileError(f"{path}: {METADATA}: expected the fields {', '.join(_FIELDS)}, got {got}")
    if metadata["format"] != FORMAT:
        raise ModelFileError(f"{path}: format: expected {FORMAT}, got {metadata['format']!r}")
    coarsening, box = metadata["coarsening"], metadata["box"]
    if not isinstance(coarsening, int) or isinstance(coarsening, bool) or coarsening < 1:
        raise ModelFileError(f"{path}: coarsening: expected an integer >= 1, got {coarsening!r}")
    if box is not None and not (
        isinstance(box, list) and len(box) == 2 and all(isinstance(x, (int, float)) and x > 0 for x in box)
    ):
        raise ModelFileError(f"{path}: box: expected null or [width, height] in m, got {box!r}")
    return metadata


def _check_layers(config, path) -> None:
    """Raise ModelFileError unless the configuration is of listed stock parts and nothing else."""
    if not isinstance(config, dict) or config.get("class_name") not in _MODELS:
        got = config.get("class_name") if isinstance(config, dict) else config
        raise ModelFileError(f"{path}: model_config: expected one of {', '.join(_MODELS)}, got {got!r}")
    inner = config.get("config")
    listed = inner.get("layers") if isinstance(inner, dict) else None
    if not isinstance(listed, list) or not listed:
        raise ModelFileError(f"{path}: model_config: expected a list of layers, got {type(listed).__name__}")
    for i, layer in enumerate(listed):
        name = layer.get("class_name") if isinstance(layer, dict) else layer
        module = layer.get("module", "keras.layers") if isinstance(layer, dict) else None
        if name not in _LAYERS or module != "keras.layers" or layer.get("registered_name") not in (None, name):
            raise ModelFileError(
                f"{path}: model_config.layers[{i}]: expected a stock Keras layer of the list, got {name!r} of "
                f"{module!r}; custom and Lambda layers are refused"
            )
        _check_parts(layer.get("config"), path, f"layers[{i}]")
        _check_parts(layer.get("inbound_nodes"), path, f"layers[{i}]")


def _check_parts(value, path, where) -> None:
    if isinstance(value, dict):
        name = value.get("class_name")
        if name is not None and name != "__keras_tensor__":
            module = value.get("module")
            allowed = _PARTS.get(module, ())
            if module not in _PARTS or not (allowed is None or name in allowed) or value.get("registered_name"):
                raise ModelFileError(f"{path}: model_config.{where}: expected stock parts, got {name!r} of {module!r}")
        if value.get("activation") not in _ACTIVATIONS:
            got = value["activation"]
            raise ModelFileError(f"{path}: model_config.{where}.activation: expected a stock one, got {got!r}")
        for item in value.values():
            _check_parts(item, path, where)
    elif isinstance(value, list):
        for item in value:
            _check_parts(item, path, where)


def _check_fit(model, spec: ImageSpec | FarFieldSpec, metadata: dict, path) -> None:
    """Raise ModelFileError unless the network takes the spec's images and gives its targets."""
    inputs, outputs = model.input_shape, model.output_shape
    if not isinstance(inputs, tuple) or len(inputs) != 4 or inputs[-1] != len(spec.channels):
        raise ModelFileError(
            f"{path}: channels: expected a network of {len(spec.channels)} input channels "
            f"({', '.join(spec.channels)}), got one of shape {inputs}"
        )
    targets = len(spec.targets)
    flat = len(outputs) == 2 and None not in inputs[1:3] and outputs[-1] == inputs[1] * inputs[2] * targets
    if not (flat or (len(outputs) == 4 and outputs[-1] == targets)):
        raise ModelFileError(
            f"{path}: targets: expected a network that gives {targets} images ({', '.join(spec.targets)}), "
            f"got outputs of shape {outputs}"
        )
    if None not in inputs[1:3] and metadata["box"] is None:
        size = inputs[1:3]
        raise ModelFileError(f"{path}: box: expected [width, height] for a network of the fixed size {size}, got none")


def _digest(file, metadata: dict) -> str:
    """SHA-256 over the configuration, every dataset of the weights by name, and the metadata but for the digest."""
    sha = hashlib.sha256()
    config = file.attrs["model_config"]
    sha.update(config if isinstance(config, bytes) else str(config).encode())

    def add(name, item):
        if isinstance(item, h5py.Dataset):
            array = np.ascontiguousarray(item[()])
            sha.update(f"{name} {array.dtype} {array.shape}".encode())
            sha.update(array.tobytes())

    # `visititems` goes by name, so the order is the same in every copy.
    file["model_weights"].visititems(add)
    rest = {name: value for name, value in metadata.items() if name != "digest"}
    sha.update(json.dumps(rest, sort_keys=True, allow_nan=False).encode())
    return sha.hexdigest()
