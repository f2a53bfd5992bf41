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
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from string import Formatter

import numpy as np

from deep_contact.accuracy.presets import PRESETS
from deep_contact.figures import results
from deep_contact.state.constants import TIME_STEP
from deep_contact.studies.chapter_5 import (
    NETWORKS,
    READ_NETWORK,
    THESIS_VISITS,
    card_of,
    networks_info,
)
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
def script(stem: str):
    """The module of a figure's script, of figure_6_3, say."""
    path = next((ROOT / "scripts").glob(f"{stem}_[a-z]*.py"), None)
    if path is None:
        raise ValueError(f"table: expected a script's figure_C_N, got {stem!r}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def printed(stem: str) -> list[list]:
    """The table that a figure's script prints, head first."""
    return script(stem).FIGURE.table(stored(stem)["data"])


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


def with_ends(ratios) -> list:
    """The number of ends of some ratios' intervals, how many of them are known, and the least and the most of the known
    ends and of the ratios.

    ratios: [ratio, low, high] of each; None for an end that no setting makes.
    """
    ends = [end for _, *both in ratios for end in both]
    known = [*filter(None, ends)]
    return [len(ends), len(known), *spread(known + [ratio for ratio, *_ in ratios])]


def rivals_ends() -> list:
    """`with_ends` of the ratios of `rivals`."""
    return with_ends([row["ratio"] for row in stored("figure_6_1")["data"]["presets"] if row["ratio"][0]])


def over_ours(engine: str, n_bodies: int, preset: str) -> float | None:
    """An engine's time over ours for a preset on plain piles of a size, the median over processes in which both were timed.

    None where one of the two keeps the preset with no setting.
    """
    rows = stored("figure_6_1")["data"]["presets"]
    (row,) = (row for row in rows if (row["n_bodies"], row["preset"]) == (n_bodies, preset))
    theirs, ours = row["peers"].get(engine), row["kinds"]["plain"]
    return float(np.median(np.divide(theirs["times"], ours["times"]))) if theirs and ours else None


def rival(engine: str) -> tuple[float, float]:
    """The least and the most of `over_ours` of an engine."""
    sizes = [(row["n_bodies"], row["preset"]) for row in stored("figure_6_1")["data"]["presets"]]
    return spread(filter(None, (over_ours(engine, *size) for size in sizes)))


def seeds_of_the_study() -> list[int]:
    """Plain piles in the study: of 100 circles, the fewest of each larger size, and those of other engines of 10,000."""
    rows = stored("run_tradeoff")["data"]["rows"]
    seeds = [(row["n_bodies"], "engine" in row["setting"], row["seeds"]) for row in rows if row["kind"] == "plain" and row["errors"]]
    return [
        min(count for n, _, count in seeds if n == 100),
        min(count for n, other, count in seeds if n > 100 and not other),
        min(count for n, other, count in seeds if n == 10000 and other),
    ]


def native_share(build: str, n_bodies: int | None = None) -> list[float]:
    """What Box2D v3 compiled natively takes of its Python package's time, a number for each size and number of substeps."""
    found = (row for row in stored("box2d_native")["data"]["results"] if n_bodies in (None, row["n"]))
    return [1.0 / row["package_over_native"][build][0] for row in found]


def rivals_with_native() -> tuple[float, float]:
    """As `rivals`, where Box2D v3 costs what its version of today does if it is compiled natively.

    Without the numbers of circles that were not timed natively.
    """
    found = []
    for row in stored("figure_6_1")["data"]["presets"]:
        if not (shares := native_share("head-avx2", row["n_bodies"])):
            continue
        share = {"Box2D v3": float(np.mean(shares))}
        costs = [share.get(engine, 1.0) * cost["us"] for engine, cost in row["peers"].items() if cost]
        ours = row["kinds"]["plain"]
        found += [min(costs) / ours["us"]] if costs and ours else []
    return spread(found)


def before() -> list[float]:
    """What was published: the least and the most ratio; a step's time with its world's destruction, and that alone, ms."""
    data = stored("ratios_before")["data"]
    with_it, alive = (data["step_of_pymunk_ms"][name] for name in ("destroyed", "alive"))
    return [*spread(row["ratio"][0] for row in data["ratios"] if row["ratio"][0]), with_it - alive, with_it]


def verified(counted: str = "kept", by: str = "rows") -> list:
    """How many cells outside of the study each preset kept, strictly or "within" the interval.

    by: "rows" for the settings of the presets, "again" for a setting as good as the reference.
    """
    data = stored("run_tradeoff_verify")["data"]
    return [sum(all(row[counted].values()) for row in data[by] if row["preset"] == preset) for preset in PRESETS]


def cells_outside() -> int:
    """Kinds and sizes of scenes outside of the study."""
    return len(stored("run_tradeoff_verify")["data"]["rows"]) // len(PRESETS)


def costs_outside() -> list[float]:
    """The median of cost over the predicted cost, and its least and most divided by this median.

    Of scenes without segments, with walls that drag, with still walls, and with pistons. The check did not run at the
    same time as the study, so that the median says how fast the machine was.
    """
    places = {"drum": "drag", "belt": "drag", "hopper": "still", "terrain": "still", "piston": "piston"}
    found = {"": [], "drag": [], "still": [], "piston": []}
    for row in stored("run_tradeoff_verify")["data"]["times"]:
        place = next((place for word, place in places.items() if word in row["kind"]), "")
        found[place].append(row["us"] / row["predicted_us"])
    middle = float(np.median(np.concatenate(list(found.values()))))
    return [middle, *(end / middle for ratios in found.values() for end in spread(ratios))]


def walls() -> tuple:
    """Figure 6.16: the least and the most ratio; cells in which what accuracy= takes keeps its preset, all cells, and
    those in which it does within the interval of the seeds."""
    scenes = stored("figure_6_16")["data"]["scenes"]
    ratios = spread(row["ratio"][0] for one in scenes for row in one["presets"] if row["ratio"][0])
    taken = [one["measured"] for one in stored("figure_6_16")["claims"] if "accuracy= takes" in one["text"]]
    of, missed, beyond = (sum(one[name] for one in taken) for name in ("of", "missed", "beyond the interval"))
    return *ratios, of - missed, of, of - beyond


def wall_cells(scene: str = "") -> list[int]:
    """Figure 6.16: scenes times presets, and those of them in which ours and a rival keep the preset.

    scene: a word in the names of those that count.
    """
    scenes = [one for one in stored("figure_6_16")["data"]["scenes"] if scene in one["scene"]]
    ratios = [row["ratio"][0] for one in scenes for row in one["presets"]]
    return [len(ratios), len(ratios) - ratios.count(None)]


def walls_alone() -> list[int]:
    """Figure 6.16: cells in which ours alone keeps a preset, those of them in which a rival does at the lower ends of
    its errors, and cells in which only a rival does."""
    who = [one["measured"] for one in stored("figure_6_16")["claims"] if "keeps what a rival keeps" in one["text"]]
    names = ("ours alone", "undecided alone", "a rival alone")
    ours, undecided, rival = (sum(len([*filter(None, one[name].split("; "))]) for one in who) for name in names)
    return [ours + undecided, undecided, rival]


def walls_ratios() -> list:
    """Figure 6.16: the ratios with their ends."""
    rows = [row for one in stored("figure_6_16")["data"]["scenes"] for row in one["presets"]]
    return [row["ratio"] for row in rows if row["ratio"][0]]


def walls_ends() -> list:
    """Figure 6.16: the least low and the most high end of the ratios, and how many have no low and no high end."""
    _, lows, highs = zip(*walls_ratios())
    return [min(filter(None, lows)), max(filter(None, highs)), lows.count(None), highs.count(None)]


def walls_slower() -> int:
    """Figure 6.16: the number of cells in which the fastest rival is faster than ours."""
    scenes = stored("figure_6_16")["data"]["scenes"]
    return sum(row["ratio"][0] < 1 for one in scenes for row in one["presets"] if row["ratio"][0])


def walls_settings() -> list[int]:
    """Figure 6.16: the fewest and the most settings of ours that were run on a scene, and the most of a rival."""
    counts = [
        Counter(row["setting"].get("engine", "ours") for row in one["rows"])
        for one in stored("figure_6_16")["data"]["scenes"]
    ]
    return [*spread(one["ours"] for one in counts), max(one[engine] for one in counts for engine in OTHERS)]


def settings_tried() -> dict[int, Counter]:
    """Circles -> engine -> how many of its settings have errors on plain piles."""
    rows = [row for row in stored("run_tradeoff")["data"]["rows"] if row["kind"] == "plain" and row["errors"]]
    counts = {n: Counter(ours=0) for n in dict.fromkeys(row["n_bodies"] for row in rows)}
    for row in rows:
        counts[row["n_bodies"]][row["setting"].get("engine", "ours")] += 1
    return counts


OTHERS = ("Box2D 2.3", "pymunk", "Box2D v3")


def steps_live(way: str, *sizes: int) -> list[float]:
    """The least time of a step of a pile at rest on a quiet machine, µs, by a way of stepping, for some sizes."""
    runs = {run["n_bodies"]: run["us"] for run in stored("benchmark_live")["data"]["runs"] if not run["busy"]}
    return [runs[n][way][0] for n in sizes]


def live_over_others(way: str) -> list[float]:
    """A way of stepping's time over that of the fastest other engine, for a pile at rest: of 10 circles, then the least
    and the most of all larger sizes."""
    runs = [run for run in stored("benchmark_live")["data"]["runs"] if not run["busy"]]
    ratios = {run["n_bodies"]: run["us"][way][0] / min(run["us"][name][0] for name in OTHERS) for run in runs}
    return [ratios.pop(10), *spread(ratios.values())]


def busy_over_idle() -> list[float]:
    """Median time of a step beside two busy processes over that beside none, the least and the most of all sizes: of
    `Simulator`, then of the other engines."""
    us = {(run["n_bodies"], run["busy"]): run["us"] for run in stored("benchmark_live")["data"]["runs"]}
    sizes = dict.fromkeys(n for n, _ in us)

    def ratios(*ways):
        return spread(us[n, 2][way][1] / us[n, 0][way][1] for n in sizes for way in ways)

    return [*ratios("Simulator"), *ratios(*OTHERS)]


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


def wild_starts() -> list[float]:
    """Figure 6.6: the least start outside of the cone that fails, and the largest that is safe, in weights of all circles."""
    cells = [one for one in stored("figure_6_6")["data"]["cells"] if one["quantity"] == "start, outside the cone"]
    value = {verdict: [one["value"] for one in cells if one["verdict"] == verdict] for verdict in ("failed", "safe")}
    return [min(value["failed"]), max(value["safe"])]


def saved(row: str) -> float:
    """How many times cheaper a step or sweep is without what its scene does not require (Figure 6.7)."""
    return cell("figure_6_7", row, "times cheaper")


def in_own_runs(*starts: str) -> list[float]:
    """Mean sweeps to the threshold of starts in runs of their own (Figure 3.8)."""
    return [stored("figure_3_8")["data"]["independent"][start]["sweeps"]["mean"] for start in starts]


def lost_at(way: str, spacing: float) -> float:
    """Relative change of the impulses of a pile of equal circles on a way through the grid with d = h (Figure 6.3)."""
    data = stored("figure_6_3")["data"]
    return data["by spacing"]["equal"][way][data["charted"].index(spacing)]


def lost(way: str) -> float:
    """Relative change of impulses on a way through the grid, by poly6 at d = h = 0.5 m (Figure 6.3)."""
    (row,) = (r for r in stored("figure_6_3")["data"]["rows"] if (r["kernel"], r["d"], r["h"]) == ("poly6", 0.5, 0.5))
    return row[way]


# ---- learned starts ----


def worth() -> np.ndarray:
    """Sweeps of the best classical setting that leave the network's error after 3, 10 and 30 (Figure 6.8, all steps).

    Between the numbers of sweeps that were measured, the logarithm of the error is taken as linear.
    """
    data, study = stored("figure_6_8")["data"], script("figure_6_8")
    classical = np.log(study.best_errors(data["scenes"], study.CLASSICAL).mean(axis=0))
    network = np.log(study.best_errors(data["scenes"], [study.LEARNED]).mean(axis=0))
    columns = [data["after"].index(k) for k in AFTER]
    return np.interp(-network[columns], -classical, data["after"])


def price(n_bodies: int) -> float:
    """Sweeps of PGS in the time of the far-field network, its images included (Figure 5.10), median over states."""
    found = stored("figure_5_10")["data"]["piles"][str(n_bodies)]["starts"]["far field"]
    seconds = {stage: np.array(values) for stage, values in found["seconds"].items()}
    a_sweep = seconds.pop("solve") / np.array(found["sweeps"])
    return float(np.median(sum(seconds.values()) / a_sweep))


def width(friction: float = 0.5, circles: int = 100, *, scene: str = "resting", radii: str = "0.8") -> float:
    """Figure 6.15: of the interval of the median contact of resting circles, over the mean λ_n."""
    name = f"{circles} circles, {scene}, μ = {friction:g}, radii from {radii} m"
    return claim("figure_6_15", "interval of the median")[name]


def elsewhere() -> list[float]:
    """Figure 6.15: of PGS from zero and from `support`, the distance from the run's impulses; of the far-field network, that and
    its velocity error."""
    errors = claim("figure_6_15", "that know no past")
    return [errors["PGS from zero"][0], errors["PGS from support"][0], *errors["network, far field"]]


def digits() -> list[float]:
    """Figure 6.17: sweeps at which one digit is ahead of Builtin, the factor of θ by a digit, and median sweeps of three starts."""
    found = stored("figure_6_17")["data"]["independent"]
    first = [found[name]["theta"][0] for name in found if "digit" in name]
    medians = (found[name]["sweeps"]["median"] for name in ("Copy, 1 digit", "builtin", "Copy, 2 digits"))
    factors = spread(one / more for one, more in zip(first, first[1:]))
    return [*sweeps("figure_6_17", "rounded to 1 significant"), *factors, *medians]


# ---- the thesis ----


def integers(text: str) -> list[int]:
    """The numbers in "1 to 180, 240 to 3000", say."""
    return [int(number) for number in re.findall(r"\d+", text)]


def sweeps(stem: str, text: str) -> list[int]:
    """The numbers of sweeps in the verdict on the one claim of a file whose text contains this."""
    (found,) = (one["verdict"] for one in stored(stem)["claims"] if text in one["text"])
    return integers(found)


def ratio_after(stem: str, text: str, after: int) -> list[float]:
    """What decided the one claim of a file whose text contains this after so many sweeps: ratio, low, high."""
    return claim(stem, text)[BY_SWEEP][str(after)]


def claims_counted() -> list[int]:
    """Claims of the thesis that were tested: all, those that hold, that do not, that are open, and the others."""
    files = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(REFERENCE.glob("*.json"))]
    claims = [claim for one in files for claim in one.get("claims", ()) if claim["thesis"]]
    held = Counter(claim["holds"] for claim in claims)
    undecided = sum(results.verdict(claim).startswith("open") for claim in claims if claim["holds"] is None)
    return [len(claims), held[True], held[False], undecided, held[None] - undecided]


