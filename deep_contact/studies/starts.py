"""The thesis's experiments: convergence rates of a solver from several starts (sections 3.4, 5.1 and 5.4).

A start is the impulses from which the solver begins. The convergence rate θ is the largest change of an impulse in a
sweep, N·s. Starts are compared in two modes. In the mode "paired", one reference run makes states, and each of them is
solved from every start, so that only the start differs. In the mode "independent", as in the thesis, each start has a
simulation of its own.

Tests: tests/starts/test_starts.py, tests/studies/test_chapter_5.py, tests/studies/test_verdicts.py
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from deep_contact.cnn.backend import one_thread
from deep_contact.cnn.start import Cnn
from deep_contact.figures.figure import Figure
from deep_contact.io.json_data import plain
from deep_contact.parallel import parallel_map, seeds
from deep_contact.plot import plotting
from deep_contact.run.one_scene import simulate, solve_contacts
from deep_contact.scenes import circles_in_box
from deep_contact.solvers import PGS, SolverOptions
from deep_contact.sph.start import Sph, solved_impulses
from deep_contact.starts.names import Start, WarmStart, warm_start_of
from deep_contact.state import constants
from deep_contact.state.materials import at_contacts
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.validation import flag, list_of, number, one_of
from deep_contact.stepping.convergence import mean_theta
from deep_contact.stepping.rows import projected
from deep_contact.studies import verdicts
from deep_contact.studies.timing import interleaved

THRESHOLD = constants.THETA_TOLERANCE
"""Convergence rate θ down to which sweeps are counted, N·s."""

THESIS_WORLD = {"friction": constants.FRICTION, "restitution": constants.RESTITUTION, "dt": constants.TIME_STEP}
"""Physical options of the thesis's scene: Coulomb's μ, Newton's e and the time step, s."""

THESIS_SCENE = {"n_bodies": 100, "size": 30.0} | THESIS_WORLD
"""Options of the thesis's scene (`scene_of`): number of circles, side of the box, m, and `THESIS_WORLD`."""

THESIS_SETTINGS = THESIS_SCENE | {"steps": 600, "sweeps": 3000, "scenes": 12}
"""Options of the thesis's comparisons: scene, number of time steps, sweeps in a step, and number of scenes.

The thesis has more scenes.
"""

THOROUGH = PGS()
"""Solver of the states of a run. Its tolerance is that of the thesis's authors' code."""

MODES = ("paired", "independent")
"""Modes of comparison; the module's docstring explains them."""

REFERENCE = PGS(sweeps=20_000, tolerance=1e-9)
"""Solver of the reference for velocity errors. It continues from a solution, so that it favours none of the starts."""

TRANSFERS = {"sph": "thesis", "sph spline": "spline"}
"""Start -> transfer of `Sph`. "sph" reads the image back as Algorithm 4 is printed, "sph spline" as it was coded."""

READ = {"sph": "bilinear (printed)", "sph spline": "spline (authors' code)"}
"""Start -> the words of claims for the way in which the start's image is read back."""

SPACINGS = {
    "0.25 to 0.75 m (text, code)": (0.25, 0.5, 0.75),
    "0.25 to 1 m (code's search, d ≤ r)": (0.25, 0.5, 0.75, 1.0),
}
"""Source of the numbers -> spacings d of the grid that are compared, m.

The thesis has no list. Its text names 0.25 m and 0.5 m, and its authors' code has 0.75 m.
"""

SPACING = 0.5
"""Grid spacing d and support radius h that the thesis chooses, m. They are equal."""

CHOSEN = {name: {"spacing": SPACING, "transfer": transfer} for name, transfer in TRANSFERS.items()}
"""Start -> fields of `Sph`, with the thesis's choice d = h = 0.5 m and the start's transfer."""


def solved_states(
    scene: State, *, steps: int, solver: SolverOptions = THOROUGH, every: int = 1, contacts_only: bool = True
) -> list[StateWithContacts]:
    """Simulate a scene, and return solved states of the run, one every `every` steps.

    steps: number of time steps. contacts_only: whether states without contacts are left out.
    """
    states = []

    def keep(state: State, record) -> None:
        if state.step % every == 0 and (state.contacts.count or not contacts_only):
            states.append(state)

    simulate(scene, steps=steps, solver=solver, on_step=keep)
    return states


