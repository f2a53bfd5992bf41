"""Learned starts against classical ones, by their errors (Figure 6.8), and the stages of a start (Figure 5.10).

A setting is a start and the solver that follows it, such as "builtin, NNCG"; after "builtin" alone follows PGS. The
learned start with its best solver is compared with the best classical setting; both are chosen after the errors are
known. Errors are velocity errors (`metrics`) on the same states: setting -> (states, numbers of sweeps). No network was
trained on scenes of these seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from deep_contact.parallel import parallel_map, seeds
from deep_contact.physics import metrics
from deep_contact.physics.contact_solver import projected
from deep_contact.physics.engine import ContactSolution, solve, step_problem
from deep_contact.physics.scenes import circles_in_box
from deep_contact.physics.solvers import NNCG, PGS, PSOR, NesterovPGS
from deep_contact.state import State
from deep_contact.studies.starts import REFERENCE, solved_states, start_of
from deep_contact.studies.verdicts import interval
from deep_contact.warm_start import Sph, WarmStart, solved_impulses

SOLVERS = {
    "PGS": PGS(),
    "PSOR 1.3": PSOR(omega=1.3),
    "PSOR 1.75 | 1.45": PSOR(omega=1.75, friction_omega=1.45),
    "NesterovPGS": NesterovPGS(),
    "NNCG": NNCG(),
}
"""Solvers that follow a start. The third is the best PSOR along runs: ω of the normal and of the friction rows."""

CLASSICAL = ("none", "builtin", "scaled")
"""Starts that nothing was trained for."""

LEARNED = "far field"


def starts_with(model: str) -> dict:
    """Name -> description (`starts.start_of`) of the classical starts, and of that of a network."""
    return {name: name for name in CLASSICAL} | {LEARNED: {"model": model}}


def parts_of(setting: str) -> tuple[str, str]:
    """(Start, solver) of a setting's name."""
    start, _, solver = setting.partition(", ")
    return start, solver or "PGS"


def settings_with(starts: Iterable[str]) -> list[str]:
    """The names of every start with every solver."""
    return [start if solver == "PGS" else f"{start}, {solver}" for start, solver in product(starts, SOLVERS)]


def errors_of(
    state: State, impulses: Mapping, settings: Iterable[str], sweeps: Sequence, solution: ContactSolution
) -> dict:
    """Setting -> velocity errors after so many sweeps. impulses: start -> its impulses."""
    errors = {}
    for name in settings:
        start, solver = parts_of(name)
        fixed = (replace(SOLVERS[solver], sweeps=k, tolerance=None) for k in sweeps)
        ends = (solve(state, solver, *impulses[start]) for solver in fixed)
        errors[name] = [metrics.velocity_error(state, end, solution) for end in ends]
    return errors


# ---- states of held-out scenes: Figure 6.8 ----

FEW = (3, 10, 30)
"""Numbers of sweeps that the claims are about."""

OFF = 0.05
"""Velocity error of Builtin's start above which a better start can matter."""


def errors_on_scenes(starts: Mapping, options: Mapping, seed: int, jobs, progress: Callable) -> list[dict]:
    """Errors of starts with all of `SOLVERS` on the same states of the thesis's scenes, with μ = 0.3.

    The training data have 0.5. starts: name -> description (`starts.start_of`), among them "builtin". options: number
    of "scenes", "steps" of a scene, of which one in "every" is measured, and the numbers of sweeps "after" which errors
    are measured. Returns scene by scene {"step": (states,), "errors": {setting: (states, len(after))}}.
    """
    settings = settings_with(starts)
    tasks = [{**options, "starts": starts, "settings": settings, "seed": s} for s in seeds(seed, options["scenes"])]
    return parallel_map(_errors_on_scene, tasks, jobs=jobs, progress=progress, text="scenes")


