"""The study of speed against accuracy in runs: errors and times of settings and of other engines.

    python scripts/run_tradeoff.py [--quick] [--jobs J] [--scheduler ADDRESS] [--seed S] [--out FILE] [--work FOLDER]
    python scripts/run_tradeoff.py --errors     only the parts that need no quiet machine
    python scripts/run_tradeoff.py --add        errors of settings that the results file lacks, and times of all
    python scripts/run_tradeoff.py --verify     errors and times of the presets on scenes outside the study

Every finished part is stored in the work folder, so an interrupted study goes on where it stopped. Several processes,
or a Dask cluster (--scheduler), compute errors; then one process of this machine measures times. `--install` makes
these the numbers that `dc.simulate` and `dc.recommend` read. Figures 6.1, 6.2 and 6.11 draw the results file.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from concurrent.futures import Executor
from itertools import islice, product
from pathlib import Path
from types import MappingProxyType

from deep_contact import parallel
from deep_contact.constants import TIME_STEP
from deep_contact.presets import PRESETS, TABLE, is_gone, recommend
from deep_contact.reporting import figures, results
from deep_contact.studies import runs
from deep_contact.studies.parts import done


def ladder(method: str, budgets: dict, **options) -> list[dict]:
    """Settings of a method. budgets: Δt / 0.01 s as a divisor -> numbers of sweeps."""
    return [
        {"method": method, "sweeps": sweeps, "dt": TIME_STEP / divisor, **options}
        for divisor, found in budgets.items()
        for sweeps in found
    ]


def by_motion(method: str, budgets: dict, **options) -> list[dict]:
    """Settings whose substeps follow the motion. budgets: (fewest, most substeps of 0.01 s, slop) -> sweeps."""
    return [
        {"method": method, "sweeps": sweeps, "dt": TIME_STEP / k, "most_substeps": most // k, "slop": slop, **options}
        for (k, most, slop), found in budgets.items()
        for sweeps in found
    ]


COLOURS = {"order": "colours"}
FEW = {"position_sweeps": 3}

SMALL = [
    *ladder("PGS", {1: (3, 4, 6), 2: (3,), 4: (2,)}),
    *ladder("PGS", {1: (4, 6), 2: (3,)}, **FEW),
    *ladder("PSOR", {1: (3, 6)}, omega=1.3),
    *ladder("PSOR", {1: (4, 6)}, omega=1.3, **FEW),
    *ladder("BatchedPGS", {1: (6,)}, **COLOURS),
    *ladder("BatchedPGS", {1: (6, 10)}, **COLOURS, **FEW),
    *by_motion("PGS", {(1, 4, 1.0): (4,), (1, 8, 0.5): (4,), (1, 8, 0.25): (6,), (2, 16, 0.25): (3, 4)}),
    *by_motion("PGS", {(4, 16, 0.25): (2, 4), (4, 32, 0.25): (4,)}),
    *by_motion("PSOR", {(1, 8, 0.5): (3, 4), (2, 16, 0.25): (2, 3), (4, 32, 0.25): (2,)}, omega=1.3),
    *by_motion("PSOR", {(2, 16, 0.25): (3,)}, omega=1.3, **FEW),
    *by_motion("PSOR", {(1, 16, 0.25): (6,)}, omega=1.5, approach=0.02),
    *by_motion("BatchedPGS", {(1, 8, 1.0): (6,), (1, 8, 0.5): (6,), (1, 8, 0.25): (6, 10)}, **COLOURS),
    *by_motion("BatchedPGS", {(1, 16, 0.25): (10,)}, **COLOURS, approach=0.015),
    *by_motion("BatchedPGS", {(2, 16, 0.25): (3, 5, 10), (4, 32, 0.25): (3, 5, 10)}, **COLOURS),
    *by_motion("BatchedPGS", {(2, 16, 0.25): (3, 5), (4, 32, 0.25): (5,)}, **COLOURS, **FEW),
]
"""Settings on every kind of scene: fixed steps for the loose presets, by motion for the tight ones."""

MEDIUM = [
    *ladder("BatchedPGS", {2: (5, 10)}, **COLOURS),
    *ladder("BatchedPGS", {1: (6, 10), 2: (5, 10), 4: (3, 5)}, **COLOURS, **FEW),
    *by_motion("PGS", {(2, 16, 0.25): (4,), (4, 32, 0.25): (4,)}),
    *by_motion("PSOR", {(2, 16, 0.25): (3,)}, omega=1.3),
    *by_motion("BatchedPGS", {(1, 8, 1.0): (6,), (1, 8, 0.5): (6, 10), (1, 8, 0.25): (10,)}, **COLOURS),
    *by_motion("BatchedPGS", {(1, 16, 0.25): (10, 20)}, **COLOURS, approach=0.015),
    *by_motion("BatchedPGS", {(2, 16, 0.25): (5, 10), (4, 32, 0.25): (3, 5, 10)}, **COLOURS),
    *by_motion("BatchedPGS", {(1, 8, 0.5): (6, 10), (2, 16, 0.25): (5, 10), (4, 32, 0.25): (5,)}, **COLOURS, **FEW),
]
LARGE = [
    *ladder("BatchedPGS", {2: (10,), 4: (5,)}, **COLOURS),
    *ladder("BatchedPGS", {2: (10,), 4: (3,)}, **COLOURS, **FEW),
    *by_motion("BatchedPGS", {(1, 8, 0.5): (20,), (2, 16, 0.25): (10, 20), (4, 32, 0.25): (5, 10, 20)}, **COLOURS),
    *by_motion("BatchedPGS", {(1, 16, 0.25): (20,)}, **COLOURS, approach=0.015),
    *by_motion("BatchedPGS", {(1, 8, 0.5): (6, 10), (2, 16, 0.25): (5, 10), (4, 32, 0.25): (5, 10)}, **COLOURS, **FEW),
]

PGS = {1: (2, 3, 4, 6, 10, 20, 50), 2: (1, 2, 3, 5, 10, 20), 4: (1, 2, 3, 5, 10, 20)}
PGS |= {8: (1, 2, 4, 10, 20), 16: (1, 2, 5, 20)}
LADDER = [
    *ladder("PGS", PGS),
    *ladder("BatchedPGS", {1: (10, 20, 50), 2: (5, 10), 4: (3, 5, 10), 8: (2, 10)}, **COLOURS),
    *ladder("PSOR", {1: (6, 10, 20), 2: (4, 8)}, omega=1.5),
    *ladder("PSOR", {1: (6, 10, 20), 2: (4, 8), 4: (2,)}, omega=1.75, friction_omega=1.45),
    *ladder("NNCG", {1: (5, 10, 20)}),
    *ladder("NesterovPGS", {1: (10, 20)}),
    *ladder("PGS", {1: (10, 50)}, start="none"),
]
"""Settings on plain piles alone: what sweeps, steps, methods and starts do to an error (Figures 6.1, 6.2, 6.11)."""

LARGE_LADDER = ladder(
    "PGS", {1: (4, 6, 10, 20, 50), 2: (2, 3, 5, 10), 4: (1, 2, 3, 5, 10), 8: (1, 2, 4, 20), 32: (20,)}
)
PEERS = {
    "Box2D 2.3": {1: (4, 10, 30), 2: (2, 4, 10), 4: (2, 4), 8: (1, 2)},
    "pymunk": {1: (4, 10, 30), 2: (2, 4, 10), 4: (2, 4), 8: (1, 2)},
    "Box2D v3": {1: (2, 4, 8), 2: (1, 2, 4), 4: (1, 2), 8: (1,)},
}
PEER_SETTINGS = [
    {"engine": engine, "sweeps": sweeps, "dt": TIME_STEP / divisor}
    for engine, budgets in PEERS.items()
    for divisor, found in budgets.items()
    for sweeps in found
]
FEW_PEERS = [s for s in PEER_SETTINGS if s["sweeps"] in (2, 4, 10) and s["dt"] > TIME_STEP / 8]

FULL = {
    "sizes": [100, 1000, 3000, 10_000],
    "seeds": {n: dict.fromkeys(runs.KINDS, 12 if n == "100" else 6) for n in ("100", "1000", "3000")}
    | {"10000": {kind: 6 for kind in runs.KINDS if kind != "drum"}},  # ten times as dear, by its segments
    "peer_seeds": {"100": 12, "1000": 3, "3000": 3, "10000": 3},
    "ladder_seeds": {"100": 12, "1000": 6, "3000": 3, "10000": 3},
    "model": [100, 1000],
    "seconds": 6.0,
    "settings": {"100": SMALL, "1000": SMALL, "3000": MEDIUM, "10000": LARGE},
    "ladders": {"100": LADDER, "1000": LADDER, "3000": LARGE_LADDER, "10000": LARGE_LADDER},
    "peers": {"100": PEER_SETTINGS, "1000": PEER_SETTINGS, "3000": FEW_PEERS, "10000": FEW_PEERS},
    "steps": {"100": 200, "1000": 50, "3000": 20, "10000": 10},
    "repeats": {"100": 5, "1000": 4, "3000": 3, "10000": 3},
}
QUICK = {
    "sizes": [100, 300],
    "seeds": {"100": {"plain": 4}, "300": {"plain": 3}},
    "peer_seeds": {"100": 4, "300": 3},
    "ladder_seeds": {"100": 4, "300": 3},
    "model": [],
    "seconds": 4.0,
    "settings": {"100": SMALL, "300": MEDIUM},
    "ladders": {"100": LADDER, "300": LARGE_LADDER},
    "peers": {"100": PEER_SETTINGS[::3], "300": []},
    "steps": {"100": 50, "300": 20},
    "repeats": {"100": 3, "300": 3},
}
FUNCTIONS = {"observed": runs.observed, "times": runs.times}


def plan(options: dict, seed: int, known: Mapping = MappingProxyType({})) -> tuple[list, list, dict]:
    """The parts as (name, arguments): observations, the quick ones first, and times; and the known rows that stay.

    known: rows by (kind, n_bodies, name), whose errors need no observation; those of fewer seeds are left out of it.
    """
    seen, timed, kept = [], [], {}
    for n in options["sizes"]:
        ours, rivals, on_plain = (options[name].get(str(n), []) for name in ("settings", "peers", "ladders"))
        for kind, count in options["seeds"][str(n)].items():
            cases = [(setting, count) for setting in (*ours, runs.REFERENCE)]
            if kind == "plain":
                more = [*on_plain, *(runs.MODEL.values() if n in options["model"] else ())]
                cases += [(setting, options["ladder_seeds"].get(str(n), count)) for setting in more]
                cases += [(setting, options["peer_seeds"][str(n)]) for setting in rivals]
            # Of a name that is there twice, the first has the most seeds.
            by_name = {runs.name_of(setting): (setting, wanted) for setting, wanted in reversed(cases)}
            for name, (setting, wanted) in by_name.items():
                row = known.get((kind, n, name))
                if row and row["seeds"] >= wanted:
                    kept[kind, n, name] = row
                    continue
                common = {"kind": kind, "n_bodies": n, "setting": setting, "seconds": options["seconds"]}
                seen += [("observed", common | {"seed": s}) for s in figures.seeds(seed, wanted)]
            settings = [setting for setting, _ in by_name.values() if setting["dt"] >= TIME_STEP / 8]
            times = {"kind": kind, "n_bodies": n, "seed": seed, "settings": settings}
            times |= {name: options[name][str(n)] for name in ("steps", "repeats")}
            phases = (*runs.MOMENTS, *(runs.PHASES if kind == "plain" else ()))
            timed += [("times", times | {"phase": phase}) for phase in phases]
    seen.sort(key=lambda part: part[1]["n_bodies"] / part[1]["setting"]["dt"])
    return seen, timed, kept


def known_rows(file: Mapping, options: dict, seed: int) -> dict:
    """Rows of a results file by (kind, n_bodies, name), but for the references. Raises ValueError on other options."""
    for key in ("sizes", "seconds"):
        if file["options"][key] != options[key]:
            raise ValueError(f"{key}: expected {options[key]} in the results, got {file['options'][key]}")
    if file["provenance"]["seed"] != seed:
        raise ValueError(f"seed: expected {seed} in the results, got {file['provenance']['seed']}")
    kept = (row for row in file["data"]["rows"] if row["errors"] and not is_gone(row["setting"]))
    return {key_of(row): row for row in kept}


def study(options: dict, *, seed: int, jobs: int | Executor, work: Path, before: Mapping | None = None) -> dict:
    """The data of the results file. before: one whose errors are taken over; times are measured anew."""
    seen, timed, known = plan(options, seed, known_rows(before, options, seed) if before else {})
    found = done(seen, FUNCTIONS, work=work, jobs=jobs, text="errors")
    took = done(timed, FUNCTIONS, work=work, jobs=1, text="times")
    ensembles: dict = {}
    for (_, part), stored in zip(seen, found):
        ensemble = ensembles.setdefault((part["kind"], part["n_bodies"]), {})
        _, runs_seen = ensemble.setdefault(runs.name_of(part["setting"]), (part["setting"], {}))
        runs_seen[part["seed"]] = runs.observation(stored)
    for ensemble in ensembles.values():  # by seed, so that each run meets the reference of its own scene
        for name, (setting, by_seed) in ensemble.items():
            ensemble[name] = setting, [by_seed[s] for s in sorted(by_seed)]
    times = {(part["kind"], part["n_bodies"], part["phase"]): us for (_, part), us in zip(timed, took)}
    rows = known | {key_of(row): row for row in runs.rows(ensembles)}
    rows = [runs.with_times(row, times) for row in rows.values()]
    return {"errors": runs.ERRORS, "rows": rows, "presets": runs.presets(rows)}


def key_of(row: Mapping) -> tuple[str, int, str]:
    """Kind, size and name of a row."""
    return row["kind"], row["n_bodies"], row["name"]


def table(data: dict, cpu: str) -> dict:
    """What the presets read: settings with errors and times by size and kind of scene."""
    settings: dict = {}
    for row in data["rows"]:
        if "engine" in row["setting"] or row["us"] is None or not row["errors"]:
            continue
        options = {key: value for key, value in row["setting"].items() if key != "dt"} | {"tolerance": None}
        new = {"name": row["name"], "options": options, "dt": row["setting"]["dt"], "us": {}, "errors": {}}
        entry, n = settings.setdefault(row["name"], new), str(row["n_bodies"])
        entry["us"].setdefault(n, {})[row["kind"]] = round(row["us"], 2)
        errors = {key: float(f"{value[0]:.3g}") for key, value in row["errors"].items() if value}
        entry["errors"].setdefault(n, {})[row["kind"]] = errors
    sizes = sorted({row["n_bodies"] for row in data["rows"]})
    return {"cpu": cpu, "sizes": sizes, "settings": list(settings.values())}


def claims(data: dict) -> list[results.Claim]:
    """Whether presets are kept, and what the fastest rival pays for the same."""
    found = []
    for n in runs.sizes_of(data["presets"]):
        mine = {row["preset"]: row for row in data["presets"] if row["n_bodies"] == n}
        missing = {preset: [kind for kind, ours in row["kinds"].items() if not ours] for preset, row in mine.items()}
        text = f"on each kind of scene some setting keeps every preset, {n:,} circles"
        missing = {preset: kinds for preset, kinds in missing.items() if kinds}
        found.append(results.Claim(text, None, not missing, {"kinds without one": missing}))
        ratios = {preset: row["ratio"][0] for preset, row in mine.items() if row["ratio"][0]}
        if ratios:
            ahead = sum(ratio >= 5 for ratio in ratios.values()) >= 2 and min(ratios.values()) >= 1
            text = f"5 times cheaper than the fastest rival for two presets, dearer for none, {n:,} circles"
            found.append(results.Claim(text, None, ahead, ratios))
    return found


# ---- scenes outside the study ----

VERIFY = {
    "sizes": [100, 300, 1000],
    "kinds": dict.fromkeys(runs.HELD_OUT_KINDS, TIME_STEP) | {"slippery": 2.5 * TIME_STEP, "loose": TIME_STEP / 2},
    "seeds": {"100": 20, "300": 10, "1000": 6},
    "more_seeds": {"1000": 20},
    "seconds": 6.0,
    "timed": {n: ["plain"] for n in ("100", "300", "3000", "10000")} | {"1000": list(runs.HELD_OUT_KINDS)},
    "steps": {"100": 200, "300": 100, "1000": 50, "3000": 20, "10000": 10},
    "repeats": 3,
}
"""Scenes outside the study: other seeds, sizes, radii, friction, heights to fall from, and time steps of the user."""

VERIFY_QUICK = VERIFY | {
    "sizes": [100], "kinds": {"plain": TIME_STEP}, "seeds": {"100": 3}, "more_seeds": {}, "seconds": 4.0,
    "timed": {"100": ["plain"]}, "repeats": 2,
}  # fmt: skip


def recommended(kind: str, n_bodies: int, seed: int, dt: float, preset: str) -> tuple[dict, float]:
    """(The setting that a preset takes for a scene, its predicted cost of TIME_STEP, μs)."""
    found = recommend(runs.scene(kind, n_bodies, seed).replace(dt=dt), accuracy=preset)
    options = {key: value for key, value in vars(found.solver).items() if key != "tolerance"}
    start = {"start": found.warm_start} if found.warm_start != "builtin" else {}
    return {"method": type(found.solver).__name__, "dt": dt, **options, **start}, found.us * TIME_STEP / dt


def verify(options: dict, *, seed: int, jobs: int | Executor, work: Path, errors_only: bool) -> dict | None:
    """Errors of the presets on scenes outside the study, and their times beside the predicted ones."""
    cases, parts = [], []
    for n, (kind, dt) in product(options["sizes"], options["kinds"].items()):
        count = options["more_seeds"].get(str(n), 0) if kind == "plain" else 0
        seeds = figures.seeds(seed + 5000, max(count, options["seeds"][str(n)]))  # that no study starts from
        for preset in [None, *PRESETS]:
            setting = runs.REFERENCE if preset is None else recommended(kind, n, seeds[0], dt, preset)[0]
            common = {"kind": kind, "n_bodies": n, "setting": setting, "seconds": options["seconds"]}
            cases.append(({"n_bodies": n, "kind": kind, "preset": preset, "setting": setting}, len(seeds)))
            parts += [("observed", common | {"seed": s}) for s in seeds]
    found = done(parts, FUNCTIONS, work=work, jobs=jobs, text="scenes")
    if errors_only:
        return None
    rows, reference, seen = [], None, map(runs.observation, found)
    for case, count in cases:
        ensemble = list(islice(seen, count))
        if case["preset"] is None:
            reference = ensemble
            continue
        errors = runs.intervals(ensemble, reference)
        # Within the interval: the tolerance is not exceeded beyond what the seeds can tell.
        judged = [(name, errors[name], most) for name, most in PRESETS[case["preset"]].items() if errors[name]]
        met = {name: value <= most for name, (value, _, _), most in judged}
        within = {name: low <= most for name, (_, low, _), most in judged}
        rows.append(case | {"errors": errors, "met": met, "within": within})
    timed = []
    for n, kind in ((int(n), kind) for n, kinds in options["timed"].items() for kind in kinds):
        wanted = {preset: recommended(kind, n, seed + 5000, TIME_STEP, preset) for preset in PRESETS}
        settings = list({runs.name_of(setting): setting for setting, _ in wanted.values()}.values())
        arguments = {"kind": kind, "n_bodies": n, "seed": seed + 5000, "settings": settings}
        arguments |= {"steps": options["steps"][str(n)], "repeats": options["repeats"]}
        parts = [("times", arguments | {"phase": moment}) for moment in runs.MOMENTS]
        moments = done(parts, FUNCTIONS, work=work, jobs=1, text="times")
        took = {name: sum(us[name] for us in moments) / len(moments) for name in moments[0]}
        for preset, (setting, predicted) in wanted.items():
            us = took[runs.name_of(setting)]
            timed.append({"n_bodies": n, "kind": kind, "preset": preset, "predicted_us": predicted, "us": us})
    return {"rows": rows, "times": timed}


def verify_claims(data: dict) -> list[results.Claim]:
    """Whether presets keep their promise, and whether their costs are as predicted."""
    found = []
    for preset in PRESETS:
        mine = [row for row in data["rows"] if row["preset"] == preset]
        within = {name: [row["within"][name] for row in mine if name in row["within"]] for name in PRESETS[preset]}
        shares = {name: sum(kept) / len(kept) for name, kept in within.items()}
        text = f"{preset} meets each of its tolerances, within the interval, in 95 % of kinds and sizes of other scenes"
        found.append(results.Claim(text, None, min(shares.values()) >= 0.95, shares))
    ratios = {
        f"{row['kind']}, {row['n_bodies']}, {row['preset']}": row["us"] / row["predicted_us"] for row in data["times"]
    }
    near = all(0.75 <= ratio <= 1.25 for ratio in ratios.values())
    return [*found, results.Claim("the cost is within 25 % of the predicted one", None, near, ratios)]


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("--quick", action="store_true", help="a smaller study that ends within five minutes")
    add("--seed", type=int, default=0, help="of the piles")
    add("--jobs", type=int, default=2, help="processes for the errors (2)")
    add("--scheduler", metavar="ADDRESS", help=parallel.SCHEDULER_HELP + ", for the errors")
    add("--out", type=Path, help="results file (in data/reference; quick: in runs)")
    add("--work", type=Path, default=Path("runs/run_tradeoff"), help="folder of the finished parts")
    add("--install", action="store_true", help="make these the numbers of the presets")
    add("--errors", action="store_true", help="only what needs no quiet machine; a later run adds times")
    add("--add", action="store_true", help="take the errors over that the results file has, and measure times anew")
    add("--verify", action="store_true", help="errors and times of the presets on scenes outside the study")
    given = parser.parse_args(arguments)
    start = time.perf_counter()
    options = (VERIFY_QUICK if given.quick else VERIFY) if given.verify else QUICK if given.quick else FULL
    settings = {"seed": given.seed, "work": given.work}
    name = "run_tradeoff_verify" if given.verify else "run_tradeoff"
    out = given.out or Path(f"runs/{name}_quick.json" if given.quick else f"data/reference/{name}.json")
    before = results.read_results(out) if given.add else None
    try:
        with parallel.opened(given.jobs, given.scheduler) as jobs:
            if given.verify:
                data = verify(options, jobs=jobs, errors_only=given.errors, **settings)
            elif given.errors:
                known = known_rows(before, options, given.seed) if before else {}
                parts, _, _ = plan(options, given.seed, known)
                data = done(parts, FUNCTIONS, work=given.work, jobs=jobs, text="errors")
            else:
                data = study(options, jobs=jobs, before=before, **settings)
    except parallel.ClusterError as error:
        print(error, file=sys.stderr)
        return 1
    if given.errors:
        return 0
    wall_s = time.perf_counter() - start
    kept = {key: value for key, value in options.items() if key not in ("settings", "ladders", "peers")} | {
        "quick": given.quick
    }
    if before:
        kept["errors_from"] = [*before["options"].get("errors_from", []), before["provenance"]["commit"]]
    file = {
        "id": "V.2" if given.verify else "6.1",
        "title": "The presets on scenes outside the study"
        if given.verify
        else "Speed for accuracy in runs: errors and times of settings and engines",
        "options": kept,
        "provenance": results.provenance(seed=given.seed, wall_s=wall_s),
        "claims": (verify_claims if given.verify else claims)(data),
        "data": data,
    }
    results.write_results(out, file, digits=4)
    for claim in file["claims"]:
        print(f"{'holds' if claim.holds else 'does not hold'}: {claim.text}: {claim.measured}")
    if given.install and not given.verify:
        results.write_json(TABLE, table(data, file["provenance"]["cpu"]))
    print(f"{len(data['rows'])} rows in {out.name}, {wall_s:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
