"""Model files: HDF5 files (.h5) with a Keras network and the metadata that its use needs.

models/README.md describes the format. Files are read by h5py. Only stock Keras layers of a short list are accepted, and
only those of their arguments that define the layer's function (`_ARGUMENTS`). All versions of Keras from 3.4 on know
these arguments. Nothing else of the configuration in a file is passed to Keras. Pickled objects, Lambda layers and
links to other files are refused. The digest in a file detects damage, but not a deliberate change.

Tests: tests/cnn/test_inference.py, tests/io/test_hostile.py, tests/cnn/test_training.py
"""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from deep_contact.cnn.convolution import is_far_field
from deep_contact.cnn.far_field import FarFieldSpec
from deep_contact.cnn.images import ImageSpec
from deep_contact.io import hdf5
from deep_contact.io.files import FileError, write_bytes
from deep_contact.state.equality import by_value
from deep_contact.state.validation import expect

FORMAT = 1
METADATA = "deep_contact"
"""Name of the dataset in a file that holds the metadata as JSON."""

_FIELDS = ("format", "spec", "coarsening", "box", "card", "digest")

_LAYERS = frozenset(
    "Add BatchNormalization Conv2D Conv2DTranspose Cropping2D Dense Dropout Flatten InputLayer MaxPooling2D ReLU "
    "ZeroPadding2D".split()
)
"""Names of the layers that a file may hold. They are those of `architectures`."""

_ARGUMENTS = frozenset(
    "activation axis batch_shape bias_regularizer center cropping data_format dilation_rate epsilon filters groups "
    "kernel_regularizer kernel_size max_value momentum name negative_slope output_padding padding pool_size rate scale "
    "strides threshold units use_bias".split()
)
"""Names of the layers' arguments that are stored and read.

Initializers are left out. They differ most between versions of Keras, and the stored weights replace their results.
"""

_NETWORKS = {"Functional": ("name", "input_layers", "output_layers"), "Sequential": ("name",)}
"""Keras class of a network -> fields of its configuration that are stored beside the layers."""

_ACTIVATIONS = (None, "linear", "relu", "tanh")


class ModelFileError(FileError):
    """Error for a faulty model file, and for a network that does not fit the scene. The message names the field."""


@by_value
class StoredNetwork(NamedTuple):
    """The network of a model file, not yet built by Keras.

    path: path of the file. config: Keras's configuration, checked and reduced by `portable`. weights: name of a layer
    -> its arrays, float32.
    """

    path: Path
    config: dict
    weights: dict[str, list[np.ndarray]]

    def count_params(self) -> int:
        """Return the number of weights, as the method of `keras.Model` with this name does."""
        return sum(array.size for arrays in self.weights.values() for array in arrays)

    def build(self):
        """Build the network as a `keras.Model`. Raises ModelFileError if its layers and weights do not fit together."""
        from deep_contact.cnn.backend import keras

        try:
            kind = {"Functional": keras.Model, "Sequential": keras.Sequential}[self.config["class_name"]]
            model = kind.from_config(_in_single_precision(self.config["config"]))
            for layer in model.layers:
                layer.set_weights(self.weights.get(layer.name, []))
            if unused := self.weights.keys() - {layer.name for layer in model.layers}:
                raise ValueError(f"there are weights of {sorted(unused)} and no such layers")
        except Exception as error:
            # Keras does not check its input. So faults raise errors of any class, such as TypeError or KeyError.
            raise ModelFileError(f"{self.path}: model_config: Keras cannot build the network ({error})") from error
        return model


def _in_single_precision(config: dict) -> dict:
    """Return the configuration with layers that compute in float32, whatever Keras's global policy is."""
    layers = [layer | {"config": layer["config"] | {"dtype": "float32"}} for layer in config["layers"]]
    return config | {"layers": layers}


def weights_of(network) -> dict[str, list[np.ndarray]]:
    """Return the weights of a network: name of a layer -> its arrays. network: a `StoredNetwork` or a `keras.Model`."""
    if isinstance(network, StoredNetwork):
        return network.weights
    return {layer.name: layer.get_weights() for layer in network.layers}


def save_model(path, model, spec: ImageSpec | FarFieldSpec, card: dict, *, box=None) -> Path:
    """Write a `keras.Model` and its metadata to a file, completely or not at all. Returns the path.

    path: path of the file. model: the network. spec: the definition of its images. card: dict that JSON can hold, with
    the network's origin and errors. box: the world's box for which a network of fixed size was made, (x_min, y_min,
    x_max, y_max), m.
    Raises ValueError if the network does not fit the spec, or has layers that a model file may not hold. Raises OSError
    if the file cannot be written.
    """
    from deep_contact.cnn.backend import keras

    weights = weights_of(model)
    size = None if box is None else [float(box[2]) - float(box[0]), float(box[3]) - float(box[1])]
    metadata = {"format": FORMAT, "spec": spec.to_dict(), "coarsening": spec.multiple, "box": size, "card": card}
    config = json.dumps(portable(json.loads(model.to_json())))
    _check_fit(model, spec, size)
    # The file is made in memory first. On a full disk HDF5 can end the process, while a plain write raises OSError.
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        group = file.create_group("model_weights")
        for attributes in (file.attrs, group.attrs):
            attributes.update({"keras_version": keras.__version__, "backend": keras.backend.backend()})
        file.attrs["model_config"] = config
        group.attrs["layer_names"] = list(weights)
        for layer in model.layers:
            names = [f"{layer.name}/{variable.name}" for variable in layer.weights]
            stored = group.create_group(layer.name)
            stored.attrs["weight_names"] = names
            for name, array in zip(names, weights[layer.name]):
                stored[name] = array
        metadata["digest"] = _digest(config, _datasets(group), metadata)
        file[METADATA] = json.dumps(metadata, allow_nan=False)
    return write_bytes(path, content.getbuffer())