def sweeps_to(theta: np.ndarray, threshold: float = THRESHOLD) -> int:
    """Return the number of sweeps until θ is at most the threshold.

    If θ never is, the number of all sweeps is returned.
    theta: θ after each sweep, (sweeps,), N·s. threshold: N·s.
    """
    within = np.flatnonzero(theta <= threshold)
    return int(within[0]) + 1 if within.size else theta.size


def convergence_of(thetas: Sequence[np.ndarray], sweeps: int) -> dict[str, np.ndarray]:
    """Return the convergence of some solves: {"theta": mean θ after each sweep, N·s, "sweeps": `sweeps_to` of each}.

    The mean is that of Eq 2.30. thetas: θ after each sweep of a solve, N·s, an array for each solve. sweeps: largest
    number of sweeps, the length of "theta".
    """
    return {"theta": mean_theta(thetas, sweeps), "sweeps": np.array([sweeps_to(theta) for theta in thetas])}


def _seconds_of(start, state: State, solver) -> tuple[float, float]:
    """Return the time in which a start computes its impulses, and the time of a solve from them, s.

    Each is the least of three measurements.
    """
    impulse = start(state, solver)
    both = {"start": lambda: start(state, solver), "solve": lambda: solve_contacts(state, solver=solver, start=impulse)}
    took = interleaved(both, repeats=3)
    return took["start"], took["solve"]


def paired(
    states: Sequence[StateWithContacts],
    starts: Mapping[str, Any] | Iterable[Start],
    *,
    sweeps: int,
    velocity_sweeps: Sequence[int] = (),
    seconds: bool = False,
) -> dict[str, dict[str, np.ndarray]]:
    """Solve the same states from every start. Returns name of the start -> result of `convergence_of`.

    states: solved states. starts: name -> start, as `simulate` takes it; or names of starts alone. sweeps: number of
    sweeps of each solve. velocity_sweeps: numbers of sweeps after which the relative velocity errors are measured,
    against the solution of `swept_on`. seconds: whether computing times are measured. No other program should
    run meanwhile.

    With `velocity_sweeps`, a result also has "velocity", the errors, (states, len(velocity_sweeps)). They are not
    finite if no impulses were needed. With `seconds`, it has "seconds", (states, 2), the time of the start and of the
    solve, s, each the least of three measured times.
    """
    from deep_contact.cnn.evaluation import velocity_errors

    states = list_of("states", State, states)

    solver = PGS(sweeps=sweeps, tolerance=None)
    goals = [swept_on(state) for state in states] if velocity_sweeps else []
    by_start = {}
    named = starts if isinstance(starts, Mapping) else {name: name for name in starts}
    for name, start in {name: warm_start_of(start) for name, start in named.items()}.items():
        impulses = [start(state, solver) for state in states]
        thetas = [solve_contacts(s, solver=solver, start=impulse).record.theta for s, impulse in zip(states, impulses)]
        by_start[name] = convergence_of(thetas, sweeps)
        if flag("seconds", seconds):
            by_start[name]["seconds"] = np.array([_seconds_of(start, s, solver) for s in states])
        if velocity_sweeps:
            errors = [velocity_errors(goal, impulse, velocity_sweeps) for goal, impulse in zip(goals, impulses)]
            by_start[name]["velocity"] = np.array(errors)
    return by_start


def swept_on(state: State) -> State:
    """Return a solved state with a more accurate solution, which `REFERENCE` computes from its impulses."""
    contacts = state.contacts
    solution = solve_contacts(state, solver=REFERENCE, start=(contacts.normal_impulse, contacts.tangent_impulse))
    better = {"normal_impulse": solution.normal_impulses, "tangent_impulse": solution.tangent_impulses}
    return state.replace(contacts=contacts._replace(**better), solved=True)


def independent(scene: State, start: WarmStart, *, steps: int, sweeps: int) -> dict[str, np.ndarray]:
    """Simulate a scene with a start. Returns the `convergence_of` all steps that have contacts.

    start: start of every time step. steps: number of time steps. sweeps: number of sweeps in each step.
    """
    thetas = []

    def keep(state: State, record) -> None:
        if state.contacts.count:
            thetas.append(record.theta)

    simulate(scene, steps=steps, solver=PGS(sweeps=sweeps, tolerance=None), warm_start=start, on_step=keep)
    return convergence_of(thetas, sweeps)


