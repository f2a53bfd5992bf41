"""python scripts/table_6_4_energy.py: the mechanical energy that bouncing circles keep in a run with each preset."""

import warnings
from itertools import product

import numpy as np

from deep_contact import figures, parallel
from deep_contact.accuracy.presets import PRESETS, PresetWarning
from deep_contact.figures import Claim, Figure
from deep_contact.run.one_scene import simulate
from deep_contact.scenes import circles_in_box
from deep_contact.studies.hard_scenes import mechanical_energy, with_bodies

KEPT = 0.02
"""Largest change of the energy of elastic circles without friction that a claim allows, over the initial energy."""

GAINED = 0.01
"""Largest increase of the energy of any circles that a claim allows, over the initial energy."""


def scene_of(case, options):
    """Return a scene of circles that fall into a box.

    Their masses are multiplied by random factors from 1 to case["mass_ratio"], whose logarithms are drawn uniformly.
    """
    scene = circles_in_box(
        options["n_bodies"], restitution=case["restitution"], friction=case["friction"], seed=case["seed"]
    )
    share = np.random.default_rng(case["seed"]).random(scene.bodies.count)
    return with_bodies(scene, mass=scene.bodies.mass * case["mass_ratio"] ** share)


def run_case(task):
    """Simulate a case with its preset. Returns the case with its final, least and greatest energy, over the initial."""
    case, options = task
    state = scene_of(case, options)
    start, shares = mechanical_energy(state, state.bodies), []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PresetWarning)
        for _ in range(options["steps"] // options["every"]):
            state = simulate(state, steps=options["every"], accuracy=case["preset"]).state.replace(solver=None)
            shares.append(mechanical_energy(state, state.bodies) / start)
    return case | {"end": shares[-1], "least": min(shares), "greatest": max(shares)}


def compute(options, seed, jobs, progress):
    """Simulate every combination of restitution, friction and mass ratio with every preset."""
    names = ("restitution", "friction", "mass_ratio", "preset")
    cases = product(options["restitutions"], options["frictions"], options["mass_ratios"], PRESETS)
    tasks = [(dict(zip(names, case)) | {"seed": seed}, options) for case in cases]
    return {"runs": parallel.parallel_map(run_case, tasks, jobs=jobs, progress=progress, text="runs")}


def claims(data):
    elastic = [run for run in data["runs"] if run["restitution"] == 1 and run["friction"] == 0]
    worst = {preset: max(max(1 - r["least"], r["greatest"] - 1) for r in elastic if r["preset"] == preset)
             for preset in PRESETS}  # fmt: skip
    text = f"elastic circles without friction keep their energy within {KEPT:.0%} with every preset, whatever their"
    yield Claim(f"{text} masses", None, max(worst.values()) <= KEPT, worst)
    gain = {preset: max(r["greatest"] - 1 for r in data["runs"] if r["preset"] == preset) for preset in PRESETS}
    text = f"no preset makes more than {GAINED:.0%} of energy at any restitution, friction and ratio of masses"
    yield Claim(text, None, max(gain.values()) <= GAINED, gain)


def table(data):
    cases = list(dict.fromkeys((r["friction"], r["mass_ratio"]) for r in data["runs"]))
    rows = [["preset", "restitution", *(f"μ = {mu:g}, masses 1 to {ratio:g}" for mu, ratio in cases)]]
    end = {(r["preset"], r["restitution"], r["friction"], r["mass_ratio"]): r["end"] for r in data["runs"]}
    for preset, e in dict.fromkeys((r["preset"], r["restitution"]) for r in data["runs"]):
        rows.append([preset, e, *(end[preset, e, *case] for case in cases)])
    return [rows[0], *sorted(rows[1:], key=lambda row: (list(PRESETS).index(row[0]), row[1]))]


OPTIONS = {
    "n_bodies": 100, "steps": 1000, "every": 50, "restitutions": [0.0, 0.3, 0.8, 1.0], "frictions": [0.0, 0.5],
    "mass_ratios": [1.0, 100.0, 1e4],
}  # fmt: skip
QUICK = {"n_bodies": 20, "steps": 200, "restitutions": [0.0, 1.0], "mass_ratios": [1.0]}
FIGURE = Figure("T 6.4", "Mechanical energy of 100 circles after 1,000 steps, over that at the start", compute, table,
                claims=claims, options=OPTIONS, quick=QUICK, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
