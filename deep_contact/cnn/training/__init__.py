"""Training a network (section 5.3): `train`, and its settings, `TrainingConfig`.

The settings are in `config`, the driver with checkpoints and history in `run`, the networks on images, which Keras
trains, in `network`, and the far-field network, trained through the solver, in `far_field_run`. All but `config` load
TensorFlow.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from deep_contact.lazy import attach

# ruff: noqa: F401
if TYPE_CHECKING:
    from deep_contact.cnn.training.config import RECIPES, TrainingConfig, config_of, recipe
    from deep_contact.cnn.training.run import Training, train

__getattr__, __dir__, __all__ = attach(__name__, __file__)

# oneDNN's convolutions train the thesis's network in 0.7 of the time on a processor without AVX-512, where they are not
# TensorFlow's default. Its default predicts a single state sooner.
os.environ.setdefault("TF_ENABLE_ONEDNN_OPTS", "1")
