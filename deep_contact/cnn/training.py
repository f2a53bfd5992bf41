"""Training: data by simulation, an epoch at a time, from wherever the last run was stopped.

A run is a folder:

| file        | holds                                                                                             |
|-------------|---------------------------------------------------------------------------------------------------|
| last.npz    | after every epoch: weights, optimizer, random state, history and settings; a run goes on from it   |
| best.h5     | the model file of the epoch with the lowest validation loss so far                                |
| history.csv | a line an epoch                                                                                   |
| model.h5    | at the end: the best one with its card                                                            |

Each file is replaced as a whole, and what an epoch does depends on nothing but last.npz, the settings and the data:
a run that is killed at any moment and started again gives the history of one that was not, to the last bit on the same
machine. At most the epoch at hand is lost.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.cnn import architectures, losses, schedules
from deep_contact.cnn.backend import keras
from deep_contact.cnn.dataset import PHASES, ImageBatches, Split, Store, fit_scales, split_by_simulation
from deep_contact.cnn.evaluation import held_out_errors
from deep_contact.cnn.far_field import FarFieldSpec, corrected, describe, nodes_of
from deep_contact.cnn.images import SOLVER_CHANNELS, THESIS_CHANNELS, ImageSpec, augment
from deep_contact.cnn.inference import Cnn, LearnedModel, limit_threads, load_model, padded_shape, projected
from deep_contact.cnn.losses import CONTACT_LOSSES, ContactBatch
from deep_contact.cnn.model_file import save_model
from deep_contact.cnn.through_solver import errors_after, impulse_loss, loss_and_gradient, solved_problem
from deep_contact.reporting.results import package_versions, processor, replacing
from deep_contact.warm_start import Builtin, NoStart

ops = keras.ops

CHANNEL_SETS = {
    "thesis": THESIS_CHANNELS,
    "solver": SOLVER_CHANNELS,
    "bodies and solver": ("mass", "velocity_x", "velocity_y", "spin", *SOLVER_CHANNELS),
}
"""Name -> input channels."""

FAR_FIELD_LOSSES = ("through solver", "residual through solver", "impulses")
LOSSES = ("appendix b", *CONTACT_LOSSES, *FAR_FIELD_LOSSES)
OPTIMIZERS = ("sgd", "adam")

COLUMNS = (
    "epoch",
    "rate",
    "loss",
    "validation_loss",
    "validation_velocity_error",
    "validation_impulse_error",
    "seconds",
)
"""Of history.csv. Errors: mean over states of the relative error before any sweep, projected. Through the solver
the last of them is the velocity error after the last number of sweeps, and the loss is over Builtin's."""

