"""The contract of the figure and table scripts: command line, simulation, results file, picture.

A script describes itself by a `Figure`, and runs where it is the program that was started:

    FIGURE = Figure("3.7", "Title", compute, table, draw, claims, options={"steps": 600}, quick={"steps": 60})
    figures.run_as_script(FIGURE, __name__)

`compute` makes the numbers. `claims`, `table` and `draw` see only what is stored of them, so that a picture drawn again
from its file is the same picture. Settings are changed by `--set NAME=VALUE`: a name may have spaces, and a value has
the type of the default, which may be a list, a dict or None.
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
from deep_contact.parallel import cores, parallel_map, progress_bar, seeds  # noqa: F401 (scripts of users take them from here)
from deep_contact.plot import plotting
from deep_contact.state.validation import brief, one_of

MEANINGS = json.loads((Path(__file__).parent / "settings.json").read_text(encoding="utf-8"))
"""Name of a setting -> its meaning and unit; "4.2 kernel" is the meaning in Figure 4.2 alone."""

INTERRUPTED = 130
"""Exit status after Ctrl-C: 128 and the number of the signal, as shells have it."""


@dataclass(frozen=True)
class Figure:
    """A figure or a table, of the thesis or of ours.

    id: "3.7" for a figure, "T 5.1" for a table. title: one line. options: the settings of a full run, name -> value
    (numbers, text, None, or lists and dicts of these). quick: the options that `--quick` changes. seed: default of
    `--seed`. digits: significant digits kept of float arrays in the data, None for all. file: name of its files without
    suffix, if the id does not give it.

    compute(options, seed, jobs, progress) -> data: dict of what `json_data.plain` can store. `jobs` goes to
    `parallel_map`, `progress` has the signature of `progress_bar`.
    table(data) -> rows to print, head first; a figure may have none. claims(data) -> `Claim`s. Both see stored data.
    draw(data, options) -> matplotlib figure. A table without `draw` gets a picture of its rows.

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
        """Name of its files without suffix: figure_3_7, table_5_1."""
        return self.file or re.sub(r"[ .]", "_", results.name_of(self.id).lower())

    @property
    def heading(self) -> str:
        """Kind, number and title, "Figure 3.7: …"."""
        return f"{results.name_of(self.id)}: {self.title}"

    def beside(self, options: dict) -> dict | None:
        """The reference results that a quick run is judged by (`results.verdict`); None for any other run."""
        return (results.reference(self.stem) or {"claims": []}) if "quick" in self.changed(options) else None

    def changed(self, options: dict) -> list[str]:
        """The settings of a run that are not the figure's own: "quick" for those of the quick run, others as
        NAME=VALUE."""
        own, quick = (results.plain(of, where="options") for of in (self.options, self.quick))
        small = {name: value for name, value in quick.items() if options[name] == value != own[name]}
        others = [name for name, value in options.items() if value != own[name] and name not in small]
        return [*(["quick"] if small else []), *(f"{name}={brief(options[name])}" for name in others)]

    def settings(self, changes: dict, quick: bool) -> dict:
        """All options of a run, as its results file stores them. Raises ValueError for changes of unknown ones."""
        for name in changes:
            one_of("options", name, self.options)
        return results.plain(self.options | (self.quick if quick else {}) | changes, where="options")

    def rows(self, data: dict) -> list[list[str]]:
        """The table of the data as text, head first."""
        return [[cell(value) for value in row] for row in self.table(data)]


def run_as_script(figure: Figure, module: str) -> None:
    """The end of a script, `module` being its `__name__`: exit with `main`'s status unless it was imported."""
    if module == "__main__":
        raise SystemExit(main(figure))


