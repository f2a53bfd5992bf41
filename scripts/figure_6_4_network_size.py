"""python scripts/figure_6_4_network_size.py: what a larger far-field network, or a coarser image, gains and costs.

One network per file, all trained alike: models/comparison/width_<features>.h5, and spacing_<d>.h5 with as many features
as width_24.h5 on images whose nodes lie d mean radii apart. Where there are none, the shipped one is used.
"""

import re
from functools import partial
from pathlib import Path

import numpy as np

from deep_contact.physics.solvers import PGS
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import timing
from deep_contact.studies.chapter_5 import networks_info
from deep_contact.studies.learned_starts import (
    cells_of,
    errors_on_scenes,
    mean_errors,
    ratios_to_builtin,
    sweep_time,
    timing_state,
)
from deep_contact.studies.starts import start_of

SHIPPED = "models/model.h5"
MARKERS = "^sDv"
"""Of networks on coarser images, in the order of their spacing."""

HOLLOW = {"linestyle": "none", "markerfacecolor": "white", "markersize": 7, "zorder": 3}


def compute(options, seed, jobs, progress):
    """Errors of every network on the same states of held-out scenes, and their times, one after the other."""
    networks = files(options["folder"])
    starts = {"builtin": "builtin"} | {name: {"model": path} for name, path in networks.items()}
    (scenes,) = errors_on_scenes(starts, options, seed=seed + 10_000, jobs=jobs, progress=progress, with_all=[])
    info, state, repeats = networks_info(networks), timing_state(), options["repeats"]
    found = [
        {
            "name": name,
            "weights": info[name]["parameters"],
            "us": 1e6 * timing.fastest(partial(start_of(starts[name]), state, PGS()), repeats),
            "spacing": spacing_of(name),
        }
        for name in networks
    ]
    return {
        "after": options["after"],
        "networks": sorted(found, key=lambda network: (network["spacing"], network["weights"])),
        "scenes": scenes,
        "sweep_us": 1e6 * sweep_time(state, "PGS", repeats),
    }


def files(folder):
    """Name -> model file of every network of the folder, or of the shipped one if it has none."""
    root = Path(__file__).resolve().parents[1]
    found = [path for path in (root / folder).glob("*.h5") if re.fullmatch(r"width_\d+|spacing_[\d.]+", path.stem)]
    if not found:
        return {"shipped": SHIPPED}
    return {path.stem.replace("_", " "): str(Path(folder) / path.name) for path in sorted(found)}


def spacing_of(name):
    """Distance of the nodes of the network's images, in mean radii."""
    kind, _, number = name.partition(" ")
    return float(number) if kind == "spacing" else 1.0


def claims(data):
    """Whether size pays, in error and in time."""
    found = []
    for network in data["networks"]:
        ratio = ratios_to_builtin(data["scenes"], network["name"])[:, 0]
        network["ratio"] = {f"after {k}": float(value) for k, value in zip(data["after"], ratio)}
    at = "after 10" if 10 in data["after"] else f"after {data['after'][-1]}"
    sizes = [network for network in data["networks"] if network["spacing"] == 1]
    small, large = sizes[0], sizes[-1]
    measured = {f"{network['weights']:,} weights": network["ratio"][at] for network in sizes}
    ratios = list(measured.values())
    text = f"every larger network leaves less error {at} sweeps than the one before"
    found.append(Claim(text, None, bool(len(ratios) > 1 and (np.diff(ratios) < 0).all()), measured))
    half = [network for network in sizes if network["weights"] <= large["weights"] / 4]
    if half:
        gain = {"a quarter of the weights": half[-1]["ratio"][at], "all": large["ratio"][at]}
        text = f"the largest network leaves at most 0.9 of the error {at} sweeps of one with a quarter of its weights"
        found.append(Claim(text, None, gain["all"] <= 0.9 * gain["a quarter of the weights"], gain))
    for coarse in (network for network in data["networks"] if network["spacing"] > 1):
        rivals = [network for network in sizes if network["us"] <= coarse["us"]]
        text = f"nodes {coarse['spacing']:g} mean radii apart leave less error {at} sweeps than those as fast at 1"
        least = min((network["ratio"][at] for network in rivals), default=np.inf)
        measured = {"coarse": coarse["ratio"][at], "μs": coarse["us"], "fine": least if rivals else None}
        found.append(Claim(text, None, coarse["ratio"][at] < least, measured))
    cost = {f"{network['weights']:,} weights, μs": network["us"] for network in sizes}
    text = "even the smallest network costs more time than thirty sweeps of PGS"
    found.append(Claim(text, None, small["us"] > 30 * data["sweep_us"], cost | {"a sweep, μs": data["sweep_us"]}))
    return found