def both_ways() -> tuple[int, int]:
    """Claims on SPH that were judged for both ways back, and how many of their verdicts are another by spline."""
    printed, spline = READ.values()
    pairs = []
    for stem in ("figure_3_8", "figure_5_4", "figure_5_5", "figure_5_6", "figure_5_7", "figure_5_9"):
        holds = {claim["text"]: claim["holds"] for claim in stored(stem)["claims"]}
        other = {text.replace(spline, printed): value for text, value in holds.items() if spline in text}
        pairs += [(holds[text], value) for text, value in other.items() if text in holds]
    return len(pairs), sum(one is not other for one, other in pairs)


def by_tree() -> dict:
    """What was measured of the interpolation by a k-d tree (Figure 5.10)."""
    return claim("figure_5_10", "interpolation alone")


def ahead(stem: str, first: str, second: str, share: float = 1.0) -> str:
    """The sweeps at which the first start's θ is below this share of the second's, by their band; "" for none."""
    data = stored(stem)["data"]
    return ranges(data["sweep"], intervals(data["independent"], first, second)[2] < share)


CNN, FAR_FIELD = "CNN (model.h5)", "far field (far_field.h5)"
"""The two networks in the claims of Figures 5.9 and 5.10."""


def not_efficient(network: str, circles: int = 100) -> list[list[float]]:
    """Figure 5.10: a network's start over Builtin, sweeps and then time to θ < 6e-5: [ratio, low, high] of each."""
    named = f"{circles} circles, {network}: it"
    return [claim("figure_5_10", f"{named} {text}")[RATIO] for text in ("reaches θ", "is not efficient")]


