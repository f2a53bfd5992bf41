"""python scripts/all_figures.py [--quick] [--only 3.7,5.9,T5.1] [--out figures] [--verbose] [--jobs J] …

Runs every scripts/figure_*.py and scripts/table_*.py in the order of their numbers. A failure does not stop the others.
At the end it prints a summary and writes all results of the folder into one page, <out>/index.html. `--resume` skips
those whose stored results have the same settings and commit, `--replot` draws all again from what is stored. Exit
status: 0 if all succeeded, 1 if any failed, 2 for bad arguments, 130 after Ctrl-C.
"""

import argparse
import ast
import signal
import subprocess
import sys
import time
from pathlib import Path

from deep_contact import parallel
from deep_contact.reporting import page, results
from deep_contact.reporting.figures import INTERRUPTED
from deep_contact.reporting.scripts import choose, find, stem

INTERRUPTS = (INTERRUPTED, -signal.SIGINT)
"""Exit status of a script that was ended by Ctrl-C, the second one before it could catch it."""

HERE = Path(__file__).resolve().parent


def main(arguments=None, folder=HERE):
    """Run the scripts of a folder; the exit status."""
    given, passed_on = parse(arguments)
    try:
        scripts = find(folder)
        chosen = scripts if given.only is None else choose(scripts, given.only.split(","))
    except ValueError as error:
        print(f"all_figures.py: {error}", file=sys.stderr)
        return 2
    done, interrupted = [], False
    for number, (name, script) in enumerate(chosen.items(), start=1):
        print(f"\n[{number}/{len(chosen)}] {script.name}", flush=True)
        stored = Path(given.out) / f"{stem(script)}.json"
        before, start = written(stored), time.perf_counter()
        status = run([sys.executable, str(script), *passed_on])
        done.append((name, status, written(stored) == before, time.perf_counter() - start, stored))
        interrupted = status in INTERRUPTS
        if interrupted:
            break
    if Path(given.out).is_dir():
        captions = {id_of(name): caption(path) for name, path in scripts.items()}
        expected = [id_of(name) for name in chosen]
        index = page.write_report(given.out, expected=expected, others=captions, captions=captions)
        print(f"\nall results as one page: {index}")
    summarise(done)
    return INTERRUPTED if interrupted else int(any(status != 0 for _, status, *_ in done))


def written(path):
    """Time at which a file was written, or None if it does not exist."""
    return path.stat().st_mtime_ns if path.exists() else None


def parse(arguments):
    """The arguments, and the list of those that are passed on to every script."""
    parser = argparse.ArgumentParser(description="Run every figure and table script.")
    parser.add_argument("--only", metavar="IDS", help="numbers parted by commas: 3.7,5.9,T5.1")
    parser.add_argument("--out", default="figures", metavar="FOLDER")
    for name in ("--quick", "--resume", "--replot", "--verbose"):
        parser.add_argument(name, action="store_true")
    for name in ("--jobs", "--seed"):
        parser.add_argument(name, type=int)
    parser.add_argument("--scheduler", metavar="ADDRESS", help=parallel.SCHEDULER_HELP)
    given = parser.parse_args(arguments)
    passed_on = ["--out", given.out]
    for name in ("quick", "resume", "replot", "verbose", "jobs", "seed", "scheduler"):
        value = getattr(given, name)
        if value is not None and value is not False:
            passed_on += [f"--{name}"] if value is True else [f"--{name}", str(value)]
    return given, passed_on


def id_of(name):
    """T 5.1 for T5.1."""
    return name.replace("T", "T ")


def caption(script):
    """What a script's docstring says of the figure, and that of its `draw` of the panels."""
    tree = ast.parse(script.read_text(encoding="utf-8"))
    draws = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "draw"]
    about = (ast.get_docstring(tree) or "").split("\n\n")[0].partition(".py: ")[2]
    panels = (ast.get_docstring(draws[0]) or "").split("\n\n")[0] if draws else ""
    return " ".join(f"{about[:1].upper()}{about[1:]} {panels}".split())


def run(command):
    """Exit status of a command. After Ctrl-C the command has 10 s to clean up."""
    process = subprocess.Popen(command)
    try:
        return process.wait()
    except KeyboardInterrupt:
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.terminate()
            process.wait()
        return INTERRUPTED


def summarise(done):
    """Print a line for each script: its status, time, and number of claims that hold."""
    print("\nid     status       time/s  claims that hold")
    for name, status, untouched, seconds, stored in done:
        word, held = "interrupted" if status in INTERRUPTS else "failed", "–"
        if status == 0:
            word = "kept" if untouched else "done"
            claims = results.read_results(stored)["claims"]
            held = f"{sum(claim['holds'] is True for claim in claims)} of {len(claims)}"
        print(f"{name:<6} {word:<11}  {seconds:6.1f}  {held}")


if __name__ == "__main__":
    raise SystemExit(main())
