"""Contact problems as matrices, ours and Siconos's, solved by our solvers and by other packages: time to an error.

    python scripts/benchmark_outside.py --out build/results FILE …

FILE: fc2d or FCLIB files (`deep_contact.io.fclib`); without any, piles of our own are solved. Every solver is asked for
`siconos_error` <= the tolerance; what it returns is judged here, by the same function. Packages of the extra `rivals`
and Siconos (a Debian package, python3-siconos) are left out, with the reason, where they cannot be imported. Times are
of the processor: set OPENBLAS_NUM_THREADS=1, for several threads would count several times.

pinocchio 4 and Debian's Siconos need different NumPys: run where one of them is, then, with --add and --only, where the
other is, with one of ours in both.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from deep_contact.io.files import write_json
from deep_contact.reporting import plotting, results
from deep_contact.studies import mujoco_piles, outside
from deep_contact.studies.piles import SLOWEST

FRICTIONS = (0.1, 0.5, 1.0)
"""μ of the steps whose convex relaxation is held against the exact solution."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help="fc2d or FCLIB files")
    parser.add_argument("--out", type=Path, default=Path("build/results"), help="folder of the results")
    parser.add_argument("--tolerance", type=float, default=1e-5, help="Siconos's error that is asked for")
    parser.add_argument("--piles", type=int, nargs="*", default=[100, 300], help="circles of our own piles")
    parser.add_argument("--repeats", type=int, default=5, help="timed runs in turns; the least counts")
    parser.add_argument("--most", type=float, default=20.0, help="s; who takes more runs once, and on nothing larger")
    parser.add_argument("--relaxed", type=int, default=0, metavar="STATES", help="also the convex relaxation's errors")
    parser.add_argument("--mujoco", type=int, nargs="*", default=[], metavar="CIRCLES", help="also piles in MuJoCo")
    parser.add_argument("--only", nargs="*", default=[], metavar="METHOD", help="of the table, as it names them")
    parser.add_argument("--add", action="store_true", help="add the methods to the results that --out has")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    problems = outside.read_problems(arguments.files) | outside.own_problems(arguments.piles)
    path = arguments.out / "benchmark_outside.json"
    limits = {
        "only": arguments.only,
        "tolerance": arguments.tolerance,
        "repeats": arguments.repeats,
        "most": arguments.most,
    }
    found = outside.compare(problems, **limits, progress=lambda line: print(line, flush=True))
    if arguments.relaxed:
        try:
            found["relaxation"] = outside.relaxation_errors(
                SLOWEST, arguments.piles, FRICTIONS, states=arguments.relaxed
            )
        except ImportError as error:
            found["missing"]["convex relaxation"] = str(error)
    if arguments.mujoco:
        try:
            found["mujoco"] = mujoco_piles.compare(arguments.mujoco, repeats=arguments.repeats)
        except ImportError as error:
            found["missing"]["MuJoCo"] = str(error)
    found["provenance"] = results.provenance(seed=0, wall_s=time.perf_counter() - begin)
    if arguments.add:
        found = outside.with_second_run(json.loads(path.read_text(encoding="utf-8")), found)
    write_json(path, found)
    plotting.save(outside.draw_profile(found), arguments.out / "benchmark_outside.png")
    for rows in (outside.table(found), outside.relaxation_table(found), mujoco_piles.table(found.get("mujoco", []))):
        for row in rows if len(rows) > 1 else []:
            print("| " + " | ".join(row) + " |")
    print(f"written: {path}")


if __name__ == "__main__":
    main()
