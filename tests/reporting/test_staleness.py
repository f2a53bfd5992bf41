"""What makes a stored result old, and what does not; and that the site says so."""

import ast
import sys

import pytest
from conftest import load_script

from deep_contact.io.shipped import ROOT
from deep_contact.reporting import staleness
from deep_contact.reporting.staleness import DRAWN

sys.path.insert(0, str(ROOT / "docs"))
import tables

FILES = {
    "deep_contact/__init__.py": "if TYPE_CHECKING:\n    from deep_contact.engine import sweep\n",
    "deep_contact/engine.py": "from deep_contact import rows\n\ndef sweep(x):\n    return rows.preprocess(x) + 1\n",
    "deep_contact/rows.py": "TABLE = 'runs.json'\n\ndef preprocess(x):\n    return 2 * x\n",
    "deep_contact/reference/runs.json": "[1]",
    "deep_contact/reporting/plotting.py": "COLOUR = 'blue'\n",
    "deep_contact/studies/piles.py": "N = 3\n\ndef table(data):\n    return data\n",
    "scripts/figure_9_1.py": """
import deep_contact as dc
from deep_contact.reporting import plotting
from deep_contact.studies import piles

COLOURS = [plotting.COLOUR]

def compute(options):
    return dc.sweep(table(options))

def table(options):
    return piles.N

def draw(data, options):
    return COLOURS

FIGURE = Figure("9.1", "Title", compute, None, draw, options={"n": 3})
""",
    "tests/tools/golden.py": "import deep_contact as dc\n\nRUN = dc.sweep\n",
    "data/reference/golden.json": '{"runs": {"pile": {"sha256": "a"}}, "extends": ["b"]}',
}
SCRIPT, ENGINE, STUDY = "scripts/figure_9_1.py", "deep_contact/engine.py", "deep_contact/studies/piles.py"


@pytest.fixture
def changed(tmp_path, monkeypatch):
    """A function: the reason why a reference is old after a change of a text in a file."""
    monkeypatch.setattr(staleness, "processor", lambda: "ours")

    def write(file, text):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
        for cached in (
            staleness.code,
            staleness._parsed,
            staleness._digest_of,
            staleness._imported_by,
            staleness.golden,
        ):
            cached.cache_clear()

    for file, text in FILES.items():
        write(file, text)
    made = staleness.code(tmp_path / SCRIPT, tmp_path) | {"golden": staleness.golden(tmp_path)[0], "cpu": "ours"}

    def why(file, old, new, is_time=False, **more):
        assert old in FILES[file]
        write(file, FILES[file].replace(old, new))
        found = staleness.reason(made | more, tmp_path / SCRIPT, is_time=is_time, root=tmp_path)
        write(file, FILES[file])
        return found

    return why


@pytest.mark.parametrize("is_time", [False, True])
def test_neither_docstrings_nor_comments_make_a_result_old(changed, is_time):
    assert changed(ENGINE, "(x):\n", '(x):\n    """Says more."""\n    # and why\n', is_time) == ""


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        (SCRIPT, "return COLOURS", "return None"),
        (SCRIPT, "COLOURS = [plotting.COLOUR]", "COLOURS = [1]"),
        (SCRIPT, "Title", "Another title"),
        ("deep_contact/reporting/plotting.py", "blue", "red"),
    ],
)
def test_what_is_drawn_otherwise_has_true_numbers(changed, file, old, new):
    assert changed(file, old, new) == changed(file, old, new, is_time=True) == DRAWN


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        (STUDY, "3", "4"),
        (STUDY, "return data", "return 0.5 * data"),  # in a function that is called table
        (SCRIPT, "return piles.N", "return 0.5 * piles.N"),
        (SCRIPT, '"n": 3', '"n": 4'),
        (SCRIPT, "dc.sweep(", "2 * dc.sweep("),
    ],
)
def test_another_study_makes_a_result_old(changed, file, old, new):
    assert changed(file, old, new) == f"{file} changed"