@dataclass(frozen=True)
class RoundedCopy:
    """A start that is the solved impulses, rounded to some significant digits and projected on the friction cone.

    digits: number of significant digits.
    """

    digits: int

    def __call__(self, state: StateWithContacts, solver) -> tuple[np.ndarray, np.ndarray]:
        one = lambda impulse: float(f"{impulse:.{self.digits - 1}e}")  # noqa: E731
        normal, tangent = (np.array([*map(one, impulses)]) for impulses in solved_impulses(state, solver))
        return projected(normal, tangent, at_contacts(state, state.world.friction))


def start_of(description) -> WarmStart:
    """Return a start for its description in a figure's options.

    description: a name, a dict with the fields of `Sph`, {"model": path} for a network, which then runs on one thread,
    or {"digits": k} for a `RoundedCopy`.
    """
    if not isinstance(description, Mapping):
        return warm_start_of(description)
    if "digits" in description:
        return RoundedCopy(**description)
    if "model" not in description:
        return Sph(**description)
    one_thread()
    return Cnn(**description)


def scene_of(options: Mapping, seed: int) -> State:
    """Return the thesis's scene, with some of its options changed.

    options: name -> value. Names that are not in `THESIS_SCENE` are ignored. "n_bodies" may be a pair (low, high), from
    which the number of circles is drawn at random, both included.
    """
    rng, world = np.random.default_rng(seed), {name: options.get(name, own) for name, own in THESIS_SCENE.items()}
    n_bodies, dt = world.pop("n_bodies"), number("dt", world.pop("dt"), above=0)
    if not isinstance(n_bodies, (int, np.integer)):
        n_bodies = int(rng.integers(*n_bodies, endpoint=True))
    return circles_in_box(n_bodies, **world, seed=rng).replace(dt=dt)


def _run(task: tuple, *, steps, sweeps, **scene_options) -> dict[str, dict]:
    """Compare starts on one scene in one mode. Returns name of the start -> result of `convergence_of`.

    task: (mode, seed of the scene, descriptions of the starts), small enough to be sent to another process. The other
    arguments are those of `compare_starts`.
    """
    mode, seed, descriptions = task
    scene = scene_of(scene_options, seed)
    starts = {name: start_of(description) for name, description in descriptions.items()}
    if mode == "independent":
        return {name: independent(scene, start, steps=steps, sweeps=sweeps) for name, start in starts.items()}
    # The states are solved with as many sweeps as the comparison has, like the thesis's copy of the world.
    return paired(solved_states(scene, steps=steps, solver=PGS(sweeps=sweeps, tolerance=None)), starts, sweeps=sweeps)


def compare_starts(
    starts: Mapping,
    *,
    steps: int = 600,
    sweeps: int = 3000,
    scenes: int = 1,
    modes: Sequence[str] = MODES,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable | None = None,
    **scene_options,
) -> dict:
    """Solve the steps of several scenes from several starts, and return θ after each sweep, for a results file.

    This is the thesis's experiment. starts: name -> description (`start_of`). steps: number of time steps of a run.
    sweeps: number of sweeps in a step. scenes: number of scenes. modes: some of `MODES`. seed: the seeds of the scenes
    follow from this seed. jobs: number of processes. progress: function that shows the progress, as for `parallel_map`.
    scene_options: options of `scene_of`. Returns {"sweep": numbers of sweeps, (k,), "threshold": `THRESHOLD`, N·s,
    mode: {name of a start: curves}}. The curves are a dict:

    * "theta": mean θ after each number in "sweep", (k,), N·s;
    * "sweeps": {"mean", "median"} of the sweeps until θ is at most `THRESHOLD`;
    * "states": number of states;
    * "scenes": {"theta": mean θ of each scene, (scenes, k), to four digits, "states": number of states, (scenes,)}.
    """
    together = {"paired": [dict(starts)], "independent": [{name: start} for name, start in starts.items()]}
    for name in scene_options:
        one_of("scene_options", name, THESIS_SCENE)
    tasks = [(mode, scene, some) for scene in seeds(seed, scenes) for mode in modes for some in together[mode]]
    run = partial(_run, steps=steps, sweeps=sweeps, **scene_options)
    done = parallel_map(run, tasks, jobs=jobs, progress=progress, text="scenes and starts")
    sample = np.unique(np.round(np.geomspace(1, sweeps, 160)).astype(np.int64))  # evenly spaced on a logarithmic axis
    data = {"sweep": sample.tolist(), "threshold": THRESHOLD} | {mode: {} for mode in modes}
    for mode in modes:
        for name in starts:
            parts = [part[name] for task, part in zip(tasks, done) if task[0] == mode and name in part]
            # Scenes have different numbers of states. The weights give every state the same weight.
            weights = [part["sweeps"].size for part in parts]
            counts = np.concatenate([part["sweeps"] for part in parts])
            curves = np.array([part["theta"][sample - 1] for part in parts])
            data[mode][name] = {
                "theta": np.average(curves, axis=0, weights=weights),
                "sweeps": {"mean": float(counts.mean()), "median": float(np.median(counts))},
                "states": int(counts.size),
                "scenes": {"theta": plain(curves, digits=4), "states": weights},
            }
    return data


