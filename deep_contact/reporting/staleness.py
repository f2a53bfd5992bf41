"""Which files of data/reference are old, and why: made by other code, other inputs or another processor than today's.

The code of a result is its script and all modules that this imports, directly or not, without comments and docstrings.
Nothing is left out by its name. What only judges and draws stored numbers is counted apart: the statements of a script
that its `compute` does not need, and the folder reporting/. After a change of that, numbers are judged and drawn again.

Numbers that are no times stay true after a change of modules that golden runs execute, while these give the same bits.
"""

from __future__ import annotations

import ast
import copy
import hashlib
import json
import sys
from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from deep_contact.io import lazy, provenance, shipped
from deep_contact.reporting import results, scripts

_SCRIPTS = shipped.ROOT / "scripts"

STUDIES = {
    "run_tradeoff": [_SCRIPTS / "run_tradeoff.py"],
    "run_tradeoff_verify": [_SCRIPTS / "run_tradeoff_verify.py"],
    "benchmark_engine": [_SCRIPTS / "benchmark.py", "engine"],
    "benchmark_live": [_SCRIPTS / "benchmark.py", "live"],
}
"""File of data/reference -> the script that writes it, and its name there."""

TIMES = frozenset({
    *STUDIES, *(f"figure_{number}" for number in ("5_2", "5_10", "6_6", "6_7", "6_16")),
})  # fmt: skip
"""Files that hold measured times."""

DRAWN = "judged or drawn otherwise"
"""Why a file is old whose numbers are true."""

JUDGING = {"title", "quick", "table", "draw", "claims"}, (1, 3, 4, 5)
"""Arguments of a `Figure` that make no number, by name and by place."""


# ---- code ----


@cache
def code(script: Path, root: Path = shipped.ROOT) -> dict:
    """{"code": file -> 16 digits, of what a script's numbers come from, "drawn": 16 digits of what draws}."""
    body = _parsed(script)
    computing = _needed(body)
    numbers, (others, drawing) = imported(computing, root)[0], imported(body, root)
    found = {script: _digest(computing)} | {file: _digest_of(file) for file in numbers}
    by_name = {file.relative_to(root).as_posix() if root in file.parents else file.name: file for file in found}
    drawn = [_digest(body), *map(_digest_of, sorted(drawing | others - numbers))]
    return {"code": {name: found[by_name[name]] for name in sorted(by_name)}, "drawn": _sha(" ".join(drawn).encode())}


def imported(statements: Sequence[ast.stmt], root: Path) -> tuple[set[Path], set[Path]]:
    """The files of the package that statements import, directly or not, and the data files that these name.

    The second are those of reporting/. What only they import changes no number and is drawn by them alone.
    """
    found, drawing, reporting = set(), set(), root / "deep_contact" / "reporting"
    waiting = _imports(statements, root)
    while waiting:
        file = waiting.pop()
        if reporting in file.parents:
            drawing.add(file)
            waiting |= {one for one in _imported_by(file, root) if reporting in one.parents} - drawing
        else:
            found.add(file)
            waiting |= _imported_by(file, root) - found - drawing
    return found, drawing


def _needed(body: Sequence[ast.stmt]) -> list[ast.stmt]:
    """The statements of a script that what its FIGURE or FIGURES computes needs; of any other script all."""
    names, needed, before = {"FIGURE", "FIGURES"}, [*body], -1
    if not any(names & _defined(node) for node in body):
        return needed
    while before != (before := len(names)):
        needed = [_Computing().visit(copy.deepcopy(node)) for node in body if names & _defined(node)]
        names |= {one.id for node in needed for one in ast.walk(node) if isinstance(one, ast.Name)}
    return needed


