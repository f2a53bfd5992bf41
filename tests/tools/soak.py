"""python tests/tools/soak.py: long runs of piles with every preset; drift of energy and momentum, memory, resumed runs.

    python tests/tools/soak.py [--share 1.0] [--presets fast …] [--out data/reference/soak.json]

A unit is one preset on one pile: 1,000,000 steps of 100 circles or 20,000 of 1,000, twice. The file is written after
each, so a run that is stopped goes on where it was.
"""

import argparse
import hashlib
import json
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact.io.files import write_json
from deep_contact.presets import PRESETS, decide
from deep_contact.reporting import results
from deep_contact.studies.extremes import mechanical_energy

PILES = {100: 1_000_000, 1000: 20_000}
"""Circles -> steps."""

SETTLE = 2000
"""Steps after which a pile lies; drift is counted from there."""


def fingerprint(state):
    """SHA-256 of all that a run has computed."""
    return hashlib.sha256(
        b"".join(np.ascontiguousarray(array).tobytes() for array in (*state.bodies, *state.contacts))
    ).hexdigest()


def megabytes():
    """Largest memory that this process has had, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def soak(n, steps, preset, parts=20):
    """Run a pile twice: what drifts after it has settled, and whether both runs end in the same bits.

    The first run is divided into so many parts, after each of which it is looked at. The second is divided once, in the
    middle, where its state is written to XML and read again. Returns {"circles", "steps", "preset", "energy",
    "momentum", "outside", "memory_mb", "same", "sha256", "seconds"}: rise of the energy and largest |Σ m v| / Σ m once
    settled, as a share of m g r̄ and in m/s; circles outside; growth of memory once settled; whether the runs are equal,
    and their fingerprint.
    """
    began = time.perf_counter()
    scene = dc.lattice_in_box(n, radius=(0.8, 1.0), seed=n)
    # A preset looks at the state that it begins with, so both runs take what it picks for the first.
    solver, start, *_ = decide(scene, preset)
    options = {"solver": solver, "warm_start": start}
    weight = float(scene.bodies.mass.sum() * np.hypot(*scene.world.gravity) * scene.bodies.radius.mean())
    x_min, y_min, x_max, y_max = scene.world.box
    settle = min(SETTLE, steps // 2)
    each = max(1, (steps - settle) // parts)
    steps = settle + parts * each
    state = dc.simulate(scene, steps=settle, **options).state
    lowest, rise, momentum, outside = mechanical_energy(scene, state.bodies), 0.0, 0.0, 0
    memory = megabytes()
    for _ in range(parts):
        state = dc.simulate(state, steps=each, **options).state
        energy = mechanical_energy(scene, state.bodies)
        rise, lowest = max(rise, (energy - lowest) / weight), min(lowest, energy)
        moved = state.bodies.mass @ state.bodies.velocity / state.bodies.mass.sum()
        momentum = max(momentum, float(np.hypot(*moved)))
        low, high = (state.bodies.position < (x_min, y_min)), (state.bodies.position > (x_max, y_max))
        outside += int((low | high).any(axis=1).sum())
    memory = megabytes() - memory
    with tempfile.TemporaryDirectory() as folder:
        middle = Path(folder) / "middle.xml"
        dc.write_state(middle, dc.simulate(scene, steps=steps // 2, **options).state)
        again = dc.simulate(dc.read_state(middle), steps=steps - steps // 2, **options).state
    return {
        "circles": n, "steps": steps, "preset": preset, "energy": rise, "momentum": momentum, "outside": outside,
        "memory_mb": memory, "same": fingerprint(again) == fingerprint(state), "sha256": fingerprint(state),
        "seconds": time.perf_counter() - began,
    }  # fmt: skip


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("soak.json"), help="results file, of which what is done stays")
    parser.add_argument("--share", type=float, default=1.0, help="of the steps, for a quick run")
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=list(PRESETS))
    options = parser.parse_args(arguments)
    record = json.loads(options.out.read_text()) if options.out.exists() else {"units": []}
    known = {(unit["circles"], unit["preset"], unit["share"]) for unit in record["units"]}
    for n, steps in PILES.items():
        for preset in options.presets:
            if (n, preset, options.share) in known:
                continue
            unit = soak(n, max(200, int(options.share * steps)), preset) | {"share": options.share}
            record["units"].append(unit)
            record["provenance"] = results.provenance(seed=n, wall_s=sum(unit["seconds"] for unit in record["units"]))
            write_json(options.out, record)
            print(unit, flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
