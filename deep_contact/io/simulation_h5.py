"""Simulations as HDF5 files: `write_simulation`, `read_simulation`, `simulation_info`.

One file, `<folder>/sim_0000.h5`, stores one simulation. It stores the states exactly (float64), so that network images
for any grid, kernel and set of channels can be made of them later. data/README.md has the meaning of the attributes and
arrays (`_ARRAYS`). Four attributes are optional, and stored only if the world has them: scales, (8,), the fields of
`ContactScales`; segments, (4 S,); surface_speeds, (S,); segment_velocities, (4 S,). Two arrays are optional: the
positions of the segments in each state, if segments move; and the work of kinematics and external forces until each
state, if there are any.

`digest` is the SHA-256 of the attributes and the uncompressed arrays in a fixed order. It does not depend on the
compression, and is checked when the arrays are read. Every fault of a file raises a `DataFileError`.

Tests: tests/cnn/test_dataset.py, tests/io/test_hostile.py, tests/io/test_segments_files.py
"""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import NamedTuple

import h5py
import numpy as np

from deep_contact.io import hdf5
from deep_contact.io.files import FileError, write_bytes
from deep_contact.solvers import METHODS, solver_from
from deep_contact.state.arrays import Bodies, Contacts
from deep_contact.state.checks import check_state
from deep_contact.state.equality import by_value
from deep_contact.state.fields import contact_faults
from deep_contact.state.materials import MOST_MATERIALS
from deep_contact.state.scales import ContactScales
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.validation import expect, number, one_of, refuse_where
from deep_contact.state.world import World

FORMAT = "deep-contact simulation"
VERSION = 1

MAX_BYTES = 2**31
"""Largest size of a simulation in a file, uncompressed, bytes."""

_MAX_TEXT = 2**16
_ARRAYS = {
    "step": ("<i8", "T"),
    "time": ("<f8", "T"),
    "solved": ("|u1", "T"),
    "sweeps": ("<i4", "T"),
    "theta": ("<f8", "T"),
    "contact_offset": ("<i8", "E"),
    "mass": ("<f8", "n"),
    "radius": ("<f8", "n"),
    "position": ("<f8", "Tn2"),
    "velocity": ("<f8", "Tn2"),
    "angle": ("<f8", "Tn"),
    "spin": ("<f8", "Tn"),
    "body_a": ("<i4", "M"),
    "body_b": ("<i4", "M"),
    "contact_position": ("<f8", "M2"),
    "normal": ("<f8", "M2"),
    "separation": ("<f8", "M"),
    "normal_impulse": ("<f8", "M"),
    "tangent_impulse": ("<f8", "M"),
    "normal_start": ("<f8", "M"),
    "tangent_start": ("<f8", "M"),
}
"""Array -> type in the file, and dimensions: T states, E = T + 1, n circles, M contacts of all states together, 2 for x
and y."""

_RARE = {"segment": ("<f8", "TS4"), "work": ("<f8", "T"), "material": ("<i4", "n")}
"""Optional arrays, in the form of `_ARRAYS`: the ends of all S segments in each state, m, stored if segments move; the
work of kinematics and external forces until each state, J; the materials of the circles, stored if any is not 0."""

_BODIES, _CONTACTS = tuple(_ARRAYS)[8:12], tuple(_ARRAYS)[12:]
_MATERIALS = ("touches", "wall_materials", "segment_materials", "rolling_friction")
_TEXTS = ("format", "name", "solver", "seed", "options", "digest")
_WORLD = ("box", "gravity", "friction", "restitution")
_OPTIONAL = ("scales", "segments", "surface_speeds", "segment_velocities", *_MATERIALS)
_NUMBERS = {"version": "<i8"} | dict.fromkeys(("dt", *_WORLD, *_OPTIONAL), "<f8")

_SHARED = ("name", "world", "dt", "solver")
"""Fields that are equal in all states of a simulation."""

_MOST_SEGMENTS = 2000
"""Largest number of segments in a file: an attribute of HDF5 has at most 64 KiB."""


class DataFileError(FileError):
    """Error: a file of states cannot be read. The message names file, field and value."""


