"""python scripts/figure_6_8_learned_start.py: velocity errors after few sweeps from a start that a network predicts.

A setting is a start and the solver that follows, such as "builtin, NNCG". The solver of "builtin" alone is PGS. The
learned start with its best solver is compared with the best setting of classical starts. Both are chosen after the
errors are known. All settings are run on the same states. Errors are relative velocity errors (`metrics`), a dict: name
of the setting -> (states, numbers of sweeps). No network was trained on scenes with the seeds of this figure.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from deep_contact import figures, parallel
from deep_contact.figures import Claim, Figure
from deep_contact.measure.errors import interval
from deep_contact.plot import plotting
from deep_contact.scenes import circles_in_box
from deep_contact.solvers import NNCG, PGS, PSOR, NesterovPGS
from deep_contact.state.state import State
from deep_contact.state.validation import integer
from deep_contact.stepping import metrics
from deep_contact.stepping.problem import ContactSolution, solve
from deep_contact.studies.starts import REFERENCE, solved_states, start_of

SOLVERS = {
    "PGS": PGS(),
    "PSOR 1.3": PSOR(omega=1.3),
    "PSOR 1.75 | 1.45": PSOR(omega=1.75, friction_omega=1.45),
    "NesterovPGS": NesterovPGS(),
    "NNCG": NNCG(),
}
"""Name -> solver that follows a start. The third is the best PSOR in runs, with ω of the normal and friction rows."""

CLASSICAL = ("none", "builtin", "scaled")
"""Names of the starts that no network predicts."""

LEARNED = "far field"
"""Name of the start that the network predicts."""

FEW = (3, 10, 30)
"""Numbers of sweeps for which claims are made."""

OFF = 0.05
"""Velocity error of Builtin's start, before any sweep, above which a better start can matter."""


def settings_with(starts: Iterable[str]) -> dict:
    """Return every combination of a start and a solver: name of the setting -> (name of the start, solver)."""
    return {
        start if name == "PGS" else f"{start}, {name}": (start, solver)
        for start, (name, solver) in product(starts, SOLVERS.items())
    }


def errors_of(state: State, impulses: Mapping, settings: Mapping, sweeps: Sequence, solution: ContactSolution) -> dict:
    """Return velocity errors in a state: name of the setting -> errors after each number of sweeps.

    impulses: name of the start -> its impulses (λ_n, λ_t), N·s. settings: result of `settings_with`. sweeps: numbers of
    sweeps. solution: the reference solution.
    """
    errors = {}
    for name, (start, solver) in settings.items():
        ends = (solve(state, replace(solver, sweeps=k, tolerance=None), *impulses[start]) for k in sweeps)
        errors[name] = [metrics.velocity_error(state, end, solution) for end in ends]
    return errors


def compute(options, seed, jobs, progress):
    """Measure the errors of every start with every solver on the same states of held-out scenes."""
    integer("scenes", options["scenes"], least=2)  # a single scene has no interval
    starts = {name: name for name in CLASSICAL} | {LEARNED: {"model": options["model"]}}
    tasks = [{**options, "starts": starts, "seed": s} for s in parallel.seeds(seed + 10_000, options["scenes"])]
    scenes = parallel.parallel_map(errors_on_scene, tasks, jobs=jobs, progress=progress, text="scenes")
    return {"after": options["after"], "scenes": scenes}


def errors_on_scene(task: Mapping) -> dict:
    """Measure the errors of all starts with all `SOLVERS` on some states of one scene.

    The scene is the thesis's, but with μ = 0.3; the training data have μ = 0.5.
    task: a dict. "starts" is name -> description (`start_of`), which includes "builtin". "seed" is the seed of the
    scene, and "steps" its number of time steps. "every" is the number of steps between measured states. "after" has the
    numbers of sweeps after which errors are measured. Returns {"step": number of the time step of each state, "errors":
    {name of the setting: (states, len(after))}}.
    """
    starts = {name: start_of(description) for name, description in task["starts"].items()}
    rng, settings = np.random.default_rng(task["seed"]), settings_with(starts)
    scene = circles_in_box(int(rng.integers(70, 110, endpoint=True)), friction=0.3, seed=rng)
    solved: dict = {"step": [], "errors": {name: [] for name in settings}}
    for state in solved_states(scene, steps=task["steps"], every=task["every"], solver=PGS(sweeps=5000)):
        solution = solve(state, REFERENCE, state.contacts.normal_impulse, state.contacts.tangent_impulse)
        impulses = {name: start(state, PGS()) for name, start in starts.items()}
        errors = errors_of(state, impulses, settings, task["after"], solution)
        if np.isfinite(list(errors.values())).all():  # errors are not finite if the contacts need no impulses
            solved["step"].append(state.step)
            for name, values in errors.items():
                solved["errors"][name].append(values)
    return solved


