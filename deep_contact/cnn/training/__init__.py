"""Training of a network (section 5.3 of the thesis): the function `train`, and its settings, `TrainingConfig`.

`config` has the settings. `run` has `train`. `network` has the base class of training runs, and its subclass for
networks on images. The base class writes checkpoints and the history. `far_field_run` trains the far-field network
through the solver. `curve` draws the history. `run`, `network` and `far_field_run` import TensorFlow.
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

# On a processor without AVX-512, oneDNN's convolutions are not TensorFlow's default. There they train the thesis's
# network in 0.7 of the default's time. But the default predicts a single state sooner.
os.environ.setdefault("TF_ENABLE_ONEDNN_OPTS", "1")
