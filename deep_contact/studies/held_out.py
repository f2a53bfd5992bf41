"""Learned starts on scenes whose seeds no network was trained on: Figures 6.4, 6.8 and 6.9, Table 6.2."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from deep_contact.physics.scenes import circles_in_box, lattice_in_box
from deep_contact.physics.solvers import NNCG, PGS
from deep_contact.reporting.figures import parallel_map, seeds
from deep_contact.simulation import simulate
from deep_contact.state import State
from deep_contact.studies import comparison, timing
from deep_contact.studies.learned import errors_on_thesis_scene, ratios_to_builtin
from deep_contact.warm_start import WarmStart

FEW = (3, 10, 30)
"""Numbers of sweeps that the claims are about."""

TENTHS = 10

TRAINED = {"circles": [70, 110], "radius": [1.0, 1.0], "friction": 0.3, "dt": 0.01, "columns": None}
"""The scenes of the training data."""


def start_of(description) -> WarmStart:
    """A start from its description: as `comparison.start_of`, or {"guarded": path of a network}."""
    if isinstance(description, Mapping) and "guarded" in description:
        from deep_contact.cnn.inference import Guarded, network_start

        return Guarded(network_start(description["guarded"]).model)
    return comparison.start_of(description)


def errors_on_scenes(
    starts: Mapping[str, object], options: Mapping, *, seed: int, jobs, progress: Callable
) -> list[dict]:
    """Errors of all starts (name -> description) on the same states of "scenes" held-out scenes: see
    `learned.errors_on_thesis_scene`, which also names the other options."""
    tasks = [{**options, "starts": starts, "seed": s} for s in seeds(seed, options["scenes"])]
    return parallel_map(_errors_on_scene, tasks, jobs=jobs, progress=progress, text="scenes")


def _errors_on_scene(task: Mapping) -> dict:
    return errors_on_thesis_scene(_starts(task), task)


def _starts(task: Mapping) -> dict[str, WarmStart]:
    return {name: start_of(description) for name, description in task["starts"].items()}


def errors_beyond(
    starts: Mapping[str, object], kinds: Sequence[Mapping], options: Mapping, *, seed: int, jobs, progress: Callable
) -> list[list[dict]]:
    """Errors of all starts on a few scenes of each kind: what it changes of `TRAINED`. Returns a list per kind."""
    tasks = [
        {**options, "starts": starts, "kind": {**TRAINED, **kind}, "number": i, "seed": s}
        for i, kind in enumerate(kinds)
        for s in seeds(seed + i, options["scenes"])
    ]
    found = parallel_map(_errors_on_scene_of_kind, tasks, jobs=jobs, progress=progress, text="scenes")
    return [[f for f, task in zip(found, tasks) if task["number"] == i] for i in range(len(kinds))]


def _errors_on_scene_of_kind(task: Mapping) -> dict:
    from deep_contact.studies.scene_errors import errors_on_scene

    # As much time as the runs of the other kinds have.
    steps = round(task["steps"] * TRAINED["dt"] / task["kind"]["dt"])
    every = max(1, steps // task["states"])
    scene = scene_of_kind(task["kind"], task["seed"])
    return errors_on_scene(scene, _starts(task), steps=steps, every=every, sweeps=task["after"])


def scene_of_kind(kind: Mapping, seed: int) -> State:
    """A scene with the fields of `TRAINED`: a loose lattice where the thesis's box would be too small."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(kind["circles"][0], kind["circles"][1] + 1))
    look = {"radius": kind["radius"], "friction": kind["friction"], "seed": rng}
    if count > 120 or kind["radius"][1] > 1.0 or kind["columns"]:
        scene = lattice_in_box(count, columns=kind["columns"], gap=0.3, **look)
    else:
        scene = circles_in_box(count, **look)
    return scene.replace(dt=kind["dt"])


def timing_state() -> State:
    """A state of 100 circles on which starts and sweeps are timed."""
    return simulate(circles_in_box(100, seed=1), steps=200, solver=NNCG()).state


def start_us(start: WarmStart, state: State, repeats: int) -> float:
    """Time of a start on one thread, including image and reading back, μs: the least of several."""
    return 1e6 * timing.fastest(lambda: start(state, PGS()), repeats)


# ---- data of the figures: "after": numbers of sweeps, "scenes": as `errors_on_scenes` returns them ----


def after_few(data: Mapping) -> list[int]:
    """Places of `FEW` among the numbers of sweeps."""
    return [data["after"].index(k) for k in FEW]


def ratio_cells(scenes: Sequence[Mapping], name: str, where: str, digits: int = 3) -> list[str]:
    """The ratios to Builtin with their intervals, one text per number of sweeps."""
    found = ratios_to_builtin(scenes, name, where)
    return [f"{r:.{digits}f} ({low:.{digits}f}–{high:.{digits}f})" for r, low, high in found]


def by_tenth(data: Mapping, name: str) -> np.ndarray:
    """Ratio to Builtin of the mean error in each tenth of the run, (10, sweeps); 1 for a tenth without states."""
    totals = {n: np.zeros((TENTHS, len(data["after"]))) for n in (name, "builtin")}
    for scene in data["scenes"]:
        tenth = np.minimum(np.array(scene["step"]) * TENTHS // data["steps"], TENTHS - 1)
        for n, total in totals.items():
            np.add.at(total, tenth, np.array(scene["errors"][n]))
    builtin = totals["builtin"]
    return np.divide(totals[name], builtin, out=np.ones_like(builtin), where=builtin > 0)


def mean_sweeps(data: Mapping, name: str) -> float:
    """Mean over all states of the sweeps to the threshold."""
    return float(np.mean(np.concatenate([scene["sweeps"][name] for scene in data["scenes"]])))