def table(data):
    """Rows: weights, time, and the error left after some sweeps over Builtin's, with its 95 % interval."""
    rows = [["network", "weights", "μs", "in sweeps", *(f"error({k}) / Builtin's" for k in data["after"])]]
    for network in data["networks"]:
        cells = cells_of(ratios_to_builtin(data["scenes"], network["name"]))
        rows.append([network["name"], network["weights"], network["us"], network["us"] / data["sweep_us"], *cells])
    builtin = mean_errors(data["scenes"], "builtin").mean(axis=0)
    rows.append(["builtin, its error", None, None, None, *(float(value) for value in builtin)])
    return rows


def draw(data, options):
    """Left: error over Builtin's by weights, with intervals. Right: time by weights, and what it is in sweeps."""
    figure, (left, right) = plotting.subplots(1, 2, size=(10.0, 4.0))
    sizes = [network for network in data["networks"] if network["spacing"] == 1]
    coarse = [network for network in data["networks"] if network["spacing"] > 1]
    weights = [network["weights"] for network in sizes]
    every, others = (
        np.array([ratios_to_builtin(data["scenes"], network["name"]) for network in group]) for group in (sizes, coarse)
    )
    for i, k in enumerate(data["after"]):
        line = left.plot(weights, every[:, i, 0], marker="o", markersize=4, label=f"after {k} sweeps")
        left.fill_between(weights, every[:, i, 1], every[:, i, 2], color=line[0].get_color(), alpha=0.15, linewidth=0)
        for network, ratios, marker in zip(coarse, others, MARKERS):
            look = HOLLOW | {"marker": marker, "color": line[0].get_color()}
            left.plot(network["weights"], ratios[i, 0], **look)
    left.axhline(1.0, color=plotting.GREY, linewidth=1.0)
    left.set_ylim(0, 1.2)
    plotting.label_axes(left, "weights", "velocity error / Builtin's", title="a) error on held-out scenes, all steps")
    left.legend()
    right.plot(weights, [network["us"] for network in sizes], marker="o", color=plotting.BLUE)
    for network, marker in zip(coarse, MARKERS):
        look = HOLLOW | {"marker": marker, "color": plotting.BLUE}
        right.plot(network["weights"], network["us"], **look, label=f"nodes {network['spacing']:g} mean radii apart")
    if coarse:
        right.legend()
    right.set_yscale("log")
    sweeps = right.secondary_yaxis(
        "right", functions=(lambda us: us / data["sweep_us"], lambda count: count * data["sweep_us"])
    )
    sweeps.set_ylabel("sweeps of PGS in that time")
    title = "b) a start for 100 circles, one thread"
    plotting.label_axes(right, "weights", "time of a start", y_unit="μs", title=title)
    for ax in (left, right):
        ax.set_xscale("log")
    return figure


FIGURE = Figure(
    id="6.4",
    title="Size of the far-field network: error and time",
    options={
        "folder": "models/comparison",
        "scenes": 20,
        "steps": 600,
        "every": 5,
        "after": [3, 10, 30],
        "repeats": 200,
    },
    quick={"scenes": 2, "every": 30, "steps": 240, "repeats": 20},
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
    digits=5,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
