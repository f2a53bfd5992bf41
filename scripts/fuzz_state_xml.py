"""Coverage-guided fuzzing of the state files: a damaged file either reads or raises StateFileError.

    python scripts/fuzz_state_xml.py [--inputs 1000000] [--seed 0] [--out data/reference/fuzz_state_xml.json]

Atheris (libFuzzer) damages files of all dialects, and files with baits: entities, document types, inclusions and
schemas that point to a file and to a port of this machine. One input in fifty is read as `.xml.gz` from the disk. What
still reads is written and read again, and has to come back the same bytes. The script fails on any other exception,
above 1 GB of memory, if one input takes longer than 10 s, and if anything but the input is opened or connected to,
by Python (audit events) or below it (Linux reports openings of the bait by inotify, and the port listens).
A million inputs take about five minutes. The input that fails is kept as `crash-…` in the working directory.
"""

import argparse
import ctypes
import gzip
import json
import os
import random
import re
import resource
import select
import socket
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["deep_contact.io.state_xml"]):
    from deep_contact.io.state_xml import StateFileError, format_state, parse_state, read_state
from deep_contact.physics.solvers import PGS
from deep_contact.reporting import results
from deep_contact.scales import BOX2D
from deep_contact.state import State

OLD_FILES = Path(__file__).resolve().parent.parent / "tests" / "io" / "data"
AUDITED = {"open", "socket", "subprocess", "os", "urllib", "ctypes"}
"""First words of the audit events that reading an input may not raise, except for opening the input itself."""
ODD = (
    *("nan", "-inf", "1e309", "1e-400", "-0.0", "1_0", "0x10", "٣", "1,5", "9" * 19, "9" * 5000, "10737418240", "-1"),
    *("&lt;", "&#0;", "&x;", "b2Vec2(0,1)", "b2Vec2(1e999,0)", "circle", "box", "ground", "fixed", "free", "(" * 500),
    *("dcCircleShape(radius=-1)", "b2CircleShape(radius=1,)", "dcLoopShape(vertices=[(0,0)])", "__import__('os')"),
)
ATTRIBUTE, VALUE, NAME = rb'\s\w+="[^"]*"', rb'(?<==")[^"]*(?=")', rb'(?<=[<\s/])[A-Za-z_]+(?=[\s=>/"])'
ELEMENT = rb"(?s)<(\w+)[^<>]*/>|<(body|contact|shape|bodies|contacts)\b.*?</\2>"
SCHEMA = ' xmlns:i="http://www.w3.org/2001/XMLSchema-instance" i:noNamespaceSchemaLocation="{0}"'
BAITS = (  # what is put before the root, into its tag, and into it
    ('<!DOCTYPE configuration SYSTEM "{0}">', "", ""),
    ('<!DOCTYPE configuration [<!ENTITY x SYSTEM "{0}">]>', "", "&x;"),
    ('<!DOCTYPE configuration [<!ENTITY % x SYSTEM "{0}"> %x;]>', "", ""),
    ('<?xml-stylesheet type="text/xsl" href="{0}"?>', "", ""),
    ("", "", '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" parse="text" href="{0}"/>'),
    ("", SCHEMA, ""),
)


def seed_files() -> list[bytes]:
    """Valid files: the canonical form with and without contacts, and both old dialects."""
    old = [path.read_bytes() for path in sorted(OLD_FILES.glob("*.xml"))]
    state = parse_state(old[0], "7.xml").replace(name="fuzz <&>", solver=PGS(tolerance=None), solved=True)
    absolute = replace(state.world, scales=BOX2D)
    return [format_state(state.replace(world=absolute)), format_state(state.replace(contacts=None, solver=None)), *old]


def damage(data: bytes, size: int, seed: int) -> bytes:
    """Change, drop or double an attribute, its value, an element or a name; or else any bytes, as libFuzzer does."""
    rng = random.Random(seed)
    spans = [match.span() for match in re.finditer(rng.choice((ATTRIBUTE, VALUE, ELEMENT, NAME)), data)]
    if not spans or rng.random() < 0.2:
        return atheris.Mutate(data, size)
    start, end = rng.choice(spans)
    part = data[start:end]
    new = rng.choice((b"", 2 * part, rng.choice(ODD).encode(), atheris.Mutate(part, len(part) + 8)))
    return (data[:start] + new + data[end:])[:size]


