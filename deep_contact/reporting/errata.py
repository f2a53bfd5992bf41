"""Faults of the thesis as it is printed, and what this package does instead, for the page and for the README.

`python -m deep_contact.reporting.errata` prints the table as Markdown.
"""

from __future__ import annotations

import json
from pathlib import Path

ERRATA: list[dict[str, str]] = json.loads((Path(__file__).parent / "errata.json").read_text(encoding="utf-8"))
"""One dict a fault, in the order of the thesis's chapters.

| key    | meaning                                           |
|--------|---------------------------------------------------|
| where  | equation, algorithm, section or line              |
| thesis | what the thesis says                              |
| right  | what is right                                     |
| here   | what this package does, and where it is shown     |
"""


def markdown() -> str:
    """The table as Markdown."""
    rows = [[name.capitalize() for name in ERRATA[0]], ["---"] * 4, *(erratum.values() for erratum in ERRATA)]
    return "\n".join("| " + " | ".join(text.replace("|", "\\|") for text in row) + " |" for row in rows) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
