"""The list of the thesis's elements: none left out, none twice, and every path and name that it gives exists."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "elements.txt").read_text(encoding="utf-8")
ROWS = [f"{line} | ".split(" | ")[:4] for line in PAGE.splitlines()]

PATHS = sorted(set(re.findall(r"\b[\w./]+\.(?:py|md|cff)(?::\w+)?", PAGE)))

SECTIONS = """1.1 1.2 1.3 1.3.1 1.4
2.1 2.2.1 2.2.2 2.2.3 2.2.4 2.2.5 2.2.6 2.3 2.3.1 2.3.2 2.4.1 2.4.2
3.1 3.2.1 3.2.2 3.2.3 3.2.4 3.2.5 3.3 3.3.1 3.4 3.4.1 3.4.2 3.4.3
4.1 4.2 4.2.1 4.2.2 4.2.3 4.2.4 4.2.5 4.2.6 4.3.1 4.3.2 4.3.3 4.3.4 4.3.5
5.1 5.1.1 5.1.2 5.1.3 5.2 5.2.1 5.2.2 5.2.3 5.3.1 5.3.2 5.3.3 5.4 6.1 6.2.1 6.2.2 6.2.3""".split()
"""Sections of the thesis with text of their own."""

NUMBERED = {"Eq": {2: 30, 3: 16, 4: 18, 5: 3}, "Figure": {3: 8, 4: 7, 5: 9}, "Table": {5: 2}}
"""Kind -> chapter -> how many it has."""


def expanded(elements):
    """The elements of a row: `Eq 2.1, 2.3–2.5` are four."""
    kind, items = re.fullmatch(r"(\D+) (\d.*|[AB].*)", elements).groups()
    for item in items.split(", "):
        first, _, last = item.partition("–")
        chapter, _, number = first.rpartition(".")
        for i in range(int(number), int(last.rpartition(".")[2]) + 1) if last else [number]:
            yield f"{kind} {chapter}{'.' if chapter else ''}{i}"


def test_every_element_of_the_thesis_has_one_row():
    expected = [f"section {number}" for number in SECTIONS]
    expected += [f"{kind} {c}.{i}" for kind, of in NUMBERED.items() for c, n in of.items() for i in range(1, n + 1)]
    expected += [f"Algorithm {i}" for i in range(1, 8)] + [f"goal {i}" for i in range(1, 10)]
    expected += [f"future work {i}" for i in range(1, 6)] + ["Appendix A", *(f"Appendix B.{i}" for i in (1, 2, 3))]
    assert sorted(element for row in ROWS for element in expanded(row[0])) == sorted(expected)


def test_every_row_has_a_verdict_a_place_and_a_reason_where_something_is_wrong():
    for element, verdict, place, why in ROWS:
        assert verdict in ("right", "partly", "wrong", "open", "–"), element
        assert place in PATHS, element
        assert why or verdict == "right", element


@pytest.mark.parametrize("given", PATHS)
def test_every_path_exists_and_has_the_name(given):
    path, _, name = given.partition(":")
    source = (ROOT / path).read_text(encoding="utf-8")
    assert not name or re.search(rf"^(def |class |){name}\b", source, re.MULTILINE)
