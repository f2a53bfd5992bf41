"""Learned starts on scenes whose seeds no network was trained on: Figures 6.4, 6.8 and 6.9, Table 6.2.

A learned start is held against the best classical setting: the best pair of a start of `CLASSICAL` and a solver of
`SOLVERS`, for each number of sweeps, chosen after the fact. The learned start may choose its solver as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from deep_contact.physics.scenes import circles_in_box, lattice_in_box
from deep_contact.physics.solvers import NNCG, PGS, PSOR, NesterovPGS
from deep_contact.reporting.figures import parallel_map, seeds
from deep_contact.simulation import simulate
from deep_contact.state import State
from deep_contact.studies import starts as comparison
from deep_contact.studies import timing
from deep_contact.studies.scene_errors import errors_on_scene
from deep_contact.warm_start import WarmStart

FEW = (3, 10, 30)
"""Numbers of sweeps that the claims are about."""

TENTHS = 10

OFF = 0.05
"""Velocity error of Builtin's start above which a better start can matter."""

SOLVERS = {
    "PGS": PGS(),
    "PSOR 1.3": PSOR(omega=1.3),
    "PSOR 1.75 | 1.45": PSOR(omega=1.75, friction_omega=1.45),
    "NesterovPGS": NesterovPGS(),
    "NNCG": NNCG(),
}
"""What follows a start, where several solvers are tried: ω of the normal and of the friction rows."""

CLASSICAL = ("none", "builtin", "scaled")
"""Starts that nothing was trained for."""

TRAINED = {"circles": [70, 110], "radius": [1.0, 1.0], "friction": 0.3, "dt": 0.01, "columns": None}
"""The scenes of the training data."""


def start_of(description) -> WarmStart:
    """A start from its description: as `starts.start_of`, or {"guarded": path of a network}."""
    if isinstance(description, Mapping) and "guarded" in description:
        from deep_contact.cnn.inference import Guarded, network_start

        return Guarded(network_start(description["guarded"]).model)
    return comparison.start_of(description)


def errors_on_scenes(
    starts: Mapping[str, object], options: Mapping, *, seed: int, jobs, progress: Callable, with_all: Sequence[str] = ()
) -> list[dict]:
    """Errors of all starts (name -> description) on the same states of held-out scenes of 70 to 110 circles, as in the
    training data.

    options: number of "scenes", "steps", "every", and the numbers of sweeps "after" which errors are measured.
    with_all: starts that all of `SOLVERS` follow; PGS follows the others.
    """
    tasks = [{**options, "starts": starts, "with_all": with_all, "seed": s} for s in seeds(seed, options["scenes"])]
    return parallel_map(_errors_on_scene, tasks, jobs=jobs, progress=progress, text="scenes")


def _errors_on_scene(task: Mapping) -> dict:
    rng = np.random.default_rng(task["seed"])
    scene = circles_in_box(int(rng.integers(70, 111)), seed=rng)
    return _errors_on(scene, task, steps=task["steps"], every=task["every"])


def _errors_on(scene: State, task: Mapping, **options) -> dict:
    solvers = dict.fromkeys(task["with_all"], SOLVERS)
    return errors_on_scene(scene, _starts(task), solvers=solvers, sweeps=task["after"], **options)


def _starts(task: Mapping) -> dict[str, WarmStart]:
    return {name: start_of(description) for name, description in task["starts"].items()}


def errors_beyond(
    starts: Mapping[str, object],
    kinds: Sequence[Mapping],
    options: Mapping,
    *,
    seed: int,
    jobs,
    progress: Callable,
    with_all: Sequence[str] = (),
) -> list[list[dict]]:
    """Errors of all starts on a few scenes of each kind: what it changes of `TRAINED`. Returns a list per kind.

    with_all: as in `errors_on_scenes`.
    """
    tasks = [
        {**options, "starts": starts, "with_all": with_all, "kind": {**TRAINED, **kind}, "number": i, "seed": s}
        for i, kind in enumerate(kinds)
        for s in seeds(seed + i, options["scenes"])
    ]
    found = parallel_map(_errors_on_scene_of_kind, tasks, jobs=jobs, progress=progress, text="scenes")
    return [[f for f, task in zip(found, tasks) if task["number"] == i] for i in range(len(kinds))]


