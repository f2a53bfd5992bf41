"""The study of speed against accuracy in runs: errors and times of settings and of other engines.

    python scripts/run_tradeoff.py [--quick] [--jobs J] [--seed S] [--out FILE] [--work FOLDER]
    python scripts/run_tradeoff.py --errors     only the parts that need no quiet machine
    python scripts/run_tradeoff.py --add        errors of settings that the results file lacks, and times of all
    python scripts/run_tradeoff.py --known      only judge the settings of the results file by answers that are known

A list of scenes and settings, which `deep_contact.trade` runs, times and judges as those of a user's own scene. Every
finished part is stored in the work folder, so an interrupted study goes on where it stopped. Several processes
compute errors; then one process measures times. `--install` makes these the numbers that `dc.simulate` and
`dc.recommend` read. Figures 6.1, 6.2 and 6.11 draw the results file.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from deep_contact import parallel, run_errors, trade
from deep_contact.constants import TIME_STEP
from deep_contact.presets import TABLE
from deep_contact.reporting import results
from deep_contact.studies import runs
from deep_contact.studies.known import error as known_error
from deep_contact.studies.parts import done
from deep_contact.validation import expect


def settings(budgets: dict, **options) -> list[dict]:
    """Settings with these options. budgets: substeps of 0.01 s -> numbers of sweeps.

    Substeps that follow the motion are (fewest, most, slop).
    """
    listed = []
    for substeps, sweeps in budgets.items():
        k, *motion = substeps if isinstance(substeps, tuple) else (substeps,)
        by_motion = {"most_substeps": motion[0] // k, "slop": motion[1]} if motion else {}
        listed += [{"sweeps": count, "dt": TIME_STEP / k, **by_motion, **options} for count in sweeps]
    return listed


PGS, PSOR = {"method": "PGS"}, {"method": "PSOR", "omega": 1.3}
COLOURS = {"method": "BatchedPGS"}
FEW = {"position_sweeps": 3}
NEAR = {"approach": 0.015}
HALF, QUARTER = (2, 16, 0.25), (4, 32, 0.25)

SMALL = [
    *settings({1: (4,), 2: (3,), 4: (2,), (1, 4, 1.0): (4,), (1, 8, 0.5): (4,), (1, 8, 0.25): (6,)}, **PGS),
    *settings({HALF: (3, 4), (4, 16, 0.25): (2, 4), QUARTER: (4,)}, **PGS),
    *settings({1: (4,), 2: (3,)}, **PGS, **FEW),
    *settings({1: (3,), (1, 8, 0.5): (3, 4), HALF: (3,), QUARTER: (2,)}, **PSOR),
    *settings({1: (4, 6), HALF: (3,)}, **PSOR, **FEW),
    *settings({(1, 16, 0.25): (6,)}, method="PSOR", omega=1.5, approach=0.02),
    *settings({(1, 8, 1.0): (6,), (1, 8, 0.5): (6,), (1, 8, 0.25): (6, 10), HALF: (10,), QUARTER: (3, 5)}, **COLOURS),
    *settings({(1, 16, 0.25): (10,)}, **COLOURS, **NEAR),
    *settings({1: (6,), HALF: (3, 5), QUARTER: (5,)}, **COLOURS, **FEW),
]
"""Settings on every kind of scene that a preset takes: fixed steps for the loose ones, by motion for the tight ones."""

MEDIUM = [
    *settings({QUARTER: (4,)}, **PGS),
    *settings({HALF: (3,)}, **PSOR),
    *settings({(1, 8, 1.0): (6,), (1, 8, 0.25): (10,), QUARTER: (3, 5)}, **COLOURS),
    *settings({(1, 16, 0.25): (10, 20)}, **COLOURS, **NEAR),
    *settings({1: (6, 10), 2: (5, 10), 4: (3, 5), (1, 8, 0.5): (6, 10)}, **COLOURS, **FEW),
    *settings({HALF: (5, 10), QUARTER: (5,)}, **COLOURS, **FEW),
]
LARGE = [
    *settings({2: (10,), 4: (5,), (1, 8, 0.5): (20,), QUARTER: (5, 10, 20)}, **COLOURS),
    *settings({(1, 16, 0.25): (20,)}, **COLOURS, **NEAR),
    *settings({2: (10,), 4: (3,), (1, 8, 0.5): (6, 10), HALF: (5, 10), QUARTER: (5, 10)}, **COLOURS, **FEW),
]

DENSE = [
    *settings({1: (10, 20), 2: (10, 20), 4: (10, 20), (1, 8, 0.5): (10, 20)}, **COLOURS, **FEW),
    *settings({HALF: (10, 20, 40), QUARTER: (5, 10, 20, 40)}, **COLOURS, **FEW),
    *settings({HALF: (20, 40), QUARTER: (20, 40), (8, 32, 0.25): (10,)}, **COLOURS, **NEAR),
]
"""For circles of two densities, and a dam that breaks, at every size: more sweeps in more substeps."""

DENSE_LARGE = [
    *settings({1: (20,), 2: (10, 20), 4: (10, 20), (1, 8, 0.5): (20,)}, **COLOURS, **FEW),
    *settings({HALF: (20,), QUARTER: (10, 20, 40), (8, 32, 0.25): (20,)}, **COLOURS, **FEW),
    *settings({QUARTER: (20, 40)}, **COLOURS, **NEAR),
]
"""Those of them that keep a preset of 3,000 circles at the least cost."""

DENSE_SMALL = [
    *SMALL,
    *DENSE,
    *settings({2: (5,)}, **COLOURS, **FEW),
    *settings({(1, 16, 0.25): (20,)}, **COLOURS, **NEAR),
    *settings({1: (6, 10), 2: (4, 10, 20), 4: (5, 10, 20)}, **PGS, **FEW),
    *settings({(1, 8, 0.25): (10,), HALF: (5, 10), QUARTER: (20,)}, method="PSOR", omega=1.5),
    *settings({HALF: (10,)}, method="NNCG"),
]
"""The same, and what costs less in small piles."""

LADDER = [
    *settings({1: (2, 3, 4, 6, 10, 20, 50), 2: (1, 2, 3, 5, 10, 20), 4: (1, 2, 3, 5, 10, 20)}, **PGS),
    *settings({8: (1, 2, 4, 10, 20), 16: (1, 2, 5, 20)}, **PGS),
    *settings({2: (10,), 4: (5,), 8: (10,)}, **COLOURS),
    *settings({1: (10, 20)}, method="PSOR", omega=1.75, friction_omega=1.45),
    *(one for method in ("NNCG", "NesterovPGS") for one in settings({1: (10, 20)}, method=method)),
]
"""Settings on plain piles alone: what sweeps, steps and methods do to an error (Figures 6.1, 6.2, 6.11)."""

LARGE_LADDER = settings(
    {1: (4, 6, 10, 20, 50), 2: (2, 3, 5, 10), 4: (1, 2, 3, 5, 10), 8: (1, 2, 4, 20), 32: (20,)}, **PGS
)
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
"""From 3,000 circles on: those of `PEERS` that kept a preset at 1,000 most cheaply, or nearly, and neighbours."""

MORE = {
    "no friction": {"100": settings({4: (3,), 8: (2,)}, **PGS), "1000": settings({4: (3,), 8: (2, 3)}, **PGS)}
    | {"3000": settings({4: (10,), 8: (3, 5)}, **COLOURS, **FEW)},
    "drum": {n: settings({2: (4,), 4: (2,)}, **PGS, **FEW) for n in ("100", "1000", "3000")},
    "heavy on light 1 : 10": {"10000": settings({4: (30, 40), 8: (10,)}, **COLOURS, **FEW)},
    "heavy on light 1 : 100": {
        "3000": [
            *settings({(8, 32, 0.25): (20, 40)}, **COLOURS, **NEAR),
            *settings({8: (20, 40)}, **COLOURS, **FEW),
        ]
    }
    | {"10000": settings({8: (20, 40), 16: (20, 40), 32: (20,)}, **COLOURS, **FEW)},
}
"""What a kind needs beside, by size: without these no setting kept one of its presets, or at a high price only."""

DEAR = ("drum", "light on heavy 1 : 10")
"""Kinds that are not run with 10,000 circles: the drum's segments make it ten times as dear."""

