"""Mutants of the physics and of the transfer, and which tests find them.

    python scripts/mutate.py [--mutants 80] [--seed 0] [--jobs 2] [--out data/reference/mutants.json]
    python scripts/mutate.py --again data/reference/mutants.json     only those that survived there
    python scripts/mutate.py --list                                  what would be tried, without trying

A mutant is the package with one small fault in `physics/` or `sph/`: an operator or a comparison exchanged, a number
changed, a minus or an `abs` dropped, `min` for `max`, `and` for `or`. The same seed makes the same mutants of the same
sources. Beside the automatic ones stand those planted by hand (`PLANTED`). Each is put into a copy of the package, and
the tests of `TESTS` run until one fails, first those of the file that was changed; one that runs out of time is found,
too. Compiled code is kept of those files that a mutant does not reach. The record lists every mutant with its place,
its fault and the test that found it. It is written after every mutant, so that a run that is stopped can go on with
`--resume`, which also tries again what has survived, and keeps in mind that it had. What survives and cannot be found
is explained in `EQUIVALENT`.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from deep_contact.reporting import results
from deep_contact.reporting.figures import progress_bar

ROOT = Path(__file__).resolve().parent.parent
TIME = 600
"""Seconds of processor time that the tests of one mutant may take; they take a fifth of it, most of that compiling.
Not of the clock: a busy machine is no fault that tests have found."""

TESTS = {
    "physics": (
        *("test_contact_solver", "test_collision", "test_engine", "test_state", "test_scenes", "test_warm_start"),
        *("test_methods", "test_errors", "test_box2d_oracle", "test_extremes", "test_properties"),
    ),
    "sph": ("test_kernels", "test_grid", "test_kernels_extremes", "test_warm_start"),
}
"""Folder -> its test files, those that find most first."""

FIRST = {
    "collision": ("test_collision",),
    "convergence": ("test_contact_solver", "test_methods"),
    "engine": ("test_engine", "test_extremes"),
    "errors": ("test_errors",),
    "exact": ("test_exact",),
    "kernels": ("test_kernels",),
    "lcp": ("test_contact_solver", "test_methods"),
    "methods": ("test_methods",),
    "neighbours": ("test_grid",),
    "relaxation": ("test_methods",),
    "scenes": ("test_scenes", "test_properties"),
    "soft_steps": ("test_methods",),
    "grid": ("test_grid",),
}
"""Module -> test files that run before the others of its folder."""

NOT_TRIED = "guarded"
"""Tests of this name are left out: that start loads a network, which takes longer than all that a mutant changes."""

COMPARISONS = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="}
OPERATORS = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "*", "**": "*", "&": "|", "|": "&"}
CALLS = {"min": "max", "max": "min", "floor": "ceil", "ceil": "floor", "minimum": "maximum", "maximum": "minimum"}
_SKIPPED_CALLS = ("raise", "_error", "check_", "_check", "_refuse")


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One fault: bytes `start` to `end` of a file replaced. file: relative to the package."""

    file: str
    line: int
    function: str
    kind: str
    old: str
    new: str
    start: int
    end: int


@dataclass(frozen=True, kw_only=True)
class Planted:
    """A fault planted by hand: the only place in the file where `old` stands."""

    name: str
    file: str
    old: str
    new: str


