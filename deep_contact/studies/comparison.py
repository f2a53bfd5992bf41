"""The thesis's experiments: a scene, some starts, a solver → convergence rates (sections 3.4, 5.1 and 5.4).

Two ways to compare starts. Paired: one reference run makes the states, and every start solves the same ones, so that
what differs is the start alone. Independent, as the thesis did it: every start drives a run of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deep_contact import constants
from deep_contact.physics.convergence import mean_theta
from deep_contact.physics.scenes import circles_in_box
from deep_contact.physics.solvers import PGS
from deep_contact.reporting import plotting
from deep_contact.reporting.figures import Claim, Figure, parallel_map, seeds
from deep_contact.simulation import ready, simulate, solve_contacts
from deep_contact.state import State, World, make_bodies
from deep_contact.warm_start import Sph, WarmStart, warm_start_of

THRESHOLD = constants.THETA_TOLERANCE
"""θ at which a solve counts as done where sweeps are counted, N·s."""

CURVE_POINTS = 240
"""Points kept of a curve of θ by sweep; they lie evenly on a logarithmic axis."""

REFERENCE = PGS(sweeps=20_000, tolerance=1e-9)
"""What velocity errors are measured against: a solution swept on, so that no start is the road to it."""


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """How the solves of a run went from one start.

    theta: mean θ after each sweep, Eq 2.30, (sweeps,), N·s. sweeps: number of sweeps until θ is within
    `THRESHOLD`, one a step; a step that never is counts as all of them. velocity: relative velocity errors
    (`cnn.evaluation.velocity_errors`), a row a step, or None where they were not asked for; a row is not finite where
    nothing was to be solved.
    """

    theta: np.ndarray
    sweeps: np.ndarray
    velocity: np.ndarray | None = None


def solved_states(
    scene: State, *, steps: int, solver=None, warm_start="builtin", every: int = 1, contacts_only: bool = True
) -> list[State]:
    """Solved states of a run: one in `every` step, those without contacts left out unless `contacts_only` is False."""
    states = []

    def keep(state: State, record) -> None:
        if state.step % every == 0 and (state.contacts.count or not contacts_only):
            states.append(state)

    simulate(scene, steps=steps, solver=solver, warm_start=warm_start, on_step=keep)
    return states


def sweeps_to(theta: np.ndarray, threshold: float = THRESHOLD) -> int:
    """Number of sweeps until θ is at most the threshold; the number of all of them if it never is."""
    within = np.flatnonzero(theta <= threshold)
    return int(within[0]) + 1 if within.size else theta.size


def convergence_of(thetas: Sequence[np.ndarray], sweeps: int) -> Convergence:
    """`Convergence` of the θ of many solves, each (≤ sweeps,)."""
    return Convergence(theta=mean_theta(thetas, sweeps), sweeps=np.array([sweeps_to(theta) for theta in thetas]))


def paired(
    states: Sequence[State], starts: Mapping[str, WarmStart], *, sweeps: int, velocity_sweeps: Sequence[int] = ()
) -> dict[str, Convergence]:
    """Every start solves the same states, with so many sweeps each.

    velocity_sweeps: after how many sweeps the velocity error is taken, against the solution swept on by `REFERENCE`.
    """
    from deep_contact.cnn.evaluation import velocity_errors

    solver = PGS(sweeps=sweeps, tolerance=None)
    goals = [swept_on(state) for state in states] if velocity_sweeps else []
    found = {}
    for name, start in starts.items():
        impulses = [start(state, solver) for state in states]
        thetas = [solve_contacts(s, solver=solver, start=given).record.theta for s, given in zip(states, impulses)]
        found[name] = convergence_of(thetas, sweeps)
        if velocity_sweeps:
            errors = [velocity_errors(goal, given, velocity_sweeps) for goal, given in zip(goals, impulses)]
            found[name] = replace(found[name], velocity=np.array(errors))
    return found


def swept_on(state: State, solver=REFERENCE) -> State:
    """A solved state whose solution is swept on until `solver` is content."""
    contacts = state.contacts
    given = contacts.normal_impulse, contacts.tangent_impulse
    solution = solve_contacts(state, solver=solver, start=given)
    better = {"normal_impulse": solution.normal_impulses, "tangent_impulse": solution.tangent_impulses}
    return state.replace(contacts=contacts._replace(**better), solved=True)


def independent(scene: State, start: WarmStart, *, steps: int, sweeps: int) -> Convergence:
    """The start drives a run of its own, with so many sweeps a step; steps without contacts do not count."""
    thetas = []

    def keep(state: State, record) -> None:
        if state.contacts.count:
            thetas.append(record.theta)

    simulate(scene, steps=steps, solver=PGS(sweeps=sweeps, tolerance=None), warm_start=start, on_step=keep)
    return convergence_of(thetas, sweeps)


def start_of(description) -> WarmStart:
    """A start from its description in a figure's options: a name, or a dict: the fields of `Sph`, or {"model": path}
    for a network, which then works on one thread (`cnn.inference.network_start`)."""
    if not isinstance(description, Mapping):
        return warm_start_of(description)
    if "model" not in description:
        return Sph(**description)
    from deep_contact.cnn.inference import network_start

    return network_start(**description)


@dataclass(frozen=True, kw_only=True)
class _Task:
    """One piece of `compare_starts`, small enough to be sent to another process."""

    starts: dict
    paired: bool
    seed: int
    n_bodies: int | tuple[int, int]
    size: float
    steps: int
    sweeps: int
    velocity_sweeps: tuple[int, ...]


def scene_of(n_bodies: int | Sequence[int], *, size: float, seed: int) -> State:
    """The thesis's scene of so many circles; of a pair (low, high), both included, the seed draws the number first."""
    if isinstance(n_bodies, (int, np.integer)):
        return circles_in_box(n_bodies, size=size, seed=seed)
    rng = np.random.default_rng(seed)
    low, high = n_bodies
    return circles_in_box(int(rng.integers(low, high, endpoint=True)), size=size, seed=rng)


