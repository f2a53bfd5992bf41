"""`plan`: a printable list of the features of the model that a run of a scene uses or leaves out.

The choices are those of `simulate`. Figure 6.7 has the costs of the stages of a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deep_contact.accuracy.presets import Accuracy
from deep_contact.accuracy.stiffness import SWEEPS, Stiffness, stiffness
from deep_contact.run.method import method_of
from deep_contact.solvers import PGS, BatchedPGS, describe
from deep_contact.starts.classical import Builtin, NoStart
from deep_contact.starts.names import Start
from deep_contact.state import html
from deep_contact.state.materials import in_scene
from deep_contact.state.state import State
from deep_contact.state.validation import one_of, suggesting
from deep_contact.stepping.inputs import leaves_tangents_out
from deep_contact.stepping.islands import islands_of
from deep_contact.stepping.prepare import ready


class Choice(NamedTuple):
    """Whether a run uses a feature of the model, and the reason in words."""

    used: bool
    why: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Solver, start and features of a run of a scene. `print` shows all of them.

    us: time of a step on the processor of the presets' study, μs, an upper bound if steps are solved to a tolerance;
    None if no preset chose the solver. choices: name of a feature of the model -> `Choice`. warnings: sentences that
    `simulate` warns of at the start of the run, because the preset may miss its tolerances.
    """

    scene: str
    n_bodies: int
    solver: object
    warm_start: str
    us: float | None
    choices: dict[str, Choice]
    warnings: tuple[str, ...] = ()

    def __getitem__(self, part: str) -> Choice:
        """Return the `Choice` of a feature, by its name. Raises ValueError with the names of all features."""
        return self.choices[one_of("part", part, self.choices)]

    def _title(self) -> str:
        most = "at most" if self.solver.tolerance else "about"
        price = "" if self.us is None else f", {most} {self.us:,.0f} μs a step"
        return f"{self.scene}: {self.n_bodies:,} circles, {describe(self.solver)} from {self.warm_start}{price}"

    def _rows(self) -> list[tuple[str, str, str]]:
        return [(part, "used" if used else "left out", why) for part, (used, why) in self.choices.items()]

    def __str__(self) -> str:
        width = max(map(len, self.choices))
        rows = (f"  {part:{width}s}  {used:8s}  {why}" for part, used, why in self._rows())
        return "\n".join([self._title(), *rows, *(f"  warning: {sentence}" for sentence in self.warnings)])

    def _repr_html_(self) -> str:
        rows = [*self._rows(), *(("warning", "", sentence) for sentence in self.warnings)]
        return html.shown(self._title(), rows, header=("part", "", "why"))


@suggesting
def plan(
    scene: State, *, solver=None, warm_start: Start = "builtin", accuracy: Accuracy | None = None, sleep: bool = False
) -> Plan:
    """Return the `Plan` of a run: the features that `simulate` uses and leaves out for a scene with these options.

    No step is done; contacts are detected if the scene has none. Arguments are those of `simulate`.
    Raises ValueError on arguments that do not fit each other.
    """
    scene = ready(scene)
    solver, start, name, decision = method_of(scene, solver, warm_start, accuracy, sleep=sleep)
    stiff = _stiffness(decision.stiff if decision else stiffness(scene), solver)
    choices = _of_the_scene(scene, solver) | _of_the_run(scene, solver, start, sleep) | {"solving stiff piles": stiff}
    of_scene = {"scene": scene.name, "n_bodies": scene.bodies.count}
    return Plan(
        **of_scene, solver=solver, warm_start=name, us=decision and decision.us, choices=choices,
        warnings=decision.warnings if decision else (),
    )  # fmt: skip


def _of_the_scene(scene: State, solver) -> dict[str, Choice]:
    tangents, friction = not leaves_tangents_out(scene, solver), in_scene(scene, scene.world.friction)
    low, high = friction.min(), friction.max()
    why = f"friction is {low:g}" if low == high else f"friction is {low:g} to {high:g}"
    if high == 0 and tangents:
        has_start = scene.contacts.tangent_start.any()
        why += ", but the state starts from tangent impulses" if has_start else f", but {describe(solver)} needs them"
    world, count = scene.world, len(scene.world.segments)
    moving = np.count_nonzero(np.reshape(world.segment_velocities, (-1, 4)).any(axis=1))
    surfaces = np.count_nonzero(world.surface_speeds)
    segments = f"the world has {count or 'none'}" + (f", {moving} of them move" if moving else "")
    segments += f", {surfaces} have a surface that moves" if surfaces else ""
    return {"tangent rows and spin": Choice(tangents, why), "segments": Choice(count > 0, segments)}


def _of_the_run(scene: State, solver, start, sleep: bool) -> dict[str, Choice]:
    asked = {True: "asked for", False: "not asked for"}
    islands, is_called = isinstance(solver, PGS) and solver.islands, not isinstance(start, (Builtin, NoStart))
    touching = len(np.unique(islands_of(scene)[scene.contacts.body_a]))
    least, most = solver.substeps, solver.substeps * solver.motion_parts
    substeps = f"{least} a step" + (f", up to {most} where something is about to hit" if most > least else "")
    corrected = f"at most {solver.position_sweeps} sweeps"
    return {
        "islands": Choice(islands, f"{asked[islands]}; {touching} of them touch something now"),
        "position correction": Choice(solver.position_sweeps > 0, f"{corrected}, none where nothing is deep"),
        "substeps": Choice(max(least, most) > 1, substeps),
        "batches of contacts": Choice(isinstance(solver, BatchedPGS), describe(solver)),
        "sleeping": Choice(bool(sleep), asked[bool(sleep)]),
        "calls between steps": Choice(is_called, f"{'every step calls' if is_called else 'no step calls'} the start"),
        "network": Choice(hasattr(start, "model"), f"the start is {type(start).__name__}"),
    }


def _stiffness(stiff: Stiffness | None, solver) -> Choice:
    if stiff is None or stiff.carried is not None:
        used = solver.tolerance is not None and solver.sweeps >= SWEEPS
    else:
        used = solver.substeps >= stiff.heap
    why = stiff.why if stiff else "nothing is too stiff for a few sweeps"
    return Choice(used, why if used or not stiff else f"{why}, but {describe(solver)} was asked for")