PLANTED = (
    Planted(
        name="friction with the wrong sign",
        file="physics/contact_solver.py",
        old="a_x = a_x - w_a * n_x * p_n - w_a * n_y * p_t",
        new="a_x = a_x - w_a * n_x * p_n + w_a * n_y * p_t",
    ),
    Planted(
        name="no clamp of the normal impulse",
        file="physics/contact_solver.py",
        old="p_n = max(free_n, -old_n)",
        new="p_n = free_n",
    ),
    Planted(
        name="no clamp of friction",
        file="physics/contact_solver.py",
        old="p_t = max(-largest - old_t, min(free_t, largest - old_t))",
        new="p_t = free_t",
    ),
    Planted(
        name="a kernel that is not normalised",
        file="sph/kernels.py",
        old="return profile(kernel, r / h, dim)[0] / h**dim",
        new="return profile(kernel, r / h, dim)[0]",
    ),
    Planted(
        name="poly6 with the constant of space on the plane",
        file="sph/kernels.py",
        old="c = 4.0 / math.pi if dim == 2 else 315.0 / (64.0 * math.pi)",
        new="c = 315.0 / (64.0 * math.pi)",
    ),
    Planted(
        name="the transposed matrix of Algorithm 4",
        file="sph/grid.py",
        old="weights[0], weights[1] = (1.0 - s) * (1.0 - t), s * (1.0 - t)\n    weights[2], weights[3] = (1.0 - s) * t",
        new="weights[0], weights[1] = (1.0 - s) * (1.0 - t), (1.0 - s) * t\n    weights[2], weights[3] = s * (1.0 - t)",
    ),
    Planted(
        name="impulses that are not carried to the next step",
        file="physics/collision.py",
        old="p_n, p_t = old.normal_impulse[j], old.tangent_impulse[j]",
        new="p_n, p_t = 0.0, 0.0",
    ),
    Planted(
        name="θ without the friction rows",
        file="physics/contact_solver.py",
        old="theta = max(theta, max(abs(p_n), abs(p_t)))",
        new="theta = max(theta, abs(p_n))",
    ),
    Planted(
        name="a wall of the wrong side",
        file="physics/collision.py",
        old="return box[2] - x\n",
        new="return x - box[2]\n",
    ),
    Planted(
        name="positions moved by the velocities of before",
        file="physics/engine.py",
        old="bodies.position[i, 1] += dt * v_y",
        new="bodies.position[i, 1] += dt * (v_y + 1e-3)",
    ),
)
"""Faults of the kinds that matter most, planted by hand."""


EQUIVALENT = {
    (
        "physics/collision.py",
        "rows = int((y_max - y_min) * per_metre) + 2",
    ): "one more row of cells, an empty one",
    ("physics/relaxation.py", "if beta >= 1.0:"): "differs only where a change is exactly as large as the one before",
    ("physics/soft_steps.py", "if restitution >= 0.0:"): "without restitution nothing bounces: the pass is idle",
    ("sph/grid.py", "return _DONE, 1"): "which particle a success is about, nobody reads",
    ("sph/neighbours.py", "nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-2, 2)"): "any negative size will do",
}
"""(File, the line as it is with the mutant in it) -> why no test can tell it from the original."""


# ---- mutants ----


def sources(package: Path) -> list[Path]:
    """The files that are mutated."""
    return [p for folder in TESTS for p in sorted((package / folder).glob("*.py")) if p.name != "__init__.py"]


def mutants_of(path: Path, package: Path) -> list[Mutant]:
    """Every mutant of a file, in the order of its text."""
    text = path.read_bytes()
    finder = _Finder(text, path.relative_to(package).as_posix())
    finder.visit(ast.parse(text))
    return sorted(finder.found, key=lambda mutant: (mutant.start, mutant.new))


