"""Siconos's bench-disks: what a step of ours costs, whole, and what Siconos's solver alone costs on the same contacts.

    python scripts/benchmark_disks.py --sides 32 100 --out build/results

`dc.bench_disks` runs with over-relaxed PGS at a fixed number of sweeps. At states along the run, both solve the contact
problem from the impulses that the last step left: ours as the run does, Siconos's NSGS to the tolerance of its own
benchmark, 1e-2. Errors are of velocities, relative in the energy norm, against an exact solution, or the best that was
found, whose natural residual is stored; and Siconos's own measure. Ours is timed over whole steps from that state
(contacts, solve, positions), Siconos's without finding the contacts and building matrices. Times are of the processor:
set OPENBLAS_NUM_THREADS=1. Without Siconos ours is measured alone.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact.io.files import write_json
from deep_contact.physics.lcp import check_problem, contact_problem, natural_residual, siconos_error
from deep_contact.reporting import results
from deep_contact.simulation import ready
from deep_contact.studies import outside


def measure(state, solvers, rival, repeats: int, steps: int = 10) -> dict:
    """Seconds and errors of ours, by name, and of the rival (None without it) at one state."""
    state = ready(state)
    problem = check_problem(contact_problem(state))
    start = np.column_stack([state.contacts.normal_start, state.contacts.tangent_start]).ravel()
    near = dc.solve_contacts(state, solver=dc.NNCG(sweeps=20_000, tolerance=1e-12))
    exact = dc.solve_exactly(state, near.normal_impulses, near.tangent_impulses).solution
    reference = min((impulses(one) for one in (near, exact)), key=lambda found: natural_residual(problem, found))
    solved = {name: impulses(dc.solve_contacts(state, solver=solver)) for name, solver in solvers.items()}
    seconds = dict.fromkeys(solvers, np.inf)
    for _ in range(repeats):
        for name, solver in solvers.items():
            begin = time.process_time()
            dc.simulate(state, steps=steps, solver=solver)
            seconds[name] = min(seconds[name], (time.process_time() - begin) / steps)
        if rival is not None:
            begin = time.process_time()
            solved["Siconos"] = rival(problem, start)
            seconds["Siconos"] = min(seconds.get("Siconos", np.inf), time.process_time() - begin)
    return {
        "step": state.step,
        "contacts": state.contacts.count,
        "seconds": seconds,
        "velocity_error": {name: outside.energy_error(problem, one, reference) for name, one in solved.items()},
        "siconos_error": {name: siconos_error(problem, one) for name, one in solved.items()},
        "reference_residual": natural_residual(problem, reference),
    }


def impulses(solution) -> np.ndarray:
    """λ_n, λ_t of every contact, (2 m,), as `contact_problem` numbers them."""
    return np.column_stack([solution.normal_impulses, solution.tangent_impulses]).ravel()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", type=int, nargs="+", default=[32], help="discs along a side of the block")
    parser.add_argument("--sweeps", type=int, nargs="+", default=[40], help="of ours; the run takes the first")
    parser.add_argument("--omega", type=float, default=1.5, help="over-relaxation of ours, of normals and friction")
    parser.add_argument("--steps", type=int, default=2000, help="of the run")
    parser.add_argument("--every", type=int, default=250, help="steps between the states that are looked at")
    parser.add_argument("--repeats", type=int, default=5, help="timed runs in turns; the least counts")
    parser.add_argument("--out", type=Path, default=Path("build/results"), help="folder of the results")
    arguments = parser.parse_args()
    started = time.perf_counter()
    solvers = {
        f"ours, {sweeps} sweeps": dc.PSOR(
            omega=arguments.omega, friction_omega=arguments.omega, sweeps=sweeps, tolerance=None
        )
        for sweeps in arguments.sweeps
    }
    first = next(iter(solvers.values()))
    rival, missing = None, None
    try:
        rival = outside.siconos("NSGS", 1e-2)
    except ImportError as error:
        missing = str(error)
        print(f"Siconos is left out: {missing}")
    found = {}
    for side in arguments.sides:
        state, rows = dc.bench_disks(side), []
        for _ in range(arguments.steps // arguments.every):
            state = dc.simulate(state, steps=arguments.every, solver=first).state
            rows.append(measure(state, solvers, rival, arguments.repeats))
            row = rows[-1]
            cells = [f"{name} {1e3 * row['seconds'][name]:.3g} ms, velocities {row['velocity_error'][name]:.2g}, "
                     f"Siconos's error {row['siconos_error'][name]:.2g}" for name in row["seconds"]]  # fmt: skip
            print(f"{side}² discs, step {row['step']}, {row['contacts']} contacts: {'; '.join(cells)}; "
                  f"reference {row['reference_residual']:.1g} m/s", flush=True)  # fmt: skip
        found[str(side)] = rows
    options = {
        "omega": arguments.omega,
        "sweeps": arguments.sweeps,
        "every": arguments.every,
        "repeats": arguments.repeats,
    }
    made = results.provenance(seed=0, wall_s=time.perf_counter() - started)
    found = {"options": options, "provenance": made, "missing": missing, "sides": found}
    path = write_json(arguments.out / "benchmark_disks.json", found)
    print(f"written: {path}")


if __name__ == "__main__":
    main()
