"""The common part of the figure and table scripts: command line, simulation, results file and picture.

A script defines a `Figure`. The second line runs it if the script is the program that was started:

    FIGURE = Figure("3.7", "Title", compute, table, draw, claims, options={"steps": 600}, quick={"steps": 60})
    figures.run_as_script(FIGURE, __name__)

`compute` computes the data. `claims`, `table` and `draw` get the data as they are stored in the results file. So a
picture that is drawn again from this file is the same. `--set NAME=VALUE` changes a setting. A name may contain spaces.
A value has to have the type of the default, which may be a list, a dict or None.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from deep_contact.figures import results, staleness
from deep_contact.figures.results import Claim
from deep_contact.io import provenance
from deep_contact.io.argument_parser import Parser
from deep_contact.parallel import cores, parallel_map, progress_bar, seeds  # noqa: F401 (scripts of users take them from here)
from deep_contact.plot import plotting
from deep_contact.state.validation import brief, one_of

MEANINGS = json.loads((Path(__file__).parent / "settings.json").read_text(encoding="utf-8"))
"""Name of a setting -> its meaning and unit. A key such as "4.2 kernel" has the meaning of "kernel" in Figure 4.2."""

INTERRUPTED = 130
"""Exit status after Ctrl-C: 128 plus the number of the signal SIGINT, the convention of shells."""


@dataclass(frozen=True)
class Figure:
    """A figure or a table, from the thesis or added by us.

    id: "3.7" for a figure, "T 5.1" for a table. title: one line. options: the settings of a full run, name -> value
    (numbers, text, None, or lists and dicts of these). quick: the options that `--quick` changes, name -> value.
    seed: default of `--seed`. digits: number of significant digits with which float arrays in the data are stored; None
    stores all. file: name of the figure's files without suffix; by default it is made from the id.

    compute: function (options, seed, jobs, progress) -> data, a dict that `json_data.plain` can store. `jobs` is an
    argument for `parallel_map`, and `progress` has the signature of `progress_bar`.
    table: function (data) -> rows to print, the heading first, or None. claims: function (data) -> `Claim`s. Both get
    the stored data.
    draw: function (data, options) -> matplotlib figure. If it is None, the picture shows the rows of the table.

    Raises ValueError naming the field.
    """

    id: str
    title: str
    compute: Callable[[dict, int, int, Callable], dict]
    table: Callable[[dict], Sequence[Sequence]] | None = None
    draw: Callable[[dict, dict], object] | None = None
    claims: Callable[[dict], Iterable[Claim]] = lambda data: ()
    _: KW_ONLY
    options: dict = field(default_factory=dict)
    quick: dict = field(default_factory=dict)
    seed: int = 0
    digits: int | None = 6
    file: str = ""

    def __post_init__(self):
        results.plain(self.options, where="options")
        for name in self.quick:
            one_of("quick", name, self.options)

    @property
    def stem(self) -> str:
        """The name of the figure's files without suffix, such as figure_3_7 or table_5_1."""
        return self.file or re.sub(r"[ .]", "_", results.name_of(self.id).lower())

    @property
    def heading(self) -> str:
        """The figure's kind, number and title, "Figure 3.7: …"."""
        return f"{results.name_of(self.id)}: {self.title}"

    def beside(self, options: dict) -> dict | None:
        """Return the results of the reference run, with which `results.verdict` compares a quick run.

        options: settings of the run. Returns None if it is not a quick run.
        """
        return (results.reference(self.stem) or {"claims": []}) if "quick" in self.changed(options) else None

    def changed(self, options: dict) -> list[str]:
        """Return the settings of a run that differ from the figure's defaults, as texts.

        "quick" stands for all settings that `--quick` changed. Any other setting is NAME=VALUE.
        """
        own, quick = (results.plain(of, where="options") for of in (self.options, self.quick))
        small = {name: value for name, value in quick.items() if options[name] == value != own[name]}
        others = [name for name, value in options.items() if value != own[name] and name not in small]
        return [*(["quick"] if small else []), *(f"{name}={brief(options[name])}" for name in others)]

    def settings(self, changes: dict, quick: bool) -> dict:
        """Return all options of a run in the form in which its results file stores them.

        changes: name of an option -> its value. quick: whether the other options are those of the quick run.
        Raises ValueError if a name in `changes` is unknown.
        """
        for name in changes:
            one_of("options", name, self.options)
        return results.plain(self.options | (self.quick if quick else {}) | changes, where="options")

    def rows(self, data: dict) -> list[list[str]]:
        """Return the rows of the figure's table as texts, the heading first."""
        return [[cell(value) for value in row] for row in self.table(data)]


def run_as_script(figure: Figure, module: str) -> None:
    """Run a figure's command line and exit with the status of `main`, unless the script was imported.

    module: the `__name__` of the script, which calls this function in its last line.
    """
    if module == "__main__":
        raise SystemExit(main(figure))