def main(figure: Figure, arguments: Sequence[str] | None = None) -> int:
    """Run a script's command line. Returns the exit status.

    0: the files are written. 1: a file that has to exist first is missing, such as a trained network; the message is
    printed. 2: bad arguments, or a ValueError of the figure's own functions under `--set`. 130: interrupted by Ctrl-C,
    143: by SIGTERM, both without a traceback and without half-written files. Any other error of the figure's own
    functions is raised.
    """
    parser = _parser(figure)
    args = parser.parse_args(arguments)
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")  # a terminal that cannot show θ must not stop a run
    if args.jobs < 1 or (args.seed or 0) < 0:
        parser.error(f"expected --jobs of at least 1 and no negative --seed, got {args.jobs} and {args.seed}")
    if args.replot and (args.set or args.quick or args.seed is not None):
        parser.error("--replot draws what is stored: expected no --set, --quick, --seed beside it")
    try:
        Path(args.out).mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=args.out).close()  # a folder without write permission is refused before the work
    except OSError as error:
        parser.error(f"--out: expected a folder that can be written, got {args.out!r} ({error.strerror})")
    changes, path = dict(args.set), Path(args.out, f"{figure.stem}.json")
    # An exit, so that temporary files and child processes are cleaned up.
    if threading.current_thread() is threading.main_thread():  # no other may set handlers
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
    """Compute, store, draw and report a figure. Returns the stored results.

    options: changes to the figure's own, by name. quick: start from the options of its quick run. out: folder of the
    files. jobs: number of processes, or an executor (`parallel.finished`); the numbers do not depend on it. The results
    are stored before they are drawn, so that an error in `draw` does not cost a long computation. Raises ValueError for
    an unknown option.
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
    """The stored results, judged and drawn again. Raises ResultsError where the file has none of this figure."""
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
    """Print the numbers as a table, one line a claim, and the picture's path.

    The claims for which a quick run is too small, and which the reference run has judged, share one line.
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
        print(f"claims that need more states than a quick run has: {left} (docs/thesis.md has the verdicts)")
    print(f"picture: {path.with_suffix('.png')}")


def claim_line(claim: dict, beside: dict | None = None, *, measured: bool = True) -> str:
    """A stored claim as one line: its verdict (`results.verdict`), its text, and the numbers if `measured`."""
    source = f" ({claim['thesis']})" if claim["thesis"] else ""
    numbers = "; ".join(f"{name} = {cell(value)}" for name, value in claim["measured"].items())
    return f"{results.verdict(claim, beside)}: {claim['text']}{source}" + (f": {numbers}" if measured else "")


def cell(value) -> str:
    """A value as tables and claims show it: floats with four significant digits, None as a dash."""
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


def _parser(figure: Figure) -> argparse.ArgumentParser:
    known = "\n".join(_described(figure.id, name, value) for name, value in figure.options.items())
    parser = argparse.ArgumentParser(
        description=f"{figure.heading}.",
        epilog=f"settings and their values without --quick:\n{known}" if known else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        parents=[common_arguments(figure.seed)],
    )
    look = {"metavar": "NAME=VALUE", "help": "change a setting; repeatable"}
    parser.add_argument("--set", action="append", type=partial(assigned, figure.options), default=[], **look)
    return parser


def common_arguments(seed: int | str) -> argparse.ArgumentParser:
    """The options of every script, for `parents` of its parser. seed: the default that the help names."""
    parser = argparse.ArgumentParser(add_help=False)
    add = parser.add_argument
    add("--quick", action="store_true", help="smaller runs, each within a minute")
    add("--replot", action="store_true", help="judge and draw again from the stored results alone")
    add("--out", default="figures", metavar="FOLDER", help="where the files go (default: figures)")
    add("--jobs", type=int, default=cores(), help="processes (default: one for each core)")
    add("--seed", type=int, help=f"of everything random (default: {seed})")
    return parser


def meaning(id: str, name: str) -> str:
    """What a setting of the figure with this id means, with its unit; empty where none is known."""
    return MEANINGS.get(f"{id} {name}", MEANINGS.get(name, ""))


def _described(id: str, name: str, value) -> str:
    """A line of the settings in `--help`; a long value is cut."""
    text = f"{name}={value if isinstance(value, str) else json.dumps(value)}"
    return f"  {text if len(text) <= 60 else f'{text[:59]}…':<32}  {meaning(id, name)}"


def assigned(options: dict, text: str) -> tuple[str, object]:
    """(name, value) from "name=value", with the type of the default: JSON, text, or "0.1,0.2" for a list.

    Raises argparse.ArgumentTypeError naming the option, what was expected and what came.
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
    """A text as a value of the default's type; a whole number is at least 1 if its default is. Raises ValueError."""
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
