"""Settings of runs, as mappings that JSON can store.

A setting names a solver of this package ("method") or another engine ("engine"). It also gives its options, its number
of sweeps ("sweeps"; iterations of an engine) and Δt ("dt", s).

Tests: tests/measure/test_trade.py, tests/scripts/test_run_tradeoff.py, tests/studies/test_run_study.py
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace

from deep_contact.accuracy import presets
from deep_contact.accuracy.presets import PRESETS
from deep_contact.accuracy.scene_numbers import SceneNumbers
from deep_contact.accuracy.stiffness import Stiffness
from deep_contact.solvers import NNCG, PGS, PSOR, BatchedPGS, solver_from
from deep_contact.state.constants import TIME_STEP


def setting_of(solver, dt: float, start: str = "builtin") -> dict:
    """Return the setting of runs with a solver, a Δt and a start.

    A setting always has the number of sweeps. It has the tolerance unless that is None, and of the solver's other
    options those that differ from their defaults. solver: options of the solver. dt: Δt, s. start: name of the start
    (`starts.names`).
    """
    plain = {f.name: None if f.name == "tolerance" else f.default for f in fields(solver)}
    changed = {name: value for name, default in plain.items() if (value := getattr(solver, name)) != default}
    begin = {} if start == "builtin" else {"start": start}
    return {"method": type(solver).__name__, **changed, "sweeps": solver.sweeps, "dt": dt, **begin}


def solver_of(setting: Mapping):
    """Return the options of the solver that a setting names. Their tolerance is None unless the setting has one."""
    options = {name: value for name, value in setting.items() if name not in ("method", "dt", "start")}
    return solver_from(setting["method"], {"tolerance": None} | options)


def name_of(setting: Mapping, step: float = TIME_STEP) -> str:
    """Return the name of a setting, such as "PGS, 10 sweeps, Δt / 2" or "Box2D v3, 4 iterations, Δt / 2".

    step: the time step, s, that "Δt" stands for in the name.
    """
    budget, ratio = "iteration" if "engine" in setting else "sweep", step / setting["dt"]
    words = [group_of(setting), f"{setting['sweeps']} {budget}{'s' * (setting['sweeps'] != 1)}"]
    words += [f"{key}={setting[key]}" for key in setting if key not in ("engine", "method", "sweeps", "dt")]
    return ", ".join([*words, "Δt" if ratio == 1 else f"Δt / {ratio:g}" if ratio > 1 else f"{1 / ratio:g} Δt"])


def group_of(setting: Mapping) -> str:
    """Return the name of a setting's engine, or of its solver if it has no engine."""
    return setting.get("engine") or setting["method"]


def reference_of(numbers: SceneNumbers, stiff: Stiffness | None, finer: int = 1) -> dict:
    """Return a setting with steps so small that its run stands for the limit of small steps.

    numbers, stiff: `scene_numbers` and `stiffness` of the scene. finer: factor on the number of substeps; 2 halves each
    substep.
    """
    parts = presets.parts_for(numbers, TIME_STEP / 16)
    if stiff is None:
        return setting_of(PGS(sweeps=20, tolerance=None, substeps=finer * parts), numbers.dt)
    solver = stiff.solver(finer * parts)
    if solver.tolerance is None:  # a heap, which has few sweeps: more sweeps and substeps
        solver = replace(solver, sweeps=20, substeps=4 * solver.substeps)
    return setting_of(solver, numbers.dt)


def settings_of_presets(numbers: SceneNumbers, stiff: Stiffness | None) -> dict:
    """Return name of a preset -> its setting for a scene.

    numbers, stiff: `scene_numbers` and `stiffness` of the scene.
    """
    chosen = {name: presets.decided(numbers, stiff, name) for name in PRESETS}
    return {name: setting_of(one.solver, numbers.dt, one.start) for name, one in chosen.items()}


def ladder(numbers: SceneNumbers) -> list:
    """Return a short list of settings for a scene, some cheaper and some dearer than those of the presets.

    numbers: `scene_numbers` of the scene.
    """
    k = presets.parts_for(numbers, TIME_STEP)
    solvers = [
        PGS(sweeps=4, tolerance=None, substeps=2 * k),
        PGS(sweeps=1, tolerance=None, substeps=k),
        PGS(sweeps=10, tolerance=None, substeps=k),
        BatchedPGS(sweeps=10, tolerance=None, substeps=4 * k, most_substeps=32 * k, slop=0.25),
        PSOR(sweeps=3, tolerance=None, substeps=2 * k, most_substeps=16 * k, slop=0.25),
        PGS(sweeps=4, tolerance=None, substeps=k, most_substeps=8 * k, slop=0.5),
        PGS(sweeps=2, tolerance=None, substeps=4 * k),
        NNCG(sweeps=20, tolerance=None, substeps=2 * k),
    ]
    return [setting_of(solver, numbers.dt) for solver in solvers]
