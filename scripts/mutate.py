"""Mutation testing: how many small faults in `physics/` and `sph/` the tests find.

    python scripts/mutate.py [--mutants 100] [--seed 0] [--jobs 2] [--out data/reference/mutants.json]

Cosmic Ray makes the mutants. The sample takes from every file by its share of places, and one fault in each place.
Every mutant is tried in a copy of the package: first without the compiler, by the tests that execute the mutated line,
the quickest first; if it survives, compiled, by all tests of its folder. Running out of time kills it, too.

The record is written after every mutant, and a stopped run goes on where it ended; `--again` tries the survivors again.
`explained` says why a survivor cannot be told from the original: it is filled in by hand, and kept.
"""

import argparse
import json
import random
import re
import shutil
import sys
import tempfile
from bisect import bisect
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate
from pathlib import Path
from queue import SimpleQueue
from time import perf_counter

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator, operator_names
from cosmic_ray.testing import run_tests
from cosmic_ray.work_item import TestOutcome
from coverage import CoverageData

from deep_contact.reporting import results
from deep_contact.reporting.figures import progress_bar

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("physics", "sph")
TESTS = "tests/physics tests/sph tests/test_state.py tests/test_warm_start.py"
COVERAGE = " ".join(f"--cov=deep_contact/{folder}" for folder in FOLDERS) + " --cov-context=test --cov-report="
TEST_S, TESTS_S, COMPILED_S = 10.0, 40.0, 900.0
"""Limits without the compiler, of one test and of all tests of a mutant; limit of the compiled tests of a mutant."""
SKIPPED = re.compile(r"Decorator|Exception|Variable|BitOr_|_(.Shift|Bit\w+|Is|IsNot)$")
"""Operators that change nothing (`njit` removed), need arguments, or that any test finds (`<<` between floats)."""
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
SWAPS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor"}


class SwapCall(Operator):
    """`min` for `max` and the like, which Cosmic Ray does not have."""

    examples = None

    def mutation_positions(self, node):
        if node.type == "name" and node.value in SWAPS and node.get_next_leaf().value == "(":
            yield node.start_pos, node.end_pos

    def mutate(self, node, index):
        node.value = SWAPS[node.value]
        return node


OPERATORS = {name: get_operator(name)() for name in operator_names() if not SKIPPED.search(name)} | {"swap": SwapCall()}