def reached() -> list[int]:
    """Figure 5.10: of piles of 1,000 circles, the states that reach θ < 6e-5: from Copy, of all, from Builtin, from far field."""
    pile = stored("figure_5_10")["data"]["piles"]["1000"]
    count = len(pile["scene"])
    copy, builtin, network = (count - pile["starts"][name]["missed"] for name in ("copy", "builtin", "far field"))
    return [copy, count, builtin, network]


def settling_width() -> float:
    """Figure 6.15: the widest median interval in settling piles with friction, over the mean λ_n."""
    found = claim("figure_6_15", "interval of the median")
    return max(value for name, value in found.items() if "settling" in name and "μ = 0," not in name)


def first_rates() -> list[float]:
    """Rates with which the training of the thesis's network began: here, and by Table 5.2."""
    settings = stored("table_5_2")["data"]
    return [float(settings[of]["Initial learning rate"].split(" ")[0]) for of in ("shipped", "printed")]


def weights_of_thesis() -> list[int]:
    """Weights that the thesis's network learns, and all of the file's, whose last layer is factored."""
    learned = sum(layer["trainable"] for layer in stored("table_5_1")["data"]["built"])
    return [learned, card_of(NETWORKS["cnn"])["parameters"]]


PEAK = 11.3e12
"""Of a GeForce GTX 1080 Ti, FLOP/s in float32, by its maker."""


