"""Contact problems as matrices, ours and Siconos's, solved by our solvers and by other packages: time to an error.

    python scripts/benchmark_outside.py --out build/results FILE …

FILE: fc2d or FCLIB files (`deep_contact.io.fclib`); without any, piles of our own are solved. Every solver is asked for
`siconos_error` <= the tolerance; what it returns is judged here, by the same function. Packages of the extra `rivals`
and Siconos (a Debian package, python3-siconos) are left out, with the reason, where they cannot be imported. Times are
of the processor: set OPENBLAS_NUM_THREADS=1, for several threads would count several times.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from deep_contact.io.files import write_json
from deep_contact.reporting import plotting, results
from deep_contact.studies import outside
from deep_contact.studies.tradeoff import KINDS

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
    arguments = parser.parse_args()
    begin = time.perf_counter()
    problems = outside.read_problems(arguments.files) | outside.own_problems(arguments.piles)
    limits = {"tolerance": arguments.tolerance, "repeats": arguments.repeats, "most": arguments.most}
    found = outside.compare(problems, **limits, progress=lambda line: print(line, flush=True))
    if arguments.relaxed:
        try:
            found["relaxation"] = outside.relaxation_errors(KINDS, arguments.piles, FRICTIONS, states=arguments.relaxed)
        except ImportError as error:
            found["missing"]["convex relaxation"] = str(error)
    found["provenance"] = results.provenance(seed=0, wall_s=time.perf_counter() - begin)
    path = write_json(arguments.out / "benchmark_outside.json", found)
    plotting.save(outside.draw_profile(found), arguments.out / "benchmark_outside.png")
    for row in outside.table(found):
        print("| " + " | ".join(row) + " |")
    for row in outside.relaxation_table(found)[1:]:
        print("| " + " | ".join(row) + " |")
    print(f"written: {path}")


if __name__ == "__main__":
    main()
