"""The study of runs: errors and times of solver settings on many scenes, and the settings of the accuracy presets.

`observed_rows` measures errors. Every setting simulates the same scenes, by the functions of `deep_contact.measure`.
`timed_rows` measures times, one after the other, on a machine that runs nothing else. The study (run_tradeoff.py), the
check on other scenes (run_tradeoff_verify.py) and Figure 6.16 pass their lists of scenes and settings to these
functions.

Time steps are given for circles of r = 1 m under g = 9.81 m/s². In other scenes Δt √(g / r) has to be the same.

Tests: tests/studies/test_run_study.py, tests/accuracy/test_presets.py
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from deep_contact import parallel
from deep_contact.accuracy.presets import FASTEST, KNOWN, PRESETS, keeping
from deep_contact.figures import results
from deep_contact.io import shipped
from deep_contact.io.provenance import commit
from deep_contact.measure import peers, setting_runs
from deep_contact.measure.errors import observation, observe
from deep_contact.measure.watched import readings_of
from deep_contact.scenes import drum, hopper, lattice_in_box, terrain
from deep_contact.state.constants import GRAVITY, TIME_STEP
from deep_contact.state.state import State
from deep_contact.state.validation import expect, one_of
from deep_contact.studies import piles

RESULTS = {"results": "data/reference/run_tradeoff.json"}
"""Default options of the figures that draw the study: the path of the study's results file."""

INTERVAL = 5 * TIME_STEP
"""Time between two observations of a run, s."""

SECONDS = 6.0
"""Duration of a run of the study, s."""


def gas(n_bodies: int, *, gap: float = 1.0, restitution: float = 0.8, seed: int = 0) -> State:
    """Return a gas: circles on a loose lattice without gravity, with random velocities.

    Collisions dissipate its energy. The largest possible speed is the one for which the time steps are meant, `FASTEST`
    √(g r) with r = 1 m and g = 9.81 m/s². gap: gap between neighbouring circles over their diameter. restitution:
    Newton's e.
    """
    rng = np.random.default_rng(seed)
    lattice = lattice_in_box(n_bodies, gap=gap, restitution=restitution, gravity=(0.0, 0.0), seed=rng)
    most = FASTEST * math.sqrt(-0.5 * GRAVITY[1])  # largest component of a velocity, m/s
    velocity = rng.uniform(-most, most, (n_bodies, 2))
    return lattice.replace(name=f"gas_{n_bodies}", bodies=lattice.bodies._replace(velocity=velocity))


def two_densities(n_bodies: int, *, ratio: float, heavy: str = "mixed", seed: int = 0) -> State:
    """Return the scene of a pile in which some circles have `ratio` times the density of the others.

    heavy: which circles are dense. With "mixed", a random 30 % of them. With "above" or "below", the half that is above
    or below the median height at the start.
    """
    pile = piles.pile_scene(n_bodies, seed)
    height = pile.bodies.position[:, 1]
    chosen = {
        "mixed": np.random.default_rng((seed, 1)).permutation(n_bodies) < 0.3 * n_bodies,
        "above": height > np.median(height),
        "below": height < np.median(height),
    }[one_of("heavy", heavy, ("mixed", "above", "below"))]
    return pile.replace(bodies=pile.bodies._replace(mass=np.where(chosen, ratio, 1.0) * pile.bodies.mass))


def dam_break(n_bodies: int, *, aspect: float = 2.0, room: float = 4.0, seed: int = 0, **options) -> State:
    """Return a loose lattice of circles that stands at the left wall of a wider box and collapses.

    aspect: height of the lattice over its width. room: width of the box over the width of the lattice. options:
    arguments of `lattice_in_box`.
    """
    lattice = lattice_in_box(n_bodies, columns=max(1, round(math.sqrt(n_bodies / aspect))), seed=seed, **options)
    _, _, width, height = lattice.world.box
    return lattice.replace(name=f"dam_{n_bodies}", world=replace(lattice.world, box=(0, 0, room * width, height)))


def piston(n_bodies: int, *, speed: float = 1.0, seed: int = 0, **options) -> State:
    """Return a loose lattice of circles that falls beside a moving wall, which pushes them along the floor.

    The box is so wide that the pile does not reach the opposite wall. Otherwise a row of circles that fills the gap
    between both walls would be compressed until it breaks apart.
    speed: speed of the moving wall, m/s. options: arguments of `lattice_in_box`.
    """
    lattice = lattice_in_box(n_bodies, seed=seed, **options)
    _, _, width, height = lattice.world.box
    wall = {"segments": ((0, 0, 0, height),), "segment_velocities": ((speed, 0, speed, 0),)}
    world = replace(lattice.world, box=(0, 0, 3.0 * width + 1.5 * speed * SECONDS, height), **wall)
    return lattice.replace(name=f"piston_{n_bodies}", world=world)


