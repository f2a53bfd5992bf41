"""Settings of a training run. The import is light, so that `scripts/train.py --help` answers at once."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

from deep_contact.cnn.schedules import SCHEDULES
from deep_contact.validation import integer, number, one_of

if TYPE_CHECKING:
    from deep_contact.cnn.far_field import FarFieldSpec
    from deep_contact.cnn.images import ImageSpec

ARCHITECTURES = ("thesis", "compact", "far field")
"""Names of `architectures.ARCHITECTURES`."""

FAR_FIELD_LOSSES = ("through solver", "residual through solver", "impulses")
LOSSES = ("appendix b", "velocity", "squared velocity", "impulse", *FAR_FIELD_LOSSES)
"""Of images: the first, and `losses.CONTACT_LOSSES`."""

OPTIMIZERS = ("sgd", "nesterov", "adam")

PRECISIONS = ("float32", "mixed_bfloat16")
"""Of the layers, by Keras's names. Weights, losses and model files are float32 with both."""


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings of a run. The defaults are those of the compact network; `thesis_config` has Table 5.2.

    | field                              | meaning                                                                     |
    |------------------------------------|-----------------------------------------------------------------------------|
    | architecture, options              | of `architectures.build`; channels and outputs follow from the images       |
    | channels                           | one of `images.CHANNEL_SETS`                                                |
    | spacing, support                   | of the images, m, or mean radii for the far-field network; None: 0.5, or 1  |
    | kernel, transfer, scale_free       | of `ImageSpec`                                                              |
    | inputs, correction                 | of `FarFieldSpec`                                                           |
    | measure_scales                     | divide channels by their root mean square on the training side, not by 1    |
    | loss                               | "appendix b" (masked, on images) or one of `losses.CONTACT_LOSSES`; for the |
    |                                    | far-field network the error after `sweeps` sweeps ("through solver"), the   |
    |                                    | change by one more sweep ("residual through solver", no labels), "impulses" |
    | sweeps                             | increasing numbers of sweeps of the losses through the solver               |
    | optimizer, momentum                | "adam", "sgd", or "nesterov", which is SGD by Eq 4.9; momentum of both      |
    | clip                               | largest norm of a gradient, or None                                         |
    | schedule, rate                     | of `schedules.schedule`                                                     |
    | epochs, batch_size, seed           |                                                                             |
    | patience                           | stop after so many epochs without a lower validation loss, or None          |
    | states_per_epoch                   | number of states drawn for an epoch, or None for all                        |
    | validation_states                  | about so many                                                               |
    | simulations                        | only the first so many, or None                                             |
    | fractions                          | of the simulations: train, validation, test                                 |
    | phases, augment                    | only these phases, None: all; turn and mirror the training states           |
    | precision                          | one of `PRECISIONS`; images only                                            |

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
    phases: tuple[str, ...] | None = None
    augment: bool = True
    sweeps: tuple[int, ...] = (3, 10, 30)
    inputs: str = "all"
    correction: bool = True
    precision: str = "float32"
    seed: int = 0

    def __post_init__(self):
        from deep_contact.cnn.dataset import PHASES
        from deep_contact.cnn.images import CHANNEL_SETS

        phases = PHASES if self.phases is None else tuple(self.phases)
        known = {"architecture": ARCHITECTURES, "channels": CHANNEL_SETS, "loss": LOSSES}
        known |= {"optimizer": OPTIMIZERS, "schedule": SCHEDULES, "precision": PRECISIONS}
        for name, values in known.items():
            one_of(name, getattr(self, name), values)
        for name in ("epochs", "batch_size", "validation_states", "patience", "states_per_epoch", "simulations"):
            if getattr(self, name) is not None or name in ("epochs", "batch_size", "validation_states"):
                integer(name, getattr(self, name), 1)
        number("rate", self.rate, above=0)
        number("clip", 1.0 if self.clip is None else self.clip, above=0)
        number("momentum", self.momentum, 0, below=1)
        if not phases or not set(phases) <= set(PHASES):
            raise ValueError(f"phases: expected among {', '.join(PHASES)}, got {self.phases!r}")
        if self.is_far_field != (self.loss in FAR_FIELD_LOSSES):
            names = ", ".join(FAR_FIELD_LOSSES)
            raise ValueError(f"loss: expected {names} for the far-field network and it alone, got {self.loss!r}")
        if self.is_far_field and self.precision != "float32":
            raise ValueError(f"precision: expected float32 for the far-field network, got {self.precision!r}")
        sweeps = tuple(self.sweeps)
        if not sweeps or list(sweeps) != sorted(set(sweeps)) or sweeps[0] < 0:
            raise ValueError(f"sweeps: expected increasing integers >= 0, got {self.sweeps!r}")
        settled = {"sweeps": sweeps, "fractions": tuple(map(float, self.fractions)), "phases": phases}
        for name in ("spacing", "support"):
            if getattr(self, name) is None:
                settled[name] = 1.0 if self.is_far_field else 0.5
        for name, value in settled.items():
            object.__setattr__(self, name, value)

    @property
    def is_far_field(self) -> bool:
        """Whether it is a run of the far-field network."""
        return self.architecture == "far field"

    def spec(self) -> ImageSpec | FarFieldSpec:
        """The images of this run, before scales are measured."""
        if self.is_far_field:
            from deep_contact.cnn.far_field import FarFieldSpec

            return FarFieldSpec(**{name: getattr(self, name) for name in _FAR_FIELD_FIELDS})
        from deep_contact.cnn.images import CHANNEL_SETS, ImageSpec

        images = {name: getattr(self, name) for name in _IMAGE_FIELDS}
        return ImageSpec(channels=CHANNEL_SETS[self.channels], **images)


_IMAGE_FIELDS = ("spacing", "support", "kernel", "transfer", "scale_free")
_FAR_FIELD_FIELDS = ("spacing", "support", "inputs", "correction")


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
        # Table 5.2: a fifth for validation. A test side is added for the reported errors.
        "fractions": (0.7, 0.2, 0.1),
        "augment": False,
    }
    return TrainingConfig(**(settings | changes))


def far_field_config(**changes) -> TrainingConfig:
    """The settings of the far-field network, trained through the solver."""
    return TrainingConfig(**({"architecture": "far field", "loss": "through solver", "rate": 1.5e-3} | changes))


def config_of(metadata: dict, **changes) -> TrainingConfig:
    """The settings of the run that made a model file, with changes. metadata: of `model_file.read_metadata`.

    Raises ValueError where the file does not hold them.
    """
    stored = metadata["card"].get("config")
    if stored is None:
        raise ValueError("card: expected the settings of the run that made the model, got none")
    images = _FAR_FIELD_FIELDS if metadata["spec"].get("kind") else _IMAGE_FIELDS
    settings = {f.name: stored[f.name] for f in fields(TrainingConfig) if f.name in stored}
    return TrainingConfig(**(settings | {name: metadata["spec"][name] for name in images} | changes))