_LEARN_FROM, _JUDGE_BY = 0.02, 0.05
"""Least error of Builtin's start, relative, of a state that the far-field network learns from, or is judged by."""


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings of a run. The defaults are those of the compact network; `thesis_config` has Table 5.2.

    architecture, options: of `architectures.build`; channels and outputs follow from the spec.
    The far-field network has images of its own (`inputs`, `correction`: of `FarFieldSpec`), and losses of its own: on
    the errors after `sweeps` sweeps "through solver", on what one more sweep would change then ("residual through
    solver", without labels), or on "impulses".
    channels: one of `CHANNEL_SETS`. spacing, support, kernel, transfer, scale_free: of the `ImageSpec`; for the
    far-field network, the first two of its `FarFieldSpec`. None: 0.5 m, or 1 mean radius.
    measure_scales: divide each channel by its root mean square on the training side; if not, by 1.
    loss: "appendix b" (masked, on images), or one of `CONTACT_LOSSES` ("velocity" …).
    optimizer: "adam" or "sgd". momentum: of SGD. clip: largest norm of a gradient, or None.
    schedule, rate: of `schedules.schedule`. epochs, batch_size, seed. patience: stop after so many epochs without a
    lower validation loss, or None. states_per_epoch: as many by chance, or None for all. validation_states: about.
    simulations: only the first so many, or None. fractions: train, validation, test. phases: train on these only.
    augment: turn and mirror the training states.
    Raises ValueError naming the field and the value.
    """

    architecture: str = "compact"
    options: dict = field(default_factory=dict)
    channels: str = "bodies and solver"
    spacing: float | None = None
    support: float | None = None
    kernel: str = "poly6"
    transfer: str = "consistent"
    scale_free: bool = True
    measure_scales: bool = True
    loss: str = "velocity"
    optimizer: str = "adam"
    momentum: float = 0.0
    clip: float | None = 1.0
    schedule: str = "cosine"
    rate: float = 1e-3
    epochs: int = 30
    batch_size: int = 32
    patience: int | None = None
    states_per_epoch: int | None = None
    validation_states: int = 1000
    simulations: int | None = None
    fractions: tuple[float, float, float] = (0.8, 0.1, 0.1)
    phases: tuple[str, ...] = PHASES
    augment: bool = True
    sweeps: tuple[int, ...] = (3, 10, 30)
    inputs: str = "all"
    correction: bool = True
    seed: int = 0

    def __post_init__(self):
        for name in ("spacing", "support"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, 1.0 if self.architecture == "far field" else 0.5)
        for name, known in (
            ("architecture", architectures.ARCHITECTURES),
            ("channels", CHANNEL_SETS),
            ("loss", LOSSES),
            ("optimizer", OPTIMIZERS),
            ("schedule", schedules.SCHEDULES),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"{name}: expected one of {', '.join(known)}, got {getattr(self, name)!r}")
        for name in ("epochs", "batch_size", "validation_states"):
            _check_count(name, getattr(self, name))
        for name in ("patience", "states_per_epoch", "simulations"):
            if getattr(self, name) is not None:
                _check_count(name, getattr(self, name))
        for name in ("rate", "clip"):
            value = getattr(self, name)
            if not (value is None and name == "clip") and not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name}: expected a finite number > 0, got {value!r}")
        if not 0 <= self.momentum < 1:
            raise ValueError(f"momentum: expected a number from 0 to below 1, got {self.momentum!r}")
        strange = [name for name in self.phases if name not in PHASES]
        if strange or not self.phases:
            raise ValueError(f"phases: expected among {', '.join(PHASES)}, got {self.phases!r}")
        if (self.architecture == "far field") != (self.loss in FAR_FIELD_LOSSES):
            names = ", ".join(FAR_FIELD_LOSSES)
            raise ValueError(f"loss: expected {names} for the far-field network and it alone, got {self.loss!r}")
        sweeps = tuple(self.sweeps)
        if not sweeps or list(sweeps) != sorted(set(sweeps)) or sweeps[0] < 0:
            raise ValueError(f"sweeps: expected increasing integers >= 0, got {self.sweeps!r}")
        object.__setattr__(self, "sweeps", sweeps)
        object.__setattr__(self, "fractions", tuple(float(f) for f in self.fractions))
        object.__setattr__(self, "phases", tuple(self.phases))

    def spec(self) -> ImageSpec:
        """The images of this run, scales not measured yet."""
        return ImageSpec(
            spacing=self.spacing,
            support=self.support,
            kernel=self.kernel,
            transfer=self.transfer,
            channels=CHANNEL_SETS[self.channels],
            scale_free=self.scale_free,
        )


def thesis_config(**changes) -> TrainingConfig:
    """The thesis's settings: Table 5.2, Algorithm 6, Appendix B's loss; images d = h = 0.5 of bodies, not scaled."""
    settings = {
        "architecture": "thesis",
        "channels": "thesis",
        "transfer": "thesis",
        "scale_free": False,
        "measure_scales": False,
        "loss": "appendix b",
        "optimizer": "sgd",
        "clip": None,
        "schedule": "algorithm 6",
        "rate": 5e-3,
        "epochs": 1000,
        "batch_size": 200,
        # Table 5.2: a fifth for validation. What is reported needs a side of its own.
        "fractions": (0.7, 0.2, 0.1),
        "augment": False,
    }
    return TrainingConfig(**(settings | changes))


def far_field_config(**changes) -> TrainingConfig:
    """The settings of the far-field network, trained through the solver."""
    return TrainingConfig(**({"architecture": "far field", "loss": "through solver", "rate": 1.5e-3} | changes))


class Training(NamedTuple):
    """A finished run: history (a dict an epoch, keys `COLUMNS`), best epoch, model.h5's path and what it holds."""

    history: list[dict]
    best_epoch: int
    path: Path
    model: LearnedModel


def set_up(seed: int, threads: int | None = None) -> None:
    """Make what follows repeatable: seeds, deterministic kernels, number of threads. Before anything is built."""
    if keras.backend.backend() == "tensorflow":
        import tensorflow as tf

        if threads is not None:
            limit_threads(threads)
        tf.config.experimental.enable_op_determinism()
    keras.utils.set_random_seed(seed)


def strategy_for(config: TrainingConfig, devices: int):
    """TensorFlow's strategy for training on so many devices; None with another backend, which has one.

    Raises ValueError naming what was expected.
    """
    _check_count("devices", devices)
    if devices > 1 and config.architecture == "far field":
        raise ValueError(f"devices: expected 1 for the far-field network, whose loss is the solver's, got {devices}")
    if config.batch_size % devices:
        raise ValueError(f"batch_size: expected a multiple of the {devices} devices, got {config.batch_size}")
    if keras.backend.backend() != "tensorflow":
        if devices > 1:
            raise ValueError(f"devices: expected 1 with the backend {keras.backend.backend()}, got {devices}")
        return None
    import tensorflow as tf

    if devices == 1:
        return tf.distribute.get_strategy()
    found = tf.config.list_logical_devices("GPU") or tf.config.list_logical_devices("CPU")
    if len(found) < devices:
        raise ValueError(f"devices: expected at most the {len(found)} that TensorFlow sees, got {devices}")
    # Summed on one device, in the same order every time. The collectives of CPUs mix up those of batch normalisation.
    reduction = tf.distribute.ReductionToOneDevice()
    return tf.distribute.MirroredStrategy([device.name for device in found[:devices]], cross_device_ops=reduction)


def train(
    config: TrainingConfig,
    data,
    out,
    *,
    threads: int | None = None,
    devices: int = 1,
    command: str = "",
    held_out: int = 300,
    tensorboard=None,
    log: Callable[[str], None] | None = None,
    on_batch: Callable[[int, int], None] | None = None,
) -> Training:
    """Train until the epochs are done or patience is lost, from the run in `out` if there is one.

    data: a `Store` or its folder. out: folder of the run. threads: of TensorFlow (`limit_threads`), or None for as it
    is. devices: of TensorFlow (GPUs, else its logical CPUs) among which every batch is shared; a step is that of one
    device but for rounding and the masks of dropout. command: what to write into the card. held_out: number of test
    states for the card. tensorboard: folder for event files. log: gets a line an epoch; by default the progress goes
    to stderr.
    on_batch: called with (epoch, batch) before each batch.
    Raises ValueError where the run in `out` was started with other settings or data (`patience` may differ, and
    `epochs` unless the schedule is "cosine"), and for devices that are not there or cannot share the batches.
    """
    store = data if isinstance(data, Store) else Store(data)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    set_up(config.seed, threads)
    strategy = strategy_for(config, devices)
    sims = store.simulations[: config.simulations]
    split = split_by_simulation(sims, fractions=config.fractions, seed=config.seed)
    settings = json.loads(json.dumps({**asdict(config), "data": data_hash(store, sims)}))
    saved = _read_checkpoint(out / "last.npz", settings)
    if config.architecture == "far field":
        options = {name: getattr(config, name) for name in ("spacing", "support", "inputs", "correction")}
        run = _FarFieldRun(config, store, split, FarFieldSpec(**options))
    else:
        spec = saved.spec if saved is not None else config.spec()
        if saved is None and config.measure_scales:
            spec = fit_scales(store, split.train, spec, seed=config.seed)
        run = _ImageRun(config, store, split, spec, strategy)
    history = run.restore(saved) if saved is not None else []
    writer = _Tensorboard(tensorboard) if tensorboard else None
    progress = _Progress(config.epochs, log)

    def card(**more):
        known = {"command": command, "config": settings, "split": split._asdict(), "history": history}
        return run.card() | known | {"seconds": round(sum(line["seconds"] for line in history), 1)} | more

    best = min((line["validation_loss"] for line in history), default=math.inf)
    while len(history) < config.epochs and not _out_of_patience(history, config.patience):
        epoch, start = len(history), time.perf_counter()
        rate = schedules.schedule(config.schedule, epochs=config.epochs, rate=config.rate)(epoch)
        loss = run.epoch(epoch, rate, progress, on_batch)
        line = {"epoch": epoch, "rate": rate, "loss": loss, **run.validate()}
        line["seconds"] = round(time.perf_counter() - start, 2)
        if not math.isfinite(loss):
            raise FloatingPointError(f"loss: expected a finite number, got {loss} in epoch {epoch}; try a lower rate")
        history.append(line)
        # The best one first: killed between the two, the epoch is done again and gives the same.
        if line["validation_loss"] < best:
            best = line["validation_loss"]
            run.save(out / "best.h5", card())
        run.write_checkpoint(out / "last.npz", settings, history)
        _write_history(out / "history.csv", history)
        progress.line(line)
        if writer:
            writer.write(line)
    best_epoch = min(range(len(history)), key=lambda k: history[k]["validation_loss"])
    model = load_model(out / "best.h5")
    tested = held_out_states(store, split, held_out)
    starts = {"none": NoStart(), "builtin": Builtin(), "cnn": Cnn(model)}
    errors = held_out_errors((store.state(*state) for state in tested.tolist()), starts)
    more = {"best_epoch": best_epoch, "held_out": errors}
    save_model(out / "model.h5", model.network, run.spec, card(**more), coarsening=model.coarsening, box=run.box)
    return Training(history, best_epoch, out / "model.h5", load_model(out / "model.h5"))


def held_out_states(store: Store, split: Split, count: int) -> np.ndarray:
    """About `count` states (k, 2) of the test side, evenly taken."""
    states = store.states(split.test)
    return states[:: max(1, len(states) // max(count, 1))]


def compact_options(spec: ImageSpec) -> dict:
    """Options of `architectures.compact` that follow from the spec: which channels it may lean on."""
    place = spec.channels.index
    options = {}
    if "contact_density" in spec.channels:
        options["density"] = place("contact_density")
    starts = ["builtin_" + name.removesuffix("_impulse") for name in spec.targets]
    if all(name in spec.channels for name in starts):
        options["starts"] = [place(name) for name in starts]
    return options


def data_hash(store: Store, sims) -> str:
    """`Store.data_hash` of some simulations, from the digests that the files bear (each is checked as it is read)."""
    sha = hashlib.sha256()
    for sim in sims:
        sha.update(f"{sim} {store.info(sim).digest}\n".encode())
    return sha.hexdigest()


class _Run:
    """Network and optimizer of a run, and what is written of them."""

    config: TrainingConfig
    store: Store
    split: Split
    spec: ImageSpec | FarFieldSpec
    training_states: int

    def build(self, **options) -> None:
        """The network and its optimizer."""
        config = self.config
        self.coarsening = architectures.coarsening(config.architecture)
        self.model = architectures.build(
            config.architecture, channels=len(self.spec.channels), outputs=len(self.spec.targets), **options
        )
        if config.optimizer == "sgd":
            self.optimizer = keras.optimizers.SGD(config.rate, momentum=config.momentum, global_clipnorm=config.clip)
        else:
            self.optimizer = keras.optimizers.Adam(config.rate, global_clipnorm=config.clip)
        self.optimizer.build(self.model.trainable_variables)

    def batches_an_epoch(self, states: int) -> int:
        """How many batches an epoch has of so many states."""
        config = self.config
        wanted = states if config.states_per_epoch is None else min(states, config.states_per_epoch)
        if states < config.batch_size:
            raise ValueError(f"batch_size: expected at most the {states} states to train on, got {config.batch_size}")
        return max(1, wanted // config.batch_size)

    # ---- what is written ----

    def save(self, path, card: dict) -> None:
        save_model(path, self.model, self.spec, card, coarsening=self.coarsening, box=self.box)

    def card(self) -> dict:
        config = self.config
        return {
            "architecture": config.architecture,
            "options": dict(config.options),
            "parameters": int(self.model.count_params()),
            "trainable_parameters": int(sum(np.prod(v.shape) for v in self.model.trainable_variables)),
            "data_hash": data_hash(self.store, self.store.simulations[: config.simulations]),
            "training_states": self.training_states,
            "seed": config.seed,
            "versions": {**package_versions(), "python": sys.version.split()[0], "backend": keras.backend.backend()},
            "cpu": processor(),
        }

    def write_checkpoint(self, path: Path, settings: dict, history: list[dict]) -> None:
        arrays = {f"model_{i:04d}": ops.convert_to_numpy(v) for i, v in enumerate(self.model.variables)}
        arrays |= {f"optimizer_{i:04d}": ops.convert_to_numpy(v) for i, v in enumerate(self.optimizer.variables)}
        text = json.dumps({"settings": settings, "history": history, "spec": self.spec.to_dict()})
        with replacing(path) as temporary:
            # Uncompressed: weights do not shrink.
            with open(temporary, "wb") as file:
                np.savez(file, state=np.frombuffer(text.encode(), np.uint8), **arrays)

    def restore(self, saved: _Checkpoint) -> list[dict]:
        for prefix, variables in (("model", self.model.variables), ("optimizer", self.optimizer.variables)):
            for i, variable in enumerate(variables):
                variable.assign(saved.arrays[f"{prefix}_{i:04d}"])
        return saved.history


class _ImageRun(_Run):
    """A run whose network predicts images of impulses."""

    def __init__(self, config: TrainingConfig, store: Store, split: Split, spec: ImageSpec, strategy=None):
        self.config, self.store, self.split, self.spec = config, store, split, spec
        self.strategy = strategy or strategy_for(config, 1)
        self.devices = self.strategy.num_replicas_in_sync if self.strategy else 1
        wanted = None if set(config.phases) == set(PHASES) else config.phases
        self.batches = ImageBatches(
            store,
            split.train,
            spec,
            batch_size=config.batch_size,
            seed=config.seed,
            augment=config.augment,
            drop_last=True,
            states=store.states(split.train, phases=wanted),
        )
        self.training_states = len(self.batches.states)
        self.per_epoch = self.batches_an_epoch(self.training_states)
        chosen = store.states(split.validation)
        chosen = chosen[:: max(1, len(chosen) // config.validation_states)]
        self.validation = ImageBatches(
            store, split.validation, spec, batch_size=config.batch_size, shuffle=False, states=chosen
        )
        self.shape = self.batches.shape
        options = dict(config.options)
        if config.architecture == "thesis":
            options["shape"] = self.shape
            self.box = store.info(split.train[0]).header["world"].box
        else:
            self.box = None
            options = compact_options(spec) | options
        with self.strategy.scope() if self.strategy else nullcontext():
            self.build(**options)
        self.contact_loss = CONTACT_LOSSES.get(config.loss)
        self._step, self._predict = _compiled_steps(self)
        self._goes: dict[int, np.ndarray] = {}

    # ---- an epoch ----

    def epoch(self, epoch: int, rate: float, progress, on_batch) -> float:
        """Train on one epoch's batches. Returns the mean loss."""
        self.optimizer.learning_rate = rate
        states, symmetry = self.batches.order(epoch)
        total = 0.0
        for k in range(self.per_epoch):
            if on_batch is not None:
                on_batch(epoch, k)
            chosen = slice(k * self.config.batch_size, (k + 1) * self.config.batch_size)
            # A number at once: an epoch's losses must not depend on how they are added up later.
            total += float(self._step(*self.shares(states[chosen], symmetry[chosen])))
            progress.batch(epoch, k + 1, self.per_epoch, self.config.batch_size, total / (k + 1))
        return total / self.per_epoch

    def validate(self) -> dict[str, float]:
        """Loss and errors on the validation states: see `COLUMNS`."""
        totals, count = np.zeros(3), 0
        for batch in self.validation.epoch(0):
            inputs, labels, contacts = self.arrays(batch)
            images, loss = self._predict(inputs, labels, contacts)
            contacts = contacts if contacts is not None else self.contacts(batch)
            normal, tangent = ops.convert_to_numpy(losses.read_at_contacts(images, contacts)).T
            impulses = ops.convert_to_tensor(np.stack(projected(normal, tangent, contacts.friction), axis=1))
            errors = [f(impulses, contacts) for f in (losses.velocity_errors, losses.impulse_errors)]
            velocity, impulse = (float(np.mean(np.sqrt(ops.convert_to_numpy(squares)))) for squares in errors)
            size = len(batch.inputs)
            totals += size * np.array([float(loss), velocity, impulse])
            count += size
        loss, velocity, impulse = (totals / max(count, 1)).tolist()
        return {
            "validation_loss": loss,
            "validation_velocity_error": velocity,
            "validation_impulse_error": impulse,
        }

    def shares(self, states: np.ndarray, symmetry: np.ndarray) -> list[tuple]:
        """The arrays of a batch of states (B, 2), a part for each device."""
        parts = zip(np.split(states, self.devices), np.split(symmetry, self.devices))
        return [self.arrays(self.batches.batch(*part)) for part in parts]

    def arrays(self, batch) -> tuple:
        """(inputs padded to the network's size, labels, contacts or None) of an image batch."""
        n_y, n_x = self.shape
        rows, columns = padded_shape(self.shape, self.coarsening)
        inputs = batch.inputs
        if (rows, columns) != self.shape:
            inputs = np.pad(inputs, ((0, 0), (0, rows - n_y), (0, columns - n_x), (0, 0)))
        return inputs, batch.labels, self.contacts(batch) if self.contact_loss else None

    def contacts(self, batch) -> ContactBatch:
        """The contacts of an image batch."""
        parts = [losses.state_contacts(self.store.state(*state), self.spec) for state in batch.states.tolist()]
        turns = [(self._where(int(k)) if k else None, k >= 4) for k in batch.symmetry]
        return losses.contact_batch(parts, self.shape[0] * self.shape[1], self.spec, turns)

    def _where(self, k: int) -> np.ndarray:
        """Where each node of an image goes under symmetry k."""
        if k not in self._goes:
            count = self.shape[0] * self.shape[1]
            # Nodes up to 2²⁴ are exact in float32.
            number = np.arange(count, dtype=np.float32).reshape(*self.shape, 1)
            plain = self.spec.replace(targets=("normal_impulse",), target_scales=None)
            _, turned = augment(np.zeros((*self.shape, len(self.spec.channels)), np.float32), number, plain, k)
            goes = np.empty(count, np.int64)
            goes[turned.reshape(-1).astype(np.int64)] = np.arange(count)
            self._goes[k] = goes
        return self._goes[k]


class _FarFieldRun(_Run):
    """A run whose network corrects Builtin, trained through the solver."""

    def __init__(self, config: TrainingConfig, store: Store, split: Split, spec: FarFieldSpec):
        self.config, self.store, self.split, self.spec = config, store, split, spec
        self.box = None
        self.states = self._worth_solving(split.train, _LEARN_FROM)
        self.training_states = len(self.states)
        self.per_epoch = self.batches_an_epoch(self.training_states)
        chosen = self._worth_solving(split.validation, _JUDGE_BY)
        self.validation = chosen[:: max(1, len(chosen) // config.validation_states)]
        self.build(**config.options)
        # So that every number of sweeps counts alike, although the errors get smaller.
        errors = self.errors(self.validation, learned=False)[:, 1:]
        self.weights = 1.0 / (errors.mean(axis=0) * len(config.sweeps))
        self._coefficients, self._apply = self._compiled()

    def _worth_solving(self, sims, least: float) -> np.ndarray:
        """(k, 2) states of the simulations whose start by Builtin is off by more than a share."""
        found = [[sim, i] for sim in sims for i in np.flatnonzero(self.store.simulation(sim).start_errors() > least)]
        return np.array(found, dtype=np.int64).reshape(-1, 2)

    def _compiled(self):
        """(images, nodes, weights) -> coefficients (K, 12), differentiable; and gradients -> one step by them."""
        import tensorflow as tf

        signature = [
            tf.TensorSpec((None, None, None, len(self.spec.channels)), tf.float32),
            tf.TensorSpec((None, 4), tf.int32),
            tf.TensorSpec((None, 4), tf.float32),
        ]

        @tf.function(input_signature=signature)
        def coefficients(images, node, weight):
            nodes = tf.reshape(self.model(images, training=True), (-1, len(self.spec.targets)))
            return tf.reduce_sum(tf.gather(nodes, node) * weight[:, :, None], axis=1)

        # As one program: called one by one, the optimizer's small operations take as long as the network.
        @tf.function(input_signature=[[tf.TensorSpec(v.shape, tf.float32) for v in self.model.trainable_variables]])
        def apply(gradients):
            self.optimizer.apply(gradients, self.model.trainable_variables)

        return coefficients, apply

    def examples(self, states: np.ndarray, symmetry: np.ndarray):
        """(description, problem) of each of the states (k, 2), one after the other."""
        for state, k in zip(states.tolist(), symmetry.tolist()):
            found = self.store.state(*state)
            yield describe(found, self.spec, k), solved_problem(found)

    def arrays(self, descriptions):
        """(images, nodes, weights) of descriptions with windows of one shape, as `_compiled` takes them."""
        shape = descriptions[0].image.shape[:2]
        out = tuple((n - 1) // self.spec.coarsening + 1 for n in shape)
        read = [nodes_of(description, self.spec, out) for description in descriptions]
        node = np.concatenate([node + k * out[0] * out[1] for k, (node, _) in enumerate(read)]).astype(np.int32)
        return np.stack([d.image for d in descriptions]), node, np.concatenate([weight for _, weight in read])

    def epoch(self, epoch: int, rate: float, progress, on_batch) -> float:
        """Train on one epoch's states. Returns the mean loss."""
        config = self.config
        self.optimizer.learning_rate = rate
        rng = np.random.default_rng((config.seed, epoch))
        count = self.per_epoch * config.batch_size
        states = self.states[rng.permutation(len(self.states))[:count]]
        symmetry = rng.integers(0, 8, count) if config.augment else np.zeros(count, np.int64)
        total, done = 0.0, 0
        for k, batch in enumerate(_by_shape(self.examples(states, symmetry), config.batch_size)):
            if on_batch is not None:
                on_batch(epoch, k)
            total += self.step(batch)
            done += len(batch)
            progress.batch(epoch, done // config.batch_size, self.per_epoch, len(batch), total / done)
        return total / count

    def step(self, batch) -> float:
        """One step by examples with windows of one shape. Returns the sum of their losses."""
        import tensorflow as tf

        with tf.GradientTape() as tape:
            coefficients = self._coefficients(*self.arrays([description for description, _ in batch]))
        values = coefficients.numpy().astype(np.float64)
        by_coefficient, total, first = np.empty_like(values), 0.0, 0
        for description, problem in batch:
            own = slice(first, first + len(description.start))
            start = corrected(description, values[own])
            loss, gradient = self.loss_and_gradient(problem, start)
            by_coefficient[own] = np.einsum("ik,ijk->ij", gradient, description.features)
            total += loss
            first = own.stop
        # Over a full batch, so that a few states with a rare window do not count as much as a batch.
        given = tf.constant(by_coefficient / self.config.batch_size, tf.float32)
        self._apply(tape.gradient(coefficients, self.model.trainable_variables, output_gradients=given))
        return total

    def loss_and_gradient(self, problem, start) -> tuple[float, np.ndarray]:
        """The loss of one state by its start, and the gradient with respect to that."""
        if self.config.loss == "impulses":
            return impulse_loss(problem, start)
        measure = "velocity" if self.config.loss == "through solver" else "residual"
        weights = self.weights if measure == "velocity" else np.full(len(self.weights), 1 / len(self.weights))
        return loss_and_gradient(problem, start, self.config.sweeps, weights, measure)[:2]

    def errors(self, states: np.ndarray, *, learned: bool) -> np.ndarray:
        """Velocity errors (k, 1 + sweeps) after none and after each number of sweeps, from the network or Builtin."""
        sweeps = sorted({0, *self.config.sweeps})
        found = []
        for batch in _by_shape(self.examples(states, np.zeros(len(states), np.int64)), 64):
            descriptions, problems = zip(*batch)
            starts = [problem.rows.impulse for problem in problems]
            if learned:
                values = self._coefficients(*self.arrays(descriptions)).numpy().astype(np.float64)
                parts = np.split(values, np.cumsum([len(start) for start in starts])[:-1])
                starts = [corrected(description, part) for description, part in zip(descriptions, parts)]
            found += [errors_after(problem, start, sweeps) for problem, start in zip(problems, starts)]
        return np.array(found)[:, [0, *(sweeps.index(k) for k in self.config.sweeps)]]

    def validate(self) -> dict[str, float]:
        """Loss on the validation states, and the mean velocity error before any sweep and after the last."""
        errors = self.errors(self.validation, learned=True).mean(axis=0)
        return {
            "validation_loss": float(errors[1:] @ self.weights),
            "validation_velocity_error": float(errors[0]),
            "validation_impulse_error": float(errors[-1]),
        }


def _by_shape(examples, size: int):
    """Lists of up to `size` examples with windows of one shape, full ones first."""
    waiting: dict[tuple, list] = {}
    for example in examples:
        batch = waiting.setdefault(example[0].image.shape, [])
        batch.append(example)
        if len(batch) == size:
            yield waiting.pop(example[0].image.shape)
    yield from waiting.values()


class _Checkpoint(NamedTuple):
    arrays: dict[str, np.ndarray]
    history: list[dict]
    spec: ImageSpec | FarFieldSpec


def _read_checkpoint(path: Path, settings: dict) -> _Checkpoint | None:
    if not path.exists():
        return None
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    state = json.loads(arrays.pop("state").tobytes())
    # How long to go on may be thought over, but where the rates depend on it.
    free = {"patience"} if settings["schedule"] == "cosine" else {"patience", "epochs"}
    # A setting that is newer than the run had its default's effect then.
    started_with = json.loads(json.dumps(asdict(TrainingConfig()))) | state["settings"]
    for name, value in settings.items():
        if name not in free and started_with.get(name) != value:
            raise ValueError(
                f"{name}: expected {started_with.get(name)!r}, with which the run in {path.parent} was started, "
                f"got {value!r}; take another folder, or delete it"
            )
    kind = FarFieldSpec if state["spec"].get("kind") == "far field" else ImageSpec
    return _Checkpoint(arrays, state["history"], kind.from_dict(state["spec"]))


def _compiled_steps(run: _Run):
    """(step, predict): arrays of each device -> loss, having trained on them; arrays -> (images, loss)."""
    model, optimizer = run.model, run.optimizer
    n_y, n_x = run.shape
    rows, columns = padded_shape(run.shape, run.coarsening)
    targets = len(run.spec.targets)

    def forward(inputs, training):
        images = ops.reshape(model(inputs, training=training), (-1, rows, columns, targets))
        return images[:, :n_y, :n_x]

    def loss_of(images, labels, contacts):
        if contacts is not None:
            return run.contact_loss(losses.read_at_contacts(images, contacts), contacts)
        flat = (-1, n_y * n_x * targets)
        return ops.mean(losses.masked_squared_error(ops.reshape(labels, flat), ops.reshape(images, flat)))

    def penalized(images, labels, contacts):
        loss = loss_of(images, labels, contacts)
        return loss + sum(model.losses) if model.losses else loss

    backend = keras.backend.backend()
    if backend == "tensorflow":
        return _tensorflow_steps(run, forward, loss_of, penalized)
    if backend != "torch":
        raise RuntimeError(f"KERAS_BACKEND: expected tensorflow or torch for training, got {backend}")
    import torch

    def tensors(arrays):
        inputs, labels, contacts = arrays
        contacts = None if contacts is None else ContactBatch(*map(ops.convert_to_tensor, contacts))
        return ops.convert_to_tensor(inputs), ops.convert_to_tensor(labels), contacts

    def step(arrays):
        inputs, labels, contacts = tensors(arrays)
        model.zero_grad()
        loss = penalized(forward(inputs, True), labels, contacts)
        loss.backward()
        variables = model.trainable_variables
        with torch.no_grad():
            optimizer.apply([v.value.grad for v in variables], variables)
        return loss.detach()

    def predict(*arrays):
        inputs, labels, contacts = tensors(arrays)
        with torch.no_grad():
            images = forward(inputs, False)
            return images, loss_of(images, labels, contacts)

    return step, predict


def _tensorflow_steps(run, forward, loss_of, penalized):
    import tensorflow as tf

    model, optimizer = run.model, run.optimizer
    rows, columns = padded_shape(run.shape, run.coarsening)
    images = tf.TensorSpec((None, rows, columns, len(run.spec.channels)), tf.float32)
    labels = tf.TensorSpec((None, *run.shape, len(run.spec.targets)), tf.float32)
    contacts = None
    if run.contact_loss:
        # One signature for all batches, whatever their number of contacts: traced once.
        types = {name: tf.int32 if name in losses.INTEGER_FIELDS else tf.float32 for name in ContactBatch._fields}
        shapes = {name: (None,) if width is None else (None, width) for name, width in losses.FIELD_WIDTHS.items()}
        contacts = ContactBatch(*(tf.TensorSpec(shapes[name], types[name]) for name in ContactBatch._fields))
    signature = [images, labels, contacts] if contacts is not None else [images, labels]

    strategy, devices, width = run.strategy, run.devices, len(signature)
    normalizations = [layer for layer in model.layers if isinstance(layer, keras.layers.BatchNormalization)]
    if optimizer.global_clipnorm:
        optimizer.global_clipnorm /= devices  # of shares of the gradient: see below

    @tf.function(input_signature=signature * devices)
    def step(*arrays):
        def on_device():
            context = tf.distribute.get_replica_context()
            k = int(tf.get_static_value(context.replica_id_in_sync_group))
            inputs, labels, *contacts = arrays[k * width : (k + 1) * width]
            with tf.GradientTape() as tape:
                loss = penalized(forward(inputs, True), labels, contacts[0] if contacts else None) / devices
            # Keras's optimizer clips what it is given and adds up over the devices afterwards: it is given shares of
            # the sum.
            total = context.all_reduce(tf.distribute.ReduceOp.SUM, tape.gradient(loss, model.trainable_variables))
            optimizer.apply([gradient / devices for gradient in total], model.trainable_variables)
            return loss

        # Over the whole batch, while this is traced; a model file does not say on what it was trained.
        for layer in normalizations:
            layer.synchronized = devices > 1
        losses_of = strategy.run(on_device)
        for layer in normalizations:
            layer.synchronized = False
        return strategy.reduce(tf.distribute.ReduceOp.SUM, losses_of, axis=None)

    @tf.function(input_signature=signature)
    def predict(inputs, labels, contacts=None):
        images = forward(inputs, False)
        return images, loss_of(images, labels, contacts)

    def called(function, arrays):
        return function(*(x for x in arrays if x is not None))

    return lambda *parts: called(step, (x for part in parts for x in part)), lambda *arrays: called(predict, arrays)


def _out_of_patience(history: list[dict], patience: int | None) -> bool:
    if patience is None or not history:
        return False
    best = min(range(len(history)), key=lambda k: history[k]["validation_loss"])
    return len(history) - 1 - best >= patience


def _write_history(path: Path, history: list[dict]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(history)
    with replacing(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


class _Tensorboard:
    """Event files for TensorBoard: a scalar for each column of the history."""

    def __init__(self, folder):
        import tensorflow as tf

        self.tf, self.writer = tf, tf.summary.create_file_writer(str(folder))
        # What `tf.summary.scalar` writes, which itself wants the tensorboard package to be installed.
        self.metadata = tf.compat.v1.SummaryMetadata(plugin_data={"plugin_name": "scalars"}, data_class=1)

    def write(self, line: dict) -> None:
        with self.writer.as_default():
            for name in COLUMNS[1:]:
                value = self.tf.constant(line[name], self.tf.float32)
                self.tf.summary.write(name, value, step=line["epoch"], metadata=self.metadata)
        self.writer.flush()


class _Progress:
    """A live line on a terminal, a line an epoch elsewhere."""

    def __init__(self, epochs: int, log):
        self.epochs, self.log = epochs, log
        self.live = log is None and sys.stderr.isatty()
        self.start, self.seen, self.last = time.perf_counter(), 0, 0.0

    def batch(self, epoch, done, batches, size, loss):
        self.seen += size
        now = time.perf_counter()
        if not self.live or (now - self.last < 0.5 and done < batches):
            return
        self.last = now
        speed = self.seen / (now - self.start)
        left = ((self.epochs - epoch) * batches - done) * size / speed
        text = f"epoch {epoch + 1}/{self.epochs}  batch {done}/{batches}  loss {loss:.4g}  {speed:.0f} states/s"
        sys.stderr.write(f"\r{text}  at most {left / 60:.1f} min left \x1b[K")
        sys.stderr.flush()

    def line(self, line):
        text = (
            f"epoch {line['epoch'] + 1}/{self.epochs}  rate {line['rate']:.2g}  loss {line['loss']:.4g}  "
            f"validation {line['validation_loss']:.4g}  velocity error {line['validation_velocity_error']:.4g}  "
            f"impulse error {line['validation_impulse_error']:.4g}  {line['seconds']:.1f} s"
        )
        if self.log is not None:
            self.log(text)
        else:
            sys.stderr.write(f"\r{text}\x1b[K\n" if self.live else f"{text}\n")
            sys.stderr.flush()


def _check_count(name: str, value) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        raise ValueError(f"{name}: expected an integer >= 1, got {value!r}")