def training_work() -> tuple[float, float]:
    """PFLOP of the thesis's training, a state forward and back being three times forward, and % of `PEAK` for a day."""
    layers = (layer for layer in stored("table_5_1")["data"]["built"] if layer["kernel"] or layer["kind"] == "Dense")
    forward = sum(2 * layer["parameters"] * math.prod(layer["shape"][:-1]) for layer in layers)
    work = 3 * forward * THESIS_VISITS
    return work / 1e15, 100 * work / PEAK / 86400


def errors_of_images() -> list[float]:
    """Figure 4.3: errors of the network's grid values and of its λ, read back both ways; of Builtin's; of the true image's λ."""
    grid, contacts = ({row[0]: row[i] for row in printed("figure_4_3")[1:]} for i in (1, 2))
    network, shared, builtin, true, *_ = contacts
    return [grid[network], contacts[network], contacts[shared], grid[builtin], contacts[builtin], contacts[true]]


def training_share() -> float:
    """States that the thesis's training showed, over those that the training of its network here did."""
    return THESIS_VISITS / networks_info(NETWORKS)["cnn"]["visits"]


def third_turn() -> list[float]:
    """Processor time of a first call over that of the commit before, in the last turn, by kind of scene."""
    kinds = stored("compile_cost")["kinds"].values()
    return [row["now"]["seconds"][2] / row["before"]["seconds"][2] for row in kinds]


def law(name: str) -> list[dict]:
    """Rows of a law in the results file of `tests/tools/material_laws.py`."""
    return stored("material_laws")["laws"][name]["rows"]


def silos_of(rough: bool) -> tuple[list[float], float]:
    """Janssen: speeds of the median disc relative to the floor, m/s, and the largest difference of K from its mean, %.

    rough: whether the walls are the two rougher kinds, or those of μ = 0.3. Each speed and each K is the mean of the
    silos of a height, and the mean of K is over the heights.
    """
    speeds, differences = [], []
    for walls in {(row["walls"], row["friction"]) for row in law("janssen") if (row["friction"] > 0.3) == rough}:
        of = [row for row in law("janssen") if (row["walls"], row["friction"]) == walls]
        heights = [[row for row in of if row["height"] == height] for height in {row["height"] for row in of}]
        speeds += [float(np.mean([row["median speed"] for row in rows])) for rows in heights]
        ks = np.array([np.mean([row["K"] for row in rows]) for rows in heights])
        differences.append(float(np.abs(ks / ks.mean() - 1.0).max()))
    return speeds, 100.0 * max(differences)


def mean_and_error(values: list[float]) -> str | None:
    """Mean and standard error, as tables write them; None if there are no values."""
    return f"{np.mean(values):.3f} ± {np.std(values, ddof=1) / math.sqrt(len(values)):.3f}" if values else None


def apart(ramp: str, of: str) -> tuple[list[float], list[float]]:
    """By preset: how far a quantity of a ramp is from that of runs that are solved anew, and of shaken runs from another."""
    verdicts = [row["verdicts"][of] for row in law("ramps") if row["ramp"] == ramp]
    return [abs(difference) for difference, *_ in verdicts], [noise for _, noise, _ in verdicts]


HOLDING = ("gravity turned by 1e-5 rad a step", "gravity turned by 1e-3 rad a step", "gravity to 0")
"""Ramps in which the mean height of the pile changes by less than 0.01 m."""


def grows_with(width: int, rho: float) -> float:
    """Exponent with which run-outs of columns grow from a = 8 to a = 16. width: discs. rho: rolling resistance, m."""
    rows = [row for row in law("collapse") if (row["width"], row["rho"]) == (width, rho)]
    low, high = (np.mean([row["run-out"] for row in rows if row["aspect"] == aspect]) for aspect in (8.0, 16.0))
    return math.log2(high / low)


