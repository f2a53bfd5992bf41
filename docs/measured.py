"""Where the measured numbers in the sentences of README.md and docs/*.md come from. `docs/tables.py` fills them.

SENTENCES has, by page, pieces of its text with a `{}` for each number, and a function that makes the numbers from files
of data/reference. GIVEN has, by page, the pieces whose numbers were chosen, not measured. A number with a decimal
point, a unit of time, % or × that is in neither fails a test.

Pages are read as they stand in the repository, so the numbers stand in them: a template would be a second copy of each.
"""

from __future__ import annotations

import importlib.util
import json
import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from string import Formatter

import numpy as np

from deep_contact.constants import TIME_STEP
from deep_contact.presets import PRESETS
from deep_contact.studies.chapter_5 import (
    NETWORKS,
    READ_NETWORK,
    THESIS_VISITS,
    networks_info,
)
from deep_contact.studies.learned_starts import CLASSICAL, best_errors
from deep_contact.studies.starts import READ
from deep_contact.studies.verdicts import BY_SWEEP, RATIO, intervals, ranges

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "data" / "reference"
NUMBER = r"[-−]?\d[\d,]*(?:\.\d+)?(?:e-?\d+)?"


USED = set()
"""Files of data/reference that were read."""


def stored(stem: str) -> dict:
    """A file of data/reference."""
    USED.add(stem)
    return _read(stem)


@cache
def _read(stem: str) -> dict:
    return json.loads((REFERENCE / f"{stem}.json").read_text(encoding="utf-8"))


