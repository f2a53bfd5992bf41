"""A small perceptron on each contact that corrects Builtin's start: `warm_start="learned"`.

The far-field network (`cnn.far_field`) predicts an image of what is far. The error of a pile after some sweeps is
local, a few circles wide. So this one looks at a contact, its two bodies, and through them at their other contacts. For
each contact it predicts gates g (`perceptron.CORRECTIONS`) on impulses that the solver could apply there:

    λ = Π(λ_Builtin + Σ_j g_j c_j)

with the projection Π on λ_n ≥ 0 and |λ_t| ≤ μ λ_n. With g = 0 the start is Builtin's: what that carries from step to
step is corrected, not replaced. The inputs (`perceptron.INPUTS`) are relative velocities, and impulses over effective
masses, divided by the state's own scale. They stay the same if the scene is turned, mirrored or scaled, if its masses
or its time are, or if bodies or contacts are numbered in another order.

It is left out where it does not pay: if the share of Builtin's impulses that one relaxation would change (`unsolved`)
is below `least`. The share is taken from a sample of the contacts. It needs the velocities after Builtin's impulses,
which the solver needs anyway.

It runs inside the compiled steps (`PerContact.within`), in blocks of contacts, in float32 (`perceptron`). What it is
worth, and what it is not: docs/starts.md.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.cnn import registry
from deep_contact.cnn.model_file import ModelFileError
from deep_contact.cnn.perceptron import (
    CORRECTIONS,
    HIDDEN,
    INPUTS,
    LearnedSettings,
    Perceptron,
    apply_corrected,
    described,
)
from deep_contact.physics.contact_solver import NORMAL, TANGENT, apply_impulses
from deep_contact.physics.engine import StepProblem, copy_rows, step_problem
from deep_contact.state import State
from deep_contact.validation import number

DEFAULT_MODEL = "per_contact"
"""Name of the shipped one in models/registry.json."""

FORMAT = 1


class Description(NamedTuple):
    """What training sees of a state.

    inputs: (m, 20), float32. corrections: (m, 8), N·s. unsolved: share of all contacts.
    """

    inputs: np.ndarray
    corrections: np.ndarray
    unsolved: float


# ---- the start ----


def describe(problem: StepProblem) -> Description:
    """The inputs and corrections of a contact problem in float64 with tangents, whose rows hold Builtin's impulses."""
    after = problem.solver_bodies.copy()
    apply_impulses(problem.rows, after)
    return Description(*described(problem.rows, problem.solver_bodies, after, problem.friction))


@dataclass(frozen=True)
class PerContact:
    """Builtin's start, corrected by a perceptron on each contact.

    model: a `Perceptron`, the path of its file, or None for the one that is shipped. least: share unsolved below which
    the start is Builtin's; by default the file's. Raises FileNotFoundError or `ModelFileError` on a bad file.
    """

    model: Perceptron | str | Path | None = None
    least: float | None = None
    network: Perceptron = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        network = self.model if isinstance(self.model, Perceptron) else load(self.model)
        if self.least is not None:
            network = network._replace(least=number("least", self.least, low=0))
        object.__setattr__(self, "network", network)

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        return self.from_problem(state, solver, step_problem(state))

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        """The start from rows that have been built; these stay as they are."""
        rows = copy_rows(problem.rows)
        if state.contacts.count:
            apply_corrected(self.within(()), rows, problem.friction, problem.solver_bodies.copy())
        return rows.impulse[:, NORMAL].copy(), rows.impulse[:, TANGENT].copy()

    def within(self, settings) -> LearnedSettings:
        """Settings with which compiled steps start as this does, without a return to Python between them."""
        return LearnedSettings(settings, self.network)


# ---- its file ----


def save(path: Path, network: Perceptron, card: dict) -> None:
    """Write a perceptron and its card as JSON. The digest tells damage from a new file."""
    found = {
        "format": FORMAT,
        "inputs": list(INPUTS),
        "corrections": list(CORRECTIONS),
        "least": float(network.least),
        "first": [[float(f"{w:.9g}") for w in row] for row in network.first],
        "second": [[float(f"{w:.9g}") for w in row] for row in network.second],
        "card": card,
    }
    found["digest"] = _digest(found)
    Path(path).write_text(json.dumps(found, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")


def load(path: Path | str | None = None) -> Perceptron:
    """The perceptron of a file, or of a name in models/registry.json; by default the shipped one.

    Raises FileNotFoundError where there is none, `ModelFileError` naming the field where it is damaged or foreign.
    """
    return _parsed(_file(path))[0]


def card_of(path: Path | str | None = None) -> dict:
    """How it was trained, and what it is worth. Errors as in `load`."""
    return _parsed(_file(path))[1]


def _file(path) -> Path:
    name = DEFAULT_MODEL if path is None else str(path)
    return registry.path_of(name) if name in registry.registered() else Path(name)


def _parsed(path: Path) -> tuple[Perceptron, dict]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ModelFileError(f"{path}: expected JSON, got {error}") from None
    expected = {"format": FORMAT, "inputs": list(INPUTS), "corrections": list(CORRECTIONS)}
    for name, value in expected.items():
        if not isinstance(found, dict) or found.get(name) != value:
            got = found.get(name) if isinstance(found, dict) else found
            raise ModelFileError(f"{path}: {name}: expected {value}, got {got}")
    if found.get("digest") != _digest(found):
        raise ModelFileError(f"{path}: digest: expected {_digest(found)}, got {found.get('digest')}")
    layers = [np.ascontiguousarray(found[name], np.float32) for name in ("first", "second")]
    shapes = [(len(INPUTS) + 1, HIDDEN), (HIDDEN + 1, len(CORRECTIONS))]
    for name, layer, shape in zip(("first", "second"), layers, shapes):
        if layer.shape != shape or not np.isfinite(layer).all():
            raise ModelFileError(f"{path}: {name}: expected finite weights of shape {shape}, got {layer.shape}")
    return Perceptron(*layers, float(found["least"])), found["card"]


def _digest(found: dict) -> str:
    rest = {name: value for name, value in found.items() if name != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
