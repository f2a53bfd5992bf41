"""python tests/tools/change_cost.py [--sizes 100,1000,10000] [--before TREE] [--only TEXT]: what changes cost.

A pile at rest is run step by step with the preset "fast". Before each step something is changed. The table has, for
each size and change, the time of a plain step, and the time that the change adds to a step, in the mean and at most,
in μs and in plain steps. A second run without changes takes its steps in turns with the first one. Times are processor
times of the thread, which other programs disturb less.

--before: folder with another version of the package. Both versions are timed, one after the other for each size, and
the table has both.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]

WARM = 60
"""Number of steps before the timing: so many calls determine the types of arguments (`compiled.direct.OFTEN`)."""

LONGEST = 20.0
"""Time after which a case ends, s."""


def turned(angle: float) -> tuple[float, float]:
    """Gravity, m/s², turned by an angle, rad."""
    return 9.81 * np.sin(angle), -9.81 * np.cos(angle)


def pushed(live, newtons: float) -> np.ndarray:
    """A force on the first circle, N, (n, 2)."""
    force = np.zeros_like(live.positions)
    force[0, 0] = newtons
    return force


def remove_highest(live, k: int) -> None:
    live.remove([int(live.positions[:, 1].argmax())])


CHANGES = {
    "gravity turned by 1e-5 rad": (100, lambda live, k: live.set(gravity=turned(1e-5 * k))),
    "friction 0.5 + 1e-6 k": (100, lambda live, k: live.set(friction=0.5 + 1e-6 * k)),
    "friction 0.5 - 1e-6 k": (100, lambda live, k: live.set(friction=0.5 - 1e-6 * k)),
    "restitution 1e-6 k": (100, lambda live, k: live.set(restitution=1e-6 * (k + 1))),
    "push of 1e-3 N": (100, lambda live, k: live.set(push=pushed(live, 1e-3 * np.cos(k)))),
    "a wall's velocity": (100, lambda live, k: live.set(segment_velocities=[((0.0, 1e-3 * np.cos(k)),) * 2])),
    "gravity turned by 1e-3 rad": (100, lambda live, k: live.set(gravity=turned(1e-3 * k))),
    "gravity turned by 0.1 rad": (10, lambda live, k: live.set(gravity=turned(0.1 * (k % 2)))),
    "gravity off and on": (10, lambda live, k: live.set(gravity=turned(0.0) if k % 2 else (0.0, 0.0))),
    "a circle removed": (10, remove_highest),
}
"""Name of a change -> (number of changes, function that makes the k-th change of a `Simulator`)."""


def pile(n: int):
    """A pile of n circles at rest, with the solver of the preset "fast"."""
    import deep_contact as dc
    from deep_contact.studies import piles

    settling = dc.PGS(sweeps=10, tolerance=None, position_sweeps=3)
    state = piles.pile("resting", n, 1, solver=settling, most=3000, make=dc.lattice_in_box)
    return dc.simulate(state.replace(solver=None), steps=100, accuracy="fast").state


def costs(n: int, only: str) -> list[dict]:
    """The costs of changes of a pile of n circles, of the package in this process. only: part of their names."""
    import deep_contact as dc

    state, rows = pile(n), []
    for name, (count, change) in CHANGES.items():
        if only not in name:
            continue
        scene = state
        if "wall" in name:  # above the pile, where it touches nothing
            x_min, _, x_max, y_max = state.world.box
            wall = {"segments": [((x_min, y_max - 1.0), (x_max, y_max - 1.0))]}
            velocities = [((0.0, 1e-3), (0.0, 1e-3))]
            scene = state.replace(world=replace(state.world, **wall, segment_velocities=velocities))
        first, live, still = (dc.Simulator(scene, accuracy="fast") for _ in range(3))
        for run in (first, live, still):
            if "push" in name:
                run.set(push=pushed(run, 0.0))
            if "restitution" in name:
                run.set(restitution=1e-6)
            for _ in range(WARM):
                run.step()
        for k in range(3):  # loads the compiled code
            change(first, k)
            first.step()
        plain, changed, begun = [], [], time.thread_time()
        for k in range(count):
            times = [time.thread_time()]
            change(live, k)
            live.step()
            times.append(time.thread_time())
            still.step()
            times.append(time.thread_time())
            changed.append(times[1] - times[0])
            plain.append(times[2] - times[1])
            if times[2] - begun > LONGEST:
                break
        step = float(np.median(plain))
        row = {"n": n, "change": name, "step": step, "median": np.median(changed) - step}
        rows.append(row | {"mean": np.mean(changed) - step, "most": np.max(changed) - step})
    return rows


def measured(tree: Path, n: int, only: str) -> list[dict]:
    """The `costs` of the package in a folder, in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(tree)}
    command = [sys.executable, __file__, "--here", str(n), "--only", only]
    done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="100,1000,10000", help="numbers of circles")
    parser.add_argument("--before", type=Path, help="folder with another version of the package")
    parser.add_argument("--only", default="", help="part of the names of the changes")
    parser.add_argument("--here", type=int, metavar="N", help="one size in this process, as JSON")
    args = parser.parse_args()
    if args.here:
        print(json.dumps(costs(args.here, args.only)))
        return
    trees = {"now": ROOT} if args.before is None else {"before": args.before.resolve(), "now": ROOT}
    print("| circles | change | version | step, µs | mean, µs | median, µs | most, µs | mean, steps | most, steps |")
    print("| --- " * 9 + "|")
    for n in map(int, args.sizes.split(",")):
        found = {name: measured(tree, n, args.only) for name, tree in trees.items()}
        for rows in zip(*found.values()):
            for version, row in zip(found, rows):
                us = [f"{1e6 * row[name]:,.0f}" for name in ("step", "mean", "median", "most")]
                steps = [f"{row[name] / row['step']:,.1f}" for name in ("mean", "most")]
                print("|", " | ".join([f"{n:,}", row["change"], version, *us, *steps]), "|", flush=True)


if __name__ == "__main__":
    main()
