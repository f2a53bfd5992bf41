"""python scripts/run_tradeoff.py: the study of errors against times in runs, for our settings and other engines.

This script has lists of scenes and settings. `studies.runs` simulates them, and measures errors and times. The results
of finished runs are stored in the work folder, so that an interrupted study of one commit can be resumed. After a
change of the lists alone, `--set earlier=COMMIT` takes over the runs of an earlier commit. First,
several processes compute the errors. Then one process measures the times, on a machine that runs nothing else;
`--set timed=false` leaves the times out. `--install` alone measures the errors of the stored settings in motions with a
known result, and writes the table of settings that `dc.simulate` and `dc.recommend` read. `--tolerances` proposes
smaller tolerances for the presets. Figures 6.1 and 6.2 draw the results.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from math import radians, sin, sqrt
from pathlib import Path

import numpy as np

from deep_contact import figures
from deep_contact.accuracy.presets import MARGIN, PRESETS, TABLE, excess, keeping
from deep_contact.figures import Claim, Figure, results
from deep_contact.measure.errors import ERRORS
from deep_contact.measure.settings import name_of
from deep_contact.state.arrays import Bodies
from deep_contact.state.constants import TIME_STEP
from deep_contact.state.state import State
from deep_contact.studies import runs
from deep_contact.studies.known import G, end, known_scene

DENSE_KINDS = [kind for kind in runs.KINDS if "1 : " in kind or kind == "dam break"]
"""Kinds of scenes that need more sweeps: circles of two densities, and the dam break."""

WALLED_KINDS = ["terrain", "hopper", "piston"]
"""Kinds of scenes with segments, which are at rest in the first two and moving in the third."""


def settings(budgets: dict, **options) -> list[dict]:
    """Return a list of settings, one for each number of sub-steps and number of sweeps.

    budgets: number of sub-steps in 0.01 s -> numbers of sweeps. If the number of sub-steps depends on the motion, it is
    (least number, largest number, slop). options: further entries of each setting.
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
HALF, QUARTER, EIGHTH = (2, 16, 0.25), (4, 32, 0.25), (8, 32, 0.25)

FINER = [
    *settings({EIGHTH: (5,), (16, 64, 0.25): (2,)}, **COLOURS, **FEW),
    *settings({(2, 32, 0.1): (10,), (4, 32, 0.1): (5,), EIGHTH: (3,)}, **COLOURS, **NEAR),
    *settings({(16, 32, 0.25): (1,)}, **PGS),
    *settings({(16, 32, 0.25): (1,)}, **PGS, **FEW),
]
"""Settings with few sweeps in small time steps, for the preset with the smallest tolerances.

Other engines have such settings, too.
"""

SMALL = [
    *FINER,
    *settings({1: (4,), 2: (3,), 4: (2,), (1, 4, 1.0): (4,), (1, 8, 0.25): (6,)}, **PGS),
    *settings({HALF: (3, 4), (4, 16, 0.25): (2,), QUARTER: (4,)}, **PGS),
    *settings({1: (4,), 2: (3,), 4: (2,)}, **PGS, **FEW),
    *settings({(1, 8, 0.5): (4,)}, **PSOR),
    *settings({1: (4,)}, **PSOR, **FEW),
    *settings({(1, 8, 0.25): (6,), QUARTER: (3, 5)}, **COLOURS),
    *settings({1: (6,), HALF: (3, 5), QUARTER: (5,)}, **COLOURS, **FEW),
]
"""Settings for most kinds of scenes.

Those with fixed numbers of sub-steps are for presets with large tolerances. Those with numbers of sub-steps that depend
on the motion are for presets with small tolerances.
"""

LARGE = [
    *settings({QUARTER: (4,)}, **PGS),
    *settings({2: (10,), 4: (5,), QUARTER: (3, 5, 10, 20)}, **COLOURS),
    *settings({(1, 16, 0.25): (10, 20)}, **COLOURS, **NEAR),
    *settings({1: (6, 10), 2: (5, 10), 4: (3, 5), (1, 8, 0.5): (6, 10)}, **COLOURS, **FEW),
    *settings({HALF: (5, 10), QUARTER: (5, 10)}, **COLOURS, **FEW),
]
"""Settings for most kinds of scenes with 3,000 circles."""

