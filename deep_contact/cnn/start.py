"""Starts that a network predicts (section 5.4, Algorithm 7). A start is the impulses from which the solver begins.

Tests: tests/cnn/test_inference.py, tests/cnn/test_far_field.py, tests/studies/test_no_past.py
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deep_contact.starts.classical import FromProblem
from deep_contact.starts.support import supported
from deep_contact.state.state import State
from deep_contact.stepping.problem import StepProblem

if TYPE_CHECKING:
    from deep_contact.cnn.inference import LearnedModel


@dataclass(frozen=True)
class Cnn(FromProblem):
    """A start that a network predicts (the thesis's CNN-Model, Algorithm 7), projected on λ_n ≥ 0 and |λ_t| ≤ μ λ_n.

    model: a `LearnedModel`, or the path or name of a model file, which is read again only if it changes. None is our
    copy of the thesis's network (the start "cnn"), which takes the thesis's box of 30 m × 30 m only. "far field" is our
    network, which corrects the impulses of the step before, in any box.
    """

    model: LearnedModel | str | Path | None = None

    def __post_init__(self):
        from deep_contact.cnn.inference import model_of

        object.__setattr__(self, "model", model_of(self.model))

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        return self.model.predict(state, problem=problem)


@dataclass(frozen=True)
class FarFieldNoPast(Cnn):
    """The start `Support`, corrected by a far-field network, for contacts without impulses of a step before.

    If the contacts have such impulses, the start `Builtin` is better. model: as for `Cnn`, a far-field network that was
    trained to correct the start `Support`.
    """

    model: LearnedModel | str | Path | None = "far field, no past"

    def __post_init__(self):
        from deep_contact.cnn.inference import FarFieldModel
        from deep_contact.cnn.model_file import ModelFileError

        super().__post_init__()
        if not isinstance(self.model, FarFieldModel):
            raise ModelFileError(f"model: expected a far-field network, got one for {self.model.spec.targets}")

    def from_problem(self, state: State, solver, problem: StepProblem) -> tuple[np.ndarray, np.ndarray]:
        impulses = np.column_stack(supported(state, problem))
        if not impulses.any():
            return tuple(impulses.T.copy())
        return super().from_problem(state, solver, problem._replace(rows=problem.rows._replace(impulse=impulses)))
