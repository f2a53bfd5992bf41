"""Fuzzing: hostile input either works or raises the error that the documentation names; nothing else.

    python tests/tools/fuzz.py xml|hdf5|models|api [--inputs 20000] [--seed 0] [--out FILE]

* xml: Atheris (libFuzzer) damages state files of all dialects, guided by coverage, and files with baits: entities,
  document types, inclusions and schemas that point to a file and to a port of this machine. One input in fifty is read
  as `.xml.gz` from the disk. What still reads is written and read again, and has to come back the same bytes. Nothing
  but the input may be opened or connected to, by Python (audit events) or below it (inotify, and the port listens).
* hdf5, models: bytes of simulations and of a network's file change, or are cut off, doubled and exchanged; in one file
  in three a part of a simulation is of another shape, type, size or link, with a digest that fits.
* api: functions of the public interface get arrays and numbers of the wrong type, shape, sign, order or size.

The script fails on any other exception, above 1 GB of memory, or if an input takes a minute of processor time (xml:
10 s by the clock). (5 GB for models: a damaged text of variable length may claim 4 GB, which the HDF5 library clears
before it looks.) The input that fails is kept as `crash-…` in the working directory.
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
import signal
import socket
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path

if sys.argv[1:2] == ["xml"]:
    import atheris  # which only this target needs, and whose instruments no compiled function takes

    with atheris.instrument_imports(include=["deep_contact.io.state_xml", "deep_contact.io.old_dialects"]):
        import deep_contact.io.state_xml
import h5py
import numpy as np

import deep_contact as dc
from deep_contact.io import simulation_h5
from deep_contact.io.files import write_json
from deep_contact.io.state_xml import StateFileError, format_state, parse_state, read_state
from deep_contact.physics.solvers import METHODS, PGS
from deep_contact.reporting import results
from deep_contact.state import State, World
from deep_contact.state.scales import BOX2D

OLD_FILES = Path(__file__).resolve().parents[1] / "io" / "data"
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


def fuzz_xml(inputs: int, seed: int, folder: Path) -> None:
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
        is_last = number == inputs
        if watch.events or is_last or number % 1000 == 0:
            assert not watch.caught(), f"expected no access to anything but the input, got {watch.caught()}"
        if is_last:
            write_outcomes(folder, outcomes)
            os._exit(0)

    limits = [f"-runs={inputs}", "-rss_limit_mb=1024", "-timeout=10", "-len_control=0", "-mutate_depth=2"]
    atheris.Setup(["fuzz", *limits, f"-seed={seed}", str(folder / "corpus")], try_input, custom_mutator=damage)
    atheris.Fuzz()


def write_outcomes(folder: Path, outcomes: Counter) -> None:
    """What came of the inputs, for the parent."""
    outcomes["peak_memory_kB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    (folder / "outcomes.json").write_text(json.dumps(outcomes))


def fuzz_calls(inputs: int, seed: int, folder: Path, make, errors: tuple, megabytes: int) -> None:
    """Try so many calls of `make(rng)`, a text and a function without arguments, in this process.

    Each has to return or raise one of the errors, with a message of at most 2000 characters.
    """
    outcomes, given = Counter(read=0, refused=0, slowest_s=0.0), folder / "input"
    for number in range(inputs):
        rng = np.random.default_rng((seed, number))
        what, call = make(rng)
        given.write_text(f"input {number} of seed {seed}: {what}")
        # Of processor time, since others may have the machine; an input that waits for ever ends, too.
        signal.setitimer(signal.ITIMER_PROF, 60)
        signal.alarm(1800)
        begin = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                call()
            outcomes["read"] += 1
        except errors as error:
            outcomes["refused"] += 1
            if not 0 < len(str(error)) <= 2000:
                raise AssertionError("expected a message of 1 to 2000 characters") from error
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        outcomes["slowest_s"] = max(outcomes["slowest_s"], time.process_time() - begin)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        assert peak < 1024 * megabytes, f"expected at most {megabytes} MB, got {peak // 1024}"
    write_outcomes(folder, outcomes)


def damaged(data: bytes, rng) -> bytes:
    """The bytes with one to four places changed, cut off, doubled or exchanged."""
    found = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        # Half of the damage where the structure of an HDF5 file usually begins.
        at = int(rng.integers(0, max(1, len(found) if rng.random() < 0.5 else min(len(found), 4096))))
        kind, size = rng.integers(0, 6), int(rng.integers(1, 9))
        if kind == 0:
            found[at : at + 1] = bytes([found[at] ^ (1 << int(rng.integers(0, 8)))]) if at < len(found) else b""
        elif kind == 1:
            found[at : at + size] = rng.bytes(size)
        elif kind == 2:
            found[at : at + size] = (b"\xff" if rng.random() < 0.5 else b"\0") * size
        elif kind == 3:
            del found[at:]
        elif kind == 4:
            other = int(rng.integers(0, len(found) + 1))
            found[at : at + size] = found[other : other + size]
        else:
            found[at:at] = found[at : at + 64]
    return bytes(found)


def hostile(rng, like=None):
    """A value that nobody should hand over; often an array like another, with a fault."""
    odd = (None, "x", b"x", True, -1, 0, 2**63, 1e400, -1e300, float("nan"), 1j, [], {}, (), object(), [[1], [1, 2]])
    if like is None or rng.random() < 0.2:
        return odd[rng.integers(0, len(odd))]
    try:
        array = np.array(like)
    except ValueError:  # it is hostile already
        return like
    if array.size and rng.random() < 0.5 and array.dtype.kind in "if":
        values = (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e308, 1e-320, 1e13, -1e13, 7.0)
        if array.dtype.kind == "i":
            values = (-1, 0, 1, 2, 4, 7, 2**31, 2**62, -(2**63))
        array.flat[rng.integers(0, array.size)] = values[rng.integers(0, len(values))]
        return array
    faults = (
        lambda: array[::-1], lambda: array[:-1], lambda: array[:0], lambda: np.repeat(array, 2, axis=0)[::2],
        lambda: array.T, lambda: array.astype(array.dtype.newbyteorder()), lambda: array.astype(np.float32),
        lambda: array.astype(complex), lambda: array.astype(object), lambda: array.astype(str), lambda: array.tolist(),
        lambda: array[..., None], lambda: array.astype(np.uint8), lambda: array.astype(bool), lambda: array.reshape(-1),
        lambda: np.broadcast_to(array[:1], array.shape), lambda: np.ma.masked_array(array, array == array.max()),
        lambda: array.astype("M8[s]"), lambda: np.matrix(array), lambda: np.asfortranarray(array),
        lambda: np.concatenate([array, array]), lambda: array.astype(np.longdouble), lambda: np.zeros((0, 0, 0)),
    )  # fmt: skip
    try:
        return faults[rng.integers(0, len(faults))]()
    except (ValueError, TypeError, IndexError):
        return array


def small_state() -> State:
    """A state that all the calls of `api_call` take: four circles with contacts."""
    return dc.simulate(dc.column(4), steps=4, solver=PGS(sweeps=5)).state


def damaged_state(rng, whole: State) -> tuple[str, State]:
    """A state with one or two fields of any of its parts hostile; what they are. Building it may raise ValueError."""
    parts = {"bodies": whole.bodies, "contacts": whole.contacts}
    changes, told = {}, []
    for _ in range(int(rng.integers(1, 3))):
        part = ("bodies", "contacts", "world", "state")[rng.integers(0, 4)]
        if part in parts:
            fields = parts[part]._fields
            name = fields[rng.integers(0, len(fields))]
            value = hostile(rng, getattr(parts[part], name))
            parts[part] = changes[part] = parts[part]._replace(**{name: value})
        else:
            names = ("box", "gravity", "friction", "restitution", "scales", "segments", "surface_speeds")
            if part == "state":
                names = ("dt", "time", "step", "solver", "contacts", "bodies", "world", "solved", "name")
            name = names[rng.integers(0, len(names))]
            value = hostile(rng)
            changes[name if part == "state" else f"world.{name}"] = value
        told.append(f"{part}.{name} = {value!r}"[:300])
    world = {name[6:]: changes.pop(name) for name in list(changes) if name.startswith("world.")}

    def build() -> State:
        if world:
            changes["world"] = replace(whole.world, **world)
        return whole.replace(**changes)

    return "; ".join(told), build


def api_call(whole: State):
    """rng -> a call of the public interface with hostile arguments, and its text."""
    solvers = (PGS(sweeps=3), PGS(sweeps=3, islands=True), METHODS["NNCG"](sweeps=3))
    numbers = {name: (lambda v, cls=cls, name=name: cls(**{name: v})) for cls, name in (
        (PGS, "sweeps"), (METHODS["PSOR"], "omega"), (METHODS["BatchedPGS"], "threads"), (PGS, "tolerance"),
        (PGS, "slop"), (PGS, "substeps"), (World, "box"), (World, "scales"),
    )}  # fmt: skip
    numbers |= {
        "make_bodies": lambda v: dc.make_bodies(v),
        "circles": lambda v: dc.circles_in_box(5, size=v, seed=1),
        "radius": lambda v: dc.circles_in_box(5, radius=v, seed=1),
        "seed": lambda v: dc.circles_in_box(5, seed=v),
        "column": lambda v: dc.column(v if not isinstance(v, int) or v < 99 else -1),
        "steps": lambda v: dc.simulate(whole, steps=v if not isinstance(v, int) or v < 99 else -1),
        "dt": lambda v: dc.simulate(whole, steps=1, dt=v),
        "start": lambda v: dc.solve_contacts(whole, start=v),
        "accuracy": lambda v: dc.simulate(whole, steps=1, accuracy=v),
    }
    uses = {
        "simulate": lambda state, rng: dc.simulate(state, steps=2, solver=solvers[rng.integers(0, len(solvers))]),
        "step": lambda state, rng: dc.step(state),
        "solve_contacts": lambda state, rng: dc.solve_contacts(state, solver=solvers[rng.integers(0, 3)]),
        "solve_exactly": lambda state, rng: dc.solve_exactly(state),
        "format_state": lambda state, rng: format_state(state),
        "pack_simulation": lambda state, rng: simulation_h5.pack_simulation([state]),
    }

    for use in uses.values():  # compiled before the clock of an input runs
        for seed in range(20):
            use(whole, np.random.default_rng(seed))

    def make(rng):
        if rng.random() < 0.25:
            name, value = list(numbers)[rng.integers(0, len(numbers))], hostile(rng, [[1.0, 2.0]] * 3)
            if rng.random() < 0.5:
                value = hostile(rng)
            return f"{name} of {value!r}"[:500], lambda: numbers[name](value)
        # The exact solver checks as the others do, and takes a second for some masses that it accepts.
        name, (told, build) = list(uses)[rng.integers(0, len(uses))], damaged_state(rng, whole)
        if name == "solve_exactly" and rng.random() > 0.02:
            name = "simulate"
        return f"{name} with {told}", lambda: uses[name](build(), rng)

    return make


def hdf5_call(folder: Path):
    """rng -> a read of a damaged simulation, and its text."""
    path, state = folder / "fuzz.h5", small_state()
    packed = simulation_h5.pack_simulation([state.replace(step=step) for step in (4, 5)])
    whole = [simulation_h5.simulation_file(packed, compression=how) for how in (None, "gzip")]

    def structural(rng) -> None:
        path.write_bytes(whole[0])
        with h5py.File(path, "r+") as file:
            if rng.random() < 0.4:
                name = list(file.attrs)[rng.integers(0, len(file.attrs))]
                value = hostile(rng, file.attrs[name] if not isinstance(file.attrs[name], str) else None)
                file.attrs[name] = value
            else:
                name = list(packed.arrays)[rng.integers(0, len(packed.arrays))]
                array = packed.arrays[name]
                del file[name]
                kind = rng.integers(0, 5)
                if kind == 0:
                    file[name] = h5py.SoftLink("/" + name)
                elif kind == 1:
                    file[name] = h5py.ExternalLink(str(path), name)
                elif kind == 2:
                    file.create_dataset(name, shape=(2**40, *array.shape[1:]), dtype=array.dtype, chunks=True)
                else:
                    file[name] = hostile(rng, array)
            arrays = {n: np.asarray(file[n]) for n in packed.arrays if n in file and file[n].size < 10**6}
            attributes = {n: v for n, v in file.attrs.items() if n != "digest"}
            file.attrs["digest"] = simulation_h5._digest(attributes, arrays)

    def make(rng):
        what = "structure"
        if rng.random() < 0.33:
            try:
                structural(rng)
            except Exception as error:  # what h5py itself cannot store, or the digest cannot hold
                what = f"structure, of which {type(error).__name__}"
        else:
            what = "bytes"
            path.write_bytes(damaged(whole[rng.integers(0, 2)], rng))

        def call():
            info = simulation_h5.simulation_info(path)
            found = simulation_h5.read_simulation(path)
            assert found.count == info.count
            for k in range(found.count):
                found.state(k)

        return what, call

    return make


def models_call(folder: Path):
    """rng -> a read of a damaged network's file, and its text."""
    from deep_contact.cnn import model_file, registry

    path, whole = folder / "fuzz.h5", registry.path_of("model").read_bytes()

    def make(rng):
        path.write_bytes(damaged(whole, rng))
        return "bytes", lambda: model_file.read_metadata(path)

    return make


