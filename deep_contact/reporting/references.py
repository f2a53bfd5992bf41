"""Which files of data/reference are true of today's code and inputs, and which are old, why, and what makes them.

A file is true if the code that made it is today's (`sources.code`) and so are its inputs. One that measures no time
also survives a change of modules that golden runs execute, as long as the golden runs are those of then, to the bit. A
time also needs the processor on which the others were measured.
"""

from __future__ import annotations

import json
from collections import Counter
from functools import cache
from pathlib import Path

from deep_contact.io import provenance, shipped, sources
from deep_contact.reporting import results, scripts

_SCRIPTS, _TOOLS = shipped.ROOT / "scripts", shipped.ROOT / "tests" / "tools"

STUDIES = {
    "run_tradeoff": [_SCRIPTS / "run_tradeoff.py"],
    "benchmark_engine": [_SCRIPTS / "benchmark.py", "engine"],
    "benchmark_step": [_SCRIPTS / "benchmark.py", "step"],
}
"""File of data/reference -> the script and options that write it; `--out` and the path follow."""

BY_HAND: dict[str, list] = {}

RECORDS = ("box2d_native", "fuzz", "golden", "mutants", "mutants_late", "ratios_before", "run_tradeoff_verify", "soak")
"""Files that say what was done once, at their commit: they grow true of no later code, nor old."""

TIMES = frozenset({
    *STUDIES, *BY_HAND,
    *(f"figure_{number}" for number in ("5_2", "5_10", "6_6", "6_7", "6_10", "6_14")),
})  # fmt: skip
"""Files that hold measured times."""


@cache
def commands() -> dict[str, list]:
    """File of data/reference -> its script and options, of all that can be old."""
    figures = {scripts.stem(path): [path] for path in scripts.find(_SCRIPTS).values()}
    return {name: command for name, command in (STUDIES | BY_HAND | figures).items() if _path(name).exists()}


def _path(name: str) -> Path:
    return results.REFERENCE / f"{name}.json"


@cache
def made(name: str) -> dict:
    """The provenance of a file of data/reference."""
    return json.loads(_path(name).read_text(encoding="utf-8"))["provenance"]


@cache
def processor() -> str:
    """On which most of the times were measured."""
    return Counter(made(name)["cpu"] for name in commands() if name in TIMES).most_common(1)[0][0]


@cache
def why_old(name: str) -> str:
    """Why a file of data/reference is not true any more; "" if it is true, or a record of what was done once."""
    if name in RECORDS:
        return ""
    return reason(made(name), commands()[name][0], is_time=name in TIMES)


def reason(stored: dict, script: Path, *, is_time: bool, root: Path = shipped.ROOT) -> str:
    """Why results with this provenance are not what a script would give today; "" if they are."""
    if "code" not in stored:
        return f"it does not say what code made it (commit {stored['commit'][:8]})"
    for name, digest in stored.get("inputs", {}).items():
        if provenance.digests([name]).get(name) != digest:
            return f"{name} has changed"
        if (path := Path(name)).parent.as_posix() == "data/reference" and why_old(path.stem):
            return f"{name} is old"
    now, no_numbers = sources.code(script, root), tuple(f"deep_contact/{name}" for name in sources.NO_NUMBERS)
    then = {file: digest for file, digest in stored["code"].items() if not file.startswith(no_numbers)}
    runs = sources.code(root / "tests" / "tools" / "golden.py", root)
    survives = not is_time and stored.get("golden") in sources.golden(root)
    held = runs.keys() | then.keys() - now.keys()  # what imported a file that is gone has changed itself
    held = {file for file in held if "/reference/" not in file}  # golden runs change with the settings of presets
    changed = [file for file in now | then if now.get(file) != then.get(file) and not (survives and file in held)]
    if changed := sorted(changed, key=lambda file: (file in runs, file)):
        return f"{', '.join(changed[:3])}{f' and {len(changed) - 3} more' if len(changed) > 3 else ''} changed"
    if is_time and stored["cpu"] != processor():
        return f"measured on {stored['cpu']}, the others on {processor()}"
    return ""


def stale() -> list[str]:
    """The files that are old: the cheap first, then those that hold times, then what is drawn from these."""

    def order(name: str):
        inputs = any(Path(one).stem in TIMES for one in made(name).get("inputs", {}))
        return name in BY_HAND, inputs, name in TIMES, made(name)["wall_s"]

    return sorted((name for name in commands() if why_old(name)), key=order)
