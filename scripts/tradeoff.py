"""The study of speed against accuracy: errors and times of every method, start, budget, precision and time step.

    python scripts/tradeoff.py [--quick] [--jobs J] [--seed S] [--out FILE] [--work FOLDER]

Every part of the study is stored in the work folder as soon as it is done, so that a run that was interrupted goes on
where it was; parts with other settings are left alone. Errors are measured by several processes, times afterwards by
one. The results file holds all numbers; `scripts/figure_6_1_methods.py` and `figure_6_2_time_step.py` draw them, and
`--install` hands the condensed part to the package, for `dc.recommend`. Quick form: 100 and 1,000 circles.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from pathlib import Path

from deep_contact import figures, results, tradeoff
from deep_contact.recommendation import TABLE

FULL = {
    "sizes": [100, 1000, 10000],
    "seeds": {"100": 6, "1000": 3, "10000": 1},
    "states": {"100": 12, "1000": 8, "10000": 4},
    "sweeps": [1, 2, 3, 5, 8, 12, 20, 30, 50, 80, 120, 200, 300, 500, 800, 1200, 2000, 4000],
    "tolerances": [1.0, 0.3, 0.1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 1e-6],
    "past_need": 100_000,
    "run_sizes": [100, 1000],
    "seconds": 2.0,
    "steps": [0.02, 0.01, 0.005],
    "peer_sizes": [100, 1000],
    "peer_budgets": [4, 10, 30, 100, 300, 1000],
    "peer_samples": 8,
    "repeats": 7,
}
QUICK = {
    "sizes": [100, 1000],
    "seeds": {"100": 2, "1000": 1},
    "states": {"100": 5, "1000": 2},
    "sweeps": [1, 3, 10, 30, 100, 300, 1000],
    "tolerances": [1.0, 0.1, 1e-2, 1e-3, 1e-4],
    "past_need": 30_000,
    "run_sizes": [100],
    "seconds": 0.5,
    "steps": [0.02, 0.01],
    "peer_sizes": [100],
    "peer_budgets": [4, 10, 100],
    "peer_samples": 3,
    "repeats": 3,
}

PARTS = {
    "errors": tradeoff.solution_errors,
    "runs": tradeoff.resting_runs,
    "peers": tradeoff.peer_errors,
    "costs": tradeoff.costs,
}


def plan(options: dict, seed: int) -> tuple[list, list]:
    """The parts of the study as (name, arguments): those whose errors count, and those whose times do."""
    measured, timed = [], []
    for n in options["sizes"]:
        for pile_seed in figures.seeds(seed, options["seeds"][str(n)]):
            for kind in tradeoff.KINDS:
                budgets = {name: options[name] for name in ("sweeps", "tolerances", "past_need")}
                arguments = {"kind": kind, "n_bodies": n, "seed": pile_seed, "states": options["states"][str(n)]}
                measured.append(("errors", arguments | budgets))
        timed.append(("costs", {"n_bodies": n, "seed": seed, "repeats": options["repeats"]}))
    for n in options["run_sizes"]:
        timed.append(("runs", {"n_bodies": n, "seed": seed, "seconds": options["seconds"], "steps": options["steps"]}))
    for n in options["peer_sizes"]:
        for name in tradeoff.PEERS:
            arguments = {"budgets": options["peer_budgets"], "samples": options["peer_samples"]}
            arguments["past_need"] = options["past_need"]
            timed.append(("peers", {"name": name, "n_bodies": n, "seed": seed} | arguments))
    # The largest first, so that no process is left with one at the end.
    measured.sort(key=lambda part: -part[1]["n_bodies"])
    return measured, timed


def do(task: tuple[str, dict, str]):
    """The result of one part: read if it has been stored, else computed and stored."""
    name, arguments, folder = task
    text = json.dumps([name, arguments], sort_keys=True)
    path = Path(folder) / f"{name}_{arguments['n_bodies']}_{hashlib.sha256(text.encode()).hexdigest()[:16]}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    found = results.plain(PARTS[name](**arguments))
    path.parent.mkdir(parents=True, exist_ok=True)
    with results.replacing(path) as temporary:
        temporary.write_text(json.dumps(found, allow_nan=False), encoding="utf-8")
    return found


def study(options: dict, *, seed: int, jobs: int, work: Path) -> dict:
    """The data of the results file."""
    measured, timed = plan(options, seed)
    tasks = [(name, arguments, str(work)) for name, arguments in measured]
    piles = figures.parallel_map(do, tasks, jobs=jobs, progress=figures.progress_bar, text="errors")
    found = {"costs": [], "runs": [], "peers": []}
    for name, arguments in figures.progress_bar(timed, total=len(timed), text="times"):
        part = do((name, arguments, str(work)))
        if name == "costs":
            found["costs"].append(part)
        else:
            extra = {"n_bodies": arguments["n_bodies"]}
            found[name] += [extra | row for row in part]
    spread = [
        {key: pile[key] for key in ("kind", "n_bodies", "seed", "contacts", "states", "left_out", "spread")}
        for pile in piles
    ]
    return {"settings": tradeoff.SETTINGS, "piles": spread, "rows": tradeoff.condensed(piles, found["costs"]), **found}


def claims(data: dict) -> list[results.Claim]:
    """What the study is meant to show, held against its numbers: medians on settling piles of up to 1,000 circles."""
    found = []
    n = max(row["n_bodies"] for row in data["rows"] if row["n_bodies"] <= 1000)
    settling = [row for row in data["rows"] if row["n_bodies"] == n and row["kind"] == "settling"]
    for error, over_pgs, over_peers in ((1e-1, 1.0, 1.0), (1e-2, 1.0, 5.0), (1e-3, 3.0, 1.0)):
        best = tradeoff.fastest_within(settling, error, "p50")
        plain = tradeoff.fastest_within([row for row in settling if row["setting"] == "PGS"], error, "p50")
        fit = [row for row in data["peers"] if row["n_bodies"] == n and median(row["velocity"]) <= error]
        peer = min(fit, key=lambda row: row["us"], default=None)
        rivals = [(plain, "PGS from Builtin", over_pgs)]
        if any(row["n_bodies"] == n for row in data["peers"]):
            rivals.append((peer, "the fastest peer", over_peers))
        for rival, name, factor in rivals:
            measured = {
                "ours": best and best["setting"],
                "ours, us": best and best["us"],
                "rival": rival and rival.get("engine", "PGS"),
                "rival, us": rival and rival["us"],
            }
            text = f"velocity error {error:g}, {n} settling circles: a step is {factor:g}x faster than {name}'s"
            # A rival that never gets there is beaten.
            holds = bool(best and (rival is None or rival["us"] >= factor * best["us"]))
            found.append(results.Claim(text, None, holds, measured))
    return found


def median(values: list) -> float:
    """The median, infinite of none."""
    return sorted(values)[len(values) // 2] if values else float("inf")


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a smaller study that ends within five minutes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes for the errors (2)")
    parser.add_argument("--out", type=Path, help="results file (data/reference/tradeoff.json; quick: runs/)")
    parser.add_argument("--work", type=Path, default=Path("runs/tradeoff"), help="folder of the finished parts")
    parser.add_argument("--install", action="store_true", help="make these the numbers that dc.recommend reads")
    given = parser.parse_args(arguments)
    options = QUICK if given.quick else FULL
    out = given.out or Path("runs/tradeoff_quick.json" if given.quick else "data/reference/tradeoff.json")
    begin = time.perf_counter()
    data = study(options, seed=given.seed, jobs=given.jobs, work=given.work)
    file = {
        "id": "6.1",
        "title": "Speed for accuracy: errors and times of every method and budget",
        "options": {**options, "quick": given.quick},
        "provenance": results.provenance(seed=given.seed, wall_s=time.perf_counter() - begin),
        "claims": claims(data),
        "data": data,
    }
    results.write_results(out, file)
    for claim in file["claims"]:
        print(f"{'holds' if claim.holds else 'DOES NOT HOLD'}: {claim.text}: {claim.measured}")
    if given.install:
        condensed = {"settings": data["settings"], "rows": tradeoff.installed(data["rows"])}
        results.write_results(TABLE, {**file, "data": condensed})
    print(f"{len(data['rows'])} rows in {out.name}, {time.perf_counter() - begin:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