def table_of_starts(data: dict) -> list[list]:
    """Return the rows of a figure's table, one for each mode and start.

    A row has the sweeps to the threshold, and θ after some numbers of sweeps. data: result of `compare_starts`.
    """
    last = data["sweep"][-1]
    shown = [s for s in (10, 100, 1000) if s < last] + [last]
    rows = [["start", "states", "mean sweeps", "median", *(f"θ({s})" for s in shown)]]
    for mode in MODES:
        for name, start in data.get(mode, {}).items():
            theta = [start["theta"][int(np.argmin(np.abs(np.asarray(data["sweep"]) - s)))] for s in shown]
            rows.append([f"{name}, {mode}", start["states"], *start["sweeps"].values(), *theta])
    return rows


FLOOR = 1e-9
"""Smallest θ in pictures, N·s. Smaller values are drawn at this one."""


def draw_comparison(data: dict, title: str, over: str | None = "builtin", hidden: Sequence[str] = ()):
    """Draw θ against the sweep in independent runs, and the ratios of θ to that of the start `over`.

    Returns the figure. data: result of `compare_starts`. over: name of the start; None draws no ratios. If a start's
    ratio after ten sweeps is at most 0.1, its ratios are not drawn. hidden: names of the starts whose θ is not drawn.
    """
    figure, panels = plotting.subplots(1, 2 if over else 1, size=(10.0 if over else 6.0, 4.6), squeeze=False)
    (left, *right), starts, sweeps = panels[0], data["independent"], data["sweep"]
    draw_theta(left, data, [name for name in starts if name not in hidden])
    left.axhline(data["threshold"], color=plotting.GREY, linewidth=1, zorder=1, label=f"θ = {data['threshold']:g} N·s")
    left.set_title("mean θ by sweep" + bands(data, "quartiles of the scenes"))
    after_ten = int(np.argmin(np.abs(np.asarray(sweeps) - 10)))
    for ax in right:
        near = [name for name in starts if verdicts.intervals(starts, name, over)[0, after_ten] > 0.1]
        draw_ratios(ax, data, near, over)
        ax.set_title("ratio" + bands(data))
    curves = {text: line for ax in panels[0] for line, text in zip(*ax.get_legend_handles_labels())}
    figure.legend(curves.values(), curves.keys(), loc="outside lower center", ncols=4 if over else 3)
    figure.suptitle(title)
    return figure


def bands(data: dict, of: str = "95 %, all sweeps at once") -> str:
    """Return the part of a title that explains the bands, or "" if there is a single scene and so no band.

    data: result of `compare_starts`. of: text that names the kind of the bands.
    """
    return f"; bands: {of}" if verdicts.scenes_of(data["independent"]) > 1 else ""


