"""python scripts/table_6_1_one_or_two_networks.py: one network for normal and tangent impulses, or one for each.

Goals 7 to 9 of the thesis. Three ways, once for each seed: a compact network for both; one with more convolutional
layers, as large as two; and two, one for each. Every network sees the same states in the same order, in batches of
the same size, with the same learning rates, so two networks cost as much work as the deeper one. The runs are stored in
runs/table_6_1, and a stopped run continues from there.
"""

import hashlib
import json
from pathlib import Path

import numpy as np

from deep_contact.cnn.dataset import Store
from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import chapter_5, verdicts

ONE, DEEPER, EACH = chapter_5.VARIANTS

TITLES = {"normal": "error of λ_n, of ‖λ‖", "tangent": "error of λ_t, of ‖λ‖", "velocity": "velocity error"}


def compute(options, seed, jobs, progress):
    """Train all networks on the generated states, or on new ones where there are none."""
    needed = options["simulations"] + options["held_out"]
    data = states_folder(options, needed, seed, progress)
    settings = options["training"]
    decided = {name: options[name] for name in ("network", "deeper", "training", "simulations")}
    digest = hashlib.sha256(json.dumps([decided, str(data)], sort_keys=True).encode()).hexdigest()[:12]
    found = chapter_5.one_or_two_networks(
        data=str(data),
        out=str(Path(options["runs"]) / digest),
        simulations=options["simulations"],
        held_out=options["held_out"],
        states=options["states"],
        sweeps=options["sweeps"],
        options=options["network"],
        larger=options["network"] | options["deeper"],
        settings=settings,
        seeds=[seed + i for i in range(options["seeds"])],
        jobs=jobs,
        progress=progress,
    )
    budget = settings["epochs"] * settings["states_per_epoch"] // settings["batch_size"]
    return found | {"training steps": budget, "batch size": settings["batch_size"]}


def states_folder(options, needed, seed, progress):
    """The generated data set if it is large enough, else a small one in the folder of the runs."""
    if options["data"] is not None and list(Path(options["data"]).glob("sim_*.h5")):
        if len(Store(options["data"]).simulations) >= needed:
            return Path(options["data"])
    bodies, steps = options["own_bodies"], options["own_steps"]
    folder = Path(options["runs"]) / f"data_{bodies[0]}_{bodies[1]}_{steps}_{seed}"
    return chapter_5.make_states(folder, simulations=needed, steps=steps, bodies=bodies, seed=seed, progress=progress)


def claims(data):
    """Whether the variants are equal within the spread of the seeds. One seed has no spread, so no claims."""
    if len(data["seeds"]) < 2:
        return []
    cases = (
        (DEEPER, EACH, "two networks equal one with more convolutional layers", "section 6.1"),
        (ONE, EACH, "two networks equal one of the size of each", "section 6.1"),
    )
    return [
        Claim(f"{text}, within the spread of the seeds", thesis, *judged(data, first, second))
        for first, second, text, thesis in cases
    ]


def judged(data, first, second):
    """Whether both are equal, the numbers, and the verdict: fewer than ten trainings of each cannot tell."""
    equal, measured = chapter_5.within_spread(data, first, second)
    count = len(data["seeds"])
    if count >= verdicts.FEWEST:
        return equal, measured
    return None, measured, f"open: {count} trainings of each show {'no' if equal else 'a'} difference"


def table(data):
    """A row per variant: mean ± standard deviation over the seeds; and the velocity error after some sweeps."""
    shown = [i for i, sweeps in enumerate(data["sweeps"]) if sweeps]
    rows = [["networks", "parameters", "seeds", *TITLES.values(), *(f"after {data['sweeps'][i]}" for i in shown)]]
    for variant, found in data["variants"].items():
        row = [variant, f"{found['parameters']:,}", len(found["errors"])]
        row += [spread(chapter_5.of_seeds(data, variant, measure)) for measure in TITLES]
        rows.append(row + [spread([errors["velocity"][i] for errors in found["errors"]]) for i in shown])
    return rows


def spread(values):
    """Mean ± standard deviation; of one value, the value."""
    values = np.asarray(values)
    return f"{values.mean():.4f} ± {values.std(ddof=1):.4f}" if values.size > 1 else f"{values.mean():.4f}"


FIGURE = Figure(
    id="T 6.1",
    title="One network for both impulses, or one for each",
    options={
        "data": "data/generated",
        "runs": "runs/table_6_1",
        "simulations": 40,
        "held_out": 10,
        "states": 300,
        "sweeps": [0, 3, 10, 30],
        "network": {"stem": 12, "width": 24, "decoder": 16, "dilations": [1, 2, 4]},
        "deeper": {"dilations": [1, 2, 4, 1, 2, 4, 1, 2]},
        "training": {"epochs": 8, "states_per_epoch": 4800, "batch_size": 32, "rate": 4e-3, "validation_states": 200},
        "seeds": 3,
        "own_bodies": [70, 110],
        "own_steps": 300,
    },
    quick={
        "data": None,
        "simulations": 3,
        "held_out": 1,
        "states": 30,
        "network": {"stem": 4, "width": 8, "decoder": 4, "dilations": [1]},
        "deeper": {"dilations": [1, 2, 1, 2]},
        "training": {"epochs": 1, "states_per_epoch": 64, "batch_size": 16, "rate": 2e-3, "validation_states": 16},
        "seeds": 1,
        "own_bodies": [40, 60],
        "own_steps": 250,
    },
    seed=61,
    compute=compute,
    claims=claims,
    table=table,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
