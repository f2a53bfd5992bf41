"""Mutation fuzzing of the state files: damaged files of all dialects either read or raise StateFileError.

    python scripts/fuzz_state_xml.py [--inputs 1000000 --seed 0]

Mutations: bytes flipped, inserted, deleted; the end cut off; numbers replaced by odd strings; tokens swapped, also
between files; attributes and elements deleted, doubled or renamed. One input in fifty is a damaged `.xml.gz` on disk.
What still reads is written and read again, and has to come back the same bytes. Any other exception is printed with
its seed and number, and the script fails. Prints the rate; a million inputs take about four minutes on one core.
"""

from __future__ import annotations

import argparse
import gzip
import random
import re
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

from deep_contact.physics.methods import PGS
from deep_contact.state import Contacts, State, World, make_bodies
from deep_contact.state_xml import StateFileError, format_state, parse_state, read_state

OLD_FILES = Path(__file__).resolve().parent.parent / "tests" / "data"
ODD = (
    *("", " ", "nan", "NaN", "inf", "-inf", "1e309", "-1e309", "1e-400", "-0.0", "0", "-1", "1_0", "0x10", "٣", "1,5"),
    *("9" * 19, "9" * 5000, "10737418240", "1e10", "1.", ".", "-", "+", "e", "1e", "--1", "1e+-5", "true", "none"),
    *("&lt;", "&#0;", "&#9;", "&amp;", "&x;", "\x00", "\ud7ff", "b2Vec2(0,1)", "b2Vec2(,)", "b2Vec2(1e999,0)"),
    *("circle", "box", "ground", "dcCircleShape(radius=-1)", "dcCircleShape(radius=)", "b2CircleShape(radius=1,)"),
    *("dcLoopShape(vertices=[])", "dcLoopShape(vertices=[(0,0)])", "dcLoopShape(vertices=[(0,0),(1,0),(1,1),(0,1)])"),
    *("__import__('os')", "(" * 500, "PGS", "fixed", "free", "../../x", "2147483648", "-9223372036854775809"),
)
_ATTRIBUTE = re.compile(rb'\s[\w]+="[^"]*"')
_VALUE = re.compile(rb'(?<==")[^"]*(?=")')
_ELEMENT = re.compile(rb"<(\w+)[^<>]*/>|<(body|contact|shape|bodies|contacts)\b.*?</\2>", re.DOTALL)
_NAME = re.compile(rb'(?<=[<\s/])[A-Za-z_]+(?=[\s=>/"])')


def seed_files() -> list[bytes]:
    """Valid files: both old dialects, and the canonical form with and without contacts."""
    state = State(
        name="fuzz <&>",
        world=World(box=(-0.0, 0.0, 8.0, 8.0)),
        bodies=make_bodies([[0.995, 1.0], [2.9, 1.0], [5.0, 7.0]], velocity=[0.1, -5e-324], spin=-0.0),
        contacts=Contacts(
            body_a=np.array([0, 0, 0]),
            body_b=np.array([1, 3, 6]),
            position=np.array([[1.95, 1.0], [1.0, 0.0], [0.0, 1.0]]),
            normal=np.array([[1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]]),
            separation=np.array([-0.095, -0.01, -0.015]),
            normal_impulse=np.array([1.0, 0.25, 1e-3]),
            tangent_impulse=np.array([0.0, -0.125, 1e-300]),
            normal_start=np.array([0.5, 0.0, 0.0]),
            tangent_start=np.array([0.0, 0.0, -1.0]),
        ),
        solver=PGS(tolerance=None),
        solved=True,
    )
    old = [path.read_bytes() for path in sorted(OLD_FILES.glob("*.xml"))]
    return [format_state(state), format_state(state.replace(contacts=None, solver=None)), *old]


def _spot(rng: random.Random, pattern, data: bytes):
    """A random match, found from a random place on, so that long files cost no more than short ones."""
    match = pattern.search(data, rng.randrange(len(data) + 1))
    return match or pattern.search(data)


def mutate(rng: random.Random, data: bytes, files: list[bytes]) -> bytes:
    """One random damage."""
    kind = rng.randrange(10)
    at = rng.randrange(len(data) + 1)
    if kind == 0:
        return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
    if kind == 1:
        return data[:at] + rng.randbytes(rng.randrange(1, 4)) + data[at:]
    if kind == 2:
        return data[:at] + data[at + rng.randrange(1, 20) :]
    if kind == 3:
        return data[:at] if rng.random() < 0.3 else data
    pattern = {4: _VALUE, 5: _VALUE, 6: _ATTRIBUTE, 7: _ELEMENT, 8: _ELEMENT, 9: _NAME}[kind]
    match = _spot(rng, pattern, data)
    if match is None:
        return data
    start, end = match.span()
    if kind == 4:
        return data[:start] + rng.choice(ODD).encode("utf-8", "replace") + data[end:]
    if kind == 6 or (kind == 7 and rng.random() < 0.5):
        return data[:start] + data[end:]
    if kind == 7:
        return data[:end] + match[0] + data[end:]
    other = _spot(rng, pattern, rng.choice((data, *files)))
    return data[:start] + (other[0] if other else b"") + data[end:]


def run(inputs: int, seed: int, folder: Path) -> tuple[Counter, list[str]]:
    """Counts of the outcomes, and the tracebacks of what should not have happened."""
    rng = random.Random(seed)
    files = seed_files()
    outcomes, faults = Counter(), []
    for number in range(inputs):
        data = rng.choice(files)
        for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
            data = mutate(rng, data, files)
        try:
            if number % 50 == 0:
                path = folder / "fuzz.xml.gz"
                packed = gzip.compress(data, 1)
                path.write_bytes(mutate(rng, packed, files) if rng.random() < 0.5 else packed)
                state = read_state(path)
            else:
                state = parse_state(data, "fuzz.xml")
            again = format_state(state)
            if format_state(parse_state(again, "again.xml")) != again:
                raise AssertionError("what was read does not come back the same")
            outcomes["read"] += 1
        except StateFileError as error:
            outcomes["refused"] += 1
            if "fuzz.xml" not in str(error) or len(str(error)) > 1000:
                faults.append(f"input {number} of seed {seed}: a message without file, or endless: {error}")
        except Exception:  # whatever else comes out is what is looked for
            outcomes["fault"] += 1
            faults.append(f"input {number} of seed {seed}:\n{traceback.format_exc()}")
    return outcomes, faults


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        outcomes, faults = run(options.inputs, options.seed, Path(folder))
    seconds = time.perf_counter() - start
    print(f"{options.inputs} inputs in {seconds:.1f} s, {options.inputs / seconds:.0f} a second: {dict(outcomes)}")
    for fault in faults[:20]:
        print(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