class _Finder(ast.NodeVisitor):
    """Collects mutants inside of functions; leaves out messages, checks of arguments, defaults and decorators."""

    def __init__(self, text: bytes, file: str):
        self.text, self.file = text, file
        self.lines = [0]
        for line in text.splitlines(keepends=True):
            self.lines.append(self.lines[-1] + len(line))
        self.functions: list[str] = []
        self.found: list[Mutant] = []

    def at(self, node, *, end=False) -> int:
        line, column = (node.end_lineno, node.end_col_offset) if end else (node.lineno, node.col_offset)
        return self.lines[line - 1] + column

    def add(self, node, kind: str, start: int, end: int, new: str) -> None:
        if self.functions:
            self.found.append(
                Mutant(
                    file=self.file,
                    line=node.lineno,
                    function=self.functions[-1],
                    kind=kind,
                    old=self.text[start:end].decode(),
                    new=new,
                    start=start,
                    end=end,
                )
            )

    def visit_FunctionDef(self, node):
        if node.name.startswith(("check_", "_check", "_error", "__post_init__", "_refuse")):
            return
        self.functions.append(node.name)
        for child in node.body:
            self.visit(child)
        self.functions.pop()

    def visit_Raise(self, node):
        return  # its text is not physics

    def visit_JoinedStr(self, node):
        return

    def visit_If(self, node):
        # A check of an argument: what raises at once is the border's business, and its tests are elsewhere.
        if not (len(node.body) == 1 and isinstance(node.body[0], ast.Raise)):
            self.visit(node.test)
        for child in (*node.body, *node.orelse):
            self.visit(child)

    def visit_BinOp(self, node):
        self.exchange(node, "operator", OPERATORS, self.at(node.left, end=True), self.at(node.right))
        self.generic_visit(node)

    def visit_AugAssign(self, node):
        self.exchange(node, "operator", OPERATORS, self.at(node.target, end=True), self.at(node.value))
        self.generic_visit(node)

    def visit_Compare(self, node):
        ends = [node.left, *node.comparators]
        for left, right in zip(ends, ends[1:]):
            self.exchange(node, "comparison", COMPARISONS, self.at(left, end=True), self.at(right))
        self.generic_visit(node)

    def visit_BoolOp(self, node):
        words = {"and": "or", "or": "and"}
        for left, right in zip(node.values, node.values[1:]):
            self.exchange(node, "boolean", words, self.at(left, end=True), self.at(right))
        self.generic_visit(node)

    def visit_UnaryOp(self, node):
        if isinstance(node.op, (ast.USub, ast.Not)):
            self.add(node, "dropped sign or not", self.at(node), self.at(node.operand), "")
        self.generic_visit(node)

    def visit_Constant(self, node):
        if isinstance(node.value, bool) or not isinstance(node.value, (int, float)):
            return
        changed = {0: "1", 1: "2", 2: "1"}.get(node.value, repr(node.value * 2))
        if isinstance(node.value, float):
            changed = {0.0: "1.0", 1.0: "2.0", 0.5: "1.0"}.get(node.value, repr(node.value * 2))
        self.add(node, "number", self.at(node), self.at(node, end=True), changed)

    def visit_Call(self, node):
        name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
        if name.startswith(_SKIPPED_CALLS):
            return
        end = self.at(node.func, end=True)
        if name in CALLS:
            self.add(node, "call", end - len(name), end, CALLS[name])
        if name == "abs" and len(node.args) == 1:
            self.add(node, "dropped abs", end - len(name), end, "")
        self.generic_visit(node)

    def exchange(self, node, kind, table, start, end) -> None:
        """A mutant for the operator that stands between two operands."""
        between = self.text[start:end].decode()
        token = re.search(r"//|\*\*|<=|>=|==|!=|[-+*/%&|<>]|\b(?:and|or)\b", between)
        if token and token[0] in table:
            at = start + len(between[: token.start()].encode())
            self.add(node, kind, at, at + len(token[0]), table[token[0]])


def choose(package: Path, count: int, seed: int) -> list[Mutant]:
    """`count` mutants, of every file by its share and two at least; all if there are no more.

    In an order of chance: a run that is stopped has then tried some of every file.
    """
    rng = random.Random(seed)
    pools = {}
    for path in sources(package):
        pools[path] = mutants_of(path, package)
        rng.shuffle(pools[path])
    total = sum(map(len, pools.values()))
    chosen = [mutant for pool in pools.values() for mutant in pool[: max(2, round(count * len(pool) / max(1, total)))]]
    rng.shuffle(chosen)
    return chosen[:count]


