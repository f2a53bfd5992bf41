"""python scripts/all_references.py [--jobs J] [--list]: make every file of data/reference again.

Studies and benchmarks first, since figures are drawn from some of them; then all figures and tables, and the tables of
the pages. It takes some hours, on a machine that does nothing else. A file that this commit made is kept, so the
command goes on where it was stopped; results do not count as changes of the checkout.
Exit status: 0, 1 if a command failed, 130 after Ctrl-C.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

from deep_contact.io.provenance import commit
from deep_contact.reporting.scripts import find

HERE = Path(__file__).resolve().parent
REFERENCE = HERE.parent / "data" / "reference"

STUDIES = {
    "run_tradeoff": ["run_tradeoff.py", "--out"],
    "run_tradeoff_verify": ["run_tradeoff.py", "--verify", "--out"],
    "benchmark_engine": ["benchmark_engine.py", "--json"],
    "benchmark_step": ["benchmark_step.py", "--json"],
    "benchmark_transfer": ["benchmark_transfer.py", "--json"],
    "benchmark_state_xml": ["benchmark_state_xml.py", "--json"],
    "soak": ["../tests/tools/soak.py", "--out"],
    "mutants": ["../tests/tools/mutate.py", "--mutants", "100", "--out"],
    "mutants_late": ["../tests/tools/mutate.py", "--late", "--mutants", "64", "--out"],
}
"""File of data/reference -> the script and options that write it; the path follows."""

ELSEWHERE = ("benchmark_disks", "benchmark_outside", "benchmark_starts", "fuzz")
"""Files that need problems and solvers of others (docs/outside.md says which), and one that several runs fill."""


def is_of_this_commit(path, digits):
    """Whether a file was made by this commit, without changes."""
    if not path.exists() or digits == "unknown" or digits.endswith("+changes"):
        return False
    return json.loads(path.read_text(encoding="utf-8")).get("provenance", {}).get("commit") == digits


def commands(jobs=None):
    """Commands that are still to be run, in their order."""
    digits, passed = commit(), [] if jobs is None else ["--jobs", str(jobs)]
    wanted = []
    for name, (script, *options) in STUDIES.items():
        path = REFERENCE / f"{name}.json"
        if not is_of_this_commit(path, digits):
            wanted.append([str(HERE / script), *options, str(path)])
    figures = [str(HERE / "all_figures.py"), "--out", str(REFERENCE), "--resume", *passed, "--only"]
    return [*wanted, [*figures, ",".join(find(HERE))], [str(HERE / "readme.py")]]


def main(arguments=None):
    """Run what is to be run; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, help="processes of each figure (default: one for each core)")
    parser.add_argument("--list", action="store_true", help="print the commands and run none")
    given = parser.parse_args(arguments)
    failed = []
    for command in commands(given.jobs):
        print("python", *command, flush=True)
        if not given.list:
            try:
                failed += [command[0]] if subprocess.run([sys.executable, *command]).returncode else []
            except KeyboardInterrupt:
                return 130
    for script in failed:
        print(f"failed: {script}", file=sys.stderr)
    return int(bool(failed))


if __name__ == "__main__":
    raise SystemExit(main())