KINDS = {
    "plain": {},
    "mixed radii": {"radius": (0.5, 1.5)},
    "no friction": {"friction": 0.0},
    "elastic 0.3": {"restitution": 0.3},
    "elastic 0.8": {"restitution": 0.8},
    "gas": {"make": gas},
    "drum": {"make": drum, "froude": 0.1, "sides": 24},
    "densities 1 : 2": {"make": two_densities, "ratio": 2.0},
    "densities 1 : 10": {"make": two_densities, "ratio": 10.0},
    "heavy on light 1 : 10": {"make": two_densities, "ratio": 10.0, "heavy": "above"},
    "light on heavy 1 : 10": {"make": two_densities, "ratio": 10.0, "heavy": "below"},
    "densities 1 : 100": {"make": two_densities, "ratio": 100.0},
    "heavy on light 1 : 100": {"make": two_densities, "ratio": 100.0, "heavy": "above"},
    "dam break": {"make": dam_break},
    "terrain": {"make": terrain},
    "hopper": {"make": hopper},
    "piston": {"make": piston},
}
"""Kind of scene -> arguments of the function that makes it: of the entry "make", or else of `piles.pile_scene`."""

AGAIN = 100
"""A study that takes over the runs of an earlier commit computes every hundredth run again, and compares both."""

REFERENCE = {"method": "PGS", "sweeps": 20, "dt": TIME_STEP / 16}
"""The setting whose runs stand for the limit of small time steps, and against which errors are measured.

Figure 6.2 shows that the next longer time steps give the same results within the noise.
"""


def scene_of_kind(kind: str, n_bodies: int, seed: int) -> State:
    """Return a scene of some kind. kind: one of `KINDS`.

    The scene of a pile is the thesis's for at most 100 circles, otherwise a loose lattice that falls.
    """
    options = dict(KINDS[kind])
    return options.pop("make", piles.pile_scene)(n_bodies, seed=seed, **options)


# ---- rows of errors and times, for scenes, settings and seeds ----

Key = tuple[str, int, str]
"""Key of a row: kind of scene, number of circles, name of the setting."""


@functools.lru_cache(256)
def made(make: Callable, kind: str, n_bodies: int, seed: int) -> State:
    """Return the scene make(kind, n_bodies, seed), from a cache if it has been made for another setting.

    The thesis's pile is drawn at random, which takes longer than most of the runs.
    """
    return make(kind, n_bodies, seed)


def observed(make: Callable, kind: str, n_bodies: int, seed: int, setting: Mapping, *, seconds: float, **_):
    """Simulate a scene with a setting, and return the observation of the run (`errors.observe`).

    make, kind, n_bodies, seed: as for `made`. setting: solver and time step. seconds: simulated time, s.
    """
    return observe(readings_of(made(make, kind, n_bodies, seed), setting, round(seconds / INTERVAL), INTERVAL))


def time_run(make: Callable, kind: str, n_bodies: int, seed: int, setting: Mapping, *, seconds: float, **_) -> float:
    """Return the computing time of a run for a simulated time of Δt, on average, μs.

    Δt is the time step that the scene has by default, not that of the setting. make, kind, n_bodies, seed, setting,
    seconds: as for `observed`.
    """
    start = made(make, kind, n_bodies, seed)
    return 1e6 * setting_runs.timed(start, setting, seconds) * start.dt / seconds


