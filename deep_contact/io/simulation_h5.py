"""Simulations as HDF5 files: `write_simulation`, `read_simulation`, `simulation_info`.

One file a simulation, `<folder>/sim_0000.h5`, holds every solved state exactly (float64), so that any image can be made
of it later, for any grid, kernel and set of channels. With T states, n circles and M contacts in all:

* attributes: format, version, name, dt, box, gravity, friction, restitution, solver, seed, options (the last three as
  JSON), digest;
* of states: step, time, solved, sweeps, theta, each (T,); contact_offset (T + 1,): the contacts of state i are
  contact_offset[i] to contact_offset[i + 1];
* of bodies: mass, radius (n,); position, velocity (T, n, 2); angle, spin (T, n);
* of contacts: body_a, body_b, separation, normal_impulse, tangent_impulse, normal_start, tangent_start (M,);
  contact_position, normal (M, 2).

`digest` is the SHA-256 of the attributes and the unpacked arrays in a fixed order, the same for every compression; it
is checked on reading. Files are written whole or not at all. Every fault of a file is a `DataFileError`.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import stat
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from deep_contact.io.files import replacing
from deep_contact.physics.methods import METHODS
from deep_contact.state import Bodies, Contacts, State, World, check_state

FORMAT = "deep-contact simulation"
VERSION = 1

MAX_BYTES = 2**31
"""Largest simulation that is read, unpacked."""

PHASES = ("impact", "settling", "rest")
SETTLING, REST = 0.5, 0.05
"""Relative errors of Builtin's start below which a state is settling, or at rest."""

_MAX_TEXT = 2**16
_STATES = {"step": "<i8", "time": "<f8", "solved": "|u1", "sweeps": "<i4", "theta": "<f8"}
_BODIES = {"position": 2, "velocity": 2, "angle": 0, "spin": 0}
_CONTACTS = {
    "body_a": 0,
    "body_b": 0,
    "contact_position": 2,
    "normal": 2,
    "separation": 0,
    "normal_impulse": 0,
    "tangent_impulse": 0,
    "normal_start": 0,
    "tangent_start": 0,
}
_TEXTS = ("format", "name", "solver", "seed", "options", "digest")
_NUMBERS = {"version": 0, "dt": 0, "box": 4, "gravity": 2, "friction": 0, "restitution": 0}


class DataFileError(ValueError):
    """A file of states that cannot be read; names file, field and value."""


# ---- one simulation ----


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredSimulation:
    """The states of one simulation, in memory.

    header: the attributes of the file (`seed`, `options` and `solver` decoded). arrays: its arrays, by name.
    digest: SHA-256 of both, hexadecimal.
    """

    header: dict
    arrays: dict[str, np.ndarray]
    digest: str

    @property
    def count(self) -> int:
        """Number of states T."""
        return self.arrays["step"].shape[0]

    @property
    def bytes(self) -> int:
        """Memory of the arrays."""
        return sum(array.nbytes for array in self.arrays.values())

    @property
    def sweeps(self) -> np.ndarray:
        """Velocity sweeps done in each state, (T,); -1 where unknown."""
        return self.arrays["sweeps"]

    @property
    def theta(self) -> np.ndarray:
        """θ after the last sweep of each state, (T,), N·s; NaN where unknown, infinite where there was no sweep."""
        return self.arrays["theta"]

    @property
    def contacts(self) -> np.ndarray:
        """Number of contacts of each state, (T,)."""
        return np.diff(self.arrays["contact_offset"])

    def state(self, index: int) -> State:
        """State `index`, 0 … T − 1, in arrays of its own; to the last bit what was written."""
        if isinstance(index, bool) or not isinstance(index, (int, np.integer)) or not 0 <= index < self.count:
            raise IndexError(f"index: expected a state, 0 to {self.count - 1}, got {index!r}")
        a, head = self.arrays, self.header
        first, last = a["contact_offset"][index : index + 2]
        return State(
            name=head["name"],
            world=head["world"],
            bodies=Bodies(
                *(a[name][index].copy() for name in ("position", "velocity", "angle", "spin")),
                a["mass"].copy(),
                a["radius"].copy(),
            ),
            contacts=Contacts(*(a[name][first:last].copy() for name in _CONTACTS)),
            time=float(a["time"][index]),
            step=int(a["step"][index]),
            dt=head["dt"],
            solver=head["solver"],
            solved=bool(a["solved"][index]),
        )

    def start_errors(self) -> np.ndarray:
        """‖λ₀ − λ‖ / ‖λ‖ of each state, (T,): how far off the impulses are that it started from; see `start_error`."""
        a = self.arrays
        off = (a["normal_start"] - a["normal_impulse"]) ** 2 + (a["tangent_start"] - a["tangent_impulse"]) ** 2
        size = a["normal_impulse"] ** 2 + a["tangent_impulse"] ** 2
        state = np.repeat(np.arange(self.count), self.contacts)
        return _relative(*(np.bincount(state, weights, self.count) for weights in (off, size)))

    def phases(self) -> np.ndarray:
        """The phase of each state as an index of `PHASES`, (T,)."""
        return _phase_index(self.start_errors())