DENSE = [
    *SMALL,
    *settings({1: (10,), 4: (5,)}, **PGS, **FEW),
    *settings({(1, 8, 0.25): (10,), HALF: (10,), QUARTER: (20,)}, method="PSOR", omega=1.5),
    *settings({(1, 16, 0.25): (6,)}, method="PSOR", omega=1.5, approach=0.02),
    *settings({(1, 8, 0.25): (10,), HALF: (10,)}, **COLOURS),
    *settings({1: (10, 20), 2: (5, 10, 20), 4: (10,), (1, 8, 0.5): (10,)}, **COLOURS, **FEW),
    *settings({HALF: (10, 20, 40), QUARTER: (10, 20, 40)}, **COLOURS, **FEW),
    *settings({HALF: (20,), QUARTER: (20, 40), EIGHTH: (10,)}, **COLOURS, **NEAR),
]
"""Settings for `DENSE_KINDS`, with more sweeps in more sub-steps."""

DENSE_LARGE = [
    *settings({1: (10, 20), 2: (10, 20), 4: (10, 20), 8: (10, 20, 40)}, **COLOURS, **FEW),
    *settings({HALF: (10, 20), QUARTER: (5, 10, 20, 40), EIGHTH: (20,)}, **COLOURS, **FEW),
    *settings({HALF: (20,), QUARTER: (20, 40), EIGHTH: (10, 40)}, **COLOURS, **NEAR),
]
"""Settings for `DENSE_KINDS` with 3,000 circles."""

LARGEST = [
    *settings({2: (5, 10), 4: (5,), HALF: (10,), QUARTER: (5, 10)}, **COLOURS, **FEW),
    *settings({QUARTER: (10,)}, **COLOURS),
    *settings({(1, 16, 0.25): (20,)}, **COLOURS, **NEAR),
]
"""Settings for 10,000 circles: those of `LARGE` that took the least time for a preset with 3,000 circles, or nearly."""

DENSE_LARGEST = [
    *settings({2: (20,), 4: (10, 20), 8: (20,), QUARTER: (10, 20)}, **COLOURS, **FEW),
    *settings({QUARTER: (20,), EIGHTH: (10, 40)}, **COLOURS, **NEAR),
]
"""Settings for `DENSE_KINDS` with 10,000 circles, chosen from `DENSE_LARGE` as `LARGEST` is from `LARGE`."""

LADDER = [
    *settings({1: (2, 3, 4, 6, 10, 20, 50), 2: (1, 2, 3, 5, 10, 20), 4: (1, 2, 3, 5, 10, 20)}, **PGS),
    *settings({8: (1, 2, 4, 10, 20), 16: (1, 2, 5, 20)}, **PGS),
    *settings({2: (10,), 4: (5,), 8: (10,)}, **COLOURS),
    *settings({1: (10, 20)}, method="PSOR", omega=1.75, friction_omega=1.45),
    *(one for method in ("NNCG", "NesterovPGS") for one in settings({1: (10, 20)}, method=method)),
]
"""Settings for plain piles only, which show the effect of sweeps, time steps and methods (Figures 6.1 and 6.2)."""

LARGE_LADDER = settings({1: (4, 10, 20), 2: (2, 5, 10, 20), 4: (2, 3, 5, 10), 8: (2, 4, 20), 32: (20,)}, **PGS)
LARGEST_LADDER = [
    *settings({1: (10, 20), 2: (5,), 4: (3,), 8: (2, 20)}, **PGS),
    *settings({1: (10,)}, **COLOURS, **FEW),
    *settings({2: (10,), 4: (5,)}, **COLOURS),
]
"""Settings for plain piles of 10,000 circles, to compare small time steps.

Some are here because they kept a preset in earlier studies.
"""

