"""python scripts/table_6_1_one_or_two_networks.py: one network for normal and tangent impulses, or one for each.

Goals 7 to 9 of the thesis. Three ways, once for each seed: a narrow network of the thesis's kind for both; one with
more convolutional layers, as large as two; and two, one for each. Every network sees the same states in the same order,
in batches of the same size, with the same learning rates. The states and the runs are stored in runs/table_6_1, and a
stopped run continues from there.
"""

from pathlib import Path

import numpy as np

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import chapter_5, verdicts
from deep_contact.studies.parts import digest_of

ONE, DEEPER, EACH = chapter_5.VARIANTS

TITLES = {"normal": "error of λ_n, of ‖λ‖", "tangent": "error of λ_t, of ‖λ‖", "velocity": "velocity error"}


def compute(options, seed, jobs, progress):
    """Make states, and train all networks on them."""
    made = {name: options[name] for name in ("simulations", "steps", "bodies")}
    used = {name: options[name] for name in ("stacks", "deeper", "settings", "held_out")}
    folder = Path(options["runs"]) / digest_of(made | used | {"seed": seed})
    data = chapter_5.make_states(folder / "data", **made, seed=seed, progress=progress)
    seeds = [seed + i for i in range(options["seeds"])]
    return chapter_5.one_or_two_networks(data, folder, options, seeds=seeds, jobs=jobs, progress=progress)


def claims(data):
    """Whether the variants are equal within the spread of the seeds; fewer than ten trainings of each cannot tell.

    One seed has no spread, so no claims.
    """
    count = len(data["seeds"])
    for first, what in ((DEEPER, "one with more convolutional layers"), (ONE, "one of the size of each")):
        if count > 1:
            equal, measured = chapter_5.within_spread(data, first, EACH)
            text = f"two networks equal {what}, within the spread of the seeds"
            verdict = f"open: {count} trainings of each show {'no' if equal else 'a'} difference"
            decided = count >= verdicts.FEWEST
            yield Claim(text, "section 6.1", equal if decided else None, measured, None if decided else verdict)


def table(data):
    """Mean ± standard deviation over the seeds; and the velocity error after some sweeps."""
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


OPTIONS = {
    "runs": "runs/table_6_1", "simulations": 16, "steps": 300, "bodies": [70, 110], "held_out": 4, "states": 200,
    "sweeps": [0, 3, 10, 30], "stacks": [[8, [3, 3]], [16, [3, 3, 2]], [32, [2, 2]]],
    "deeper": [[8, [3, 3, 3, 3]], [16, [3, 3, 2, 3, 3, 2]], [32, [2, 2, 2, 2]]],
    "settings": {**{"spacing": 1.0, "support": 1.0, "optimizer": "adam", "schedule": "cosine", "rate": 2e-3},
        **{"epochs": 4, "batch_size": 32, "states_per_epoch": 1600, "validation_states": 200}}, "seeds": 3,
}  # fmt: skip
QUICK = {
    "simulations": 5, "steps": 150, "bodies": [40, 60], "held_out": 1, "states": 30, "stacks": [[4, [3]], [4, [2]]],
    "deeper": [[4, [3, 3]], [4, [2, 2]]],
    "settings": {"epochs": 1, "states_per_epoch": 64, "batch_size": 16, "validation_states": 16}, "seeds": 1,
}  # fmt: skip
FIGURE = Figure("T 6.1", "One network for both impulses, or one for each", compute, table, claims=claims,
                options=OPTIONS, quick=QUICK, seed=61)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
