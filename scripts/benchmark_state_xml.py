"""How long a state takes to be written to XML and read back: 100 circles with 170 contacts.

    python scripts/benchmark_state_xml.py [--repeats 200] [--json FILE]

Prints minimum and median over the repeats, for plain and compressed files. The goal is at most 4 ms to write
and 6 ms to read.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from deep_contact.io.state_xml import read_state, write_state
from deep_contact.physics.solvers import PGS
from deep_contact.state import Contacts, State, World, make_bodies


def example_state(circles: int = 100, contacts: int = 170, seed: int = 0) -> State:
    """Random numbers in all fields, as long in print as those of a simulation. Not a physical state."""
    rng = np.random.default_rng(seed)
    bodies = make_bodies(
        rng.uniform(1, 29, (circles, 2)),
        velocity=rng.normal(size=(circles, 2)),
        angle=rng.normal(size=circles),
        spin=rng.normal(size=circles),
    )
    pairs = rng.choice(circles * (circles - 1) // 2, contacts, replace=False)
    a, b = (index[pairs] for index in np.triu_indices(circles, 1))
    direction = rng.uniform(-np.pi, np.pi, contacts)
    return State(
        name="benchmark",
        world=World(),
        bodies=bodies,
        contacts=Contacts(
            body_a=a,
            body_b=b,
            position=rng.uniform(0, 30, (contacts, 2)),
            normal=np.column_stack([np.cos(direction), np.sin(direction)]),
            separation=rng.normal(size=contacts),
            normal_impulse=rng.exponential(size=contacts),
            tangent_impulse=rng.normal(size=contacts),
            normal_start=rng.exponential(size=contacts),
            tangent_start=rng.normal(size=contacts),
        ),
        solver=PGS(),
        solved=True,
    )


def milliseconds(function, repeats: int) -> dict:
    """Minimum and median time of a call, after one that does not count."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(1e3 * (time.perf_counter() - start))
    return {"min_ms": min(times), "median_ms": statistics.median(times)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    state = example_state()
    results = {"circles": state.bodies.count, "contacts": state.contacts.count, "repeats": options.repeats}
    results["machine"] = platform.processor() or platform.machine()
    print(f"{state.bodies.count} circles, {state.contacts.count} contacts, {options.repeats} repeats")
    print(f"{'file':8}{'kB':>7}{'write: min':>14}{'median':>10}{'read: min':>14}{'median':>10}   (ms)")
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".xml", ".xml.gz"):
            path = Path(folder) / f"state{suffix}"
            write = milliseconds(lambda path=path: write_state(path, state), options.repeats)
            read = milliseconds(lambda path=path: read_state(path), options.repeats)
            size = path.stat().st_size
            results[suffix] = {"bytes": size, "write": write, "read": read}
            times = (write["min_ms"], write["median_ms"], read["min_ms"], read["median_ms"])
            print(f"{suffix:8}{size / 1e3:7.1f}{times[0]:14.2f}{times[1]:10.2f}{times[2]:14.2f}{times[3]:10.2f}")
    if options.json:
        temporary = options.json.with_name(options.json.name + ".tmp")
        temporary.write_text(json.dumps(results, indent=1) + "\n")
        temporary.replace(options.json)


if __name__ == "__main__":
    main()
