"""README and the documentation: tables are what the results files say, and every block of code does what it says."""

import io
import json
import re
import runpy
import shlex
import subprocess
import sys
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from unittest.mock import patch

import pytest
from conftest import ROOT, run_python

import deep_contact.__main__

sys.path.insert(0, str(ROOT / "docs"))
import measured

README = ROOT / "README.md"
DOCS = ROOT / "docs"
REFERENCE = ROOT / "data" / "reference"
MADE = ("../api/index.md", "appendix.md")
"""Pages that are made when the site is built."""
PAGES = {
    str(path.relative_to(ROOT)): path for path in (README, *sorted(DOCS.glob("*.md")), DOCS / "gallery" / "index.md")
}
TEXTS = {name: path.read_text(encoding="utf-8") for name, path in PAGES.items()}


def blocks(language, text):
    """The fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


PYTHON = {name: blocks("python", text) for name, text in TEXTS.items()}
LINES = "".join(block for text in TEXTS.values() for block in blocks("bash", text)).splitlines()
COMMANDS = dict.fromkeys(line for line in LINES if line.strip() and not line.startswith("#"))


def test_commands_that_are_named_exist():
    named = " ".join([*TEXTS.values(), (ROOT / "scripts" / "quickstart.sh").read_text(encoding="utf-8")])
    commands = set(re.findall(r"(?:-m deep_contact|deep-contact) ([a-z]+(?:-[a-z]+)*)", named))
    assert "simulate" in commands
    assert commands <= set(deep_contact.__main__.COMMANDS)


def test_tables_and_sentences_have_the_numbers_of_the_results_files():
    run_python(DOCS / "tables.py", "--check")


@pytest.mark.parametrize("page", [page for page in PAGES if page != "docs/tried.md"])  # whose files are gone
def test_a_number_of_the_prose_has_its_file_or_was_chosen(page):
    assert measured.unexplained(PAGES[page].name, TEXTS[page]) == []


def test_a_sentence_gets_its_numbers_wherever_its_lines_end(monkeypatch):
    monkeypatch.setitem(measured.SENTENCES, "a.md", [("it takes {:.1f} ms, or {:g}", lambda: [2.25, 1e-8])])
    assert measured.filled("a.md", "So it\ntakes 0 ms,\nor 1e3.") == "So it\ntakes 2.2 ms,\nor 1e-8."
    with pytest.raises(ValueError, match=r"a\.md: expected"):
        measured.filled("a.md", "It takes 2.25 ms.")
    assert measured.unexplained("a.md", "it takes 2.2 ms, or 1e-8; Figure 6.1: 3.5 N, 7 %") == ["3.5", "7"]


def test_the_appendix_has_every_claim_element_and_erratum():
    appendix = run_python(DOCS / "tables.py", "--appendix").stdout
    claims = [claim for path in REFERENCE.glob("*.json") for claim in json.loads(path.read_text()).get("claims", ())]
    assert all(claim["text"].replace("|", "\\|") in appendix for claim in claims)
    for line in (DOCS / "elements.txt").read_text(encoding="utf-8").splitlines():
        assert f"| {line.partition(' | ')[0]} | " in appendix
    titles = [re.sub(r"[^\w -]", "", title, flags=re.ASCII) for title in re.findall("^## (.*)", appendix, re.M)]
    anchors = {re.sub("[ -]+", "-", title).lower() for title in titles}
    linked = {anchor for text in TEXTS.values() for anchor in re.findall(r"appendix\.md#([\w-]+)", text)}
    assert linked
    assert linked <= anchors


@pytest.mark.parametrize("page", [page for page, found in PYTHON.items() if found])
def test_python_of_a_page_runs_in_order_in_one_namespace(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for block in blocks("xml", TEXTS[page]):
        Path("mine.xml").write_text(block, encoding="utf-8")
    namespace = {}
    for block in PYTHON[page]:
        exec(compile(block, page, "exec"), namespace)
    for name in re.findall(r'(?:save\(figure, |write_state\()"(\S+)"', "".join(PYTHON[page])):
        assert Path(name).stat().st_size > 0


@cache
def help_of(*words):
    """What a Python program says of its options."""
    if words[0] == "-m" and words[1] != "deep_contact":
        return run_python(*words, "--help").stdout
    script = ROOT / words[0] if words[0] != "-m" else Path(deep_contact.__file__).parent / "__main__.py"
    said, given = io.StringIO(), words[1:] if words[0] != "-m" else words[2:]
    with redirect_stdout(said), patch.object(sys, "argv", [str(script), *given, "--help"]):
        with pytest.raises(SystemExit, match="0"):
            runpy.run_path(str(script), run_name="__main__")
    return said.getvalue()


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_name_scripts_files_and_options_that_there_are(command):
    program, *arguments = shlex.split(command, comments=True)
    files = [word for word in arguments if "/" in word and "." in Path(word).name and "://" not in word]
    assert all((ROOT / file).exists() for file in files)
    if program == "bash":
        subprocess.run(["bash", "-n", files[0]], cwd=ROOT, check=True)
        return
    if program == "deep-contact":
        program, arguments = "python", ["-m", "deep_contact", *arguments]
    assert program == "python"
    if arguments[0].startswith("docs/gallery/"):
        assert len(arguments) == 1  # an example has no options, and --help would run it
        return
    words = arguments[:3] if arguments[0] == "-m" else arguments[:1]
    if arguments[0].endswith("benchmark.py"):
        words = arguments[:2]  # which of them
    if words[-1] in ("figure", "table") and arguments[3:]:
        words = arguments[:4]  # the script has the options
    known = help_of(*words)
    for option in (word for word in arguments if word.startswith("--")):
        assert re.search(rf"{option}\b", known), option


@pytest.mark.parametrize("page", PAGES)
def test_every_picture_path_and_link_exists(page):
    text = TEXTS[page]
    links = [link for link in re.findall(r"\]\(([^)#\s]+)", text) if "://" not in link and not link.startswith("api/")]
    paths = re.findall(r"`((?:scripts|tests|data|models|deep_contact)/[\w./]*)`", text)
    for path in links:
        assert (PAGES[page].parent / path).exists() or path in MADE, path
    for path in paths:
        assert (ROOT / path).exists(), path