class Watch:
    """What is opened, connected to or started while an input is read, and the baits."""

    def __init__(self, folder: Path):
        self.given, self.looking, self.events = None, False, Counter()
        self.bait = folder / "bait.txt"
        self.bait.write_text("7.25")
        self.port = socket.create_server(("127.0.0.1", 0))
        libc, opened = ctypes.CDLL(None), 0x20
        self.openings = libc.inotify_init1(os.O_CLOEXEC)
        libc.inotify_add_watch(self.openings, os.fsencode(self.bait), opened)
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple) -> None:
        given = event == "open" and str(arguments[0]) == str(self.given)
        if self.looking and not given and event.partition(".")[0] in AUDITED:
            self.events[event] += 1

    def caught(self) -> dict[str, int]:
        """Event -> how often, of what should not have happened."""
        for name, descriptor in (("connection to", self.port.fileno()), ("opening of", self.openings)):
            if select.select([descriptor], [], [], 0)[0]:
                self.events[f"{name} the bait"] += 1
        return dict(self.events)

    def baited(self, data: bytes) -> list[bytes]:
        """The file with each way in which XML can point elsewhere, to the bait and to the port."""
        urls = self.bait.as_uri(), str(self.bait), f"http://127.0.0.1:{self.port.getsockname()[1]}/bait"
        texts = [f"{before}<configuration{within}\\1>{inside}" for before, within, inside in BAITS]
        pattern = "<configuration([^>]*)>"
        return [re.sub(pattern, text.format(url), data.decode(), count=1).encode() for text in texts for url in urls]

    def read(self, data: bytes, path: Path | None = None) -> State:
        """The state in an input, or in a file where a path is given."""
        self.given, self.looking = path, True
        try:
            return parse_state(data, "fuzz.xml") if path is None else read_state(path)
        finally:
            self.looking = False


def fuzz(inputs: int, seed: int, folder: Path) -> None:
    """Try the inputs. libFuzzer ends the process after the last; what came out is then in outcomes.json."""
    watch, outcomes, path = Watch(folder), Counter(slowest_s=0.0), folder / "fuzz.xml.gz"
    (folder / "corpus").mkdir()
    for number, data in enumerate([*seed_files(), *watch.baited(seed_files()[0])]):
        (folder / "corpus" / str(number)).write_bytes(data)

    def try_input(data: bytes) -> None:
        number = outcomes["read"] + outcomes["refused"] + 1
        if number % 50 == 0:
            packed = gzip.compress(data, 1)
            path.write_bytes(packed if number % 100 else packed[: len(packed) * number // inputs])
        begin = time.perf_counter()
        try:
            again = format_state(watch.read(data, path if number % 50 == 0 else None))
            assert format_state(parse_state(again, "again.xml")) == again, "a state does not come back the same"
            outcomes["read"] += 1
        except StateFileError as error:
            outcomes["refused"] += 1
            if not re.fullmatch("(?s)(?=.*fuzz.xml).{,1000}", str(error)):
                raise AssertionError("expected a message of at most 1000 characters that names the file") from error
        outcomes["slowest_s"] = max(outcomes["slowest_s"], time.perf_counter() - begin)
        if watch.events or number == inputs or number % 1000 == 0:
            assert not watch.caught(), f"expected no access to anything but the input, got {watch.caught()}"
        if number == inputs:
            outcomes["peak_memory_kB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            (folder / "outcomes.json").write_text(json.dumps(outcomes))

    limits = [f"-runs={inputs}", "-rss_limit_mb=1024", "-timeout=10", "-len_control=0", "-mutate_depth=2"]
    atheris.Setup(["fuzz", *limits, f"-seed={seed}", str(folder / "corpus")], try_input, custom_mutator=damage)
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="results file to write")
    given, begin = parser.parse_args(), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        child = os.fork()
        if child == 0:
            fuzz(given.inputs, given.seed + 1, Path(folder))  # libFuzzer takes 0 for any seed
        if os.waitpid(child, 0)[1]:
            return 1
        outcomes = json.loads((Path(folder) / "outcomes.json").read_text())
    seconds = time.perf_counter() - begin
    print(f"{given.inputs} inputs in {seconds:.1f} s: {outcomes}")
    if given.out:
        provenance = results.provenance(seed=given.seed, wall_s=seconds)
        record = {"inputs": given.inputs, **outcomes, "faults": [], "provenance": provenance}
        with results.replacing(given.out) as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
