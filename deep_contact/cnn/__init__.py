"""Chapters 4 and 5 of the thesis: states as images, data, networks, training and inference.

A name is imported when it is first used. Keras and TensorFlow are imported in `backend` alone, for networks on images
and for training.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.io.lazy import attach

# ruff: noqa: F401
if TYPE_CHECKING:
    from deep_contact.cnn import architectures, dataset, evaluation, images, inference, model_file, schedules, training
    from deep_contact.cnn.architectures import build
    from deep_contact.cnn.dataset import Store, phase, split_by_simulation
    from deep_contact.cnn.images import CHANNELS, ImageSpec, input_image, label_image, read_back
    from deep_contact.cnn.inference import LearnedModel, load_model
    from deep_contact.cnn.training.run import train
    from deep_contact.io.simulation_h5 import DataFileError, read_simulation, write_simulation

__getattr__, __dir__, __all__ = attach(__name__, __file__)
