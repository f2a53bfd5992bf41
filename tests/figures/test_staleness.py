"""What makes a stored result old, and what does not; and that the site says so."""

import sys
from pathlib import Path

import pytest
from conftest import load_script

from deep_contact.accuracy import presets
from deep_contact.figures import staleness
from deep_contact.io.shipped import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import tables

FILES = {
    "deep_contact/__init__.py": "if TYPE_CHECKING:\n    from deep_contact.engine import sweep\n",
    "deep_contact/engine.py": "from deep_contact import rows\n\ndef sweep(x):\n    return rows.preprocess(x) + 1\n",
    "deep_contact/rows.py": "TABLE = 'runs.json'\n\ndef preprocess(x):\n    return 2 * x\n",
    "deep_contact/runs.json": "[1]",
    "deep_contact/plot/plotting.py": "COLOUR = 'blue'\n",
    "deep_contact/studies/piles.py": "N = 3\n\ndef table(data):\n    return data\n",
    "deep_contact/studies/others.py": "M = 3\n",
    "scripts/figure_9_1.py": """
import deep_contact as dc
from deep_contact.plot import plotting
from deep_contact.studies import piles

OPTIONS = {"n": 3}

def compute(options):
    return dc.sweep(table(options))

def table(options):
    return piles.N

def draw(data, options):
    return plotting.COLOUR

FIGURE = Figure("9.1", "Title", compute, None, draw, options=OPTIONS)
""",
    "tests/tools/golden.py": "import deep_contact as dc\n\nRUN = dc.sweep\n",
    "data/reference/golden.json": '{"runs": {"pile": {"sha256": "a"}}, "extends": ["b"]}',
}
SCRIPT, ENGINE, STUDY = "scripts/figure_9_1.py", "deep_contact/engine.py", "deep_contact/studies/piles.py"
CACHED = staleness.read, staleness.reached, staleness.everywhere, staleness.made_by, staleness.golden


@pytest.fixture
def old(tmp_path, monkeypatch):
    """A function: the reasons why numbers and times of a script are old after changes of texts and of provenance."""
    monkeypatch.setattr(staleness, "ROOT", tmp_path)
    monkeypatch.setattr(staleness, "processor", lambda: "ours")

    def tree(files):
        for file in tmp_path.rglob("*.*"):
            file.unlink()
        for file, text in files.items():
            (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / file).write_text(text)
        for cached in CACHED:
            cached.cache_clear()

    def reasons(changed=None, **provenance):
        tree(FILES)
        stored = staleness.made_by(tmp_path / SCRIPT) | {"cpu": "ours"} | provenance
        tree({file: text for file, text in (FILES | (changed or {})).items() if text is not None})
        return [staleness.reason(stored, tmp_path / SCRIPT, is_time=is_time) for is_time in (False, True)]

    yield reasons
    for cached in CACHED:
        cached.cache_clear()


def edited(file, before, after):
    """The file with a text replaced."""
    assert before in FILES[file]
    return {file: FILES[file].replace(before, after)}


@pytest.mark.parametrize(
    "changed",
    [
        {},
        edited(ENGINE, "(x):\n", '(x):\n    """Says more."""\n    # and why\n'),
        edited(STUDY, "N = 3", "# circles\nN   =   3"),
        edited("deep_contact/plot/plotting.py", "blue", "red"),
        edited("deep_contact/studies/others.py", "3", "4"),
        edited(SCRIPT, "return plotting.COLOUR", "return None"),
    ],
)
def test_comments_docstrings_drawing_and_what_a_script_does_not_import_make_nothing_old(old, changed):
    assert old(changed) == ["", ""]


def test_moves_make_nothing_old(old):
    """Of a file, of a function to another, and of one into the script."""
    imports = "from deep_contact.stepping import rows\nfrom deep_contact.rows_too import preprocess"
    file = {
        ENGINE: None,
        "deep_contact/stepping/engine.py": FILES[ENGINE].replace("from deep_contact import rows", imports),
    }
    file |= edited("deep_contact/__init__.py", "deep_contact.engine", "deep_contact.stepping.engine")
    text = FILES["deep_contact/rows.py"]
    split = {"deep_contact/rows.py": text[: text.index("def")], "deep_contact/rows_too.py": text[text.index("def") :]}
    split |= edited(ENGINE, "import rows", "import rows, rows_too")
    split[ENGINE] = split[ENGINE].replace("rows.preprocess", "rows_too.preprocess")
    into = edited(SCRIPT, "piles.N", "N") | edited(STUDY, "N = 3\n", "")
    into[SCRIPT] = into[SCRIPT].replace("OPTIONS =", "N = 3\n\nOPTIONS =", 1)
    moved = {"deep_contact/rows.py": None, "deep_contact/stepping/rows.py": text}
    whole = file | moved | edited(ENGINE, "deep_contact", "deep_contact") | {ENGINE: None}
    whole["deep_contact/stepping/engine.py"] = FILES[ENGINE].replace(
        "deep_contact import", "deep_contact.stepping import"
    )
    runs = {"deep_contact/runs.json": None, "deep_contact/stepping/runs.json": "[1]"}
    assert old(whole | runs) == old(split) == old(into) == ["", ""]


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        (edited(STUDY, "N = 3", "N = 4"), "piles.N"),
        (edited(STUDY, "return data", "return 0.5 * data"), "piles.table"),
        (edited(SCRIPT, "return piles.N", "return 0.5 * piles.N"), "figure_9_1.table"),  # which `compute` calls
        (edited(SCRIPT, '"n": 3', '"n": 4'), "figure_9_1.OPTIONS"),
        (edited(SCRIPT, "dc.sweep(", "2 * dc.sweep("), "figure_9_1.compute"),
        (edited(SCRIPT, "OPTIONS =", "MORE = 1\nOPTIONS ="), "figure_9_1.MORE"),
        ({"deep_contact/runs.json": "[2]"}, "runs.json"),
    ],
)
def test_another_script_study_or_table_makes_a_result_old(old, changed, name):
    assert old(changed) == [f"{name} changed"] * 2