PYMUNK, BOX2D, BOX2D_V3 = {"engine": "pymunk"}, {"engine": "Box2D 2.3"}, {"engine": "Box2D v3"}
BY_SLOP = {1: (4, 6, 10, 20, 30), 2: (2, 3, 4, 6, 10), 4: (1, 2, 3, 4), 8: (1, 2)}
BY_POSITIONS = {1: (4, 10, 20, 30), 2: (2, 4, 6, 10), 4: (1, 2, 4), 8: (1, 2)}
BY_STIFFNESS = {1: (1, 2, 4, 6, 8), 2: (1, 2, 4), 4: (1, 2), 8: (1,)}
PEERS = [
    *settings(BY_SLOP, **PYMUNK),
    *settings(BY_SLOP | {8: (1, 2, 4), 16: (1, 2)}, **PYMUNK, slop=0.25),
    *settings({1: (10,), 2: (4,), 4: (2,)}, **PYMUNK, bias=0.1),
    *settings({1: (4, 10), 2: (2, 4), 4: (1, 2)}, **PYMUNK, bias=0.4),
    *(one for most in (1, 3) for one in settings(BY_POSITIONS, **BOX2D, position_sweeps=most)),
    *settings({8: (4,), 16: (1, 2)}, **BOX2D, position_sweeps=3),
    *settings(BY_POSITIONS, **BOX2D),
    *settings(BY_STIFFNESS, **BOX2D_V3),
    *(one for hertz in (60.0, 120.0) for one in settings(BY_STIFFNESS, **BOX2D_V3, hertz=hertz)),
    *settings({4: (4,), 8: (2,), 16: (1,)}, **BOX2D_V3, hertz=120.0),
    *settings({4: (4,), 8: (2,), 16: (1,)}, **BOX2D_V3, hertz=240.0),
]
"""Settings of other engines, with several numbers of iterations and time steps.

Options of one engine vary as well: slop and bias of pymunk, position iterations of Box2D 2.3, stiffness of Box2D v3.
"""

LARGE_PEERS = [
    *settings({1: (4, 6, 10, 20), 2: (4, 6, 10), 4: (2, 4), 8: (2,)}, **PYMUNK, slop=0.25),
    *settings({1: (4, 6, 10), 2: (4, 6, 10), 4: (2, 4)}, **PYMUNK),
    *settings({1: (10,), 2: (4,)}, **PYMUNK, bias=0.4),
    *settings({2: (4,)}, **PYMUNK, bias=0.1),
    *settings({1: (10,), 2: (4,)}, **BOX2D, position_sweeps=1),
    *settings({1: (10,), 2: (4, 10), 4: (2, 4), 8: (2,)}, **BOX2D, position_sweeps=3),
    *settings({1: (10,), 2: (4, 6), 4: (2,)}, **BOX2D),
    *settings({1: (4, 6), 2: (4,)}, **BOX2D_V3, hertz=60.0),
    *settings({1: (6, 8), 2: (2, 4), 4: (2, 4)}, **BOX2D_V3, hertz=120.0),
    *settings({2: (8,), 4: (4, 8)}, **BOX2D_V3, hertz=240.0),
]
"""Settings of other engines for 3,000 circles.

They are those of `PEERS` that took the least time for a preset with 1,000 circles, or nearly, and similar settings.
"""

LARGEST_PEERS = [
    *settings({1: (4, 6, 10, 20), 2: (4, 6, 10), 4: (2, 4), 8: (4,)}, **PYMUNK, slop=0.25),
    *settings({1: (4, 6, 10), 2: (4,), 4: (4,)}, **PYMUNK),
    *settings({1: (10,)}, **PYMUNK, bias=0.4),
    *(one for one in LARGE_PEERS if one["engine"] != "pymunk"),
]
"""Settings of other engines for 10,000 circles.

For both versions of Box2D they are all of `LARGE_PEERS`. For pymunk they are those that took the least time with 3,000
circles. Each engine has more settings than `LARGEST` has for this package.
"""

FINER_LARGE = [
    *settings({(2, 32, 0.1): (10,), (4, 32, 0.1): (5, 10), EIGHTH: (5,)}, **COLOURS, **NEAR),
    *settings({EIGHTH: (5,)}, **COLOURS, **FEW),
]
FINER_DENSE = [
    *settings({EIGHTH: (20,), (8, 64, 0.1): (10, 20), (16, 64, 0.25): (10,)}, **COLOURS, **NEAR),
    *settings({(16, 64, 0.25): (10,)}, **COLOURS, **FEW),
]
MORE = {
    "plain": dict.fromkeys(("3000", "10000"), FINER_LARGE),
    "mixed radii": dict.fromkeys(("3000", "10000"), FINER_LARGE),
    "hopper": {"3000": [*FINER_LARGE, *settings({(2, 32, 0.1): (20,)}, **COLOURS, **NEAR)]},
    "no friction": {
        **{n: settings({4: (3,), 8: (2, 3)}, **PGS) for n in ("100", "300", "1000")},
        "3000": settings({4: (10,), 8: (3, 5)}, **COLOURS, **FEW),
    },
    "drum": {n: settings({2: (4,), 4: (2,)}, **PGS, **FEW) for n in ("100", "300", "1000", "3000")},
    "densities 1 : 100": dict.fromkeys(("300", "1000", "10000"), FINER_DENSE),
    "heavy on light 1 : 10": {"10000": settings({4: (30,)}, **COLOURS, **FEW)},
    "heavy on light 1 : 100": {
        **dict.fromkeys(("300", "1000"), FINER_DENSE),
        "3000": [*FINER_DENSE, *settings({(8, 64, 0.1): (40,), (16, 64, 0.25): (20,)}, **COLOURS, **NEAR)],
        "10000": settings({8: (40,), 16: (20,), 32: (20,)}, **COLOURS, **FEW),
    },
}
"""Kind of scene -> number of circles -> further settings.

Without these, no setting kept the tolerances of some preset, or only one that takes much time.
"""

