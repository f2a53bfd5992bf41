"""Mutation testing: how many small faults in the physics, or in the files that are named, the tests find.

    python tests/tools/mutate.py [--mutants 100] [--seed 0] [--jobs 2] [--out data/reference/mutants.json]
    python tests/tools/mutate.py analysis/exact.py=tests/analysis/test_exact.py,… 'io/*.py=tests/io' … --out …

Cosmic Ray makes the mutants. The sample takes from every file by its share of places, and one fault in each place.
Every mutant is tried in a copy of the package, by the tests of its folder, those of behaviour and the golden runs, or
by the tests that are named with its file, or with a pattern of files. A mutant whose tests run out of time counts as
killed. With the hash of a commit as seed, nobody has chosen the mutants.

The record is written after every mutant. Another run keeps the mutants that were killed, and the survivors whose entry
`explained` says why they cannot be told from the original. It tries all others.
"""

import argparse
import json
import random
import re
import shutil
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from time import perf_counter

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from cosmic_ray.testing import run_tests

from deep_contact.figures import results
from deep_contact.io.files import replacing
from deep_contact.parallel import progress_bar

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = "stepping", "solvers", "starts", "analysis", "sph"
"""Those of the package from which mutants are drawn where no files are named."""
TESTS = f"{' '.join(f'tests/{folder}' for folder in FOLDERS)} tests/behaviour tests/test_golden.py"
LIMIT_S = 900
"""Seconds that the tests of a mutant may take."""
SKIPPED = re.compile(r"Decorator|Exception|Variable|BitOr_|_(.Shift|Bit\w+|Is|IsNot)$")
"""Operators that change nothing (`njit` removed), need arguments, or that any test finds (`<<` between floats)."""
OPERATORS = {name: get_operator(name)() for name in operator_names() if not SKIPPED.search(name)}
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)


def draw(count: int, seed: int | str, files: Iterable[str] = ()) -> dict[str, dict]:
    """`count` mutants, in random order, by a name without line numbers, which change with every edit."""
    folders = (ROOT / "deep_contact" / name for name in FOLDERS)
    named = [ROOT / file for file in files]
    places = defaultdict(lambda: defaultdict(list))
    for path in sorted(named or (path for folder in folders for path in folder.rglob("*.py"))):
        nodes = list(ast_nodes(get_ast(path.read_text(encoding="utf-8"))))
        for name, operator in OPERATORS.items():
            found = ((node, start) for node in nodes for start, _ in operator.mutation_positions(node))
            for occurrence, (node, start) in enumerate(found):
                around = node.search_ancestor("funcdef", "raise_stmt", "parameters", "annassign")
                if around is not None and around.type == "funcdef":
                    places[path][start].append((name, occurrence, around.name.value))
    total, drawn = sum(map(len, places.values())), []
    for path, of_file in places.items():
        source = path.read_text(encoding="utf-8")
        rng = random.Random(f"{seed} {path.relative_to(ROOT)}")  # a change in one file keeps the mutants of the others
        for start in rng.sample(sorted(of_file), min(len(of_file), 1 + count * len(of_file) // total)):
            operator, occurrence, function = rng.choice(of_file[start])
            changed = mutate_code(source, OPERATORS[operator], occurrence)
            old, new = (text.splitlines()[start[0] - 1].strip() for text in (source, changed))
            mutant = {"file": str(path.relative_to(ROOT)), "line": start[0], "operator": operator}
            mutant |= {"occurrence": occurrence, "old": old, "new": new}
            drawn.append((f"{mutant['file']}, {function}: {old} -> {new}", mutant))
    return dict(random.Random(seed).sample(drawn, min(count, len(drawn))))


def run_pytest(folder: Path, tests: str, limit: float) -> tuple[str, str]:
    """Run tests in a copy; "killed" or "survived", and the output. With CI set, Hypothesis has fixed examples."""
    pytest = f"{sys.executable} -m pytest -p no:cacheprovider --tb=no -rfE -x {tests}"
    return run_tests(f'sh -c "cd {folder} && PYTHONPATH={folder} OMP_NUM_THREADS=1 CI=1 exec {pytest}"', limit)


def try_mutant(mutant: dict, tests: str, folder: Path) -> dict:
    """Run the tests of a mutant in a copy. Returns its entry in the record."""
    source, begin, path = (ROOT / mutant["file"]).read_text(encoding="utf-8"), perf_counter(), folder / mutant["file"]
    path.write_text(mutate_code(source, OPERATORS[mutant["operator"]], mutant["occurrence"]), encoding="utf-8")
    outcome, output = run_pytest(folder, tests, LIMIT_S)
    path.write_text(source, encoding="utf-8")
    by = None if outcome == "survived" else (FAILED.findall(output) or [output[-200:]])[0]
    return {**mutant, "outcome": outcome, "by": by, "seconds": round(perf_counter() - begin, 1), "explained": None}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", metavar="FILE=TEST,…", nargs="*", help="default: all of FOLDERS, by TESTS")
    parser.add_argument("--mutants", type=int, default=100)
    number_or_text = lambda text: int(text) if text.isdecimal() else text  # noqa: E731
    parser.add_argument("--seed", type=number_or_text, default=0, help="a number, or the hash of a commit")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "data" / "reference" / "mutants.json")
    given = parser.parse_args()
    split = (text.partition("=") for text in given.files)
    named = {
        str(path.relative_to(ROOT)): tests.replace(",", " ")
        for pattern, _, tests in split
        for path in sorted((ROOT / "deep_contact").glob(pattern))
    }
    mutants, folders = draw(given.mutants, given.seed, named), SimpleQueue()
    stored = json.loads(given.out.read_text())["mutants"] if given.out.exists() else {}
    kept = {name for name, found in stored.items() if found["outcome"] == "killed" or found["explained"]}
    done = {name: stored[name] | mutants[name] for name in mutants if name in kept}
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(given.jobs) as pool:
        folder = Path(temporary) / "0"
        for part in ("deep_contact", "tests", "scripts", "models", "data"):
            shutil.copytree(ROOT / part, folder / part)
        shutil.copy(ROOT / "setup.cfg", folder)
        tests = dict.fromkeys(" ".join(named.values()).split())
        outcome, output = run_pytest(folder, " ".join(tests) or TESTS, 4 * LIMIT_S)
        if outcome == "killed":
            raise SystemExit(f"expected tests that pass without a mutant, got {FAILED.findall(output) or output}")
        folders.put(folder)
        for job in range(1, given.jobs):  # with the compiled code of what does not change
            folders.put(shutil.copytree(folder, Path(temporary) / str(job)))

        def try_one(name: str) -> tuple[str, dict]:
            file, folder = mutants[name]["file"], folders.get()
            tests = named.get(file, f"tests/{Path(file).parts[1]} tests/behaviour tests/test_golden.py")
            try:
                return name, try_mutant(mutants[name], tests, folder)
            finally:
                folders.put(folder)

        waiting = [name for name in mutants if name not in done]
        for name, entry in progress_bar(pool.map(try_one, waiting), total=len(waiting), text="mutants"):
            done[name] = entry
            counts = Counter(found["outcome"] for found in done.values())
            record = {"tried": len(done), **counts, "provenance": results.provenance(seed=given.seed), "mutants": done}
            with replacing(given.out) as path:
                path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
