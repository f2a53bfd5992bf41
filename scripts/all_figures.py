"""python scripts/all_figures.py [--quick] [--only 3.7,5.9,T5.1] [--out figures] [--jobs J] [--scheduler A] [--seed S]

Runs every scripts/figure_*.py and scripts/table_*.py, in the order of their numbers. One that fails does not
stop the others; a summary comes last, and all results of the folder become one page, <out>/index.html, that can
be opened anywhere. `--resume` leaves out those whose stored results have the same settings
and commit, `--replot` draws all again from what is stored. Exit status 0 if all went well, 1 if any failed,
2 for bad arguments, 130 after Ctrl-C.
"""

import argparse
import re
import subprocess
import sys
import time
from pathlib import Path

from deep_contact import parallel
from deep_contact.reporting import page, results
from deep_contact.reporting.figures import INTERRUPTED

HERE = Path(__file__).resolve().parent
SCRIPT = re.compile(r"(figure|table)_([0-9]+)_([0-9]+)(_\w+)?\.py")


def main(arguments=None, folder=HERE):
    """Run the scripts of a folder; the exit status."""
    given, passed_on = parse(arguments)
    try:
        scripts = find(folder)
        chosen = choose(scripts, given.only)
    except ValueError as error:
        print(f"all_figures.py: {error}", file=sys.stderr)
        return 2
    done = []
    for number, (name, script) in enumerate(chosen.items(), start=1):
        print(f"\n[{number}/{len(chosen)}] {script.name}", flush=True)
        stored = Path(given.out) / f"{stem(script)}.json"
        before = stored.stat().st_mtime_ns if stored.exists() else None
        start = time.perf_counter()
        status = run([sys.executable, str(script), *passed_on])
        seconds = time.perf_counter() - start
        after = stored.stat().st_mtime_ns if stored.exists() else None
        done.append((name, status, after == before, seconds, stored))
        if status in (INTERRUPTED, -2):
            break
    if Path(given.out).is_dir():
        index = page.write_report(given.out, expected=[name.replace("T", "T ") for name in scripts])
        print(f"\nall results as one page: {index}")
    summarise(done)
    if any(status in (INTERRUPTED, -2) for _, status, *_ in done):
        return INTERRUPTED
    return int(any(status != 0 for _, status, *_ in done))


def parse(arguments):
    """Our own arguments, and the list of those that every script gets."""
    parser = argparse.ArgumentParser(description="Run every figure and table script.")
    parser.add_argument("--only", metavar="IDS", help="numbers parted by commas: 3.7,5.9,T5.1")
    parser.add_argument("--out", default="figures", metavar="FOLDER")
    for name in ("--quick", "--resume", "--replot"):
        parser.add_argument(name, action="store_true")
    for name in ("--jobs", "--seed"):
        parser.add_argument(name, type=int)
    parser.add_argument("--scheduler", metavar="ADDRESS", help=parallel.SCHEDULER_HELP)
    given = parser.parse_args(arguments)
    passed_on = ["--out", given.out]
    passed_on += [f"--{name}" for name in ("quick", "resume", "replot") if getattr(given, name)]
    for name in ("jobs", "seed", "scheduler"):
        if getattr(given, name) is not None:
            passed_on += [f"--{name}", str(getattr(given, name))]
    return given, passed_on


def find(folder):
    """Id -> script, in the order in which they run: by chapter and number, figures before tables.

    Raises ValueError for two scripts of one id, since they would write the same files.
    """
    found = []
    for path in folder.glob("*_*.py"):
        match = SCRIPT.fullmatch(path.name)
        if match:
            kind, chapter, number, _ = match.groups()
            name = f"{'T' if kind == 'table' else ''}{chapter}.{number}"
            found.append(((int(chapter), int(number), kind, path.name), name, path))
    scripts = {}
    for _, name, path in sorted(found):
        if name in scripts:
            raise ValueError(f"expected one script for {name}, got {scripts[name].name} and {path.name}")
        scripts[name] = path
    return scripts


def choose(scripts, only):
    """The scripts named in `only` ("3.7,T5.1"; None is all). Raises ValueError naming the known ones."""
    if only is None:
        return scripts
    wanted = [name.replace(" ", "").upper() for name in only.split(",") if name.strip()]
    for name in wanted:
        if name not in scripts:
            raise ValueError(f"--only: expected some of {', '.join(scripts)}, got {name!r}")
    return {name: path for name, path in scripts.items() if name in wanted}


def stem(script):
    """figure_3_7 for scripts/figure_3_7_baselines.py."""
    kind, chapter, number, _ = SCRIPT.fullmatch(script.name).groups()
    return f"{kind}_{chapter}_{number}"


def run(command):
    """Exit status of a command; after Ctrl-C it has a moment to clean up."""
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
    """Print a line for each script: what became of it, its time, and how many of its claims hold."""
    print("\nid     status   time/s  claims that hold")
    for name, status, untouched, seconds, stored in done:
        word, held = "failed", "–"
        if status == 0:
            word = "kept" if untouched else "done"
            claims = results.read_results(stored)["claims"]
            held = f"{sum(claim['holds'] for claim in claims)} of {len(claims)}"
        print(f"{name:<6} {word:<8} {seconds:6.1f}  {held}")


if __name__ == "__main__":
    raise SystemExit(main())