def draw(count: int, seed: int) -> list[dict]:
    """`count` mutants, in random order."""
    rng, places = random.Random(seed), defaultdict(lambda: defaultdict(list))
    for file in sorted(file for folder in FOLDERS for file in (ROOT / "deep_contact" / folder).rglob("*.py")):
        nodes = list(ast_nodes(get_ast(file.read_text(encoding="utf-8"))))
        for name, operator in OPERATORS.items():
            found = ((node, start) for node in nodes for start, _ in operator.mutation_positions(node))
            for occurrence, (node, start) in enumerate(found):
                around = node.search_ancestor("funcdef", "raise_stmt", "param", "annassign")
                if around is not None and around.type == "funcdef":
                    places[file][start].append((name, occurrence, around.name.value))
    total, drawn = sum(map(len, places.values())), []
    for file, of_file in places.items():
        source = file.read_text(encoding="utf-8")
        for line, column in rng.sample(sorted(of_file), min(len(of_file), 1 + count * len(of_file) // total)):
            operator, occurrence, function = rng.choice(of_file[line, column])
            changed = mutate_code(source, OPERATORS[operator], occurrence)
            old, new = (text.splitlines()[line - 1].strip() for text in (source, changed))
            place = {"file": str(file.relative_to(ROOT)), "line": line, "function": function, "operator": operator}
            drawn.append({**place, "occurrence": occurrence, "old": old, "new": new})
    return rng.sample(drawn, min(count, len(drawn)))


def run_pytest(folder: Path, arguments: str, limit: float, *, compiled: bool) -> tuple[TestOutcome, str]:
    """Run tests in a copy. With CI set, Hypothesis tries the same examples every time."""
    pytest = f"{sys.executable} -m pytest -p no:cacheprovider --tb=no -rfE {arguments}"
    environment = f"PYTHONPATH={folder} OMP_NUM_THREADS=1 CI=1 NUMBA_DISABLE_JIT={int(not compiled)}"
    return run_tests(f'sh -c "cd {folder} && {environment} exec {pytest}"', limit)


def tests_of_lines(folder: Path) -> dict[tuple[str, int], list[str]]:
    """(File, line) -> tests that execute it without the compiler and pass; the quickest first, as many as fit."""
    output = run_pytest(folder, f"{TESTS} --timeout {TEST_S} {COVERAGE} --durations 0 -vvv", 7200, compiled=False)[1]
    seconds = {test: float(time) for time, test in re.findall(r"^([\d.]+)s call +(.+)$", output, re.MULTILINE)}
    for test in FAILED.findall(output):
        seconds.pop(test, None)
    data, tests = CoverageData(str(folder / ".coverage")), {}
    data.read()
    for file in data.measured_files():
        for line, contexts in data.contexts_by_lineno(file).items():
            names = sorted({name.removesuffix("|run") for name in contexts} & seconds.keys(), key=seconds.get)
            fitting = bisect(list(accumulate(map(seconds.get, names))), TESTS_S)
            tests[str(Path(file).relative_to(folder)), line] = names[:fitting]
    return tests


def try_mutant(mutant: dict, folder: Path, tests: list[str]) -> dict:
    """Run the tests of a mutant in a copy. Returns its entry in the record."""
    source, begin = (ROOT / mutant["file"]).read_text(encoding="utf-8"), perf_counter()
    path, output = folder / mutant["file"], ""
    path.write_text(mutate_code(source, OPERATORS[mutant["operator"]], mutant["occurrence"]), encoding="utf-8")
    (folder / "tests.txt").write_text("\n".join(tests))
    outcome = TestOutcome.SURVIVED
    if tests:
        outcome, output = run_pytest(folder, "-x @tests.txt", 60 + 3 * TESTS_S, compiled=False)
    if compiled := outcome == TestOutcome.SURVIVED:
        outcome, output = run_pytest(folder, f"-x tests/{path.parts[-2]}", COMPILED_S, compiled=True)
    path.write_text(source, encoding="utf-8")
    failed = FAILED.search(output)
    by = failed[1] if failed else None if outcome == TestOutcome.SURVIVED else output[-200:]
    return {**mutant, "outcome": outcome.value, "by": by, "compiled": compiled, "seconds": perf_counter() - begin}


def identity(mutant: dict) -> tuple[str, ...]:
    """What makes a mutant the same in another run, whatever its line number."""
    return tuple(mutant[name] for name in ("file", "function", "old", "new"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "data" / "reference" / "mutants.json")
    parser.add_argument("--again", action="store_true", help="try survivors again that have no explanation")
    given = parser.parse_args()
    mutants = {identity(mutant): mutant for mutant in draw(given.mutants, given.seed)}
    stored = json.loads(given.out.read_text())["mutants"] if given.out.exists() else []
    done = {key: entry | mutants[key] for entry in stored if (key := identity(entry)) in mutants
            and not (given.again and entry["outcome"] == "survived" and not entry["explained"])}  # fmt: skip
    folders, waiting = SimpleQueue(), [mutant for key, mutant in mutants.items() if key not in done]
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(given.jobs) as pool:
        for job in range(given.jobs):
            folder = Path(temporary) / str(job)
            for name in ("deep_contact", "tests", "scripts"):
                shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
            shutil.copy(ROOT / "setup.cfg", folder)
            folders.put(folder)
        tests = tests_of_lines(folder)

        def in_free_folder(mutant: dict) -> dict:
            folder = folders.get()
            entry = try_mutant(mutant, folder, tests.get((mutant["file"], mutant["line"]), []))
            folders.put(folder)
            return entry | {"explained": None}

        for entry in progress_bar(pool.map(in_free_folder, waiting), total=len(waiting), text="mutants"):
            done[identity(entry)] = entry
            counts = Counter(found["outcome"] for found in done.values())
            record = {"seed": given.seed, "provenance": results.provenance(seed=given.seed), "tried": len(done),
                      **counts, "mutants": list(done.values())}  # fmt: skip
            with results.replacing(given.out) as path:
                path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