def _errors_on_scene_of_kind(task: Mapping) -> dict:
    # As much time as the runs of the other kinds have.
    steps = round(task["steps"] * TRAINED["dt"] / task["kind"]["dt"])
    every = max(1, steps // task["states"])
    scene = scene_of_kind(task["kind"], task["seed"])
    return _errors_on(scene, task, steps=steps, every=every)


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


def mean_errors(scenes: Sequence[Mapping], name: str, where: str) -> np.ndarray:
    """Mean velocity error of a setting by scene and number of sweeps, from the output of `errors_on_scenes`.

    where: "all" states, or only those where Builtin is "off" by more than `OFF`; scenes without any are omitted.
    """
    means = []
    for scene in scenes:
        found, builtin = (np.array(scene["errors"][n]) for n in (name, "builtin"))
        chosen = builtin[:, 0] > OFF if where == "off" else np.ones(len(found), bool)
        if chosen.any():
            means.append(found[chosen].mean(axis=0))
    return np.array(means)


def best_settings(scenes: Sequence[Mapping], starts: Sequence[str], where: str) -> list[str]:
    """For each number of sweeps the setting with the least mean error among those of some starts."""
    names = [name for name in scenes[0]["errors"] if name.partition(", ")[0] in starts]
    means = np.array([mean_errors(scenes, name, where).mean(axis=0) for name in names])
    return [names[i] for i in means.argmin(axis=0)]


def best_errors(scenes: Sequence[Mapping], starts: Sequence[str], where: str) -> np.ndarray:
    """`mean_errors` of the best of the settings of some starts, the best for each number of sweeps."""
    names = best_settings(scenes, starts, where)
    return np.column_stack([mean_errors(scenes, name, where)[:, i] for i, name in enumerate(names)])


def ratios_of(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Ratio of the means of two errors by scene and number of sweeps, with the 95 % interval by resampling scenes:
    (sweeps, 3)."""
    chosen = np.random.default_rng(0).integers(0, len(one), (2000, len(one)))
    sampled = one[chosen].mean(axis=1) / other[chosen].mean(axis=1)
    return np.column_stack([one.mean(axis=0) / other.mean(axis=0), *np.quantile(sampled, [0.025, 0.975], axis=0)])


def ratios_to_builtin(scenes: Sequence[Mapping], name: str, where: str) -> np.ndarray:
    """Mean error of a setting over that of PGS from Builtin, as `ratios_of`."""
    return ratios_of(mean_errors(scenes, name, where), mean_errors(scenes, "builtin", where))


def ratios_to_best(scenes: Sequence[Mapping], start: str, where: str) -> np.ndarray:
    """Mean error of a start with its best solver over that of the best classical setting, as `ratios_of`."""
    return ratios_of(best_errors(scenes, [start], where), best_errors(scenes, CLASSICAL, where))


def cells_of(ratios: np.ndarray, digits: int = 3) -> list[str]:
    """Ratios with their intervals, one text per number of sweeps."""
    return [f"{r:.{digits}f} ({low:.{digits}f}–{high:.{digits}f})" for r, low, high in ratios]


def by_tenth(data: Mapping, start: str) -> np.ndarray:
    """Ratio of the mean error of a start with its best solver to that of the best classical setting in each tenth of
    the run, (10, sweeps); 1 for a tenth without states. The settings are the best over all states."""
    scenes = data["scenes"]
    totals = []
    for names in (best_settings(scenes, [start], "all"), best_settings(scenes, CLASSICAL, "all")):
        total = np.zeros((TENTHS, len(data["after"])))
        for scene in scenes:
            tenth = np.minimum(np.array(scene["step"]) * TENTHS // data["steps"], TENTHS - 1)
            errors = np.column_stack([np.array(scene["errors"][name])[:, i] for i, name in enumerate(names)])
            np.add.at(total, tenth, errors)
        totals.append(total)
    return np.divide(*totals, out=np.ones_like(totals[1]), where=totals[1] > 0)


def mean_sweeps(data: Mapping, name: str) -> float:
    """Mean over all states of the sweeps to the threshold."""
    return float(np.mean(np.concatenate([scene["sweeps"][name] for scene in data["scenes"]])))
