"""What makes a stored result old, and what does not; and that the site says so."""

import sys

import pytest
from conftest import load_script

from deep_contact.io import sources
from deep_contact.io.shipped import ROOT
from deep_contact.reporting import references

sys.path.insert(0, str(ROOT / "docs"))
import tables

FILES = {
    "deep_contact/__init__.py": "if TYPE_CHECKING:\n    from deep_contact.engine import sweep\n",
    "deep_contact/engine.py": """from deep_contact import rows

def sweep(x):
    if x < 0:
        raise ValueError("x")
    return rows.of(x) + 1
""",
    "deep_contact/rows.py": "TABLE = 'runs.json'\n\ndef of(x):\n    return 2 * x\n",
    "deep_contact/reference/runs.json": "[1]",
    "deep_contact/other.py": "n = 1\n",
    "deep_contact/studies/piles.py": "N = 3\n\ndef draw(data):\n    pass\n",
    "scripts/figure_9_1.py": """
import deep_contact as dc
from deep_contact import other
from deep_contact.studies import piles

COLOURS = [other.n]

def compute(options):
    return dc.sweep(piles.N)

def draw(data, options):
    return COLOURS

FIGURE = Figure("9.1", "Title", compute, None, draw, options={"n": 3})
""",
    "tests/tools/golden.py": "import deep_contact as dc\n\nRUN = dc.sweep\n",
    "data/reference/golden.json": '{"runs": {"pile": {"sha256": "a"}}, "extends": ["b"]}',
}
SCRIPT, ENGINE, STUDY = "scripts/figure_9_1.py", "deep_contact/engine.py", "deep_contact/studies/piles.py"


@pytest.fixture
def changed(tmp_path):
    """A function: the reason why a reference is old after a change of a text in a file."""

    def write(file, text):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
        for cached in (sources.code, sources._read, sources.golden):
            cached.cache_clear()

    for file, text in FILES.items():
        write(file, text)
    made = {"code": sources.code(tmp_path / SCRIPT, tmp_path), "golden": sources.golden(tmp_path)[0], "cpu": "ours"}

    def why(file, old, new, is_time=False, **more):
        assert old in FILES[file]
        write(file, FILES[file].replace(old, new))
        found = references.reason(made | more, tmp_path / SCRIPT, is_time=is_time, root=tmp_path)
        write(file, FILES[file])
        return found

    return why


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        (ENGINE, "def sweep(x):\n", 'def sweep(x):\n    """Says more."""\n    # and why\n'),
        (ENGINE, 'ValueError("x")', 'ValueError("x: expected a number")'),
        (STUDY, "pass", "return 1"),
        (SCRIPT, "return COLOURS", "return None"),
        (SCRIPT, "COLOURS = [other.n]", "COLOURS = [1]"),
        (SCRIPT, "Title", "Another title"),
        ("deep_contact/other.py", "1", "2"),
    ],
)
def test_neither_docstrings_nor_drawings_make_a_result_old(changed, file, old, new, monkeypatch):
    monkeypatch.setattr(references, "processor", lambda: "ours")
    assert changed(file, old, new) == changed(file, old, new, is_time=True) == ""


@pytest.mark.parametrize(
    ("file", "old", "new"), [(STUDY, "3", "4"), (SCRIPT, '"n": 3', '"n": 4'), (SCRIPT, "dc.sweep(", "2 * dc.sweep(")]
)
def test_another_study_makes_a_result_old(changed, file, old, new):
    assert changed(file, old, new) == f"{file} changed"


@pytest.mark.parametrize("file", [ENGINE, "deep_contact/rows.py"])
def test_another_sweep_makes_a_time_old_and_the_rest_unless_the_golden_runs_are_those_of_then(changed, file):
    change = (file, "return", "return 1 *")
    assert changed(*change, is_time=True) == f"{file} changed"
    assert changed(*change) == changed(*change, golden="b") == ""
    assert changed(*change, golden="c") == f"{file} changed"


def test_a_module_that_is_gone_makes_times_alone_old(changed, tmp_path):
    code = sources.code(tmp_path / SCRIPT, tmp_path) | {"deep_contact/gone.py": "0" * 16}
    assert changed(SCRIPT, "", "", code=code) == ""
    assert changed(SCRIPT, "", "", code=code, is_time=True) == "deep_contact/gone.py changed"
    assert changed(SCRIPT, "", "", code=code, golden="c") == "deep_contact/gone.py changed"


def test_another_table_of_presets_makes_old_what_gives_an_accuracy(changed, tmp_path):
    table = "deep_contact/reference/runs.json"
    assert changed(table, "1", "2") == ""
    (tmp_path / SCRIPT).write_text(FILES[SCRIPT].replace("(piles.N", "(piles.N, accuracy=1"))
    sources._read.cache_clear()
    sources.code.cache_clear()
    assert changed(table, "1", "2", code=sources.code(tmp_path / SCRIPT, tmp_path)) == f"{table} changed"


def test_another_input_or_processor_makes_a_result_old(changed, monkeypatch):
    same = SCRIPT, "", ""
    assert changed(*same, inputs={"models/model.h5": "0" * 64}) == "models/model.h5 has changed"
    monkeypatch.setattr(references, "processor", lambda: "theirs")
    assert (changed(*same), changed(*same, is_time=True)) == ("", "measured on ours, the others on theirs")


def test_a_script_counts_what_it_runs():
    files = {name: sources.code(path) for name, (path, *_) in references.commands().items()}
    assert "deep_contact/physics/solvers/pgs.py" in files["figure_5_7"]
    presets = "deep_contact/reference/runs.json"
    assert {name for name, found in files.items() if presets in found} == {"figure_6_14", "figure_6_15", "table_6_4"}
    assert presets in sources.code(ROOT / "tests" / "tools" / "golden.py")
    assert not any("physics" in file for file in files["figure_3_3"])
    assert not any("plotting" in file for found in files.values() for file in found)


def test_stale_lists_what_is_old_once_and_the_pages_show_it(monkeypatch, capsys):
    monkeypatch.setattr(references, "why_old", lambda name: "why" * (name in ("figure_6_1", "figure_3_3")))
    all_figures = load_script("all_figures")
    assert all_figures.main(["--stale"]) == 0
    assert [line.partition(",")[0] for line in capsys.readouterr().out.splitlines()] == ["figure_3_3", "figure_6_1"]
    made = []
    monkeypatch.setattr(all_figures, "timed", lambda command: (made.append(command[0].stem), (0, 0.0))[1])
    assert all_figures.main(["--references"]) == 0
    assert made == ["figure_3_3_kernels", "figure_6_1_trade", "tables"]
    capsys.readouterr()
    for page, is_old in (("accuracy.md", True), ("starts.md", False)):
        shown = tables.old_on(page, (ROOT / "docs" / page).read_text(encoding="utf-8"))
        assert ("<code>figure_6_1</code>: why" in shown) == bool(shown) == is_old
    monkeypatch.setattr(references, "why_old", lambda name: "")
    assert all_figures.main(["--stale"]) == 0
    assert capsys.readouterr().out == ""


def test_the_constraints_are_the_versions_that_made_the_results():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    versions = dict(line.split("==") for line in lines if "==" in line)
    for name in references.commands().keys() - references.BY_HAND.keys():
        assert versions.items() >= references.made(name)["packages"].items(), name