FULL = {
    "sizes": [100, 1000, 3000, 10_000],
    "seeds": {n: dict.fromkeys(runs.KINDS, 12 if n == "100" else 6) for n in ("100", "1000")}
    | {"3000": {kind: 4 if kind in runs.DENSE_KINDS else 6 for kind in runs.KINDS}}
    | {"10000": {kind: 3 if kind in runs.DENSE_KINDS else 6 for kind in runs.KINDS if kind not in DEAR}},
    "peer_seeds": {"100": 12, "1000": 6, "3000": 6, "10000": 6},
    "ladder_seeds": {"100": 12, "1000": 6, "3000": 3, "10000": 3},
    "seconds": 6.0,
    "settings": {"100": SMALL, "1000": SMALL, "3000": MEDIUM, "10000": LARGE},
    "dense": {"100": DENSE_SMALL, "1000": DENSE_SMALL, "3000": DENSE, "10000": DENSE_LARGE},
    "more": MORE,
    "ladders": {"100": LADDER, "1000": LADDER, "3000": LARGE_LADDER, "10000": LARGE_LADDER},
    "peers": {"100": PEERS, "1000": PEERS, "3000": LARGE_PEERS, "10000": LARGE_PEERS},
    "processes": 3,
}
QUICK = FULL | {
    "sizes": [100, 300],
    "seeds": {"100": {"plain": 4}, "300": {"plain": 3}},
    "peer_seeds": {"100": 4, "300": 3},
    "ladder_seeds": {"100": 4, "300": 3},
    "seconds": 4.0,
    "settings": {"100": SMALL, "300": MEDIUM},
    "ladders": {"100": LADDER, "300": LARGE_LADDER},
    "peers": {"100": PEERS[::3], "300": []},
    "processes": 1,
}
ON_PLAIN_PILES = {"ladders": "ladder_seeds", "peers": "peer_seeds"}
"""Lists of settings of plain piles alone -> their numbers of seeds."""