@by_value
@dataclass(frozen=True, kw_only=True, eq=False)
class StoredSimulation:
    """The states of one simulation, in memory.

    header: the attributes of the file, with `seed`, `options` and `solver` decoded. arrays: name -> array.
    """

    header: dict
    arrays: dict[str, np.ndarray]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of header and arrays, hexadecimal. It is computed on first use."""
        return _digest(_attributes(self.header), self.arrays)

    @property
    def count(self) -> int:
        """Number of states T."""
        return self.arrays["step"].shape[0]

    @property
    def bytes(self) -> int:
        """Size of the arrays in memory, bytes."""
        return sum(array.nbytes for array in self.arrays.values())

    def state(self, index: int) -> StateWithContacts:
        """Return state `index`, 0 … T − 1, equal to the written state to the last bit. Its arrays are copies."""
        if not 0 <= index < self.count:
            raise IndexError(f"index: expected one from 0 to {self.count - 1}, got {index}")
        a, of_contacts = self.arrays, slice(*self.arrays["contact_offset"][index : index + 2])
        shared = {name: self.header[name] for name in _SHARED}
        if "segment" in a:
            shared["world"] = replace(shared["world"], segments=a["segment"][index])
        return State(
            **shared,
            preset=self.header.get("preset"),
            bodies=Bodies(
                *(a[name][index].copy() for name in _BODIES),
                a["mass"].copy(),
                a["radius"].copy(),
                a["material"].astype(np.int64) if "material" in a else None,
            ),
            contacts=Contacts(*(a[name][of_contacts].copy() for name in _CONTACTS)),
            time=float(a["time"][index]),
            step=int(a["step"][index]),
            solved=bool(a["solved"][index]),
        )


def pack_simulation(
    states: Iterable[State], *, sweeps=None, theta=None, work=None, seed=None, options=None
) -> StoredSimulation:
    """Return states of one simulation as arrays, a `StoredSimulation`.

    states: states with contacts, which have equal name, world, dt and solver, and the same circles. Only the positions
    of moving segments may differ. sweeps, theta: number of sweeps, and θ of the last sweep, N·s, of each state, (T,).
    Without them, −1 and NaN are stored. work: work of kinematics and external forces until each state, (T,), J, or
    None. seed, options: seed and options with which the simulation was made, any values that JSON can store. Raises
    ValueError, which names the state and the field.
    """
    states = [check_state(state) for state in states]
    expect(states, "states: expected at least one state, got none")
    first = states[0]
    for i, state in enumerate(states):
        expect(state.contacts is not None, f"states[{i}].contacts: expected contacts, got None")
        for name in _SHARED:
            expected, got = getattr(first, name), getattr(state, name)
            if name == "world" and got.segment_velocities and len(got.segments) == len(expected.segments):
                got = replace(got, segments=expected.segments)
            if got != expected:
                raise ValueError(f"states[{i}].{name}: expected that of the first state, {expected!r}, got {got!r}")
        n, circles = first.bodies.count, state.bodies.count
        expected = f"the {n} circles of the first state, as a trajectory has them (dc.film shows any states)"
        expect(circles == n, f"states[{i}].bodies: expected {expected}, got {circles}")
        for name in ("mass", "radius", "material"):
            same = np.array_equal(getattr(state.bodies, name), getattr(first.bodies, name))
            expect(same, f"states[{i}].bodies.{name}: expected that of the first state, got another")
    known = first.solver is None or type(first.solver) in METHODS.values()
    expect(known, f"states[0].solver: expected None or one of {', '.join(METHODS)}, got {first.solver!r}")
    expect("\0" not in first.name, f"states[0].name: expected text without NUL, got {first.name!r}")
    arrays = {
        "step": np.array([s.step for s in states], np.int64),
        "time": np.array([s.time for s in states], np.float64),
        "solved": np.array([s.solved for s in states], np.uint8),
        "sweeps": _per_state("sweeps", sweeps, len(states), np.int32, -1),
        "theta": _per_state("theta", theta, len(states), np.float64, math.nan),
        "contact_offset": np.cumsum([0, *(s.contacts.count for s in states)], dtype=np.int64),
        "mass": first.bodies.mass,
        "radius": first.bodies.radius,
        **{name: np.stack([getattr(s.bodies, name) for s in states]) for name in _BODIES},
        **{name: np.concatenate(parts) for name, parts in zip(_CONTACTS, zip(*(s.contacts for s in states)))},
    }
    if first.bodies.material.any():
        arrays["material"] = first.bodies.material
    if first.world.segment_velocities:
        arrays["segment"] = np.array([s.world.segments for s in states])
    if work is not None:
        arrays["work"] = _per_state("work", work, len(states), np.float64, 0.0)
    header = {name: getattr(first, name) for name in _SHARED} | {"dt": float(first.dt)}
    header |= {
        "preset": states[-1].preset,
        "seed": _json_value("seed", seed),
        "options": _json_value("options", {} if options is None else options),
    }
    return StoredSimulation(header=header, arrays=arrays)


def write_simulation(path, states: Iterable[State], *, compression: str | None = "gzip", **recorded) -> str:
    """Write states of one simulation to an HDF5 file in one move. Returns the digest of its contents.

    compression: "gzip" (lossless, known to every HDF5 reader), "lzf" or None. recorded: other arguments of
    `pack_simulation`. Equal arguments give equal bytes. Raises ValueError, which names the state and the field.
    """
    simulation = pack_simulation(states, **recorded)
    write_bytes(path, simulation_file(simulation, compression=compression))
    return simulation.digest


def simulation_file(simulation: StoredSimulation, *, compression="gzip") -> bytes:
    """Return the bytes of a simulation's file. compression, and errors, are those of `write_simulation`."""
    one_of("compression", compression, ("gzip", "lzf", None))
    size, segments = simulation.bytes, len(simulation.header["world"].segments)
    expect(size <= MAX_BYTES, f"states: expected at most {MAX_BYTES} bytes a file, got {size}")
    expect(segments <= _MOST_SEGMENTS, f"segments: expected at most {_MOST_SEGMENTS:,} in a file, got {segments:,}")
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        for name, value in (_attributes(simulation.header) | {"digest": simulation.digest}).items():
            if isinstance(value, str):
                # A text of fixed length: a reader knows its length before it reads the text. HDF5 has no text of length
                # 0.
                file.attrs.create(name, value.encode(), dtype=f"S{max(1, len(value.encode()))}")
            else:
                file.attrs.create(name, value, dtype=_NUMBERS[name])
        for name, array in simulation.arrays.items():
            options = {}
            if compression and array.size:
                rows = max(1, 2**18 // max(1, array.nbytes // array.shape[0]))
                options = {"chunks": (min(rows, array.shape[0]), *array.shape[1:]), "shuffle": True}
                options |= {"compression": compression, "compression_opts": 1 if compression == "gzip" else None}
            # Flushed at once. Otherwise, if a profiler holds a reference to a dataset, its bytes are written after
            # those of the next dataset.
            file.create_dataset(name, data=array.astype((_ARRAYS | _RARE)[name][0]), **options).flush()
    return buffer.getvalue()


def read_simulation(path) -> StoredSimulation:
    """Read the simulation in a file, and check all of it.

    Raises DataFileError, which names file, field and value, if the file is truncated, altered or of another kind.
    Raises OSError if it cannot be opened.
    """
    with hdf5.opened(path, DataFileError) as file:
        attributes, datasets = _read_attributes(file), _datasets(file)
        header = _header(attributes)
        arrays = hdf5.read(datasets, MAX_BYTES)
        arrays |= {name: arrays[name].astype(np.int64) for name in ("body_a", "body_b")}
        _check_arrays(arrays, len(header["world"].segments))
        digest = attributes.pop("digest")
        # The digest of the attributes as they are stored. The header may also have options of the solver that are newer
        # than the file.
        actual = _digest(attributes, arrays)
        expect(actual == digest, f"digest: expected that of the contents, {actual}, got {digest}: altered or damaged")
    simulation = StoredSimulation(header=header, arrays=arrays)
    vars(simulation)["digest"] = digest  # fills the cached property
    return simulation


class SimulationInfo(NamedTuple):
    """Header, digest and number of states of a file, without its arrays.

    The digest is not checked; only `read_simulation` checks it.
    """

    header: dict
    digest: str
    count: int


def simulation_info(path) -> SimulationInfo:
    """Return header, digest and number of states of a file. Errors are those of `read_simulation`."""
    with hdf5.opened(path, DataFileError) as file:
        attributes, datasets = _read_attributes(file), _datasets(file)
        return SimulationInfo(_header(attributes), attributes["digest"], datasets["step"].size)


# ---- details of a file ----


def _per_state(name: str, values, count: int, dtype, missing) -> np.ndarray:
    if values is None:
        return np.full(count, missing, dtype)
    array = np.asarray(values)
    fits = array.shape == (count,) and array.dtype.kind in ("iu" if dtype is np.int32 else "iuf")
    expect(fits, f"{name}: expected {count} numbers, one a state, got {array.dtype}, shape {array.shape}")
    return array.astype(dtype)


def _json_value(name: str, value):
    """Return `value` as it comes back if it is written as JSON and read. Raises ValueError if JSON cannot store it."""
    try:
        text = json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected what JSON can hold, got {value!r}: {error}") from None
    expect(len(text) <= _MAX_TEXT, f"{name}: expected at most {_MAX_TEXT} characters of JSON, got {len(text)}")
    return json.loads(text)


def _attributes(header: dict) -> dict:
    """Return the attributes of a file, without its digest.

    An optional attribute is left out if it is not set, so that the digests of older files stay valid.
    """
    solver, world = header["solver"], header["world"]
    settings = None if solver is None else {"method": type(solver).__name__, **asdict(solver)}
    if solver is not None and header.get("preset") is not None:
        settings["preset"] = header["preset"]
    optional = {"scales": tuple(world.scales or ()), "segments": tuple(np.ravel(world.segments).tolist())}
    optional["surface_speeds"] = world.surface_speeds
    optional["segment_velocities"] = tuple(np.ravel(world.segment_velocities).tolist())
    optional["touches"] = () if world.touches is True else np.array(world.touches, float).tolist()
    optional |= {name: tuple(map(float, getattr(world, name))) for name in _MATERIALS[1:3]}
    optional["rolling_friction"] = world.rolling_friction
    if not any(world.wall_materials):
        del optional["wall_materials"]
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": header["name"],
        "dt": header["dt"],
        **{name: getattr(world, name) for name in _WORLD},
        **{name: value for name, value in optional.items() if value},
        "solver": json.dumps(settings, sort_keys=True, default=lambda value: value.item()),
        **{name: json.dumps(header[name], sort_keys=True) for name in ("seed", "options")},
    }