def draw_theta(ax, data: dict, names: Sequence[str]) -> None:
    """Draw the mean θ against the sweep for some starts in independent runs, with the quartiles of the scenes."""
    styles = plotting.styles_of(list(data["independent"]))
    for name in names:
        start = data["independent"][name]
        curves = [start["theta"], *np.percentile(start["scenes"]["theta"], (25, 75), axis=0)]
        plotting.band(ax, data["sweep"], *np.maximum(curves, FLOOR), **styles[name])
    ax.set(xscale="log", yscale="log")
    plotting.label_axes(ax, "sweep", "mean convergence rate θ", y_unit="N·s")
    if min(min(data["independent"][name]["theta"]) for name in names) < FLOOR:
        note = f"θ below {FLOOR:.0e}, zero included, is drawn there"
        ax.text(0.01, 0.01, note, transform=ax.transAxes, fontsize=8, color="#555555", va="bottom")


def draw_ratios(ax, data: dict, names: Sequence[str], over: str) -> None:
    """Draw the ratio of some starts' θ to that of the start `over` in independent runs, with their confidence bands.

    names: names of the starts. The bands are those of `verdicts.intervals`.
    """
    styles = plotting.styles_of(list(data["independent"]))
    for name in names:
        plotting.band(ax, data["sweep"], *verdicts.intervals(data["independent"], name, over), **styles[name])
    plotting.log_axes(ax)
    plotting.label_axes(ax, "sweep", f"θ over that of {styles[over]['label']}")


def convergence_figure(
    *,
    id: str,
    title: str,
    starts: Mapping,
    claims: Callable,
    sweeps: int = 3000,
    seed: int = 0,
    over: str | None = "builtin",
    hidden: Sequence[str] = (),
    modes: Sequence[str] = ("independent",),
) -> Figure:
    """Return a `Figure` that compares starts by `compare_starts` with the thesis's settings.

    id, title, seed: fields of the `Figure`. starts: name -> description (`start_of`). If a description has only the
    fields "spacing" and "transfer", as in `CHOSEN`, the figure's option "spacing" replaces its spacing. claims:
    function (data) -> `Claim`s. sweeps: number of sweeps in a step. over, hidden: as for `draw_comparison`. modes: some
    of `MODES`.
    """
    plain_sph = {"spacing", "transfer"}
    chosen = {name: of for name, of in starts.items() if isinstance(of, Mapping) and of.keys() == plain_sph}

    def compute(options, seed, jobs, progress):
        described = starts | {name: of | {"spacing": options["spacing"]} for name, of in chosen.items()}
        options = {name: options[name] for name in options if name != "spacing"}
        return compare_starts(described, modes=modes, seed=seed, jobs=jobs, progress=progress, **options)

    draw = lambda data, options: draw_comparison(data, title, over, hidden)  # noqa: E731
    options, quick = THESIS_SETTINGS | {"sweeps": sweeps}, {"scenes": 1, "steps": 300}
    options |= {"spacing": SPACING} if chosen else {}
    return Figure(id, title, compute, table_of_starts, draw, claims, options=options, quick=quick, seed=seed)


def grid_of(d: float, h: float, start: str = "sph") -> str:
    """Return the name of an SPH start in figures, such as "d = 0.25 m, h = 0.1 m, spline".

    d: spacing of the grid, m. h: support radius, m. start: one of `TRANSFERS`, which tells how the image is read back.
    """
    size = f"d = h = {d:g} m" if d == h else f"d = {d:g} m, h = {h:g} m"
    return size + start.removeprefix("sph").replace(" ", ", ")


