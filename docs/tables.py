"""python docs/tables.py [--check]: fill the tables of README.md and docs/*.md from data/reference.

A table stands between the lines `<!-- table: NAME -->` and `<!-- end -->`. NAME is a function of this file, or a script
such as figure_6_3, whose printed table is taken (`figure_6_3 poly6`: its rows with that word). With --check nothing is
written, and the exit status is 1 if a table is not what its results file says.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from statistics import median

import measured
from deep_contact.accuracy.presets import PRESETS
from deep_contact.figures import results, staleness
from deep_contact.figures.figure import cell
from deep_contact.io.files import write_bytes
from deep_contact.measure.errors import ERRORS
from deep_contact.studies import verdicts
from deep_contact.studies.starts import READ
from measured import REFERENCE, ROOT, stored

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
ERRATA: dict[str, list[dict]] = json.loads((ROOT / "docs" / "errata.json").read_text(encoding="utf-8"))
"""Kind of a fault of the thesis or of its authors' code -> one dict a fault: where it is, what the thesis says, what is
right, what is done here."""
_BLOCK = re.compile(r"(<!-- table: (?P<name>[\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def markdown(rows: list[list]) -> str:
    """Rows, head first, as a Markdown table."""
    head, *body = [[_text(value) for value in row] for row in rows]
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ["---"] * len(head), *body))


def _text(value, digits: int = 3) -> str:
    if isinstance(value, list):
        return "–".join(map(_text, value))
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.{digits}g}"
    text = "–" if value is None else str(value).replace("|", "\\|")
    return re.sub(r"(?<!\*)\*(?!\*)", r"\\*", text)  # v*, but not **bold**


def rows_of(stem: str, having: str | None = None) -> list[list]:
    """The table that a figure's script prints; or its rows that have a word between commas."""
    head, *rows = measured.printed(stem)
    return [head, *(row for row in rows if having is None or any(having in str(cell).split(", ") for cell in row))]


def engine(kind: str = "settled") -> list[list]:
    """Ours beside the peers on piles of a kind; in brackets the multiple of ours."""
    rows = [["pile", "engine", "contacts", "ns a contact and sweep", "overhead, µs a step", "step of 10 sweeps, µs"]]
    for case in stored("benchmark_engine")["data"]["cases"]:
        if case["kind"] != kind:
            continue
        for name, cost in case["engines"].items():
            cells = [f"{case['n_bodies']:,} {case['kind']}", name, f"{cost['contacts']:.0f}"]
            for key in ("sweep_ns", "overhead_us", "step_us"):
                ratio = f" ({case['ratios'][name][key]:.2f}×)" if name in case["ratios"] else ""
                cells.append(_text(cost[key], 4) + ratio)
            rows.append(cells)
    return rows


def noticed() -> list[list]:
    """What was done to find what the tests overlook, each with the commit at which it was done."""
    soak, fuzz = stored("soak"), stored("fuzz")["targets"]

    def at(record, again=None):
        return f"{record['provenance']['commit'][:8]}{f'; survivors again at {again[:8]}' if again else ''}"

    def mutants(text, name):
        record = stored(name)
        explained = sum(found["explained"] is not None for found in record["mutants"].values())
        when = at(record, record.get("tried_again", {}).get("commit"))
        return [f"mutants of {text}", record["tried"], record["killed"], explained, when]

    longest = max(unit["steps"] for unit in soak["units"])
    parted = sum(not unit["same"] or unit["outside"] > 0 for unit in soak["units"])
    return [
        ["tried", "how many", "found", "explained", "at commit"],
        mutants("`physics/` and `sph/`", "mutants"),
        mutants("modules that the first sample hardly met", "mutants_late"),
        *(
            [f"fuzzing, {name}: crashes or hangs", f"{one['inputs']:,}", len(one["faults"]), None, at(one)]
            for name, one in fuzz.items()
        ),
        [f"runs of up to {longest:,} steps: other bits, or a circle outside", len(soak["units"]), parted, None, at(soak)],
    ]


