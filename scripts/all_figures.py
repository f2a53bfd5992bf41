"""python scripts/all_figures.py [--quick] [--only 3.7,5.9,T5.1] [--out figures] [--jobs J] …

Runs every scripts/figure_*.py and scripts/table_*.py in the order of their numbers, and prints a summary. If a script
fails, the others still run.

A file of data/reference is old if other code or inputs than the present ones made it. `--stale` lists the old files,
the reason for each, and its computing time. `--references` makes these files again, and then the tables of the
documentation. Files that take little time come first, and files with measured times come last. The machine should run
nothing else. Files that are not old are left as they are. So the command can be interrupted and started again. Exit
status: 0 if all succeeded, 1 if any failed, 2 for bad arguments, 130 after Ctrl-C.
"""

import argparse
import json
import signal
import subprocess
import sys
import time
from datetime import timedelta
from pathlib import Path

from deep_contact.figures import staleness
from deep_contact.figures.figure import INTERRUPTED, common_arguments
from deep_contact.figures.results import REFERENCE
from deep_contact.io.argument_parser import Parser
from deep_contact.io.scripts import choose, find, stem

INTERRUPTS = (INTERRUPTED, -signal.SIGINT)
"""Exit statuses of a script that Ctrl-C has ended. The second is that of a script that has not set its handler yet."""

HERE = Path(__file__).resolve().parent


def main(arguments=None, folder=HERE):
    """Run the command line on the scripts of a folder. Returns the exit status."""
    args, passed_on = parse(arguments)
    try:
        scripts = find(folder)
        chosen = scripts if args.only is None else choose(scripts, args.only.split(","))
    except ValueError as error:
        print(f"all_figures.py: {error}", file=sys.stderr)
        return 2
    stale = (
        {name: staleness.made(name)["wall_s"] for name in staleness.stale()} if args.stale or args.references else {}
    )
    if args.stale:
        lines = (f"{name}, {duration(took)}: {staleness.why_old(name)}\n" for name, took in stale.items())
        print(*lines, sep="", end="")
        return 0
    work = [(name, [path, *passed_on], Path(args.out) / f"{stem(path)}.json") for name, path in chosen.items()]
    if args.references:
        wanted = [stem(path) for path in chosen.values()] if args.only else staleness.STUDIES.keys() | stale.keys()
        names = [name for name in stale if name in wanted]
        work = [(name, [*staleness.commands()[name], *passed_on], REFERENCE / f"{name}.json") for name in names]
        work.append(("tables", [HERE.parent / "docs" / "tables.py"], None))
    done, status = [], 0
    for number, (name, command, stored) in enumerate(work, start=1):
        left = sum(stale[one] for one, *_ in work[number - 1 : -1]) if args.references else 0
        print(f"\n[{number}/{len(work)}] {command[0].name}{f', {duration(left)} left' * bool(left)}", flush=True)
        status, seconds = timed(command)
        done.append((name, status, seconds, stored))
        if status in INTERRUPTS:
            break
    summarise(done)
    return INTERRUPTED if status in INTERRUPTS else int(any(status for _, status, *_ in done))


def parse(arguments):
    """Parse the command line. Returns the parsed arguments, and the list of arguments to pass on to every script."""
    layout, common = argparse.RawDescriptionHelpFormatter, common_arguments("each script's own")
    parser = Parser(description=__doc__, formatter_class=layout, parents=[common])
    add = parser.add_argument
    add("--stale", action="store_true", help="list what of data/reference is old")
    add("--references", action="store_true", help="make what of data/reference is old")
    add("--only", metavar="IDS", help="numbers parted by commas: 3.7,5.9,T5.1")
    args = parser.parse_args(arguments)
    if args.references:
        args.out = str(REFERENCE)
    flags = [f"--{name}" for name in ("quick", "replot") if getattr(args, name)]
    values = [(f"--{name}", getattr(args, name)) for name in ("out", "jobs", "seed")]
    return args, flags + [str(word) for name, value in values if value is not None for word in (name, value)]


def duration(seconds):
    """Return a time as a text, such as "2:40:00". seconds: the time, s."""
    return str(timedelta(seconds=round(seconds)))


def timed(command):
    """Run a script. Returns its exit status and its time, s. command: path of the script, then its arguments."""
    start = time.perf_counter()
    with subprocess.Popen([sys.executable, *map(str, command)]) as process:
        try:
            status = process.wait()
        except KeyboardInterrupt:
            status = INTERRUPTED  # the script got Ctrl-C as well; leaving the block waits until it has cleaned up
    return status, time.perf_counter() - start


def summarise(done):
    """Print a line for each script: its status, its time, and the number of its claims that hold.

    done: (name, exit status, time, s, path of the results file or None) of each script.
    """
    print("\nid     status       time/s  claims that hold")
    for name, status, seconds, stored in done:
        word, held = "interrupted" if status in INTERRUPTS else "failed" if status else "done", "–"
        if status == 0 and stored is not None:
            claims = json.loads(stored.read_text(encoding="utf-8")).get("claims", [])
            held = f"{sum(claim['holds'] is True for claim in claims)} of {len(claims)}"
        print(f"{name:<6} {word:<11}  {seconds:6.1f}  {held}")


if __name__ == "__main__":
    raise SystemExit(main())