def mean_errors(scenes: Sequence[Mapping], setting: str, where: str = "all") -> np.ndarray:
    """Return the mean velocity errors of a setting in each scene, (scenes, numbers of sweeps).

    where: "all" takes all states. "off" takes those in which the error of Builtin's start is above `OFF`. Scenes
    without such a state are left out.
    """
    means = []
    for scene in scenes:
        errors, builtin = (np.array(scene["errors"][name]) for name in (setting, "builtin"))
        chosen = builtin[:, 0] > OFF if where == "off" else np.ones(len(errors), bool)
        if chosen.any():
            means.append(errors[chosen].mean(axis=0))
    return np.array(means)


def best_settings(scenes: Sequence[Mapping], starts: Sequence[str], where: str = "all") -> list[str]:
    """Return the setting with the least mean error for each number of sweeps.

    starts: names of the starts whose settings are compared. where: as for `mean_errors`.
    """
    names = [name for name in settings_with(starts) if name in scenes[0]["errors"]]
    means = np.array([mean_errors(scenes, name, where).mean(axis=0) for name in names])
    return [names[i] for i in means.argmin(axis=0)]


def best_errors(scenes: Sequence[Mapping], starts: Sequence[str], where: str = "all") -> np.ndarray:
    """Return the `mean_errors` of the settings that `best_settings` chooses, (scenes, numbers of sweeps)."""
    names = best_settings(scenes, starts, where)
    return np.column_stack([mean_errors(scenes, name, where)[:, i] for i, name in enumerate(names)])


def ratios_of(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the ratio of two errors' means over scenes, with its confidence interval, (k, 3).

    one, other: errors, (scenes, k), for k numbers of sweeps.
    """
    return interval(lambda drawn: one[drawn].mean(axis=1) / other[drawn].mean(axis=1), len(one)).T


def ratios_to_best(scenes: Sequence[Mapping], where: str = "all") -> np.ndarray:
    """Return `ratios_of` the errors of the network with its best solver to those of the best classical setting."""
    return ratios_of(best_errors(scenes, [LEARNED], where), best_errors(scenes, CLASSICAL, where))


def claims(data):
    few, scenes = [data["after"].index(k) for k in FEW], data["scenes"]

    def claim(text, ratios, column, most):
        measured = {f"after {k} sweeps": of for k, of in zip(FEW, ratios[few].tolist())}
        return Claim(text, None, bool(ratios[few, column].max() <= most), measured)

    text = "with PGS, where Builtin is off by more than 5 %, the network leaves at most 0.33 of its error"
    yield claim(text, ratios_of(*(mean_errors(scenes, start, "off") for start in (LEARNED, "builtin"))), 0, 0.33)
    text = "the network, its price left out, leaves less error than the best classical setting (95 %), over all steps"
    yield claim(text, ratios_to_best(scenes), 2, np.nextafter(1, 0))


def table(data):
    scenes = data["scenes"]
    rows = [["start", "states", *(f"error({k})" for k in data["after"])]]
    for where, text in (("off", "Builtin off"), ("all", "all")):
        for name in settings_with([*CLASSICAL, LEARNED]):
            rows.append([name, text, *mean_errors(scenes, name, where).mean(axis=0).tolist()])
        rows.append(["best classical", text, *best_settings(scenes, CLASSICAL, where)])
        ratios = ("{:.3f} ({:.3f}–{:.3f})".format(*ratio) for ratio in ratios_to_best(scenes, where))
        rows.append([f"{LEARNED} / best classical", text, *ratios])
    return rows


def draw(data, options):
    """Draw the mean error against the number of sweeps, with its interval over scenes.

    Only states count in which the error of Builtin's start is above `OFF`.
    """
    figure, ax = plotting.subplots(size=(6.5, 4.2))
    scenes = data["scenes"]
    curves = {name: mean_errors(scenes, name, "off") for name in ("none", "builtin")}
    curves |= {
        "best classical": best_errors(scenes, CLASSICAL, "off"),
        LEARNED: best_errors(scenes, [LEARNED], "off"),
    }
    labels = {"none": "None, PGS", "builtin": "Builtin, PGS", LEARNED: "network, its best solver"}
    x = [max(k, 1) for k in data["after"]]  # 0 sweeps, which have no logarithm, are drawn at 1
    for name, errors in curves.items():
        spread, mean = 1.96 * errors.std(axis=0) / np.sqrt(len(errors)), errors.mean(axis=0)
        look = plotting.style_of(name) | ({"label": labels[name]} if name in labels else {})
        plotting.band(ax, x, mean, mean - spread, mean + spread, marker="o", markersize=3, **look)
    plotting.log_axes(ax)
    ax.set_xticks(x, [f"{k}" for k in data["after"]])
    ax.set(xlabel="sweeps", ylabel="velocity error, share of a step's")
    ax.set_title(f"What is left after so many sweeps, where Builtin is off by over {OFF:.0%}?")
    ax.legend(title="band: 95 % over scenes", loc="lower left")
    return figure


OPTIONS = {"scenes": 20, "steps": 600, "every": 5, "after": [0, 3, 10, 30, 100], "model": "models/far_field.h5"}
QUICK = {"scenes": 2, "every": 15, "steps": 300}
FIGURE = Figure("6.8", "What a learned start is worth from given states", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
