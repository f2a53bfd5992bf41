"""The study of runs: scenes × settings × seeds -> rows of errors and times; its scenes; the settings of presets.

`observed_rows` measures errors: every setting runs the same scenes, by the functions of `deep_contact.measure`.
`timed_rows` measures times, one after the other, on a machine that does nothing else. The study (run_tradeoff.py), the
check on other scenes (run_tradeoff_verify.py) and Figure 6.16 are lists of scenes and settings for them.

Time steps are those of circles of r = 1 m under g = 9.81 m/s²: what counts is Δt √(g / r).
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
from deep_contact.measure.setting_runs import states_of
from deep_contact.scenes import drum, hopper, lattice_in_box, terrain
from deep_contact.state.constants import GRAVITY, TIME_STEP
from deep_contact.state.state import State
from deep_contact.state.validation import one_of
from deep_contact.studies import piles

RESULTS = {"results": "data/reference/run_tradeoff.json"}
"""The option of figures that draw the study: the path of its results file."""

INTERVAL = 5 * TIME_STEP
"""Time between two observations of a run, s."""

SECONDS = 6.0
"""Duration of a run of the study, s."""


def gas(n_bodies: int, *, gap: float = 1.0, restitution: float = 0.8, seed: int = 0) -> State:
    """Circles on a loose lattice without gravity, whose velocities are drawn; collisions cool it.

    The largest speed is the one for which the time steps are meant, `FASTEST` √(g r) with r = 1 m and g = 9.81 m/s².
    """
    rng = np.random.default_rng(seed)
    lattice = lattice_in_box(n_bodies, gap=gap, restitution=restitution, gravity=(0.0, 0.0), seed=rng)
    most = FASTEST * math.sqrt(-0.5 * GRAVITY[1])  # of a component of the velocity
    velocity = rng.uniform(-most, most, (n_bodies, 2))
    return lattice.replace(name=f"gas_{n_bodies}", bodies=lattice.bodies._replace(velocity=velocity))


def two_densities(n_bodies: int, *, ratio: float, heavy: str = "mixed", seed: int = 0) -> State:
    """A pile in which some circles are `ratio` times as dense as the others.

    heavy: the dense circles: "mixed", 30 % drawn at random; "above" or "below", that half at the start.
    """
    pile = piles.scene(n_bodies, seed)
    height = pile.bodies.position[:, 1]
    chosen = {
        "mixed": np.random.default_rng((seed, 1)).permutation(n_bodies) < 0.3 * n_bodies,
        "above": height > np.median(height),
        "below": height < np.median(height),
    }[one_of("heavy", heavy, ("mixed", "above", "below"))]
    return pile.replace(bodies=pile.bodies._replace(mass=np.where(chosen, ratio, 1.0) * pile.bodies.mass))


def dam_break(n_bodies: int, *, aspect: float = 2.0, room: float = 4.0, seed: int = 0, **options) -> State:
    """A loose lattice, `aspect` times as high as wide, that collapses at the left wall of a box `room` times as wide.

    options: those of `lattice_in_box`.
    """
    lattice = lattice_in_box(n_bodies, columns=max(1, round(math.sqrt(n_bodies / aspect))), seed=seed, **options)
    _, _, width, height = lattice.world.box
    return lattice.replace(name=f"dam_{n_bodies}", world=replace(lattice.world, box=(0, 0, room * width, height)))


def piston(n_bodies: int, *, speed: float = 1.0, seed: int = 0, **options) -> State:
    """A loose lattice that falls beside a moving wall, which pushes the circles along the floor at `speed`, m/s.

    The box is so wide that the pile does not reach its other side: between two walls a row of circles would be a rod,
    which bursts when it fills the gap. options: those of `lattice_in_box`.
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
"""Kind of scene -> arguments of `piles.scene`, or of the function `make`."""

REFERENCE = {"method": "PGS", "sweeps": 20, "dt": TIME_STEP / 16}
"""The setting taken for the limit of small steps. Figure 6.2: the next longer steps give the same within the noise."""


def scene(kind: str, n_bodies: int, seed: int) -> State:
    """A scene of a kind. Piles: the thesis's scene for 100 circles and fewer, otherwise a loose lattice that falls."""
    options = dict(KINDS[kind])
    return options.pop("make", piles.scene)(n_bodies, seed=seed, **options)


# ---- scenes × settings × seeds -> rows ----

Key = tuple[str, int, str]
"""Kind of scene, number of circles, name of the setting."""


@functools.lru_cache(256)
def made(make: Callable, kind: str, n_bodies: int, seed: int) -> State:
    """A scene, made once for all its settings: drawing the thesis's pile takes longer than most runs of it."""
    return make(kind, n_bodies, seed)


def observed(make: Callable, kind: str, n_bodies: int, seed: int, setting: Mapping, *, seconds: float, **_):
    """The observation (`errors.observe`) of one run of a scene with a setting."""
    return observe(states_of(made(make, kind, n_bodies, seed), setting, round(seconds / INTERVAL), INTERVAL))