def _run(task: _Task) -> dict[str, Convergence]:
    scene = scene_of(task.n_bodies, size=task.size, seed=task.seed)
    starts = {name: start_of(description) for name, description in task.starts.items()}
    if task.paired:
        # Solved with as many sweeps as the starts get, as the thesis's copy of the world is.
        states = solved_states(scene, steps=task.steps, solver=PGS(sweeps=task.sweeps, tolerance=None))
        return paired(states, starts, sweeps=task.sweeps, velocity_sweeps=task.velocity_sweeps)
    return {name: independent(scene, start, steps=task.steps, sweeps=task.sweeps) for name, start in starts.items()}


def compare_starts(
    starts: Mapping,
    *,
    n_bodies: int | Sequence[int] = 100,
    size: float = 30.0,
    steps: int = 600,
    sweeps: int = 3000,
    scenes: int = 1,
    velocity_sweeps: Sequence[int] = (),
    seed: int = 0,
    jobs: int = 1,
    progress: Callable | None = None,
) -> dict:
    """The thesis's comparison of starts over `scenes` scenes, both ways, as the data of a results file.

    starts: name -> description (`start_of`). n_bodies: see `scene_of`. velocity_sweeps: see `paired`.
    Returns {"sweep": (k,), "paired": {name: …}, "independent": {name: …}} where … is
    {"theta": mean θ at these sweeps (k,), "quartiles": those of the scenes' own means (2, k),
    "sweeps": {"mean", "median"} until `THRESHOLD`, "states": number}.
    With velocity_sweeps also {"velocity": {"sweeps", "states", "mean": {name: …}, "median": {name: …}}}, paired, over
    the states that have something to be solved.
    """
    common = {"n_bodies": n_bodies, "size": size, "steps": steps, "sweeps": sweeps}
    common["velocity_sweeps"] = tuple(velocity_sweeps)
    tasks = []
    for scene_seed in seeds(seed, scenes):
        tasks.append(_Task(starts=dict(starts), paired=True, seed=scene_seed, **common))
        tasks += [_Task(starts={n: d}, paired=False, seed=scene_seed, **common) for n, d in starts.items()]
    found = parallel_map(_run, tasks, jobs=jobs, progress=progress, text="scenes and starts")
    sample = np.union1d(sampled_sweeps(sweeps), [k for k in velocity_sweeps if 1 <= k <= sweeps]).astype(np.int64)
    data = {"sweep": sample, "threshold": THRESHOLD, "paired": {}, "independent": {}}
    for mode in ("paired", "independent"):
        for name in starts:
            parts = [
                part[name] for task, part in zip(tasks, found) if name in part and task.paired == (mode == "paired")
            ]
            # Scenes differ in their number of states; every state counts the same.
            weights = [part.sweeps.size for part in parts]
            counts = np.concatenate([part.sweeps for part in parts])
            theta = np.average([part.theta for part in parts], axis=0, weights=weights)
            data[mode][name] = {
                "theta": theta[sample - 1],
                "quartiles": np.percentile([part.theta for part in parts], (25, 75), axis=0)[:, sample - 1],
                "sweeps": {"mean": float(counts.mean()), "median": float(np.median(counts))},
                "states": int(counts.size),
            }
    if velocity_sweeps:
        together = [part for task, part in zip(tasks, found) if task.paired]
        errors = {name: np.concatenate([part[name].velocity for part in together]) for name in starts}
        data["velocity"] = _summary_of_errors(errors, velocity_sweeps)
    return data