def main(figure: Figure, arguments: Sequence[str] | None = None) -> int:
    """Run the command line of a figure's script. Returns the exit status.

    figure: the figure. arguments: arguments of the command line; None takes those of the process. The status is:

    * 0: the files have been written.
    * 1: a file that the figure needs is missing, such as a trained network. The message is printed.
    * 2: an argument is wrong, or the figure's functions raised a ValueError and `--set` was used.
    * 130: Ctrl-C interrupted the run. 143: SIGTERM did. Neither prints a traceback or leaves half-written files.

    Any other error of the figure's functions is raised.
    """
    parser = _parser(figure)
    args = parser.parse_args(arguments)
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")  # so that a terminal that cannot show θ raises no error
    if args.jobs < 1 or (args.seed or 0) < 0:
        parser.error(f"expected --jobs of at least 1 and no negative --seed, got {args.jobs} and {args.seed}")
    if args.replot and (args.set or args.quick or args.seed is not None):
        parser.error("--replot draws what is stored: expected no --set, --quick, --seed beside it")
    try:
        Path(args.out).mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=args.out).close()  # fails before the computation if the folder cannot be written
    except OSError as error:
        parser.error(f"--out: expected a folder that can be written, got {args.out!r} ({error.strerror})")
    changes, path = dict(args.set), Path(args.out, f"{figure.stem}.json")
    # SIGTERM raises SystemExit, so that temporary files and child processes are cleaned up.
    if threading.current_thread() is threading.main_thread():  # other threads may not set signal handlers
        signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        if args.replot:
            _report(figure, _redrawn(figure, path), path)
        else:
            produce(figure, options=changes, quick=args.quick, seed=args.seed, out=args.out, jobs=args.jobs)
        return 0
    except KeyboardInterrupt:
        print(f"{figure.stem}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except FileNotFoundError as error:
        print(f"{figure.stem}: {error}", file=sys.stderr)
        return 1
    except ValueError as error:
        if args.replot and isinstance(error, results.ResultsError):
            parser.error(f"--replot: {error}")
        if not changes:
            raise
        parser.error(f"--set: {error}")


def produce(
    figure: Figure,
    *,
    options: dict | None = None,
    quick: bool = False,
    seed: int | None = None,
    out: str | os.PathLike = "figures",
    jobs: int | Executor = 1,
) -> dict:
    """Compute the data of a figure, store them, draw the picture and print a report. Returns the stored results.

    The results are stored before the picture is drawn. So an error in `draw` does not lose a long computation.
    figure: the figure. options: options that differ from the figure's, name -> value. quick: whether the other options
    are those of the quick run. seed: seed of the random numbers; None: the figure's. out: folder of the files.
    jobs: number of processes, or an executor (`parallel.finished`); the results do not depend on it. Raises ValueError
    for an unknown option.
    """
    options = figure.settings(options or {}, quick)
    seed, path = figure.seed if seed is None else seed, Path(out, f"{figure.stem}.json")
    start = time.perf_counter()
    data = results.plain(figure.compute(dict(options), seed, jobs, progress_bar), digits=figure.digits)
    took = time.perf_counter() - start
    made = staleness.made_by() | provenance.provenance(seed=seed, wall_s=took, options=options)
    stored = {"id": figure.id, "title": figure.title, "options": options, "provenance": made}
    stored |= {"claims": list(figure.claims(data)), "data": data}
    stored = results.read_results(results.write_results(path, stored))
    _draw(figure, stored, path)
    _report(figure, stored, path)
    return stored


def _draw(figure: Figure, stored: dict, path: Path) -> None:
    with plotting.style():
        if figure.draw is None:
            picture = plotting.draw_table(figure.rows(stored["data"]), figure.heading)
        else:
            picture = figure.draw(stored["data"], stored["options"])
        if changed := ", ".join(figure.changed(stored["options"])):
            picture.text(1.0, 0.0, changed, ha="right", va="bottom", color=plotting.GREY, in_layout=False)
        plotting.save(picture, path.with_suffix(".png"))


def _redrawn(figure: Figure, path: Path) -> dict:
    """Draw the picture again from the stored results, with the claims judged again. Returns the results.

    path: path of the results file. The file is written again if a claim or the title has changed. Raises ResultsError
    if there is no file, or if it has the results of another figure.
    """
    if not path.exists():
        raise results.ResultsError(f"{path}: expected the results of a run, got no file")
    stored = results.read_results(path)
    if stored["id"] != figure.id:
        raise results.ResultsError(f"{path.name}: expected id {figure.id!r}, got {stored['id']!r}")
    judged = stored | results.plain({"title": figure.title, "claims": list(figure.claims(stored["data"]))})
    if judged != stored:
        results.write_results(path, judged)
    _draw(figure, judged, path)
    return judged


def _report(figure: Figure, stored: dict, path: Path) -> None:
    """Print the table, a line for each claim, and the picture's path.

    In a quick run, one line counts the claims that disagree with the reference run, because the quick run has too few
    states for them.
    """
    beside = figure.beside(stored["options"])
    print(figure.heading)
    rows = figure.rows(stored["data"]) if figure.table else []
    widths = [max(map(len, column)) for column in zip(*rows)]
    for row in rows:
        print(f"  {'  '.join(map(str.ljust, row, widths))}".rstrip())
    judged = stored["claims"]
    if beside is not None:
        judged = [claim for claim in judged if not results.verdict(claim, beside).startswith(f"{results.OPEN} (")]
    for claim in judged:
        print(claim_line(claim, beside, measured=beside is None))
    if left := len(stored["claims"]) - len(judged):
        print(f"claims that need more states than a quick run has: {left} (docs/appendix.md has the verdicts)")
    print(f"picture: {path.with_suffix('.png')}")


def claim_line(claim: dict, beside: dict | None = None, *, measured: bool = True) -> str:
    """Return a stored claim as one line: its verdict, its text, and its numbers if `measured` is true.

    beside: results of the reference run, as for `results.verdict`, or None.
    """
    source = f" ({claim['thesis']})" if claim["thesis"] else ""
    numbers = "; ".join(f"{name} = {cell(value)}" for name, value in claim["measured"].items())
    return f"{results.verdict(claim, beside)}: {claim['text']}{source}" + (f": {numbers}" if measured else "")


def cell(value) -> str:
    """Return the text of a value for tables and claims. Floats have four significant digits, and None is a dash."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool):
        return {None: "–", True: "yes", False: "no"}[value]
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(cell(item) for item in value) + "]"
    if isinstance(value, dict):
        shown = {name: f"({cell(item)})" if isinstance(item, dict) else cell(item) for name, item in value.items()}
        return ", ".join(f"{name} {text}" for name, text in shown.items())
    return str(value)


def _parser(figure: Figure) -> Parser:
    known = "\n".join(_described(figure.id, name, value) for name, value in figure.options.items())
    parser = Parser(
        description=f"{figure.heading}.",
        epilog=f"settings and their values without --quick:\n{known}" if known else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        parents=[common_arguments(figure.seed)],
    )
    look = {"metavar": "NAME=VALUE", "help": "change a setting; repeatable"}
    parser.add_argument("--set", action="append", type=partial(assigned, figure.options), default=[], **look)
    return parser


def common_arguments(seed: int | str) -> Parser:
    """Return a parser with the options that all scripts have, to be passed as a parent of a script's parser.

    seed: the default of `--seed` that the help text names.
    """
    parser = Parser(add_help=False)
    add = parser.add_argument
    add("--quick", action="store_true", help="smaller runs, each within a minute")
    add("--replot", action="store_true", help="judge and draw again from the stored results alone")
    add("--out", default="figures", metavar="FOLDER", help="where the files go (default: figures)")
    add("--jobs", type=int, default=cores(), help="processes (default: one for each core)")
    add("--seed", type=int, help=f"of everything random (default: {seed})")
    return parser


def meaning(id: str, name: str) -> str:
    """Return the meaning and the unit of a setting, or "" if they are unknown.

    id: id of the figure. name: name of the setting.
    """
    return MEANINGS.get(f"{id} {name}", MEANINGS.get(name, ""))


def _described(id: str, name: str, value) -> str:
    """Return the line of `--help` for a setting of the figure `id`. A long value is truncated."""
    text = f"{name}={value if isinstance(value, str) else json.dumps(value)}"
    return f"  {text if len(text) <= 60 else f'{text[:59]}…':<32}  {meaning(id, name)}"


def assigned(options: dict, text: str) -> tuple[str, object]:
    """Parse "name=value". Returns (name, value), where the value has the type of the option's default.

    options: the figure's options, name -> default. text: the value in it is JSON or plain text; a list may be
    "0.1,0.2". Raises argparse.ArgumentTypeError naming the option, the expected value and the text.
    """
    name, sign, text = map(str.strip, text.partition("="))
    if not sign or name not in options:
        known = ", ".join(options) or "(none)"
        raise argparse.ArgumentTypeError(f"expected NAME=VALUE with one of {known}, got {name + sign + text!r}")
    try:
        return name, _value(text, options[name])
    except ValueError:
        raise argparse.ArgumentTypeError(f"{name}: expected a value like {options[name]!r}, got {text!r}") from None


def _value(text: str, default):
    """Return the value that a text stands for, with the type of the default.

    Raises ValueError if the text has another type, or is an integer below 1 while the default is at least 1.
    """
    if isinstance(default, str):
        return text
    if isinstance(default, list):
        parts = map(json.dumps, json.loads(text)) if text.startswith("[") else map(str.strip, text.split(","))
        return [_value(part, default[0] if default else None) for part in parts]
    try:
        value = json.loads(text)
    except json.JSONDecodeError:
        if default is None:
            return text
        raise
    if type(default) is float and type(value) is int:
        value = float(value)
    results.plain(value)
    wrong = default is not None and type(value) is not type(default)
    if wrong or (type(default) is int and value < 1 <= default):
        raise ValueError
    return value