LISTS = ("settings", "dense", "more", *ON_PLAIN_PILES)
"""Options that the results file leaves out: its rows have them."""

FUNCTIONS = {"observed": runs.observed, "timed": runs.timed}
LIMIT = trade.name_of(runs.REFERENCE)


def wanted(options: dict) -> dict[tuple[str, int, str], tuple[dict, int]]:
    """(Kind, n_bodies, name) -> (setting, number of seeds); of a name that is there twice, the first has the most."""
    cases_by_name = {}
    for n, kinds in options["seeds"].items():
        for kind, count in kinds.items():
            ours = options["dense" if kind in runs.DENSE_KINDS else "settings"][n]
            lists = [([*ours, *options["more"].get(kind, {}).get(n, []), runs.REFERENCE], count)]
            if kind == "plain":
                lists += [(options[name][n], options[seeds][n]) for name, seeds in ON_PLAIN_PILES.items()]
            cases = [(setting, count) for listed, count in lists for setting in listed]
            cases_by_name |= {(kind, int(n), trade.name_of(case[0])): case for case in reversed(cases)}
    return cases_by_name


def plan(options: dict, seed: int, before: Mapping | None) -> tuple[list, dict]:
    """The observations as (name, arguments), the quick ones first, and (kind, n_bodies, name) -> row that needs none.

    before: results whose rows are known. Those of fewer seeds are observed again, and the reference beside them. Raises
    ValueError where it has other options.
    """
    cases, known = wanted(options), {}
    if before is not None:
        of = before["options"] | {"seed": before["provenance"]["seed"]}
        for name, mine in {"sizes": options["sizes"], "seconds": options["seconds"], "seed": seed}.items():
            expect(of[name] == mine, f"{name}: expected {mine} in the results, got {of[name]}")
        known = {(row["kind"], row["n_bodies"], row["name"]): row for row in before["data"]["rows"]}
    kept = {key: known[key] for key, (_, count) in cases.items() if key in known and known[key]["seeds"] >= count}
    renewed = {key[:2] for key in cases.keys() - kept.keys()}
    kept = {key: row for key, row in kept.items() if key[2] != LIMIT or key[:2] not in renewed}
    seen = [
        ("observed", {"kind": kind, "n_bodies": n, "seed": one, "setting": setting, "seconds": options["seconds"]})
        for (kind, n, name), (setting, count) in cases.items()
        if (kind, n, name) not in kept
        for one in parallel.seeds(seed, count)
    ]
    return sorted(seen, key=lambda part: part[1]["n_bodies"] / part[1]["setting"]["dt"]), kept


def study(
    options: dict, before: Mapping | None = None, *, seed: int, jobs: int, work: Path, errors_only: bool
) -> dict | None:
    """The data of the results file. before: one whose errors are taken over; times are measured anew."""
    seen, rows = plan(options, seed, before)
    observed = done(seen, FUNCTIONS, work=work, jobs=jobs, text="errors")
    if errors_only:
        return None
    ensembles: dict = {}  # runs in the order of their seeds, so that each meets the reference of its own scene
    for (_, part), stored in zip(seen, observed):
        key = part["kind"], part["n_bodies"], trade.name_of(part["setting"])
        ensembles.setdefault(key, (part["setting"], []))[1].append(run_errors.observation(stored))
    for (kind, n, name), (setting, ensemble) in ensembles.items():
        row = trade.row_of(setting, TIME_STEP, ensemble, ensembles[kind, n, LIMIT][1][: len(ensemble)])
        rows[kind, n, name] = {"kind": kind, "n_bodies": n} | row | ({"errors": None} if name == LIMIT else {})
    # Of plain piles the smallest steps are there for Figure 6.2 alone.
    timed = [key for key, row in rows.items()
             if row["errors"] and (key[0] != "plain" or row["setting"]["dt"] >= TIME_STEP / 8)]  # fmt: skip
    took: dict = {key: [] for key in rows}
    for process in range(options["processes"]):  # of plain piles in several, each on a scene of its own
        keys = [key for key in timed if process == 0 or key[0] == "plain"]
        of = {"seed": seed + process, "seconds": options["seconds"]}
        parts = [("timed", of | {"kind": key[0], "n_bodies": key[1], "setting": rows[key]["setting"]}) for key in keys]
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            one = alone if options["processes"] > 1 else 1
            for key, us in zip(keys, done(parts, FUNCTIONS, work=work, jobs=one, text="times")):
                took[key].append(us)
    priced = [rows[key] | {"us": float(np.median(us)) if us else None, "times": us} for key, us in took.items()]
    return judged(priced)