def _summary_of_errors(errors: Mapping[str, np.ndarray], sweeps: Sequence[int]) -> dict:
    """Mean and median over the states in which every start has a finite error."""
    kept = np.all([np.isfinite(of_start).all(axis=1) for of_start in errors.values()], axis=0)
    return {
        "sweeps": list(sweeps),
        "states": int(kept.sum()),
        "mean": {name: of_start[kept].mean(axis=0) for name, of_start in errors.items()},
        "median": {name: np.median(of_start[kept], axis=0) for name, of_start in errors.items()},
    }


def sampled_sweeps(sweeps: int, points: int = CURVE_POINTS) -> np.ndarray:
    """Up to `points` sweep numbers from 1 to `sweeps`, evenly on a logarithmic axis, without repeats."""
    return np.unique(np.round(np.geomspace(1, sweeps, points)).astype(np.int64))


def table_of_starts(data: dict, after: Sequence[int] = (10, 100, 1000)) -> list[list]:
    """Rows for a figure's table: sweeps to the threshold and θ after some sweeps, and after all, both ways."""
    shown = [s for s in (*after, data["sweep"][-1]) if s <= data["sweep"][-1]]
    rows = [["start", "states", "mean sweeps", "median", *(f"θ({s})" for s in dict.fromkeys(shown))]]
    for mode in ("paired", "independent"):
        for name, found in data[mode].items():
            theta = [theta_after(data, mode, name, s) for s in dict.fromkeys(shown)]
            rows.append(
                [f"{name}, {mode}", found["states"], found["sweeps"]["mean"], found["sweeps"]["median"], *theta]
            )
    return rows


def theta_after(data: dict, mode: str, name: str, sweep: int) -> float:
    """Mean θ of a start after so many sweeps (the nearest one kept), N·s."""
    nearest = int(np.argmin(np.abs(np.asarray(data["sweep"]) - sweep)))
    return float(data[mode][name]["theta"][nearest])


def mean_sweeps(data: dict, name: str, mode: str = "paired") -> float:
    """Mean number of sweeps to the threshold of a start."""
    return data[mode][name]["sweeps"]["mean"]


def draw_comparison(data: dict):
    """Two panels of θ by sweep: paired and independent."""
    figure, panels = plotting.subplots(1, 2, size=(10.0, 3.8), sharey=True)
    titles = {"paired": "the same states for every start", "independent": "a run of its own for every start"}
    for ax, (mode, text) in zip(panels, titles.items()):
        draw_convergence(ax, data, mode, floor=1e-9)
        ax.set_title(text)
    panels[0].get_legend().remove()
    return figure


def draw_convergence(ax, data: dict, mode: str, *, floor: float) -> None:
    """θ by sweep of every start of `compare_starts`' data, "paired" or "independent", with the scenes' quartiles."""
    curves = {name: found["theta"] for name, found in data[mode].items()}
    bands = {name: found["quartiles"] for name, found in data[mode].items()}
    plotting.convergence_plot(ax, curves, sweeps=data["sweep"], bands=bands, threshold=data["threshold"], floor=floor)


def faster(data: dict, first: str, second: str, *, text: str, thesis: str | None, mode: str = "independent") -> Claim:
    """The claim that one start needs fewer sweeps to the threshold than another, in the mean; both ways measured.

    It holds if it does in the given mode; by default the thesis's own, a run for each start.
    """
    measured = {
        f"{name}, {way}": mean_sweeps(data, name, way) for way in ("independent", "paired") for name in (first, second)
    }
    measured |= {f"θ(100), {name}": theta_after(data, mode, name, 100) for name in (first, second)}
    return Claim(text, thesis, bool(mean_sweeps(data, first, mode) < mean_sweeps(data, second, mode)), measured)


