"""Faults of the thesis as it is printed, and what this package does instead, for the page and for the documentation.

`python -m deep_contact.reporting.errata` prints the tables as Markdown.
"""

from __future__ import annotations

import json
from pathlib import Path

_LISTS = json.loads((Path(__file__).parent / "errata.json").read_text(encoding="utf-8"))

ERRATA: list[dict[str, str]] = _LISTS["thesis"]
"""One dict a fault of the thesis, in the order of its chapters.

| key    | meaning                                           |
|--------|---------------------------------------------------|
| where  | equation, algorithm, table or section             |
| thesis | what the thesis says                              |
| right  | what is right                                     |
| here   | what this package does, and where it is shown     |
"""

CONVENTIONS: list[dict[str, str]] = _LISTS["conventions"]
"""The same of what is no fault: conventions and scope of the thesis that differ from this package's."""

CODE: list[dict[str, str]] = _LISTS["code"]
"""The same of its authors' code, where it differs from the thesis or from what it means to do."""

TITLES = {
    "Errata of the thesis": ERRATA,
    "Conventions and scope that differ here": CONVENTIONS,
    "The authors' code beside the thesis": CODE,
}
"""Heading -> list."""


def rows(errata: list[dict[str, str]]) -> list[list[str]]:
    """A list as rows, head first."""
    return [list(errata[0]), *(list(erratum.values()) for erratum in errata)]


def markdown() -> str:
    """The tables as Markdown."""
    text = ""
    for title, errata in TITLES.items():
        head, *body = rows(errata)
        lines = [[name.capitalize() for name in head], ["---"] * len(head), *body]
        text += (
            f"## {title}\n\n"
            + "".join(f"| {' | '.join(v.replace('|', chr(92) + '|') for v in row)} |\n" for row in lines)
            + "\n"
        )
    return text


if __name__ == "__main__":
    print(markdown(), end="")
