"""Our engine against Box2D 2.3, pymunk and Box2D v3 on the same piles, in one run.

    python scripts/benchmark_engine.py [--quick] [--sizes 100,1000,10000] [--repeats 5] [--json FILE]

Our engine makes each pile, and every engine gets its circles. "falling" is the moment when there are as many contacts
as circles, about half of the final number; "settled" is the pile at rest. Each engine steps it with 3 sweeps of
position correction, where it has them (ours, Box2D 2.3), in four blocks of steps: of 10, 100, 100 and 10 velocity
sweeps. Ours is timed as users run it, one `dc.simulate` per block: by PGS, in batches by levels, by colours, and by
colours on two threads (`BatchedPGS`), and once by one `dc.step` per step; the others by their step functions, on two
threads as well where they can. Repeats are interleaved, and the fastest of each block counts. For the model, and what
a sweep is in each engine, see `deep_contact.studies.engines`.
"Whole step" is the mean step of 10 sweeps.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib import metadata
from pathlib import Path

import numpy as np

from deep_contact.reporting import results
from deep_contact.studies import engines, peers
from deep_contact.studies.piles import SLOWEST, rms_speed

PILES = Path(__file__).resolve().parents[1] / "runs" / "piles"
GOALS = (
    ("A sweep costs at most a quarter of pybox2d's", "sweep_ns", ("Box2D 2.3",), 0, 4.0),
    (
        "A step is at least 2x faster than pybox2d's and pymunk's from 1,000 on",
        "step_us",
        ("Box2D 2.3", "pymunk"),
        1000,
        2.0,
    ),
    ("The overhead is below pybox2d's and pymunk's", "overhead_us", ("Box2D 2.3", "pymunk"), 0, 1.0),
    ("The overhead is below Box2D v3's from 1,000 on", "overhead_us", ("Box2D v3",), 1000, 1.0),
)
"""Claim, cost, engines, the smallest pile that counts, and the factor to reach."""


def measure(kind: str, n_bodies: int, seed: int, *, steps: int, repeats: int) -> dict:
    """The costs of every engine on one pile."""
    name = f"{kind}_{n_bodies}_seed_{seed}_dt_{engines.TIME_STEP}_sweeps_{engines.FEW}_rest_{SLOWEST['resting']}.npz"
    path = engines.stored_pile(PILES / name, lambda: engines.dropped_pile(kind, n_bodies, seed))
    state = engines.read_pile(path)
    measured = engines.measure(state, engines.ENGINES, steps=steps, repeats=repeats)
    return {
        "n_bodies": n_bodies,
        "kind": kind,
        "rms_speed": rms_speed(state),
        "steps": steps * len(engines.BLOCKS),
        "engines": measured,
        "ratios": engines.ratios(measured),
    }


def claims(cases: list[dict]) -> list[results.Claim]:
    """The goals of the engine, by its worst measured ratios."""
    found = []
    for text, cost, names, smallest, factor in GOALS:
        met = {
            f"{name}, {case['kind']}, {case['n_bodies']}": case["ratios"][name][cost]
            for case in cases
            for name in names
            if case["n_bodies"] >= smallest
        }
        if met:
            worst = min(met, key=met.get)
            holds = bool(met[worst] > factor or (met[worst] == factor and factor > 1))
            found.append(results.Claim(text, None, holds, {"worst case": worst, "ratio": met[worst]}))
    return found


def report(case: dict) -> None:
    """Print the costs of one pile."""
    print(f"\n{case['n_bodies']} circles, {case['kind']} (rms speed {case['rms_speed']:.3f} m/s)")
    print("                         contacts   ns/contact/sweep        overhead, µs       whole step, µs")
    for name, cost in case["engines"].items():
        line = f"  {name:22s}{cost['contacts']:9.0f}"
        for key, digits in (("sweep_ns", 2), ("overhead_us", 1), ("step_us", 1)):
            ratio = f"({case['ratios'][name][key]:.2f}x)" if name in case["ratios"] else ""
            line += f"{cost[key]:12.{digits}f} {ratio:8s}"
        print(line, flush=True)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    parser.add_argument("--sizes", help="numbers of circles, with commas (100,1000,10000; quick: 100,1000)")
    parser.add_argument("--repeats", type=int, help="runs of each engine on each pile (5; quick: 3)")
    parser.add_argument("--seed", type=int, default=0, help="of the piles")
    parser.add_argument("--quick", action="store_true", help="smaller piles, fewer steps")
    given = parser.parse_args(arguments)
    sizes = given.sizes or ("100,1000" if given.quick else "100,1000,10000")
    repeats = given.repeats or (3 if given.quick else 5)
    try:
        sizes = [int(size) for size in sizes.split(",")]
    except ValueError:
        parser.error(f"--sizes: expected integers with commas between, got {sizes!r}")
    if min(sizes) < 1 or repeats < 1:
        parser.error(f"expected sizes and repeats of at least 1, got {sizes} and {repeats}")

    start = time.perf_counter()
    cases = []
    for n_bodies in sizes:
        for kind in engines.KINDS:
            # Long enough that the fixed cost of one `dc.simulate` does not count, as in a run; what falls has landed
            # after a while.
            most = 10 if given.quick else 200 if kind == "settled" else 30
            steps = int(np.clip(300_000 // n_bodies, 10, most))
            cases.append(measure(kind, n_bodies, given.seed, steps=steps, repeats=repeats))
            report(cases[-1])
    found = claims(cases)
    print()
    for claim in found:
        verdict = "holds" if claim.holds else "does not hold"
        print(f"{claim.text}: {verdict} ({claim.measured['ratio']:.2f}x, {claim.measured['worst case']})")
    if given.json:
        options = {
            "sizes": sizes,
            "repeats": repeats,
            "quick": given.quick,
            "dt": engines.TIME_STEP,
            "sweeps": [engines.FEW, engines.MANY],
            "position_sweeps": engines.POSITION_SWEEPS,
            "peers": {name: metadata.version(adapter.package) for name, adapter in peers.ENGINES.items()},
        }
        file = {"id": "B.1", "title": "Cost of a sweep and of a step, against other engines", "options": options}
        file["provenance"] = results.provenance(seed=given.seed, wall_s=time.perf_counter() - start)
        results.write_results(given.json, file | {"claims": found, "data": {"cases": cases}})
    return 0


if __name__ == "__main__":
    sys.exit(main())