def _digest(attributes: dict, arrays: dict) -> str:
    sha = hashlib.sha256(json.dumps(attributes, sort_keys=True).encode())
    for name in sorted(arrays):
        stored = np.ascontiguousarray(arrays[name].astype((_ARRAYS | _RARE)[name][0], copy=False))
        sha.update(f"\n{name} {stored.dtype.str} {stored.shape}\n".encode())
        sha.update(stored)
    return sha.hexdigest()


def _read_attributes(file: h5py.File) -> dict:
    values = {}
    for name in (name for name in (*_TEXTS, *_NUMBERS) if name in file.attrs or name not in _OPTIONAL):
        value = hdf5.attribute(file, name)
        if name in _TEXTS:
            expect(isinstance(value, bytes), f"{name}: expected a text of fixed length, got {type(value).__name__}")
            values[name] = value.decode()
        else:
            array = np.asarray(value)
            expect(array.dtype.str == _NUMBERS[name], f"{name}: expected {_NUMBERS[name]}, got {array.dtype.str}")
            values[name] = tuple(array.tolist()) if array.shape else array.item()
    return values


def _header(attributes: dict) -> dict:
    """Return the header that the attributes of a file describe. Raises ValueError, which names the attribute."""
    for name, expected in (("format", FORMAT), ("version", VERSION)):
        expect(attributes[name] == expected, f"{name}: expected {expected!r}, got {attributes[name]!r}")
    header = {"name": attributes["name"], "dt": number("dt", attributes["dt"], above=0)}
    world = {name: attributes[name] for name in _WORLD}
    scales, segments = attributes.get("scales"), attributes.get("segments", ())
    if scales is not None:
        count = len(ContactScales._fields)
        expect(np.size(scales) == count, f"scales: expected {count}, got {np.size(scales)}")
        world["scales"] = ContactScales._make(scales)
    expect(np.size(segments) % 4 == 0, f"segments: expected 4 numbers each, got {np.size(segments)} in all")
    segments, velocities = np.reshape(segments, (-1, 4)).tolist(), attributes.get("segment_velocities", ())
    velocities = np.reshape(velocities, (-1, 4)) if np.size(velocities) % 4 == 0 else velocities
    speeds = attributes.get("surface_speeds", ())
    if "rolling_friction" in attributes:
        world["rolling_friction"] = attributes["rolling_friction"]
    for name in (name for name in _MATERIALS[:3] if name in attributes):
        values = np.array(attributes[name])
        whole = values.astype(int)
        expect((whole == values).all(), f"{name}: expected integers, got {attributes[name]}")
        world[name] = whole == 1 if name == "touches" else whole
    header["world"] = World(**world, segments=segments, surface_speeds=speeds, segment_velocities=velocities)
    for name in ("solver", "seed", "options"):
        try:
            header[name] = json.loads(attributes[name])
            if name == "solver" and header[name] is not None:
                options = dict(header[name])
                header["preset"] = preset = options.pop("preset", None)
                expect(preset is None or isinstance(preset, str), f"preset: expected a text, got {preset!r}")
                header[name] = solver_from(options.pop("method", None), options)
        except (TypeError, ValueError, RecursionError) as error:
            expected = "null, or a method and its options" if name == "solver" else "JSON"
            raise ValueError(f"{name}: expected {expected}, got {attributes[name][:200]!r}: {error}") from None
    return header