def presets() -> list[list]:
    """The errors of a run: what each preset tolerates, and in brackets the median of the scenes outside of the study."""
    found = {}
    for row in stored("run_tradeoff_verify")["data"]["rows"]:
        for name, error in row["errors"].items():
            if error is not None:
                found.setdefault((row["preset"], name), []).append(abs(error[0]))
    medians = {case: median(errors) for case, errors in found.items()}
    rows = [["error of a run", *PRESETS]]
    return rows + [
        [text, *(f"{PRESETS[preset][name]:g} ({medians[preset, name]:.2g})" for preset in PRESETS)]
        for name, text in ERRORS.items()
    ]


def units(radius: float = 0.01) -> list[list]:
    """What the presets tolerate of lengths and speeds, in mm and mm/s. radius: mean radius of the circles, m."""
    scales = {", % of r": (10 * radius, "mm"), ", % of √(g r)": (10 * math.sqrt(9.81 * radius), "mm/s")}
    rows = [[f"at r = {100 * radius:g} cm", *PRESETS]]
    for name, text in ERRORS.items():
        for end, (of_a_percent, unit) in scales.items():
            if text.endswith(end):
                values = (f"{PRESETS[preset][name] * of_a_percent:.2g}" for preset in PRESETS)
                rows.append([f"{text.removesuffix(end)}, {unit}", *values])
    return rows


def costs() -> list[list]:
    """What the presets take on plain piles, µs for 10 ms of simulated time."""
    us = {(row["n_bodies"], row["preset"]): row["kinds"]["plain"] for row in stored("figure_6_1")["data"]["presets"]}
    rows = [["circles", *PRESETS]]
    return rows + [
        [f"{n:,}", *(_us(us[n, preset]["us"]) if us[n, preset] else None for preset in PRESETS)]
        for n in dict.fromkeys(n for n, _ in us)
    ]


def each_rival() -> list[list]:
    """The time of each other engine over ours on plain piles, by size and preset."""
    rows = [["circles", "engine", *PRESETS]]
    for n in dict.fromkeys(row["n_bodies"] for row in stored("figure_6_1")["data"]["presets"]):
        for engine in measured.OTHERS:
            times = (measured.over_ours(engine, n, preset) for preset in PRESETS)
            rows.append([f"{n:,}", engine, *(time and f"{time:.1f}" for time in times)])
    return rows


def interval_of(value: float | None, low: float | None, high: float | None) -> str | None:
    """Such as "5.1 (4.0–6.3)"; an end that no setting makes is a question mark."""
    ends = "–".join(f"{end:.1f}" if end else "?" for end in (low, high))
    return value and f"{value:.1f} ({ends})"


def rivals() -> list[list]:
    """How many times as long as ours the fastest other engine takes for a preset on plain piles, and of how many settings."""
    times, tried = ratios(stored("figure_6_1")["data"]["presets"]), measured.settings_tried()
    head = ["circles", *PRESETS, f"settings: {' / '.join(next(iter(tried.values())))}"]
    return [head, *([f"{n:,}", *row, " / ".join(map(str, tried[n].values()))] for n, row in times.items())]


def rivals_short() -> list[list]:
    """`rivals` without settings."""
    return [row[:-1] for row in rivals()]


def sph_start() -> list[list]:
    """The sweeps at which the thesis's SPH start is ahead of Builtin or behind it, by the way back."""
    rows = [["SPH's θ is", *READ.values()]]
    for figure in ("3.8", "5.7"):
        stem = f"figure_{figure.replace('.', '_')}"
        below, half = ([measured.ahead(stem, sph, "builtin", share) for sph in READ] for share in (1.0, 0.5))
        above = [measured.ahead(stem, "builtin", sph) for sph in READ]
        rows += [[f"{text}, Figure {figure}", *(found or "none" for found in row)]
                 for text, row in (("below Builtin's", below), ("below half of it", half), ("above Builtin's", above))]  # fmt: skip
    return rows


def live() -> list[list]:
    """A step as users step, alone and beside a busy process on each of two cores; and the fastest other engine."""
    runs = stored("benchmark_live")["data"]["runs"]
    us = {(run["n_bodies"], run["busy"]): run["us"] for run in runs}
    ours = {"one call": "one call", "Simulator": "`Simulator.step()`", "on_step": "with `on_step`"}
    rows = [["circles", *ours.values(), "fastest other engine", "`Simulator`, busy cores", "fastest other, busy cores"]]
    for n in dict.fromkeys(run["n_bodies"] for run in runs):
        quiet, busy = us[n, 0], us[n, 2]
        best = min(measured.OTHERS, key=lambda name: quiet[name][0])
        cells = [_us(quiet[name][0]) for name in ours]
        beside = [_us(busy["Simulator"][1]), _us(min(busy[name][1] for name in measured.OTHERS))]
        rows.append([f"{n:,}", *cells, f"{_us(quiet[best][0])} ({best})", *beside])
    return rows


