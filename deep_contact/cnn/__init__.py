"""Chapters 4 and 5 of the thesis: states as images, data, networks, training and inference.

`images` and `dataset` know nothing of TensorFlow; the other modules load it when they are first used.
"""

from __future__ import annotations

import importlib

_HOME = {
    "deep_contact.cnn.architectures": ("build",),
    "deep_contact.cnn.inference": ("Cnn", "load_model"),
    "deep_contact.cnn.training": ("train",),
    "deep_contact.cnn.images": (
        "CHANNELS",
        "SOLVER_CHANNELS",
        "THESIS_CHANNELS",
        "ImageSpec",
        "augment",
        "image_pair",
        "input_image",
        "label_image",
        "read_back",
        "state_scale",
        "symmetries",
        "transform_state",
    ),
    "deep_contact.cnn.dataset": (
        "DataFileError",
        "ImageBatches",
        "Store",
        "fit_scales",
        "phase",
        "read_simulation",
        "split_by_simulation",
        "write_simulation",
    ),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}
_MODULES = (
    "architectures",
    "dataset",
    "evaluation",
    "images",
    "inference",
    "losses",
    "model_file",
    "schedules",
    "training",
)

__all__ = [*_MODULE_OF, *_MODULES]


def __getattr__(name: str):
    if name in _MODULE_OF:
        return getattr(importlib.import_module(_MODULE_OF[name]), name)
    if name in _MODULES:
        return importlib.import_module(f"deep_contact.cnn.{name}")
    raise AttributeError(f"module 'deep_contact.cnn' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
