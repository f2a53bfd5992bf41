"""python scripts/run_tradeoff.py: the study of speed against accuracy in runs, of settings and of other engines.

A list of scenes and settings, which `studies.runs` runs, times and judges. Every finished part is stored in the work
folder, so an interrupted study of one commit goes on where it stopped. Several processes compute errors; then one
measures times: `--set timed=false` leaves these out, for a machine that is not quiet. `--install` alone judges the
stored settings by known answers and makes their numbers those that `dc.simulate` and `dc.recommend` read. Figures 6.1
and 6.2 draw them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from math import radians, sin, sqrt
from pathlib import Path

import numpy as np

from deep_contact import figures
from deep_contact.accuracy.presets import PRESETS, TABLE, excess
from deep_contact.figures import Claim, Figure, results
from deep_contact.measure.errors import ERRORS
from deep_contact.measure.settings import name_of
from deep_contact.state.arrays import Bodies
from deep_contact.state.constants import TIME_STEP
from deep_contact.state.state import State
from deep_contact.studies import runs
from deep_contact.studies.known import G, end, scene_of

DENSE_KINDS = [kind for kind in runs.KINDS if "1 : " in kind or kind == "dam break"]
"""Kinds that need more sweeps: two densities, and a dam that breaks."""

WALLED_KINDS = ["terrain", "hopper", "piston"]
"""Kinds with segments, still ones and one that moves."""


def settings(budgets: dict, **options) -> list[dict]:
    """A setting with these options for each number of sweeps. budgets: substeps of 0.01 s -> numbers of sweeps.

    Substeps that follow the motion are given as (fewest, most, slop).
    """
    listed = []
    for substeps, sweeps in budgets.items():
        k, *motion = substeps if isinstance(substeps, tuple) else (substeps,)
        by_motion = {"most_substeps": motion[0] // k, "slop": motion[1]} if motion else {}
        listed += [{"sweeps": count, "dt": TIME_STEP / k, **by_motion, **options} for count in sweeps]
    return listed


PGS = {"method": "PGS"}
PSOR = {"method": "PSOR", "omega": 1.3}
COLOURS = {"method": "BatchedPGS"}
FEW = {"position_sweeps": 3}
NEAR = {"approach": 0.015}
HALF, QUARTER = (2, 16, 0.25), (4, 32, 0.25)

SMALL = [
    *settings({1: (4,), 2: (3,), 4: (2,), (1, 4, 1.0): (4,), (1, 8, 0.25): (6,)}, **PGS),
    *settings({HALF: (3, 4), (4, 16, 0.25): (2,), QUARTER: (4,)}, **PGS),
    *settings({1: (4,), 2: (3,), 4: (2,)}, **PGS, **FEW),
    *settings({(1, 8, 0.5): (4,)}, **PSOR),
    *settings({1: (4,)}, **PSOR, **FEW),
    *settings({(1, 8, 0.25): (6,), QUARTER: (3, 5)}, **COLOURS),
    *settings({1: (6,), HALF: (3, 5), QUARTER: (5,)}, **COLOURS, **FEW),
]
"""Settings of most kinds of scenes: fixed steps for the loose presets, by motion for the tight ones."""

LARGE = [
    *settings({QUARTER: (4,)}, **PGS),
    *settings({2: (10,), 4: (5,), QUARTER: (3, 5, 10, 20)}, **COLOURS),
    *settings({(1, 16, 0.25): (10, 20)}, **COLOURS, **NEAR),
    *settings({1: (6, 10), 2: (5, 10), 4: (3, 5), (1, 8, 0.5): (6, 10)}, **COLOURS, **FEW),
    *settings({HALF: (5, 10), QUARTER: (5, 10)}, **COLOURS, **FEW),
]
"""Settings of most kinds of scenes from 3,000 circles on."""

DENSE = [
    *SMALL,
    *settings({1: (10,), 4: (5,)}, **PGS, **FEW),
    *settings({(1, 8, 0.25): (10,), HALF: (10,), QUARTER: (20,)}, method="PSOR", omega=1.5),
    *settings({(1, 16, 0.25): (6,)}, method="PSOR", omega=1.5, approach=0.02),
    *settings({(1, 8, 0.25): (10,), HALF: (10,)}, **COLOURS),
    *settings({1: (10, 20), 2: (5, 10, 20), 4: (10,), (1, 8, 0.5): (10,)}, **COLOURS, **FEW),
    *settings({HALF: (10, 20, 40), QUARTER: (10, 20, 40)}, **COLOURS, **FEW),
    *settings({HALF: (20,), QUARTER: (20, 40), (8, 32, 0.25): (10,)}, **COLOURS, **NEAR),
]
"""Settings for `DENSE_KINDS`: more sweeps in more substeps."""

DENSE_LARGE = [
    *settings({1: (10, 20), 2: (10, 20), 4: (10, 20), 8: (10, 20, 40)}, **COLOURS, **FEW),
    *settings({HALF: (10, 20), QUARTER: (5, 10, 20, 40), (8, 32, 0.25): (20,)}, **COLOURS, **FEW),
    *settings({HALF: (20,), QUARTER: (20, 40), (8, 32, 0.25): (10, 40)}, **COLOURS, **NEAR),
]
"""Settings for `DENSE_KINDS` from 3,000 circles on."""

LARGEST = [
    *settings({2: (5, 10), 4: (5,), HALF: (10,), QUARTER: (5, 10)}, **COLOURS, **FEW),
    *settings({QUARTER: (10,)}, **COLOURS),
    *settings({(1, 16, 0.25): (20,)}, **COLOURS, **NEAR),
]
"""Settings with 10,000 circles: those of `LARGE` that keep a preset most cheaply with 3,000, or nearly."""

DENSE_LARGEST = [
    *settings({2: (20,), 4: (10, 20), 8: (20,), QUARTER: (10, 20)}, **COLOURS, **FEW),
    *settings({QUARTER: (20,), (8, 32, 0.25): (10, 40)}, **COLOURS, **NEAR),
]
"""Settings for `DENSE_KINDS` with 10,000 circles: the same choice from `DENSE_LARGE`."""

LADDER = [
    *settings({1: (2, 3, 4, 6, 10, 20, 50), 2: (1, 2, 3, 5, 10, 20), 4: (1, 2, 3, 5, 10, 20)}, **PGS),
    *settings({8: (1, 2, 4, 10, 20), 16: (1, 2, 5, 20)}, **PGS),
    *settings({2: (10,), 4: (5,), 8: (10,)}, **COLOURS),
    *settings({1: (10, 20)}, method="PSOR", omega=1.75, friction_omega=1.45),
    *(one for method in ("NNCG", "NesterovPGS") for one in settings({1: (10, 20)}, method=method)),
]
"""Settings on plain piles alone: what sweeps, steps and methods do to an error (Figures 6.1 and 6.2)."""

LARGE_LADDER = settings({1: (4, 10, 20), 2: (2, 5, 10, 20), 4: (2, 3, 5, 10), 8: (2, 4, 20), 32: (20,)}, **PGS)
LARGEST_LADDER = [
    *settings({1: (10, 20), 2: (5,), 4: (3,), 8: (2, 20)}, **PGS),
    *settings({1: (10,)}, **COLOURS, **FEW),
    *settings({2: (10,), 4: (5,)}, **COLOURS),
]
"""Settings on plain piles of 10,000 circles: a comparison for smaller steps, and what kept a preset in old studies."""

PYMUNK, BOX2D, BOX2D_V3 = {"engine": "pymunk"}, {"engine": "Box2D 2.3"}, {"engine": "Box2D v3"}
BY_SLOP = {1: (4, 6, 10, 20, 30), 2: (2, 3, 4, 6, 10), 4: (1, 2, 3, 4), 8: (1, 2)}
BY_POSITIONS = {1: (4, 10, 20, 30), 2: (2, 4, 6, 10), 4: (1, 2, 4), 8: (1, 2)}
BY_STIFFNESS = {1: (1, 2, 4, 6, 8), 2: (1, 2, 4), 4: (1, 2), 8: (1,)}
PEERS = [
    *settings(BY_SLOP, **PYMUNK),
    *settings(BY_SLOP, **PYMUNK, slop=0.25),
    *settings({1: (10,), 2: (4,), 4: (2,)}, **PYMUNK, bias=0.1),
    *settings({1: (4, 10), 2: (2, 4), 4: (1, 2)}, **PYMUNK, bias=0.4),
    *(one for most in (1, 3) for one in settings(BY_POSITIONS, **BOX2D, position_sweeps=most)),
    *settings(BY_POSITIONS, **BOX2D),
    *settings(BY_STIFFNESS, **BOX2D_V3),
    *(one for hertz in (60.0, 120.0) for one in settings(BY_STIFFNESS, **BOX2D_V3, hertz=hertz)),
]
"""Settings of other engines by iterations, Δt and their own knobs: slop and bias, position iterations, stiffness."""

LARGE_PEERS = [
    *settings({1: (4, 6, 10, 20), 2: (4, 6, 10), 4: (2, 4), 8: (2,)}, **PYMUNK, slop=0.25),
    *settings({1: (4, 6, 10), 2: (4, 6, 10), 4: (2, 4)}, **PYMUNK),
    *settings({1: (10,), 2: (4,)}, **PYMUNK, bias=0.4),
    *settings({2: (4,)}, **PYMUNK, bias=0.1),
    *settings({1: (10,), 2: (4,)}, **BOX2D, position_sweeps=1),
    *settings({2: (4, 10), 4: (4,)}, **BOX2D, position_sweeps=3),
    *settings({2: (6,)}, **BOX2D),
    *settings({1: (4, 6), 2: (4,)}, **BOX2D_V3, hertz=60.0),
    *settings({1: (6, 8), 2: (2, 4), 4: (2, 4)}, **BOX2D_V3, hertz=120.0),
    *settings({2: (8,), 4: (4,)}, **BOX2D_V3, hertz=240.0),
]
"""Settings with 3,000 circles: those of `PEERS` that kept a preset at 1,000 most cheaply, or nearly, and neighbours."""

LARGEST_PEERS = [
    *settings({1: (4, 6, 10, 20), 2: (4, 6, 10), 4: (2, 4)}, **PYMUNK, slop=0.25),
    *settings({1: (4, 6, 10), 2: (4,), 4: (4,)}, **PYMUNK),
    *settings({1: (10,)}, **PYMUNK, bias=0.4),
    *settings({1: (10,), 2: (4,)}, **BOX2D, position_sweeps=1),
    *settings({2: (4,), 4: (4,)}, **BOX2D, position_sweeps=3),
    *(one for one in LARGE_PEERS if one["engine"] == "Box2D v3"),
]
"""Settings with 10,000 circles: all of `LARGE_PEERS` for the fastest rival, for others the cheapest with 3,000."""

MORE = {
    "no friction": {"100": settings({4: (3,), 8: (2,)}, **PGS), "1000": settings({4: (3,), 8: (2, 3)}, **PGS)}
    | {"3000": settings({4: (10,), 8: (3, 5)}, **COLOURS, **FEW)},
    "drum": {n: settings({2: (4,), 4: (2,)}, **PGS, **FEW) for n in ("100", "1000", "3000")},
    "heavy on light 1 : 10": {"10000": settings({4: (30,)}, **COLOURS, **FEW)},
    "heavy on light 1 : 100": {"10000": settings({8: (40,), 16: (20,), 32: (20,)}, **COLOURS, **FEW)},
}
"""Further settings of a kind, by size: without them no setting kept one of its presets, or only at a high price."""

LISTS = {
    "settings": {"100": SMALL, "300": SMALL, "1000": SMALL, "3000": LARGE, "10000": LARGEST},
    "dense": {"100": DENSE, "1000": DENSE, "3000": DENSE_LARGE, "10000": DENSE_LARGEST},
    "walled": {"100": DENSE, "1000": DENSE, "3000": [*LARGE, *DENSE_LARGE]},
    "ladder": {"100": LADDER, "300": LARGE_LADDER, "1000": LADDER, "3000": LARGE_LADDER} | {"10000": LARGEST_LADDER},
    "peers": {"100": PEERS, "300": [], "1000": PEERS, "3000": LARGE_PEERS, "10000": LARGEST_PEERS},
}
"""Settings by number of circles: of most kinds, of `DENSE_KINDS`, of `WALLED_KINDS`; two lists of plain piles alone."""


# ---- motions with known answers ----
#
# An over-relaxed solver with few sweeps can be good at piles and wrong in the simplest impact: a sweep with ω leaves
# 1 − ω of a lone contact's error. A study of piles does not show this error.


def error(setting: Mapping) -> float:
    """The largest error of a setting among `motions`, % of their speeds. setting: as `solver_of` reads it."""
    return 100.0 * max(wrong(end(setting, scene, seconds).bodies) for scene, seconds, wrong in motions())


def motions() -> Iterator[tuple[State, float, Callable[[Bodies], float]]]:
    """Yields (scene, duration, s, function from the bodies at the end to their error, as a share of the scene's speed).

    A disc of 1 m hits the floor at 6 m/s: k_t = m / 3, so it sticks where μ (1 + e) v_n ≥ v_t / 3, and otherwise slides
    on (Coulomb's law). Two discs meet (Newton's law). A disc slides until it rolls (Coriolis 1835), rolls or slides
    down a slope.
    """
    for friction, restitution in ((5.0, 0.0), (0.1, 0.0), (0.1, 0.5)):
        tangent = min(friction * (1.0 + restitution) * 6.0, 3.0 / 3.0)  # λ_t / m, m/s
        after = 3.0 - tangent, 6.0 * restitution, -2.0 * tangent
        material = {"friction": friction, "restitution": restitution}
        disc = scene_of([[10.0, 2.0]], gravity=0.0, **material, velocity=[3.0, -6.0])
        yield disc, 0.4, lambda bodies, after=after: _off((*bodies.velocity[0], bodies.spin[0]), after) / 6.0
    for mass in (1.0, 100.0):
        velocity = [[4.0, 0.0], [-4.0, 0.0]]
        pair = scene_of([[10.0, 20.0], [13.0, 20.0]], gravity=0.0, mass=[1.0, mass], velocity=velocity)
        together = 4.0 * (1.0 - mass) / (1.0 + mass)
        yield pair, 0.6, lambda bodies, v=together: _off(bodies.velocity[:, 0], v) / 4.0
    sliding = scene_of([[10.0, 1.0]], friction=0.3, velocity=[4.0, 0.0])
    yield sliding, 1.5, lambda bodies: _off(bodies.velocity[0, 0], 8.0 / 3.0) / 4.0
    slopes = (0.5, 20.0, 4.0 / 3.0 * G * sin(radians(20.0))), (0.2, 45.0, 1.6 * G * sqrt(0.5))
    for friction, angle, speed in slopes:
        disc = scene_of([[10.0, 1.0]], slope=angle, friction=friction)
        yield disc, 2.0, lambda bodies, v=speed: _off(bodies.velocity[0, 0], v) / v


def _off(values, right) -> float:
    return float(np.abs(np.subtract(values, right)).max())


def wanted(options: Mapping) -> dict[tuple[str, int, str], tuple[dict, int]]:
    """(Kind, n_bodies, name) -> (setting, number of seeds). Of settings with one name the first has most seeds."""
    cases_by_name = {}
    for n, kinds in options["seeds"].items():
        for kind, count in kinds.items():
            of = "dense" if kind in DENSE_KINDS else "walled" if kind in WALLED_KINDS else "settings"
            lists = [([runs.REFERENCE, *LISTS[of][n], *MORE.get(kind, {}).get(n, [])], count)]
            if kind == "plain":
                lists += [(LISTS["ladder"][n], options["ladder_seeds"][n])]
                lists += [(LISTS["peers"][n][:: options["peers"]], options["peer_seeds"][n])]
            for setting, seeds in ((setting, seeds) for listed, seeds in lists for setting in listed):
                cases_by_name.setdefault((kind, int(n), name_of(setting)), (setting, seeds))
    return cases_by_name


def compute(options, seed, jobs, progress):
    """Rows of all scenes and settings, and the settings that the presets take."""
    common = {"work": Path(options["work"]), "seconds": options["seconds"], "seed": seed}
    rows = runs.observed_rows(runs.scene, wanted(options), **common, jobs=jobs)
    times = {key: times_of(row, options["processes"]) for key, row in rows.items() if options["timed"]}
    return judged(runs.timed_rows(runs.scene, rows, times, **common))


def times_of(row: Mapping, processes: int) -> int:
    """How often the time of a row is measured: in several processes where ratios to rivals may rest on it."""
    if not row["errors"]:
        return 0
    if row["kind"] != "plain":
        return 1
    if row["setting"]["dt"] < TIME_STEP / 8:
        return 0  # the smallest steps are there for Figure 6.2 alone
    least = {name: error[1] for name, error in row["errors"].items() if error}
    return processes if any(excess(least, most) <= 1 for most in PRESETS.values()) else 1


def judged(rows: list[dict]) -> dict:
    """The rows, with the errors of our settings where the answer is known, and the settings that the presets take."""
    ours = {row["name"]: row["setting"] for row in rows if "engine" not in row["setting"]}
    known = {name: runs.rounded(error(setting)) for name, setting in ours.items()}
    rows = [row | ({"known": known[row["name"]]} if row["name"] in known else {}) for row in rows]
    return {"errors": ERRORS, "rows": rows, "presets": runs.presets(rows)}


def table(data):
    """The setting of each preset on plain piles, its time, and that of the fastest other engine over it."""
    rows = [["circles", "preset", "setting", "µs", "fastest rival / ours"]]
    for row in data["presets"]:
        ours = row["kinds"].get("plain") or {"name": None, "us": None}
        rows.append([row["n_bodies"], row["preset"], ours["name"], ours["us"], row["ratio"][0]])
    return rows


def installed(data: Mapping, cpu: str) -> dict:
    """The table that the presets read: settings with errors and times by size and kind of scene."""
    settings: dict = {}
    for row in data["rows"]:
        if "engine" in row["setting"] or row["us"] is None or not row["errors"]:
            continue
        options = {key: value for key, value in row["setting"].items() if key != "dt"} | {"tolerance": None}
        new = {"name": row["name"], "options": options, "dt": row["setting"]["dt"], "known": row["known"]}
        new |= {"us": {}, "errors": {}}
        entry, n = settings.setdefault(row["name"], new), str(row["n_bodies"])
        entry["us"].setdefault(n, {})[row["kind"]] = round(row["us"], 2)
        errors = {key: runs.rounded(value[0]) for key, value in row["errors"].items() if value}
        entry["errors"].setdefault(n, {})[row["kind"]] = errors
    kinds: dict[str, list] = {}
    for n, kind in sorted({(row["n_bodies"], row["kind"]) for row in data["rows"]}):
        kinds.setdefault(kind, []).append(n)
    return {"cpu": cpu, "sizes": runs.sizes_of(data["rows"]), "kinds": kinds, "settings": list(settings.values())}


def claims(data: Mapping) -> Iterator[Claim]:
    """Whether presets are kept, and what the fastest rival pays for them."""
    for n in runs.sizes_of(data["presets"]):
        mine = {row["preset"]: row for row in data["presets"] if row["n_bodies"] == n}
        missing = {preset: [kind for kind, ours in row["kinds"].items() if not ours] for preset, row in mine.items()}
        missing = {preset: kinds for preset, kinds in missing.items() if kinds}
        text = f"on each kind of scene some setting keeps every preset, {n:,} circles"
        yield Claim(text, None, not missing, {"kinds without one": missing})
        if ratios := {preset: row["ratio"][0] for preset, row in mine.items() if row["ratio"][0]}:
            ahead = sum(ratio >= 5 for ratio in ratios.values()) >= 2 and min(ratios.values()) >= 1
            text = f"5 times cheaper than the fastest rival for two presets, dearer for none, {n:,} circles"
            yield Claim(text, None, ahead, ratios)


MANY = ("plain", "piston")
"""Kinds with more seeds than others."""

FEWER = (*DENSE_KINDS, *WALLED_KINDS)
"""Kinds with fewer seeds than others."""

DEAR = ("gas", "drum", *WALLED_KINDS)
"""Kinds that are not run with 10,000 circles: they take what was measured with 3,000."""

FULL = {
    "seeds": {"100": {kind: 12 if kind in MANY else 8 for kind in runs.KINDS}, "1000": dict.fromkeys(runs.KINDS, 6)}
    | {"3000": {kind: 4 if kind in FEWER else 6 for kind in runs.KINDS}}
    | {"10000": {kind: 6 if kind in MANY else 3 for kind in runs.KINDS if kind not in DEAR}},
    "peer_seeds": {"100": 12, "1000": 6, "3000": 6, "10000": 3},
    "ladder_seeds": {"100": 12, "1000": 6, "3000": 6, "10000": 6},
    "peers": 1, "seconds": runs.SECONDS, "processes": 3, "timed": True, "work": "runs/run_tradeoff",
}  # fmt: skip
QUICK = {
    "seeds": {"100": {"plain": 4}, "300": {"plain": 3}}, "peer_seeds": {"100": 4, "300": 3},
    "ladder_seeds": {"100": 4, "300": 3}, "peers": 3, "seconds": 4.0, "processes": 1,
}  # fmt: skip
FIGURE = Figure("B.3", "Speed for accuracy in runs: errors and times of settings and engines", compute, table,
                claims=claims, options=FULL, quick=QUICK, digits=4, file="run_tradeoff")  # fmt: skip


def install() -> None:
    """Judge the settings of data/reference by known answers once more, and make its numbers those of the presets."""
    stored = results.reference("run_tradeoff")
    data = stored["data"] | judged(stored["data"]["rows"])
    stored |= {"claims": list(claims(data)), "data": data}
    results.write_results(results.REFERENCE / "run_tradeoff.json", stored, digits=4)
    results.write_json(TABLE, installed(data, stored["provenance"]["cpu"]))


if __name__ == "__main__" and sys.argv[1:] == ["--install"]:
    install()
else:
    figures.run_as_script(FIGURE, __name__)
