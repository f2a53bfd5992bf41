"""The list of the thesis's elements: none left out, none twice, and every path and name that it gives exists."""

import json
import re
from pathlib import Path

import pytest
from conftest import ROOT

from deep_contact.figures import results

PAGE = (ROOT / "docs" / "elements.txt").read_text(encoding="utf-8")
ROWS = [f"{line} | ".split(" | ")[:4] for line in PAGE.splitlines()]

PATHS = sorted(set(re.findall(r"\b[\w./]+\.(?:py|md|cff)(?::\w+)?", PAGE)))

PRINTED = (Path(__file__).parent / "thesis_elements.txt").read_text(encoding="utf-8").splitlines()
"""Headings and numbers of equations, figures, tables and algorithms, taken from the text of the thesis."""

LISTED = [
    f"{kind} {i}" for kind, count in (("abstract", 3), ("goal", 9), ("future work", 5)) for i in range(1, count + 1)
]
"""Claims of the abstract, and items of the lists of sections 1.3.1 and 6.2, which have no headings."""


def expanded(elements):
    """The elements of a row: `Eq 2.1, 2.3–2.5` are four."""
    kind, items = re.fullmatch(r"(\D+) (\d.*|[AB].*)", elements).groups()
    for item in items.split(", "):
        first, _, last = item.partition("–")
        chapter, _, number = first.rpartition(".")
        for i in range(int(number), int(last.rpartition(".")[2]) + 1) if last else [number]:
            yield f"{kind} {chapter}{'.' if chapter else ''}{i}"


def test_every_element_of_the_thesis_has_one_row():
    expected = LISTED + [" ".join(line.split()[:2]) for line in PRINTED]
    assert sorted(element for row in ROWS for element in expanded(row[0])) == sorted(expected)


def test_every_row_has_a_verdict_a_place_and_a_reason_where_something_is_wrong():
    for element, verdict, place, why in ROWS:
        assert verdict in ("right", "partly", "wrong", "open", "–"), element
        assert place in PATHS, element
        assert why or verdict == "right", element


def test_no_element_is_right_of_which_a_claim_does_not_hold_throughout():
    right = {element for row in ROWS if row[1] == "right" for element in expanded(row[0])}
    for path in results.REFERENCE.glob("*.json"):
        for claim in json.loads(path.read_text(encoding="utf-8")).get("claims", ()):
            if claim["thesis"] and claim["holds"] is not True:
                named = [place for place in claim["thesis"].split(", ") if place != "abstract"]
                assert not right.intersection(named), (path.stem, claim["text"])


@pytest.mark.parametrize("given", PATHS)
def test_every_path_exists_and_has_the_name(given):
    path, _, name = given.partition(":")
    source = (ROOT / path).read_text(encoding="utf-8")
    assert not name or re.search(rf"^(def |class |){name}\b", source, re.MULTILINE)
