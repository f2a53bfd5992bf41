"""Chapters 4 and 5 of the thesis: states as images, data, networks, training and inference.

A module is imported when one of its names is first used. Keras and TensorFlow are imported in `backend` alone, for
networks on images and for training.
"""

from __future__ import annotations

import importlib

_MODULES = "architectures dataset evaluation images inference model_file schedules training".split()
_HOME = {
    ".architectures": "build",
    ".dataset": "Store split_by_simulation",
    ".images": "CHANNELS THESIS_CHANNELS ImageSpec input_image label_image read_back",
    ".inference": "Cnn LearnedModel load_model",
    ".training": "train",
    "..io.simulation_h5": "DataFileError phase read_simulation write_simulation",
}
"""Module -> its names that are public here."""

_MODULE_OF = {name: module for module, names in _HOME.items() for name in names.split()}
__all__ = [*_MODULE_OF, *_MODULES]


def __getattr__(name: str):
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(_MODULE_OF.get(name, f".{name}"), __name__)
    return getattr(module, name) if name in _MODULE_OF else module


def __dir__() -> list[str]:
    return sorted(__all__)
