"""python tests/tools/slow_cases.py [bounces] [terrain] [ten] [materials]: times in cases in which this package once was
slow, or that model more.

bounces  1,000 circles, 6 s, preset "fast": the time of e = 0.3 and of e = 0.8, divided by that of e = 0
terrain  100 circles on rough ground: the time of the fastest other engine that keeps a preset, divided by ours, with
         the settings of Figure 6.16 (`data/reference/figure_6_16.json`); errors are not measured again
ten      10 circles, step by step: the time of `Simulator.step`, divided by that of pymunk's `Space.step`
materials  resting piles, ten sweeps: the time of a step with two materials of equal tables, and with rolling
         resistance, divided by the time of a step with one number for all pairs

All runs of a case take turns. The time of a run is its least thread time, so that other programs disturb it little.
They still share caches with it: for times that are printed somewhere, let the machine run nothing else.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import thread_time

import numpy as np

import deep_contact as dc
from deep_contact.accuracy.presets import PRESETS
from deep_contact.measure.peers import Pymunk
from deep_contact.measure.setting_runs import WARM, Run

FIGURE = Path(__file__).resolve().parents[2] / "data" / "reference" / "figure_6_16.json"
SECONDS = 6.0


def least_times(runs: Mapping[object, Callable[[], Callable]], repeats: int) -> dict:
    """Return the least thread time of each run, s. runs: name -> function that prepares a run and returns it."""
    least = dict.fromkeys(runs, float("inf"))
    for _ in range(repeats):
        for name, prepare in runs.items():
            run = prepare()
            begun = thread_time()
            run()
            least[name] = min(least[name], thread_time() - begun)
    return least


def bounces() -> None:
    """Print the times of a step for three restitutions."""
    scenes = {e: dc.lattice_in_box(1000, restitution=e) for e in (0.0, 0.3, 0.8)}
    steps = round(SECONDS / scenes[0.0].dt)
    runs = {e: partial(partial, dc.simulate, scene, steps=steps, accuracy="fast") for e, scene in scenes.items()}
    least_times(runs, 1)  # compiles
    least = least_times(runs, 5)
    for e, seconds in least.items():
        print(f"bounces, e = {e}: {1e6 * seconds / steps:.1f} μs a step, {seconds / least[0.0]:.2f} times e = 0")


def terrain() -> None:
    """Print the ratio of the fastest rival's time to ours for each preset that both keep."""
    for one in json.loads(FIGURE.read_text(encoding="utf-8"))["data"]["scenes"]:
        if one["n_bodies"] != 100 or "terrain" not in one["scene"]:
            continue
        scene = dc.terrain(100, bumps=int(one["scene"].split()[1]))
        settings = {row["name"]: row["setting"] for row in one["rows"]}
        kept = {row["preset"]: (row["kinds"]["plain"], row["peers"]) for row in one["presets"]}
        needed = {name for mine, peers in kept.values() for name in _names(mine, *peers.values())}
        least = least_times({name: partial(_started, scene, settings[name]) for name in needed}, 5)
        for preset in PRESETS:
            mine, peers = kept[preset]
            theirs = min(_names(*peers.values()), key=least.get, default=None)
            if mine and theirs:
                us = {name: 1e6 * least[name] * scene.dt / SECONDS for name in (mine["name"], theirs)}
                ratio = us[theirs] / us[mine["name"]]
                print(f"{one['scene']}, {preset}: {ratio:.2f}; " + "; ".join(f"{k}: {us[k]:.1f} μs" for k in us))


def _names(*rows) -> list[str]:
    return [row["name"] for row in rows if row]


def _started(scene, setting) -> Callable:
    run = Run(scene, setting)
    run.advance(WARM)
    return partial(run.advance, round(SECONDS / setting["dt"]))


def ten() -> None:
    """Print the times of single steps of 10 circles at rest."""
    live, world = dc.Simulator(dc.circles_in_box(10, seed=0)), Pymunk(dc.circles_in_box(10, seed=0)).space
    ways = {"Simulator.step": live.step, "pymunk": partial(world.step, 0.01)}
    for step in ways.values():
        for _ in range(400):
            step()

    def often(step):
        for _ in range(500):
            step()

    least = least_times({name: partial(partial, often, step) for name, step in ways.items()}, 100)
    for name, seconds in least.items():
        print(f"ten, {name}: {1e6 * seconds / 500:.2f} μs a step, {seconds / least['pymunk']:.2f} times pymunk")


def materials() -> None:
    """Print the times of a step of resting piles with one material, with two, and with rolling resistance."""
    for count, steps in ((100, 1500), (1000, 250), (10_000, 40)):
        pile = dc.simulate(dc.lattice_in_box(count, seed=1), steps=600, accuracy="fast").state
        kinds = np.random.default_rng(0).integers(0, 2, count)
        mu, e = pile.world.friction, pile.world.restitution
        tables = replace(pile.world, friction=[[mu, mu], [mu, mu]], restitution=[[e, e], [e, e]])
        rolling = replace(pile.world, rolling_friction=0.05)
        scenes = {
            "one": pile, "two materials": pile.replace(world=tables, bodies=pile.bodies._replace(material=kinds)),
            "rolling resistance": pile.replace(world=rolling),
        }  # fmt: skip
        for solver in (dc.PGS(sweeps=10, tolerance=None), dc.BatchedPGS(sweeps=10, tolerance=None)):
            # Their first steps test the carried impulses, since the world has changed. These steps are not timed.
            begun = {name: dc.simulate(scene, steps=60, solver=solver).state for name, scene in scenes.items()}
            runs = {name: partial(partial, dc.simulate, one, steps=steps, solver=solver) for name, one in begun.items()}
            least = least_times(runs, 12)
            ratios = ", ".join(f"{name} {least[name] / least['one']:.3f}" for name in list(least)[1:])
            name = f"materials, {count} circles, {type(solver).__name__}"
            print(f"{name}: {1e6 * least['one'] / steps:.1f} μs a step; {ratios}")


CASES = {"bounces": bounces, "terrain": terrain, "ten": ten, "materials": materials}

if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for name in sys.argv[1:] or CASES:
        CASES[name]()