LISTS = {
    "settings": {"100": SMALL, "300": SMALL, "1000": SMALL, "3000": LARGE, "10000": LARGEST},
    "dense": {"100": DENSE, "300": DENSE, "1000": DENSE, "3000": DENSE_LARGE, "10000": DENSE_LARGEST},
    "walled": {"100": DENSE, "300": DENSE, "1000": DENSE, "3000": [*LARGE, *DENSE_LARGE]},
    "ladder": {"100": LADDER, "300": LADDER, "1000": LADDER, "3000": LARGE_LADDER, "10000": LARGEST_LADDER},
    "peers": {"100": PEERS, "300": PEERS, "1000": PEERS, "3000": LARGE_PEERS, "10000": LARGEST_PEERS},
}
"""Name of a list -> number of circles -> settings.

"settings" is for most kinds of scenes, "dense" for `DENSE_KINDS` and "walled" for `WALLED_KINDS`. "ladder" and "peers"
are for plain piles only.
"""


# ---- motions with a known result ----
#
# An over-relaxed solver with few sweeps can be accurate in piles and inaccurate in the simplest impact. A sweep with ω
# leaves 1 − ω of the error of a contact that has no neighbours. A study of piles does not show this error.


def error(setting: Mapping) -> float:
    """Return the largest error of a setting in the `motions`, as a percentage of their speeds."""
    return 100.0 * max(wrong(end(setting, scene, seconds).bodies) for scene, seconds, wrong in motions())


def motions() -> Iterator[tuple[State, float, Callable[[Bodies], float]]]:
    """Yield motions with a known result: (scene, duration, s, function from the final bodies to their error).

    The error is a share of the scene's speed. These are the motions:

    * A disc with a radius of 1 m hits the floor at 6 m/s. k_t = m / 3, so it sticks if μ (1 + e) v_n ≥ v_t / 3, and
      slides on otherwise (Coulomb's law).
    * Two discs collide (Newton's law).
    * A disc slides until it rolls (Coriolis 1835).
    * A disc rolls down a slope, and another one slides down a slope.
    """
    for friction, restitution in ((5.0, 0.0), (0.1, 0.0), (0.1, 0.5)):
        tangent = min(friction * (1.0 + restitution) * 6.0, 3.0 / 3.0)  # tangent impulse over mass, λ_t / m, m/s
        after = 3.0 - tangent, 6.0 * restitution, -2.0 * tangent
        material = {"friction": friction, "restitution": restitution}
        disc = known_scene([[10.0, 2.0]], gravity=0.0, **material, velocity=[3.0, -6.0])
        yield disc, 0.4, lambda bodies, after=after: _off((*bodies.velocity[0], bodies.spin[0]), after) / 6.0
    for mass in (1.0, 100.0):
        velocity = [[4.0, 0.0], [-4.0, 0.0]]
        pair = known_scene([[10.0, 20.0], [13.0, 20.0]], gravity=0.0, mass=[1.0, mass], velocity=velocity)
        together = 4.0 * (1.0 - mass) / (1.0 + mass)
        yield pair, 0.6, lambda bodies, v=together: _off(bodies.velocity[:, 0], v) / 4.0
    sliding = known_scene([[10.0, 1.0]], friction=0.3, velocity=[4.0, 0.0])
    yield sliding, 1.5, lambda bodies: _off(bodies.velocity[0, 0], 8.0 / 3.0) / 4.0
    slopes = (0.5, 20.0, 4.0 / 3.0 * G * sin(radians(20.0))), (0.2, 45.0, 1.6 * G * sqrt(0.5))
    for friction, angle, speed in slopes:
        disc = known_scene([[10.0, 1.0]], slope=angle, friction=friction)
        yield disc, 2.0, lambda bodies, v=speed: _off(bodies.velocity[0, 0], v) / v


def _off(values, right) -> float:
    return float(np.abs(np.subtract(values, right)).max())