def _us(us: float) -> str:
    return f"{us:,.1f}" if us < 20 else f"{us:,.0f}"


def first_calls() -> list[list]:
    """Seconds from the start of a process to the first step, once the code is compiled."""
    found = stored("benchmark_live")["data"]["first"]
    return [["scene", "first call, s"], *([name, f"{seconds:.2f}"] for name, seconds in found.items())]


def compiling() -> list[list]:
    """What a first step compiles by the kind of scene: functions, lines, and processor time beside that of before."""
    rows = [["first step of", "functions", "lines for LLVM", "processor time, s", "before, s", "ratio"]]
    for kind, row in stored("compile_cost")["kinds"].items():
        now, before = (median(row[side]["seconds"]) for side in ("now", "before"))
        counts = (f"{row['now'][name]:,}" for name in ("functions", "lines"))
        rows.append([kind, *counts, f"{now:.1f}", f"{before:.1f}", f"{now / before:.2f}"])
    return rows


def kinds() -> list[list]:
    """What "fast" and "reference" cost for each kind of scene, in those of a plain pile of its size."""
    costs = {(row["n_bodies"], row["preset"]): row["kinds"] for row in stored("figure_6_1")["data"]["presets"]}
    sizes = dict.fromkeys(n for n, _ in costs)
    rows = [["kind of scene", *(f"{n:,} circles" for n in sizes)]]
    for kind in list(costs[next(iter(sizes)), "fast"])[1:]:
        rows.append([kind, *(" / ".join(_over_plain(costs[n, name], kind) for name in ("fast", "reference")) for n in sizes)])
    return rows


def _over_plain(of: dict, kind: str) -> str:
    """Such as "1.3": a kind's cost over that of plain piles; a dash where no setting keeps the preset for one of them."""
    ours, plain = of.get(kind), of["plain"]
    return f"{ours['us'] / plain['us']:.2g}" if ours and plain else "–"


def missed() -> list[list]:
    """Every scene outside of the study that missed a preset, strictly counted: the worst error over its tolerance."""
    cells = {}
    for row in stored("run_tradeoff_verify")["data"]["rows"]:
        most = PRESETS[row["preset"]]
        over = [(row["errors"][name][0] / most[name], name) for name, kept in row["kept"].items() if not kept]
        if over:
            times, name = max(over)
            within = "" if all(row["within"].values()) else "**"
            cells.setdefault((row["n_bodies"], row["kind"]), {})[row["preset"]] = f"{within}{name} {times:.3g}{within}"
    rows = [[f"{kind}, {n:,}", *(found.get(preset, "") for preset in PRESETS)] for (n, kind), found in sorted(cells.items())]
    return [["scene, circles", *PRESETS], *rows]


def ratios(found: list[dict]) -> dict[int, list]:
    """Circles -> the ratio of each preset with its interval."""
    of = {(row["n_bodies"], row["preset"]): interval_of(*row["ratio"]) for row in found}
    return {n: [of[n, preset] for preset in PRESETS] for n in dict.fromkeys(n for n, _ in of)}


def claims(*, of_thesis: bool) -> list[list]:
    """The claims of the thesis that reference runs have tested, or our goals with what was measured."""
    head = ["results", "goal", "met", "measured"]
    keys = ("text", "holds", "measured")
    if of_thesis:
        head, keys = ["figure", "thesis", "claim", "verdict", "ratio"], ("thesis", "text", "holds", "ratio")
    files = [one for one in (stored(path.stem) for path in sorted(REFERENCE.glob("*.json"))) if "claims" in one]
    files.sort(key=lambda one: (one["id"][0] > "9", [int(n) for n in re.findall(r"\d+", one["id"])]))
    found = [(one["id"], dict(claim)) for one in files for claim in one["claims"] if bool(claim["thesis"]) == of_thesis]
    for id, claim in found:
        verdict, claim["thesis"] = results.verdict(claim), (claim["thesis"] or "").removesuffix(f", Figure {id}")
        if not of_thesis and not claim.get("verdict"):
            verdict = {True: "yes", False: "no", None: "open"}[claim["holds"]]
        claim["holds"] = f"**{verdict}**" if claim["holds"] is False else verdict
        claim["ratio"] = ratio(claim["measured"])
        claim["measured"] = "; ".join(f"{name} = {cell(value)}" for name, value in claim["measured"].items())
    return [head, *([id, *(claim[key] for key in keys)] for id, claim in found)]


