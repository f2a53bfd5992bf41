"""Fuzzing: hostile input either works or raises the error that the documentation names; nothing else.

    python tests/tools/fuzz.py xml|hdf5|api [--inputs 20000] [--seed 0] [--out FILE]

* xml: Atheris (libFuzzer) damages state files of all dialects, guided by coverage. A state that is still read is
  written and read again, and has to give the same bytes.
* hdf5: bytes of simulations change, or are cut off, doubled and exchanged; in one file in three a part is of another
  shape, type, size or link, with a digest that fits.
* api: functions of the public interface get arrays and numbers of the wrong type, shape, sign, order or size.

The script fails on any other exception, above 1 GB of memory, or if an input takes a minute of processor time (xml:
10 s by the clock). The input that fails is kept in the working directory, as `crash-…` or `fuzz-…`.
"""

import argparse
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

if sys.argv[1:2] == ["xml"]:
    import atheris  # which only this target needs, and whose instruments no compiled function takes

    with atheris.instrument_imports(include=["deep_contact.io.state_xml", "deep_contact.io.old_dialects"]):
        import deep_contact.io.state_xml
import h5py
import numpy as np

import deep_contact as dc
from deep_contact.figures import results
from deep_contact.io import simulation_h5
from deep_contact.io.files import write_json
from deep_contact.io.state_xml import format_state, parse_state
from deep_contact.io.xml_tree import StateFileError
from deep_contact.solvers import METHODS, PGS
from deep_contact.state.scales import BOX2D
from deep_contact.state.world import World

OLD_FILES = Path(__file__).resolve().parents[1] / "io" / "data"
ODD = (
    *("nan", "-inf", "1e309", "1e-400", "-0.0", "1_0", "0x10", "٣", "1,5", "9" * 19, "9" * 5000, "10737418240", "-1"),
    *("&lt;", "&#0;", "&x;", "b2Vec2(0,1)", "b2Vec2(1e999,0)", "circle", "box", "ground", "fixed", "free", "(" * 500),
    *("dcCircleShape(radius=-1)", "b2CircleShape(radius=1,)", "dcLoopShape(vertices=[(0,0)])", "__import__('os')"),
)
ATTRIBUTE, VALUE, NAME = rb'\s\w+="[^"]*"', rb'(?<==")[^"]*(?=")', rb'(?<=[<\s/])[A-Za-z_]+(?=[\s=>/"])'
ELEMENT = rb"(?s)<(\w+)[^<>]*/>|<(body|contact|shape|bodies|contacts)\b.*?</\2>"


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


def fuzz_xml(inputs: int, seed: int, folder: Path, report) -> None:
    """Try the inputs. libFuzzer does not return, so the last input ends the process."""
    outcomes = Counter(slowest_s=0.0)
    for number, data in enumerate(seed_files()):
        (folder / str(number)).write_bytes(data)

    def try_input(data: bytes) -> None:
        begin = time.perf_counter()
        try:
            again = format_state(parse_state(data, "fuzz.xml"))
            assert format_state(parse_state(again, "again.xml")) == again, "a state does not come back the same"
            outcomes["read"] += 1
        except StateFileError as error:
            outcomes["refused"] += 1
            if not re.fullmatch("(?s)(?=.*fuzz.xml).{,1000}", str(error)):
                raise AssertionError("expected a message of at most 1000 characters that names the file") from error
        outcomes["slowest_s"] = max(outcomes["slowest_s"], time.perf_counter() - begin)
        if outcomes["read"] + outcomes["refused"] == inputs:
            report(outcomes)
            shutil.rmtree(folder)
            os._exit(0)

    limits = [f"-runs={inputs}", "-rss_limit_mb=1024", "-timeout=10", "-len_control=0", "-mutate_depth=2"]
    # libFuzzer takes 0 for any seed.
    atheris.Setup(["fuzz", *limits, f"-seed={seed + 1}", str(folder)], try_input, custom_mutator=damage)
    atheris.Fuzz()