def read_metadata(path) -> dict:
    """Return the metadata of a model file after a check of its digest, without Keras.

    Raises the errors of `read_model`.
    """
    return _read(Path(path))[2]


def read_model(path):
    """Read a model file. Returns (network, spec, metadata).

    The network is a `StoredNetwork` if it is a far-field network, otherwise a `keras.Model`. The spec is the definition
    of its images. Raises FileNotFoundError if there is no file, and ModelFileError if it is not a complete model file
    of this package.
    """
    network, spec, metadata = _read(Path(path))
    model = network if isinstance(spec, FarFieldSpec) else network.build()
    try:
        _check_fit(model, spec, metadata["box"])
    except ValueError as error:
        raise ModelFileError(f"{path}: {error}") from None
    return model, spec, metadata


def spec_of(metadata: dict) -> ImageSpec | FarFieldSpec:
    """Return the spec in the metadata of a file. Raises ValueError naming the field if they have no valid spec."""
    kind = FarFieldSpec if metadata["spec"].get("kind") == "far field" else ImageSpec
    spec, multiple = kind.from_dict(metadata["spec"]), metadata["coarsening"]
    expect(multiple == spec.multiple, f"coarsening: expected {spec.multiple}, got {multiple!r}")
    return spec


def _check_fit(model, spec: ImageSpec | FarFieldSpec, box) -> None:
    """Raise ValueError if the network does not fit the spec (`check_network`), or has a fixed size and no box.

    box: [width, height] of the network's only box, m, or None.
    """
    check_network(model, spec)
    if isinstance(spec, ImageSpec):
        n = model.input_shape[1:3]
        expect(box is not None or None in n, f"box: expected [width, height] for a network of {n} nodes, got none")


def check_network(model, spec: ImageSpec | FarFieldSpec) -> None:
    """Raise ValueError unless the network takes the spec's images and gives its targets.

    A far-field network is judged by its weights, any other network by its input and output shapes. The output of a
    network that takes images of one size only may be flat. A side that is None fits any number of nodes.
    """
    if isinstance(spec, FarFieldSpec):
        weights, expected = weights_of(model), "expected the layers of architectures.far_field"
        return expect(is_far_field(weights), f"model_weights: {expected}, got {', '.join(weights)}")
    inputs, outputs = model.input_shape, model.output_shape
    channels, targets = len(spec.channels), len(spec.targets)
    fits = isinstance(inputs, tuple) and len(inputs) == 4 and inputs[3] == channels
    expected = f"expected an input of shape (None, n_y, n_x, {channels}) for {', '.join(spec.channels)}"
    expect(fits, f"channels: {expected}, got {inputs}")
    n_y, n_x = sides = inputs[1:3]
    shape = outputs if isinstance(outputs, tuple) else ()
    is_flat = None not in sides and shape[1:] == (n_y * n_x * targets,)
    same = all(None in pair or pair[0] == pair[1] for pair in zip(shape[1:3], sides))
    fits = is_flat or (len(shape) == 4 and same and shape[3] == targets)
    expected = f"expected an output of shape (None, {n_y or 'n_y'}, {n_x or 'n_x'}, {targets})"
    expect(fits, f"targets: {expected} for {', '.join(spec.targets)}, got {outputs}")


# ---- Keras's configuration, reduced to the fields that every supported version of Keras reads ----


def portable(config) -> dict:
    """Return a network's configuration, reduced to the fields that every supported version of Keras reads.

    Raises ValueError unless all its layers and activations are in the lists at the top of this module.
    """
    kind, inner = _class_and_config(config, "model_config")
    expect(kind in _NETWORKS, f"model_config: expected one of {', '.join(_NETWORKS)}, got {kind!r}")
    layers = inner.get("layers")
    fits = isinstance(layers, list) and layers
    expect(fits, f"model_config: expected a list of layers, got {type(layers).__name__}")
    kept = {key: inner[key] for key in _NETWORKS[kind] if key in inner}
    kept["layers"] = [_layer(layer, f"model_config.layers[{i}]") for i, layer in enumerate(layers)]
    return {"class_name": kind, "config": kept}


def _class_and_config(part, where: str) -> tuple:
    config = part.get("config") if isinstance(part, dict) else None
    expect(isinstance(config, dict), f"{where}: expected an object with a config, got {str(part)[:200]}")
    return part.get("class_name"), config


