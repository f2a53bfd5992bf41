"""Which files of data/reference are old, and why: made by another script, package, input or processor than today's.

Code is compared by statements: functions, classes and constants at the top of a module, without comments, docstrings,
imports and the names of modules. So a move changes nothing. A result stores the statements of its script, and of the
modules that this imports, directly or not. It is old once one of them is in no file any more, or once its script has a
new one. What only judges and draws stored numbers does not count.

Modules that the golden runs import are held by these instead: numbers are old once the runs give other bits. Times are
old after any change of such a module.
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
"""File of data/reference -> the script that writes it, and its name there."""

TIMES = frozenset([*STUDIES, *(f"figure_{number}" for number in ("5_2", "5_10", "6_6", "6_7", "6_16"))])
"""Files that hold measured times."""

DRAWING = {"reporting", "figures", "plot"}
"""Folders of the package that store, judge and draw numbers."""

JUDGING = {"claims", "draw", "table"}
"""Functions of a script that see stored numbers alone, unless another function of the script names them."""


# ---- code ----


class _Code(ast.NodeTransformer):
    """Leaves out imports, names of the package's modules, docstrings, and what only type checkers read.

    imported: (module, name) of all that a file imports from the package. used: the same, of attributes of these.
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
    """Where a name of a module is defined, if the module imports its names when they are used."""
    package = _place(f"{module}.__init__")
    if not package.is_file() and "." in module and not _place(module).is_file():
        module = ".".join(_home(*module.rpartition(".")[::2]))
    return lazy.homes(str(package)).get(name, (module, name)) if package.is_file() else (module, name)


def _sha(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()[:16]


@cache
def read(file: Path) -> tuple[dict[str, str], set[Path]]:
    """{16 digits of a statement: its name, such as "starts.paired"} of a file, and the files that it imports or names.

    A data file is one statement. Of a script, those of `JUDGING` are left out. Raises ValueError for an import that is
    in no file.
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
    """The modules and the data files behind a module's imports and texts, but for those of `DRAWING`."""
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
    """A file, and all that it imports or names, directly or not."""
    found, waiting = set(), {file}
    while waiting:
        found.add(one := waiting.pop())
        waiting |= read(one)[1] - found
    return found


def _statements(files) -> dict[str, str]:
    return {digest: name for file in sorted(files) for digest, name in read(file)[0].items()}


@cache
def everywhere() -> dict[str, str]:
    """The statements of the package, the scripts and their data files."""
    folders = ROOT / "deep_contact", ROOT / "scripts", ROOT / "models"
    return _statements(one for folder in folders for kind in ("*.py", "*.json") for one in folder.rglob(kind))


@cache
def made_by(script: Path | None = None) -> dict:
    """Digests of the code behind a script's results, which `reason` compares; {} if none runs, or outside a checkout.

    script: by default the script that runs. Keys: code, the digests of the statements that golden runs do not import;
    held, one digest of all statements that they import; golden, the digest of the bits of the golden runs.
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
    """Digests of the golden runs (tests/tools/golden.py): today's, and those of before whose runs kept their bits."""
    file = ROOT / "data" / "reference" / "golden.json"
    if not file.is_file():
        return ()
    record = json.loads(file.read_text(encoding="utf-8"))
    return digest_of_runs(record["runs"]), *record.get("extends", ())


def digest_of_runs(runs: dict) -> str:
    """16 digits for the bits of all golden runs."""
    return _sha(json.dumps({name: runs[name]["sha256"] for name in sorted(runs)}))


# ---- what is old ----


@cache
def commands() -> dict[str, list]:
    """File of data/reference -> its script and options, of all that can be old. Others say what was done once."""
    folder = ROOT / "scripts"
    found = {name: [folder / script, *options] for name, (script, *options) in STUDIES.items()}
    found |= {scripts.stem(path): [path] for path in scripts.find(folder).values()}
    return {name: command for name, command in found.items() if (results.REFERENCE / f"{name}.json").is_file()}


@cache
def made(name: str) -> dict:
    """The provenance of a file of data/reference."""
    return json.loads((results.REFERENCE / f"{name}.json").read_text(encoding="utf-8"))["provenance"]


@cache
def processor() -> str:
    """On which most of the times were measured."""
    return Counter(made(name)["cpu"] for name in commands() if name in TIMES).most_common(1)[0][0]


@cache
def why_old(name: str) -> str:
    """Why a file of data/reference is not true any more; "" if it is true, or says what was done once."""
    return reason(made(name), commands()[name][0], is_time=name in TIMES) if name in commands() else ""


def reason(stored: dict, script: Path, *, is_time: bool) -> str:
    """Why results with this provenance are not what a script would give today; "" if they are."""
    if not stored.get("code"):
        return f"it does not say what code made it (commit {stored['commit'][:8]})"
    for name, digest in stored.get("inputs", {}).items():
        if provenance.digests([name]).get(name) != digest:
            return f"{name} has changed"
        if (path := Path(name)).parent.as_posix() == "data/reference" and why_old(path.stem):
            return f"{name} is old"
    changed = {name for digest, name in stored["code"].items() if digest not in everywhere()}
    changed |= {name for digest, name in read(script)[0].items() if digest not in stored["code"]}
    if changed:
        return f"{', '.join(sorted(changed)[:3])}{f' and {len(changed) - 3} more' * (len(changed) > 3)} changed"
    if is_time:
        if stored["held"] != made_by(script)["held"]:
            return "a time, and the package has changed"
        return "" if stored["cpu"] == processor() else f"measured on {stored['cpu']}, the others on {processor()}"
    return "" if stored.get("golden") in golden() else "golden runs give other bits"


def stale() -> list[str]:
    """The files that are old: the cheap first, then those that hold times, then what is drawn from these."""

    def order(name: str):
        inputs = any(Path(one).stem in TIMES for one in made(name).get("inputs", {}))
        return inputs, name in TIMES, made(name)["wall_s"]

    return sorted((name for name in commands() if why_old(name)), key=order)
