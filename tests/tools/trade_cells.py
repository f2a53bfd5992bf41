"""Whether what a trade chooses keeps its word: ten scenes of no study, on twenty other seeds.

    python tests/tools/trade_cells.py [--circles N] [--steps N] [--scenes NAME …]

Prints for each scene how long it was said to take, took, and the share of cells (scene, preset, error) that the chosen
settings keep on seeds 100 to 119, which no trade has seen.
"""

import argparse
import math
import time
import warnings
from dataclasses import replace

import numpy as np

import deep_contact as dc
from deep_contact import presets, run_errors, trade
from deep_contact.studies import runs


def heavy_drum(n, seed):
    scene = dc.drum(n, restitution=0.5, seed=seed)
    mass = np.where(np.random.default_rng(seed).random(n) < 0.3, 10.0, 1.0) * scene.bodies.mass
    return scene.replace(bodies=scene.bodies._replace(mass=mass))


def pyramid(n, seed):
    rows = math.ceil(0.5 * (math.sqrt(8 * n + 1) - 1))
    places = np.array([(2.002 * i + 1.001 * r, 1.734 * r) for r in range(rows) for i in range(rows - r)])
    return placed(places + np.random.default_rng(seed).uniform(-1e-4, 1e-4, places.shape), "pyramid")


def two_heaps(n, seed):
    heap = dc.lattice_in_box(n // 2, seed=seed).bodies
    width = np.ptp(heap.position[:, 0]) + 4.0
    places = np.concatenate(
        [heap.position + np.array([2.0, 0.0]), heap.position[::-1] + np.array([2.0 + 1.5 * width, 0.0])]
    )
    velocity = np.repeat([[6.0, 0.0], [-6.0, 0.0]], n // 2, axis=0)
    return placed(places, "two_heaps", velocity=velocity)


def belt(n, seed):
    scene = dc.lattice_in_box(n, seed=seed)
    x_min, y_min, x_max, y_max = scene.world.box
    line = ((x_min, 1.0, x_max, 1.0),)
    world = replace(scene.world, box=(x_min, y_min, x_max + 40, y_max + 2), segments=line, surface_speeds=(3.0,))
    return scene.replace(
        world=world, bodies=scene.bodies._replace(position=scene.bodies.position + np.array([0.0, 1.2]))
    )


def placed(places, name, **options):
    places = places - places.min(axis=0) + 1.01
    box = (0, 0, *(places.max(axis=0) + np.array([21.0, 3.0])))
    return dc.State(name=name, world=dc.World(box=box), bodies=dc.make_bodies(places, radius=1.0, **options))


SCENES = {
    "hopper": lambda n, seed: dc.hopper(n, opening=9.0, steepness=50.0, seed=seed),
    "dam break": lambda n, seed: runs.dam_break(n, aspect=1.5, radius=(0.7, 1.0), seed=seed),
    "drum, e = 0.5, masses 1 : 10": heavy_drum,
    "radii 1 : 10": lambda n, seed: dc.lattice_in_box(n, radius=(0.1, 1.0), seed=seed),
    "terrain": lambda n, seed: dc.terrain(n, bumps=12, seed=seed),
    "silo": lambda n, seed: dc.lattice_in_box(n, columns=5, seed=seed),
    "gas": lambda n, seed: runs.gas(n, gap=0.5, restitution=0.95, seed=seed),
    "pyramid": pyramid,
    "two heaps": two_heaps,
    "belt": belt,
}


def judged(make, n, steps):
    """(Trade, preset -> error -> (value on the other seeds, tolerance)) of a scene."""
    measured = dc.measure_trade(lambda seed: make(n, seed), steps=steps)
    every = max(1, steps // trade.FRAMES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        chosen = {preset: measured.chosen(preset) for preset in presets.PRESETS}

    def ensemble(setting):
        scenes = (make(n, seed) for seed in range(100, 120))
        each = steps // every, every * measured.dt
        return [run_errors.observe(trade.states_of(scene, setting, *each)) for scene in scenes]

    true, seen, cells = ensemble(measured.reference), {}, {}
    for preset, row in chosen.items():
        if row["name"] not in seen:
            seen[row["name"]] = run_errors.errors(ensemble(row["setting"]), true)
        limits = presets.PRESETS[preset]
        cells[preset] = {name: (seen[row["name"]][name], most, row["errors"][name]) for name, most in limits.items()
                         if seen[row["name"]][name] is not None and row["errors"][name]}  # fmt: skip
    return measured, cells


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--circles", type=int, default=100)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    options = parser.parse_args()
    kept = promised = total = offered = 0
    for name in options.scenes:
        begun = time.process_time()
        measured, cells = judged(SCENES[name], options.circles, options.steps)
        mine = [(p, e, value, most, at) for p, of in cells.items() for e, (value, most, at) in of.items()]
        missed = [f"{p} {e} {value / most:.2f}" for p, e, value, most, _ in mine if value > most]
        # Where the trade itself said that a tolerance is not kept, nothing was promised.
        able = [(value, most) for *_, value, most, at in mine if at[0] <= most]
        kept, total = kept + len(mine) - len(missed), total + len(mine)
        promised, offered = promised + sum(value <= most for value, most in able), offered + len(able)
        ratio = measured.took_s / measured.predicted_s
        text = f"{name}: said {measured.predicted_s:.1f} s, took {measured.took_s:.1f} s, {ratio:.2f}"
        text += f"; CPU {time.process_time() - begun:.0f} s; {len(mine) - len(missed)} of {len(mine)} cells"
        print(
            f"{text}, {sum(v <= m for v, m in able)} of {len(able)} promised; missed: {', '.join(missed)}", flush=True
        )
    print(f"kept {kept} of {total} cells, {promised} of {offered} that the trade promised")


if __name__ == "__main__":
    main()