def wanted(options: Mapping) -> dict[tuple[str, int, str], tuple[dict, int]]:
    """Return the cases of the study: (kind, n_bodies, name of the setting) -> (setting, number of seeds).

    If several lists have a setting with the same name, the first one is taken. It has the most seeds.
    """
    cases_by_name = {}
    for n, kinds in options["seeds"].items():
        for kind, count in kinds.items():
            of = "dense" if kind in DENSE_KINDS else "walled" if kind in WALLED_KINDS else "settings"
            lists = [([runs.REFERENCE, *LISTS[of][n], *MORE.get(kind, {}).get(n, [])], count)]
            if kind == "plain":
                lists += [(LISTS["ladder"][n], options["ladder_seeds"][n])]
                lists += [(LISTS["peers"][n][:: options["peers"]], options["peer_seeds"].get(n, 0))]
            for setting, seeds in ((setting, seeds) for listed, seeds in lists if seeds for setting in listed):
                cases_by_name.setdefault((kind, int(n), name_of(setting)), (setting, seeds))
    return cases_by_name


def compute(options, seed, jobs, progress):
    """Measure all scenes and settings, and choose the settings of the presets."""
    common = {"work": Path(options["work"]), "seed": seed, **{name: options[name] for name in ("seconds", "earlier")}}
    rows = runs.observed_rows(runs.scene_of_kind, wanted(options), **common, jobs=jobs)
    times = {key: times_of(row, options["processes"]) for key, row in rows.items() if options["timed"]}
    return judged(runs.timed_rows(runs.scene_of_kind, rows, times, **common))


def times_of(row: Mapping, processes: int) -> int:
    """Return how many times the computing time of a row is measured, each time in a new process.

    It is `processes` for plain piles with errors that may be within a preset's tolerances, because the ratio of our
    time to that of another engine may depend on this row.
    """
    if not row["errors"]:
        return 0
    if row["kind"] != "plain":
        return 1
    if row["setting"]["dt"] < TIME_STEP / 16:
        return 0  # only Figure 6.2 uses the smallest time steps, and it draws no times
    least = {name: error[1] for name, error in row["errors"].items() if error}
    return processes if any(excess(least, most) <= 1 for most in PRESETS.values()) else 1


def judged(rows: list[dict]) -> dict:
    """Return the data of the study: the rows, to which "known" is added, and the settings of the presets.

    "known" is the `error` of a setting of this package in motions with a known result, %.
    """
    ours = {row["name"]: row["setting"] for row in rows if "engine" not in row["setting"]}
    known = {name: runs.rounded(error(setting)) for name, setting in ours.items()}
    rows = [row | ({"known": known[row["name"]]} if row["name"] in known else {}) for row in rows]
    return {"errors": ERRORS, "rows": rows, "presets": runs.presets(rows)}


def table(data):
    """Return the rows of the table: for each preset the setting for plain piles, its time, and the ratio of times.

    The ratio is the time of the fastest other engine over that of this package.
    """
    rows = [["circles", "preset", "setting", "µs", "fastest rival / ours"]]
    for row in data["presets"]:
        ours = row["kinds"].get("plain") or {"name": None, "us": None}
        rows.append([row["n_bodies"], row["preset"], ours["name"], ours["us"], row["ratio"][0]])
    return rows


def installed(data: Mapping, cpu: str) -> dict:
    """Return the table that the presets read: settings with errors and times by number of circles and kind of scene.

    cpu: name of the processor on which the times were measured.
    """
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


UNUSED = ("creep", "restlessness", "contacts", "forces", "impact")
"""Errors whose tolerances most settings use in small part, since other errors choose the settings."""

NICE = tuple(digits * 10.0**power for power in (-2, -1, 0, 1) for digits in (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8))
"""Tolerances that are tried."""