def observed_rows(
    make: Callable,
    cases: Mapping[Key, tuple[dict, int]],
    *,
    seed: int,
    seconds: float,
    work: Path,
    jobs: int | Executor,
    earlier: str = "",
) -> dict[Key, dict]:
    """Measure the errors of each case. Returns its key -> a row, a dict with the setting and its errors.

    make: function (kind, n_bodies, seed) -> scene, which other processes can import. cases: key -> (setting, number of
    seeds). The first case of a scene is its reference, which has no errors. seed: seed from which those of the scenes
    are made. seconds: simulated time of a run, s. work: folder for the results of finished runs, so that a study of the
    same commit does not compute them again. jobs: number of processes, or an executor. earlier: commit of an earlier
    study. Runs that this study has stored in the folder are taken over. Every `AGAIN`-th run is computed again. Raises
    ValueError if the new run differs in any bit from the stored run.
    """
    common = {"seconds": seconds, "commit": commit()}
    parts = [(key, common | {"kind": key[0], "n_bodies": key[1], "seed": one, "setting": setting})
             for key, (setting, count) in cases.items() for one in parallel.seeds(seed, count)]  # fmt: skip
    parts.sort(key=lambda part: part[0][1] / part[1]["setting"]["dt"])  # runs that take little time come first
    # The observations of a case are in the order of seeds, as are those of its reference. So observations with the same
    # index are of the same scene.
    seen: dict[Key, list] = {key: [] for key in cases}
    how = {"function": partial(observed, make), "work": work, "jobs": jobs}
    found = done("observed", parts=[part | {"earlier": earlier} for _, part in parts], **how)
    for (key, _), stored in zip(parts, found):
        seen[key].append(observation(stored))
    if earlier:
        sample = slice(None, None, AGAIN)
        again = done("again", parts=[part for _, part in parts[sample]], **how)
        for (key, _), stored, new in zip(parts[sample], found[sample], again):
            expect(stored == new, f"earlier: expected a commit with the same bits, got another run of {key}")
    references, rows = {}, {}
    for key, ensemble in seen.items():
        kind, n_bodies, _ = key
        if key[:2] not in references:
            references[key[:2]] = ensemble, make(kind, n_bodies, seed).dt
        true, step = references[key[:2]]
        row = setting_runs.row_of(cases[key][0], step, ensemble, true[: len(ensemble)])
        rows[key] = {"kind": kind, "n_bodies": n_bodies} | row | ({"errors": None} if true is ensemble else {})
    return rows


def timed_rows(
    make: Callable,
    rows: Mapping[Key, dict],
    times: Mapping[Key, int],
    *,
    seed: int,
    seconds: float,
    work: Path,
    earlier: str = "",
) -> list[dict]:
    """Measure the computing times of some cases. Returns the rows with "times", μs, and "us", the median of these.

    No other program should run at the same time. make, seed, seconds, work: as for `observed_rows`. rows: result of
    `observed_rows`. times: key -> number of times to measure. Each is measured in a new process, on a scene with
    another seed. earlier: commit of an earlier study. A case with a single time takes over the time that this study has
    stored in the folder. A case with several times is compared with other engines, so all its times are measured anew.
    """
    common, took = {"seconds": seconds, "commit": commit()}, {key: [] for key in rows}
    scenes = parallel.seeds(seed, max(times.values(), default=0))
    for number, one in enumerate(scenes):
        keys = [key for key in rows if times.get(key, 0) > number]
        parts = [common | {"kind": key[0], "n_bodies": key[1], "seed": one, "setting": rows[key]["setting"]}
                 | {"earlier": earlier if times[key] == 1 else ""} for key in keys]  # fmt: skip
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            jobs = alone if len(scenes) > 1 else 1
            for key, us in zip(keys, done("timed", partial(time_run, make), parts=parts, work=work, jobs=jobs)):
                took[key].append(us)
    return [row | {"us": float(np.median(took[key])) if took[key] else None, "times": took[key]}
            for key, row in rows.items()]  # fmt: skip


# ---- results of finished runs in files, so that an interrupted study can be resumed ----


def done(name: str, function: Callable, parts: Sequence[dict], *, work: Path, jobs: int | Executor) -> list:
    """Call a function once for each part of a study, and return its results in the order of the parts.

    If the folder `work` has a file with the result of a part, and JSON can read it, the result is read from this file.
    Otherwise it is computed and stored. name: beginning of the files' names. function: function that other processes
    can import, and whose result JSON can hold. parts: keyword arguments of the function for each part. The entry
    "earlier" of a part is not passed to the function. This entry is a commit, or "": a result that the folder has for
    this commit is taken over. work: folder of the files. jobs: number of processes or an executor, as for
    `parallel.finished`; each process stores its results.
    """
    work.mkdir(parents=True, exist_ok=True)
    run = partial(_done, name, function, work)
    return parallel.parallel_map(run, parts, jobs=jobs, progress=parallel.progress_bar, text=name)


def _done(name: str, function: Callable, work: Path, part: dict):
    arguments = {key: value for key, value in part.items() if key != "earlier"}
    path = _file(name, work, arguments)
    paths = [_file(name, work, arguments | {"commit": part["earlier"]})] if part.get("earlier") else []
    for stored in (path, *paths):
        with suppress(FileNotFoundError, ValueError):
            result = json.loads(stored.read_text(encoding="utf-8"))
            break
    else:
        result, stored = results.plain(function(**arguments)), None
    if stored != path:
        results.write_json(path, result)
    return result


def _file(name: str, work: Path, arguments: dict) -> Path:
    digest = hashlib.sha256(json.dumps(arguments, sort_keys=True).encode()).hexdigest()[:16]
    return work / f"{name}_{arguments['n_bodies']}_{digest}.json"


