"""Results files: every number of a figure or table, where it came from, and what it says about the thesis.

A results file is strict JSON; `results_schema.json` has its fields.

A float is stored by its shortest exact representation: reading gives the same bits. NaN and infinity are refused; a
missing number is None (`null`).
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
"""Results of the full runs, in a checkout."""

OPEN = "too few states to tell"
"""Verdict on a claim of a small run that does not agree with the reference run."""

_VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


class Claim(NamedTuple):
    """A statement tested on the data.

    | field    | meaning                                                                                |
    |----------|----------------------------------------------------------------------------------------|
    | text     | the statement                                                                          |
    | thesis   | where the thesis makes it, "section 3.4.1" or "section 5.1.3, Eq 3.8"; None if it does |
    |          | not. The text copy of the thesis has no pages                                          |
    | holds    | whether it is true of the data; None where the data leave it open, or say both         |
    | measured | the numbers that decided it, name -> value                                             |
    | verdict  | more than `holds` says: "holds, sweeps 1 to 180", "within the noise"; or None          |
    """

    text: str
    thesis: str | None
    holds: bool | None
    measured: dict
    verdict: str | None = None


def check_results(results: dict) -> dict:
    """The results. Raises ResultsError naming field and value unless they follow the schema and are finite."""
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
    """Check `results` and write them in one move. Returns the path. digits: see `plain`.

    Raises ResultsError naming field and value, and then leaves whatever was there before untouched.
    """
    return write_json(path, check_results(plain(results, digits=digits, where="results")))


def read_results(path: str | os.PathLike) -> dict:
    """The checked contents of a results file. Raises ResultsError naming file, field and value."""
    path = Path(path)
    try:
        return check_results(json.loads(path.read_text(encoding="utf-8")))
    except ResultsError as error:
        raise ResultsError(f"{path.name}: {error}") from None
    except (ValueError, RecursionError) as error:
        raise ResultsError(f"{path.name}: expected strict JSON: {error}") from None


def reference(stem: str) -> dict | None:
    """The results of the reference run of "figure_3_7"; None where there are none, as in an installed package."""
    path = REFERENCE / f"{stem}.json"
    return read_results(path) if path.exists() else None


def name_of(id: str) -> str:
    """The name of an id: "Figure 3.7" of "3.7", "Table 5.1" of "T 5.1"."""
    return f"Table {id[2:]}" if id.startswith("T ") else f"Figure {id}"


def verdict(claim: Mapping, beside: Mapping | None = None) -> str:
    """The verdict of a stored claim in words: its own if it has one, else "holds", "does not hold" or "open".

    beside: results of the reference run, for a claim of a smaller run. Where the claim comes out alike in both runs,
    the verdict says so. Where it does not, the verdict is "too few states to tell", with the verdict of the reference
    run. Two claims are the same if their texts are, whatever the number of circles.
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
    said = verdict(other)  # the documentation has the sweeps
    return f"{OPEN} (reference run: {'holds in part' if ';' in said else said.partition(',')[0]})"


def _of_any_size(text: str) -> str:
    """A claim without its number of circles."""
    return re.sub(r"\d+ circles", "circles", text)
