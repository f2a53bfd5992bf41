"""The step as a budget: time of each stage in the running step, a circle.

    python scripts/benchmark_step.py [--quick] [--sizes 100,1000,3000,10000,100000,1000000] [--repeats 30] [--json FILE]

Steps of ten sweeps and three sweeps of position correction, contact by contact and in batches by colours, of piles that
fall and that have settled (of `scripts/benchmark_engine.py`; from 100,000 circles on, packed piles of Figure 6.5, which
do not have to fall first). Times are of the compiled steps alone, each stage's the least of the repeats. For how they
are taken, and for the floor of a stage, see `deep_contact.studies.step_stages`.

The same piles are run as users run them, by `dc.simulate`, with every method and on two threads, in turns; the fastest
counts. The memory is the largest that a process takes that runs a pile of that size from its scene. Last, 16 piles
of 100 circles are run by `dc.simulate_many`, on one core and on all.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

from deep_contact.compiled import crew
from deep_contact.physics.solvers import PGS, BatchedPGS
from deep_contact.reporting import results
from deep_contact.simulation import simulate, simulate_many
from deep_contact.state import State
from deep_contact.studies import engines, step_stages, timing

PILES = Path(__file__).resolve().parents[1] / "runs" / "piles"
LARGE = 100_000
"""Circles from which on piles are packed instead of dropped."""

RUNS = {
    "PGS": PGS,
    "colours": partial(BatchedPGS, threads=1),
    "colours, two threads": partial(BatchedPGS, threads=2),
}
"""Name -> method whose runs are timed."""

MEMORY = """
from deep_contact.studies import engines
engines.simulate(engines.packed_pile({n_bodies}, steps=0), steps=5, solver=engines.solver_of(10))
with open("/proc/self/status") as status:
    print(*(line.split()[1] for line in status if line.startswith("VmHWM")))