def ratio(measured: dict) -> str | None:
    """The ratio that decides a claim with its interval, by sweep where it is one of curves."""

    def text(value, low, high):
        return f"{value:.3g} ({low:.3g} to {high:.3g})"

    if verdicts.BY_SWEEP in measured:
        return "; ".join(f"{k}: {text(*found)}" for k, found in measured[verdicts.BY_SWEEP].items() if k != "1")
    return text(*measured[verdicts.RATIO]) if verdicts.RATIO in measured else None


def figures() -> list[list]:
    """Figures and tables with their pictures, what the thesis's claims came to, and what goals of ours."""
    rows = []
    for path in (ROOT / "scripts").glob("[ft]*_[3-6]_*.py"):
        stem = re.match(r"[a-z]+_\d+_\d+", path.stem)[0]
        if (REFERENCE / f"{stem}.json").exists():
            found = stored(stem)
            whose = ([claim for claim in found["claims"] if bool(claim["thesis"]) == of] for of in (True, False))
            outcomes = map(outcome, whose, (("hold", "does not hold"), ("met", "missed")))
            rows.append([f"[{found['id']}](../data/reference/{stem}.png)", found["title"], *outcomes])
    rows.sort(key=lambda row: ["T" in row[0], *map(int, re.findall(r"\d+", row[0])[:2])])
    return [["figure", "shows", "claims of the thesis", "goals of ours"], *rows]


def outcome(claims: list[dict], words: tuple[str, str]) -> str | None:
    """How many hold and what came out otherwise, as sentences; None without claims. words: of true and of false ones."""
    right, wrong = words
    held = sum(claim["holds"] is True for claim in claims)
    undecided = [results.verdict(claim).startswith("open") for claim in claims if claim["holds"] is None]
    parts = {"open": sum(undecided), "in part or within the noise": undecided.count(False)}
    counted = [f"{held} of {len(claims)} {right}", *(f"{count} {name}" for name, count in parts.items() if count)]
    others = [(results.verdict(claim), claim["text"]) for claim in claims if claim["holds"] is False]
    found = [f"**{says.replace('does not hold', wrong).capitalize()}**: {text}." for says, text in others]
    return " ".join([f"{', '.join(counted)}.", *found]) if claims else None


def elements() -> list[list]:
    """Every section, equation, algorithm, figure, table, goal and item of future work of the thesis."""
    lines = (ROOT / "docs" / "elements.txt").read_text(encoding="utf-8").splitlines()
    rows = [f"{line} | ".split(" | ")[:4] for line in lines]
    return [["element", "right", "here", "why"], *([*row[:2], f"`{row[2]}`", row[3]] for row in rows)]


def errata(kind: str) -> list[list]:
    """Faults of the thesis, or of its authors' code, and what is done here."""
    found = ERRATA[kind]
    return [list(found[0]), *(list(fault.values()) for fault in found)]


def silos() -> list[list]:
    """Janssen's K by the walls and the height of a silo, the mean of its seeds."""
    found = {}
    for row in measured.law("janssen"):
        found.setdefault((row["walls"], row["friction"]), {}).setdefault(row["height"], []).append(row["K"])
    heights = sorted({height for of in found.values() for height in of})
    rows = [["walls", *(f"{height} diameters" for height in heights), "largest over smallest"]]
    for (walls, friction), of in found.items():
        means = {height: sum(ks) / len(ks) for height, ks in of.items()}
        name = "glued discs" if walls == "glued" else f"a material, μ = {friction:g}"
        rows.append([name, *(f"{means[height]:.2f}" for height in heights), f"{max(means.values()) / min(means.values()):.2f}"])
    return rows


