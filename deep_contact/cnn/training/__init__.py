"""Training a network (section 5.3): `train`, and its settings, `TrainingConfig`.

The settings are in `config`, the driver with checkpoints and history in `run`, the networks on images, which Keras
trains, in `network`, and the far-field network, trained through the solver, in `far_field_run`. All but `config` load
TensorFlow.
"""

from importlib import import_module

from deep_contact.cnn.training.config import TrainingConfig, config_of, far_field_config, thesis_config

__all__ = ["Training", "TrainingConfig", "config_of", "far_field_config", "thesis_config", "train"]


def __getattr__(name: str):
    if name not in ("Training", "train"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.run"), name)