def fuzz(target: str, inputs: int, seed: int, folder: Path) -> None:
    """Try the inputs of a target, and write what came out into outcomes.json of the folder."""
    if target == "xml":
        fuzz_xml(inputs, seed + 1, folder)  # libFuzzer takes 0 for any seed
    elif target == "api":
        errors = (ValueError, FloatingPointError, OverflowError)
        fuzz_calls(inputs, seed, folder, api_call(small_state()), errors, 1024)
    elif target == "hdf5":
        fuzz_calls(inputs, seed, folder, hdf5_call(folder), (simulation_h5.DataFileError,), 1024)
    else:
        from deep_contact.cnn.model_file import ModelFileError

        fuzz_calls(inputs, seed, folder, models_call(folder), (ModelFileError,), 5120)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=("xml", "hdf5", "models", "api"))
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="results file, in which the target's entry is replaced")
    given, begin = parser.parse_args(), time.perf_counter()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        folder, child = Path(name), os.fork()
        if child == 0:
            try:
                fuzz(given.target, given.inputs, given.seed, folder)
            except BaseException:
                traceback.print_exc()
                os._exit(1)
            os._exit(0)
        if os.waitpid(child, 0)[1]:
            for file in (folder / "input", folder / "fuzz.h5"):
                if file.exists():
                    Path(f"crash-{given.target}-{file.name}").write_bytes(file.read_bytes())
                    print(f"kept {file.name}: {file.read_bytes()[:500]!r}")
            return 1
        outcomes = json.loads((folder / "outcomes.json").read_text())
    seconds, tried = time.perf_counter() - begin, outcomes["read"] + outcomes["refused"]
    print(f"{given.target}: {tried} inputs in {seconds:.1f} s: {outcomes}")
    if given.out:
        record = json.loads(given.out.read_text()) if given.out.exists() else {"targets": {}}
        provenance = results.provenance(seed=given.seed, wall_s=seconds)
        record["targets"][given.target] = {"inputs": tried, **outcomes, "faults": [], "provenance": provenance}
        record["provenance"] = provenance
        write_json(given.out, record)
    return 0


if __name__ == "__main__":
    sys.exit(main())
