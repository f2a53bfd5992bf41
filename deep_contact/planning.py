"""What a run of a scene uses and what it leaves out: `plan`, made to be printed.

The choices are those that `simulate` makes. What each is worth, Figure 6.7 measured; its results come with the package.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.compiled.team import cores
from deep_contact.physics.engine import leaves_tangents_out
from deep_contact.physics.islands import islands_of
from deep_contact.physics.ready import ready
from deep_contact.physics.solvers import BatchedPGS, describe
from deep_contact.physics.solvers.batched import CIRCLES_A_THREAD, threads_of
from deep_contact.presets import Accuracy
from deep_contact.reporting import results
from deep_contact.simulation import method_of
from deep_contact.state import State, notebook
from deep_contact.stiffness import SUBSTEPS, SWEEPS, Stiffness, stiffness
from deep_contact.warm_start import STARTS, Builtin, Cnn, NoStart, Start

TABLE = Path(__file__).parent / "reference" / "figure_6_7.json"
"""Results of Figure 6.7, shipped with the package."""


class Choice(NamedTuple):
    """A part of the model: whether a run uses it, why, and what it was measured to cost or to save."""

    part: str
    used: bool
    why: str
    saving: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run does with a scene, made to be printed. cpu: processor that the savings were measured on.

    us: what a step costs, μs, at most for what is solved to a tolerance; None where no preset was asked for.
    """

    scene: str
    n_bodies: int
    solver: object
    warm_start: str
    us: float | None
    choices: tuple[Choice, ...]
    cpu: str

    def __getitem__(self, part: str) -> Choice:
        """The choice of a part, by name. Raises KeyError naming the parts."""
        by_name = {choice.part: choice for choice in self.choices}
        if part not in by_name:
            raise KeyError(f"expected one of {', '.join(by_name)}, got {part!r}")
        return by_name[part]

    def _title(self) -> str:
        most = "at most" if self.solver.tolerance else "about"
        price = "" if self.us is None else f", {most} {self.us:,.0f} μs a step"
        return f"{self.scene}: {self.n_bodies:,} circles, {describe(self.solver)} from {self.warm_start}{price}"

    def __str__(self) -> str:
        width, lines = max(len(choice.part) for choice in self.choices), [self._title()]
        for part, used, why, saving in self.choices:
            lines.append(f"  {part:{width}s}  {'used' if used else 'left out':8s}  {why}")
            lines.append(f"  {'':{width}s}            {saving}")
        return "\n".join([*lines, f"  Savings: Figure 6.7, {self.cpu}"])

    def _repr_html_(self) -> str:
        rows = [(part, "used" if used else "left out", why, saving) for part, used, why, saving in self.choices]
        return notebook.shown(self._title(), rows, header=("part", "", "why", f"saving (Figure 6.7, {self.cpu})"))


def plan(
    scene: State, *, solver=None, warm_start: Start = "builtin", accuracy: Accuracy | None = None, sleep: bool = False
) -> Plan:
    """What `simulate` would use for a scene with these options, and what it would leave out, with the savings.

    Nothing is simulated; contacts are looked for where the scene has none. Arguments as in `simulate`.
    Raises ValueError on arguments that do not hold together, FileNotFoundError where no results are installed.
    """
    scene = ready(scene)
    solver, start, name, decision = method_of(scene, solver, warm_start, accuracy, sleep=sleep)
    study = installed_results()
    left = {
        part: f"{100 / one['ratio']:.3g} % ({100 / one['high']:.3g} to {100 / one['low']:.3g} %)"
        for part, one in study["data"]["savings"].items()
    }
    choices = (
        *_of_the_scene(scene, solver, left),
        *_of_the_solver(scene, solver, left),
        *_between_steps(start, sleep, left, study["data"]["jobs"]),
        _stiffness(decision.stiff if decision else stiffness(scene), solver),
    )
    us = decision and decision.us
    of_scene = {"scene": scene.name, "n_bodies": scene.bodies.count, "warm_start": name}
    return Plan(**of_scene, solver=solver, us=us, choices=choices, cpu=study["provenance"]["cpu"])


@functools.cache
def installed_results() -> dict:
    """The results file in the package, checked. Raises FileNotFoundError naming it where there is none."""
    return results.read_results(TABLE)