def study_figure(*, id: str, kernel: str, claims: Callable, numbers: Sequence[int] = ()) -> Figure:
    """Return Figure 5.4 or 5.5: the thesis's search for the best grid spacing d and support radius h (section 5.1.3).

    The figure's data are those of `compare_starts` in independent runs. A start is a pair (d, h), with the name of
    `grid_of`, and its image is read back in both ways of `TRANSFERS`. The entry "numbers" of the data maps
    each number of circles to the data of the pairs with d = h, read back bilinearly.
    id: "5.4" or "5.5". kernel: name of the kernel. claims: function (data) -> `Claim`s. numbers: numbers of circles
    for the entry "numbers".
    """
    title = f"Which support h and spacing d are best with {kernel}?"

    def compute(options, seed, jobs, progress):
        d, supports, spacings, numbers = (options.pop(name) for name in ("d", "h", "spacings", "numbers"))

        def compare(pairs, ways=TRANSFERS, **changed):
            described = {
                grid_of(*pair, start): {"spacing": pair[0], "support": pair[1], "kernel": kernel, "transfer": way}
                for start, way in ways.items()
                for pair in pairs
            }
            settings = options | changed | {"modes": ["independent"]}
            return compare_starts(described, seed=seed, jobs=jobs, progress=progress, **settings)

        equal = [(size, size) for size in spacings]
        others = {str(n): compare(equal, {"sph": TRANSFERS["sph"]}, n_bodies=n) for n in numbers}
        return compare([*((d, h) for h in supports), *equal]) | {"numbers": others}

    def draw(data, options):
        d, spacings = options["d"], options["spacings"]
        figure, panels = plotting.subplots(2, 2, size=(8.3, 8.0), sharex=True, sharey="row")
        sides = [
            (f"a) d = {d:g} m", [grid_of(d, h) for h in options["h"]], grid_of(d, d)),
            ("b) h = d", [*map(grid_of, spacings, spacings), grid_of(0.5, 0.5, "sph spline")], grid_of(0.5, 0.5)),
        ]
        for (above, below), (text, names, over) in zip(panels.T, sides):
            draw_theta(above, data, names)
            draw_ratios(below, data, names, over)
            above.set(title=text + bands(data, "quartiles of the scenes"), xlabel="")
            below.set_title("ratio" + bands(data))
            below.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
        figure.suptitle(title)
        return figure

    def table(data):
        rows = table_of_starts(data)
        for n, of_number in data["numbers"].items():
            rows += [[f"{name}, {n} circles", *row] for name, *row in table_of_starts(of_number)[1:]]
        return rows

    own = {"d": 0.25, "h": [0.1, 0.2, 0.25, 0.5], "spacings": [0.25, 0.5, 0.75, 1.0], "numbers": list(numbers)}
    quick = {"scenes": 1, "steps": 250, "sweeps": 1500, "numbers": []}
    return Figure(id, title, compute, table, draw, claims, options=THESIS_SETTINGS | own, quick=quick)


SHOWN = 95
"""Percentile of the positive values at which the scales of colours and of line widths in snapshots end."""


def snapshots_figure(*, id: str, title: str, times: Sequence[float], colour_by: str) -> Figure:
    """Return Figure 3.6 or 5.1: snapshots of the thesis's scene at some times.

    id, title: fields of the `Figure`. times: simulated times of the snapshots, s. colour_by: quantity that colours the
    circles, as for `plotting.draw_state`.
    """

    def compute(options, seed, jobs, progress):
        scene = scene_of(options, seed)
        steps = [round(t / scene.dt) for t in options["times"]]
        states = solved_states(scene, steps=max(steps) + 1, contacts_only=False)
        return {"snapshots": [plotting.state_data(states[step]) for step in steps]}

    def end(values):  # upper end of a scale: a percentile, since one impact would make all other values look equal
        positive = [value for of_state in values for value in of_state if value > 0]
        return float(np.percentile(positive, SHOWN)) if positive else 0.0

    def draw(data, options):
        states = [*map(plotting.state_of, data["snapshots"])]
        figure, panels = plotting.subplots(1, len(states), size=(8.3, 3.1), squeeze=False, sharey=True)
        limits = 0.0, end(plotting.body_values(state, colour_by)[0] for state in states)
        impulse = end(state.contacts.normal_impulse for state in states)
        for ax, state in zip(panels[0], states):
            look = {"limits": limits, "largest_impulse": impulse or None, "bar": False}
            circles = plotting.draw_state(ax, state, colour_by=colour_by, **look)
            ax.set_title(f"t = {state.time:.2f} s\n{state.contacts.count} contacts", loc="left")
            ax.label_outer()
        bar = figure.colorbar(circles, ax=ax, shrink=0.8, pad=0.02, label=circles.get_label(), extend="max")
        bar.outline.set_visible(False)
        plotting.impulse_key(figure, impulse)
        figure.suptitle(f"{title} (colours and widths end at the {SHOWN}th percentile)")
        return figure

    return Figure(id, title, compute, draw=draw, options=THESIS_SCENE | {"times": list(times)})