def planted_mutant(planted: Planted, package: Path) -> Mutant:
    """The mutant of a fault planted by hand. Raises ValueError where its place is gone or not the only one."""
    text = (package / planted.file).read_bytes()
    old = planted.old.encode()
    if text.count(old) != 1:
        raise ValueError(f"{planted.file}: expected {planted.old!r} once, got it {text.count(old)} times")
    start = text.index(old)
    return Mutant(
        file=planted.file,
        line=text[:start].count(b"\n") + 1,
        function="",
        kind=f"planted: {planted.name}",
        old=planted.old,
        new=planted.new,
        start=start,
        end=start + len(old),
    )


# ---- trying them ----


def make_copy(folder: Path) -> None:
    """What the tests need, without compiled code and data."""
    leave_out = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
    for name in ("deep_contact", "tests", "scripts"):
        shutil.copytree(ROOT / name, folder / name, ignore=leave_out)
    for name in ("setup.cfg", "pyproject.toml", "README.md"):
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, folder / name)


def keep_code(folder: Path) -> None:
    """Let the package in a copy take the compiled code of the tests without a mutant; what the mutant is part of is
    stale (`deep_contact.compiled.code_cache`)."""
    shutil.copytree(folder / "warm", folder / "deep_contact", dirs_exist_ok=True)


def _limit_time() -> None:
    """In the process of the tests, before they run."""
    resource.setrlimit(resource.RLIMIT_CPU, (TIME, TIME + 10))


def try_mutant(mutant: Mutant | None, folder: Path, tests: list[str]) -> dict:
    """Run the tests in a copy with a mutant in it; {"found": bool, "by": the test, or "time", or None}.

    Without a mutant it says whether the tests pass at all, and puts the code that they compile into `warm`. tests: as
    pytest takes them; by default those of `TESTS`.
    """
    folders = TESTS if mutant is None else [mutant.file.split("/")[0]]
    names = [name for key in folders for name in TESTS[key]]
    package, path = folder / "deep_contact", None
    if mutant is not None:
        names = [*FIRST.get(Path(mutant.file).stem, ()), *names]
        path = package / mutant.file
        original = path.read_bytes()
        if original[mutant.start : mutant.end].decode() != mutant.old:
            raise ValueError(f"{mutant.file}:{mutant.line}: expected {mutant.old!r}: the source has changed")
        path.write_bytes(original[: mutant.start] + mutant.new.encode() + original[mutant.end :])
        keep_code(folder)
    tests = tests or [file for name in dict.fromkeys(names) if (folder / (file := f"tests/{name}.py")).exists()]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no", "-rfE"]
    command += ["-k", f"not {NOT_TRIED}", *tests]
    # The copy comes first on the path, so that an installed package does not stand in for it.
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, preexec_fn=_limit_time
        )
    finally:
        if path is not None:
            path.write_bytes(original)
    if done.returncode == 0:
        if mutant is None:
            shutil.copytree(package, folder / "warm", ignore=shutil.ignore_patterns("*.py", "*.json"))
        return {"found": False, "by": None}
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return {"found": True, "by": "time"}
    failed = re.search(r"^(?:FAILED|ERROR) (?:tests/)?(\S+)", done.stdout, re.MULTILINE)
    return {"found": True, "by": failed[1] if failed else f"the process ended with {done.returncode}"}


def run(mutants: list[Mutant], *, jobs: int, record: dict, path: Path, tests: list[str]) -> None:
    """Try all mutants that the record does not know, in `jobs` copies, and write the record after each."""
    survived = {identity(entry) for entry in record["mutants"] if not (entry["found"] or entry["equivalent"])}
    record["mutants"] = [entry for entry in record["mutants"] if identity(entry) not in survived]
    known = {identity(entry) for entry in record["mutants"]}
    waiting = [mutant for mutant in mutants if identity(asdict(mutant)) not in known]
    if not waiting:
        return
    with tempfile.TemporaryDirectory() as temporary:
        free = []
        for number in range(jobs):
            folder = Path(temporary) / str(number)
            folder.mkdir()
            make_copy(folder)
            free.append(folder)
        for folder in free:
            if (failed := try_mutant(None, folder, tests))["found"]:
                raise SystemExit(f"mutate.py: {failed['by']} fails without any mutant; mutants would tell nothing")

        def one(mutant):
            folder = free.pop()
            try:
                tried = try_mutant(mutant, folder, tests)
            finally:
                free.append(folder)
            return {**asdict(mutant), **tried, "survived_before": identity(asdict(mutant)) in survived}

        with ThreadPoolExecutor(jobs) as pool, progress_bar(total=len(waiting), text="mutants") as bar:
            for found in pool.map(one, waiting):
                record["mutants"].append(found)
                summarise(record)
                write_record(path, record)
                bar.update()