def test_a_table_that_a_script_writes_does_not_make_its_own_results_old(old, monkeypatch):
    """The study of runs imports the presets, which read the table that the study writes."""
    monkeypatch.setitem(staleness.WRITTEN, "figure_9_1.py", {"runs.json"})
    assert old({"deep_contact/runs.json": "[2]"}) == ["", ""]
    assert old({"deep_contact/runs.json": "[2]"} | edited(STUDY, "N = 3", "N = 4")) == ["piles.N changed"] * 2
    assert staleness.WRITTEN["run_tradeoff.py"] == {presets.TABLE.name}


@pytest.mark.parametrize("file", [ENGINE, "deep_contact/rows.py"])
def test_what_golden_runs_import_makes_times_alone_old(old, file):
    assert old(edited(file, "return", "return 1 *")) == ["", "a time, and the package has changed"]


def test_other_golden_runs_make_numbers_old_unless_these_kept_their_bits(old):
    assert (
        old({"data/reference/golden.json": '{"runs": {"pile": {"sha256": "c"}}}'})[0] == "golden runs give other bits"
    )
    assert old(golden="b") == ["", ""]
    assert old(golden="c")[0] == "golden runs give other bits"


def test_another_input_or_processor_makes_a_result_old(old):
    assert old(inputs={"models/model.h5": "0" * 64}) == ["models/model.h5 has changed"] * 2
    assert old(cpu="theirs") == ["", "measured on theirs, the others on ours"]


def test_a_result_that_says_not_what_made_it_is_old(old):
    assert old(code=None, commit="12345678 and more")[0] == "it does not say what code made it (commit 12345678)"


def test_an_import_that_is_nowhere_is_an_error(old):
    with pytest.raises(ValueError, match=r"figure_9_1.py: expected a module for deep_contact.gone.piles"):
        old(edited(SCRIPT, "deep_contact.studies", "deep_contact.gone"))


def test_an_installed_package_says_not_what_code_made_the_results_of_a_clones_scripts(old, tmp_path, monkeypatch):
    """`pip install .` and then `python scripts/figure_….py` ended in an error, after the whole run."""
    old()
    monkeypatch.setattr(staleness, "ROOT", tmp_path / "site-packages" / "deep_contact")
    staleness.made_by.cache_clear()
    assert staleness.made_by(tmp_path / SCRIPT) == {}


def test_a_script_counts_what_it_runs():
    def files(name):
        return {one.relative_to(ROOT).as_posix() for one in staleness.reached(staleness.commands()[name][0])}

    assert "deep_contact/solvers/pgs.py" in files("figure_5_7")
    assert "deep_contact/accuracy/runs.json" in files("table_6_4")
    assert "deep_contact/parallel.py" in files("figure_4_4")  # which draws its seeds
    assert not any("physics" in file for file in files("figure_3_3"))
    code = staleness.made_by(staleness.commands()["figure_5_7"][0])["code"].values()
    assert {"starts.paired", "evaluation.velocity_errors", "figure_5_7_starts.FIGURE"} <= {*code}
    assert not {"figure_5_7_starts.claims", "pgs.PGS"} & {*code}


def test_stale_lists_what_is_old_once_and_the_pages_show_it(monkeypatch, capsys):
    whys = {"figure_6_1": "why", "figure_3_3": "because"}
    monkeypatch.setattr(staleness, "why_old", lambda name: whys.get(name, ""))
    all_figures = load_script("all_figures")
    assert all_figures.main(["--stale"]) == 0
    assert [line.partition(",")[0] for line in capsys.readouterr().out.splitlines()] == ["figure_3_3", "figure_6_1"]
    made = []
    monkeypatch.setattr(all_figures, "timed", lambda command: (made.append(command), (0, 0.0))[1])
    assert all_figures.main(["--references"]) == 0
    assert [Path(script).stem for script, *_ in made] == ["figure_3_3_kernels", "figure_6_1_trade", "tables"]
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
