"""Chapters 4 and 5 of the thesis: images of states, data sets, networks, training and inference.

Each name of this package is imported when it is first used. Only `backend` imports Keras and TensorFlow. Networks on
images and the training of any network need them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.lazy import attach

if TYPE_CHECKING:
    from deep_contact.cnn import architectures as architectures
    from deep_contact.cnn import dataset as dataset
    from deep_contact.cnn import evaluation as evaluation
    from deep_contact.cnn import images as images
    from deep_contact.cnn import inference as inference
    from deep_contact.cnn import model_file as model_file
    from deep_contact.cnn import schedules as schedules
    from deep_contact.cnn import training as training
    from deep_contact.cnn.architectures import build as build
    from deep_contact.cnn.dataset import Store as Store
    from deep_contact.cnn.dataset import phase as phase
    from deep_contact.cnn.dataset import split_by_simulation as split_by_simulation
    from deep_contact.cnn.images import CHANNELS as CHANNELS
    from deep_contact.cnn.images import TARGETS as TARGETS
    from deep_contact.cnn.images import ImageSpec as ImageSpec
    from deep_contact.cnn.images import input_image as input_image
    from deep_contact.cnn.images import label_image as label_image
    from deep_contact.cnn.images import read_back as read_back
    from deep_contact.cnn.inference import LearnedModel as LearnedModel
    from deep_contact.cnn.inference import load_model as load_model
    from deep_contact.cnn.training.run import train as train
    from deep_contact.io.simulation_h5 import DataFileError as DataFileError
    from deep_contact.io.simulation_h5 import read_simulation as read_simulation
    from deep_contact.io.simulation_h5 import write_simulation as write_simulation

__getattr__, __dir__, __all__ = attach(__name__, __file__)
