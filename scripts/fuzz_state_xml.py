"""Mutation fuzzing of the state files: damaged files of all dialects either read or raise StateFileError.

    python scripts/fuzz_state_xml.py [--inputs 1000000 --seed 0] [--out data/reference/fuzz_state_xml.json]

Mutations: bytes flipped, inserted, deleted; the end cut off; numbers replaced by odd strings; tokens swapped, also
between files; attributes and elements deleted, doubled or renamed. One input in fifty is a damaged `.xml.gz` on disk.
What still reads is written and read again, and has to come back the same bytes. Any other exception is printed with
its seed and number, and the script fails.

It fails as well where the process needs more than 1 GB, where one input takes longer than ten seconds, and where
anything else is opened or connected to than the file that is given: Python's own audit events are looked at, and for
what a library does below Python, one input in thirty holds baits (entities, document types, inclusions, schemas) that
point to a file whose openings Linux reports (inotify), and to a port where nobody may knock.
Prints the rate; a million inputs take about four minutes on one core. --out keeps the results.
"""

from __future__ import annotations

import argparse
import ctypes
import gzip
import json
import os
import random
import re
import signal
import socket
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

from deep_contact.io.state_xml import StateFileError, format_state, parse_state, read_state
from deep_contact.physics.solvers import PGS
from deep_contact.reporting import results
from deep_contact.state import Contacts, State, World, make_bodies

MEMORY = 1 << 30
"""Bytes that the process may need."""

SECONDS = 10
"""That one input may take."""

AUDITED = {"open", "socket", "subprocess", "os", "urllib", "ctypes"}
"""First words of Python's audit events that reading an input may not raise, but for opening the input itself."""

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


class Watch:
    """What is opened, connected to or started while an input is read, and the baits that are laid out for it."""

    def __init__(self, folder: Path):
        self.given, self.looking, self.events = None, False, Counter()
        self.bait = folder / "bait.txt"
        self.bait.write_text("7.25")
        self.port = socket.create_server(("127.0.0.1", 0))
        self.port.setblocking(False)
        self.url = f"http://127.0.0.1:{self.port.getsockname()[1]}/bait"
        self.openings = _openings_of(self.bait)
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple) -> None:
        if not self.looking or event.partition(".")[0] not in AUDITED:
            return
        if not (event == "open" and self.given is not None and str(arguments[0]) == str(self.given)):
            self.events[event] += 1

    def caught(self) -> dict[str, int]:
        """Event -> how often, of what should not have happened."""
        found = Counter(self.events)
        try:
            self.port.accept()[0].close()
            found["connection to the bait"] += 1
        except BlockingIOError:
            pass
        if self.openings is not None:
            try:
                os.read(self.openings, 1 << 16)
                found["opening of the bait"] += 1
            except BlockingIOError:
                pass
        return dict(found)

    def lure(self, rng: random.Random, data: bytes) -> bytes:
        """The input with one of the ways in which XML can point elsewhere, at the file or at the port."""
        target = rng.choice((self.bait.as_uri(), str(self.bait), self.url))
        head, body = data[: data.find(b"?>") + 2], data[data.find(b"?>") + 2 :]
        declared = {
            0: f'<!DOCTYPE configuration SYSTEM "{target}">',
            1: f'<!DOCTYPE configuration [<!ENTITY x SYSTEM "{target}">]>',
            2: f'<!DOCTYPE configuration [<!ENTITY % x SYSTEM "{target}"> %x;]>',
            3: f'<?xml-stylesheet type="text/xsl" href="{target}"?>',
        }
        inside = {
            1: b"&x;",
            4: f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" parse="text" href="{target}"/>'.encode(),
        }
        kind = rng.randrange(6)
        if kind == 5:
            schema = f' xmlns:i="http://www.w3.org/2001/XMLSchema-instance" i:noNamespaceSchemaLocation="{target}"'
            return head + body.replace(b"<configuration", b"<configuration" + schema.encode(), 1)
        if kind in inside:
            places = [match.end() for match in re.finditer(rb'>|="', body)] or [0]
            at = rng.choice(places)
            body = body[:at] + inside[kind] + body[at:]
        return head + declared.get(kind, "").encode() + body