def _errors_on_scene(task: Mapping) -> dict:
    starts = {name: start_of(description) for name, description in task["starts"].items()}
    rng = np.random.default_rng(task["seed"])
    scene = circles_in_box(int(rng.integers(70, 110, endpoint=True)), friction=0.3, seed=rng)
    solved: dict = {"step": [], "errors": {name: [] for name in task["settings"]}}
    for state in solved_states(scene, steps=task["steps"], every=task["every"], solver=PGS(sweeps=5000)):
        solution = solve(state, REFERENCE, state.contacts.normal_impulse, state.contacts.tangent_impulse)
        impulses = {name: start(state, PGS()) for name, start in starts.items()}
        errors = errors_of(state, impulses, task["settings"], task["after"], solution)
        if np.isfinite(list(errors.values())).all():  # not where contacts have nothing to solve
            solved["step"].append(state.step)
            for name, values in errors.items():
                solved["errors"][name].append(values)
    return solved


def mean_errors(scenes: Sequence[Mapping], setting: str, where: str = "all") -> np.ndarray:
    """Mean velocity errors of a setting, (scenes, numbers of sweeps).

    where: "all" states, or only those where Builtin is "off" by more than `OFF`; scenes without any are left out.
    """
    means = []
    for scene in scenes:
        errors, builtin = (np.array(scene["errors"][name]) for name in (setting, "builtin"))
        chosen = builtin[:, 0] > OFF if where == "off" else np.ones(len(errors), bool)
        if chosen.any():
            means.append(errors[chosen].mean(axis=0))
    return np.array(means)


def best_settings(scenes: Sequence[Mapping], starts: Sequence[str], where: str = "all") -> list[str]:
    """For each number of sweeps the setting of some starts with the least mean error."""
    names = [name for name in settings_with(starts) if name in scenes[0]["errors"]]
    means = np.array([mean_errors(scenes, name, where).mean(axis=0) for name in names])
    return [names[i] for i in means.argmin(axis=0)]


def best_errors(scenes: Sequence[Mapping], starts: Sequence[str], where: str = "all") -> np.ndarray:
    """`mean_errors` of the best setting of some starts for each number of sweeps."""
    names = best_settings(scenes, starts, where)
    return np.column_stack([mean_errors(scenes, name, where)[:, i] for i, name in enumerate(names)])


def ratios_of(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Ratio of the means over scenes of two errors, (scenes,) or (scenes, k), with its interval, (3,) or (k, 3)."""
    one, other = np.asarray(one), np.asarray(other)
    return interval(lambda drawn: one[drawn].mean(axis=1) / other[drawn].mean(axis=1), len(one)).T


def ratios_to_best(scenes: Sequence[Mapping], start: str, where: str = "all") -> np.ndarray:
    """`ratios_of` a start with its best solver to the best classical setting."""
    return ratios_of(best_errors(scenes, [start], where), best_errors(scenes, CLASSICAL, where))


def text_of(ratio: Sequence[float], digits: int = 2) -> str:
    """A ratio with its interval as text."""
    return "{:.{d}f} ({:.{d}f}–{:.{d}f})".format(*ratio, d=digits)


# ---- stages of a start: Figure 5.10 ----


def stages_of(start: WarmStart, state: State) -> dict[str, Callable[[], object]]:
    """The stages of a start as calls that need none of each other: "splat", "network" and "gather", whose result it is.

    The solution that SPH transfers is known, and rows have been built. A start without an image has no stages.
    """
    if isinstance(start, Sph):
        impulses = np.column_stack(solved_impulses(state, PGS()))
        image = start.splat(state, impulses)
        return {"splat": lambda: start.splat(state, impulses), "gather": lambda: start.gather(state, image)}
    if not hasattr(start, "model"):
        return {}
    model, splat = start.model, partial(start.model.seen, state, step_problem(state))
    image, read = splat()
    out = model.run(image)
    gather = lambda: projected(*read(out), state.world.friction)  # noqa: E731
    return {"splat": splat, "network": partial(model.run, image), "gather": gather}