@cache
def printed(stem: str) -> list[list]:
    """The table that a figure's script prints, of figure_6_3, say, head first."""
    path = next((ROOT / "scripts").glob(f"{stem}_[a-z]*.py"), None)
    if path is None:
        raise ValueError(f"table: expected a script's figure_C_N, got {stem!r}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.FIGURE.table(stored(stem)["data"])


def cell(stem: str, row: str, column: str):
    """A cell of a printed table, by the first cell of its row and the head of its column."""
    head, *rows = printed(stem)
    (found,) = (cells[head.index(column)] for cells in rows if cells[0] == row)
    return found


def claim(stem: str, text: str) -> dict:
    """What decided the one claim of a file whose text contains this: name -> value."""
    (found,) = (one["measured"] for one in stored(stem)["claims"] if text in one["text"])
    return found


def spread(values) -> tuple[float, float]:
    """The least and the largest of some numbers."""
    values = list(values)
    return min(values), max(values)


# ---- runs ----


def rivals() -> tuple[float, float]:
    """The least and the most times that the fastest rival takes as long as ours for a preset."""
    found = (row["ratio"][0] for row in stored("figure_6_1")["data"]["presets"])
    return spread(ratio for ratio in found if ratio)


def native_share(build: str, n_bodies: int | None = None) -> list[float]:
    """What Box2D v3 compiled natively takes of its Python package's time, a number for each size and number of substeps."""
    found = (row for row in stored("box2d_native")["data"]["results"] if n_bodies in (None, row["n"]))
    return [1.0 / row["package_over_native"][build][0] for row in found]


def rivals_with_native() -> tuple[float, float]:
    """As `rivals`, where Box2D v3 costs what its version of today does if it is compiled natively."""
    found = []
    for row in stored("figure_6_1")["data"]["presets"]:
        share = {"Box2D v3": float(np.mean(native_share("head-avx2", row["n_bodies"])))}
        costs = [share.get(engine, 1.0) * cost["us"] for engine, cost in row["peers"].items() if cost]
        ours = row["kinds"]["plain"]
        found += [min(costs) / ours["us"]] if costs and ours else []
    return spread(found)


def before() -> list[float]:
    """What was published: the least and the most ratio; a step's time with its world's destruction, and that alone, ms."""
    data = stored("ratios_before")["data"]
    with_it, alive = (data["step_of_pymunk_ms"][name] for name in ("destroyed", "alive"))
    return [*spread(row["ratio"][0] for row in data["ratios"] if row["ratio"][0]), with_it - alive, with_it]


def verified(counted: str = "kept") -> list:
    """How many cells outside of the study each preset kept, strictly or "within" the interval."""
    data = stored("run_tradeoff_verify")["data"]
    return [sum(all(row[counted].values()) for row in data["rows"] if row["preset"] == preset) for preset in PRESETS]


def cells_outside() -> int:
    """Kinds and sizes of scenes outside of the study."""
    return len(stored("run_tradeoff_verify")["data"]["rows"]) // len(PRESETS)


def costs_outside() -> tuple[float, float]:
    """Least and most cost over the predicted one, of scenes without tens of segments."""
    rows = stored("run_tradeoff_verify")["data"]["times"]
    return spread(row["us"] / row["predicted_us"] for row in rows if row["kind"] not in ("terrain", "slow drum", "heavy drum"))


def walls() -> tuple:
    """Figure 6.16: the least and the most ratio; cells in which what accuracy= takes keeps its preset, all cells, and
    those in which it does within the interval of the seeds."""
    scenes = stored("figure_6_16")["data"]["scenes"]
    ratios = spread(row["ratio"][0] for one in scenes for row in one["presets"] if row["ratio"][0])
    taken = [one["measured"] for one in stored("figure_6_16")["claims"] if "accuracy= takes" in one["text"]]
    of, missed, beyond = (sum(one[name] for one in taken) for name in ("of", "missed", "beyond the interval"))
    return *ratios, of - missed, of, of - beyond


def four_sweeps(**setting) -> dict:
    """The study's row of plain piles of 1,000 with 4 sweeps of PGS and a setting."""
    wanted = {"method": "PGS", "sweeps": 4} | setting
    rows = stored("run_tradeoff")["data"]["rows"]
    (row,) = (r for r in rows if (r["n_bodies"], r["kind"], r["setting"]) == (1000, "plain", wanted))
    return row


BY_MOTION = {"dt": 0.005, "most_substeps": 8, "slop": 0.25}
"""Two to sixteen substeps of 10 ms, and a quarter of the slop."""


def penetration(**setting) -> float:
    """Mean penetration at rest with `four_sweeps`, % of r."""
    return four_sweeps(**setting)["errors"]["penetration"][0]


def deepest(**setting) -> tuple[float, float]:
    """Deepest penetration with `four_sweeps`, % of r, and time of 10 ms, µs."""
    row = four_sweeps(**setting)
    return row["errors"]["penetration_max"][0], row["us"]


def smaller_steps() -> list[tuple[dict, dict]]:
    """Of each size: the row of 20 sweeps a step of Δt, and the row with the least depth for its price in smaller steps."""
    pairs = []
    for n in (100, 1000, 3000, 10000):
        rows = [row for row in stored("run_tradeoff")["data"]["rows"] if (row["n_bodies"], row["kind"]) == (n, "plain")]
        rows = [row for row in rows if row["setting"].keys() == {"method", "sweeps", "dt"} and row["us"] is not None]
        rows = [row for row in rows if row["setting"]["method"] == "PGS"]
        (solved,) = (row for row in rows if (row["setting"]["dt"], row["setting"]["sweeps"]) == (TIME_STEP, 20))
        cheaper = [row for row in rows if row["setting"]["dt"] < TIME_STEP and row["us"] <= solved["us"]]
        pairs.append((solved, min(cheaper, key=lambda row: row["errors"]["penetration_max"][0])))
    return pairs


def smaller_step_over_20_sweeps(error: str) -> tuple[float, float]:
    """The least and the most of an error with the smaller step, over that with 20 sweeps."""
    return spread(best["errors"][error][0] / solved["errors"][error][0] for solved, best in smaller_steps())


def safe(engine: str, *quantities: str) -> list[float]:
    """The largest values of Figure 6.6 up to which quantities are safe."""
    return [float(str(cell("figure_6_6", name, f"{engine}: safe")).split(" ")[-1]) for name in quantities]


def saved(row: str) -> float:
    """How many times cheaper a step or sweep is without what its scene does not require (Figure 6.7)."""
    return cell("figure_6_7", row, "times cheaper")


def in_own_runs(*starts: str) -> list[float]:
    """Mean sweeps to the threshold of starts in runs of their own (Figure 3.8)."""
    return [stored("figure_3_8")["data"]["independent"][start]["sweeps"]["mean"] for start in starts]


def lost(way: str) -> float:
    """Relative change of impulses on a way through the grid, by poly6 at d = h = 0.5 m (Figure 6.3)."""
    (row,) = (r for r in stored("figure_6_3")["data"]["rows"] if (r["kernel"], r["d"], r["h"]) == ("poly6", 0.5, 0.5))
    return row[way]


# ---- learned starts ----


def worth() -> np.ndarray:
    """Sweeps of the best classical setting that leave the network's error after 3, 10 and 30 (Figure 6.8, all steps).

    Between the numbers of sweeps that were measured, the logarithm of the error is taken as linear.
    """
    data = stored("figure_6_8")["data"]
    classical = np.log(best_errors(data["scenes"], CLASSICAL).mean(axis=0))
    network = np.log(best_errors(data["scenes"], ["far field"]).mean(axis=0))
    columns = [data["after"].index(k) for k in AFTER]
    return np.interp(-network[columns], -classical, data["after"])


def price(n_bodies: int) -> float:
    """Sweeps of PGS in the time of the network `model.h5`, its images included (Figure 5.10), median over states."""
    found = stored("figure_5_10")["data"]["piles"][str(n_bodies)]["starts"]["cnn"]
    seconds = {stage: np.array(values) for stage, values in found["seconds"].items()}
    a_sweep = seconds.pop("solve") / np.array(found["sweeps"])
    return float(np.median(sum(seconds.values()) / a_sweep))


def width(friction: float = 0.5, circles: int = 100, *, scene: str = "resting", radii: str = "0.8") -> float:
    """Figure 6.15: of the interval of the median contact of resting circles, over the mean λ_n."""
    name = f"{circles} circles, {scene}, μ = {friction:g}, radii from {radii} m"
    return claim("figure_6_15", "interval of the median")[name]


def elsewhere() -> list[float]:
    """Figure 6.15: of PGS from zero, the distance from the run's impulses; of model.h5, that and its velocity error."""
    errors = claim("figure_6_15", "that know no past")
    return [errors["PGS from zero"][0], *errors["model.h5"]]


# ---- the thesis ----


def sweeps(stem: str, text: str) -> list[int]:
    """The numbers of sweeps in the verdict on the one claim of a file whose text contains this."""
    (found,) = (one["verdict"] for one in stored(stem)["claims"] if text in one["text"])
    return [int(number) for number in re.findall(r"\d+", found)]


def ratio_after(stem: str, text: str, after: int) -> list[float]:
    """What decided the one claim of a file whose text contains this after so many sweeps: ratio, low, high."""
    return claim(stem, text)[BY_SWEEP][str(after)]


def both_ways() -> tuple[int, int]:
    """Claims on SPH that were judged for both ways back, and how many of their verdicts are another by spline."""
    printed, spline = READ.values()
    pairs = []
    for stem in ("figure_3_8", "figure_5_4", "figure_5_5", "figure_5_6", "figure_5_7", "figure_5_9"):
        holds = {claim["text"]: claim["holds"] for claim in stored(stem)["claims"]}
        other = {text.replace(spline, printed): value for text, value in holds.items() if spline in text}
        pairs += [(holds[text], value) for text, value in other.items() if text in holds]
    return len(pairs), sum(one is not other for one, other in pairs)


def times_builtin(network: str) -> float:
    """Time of a network's start to θ < 6e-5 in piles of 100 circles, over that of Builtin's (Figure 5.10)."""
    named = f"100 circles, CNN ({network})"
    claims = (one for one in stored("figure_5_10")["claims"] if one["text"].startswith(named))
    (found,) = (one["measured"][RATIO][0] for one in claims if "not efficient" in one["text"])
    return found


def by_tree() -> dict:
    """What was measured of the interpolation by a k-d tree (Figure 5.10)."""
    return claim("figure_5_10", "interpolation alone")


def ahead(stem: str, first: str, second: str) -> list[int]:
    """Ends of the ranges of sweeps at which the first start's θ is below the second's, by intervals of 95 %."""
    data = stored(stem)["data"]
    below = intervals(data["independent"], first, second)[2] < 1
    return [int(number) for number in re.findall(r"\d+", ranges(data["sweep"], below))]


PEAK = 11.3e12
"""Of a GeForce GTX 1080 Ti, FLOP/s in float32, by its maker."""


def training_work() -> tuple[float, float]:
    """PFLOP of the thesis's training, a state forward and back being three times forward, and % of `PEAK` for a day."""
    layers = (layer for layer in stored("table_5_1")["data"]["built"] if layer["kernel"] or layer["kind"] == "Dense")
    forward = sum(2 * layer["parameters"] * math.prod(layer["shape"][:-1]) for layer in layers)
    work = 3 * forward * THESIS_VISITS
    return work / 1e15, 100 * work / PEAK / 86400


def training_share() -> float:
    """States that the thesis's training showed, over those that the training of its network here did."""
    return THESIS_VISITS / networks_info(NETWORKS)["cnn thesis"]["visits"]


AFTER = (3, 10, 30)
"""Sweeps after which the errors of Figure 6.8 are compared."""

Numbers = Callable[[], object]

SENTENCES: dict[str, list[tuple[str, Numbers]]] = {
    "accuracy.md": [
        ("pymunk takes {:.1f} to {:.1f} times as long for the same error", rivals),
        (
            "This page once said {:.1f} to {:.1f} times. Rivals paid for the destruction of their worlds: {:.0f} of the {:.0f} ms",
            before,
        ),
        (
            "natively (version 3.2.0, not yet released, gcc 12.2, -O3 -mavx2) it takes {:.2f} to {:.2f} of its package's time, "
            "version 3.1.1, which the package has, {:.2f} to {:.2f}. With the former the range is {:.1f} to {:.1f}",
            lambda: [*spread(native_share("head-avx2")), *spread(native_share("v3.1.1-avx2")), *rivals_with_native()],
        ),
        ("rival takes {:.1f} to {:.1f} times as long as ours for the same preset", lambda: walls()[:2]),
        ("`accuracy=` takes keeps its preset in {} of {} cases, in {} within the interval of the seeds", lambda: walls()[2:]),
        (
            "Mass ratios of {:g}, columns of {:,.0f} circles and coordinates of {:g} m are safe",
            lambda: safe("ours", "mass ratio, heavy on light", "column height", "coordinate"),
        ),
        (
            "sleeps costs 1/{:.0f} of one that is awake, and a sweep without friction 1/{:.1f} of one with it",
            lambda: [saved("asleep: a step"), saved("no tangent rows, no spin: a sweep, 100 circles")],
        ),
        (
            "checked on {} kinds and sizes of scenes outside the study, from 100 to 10,000 circles: other seeds, radii, "
            "friction, heights, densities, time steps and restitutions, hoppers, terrain, a low dam, a thinner gas, a "
            'slower drum. All tolerances were kept in {} cells by "preview", {} by "fast", {} by "balanced", {} by '
            '"accurate" and {} by "reference"; if a miss counts only beyond the interval of the seeds, in {}, {}, {}, {} '
            "and {}. Costs were {:.2f} to {:.2f} times the predicted ones, but where there are segments",
            lambda: [cells_outside(), *verified(), *verified("within"), *costs_outside()],
        ),
        (
            "Safe are mass ratios to {:g}, radius ratios to {:,.0f}, columns of {:,.0f} circles, pyramids of {:.0f} "
            "rows",
            lambda: safe("ours", "mass ratio, heavy on light", "radius ratio", "column height", "pyramid rows"),
        ),
        (
            "to {:g} s, speeds to {:g} m/s and coordinates to {:g} m",
            lambda: safe("ours", "time step", "speed", "coordinate"),
        ),
        (
            "safe to a mass ratio of {:.0f}, columns of {:.0f} circles and pyramids of {:.0f} rows",
            lambda: safe("Box2D 2.3", "mass ratio, heavy on light", "column height", "pyramid rows"),
        ),
        (
            "has {} to {} sweeps and {:.2f} to {:.2f} of the deepest penetration",
            lambda: [
                *spread(best["setting"]["sweeps"] for _, best in smaller_steps()),
                *smaller_step_over_20_sweeps("penetration_max"),
            ],
        ),
        (
            "is {:.1f} to {:.1f} times as far from the reference's as that of 20 sweeps",
            lambda: smaller_step_over_20_sweeps("energy"),
        ),
        (
            "mean penetration of {:.2f} % of r at rest, one step with the whole slop {:.2f} %",
            lambda: [penetration(**BY_MOTION), penetration(dt=0.01)],
        ),
        (
            "Radii that differ {:,.0f} times degrade",
            lambda: [float(cell("figure_6_6", "radius ratio", "ours: degraded"))],
        ),
        (
            "circles sink at most {:.1f} % of r into each other, and 10 ms of the run take {:.0f} µs. With one step of 10 ms they "
            "sink at most {:.1f} %, and it takes {:.0f} µs. With eight fixed substeps they sink at most {:.1f} %, and these take "
            "{:.0f} µs",
            lambda: [*deepest(**BY_MOTION), *deepest(dt=0.01), *deepest(dt=0.00125)],
        ),
    ],
    "README.md": [
        ("pymunk takes {:.1f} to {:.1f} times as long", rivals),
        ("compiled natively the range is {:.1f} to {:.1f}", rivals_with_native),
        ("on terrain, in drums and in hoppers {:.1f} to {:.1f} times", lambda: walls()[:2]),
    ],
    "other_starts.md": [
        (
            "loses {:.2f} of the impulse of an isolated contact and {:.2f} of those of a falling pile",
            lambda: [lost("isolated, thesis"), lost("pile, thesis")],
        ),
        ("*sph* takes {:,.0f} sweeps, more than *none* with {:,.0f}", lambda: in_own_runs("sph", "none")),
        ("field of ones, {:.0e} on the pile", lambda: [lost("pile, consistent")]),
        ("weights that sum to one, {:.0e}. This", lambda: [lost("pile, authors' sharing")]),
        ("for the SPH image: {:.2f} on the pile", lambda: [lost("pile, authors' spline")]),
    ],
    "starts.md": [
        (
            "μ = 0.5 they leave the median contact an interval of {:.1f} times the mean λ_n (without friction {:.2f}), and in one "
            "of 1,000 circles {:.0f} times",
            lambda: [width(), width(0), width(circles=1000)],
        ),
        ("Solvers from other starts end {:.2f} of the mean λ_n", lambda: elsewhere()[:1]),
        ("ends {:.3f} from its impulses and {:.2f} off in velocity", lambda: elsewhere()[1:]),
        (
            "3 sweeps from the network leave as small an error as {:.1f} sweeps of the best classical setting; 10 sweeps are "
            "worth {:.1f}, and 30 are worth {:.1f}",
            worth,
        ),
        ("takes the time of {:.0f} sweeps, for 1,000 circles", lambda: [price(1000)]),
        ("This network saves {:.1f}, {:.1f} and {:.1f} sweeps where", lambda: worth() - AFTER),
    ],
    "thesis.md": [
        (
            "scene an interval of {:.2f} times the mean λ_n. So in the worst case no network can promise an error below {:.2f} "
            "of it; what PGS finds from zero is {:.2f} off",
            lambda: (width(scene="thesis", radii="1"), width(scene="thesis", radii="1") / 2, elsewhere()[0]),
        ),
        (
            "is faster than Builtin at sweeps {} to {} (Figure 5.9)",
            lambda: sweeps("figure_5_9", "CNN (model.h5) converges faster than Builtin"),
        ),
        ("it takes {:.1f} times Builtin's time;", lambda: [times_builtin("model.h5")]),
        ("Of {} claims on SPH that were judged both ways, {} have another verdict by spline", both_ways),
        (
            "Bilinear, it converges faster than Builtin at sweeps {} to {}, by spline at sweeps {} to {} (Figure 3.8)",
            lambda: ahead("figure_3_8", "sph", "builtin") + ahead("figure_3_8", "sph spline", "builtin"),
        ),
        (
            "bilinear SPH is slower at sweeps {} to {:,} of Figure 3.8 and {} to {} of Figure 5.7, by spline at none of "
            "Figure 3.8 and {:,} to {:,} of Figure 5.7",
            lambda: [
                number
                for start in ("sph", "sph spline")
                for stem in ("figure_3_8", "figure_5_7")
                for number in ahead(stem, "builtin", start)
            ],
        ),
        (
            "θ at most half of Builtin's, it has at sweeps {} to {}, or {} to {} by spline (Figure 5.7)",
            lambda: [
                *sweeps("figure_5_7", "bilinear (printed), gets convergence much faster than Builtin")[:2],
                *sweeps("figure_5_7", "spline (authors' code), gets convergence much faster than Builtin")[:2],
            ],
        ),
        (
            "with one that loses nothing it is faster up to sweep {:,}",
            lambda: sweeps("figure_3_8", "with the consistent transfer SPH is faster than Builtin")[1:],
        ),
        (
            "leaves {:.2f} of the θ of d = h = 0.5 m after 100 sweeps, with an interval of {:.2f} to {:.2f}",
            lambda: ratio_after("figure_3_8", "the authors' setting", 100),
        ),
        (
            "converges like None at sweeps {} to {} only, more slowly at {} to {} and faster at {} to {:,}",
            lambda: [
                *sweeps("figure_3_7", "Builtin performs like None")[:2],
                *ahead("figure_3_7", "none", "builtin"),
                *ahead("figure_3_7", "builtin", "none"),
            ],
        ),
        (
            "d = 0.25 m is the fastest by bilinear spiky at sweeps {} to {};",
            lambda: sweeps("figure_5_5", "bilinear (printed), is a bit faster than any other of 0.25 to 0.75 m"),
        ),
        ("was shown 1/{:.1f} as many states", lambda: [training_share()]),
        (
            "Its λ is off by {:.2f} on a falling pile, {:.2f} read as in their code, where zero is off by 1 (Figure 4.3)",
            lambda: list(stored("figure_4_3")["data"]["relative error of λ"].values())[:2],
        ),
        (
            "its θ after 100 sweeps is {:.2f} of None's, {:.2f} read as in their code (Figure 5.9)",
            lambda: [
                ratio_after("figure_5_9", f"CNN (thesis_factored.h5){read} is a start", 100)[0]
                for read in READ_NETWORK.values()
            ],
        ),
        ("alone takes {:.0f} times Builtin's time to θ < 6e-5", lambda: [by_tree()[RATIO][0]]),
        ("compiled here, {:.2f} of it", lambda: [by_tree()["mean compiled here, ms"] / by_tree()["mean builtin, ms"]]),
        (
            "angular momentum to {:.2f} % (Figure 6.3)",
            lambda: [100 * float(np.mean(stored("figure_6_3")["data"]["by scene"]["angular momentum"]))],
        ),
        ("are {:.0f} PFLOP, over a day {:.0f} % of the card's peak", training_work),
    ],
}
"""Page -> pieces of its text, and the function that makes their numbers."""

GIVEN: dict[str, list[str]] = {
    "README.md": ["a run of 6 s", "μ = 0.5"],
    "accuracy.md": [
        *(
            "at most 85 % of the tolerances",
            "restitutions of 0.3 and 0.8",
            "Wall time of 10 ms, the mean over a run of 6 s",
        ),
        *("by at most 1 % of its initial value", "Δt is 10 ms", "below 3 % of a mean radius", "steps of 0.625 ms"),
    ],
    "benchmarks.md": ["ω = 1.5", "61 × 61 nodes"],
    "guide.md": [
        *("0.01 s for r = 1 m", "takes 2.6 GB", "takes 0.6 GB"),
        *("about 1 ms of its own", "a scene took 10 ms", "a task of 10 s"),
    ],
    "other_starts.md": ["Δt = 0.01 s", "1.75 | 1.45", "ω = 1.75 for the normal and 1.45 for", "d = h = 0.5 m"],
    "solvers.md": ["9.81 m/s² and Δt = 0.01 s", "√1000 times", "more than 100 times"],
    "thesis.md": [
        *("95 %", "d = 0.75 m with h = 0.5 m", "of d = h = 0.5 m"),
        *("Of 0.25, 0.5 and 0.75 m", "grid search has 0.25 m to 2 m"),
    ],
}
"""Page -> pieces of its text whose numbers are settings, or sizes of what others made."""


def pattern(template: str) -> re.Pattern:
    """A template as it stands in a page, whatever its numbers and its line ends; a group for each piece and number."""
    pieces = []
    for literal, field, *_ in Formatter().parse(template):
        words = re.sub(r"(?:\\ )+", r"\\s+", re.escape(literal))
        pieces.append(f"({words})({NUMBER})" if field is not None else f"({words})()")
    return re.compile("".join(pieces))


def filled(page: str, text: str) -> str:
    """The text of a page with the numbers of its sentences. Raises ValueError for a sentence that is not there once."""
    for template, numbers in SENTENCES.get(page, ()):
        specs = [spec for _, field, spec, _ in Formatter().parse(template) if field is not None]
        values = [_written(value, spec) for value, spec in zip(numbers(), specs, strict=True)]

        def sentence(match: re.Match, values=values) -> str:
            pieces = list(match.groups())
            pieces[1 : 2 * len(values) : 2] = values
            return "".join(pieces)

        text, times = pattern(template).subn(sentence, text)
        if times != 1:
            raise ValueError(f"{page}: expected one sentence with {template!r}, got {times}")
    return text


def _written(value, spec: str) -> str:
    """A number as the pages write it: 1e8, not 1e+08."""
    return re.sub(r"e([+-]?)0*(\d)", lambda match: f"e{match[1].strip('+')}{match[2]}", format(value, spec))


MEASURED = re.compile(rf"(?<![\w.])(?:\d[\d,]*\.\d+(?:e-?\d+)?|{NUMBER}(?=\s*(?:%|×|times\b|[mµn]?s\b)))(?![\w.]*\d)")


NAMES = r"\b(?:Figures?|Tables?|Eq|sections?|chapters?|Python|Siconos|Box2D|Keras|Python 3.10 and)\s\d+(?:\.\d+)+"
"""Numbers that are names."""


def unexplained(page: str, text: str) -> list[str]:
    """The numbers of a page's prose that look measured and are in no sentence of SENTENCES or GIVEN."""
    for names in (r"^```.*?^```", r"^\|.*?$", r"<!--.*?-->", r"^#.*?$", r"`[^`]*`", r"\]\([^)]*\)"):
        text = re.sub(names, "", text, flags=re.MULTILINE | (re.DOTALL if "`" in names else 0))
    for template in [*(template for template, _ in SENTENCES.get(page, ())), *GIVEN.get(page, ())]:
        text = pattern(template).sub("", text)
    return [match[0] for match in MEASURED.finditer(re.sub(NAMES, "", text))]
