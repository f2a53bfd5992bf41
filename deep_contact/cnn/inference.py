"""Inference with trained networks: `load_model` and `LearnedModel.predict`.

`cnn.start` calls them to predict the impulses from which the solver begins. The far-field network runs in Numba
(`cnn.convolution`) with the weights of its file. Keras and TensorFlow are imported only for the other networks, and for
the attribute `LearnedModel.network`.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from html import escape
from pathlib import Path
from threading import RLock
from typing import Any, overload

import numpy as np

from deep_contact.cnn.convolution import Program
from deep_contact.cnn.far_field import COARSENING, FarFieldSpec, correct, description_of
from deep_contact.cnn.images import ImageSpec, input_image, read_back
from deep_contact.cnn.model_file import ModelFileError, StoredNetwork, check_network, read_model, weights_of
from deep_contact.cnn.registry import network_file
from deep_contact.state.equality import by_value
from deep_contact.state.materials import at_contacts
from deep_contact.state.state import State
from deep_contact.state.validation import brief, expect, list_of
from deep_contact.stepping.problem import StepProblem
from deep_contact.stepping.rows import projected

_compiling = RLock()
"""Lock that a thread holds while it builds or compiles a network. Other threads wait for the result."""


def load_model(path=None) -> LearnedModel:
    """Read a trained network from a model file, and return it as a `LearnedModel`.

    path: path of the file, or a name in `models/registry.json`, which has "model", "far field" and "far field, no
    past". The default is "model", our copy of the thesis's network. It takes the thesis's box of 30 m × 30 m only, and
    needs Keras. The far-field networks take any box, and do not need Keras. No code in the file is run.
    Raises FileNotFoundError if there is no file, ModuleNotFoundError if Keras is needed and missing, and
    `ModelFileError` (a ValueError) naming the field if the file is damaged, changed or not of this package.
    """
    path = network_file(path)
    network, spec, metadata = read_model(path)
    kind = FarFieldModel if isinstance(spec, FarFieldSpec) else LearnedModel
    box = None if metadata["box"] is None else tuple(metadata["box"])
    return kind(source=network, spec=spec, card=Card(metadata["card"]), box=box, path=path)


class Card(dict):
    """The origin and the measured errors of a network. Printing a card shortens long entries; `dict(card)` does not."""

    def __repr__(self) -> str:
        texts = ((name, repr(value)) for name, value in self.items())
        return "\n".join(f"{name}: {text if len(text) <= 100 else f'{text[:99]}…'}" for name, text in texts)


@by_value
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LearnedModel:
    """A network that predicts the impulses at the contacts of a state.

    `predict` makes the prediction in one call. `input` and `impulses` are its first and its last step, for use with
    another Keras model in between:

        x = net.input(state)
        y = keras_model(x[None])
        normal, tangent = net.impulses(state, y)

    source: the network. It is any `keras.Model` with the spec's channels and targets, or a `StoredNetwork` for a
    far-field network. spec: the definition of the network's images. card: the network's origin and errors. box: (width,
    height) of the only box that a network of fixed size takes, m, or None. path: path of the file from which the
    network was read, or None.
    Raises ValueError naming the model, its shape and the expected shape.
    """

    source: object
    spec: ImageSpec
    card: dict = field(default_factory=dict)
    box: tuple[float, float] | None = None
    path: Path | None = None
    _compiled: dict = field(default_factory=dict, init=False, compare=False)

    def __post_init__(self):
        is_stored, has_shape = isinstance(self.source, StoredNetwork), _has_input_shape(self.source)
        if not (is_stored or has_shape) and hasattr(self.source, "layers"):
            hint = "a functional model has one, and a Sequential that begins with keras.Input"
            raise ValueError(f"source: expected a keras.Model with an input_shape, got {brief(self.source)}; {hint}")
        hint = "keras.models.load_model reads a file"
        expect(is_stored or has_shape, f"source: expected a keras.Model, got {brief(self.source)}; {hint}")
        is_spec = isinstance(self.spec, (ImageSpec, FarFieldSpec))
        expect(is_spec, f"spec: expected what its images are made of, such as ImageSpec(), got {brief(self.spec)}")
        if not is_stored:
            try:
                check_network(self.source, self.spec)
            except ValueError as error:
                raise ValueError(f"{self._called()}: {error}") from None

    @cached_property
    def network(self):
        """The network as a `keras.Model`, which is built when this attribute is first read."""
        with _compiling:
            if not isinstance(self.source, StoredNetwork):
                return self.source
            return vars(self).get("network") or self.source.build()

    def input(self, state: State) -> np.ndarray:
        """Return the network's input image for a state, (n_y, n_x, channels), float32.

        Raises ModelFileError if the network does not take the state's box, and ValueError if the state's contacts have
        not been searched.
        """
        return self.seen(state)[0]

    def impulses(self, state: State, output, *, project: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Return (λ_n, λ_t) at the state's contacts, (m,) each, N·s, from a network's output for `input(state)`.

        output: the network's output, (n_y, n_x, targets). It may be flattened, and may have a batch dimension of size
        1. project: whether the impulses are projected on λ_n ≥ 0 and |λ_t| ≤ μ λ_n. Raises ValueError naming the
        expected shape and the shape of `output`.
        """
        image, read = self.seen(state)
        shape, pixels = self._output_shape(image.shape), np.asarray(output, np.float32)
        if pixels.size != np.prod(shape):
            raise ValueError(f"output: expected shape {(1, *shape)}, got {pixels.shape}")
        return _cut(read(pixels.reshape(shape)), state, project)

    @overload
    def predict(
        self, state: State, *, project: bool = True, problem: StepProblem | None = None
    ) -> tuple[np.ndarray, np.ndarray]: ...

    @overload
    def predict(
        self, state: Iterable[State], *, project: bool = True, problem: StepProblem | None = None
    ) -> list[tuple[np.ndarray, np.ndarray]]: ...

    def predict(self, state, *, project=True, problem=None):
        """Predict the impulses (λ_n, λ_t) at a state's contacts, (m,) each, N·s.

        state: a `State`, or several states, for which a list of pairs (λ_n, λ_t) is returned. project: whether the
        impulses are projected on λ_n ≥ 0 and |λ_t| ≤ μ λ_n. problem: the result of `step_problem(state)`, if it has
        been computed; a far-field network corrects the impulses in the problem's rows. Raises the errors of `input`.
        """
        if not isinstance(state, State):
            states = list_of("state", State, state)
            return [self.predict(one, project=project) for one in states]
        if state.contacts is not None and state.contacts.count == 0:
            return np.zeros(0), np.zeros(0)
        image, read = self.seen(state, problem)
        return _cut(read(self.run(image)), state, project)

    def predict_image(self, state: State) -> np.ndarray:
        """Return the network's output image for a state: impulses, N·s, or the coefficients of a far-field network."""
        return self.run(self.input(state))

    def run(self, image: np.ndarray) -> np.ndarray:
        """Return the network's output image for an input image, (n_y, n_x, targets), float32.

        image: (n_y, n_x, channels). For a far-field network n_y and n_x have to be one more than a multiple of 8, and
        the output is at every second node, ((n_y + 1) / 2, (n_x + 1) / 2, 12). Raises ValueError naming the expected
        shape and that of `image`.
        """
        image = np.asarray(image, np.float32)
        if image.shape not in self._compiled:
            with _compiling:
                compiled = self._compiled.get(image.shape) or self._compile(
                    image.shape, self._output_shape(image.shape)
                )
                self._compiled[image.shape] = compiled
        return self._compiled[image.shape](image)

    def seen(self, state, problem=None):
        """Return the network's input image for a state, and the function that turns its output image into (λ_n, λ_t).

        problem: as for `predict`.
        """
        self._check_scene(state)
        return input_image(state, self.spec), lambda image: read_back(image, state, self.spec)

    def _output_shape(self, shape):
        takes = self.network.input_shape[1:]
        if len(shape) != 3 or any(side not in (None, nodes) for side, nodes in zip(takes, shape)):
            raise ValueError(f"{self._called()}: image: expected shape {takes}, got {shape}")
        return (*shape[:2], len(self.spec.targets))

    def _compile(self, shape, output):
        """Return a function (input image) -> output image, for images of one shape.

        TensorFlow traces the network once for each shape. So a call does not have the overhead of
        `keras.Model.predict`. shape: shape of the input image. output: shape of the output image.
        """
        from deep_contact.cnn.backend import tensorflow as tf

        traced = tf.function(lambda image: self.network(image, training=False))
        # A concrete function does not look up the signature, which would take a tenth of a small network's time.
        concrete = traced.get_concrete_function(tf.TensorSpec((1, *shape), tf.float32))
        gives = tuple(concrete.structured_outputs.shape)
        if None not in gives and np.prod(gives) != np.prod(output):
            expected = f"expected shape {(1, *output)} for an input of {(1, *shape)}"
            raise ValueError(f"{self._called()}: output: {expected}, got {gives}")
        return lambda image: concrete(tf.constant(image[None])).numpy().reshape(output)

    def _check_scene(self, state):
        spec, size = self.spec, self.network.input_shape[1:3]
        x_min, y_min, x_max, y_max = state.world.box
        extent, shape = (x_max - x_min, y_max - y_min), spec.shape(state.world)
        if None not in size and self.box and not np.allclose(extent, self.box, rtol=1e-6, atol=0.0):
            expected = f"a scene of {self.box[0]:g} m × {self.box[1]:g} m, for which the network was trained"
            got = f"got {extent[0]:g} m × {extent[1]:g} m"
            raise ModelFileError(f'box: expected {expected}, {got}; the network "far field" takes any box')
        if None not in size and shape != size:
            raise ModelFileError(
                f"{self._called()}: shape: expected images of {size} nodes, its only size, got {shape}"
            )

    def _called(self) -> str:
        """The model as errors name it: its file, or its name in Keras."""
        return f"model {getattr(self.source, 'name', '')!r}" if self.path is None else str(self.path)

    def describe(self) -> dict[str, str]:
        """Return a text for each property of the model: its file, architecture, size, input and output."""
        return {
            "model": "not in a file" if self.path is None else self.path.name,
            "architecture": str(self.card.get("architecture", "unknown")),
            "weights": f"{self.source.count_params():,}",
            **ends(self.spec, self.box),
        }

    def __repr__(self):
        return f"<{type(self).__name__} {'; '.join(map(': '.join, self.describe().items()))}>"

    def _repr_html_(self):
        rows = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in self.describe().items())
        return f"<table>{rows}</table>"


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FarFieldModel(LearnedModel):
    """A far-field network (`cnn.far_field`). It corrects impulses of the step before, which a state's contacts carry.

    `predict` warns if the contacts carry no such impulses. For such states `warm_start.FarFieldNoPast` predicts
    impulses from positions alone.
    """

    def predict(self, state, *, project=True, problem=None) -> Any:
        contacts = state.contacts if isinstance(state, State) and problem is None else None
        if contacts is not None and contacts.count and not contacts.have_past:
            hint = "expected impulses, which this network corrects, got none; warm_start.FarFieldNoPast needs none"
            warnings.warn(f"state.contacts: {hint}", stacklevel=2)
        return super().predict(state, project=project, problem=problem)

    def seen(self, state, problem=None):
        description = description_of(state, self.spec, problem=problem)
        return description.image, lambda image: correct(image, description).T

    def _output_shape(self, shape):
        channels = len(self.spec.channels)
        if len(shape) != 3 or shape[0] % 8 != 1 or shape[1] % 8 != 1 or shape[2] != channels:
            raise ValueError(f"image: expected shape (8 j + 1, 8 k + 1, {channels}), got {shape}")
        return (*((n - 1) // COARSENING + 1 for n in shape[:2]), len(self.spec.targets))

    def _compile(self, shape, output):
        return Program(weights_of(self.source), shape[:2])


def ends(spec: ImageSpec | FarFieldSpec, box=None) -> dict[str, str]:
    """Return a description of a network's input ("takes") and output ("gives") in words.

    box: (width, height) of the only box that the network takes, m, or None.
    """
    sides, gives = "any number of nodes a side", f"images of {', '.join(spec.targets)}"
    if isinstance(spec, FarFieldSpec):
        sides, gives = "n = 8 k + 1 nodes a side", f"{len(spec.targets)} coefficients at every second node"
    if box is not None:
        sides = f"the nodes of a box of {box[0]:g} m × {box[1]:g} m"
    return {"takes": f"float32 images of {len(spec.channels)} channels, {sides}", "gives": gives}


def _has_input_shape(network) -> bool:
    """Return whether a network knows the shape of its input; a Sequential of Keras 3.4 raises where it does not."""
    try:
        return hasattr(network, "input_shape")
    except ValueError:
        return False


def _cut(impulses, state: State, project: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return (λ_n, λ_t) as contiguous arrays, (m,) each, N·s, projected on the friction cone if `project` is true.

    impulses: λ_n and λ_t, (2, m), N·s.
    """
    normal, tangent = (np.ascontiguousarray(row) for row in impulses)
    return projected(normal, tangent, at_contacts(state, state.world.friction)) if project else (normal, tangent)


def model_of(model: LearnedModel | str | Path | None) -> LearnedModel:
    """Return a `LearnedModel`. model: the model itself, or a name or path as for `load_model`.

    A file is read again only if its time of change or its size has changed.
    """
    if isinstance(model, LearnedModel):
        return model
    path = network_file(model)
    status = path.stat()
    return _read_once(path.resolve(), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _read_once(path: Path, changed_ns: int, size: int) -> LearnedModel:
    return load_model(path)