def fuzz_calls(inputs: int, seed: int, make, errors: tuple, kept: Path) -> Counter:
    """Try `inputs` calls. make(rng) returns a call as a text and as a function without arguments.

    Each function has to return, or to raise one of the errors with a message of at most 2000 characters. The file
    `kept` has the text of the present call, and is removed after the last one.
    """
    outcomes = Counter(read=0, refused=0, slowest_s=0.0)
    for number in range(inputs):
        what, call = make(np.random.default_rng((seed, number)))
        kept.write_text(f"input {number} of seed {seed}: {what}")
        # A limit of processor time, since other programs may run; and an alarm for an input that waits for ever.
        signal.setitimer(signal.ITIMER_PROF, 60)
        signal.alarm(1800)
        begin = time.process_time()
        try:
            call()
            outcomes["read"] += 1
        except errors as error:
            outcomes["refused"] += 1
            if not 0 < len(str(error)) <= 2000:
                raise AssertionError("expected a message of 1 to 2000 characters") from error
        outcomes["slowest_s"] = max(outcomes["slowest_s"], time.process_time() - begin)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        assert peak < 1024**2, f"expected at most 1 GB, got {peak // 1024} MB"
    kept.unlink()
    return outcomes


def damaged(data: bytes, rng) -> bytes:
    """The bytes with one to four places changed, cut off, doubled or exchanged."""
    found = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        # Half of the damage where the structure of an HDF5 file usually begins.
        at = int(rng.integers(0, max(1, len(found) if rng.random() < 0.5 else min(len(found), 4096))))
        kind, size = rng.integers(0, 6), int(rng.integers(1, 9))
        if kind == 0:
            found[at : at + 1] = bytes(byte ^ (1 << int(rng.integers(0, 8))) for byte in found[at : at + 1])
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


def one_of(rng, values):
    """One of the values, drawn at random."""
    return list(values)[rng.integers(0, len(values))]


def hostile(rng, like=None):
    """A value that nobody should hand over; often an array like another, with a fault."""
    odd = (None, "x", b"x", True, -1, 0, 2**63, 1e400, -1e300, float("nan"), 1j, [], {}, (), object(), [[1], [1, 2]])
    if like is None or rng.random() < 0.2:
        return one_of(rng, odd)
    array = np.array(like)
    if array.size and rng.random() < 0.5 and array.dtype.kind in "if":
        values = (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e308, 1e-320, 1e13, -1e13, 7.0)
        if array.dtype.kind == "i":
            values = (-1, 0, 1, 2, 4, 7, 2**31, 2**62, -(2**63))
        array.flat[rng.integers(0, array.size)] = one_of(rng, values)
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
        return one_of(rng, faults)()
    except (ValueError, TypeError, IndexError):
        return array


def small_state():
    """A state that all the calls of `api_call` take: four circles with contacts."""
    return dc.simulate(dc.column(4), steps=4, solver=PGS(sweeps=5)).state


def damaged_state(rng, whole):
    """The fault of a state, one field of one or two of its parts, as a text; and a function that makes the state."""
    changes = []
    for part in rng.choice(["bodies", "contacts", "world", "state"], size=rng.integers(1, 3), replace=False):
        owner = whole if part == "state" else getattr(whole, part)
        of_arrays = part in ("bodies", "contacts")
        name = one_of(rng, owner._fields if of_arrays else [field.name for field in fields(owner)])
        changes.append((part, owner, name, hostile(rng, getattr(owner, name) if of_arrays else None)))

    def build():
        found = {}
        for part, owner, name, value in changes:
            change = replace if part == "world" else type(owner)._replace if part != "state" else None
            found |= {part: change(owner, **{name: value})} if change else {name: value}
        return whole.replace(**found)

    return "; ".join(f"{part}.{name} = {value!r}"[:300] for part, _, name, value in changes), build


