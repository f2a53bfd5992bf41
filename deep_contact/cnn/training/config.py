"""Settings of a training run. The import is light, so that `scripts/train.py --help` answers at once."""

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
    """Settings of a run. The defaults are those of the far-field network; `recipe` has those of the thesis's.

    The loss of the far-field network is the velocity error after `sweeps` sweeps, through the solver; that of the
    thesis's is the masked error of the image (Appendix B). Raises ValueError naming the field and the value.
    """

    architecture: str = "far field"
    options: dict = field(default_factory=dict)  # arguments of the network, for `architectures.build`
    spacing: float = 1.0  # of the images, m, or mean radii for the far-field network
    support: float = 1.0  # h of the splat, in the unit of the spacing
    sweeps: tuple[int, ...] = (3, 10, 30)  # numbers of sweeps after which errors count, increasing
    optimizer: str = "adam"  # with gradients of norm <= 1; or "sgd"; or "nesterov": sgd with momentum 0.9
    schedule: str = "cosine"  # one of `schedules.SCHEDULES`
    rate: float = 1.5e-3
    epochs: int = 30
    batch_size: int = 32
    states_per_epoch: int | None = None  # number drawn for an epoch; None: all
    validation_states: int = 1000  # about this number
    fractions: tuple[float, float, float] = (0.8, 0.1, 0.1)  # of the simulations: train, validation, test
    precision: str = "float32"  # or "mixed_bfloat16", of the layers of a network on images; its weights are float32
    seed: int = 0

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
        """The images of this run."""
        from deep_contact.cnn.far_field import FarFieldSpec
        from deep_contact.cnn.images import ImageSpec

        sizes = {"spacing": self.spacing, "support": self.support}
        return FarFieldSpec(**sizes) if self.architecture == "far field" else ImageSpec(**sizes)


_IMAGES = {"architecture": "thesis", "spacing": 0.5, "support": 0.5, "batch_size": 200, "epochs": 1000}
# Table 5.2: a fifth is held out. Of the other simulations an eighth is for the errors on the card.
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
"""Name -> settings of a training. The thesis and its authors' code differ; models/README.md has both, with sources."""


def recipe(name: str, **changes) -> TrainingConfig:
    """The settings of a recipe by its name in `RECIPES`, with changes; `options` are changed one by one.

    Raises ValueError naming the field and the value.
    """
    settings = RECIPES[one_of("recipe", name, RECIPES)]
    options = {**settings.get("options", {}), **changes.get("options", {})}
    return TrainingConfig(**(settings | changes | {"options": options}))


def config_of(metadata: dict, **changes) -> TrainingConfig:
    """The settings of the run that made a model file, with changes. metadata: of `model_file.read_metadata`.

    Raises ValueError where the file holds no settings.
    """
    stored = metadata["card"].get("config")
    if not isinstance(stored, dict):
        raise ValueError(f"card: expected the settings of the run that made the model, got {stored!r}")
    names, settings = {f.name for f in fields(TrainingConfig)}, {**stored, **metadata["spec"]}
    return TrainingConfig(**{name: value for name, value in settings.items() if name in names} | changes)
