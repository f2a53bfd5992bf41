"""A trained network at work: `load_model`, `LearnedModel.predict`, and the start that it gives the solver, `Cnn`.

TensorFlow is imported here and when it is first needed. A network is compiled once for each size of image; there is
no retracing, and the overhead of `keras.Model.predict` is not paid.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from deep_contact.cnn.convolution import Program, supports
from deep_contact.cnn.far_field import Description, FarFieldSpec, correct, describe
from deep_contact.cnn.images import ImageSpec, input_image, read_back
from deep_contact.cnn.model_file import ModelFileError, default_model_path, read_model
from deep_contact.physics.contact_solver import projected
from deep_contact.physics.engine import solve
from deep_contact.physics.solvers import PGS
from deep_contact.state import State

_SAME_BOX = 1e-6
"""A box may differ by so much from the one a network of fixed size was made for, relative."""


def limit_threads(count: int) -> None:
    """Let TensorFlow use so many threads, for all networks of this process. Before the first one is used.

    Raises RuntimeError where TensorFlow is already at work with another number.
    """
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise ValueError(f"threads: expected an integer >= 1, got {count!r}")
    import tensorflow as tf

    threading = tf.config.threading
    if threading.get_intra_op_parallelism_threads() == count and threading.get_inter_op_parallelism_threads() == 1:
        return
    threading.set_intra_op_parallelism_threads(count)
    threading.set_inter_op_parallelism_threads(1)


def load_model(path=None) -> LearnedModel:
    """The model of a file; by default the one that is shipped, models/model.h5. No code in the file is run.

    Raises FileNotFoundError where there is none, `ModelFileError` (a ValueError) where it is damaged, foreign or
    changed, naming the field.
    """
    path = default_model_path() if path is None else Path(path)
    model, spec, metadata = read_model(path)
    kind = FarFieldModel if isinstance(spec, FarFieldSpec) else LearnedModel
    return kind(
        keras=model,
        spec=spec,
        card=metadata["card"],
        coarsening=metadata["coarsening"],
        box=None if metadata["box"] is None else tuple(metadata["box"]),
        path=path,
    )


@dataclass(frozen=True, kw_only=True)
class LearnedModel:
    """A network and what is needed to use it: state in, impulses at its contacts out.

    keras: the `keras.Model`. spec: what its images are made of. card: where it comes from, what it is worth.
    coarsening: it takes n = 1 (mod coarsening) nodes along an edge. box: (width, height) that a network of fixed size
    was made for, m, or None. path: the file it was read from, or None.
    """

    keras: object
    spec: ImageSpec
    card: dict = field(default_factory=dict)
    coarsening: int = 1
    box: tuple[float, float] | None = None
    path: Path | None = None
    _compiled: dict = field(default_factory=dict, init=False, repr=False, compare=False)

    def predict(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """(λ_n, λ_t) at the state's contacts as the network has them, (m,) each, N·s: not projected.

        Raises ModelFileError where the network does not fit the scene, ValueError where the state has no contacts
        found yet.
        """
        return read_back(self.predict_image(state), state, self.spec)

    def predict_image(self, state: State) -> np.ndarray:
        """The predicted image of impulses, float32, (n_y, n_x, targets), in the network's units."""
        self.check_scene(state)
        return self.run(input_image(state, self.spec))

    def run(self, image: np.ndarray) -> np.ndarray:
        """The network alone: image (n_y, n_x, channels) to image (n_y, n_x, targets), float32."""
        n_y, n_x = image.shape[:2]
        rows, columns = padded_shape((n_y, n_x), self.coarsening)
        return self._padded(image).reshape(rows, columns, -1)[:n_y, :n_x]

    def _padded(self, image: np.ndarray, *, one_program: bool = False) -> np.ndarray:
        """What the network makes of the image, padded to a size that it takes."""
        n_y, n_x = image.shape[:2]
        rows, columns = padded_shape((n_y, n_x), self.coarsening)
        if (rows, columns) != (n_y, n_x):
            image = np.pad(image, ((0, rows - n_y), (0, columns - n_x), (0, 0)))
        key = rows, columns
        if key not in self._compiled:
            shape = rows, columns, image.shape[2]
            self._compiled[key] = compiled(self.keras, shape, one_program=one_program)
        return self._compiled[key](image)

    def check_scene(self, state: State) -> None:
        """Raise ModelFileError naming the field unless the network can work on this scene."""
        spec, size = self.spec, self.keras.input_shape[1:3]
        if len(spec.targets) != 2:
            raise ModelFileError(f"targets: expected a network for normal and tangent impulses, got {spec.targets}")
        if None in size:
            return
        x_min, y_min, x_max, y_max = state.world.box
        extent = x_max - x_min, y_max - y_min
        if self.box is not None and not np.allclose(extent, self.box, rtol=_SAME_BOX, atol=0.0):
            raise ModelFileError(
                f"box: expected a scene of {self.box[0]:g} m × {self.box[1]:g} m, for which the network "
                f"was trained, got {extent[0]:g} m × {extent[1]:g} m"
            )
        shape = spec.shape(state.world)
        if shape != size:
            raise ModelFileError(f"shape: expected images of {size} nodes, the network's only size, got {shape}")