def collapses() -> list[list]:
    """Run-out (L∞ − L₀) / L₀ of columns by aspect ratio, rolling resistance and width, the mean of its seeds."""
    found = {}
    for row in measured.law("collapse"):
        found.setdefault((row["rho"], row["width"]), {}).setdefault(row["aspect"], []).append(row["run-out"])
    aspects = sorted({aspect for of in found.values() for aspect in of})
    rows = [["ρ over the mean radius", "discs side by side", *(f"a = {aspect:g}" for aspect in aspects)]]
    for (rho, width), of in sorted(found.items()):
        cells = (f"{sum(of[aspect]) / len(of[aspect]):.1f}" if aspect in of else None for aspect in aspects)
        rows.append([f"{rho / 0.45:.1f}", f"{width}", *cells])
    return rows


def cooling() -> list[list]:
    """Rates of gases that cool over that of Haff's law, by events and by Δt, with standard errors."""
    dense, thin, early = (measured.law(f"haff, side {of}") for of in ("128, 80 s", "256, 320 s", "128, 4 s"))
    lost = {(row["seed"], row["by"]): row["lost"] for row in early}
    rows = [["Δt, s", *(f"rate, {100 * of[0]['covered']:.1f} % covered" for of in (dense, thin)), "energy lost in 4 s over that by events"]]
    for by in dict.fromkeys(row["by"] for row in dense):
        rates = ([row["rate over theory"] for row in of if row["by"] == by] for of in (dense, thin))
        losses = [value / lost[seed, "events"] for (seed, kind), value in lost.items() if kind == by != "events"]
        rows.append(["by events" if by == "events" else by, *map(measured.mean_and_error, (*rates, losses))])
    return rows


def ramps() -> list[list]:
    """Differences of runs whose load changes in every step from runs that are solved anew, the largest of all presets."""
    rows = [["ramp", "mean height differs by, m", "shaken, m", "top speed differs by, m/s", "shaken, m/s"]]
    for name in dict.fromkeys(row["ramp"] for row in measured.law("ramps")):
        cells = (max(values) for of in ("height", "top speed") for values in measured.apart(name, of))
        rows.append([name, *(measured.written(cell, ".1e") for cell in cells)])
    return rows


_MADE = (
    *(engine, live, first_calls, compiling, noticed, presets, units, costs, each_rival, rivals, rivals_short, kinds, missed),
    *(figures, sph_start, elements, silos, collapses, cooling, ramps),
)

TABLES = {table.__name__.replace("_", " "): table for table in _MADE} | {
    "claims": lambda: claims(of_thesis=True),
    "goals": lambda: claims(of_thesis=False),
    "errata": lambda: errata("Errata of the thesis"),
    "conventions": lambda: errata("Conventions and scope that differ here"),
    "authors code": lambda: errata("The authors' code beside the thesis"),
    "engine falling": lambda: engine("falling"),
}


def filled(page: str, text: str) -> str:
    """The text of a page with every table and number made anew. Raises ValueError on an unknown table or sentence."""

    def table(match: re.Match) -> str:
        name = match["name"]
        return f"{match[1]}{markdown(TABLES[name]() if name in TABLES else rows_of(*name.split()))}{match[3]}"

    return measured.filled(page, _BLOCK.sub(table, text))


def old_on(page: str, text: str) -> str:
    """What the site says of the files of data/reference behind a page's numbers and pictures that are old; "" for none."""
    measured.printed.cache_clear()
    measured.USED.clear()
    filled(page, text)
    used = sorted(measured.USED | set(re.findall(r"data/reference/(\w+)\.png", text)))
    old = [f"<li><code>{name}</code>: {why}</li>" for name in used if (why := staleness.why_old(name))]
    title = f"{len(old)} of the {len(used)} results behind this page were made before the code last changed: which, and why"
    return f"<details><summary>{title}</summary><ul>{''.join(old)}</ul></details>\n" if old else ""


def main() -> int:
    """Fill or check."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, fail if a table is out of date")
    asked, stale = parser.parse_args(), []
    for path in PAGES:
        before = path.read_text(encoding="utf-8")
        after = filled(path.name, before)
        if before != after and asked.check:
            stale.append(path.name)
        elif before != after:
            write_bytes(path, after.encode())
    if stale:
        print(f"expected the numbers of the results files in {stale}: run python docs/tables.py", file=sys.stderr)
    return int(bool(stale))


if __name__ == "__main__":
    raise SystemExit(main())
