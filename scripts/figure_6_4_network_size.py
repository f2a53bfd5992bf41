"""python scripts/figure_6_4_network_size.py: what a larger far-field network gains and costs.

One network per file, all trained alike: models/comparison/width_<features>.h5. Where there are none, the shipped one.
"""

import re
from functools import partial
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import learned_starts as study
from deep_contact.studies import timing
from deep_contact.studies.chapter_5 import networks_info
from deep_contact.studies.starts import start_of


def compute(options, seed, jobs, progress):
    """Errors of every network on the same states of held-out scenes, and their times, one after the other."""
    networks = files(options["folder"])
    starts = {"builtin": "builtin"} | {name: {"model": path} for name, path in networks.items()}
    (scenes,) = study.errors_on_scenes(starts, options, seed + 10_000, jobs, progress)
    info, repeats = networks_info(networks), options["repeats"]
    state = dc.simulate(dc.circles_in_box(100, seed=1), steps=200, solver=dc.NNCG()).state
    priced = []
    for name in networks:
        us = 1e6 * timing.fastest(partial(start_of(starts[name]), state, dc.PGS()), repeats)
        priced.append({"name": name, "weights": info[name]["parameters"], "us": us})
    sweep_us = 1e6 * study.sweep_time(state, "PGS", repeats)
    return {"after": options["after"], "networks": priced, "scenes": scenes, "sweep_us": sweep_us}


def files(folder):
    """Name -> model file of every network of the folder, or of the shipped one if it has none."""
    root = Path(__file__).resolve().parents[1]
    paths = (root / folder).glob("width_*.h5")
    return {path.stem.replace("_", " "): f"{folder}/{path.name}" for path in paths} or {"shipped": "models/model.h5"}


def networks_of(data):
    """The networks by weights, each with its error over Builtin's, (sweeps, 3)."""
    kept = (one for one in data["networks"] if re.fullmatch(r"width \d+|shipped", one["name"]))
    networks = (one | {"ratios": study.ratios_to_builtin(data["scenes"], one["name"])} for one in kept)
    return sorted(networks, key=lambda network: network["weights"])


def claims(data):
    networks, after = networks_of(data), 10 if 10 in data["after"] else data["after"][-1]
    error = {n["weights"]: float(n["ratios"][data["after"].index(after), 0]) for n in networks}
    text = f"every larger network leaves less error after {after} sweeps than the one before"
    falls = len(error) > 1 and (np.diff(list(error.values())) < 0).all()
    yield Claim(text, None, bool(falls), {f"{weights:,} weights": ratio for weights, ratio in error.items()})
    largest = networks[-1]["weights"]
    if quarter := [weights for weights in error if weights <= largest / 4]:
        part, whole = error[quarter[-1]], error[largest]
        text = f"the largest network leaves at most 0.9 of the error after {after} sweeps of one with a quarter of its"
        measured = {"a quarter of the weights": part, "all": whole}
        yield Claim(f"{text} weights", None, whole <= 0.9 * part, measured)
    cost = {f"{network['weights']:,} weights, μs": network["us"] for network in networks}
    text = "even the smallest network costs more time than thirty sweeps of PGS"
    holds = networks[0]["us"] > 30 * data["sweep_us"]
    yield Claim(text, None, holds, cost | {"a sweep, μs": data["sweep_us"]})


def table(data):
    rows = [["network", "weights", "μs", "in sweeps", *(f"error({k}) / Builtin's" for k in data["after"])]]
    for network in networks_of(data):
        cells = (study.text_of(ratio, 3) for ratio in network["ratios"])
        rows.append([network["name"], network["weights"], network["us"], network["us"] / data["sweep_us"], *cells])
    builtin = study.mean_errors(data["scenes"], "builtin").mean(axis=0)
    return [*rows, ["builtin, its error", None, None, None, *(float(value) for value in builtin)]]


def draw(data, options):
    """Left: error over Builtin's by weights, with intervals. Right: time by weights, and what it is in sweeps."""
    figure, (left, right) = plotting.subplots(1, 2, size=(10.0, 4.0))
    networks = networks_of(data)
    weights = [network["weights"] for network in networks]
    ratios = np.array([network["ratios"] for network in networks])
    for i, k in enumerate(data["after"]):
        plotting.band(left, weights, *ratios[:, i].T, marker="o", markersize=4, label=f"after {k} sweeps")
    left.axhline(1.0, color=plotting.GREY, linewidth=1.0)
    left.set(ylim=(0, 1.2), ylabel="velocity error / Builtin's", title="error on held-out scenes")
    left.legend(loc="lower left")
    us = [network["us"] for network in networks]
    right.plot(weights, us, marker="o", color=plotting.PURPLE)
    right.set(ylim=(0, None), ylabel="time of a start (μs)", title="time of a start for 100 circles")
    sweep_us = data["sweep_us"]
    sweeps = right.secondary_yaxis("right", functions=(lambda us: us / sweep_us, lambda count: count * sweep_us))
    sweeps.set_ylabel("sweeps of PGS in that time")
    for ax in (left, right):
        ax.set(xscale="log", xlabel="weights")
    figure.suptitle("What does a larger network gain, and what does it cost?", fontsize=10)
    return figure


OPTIONS = {"folder": "models/comparison", "scenes": 20, "steps": 600, "every": 5, "after": [3, 10, 30], "repeats": 200}
QUICK = {"scenes": 2, "every": 30, "steps": 240, "repeats": 20}
FIGURE = Figure("6.4", "Size of the far-field network: error and time", compute, table, draw, claims,
                options=OPTIONS, quick=QUICK, digits=5)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