"""
"""What a process does whose largest memory is measured. (What `getrusage` tells is no less than its parent's.)"""


def pile_of(kind: str, n_bodies: int, seed: int) -> State:
    """A stored pile a few steps later: with contacts that carry impulses."""
    if n_bodies >= LARGE:
        path = PILES / f"packed_{n_bodies}_seed_{seed}.npz"
        engines.stored_pile(path, lambda: engines.packed_pile(n_bodies, seed=seed, steps=50))
    else:
        path = PILES / f"step_{kind}_{n_bodies}_seed_{seed}.npz"
        engines.stored_pile(path, lambda: engines.dropped_pile(kind, n_bodies, seed))
    return simulate(engines.read_pile(path), steps=engines.WARM_UP, solver=engines.solver_of(engines.FEW)).state


def measure_runs(state: State, repeats: int) -> dict[str, float]:
    """Name of a method -> microseconds of a step in a run, the least of so many runs in turns."""
    steps = max(5, min(200, 200_000 // state.bodies.count))
    found = dict.fromkeys(RUNS, math.inf)
    for method in RUNS.values():
        simulate(state, steps=2, solver=engines.solver_of(engines.FEW, method))
    for _ in range(repeats):
        for name, method in RUNS.items():
            begin = time.perf_counter()
            simulate(state, steps=steps, solver=engines.solver_of(engines.FEW, method))
            found[name] = min(found[name], 1e6 * (time.perf_counter() - begin) / steps)
    return found


def measure_many(seed: int, repeats: int, piles: int = 16, steps: int = 600) -> dict:
    """Settled piles of 100 by `simulate_many`: μs of a step on one core and on all, and of the bare steps of one run.

    "bare" has 20 times the steps in one call of `simulate`, whose price vanishes then.
    """
    states = [pile_of("settled", 100, seed + k) for k in range(piles)]
    solver, cores = engines.solver_of(engines.FEW), crew.cores()
    each = {"solver": solver, "steps": steps}
    run = {
        "bare": lambda: simulate(states[0], solver=solver, steps=20 * steps),
        "one core": lambda: simulate_many(states, threads=1, **each),
        "all cores": lambda: simulate_many(states, **each),
    }
    counts = {"bare": 20 * steps, "one core": piles * steps, "all cores": piles * steps}
    took = timing.interleaved(run, repeats=repeats)
    return {"cores": cores, "us": {name: 1e6 * seconds / counts[name] for name, seconds in took.items()}}


def peak_memory(n_bodies: int) -> float:
    """The largest memory, MB, of a process that runs a packed pile by PGS, its interpreter and code included."""
    done = subprocess.run([sys.executable, "-c", MEMORY.format(n_bodies=n_bodies)], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"memory: the process failed:\n{done.stderr}")
    return int(done.stdout) * 1024 / 1e6


def report(case: dict) -> None:
    """Print the stages of one pile."""
    print(f"\n{case['n_bodies']:,} circles, {case['kind']}, {case['engine']}: {case['ns']:.0f} ns a circle and step")
    for stage, cost in case["stages"].items():
        share = cost["ns"] / case["ns"]
        print(f"  {stage:30s}{cost['ns']:8.1f} ns  {share:6.1%}   floor {cost['floor_ns']:6.1f} ns", flush=True)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    parser.add_argument("--sizes", help="numbers of circles, with commas (100 to 1000000; quick: 100,1000)")
    parser.add_argument("--repeats", type=int, help="runs of each step on each pile (30; quick: 5)")
    parser.add_argument("--seed", type=int, default=0, help="of the piles")
    parser.add_argument("--quick", action="store_true", help="smaller piles, fewer steps")
    given = parser.parse_args(arguments)
    sizes = given.sizes or ("100,1000" if given.quick else "100,1000,3000,10000,100000,1000000")
    repeats = given.repeats or (5 if given.quick else 30)
    try:
        sizes = [int(size) for size in sizes.split(",")]
    except ValueError:
        parser.error(f"--sizes: expected integers with commas between, got {sizes!r}")
    if min(sizes) < 1 or repeats < 1:
        parser.error(f"expected sizes and repeats of at least 1, got {sizes} and {repeats}")

    start = time.perf_counter()
    timed, cases, runs, all_repeats = step_stages.timed_steps(), [], [], repeats
    for n_bodies in sizes:
        repeats = max(2, min(all_repeats, 3_000_000 // n_bodies))
        steps = max(10, min(50, 500_000 // n_bodies))  # the first of a run have new memory and no list of pairs
        for kind in ("packed",) if n_bodies >= LARGE else engines.KINDS:
            state = pile_of(kind, n_bodies, given.seed)
            for engine, step in timed.items():
                solver = engines.solver_of(engines.FEW, step_stages.ENGINES[engine])
                measured = step_stages.measure(state, solver, step, steps=steps, repeats=repeats)
                cases.append({"n_bodies": n_bodies, "kind": kind, "engine": engine, "steps": steps, **measured})
                report(cases[-1])
            runs.append({"n_bodies": n_bodies, "kind": kind, "us": measure_runs(state, min(repeats, 10))})
            print(
                "  whole steps:", ", ".join(f"{name} {us:,.1f} µs" for name, us in runs[-1]["us"].items()), flush=True
            )
    memory = {str(n): peak_memory(n) for n in sizes if n >= LARGE and Path("/proc/self/status").exists()}
    print("\n".join(f"{int(n):,} circles: {found:,.0f} MB at the peak" for n, found in memory.items()))
    many = measure_many(given.seed, min(all_repeats, 5))
    print("many piles of 100, µs a step:", {name: round(us, 1) for name, us in many["us"].items()})
    if given.json:
        options = {
            "sizes": sizes,
            "repeats": all_repeats,
            "quick": given.quick,
            "dt": engines.TIME_STEP,
            "sweeps": engines.FEW,
            "position_sweeps": engines.POSITION_SWEEPS,
        }
        file = {"id": "B.2", "title": "Time of each stage in the running step", "options": options}
        file["provenance"] = results.provenance(seed=given.seed, wall_s=time.perf_counter() - start)
        results.write_results(
            given.json, file | {"claims": [], "data": {"cases": cases, "runs": runs, "memory_mb": memory, "many": many}}
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