def _of_the_scene(scene: State, solver, left: Mapping) -> Iterator[Choice]:
    used, friction = not leaves_tangents_out(scene, solver), scene.world.friction
    if friction > 0:
        why = f"friction is {friction:g}"
    elif not used:
        why = "friction is 0, so nothing turns a circle"
    elif scene.contacts.tangent_start.any():
        why = "friction is 0, but the state starts from tangent impulses"
    else:
        why = f"friction is 0, but {type(solver).__name__} has no rows without them"
    yield Choice("tangent rows and spin", used, why, f"without them a sweep costs {left['frictionless']}")
    count, moving = len(scene.world.segments), np.count_nonzero(scene.world.surface_speeds)
    why = f"the world has {count or 'none'}" + (f", and {moving} surfaces move" if moving else "")
    saving = "a grid passes over circles that none is near; positions are corrected contact by contact"
    yield Choice("static segments", count > 0, why, saving)
    used = bool(getattr(solver, "islands", False))
    touching = len(np.unique(islands_of(scene)[scene.contacts.body_a]))
    why = f"{'asked for' if used else 'not asked for'}; {touching} of them touch something now"
    one, many = left["islands, one pile"], left["islands, heaps"]
    yield Choice("islands", used, why, f"with them sweeps × contacts are {one} in one pile, {many} in scattered heaps")


def _of_the_solver(scene: State, solver, left: Mapping) -> Iterator[Choice]:
    why = f"at most {solver.position_sweeps} sweeps, none where nothing is deep"
    saving = f"without it a step of a resting pile costs {left['no position correction']}"
    yield Choice("position correction", solver.position_sweeps > 0, why, saving)
    least, most = getattr(solver, "substeps", 1), getattr(solver, "most_substeps", None) or 1
    why = f"{least} a step" if most <= least else f"{least} a step, up to {most} where something is about to hit"
    yield Choice("substeps", max(least, most) > 1, why, "each costs what a step without them does")
    n, in_batches = scene.bodies.count, isinstance(solver, BatchedPGS)
    saving = "eight contacts at a time, in another order than PGS's: sooner at some thousand circles"
    yield Choice("batches of contacts", in_batches, f"{describe(solver)} for {n:,} circles", saving)
    threads, wanted = threads_of(solver, n), getattr(solver, "threads", None)
    if wanted is not None:
        why = f"threads={wanted} was asked for"
    elif in_batches:
        why = f"{threads} for {n:,} circles, one for every {CIRCLES_A_THREAD:,}, and {cores()} cores"
    else:
        why = f"{type(solver).__name__} sweeps contact by contact: nothing that threads could share"
    saving = "batches let them share the stages of a step, and they change no bit of it"
    yield Choice("threads", threads > 1, why, saving)


def _between_steps(start, sleep: bool, left: Mapping, jobs: Mapping) -> Iterator[Choice]:
    saving = f"asleep a step costs {left['asleep']}, with one circle awake {left['asleep but for one']}"
    yield Choice("sleeping", bool(sleep), "asked for" if sleep else "not asked for", saving)
    used, known = not isinstance(start, (Builtin, NoStart)), type(start) in STARTS.values()
    why = "every step calls the start" if used else "the start needs none, unless on_step does"
    yield Choice("calls between steps", used, why, f"without them a step costs {left['no call between steps']}")
    used = isinstance(start, Cnn)
    why = "the start predicts" if used else "the start needs none" if known else "not known of a start of your own"
    one, other = jobs["simulate"], jobs["predict"]
    saving = f"a first step after {one['seconds']:.2g} s instead of a first prediction after {other['seconds']:.2g} s"
    if one["memory_mb"] and other["memory_mb"]:
        saving += f", in {one['memory_mb']:.0f} instead of {other['memory_mb']:.0f} MB"
    yield Choice("network", used, why, saving)


def _stiffness(stiff: Stiffness | None, solver) -> Choice:
    substeps = getattr(solver, "substeps", 1)
    if stiff is None or stiff.solver.tolerance is not None:
        used = solver.tolerance is not None and solver.sweeps >= SWEEPS
        saving = f"it costs up to {SWEEPS * max(substeps, SUBSTEPS):,} sweeps a step, and a few where nothing changes"
    else:
        used = substeps >= stiff.solver.substeps
        saving = f"it costs {stiff.solver.substeps} substeps of {stiff.solver.sweeps} sweeps"
    why = stiff.why if stiff else "nothing is too stiff for a few sweeps"
    if stiff and not used:
        why += f", but {describe(solver)} was asked for"
    return Choice("solving stiff piles", used, why, saving)