def _defined(node: ast.stmt) -> set[str]:
    """Names to which a statement of a module gives a meaning, or which it may change."""
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        return {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return {node.name}
    names = [one for one in ast.walk(node) if isinstance(one, ast.Name)]
    stored = {one.id for one in names if isinstance(one.ctx, ast.Store)}
    return stored if stored and isinstance(node, (ast.Assign, ast.AnnAssign)) else {one.id for one in names}


class _Computing(ast.NodeTransformer):
    """Leaves out what of a `Figure` only judges and draws stored numbers."""

    def visit_Call(self, node):
        if ast.unparse(node.func).endswith(("Figure", "_figure")):
            names, places = JUDGING
            node.args = [value for place, value in enumerate(node.args) if place not in places]
            node.keywords = [keyword for keyword in node.keywords if keyword.arg not in names]
        return self.generic_visit(node)


class _Code(ast.NodeTransformer):
    """Leaves out docstrings, and what only type checkers read."""

    def visit_Expr(self, node):
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_If(self, node):
        return None if ast.unparse(node.test) == "TYPE_CHECKING" else self.generic_visit(node)


@cache
def _parsed(file: Path) -> list[ast.stmt]:
    return _Code().visit(ast.parse(file.read_bytes())).body


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _digest(statements: Sequence[ast.stmt]) -> str:
    return _sha(" ".join(map(ast.dump, statements)).encode())


@cache
def _digest_of(file: Path) -> str:
    return _digest(_parsed(file)) if file.suffix == ".py" else _sha(file.read_bytes())


@cache
def _imported_by(file: Path, root: Path) -> set[Path]:
    """The files that a module of the package imports, and the .json files beside it or of models/ that it names."""
    if file.suffix != ".py":
        return set()
    texts = [one.value for node in _parsed(file) for one in ast.walk(node) if isinstance(one, ast.Constant)]
    names = [text for text in texts if isinstance(text, str) and text.endswith(".json") and "/" not in text]
    data = (folder / name for folder in (file.parent, file.parent / "reference", root / "models") for name in names)
    return _imports(_parsed(file), root) | {path for path in data if path.is_file()}


def _imports(statements: Sequence[ast.stmt], root: Path) -> set[Path]:
    """Files of the package that statements import, those included that they take as attributes of a lazy package."""
    nodes = [one for statement in statements for one in ast.walk(statement)]
    wanted, packages = set(), {}
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module:
            wanted |= {(node.module, alias.name) for alias in node.names}
            packages |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            wanted |= {(alias.name, "") for alias in node.names}
            packages |= {alias.asname or alias.name: alias.name for alias in node.names}
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in packages:
            wanted.add((packages[node.value.id], node.attr))
    inside = [pair for pair in wanted if pair[0].partition(".")[0] == "deep_contact"]
    return {file for module, name in inside for file in _files(root, module, name)}


def _files(root: Path, module: str, name: str) -> set[Path]:
    """Where a module, or a name of it, is defined, with the packages that are imported on the way."""
    place = root / module.replace(".", "/")
    files = {place.with_suffix(".py"), place / f"{name}.py", place / name / "__init__.py"}
    files |= {folder / "__init__.py" for folder in (place / "_").parents if root in folder.parents}
    files = {file for file in files if file.is_file()}
    homes = lazy.homes(str(place / "__init__.py")) if place / "__init__.py" in files else {}
    return files if homes.get(name, [module])[0] == module else files | _files(root, *homes[name])


# ---- what is old ----


def made_by() -> dict:
    """What `reason` compares of the script that runs: its `code` and the golden runs; nothing outside of a script."""
    script = Path(getattr(sys.modules["__main__"], "__file__", None) or "none").resolve()
    if script.suffix != ".py" or not script.is_file() or "site-packages" in script.parts:
        return {}
    return code(script) | dict(zip(["golden"], golden()))


@cache
def golden(root: Path = shipped.ROOT) -> tuple[str, ...]:
    """Digests of the golden runs (tests/tools/golden.py): today's, and those of before whose runs kept their bits."""
    file = root / "data" / "reference" / "golden.json"
    if not file.is_file():
        return ()
    record = json.loads(file.read_text(encoding="utf-8"))
    return digest_of_runs(record["runs"]), *record.get("extends", ())


def digest_of_runs(runs: dict) -> str:
    """16 digits for the bits of all golden runs."""
    return _sha(json.dumps({name: runs[name]["sha256"] for name in sorted(runs)}).encode())


@cache
def commands() -> dict[str, list]:
    """File of data/reference -> its script and options, of all that can be old. Others say what was done once."""
    figures = {scripts.stem(path): [path] for path in scripts.find(_SCRIPTS).values()}
    there = {path.stem for path in results.REFERENCE.glob("*.json")}
    return {name: command for name, command in (STUDIES | figures).items() if name in there}


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


def reason(stored: dict, script: Path, *, is_time: bool, root: Path = shipped.ROOT) -> str:
    """Why results with this provenance are not what a script would give today; "" if they are."""
    if "drawn" not in stored:
        return f"it does not say what code made it (commit {stored['commit'][:8]})"
    for name, digest in stored.get("inputs", {}).items():
        if provenance.digests([name]).get(name) != digest:
            return f"{name} has changed"
        if (path := Path(name)).parent.as_posix() == "data/reference" and why_old(path.stem) not in ("", DRAWN):
            return f"{name} is old"
    now, then = code(script, root), stored["code"]
    changed = [file for file in sorted(now["code"] | then) if now["code"].get(file) != then.get(file)]
    if not is_time and stored.get("golden") in golden(root):
        runs = code(root / "tests" / "tools" / "golden.py", root)["code"]
        # What imported a file that is gone has changed itself; golden runs change with the settings of presets.
        held = {file for file in runs.keys() | then.keys() - now["code"].keys() if file.endswith(".py")}
        changed = [file for file in changed if file not in held]
    if changed:
        return f"{', '.join(changed[:3])}{f' and {len(changed) - 3} more' if len(changed) > 3 else ''} changed"
    if is_time and stored["cpu"] != processor():
        return f"measured on {stored['cpu']}, the others on {processor()}"
    return "" if stored["drawn"] == now["drawn"] else DRAWN


def stale() -> list[str]:
    """The files that are old: the cheap first, then those that hold times, then what is drawn from these."""

    def order(name: str):
        inputs = any(Path(one).stem in TIMES for one in made(name).get("inputs", {}))
        return inputs, name in TIMES, 0.0 if why_old(name) == DRAWN else made(name)["wall_s"]

    return sorted((name for name in commands() if why_old(name)), key=order)