@pytest.mark.parametrize("file", [ENGINE, "deep_contact/rows.py"])
def test_another_sweep_makes_a_time_old_and_the_rest_unless_the_golden_runs_are_those_of_then(changed, file):
    """Also in a function whose name contains "repr", which was once taken for text."""
    change = (file, "return", "return 1 *")
    assert changed(*change, is_time=True) == f"{file} changed"
    assert changed(*change) == changed(*change, golden="b") == ""
    assert changed(*change, golden="c") == f"{file} changed"


def test_a_module_that_is_gone_makes_times_alone_old(changed, tmp_path):
    code = staleness.code(tmp_path / SCRIPT, tmp_path)["code"] | {"deep_contact/gone.py": "0" * 16}
    assert changed(SCRIPT, "", "", code=code) == ""
    assert changed(SCRIPT, "", "", code=code, is_time=True) == "deep_contact/gone.py changed"
    assert changed(SCRIPT, "", "", code=code, golden="c") == "deep_contact/gone.py changed"


def test_another_table_of_presets_makes_a_result_old(changed):
    table = "deep_contact/reference/runs.json"
    assert changed(table, "1", "2") == f"{table} changed"


def test_another_input_or_processor_makes_a_result_old(changed, monkeypatch):
    same = SCRIPT, "", ""
    assert changed(*same, inputs={"models/model.h5": "0" * 64}) == "models/model.h5 has changed"
    monkeypatch.setattr(staleness, "processor", lambda: "theirs")
    assert (changed(*same), changed(*same, is_time=True)) == ("", "measured on ours, the others on theirs")


def test_a_script_counts_what_it_runs():
    files = {name: staleness.code(path)["code"] for name, (path, *_) in staleness.commands().items()}
    assert "deep_contact/physics/solvers/pgs.py" in files["figure_5_7"]
    assert "deep_contact/reference/runs.json" in files["table_6_4"]
    assert "deep_contact/parallel.py" in files["figure_4_4"]  # which draws its seeds
    assert not any("physics" in file for file in files["figure_3_3"])
    assert not any("reporting" in file for found in files.values() for file in found)


def test_stale_lists_what_is_old_once_and_the_pages_show_it(monkeypatch, capsys):
    whys = {"figure_6_1": "why", "figure_3_3": DRAWN}
    monkeypatch.setattr(staleness, "why_old", lambda name: whys.get(name, ""))
    all_figures = load_script("all_figures")
    assert all_figures.main(["--stale"]) == 0
    assert [line.partition(",")[0] for line in capsys.readouterr().out.splitlines()] == ["figure_3_3", "figure_6_1"]
    made = []
    monkeypatch.setattr(all_figures, "timed", lambda command: (made.append(command), (0, 0.0))[1])
    assert all_figures.main(["--references"]) == 0
    assert [script.stem for script, *_ in made] == ["figure_3_3_kernels", "figure_6_1_trade", "tables"]
    assert ["--replot" in command for command in made] == [True, False, False]
    capsys.readouterr()
    for page, is_old in (("accuracy.md", True), ("starts.md", False)):
        shown = tables.old_on(page, (ROOT / "docs" / page).read_text(encoding="utf-8"))
        assert ("<code>figure_6_1</code>: why" in shown) == bool(shown) == is_old
    monkeypatch.setattr(staleness, "why_old", lambda name: "")
    assert all_figures.main(["--stale"]) == 0
    assert capsys.readouterr().out == ""


def test_the_constraints_are_the_versions_that_made_the_results():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    versions = dict(line.split("==") for line in lines if "==" in line)
    for name in staleness.commands():
        assert versions.items() >= staleness.made(name)["packages"].items(), name


def test_numbers_come_from_what_compute_needs_directly_or_not():
    """Not from what draws, nor from what nothing needs."""
    lines = [
        "from package import solve",
        "X = 1",
        "def helper(): return solve(X)",
        "def compute(): return helper()",
        "COLOUR = 2",
        "def draw(): return COLOUR",
        "FIGURE = Figure('1.1', 'title', compute, None, draw)",
    ]
    needed = [ast.unparse(one) for one in staleness._needed(ast.parse("\n".join(lines)).body)]
    assert [one.splitlines()[0] for one in needed[:-1]] == [line.split(" return")[0] for line in lines[:4]]
    assert "draw" not in needed[-1]
