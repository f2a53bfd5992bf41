"""python scripts/figure_6_4_network_size.py: what a larger far-field network, or a coarser image, gains and costs.

One network a file, all trained alike: models/comparison/width_<features>.h5, and spacing_<d>.h5 with as many features
as width_24.h5 on images whose nodes lie d mean radii apart. Where there are none, the shipped one.
"""

import re
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.break_even import sweep_times
from deep_contact.studies.learned import errors_on_thesis_scene, mean_errors, networks_info, ratios_to_builtin
from deep_contact.studies.scaling import fastest

SHIPPED = "models/model.h5"
MARKERS = "^sDv"
"""Of networks on coarser images, in the order of their spacing."""

HOLLOW = {"linestyle": "none", "markerfacecolor": "white", "markersize": 7, "zorder": 3}


def compute(options, seed, jobs, progress):
    """Errors of every network on the same states of scenes that none has seen, and their times, one after the other."""
    networks = files(options["folder"])
    tasks = [{**options, "networks": networks, "seed": s} for s in figures.seeds(seed + 10_000, options["scenes"])]
    scenes = figures.parallel_map(one_scene, tasks, jobs=jobs, progress=progress, text="scenes")
    info = networks_info(networks)
    us = {name: inference_us(path, options["repeats"]) for name, path in networks.items()}
    found = [
        {"name": name, "weights": info[name]["parameters"], "us": us[name], "spacing": spacing_of(name)}
        for name in networks
    ]
    return {
        "after": options["after"],
        "networks": sorted(found, key=lambda network: (network["spacing"], network["weights"])),
        "scenes": scenes,
        "sweep_us": 1e6 * sweep_times(settled(), repeats=options["repeats"])["PGS"],
    }


def files(folder):
    """Name -> model file of every network of the folder, or of the shipped one if it has none."""
    root = Path(__file__).resolve().parents[1]
    found = [path for path in (root / folder).glob("*.h5") if re.fullmatch(r"width_\d+|spacing_[\d.]+", path.stem)]
    if not found:
        return {"shipped": SHIPPED}
    return {path.stem.replace("_", " "): str(Path(folder) / path.name) for path in sorted(found)}


def spacing_of(name):
    """Of the nodes of the network's images, in mean radii."""
    kind, _, number = name.partition(" ")
    return float(number) if kind == "spacing" else 1.0


def one_scene(task):
    """Errors of all starts on one scene of 70 to 110 circles, in a process of its own."""
    from deep_contact.cnn.inference import network_start
    from deep_contact.warm_start import Builtin

    starts = {"builtin": Builtin()} | {name: network_start(path) for name, path in task["networks"].items()}
    return errors_on_thesis_scene(starts, task)


def settled():
    """A state of 100 circles on which all times are taken."""
    return dc.simulate(dc.circles_in_box(100, seed=1), steps=200, solver=dc.NNCG()).state


def inference_us(path, repeats):
    """Time of a warm start by the network on one thread, image and reading back included, μs: the least of several."""
    from deep_contact.cnn.inference import network_start

    start, state = network_start(path), settled()
    return fastest(lambda: start(state, dc.PGS()), repeats)


def claims(data):
    """Whether size pays, in error and in time."""
    found = []
    for network in data["networks"]:
        ratio = ratios_to_builtin(data["scenes"], network["name"], "all")[:, 0]
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
        ratios = ratios_to_builtin(data["scenes"], network["name"], "all")
        cells = [f"{ratio:.3f} ({low:.3f}–{high:.3f})" for ratio, low, high in ratios]
        rows.append([network["name"], network["weights"], network["us"], network["us"] / data["sweep_us"], *cells])
    builtin = mean_errors(data["scenes"], "builtin", "all").mean(axis=0)
    rows.append(["builtin, its error", None, None, None, *(float(value) for value in builtin)])
    return rows


def draw(data, options):
    """Left: error over Builtin's by weights, with intervals. Right: time by weights, and what it is in sweeps."""
    figure, (left, right) = plotting.subplots(1, 2, size=(10.0, 4.0))
    sizes = [network for network in data["networks"] if network["spacing"] == 1]
    coarse = [network for network in data["networks"] if network["spacing"] > 1]
    weights = [network["weights"] for network in sizes]
    every, others = (
        np.array([ratios_to_builtin(data["scenes"], network["name"], "all") for network in group])
        for group in (sizes, coarse)
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
