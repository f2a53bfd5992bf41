"""All results of a folder as one page, `index.html`, that loads nothing else: no network, no file, no script.

Pictures are embedded. The page's content security policy forbids it to load anything.
"""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import jinja2

from deep_contact.io.files import write_bytes
from deep_contact.reporting import results, staleness
from deep_contact.reporting.figures import cell

ERRATA: dict[str, list[dict]] = json.loads((Path(__file__).parent / "errata.json").read_text(encoding="utf-8"))
"""Kind of a fault of the thesis or of its authors' code -> one dict a fault: where it is, what the thesis says, what is
right, what is done here."""

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def write_report(
    folder: str | os.PathLike, *, expected: Iterable[str] = (), captions: Mapping[str, str] | None = None
) -> Path:
    """Write `index.html` into a folder of results files; its path.

    captions: id ("3.7", "T 5.1") -> text under the picture. expected: ids that should be there, whose absence is a
    fault, as is a results file that cannot be read.
    """
    folder, entries, faults, captions = Path(folder), [], [], captions or {}
    for path in sorted(folder.glob("*.json")):
        if re.fullmatch(r"(figure|table)_[0-9A-Z]+_[0-9]+\.json", path.name):
            try:
                entries.append(_content(path))
            except results.ResultsError as error:
                faults.append(str(error))
    entries.sort(key=lambda entry: _order(entry["id"]))
    if missing := set(expected) - {entry["id"] for entry in entries}:
        faults.append(f"No results of {', '.join(map(results.name_of, sorted(missing, key=_order)))}.")
    environment = jinja2.Environment(loader=jinja2.PackageLoader("deep_contact.reporting", ""), autoescape=True)
    environment.filters["cell"] = cell
    page = environment.get_template("page.html.j2").render(
        policy=POLICY,
        entries=[entry | {"caption": captions.get(entry["id"], "")} for entry in entries],
        claims=[claim for entry in entries for claim in entry["claims"] if claim["thesis"]],
        faults=faults,
        errata=ERRATA,
    )
    return write_bytes(folder / "index.html", page.encode())


def _content(path: Path) -> dict:
    """Content of the page for a results file. Raises ResultsError where it cannot be read."""
    entry, reference, picture = results.read_results(path), results.reference(path.stem), path.with_suffix(".png")
    made, is_full = entry["provenance"], reference and reference["options"] == entry["options"]
    run = {key: value for key, value in made.items() if key not in ("packages", "seed", "inputs", "code", "drawn")}
    return entry | {
        "claims": [_judged(claim, None if is_full else reference) for claim in entry["claims"]],
        "full": is_full,
        "name": results.name_of(entry["id"]),
        "anchor": path.stem.replace("_", "-"),
        "picture": base64.b64encode(picture.read_bytes()).decode("ascii") if picture.exists() else None,
        "settings": {**entry["options"], "seed": made["seed"]},
        "old": staleness.why_old(path.stem) if path.resolve().parent == results.REFERENCE else "",
        "made": run | made["packages"] | made.get("inputs", {}),
    }


def _judged(claim: dict, beside: dict | None) -> dict:
    """A claim with its verdict, and whether it holds, does not, does in part, or is left open."""
    verdict = results.verdict(claim, beside)
    kind = {True: "holds", False: "not", None: "part" if verdict.startswith("holds") else "open"}[claim["holds"]]
    return claim | {"verdict": verdict, "kind": "open" if verdict.startswith(results.OPEN) else kind}


def _order(id: str) -> tuple:
    chapter, number = id.removeprefix("T ").split(".")
    return chapter.zfill(4), int(number), id.startswith("T ")