def _datasets(file: h5py.File) -> dict[str, h5py.Dataset]:
    """Return the arrays of a file before they are read.

    Raises ValueError unless their types and shapes fit each other.
    """
    known = _ARRAYS | {name: kind for name, kind in _RARE.items() if name in file}
    strange = sorted(set(file) ^ set(known))
    expect(not strange, f"arrays: expected {', '.join(sorted(_ARRAYS))}, missing or unknown: {strange}")
    datasets = {name: hdf5.dataset(file, name) for name in known}
    count, n, m = ((*(datasets[name].shape or ()), 0)[0] for name in ("step", "mass", "body_a"))
    expect(count, "step: expected at least one state, got none")
    segments = np.size(file.attrs.get("segment_velocities", ())) // 4
    sizes = {"T": count, "E": count + 1, "n": n, "M": m, "2": 2, "4": 4, "S": segments}
    for name, (dtype, dimensions) in known.items():
        array, shape = datasets[name], tuple(sizes[letter] for letter in dimensions)
        expect(array.dtype.str == dtype, f"{name}: expected numbers of type {dtype}, got {array.dtype.str}")
        expect(array.shape == shape, f"{name}: expected shape {shape}, got {array.shape}")
    return datasets


def _check_arrays(arrays: dict, segments: int) -> None:
    """Raise ValueError unless all states satisfy the rules of `check_state`.

    segments: number of the world's segments.
    """

    def refuse(name, bad, expected):
        refuse_where(bad, name, arrays[name], expected)

    for name, array in arrays.items():
        if array.dtype.kind == "f" and name != "theta":
            refuse(name, ~(np.isfinite(array) | ((name == "mass") & (array == np.inf))), "a finite number")
    offset, n, a, b = arrays["contact_offset"], arrays["mass"].size, arrays["body_a"], arrays["body_b"]
    end, steps = n + 4 + segments, np.diff(offset, prepend=0)
    refuse("mass", arrays["mass"] <= 0, "a number > 0")
    refuse("radius", arrays["radius"] <= 0, "a number > 0")
    if "material" in arrays:
        wrong = (arrays["material"] < 0) | (arrays["material"] >= MOST_MATERIALS)
        refuse("material", wrong, f"an integer from 0 to {MOST_MATERIALS - 1}")
    refuse("step", arrays["step"] < 0, "an integer >= 0")
    refuse("solved", arrays["solved"] > 1, "0 or 1")
    refuse("contact_offset", (steps < 0) | (offset > a.size), "rising numbers within the contacts")
    first, last = offset[[0, -1]].tolist()
    expect((first, last) == (0, a.size), f"contact_offset: expected 0 to {a.size}, got {first} to {last}")
    for name, bad, expected in contact_faults(arrays, n, segments):
        refuse(name, bad, expected)
    key = (np.repeat(np.arange(offset.size - 1), steps[1:]) * n + a) * end + b
    refuse("body_b", np.diff(key, prepend=-1) <= 0, "contacts in the order of (body_a, body_b), each pair once")