def start_error(state: State) -> float:
    """‖λ₀ − λ‖ / ‖λ‖ over all rows of a solved state; 0 where both are zero, infinite where only λ is."""
    c = state.contacts
    off = np.sum((c.normal_start - c.normal_impulse) ** 2 + (c.tangent_start - c.tangent_impulse) ** 2)
    return float(_relative(np.array([off]), np.array([np.sum(c.normal_impulse**2 + c.tangent_impulse**2)]))[0])


def phase(state: State) -> str:
    """One of `PHASES`, by how far off Builtin's start was: "settling" up to `SETTLING`, "rest" up to `REST`.

    For solved states of runs that Builtin started: what is new in a state is what the step before did not know.
    """
    return PHASES[_phase_index(np.array([start_error(state)]))[0]]


def _relative(off: np.ndarray, size: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(off == 0, 0.0, np.sqrt(off / size))


def _phase_index(errors: np.ndarray) -> np.ndarray:
    return (errors <= SETTLING).astype(np.int64) + (errors <= REST)


def pack_simulation(states: Iterable[State], *, sweeps=None, theta=None, seed=None, options=None) -> StoredSimulation:
    """States of one simulation as arrays. Arguments and errors as for `write_simulation`."""
    states = [check_state(state) for state in states]
    if not states:
        raise ValueError("states: expected at least one state, got none")
    first = states[0]
    for i, state in enumerate(states):
        if state.contacts is None:
            raise ValueError(f"states[{i}].contacts: expected contacts, got None")
        for name in ("name", "world", "dt", "solver"):
            if getattr(state, name) != getattr(first, name):
                expected, got = getattr(first, name), getattr(state, name)
                raise ValueError(f"states[{i}].{name}: expected that of the first state, {expected!r}, got {got!r}")
        for name in ("mass", "radius"):
            if not np.array_equal(getattr(state.bodies, name), getattr(first.bodies, name)):
                raise ValueError(f"states[{i}].bodies.{name}: expected that of the first state, got another")
    if first.solver is not None and type(first.solver) not in METHODS.values():
        raise ValueError(f"states[0].solver: expected None or one of {', '.join(METHODS)}, got {first.solver!r}")
    if "\0" in first.name:
        raise ValueError(f"states[0].name: expected text without NUL, got {first.name!r}")
    count = len(states)
    arrays = {
        "step": np.array([s.step for s in states], np.int64),
        "time": np.array([s.time for s in states], np.float64),
        "solved": np.array([s.solved for s in states], np.uint8),
        "sweeps": _per_state("sweeps", sweeps, count, np.int32, -1),
        "theta": _per_state("theta", theta, count, np.float64, math.nan),
        "contact_offset": np.cumsum([0, *(s.contacts.count for s in states)], dtype=np.int64),
        "mass": first.bodies.mass,
        "radius": first.bodies.radius,
        **{name: np.stack([getattr(s.bodies, name) for s in states]) for name in _BODIES},
    }
    for name, field in zip(_CONTACTS, Contacts._fields):
        arrays[name] = np.concatenate([getattr(s.contacts, field) for s in states])
    header = {
        "name": first.name,
        "dt": float(first.dt),
        "world": first.world,
        "solver": first.solver,
        "seed": _json_value("seed", seed),
        "options": _json_value("options", {} if options is None else options),
    }
    return StoredSimulation(header=header, arrays=arrays, digest=_digest(_attributes(header), arrays))


def write_simulation(
    path, states: Iterable[State], *, sweeps=None, theta=None, seed=None, options=None, compression="gzip"
) -> str:
    """Write states of one simulation to an HDF5 file, whole or not at all. Returns the digest of its contents.

    states: all of one name, world, dt, solver and the same circles, with contacts. sweeps, theta: of each state, (T,);
    -1 and NaN where not given. seed, options: what made the simulation, anything that JSON holds.
    compression: "gzip" (lossless, every HDF5 reader has it), "lzf" or None. The same arguments give the same bytes.
    Raises ValueError naming the state and the field.
    """
    simulation = pack_simulation(states, sweeps=sweeps, theta=theta, seed=seed, options=options)
    data = simulation_file(simulation, compression=compression)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    return simulation.digest


def simulation_file(simulation: StoredSimulation, *, compression="gzip") -> bytes:
    """The bytes of a simulation's file. compression and errors as for `write_simulation`."""
    if compression not in ("gzip", "lzf", None):
        raise ValueError(f"compression: expected 'gzip', 'lzf' or None, got {compression!r}")
    if simulation.bytes > MAX_BYTES:
        raise ValueError(f"states: expected at most {MAX_BYTES} bytes a file, got {simulation.bytes}")
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        for name, value in (_attributes(simulation.header) | {"digest": simulation.digest}).items():
            if isinstance(value, str):
                text = value.encode()
                # Of fixed length, which a reader sees before it reads; HDF5 has no text of length 0.
                file.attrs.create(name, text, dtype=f"S{max(1, len(text))}")
            else:
                file.attrs.create(name, value, dtype="<i8" if name == "version" else "<f8")
        for name, array in simulation.arrays.items():
            options = {}
            if compression and array.size:
                rows = max(1, 2**18 // max(1, array.nbytes // array.shape[0]))
                options = {"chunks": (min(rows, array.shape[0]), *array.shape[1:]), "shuffle": True}
                options |= {"compression": compression, "compression_opts": 1 if compression == "gzip" else None}
            dataset = file.create_dataset(name, data=array.astype(_stored_type(name)), **options)
            # Now, not when it is closed: whatever looks at running frames, as profilers do (Dask's workers have one),
            # may hold it open for a moment, and then its bytes would come to lie behind those of the next.
            dataset.flush()
    return buffer.getvalue()


def read_simulation(path) -> StoredSimulation:
    """The simulation in a file, checked as a whole.

    Raises DataFileError naming file, field and value where it is truncated, foreign or altered; OSError where the file
    cannot be opened.
    """
    path = Path(path)
    with _open(path) as file:
        header, attributes, shapes = _read_header(path, file)
        arrays = {name: _read_array(path, file, name, shape) for name, shape in shapes.items()}
    _check_arrays(path, arrays)
    digest = attributes.pop("digest")
    # Of the attributes as they are in the file: what is made of them may gain options that old files do not have.
    found = _digest(attributes, arrays)
    if found != digest:
        raise DataFileError(f"{path}: digest: expected that of the contents, {found}, got {digest}: altered or damaged")
    return StoredSimulation(header=header, arrays=arrays, digest=digest)


class SimulationInfo(NamedTuple):
    """What a file says of itself, read without its arrays.

    | field  | meaning                                                                       |
    |--------|-------------------------------------------------------------------------------|
    | header | name, dt, world, solver, seed, options                                        |
    | digest | SHA-256 as the file has it; `read_simulation` checks it against the contents  |
    | count  | number of states                                                              |
    | bytes  | memory of the arrays                                                          |
    """

    header: dict
    digest: str
    count: int
    bytes: int


def simulation_info(path) -> SimulationInfo:
    """The header of a file. Errors as for `read_simulation`."""
    path = Path(path)
    with _open(path) as file:
        header, attributes, shapes = _read_header(path, file)
    return SimulationInfo(header, attributes["digest"], shapes["step"][0], _memory(shapes))


# ---- details of a file ----


class _open:
    """A file of ours, open for reading; whatever HDF5 stumbles over inside the block becomes a DataFileError."""

    def __init__(self, path: Path):
        self.path = path

    def __enter__(self) -> h5py.File:
        if not stat.S_ISREG(self.path.stat().st_mode):
            raise DataFileError(f"{self.path}: expected a file, got a folder, pipe or device")
        with open(self.path, "rb"):
            pass  # a file that may not be read is an OSError, not a fault of its contents
        try:
            self.file = h5py.File(self.path, "r", locking=False)
        except (OSError, RuntimeError, ValueError) as error:
            raise DataFileError(f"{self.path}: expected an HDF5 file, whole and undamaged: {error}") from None
        return self.file

    def __exit__(self, kind, error, _):
        self.file.close()
        hdf5_faults = (OSError, RuntimeError, KeyError, TypeError, OverflowError, MemoryError)
        if kind is not None and (issubclass(kind, hdf5_faults) or kind in (ValueError, UnicodeDecodeError)):
            raise DataFileError(f"{self.path}: expected an undamaged file: {error}") from None


def _stored_type(name: str) -> str:
    return _STATES.get(name) or {"contact_offset": "<i8", "body_a": "<i4", "body_b": "<i4"}.get(name, "<f8")


def _per_state(name: str, given, count: int, dtype, missing) -> np.ndarray:
    if given is None:
        return np.full(count, missing, dtype)
    array = np.asarray(given)
    if array.shape != (count,) or array.dtype.kind not in ("iu" if dtype is np.int32 else "iuf"):
        raise ValueError(f"{name}: expected {count} numbers, one a state, got {array.dtype}, shape {array.shape}")
    return array.astype(dtype)


def _json_value(name: str, value):
    """`value` as JSON gives it back, so that it is the same before and after the file."""
    try:
        text = json.dumps(value, allow_nan=False, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: expected what JSON can hold, got {value!r}: {error}") from None
    if len(text) > _MAX_TEXT:
        raise ValueError(f"{name}: expected at most {_MAX_TEXT} characters of JSON, got {len(text)}")
    return json.loads(text)


def _attributes(header: dict) -> dict:
    """The attributes of a file but its digest, in the order of the digest."""
    solver, world = header["solver"], header["world"]
    settings = None if solver is None else {"method": type(solver).__name__, **asdict(solver)}
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": header["name"],
        "dt": header["dt"],
        "box": world.box,
        "gravity": world.gravity,
        "friction": world.friction,
        "restitution": world.restitution,
        "solver": json.dumps(settings, sort_keys=True, default=_number),
        "seed": json.dumps(header["seed"], sort_keys=True),
        "options": json.dumps(header["options"], sort_keys=True),
    }


def _number(value):
    return value.item() if isinstance(value, np.generic) else value


def _digest(attributes: dict, arrays: dict) -> str:
    sha = hashlib.sha256(json.dumps(attributes, sort_keys=True).encode())
    for name in sorted(arrays):
        stored = np.ascontiguousarray(arrays[name].astype(_stored_type(name), copy=False))
        sha.update(f"\n{name} {stored.dtype.str} {stored.shape}\n".encode())
        sha.update(stored)
    return sha.hexdigest()


def _read_header(path: Path, file: h5py.File) -> tuple[dict, dict, dict]:
    """(header, attributes as they are, shape of every array); all sizes are checked before any array is read."""
    texts = {name: _read_text(path, file, name) for name in _TEXTS}
    if texts["format"] != FORMAT:
        raise DataFileError(f"{path}: format: expected {FORMAT!r}, got {texts['format']!r}")
    numbers = {name: _read_number(path, file, name, size) for name, size in _NUMBERS.items()}
    if numbers["version"] != VERSION:
        raise DataFileError(f"{path}: version: expected {VERSION}, got {numbers['version']!r}")
    decoded = {}
    for name in ("solver", "seed", "options"):
        try:
            decoded[name] = json.loads(texts[name])
        except (ValueError, RecursionError) as error:
            raise DataFileError(f"{path}: {name}: expected JSON, got {texts[name][:80]!r}: {error}") from None
    try:
        world = World(**{name: numbers[name] for name in ("box", "gravity", "friction", "restitution")})
    except ValueError as error:
        raise DataFileError(f"{path}: {error}") from None
    if not (math.isfinite(numbers["dt"]) and numbers["dt"] > 0):
        raise DataFileError(f"{path}: dt: expected a finite number > 0, got {numbers['dt']}")
    header = {"name": texts["name"], "dt": numbers["dt"], "world": world, **decoded}
    header["solver"] = _solver_of(path, decoded["solver"])
    expected = {*_STATES, *_BODIES, *_CONTACTS, "contact_offset", "mass", "radius"}
    if set(file) != expected:
        strange = sorted(set(file) ^ expected)
        raise DataFileError(f"{path}: arrays: expected {', '.join(sorted(expected))}, missing or unknown: {strange}")
    return header, texts | numbers, _checked_shapes(path, file)


def _solver_of(path: Path, settings):
    if settings is None:
        return None
    method = settings.get("method") if isinstance(settings, dict) else None
    if not isinstance(method, str) or method not in METHODS:
        raise DataFileError(f"{path}: solver: expected null or a method among {', '.join(METHODS)}, got {settings!r}")
    try:
        return METHODS[method](**{name: value for name, value in settings.items() if name != "method"})
    except (TypeError, ValueError) as error:
        raise DataFileError(f"{path}: solver: expected options of {method}, got {settings!r}: {error}") from None


def _read_text(path: Path, file: h5py.File, name: str) -> str:
    dtype, shape = _attribute(path, file, name)
    if dtype.kind != "S" or shape != () or dtype.itemsize > 4 * _MAX_TEXT:
        raise DataFileError(f"{path}: {name}: expected a text of fixed length, got {dtype}, shape {shape}")
    try:
        return bytes(file.attrs[name]).decode()
    except UnicodeDecodeError as error:
        raise DataFileError(f"{path}: {name}: expected UTF-8: {error}") from None


def _read_number(path: Path, file: h5py.File, name: str, size: int):
    dtype, shape = _attribute(path, file, name)
    if dtype.str != ("<i8" if name == "version" else "<f8") or shape != ((size,) if size else ()):
        expected = f"{size} numbers" if size else "a number"
        raise DataFileError(f"{path}: {name}: expected {expected}, got {dtype}, shape {shape}")
    value = file.attrs[name]
    return tuple(value.tolist()) if size else value.item()


def _attribute(path: Path, file: h5py.File, name: str):
    if name not in file.attrs:
        raise DataFileError(f"{path}: {name}: expected this attribute, got none: not a file of ours")
    attribute = file.attrs.get_id(name)
    return attribute.dtype, attribute.shape


def _checked_shapes(path: Path, file: h5py.File) -> dict[str, tuple[int, ...]]:
    shapes = {}
    for name in file:
        # Links and external storage would read other files.
        link = file.get(name, getlink=True)
        array = file[name] if isinstance(link, h5py.HardLink) else None
        if not isinstance(array, h5py.Dataset) or array.is_virtual or array.external:
            raise DataFileError(f"{path}: {name}: expected an array in this file, got {array or link}")
        if array.dtype.str != _stored_type(name):
            raise DataFileError(f"{path}: {name}: expected numbers of type {_stored_type(name)}, got {array.dtype.str}")
        shapes[name] = array.shape
    for name in ("step", "mass", "body_a"):
        if shapes[name] is None or len(shapes[name]) != 1:
            raise DataFileError(f"{path}: {name}: expected one dimension, got shape {shapes[name]}")
    (count,), (n,), (m,) = shapes["step"], shapes["mass"], shapes["body_a"]
    expected = {name: (count,) for name in _STATES} | {"contact_offset": (count + 1,), "mass": (n,), "radius": (n,)}
    expected |= {name: (count, n, columns) if columns else (count, n) for name, columns in _BODIES.items()}
    expected |= {name: (m, columns) if columns else (m,) for name, columns in _CONTACTS.items()}
    for name, shape in expected.items():
        if shapes[name] != shape:
            raise DataFileError(f"{path}: {name}: expected shape {shape}, got {shapes[name]}")
    if count == 0 or _memory(shapes) > MAX_BYTES:
        raise DataFileError(
            f"{path}: expected at least one state and at most {MAX_BYTES} bytes unpacked, got {count} states, "
            f"{_memory(shapes)} bytes"
        )
    return {name: shapes[name] for name in expected}


def _memory(shapes: dict) -> int:
    return sum(8 * math.prod(shape) for shape in shapes.values())


def _read_array(path: Path, file: h5py.File, name: str, shape) -> np.ndarray:
    try:
        array = file[name][...]
    except (OSError, RuntimeError) as error:
        raise DataFileError(f"{path}: {name}: expected an array, whole and undamaged: {error}") from None
    return array.astype(np.int64) if name in ("body_a", "body_b") else array


def _check_arrays(path: Path, arrays: dict) -> None:
    """What `check_state` asks of every state, for all at once."""

    def refuse(bad, name, expected):
        if bad.any():
            at = tuple(int(i) for i in np.argwhere(bad)[0])
            where = ", ".join(map(str, at))
            raise DataFileError(f"{path}: {name}[{where}]: expected {expected}, got {arrays[name][at]}")

    for name, array in arrays.items():
        if array.dtype.kind == "f" and name != "theta":
            refuse(~np.isfinite(array), name, "a finite number")
    for name in ("mass", "radius"):
        refuse(arrays[name] <= 0, name, "a number > 0")
    refuse(arrays["step"] < 0, "step", "an integer >= 0")
    refuse(arrays["solved"] > 1, "solved", "0 or 1")
    refuse(arrays["normal_impulse"] < 0, "normal_impulse", "a number >= 0")
    offset, n, a, b = arrays["contact_offset"], arrays["mass"].size, arrays["body_a"], arrays["body_b"]
    steps = np.diff(offset, prepend=0)
    refuse((steps < 0) | (offset > a.size), "contact_offset", "rising numbers within the contacts")
    if offset[0] != 0 or offset[-1] != a.size:
        raise DataFileError(f"{path}: contact_offset: expected 0 to {a.size}, got {offset[0]} to {offset[-1]}")
    refuse((a < 0) | (a >= n), "body_a", f"a circle, 0 to {n - 1}")
    refuse((b <= a) | (b >= n + 4), "body_b", f"a body after body_a, up to {n + 3}")
    length = np.hypot(*arrays["normal"].T)
    refuse(np.stack([np.abs(length - 1) > 1e-4] * 2, axis=1), "normal", "a unit vector")
    state = np.repeat(np.arange(offset.size - 1), np.diff(offset))
    key = (state * n + a) * (n + 4) + b
    refuse(np.diff(key, prepend=-1) <= 0, "body_b", "contacts in the order of (body_a, body_b), each pair once")