def api_call(whole):
    """A function of rng that returns a call of the public interface with hostile arguments: its text, and itself."""
    solvers = (PGS(sweeps=3), PGS(sweeps=3, islands=True), METHODS["NNCG"](sweeps=3))
    options = (
        (PGS, "sweeps"), (METHODS["PSOR"], "omega"), (METHODS["BatchedPGS"], "sweeps"), (PGS, "tolerance"),
        (PGS, "slop"), (PGS, "substeps"), (World, "box"), (World, "scales"),
    )  # fmt: skip
    arguments = {f"{made.__name__}.{name}": lambda v, made=made, name=name: made(**{name: v}) for made, name in options}
    arguments |= {
        "make_bodies": dc.make_bodies,
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
        "simulate": lambda state, solver: dc.simulate(state, steps=2, solver=solver),
        "step": lambda state, _: dc.step(state),
        "solve_contacts": lambda state, solver: dc.solve_contacts(state, solver=solver),
        "solve_exactly": lambda state, _: dc.solve_exactly(state),
        "format_state": lambda state, _: format_state(state),
        "pack_simulation": lambda state, _: simulation_h5.pack_simulation([state]),
    }
    for use in uses.values():  # compiled before the clock of an input runs
        for solver in solvers:
            use(whole, solver)

    def make(rng):
        if rng.random() < 0.25:
            name, value = one_of(rng, arguments), hostile(rng, [[1.0, 2.0]] * 3 if rng.random() < 0.5 else None)
            return f"{name} of {value!r}"[:500], lambda: arguments[name](value)
        name, solver, (told, build) = one_of(rng, uses), one_of(rng, solvers), damaged_state(rng, whole)
        # The exact solver checks as the others do, and takes a second for some masses that it accepts.
        if name == "solve_exactly" and rng.random() > 0.02:
            name = "simulate"
        return f"{name} with {told}", lambda: uses[name](build(), solver)

    return make


def hdf5_call(path: Path):
    """A function of rng that returns a read of a damaged simulation: its text, and itself."""
    state = small_state()
    packed = simulation_h5.pack_simulation([state.replace(step=step) for step in (4, 5)])
    whole = [simulation_h5.simulation_file(packed, compression=how) for how in (None, "gzip")]

    def damage_structure(rng) -> None:
        path.write_bytes(whole[0])
        with h5py.File(path, "r+") as file:
            if rng.random() < 0.4:
                name = one_of(rng, file.attrs)
                file.attrs[name] = hostile(rng, file.attrs[name] if not isinstance(file.attrs[name], str) else None)
            else:
                name = one_of(rng, packed.arrays)
                array, kind = packed.arrays[name], rng.integers(0, 5)
                del file[name]
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

    def read():
        info, found = simulation_h5.simulation_info(path), simulation_h5.read_simulation(path)
        assert found.count == info.count
        for k in range(found.count):
            found.state(k)

    def make(rng):
        if rng.random() < 0.33:
            with suppress(Exception):  # what h5py itself cannot store, or the digest cannot hold
                damage_structure(rng)
            return "structure", read
        path.write_bytes(damaged(one_of(rng, whole), rng))
        return "bytes", read

    return make


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=("xml", "hdf5", "api"))
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="results file, in which the target's entry is replaced")
    target, inputs, seed, out = vars(parser.parse_args()).values()
    begin = time.perf_counter()
    if child := os.fork():  # so that the peak of memory is that of the child alone
        sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))

    def report(outcomes: Counter) -> None:
        seconds, tried = time.perf_counter() - begin, outcomes["read"] + outcomes["refused"]
        outcomes["peak_memory_kB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(f"{target}: {tried} inputs in {seconds:.1f} s: {dict(outcomes)}", flush=True)
        if out:
            record = json.loads(out.read_text()) if out.exists() else {"targets": {}}
            record["provenance"] = provenance = results.provenance(seed=seed, wall_s=seconds)
            record["targets"][target] = {"inputs": tried, **outcomes, "faults": [], "provenance": provenance}
            write_json(out, record)

    if target == "xml":
        fuzz_xml(inputs, seed, Path(tempfile.mkdtemp()), report)
    path = Path(f"fuzz-{target}.h5")
    if target == "api":
        make, errors = api_call(small_state()), (ValueError, FloatingPointError, OverflowError)
    else:
        make, errors = hdf5_call(path), (simulation_h5.DataFileError,)
    warnings.simplefilter("ignore")
    report(fuzz_calls(inputs, seed, make, errors, path.with_suffix(".txt")))
    path.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
