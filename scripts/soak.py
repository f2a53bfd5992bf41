"""python scripts/soak.py: long runs of piles with every preset; drift of energy, momentum, memory, and resumed runs.

A unit is one preset on one pile. Each is appended to the file `--out` as one line of JSON once it is done, so a run
that is stopped goes on where it was. The whole takes hours: 1,000,000 steps of 100 circles and 20,000 of 1,000, for
each of five presets.
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
from deep_contact.io.provenance import provenance
from deep_contact.recommendation import PRESETS
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
    """Run a pile in so many parts; what drifts after it has settled, and whether a resumed run ends in the same bits.

    In the middle the state is written to XML and read again, and the run goes on from both. Returns
    {"circles", "steps", "preset", "energy", "momentum", "outside", "memory_mb", "resumed", "seconds"}: rise of the
    energy and largest |Σ m v| / Σ m once settled, as a share of m g r̄ and in m/s; circles outside; growth of memory;
    same bits.
    """
    began = time.perf_counter()
    scene = dc.lattice_in_box(n, radius=(0.8, 1.0), seed=n)
    weight = float(scene.bodies.mass.sum() * np.hypot(*scene.world.gravity) * scene.bodies.radius.mean())
    x_min, y_min, x_max, y_max = scene.world.box
    settle = min(SETTLE, steps // 2)
    state = dc.simulate(scene, steps=settle, accuracy=preset).state
    lowest, rise, momentum, outside = mechanical_energy(scene, state.bodies), 0.0, 0.0, 0
    memory, resumed = megabytes(), None
    each = max(1, (steps - settle) // parts)
    for part in range(parts):
        before, state = state, dc.simulate(state, steps=each, accuracy=preset).state
        if part == parts // 2:
            with tempfile.TemporaryDirectory() as folder:
                dc.write_state(Path(folder) / "middle.xml", before)
                again = dc.read_state(Path(folder) / "middle.xml")
            resumed = fingerprint(dc.simulate(again, steps=each, accuracy=preset).state) == fingerprint(state)
        energy = mechanical_energy(scene, state.bodies)
        rise, lowest = max(rise, (energy - lowest) / weight), min(lowest, energy)
        moved = state.bodies.mass @ state.bodies.velocity / state.bodies.mass.sum()
        momentum = max(momentum, float(np.hypot(*moved)))
        low, high = (state.bodies.position < (x_min, y_min)), (state.bodies.position > (x_max, y_max))
        outside += int((low | high).any(axis=1).sum())
    return {
        "circles": n, "steps": settle + parts * each, "preset": preset, "energy": rise, "momentum": momentum,
        "outside": outside, "memory_mb": megabytes() - memory, "resumed": resumed,
        "seconds": time.perf_counter() - began,
    }  # fmt: skip


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("soak.jsonl"), help="file of the units that are done")
    parser.add_argument("--share", type=float, default=1.0, help="of the steps, for a quick run")
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=list(PRESETS))
    options = parser.parse_args(arguments)
    done = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    known = {(unit["circles"], unit["preset"], unit["share"]) for unit in done}
    for n, steps in PILES.items():
        for preset in options.presets:
            if (n, preset, options.share) in known:
                continue
            unit = soak(n, max(200, int(options.share * steps)), preset)
            unit |= {"share": options.share, "provenance": provenance()}
            with options.out.open("a") as file:
                file.write(json.dumps(unit) + "\n")
            print({name: unit[name] for name in unit if name != "provenance"}, flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