def near(
    data: dict, first: str, second: str, *, ratio: float, text: str, thesis: str | None = None, mode: str = "paired"
) -> Claim:
    """The claim that a start needs at most `ratio` times the mean sweeps of another, in the given mode."""
    measured = {
        f"{name}, {way}": mean_sweeps(data, name, way) for way in ("independent", "paired") for name in (first, second)
    }
    found = mean_sweeps(data, first, mode) / mean_sweeps(data, second, mode)
    return Claim(text, thesis, bool(found <= ratio), {f"ratio, {mode}": found, **measured})


def convergence_figure(*, id: str, title: str, compute: Callable, claims: Callable, **options) -> Figure:
    """A figure of `compare_starts`' data with the thesis's settings; options: more of them, or others."""
    return Figure(
        id=id,
        title=title,
        options={"n_bodies": 100, "size": 30.0, "steps": 600, "sweeps": 3000, "scenes": 5} | options,
        quick={"scenes": 1, "steps": 300},
        compute=compute,
        claims=claims,
        table=table_of_starts,
        draw=lambda data, options: draw_comparison(data),
    )


def study_figure(*, id: str, kernel: str, claims: Callable) -> Figure:
    """Figure 5.4 or 5.5: `study_of_kernel` with the thesis's settings."""

    def compute(options, seed, jobs, progress):
        return study_of_kernel(kernel, seed=seed, jobs=jobs, progress=progress, **options)

    return Figure(
        id=id,
        title=f"Convergence with the kernel {kernel} by support and spacing",
        options={
            "n_bodies": 100,
            "size": 30.0,
            "steps": 600,
            "sweeps": 3000,
            "scenes": 3,
            "d": 0.25,
            "h": [0.1, 0.2, 0.25, 0.5],
            "spacings": [0.25, 0.5, 0.75, 1.0],
            "transfer": "thesis",
        },
        quick={"scenes": 1, "steps": 250, "sweeps": 1500},
        compute=compute,
        claims=claims,
        table=table_of_study,
        draw=lambda data, options: draw_study(data, d=options["d"]),
    )


def study_of_kernel(
    kernel: str, *, d: float, h: Sequence[float], spacings: Sequence[float], transfer: str, **options
) -> dict:
    """The thesis's search for grid spacing and support of a kernel (section 5.1.3), as the data of a results file.

    "h": starts with each support h at the spacing d; "d": starts with each spacing, h = d. Every part is what
    `compare_starts` returns. options: those of `compare_starts`.
    """

    def starts(pairs):
        return {
            name: {"spacing": spacing, "support": support, "kernel": kernel, "transfer": transfer}
            for name, (spacing, support) in pairs.items()
        }

    by_support = starts({f"h = {support:g} m": (d, support) for support in h})
    by_spacing = starts({f"d = h = {spacing:g} m": (spacing, spacing) for spacing in spacings})
    return {"h": compare_starts(by_support, **options), "d": compare_starts(by_spacing, **options)}


def table_of_study(data: dict) -> list[list]:
    """Rows for the table of `study_of_kernel`'s data."""
    head, *rows = table_of_starts(data["h"])
    return [head, *rows, *table_of_starts(data["d"])[1:]]


def draw_study(data: dict, *, d: float):
    """Panels a and b as in Figures 5.4 and 5.5 (a run for each start), and below them the same states for each."""
    figure, panels = plotting.subplots(2, 2, size=(9.0, 7.0), sharey=True, sharex=True)
    modes = {"independent": "a run of its own for each", "paired": "the same states for each"}
    for row, (mode, text) in zip(panels, modes.items()):
        for ax, part, title in zip(row, ("h", "d"), (f"a) d = {d:g} m", "b) h = d")):
            draw_convergence(ax, data[part], mode, floor=1e-7)
            ax.set_title(f"{title}, {text}")
    return figure


def transfer_loss(states: Sequence[State], start: Sph, *, method: str = "bilinear") -> dict[str, float]:
    """What the round trip of the solved impulses through the grid changes in them.

    method: how the thesis's transfer reads back, see `sph.gather`; the consistent one is bilinear.
    Returns {"relative error": mean over states of ‖λ' − λ‖ / ‖λ‖, "returned": Σ λ_n' / Σ λ_n}.
    """
    errors, returned, total = [], 0.0, 0.0
    for state in states:
        impulses = np.column_stack([state.contacts.normal_impulse, state.contacts.tangent_impulse])
        size = np.linalg.norm(impulses)
        if size > 0:
            back = np.column_stack(start.round_trip(state, impulses, method=method))
            errors.append(np.linalg.norm(back - impulses) / size)
            returned += back[:, 0].sum()
            total += impulses[:, 0].sum()
    return {"relative error": float(np.mean(errors)), "returned": float(returned / total)}


