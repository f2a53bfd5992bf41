"""python scripts/readme.py [--check]: fill README.md's tables from the results files under data/reference.

A table stands between the lines `<!-- table: NAME -->` and `<!-- end -->`. With --check nothing is written, and the
exit status is 1 if a table is not what its results file says.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median

from deep_contact.constants import LINEAR_SLOP
from deep_contact.reporting import errata
from deep_contact.reporting.figures import cell
from deep_contact.reporting.results import read_results, replacing
from deep_contact.studies.extremes import spans
from deep_contact.studies.tradeoff import best_within, fastest_within

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "data" / "reference"
_BLOCK = re.compile(r"(<!-- table: (?P<name>[\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def markdown(rows: list[list]) -> str:
    """Rows, head first, as a Markdown table."""
    cells = [["–" if value is None else _text(value) for value in row] for row in rows]
    return "".join(f"| {' | '.join(row)} |\n" for row in (cells[0], ["---"] * len(cells[0]), *cells[1:]))


def _text(value) -> str:
    if isinstance(value, list):
        return "–".join(map(_text, value))
    return _number(value) if isinstance(value, float) else str(value)


def of_script(stem: str, *, having: str | None = None) -> Callable[[], str]:
    """The table of a figure's script from its results file, of figure_6_9, say; or its rows with a certain cell."""

    def table() -> str:
        (path,) = (ROOT / "scripts").glob(f"{stem}_[a-z]*.py")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        head, *rows = module.FIGURE.table(read_results(REFERENCE / f"{stem}.json")["data"])
        return markdown([head, *(row for row in rows if having is None or having in row)])

    return table


def _number(value: float, digits: int = 3) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.{digits}g}"


def engine() -> str:
    """Ours beside the peers, from benchmark_engine.json; in brackets the multiple of ours."""
    rows = [["pile", "engine", "contacts", "ns a contact and sweep", "overhead, µs a step", "step of 10 sweeps, µs"]]
    for case in read_results(REFERENCE / "benchmark_engine.json")["data"]["cases"]:
        for name, cost in case["engines"].items():
            cells = [f"{case['n_bodies']:,} {case['kind']}", name, f"{cost['contacts']:.0f}"]
            for key in ("sweep_ns", "overhead_us", "step_us"):
                ratio = f" ({case['ratios'][name][key]:.2f}×)" if name in case["ratios"] else ""
                cells.append(_number(cost[key], 4) + ratio)
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
    rows += [[name, f"{_number(1e6 * seconds, 4)} µs"] for name, seconds in case["case"].items()]
    rows += [[name, f"{_number(ratio)}×"] for name, ratio in case["ratio"].items()]
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


def pushed() -> str:
    """How far each quantity can be pushed, from figure_6_6.json: by engine, and where another engine goes further."""
    data = read_results(REFERENCE / "figure_6_6.json")["data"]
    rows = [["pushed", "safe", "degraded", "fails", "refused", "safe in Box2D 2.3", "safe in pymunk"]]
    cells = {}
    for one in data["cells"]:
        cells.setdefault(one["quantity"], {}).setdefault(one["engine"], {})[one["value"]] = one["verdict"]
    for name, engines in cells.items():
        unit = f" ({data['units'][name]})" if data["units"][name] else ""
        mine, better = engines["ours"], {v for v, verdict in engines["ours"].items() if verdict != "safe"}
        row = [name + unit, *(_values(mine, verdict) for verdict in ("safe", "degraded", "failed", "refused"))]
        for peer in ("Box2D 2.3", "pymunk"):
            found = engines.get(peer, {})
            further = ", ".join(f"{value:g}" for value in sorted(better) if found.get(value) == "safe")
            row.append(_values(found, "safe") + (f"; **further: {further}**" if further else ""))
        rows.append(row)
    return markdown(rows)


def _values(verdicts: dict, wanted: str) -> str:
    """The values with a verdict, neighbours among those tried as "from to last"."""
    found = [(low, high) for verdict, low, high in spans(verdicts, verdicts.values()) if verdict == wanted]
    return "; ".join(f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in found) or "–"


def columns() -> str:
    """Penetration of columns that stand in a silo, from figure_6_6.json."""
    data = read_results(REFERENCE / "figure_6_6.json")["data"]
    engines = ("ours", "Box2D 2.3", "pymunk")
    rows = [["column of 50 in a silo", *(f"{engine}, slops" for engine in engines)]]
    for name, found in data["silos"].items():
        depths = [found[engine].get("settled") if engine in found else None for engine in engines]
        rows.append([name, *("–" if depth is None else depth / LINEAR_SLOP for depth in depths)])
    return markdown(rows)


def tried() -> str:
    """What was done to find what the tests overlook, from mutants.json and fuzz_state_xml.json."""
    mutants = json.loads((REFERENCE / "mutants.json").read_text())
    fuzz = json.loads((REFERENCE / "fuzz_state_xml.json").read_text())
    rows = [["tried", "how many", "outcome"]]
    kinds = {"planted": "faults planted by hand", "automatic": "mutants of `physics/` and `sph/`, drawn at random"}
    for name, what in kinds.items():
        found = mutants[name]
        equal = f", {found['equivalent']} that change nothing" if found["equivalent"] else ""
        rows.append([what, str(found["tried"]), f"{found['found']} found by the tests{equal}"])
    wrong = len(fuzz["faults"])
    rows.append(["damaged state files", f"{fuzz['inputs']:,}", f"{wrong} crashes, hangs, or accesses to anything else"])
    return markdown(rows)


def trade() -> str:
    """Time of a step to a median velocity error on piles of 1,000, from tradeoff.json; in brackets over the best."""
    data = read_results(REFERENCE / "tradeoff.json")["data"]
    rows = [["pile", "velocity error", "best setting", "µs a step", "PGS from Builtin", "NNCG", "fastest peer"]]
    for kind in dict.fromkeys(row["kind"] for row in data["rows"]):
        mine = [row for row in data["rows"] if row["n_bodies"] == 1000 and row["kind"] == kind]
        peers = [
            {"us": row["us"], "setting": row["engine"], "velocity": {"p50": median(row["velocity"])}}
            for row in data["peers"]
            if row["n_bodies"] == 1000 and kind == "settling" and row["velocity"]
        ]
        for error in (0.3, 0.1, 0.03, 0.01, 0.001):
            best = best_within(data, 1000, kind, error)
            cells = [best["setting"] if best else "none", best["us"] if best else "–"]
            for rivals in (
                [r for r in mine if r["setting"] == "PGS"],
                [r for r in mine if r["setting"] == "NNCG"],
                peers,
            ):
                found = fastest_within(rivals, error, "p50")
                if found is None:
                    cells.append(f"not in {_number(max(row['us'] for row in rivals))}" if rivals else "–")
                else:
                    name = f"{found['setting']}, " if rivals is peers else ""
                    over = f" ({found['us'] / best['us']:.1f}×)" if best else ""
                    cells.append(f"{name}{_number(found['us'])}{over}")
            rows.append([kind, error, *cells])
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
    "trade": trade,
    "pushed": pushed,
    "columns": columns,
    "tried": tried,
    "inputs": of_script("table_6_2"),
    "size": of_script("figure_6_4"),
    "requires": of_script("figure_6_7"),
    "beyond": of_script("figure_6_9"),
    "runtimes": of_script("table_6_3"),
    "break even": of_script("figure_6_10", having="settling"),
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
