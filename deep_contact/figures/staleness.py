"""A test whether results files in data/reference are old: made by other code, input or processor than the present one.

Code is compared by statements. A statement is a function, class or constant at the top level of a module, without
comments, docstrings, imports and names of modules. So moving a statement to another module changes nothing. A results
file stores digests of the statements of its script, and of all modules that the script imports, directly or not. It is
old if one of these statements is in no file any more, or if its script has a new statement. Statements that only judge
or draw stored numbers do not count.

The golden runs are simulations whose results are stored bit by bit (tests/tools/golden.py). For the modules that they
import, the statements are not compared one by one. Instead, a results file is old if the golden runs give other bits.
If the file holds measured times, it is old after any change of such a module.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections import Counter
from functools import cache
from pathlib import Path

from deep_contact import lazy
from deep_contact.figures import results
from deep_contact.io import provenance, scripts, shipped

ROOT = shipped.ROOT

STUDIES = {
    "run_tradeoff": ["run_tradeoff.py"],
    "run_tradeoff_verify": ["run_tradeoff_verify.py"],
    "benchmark_engine": ["benchmark.py", "engine"],
    "benchmark_live": ["benchmark.py", "live"],
}
"""Results file in data/reference -> [script that writes it, arguments of the script].

Files of figures and tables are not listed here.
"""

TIMES = frozenset([*STUDIES, *(f"figure_{number}" for number in ("5_2", "5_10", "6_6", "6_7", "6_16"))])
"""Names of the results files that hold measured times."""

WRITTEN = {"run_tradeoff.py": {"runs.json"}}
"""Script -> data files that it writes from its results. They are not what its results were made from."""

DRAWING = {"reporting", "figures", "plot"}
"""Folders of the package whose code only stores, judges and draws numbers. Their statements do not count."""

JUDGING = {"claims", "draw", "table"}
"""Names of the functions of a script that get stored numbers. They do not count, unless another function calls them."""


# ---- code ----


class _Code(ast.NodeTransformer):
    """A transformer that removes imports, names of the package's modules, docstrings and code for type checkers.

    It collects two sets of pairs (module, name). `imported` has the names that a file imports from the package, and
    `used` the names that the file reads as attributes of imported modules. The dict `modules` has the module for each
    name by which the file calls it.
    """

    def __init__(self):
        self.imported, self.used, self.modules = set(), set(), {}

    def visit_ImportFrom(self, node):
        if (node.module or "").partition(".")[0] == "deep_contact":
            self.imported |= {(node.module, one.name) for one in node.names}
            self.modules |= {one.asname or one.name: f"{node.module}.{one.name}" for one in node.names}

    def visit_Import(self, node):
        self.modules |= {one.asname: one.name for one in node.names if one.name == "deep_contact"}

    def visit_Attribute(self, node):
        if not (isinstance(node.value, ast.Name) and node.value.id in self.modules):
            return self.generic_visit(node)
        self.used.add((self.modules[node.value.id], node.attr))
        return ast.Name(node.attr)

    def visit_Expr(self, node):
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_If(self, node):
        return None if ast.unparse(node.test) == "TYPE_CHECKING" else self.generic_visit(node)


def _place(module: str) -> Path:
    return ROOT / f"{module.replace('.', '/')}.py"


def _home(module: str, name: str) -> tuple[str, str]:
    """Return (module, name) of the definition of a name that may be imported from a package.

    Packages of this project import a name from the defining module when the name is used (`lazy`). This function finds
    the defining module. For other modules it returns its arguments.
    """
    package = _place(f"{module}.__init__")
    if not package.is_file() and "." in module and not _place(module).is_file():
        module = ".".join(_home(*module.rpartition(".")[::2]))
    return lazy.homes(str(package)).get(name, (module, name)) if package.is_file() else (module, name)


def _sha(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()[:16]


@cache
def read(file: Path) -> tuple[dict[str, str], set[Path]]:
    """Return the statements of a file, and the set of the files that it imports or names.

    The statements are a dict: digest of 16 hexadecimal digits -> name, such as "starts.paired". A data file counts as
    one statement. The functions `JUDGING` of a script are left out. Raises ValueError if the file imports a module of
    the package that does not exist.
    """
    text = file.read_text(encoding="utf-8")
    if file.suffix != ".py":
        return {_sha(text): file.name}, set()
    code = _Code()
    body = code.visit(ast.parse(text)).body
    named = {one.id for node in body if hasattr(node, "args") for one in ast.walk(node) if isinstance(one, ast.Name)}
    left_out = JUDGING - named if ROOT / "deep_contact" not in file.parents else ()
    names = [getattr(node, "name", None) or ast.unparse(getattr(node, "targets", [node])[0])[:30] for node in body]
    made = {_sha(ast.unparse(node)): f"{file.stem}.{name}" for node, name in zip(body, names) if name not in left_out}
    return made, _files(file, code, body)


def _files(file: Path, code: _Code, body: list[ast.stmt]) -> set[Path]:
    """Return the files of the modules that a file imports, and of the data files that its texts name.

    code: the transformer that has visited the file. body: statements of the file. Files in folders of `DRAWING` are
    left out.
    """
    texts = [one.value for node in body for one in ast.walk(node) if isinstance(one, ast.Constant)]
    names = [text for text in texts if isinstance(text, str) and text.endswith(".json") and "/" not in text]
    files = {folder / name for name in names for folder in (file.parent, ROOT / "models")}
    for pair in code.imported | code.used:
        home, whole = _home(*pair)[0], ".".join(_home(*pair))
        places = {_place(one) for one in (home, f"{home}.__init__", whole, f"{whole}.__init__")}
        if pair in code.imported and not any(place.is_file() for place in places):
            raise ValueError(f"{file.name}: expected a module for {'.'.join(pair)}")
        files |= {*places, _place(f"{pair[0]}.__init__")}
    return {one for one in files if one.is_file() and not DRAWING & {*one.parts[len(ROOT.parts) :]}}


@cache
def reached(file: Path) -> set[Path]:
    """Return a file and all files that it imports or names, directly or not."""
    found, waiting = set(), {file}
    while waiting:
        found.add(one := waiting.pop())
        waiting |= read(one)[1] - found
    return found


def _statements(files) -> dict[str, str]:
    return {digest: name for file in sorted(files) for digest, name in read(file)[0].items()}


@cache
def everywhere() -> dict[str, str]:
    """Return all statements of the package, of the scripts and of their data files: digest -> name."""
    folders = ROOT / "deep_contact", ROOT / "scripts", ROOT / "models"
    return _statements(one for folder in folders for kind in ("*.py", "*.json") for one in folder.rglob(kind))


@cache
def made_by(script: Path | None = None) -> dict:
    """Return digests of the code that computes the results of a script. `reason` compares them with stored digests.

    script: path of the script; by default the script that runs now. The result is {} if no script runs, or if the
    package is not in a checkout. Otherwise its entries are

    * "code": the digest of each statement in the modules that the golden runs do not import;
    * "held": one digest of all statements in the modules that the golden runs import;
    * "golden": the digest of the bits of the golden runs, if there is a record of them.
    """
    script = script or Path(getattr(sys.modules["__main__"], "__file__", None) or "none").resolve()
    is_checkout = (ROOT / "deep_contact").is_dir()
    if script.suffix != ".py" or not script.is_file() or "site-packages" in script.parts or not is_checkout:
        return {}
    runs = ROOT / "tests" / "tools" / "golden.py"
    held = {one for one in reached(runs) if one.suffix == ".py"} if runs.is_file() else set()
    digits = _sha(" ".join(sorted(_statements(reached(script) & held))))
    return {"code": _statements(reached(script) - held), "held": digits} | dict(zip(["golden"], golden()))


@cache
def golden() -> tuple[str, ...]:
    """Return digests of the golden runs (tests/tools/golden.py), or () if there is no record of them.

    The first is the present digest. The others are digests of earlier records whose runs have the same bits in the
    present record.
    """
    file = ROOT / "data" / "reference" / "golden.json"
    if not file.is_file():
        return ()
    record = json.loads(file.read_text(encoding="utf-8"))
    return digest_of_runs(record["runs"]), *record.get("extends", ())


def digest_of_runs(runs: dict) -> str:
    """Return a digest of the bits of all golden runs, 16 hexadecimal digits. runs: name -> entry with "sha256"."""
    return _sha(json.dumps({name: runs[name]["sha256"] for name in sorted(runs)}))


# ---- what is old ----


@cache
def commands() -> dict[str, list]:
    """Return the commands that make results files anew: name of the file in data/reference -> [script, arguments].

    Only these files are watched. All other files there, such as fuzz.json, mutants.json and soak.json, name the commit
    at which they were made, and may be older than the code.
    """
    folder = ROOT / "scripts"
    found = {name: [folder / script, *options] for name, (script, *options) in STUDIES.items()}
    found |= {scripts.stem(path): [path] for path in scripts.find(folder).values()}
    return {name: command for name, command in found.items() if (results.REFERENCE / f"{name}.json").is_file()}


@cache
def made(name: str) -> dict:
    """Return the provenance that a results file in data/reference stores. name: name of the file, without suffix."""
    return json.loads((results.REFERENCE / f"{name}.json").read_text(encoding="utf-8"))["provenance"]


@cache
def processor() -> str:
    """Return the name of the processor on which most of the files with times were measured."""
    return Counter(made(name)["cpu"] for name in commands() if name in TIMES).most_common(1)[0][0]


@cache
def why_old(name: str) -> str:
    """Return the reason why a results file in data/reference is old, or "" if it is not old.

    name: name of the file, without suffix. A file that `commands` does not list is never called old.
    """
    return reason(made(name), commands()[name][0], is_time=name in TIMES) if name in commands() else ""


def reason(stored: dict, script: Path, *, is_time: bool) -> str:
    """Return the reason why stored results are not what their script would give now, or "" if they are.

    stored: provenance of the results. is_time: whether the results are measured times.
    """
    if not stored.get("code"):
        return f"it does not say what code made it (commit {stored['commit'][:8]})"
    for name, digest in stored.get("inputs", {}).items():
        if provenance.digests([name]).get(name) != digest:
            return f"{name} has changed"
        if (path := Path(name)).parent.as_posix() == "data/reference" and why_old(path.stem):
            return f"{name} is old"
    changed = {name for digest, name in stored["code"].items() if digest not in everywhere()}
    changed |= {name for digest, name in read(script)[0].items() if digest not in stored["code"]}
    if changed := changed - WRITTEN.get(script.name, set()):
        return f"{', '.join(sorted(changed)[:3])}{f' and {len(changed) - 3} more' * (len(changed) > 3)} changed"
    if is_time:
        if stored["held"] != made_by(script)["held"]:
            return "a time, and the package has changed"
        return "" if stored["cpu"] == processor() else f"measured on {stored['cpu']}, the others on {processor()}"
    return "" if stored.get("golden") in golden() else "golden runs give other bits"


def stale() -> list[str]:
    """Return the names of the old results files, in the order in which they should be made again.

    Files without times come first, then files with times, then files that take a file with times as input. Within each
    group, the files with the shortest computing time come first.
    """

    def order(name: str):
        inputs = any(Path(one).stem in TIMES for one in made(name).get("inputs", {}))
        return inputs, name in TIMES, made(name)["wall_s"]

    return sorted((name for name in commands() if why_old(name)), key=order)