def timed(make: Callable, kind: str, n_bodies: int, seed: int, setting: Mapping, *, seconds: float, **_) -> float:
    """Mean computing time of the scene's Δt in a run with a setting, μs."""
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
) -> dict[Key, dict]:
    """A row with errors for each case.

    cases: key -> (setting, number of seeds). The first case of a scene is its reference, which has no errors.
    make: (kind, n_bodies, seed) -> scene, a function that can be imported. seconds: duration of a run, s. work: folder
    in which finished parts are kept, so that a study of the same commit does not compute them again.
    """
    common = {"seconds": seconds, "commit": commit()}
    parts = [(key, common | {"kind": key[0], "n_bodies": key[1], "seed": one, "setting": setting})
             for key, (setting, count) in cases.items() for one in parallel.seeds(seed, count)]  # fmt: skip
    parts.sort(key=lambda part: part[0][1] / part[1]["setting"]["dt"])  # quick runs first
    seen: dict[Key, list] = {key: [] for key in cases}  # in the order of seeds: a run meets the reference of its scene
    tasks = [part for _, part in parts]
    for (key, _), stored in zip(parts, done("observed", partial(observed, make), tasks, work=work, jobs=jobs)):
        seen[key].append(observation(stored))
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
    make: Callable, rows: Mapping[Key, dict], times: Mapping[Key, int], *, seed: int, seconds: float, work: Path
) -> list[dict]:
    """The rows with "times", μs, and "us", their median. Nothing else should run meanwhile.

    times: key -> number of times to measure, each in a process of its own, on a scene of another seed.
    """
    common, took = {"seconds": seconds, "commit": commit()}, {key: [] for key in rows}
    scenes = parallel.seeds(seed, max(times.values(), default=0))
    for number, one in enumerate(scenes):
        keys = [key for key in rows if times.get(key, 0) > number]
        parts = [common | {"kind": key[0], "n_bodies": key[1], "seed": one, "setting": rows[key]["setting"]}
                 for key in keys]  # fmt: skip
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            jobs = alone if len(scenes) > 1 else 1
            for key, us in zip(keys, done("timed", partial(timed, make), parts, work=work, jobs=jobs)):
                took[key].append(us)
    return [row | {"us": float(np.median(took[key])) if took[key] else None, "times": took[key]}
            for key, row in rows.items()]  # fmt: skip


# ---- parts that are kept: an interrupted study goes on where it stopped ----


def done(name: str, function: Callable, parts: Sequence[dict], *, work: Path, jobs: int | Executor) -> list:
    """The results of a function for several parts, in the order of the parts. Each part is a dict of its arguments.

    A result is read from its file in the folder `work`. Where there is no file, or JSON cannot read it, the result is
    computed and stored. name: begin of the files' names. function: can be imported, and returns what JSON can hold.
    jobs: as in `parallel.finished`; a process stores its own results.
    """
    work.mkdir(parents=True, exist_ok=True)
    run = partial(_done, name, function, work)
    return parallel.parallel_map(run, parts, jobs=jobs, progress=parallel.progress_bar, text=name)


def _done(name: str, function: Callable, work: Path, arguments: dict):
    digest = hashlib.sha256(json.dumps(arguments, sort_keys=True).encode()).hexdigest()[:16]
    path = work / f"{name}_{arguments['n_bodies']}_{digest}.json"
    with suppress(FileNotFoundError, ValueError):
        return json.loads(path.read_text(encoding="utf-8"))
    result = results.plain(function(**arguments))
    results.write_json(path, result)
    return result


# ---- what the study says ----


def read_study(path) -> dict:
    """A stored study: "plain", its rows of plain piles with errors, and "presets", the `presets` of all its rows.

    path: from the current folder, or else of a file that comes with the package.
    """
    rows = results.read_results(shipped.find(path))["data"]["rows"]
    return {"plain": [row for row in rows if row["kind"] == "plain" and row["errors"]], "presets": presets(rows)}


def presets(rows: Sequence[Mapping]) -> list[dict]:
    """For each size and preset our setting, and the cheapest setting of each rival that keeps the preset.

    Returns [{"n_bodies", "preset", "kinds": kind -> ours, "peers": engine -> on plain piles, "ratio"}]. A setting is
    {"name", "us", "times", "seeds"}, or None where there is none. Ours is what `simulate(accuracy=…)` takes, which
    leaves a margin (`presets.keeping`); a rival's setting may use up the tolerances.
    ratio: time of the fastest rival over ours on plain piles, [value, low, high], None where it is unknown. The value
    is the median over the processes that measured times. Low is the least of these ratios and of those that follow with
    our errors at the upper ends of their intervals and theirs at the lower ends. High is the largest, with ours at the
    lower and theirs at the upper ends.
    """
    known = [row for row in rows if row["us"] is not None and row["errors"] and row.get("known", 0.0) <= KNOWN]

    def cheapest(n, engine, preset, kind="plain", at=0):
        candidates = [
            row | {"errors": {name: rounded(error[at]) for name, error in row["errors"].items() if error}}
            for row in known
            if (row["n_bodies"], row["kind"], row["setting"].get("engine")) == (n, kind, engine)
        ]
        kept = keeping(candidates, PRESETS[preset], margin=engine is None and at == 0)
        best = min(kept, key=lambda one: one["us"], default=None)
        return best and {key: best[key] for key in ("name", "us", "times", "seeds")}

    def ratios(n, preset, ours, theirs):
        mine = cheapest(n, None, preset, at=ours)
        rivals = [rival for name in peers.ENGINES if (rival := cheapest(n, name, preset, at=theirs))]
        fastest = min(rivals, key=lambda one: one["us"], default=None)
        return mine and fastest and [a / b for a, b in zip(fastest["times"], mine["times"])]  # of the same processes

    def ratio(n, preset):
        value, low, high = (ratios(n, preset, *ends) for ends in ((0, 0), (2, 1), (1, 2)))
        if value is None:
            return [None] * 3
        # The values count too: the margin of `accuracy=` can make ours dearer than the settings at the ends.
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


def rounded(error: float) -> float:
    """An error with three digits, as in the presets' table, so that table and study choose the same settings."""
    return float(f"{error:.3g}")


def sizes_of(rows: Iterable[Mapping]) -> list[int]:
    """The numbers of circles of the rows, ascending."""
    return sorted({row["n_bodies"] for row in rows})