@dataclass(frozen=True, kw_only=True)
class FarFieldModel(LearnedModel):
    """A far-field network (`cnn.far_field`): what it predicts corrects Builtin's start, which the state holds.

    It runs in Numba (`cnn.convolution`), with the weights that it has when it meets a size of window for the first
    time; other layers than those of `architectures.far_field` run in TensorFlow.
    threads: at most so many work on it in Numba; the number changes no bit.
    """

    threads: int = 1

    def predict(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """(λ_n, λ_t) at the state's contacts, (m,) each, N·s: not projected."""
        return self.correct(state, describe(state, self.spec))

    def correct(self, state: State, description: Description) -> tuple[np.ndarray, np.ndarray]:
        """The same from a description that has been made already."""
        impulses = correct(self.run(description.image), description, self.spec)
        return np.ascontiguousarray(impulses[:, 0]), np.ascontiguousarray(impulses[:, 1])

    def predict_image(self, state: State) -> np.ndarray:
        """The predicted image of coefficients, float32, (rows, columns, 12): every second node of the window."""
        return self.run(describe(state, self.spec).image)

    def run(self, image: np.ndarray) -> np.ndarray:
        """The network alone: image (n_y, n_x, channels) to coefficients (rows, columns, 12), float32."""
        rows, columns = padded_shape(image.shape[:2], self.coarsening)
        if (rows, columns) not in self._compiled and supports(self.keras):
            self._compiled[rows, columns] = Program(self.keras, (rows, columns), threads=self.threads)
        # In TensorFlow one program takes three quarters of the time that one call for each layer does.
        return self._padded(image, one_program=True)

    def check_scene(self, state: State) -> None:
        """Any scene will do."""


def padded_shape(shape: tuple[int, int], coarsening: int) -> tuple[int, int]:
    """The next size up with n = 1 (mod coarsening) along both edges."""
    return tuple(n + (1 - n) % coarsening for n in shape)


def compiled(model, shape: tuple[int, int, int], *, one_program: bool = False) -> Callable[[np.ndarray], np.ndarray]:
    """The network for one image of this shape as a function of a NumPy array (n_y, n_x, c), float32.

    one_program: compiled by XLA as a whole, which takes about a second.
    """
    import keras

    if keras.backend.backend() != "tensorflow":
        return lambda image: keras.ops.convert_to_numpy(model(image[None], training=False))[0]
    import tensorflow as tf

    signature = [tf.TensorSpec((1, *shape), tf.float32)]
    # The concrete function skips the look-up by signature, a tenth of the time of a small network.
    jit = {"jit_compile": True} if one_program else {}
    function = tf.function(lambda image: model(image, training=False), input_signature=signature, **jit)
    concrete = function.get_concrete_function()
    return lambda image: concrete(tf.constant(image[None])).numpy()[0]


@dataclass(frozen=True)
class Cnn:
    """What a network predicts (the thesis's CNN-Model, Algorithm 7), projected on λ_n ≥ 0 and |λ_t| ≤ μ λ_n.

    model: a `LearnedModel`, the path of a model file, or None for the one that is shipped.
    """

    model: LearnedModel | str | Path | None = None

    def __post_init__(self):
        if not isinstance(self.model, LearnedModel):
            object.__setattr__(self, "model", load_model(self.model))

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        if state.contacts is not None and state.contacts.count == 0:
            return np.zeros(0), np.zeros(0)
        return projected(*self.model.predict(state), state.world.friction)


@dataclass(frozen=True)
class Guarded:
    """The far-field network where it helps: Builtin's start wherever that is good enough, or better by a trial.

    model: a `FarFieldModel`, or the path of its file; by default the one that is shipped.
    least: no network is asked where one relaxation of the rows after Builtin would change them by less than this
    share of the carried impulses (`Description.unsolved`), so that a resting pile pays next to nothing.
    trial: sweeps from both starts. The network's is taken unless its last θ is more than `margin` times that of
    Builtin's; 0 takes it untried. θ is a rough judge, so a start that is better in the mean gets the benefit of doubt.
    """

    model: FarFieldModel | str | Path | None = None
    least: float = 1e-2
    trial: int = 3
    margin: float = 2.0

    def __post_init__(self):
        model = self.model
        if not isinstance(model, LearnedModel):
            model = load_model(model)
        if not isinstance(model, FarFieldModel):
            raise ModelFileError(f"model: expected a far-field network, got one for {model.spec.targets}")
        object.__setattr__(self, "model", model)

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        contacts = state.contacts
        builtin = contacts.normal_start.copy(), contacts.tangent_start.copy()
        if contacts.count == 0:
            return builtin
        description = describe(state, self.model.spec)
        if description.unsolved < self.least:
            return builtin
        learned = projected(*self.model.correct(state, description), state.world.friction)
        if self.trial == 0:
            return learned
        tried = PGS(sweeps=self.trial, tolerance=None)
        theta = [solve(state, tried, *start).record.theta[-1] for start in (builtin, learned)]
        return learned if theta[1] <= self.margin * theta[0] else builtin


def network_file(path) -> Path:
    """A model file by its path, from the current folder or from the root of the checkout.

    Raises FileNotFoundError where there is none.
    """
    given = Path(path)
    for place in (given, Path(__file__).resolve().parents[2] / given):
        if place.is_file():
            return place
    raise FileNotFoundError(f"model file: expected {given}, which does not exist; `python scripts/train.py` makes one")


def one_thread() -> None:
    """Let TensorFlow use one thread in this process, and keep quiet, unless it is already at work."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    try:
        limit_threads(1)
    except RuntimeError:  # as it was set up by whoever used it first: the numbers stay the same, the times may not
        pass


def network_start(model: str) -> Cnn:
    """The start by the network of a file (Algorithm 7), working on one thread, read again only if the file changes.

    Raises FileNotFoundError where there is no such file, `ModelFileError` where it is damaged.
    """
    one_thread()
    return Cnn(known_model(network_file(model)))


def known_model(path: Path | None = None) -> LearnedModel:
    """`load_model`, but a file that this process has read and that has not changed since is not read again."""
    path = default_model_path() if path is None else path
    status = path.stat()
    return _read_once(path.resolve(), status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _read_once(path: Path, changed_ns: int, size: int) -> LearnedModel:
    return load_model(path)
