"""The thesis's experiments: a scene, some starts, a solver → convergence rates (sections 3.4, 5.1 and 5.4).

Two ways to compare starts. Paired: one reference run makes the states, and every start solves the same ones, so that
what differs is the start alone. Independent, as the thesis did it: every start drives a run of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deep_contact import constants
from deep_contact.figures import Claim, parallel_map, seeds
from deep_contact.physics.convergence import mean_theta
from deep_contact.physics.methods import PGS
from deep_contact.physics.scenes import circles_in_box
from deep_contact.simulation import ready, simulate, solve_contacts
from deep_contact.state import State, World, make_bodies
from deep_contact.warm_start import Sph, WarmStart, warm_start_of

THRESHOLD = constants.THETA_TOLERANCE
"""θ at which a solve counts as done where sweeps are counted, N·s."""

CURVE_POINTS = 240
"""Points kept of a curve of θ by sweep; they lie evenly on a logarithmic axis."""


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """How the solves of a run went from one start.

    theta: mean θ after each sweep, Eq 2.30, (sweeps,), N·s. sweeps: number of sweeps until θ is within
    `THRESHOLD`, one a step; a step that never is counts as all of them.
    """

    theta: np.ndarray
    sweeps: np.ndarray


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


def paired(states: Sequence[State], starts: Mapping[str, WarmStart], *, sweeps: int) -> dict[str, Convergence]:
    """Every start solves the same states, with so many sweeps each."""
    solver = PGS(sweeps=sweeps, tolerance=None)
    return {
        name: convergence_of([solve_contacts(s, solver=solver, start=start).record.theta for s in states], sweeps)
        for name, start in starts.items()
    }


def independent(scene: State, start: WarmStart, *, steps: int, sweeps: int) -> Convergence:
    """The start drives a run of its own, with so many sweeps a step; steps without contacts do not count."""
    thetas = []

    def keep(state: State, record) -> None:
        if state.contacts.count:
            thetas.append(record.theta)

    simulate(scene, steps=steps, solver=PGS(sweeps=sweeps, tolerance=None), warm_start=start, on_step=keep)
    return convergence_of(thetas, sweeps)


def start_of(description) -> WarmStart:
    """A start from its description in a figure's options: a name, or the fields of `Sph` as a dict."""
    return Sph(**description) if isinstance(description, Mapping) else warm_start_of(description)


@dataclass(frozen=True, kw_only=True)
class _Task:
    """One piece of `compare_starts`, small enough to be sent to another process."""

    starts: dict
    paired: bool
    seed: int
    n_bodies: int
    size: float
    steps: int
    sweeps: int


def _run(task: _Task) -> dict[str, Convergence]:
    scene = circles_in_box(task.n_bodies, size=task.size, seed=task.seed)
    starts = {name: start_of(description) for name, description in task.starts.items()}
    if task.paired:
        # Solved with as many sweeps as the starts get, as the thesis's copy of the world is.
        states = solved_states(scene, steps=task.steps, solver=PGS(sweeps=task.sweeps, tolerance=None))
        return paired(states, starts, sweeps=task.sweeps)
    return {name: independent(scene, start, steps=task.steps, sweeps=task.sweeps) for name, start in starts.items()}


def compare_starts(
    starts: Mapping,
    *,
    n_bodies: int = 100,
    size: float = 30.0,
    steps: int = 600,
    sweeps: int = 3000,
    scenes: int = 1,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable | None = None,
) -> dict:
    """The thesis's comparison of starts over `scenes` scenes, both ways, as the data of a results file.

    starts: name -> description (`start_of`). Returns {"sweep": (k,), "paired": {name: …}, "independent": {name: …}}
    where … is {"theta": mean θ at these sweeps (k,), "sweeps": {"mean", "median"} until `THRESHOLD`, "states": number}.
    """
    common = {"n_bodies": n_bodies, "size": size, "steps": steps, "sweeps": sweeps}
    tasks = []
    for scene_seed in seeds(seed, scenes):
        tasks.append(_Task(starts=dict(starts), paired=True, seed=scene_seed, **common))
        tasks += [_Task(starts={n: d}, paired=False, seed=scene_seed, **common) for n, d in starts.items()]
    found = parallel_map(_run, tasks, jobs=jobs, progress=progress, text="scenes and starts")
    sample = sampled_sweeps(sweeps)
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
                "sweeps": {"mean": float(counts.mean()), "median": float(np.median(counts))},
                "states": int(counts.size),
            }
    return data


def sampled_sweeps(sweeps: int, points: int = CURVE_POINTS) -> np.ndarray:
    """Up to `points` sweep numbers from 1 to `sweeps`, evenly on a logarithmic axis, without repeats."""
    return np.unique(np.round(np.geomspace(1, sweeps, points)).astype(np.int64))


def table_of_starts(data: dict) -> list[list]:
    """Rows for a figure's table: sweeps to the threshold and θ after some sweeps, both ways."""
    shown = [s for s in (10, 100, 1000, data["sweep"][-1]) if s <= data["sweep"][-1]]
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


def draw_comparison(data: dict, *, title: str = ""):
    """Two panels of θ by sweep: paired and independent."""
    from deep_contact import plotting

    figure, panels = plotting.subplots(1, 2, size=(10.0, 3.8), sharey=True)
    titles = {"paired": "the same states for every start", "independent": "a run of its own for every start"}
    for ax, (mode, text) in zip(panels, titles.items()):
        curves = {name: found["theta"] for name, found in data[mode].items()}
        plotting.convergence_plot(ax, curves, sweeps=data["sweep"], threshold=data["threshold"], floor=1e-9)
        ax.set_title(f"{title}{text}")
    panels[0].get_legend().remove()
    return figure


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

    by_support = starts({f"h = {support:g}": (d, support) for support in h})
    by_spacing = starts({f"d = h = {spacing:g}": (spacing, spacing) for spacing in spacings})
    return {"h": compare_starts(by_support, **options), "d": compare_starts(by_spacing, **options)}


def table_of_study(data: dict) -> list[list]:
    """Rows for the table of `study_of_kernel`'s data."""
    head, *rows = table_of_starts(data["h"])
    return [head, *rows, *table_of_starts(data["d"])[1:]]


def draw_study(data: dict, *, d: float):
    """Panels a and b as in Figures 5.4 and 5.5 (a run for each start), and below them the same states for each."""
    from deep_contact import plotting

    figure, panels = plotting.subplots(2, 2, size=(9.0, 7.0), sharey=True, sharex=True)
    modes = {"independent": "a run of its own for each", "paired": "the same states for each"}
    for row, (mode, text) in zip(panels, modes.items()):
        for ax, part, title in zip(row, ("h", "d"), (f"a) d = {d:g} m", "b) h = d")):
            curves = {name: found["theta"] for name, found in data[part][mode].items()}
            plotting.convergence_plot(
                ax, curves, sweeps=data[part]["sweep"], threshold=data[part]["threshold"], floor=1e-7
            )
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


def draw_snapshots(data: dict, *, colour_by: str, columns: int = 4):
    """Panels of the states that `data["snapshots"]` holds (`plotting.state_data`), one colour scale for all."""
    from deep_contact import plotting

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
