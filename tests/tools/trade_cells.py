"""Whether what a trade chooses keeps its word: eight scenes of no study, on twenty other seeds.

    python tests/tools/trade_cells.py [--circles N] [--steps N] [--scenes NAME …]

Prints for each scene how long it was said to take, took, and the share of cells (scene, preset, error) that the chosen
settings keep on seeds 100 to 119, which no trade has seen; and of those that the trade itself said are kept.
"""

import argparse
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


def belt(n, seed):
    scene = dc.lattice_in_box(n, seed=seed)
    x_min, y_min, x_max, y_max = scene.world.box
    line = ((x_min, 1.0, x_max, 1.0),)
    world = replace(scene.world, box=(x_min, y_min, x_max + 40, y_max + 2), segments=line, surface_speeds=(3.0,))
    return scene.replace(
        world=world, bodies=scene.bodies._replace(position=scene.bodies.position + np.array([0.0, 1.2]))
    )


SCENES = {
    "hopper": lambda n, seed: dc.hopper(n, opening=9.0, steepness=50.0, seed=seed),
    "dam break": lambda n, seed: runs.dam_break(n, aspect=1.5, radius=(0.7, 1.0), seed=seed),
    "drum, e = 0.5, masses 1 : 10": heavy_drum,
    "radii 1 : 10": lambda n, seed: dc.lattice_in_box(n, radius=(0.1, 1.0), seed=seed),
    "terrain": lambda n, seed: dc.terrain(n, bumps=12, seed=seed),
    "silo": lambda n, seed: dc.lattice_in_box(n, columns=5, seed=seed),
    "gas": lambda n, seed: runs.gas(n, gap=0.5, restitution=0.95, seed=seed),
    "belt": belt,
}


def cells_of(measured, make, n):
    """(Preset, error, value on the other seeds, tolerance, value that the trade measured) of what a trade chooses."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        chosen = {preset: measured.chosen(preset) for preset in presets.PRESETS}
    every = max(1, measured.steps // trade.FRAMES)

    def ensemble(setting):
        each = measured.steps // every, every * measured.dt
        scenes = (make(n, seed) for seed in range(100, 120))
        return [run_errors.observe(trade.states_of(scene, setting, *each)) for scene in scenes]

    true = ensemble(measured.reference)
    seen = {row["name"]: row["setting"] for row in chosen.values()}
    seen = {name: run_errors.errors(ensemble(setting), true) for name, setting in seen.items()}
    for preset, row in chosen.items():
        for name, most in presets.PRESETS[preset].items():
            if (value := seen[row["name"]][name]) is not None and row["errors"][name]:
                yield preset, name, value, most, row["errors"][name][0]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--circles", type=int, default=100)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    options = parser.parse_args()
    for name in options.scenes:
        measured = dc.measure_trade(lambda seed, make=SCENES[name]: make(options.circles, seed), steps=options.steps)
        cells = list(cells_of(measured, SCENES[name], options.circles))
        missed = [f"{preset} {error} {value / most:.2f}" for preset, error, value, most, _ in cells if value > most]
        promised = [value <= most for *_, value, most, said in cells if said <= most]
        text = f"{name}: said {measured.predicted_s:.1f} s, took {measured.took_s:.1f} s; kept "
        text += f"{len(cells) - len(missed)} of {len(cells)} cells, {sum(promised)} of {len(promised)} promised"
        print(f"{text}; missed: {', '.join(missed)}", flush=True)


if __name__ == "__main__":
    main()
