"""A trained network at work: `load_model` and `LearnedModel.predict`, which the starts of `cnn.start` call.

The far-field network runs in Numba (`cnn.convolution`) from the weights in its file. Keras and TensorFlow are imported
only for networks on images, and for `LearnedModel.network`.
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
from deep_contact.state.state import State
from deep_contact.state.validation import brief, expect, list_of
from deep_contact.stepping.problem import StepProblem
from deep_contact.stepping.rows import projected

_compiling = RLock()
"""Lock of the thread that builds or traces a network, while others wait for the result."""


def load_model(path=None) -> LearnedModel:
    """The model of a file, or of a name in `models/registry.json`: "model", "far field", "far field, no past".

    The default is "model", the thesis's network, for the thesis's box of 30 m × 30 m. It needs Keras. The far-field
    networks need no Keras, and take any box. No code in the file is run. Raises FileNotFoundError where there is no
    file, ModuleNotFoundError where Keras is needed and missing, and `ModelFileError` (a ValueError) where the file is
    damaged, foreign or changed, naming the field.
    """
    path = network_file(path)
    network, spec, metadata = read_model(path)
    kind = FarFieldModel if isinstance(spec, FarFieldSpec) else LearnedModel
    box = None if metadata["box"] is None else tuple(metadata["box"])
    return kind(source=network, spec=spec, card=Card(metadata["card"]), box=box, path=path)


class Card(dict):
    """The origin of a network and its measured errors. Printing a card cuts long entries; `dict(card)` has all."""

    def __repr__(self) -> str:
        texts = ((name, repr(value)) for name, value in self.items())
        return "\n".join(f"{name}: {text if len(text) <= 100 else f'{text[:99]}…'}" for name, text in texts)


@by_value
@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LearnedModel:
    """A network and what is needed to use it: from a state to the impulses at its contacts.

    `predict` goes all the way. `input` and `impulses` are its two ends, for any Keras model between them:

        x = net.input(state)
        y = keras_model(x[None])
        normal, tangent = net.impulses(state, y)

    source: the network, any `keras.Model` with the spec's channels and targets; a far-field network as its file holds
    it. spec: the definition of its images. card: its origin and its errors. box: (width, height) of the only box that a
    network of fixed size takes, m, or None. path: the file that it was read from, or None.
    Raises ValueError naming the model, the shape that was expected and the one that it has.
    """

    source: object
    spec: ImageSpec
    card: dict = field(default_factory=dict)
    box: tuple[float, float] | None = None
    path: Path | None = None
    _compiled: dict = field(default_factory=dict, init=False, compare=False)

    def __post_init__(self):
        is_stored, has_shape = isinstance(self.source, StoredNetwork), hasattr(self.source, "input_shape")
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
        """The network as a `keras.Model`, built on first use."""
        with _compiling:
            if not isinstance(self.source, StoredNetwork):
                return self.source
            return vars(self).get("network") or self.source.build()

    def input(self, state: State) -> np.ndarray:
        """The image that the network takes, (n_y, n_x, channels), float32.

        Raises ModelFileError where the network does not fit the scene, ValueError where contacts have not been
        searched.
        """
        return self.seen(state)[0]

    def impulses(self, state: State, output, *, project: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """(λ_n, λ_t) at the state's contacts, (m,) each, N·s, from a network's output for `input(state)`.

        output: (n_y, n_x, targets), flat or not, with or without a batch of one. project: whether the impulses are
        projected on λ_n ≥ 0 and |λ_t| ≤ μ λ_n. Raises ValueError naming the shape that was expected and the one that
        came.
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
        """(λ_n, λ_t) at the state's contacts, (m,) each, N·s; for several states, a list of such pairs.

        project: whether the impulses are projected on λ_n ≥ 0 and |λ_t| ≤ μ λ_n. problem: the result of
        `step_problem(state)`, if it has been computed; a far-field network corrects the impulses of its rows. Raises
        the errors of `input`.
        """
        if not isinstance(state, State):
            states = list_of("state", State, state)
            return [self.predict(one, project=project) for one in states]
        if state.contacts is not None and state.contacts.count == 0:
            return np.zeros(0), np.zeros(0)
        image, read = self.seen(state, problem)
        return _cut(read(self.run(image)), state, project)

    def predict_image(self, state: State) -> np.ndarray:
        """The predicted image of impulses, or of a far-field network's coefficients: `run` of `input`."""
        return self.run(self.input(state))

    def run(self, image: np.ndarray) -> np.ndarray:
        """The network alone: image (n_y, n_x, channels) to image (n_y, n_x, targets), float32.

        A far-field network takes n = 1 (mod 8) nodes a side, and returns (rows, columns, 12), at every second node.
        Raises ValueError naming the shape that was expected and the one that came.
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
        """The network's input for a state, and the function from its output to (λ_n, λ_t)."""
        self._check_scene(state)
        return input_image(state, self.spec), lambda image: read_back(image, state, self.spec)

    def _output_shape(self, shape):
        takes = self.network.input_shape[1:]
        if len(shape) != 3 or any(side not in (None, nodes) for side, nodes in zip(takes, shape)):
            raise ValueError(f"{self._called()}: image: expected shape {takes}, got {shape}")
        return (*shape[:2], len(self.spec.targets))

    def _compile(self, shape, output):
        """The network for images of this shape, traced once, without the overhead of `keras.Model.predict`."""
        from deep_contact.cnn.backend import tensorflow as tf

        traced = tf.function(lambda image: self.network(image, training=False))
        # The concrete function skips the look-up by signature, a tenth of the time of a small network.
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
        """The model's file, architecture and size, its input and its output, in words."""
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
    """A far-field network (`cnn.far_field`), whose prediction corrects Builtin's start, which the state holds.

    A state without impulses of a step before gets a warning: `warm_start.FarFieldNoPast` predicts from positions alone.
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
    """Input and output of a network with this spec, in words."""
    sides, gives = "any number of nodes a side", f"images of {', '.join(spec.targets)}"
    if isinstance(spec, FarFieldSpec):
        sides, gives = "n = 8 k + 1 nodes a side", f"{len(spec.targets)} coefficients at every second node"
    if box is not None:
        sides = f"the nodes of a box of {box[0]:g} m × {box[1]:g} m"
    return {"takes": f"float32 images of {len(spec.channels)} channels, {sides}", "gives": gives}


def _cut(impulses, state: State, project: bool) -> tuple[np.ndarray, np.ndarray]:
    """(λ_n, λ_t) as arrays of their own, projected on the friction cone if `project`."""
    normal, tangent = (np.ascontiguousarray(row) for row in impulses)
    return projected(normal, tangent, state.world.friction) if project else (normal, tangent)


def model_of(model: LearnedModel | str | Path | None) -> LearnedModel:
    """The model itself, or that of a name or file as for `load_model`. A file is read again only if it has changed."""
    if isinstance(model, LearnedModel):
        return model
    path = network_file(model)
    status = path.stat()
    return _read_once(path.resolve(), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _read_once(path: Path, changed_ns: int, size: int) -> LearnedModel:
    return load_model(path)
