"""Time of the particle–grid transfer: the thesis's case, the k-d tree in the same run, and growth with particles.

    python scripts/benchmark_transfer.py [--json FILE] [--kernel poly6] [--normalization particle]

One core. Every time is the minimum of many calls of the public functions, with their validation. The case is 100 bodies
in 4 channels and 170 contacts in 2 channels on the thesis's 61 x 61 nodes with h = d = 0.5 m. Growth is measured from
100 to 100,000 particles in 2 channels: on the same grid, where an image is a fixed cost, and on one that grows with the
particles at the thesis's density of 170 contacts in 900 m².
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np

from deep_contact import sph
from deep_contact.reporting.results import provenance, replacing
from deep_contact.sph.neighbours import splat_by_tree
from deep_contact.studies import timing

BOX = (0.0, 0.0, 30.0, 30.0)
SPACING = 0.5
COUNTS = (100, 316, 1000, 3162, 10_000, 31_623, 100_000)


def shortest(function) -> float:
    """Seconds per call: the minimum over calls that take about 0.3 s together, at least three."""
    return timing.fastest(function, repeats=max(3, min(int(0.3 / timing.fastest(function, repeats=1)), 20_000)))


def particles(rng, count, channels, box=BOX):
    """Positions uniform over the box, values normal."""
    return rng.uniform(box[:2], box[2:], (count, 2)), rng.normal(size=(count, channels))


def thesis_case(options) -> dict[str, float]:
    """Seconds of the calls that a step of the SPH start and of the images makes, and of the k-d tree."""
    rng = np.random.default_rng(0)
    grid = sph.Grid.over_box(BOX, SPACING)
    bodies, contacts = particles(rng, 100, 4), particles(rng, 170, 2)
    image = sph.splat(grid, *contacts, **options)
    kernel = {name: options[name] for name in ("h", "kernel")}
    density = sph.density(grid, contacts[0], **kernel)

    def both(splat, **more):
        splat(grid, *bodies, **options, **more)
        splat(grid, *contacts, **options, **more)

    def round_trip():
        consistent = options | {"normalization": "consistent"}
        return sph.gather(grid, sph.splat(grid, *contacts, **consistent), contacts[0], **consistent)

    def gather_consistent():
        return sph.gather(grid, image, contacts[0], normalization="consistent", density=density)

    return {
        "splat of 100 bodies, 4 channels": shortest(lambda: sph.splat(grid, *bodies, **options)),
        "splat of 170 contacts, 2 channels": shortest(lambda: sph.splat(grid, *contacts, **options)),
        "splat of both": shortest(lambda: both(sph.splat)),
        "density of 170 contacts": shortest(lambda: sph.density(grid, contacts[0], **kernel)),
        "gather of 170 contacts, bilinear": shortest(lambda: sph.gather(grid, image, contacts[0])),
        "gather of 170 contacts, consistent": shortest(gather_consistent),
        "splat, density and consistent gather": shortest(round_trip),
        "k-d tree, splat of both": shortest(lambda: both(splat_by_tree)),
        "k-d tree, all nodes in one query": shortest(lambda: both(splat_by_tree, one_query=True)),
    }


def growth(options, *, grows: bool) -> dict:
    """Seconds of splat and gather for each count, and the exponents b of time ~ count^b fitted over all of them."""
    rng = np.random.default_rng(1)
    times = {"splat": [], "gather": []}
    for count in COUNTS:
        side = 30.0 * math.sqrt(count / 170) if grows else 30.0
        box = (0.0, 0.0, side, side)
        grid = sph.Grid.over_box(box, SPACING)
        position, values = particles(rng, count, 2, box)
        image = sph.splat(grid, position, values, **options)
        times["splat"].append(shortest(lambda: sph.splat(grid, position, values, **options)))  # noqa: B023
        times["gather"].append(shortest(lambda: sph.gather(grid, image, position)))  # noqa: B023
    slopes = {name: float(np.polyfit(np.log(COUNTS), np.log(t), 1)[0]) for name, t in times.items()}
    return {"count": list(COUNTS), "seconds": times, "exponent": slopes}


def report(result) -> None:
    """Print the tables."""
    for name, seconds in result["case"].items():
        print(f"{name:40} {seconds * 1e6:12.1f} µs")
    for name, ratio in result["ratio"].items():
        print(f"{name:40} {ratio:12.0f} x")
    for mode, table in result["growth"].items():
        print(f"\n{mode}\n{'particles':>10} {'splat µs':>12} {'ns each':>9} {'gather µs':>12} {'ns each':>9}")
        for n, splat, gather in zip(table["count"], table["seconds"]["splat"], table["seconds"]["gather"], strict=True):
            print(f"{n:10} {splat * 1e6:12.1f} {splat / n * 1e9:9.1f} {gather * 1e6:12.1f} {gather / n * 1e9:9.1f}")
        print("time ~ particles^b: " + ", ".join(f"{name} b = {b:.2f}" for name, b in table["exponent"].items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers there too")
    parser.add_argument("--kernel", default="poly6", choices=sph.KERNELS)
    parser.add_argument("--normalization", default="particle", choices=("raw", "particle"))
    arguments = parser.parse_args()
    options = {"h": SPACING, "kernel": arguments.kernel, "normalization": arguments.normalization}
    case = thesis_case(options)
    result = {
        "options": options,
        "spacing": SPACING,
        "provenance": provenance(),
        "case": case,
        "ratio": {
            "k-d tree / splat of both": case["k-d tree, splat of both"] / case["splat of both"],
            "k-d tree, one query / splat of both": case["k-d tree, all nodes in one query"] / case["splat of both"],
        },
        "growth": {
            "fixed grid of 61 x 61 nodes": growth(options, grows=False),
            "grid that grows at fixed density": growth(options, grows=True),
        },
    }
    report(result)
    if arguments.json:
        with replacing(arguments.json) as temporary:
            temporary.write_text(json.dumps(result, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
