"""A benchmark of warm starts: states in sequence as matrices with last step's impulses, and what starts are worth.

    python scripts/benchmark_starts.py write FOLDER [--circles 100] [--steps 40] [--first 100] [--sweeps 10] [--seed 0]
    python scripts/benchmark_starts.py score FOLDER --out build/results [--start MODULE:FUNCTION …] [--tolerance 1e-4]

`write` runs a pile by PGS with as many sweeps as a user's run takes and writes every step from `--first` on as an FCLIB
file whose guess is what the run carried. `score` solves them from each start with every solver that can be imported; a
start of your own is a function of (problem, carried impulses (2 m,)) that returns impulses (2 m,). Solvers that need
another environment are added by a second run with --add and --only there, with one of ours in both.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from pathlib import Path

import deep_contact as dc
from deep_contact.io.files import write_json
from deep_contact.reporting import results
from deep_contact.studies import outside
from deep_contact.studies.starts import solved_states


def write(arguments) -> None:
    """The sequence of a falling pile, from its first contacts on."""
    scene = dc.circles_in_box(arguments.circles, seed=arguments.seed)
    solver = dc.PGS(sweeps=arguments.sweeps, tolerance=None)
    if arguments.first:
        scene = dc.simulate(scene, steps=arguments.first, solver=solver).state
    states = solved_states(scene, steps=arguments.steps, solver=solver, every=1)
    outside.write_sequence(arguments.folder, states)
    print(f"written: {len(states)} problems in {arguments.folder}")


def score(arguments) -> None:
    """Times and unsolved steps, solver by solver and start by start."""
    starts = dict(outside.STARTS)
    for name in arguments.start:
        module, _, function = name.partition(":")
        starts[name] = getattr(importlib.import_module(module), function)
    begin, path = time.perf_counter(), arguments.out / "benchmark_starts.json"
    solvers, missing = outside.methods(arguments.tolerance)
    solvers = {name: solve for name, solve in solvers.items() if name in (arguments.only or solvers)}
    found = {
        "tolerance": arguments.tolerance,
        "sequence": json.loads((arguments.folder / "sequence.json").read_text(encoding="utf-8")),
        "solvers": outside.score_starts(arguments.folder, starts, tolerance=arguments.tolerance, solvers=solvers),
        "missing": missing,
    }
    found["provenance"] = results.provenance(seed=0, wall_s=time.perf_counter() - begin)
    if arguments.add:
        first = json.loads(path.read_text(encoding="utf-8"))
        for key in ("tolerance", "sequence"):
            if first[key] != found[key]:
                raise ValueError(f"{key}: expected {first[key]} as in the first run, got {found[key]}")
        found = first | {
            "solvers": outside.with_again(first["solvers"], found["solvers"]),
            "missing": {name: why for name, why in first["missing"].items() if name not in solvers},
            "second_provenance": found["provenance"],
        }
    for row in outside.starts_table(found):
        print("| " + " | ".join(row) + " |")
    print(f"written: {write_json(path, found)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    writer = commands.add_parser("write")
    writer.set_defaults(run=write)
    for name, value in {"circles": 100, "steps": 40, "first": 100, "sweeps": 10, "seed": 0}.items():
        writer.add_argument(f"--{name}", type=int, default=value)
    scorer = commands.add_parser("score")
    scorer.set_defaults(run=score)
    scorer.add_argument("--out", type=Path, default=Path("build/results"))
    scorer.add_argument("--start", nargs="*", default=[])
    scorer.add_argument("--tolerance", type=float, default=1e-4)
    scorer.add_argument("--only", nargs="*", default=[], metavar="SOLVER", help="as the table names them")
    scorer.add_argument("--add", action="store_true", help="add the solvers to the results that --out has")
    for command in (writer, scorer):
        command.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    arguments.run(arguments)


if __name__ == "__main__":
    main()