def mutated_line(entry: dict, package: Path) -> str:
    """The source line with the mutant of an entry in it."""
    text, start = (package / entry["file"]).read_bytes(), entry["start"]
    before, after = text[:start].decode(), entry["new"] + text[entry["end"] :].decode()
    return before.rpartition("\n")[2].lstrip() + after.partition("\n")[0]


def identity(entry: dict) -> tuple:
    """What makes a mutant the same in another run: place, and what is replaced by what."""
    return entry["file"], entry["line"], entry["start"], entry["old"], entry["new"]


def summarise(record: dict) -> None:
    """Fill in how many mutants were tried, found, and not found because they are none: `EQUIVALENT`."""
    for entry in record["mutants"]:
        if not entry["found"]:
            entry["equivalent"] = EQUIVALENT.get((entry["file"], mutated_line(entry, ROOT / "deep_contact")))
    for name in ("automatic", "planted"):
        entries = [e for e in record["mutants"] if e["kind"].startswith("planted") == (name == "planted")]
        found, equivalent, late = (
            sum(bool(e.get(key)) for e in entries) for key in ("found", "equivalent", "survived_before")
        )
        record[name] = {"tried": len(entries), "found": found, "equivalent": equivalent, "survived_at_first": late}


def write_record(path: Path, record: dict) -> None:
    """Write the record in one move."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with results.replacing(path) as temporary:
        temporary.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=80, help="automatic mutants (80)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "data" / "reference" / "mutants.json")
    parser.add_argument("--resume", action="store_true", help="keep what --out has, and try the rest")
    parser.add_argument("--again", type=Path, help="only the mutants that survived in this record")
    parser.add_argument("--tests", nargs="+", default=[], help="these alone, such as those written for the survivors")
    parser.add_argument("--list", action="store_true", help="only print the mutants")
    given = parser.parse_args(arguments)
    if given.mutants < 0 or given.jobs < 1:
        parser.error("expected --mutants >= 0 and --jobs >= 1")
    package = ROOT / "deep_contact"
    mutants = [planted_mutant(planted, package) for planted in PLANTED] + choose(package, given.mutants, given.seed)
    if given.again:
        survived = {identity(e) for e in json.loads(given.again.read_text())["mutants"] if not e["found"]}
        mutants = [mutant for mutant in mutants if identity(asdict(mutant)) in survived]
    if given.list:
        for mutant in sorted(mutants, key=lambda mutant: (mutant.file, mutant.start)):
            print(f"{mutant.file}:{mutant.line} {mutant.function}: {mutant.kind}: {mutant.old!r} -> {mutant.new!r}")
        return 0
    record = {"seed": given.seed, "provenance": results.provenance(seed=given.seed), "tests": TESTS, "mutants": []}
    if given.resume and given.out.exists():
        record["mutants"] = json.loads(given.out.read_text())["mutants"]
        summarise(record)
    run(mutants, jobs=given.jobs, record=record, path=given.out, tests=given.tests)
    summarise(record)
    for entry in record["mutants"]:
        word = "found" if entry["found"] else "SURVIVED"
        print(f"{word:9}{entry['file']}:{entry['line']} {entry['kind']}: {entry['old']!r} -> {entry['new']!r}  "
              f"{entry['by'] or entry.get('equivalent') or ''}")  # fmt: skip
    print(f"automatic: {record['automatic']}, planted: {record['planted']}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