def isolated_contacts(count: int, *, seed: int) -> list[State]:
    """States with a single contact each, of impulse (1, 0.3) N·s, anywhere in a cell of the thesis's box."""
    rng = np.random.default_rng(seed)
    states = []
    for centre in rng.uniform(10.0, 20.0, (count, 2)):
        angle = rng.uniform(0, 2 * np.pi)
        reach = 0.999 * np.array([np.cos(angle), np.sin(angle)])
        bodies = make_bodies([centre - reach, centre + reach], radius=1.0)
        state = ready(State(name="isolated", world=World(), bodies=bodies))
        impulses = {"normal_impulse": np.array([1.0]), "tangent_impulse": np.array([0.3])}
        states.append(state.replace(contacts=state.contacts._replace(**impulses), solved=True))
    return states


def snapshots(scene: State, times: Sequence[float], *, solver=None) -> list[State]:
    """The solved states of a run at these times, s, each at the step that begins nearest to it."""
    wanted = [round(t / scene.dt) for t in times]
    if not wanted or min(wanted) < 0:
        raise ValueError(f"times: expected at least one, all >= 0, got {list(times)}")
    kept: dict[int, State] = {}

    def keep(state: State, record) -> None:
        if state.step in wanted:
            kept[state.step] = state

    simulate(scene, steps=max(wanted) + 1, solver=solver, on_step=keep)
    return [kept[step] for step in wanted]


def snapshots_figure(*, id: str, title: str, times: Sequence[float], colour_by: str) -> Figure:
    """The figure of snapshots of the thesis's scene at some times, s, its circles coloured by speed or impulse."""

    def compute(options, seed, jobs, progress):
        scene = circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
        return {"snapshots": [plotting.state_data(state) for state in snapshots(scene, options["times"])]}

    def table(data):
        rows = [["time (s)", "contacts", "mean height (m)", "largest speed (m/s)", "largest λ_n (N·s)"]]
        for state in map(plotting.state_of, data["snapshots"]):
            height, speed = state.bodies.position[:, 1].mean(), plotting.body_values(state, "speed")[0].max()
            largest = state.contacts.normal_impulse.max(initial=0.0)
            rows.append([state.time, state.contacts.count, height, speed, largest])
        return rows

    return Figure(
        id=id,
        title=title,
        options={"n_bodies": 100, "size": 30.0, "times": list(times)},
        compute=compute,
        table=table,
        draw=lambda data, options: draw_snapshots(data, colour_by=colour_by),
    )


def draw_snapshots(data: dict, *, colour_by: str, columns: int = 4):
    """Panels of the states that `data["snapshots"]` holds (`plotting.state_data`), one colour scale for all."""
    states = [plotting.state_of(found) for found in data["snapshots"]]
    rows = -(-len(states) // columns)
    figure, panels = plotting.subplots(
        rows, columns, size=(2.9 * columns, 3.0 * rows), squeeze=False, sharex=True, sharey=True
    )
    high = max(plotting.body_values(state, colour_by)[0].max(initial=0.0) for state in states)
    impulse = max(state.contacts.normal_impulse.max(initial=0.0) for state in states)
    for ax in panels.ravel()[len(states) :]:
        ax.set_visible(False)
    for ax, state in zip(panels.ravel(), states):
        circles = plotting.draw_state(
            ax, state, colour_by=colour_by, limits=(0.0, high), largest_impulse=impulse or None
        )
        ax.set_title(f"t = {state.time:.2f} s, {state.contacts.count} contacts", loc="left")
    plotting.colour_bar(panels[0, -1], circles)
    return figure


def contact_time(state: State, *, sweeps: int, repeats: int = 3) -> float:
    """Time of one contact solution with so many sweeps, the least of some tries, s."""
    solver = PGS(sweeps=sweeps, tolerance=None)
    best = np.inf
    for _ in range(repeats):
        begin = time.perf_counter()
        solve_contacts(state, solver=solver)
        best = min(best, time.perf_counter() - begin)
    return best