# ---- results of the study: the cheapest settings that satisfy a preset ----


def read_study(path) -> dict:
    """Read the results of the study. Returns {"plain": rows of plain piles that have errors, "presets": `presets`}.

    path: path of the results file, relative to the current folder or to the folder of the package's files.
    """
    rows = results.read_results(shipped.find(path))["data"]["rows"]
    return {"plain": [row for row in rows if row["kind"] == "plain" and row["errors"]], "presets": presets(rows)}


def presets(rows: Sequence[Mapping]) -> list[dict]:
    """Return the cheapest setting of each engine whose errors are within the tolerances of a preset.

    rows: rows of the study, with errors and times. Returns a list with a dict for each number of circles and preset:

    * "n_bodies": number of circles;
    * "preset": name of the preset;
    * "kinds": kind of scene -> setting of this package;
    * "peers": name of another engine -> its setting for plain piles;
    * "ratio": [value, low, high], the time of the fastest other engine over the time of this package, for plain piles.

    A setting is {"name", "us", "times", "seeds"}, or None if none is within the tolerances. For this package it is the
    setting that `simulate(accuracy=…)` takes, which leaves a margin to the tolerances (`presets.keeping`). For another
    engine no margin is required.

    The value of the ratio is the median over the processes that measured times. Errors have confidence intervals, and
    low and high show their effect. For low, settings are chosen a second time, with our errors at the upper bounds of
    their intervals and the other engines' errors at the lower bounds. low is the smallest ratio of both choices in any
    process. For high the bounds are exchanged, and the largest ratio is taken. Entries of the ratio are None if they
    are unknown.
    """
    found = {at: candidates_by_cell(rows, at) for at in range(3)}

    def cheapest(n, engine, preset, kind="plain", at=0):
        candidates = found[at].get((n, kind, engine), [])
        kept = keeping(candidates, PRESETS[preset], margin=engine is None and at == 0)
        best = min(kept, key=lambda one: one["us"], default=None)
        return best and {key: best[key] for key in ("name", "us", "times", "seeds")}

    def ratios(n, preset, ours, theirs):
        mine = cheapest(n, None, preset, at=ours)
        rivals = [rival for name in peers.ENGINES if (rival := cheapest(n, name, preset, at=theirs))]
        fastest = min(rivals, key=lambda one: one["us"], default=None)
        # Times with the same index were measured in the same process.
        return mine and fastest and [a / b for a, b in zip(fastest["times"], mine["times"])]

    def ratio(n, preset):
        value, low, high = (ratios(n, preset, *ends) for ends in ((0, 0), (2, 1), (1, 2)))
        if value is None:
            return [None] * 3
        # The minimum includes the value's ratios: the margin can make our setting slower than those at the bounds.
        return [float(np.median(value)), low and min(*low, *value), high and max(*high, *value)]

    kinds = {n: dict.fromkeys(row["kind"] for row in rows if row["n_bodies"] == n) for n in sizes_of(rows)}
    return [
        {
            "n_bodies": n,
            "preset": preset,
            "kinds": {kind: cheapest(n, None, preset, kind) for kind in kinds[n]},
            "peers": {engine: cheapest(n, engine, preset) for engine in peers.ENGINES},
            "ratio": ratio(n, preset),
        }
        for n, preset in product(kinds, PRESETS)
    ]


def candidates_by_cell(rows: Iterable[Mapping], at: int = 0) -> dict[tuple, list[dict]]:
    """Return the rows among which a preset chooses: (circles, kind, engine or None) -> rows of known times and errors.

    Settings with a large error in motions of known results are left out (`presets.KNOWN`). Each row has "errors", name
    -> number, `rounded`. at: 0 for the errors themselves, 1 for the lower and 2 for the upper ends of their intervals.
    """
    cells: dict[tuple, list] = {}
    for row in rows:
        if row["us"] is None or not row["errors"] or row.get("known", 0.0) > KNOWN:
            continue
        known = {name: error for name, error in row["errors"].items() if error}
        errors = {name: rounded(error[at]) for name, error in known.items()}
        key = row["n_bodies"], row["kind"], row["setting"].get("engine")
        cells.setdefault(key, []).append(row | {"errors": errors})
    return cells


def rounded(error: float) -> float:
    """Return an error rounded to three significant digits.

    The table of the presets has errors with three digits. So the table and the study choose the same settings.
    """
    return float(f"{error:.3g}")


def sizes_of(rows: Iterable[Mapping]) -> list[int]:
    """Return the numbers of circles that occur in the rows, ascending."""
    return sorted({row["n_bodies"] for row in rows})
