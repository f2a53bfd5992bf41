"""Which code a script runs, as a digest of each file: what makes a stored result old, and what does not.

A digest is of the parsed file without docstrings, comments, texts of errors and what only judges, prints or draws what
is stored: functions of `NOT_STORED`, titles of figures, and the modules of `NO_NUMBERS`. Of a script that describes a
`Figure`, only what its `compute` and its options name is counted, with the modules imported for that.
"""

from __future__ import annotations

import ast
import hashlib
import json
from functools import cache
from pathlib import Path

from deep_contact.io import lazy, shipped

NO_NUMBERS = (
    *("reporting/", "parallel.py", "studies/verdicts.py", "state/notebook.py", "compiled/__init__.py"),
    *("compiled/boxing.py", "compiled/code_cache.py"),
    *("io/lazy.py", "io/provenance.py", "io/shipped.py", "io/sources.py"),
)
"""Files and folders of the package that change no number of a result."""

NOT_STORED = ("draw", "_draw", "claims", "table", "_summary", "_walls")
"""Beginnings of the names of functions that see stored data alone, or say what a state is."""

LEFT_OUT = {"title", "table", "draw", "claims"}, (1, 3, 4, 5)
"""Arguments of a `Figure` that are not counted, by name and by position."""


@cache
def code(script: Path, root: Path = shipped.ROOT) -> dict[str, str]:
    """Path below `root` -> 16 digits, of a script, of all modules that it imports, directly or not, and their .json.

    The table of settings that `accuracy=` looks up counts where the script or a study that it imports gives one: the
    study of runs, which writes the table, does not.
    """
    digests, waiting, looks_up = {}, {script}, False
    while waiting:
        file = waiting.pop()
        read, imported, gives_accuracy = _read(file, root, file == script)
        looks_up |= gives_accuracy and (file == script or file.parent.name == "studies")
        digests |= read
        waiting |= imported - digests.keys()
    if not looks_up:
        digests = {path: digest for path, digest in digests.items() if path.parent.name != "reference"}
    below = {path: path.relative_to(root).as_posix() if root in path.parents else path.name for path in digests}
    return {below[path]: digests[path] for path in sorted(digests)}


@cache
def _read(file: Path, root: Path, is_script: bool) -> tuple[dict[Path, str], set[Path], bool]:
    """Digests of a file and of the .json files it names, the files that it imports, whether it gives an accuracy."""
    tree = _Numbers(is_script).visit(ast.parse(file.read_bytes()))
    texts = {str(node.value) for node in ast.walk(tree) if isinstance(node, ast.Constant)}
    names = [text for text in texts if text.endswith(".json") and "/" not in text]
    data = [folder / name for folder in (file.parent, file.parent / "reference", root / "models") for name in names]
    digests = {file: _digest(ast.dump(tree).encode())}
    digests |= {path: _digest(path.read_bytes()) for path in data if path.is_file()}
    return digests, _imported(tree, root), "accuracy=" in ast.unparse(tree)


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
    return _digest(json.dumps({name: runs[name]["sha256"] for name in sorted(runs)}).encode())


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


class _Numbers(ast.NodeTransformer):
    """Leaves what numbers come from."""

    def __init__(self, only_figure: bool):
        self.only_figure = only_figure

    def visit_Module(self, node):
        self.generic_visit(node)
        if self.only_figure and any(_is_figure(statement) for statement in node.body):
            node.body = _reached(node.body)
        return node

    def visit_FunctionDef(self, node):
        return None if node.name.startswith(NOT_STORED) or "repr" in node.name else self.generic_visit(node)

    def visit_If(self, node):
        return None if ast.unparse(node.test) == "TYPE_CHECKING" else self.generic_visit(node)

    def visit_Expr(self, node):
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_Raise(self, node):
        return ast.Raise(exc=None, cause=None)

    def visit_Call(self, node):
        if ast.unparse(node.func) == "expect":
            del node.args[1:]  # what it says where it refuses
        if ast.unparse(node.func).endswith(("Figure", "_figure")):
            names, places = LEFT_OUT
            node.args = [value for place, value in enumerate(node.args) if place not in places]
            node.keywords = [keyword for keyword in node.keywords if keyword.arg not in names]
        return self.generic_visit(node)


def _is_figure(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "FIGURE"


def _reached(body: list[ast.stmt]) -> list[ast.stmt]:
    """The statements of a script that its FIGURE needs: those that define a name which a needed one uses."""
    needed, names, before = set(), set(), None
    while before != len(needed):
        before = len(needed)
        for number, statement in enumerate(body):
            if _is_figure(statement) or names & _defined(statement):
                needed.add(number)
                names |= {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}
    return [body[number] for number in sorted(needed)]


def _defined(statement: ast.stmt) -> set[str]:
    if isinstance(statement, (ast.Import, ast.ImportFrom)):
        return {(alias.asname or alias.name).partition(".")[0] for alias in statement.names}
    stored = (node.id for node in ast.walk(statement) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    return {getattr(statement, "name", ""), *stored}


def _imported(tree: ast.Module, root: Path) -> set[Path]:
    """Files of the package that a module imports, those included that it takes as attributes of a lazy package."""
    wanted, packages = set(), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            wanted |= {(node.module, alias.name) for alias in node.names}
            packages |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            wanted |= {(alias.name, "") for alias in node.names}
            packages |= {alias.asname or alias.name: alias.name for alias in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in packages:
            wanted.add((packages[node.value.id], node.attr))
    inside = [pair for pair in wanted if pair[0].partition(".")[0] == "deep_contact"]
    files = {file for module, name in inside for file in _files(root, module, name)}
    return {file for file in files if not file.relative_to(root / "deep_contact").as_posix().startswith(NO_NUMBERS)}


def _files(root: Path, module: str, name: str) -> set[Path]:
    """Where a module, or a name of it, is defined, with the packages that are imported on the way."""
    place = root / module.replace(".", "/")
    files = {place.with_suffix(".py"), place / f"{name}.py", place / name / "__init__.py"}
    files |= {folder / "__init__.py" for folder in (place / "_").parents if root in folder.parents}
    files = {file for file in files if file.is_file()}
    homes = lazy.homes(str(place / "__init__.py")) if place / "__init__.py" in files else {}
    return files if homes.get(name, [module])[0] == module else files | _files(root, *homes[name])
