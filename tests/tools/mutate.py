"""Mutation testing: how many small faults in `physics/` and `sph/`, or in the files that are named, the tests find.

    python tests/tools/mutate.py [--mutants 100] [--seed 0] [--jobs 2] [--out data/reference/mutants.json]
    python tests/tools/mutate.py physics/exact.py=tests/physics/test_exact.py,… … --out …

Cosmic Ray makes the mutants. The sample takes from every file by its share of places, and one fault in each place.
Every mutant is tried in a copy of the package: first without the compiler, by the tests that execute the mutated line,
the quickest first; if it survives, compiled, by all tests of its folder, or by those that are named with its file.
Running out of time kills it, too.

The record is written after every mutant. Another run keeps what was killed there, and the survivors under `explained`
of which somebody has written why they cannot be told from the original; it tries the others.
"""

import argparse
import json
import random
import re
import shutil
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from time import perf_counter

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from cosmic_ray.testing import run_tests
from coverage import CoverageData

from deep_contact.io.files import replacing
from deep_contact.reporting import results
from deep_contact.reporting.figures import progress_bar

ROOT = Path(__file__).resolve().parents[2]
LATE = """
physics/exact.py=tests/physics/test_exact.py
physics/proximal_path.py=tests/physics/test_exact.py
physics/matrix_solvers.py=tests/physics/test_matrix_solvers.py,tests/physics/test_exact.py
physics/islands.py=tests/physics/test_islands.py
physics/sleeping.py=tests/physics/test_sleeping.py
physics/segments.py=tests/physics/test_segments.py,tests/physics/test_surfaces.py
physics/continuous.py=tests/physics/test_continuous.py,tests/physics/test_segments.py
presets.py=tests/test_presets.py,tests/test_stiffness.py
compiled/code_cache.py=tests/compiled/test_code_cache.py
compiled/team.py=tests/compiled/test_team.py,tests/physics/solvers/test_batched.py
compiled/simd.py=tests/cnn/test_convolution.py,tests/physics/solvers/test_batched.py
cnn/convolution.py=tests/cnn/test_convolution.py
cnn/far_field.py=tests/cnn/test_far_field.py,tests/cnn/test_convolution.py
cnn/inference.py=tests/cnn/test_far_field.py,tests/cnn/test_inference.py::test_a_model_says_what_it_is_takes_and_gives
""".split()
"""Modules of which the sample of mutants from all of physics and sph has few or none, and their tests."""

TESTS = "tests/physics tests/sph tests/test_state.py tests/test_warm_start.py"
COVERAGE = "--durations 0 -vvv --timeout 10 --maxfail 10 --cov=deep_contact --cov-context=test --cov-report="
QUICK, INTERPRETED_S, COMPILED_S = 60, 180, 900
"""How many tests run without the compiler; seconds that they may take, and that the compiled tests may take."""
SKIPPED = re.compile(r"Decorator|Exception|Variable|BitOr_|_(.Shift|Bit\w+|Is|IsNot)$")
"""Operators that change nothing (`njit` removed), need arguments, or that any test finds (`<<` between floats)."""
OPERATORS = {name: get_operator(name)() for name in operator_names() if not SKIPPED.search(name)}
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)


def draw(count: int, seed: int, files: Iterable[str] = ()) -> dict[str, dict]:
    """`count` mutants, in random order, by a name without line numbers, which change with every edit."""
    folders = (ROOT / "deep_contact" / name for name in ("physics", "sph"))
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


def run_pytest(folder: Path, arguments: str, limit: float, *, compiled: bool) -> tuple[str, str]:
    """Run tests in a copy; "killed" or "survived", and the output. With CI set, Hypothesis has fixed examples."""
    pytest = f"{sys.executable} -m pytest -p no:cacheprovider --tb=no -rfE {arguments}"
    environment = f"PYTHONPATH={folder} OMP_NUM_THREADS=1 CI=1 NUMBA_DISABLE_JIT={int(not compiled)}"
    return run_tests(f'sh -c "cd {folder} && {environment} exec {pytest}"', limit)


def tests_of_lines(folder: Path, file: str) -> dict[tuple[str, int], dict[str, float]]:
    """(Source file, line) -> tests of a file that execute it and pass without the compiler, and their times, s.

    A file of tests has a process of its own: pytest-timeout can end pytest itself, without times and lines.
    """
    _, output = run_pytest(folder, f"{file} {COVERAGE}", 7200, compiled=False)
    seconds = {test: float(time) for time, test in re.findall(r"^([\d.]+)s call +(.+)$", output, re.MULTILINE)}
    passed, data, of_lines = seconds.keys() - FAILED.findall(output), CoverageData(str(folder / ".coverage")), {}
    data.read()
    for path in data.measured_files() if passed else ():
        for line, contexts in data.contexts_by_lineno(path).items():
            found = passed & {name.removesuffix("|run") for name in contexts}
            of_lines[str(Path(path).relative_to(folder)), line] = {test: seconds[test] for test in found}
    return of_lines


