"""The study of single steps, for those who study solvers: errors and times of every method, start and budget.

    python scripts/tradeoff.py [--quick] [--jobs J] [--scheduler ADDRESS] [--seed S] [--out FILE] [--work FOLDER]
    python scripts/tradeoff.py --errors     only the parts that need no quiet machine
    python scripts/tradeoff.py --verify     errors of the recommendations on scenes outside the study

Every finished part of the study is stored in the work folder, so an interrupted run continues where it stopped; parts
with other settings are not touched. Several processes, or a Dask cluster (--scheduler, see `deep_contact.parallel`),
compute errors; then one process of this machine measures times. `--install` copies what
`dc.recommend(velocity_error=…)` reads into the package; with --verify it sets the margin there. Quick form: 100 and
1,000 circles.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import Executor
from pathlib import Path

from deep_contact import parallel
from deep_contact.recommendation.steps import TABLE
from deep_contact.reporting import figures, results
from deep_contact.studies import peers, tradeoff
from deep_contact.studies.parts import done

FULL = {
    "sizes": [100, 1000, 10000],
    "seeds": {"100": 4, "1000": 2, "10000": 1},
    "states": {"100": 8, "1000": 6, "10000": 4},
    "sweeps": [1, 2, 3, 5, 8, 12, 20, 30, 50, 80, 120, 200, 300, 500, 800, 1200, 2000, 4000, 10_000, 30_000, 100_000],
    "tolerances": [1.0, 0.3, 0.1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 1e-6],
    "most_sweeps": {"100": 100_000, "1000": 100_000, "10000": 2000},
    "past_need": {"100": 100_000, "1000": 100_000, "10000": 60_000},
    "exact": [100, 1000],
    "peer_sizes": [100, 1000],
    "peer_budgets": [4, 10, 30, 100, 300, 1000, 10_000],
    "peer_samples": 6,
    "repeats": 7,
}
QUICK = {
    "sizes": [100, 1000],
    "seeds": {"100": 2, "1000": 1},
    "states": {"100": 5, "1000": 2},
    "sweeps": [1, 3, 10, 30, 100, 300, 1000],
    "tolerances": [1.0, 0.1, 1e-2, 1e-3, 1e-4],
    "most_sweeps": {"100": 1000, "1000": 1000},
    "past_need": {"100": 20_000, "1000": 20_000},
    "exact": [100, 1000],
    "peer_sizes": [100],
    "peer_budgets": [4, 10, 100],
    "peer_samples": 3,
    "repeats": 3,
}

VERIFY = {
    "sizes": [80, 700, 3000],
    "seeds": {"80": 4, "700": 2, "3000": 1},
    "states": {"80": 12, "700": 8, "3000": 2},
    "asked": [0.3, 0.1, 0.03, 0.01, 0.003, 0.001],
    "margins": [1.0, 1.25, 1.5, 2.0, 3.0, 4.0],
    "past_need": {"80": 100_000, "700": 30_000, "3000": 60_000},
    "exact": [80, 700],
}
"""Scenes outside the study: other numbers of circles, other seeds."""

VERIFY_QUICK = {
    "sizes": [80],
    "seeds": {"80": 1},
    "states": {"80": 4},
    "asked": [0.1, 0.01],
    "margins": [1.0, 2.0, 4.0],
    "past_need": {"80": 20_000},
    "exact": [80],
}

PEERS_PAST_NEED = 10_000
"""Sweeps of the long runs that lead to the references of other engines, of which every step needs its own."""

PARTS = {
    "errors": tradeoff.solution_errors,
    "peer_errors": tradeoff.peer_errors,
    "peer_times": tradeoff.peer_times,
    "costs": tradeoff.costs,
    "exact": tradeoff.exact_solutions,
    "verify": tradeoff.recommended_errors,
}


def plan(options: dict, seed: int) -> tuple[list, list]:
    """The parts of the study as (name, arguments): those that count errors, and those that measure times."""
    measured, timed = [], []
    for n in options["sizes"]:
        exact = n in options["exact"]
        budgets = {
            "sweeps": [k for k in options["sweeps"] if k <= options["most_sweeps"][str(n)]],
            "tolerances": options["tolerances"],
            "past_need": options["past_need"][str(n)],
            "exact": exact,
        }
        for pile_seed in figures.seeds(seed, options["seeds"][str(n)]):
            for kind in tradeoff.KINDS:
                arguments = {"kind": kind, "n_bodies": n, "seed": pile_seed, "states": options["states"][str(n)]}
                measured.append(("errors", arguments | budgets))
                if exact:
                    timed.append(("exact", arguments))
        timed.append(("costs", {"n_bodies": n, "seed": seed, "repeats": options["repeats"]}))
    for n in options["peer_sizes"]:
        for name in peers.ENGINES:
            common = {"name": name, "n_bodies": n, "seed": seed, "budgets": options["peer_budgets"]}
            more = {"samples": options["peer_samples"], "past_need": PEERS_PAST_NEED, "exact": n in options["exact"]}
            measured.append(("peer_errors", common | more))
            timed.append(("peer_times", common))
    return largest_first(measured), timed


def largest_first(parts: list) -> list:
    """The parts in the order in which processes should take them: no process ends with a large one."""
    return sorted(parts, key=lambda part: -part[1]["n_bodies"])


def study(options: dict, *, seed: int, jobs: int | Executor, work: Path) -> dict:
    """The data of the results file."""
    measured, timed = plan(options, seed)
    found = done(measured, PARTS, work=work, jobs=jobs, text="errors")
    found += done(timed, PARTS, work=work, jobs=1, text="times")
    parts: dict = {name: [] for name in PARTS}
    for (name, _), part in zip(measured + timed, found):
        parts[name].append(part)

    def peer_key(row):
        return row["engine"], row["n_bodies"], row["budget"]

    peer_us = {peer_key(row): row["us"] for part in parts["peer_times"] for row in part}
    return {
        "settings": tradeoff.SETTINGS,
        "piles": [{key: value for key, value in pile.items() if key != "settings"} for pile in parts["errors"]],
        "rows": tradeoff.condensed(parts["errors"], parts["costs"]),
        "costs": parts["costs"],
        "exact": parts["exact"],
        "peers": [row | {"us": peer_us[peer_key(row)]} for part in parts["peer_errors"] for row in part],
    }


def claims(data: dict) -> list[results.Claim]:
    """The goals of the study, by its medians on settling piles of up to 1,000 circles."""
    n = max(row["n_bodies"] for row in data["rows"] if row["n_bodies"] <= 1000)
    found = []
    for error, over_pgs, over_peers in ((1e-1, 1.0, 1.0), (1e-2, 1.0, 5.0), (1e-3, 3.0, 1.0)):
        best = tradeoff.best_within(data, n, "settling", error)
        for (name, rival), factor in zip(tradeoff.rivals(data, n, error).items(), (over_pgs, over_peers)):
            measured = {f"ours, {key}": value for key, value in (best or {}).items()}
            measured |= {f"rival, {key}": value for key, value in rival.items()}
            text = f"velocity error {error:g}, {n} settling circles: a step is {factor:g}x faster than {name}'s"
            found.append(results.Claim(text, None, best is not None and rival["us"] >= factor * best["us"], measured))
    return found


def verify(options: dict, *, seed: int, jobs: int | Executor, work: Path) -> dict:
    """The data of the verification: errors of what the package recommends, on scenes outside of its study."""
    found = results.read_results(TABLE)
    # Without the margin: it would change the digests of the stored parts once it is installed.
    table = {"data": {name: found["data"][name] for name in ("settings", "rows")}, "provenance": found["provenance"]}
    parts = []
    for n in options["sizes"]:
        for kind in tradeoff.KINDS:
            common = {name: options[name] for name in ("asked", "margins")} | {"table": table}
            common |= {"kind": kind, "n_bodies": n, "states": options["states"][str(n)]}
            common |= {"past_need": options["past_need"][str(n)], "exact": n in options["exact"]}
            # Seeds that no study starts from.
            parts += [("verify", common | {"seed": s}) for s in figures.seeds(seed + 5000, options["seeds"][str(n)])]
    rows = [row for part in done(largest_first(parts), PARTS, work=work, jobs=jobs, text="scenes") for row in part]
    margin = tradeoff.least_margin(rows)
    kept = [row for row in rows if row["margin"] == (margin or max(options["margins"]))]
    by_kind = {kind: shares([row for row in kept if row["kind"] == kind]) for kind in tradeoff.KINDS}
    return {"rows": rows, "margin": margin, "met": shares(kept), "by_kind": by_kind}


def shares(rows: list[dict]) -> dict[str, float]:
    """`tradeoff.met` with names that JSON knows."""
    return {f"{error:g}": share for error, share in tradeoff.met(rows).items()}


def verify_claims(data: dict) -> list[results.Claim]:
    """Whether the recommendations keep their promise."""
    plain = shares([row for row in data["rows"] if row["margin"] == 1.0])
    text = "a recommended setting meets the error asked for in 95 % of the states of scenes outside the study"
    return [
        results.Claim(text, None, data["margin"] is not None, {"margin": data["margin"], **data["met"]}),
        results.Claim(text + ", without a margin", None, bool(plain) and min(plain.values()) >= 0.95, plain),
    ]


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("--quick", action="store_true", help="a smaller study that ends within five minutes")
    add("--seed", type=int, default=0)
    add("--jobs", type=int, default=2, help="processes for the errors (2)")
    add("--scheduler", metavar="ADDRESS", help=parallel.SCHEDULER_HELP + ", for the errors")
    add("--out", type=Path, help="results file (data/reference/tradeoff.json; quick: runs/)")
    add("--work", type=Path, default=Path("runs/tradeoff"), help="folder of the finished parts")
    add("--install", action="store_true", help="make these the numbers that dc.recommend reads")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--errors", action="store_true", help="only what needs no quiet machine; a later run adds times")
    what.add_argument("--verify", action="store_true", help="measure the recommendations on scenes outside the study")
    given = parser.parse_args(arguments)
    start = time.perf_counter()
    try:
        with parallel.opened(given.jobs, given.scheduler) as jobs:
            file = _run(given, jobs)
    except parallel.ClusterError as error:
        print(error, file=sys.stderr)
        return 1
    if file is None:
        return 0
    wall_s = time.perf_counter() - start
    file["provenance"] = results.provenance(seed=given.seed, wall_s=wall_s)
    name = "tradeoff_verify" if given.verify else "tradeoff"
    out = given.out or Path(f"runs/{name}_quick.json" if given.quick else f"data/reference/{name}.json")
    results.write_results(out, file)
    for claim in file["claims"]:
        print(f"{'holds' if claim.holds else 'does not hold'}: {claim.text}: {claim.measured}")
    if given.install:
        install(file)
    print(f"{len(file['data']['rows'])} rows in {out.name}, {wall_s:.0f} s")
    return 0


def _run(given, jobs: int | Executor) -> dict | None:
    """The results without their provenance; None with --errors."""
    settings = {"seed": given.seed, "jobs": jobs, "work": given.work}
    if given.verify:
        options, id = VERIFY_QUICK if given.quick else VERIFY, "V.1"
        title = "Velocity errors of what is recommended, on scenes outside the study"
    else:
        options, id = QUICK if given.quick else FULL, "S.1"
        title = "Speed for accuracy: errors and times of every method and budget"
    if given.errors:
        done(plan(options, given.seed)[0], PARTS, work=given.work, jobs=jobs, text="errors")
        return None
    data = (verify if given.verify else study)(options, **settings)
    found = (verify_claims if given.verify else claims)(data)
    return {"id": id, "title": title, "options": {**options, "quick": given.quick}, "claims": found, "data": data}


def install(file: dict) -> None:
    """Copy a study into the package, or, of a verification, the margin that its recommendations have to keep."""
    if file["id"] == "V.1":
        if file["data"]["margin"] is not None:
            results.write_results(TABLE, tradeoff.with_margin(results.read_results(TABLE), file["data"]["margin"]))
        return
    rows = tradeoff.installed(file["data"]["rows"])
    results.write_results(TABLE, {**file, "data": {"settings": file["data"]["settings"], "rows": rows}})


if __name__ == "__main__":
    sys.exit(main())
