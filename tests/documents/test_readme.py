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


@pytest.mark.parametrize("page", [page for page in PAGES if "/tried" not in page])  # whose files are gone
def test_a_number_of_the_prose_has_its_file_or_was_chosen(page):
    assert measured.unexplained(PAGES[page].name, TEXTS[page]) == []


def test_what_was_tried_has_a_line_for_each_section_of_the_archive_with_numbers_of_that_section():
    sections = dict(re.findall(r"^### (.*)\n((?:(?!##).*\n)*)", TEXTS["docs/tried_archive.md"], re.MULTILINE))
    lines = re.findall(r"^\| \[(.*)\]\(tried_archive\.md#.*?\) \| (.*) \|$", TEXTS["docs/tried.md"], re.MULTILINE)
    assert [title for title, _ in lines] == list(sections)
    for title, line in lines:
        line, number = re.sub(r"`[^`]*`|(?:Table|Figure) \d\.\d", "", line), r"(?<![\w.,])\d+(?:,\d{3})*(?:\.\d+)?"
        missing = set(re.findall(number, line)) - set(re.findall(number, sections[title]))
        assert missing == set(), title


def test_a_sentence_gets_its_numbers_wherever_its_lines_end(monkeypatch):
    monkeypatch.setitem(measured.SENTENCES, "a.md", [("it takes {:.1f} ms, or {:g}", lambda: [2.25, 1e-8])])
    assert measured.filled("a.md", "So it\ntakes 0 ms,\nor 1e3.") == "So it\ntakes 2.2 ms,\nor 1e-8."
    with pytest.raises(ValueError, match=r"a\.md: expected"):
        measured.filled("a.md", "It takes 2.25 ms.")
    assert measured.unexplained("a.md", "it takes 2.2 ms, or 1e-8; Figure 6.1: 3.5 N, 7 %") == ["3.5", "7"]


def test_the_appendix_has_every_claim_element_and_erratum():
    appendix = TEXTS["docs/appendix.md"]
    claims = [claim for path in REFERENCE.glob("*.json") for claim in json.loads(path.read_text()).get("claims", ())]
    assert all(claim["text"].replace("|", "\\|") in appendix for claim in claims)
    for line in (DOCS / "elements.txt").read_text(encoding="utf-8").splitlines():
        assert f"| {line.partition(' | ')[0]} | " in appendix
    for faults in json.loads((DOCS / "errata.json").read_text(encoding="utf-8")).values():
        assert all(f"| {fault['where']} | ".replace("*", "\\*") in appendix for fault in faults)


SLOW = {"docs/materials.md": [pytest.mark.slow]}
"""Page -> marks of its Python, where most of its kinds of steps are compiled for it alone, which takes minutes."""


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=SLOW.get(page, [])) for page, found in PYTHON.items() if found]
)
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
def test_every_path_that_is_named_exists(page):
    for path in re.findall(r"`((?:scripts|tests|data|models|deep_contact)/[\w./]*)`", TEXTS[page]):
        assert (ROOT / path).exists(), path


MADE = {"build", "dist", "figures", "runs", "predictions", "generated", "node_modules"}
"""Folders of what programs write: a clone has none of them."""
TREE = sorted(
    path.relative_to(ROOT)
    for path in ROOT.rglob("*.md")
    if not any(part in MADE or part.startswith(".") for part in path.relative_to(ROOT).parts)
)


def without_code(text):
    """A page without its blocks and pieces of code, which have no links."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))


def anchors(page):
    """Where links can point to in a page: its headings as GitHub names them, and what has an id."""
    text = page.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.*)", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE), re.MULTILINE)
    plain = (re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading) for heading in headings)
    return {re.sub(r"[^\w -]", "", one.lower()).strip().replace(" ", "-") for one in plain} | set(
        re.findall(r"""id=["']([^"']+)""", text)
    )


def links(page):
    """The links of a page that stay in the repository, pictures and HTML included."""
    text = without_code(page.read_text(encoding="utf-8"))
    found = re.findall(r"\]\(<?([^)\s>]+)", text) + re.findall(r"""(?:href|src)=["']([^"']+)""", text)
    return [link for link in found + re.findall(r"^\[[^]]+\]: (\S+)", text, re.M) if not re.match(r"[a-z]+:", link)]


def dead(page):
    """The links of a page that lead nowhere in a clone."""
    targets = [(link, *link.partition("#")[::2]) for link in links(page)]
    places = [(link, (page.parent / path).resolve() if path else page, anchor) for link, path, anchor in targets]
    return [
        link
        for link, place, anchor in places
        if not place.exists() or (anchor and place.suffix == ".md" and anchor not in anchors(place))
    ]


@pytest.mark.parametrize("page", TREE, ids=str)
def test_no_link_of_a_page_is_dead_in_a_clone(page):
    assert dead(ROOT / page) == []


def test_dead_links_of_every_kind_are_found(tmp_path):
    page = tmp_path / "page.md"
    other = tmp_path / "other.md"
    other.write_text("# Title, *one*: of `two`\n## [Linked](page.md) 3.5\n```\n# no heading\n```\n<a id='here'></a>\n")
    alive = "other.md other.md#title-one-of-two other.md#linked-35 other.md#here #words https://nowhere.invalid/x"
    wrong = "gone.md other.md#no-heading #gone gone.png gone.html gone.txt"
    every = [*(f"[a]({link})" for link in alive.split()), *(f"[a]({link})" for link in wrong.split()[:3])]
    every += ["![a](gone.png)", '<a href="gone.html">a</a>', "[b]: gone.txt", "`[a](code.md)`"]
    page.write_text("# Words\n" + "\n".join(every))
    assert dead(page) == wrong.split()
    assert len(TREE) > 20
