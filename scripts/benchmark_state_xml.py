"""Time to write a state to XML and to read it back: 100 circles with 170 contacts.

    python scripts/benchmark_state_xml.py [--repeats 200] [--json FILE]

Prints minimum and median over the repeats, for plain and compressed files. The goal is at most 4 ms to write
and 6 ms to read.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from deep_contact.io.state_xml import read_state, write_state
from deep_contact.physics.solvers import PGS
from deep_contact.reporting.results import provenance, replacing
from deep_contact.state import Contacts, State, World, make_bodies
from deep_contact.studies import timing


def example_state(circles: int = 100, contacts: int = 170, seed: int = 0) -> State:
    """Random numbers in all fields, printed with as many digits as those of a simulation. Not a physical state."""
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
    found = Contacts(
        body_a=a,
        body_b=b,
        position=rng.uniform(0, 30, (contacts, 2)),
        normal=np.column_stack([np.cos(direction), np.sin(direction)]),
        separation=rng.normal(size=contacts),
        normal_impulse=rng.exponential(size=contacts),
        tangent_impulse=rng.normal(size=contacts),
        normal_start=rng.exponential(size=contacts),
        tangent_start=rng.normal(size=contacts),
    )
    return State(name="benchmark", world=World(), bodies=bodies, contacts=found, solver=PGS(), solved=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--json", type=Path, metavar="FILE")
    given = parser.parse_args()
    state = example_state()
    found = {"circles": state.bodies.count, "contacts": state.contacts.count, "repeats": given.repeats}
    found["provenance"] = provenance()
    print(f"{state.bodies.count} circles, {state.contacts.count} contacts, {given.repeats} repeats")
    print(f"{'file':8}{'kB':>7}{'write: min':>14}{'median':>10}{'read: min':>14}{'median':>10}   (ms)")
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".xml", ".xml.gz"):
            path = Path(folder) / f"state{suffix}"
            runs = {"write": lambda path=path: write_state(path, state), "read": lambda path=path: read_state(path)}
            seconds = timing.interleaved(runs, repeats=given.repeats, reduce=np.array)
            found[suffix] = {"bytes": path.stat().st_size}
            line = f"{suffix:8}{found[suffix]['bytes'] / 1e3:7.1f}"
            for way, ms in ((way, 1e3 * one) for way, one in seconds.items()):
                found[suffix][way] = {"min_ms": float(ms.min()), "median_ms": float(np.median(ms))}
                line += f"{ms.min():14.2f}{np.median(ms):10.2f}"
            print(line)
    if given.json:
        with replacing(given.json) as temporary:
            temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
