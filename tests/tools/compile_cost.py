"""python tests/tools/compile_cost.py [KIND …] [--functions]: what a first run compiles, each kind with an empty cache.

Prints for each kind of scene the functions that Numba compiles, the modules that it hands to LLVM, the lines of these
modules, in LLVM's language before it optimises, and the processor time of the first call, in s. Counts do not depend on
the machine; other work on it makes the time longer. --functions: each function of the package and of Numba, with its
modules and lines, the largest first.

--before CHECKOUT compares with an earlier commit: both take turns, `--repeats` times. --out FILE stores all numbers
after each turn; a file of the same two commits is gone on with.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

from numba.core import codegen, event

ROOT = Path(__file__).resolve().parents[2]

KINDS = {
    "pile": "dc.simulate(dc.circles_in_box(20), steps=1, accuracy='fast')",
    "pile, PGS": "dc.simulate(dc.circles_in_box(20), steps=1, solver=dc.PGS())",
    "pile, accurate": "dc.simulate(dc.circles_in_box(20), steps=1, accuracy='accurate')",
    "terrain": "dc.simulate(dc.terrain(20), steps=1, accuracy='fast')",
    "bounces": "dc.simulate(dc.circles_in_box(20, restitution=0.8), steps=1, accuracy='fast')",
    "moving wall": "dc.simulate(dc.drum(20, froude=0.5), steps=1, accuracy='fast')",
}
"""Kind of scene -> its first step."""


class Count(event.Listener):
    """What is compiled while it listens: function -> number of versions, modules and lines."""

    def __init__(self):
        self.versions, self.modules, self.lines, self._running = Counter(), Counter(), Counter(), []

    def on_start(self, event) -> None:
        function = event.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__qualname__}"
        self.versions[name] += 1
        self._running.append(name)

    def on_end(self, event) -> None:
        self._running.pop()

    def add(self, module) -> None:
        """Count a module that the function which is compiled now hands to LLVM."""
        name = self._running[-1] if self._running else "(none)"
        self.modules[name] += 1
        self.lines[name] += str(module).count("\n")


def count(call: Callable) -> tuple[Count, float]:
    """What a call compiles in this process, and its processor time, s."""
    counted, add = Count(), codegen.CPUCodeLibrary.add_ir_module

    def add_and_count(library, module):
        counted.add(module)
        add(library, module)

    codegen.CPUCodeLibrary.add_ir_module = add_and_count
    try:
        with event.install_listener("numba:compile", counted):
            begun = time.process_time()
            call()
            return counted, time.process_time() - begun
    finally:
        codegen.CPUCodeLibrary.add_ir_module = add


def cost(kind: str, checkout: Path = ROOT) -> dict:
    """What a kind compiles in a process of its own with an empty cache. checkout: whose package it uses.

    Returns {"functions": name -> [versions, modules, lines], "seconds": processor time}.
    """
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder, "PYTHONPATH": str(checkout)}
        command = [sys.executable, __file__, kind, "--here"]
        options = {"env": environment, "cwd": folder, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        done = subprocess.run(command, check=True, text=True, timeout=900, **options)
    return json.loads(done.stdout)


def sums_of(found: dict) -> list[int]:
    """Functions, modules and lines of a `cost`, in all."""
    return [sum(column) for column in zip(*found["functions"].values())]


def commit_of(checkout: Path) -> str:
    """The commit of a checkout; "+changes" follows it if tracked files but data/reference differ from it."""
    git = partial(subprocess.check_output, cwd=checkout, text=True)
    changed = git(["git", "status", "--porcelain", "--untracked-files=no", "--", ":/", ":(top,exclude)data/reference"])
    return git(["git", "rev-parse", "HEAD"]).strip() + ("+changes" if changed else "")


def compare(kinds, before: Path, repeats: int, out: Path | None) -> None:
    """Measure kinds in this checkout and in another, in turns. Stores the numbers in `out`, and prints them."""
    from deep_contact.io.provenance import provenance

    sides = {"now": ROOT, "before": before}
    commits, record = {side: commit_of(path) for side, path in sides.items()}, {}
    if out and out.exists():
        record = json.loads(out.read_text(encoding="utf-8"))
    if record.get("commits") != commits:
        record = {"provenance": provenance(), "commits": commits, "kinds": {}}
    for turn in range(repeats):
        for kind in kinds:
            row = record["kinds"].setdefault(kind, {side: {"seconds": []} for side in sides})
            for side in list(sides)[:: 1 if turn % 2 else -1]:
                if len(row[side]["seconds"]) <= turn:
                    found = cost(kind, sides[side])
                    row[side] |= dict(zip(("functions", "modules", "lines"), sums_of(found)))
                    row[side]["seconds"].append(round(found["seconds"], 2))
            if out:
                out.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(
        f"{'kind':16}{'functions':>10}{'lines':>10}{'s':>8}{'before: functions':>20}{'lines':>10}{'s':>8}{'ratio':>8}"
    )
    for kind, row in record["kinds"].items():
        (n, lines, s), (n_before, lines_before, s_before) = (
            (row[side]["functions"], row[side]["lines"], median(row[side]["seconds"])) for side in sides
        )
        print(f"{kind:16}{n:10}{lines:10,}{s:8.1f}{n_before:20}{lines_before:10,}{s_before:8.1f}{s / s_before:8.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--functions", action="store_true", help="list them")
    parser.add_argument("--before", type=Path, help="checkout of an earlier commit")
    parser.add_argument("--repeats", type=int, default=3, help="turns of both commits")
    parser.add_argument("--out", type=Path, help="file for the numbers of both")
    parser.add_argument("--here", action="store_true", help="in this process, with its cache, as JSON")
    args = parser.parse_args()
    if args.here:
        import deep_contact as dc

        counted, seconds = count(partial(eval, KINDS[args.kinds[0]], {"dc": dc}))
        functions = {name: (n, counted.modules[name], counted.lines[name]) for name, n in counted.versions.items()}
        print(json.dumps({"functions": functions, "seconds": seconds}))
        return
    if args.before:
        compare(args.kinds or KINDS, args.before.resolve(), args.repeats, args.out)
        return
    print(f"{'kind':16}{'functions':>10}{'modules':>10}{'lines':>10}{'s':>8}")
    for kind in args.kinds or KINDS:
        found = cost(kind)
        sums = sums_of(found)
        print(f"{kind:16}{sums[0]:10}{sums[1]:10}{sums[2]:10,}{found['seconds']:8.1f}", flush=True)
        if args.functions:
            for name, numbers in sorted(found["functions"].items(), key=lambda item: -item[1][2]):
                print("  ", *numbers, name)


if __name__ == "__main__":
    main()