def files_of(tests: str) -> list[str]:
    """The files of tests that folders, files and single tests name; a single test is as good as a file."""
    paths = [ROOT / name for name in tests.split()]
    files = ((path.rglob("test_*.py") if path.is_dir() else [path]) for path in paths)
    return [str(file.relative_to(ROOT)) for of_path in files for file in sorted(of_path)]


def try_mutant(mutant: dict, folder: Path, of_line: list[str], tests: str) -> dict:
    """Run the tests of a mutant's line, then `tests`, in a copy. Returns its entry in the record."""
    source, begin = (ROOT / mutant["file"]).read_text(encoding="utf-8"), perf_counter()
    path, outcome, output = folder / mutant["file"], "survived", ""
    path.write_text(mutate_code(source, OPERATORS[mutant["operator"]], mutant["occurrence"]), encoding="utf-8")
    if of_line:
        (folder / "tests.txt").write_text("\n".join(of_line))
        outcome, output = run_pytest(folder, "-x @tests.txt", INTERPRETED_S, compiled=False)
    if compiled := outcome == "survived":
        outcome, output = run_pytest(folder, f"-x {tests}", COMPILED_S, compiled=True)
    path.write_text(source, encoding="utf-8")
    by = None if outcome == "survived" else (FAILED.findall(output) or [output[-200:]])[0]
    found = {"outcome": outcome, "by": by, "compiled": compiled, "seconds": round(perf_counter() - begin, 1)}
    return {**mutant, **found, "explained": None}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", metavar="FILE=TEST,…", nargs="*", help="default: all of physics and sph, by TESTS")
    parser.add_argument("--late", action="store_true", help="the files and tests of LATE")
    parser.add_argument("--mutants", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "data" / "reference" / "mutants.json")
    given = parser.parse_args()
    split = (text.partition("=") for text in (LATE if given.late else given.files))
    named = {f"deep_contact/{file}": tests.replace(",", " ") for file, _, tests in split}
    all_tests = " ".join(dict.fromkeys(" ".join(named.values()).split())) or TESTS
    mutants, folders = draw(given.mutants, given.seed, named), SimpleQueue()
    stored = json.loads(given.out.read_text())["mutants"] if given.out.exists() else {}
    kept = {name for name, found in stored.items() if found["outcome"] == "killed" or found["explained"]}
    done = {name: stored[name] | mutants[name] for name in mutants if name in kept}
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(given.jobs) as pool:
        folder = Path(temporary) / "0"
        for part in ("deep_contact", "tests", "scripts", "models"):
            shutil.copytree(ROOT / part, folder / part)
        shutil.copy(ROOT / "setup.cfg", folder)
        outcome, output = run_pytest(folder, f"-x {all_tests}", 4 * COMPILED_S, compiled=True)
        if outcome == "killed":
            raise SystemExit(f"expected tests that pass without a mutant, got {FAILED.findall(output) or output}")
        folders.put(folder)
        for job in range(1, given.jobs):  # with the compiled code of what does not change
            folders.put(shutil.copytree(folder, Path(temporary) / str(job)))
        of_lines = defaultdict(dict)

        def in_free_folder(function: Callable, *given):
            folder = folders.get()
            try:
                return function(folder, *given)
            finally:
                folders.put(folder)

        def try_one(folder: Path, name: str) -> tuple[str, dict]:
            mutant = mutants[name]
            seconds = of_lines[mutant["file"], mutant["line"]]
            of_file = named.get(mutant["file"], f"tests/{Path(mutant['file']).parts[1]}")
            return name, try_mutant(mutant, folder, sorted(seconds, key=seconds.get)[:QUICK], of_file)

        files = files_of(all_tests)
        mapped = pool.map(partial(in_free_folder, tests_of_lines), files)
        for found in progress_bar(mapped, total=len(files), text="lines of tests"):
            for place, seconds in found.items():
                of_lines[place] |= seconds
        if not of_lines:
            raise SystemExit("expected tests that pass without the compiler, got none")
        waiting = [name for name in mutants if name not in done]
        tried = pool.map(partial(in_free_folder, try_one), waiting)
        for name, entry in progress_bar(tried, total=len(waiting), text="mutants"):
            done[name] = entry
            counts = Counter(found["outcome"] for found in done.values())
            record = {"tried": len(done), **counts, "provenance": results.provenance(seed=given.seed), "mutants": done}
            with replacing(given.out) as path:
                path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
