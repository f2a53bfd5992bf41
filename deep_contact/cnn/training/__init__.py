"""Training a network (section 5.3): `train`, and its settings, `TrainingConfig`.

The settings are in `config`; `run` has the driver with checkpoints and history, and the training of networks on images
by Keras; `far_field_run` has the epochs of the far-field network, through the solver. All but `config` load TensorFlow.
"""

from deep_contact.cnn.training.config import TrainingConfig, config_of, far_field_config, thesis_config

_FROM_RUN = ("ImageDataset", "Training", "train")
__all__ = [*_FROM_RUN, "TrainingConfig", "config_of", "far_field_config", "thesis_config"]


def __getattr__(name: str):
    if name not in _FROM_RUN:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from deep_contact.cnn.training import run

    return getattr(run, name)