AFTER = (3, 10, 30)
"""Sweeps after which the errors of Figure 6.8 are compared."""

Numbers = Callable[[], object]

SENTENCES: dict[str, list[tuple[str, Numbers]]] = {
    "accuracy.md": [
        ("Of the {} ends {} are known. The known ends lie between {:.1f} and {:.1f}", rivals_ends),
        ("is the median over the {} scenes of", lambda: [cells_outside()]),
        (
            "They come from {} piles of 100 circles and from {} piles of each larger size. The errors of other engines with "
            "10,000 circles come from {}",
            seeds_of_the_study,
        ),
        (
            "the fastest other engine takes {:.1f} to {:.1f} times as long as ours. The times of the other engines then included "
            "the destruction of their worlds. This destruction took {:.0f} of the {:.0f} ms",
            before,
        ),
        (
            "Version 3.2.0 of Box2D, which is not yet released, was compiled natively (gcc 12.2, -O3 -mavx2). It takes {:.2f} to {:.2f} of "
            "the time of the package. Version 3.1.1, which is the one in the package, takes {:.2f} to {:.2f} of the time of the "
            "package if it is compiled natively. With the native version 3.2.0, the time of the fastest other engine over ours is "
            "{:.1f} to {:.1f}",
            lambda: [*spread(native_share("head-avx2")), *spread(native_share("v3.1.1-avx2")), *rivals_with_native()],
        ),
        (
            "That makes {} cells. In {} of them both ours and a rival keep the preset. In these cells the fastest rival takes "
            "{:.1f} to {:.1f} times as long as ours",
            lambda: [*wall_cells(), *walls()[:2]],
        ),
        (
            "The known ends lie between {:.2f} and {:.1f}. For {} ratios the lower end is not known, since no setting of ours keeps "
            "the preset at the upper ends of its errors. For {} ratios the upper end is not known",
            walls_ends,
        ),
        (
            "In {} cells ours alone keeps the preset. In {} of these cells a rival keeps it at the lower ends of its errors. The "
            "number of cells in which only a rival keeps the preset is {}",
            walls_alone,
        ),
        ("For hoppers, {} of the {} cells have a ratio", lambda: wall_cells("hopper")[::-1]),
        ("{} to {} settings of ours were run, and {} of each rival", walls_settings),
        ("The number of cells without a mark is {}", lambda: [sum(walls_alone()[1:])]),
        ("The fastest rival is faster than ours in {} of these cells", lambda: [walls_slower()]),
        (
            "takes {:.1f} times as long as a step of the fastest other engine. For more circles it takes {:.2f} to {:.2f} times as "
            "long. A step of a run that calls a function at each step takes {:.1f} times as long as a step of the fastest other "
            "engine for 10 circles, and {:.2f} to {:.2f} times as long for more circles",
            lambda: [*live_over_others("Simulator"), *live_over_others("on_step")],
        ),
        (
            "takes {:.1f} to {:.1f} times as long as on idle cores. The median steps of the other engines take {:.1f} to {:.1f} "
            "times as long",
            busy_over_idle,
        ),
        (
            "`accuracy=` takes keeps its preset in {} of {} cells. If a miss counts only beyond the interval of the seeds, it keeps "
            "its preset in {} cells",
            lambda: walls()[2:],
        ),
        (
            "A step of a pile that sleeps takes 1/{:.0f} of the time of a step of the same pile awake. A sweep without friction "
            "takes 1/{:.1f} of the time of a sweep with friction at 100 circles, and 1/{:.1f} at 1,000",
            lambda: [
                saved(row)
                for row in ("asleep: a step", *(f"no tangent rows, no spin: a sweep, {n} circles" for n in ("100", "1,000")))
            ],
        ),
        (
            'All tolerances were kept in {} of these scenes by "preview", in {} by "fast", in {} by "balanced", in {} by "accurate" '
            'and in {} by "reference". If a miss counts only beyond the interval of the seeds, the numbers are {}, {}, {}, {} '
            "and {}",
            lambda: [*verified(), *verified("within")],
        ),
        (
            'In the check the solver with one sweep more keeps all tolerances of "preview" in {} of these scenes, of "fast" in '
            '{}, of "balanced" in {}, of "accurate" in {} and of "reference" in {}',
            lambda: verified(by="again"),
        ),
        ("checked on {} kinds and sizes of scenes outside the study", lambda: [cells_outside()]),
        (
            "The median of the measured time over the predicted time was {:.2f}. Divided by this median, the measured time over "
            "the predicted time was {:.2f} to {:.2f} where scenes have no segments, {:.2f} to {:.2f} in drums and on a belt, "
            "{:.2f} to {:.2f} in hoppers and on terrain, and {:.2f} to {:.2f} where a wall pushes",
            costs_outside,
        ),
        (
            "safe for mass ratios up to {:g}, radius ratios up to {:,.0f}, columns of up to {:,.0f} circles, pyramids of up to "
            "{:.0f} rows",
            lambda: safe("ours", "mass ratio, heavy on light", "radius ratio", "column height", "pyramid rows"),
        ),
        (
            "to {:g} s, speeds up to {:g} m/s and coordinates up to {:g} m",
            lambda: safe("ours", "time step", "speed", "coordinate"),
        ),
        (
            "safe up to a mass ratio of {:.0f}, columns of {:.0f} circles and pyramids of {:.0f} rows",
            lambda: safe("Box2D 2.3", "mass ratio, heavy on light", "column height", "pyramid rows"),
        ),
        (
            "this setting has {} to {} sweeps, and its deepest penetration is {:.2f} to {:.2f} times that of the long step",
            lambda: [
                *spread(best["setting"]["sweeps"] for _, best in smaller_steps()),
                *smaller_step_over_20_sweeps("penetration_max"),
            ],
        ),
        (
            "is {:.1f} to {:.1f} times as far from the reference's as the curve of the long step",
            lambda: smaller_step_over_20_sweeps("energy"),
        ),
        (
            "mean penetration at rest of {:.2f} % of r. One step with the whole slop leaves {:.2f} %",
            lambda: [penetration(**BY_MOTION), penetration(dt=0.01)],
        ),
        ("a start in which each tangent impulse is {:g} times W. W is the weight of all circles times Δt. The rounding of these impulses stays in the velocities. A start of {:g} times W", wild_starts),
        (
            "radii that differ {:,.0f} times is degraded",
            lambda: [float(cell("figure_6_6", "radius ratio", "ours: degraded"))],
        ),
        (
            "With this setting the deepest penetration is {:.1f} % of r, and 10 ms of the run take {:.0f} µs of computing time. With 4 sweeps in one "
            "step of 10 ms the deepest penetration is {:.1f} %, and the step takes {:.0f} µs. With 4 sweeps in each of eight fixed "
            "substeps the deepest penetration is {:.1f} %, and the eight substeps take {:.0f} µs",
            lambda: [*deepest(**BY_MOTION), *deepest(dt=0.01), *deepest(dt=0.00125)],
        ),
    ],
    "README.md": [
        (
            "On {} scenes outside of the study that the presets come from, all tolerances were kept in {} by "
            '"preview", in {} by "fast", in {} by "balanced", in {} by "accurate" and in {} by "reference". Some misses are '
            "smaller than the uncertainty from the random seeds. Without these misses the numbers are {}, {}, {}, {} and {}",
            lambda: [cells_outside(), *verified(), *verified("within")],
        ),
        ("the fastest of Box2D 2.3, Box2D v3 and pymunk takes {:.1f} to {:.1f} times as long", rivals),
        (
            "With the known ends of their intervals these ratios are {:.1f} to {:.1f}. pymunk alone takes {:.1f} to {:.1f} times as "
            "long",
            lambda: [*rivals_ends()[2:], *rival("pymunk")],
        ),
        (
            "the fastest other engine takes {:.1f} to {:.1f} times as long as Deep Contact. This counts the {} of {} cases in which "
            "both keep the tolerances. Below 1 the other engine is faster. With the known ends of their intervals these ratios are "
            "{:.2f} to {:.1f}",
            lambda: [*walls()[:2], *wall_cells()[::-1], *with_ends(walls_ratios())[2:]],
        ),
        (
            "10 circles at rest take {:.1f} times the time of the fastest other engine, 100 to 10,000 take {:.2f} to {:.2f} times",
            lambda: live_over_others("Simulator"),
        ),
        (
            "mass ratios of {:g} and columns of {:,.0f} circles are",
            lambda: safe("ours", "mass ratio, heavy on light", "column height"),
        ),
        (
            "our network takes {:.2f} times as long as a start from the impulses of the step before (interval {:.2f} to {:.2f})",
            lambda: not_efficient(FAR_FIELD)[1],
        ),
        ("on 1/{:.0f} of the states", lambda: [training_share()]),
    ],
    "appendix.md": [("training, on 1/{:.1f} of the states", lambda: [training_share()])],
    "benchmarks.md": [
        (
            "its energy rose by at most {:.0e} m g r̄, where m is the mass of the pile, and the memory of the process grew by at most "
            "{:.1f} MB",
            lambda: [max(unit[name] for unit in stored("soak")["units"]) for name in ("energy", "memory_mb")],
        ),
        ("In the third turn alone these ratios are {:.2f}, {:.2f}, {:.2f}, {:.2f}, {:.2f} and {:.2f}", third_turn),
    ],
    "guide.md": [
        (
            "takes {:.0f} µs as a call of its own, and {:.1f} µs as one of many steps in one call. In a pile of 100 circles "
            "these times are {:.0f} µs and {:.1f} µs",
            lambda: [steps_live(way, n)[0] for n in (10, 100) for way in ("Simulator", "one call")],
        ),
        (
            "took {:,.0f} µs a step for 10 circles, {:,.0f} µs for 100 and {:,.0f} µs for 10,000",
            lambda: steps_live("simulate, one step each", 10, 100, 10000),
        ),
    ],
    "materials.md": [
        (
            "the median disc moves at {:.3f} m/s at most relative to it. K then differs from its mean over the heights by at "
            "most {:.1f} %",
            lambda: [max(silos_of(rough=False)[0]), silos_of(rough=False)[1]],
        ),
        (
            "The median disc moves at {:.2f} to {:.2f} m/s relative to the floor. Only a part of the friction works there, and "
            "K differs from its mean by up to {:.0f} %",
            lambda: [min(silos_of(rough=True)[0]), max(silos_of(rough=True)[0]), silos_of(rough=True)[1]],
        ),
        (
            "as a mean over {} gases with its standard error. A gas has 1,024 discs",
            lambda: [len({row["seed"] for row in law("haff, side 128, 80 s")})],
        ),
        (
            "from a = 8 to a = 16 without rolling resistance are {:.2f}, {:.2f} and {:.2f} with 20, 40 and 80 discs side by side. "
            "With rolling resistance they are {:.2f}, {:.2f} and {:.2f}",
            lambda: [grows_with(width, rho) for rho in (0.0, 0.09) for width in (20, 40, 80)],
        ),
    ],
    "moving.md": [
        (
            "There mean heights differ by at most {:.4f} m",
            lambda: [max(max(apart(ramp, "height")[0]) for ramp in HOLDING)],
        ),
    ],
    "other_starts.md": [
        (
            "loses {:.2f} of the impulse of an isolated contact and {:.2f} of those of a falling pile",
            lambda: [lost("isolated, thesis"), lost("pile, thesis")],
        ),
        (
            "*none* takes {:,.0f} sweeps, *sph* {:,.0f} and *builtin* {:,.0f}",
            lambda: in_own_runs("none", "sph", "builtin"),
        ),
        (
            "field of ones. On the pile {:.0e} is lost, and {:.2f} at d = h = 1 m",
            lambda: [lost("pile, consistent"), lost_at("consistent", 1.0)],
        ),
        (
            "weights that sum to one. What is lost is {:.0e}, which is rounding, and {:.2f} at d = h = 1 m",
            lambda: [lost("pile, authors' sharing"), lost_at("authors' sharing", 1.0)],
        ),
        ("for the SPH image. It loses {:.2f} on the pile", lambda: [lost("pile, authors' spline")]),
    ],
    "starts.md": [
        (
            "this interval is {:.1f} times the mean λ_n with μ = 0.5, and {:.2f} times the mean λ_n without friction. In a "
            "pile of 1,000 circles, with friction, it is {:.0f} times the mean λ_n",
            lambda: [width(), width(0), width(circles=1000)],
        ),
        ("the median contact's λ_n is off by {:.2f} of the mean λ_n", lambda: elsewhere()[:1]),
        ("λ_n is off by {:.2f} of the mean λ_n. The network", lambda: elsewhere()[1:2]),
        ("its λ_n is off by {:.3f} before any sweep, and its velocity error is {:.2f}", lambda: elsewhere()[2:]),
        (
            "3 sweeps from the network leave as small an error as {:.1f} sweeps of the best classical setting; 10 sweeps are "
            "worth {:.1f}, and 30 are worth {:.1f}",
            worth,
        ),
        (
            "takes the time of {:.0f} sweeps for 1,000 circles, and of {:.0f} for 100",
            lambda: [price(1000), price(100)],
        ),
        ("This network saves {:.1f}, {:.1f} and {:.1f} sweeps where", lambda: worth() - AFTER),
        (
            "rounded to one digit is ahead of Builtin at sweeps {} to {:,}, and each further digit divides the θ of the first "
            "sweep by {:.0f} to {:.0f}. In the median state one digit is not enough: to θ < 6e-5 N·s it takes {:.0f} sweeps, "
            "Builtin takes {:.0f}, and two digits take {:.0f}",
            digits,
        ),
    ],
    "thesis.md": [
        (
            "Of {} claims that were tested, {} hold, {} do not, {} are open, and {} hold at some sweeps only or lie within the noise",
            claims_counted,
        ),
        (
            "`far_field.h5`, ours, does at sweeps {} to {}. The thesis's network, rebuilt, does at sweeps {} to {} only",
            lambda: [number for network in (FAR_FIELD, CNN) for number in sweeps("figure_5_9", f"{network} converges faster than Builtin")[:2]],
        ),
        (
            "{:.2f} times Builtin's time ({:.2f} to {:.2f}) by `far_field.h5`, {:.2f} times ({:.2f} to {:.2f}) by the rebuilt network",
            lambda: [*not_efficient(FAR_FIELD)[1], *not_efficient(CNN)[1]],
        ),
        ("The rebuilt one does not: they are off by {:.2f} of their size", lambda: errors_of_images()[:1]),
        (
            "its θ is at most half of Builtin's at sweeps {} to {} only. It is lower up to sweep {}",
            lambda: [
                *sweeps("figure_5_7", "SPH, bilinear (printed), gets convergence much faster than Builtin")[:2],
                integers(ahead("figure_5_7", "sph", "builtin"))[-1],
            ],
        ),
        ("The bilinear way back loses {:.2f} of a pile's", lambda: [lost("pile, thesis")]),
        (
            "By the thesis's k-d tree {:.0f} times Builtin's time to θ < 6e-5 N·s; compiled here {:.2f} times",
            lambda: [by_tree()[RATIO][0], by_tree()["mean compiled here, ms"] / by_tree()["mean builtin, ms"]],
        ),
        (
            "Within a quarter of its θ at sweeps {} to {} only. It is slower at sweeps {} to {}, faster at sweeps {} to {:,}",
            lambda: [
                *sweeps("figure_3_7", "Builtin performs like None")[:2],
                *integers(ahead("figure_3_7", "none", "builtin")),
                *integers(ahead("figure_3_7", "builtin", "none")),
            ],
        ),
        (
            "angular momentum to {:.2f} %",
            lambda: [100 * float(np.mean(stored("figure_6_3")["data"]["by scene"]["angular momentum"]))],
        ),
        ("All its epochs are {:.0f} PFLOP, over a day {:.0f} % of the card's peak", training_work),
        (
            "the interval of the median contact is {:.2f} times the mean λ_n. So in the worst case no network can promise an "
            "error below {:.2f} of the mean λ_n. PGS from zero ends with impulses that are not those of the run: the λ_n of "
            "the median contact is off by {:.2f} of the mean λ_n (Figure 6.15). In settling piles of 100 circles, the "
            "interval of the median contact is at most {:.2f}",
            lambda: [*(width(scene="thesis", radii="1") / k for k in (1, 2)), elsewhere()[0], settling_width()],
        ),
        (
            "takes {:.2f} times Builtin's sweeps, with an interval of {:.2f} to {:.2f}",
            lambda: not_efficient(FAR_FIELD)[0],
        ),
        ("reach this θ within 20,000 sweeps: {} of {} from Copy, {} from Builtin, {} from", reached),
        ("five channels of input and {:,} weights", lambda: weights_of_thesis()[:1]),
        ("It was shown 1/{:.1f} as many states as the network of the thesis", lambda: [training_share()]),
        ("Its learning rate began at {:g}, as in Appendix B. In Table 5.2 the first learning rate is {:g}", first_rates),
        (
            "predicts are off by {:.2f}. Its λ at the contacts is off by {:.2f}, or by {:.2f} if its image is read back as in "
            "the authors' code. Builtin is off by {:.2f} at the grid nodes and by {:.2f} at the contacts. Impulses of zero are "
            "off by 1 at both. The image of the true solution, read back bilinearly, is off by {:.2f}",
            errors_of_images,
        ),
        (
            "predicts, θ is {:.2f} times the θ from None. If the image is read back as in the authors' code, θ is {:.2f} times "
            "the θ from None (Figure 5.9)",
            lambda: [ratio_after("figure_5_9", f"{CNN}{read} is a start", 100)[0] for read in READ_NETWORK.values()],
        ),
        (
            "Our consistent transfer loses {:.0e} of a pile's impulses at d = h = 0.5 m. With this transfer the SPH start is "
            "faster than Builtin up to sweep {:,}",
            lambda: [lost("pile, consistent"), *sweeps("figure_3_8", "with the consistent transfer SPH is faster than Builtin")[1:]],
        ),
        ("were used to judge {} claims on SPH. For {} of these claims the verdict by the spline differs", both_ways),
        (
            "its θ after 100 sweeps is {:.2f} times the θ of d = h = 0.5 m, with an interval of {:.2f} to {:.2f}",
            lambda: ratio_after("figure_3_8", "the authors' setting", 100),
        ),
    ],
}
"""Page -> pieces of its text, and the function that makes their numbers."""