def tighter(rows: list[Mapping], *, price: float = 1.0, names: Iterable[str] = UNUSED) -> dict[str, dict[str, float]]:
    """Propose tolerances that are at most as large as those of the presets: name of the preset -> tolerances.

    rows: rows of the study. price: largest factor by which the tolerances of one error may raise the cost of a preset,
    as the geometric mean over all kinds and numbers of circles. With 1, all settings stay as they are. names: errors
    whose tolerances may change. Each gets the least of `NICE` which is at least that of the next tighter preset, and
    with which every kind still has a setting that is kept with as much margin. The errors are taken one by one, and
    each has to keep the tolerances that were reduced before it.
    """
    cells = [of for (_, _, engine), of in runs.candidates_by_cell(rows).items() if engine is None]

    def chosen(tolerances):
        """Return, for each cell, the margin of its cheapest setting, 2 if none is kept, and its cost."""
        found = []
        for best in (min(keeping(of, tolerances), key=lambda one: one["us"], default=None) for of in cells):
            over = 2.0 if best is None else float(excess(best["errors"], tolerances) > MARGIN)
            found.append((over, np.nan if best is None else best["us"]))
        return np.array(found).T

    proposed: dict[str, dict[str, float]] = {}
    least = dict.fromkeys(names, 0.0)
    for preset, tolerances in reversed(PRESETS.items()):
        mine = dict(tolerances)
        for name in names:
            margin, cost = chosen(mine)
            for value in (value for value in NICE if least[name] <= value < mine[name]):
                now, dearer = chosen(mine | {name: value})
                if (now <= margin).all() and np.nanmean(np.log(dearer / cost)) <= np.log(price):
                    mine[name] = value
                    break
        proposed[preset] = least = mine
    return {preset: proposed[preset] for preset in PRESETS}


def tolerance_rows(rows: list[Mapping]) -> list[list[str]]:
    """Return the rows of a table: each error of `UNUSED`, and its tolerance in each preset today and as proposed.

    The proposals are those without a price, and those that may cost 1 % for each error.
    """
    listed = [["error", "tolerances", *PRESETS]]
    proposals = {"today": PRESETS, "for nothing": tighter(rows), "for 1 % each": tighter(rows, price=1.01)}
    for name in UNUSED:
        listed += [[name, what, *(f"{of[preset][name]:g}" for preset in PRESETS)] for what, of in proposals.items()]
    return listed


def claims(data: Mapping) -> Iterator[Claim]:
    """Yield two claims for each number of circles.

    They say whether settings keep the presets, and how long the fastest other engine takes for them.
    """
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
"""Kinds of scenes with more seeds than others."""

FEWER = (*DENSE_KINDS, *WALLED_KINDS)
"""Kinds of scenes with fewer seeds than others."""

DEAR = ("gas", "drum", *WALLED_KINDS)
"""Kinds of scenes that are not run with 10,000 circles. The presets take what was measured with 3,000 circles."""

FULL = {
    "seeds": {"100": {kind: 12 if kind in MANY else 8 for kind in runs.KINDS}}
    | {"300": dict.fromkeys(runs.KINDS, 6), "1000": dict.fromkeys(runs.KINDS, 6)}
    | {"3000": {kind: 4 if kind in FEWER else 6 for kind in runs.KINDS}}
    | {"10000": {kind: 6 if kind in MANY else 3 for kind in runs.KINDS if kind not in DEAR}},
    "peer_seeds": {"100": 12, "300": 6, "1000": 6, "3000": 6, "10000": 3},
    "ladder_seeds": {"100": 12, "300": 6, "1000": 6, "3000": 6, "10000": 6},
    "peers": 1, "seconds": runs.SECONDS, "processes": 3, "timed": True, "work": "runs/run_tradeoff",
    "earlier": "",
}  # fmt: skip
QUICK = {
    "seeds": {"100": {"plain": 4}, "300": {"plain": 3}}, "peer_seeds": {"100": 4},
    "ladder_seeds": {"100": 4, "300": 3}, "peers": 3, "seconds": 4.0, "processes": 1,
}  # fmt: skip
FIGURE = Figure("B.3", "Speed for accuracy in runs: errors and times of settings and engines", compute, table,
                claims=claims, options=FULL, quick=QUICK, digits=4, file="run_tradeoff")  # fmt: skip


def install() -> None:
    """Measure the errors of the settings in data/reference in `motions` again, and write the table of the presets."""
    stored = results.reference("run_tradeoff")
    data = stored["data"] | judged(stored["data"]["rows"])
    stored |= {"claims": list(claims(data)), "data": data}
    results.write_results(results.REFERENCE / "run_tradeoff.json", stored, digits=4)
    results.write_json(TABLE, installed(data, stored["provenance"]["cpu"]))


if __name__ == "__main__" and sys.argv[1:] == ["--install"]:
    install()
elif __name__ == "__main__" and sys.argv[1:] == ["--tolerances"]:
    for line in tolerance_rows(results.reference("run_tradeoff")["data"]["rows"]):
        print("  ".join(f"{text:>12}" for text in line))
else:
    figures.run_as_script(FIGURE, __name__)
