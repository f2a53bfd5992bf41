"""Results files: the numbers of a figure or table, their provenance, and the verdicts on claims of the thesis.

A results file is strict JSON; `results_schema.json` has its fields.

A float is stored as its shortest decimal representation that gives the same bits when it is read. NaN and infinity are
refused. A missing number is None (`null`).
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import jsonschema

from deep_contact.io.files import write_json
from deep_contact.io.json_data import ResultsError, plain
from deep_contact.io.provenance import provenance  # noqa: F401 (scripts take it from here)

SCHEMA = json.loads((Path(__file__).parent / "results_schema.json").read_text(encoding="utf-8"))

REFERENCE = Path(__file__).resolve().parents[2] / "data" / "reference"
"""Folder of the results of the full runs, the reference runs. It exists in a checkout of the repository only."""

OPEN = "too few states to tell"
"""Verdict on a claim of a small run, if the small run and the reference run disagree."""

_VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


class Claim(NamedTuple):
    """A statement that is tested on the data of a figure.

    | field    | meaning                                                                                  |
    |----------|------------------------------------------------------------------------------------------|
    | text     | the statement                                                                            |
    | thesis   | place of the statement in the thesis, "section 3.4.1" or "section 5.1.3, Eq 3.8"; None   |
    |          | if the thesis does not make it. Our copy of the thesis has no page numbers               |
    | holds    | whether the data agree with the statement; None if they leave it open, or if some agree  |
    |          | and some do not                                                                          |
    | measured | the numbers that decided, name -> value                                                  |
    | verdict  | a text with more detail than `holds`: "holds, sweeps 1 to 180", "within the noise"; or   |
    |          | None                                                                                     |
    """

    text: str
    thesis: str | None
    holds: bool | None
    measured: dict
    verdict: str | None = None


def check_results(results: dict) -> dict:
    """Return the results after a check. Raises ResultsError naming field and value if they violate the schema.

    The error is also raised if a number is not finite.
    """
    error = jsonschema.exceptions.best_match(_VALIDATOR.iter_errors(results))
    if error is not None:
        place = error.json_path.removeprefix("$").lstrip(".") or "results"
        names_only = error.validator in ("required", "additionalProperties")
        shown = repr(list(error.instance) if names_only else error.instance)
        shown = shown if len(shown) <= 200 else f"{shown[:200]} …"
        raise ResultsError(f"{place}: expected {error.schema['description']}, got {shown}")
    plain(results, where="results")
    return results


def write_results(path: str | os.PathLike, results: Mapping, *, digits: int | None = None) -> Path:
    """Check results and write them to a file, completely or not at all. Returns the path.

    digits: number of significant digits of float arrays, as for `plain`. Raises ResultsError naming field and value. An
    existing file then stays unchanged.
    """
    return write_json(path, check_results(plain(results, digits=digits, where="results")))


def read_results(path: str | os.PathLike) -> dict:
    """Read and check a results file. Returns its contents. Raises ResultsError naming file, field and value."""
    path = Path(path)
    try:
        return check_results(json.loads(path.read_text(encoding="utf-8")))
    except ResultsError as error:
        raise ResultsError(f"{path.name}: {error}") from None
    except (ValueError, RecursionError) as error:
        raise ResultsError(f"{path.name}: expected strict JSON: {error}") from None


def reference(stem: str) -> dict | None:
    """Return the results of a figure's reference run, or None if there is no file, as in an installed package.

    stem: name of the figure's files without suffix, such as "figure_3_7".
    """
    path = REFERENCE / f"{stem}.json"
    return read_results(path) if path.exists() else None


def name_of(id: str) -> str:
    """Return the name of a figure or table for its id: "Figure 3.7" for "3.7", "Table 5.1" for "T 5.1"."""
    return f"Table {id[2:]}" if id.startswith("T ") else f"Figure {id}"


def verdict(claim: Mapping, beside: Mapping | None = None) -> str:
    """Return the verdict on a stored claim in words.

    It is the text in the claim's field "verdict", if there is one. Otherwise it is "holds", "does not hold" or "open".
    beside: results of the reference run, if the claim is one of a smaller run. If `holds` is the same in both runs, the
    verdict says that it is as in the reference run. If not, it is "too few states to tell", followed by the verdict of
    the reference run. Two claims are the same if their texts are equal apart from the number of circles.
    """
    own = claim.get("verdict") or {True: "holds", False: "does not hold", None: "open"}[claim["holds"]]
    if beside is None:
        return own
    others = {_of_any_size(other["text"]): other for other in beside["claims"]}
    other = others.get(_of_any_size(claim["text"]))
    if other and claim["holds"] is not None and claim["holds"] == other["holds"]:
        return f"as in the reference run, {own}"
    if other is None:
        return OPEN
    said = verdict(other)  # printed without its ranges of sweeps, which the documentation has
    return f"{OPEN} (reference run: {'holds in part' if ';' in said else said.partition(',')[0]})"


def _of_any_size(text: str) -> str:
    """Return the text of a claim without its number of circles."""
    return re.sub(r"\d+ circles", "circles", text)
