"""Deep Contact: rigid contact made faster by learning where the solver should start.

The public names below are looked up when they are first used, so that `import deep_contact` costs next to nothing
and a job that predicts nothing never loads TensorFlow.
"""

from __future__ import annotations

import importlib

from deep_contact.version import VERSION as __version__

_HOME = {
    "deep_contact.state": ("Bodies", "Contacts", "State", "World", "make_bodies"),
    "deep_contact.physics.scenes": (
        "circles_in_box",
        "column",
        "drifting_circles",
        "lattice_in_box",
        "single_body",
        "two_bodies",
    ),
    "deep_contact.physics.solvers": (
        "APGD",
        "BatchedPGS",
        "NNCG",
        "NesterovPGS",
        "PGS",
        "PSOR",
        "SoftSteps",
        "SymmetricPGS",
    ),
    "deep_contact.physics.exact": ("solve_exactly",),
    "deep_contact.cnn.inference": ("load_model",),
    "deep_contact.planning": ("plan",),
    "deep_contact.recommendation": ("recommend",),
    "deep_contact.simulation": ("simulate", "solve_contacts", "step"),
    "deep_contact.io.state_xml": ("read_state", "write_state"),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}
_MODULES = {
    "cnn": "deep_contact.cnn",
    "experiments": "deep_contact.studies.comparison",
    "figures": "deep_contact.reporting.figures",
    "peers": "deep_contact.studies.peers",
    "physics": "deep_contact.physics",
    "plotting": "deep_contact.reporting.plotting",
    "results": "deep_contact.reporting.results",
    "sph": "deep_contact.sph",
    "warm_start": "deep_contact.warm_start",
}

__all__ = [*_MODULE_OF, *_MODULES, "__version__"]


def __getattr__(name: str):
    if name in _MODULE_OF:
        return getattr(importlib.import_module(_MODULE_OF[name]), name)
    if name in _MODULES:
        return importlib.import_module(_MODULES[name])
    raise AttributeError(f"module 'deep_contact' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