def _openings_of(path: Path) -> int | None:
    """A file descriptor that has something to read once the file has been opened; None where there is no inotify."""
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None, use_errno=True)
    descriptor = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    opened = 0x20
    if descriptor < 0 or libc.inotify_add_watch(descriptor, os.fsencode(path), opened) < 0:
        raise OSError(ctypes.get_errno(), "inotify")
    return descriptor


def limit() -> None:
    """Let this process have no more than `MEMORY`, and be told after `SECONDS`, where the system can."""
    try:
        import resource
    except ImportError:
        return

    def too_long(number, frame):
        raise TimeoutError(f"expected an input to be read within {SECONDS} s")

    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    signal.signal(signal.SIGALRM, too_long)


def peak_memory() -> int | None:
    """The most memory that this process has held, bytes; None where the system does not tell."""
    try:
        # Of Linux's two numbers the other one begins with what the process that started this one had held.
        status = Path("/proc/self/status").read_text(encoding="ascii")
        return 1024 * int(re.search(r"VmHWM:\s*(\d+) kB", status)[1])
    except (OSError, TypeError):
        pass
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def read(data: bytes, path: Path | None, watch: Watch) -> State:
    """The state in an input: a file where a path is given; watched, and for so many seconds only."""
    watch.given, watch.looking = path, True
    if hasattr(signal, "alarm"):
        signal.alarm(SECONDS)
    try:
        return parse_state(data, "fuzz.xml") if path is None else read_state(path)
    finally:
        watch.looking = False
        if hasattr(signal, "alarm"):
            signal.alarm(0)


def run(inputs: int, seed: int, folder: Path) -> dict:
    """Outcomes, the tracebacks of what should not have happened, what was caught, and the slowest input, s."""
    rng = random.Random(seed)
    files, watch = seed_files(), Watch(folder)
    outcomes, faults, slowest, path = Counter(), [], 0.0, folder / "fuzz.xml.gz"
    for number in range(inputs):
        data = rng.choice(files)
        for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
            data = mutate(rng, data, files)
        if number % 30 == 0:
            data = watch.lure(rng, data)
        if number % 50 == 0:
            packed = gzip.compress(data, 1)
            path.write_bytes(mutate(rng, packed, files) if rng.random() < 0.5 else packed)
        begin = time.perf_counter()
        try:
            state = read(data, path if number % 50 == 0 else None, watch)
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
        slowest = max(slowest, time.perf_counter() - begin)
    caught = watch.caught()
    if caught:
        faults.append(f"seed {seed}: expected no access to anything but the input, got {caught}")
    return {"outcomes": dict(outcomes), "faults": faults, "accesses": caught, "slowest_s": slowest}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="results file to write")
    options = parser.parse_args()
    limit()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        found = run(options.inputs, options.seed, Path(folder))
    seconds, memory = time.perf_counter() - start, peak_memory()
    if memory is not None and memory > MEMORY:
        found["faults"].append(f"expected at most {MEMORY} bytes of memory, got {memory}")
    print(f"{options.inputs} inputs in {seconds:.1f} s, {options.inputs / seconds:.0f} a second: {found['outcomes']}, "
          f"slowest {1e3 * found['slowest_s']:.1f} ms, at most {(memory or 0) / 1e6:.0f} MB")  # fmt: skip
    for fault in found["faults"][:20]:
        print(fault)
    if options.out:
        record = {"inputs": options.inputs, **found, "peak_memory_bytes": memory,
                  "provenance": results.provenance(seed=options.seed, wall_s=seconds)}  # fmt: skip
        with results.replacing(options.out) as temporary:
            temporary.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return 1 if found["faults"] else 0


if __name__ == "__main__":
    sys.exit(main())