def judged(rows: list[dict]) -> dict:
    """The data of the results file from its rows: with the errors of ours where the answer is known, and presets."""
    ours = {row["name"]: row["setting"] for row in rows if "engine" not in row["setting"]}
    known = {name: runs.rounded(known_error(setting)) for name, setting in ours.items()}
    rows = [row | ({"known": known[row["name"]]} if row["name"] in known else {}) for row in rows]
    return {"errors": run_errors.ERRORS, "rows": rows, "presets": runs.presets(rows)}


def table(data: dict, cpu: str) -> dict:
    """What the presets read: settings with errors and times by size and kind of scene."""
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
    return {"cpu": cpu, "sizes": runs.sizes_of(data["rows"]), "settings": list(settings.values())}


def claims(data: dict) -> Iterator[results.Claim]:
    """Whether presets are kept, and what the fastest rival pays for the same."""
    for n in runs.sizes_of(data["presets"]):
        mine = {row["preset"]: row for row in data["presets"] if row["n_bodies"] == n}
        missing = {preset: [kind for kind, ours in row["kinds"].items() if not ours] for preset, row in mine.items()}
        missing = {preset: kinds for preset, kinds in missing.items() if kinds}
        text = f"on each kind of scene some setting keeps every preset, {n:,} circles"
        yield results.Claim(text, None, not missing, {"kinds without one": missing})
        if ratios := {preset: row["ratio"][0] for preset, row in mine.items() if row["ratio"][0]}:
            ahead = sum(ratio >= 5 for ratio in ratios.values()) >= 2 and min(ratios.values()) >= 1
            text = f"5 times cheaper than the fastest rival for two presets, dearer for none, {n:,} circles"
            yield results.Claim(text, None, ahead, ratios)


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add = parser.add_argument
    add("--quick", action="store_true", help="a smaller study that ends within five minutes")
    add("--seed", type=int, default=0, help="of the piles")
    add("--jobs", type=int, default=2, help="processes for the errors (2)")
    add("--out", type=Path, help="results file (in data/reference; quick: in runs)")
    add("--work", type=Path, default=Path("runs/run_tradeoff"), help="folder of the finished parts")
    add("--install", action="store_true", help="make these the numbers of the presets")
    add("--errors", action="store_true", help="only what needs no quiet machine; a later run adds times")
    add("--add", action="store_true", help="take the errors over that the results file has, and measure times anew")
    add("--known", action="store_true", help="judge the settings that the file has by known answers; installs them")
    args = parser.parse_args(arguments)
    start, options = time.perf_counter(), QUICK if args.quick else FULL
    out = args.out or Path("runs/run_tradeoff_quick.json" if args.quick else "data/reference/run_tradeoff.json")
    before = results.read_results(out) if args.add or args.known else None
    if args.known:
        data = judged(before["data"]["rows"])
        results.write_results(out, before | {"claims": list(claims(data)), "data": data}, digits=4)
        results.write_json(TABLE, table(data, before["provenance"]["cpu"]))
        return
    data = study(options, before, seed=args.seed, jobs=args.jobs, work=args.work, errors_only=args.errors)
    if data is None:
        return
    made = results.provenance(seed=args.seed, wall_s=time.perf_counter() - start)
    kept = {key: value for key, value in options.items() if key not in LISTS} | {"quick": args.quick}
    if before:
        kept["errors_from"] = [*before["options"].get("errors_from", []), before["provenance"]["commit"]]
    stored = {"id": "6.1", "title": "Speed for accuracy in runs: errors and times of settings and engines"}
    stored |= {"options": kept, "provenance": made, "claims": list(claims(data)), "data": data}
    results.write_results(out, stored, digits=4)
    for claim in stored["claims"]:
        print(f"{'holds' if claim.holds else 'does not hold'}: {claim.text}: {claim.measured}")
    if args.install:
        results.write_json(TABLE, table(data, made["cpu"]))
    print(f"{len(data['rows'])} rows in {out.name}, {made['wall_s']:.0f} s")


if __name__ == "__main__":
    main()
