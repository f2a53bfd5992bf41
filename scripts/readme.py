"""python scripts/readme.py [--check]: fill README.md's tables from the results files under data/reference.

A table stands between the lines `<!-- table: NAME -->` and `<!-- end -->`. With --check nothing is written, and the
exit status is 1 if a table is not what its results file says.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

from deep_contact import errata
from deep_contact.figures import cell
from deep_contact.results import read_results, replacing

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "data" / "reference"
_BLOCK = re.compile(r"(<!-- table: (?P<name>[\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def markdown(rows: list[list]) -> str:
    """Rows, head first, as a Markdown table."""
    cells = [[_number(value) if isinstance(value, float) else str(value) for value in row] for row in rows]
    return "".join(f"| {' | '.join(row)} |\n" for row in (cells[0], ["---"] * len(cells[0]), *cells[1:]))


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def engine() -> str:
    """Ours beside the peers, from benchmark_engine.json; in brackets the multiple of ours."""
    rows = [["pile", "engine", "contacts", "ns a contact and sweep", "overhead, µs a step", "step of 10 sweeps, µs"]]
    for case in read_results(REFERENCE / "benchmark_engine.json")["data"]["cases"]:
        for name, cost in case["engines"].items():
            cells = [f"{case['n_bodies']:,} {case['kind']}", name, f"{cost['contacts']:.0f}"]
            for key in ("sweep_ns", "overhead_us", "step_us"):
                ratio = f" ({case['ratios'][name][key]:.2f}×)" if name in case["ratios"] else ""
                cells.append(f"{cost[key]:.4g}{ratio}")
            rows.append(cells)
    return markdown(rows)


def starts() -> str:
    """Sweeps until θ < 6e-5 by start, from figure_3_8.json."""
    data = read_results(REFERENCE / "figure_3_8.json")["data"]
    rows = [["start", "mean sweeps, same states", "median", "mean sweeps, runs of their own", "median"]]
    for name in data["paired"]:
        both = [data[mode][name]["sweeps"] for mode in ("paired", "independent")]
        rows.append([name, *(found[key] for found in both for key in ("mean", "median"))])
    return markdown(rows)


def transfer() -> str:
    """Times of the transfer and of state files, from benchmark_transfer.json and benchmark_state_xml.json."""
    case = json.loads((REFERENCE / "benchmark_transfer.json").read_text())
    files = json.loads((REFERENCE / "benchmark_state_xml.json").read_text())
    rows = [["what", "time"]]
    rows += [[name, f"{1e6 * seconds:.4g} µs"] for name, seconds in case["case"].items()]
    rows += [[name, f"{ratio:.3g}×"] for name, ratio in case["ratio"].items()]
    for suffix in (".xml", ".xml.gz"):
        for way in ("write", "read"):
            rows.append([f"{way} a state as {suffix}", f"{files[suffix][way]['min_ms']:.3g} ms"])
    return markdown(rows)


def loss() -> str:
    """What the way through the grid changes, from figure_6_3.json (poly6)."""
    rows = [["d (m)", "h (m)", "pile, thesis's transfer", "pile, SPH gather", "pile, consistent"]]
    for row in read_results(REFERENCE / "figure_6_3.json")["data"]["rows"]:
        if row["kernel"] == "poly6":
            rows.append([row["d"], row["h"], *(row[f"pile, {way}"] for way in ("thesis", "SPH gather", "consistent"))])
    return markdown(rows)


def claims() -> str:
    """Every claim of the thesis that a reference run has tested."""
    rows = [["figure", "thesis", "claim", "holds"]]
    for stored, claim in _claims():
        if claim["thesis"]:
            rows.append([stored["id"], claim["thesis"], claim["text"], "yes" if claim["holds"] else "**no**"])
    return markdown(rows)


def goals() -> str:
    """What we set out to reach, and the reference runs measured."""
    rows = [["results file", "goal", "met", "measured"]]
    for stored, claim in _claims():
        if not claim["thesis"]:
            measured = "; ".join(f"{name} = {cell(value)}" for name, value in claim["measured"].items())
            rows.append([stored["id"], claim["text"], "yes" if claim["holds"] else "**no**", measured])
    return markdown(rows)


def _claims():
    """(results, claim) of all results files, in the order of their ids."""
    files = [json.loads(path.read_text()) for path in REFERENCE.glob("*.json")]
    files = [stored for stored in files if "claims" in stored]

    def order(stored):
        kind, _, number = stored["id"].rpartition(" ")
        return kind, [int(part) if part.isdigit() else -1 for part in number.split(".")]

    return [(stored, claim) for stored in sorted(files, key=order) for claim in stored["claims"]]


TABLES: dict[str, Callable[[], str]] = {
    "engine": engine,
    "starts": starts,
    "transfer": transfer,
    "loss": loss,
    "claims": claims,
    "goals": goals,
    "errata": errata.markdown,
}
"""Name of a table in README.md -> what makes it."""


def filled(text: str) -> str:
    """The text with every table made anew. Raises ValueError on a table nobody knows."""

    def table(match: re.Match) -> str:
        name = match["name"]
        if name not in TABLES:
            raise ValueError(f"README.md: expected a table among {', '.join(TABLES)}, got {name!r}")
        return f"{match[1]}{TABLES[name]().rstrip()}\n{match[3]}"

    return _BLOCK.sub(table, text)


def main() -> int:
    """Fill or check."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, fail if a table is out of date")
    given = parser.parse_args()
    readme = ROOT / "README.md"
    before = readme.read_text(encoding="utf-8")
    after = filled(before)
    if given.check:
        if before != after:
            print("README.md: a table differs from its results file; run python scripts/readme.py", file=sys.stderr)
        return int(before != after)
    with replacing(readme) as temporary:
        temporary.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
