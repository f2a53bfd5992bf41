"""The data of the start `learned support`: packed piles without a past, whose contacts start from the support.

    python scripts/generate_packings.py [--piles 640] [--out data/generated/packings] [--jobs 2]
    python scripts/train.py --data data/generated/packings --spacing 3 --support 3 --options width=16 \\
        --sweeps 10 40 120 --epochs 80 --rate 2e-3 --states-per-epoch 1600 --validation-states 100

Writes <out>/sim_0000.h5, …, about 0.7 MB each: four states of a pile that settles, solved from their past. Five eighths
have 50 to 3,000 circles, the others 600 to 6,000. A file depends on its number only; what is there stays.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact.cnn.dataset import simulation_path
from deep_contact.io import simulation_h5
from deep_contact.physics import metrics
from deep_contact.reporting import figures
from deep_contact.studies.no_past import without_past
from deep_contact.studies.piles import SETTLE, packing

SMALL = {"sizes": (50, 3000), "steps": (80, 80, 200, 300), "stream": 34}
LARGE = {"sizes": (600, 6000), "steps": (80, 120, 300, 400), "stream": 35}
SMALLEST = 0.5, 0.8, 0.95
"""Least radii, m; the largest is 1 m."""
FRICTION = 0.1, 0.3, 0.5, 0.5, 0.5, 0.8, 1.0
UNSOLVED = 1e-2
"""Residual of a solution beyond which a state is left out, m/s."""


def states_of(number: int):
    """The solved states of a pile, each with its support as the start."""
    kind, k = (SMALL, number) if number < 400 else (LARGE, number - 400)
    rng = np.random.default_rng((kind["stream"], k))
    n = int(np.exp(rng.uniform(*np.log(kind["sizes"]))))
    smallest, friction = rng.choice(SMALLEST), float(rng.choice(FRICTION))
    state = packing(n, rng, width=rng.uniform(0.7, 1.3), smallest=smallest, friction=friction)
    tolerance = 1e-8 * float(state.bodies.mass.mean())
    for steps in kind["steps"]:
        state = dc.simulate(state, steps=steps, solver=SETTLE).state
        solution = dc.solve_contacts(state, solver=dc.NNCG(sweeps=10_000, tolerance=tolerance))
        if metrics.residual(state, solution) <= UNSOLVED:
            bare = without_past(state)
            normal, tangent = dc.warm_start.Support()(bare, None)
            contacts = bare.contacts._replace(normal_start=normal, tangent_start=tangent,
                                              normal_impulse=solution.normal_impulses,
                                              tangent_impulse=solution.tangent_impulses)  # fmt: skip
            yield bare.replace(contacts=contacts, solved=True)


def make(number: int, out: Path) -> None:
    """Write the pile's file, unless it is there."""
    path = simulation_path(out, number)
    if not path.exists():
        simulation_h5.write_simulation(path, states_of(number))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--piles", type=int, default=640, metavar="N")
    parser.add_argument("--out", type=Path, default=Path("data/generated/packings"))
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (2)")
    given = parser.parse_args()
    try:
        given.out.mkdir(parents=True, exist_ok=True)
        numbers = range(given.piles)
        figures.parallel_map(partial(make, out=given.out), numbers, jobs=given.jobs, progress=figures.progress_bar,
                             text="piles")  # fmt: skip
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