GIVEN: dict[str, list[str]] = {
    "README.md": ["come to rest in 6 s", "μ = 0.5", "to velocity errors of 0.3 and 0.1"],
    "appendix.md": ["95 %", "ratios of 1e-15 and less", "shown as 1e-15"],
    "accuracy.md": [
        *(
            "at most 85 % of the tolerances",
            "restitutions of 0.3 and 0.8",
            "friction above 1, restitution above 0.9",
            "radii that differ more than 1.3 times",
            "a thread works for 10 ms of simulated time, in the mean over a run of 6 s",
        ),
        *("by at most 1 % of its initial value", "Δt is 10 ms", "below 3 % of a mean radius", "steps of 0.625 ms"),
        *("the lengths are 100 times these, and the speeds 10 times", "a thread works for 10 ms"),
        *("The window is 50 ms for circles of 1 m, and 5 ms for", "which is 10 ms for circles of 1 m, and 1 ms for"),
    ],
    "benchmarks.md": ["a velocity error of 0.1", "of radii from 0.5 to 1.5 m", "ω = 1.5", "61 × 61 nodes", "30 ns a contact and sweep"],
    "guide.md": [
        *("0.01 s for r = 1 m", "takes 2.6 GB", "takes 0.6 GB"),
        *("about 1 ms of its own", "a scene took 10 ms", "a task of 10 s"),
    ],
    "materials.md": [
        *("Smooth discs with e = 0.9 between walls", "In the first 4 s"),
        *("The floor sinks at 0.2 m/s, by some 5 % of the height", "Between walls of μ = 0.3", "other, and μ = 0.5"),
        *("the run-out is 1.2 a for a < 1.8, and 1.9 a^(2/3) for a > 2.8", "have 3.25 a^0.70 for a > 2"),
    ],
    "moving.md": ["at most 0.001 √(g r)", "discs of 1 m under 9.81 m/s² at Δt = 0.01 s", "may move by 0.01"],
    "other_starts.md": ["Δt = 0.01 s", "1.75 | 1.45", "ω = 1.75 for the normal and 1.45 for", "d = h = 0.5 m"],
    "recipes.md": ["speeds from 0.1 to 10"],
    "solvers.md": ["9.81 m/s² and Δt = 0.01 s", "√1000 times", "more than 100 times"],
    "starts.md": [
        *("off by more than 5 %", "radii from 0.8 m", "2 to 5 times as fast", "10 to 60 times as fast"),
        *("about 90 % for a pile that flows out and 65 % for bulldozing", "errors (0.3 and 0.1)"),
        "velocity errors of 0.3 and 0.1: an error of 0.03",
    ],
    "thesis.md": [
        *("d = 0.75 m with h = 0.5 m", "of d = h = 0.5 m", "0.25, 0.5 and 0.75 m", "goes from 0.25 m to 2 m"),
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
        values = [written(value, spec) for value, spec in zip(numbers(), specs, strict=True)]

        def sentence(match: re.Match, values=values) -> str:
            pieces = list(match.groups())
            pieces[1 : 2 * len(values) : 2] = values
            return "".join(pieces)

        text, times = pattern(template).subn(sentence, text)
        if times != 1:
            raise ValueError(f"{page}: expected one sentence with {template!r}, got {times}")
    return text


def written(value, spec: str) -> str:
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
