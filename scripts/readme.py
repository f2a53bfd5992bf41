"""python scripts/readme.py [--check]: fill the tables of README.md and docs/*.md from the files in data/reference.

A table stands between the lines `<!-- table: NAME -->` and `<!-- end -->`. NAME is a function of this file, or a script
such as figure_6_3, whose printed table is taken (`figure_6_3 poly6`: its rows with that cell). With --check nothing is
written, and the exit status is 1 if a table is not what its results file says.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import sys
from pathlib import Path

from deep_contact.recommendation import PRESETS
from deep_contact.reporting import page, results
from deep_contact.reporting.figures import cell
from deep_contact.reporting.results import replacing
from deep_contact.studies import mujoco_piles
from deep_contact.studies import outside as others
from deep_contact.studies.run_errors import ERRORS

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "data" / "reference"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
_BLOCK = re.compile(r"(<!-- table: (?P<name>[\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def stored(stem: str) -> dict:
    """A file of data/reference."""
    return json.loads((REFERENCE / f"{stem}.json").read_text(encoding="utf-8"))


def markdown(rows: list[list]) -> str:
    """Rows, head first, as a Markdown table."""
    head, *body = [[_text(value) for value in row] for row in rows]
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ["---"] * len(head), *body))


def _text(value, digits: int = 3) -> str:
    if isinstance(value, list):
        return "–".join(map(_text, value))
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.{digits}g}"
    return "–" if value is None else str(value).replace("|", "\\|")


def printed(stem: str, having: str | None = None) -> list[list]:
    """The table that a figure's script prints, of figure_6_9, say; or its rows with a certain cell."""
    path = next((ROOT / "scripts").glob(f"{stem}_[a-z]*.py"), None)
    if path is None:
        raise ValueError(f"table: expected a script's figure_C_N or one of {', '.join(TABLES)}, got {stem!r}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    head, *rows = module.FIGURE.table(stored(stem)["data"])
    return [head, *(row for row in rows if having is None or having in row)]


def learned() -> list[list]:
    """What a learned start gains and where it does not, in five rows."""

    def short(cells):
        return " / ".join(str(cell).split(" ")[0] for cell in cells)

    near = {row[0]: short(row[3:6]) for row in printed("figure_6_8") if row[1] == "all"}
    time = stored("figure_6_10")["claims"][0]["measured"]
    price = [time["far field"][f"{n} circles"]["in sweeps"] for n in (100, 1000)]
    where = "error over the best classical setting's with 3 / 10 / 30 sweeps from given states, price left out"
    return [
        ["learned start", "measured", "figure"],
        [f"network on images, guarded: {where}", near["guarded / best classical"], "6.8"],
        ["its price at 100 and 1,000 circles", "{:.0f} and {:.0f} sweeps".format(*price), "6.10"],
        [
            "cases in which it is faster to an error than the best classical setting",
            f"{time['wins']} of {time['cases']}",
            "6.10",
        ],
    ]


def engine() -> list[list]:
    """Ours beside the peers; in brackets the multiple of ours."""
    rows = [["pile", "engine", "contacts", "ns a contact and sweep", "overhead, µs a step", "step of 10 sweeps, µs"]]
    for case in stored("benchmark_engine")["data"]["cases"]:
        for name, cost in case["engines"].items():
            cells = [f"{case['n_bodies']:,} {case['kind']}", name, f"{cost['contacts']:.0f}"]
            for key in ("sweep_ns", "overhead_us", "step_us"):
                ratio = f" ({case['ratios'][name][key]:.2f}×)" if name in case["ratios"] else ""
                cells.append(_text(cost[key], 4) + ratio)
            rows.append(cells)
    return rows


def stages() -> list[list]:
    """Time of each stage of a step contact by contact, ns a circle, on piles of three sizes; its floor in brackets."""
    piles = {}
    for case in stored("benchmark_step")["data"]["cases"]:
        if case["n_bodies"] in (100, 10_000, 100_000) and case["kind"] != "falling":
            piles.setdefault((case["n_bodies"], case["kind"]), {})[case["engine"]] = case
    cases = list(piles.values())
    rows = [["stage, ns a circle (floor)", *(f"{n_bodies:,} {kind}" for n_bodies, kind in piles)]]
    for stage in cases[0]["sequential"]["stages"]:
        costs = [case["sequential"]["stages"][stage] for case in cases]
        rows.append([f"`{stage}`", *(f"{cost['ns']:.1f} ({cost['floor_ns']:.1f})" for cost in costs)])
    for name, engine in (("all", "sequential"), ("all, in batches by colours", "colours")):
        rows.append([name, *(f"{case[engine]['ns']:.0f}" for case in cases)])
    return rows


def runs() -> list[list]:
    """Microseconds of a step as users run it, by every method, and the memory of a run."""
    data = stored("benchmark_step")["data"]
    rows = [["pile", *data["runs"][0]["us"], "memory, MB"]]
    for run in data["runs"]:
        memory = data["memory_mb"].get(str(run["n_bodies"]))
        cells = [f"{us:,.1f}" if us < 1e3 else f"{us:,.0f}" for us in run["us"].values()]
        rows.append([f"{run['n_bodies']:,} {run['kind']}", *cells, f"{memory:,.0f}" if memory else "–"])
    return rows


def many() -> list[list]:
    """A step of many small piles by one call: on one core, on all, and a minute's steps of each core."""
    found = stored("benchmark_step")["data"]["many"]
    rows = [["16 piles of 100", "µs a step", "steps a minute and core"]]
    for name, us in found["us"].items():
        cores = found["cores"] if name == "all cores" else 1
        rows.append([name, f"{us:.1f}", f"{60e6 / us / cores:,.0f}"])
    return rows


def outside() -> list[list]:
    """Every method on every problem of others."""
    return others.table(stored("benchmark_outside"))


def disks() -> list[list]:
    """A step of Siconos's bench-disks: ours whole, and Siconos's solver alone."""
    rows = []
    for side, states in stored("benchmark_disks")["sides"].items():
        for state in states:
            errors = state["velocity_error"]
            cells = [f"{1e3 * seconds:.3g} ms, {errors[name]:.2g}" for name, seconds in state["seconds"].items()]
            residual = f"{state['reference_residual']:.0e}"
            rows.append([f"{side}²", state["step"], f"{state['contacts']:,}", *cells, residual])
    return [["discs", "step", "contacts", *errors, "reference's residual, m/s"], *rows]


def relaxation() -> list[list]:
    """Errors of the convex relaxation, by pile and μ."""
    return others.relaxation_table(stored("benchmark_outside"))


def mujoco() -> list[list]:
    """A step of settling piles in ours and in MuJoCo, and what comes out."""
    return mujoco_piles.table(stored("benchmark_outside")["mujoco"])


def starts() -> list[list]:
    """What starts are worth to every solver along a sequence."""
    return others.starts_table(stored("benchmark_starts"))


def transfer() -> list[list]:
    """Times of the transfer and of state files."""
    case, files = stored("benchmark_transfer"), stored("benchmark_state_xml")
    times = [[name, f"{_text(1e6 * seconds, 4)} µs"] for name, seconds in case["case"].items()]
    times += [[name, f"{_text(ratio)}×"] for name, ratio in case["ratio"].items()]
    kinds = [(way, suffix) for suffix in (".xml", ".xml.gz") for way in ("write", "read")]
    files = [[f"{way} a state as {suffix}", f"{files[suffix][way]['min_ms']:.3g} ms"] for way, suffix in kinds]
    return [["what", "time"], *times, *files]


def tried() -> list[list]:
    """What was done to find what the tests overlook."""
    fuzz = stored("fuzz")["targets"]

    def mutants(text, name):
        record = stored(name)
        explained = sum(found["explained"] is not None for found in record["mutants"].values())
        return [f"mutants of {text}", record["tried"], record["killed"], explained]

    return [
        ["tried", "how many", "found", "change nothing"],
        mutants("`physics/` and `sph/`", "mutants"),
        mutants("modules that the first sample hardly met", "mutants_late"),
        *(
            [f"fuzzing, {name}: crashes or hangs", f"{one['inputs']:,}", len(one["faults"]), None]
            for name, one in fuzz.items()
        ),
    ]


def presets() -> list[list]:
    """The errors of a run, and what each preset tolerates."""
    rows = [["error of a run", *PRESETS]]
    return rows + [[text, *(f"{PRESETS[preset][name]:g}" for preset in PRESETS)] for name, text in ERRORS.items()]


def claims(*, of_thesis: bool) -> list[list]:
    """Every claim of the thesis that a reference run has tested; or every goal of ours, with what was measured."""
    head = ["results", "goal", "met", "measured"]
    keys = ("text", "holds", "measured")
    if of_thesis:
        head, keys = ["figure", "thesis", "claim", "verdict", "by mean sweeps"], ("thesis", "text", "holds", "ours")
    files = [one for one in (stored(path.stem) for path in sorted(REFERENCE.glob("*.json"))) if "claims" in one]
    files.sort(key=lambda one: (one["id"][0] > "9", [int(n) for n in re.findall(r"\d+", one["id"])]))
    found = [(one["id"], claim) for one in files for claim in one["claims"] if bool(claim["thesis"]) == of_thesis]
    for _, claim in found:
        verdict = results.verdict(claim)
        if not of_thesis and not claim.get("verdict"):
            verdict = {True: "yes", False: "no", None: "open"}[claim["holds"]]
        claim["holds"] = f"**{verdict}**" if claim["holds"] is False else verdict
        claim["ours"] = claim["measured"].get("by that measure")
        claim["measured"] = "; ".join(f"{name} = {cell(value)}" for name, value in claim["measured"].items())
    return [head, *([id, *(claim[key] for key in keys)] for id, claim in found)]


def figures() -> list[list]:
    """Figures and tables with their pictures and scripts."""
    rows = [["figure", "shows", "script"]]
    for path in (ROOT / "scripts").glob("[ft]*_[3-6]_*.py"):
        stem = re.match(r"[a-z]+_\d+_\d+", path.stem)[0]
        found = stored(stem)
        rows.append([f"[{found['id']}](../data/reference/{stem}.png)", found["title"], f"`{path.name}`"])
    return [rows[0], *sorted(rows[1:], key=lambda row: ["table" in row[2], *map(int, re.findall(r"\d+", row[2])[:2])])]


def faults(kind: str) -> list[list]:
    """Faults of the thesis, or of its authors' code, and what is done here."""
    found = page.ERRATA[kind]
    return [list(found[0]), *(list(fault.values()) for fault in found)]


_MADE = (
    learned, engine, stages, runs, many, outside, disks, relaxation, mujoco, starts, transfer, tried, presets, figures,
)  # fmt: skip

TABLES = {table.__name__: table for table in _MADE} | {
    "claims": lambda: claims(of_thesis=True),
    "goals": lambda: claims(of_thesis=False),
    "errata": lambda: faults("Errata of the thesis"),
    "conventions": lambda: faults("Conventions and scope that differ here"),
    "code": lambda: faults("The authors' code beside the thesis"),
}


def filled(text: str) -> str:
    """The text with every table made anew. Raises ValueError on an unknown table."""

    def table(match: re.Match) -> str:
        name = match["name"]
        return f"{match[1]}{markdown(TABLES[name]() if name in TABLES else printed(*name.split()))}{match[3]}"

    return _BLOCK.sub(table, text)


def main() -> int:
    """Fill or check."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, fail if a table is out of date")
    check, stale = parser.parse_args().check, []
    for path in PAGES:
        before = path.read_text(encoding="utf-8")
        after = filled(before)
        if before != after and check:
            stale.append(path.name)
        elif before != after:
            with replacing(path) as temporary:
                temporary.write_text(after, encoding="utf-8")
    if stale:
        print(f"expected the tables of the results files in {stale}: run python scripts/readme.py", file=sys.stderr)
    return int(bool(stale))


if __name__ == "__main__":
    raise SystemExit(main())
