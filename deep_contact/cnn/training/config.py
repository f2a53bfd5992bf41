"""Settings of a training run.

This module does not import TensorFlow, so that `scripts/train.py --help` answers at once.

Tests: tests/cnn/test_training.py
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

from deep_contact.cnn.schedules import SCHEDULES
from deep_contact.state.validation import integer, number, one_of

if TYPE_CHECKING:
    from deep_contact.cnn.far_field import FarFieldSpec
    from deep_contact.cnn.images import ImageSpec


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings of a training run.

    The defaults are for the far-field network. `recipe` also has the settings of the thesis's network. The loss of the
    far-field network is computed through the solver. It is the velocity error after some sweeps, relative to the error
    after the same number of sweeps from Builtin's start, the impulses of the step before. It is averaged over the
    numbers of sweeps in `sweeps`. The loss of the thesis's network is the masked squared error of the image (Appendix
    B). Raises ValueError naming the field and the value.
    """

    architecture: str = "far field"  # or "thesis"
    options: dict = field(default_factory=dict)  # arguments of the network for `architectures.build`
    spacing: float = 1.0  # spacing of the images' nodes, m; in mean radii for the far-field network
    support: float = 1.0  # support radius h of the splat, in the unit of the spacing
    sweeps: tuple[int, ...] = (3, 10, 30)  # numbers of sweeps after which the loss takes the error, ascending
    optimizer: str = "adam"  # with gradients clipped to norm 1; or "sgd"; or "nesterov", SGD with momentum 0.9
    schedule: str = "cosine"  # one of `schedules.SCHEDULES`
    rate: float = 1.5e-3  # learning rate that the schedule takes
    epochs: int = 30  # number of epochs
    batch_size: int = 32  # number of states in a batch
    states_per_epoch: int | None = None  # number of states drawn for an epoch; None: all
    validation_states: int = 1000  # approximate number of validation states
    fractions: tuple[float, float, float] = (0.8, 0.1, 0.1)  # shares of the simulations: training, validation, test
    precision: str = "float32"  # of the layers; or "mixed_bfloat16" for networks on images, with float32 weights
    seed: int = 0  # seed of the split, the first weights and the batches

    def __post_init__(self):
        one_of("architecture", self.architecture, ("thesis", "far field"))
        one_of("optimizer", self.optimizer, ("sgd", "nesterov", "adam"))
        one_of("schedule", self.schedule, SCHEDULES)
        precisions = ("float32",) if self.architecture == "far field" else ("float32", "mixed_bfloat16")
        one_of(f"precision of {self.architecture}", self.precision, precisions)
        for name in ("epochs", "batch_size", "validation_states", "states_per_epoch"):
            if getattr(self, name) is not None or name != "states_per_epoch":
                integer(name, getattr(self, name), 1)
        number("rate", self.rate, above=0)
        sweeps = tuple(self.sweeps)
        if not sweeps or list(sweeps) != sorted(set(sweeps)) or sweeps[0] < 0:
            raise ValueError(f"sweeps: expected increasing integers >= 0, got {self.sweeps!r}")
        object.__setattr__(self, "sweeps", sweeps)
        object.__setattr__(self, "fractions", tuple(map(float, self.fractions)))

    def spec(self) -> ImageSpec | FarFieldSpec:
        """Return the definition of the network's images in this run."""
        from deep_contact.cnn.far_field import FarFieldSpec
        from deep_contact.cnn.images import ImageSpec

        sizes = {"spacing": self.spacing, "support": self.support}
        return FarFieldSpec(**sizes) if self.architecture == "far field" else ImageSpec(**sizes)


_IMAGES = {"architecture": "thesis", "spacing": 0.5, "support": 0.5, "batch_size": 200, "epochs": 1000}
# Table 5.2 holds a fifth of the simulations out. An eighth of the others is the test set, for the errors on the card.
_IMAGES |= {"fractions": (0.7, 0.2, 0.1), "states_per_epoch": 18_200, "validation_states": 1700}

RECIPES = {
    "far field": {},
    "thesis": _IMAGES
    | {"optimizer": "sgd", "schedule": "scaled algorithm 6", "rate": 5e-3}
    | {"options": {"dropout": 0.1, "weight_decay": 1e-4, "rank": 170}},
    "authors' code": _IMAGES
    | {"optimizer": "nesterov", "schedule": "scaled appendix b", "rate": 0.05}
    | {"options": {"dropout": [0, 0, 0, 0, 0.25], "weight_decay": 1e-4, "rank": 170}},
}
"""Name of a recipe -> settings that differ from the defaults of `TrainingConfig`.

The thesis and its authors' code differ, and models/README.md has the settings of both, with sources.
"""


def recipe(name: str, **changes) -> TrainingConfig:
    """Return the settings of a recipe.

    name: one of `RECIPES`. changes: fields of `TrainingConfig` with other values. A change of `options` replaces only
    the entries that it names. Raises ValueError naming the field and the value.
    """
    settings = RECIPES[one_of("recipe", name, RECIPES)]
    options = {**settings.get("options", {}), **changes.get("options", {})}
    return TrainingConfig(**(settings | changes | {"options": options}))


def config_of(metadata: dict, **changes) -> TrainingConfig:
    """Return the settings of the run that made a model file.

    metadata: result of `model_file.read_metadata`. changes: fields of `TrainingConfig` with other values. Raises
    ValueError if the file has no settings.
    """
    stored = metadata["card"].get("config")
    if not isinstance(stored, dict):
        raise ValueError(f"card: expected the settings of the run that made the model, got {stored!r}")
    names, settings = {f.name for f in fields(TrainingConfig)}, {**stored, **metadata["spec"]}
    return TrainingConfig(**{name: value for name, value in settings.items() if name in names} | changes)