def _layer(layer, where: str) -> dict:
    """Return a layer's configuration with the arguments of `_ARGUMENTS` only.

    where: place of the layer in the configuration, for messages. Raises ValueError unless it is a layer of `_LAYERS`.
    """
    (kind, config), module = _class_and_config(layer, where), layer.get("module", "keras.layers")
    stock = kind in _LAYERS and module == "keras.layers" and layer.get("registered_name") in (None, kind)
    expected = "a stock Keras layer of the list, no custom or Lambda layer"
    expect(stock, f"{where}: expected {expected}, got {kind!r} of {module!r}")
    kept = {"class_name": kind, "config": {key: config[key] for key in config if key in _ARGUMENTS}}
    kept |= {key: layer[key] for key in ("name", "inbound_nodes") if key in layer}
    _check_parts([kept["config"], kept.get("inbound_nodes")], where)
    return kept


def _check_parts(value, where: str) -> None:
    """Raise ValueError if a layer's arguments contain a class other than Keras's L2, or an unknown activation.

    value: the arguments, or a part of them. where: place of the layer in the configuration, for messages.
    """
    if isinstance(value, dict):
        kind, module = value.get("class_name"), value.get("module")
        stock = module == "keras.regularizers" and kind == "L2" and not value.get("registered_name")
        stock = stock or kind in (None, "__keras_tensor__")
        expect(stock, f"{where}: expected stock parts, got {kind!r} of {module!r}")
        activation = value.get("activation")
        expect(activation in _ACTIVATIONS, f"{where}.activation: expected a stock one, got {activation!r}")
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _check_parts(item, where)


# ---- the contents of a file ----


def _read(path: Path) -> tuple[StoredNetwork, ImageSpec | FarFieldSpec, dict]:
    """Return the network, the spec and the metadata of a file, after a check of its digest."""
    if not path.exists():
        raise FileNotFoundError(f"model file: {path} does not exist")
    with hdf5.opened(path, ModelFileError) as file:
        text = hdf5.attribute(file, "model_config")
        config = portable(_parsed(text, "model_config"))
        group, metadata = hdf5.member(file, "model_weights"), _metadata(file)
        expect(isinstance(group, h5py.Group), f"model_weights: expected the network's weights, got {group}")
        datasets = _datasets(group)
        whole = _digest(text, datasets, metadata) == metadata["digest"]
        expect(whole, "digest: expected that of the file's contents, got another; it was changed or damaged")
        for name, array in datasets.items():
            bad = array[~np.isfinite(array)]
            expect(not bad.size, f"model_weights/{name}: expected finite weights, got {bad[:1]}")
        weights = {}
        for layer in group:
            names = [n.decode() if isinstance(n, bytes) else n for n in hdf5.attribute(group[layer], "weight_names")]
            if names:
                weights[layer] = [np.asarray(datasets[f"{layer}/{n}"], np.float32) for n in names]
        return StoredNetwork(path, config, weights), spec_of(metadata), metadata


def _parsed(text, name):
    try:
        return json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{name}: expected JSON, got {str(text)[:60]!r}") from error


def _metadata(file) -> dict:
    way = "LearnedModel(source=keras.models.load_model(…), spec=ImageSpec(…)) takes a network of your own"
    expect(METADATA in file, f"{METADATA}: expected our metadata, got a file without; {way}")
    text = hdf5.dataset(file, METADATA)
    expect(text.shape == (), f"{METADATA}: expected one text, our metadata, got shape {text.shape}")
    metadata = _parsed(text[()], METADATA)
    got = sorted(metadata) if isinstance(metadata, dict) else type(metadata).__name__
    expect(got == sorted(_FIELDS), f"{METADATA}: expected the fields {', '.join(_FIELDS)}, got {got}")
    box = metadata["box"]
    is_size = isinstance(box, list) and len(box) == 2 and all(isinstance(x, (int, float)) and x > 0 for x in box)
    expect(metadata["format"] == FORMAT, f"format: expected {FORMAT}, got {metadata['format']!r}")
    expect(box is None or is_size, f"box: expected null or [width, height] in m, got {box!r}")
    for name in ("spec", "card"):
        expect(isinstance(metadata[name], dict), f"{name}: expected an object, got {metadata[name]!r}")
    return metadata


def _datasets(group) -> dict[str, np.ndarray]:
    """Return all datasets below a group: name -> array, ordered by name.

    Raises ValueError if the arrays would be larger than the file.
    """
    arrays = hdf5.read(hdf5.datasets(group), group.file.id.get_filesize())
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def _digest(config, datasets: dict[str, np.ndarray], metadata: dict) -> str:
    """Return the SHA-256 of the configuration, the weights with their names, and the metadata without "digest"."""
    sha = hashlib.sha256(config if isinstance(config, bytes) else str(config).encode())
    for name, array in datasets.items():
        sha.update(f"{name} {array.dtype} {array.shape}".encode())
        sha.update(array.tobytes())
    rest = {name: value for name, value in metadata.items() if name != "digest"}
    sha.update(json.dumps(rest, sort_keys=True, allow_nan=False).encode())
    return sha.hexdigest()
